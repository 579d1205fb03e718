// A page with A-Frame: window.show() draws a model and returns the normals of its vertices.

import { applySkinbake } from 'skinbake-three';
import { worldNormals } from './viewed.mjs';

window.show = async ({ url, pose }) => {
    document.body.insertAdjacentHTML('beforeend', '<a-scene embedded><a-entity id="hero" position="0 0 -3"></a-entity></a-scene>');
    const scene = document.querySelector('a-scene');
    const hero = document.getElementById('hero');
    if (!scene.hasLoaded) await new Promise((resolve) => scene.addEventListener('loaded', resolve));
    hero.setAttribute('gltf-model', url);
    await new Promise((resolve) => hero.addEventListener('model-loaded', resolve));
    const model = hero.getObject3D('mesh');
    const mixer = new AFRAME.THREE.AnimationMixer(model);
    mixer.clipAction(model.animations[pose.clip]).play();
    mixer.setTime(pose.time);
    model.traverse((object) => (object.frustumCulled = false));
    const meshes = applySkinbake(hero.object3D);
    return worldNormals(meshes[0], () => scene.camera, () => {});
};
