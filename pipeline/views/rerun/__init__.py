"""Recordings for the Rerun viewer, and serving them to viewers."""
