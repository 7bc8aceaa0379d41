"""Measurements beside what you would use instead: `python -m benchmarks.NAME` prints a table."""
