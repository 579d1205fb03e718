"""A bake inside a file: storing, reading and removing it."""
