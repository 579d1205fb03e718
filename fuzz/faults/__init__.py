"""Kills, signals and I/O errors at every call that writes: each target stays as it was, or is all new."""
