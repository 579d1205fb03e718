// Every name of the package as an application uses it, for tsc --strict.

import { AssetType, type GLTFResource, type WebGLEngine } from '@galacean/engine';
import { lighting, registerSkinbake, report, unregisterSkinbake, type MeshReport } from 'skinbake-galacean';

export async function show(engine: WebGLEngine): Promise<string[]> {
    registerSkinbake({ method: 'dqs' });
    const { resourceManager, sceneManager } = engine;
    const resource = await resourceManager.load<GLTFResource>({ url: 'hero.glb', type: AssetType.GLTF });
    const [scene] = sceneManager.scenes;
    const entity = resource.instantiateSceneRoot();
    scene.addRootEntity(entity);
    const found: MeshReport[] = [...report(scene), ...report(entity), ...report([entity])];
    lighting(entity, 'standard');
    lighting(scene, 'accurate');
    unregisterSkinbake();
    // @ts-expect-error: there are two lightings
    lighting(scene, 'other');
    return found.map(({ renderer, lighting, reason }) => `${renderer.entity.name} ${lighting}: ${reason}`);
}
