"""Files and workers beyond this machine: URLs, staging, Dask."""
