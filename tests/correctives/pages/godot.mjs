// What the tests call in the browser: Godot's web build plays a clip, with none of our code.

import { base64 } from '/support/base64.mjs';

const canvas = document.getElementById('canvas');
const paths = { executable: '/engine/index', mainPack: '/project/main.zip' };
const engine = new Engine({ ...paths, canvas, canvasResizePolicy: 0, args: [] });
const frame = () => new Promise(requestAnimationFrame);
await engine.startGame();
for (const start = performance.now(); !window.isStarted; await frame()) {
    if (performance.now() - start > 60000) throw new Error('the project did not start');
}

// The normals that each draw hands on, in the scene. The page sets weights of the morph targets of a node first,
// and runs code of documentation last. The clip may be from another file, clipsOf.
window.played = async ({ url, clipsOf = url, clip, time, node = '', weights = [], code = '' }) => {
    engine.copyToFS('/model.glb', await (await fetch(url)).arrayBuffer());
    engine.copyToFS('/clips.glb', await (await fetch(clipsOf)).arrayBuffer());
    window.show(JSON.stringify({ path: '/model.glb', clips: '/clips.glb', clip, time, node, weights, code }));
    if (window.answer) throw new Error(window.answer);
    // Godot fills the joint texture at the end of a frame, and uses its copy in the next.
    for (let i = 0; i < 3; i++) await frame();
    CAPTURE.draws = [];
    CAPTURE.on = true;
    await frame();
    CAPTURE.on = false;
    return CAPTURE.draws.filter(({ name }) => name === 'normal_interp').map(({ values }) => base64(values));
};
