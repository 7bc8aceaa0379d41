"""One module or a few for each outside format: MCAP, Parquet, DuckDB, Rerun, figures. Nothing is computed here."""
