// Accurate lighting in Babylon.js for skinned meshes that skinbake has baked, under WebGL 2 and WebGPU.
//
// One module serves all characters: frame, encoding, scale, layout, names and influences come from their
// files. Use:
//
//     import { registerSkinbake } from 'skinbake-babylon'; // or what `skinbake shader` has written
//
//     registerSkinbake(); // once, before the first file is loaded

import {
    registerGLTFExtension,
    unregisterGLTFExtension,
} from '@babylonjs/loaders/glTF/2.0/glTFLoaderExtensionRegistry.js';
import { watch } from './lighting.js';
import { Loading, NAME } from './loading.js';
import { METHOD } from './shaders.js';

export { lighting, report } from './lighting.js';

/**
 * Load alpha and beta with every glTF file from now on. Skinned meshes that have them are lit accurately.
 *
 * @param {{ method?: 'lbs' | 'dqs' }} [options] - Linear blending, as Babylon.js has it, or dual quaternions.
 * @throws {Error} If the method is neither.
 */
export function registerSkinbake({ method = METHOD } = {}) {
    if (method !== 'lbs' && method !== 'dqs') throw new Error(`skinbake: method ${method} is neither lbs nor dqs`);
    unregisterGLTFExtension(NAME);
    registerGLTFExtension(NAME, false, (loader) => new Loading(loader, watch, method));
}

/** Load files as before. What is loaded stays as it is. */
export function unregisterSkinbake() {
    unregisterGLTFExtension(NAME);
}
