//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
//% if stage == "compute"
// A compute pass in HLSL of shader model 5.
//% else
// HLSL of shader model 5. Pure functions: no semantics, buffers or globals.
//% endif
//
@{ text.inputs }
//
@{ text.usage }

#ifndef @{ guard }
#define @{ guard }

@{ text.snippet }

#endif
