// A page with model-viewer: window.show() draws a model and returns the normals of its vertices.

import '@google/model-viewer';
import { applySkinbake } from 'skinbake-three';
import { worldNormals } from './viewed.mjs';

window.show = async ({ url, pose }) => {
    const viewer = document.createElement('model-viewer');
    viewer.style = 'width: 64px; height: 64px';
    viewer.autoplay = true;
    viewer.src = url;
    document.body.append(viewer);
    await new Promise((resolve) => viewer.addEventListener('load', resolve));
    viewer.play();
    viewer.pause();
    viewer.currentTime = pose.time;
    const symbol = Object.getOwnPropertySymbols(viewer).find(({ description }) => description === 'scene');
    const scene = viewer[symbol];
    const meshes = applySkinbake(scene);
    return worldNormals(meshes[0], () => scene.camera, () => viewer[symbol].queueRender());
};
