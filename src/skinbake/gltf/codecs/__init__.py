"""Compressed geometry: Draco, meshopt, and the change of a document from one to the other."""
