"""Kills, signals and I/O errors at every call that writes: each target must be the old bytes or the new ones."""
