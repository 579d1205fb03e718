//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
@{ text.inputs }
//
@{ text.usage }

#ifndef @{ guard }
#define @{ guard }

@{ text.snippet }

#endif
