"""The catalog of all tables as one DuckDB file, its views, and questions asked in a process of their own."""
