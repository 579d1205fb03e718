"""Compressed geometry: Draco, meshopt, and moving a document between them."""
