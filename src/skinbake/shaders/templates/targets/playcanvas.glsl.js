//% if lighting == "approximated"
//%   set _ = refuse("--target playcanvas: approximated lighting is PlayCanvas's own; use --lighting accurate or direct")
//% elif method == "dqs" and lighting != "exact"
//%   set _ = refuse("--target playcanvas: use --lighting exact with --method dqs")
//% elif influences > 4
//%   set _ = refuse("--target playcanvas: PlayCanvas reads four influences per vertex, not " ~ influences ~ "; bake with --limit-influences 4")
//% elif influences < 4
//%   set _ = refuse("--target playcanvas: PlayCanvas always reads four influences per vertex; use --influences 4")
//% endif
//% set blended = lighting if method == "lbs" else "accurate"
//% set common = {"morphs": "normal", "frame": "tangent", "encoding": "float32", "layout": "attributes", "attributes": None, "also": ["frame_normal"]}
//% set lbs = text_for(language="glsl", method="lbs", lighting=blended, **common)
//% set dqs = text_for(language="glsl", method="dqs", lighting="exact", mirrored_joints=False, **common)
//% set glsl = dict(lbs.parts, **dqs.parts).values() | join("\n\n")
//% set lbs = text_for(language="wgsl", method="lbs", lighting=blended, **common)
//% set dqs = text_for(language="wgsl", method="dqs", lighting="exact", mirrored_joints=False, **common)
//% set wgsl = dict(lbs.parts, **dqs.parts).values() | join("\n\n")
// Accurate lighting in PlayCanvas for skinned meshes that skinbake has baked. For WebGL 2 and WebGPU.
//
// Written by skinbake @{ version }:
//     @{ command }
//
// One module serves all characters: frame, encoding, scale, layout and names come from the file. Use:
//
//     import { skinbakeOptions } from 'skinbake-playcanvas';
//
//     const asset = new Asset('hero', 'container', { url: 'hero.glb' }, null, skinbakeOptions(app));
//
// Linear blending: algorithm @{ lbs.algorithm } of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient
// Lighting for Skinned Models", Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions:
// algorithm 6 of skinbake, the exact derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal
// Basis, Revisited", JCGT 6(1), 2017.

import {
    ADDRESS_CLAMP_TO_EDGE,
    FILTER_NEAREST,
    LitMaterial,
    Mat4,
    PIXELFORMAT_RGBA32F,
    SEMANTIC_BLENDWEIGHT,
    SEMANTIC_NORMAL,
    SEMANTIC_POSITION,
    SHADERLANGUAGE_GLSL,
    SHADERLANGUAGE_WGSL,
    ShaderChunks,
    StandardMaterial,
    Texture,
    Vec3,
} from 'playcanvas';

const METHOD = '@{ method }';

//% include "playcanvas/core.js"

//% include "playcanvas/joints.js"

//% include "playcanvas/loading.js"

//% include "playcanvas/glsl.js"

//% include "playcanvas/wgsl.js"
