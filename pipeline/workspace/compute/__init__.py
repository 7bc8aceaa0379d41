"""Computing a set part by part, on the cores of this machine or on a Dask cluster."""
