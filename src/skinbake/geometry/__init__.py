"""Geometry on plain arrays: triangles, tangent frames, dual quaternions, poses of joints."""
