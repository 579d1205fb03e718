"""Templates to GLSL and WGSL text, one file a language and algorithm, one file a target engine."""
