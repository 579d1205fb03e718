
// What follows drawing.mjs where GLTF2Export is installed.
import { GLTF2Export } from '@babylonjs/serializers/glTF/2.0/glTFSerializer.js';

// The attributes of a character that is drawn, and then exported as often as is asked for.
window.exported = async ({ times, ...options }) => {
    const { scene, mesh } = await load(options);
    mesh.name = 'exported';
    await draw(scene);
    let names = [];
    for (let number = 0; number < times; number++) {
        const { files } = await GLTF2Export.GLTFAsync(scene, 'exported');
        const { meshes } = JSON.parse(files['exported.gltf']);
        names = meshes.flatMap(({ primitives }) => primitives.flatMap(({ attributes }) => Object.keys(attributes)));
    }
    return { names, report: told(scene) };
};
