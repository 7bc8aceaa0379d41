"""The report of a project: its contents, and the HTML file that holds them."""
