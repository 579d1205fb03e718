// What the tests call in the browser: scenes of Babylon.js, drawn as a page draws them. What comes back are the
// normals that the vertex shaders handed on.

import '@babylonjs/core/Animations/animatable.js';
import { FreeCamera } from '@babylonjs/core/Cameras/freeCamera.js';
import { Engine } from '@babylonjs/core/Engines/engine.js';
import '@babylonjs/core/Engines/Extensions/index.js';
import { ImportMeshAsync } from '@babylonjs/core/Loading/sceneLoader.js';
import { Quaternion, Vector3 } from '@babylonjs/core/Maths/math.vector.js';
import { DirectionalLight } from '@babylonjs/core/Lights/directionalLight.js';
import { Scene } from '@babylonjs/core/scene.js';
import '@babylonjs/loaders/glTF/2.0/index.js';
import * as skinbake from 'skinbake-babylon';

const engines = {};

async function engineOf(backend) {
    engines[backend] ??= started(backend);
    return engines[backend];
}

async function started() {
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = 64;
    document.body.append(canvas);
    return new Engine(canvas, false);
}

async function load({ backend = 'webgl', url, pose = {}, left = false, plugin = true }) {
    const engine = await engineOf(backend);
    const scene = new Scene(engine);
    scene.useRightHandedSystem = !left;
    new DirectionalLight('sun', new Vector3(-1, -1, -1), scene);
    scene.activeCamera = new FreeCamera('camera', new Vector3(0, 0, -3), scene);
    if (plugin) skinbake.registerSkinbake();
    else skinbake.unregisterSkinbake();
    const loaded = await ImportMeshAsync(url, scene, { pluginExtension: '.glb' });
    for (const group of loaded.animationGroups) group.stop();
    if (pose.clip !== undefined) {
        const group = loaded.animationGroups[pose.clip];
        group.start(false);
        group.pause();
        group.goToFrame(60 * pose.time);
    }
    const meshes = loaded.meshes.filter((mesh) => mesh.geometry);
    for (const [joint, turn] of (pose.turned ?? []).entries()) {
        const bone = meshes[0].skeleton.bones.find((one) => one.getIndex() === joint);
        const [w, x, y, z] = turn;
        const node = bone.getTransformNode();
        node.rotationQuaternion = node.rotationQuaternion.multiply(new Quaternion(x, y, z, w));
    }
    for (const mesh of meshes) mesh.alwaysSelectAsActiveMesh = true;
    return { scene, meshes, loaded };
}

// Draw until everything is compiled, then once more, recorded.
async function draw(scene) {
    await scene.whenReadyAsync();
    scene.render();
    scene.render();
    CAPTURE.draws = [];
    CAPTURE.on = true;
    scene.render();
    CAPTURE.on = false;
    return CAPTURE.draws.map(({ values }) => base64(values));
}

function base64(floats) {
    const bytes = new Uint8Array(floats.buffer, floats.byteOffset, floats.byteLength);
    let text = '';
    for (let at = 0; at < bytes.length; at += 8192) {
        text += String.fromCharCode(...bytes.subarray(at, at + 8192));
    }
    return btoa(text);
}

const told = (reports) => reports.map(({ lighting, reason }) => [lighting, reason]);

const api = {
    async normals(options) {
        const { scene } = await load(options);
        const draws = await draw(scene);
        const report = told(skinbake.report(scene));
        scene.dispose();
        return { draws, report };
    },
};

CAPTURE.names = ['vNormalW'];
Object.assign(window, api);
