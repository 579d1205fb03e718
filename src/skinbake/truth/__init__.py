"""True normals of deformed meshes: the mesh, both truths, the replay in blocks, and compiled loops."""
