"""Recordings: MCAP files with joint states, read as untrusted data and written."""
