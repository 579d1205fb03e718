"""Pictures of a baked file without a browser, through WebGPU: the extra ``skinbake[render]``."""
