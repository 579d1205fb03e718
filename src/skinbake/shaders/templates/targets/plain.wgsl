//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
@{ text.inputs }
//
@{ text.usage }

@{ text.snippet }
