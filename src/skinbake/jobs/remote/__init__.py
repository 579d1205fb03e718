"""Files and workers elsewhere: URLs, staging, Dask. Nothing else needs this package."""
