"""The versions of the program and of its file format."""

__version__ = "0.1.0"

FILE_FORMAT = 1
"""The version of the metadata in baked files, which docs/reference/file-format.md defines."""

FIT = 5
"""The version of fitted gradients. It rises with every change of their numbers that verify would notice."""
