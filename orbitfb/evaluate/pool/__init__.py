"""How independent tasks are run: in this process, in local processes, on a Dask cluster."""
