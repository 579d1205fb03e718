"""Correct lighting without a shader: morph targets of normals, played by the clips of a file."""
