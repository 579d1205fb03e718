// What the tests call in the browser: Babylon.js plays a clip as a page does, with none of our code.

import '@babylonjs/core/Animations/animatable.js';
import { FreeCamera } from '@babylonjs/core/Cameras/freeCamera.js';
import { Engine } from '@babylonjs/core/Engines/engine.js';
import '@babylonjs/core/Engines/Extensions/index.js';
import { DirectionalLight } from '@babylonjs/core/Lights/directionalLight.js';
import { ImportMeshAsync, LoadAssetContainerAsync } from '@babylonjs/core/Loading/sceneLoader.js';
import { Vector3 } from '@babylonjs/core/Maths/math.vector.js';
import '@babylonjs/core/Meshes/instancedMesh.js';
import { Scene } from '@babylonjs/core/scene.js';
import '@babylonjs/loaders/glTF/2.0/index.js';
import { base64 } from '/support/base64.mjs';

CAPTURE.names = ['vNormalW'];

const canvas = document.createElement('canvas');
canvas.width = canvas.height = 16;
document.body.append(canvas);
const engine = new Engine(canvas, false);

const targetsOf = (manager) => Array.from({ length: manager.numTargets }, (_, target) => manager.getTarget(target));

function frame(scene) {
    engine.beginFrame();
    scene.render();
    engine.endFrame();
}

// The normals that each draw hands on, in the scene. The page sets weights of the morph targets of a node first,
// and runs code of documentation last. The clip may be from another file, clipsOf.
window.played = async ({ url, clip, time, clipsOf, node, weights = [], code = '' }) => {
    const scene = new Scene(engine);
    scene.useRightHandedSystem = true;
    new DirectionalLight('sun', new Vector3(-1, -2, -3), scene);
    scene.activeCamera = new FreeCamera('camera', new Vector3(0, 0, -3), scene);
    let { animationGroups } = await ImportMeshAsync(url, scene, { pluginExtension: '.glb' });
    for (const group of animationGroups) group.stop();
    if (clipsOf) {
        const other = await LoadAssetContainerAsync(clipsOf, scene, { pluginExtension: '.glb' });
        const morphs = (meshes) => meshes.flatMap(({ morphTargetManager: found }) => (found ? targetsOf(found) : []));
        const targets = morphs(other.meshes);
        const ours = morphs(scene.meshes);
        animationGroups = other.animationGroups.map((group) =>
            group.clone(group.name, (target) => ours[targets.indexOf(target)] ?? scene.getNodeByName(target.name)),
        );
    }
    const morphed = scene.getMeshByName(node)?.morphTargetManager;
    weights.forEach((weight, target) => (morphed.getTarget(target).influence = weight));
    animationGroups[clip].start(false);
    animationGroups[clip].pause();
    animationGroups[clip].goToFrame(60 * time);
    for (const mesh of scene.meshes) mesh.alwaysSelectAsActiveMesh = true;
    for (const end = performance.now() + 60000; !scene.isReady(); ) {
        if (performance.now() > end) throw new Error('the scene is never ready');
        await new Promise((resolve) => setTimeout(resolve, 2));
    }
    frame(scene);
    new Function('scene', code)(scene);
    frame(scene);
    CAPTURE.draws = [];
    CAPTURE.on = true;
    frame(scene);
    CAPTURE.on = false;
    const draws = CAPTURE.draws.map(({ values }) => base64(values));
    scene.dispose();
    return draws;
};
