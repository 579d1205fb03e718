//% set text = text_for(reads=["snorm16", "packed8", "texcoord"])
@{ text.header }
//% if stage == "compute"
// A compute pass in WGSL for WebGPU. All bindings are in group 0.
//% else
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//% endif
//
@{ text.inputs }
//
@{ text.usage }

@{ text.snippet }
