"""GLSL, WGSL and HLSL text from templates: one file for each language and algorithm, and for each engine."""
