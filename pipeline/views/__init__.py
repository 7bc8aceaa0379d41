"""What people look at, and what figures, recordings and the report share: palette, captions, summaries."""
