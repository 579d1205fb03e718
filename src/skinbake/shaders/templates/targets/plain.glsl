//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
//% if stage == "compute"
// A compute pass in GLSL 4.50, for Vulkan and OpenGL.
//% else
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//% endif
//
@{ text.inputs }
//
@{ text.usage }

//% if stage == "compute"
#version 450

//% endif
#ifndef @{ guard }
#define @{ guard }

@{ text.snippet }

#endif
