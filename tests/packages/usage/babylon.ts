// Every name of the package as an application uses it, for tsc --strict.

import { ImportMeshAsync, LoadAssetContainerAsync } from '@babylonjs/core/Loading/sceneLoader.js';
import { Scene } from '@babylonjs/core/scene.js';
import { lighting, registerSkinbake, report, unregisterSkinbake, type MeshReport } from 'skinbake-babylon';

export async function show(scene: Scene): Promise<string[]> {
    registerSkinbake();
    const loaded = await ImportMeshAsync('hero.glb', scene);
    const container = await LoadAssetContainerAsync('hero.glb', scene);
    const found: MeshReport[] = [...report(scene), ...report(loaded), ...report(container), ...report(loaded.meshes)];
    found.push(...report(container.instantiateModelsToScene()));
    lighting(loaded.meshes[0], 'standard');
    lighting(scene, 'accurate');
    unregisterSkinbake();
    // @ts-expect-error: there are two lightings
    lighting(scene, 'other');
    return found.map((one) => `${one.mesh.name} ${one.lighting}: ${one.reason}`);
}
