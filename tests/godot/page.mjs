// What the tests call in the browser: files shown by Godot's web build, and vertices read back.

const said = [];
const canvas = document.getElementById('canvas');
const engine = new Engine({
    executable: '/engine/index',
    mainPack: '/project/main.zip',
    canvas,
    canvasResizePolicy: 0,
    args: [],
    onPrint: (...words) => said.push(words.join(' ')),
    onPrintError: (...words) => said.push(words.join(' ')),
});
await engine.startGame();
for (const start = performance.now(); !window.isStarted; await frame()) {
    if (performance.now() - start > 60000) throw new Error(`the project did not start: ${said.join('\n')}`);
}

// Show a file, and return the answer of main.gd, the draws of one frame, and what Godot has said. Options: url, and
// those of main.gd; isDrawn: false skips the draws, isPictured adds the picture. later: changes of the running scene,
// each after two frames. The draws are those of the very frame after the last one.
window.shown = async (options) => {
    said.length = 0;
    engine.copyToFS('/model.glb', await (await fetch(options.url)).arrayBuffer());
    window.show(JSON.stringify({ ...options, path: '/model.glb' }));
    if (options.isDrawn === false) return { ...JSON.parse(window.answer), said: [...said] };
    // Godot fills the joint texture at the end of a frame, and uses its copy in the next.
    for (let i = 0; i < 2; i++) await frame();
    for (const change of options.later ?? []) {
        for (let i = 0; i < 2; i++) await frame();
        window.change(change);
    }
    CAPTURE.draws = [];
    CAPTURE.on = true;
    await frame();
    CAPTURE.on = false;
    const draws = CAPTURE.draws.map(({ name, values }) => ({ name, values: encoded(values) }));
    const picture = options.isPictured ? await pictured() : '';
    window.look();
    return { ...JSON.parse(window.answer), ...JSON.parse(window.seen), draws, picture, said: [...said] };
};

// The pixels of the canvas must be read in the frame that draws them.
async function pictured() {
    await frame();
    const gl = canvas.getContext('webgl2');
    const pixels = new Uint8Array(4 * canvas.width * canvas.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return encoded(pixels);
}

function frame() {
    return new Promise(requestAnimationFrame);
}

function encoded(array) {
    const bytes = new Uint8Array(array.buffer);
    let text = '';
    for (let at = 0; at < bytes.length; at += 0x8000) text += String.fromCharCode(...bytes.subarray(at, at + 0x8000));
    return btoa(text);
}
