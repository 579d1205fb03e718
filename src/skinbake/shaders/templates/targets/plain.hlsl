//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
// HLSL, shader model 4.0 or later. Pure functions: no semantics, buffers or globals.
//
@{ text.inputs }
//
@{ text.usage }

#ifndef @{ guard }
#define @{ guard }

@{ text.snippet }

#endif
