"""The texts of ``skinbake.shaders``: compiled, run, counted and compared."""
