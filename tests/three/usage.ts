// Every name of the package as an application uses it, for tsc --strict.

import { Scene, SkinnedMesh } from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { applySkinbake, dispose, lighting, type MeshReport, report, SkinbakePlugin } from 'skinbake-three';
import { applySkinbake as applyToNodes } from 'skinbake-three/webgpu';

export async function show(scene: Scene): Promise<string[]> {
    const loader = new GLTFLoader();
    loader.register((parser) => new SkinbakePlugin(parser, { method: 'dqs', cap: 0.9 }));
    const gltf = await loader.loadAsync('hero.glb');
    scene.add(gltf.scene);
    const found: MeshReport[] = [...applySkinbake(scene, { method: 'lbs', cap: 0.9 }), ...report(scene)];
    applyToNodes(scene);
    lighting(scene, 'standard');
    dispose(scene);
    const meshes: SkinnedMesh[] = found.map((one) => one.mesh);
    // @ts-expect-error: the methods are lbs and dqs
    applySkinbake(scene, { method: 'other' });
    // @ts-expect-error: there are two lightings
    lighting(scene, 'other');
    return [...meshes.map((mesh) => mesh.name), ...found.map((one) => `${one.lighting}: ${one.reason}`)];
}
