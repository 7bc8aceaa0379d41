"""The report: its contents, and one HTML file that holds them."""
