"""Figures, recordings for the viewer and the report, and what they share: colours, captions, summaries."""
