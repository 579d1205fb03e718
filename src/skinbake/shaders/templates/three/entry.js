const METHOD = '@{ method }';

/**
 * Light the baked skinned meshes below an object accurately. Meshes that are not baked stay as they are.
 * Doing it again repairs what was changed since.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 * @param {{ method?: 'lbs' | 'dqs' }} [options] - Linear blending, as three.js has it, or dual quaternions.
 * @returns {SkinbakeReport} What each skinned mesh is drawn with. It stays up to date.
 */
export function applySkinbake(root, { method = METHOD } = {}) {
    @{ served | default("serveWebGL") }();
    return apply(root, method);
}

/** A plugin of GLTFLoader: `loader.register((parser) => new SkinbakePlugin(parser))`. */
export class SkinbakePlugin {
    constructor(parser, { method = METHOD } = {}) {
        this.name = 'SKINBAKE';
        this.parser = parser;
        this.method = method;
    }

    // The report is in userData.skinbake of what the loader returns.
    afterRoot(gltf) {
        @{ served | default("serveWebGL") }();
        gltf.userData ??= {};
        gltf.userData.skinbake = applyToAll(gltf, this.parser, this.method);
        return null;
    }
}
