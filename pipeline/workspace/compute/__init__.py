"""What computes the parts of a set: this machine's cores or a Dask cluster."""
