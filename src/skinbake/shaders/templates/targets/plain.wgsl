@{ header }
// WGSL for WebGPU. Pure functions: no bindings and no module variables.
//
@{ inputs }
//
@{ usage }

@{ snippet }
