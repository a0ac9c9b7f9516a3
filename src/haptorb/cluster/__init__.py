"""Where long computations run besides this process: the cores of this computer, or a Dask cluster."""
