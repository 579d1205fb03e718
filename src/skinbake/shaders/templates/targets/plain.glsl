@{ header }
// Compiles as GLSL ES 3.00, 3.30 and 4.50. Pure functions: no attributes, uniforms or globals.
//
@{ inputs }
//
@{ usage }

#ifndef @{ guard }
#define @{ guard }

@{ snippet }

#endif
