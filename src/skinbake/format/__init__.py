"""A bake inside a file: what it stores, how it is read, and how it is taken out again."""
