// A page of three.js with WebGLRenderer: window.show() draws a model and returns the normals of its vertices.

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { SkinbakePlugin } from 'skinbake-three';

window.show = async ({ url, pose }) => {
    const loader = new GLTFLoader();
    loader.register((parser) => new SkinbakePlugin(parser));
    const { scene, animations, userData } = await loader.loadAsync(url);
    const mixer = new THREE.AnimationMixer(scene);
    mixer.clipAction(animations[pose.clip]).play();
    mixer.setTime(pose.time);
    scene.traverse((object) => (object.frustumCulled = false));
    const renderer = new THREE.WebGLRenderer();
    const camera = new THREE.PerspectiveCamera(); // At the origin: view space is the world.
    for (let frame = 0; frame < 3; frame++) {
        CAPTURE.draws = [];
        CAPTURE.on = true;
        renderer.render(scene, camera);
        CAPTURE.on = false;
        await null;
    }
    const [{ mesh, lighting, reason }] = userData.skinbake;
    return { values: [...CAPTURE.draws[0].values], report: [lighting, reason], world: mesh.matrixWorld.toArray() };
};
