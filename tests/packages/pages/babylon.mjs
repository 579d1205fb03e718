// A page of Babylon.js: window.show() draws a model and returns the normals of its vertices.

import '@babylonjs/core/Animations/animatable.js';
import { FreeCamera } from '@babylonjs/core/Cameras/freeCamera.js';
import { Engine } from '@babylonjs/core/Engines/engine.js';
import { DirectionalLight } from '@babylonjs/core/Lights/directionalLight.js';
import { ImportMeshAsync } from '@babylonjs/core/Loading/sceneLoader.js';
import { Vector3 } from '@babylonjs/core/Maths/math.vector.js';
import { Scene } from '@babylonjs/core/scene.js';
import '@babylonjs/loaders/glTF/2.0/index.js';
import { registerSkinbake, report } from 'skinbake-babylon';

CAPTURE.names = ['vNormalW'];

window.show = async ({ url, pose }) => {
    registerSkinbake();
    const canvas = document.createElement('canvas');
    const scene = new Scene(new Engine(canvas, false));
    scene.useRightHandedSystem = true;
    new DirectionalLight('sun', new Vector3(-1, -2, -3), scene);
    scene.activeCamera = new FreeCamera('camera', new Vector3(0, 0, -3), scene);
    const { animationGroups } = await ImportMeshAsync(url, scene, { pluginExtension: '.glb' });
    for (const group of animationGroups) group.stop();
    animationGroups[pose.clip].start(false);
    animationGroups[pose.clip].pause();
    animationGroups[pose.clip].goToFrame(60 * pose.time);
    for (const mesh of scene.meshes) mesh.alwaysSelectAsActiveMesh = true;
    await scene.whenReadyAsync();
    for (let frame = 0; frame < 3; frame++) {
        CAPTURE.draws = [];
        CAPTURE.on = true;
        scene.render();
        CAPTURE.on = false;
    }
    const [{ lighting, reason }] = report(scene);
    return { values: [...CAPTURE.draws[0].values], report: [lighting, reason] };
};
