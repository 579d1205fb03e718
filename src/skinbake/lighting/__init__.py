"""Measurements of a baked file: whether α and β are still right, and how good its lighting is."""
