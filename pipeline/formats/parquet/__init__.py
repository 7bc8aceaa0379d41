"""Tables: Parquet files that follow the schemas of `schemas/`, whole or in partitions."""
