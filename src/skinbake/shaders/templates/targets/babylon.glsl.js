//% if method != "lbs"
//%   set _ = refuse("--target babylon: Babylon.js blends joint matrices; use --method lbs")
//% elif lighting == "direct"
//%   set _ = refuse("--target babylon: its module corrects normals by the accurate algorithm only; use --lighting accurate")
//% elif lighting != "accurate"
//%   set _ = refuse("--target babylon: use --lighting accurate; approximated lighting is Babylon.js's own")
//% elif influences > 8
//%   set _ = refuse("--target babylon: Babylon.js reads eight influences per vertex, not " ~ influences ~ "; bake with --limit-influences 8")
//% elif influences < 4
//%   set _ = refuse("--target babylon: Babylon.js always reads four or eight influences per vertex; use --influences 4")
//% endif
//% set common = {"reads": ["packed8"], "morphs": "normal", "frame": "tangent", "encoding": "packed8", "layout": "attributes", "attributes": None, "mirrored_joints": True}
//% set glsl = text_for(language="glsl", influences=8, also=["frame_normal", "morphed_tangent"], **common)
//% set glsl_four = text_for(language="glsl", influences=4, **common)
//% set wgsl = text_for(language="wgsl", influences=8, also=["frame_normal", "morphed_tangent"], **common)
//% set wgsl_four = text_for(language="wgsl", influences=4, **common)
// Accurate lighting in Babylon.js for skinned meshes that skinbake has baked, under WebGL 2 and WebGPU.
//
// Written by skinbake @{ version }:
//     @{ command }
//
// One module serves all characters: frame, encoding, scale, layout, names and influences come from their
// files. Use:
//
//     import { registerSkinbake } from './skinbake.js'; // npm: 'skinbake-babylon'
//
//     registerSkinbake(); // once, before the first file is loaded
//
// Algorithm @{ glsl.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

import { Buffer, VertexBuffer } from '@babylonjs/core/Buffers/buffer.js';
import { Material } from '@babylonjs/core/Materials/material.js';
import { MaterialPluginBase } from '@babylonjs/core/Materials/materialPluginBase.js';
import { PushMaterial } from '@babylonjs/core/Materials/pushMaterial.js';
import { DracoDecoder } from '@babylonjs/core/Meshes/Compression/dracoDecoder.js';
import {
    registerGLTFExtension,
    unregisterGLTFExtension,
} from '@babylonjs/loaders/glTF/2.0/glTFLoaderExtensionRegistry.js';

//% include "babylon/loading.js"
@{ "" }
//% include "babylon/glsl.js"
@{ "" }
//% include "babylon/wgsl.js"
@{ "" }
//% include "babylon/lighting.js"
