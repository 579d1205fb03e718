//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
// HLSL of shader model 5. Pure functions: no semantics, buffers or globals.
//
@{ text.inputs }
//
@{ text.usage }

#ifndef @{ guard }
#define @{ guard }

@{ text.snippet }

#endif
