// The page: what is chosen, what is drawn, and when.

import { Camera } from './camera.js';
import { Chart, isKnown } from './chart.js';
import { degrees, isolated, showFigures, showNotes } from './figures.js';
import { fromBase64, gradientsOf, ReadError, readModel } from './reader.js';
import { LIGHTINGS, pause, Renderer } from './renderer.js';
import { Scene } from './scene.js';

const NAMES = {
    standard: 'Standard',
    corrected: 'Corrected by targets',
    surface: 'Accurate, surface',
    fitted: 'Accurate, fitted',
    dqs: 'Dual quaternions, exact',
    truth: 'True normals',
};
const SAMPLES = 49;
const LEGENDS = [2, 5, 10, 20, 30, 45, 60, 90];
const HEAT = ['#d9dde1', '#f2d16b', '#ee8a2e', '#cf2f2f', '#5c0f3a'];
const PATIENCE = 250; // Milliseconds that a first frame waits for its images.
const SLICE = [10, 100]; // Milliseconds of measuring at a time: as long as it had to wait, within these.
const LOST = 'The browser has lost the GPU. If the model does not come back, reload the page.';
const CONTROLS = 'canvas, .open, .side, .divider, .bar, .transport';
const OF_SHADED = ['textures', 'moving']; // What is chosen for this mode alone.

const byId = Object.fromEntries([...document.querySelectorAll('[id]')].map((element) => [element.id, element]));
const calm = matchMedia('(prefers-reduced-motion: reduce)');
const dark = matchMedia('(prefers-color-scheme: dark)');

// The texts of skinbake shader by name. The page holds each of their lines, and each paragraph, once.
function unpackedTexts({ lines, paragraphs, texts }) {
    const made = paragraphs.map((numbers) => numbers.map((number) => lines[number]).join('\n'));
    return Object.fromEntries(Object.entries(texts).map(([name, numbers]) => [name, numbers.map((number) => made[number]).join('\n\n')]));
}

class Application {
    constructor(renderer) {
        this.renderer = renderer;
        this.scene = new Scene(renderer);
        this.camera = new Camera(byId.canvas, () => this.changed());
        this.chart = new Chart(byId.chart, byId['chart-key'], byId['chart-words'], (time, stays) => this.look(time, stays));
        Object.assign(this, { split: 0.5, mode: 'shaded', speed: 1, isPlaying: false, turn: 0.9 });
        this.setLegend(10);
        this.listen();
        new ResizeObserver(() => this.resize()).observe(byId.canvas);
        dark.addEventListener('change', () => this.changed());
    }

    listen() {
        byId.play.addEventListener('click', () => this.play(!this.isPlaying));
        byId.time.addEventListener('input', () => this.seek(Number(byId.time.value), true));
        byId.clip.addEventListener('change', () => this.choose(this.scene.clips[byId.clip.value]));
        byId.speed.addEventListener('change', () => (this.speed = Number(byId.speed.value)));
        byId.left.addEventListener('change', () => this.chooseSides());
        byId.right.addEventListener('change', () => this.chooseSides());
        byId.home.addEventListener('click', () => this.goHome());
        byId.flip.addEventListener('click', () => this.setSplit(this.split < 0.5 ? 1 : 0));
        byId.open.addEventListener('change', () => {
            this.take([...byId.open.files]);
            byId.open.value = ''; // A file may be baked anew and chosen again.
        });
        for (const name of OF_SHADED) byId[name].addEventListener('change', () => this.changed());
        for (const radio of document.querySelectorAll('input[name=mode]')) {
            radio.addEventListener('change', () => this.setMode(radio.value));
        }
        this.listenToDivider();
        this.listenToFiles();
        this.listenToContext();
        document.addEventListener('keydown', (event) => {
            if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest('select')) return;
            const alone = { a: 1, b: 0 }[event.key]; // One lighting alone, or both again.
            if (alone !== undefined) this.setSplit(this.split === alone ? 0.5 : alone);
            if (event.key !== ' ' || event.target.closest('button, input, select, label')) return;
            event.preventDefault();
            this.play(!this.isPlaying);
        });
    }

    listenToDivider() {
        const { divider } = byId;
        const follow = (event) => {
            const { left, width } = byId.canvas.getBoundingClientRect();
            this.setSplit((event.clientX - left) / width);
        };
        divider.addEventListener('pointerdown', (event) => {
            divider.setPointerCapture(event.pointerId);
            divider.focus({ focusVisible: false });
            event.preventDefault();
        });
        divider.addEventListener('pointermove', (event) => divider.hasPointerCapture(event.pointerId) && follow(event));
        divider.addEventListener('keydown', (event) => {
            const steps = { ArrowLeft: -0.02, ArrowRight: 0.02, ArrowDown: -0.02, ArrowUp: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 };
            if (!(event.key in steps)) return;
            event.preventDefault();
            this.setSplit(this.split + steps[event.key]);
        });
    }

    listenToFiles() {
        let depth = 0;
        const show = (step) => (byId.drop.hidden = (depth = Math.max(0, depth + step)) === 0);
        addEventListener('dragenter', () => show(1));
        addEventListener('dragleave', () => show(-1));
        addEventListener('dragover', (event) => event.preventDefault());
        addEventListener('drop', (event) => {
            event.preventDefault();
            show(-depth);
            this.take([...event.dataTransfer.files]);
        });
    }

    // The browser may lose the GPU, as when its driver ends, and have it back later. Without it normals are zeros.
    listenToContext() {
        byId.canvas.addEventListener('webglcontextlost', (event) => {
            event.preventDefault(); // It may come back.
            this.stopMeasuring();
            this.play(false);
            this.isShown = false;
            this.tell(LOST);
        });
        byId.canvas.addEventListener('webglcontextrestored', async () => {
            this.renderer.begin();
            if (this.former) await this.show(...this.former);
            this.tell('');
        });
    }

    // Show a file that was dropped or chosen, with the files beside it.
    // If another one is taken before it is read, that one is shown. If it cannot be shown, the former one is.
    async take(files) {
        const main = files.find(({ name }) => /\.(glb|gltf|vrm)$/i.test(name));
        if (!main) return this.tell('Expected a .glb, .gltf or .vrm file.');
        if (this.renderer.isLost) return this.tell(LOST);
        const own = (this.taken = {});
        const { former } = this;
        try {
            const bytes = new Uint8Array(await main.arrayBuffer());
            const model = await readModel(bytes, main.name, new Map(files.map((file) => [file.name, file]))).catch(damaged);
            if (this.taken !== own) return;
            await this.show(model, { name: main.name });
            if (this.taken === own) this.tell('');
        } catch (error) {
            if (this.taken !== own) return;
            if (!this.isShown && former) await this.show(...former);
            this.tell(`${main.name} cannot be shown: ${error.message}`);
        }
    }

    tell(text) {
        byId.message.textContent = text;
        byId.message.hidden = !text;
    }

    // Show a model, with what is known of it.
    async show(model, given) {
        this.stopMeasuring();
        this.isShown = false;
        this.given = given;
        const own = (this.showing = {});
        const loading = this.scene.show(model);
        loading.then(() => this.changed());
        byId.name.textContent = given.name;
        document.title = `${given.name} – skinbake`;
        byId.facts.textContent = factsOf(model);
        showFigures(byId, given);
        showNotes(byId, given);
        byId.clip.replaceChildren(...this.scene.clips.map(({ name }, number) => new Option(name, number)));
        byId.clip.disabled = this.scene.clips.length < 2;
        this.nameUnknown(false);
        this.fillSides();
        this.renderer.prepare(this.sides, this.mode, byId.textures.checked);
        const { middle, radius, low } = this.scene.bounds();
        const skinned = this.scene.parts.filter(({ skin }) => skin !== undefined);
        const isMixed = skinned.length > 0 && skinned.length < this.scene.parts.length;
        this.ground = [middle[0], low, middle[2], 2.4 * radius];
        this.measures = new Map();
        this.camera.frame(middle, radius, isMixed ? this.scene.bounds(skinned) : undefined, model.facesBackward ? Math.PI : 0);
        const places = (given.places ?? []).filter(({ clip }) => this.clipOf(clip));
        this.listPlaces(places);
        this.choose(this.scene.clips[0]);
        if (places.length) this.go(places[0]);
        await Promise.race([loading, pause(PATIENCE)]);
        if (this.showing !== own) return;
        this.draw();
        await this.renderer.finished(); // All else begins when the model is seen.
        if (this.showing !== own) return;
        this.former = [model, given];
        this.isShown = true;
        this.firstFrame = performance.now();
        this.measure(this.clip);
        this.play(!calm.matches && !places.length);
    }

    clipOf(number) {
        return this.scene.clips.find((clip) => clip.number === number);
    }

    listPlaces(places) {
        byId.places.hidden = !places.length;
        byId['places-list'].replaceChildren(
            ...places.map((place) => {
                const item = document.createElement('li');
                const button = document.createElement('button');
                Object.assign(button, { type: 'button', className: 'button', textContent: `${place.words}, ${isolated(this.clipOf(place.clip).name)} at ${place.time.toFixed(2)} s` });
                button.addEventListener('click', () => this.go(place));
                item.append(button);
                return item;
            })
        );
    }

    // Go to a place, a clip and a moment at which the bake shows, close up.
    go({ clip, time, words, ...place }) {
        this.choose(this.clipOf(clip));
        this.seek(time, true);
        this.camera.look(place);
        this.turn = this.camera.yaw - this.camera.facing + 0.45; // The light comes from beside the camera.
        this.tell(`Here ${words}`);
    }

    fillSides() {
        const fitting = Object.keys(NAMES).filter((name) => !this.scene.reasonWithout(name));
        const best = ['corrected', 'fitted', 'surface', 'standard'].find((name) => fitting.includes(name));
        for (const [side, chosen] of [['left', 'standard'], ['right', best]]) {
            byId[side].replaceChildren(
                ...Object.entries(NAMES).map(([name, text]) => {
                    const reason = this.scene.reasonWithout(name);
                    const option = new Option(reason ? `${text} (${reason})` : text, name);
                    option.disabled = Boolean(reason);
                    return option;
                })
            );
            byId[side].value = chosen ?? 'standard';
        }
        this.chooseSides();
    }

    chooseSides() {
        this.sides = [byId.left.value, byId.right.value];
        this.showChart();
        this.changed();
    }

    setSplit(share) {
        this.split = Math.max(0, Math.min(1, share));
        byId.divider.style.left = `${100 * this.split}%`;
        document.body.dataset.only = ['right', '', 'left'][Math.floor(this.split) + Math.ceil(this.split)];
        byId.divider.setAttribute('aria-valuenow', String(Math.round(100 * this.split)));
        this.changed();
    }

    setMode(mode) {
        this.mode = mode;
        byId.legend.hidden = mode !== 'error';
        for (const name of OF_SHADED) byId[name].disabled = mode !== 'shaded';
        this.changed();
    }

    setLegend(most) {
        this.legend = LEGENDS.find((one) => one >= most) ?? 90;
        byId['legend-middle'].textContent = `${this.legend / 2}°`;
        byId['legend-end'].textContent = `${this.legend}° and more`;
    }

    // Say in the legend what has no error. isPartial: some vertices have no true normal.
    nameUnknown(isPartial) {
        const hasRigid = this.scene.parts.some(({ skin }) => skin === undefined);
        byId['legend-unknown'].hidden = !hasRigid && !isPartial;
        byId['legend-unknown'].textContent = !isPartial ? 'Not skinned' : hasRigid ? 'Not skinned, or no true normal' : 'No true normal';
    }

    choose(clip) {
        this.clip = clip;
        byId.clip.value = String(this.scene.clips.indexOf(clip));
        Object.assign(byId.time, { min: clip.start, max: clip.end, step: Math.max((clip.end - clip.start) / 1000, 1e-4) });
        this.seek(clip.start);
        if (this.isShown) this.measure(clip);
    }

    seek(time, stops = false) {
        if (stops) this.play(false);
        this.time = time;
        byId.time.value = String(time);
        byId.clock.textContent = `${time.toFixed(2)} s`;
        this.chart.setTime(time);
        this.isPosed = false;
        this.changed();
    }

    play(isPlaying) {
        this.isPlaying = isPlaying;
        this.last = null;
        byId.play.classList.toggle('is-playing', isPlaying);
        byId.play.setAttribute('aria-label', isPlaying ? 'Pause' : 'Play');
        this.changed();
    }

    // Show the pose at which the chart is pointed at; null goes back.
    look(time, stays) {
        if (time === null) {
            if (this.kept === undefined) return;
            const { kept, wasPlaying } = this;
            this.kept = undefined;
            this.seek(kept);
            this.play(wasPlaying);
            return;
        }
        if (this.kept === undefined) [this.kept, this.wasPlaying] = [this.time, this.isPlaying];
        if (stays) [this.kept, this.wasPlaying] = [time, false];
        this.seek(time, true);
    }

    // Measure the errors of all lightings over a clip, a pose at a time, between the frames.
    measure(clip) {
        this.stopMeasuring();
        if (!this.measures.has(clip)) {
            const times = Array.from({ length: SAMPLES }, (_, i) => clip.start + (i / (SAMPLES - 1)) * (clip.end - clip.start));
            const lightings = Object.keys(NAMES).filter((name) => name !== 'truth' && !this.scene.reasonWithout(name));
            const lines = Object.fromEntries(lightings.map((name) => [name, new Array(SAMPLES)]));
            this.measures.set(clip, { times, lines, next: 0 });
        }
        this.showChart();
        this.measureAll(clip, (this.measuring = {}));
    }

    stopMeasuring() {
        this.measuring = null;
    }

    // Measure when the browser and the GPU have nothing else to do.
    async measureAll(clip, own) {
        const lightings = Object.keys(this.measures.get(clip).lines);
        await this.renderer.compiled(this.renderer.prepare(lightings, 'normals', false));
        let isMore = true;
        while (isMore) {
            const begun = performance.now();
            await this.renderer.finished();
            await idle();
            const now = performance.now();
            const end = now + Math.min(Math.max(now - begun, SLICE[0]), SLICE[1]);
            while (isMore && this.measuring === own && performance.now() < end) isMore = this.measureNext(clip);
            isMore &&= this.measuring === own;
        }
    }

    // Measure a part of a sample: its true normals, or the errors of one lighting. Return whether there is more.
    measureNext(clip) {
        const found = this.measures.get(clip);
        if (found.next === SAMPLES || this.renderer.isLost) return false;
        const number = spread(found.next);
        this.isPosed = false;
        this.scene.pose(clip, found.times[number]);
        found.left ??= Object.keys(found.lines);
        found.truths ??= {};
        const [lighting] = found.left;
        const { method } = LIGHTINGS[lighting];
        if (!found.truths[method]) {
            found.truths[method] = this.scene.truths(method);
            return true;
        }
        const { mean, isPartial } = this.scene.errors(lighting, found.truths[method]);
        if (this.renderer.isLost) return false;
        found.lines[lighting][number] = mean;
        if (lighting === 'standard') found.isPartial ||= isPartial;
        found.left.shift();
        if (found.left.length) return true;
        Object.assign(found, { left: null, truths: null, next: found.next + 1 });
        if (found.next === 1 || found.next % 8 === 0 || found.next === SAMPLES) this.showMeasures(found);
        return found.next < SAMPLES;
    }

    showMeasures(found) {
        this.nameUnknown(found.isPartial);
        this.setLegend(4 * Math.max(...found.lines.standard.filter(isKnown)));
        this.showChart();
        this.changed();
    }

    showChart() {
        const found = this.measures?.get(this.clip);
        if (!found) return;
        const shown = [...new Set(this.sides)].filter((lighting) => found.lines[lighting]);
        this.chart.set(this.clip, found.times, found.lines, shown, NAMES);
    }

    goHome() {
        this.tell('');
        this.camera.home();
    }

    changed() {
        if (this.frame) return;
        this.frame = requestAnimationFrame((now) => {
            this.frame = 0;
            this.tick(now);
        });
    }

    tick(now) {
        if (!this.isShown) return;
        const step = this.last ? Math.min((now - this.last) / 1000, 0.25) : 0;
        this.last = now;
        if (this.isPlaying) {
            const { start, end } = this.clip;
            const length = end - start;
            if (length > 0) this.seek(start + ((this.time - start + step * this.speed) % length));
        }
        const isTurning = byId.moving.checked && this.mode === 'shaded' && !calm.matches;
        if (isTurning) this.turn += 0.7 * step;
        this.draw();
        if (this.isPlaying || isTurning) this.changed();
        else this.last = null;
    }

    applyPose() {
        if (this.isPosed && this.scene.clip === this.clip) return;
        this.scene.pose(this.clip, this.time);
        this.isPosed = true;
        this.uploaded = new Set();
    }

    draw() {
        this.applyPose();
        const methods = this.sides.filter((side) => this.mode === 'error' || LIGHTINGS[side].isTrue).map((side) => LIGHTINGS[side].method);
        for (const method of methods) {
            if (this.uploaded.has(method)) continue;
            this.scene.uploadTruth(method);
            this.uploaded.add(method);
        }
        const { canvas } = byId;
        const projected = this.camera.projected(canvas.width / canvas.height || 1);
        const turn = this.turn + this.camera.facing;
        const light = [Math.sin(turn) * 0.75, 0.6, Math.cos(turn) * 0.75];
        const size = Math.hypot(...light);
        this.renderer.draw({
            sides: [[this.sides[0], 0, this.split], [this.sides[1], this.split, 1]],
            projected,
            eye: this.camera.eye,
            light: light.map((value) => value / size),
            mode: this.mode,
            legend: this.legend,
            stops: HEAT.flatMap(rgb),
            unknown: rgb('#8b93a0'),
            ink: dark.matches ? [0, 0, 0] : [0.25, 0.23, 0.2],
            ground: this.ground,
            isTextured: byId.textures.checked,
            depthOf: (part) => this.scene.depth(part, projected),
        });
        this.showReadings();
    }

    showReadings() {
        this.sides.forEach((side, i) => {
            const mean = this.chart.at(side, this.time);
            const text = LIGHTINGS[side].isTrue ? 'by triangles' : isKnown(mean) ? `${degrees(mean)} mean error` : mean === null ? 'no true normals' : '…';
            const output = byId[i ? 'right-error' : 'left-error'];
            if (output.textContent !== text) output.textContent = text;
        });
    }

    resize() {
        const { canvas } = byId;
        const ratio = Math.min(devicePixelRatio, 2);
        const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
        if (canvas.width === width && canvas.height === height) return;
        Object.assign(canvas, { width, height });
        if (this.isShown) this.draw();
    }
}

const idle = () => new Promise((done) => (window.requestIdleCallback ?? ((call) => setTimeout(call, 16)))(done, { timeout: 100 }));
const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

// What readModel throws, in words: it checks no more of a file than it must.
function damaged(error) {
    throw error instanceof ReadError ? error : new ReadError(`it is damaged, or too large (${error.message})`);
}

// The order in which samples are measured: coarse at first, so that the chart soon has its shape.
function spread(next) {
    const order = [];
    for (let step = 16; step >= 1; step /= 2) {
        for (let i = 0; i < SAMPLES; i += step) if (!order.includes(i)) order.push(i);
    }
    return order[next];
}

function factsOf(model) {
    const primitives = [...model.primitives.values()].filter(Boolean);
    const [count, skinned] = [primitives, primitives.filter(({ joints }) => joints.length)].map((some) =>
        some.reduce((sum, { count }) => sum + count, 0)
    );
    const baked = primitives.find(({ metadata }) => metadata)?.metadata;
    const targets = Math.max(...primitives.map(({ correctives }) => correctives.length));
    const how = targets ? `${targets} corrective normals` : baked ? `${baked.frame} frame, ${baked.encoding ?? 'float32'}` : 'not baked';
    const all = `${count.toLocaleString('en')} vertices`;
    return `${all}${skinned < count ? `, ${skinned.toLocaleString('en')} of them skinned` : ''}, ${how}`;
}

// Put the other kind of α and β beside the one that the file holds.
function addOther(model, other) {
    for (const one of other?.primitives ?? []) {
        const primitive = model.primitives.get(`${one.mesh}/${one.primitive}/true`);
        if (primitive && one.frame) primitive.metadata ??= { frame: one.frame }; // Of a file with correctives.
        if (!primitive?.metadata) continue;
        const [alpha, beta] = [one.alpha, one.beta].map((text) => new Float32Array(fromBase64(text).buffer));
        const others = alpha.length / primitive.count;
        const own = gradientsOf(primitive, (vertex, slot) => [alpha[others * vertex + slot], beta[others * vertex + slot]]);
        if (one.joints) Object.assign(own, influencesOfSets(one, others + 1));
        primitive.gradients[one.kind] = own;
    }
}

// Joints and weights of another kind, by set of four. A bake may have adopted other joints for it.
function influencesOfSets({ joints, weights }, slots) {
    const inSets = (text, Type) => {
        const row = new Float32Array(fromBase64(text).buffer);
        return Array.from({ length: slots / 4 }, (_, set) => Type.from(row.filter((_, i) => (i % slots) >> 2 === set)));
    };
    return { joints: inSets(joints, Uint16Array), weights: inSets(weights, Float32Array) };
}

async function start() {
    const given = JSON.parse(byId.given.textContent);
    showFigures(byId, given);
    showNotes(byId, given);
    const model = await readModel(fromBase64(byId.model.textContent), given.name);
    addOther(model, given.other);
    const renderer = new Renderer(byId.canvas); // Only now: until here the GPU's process starts beside this.
    renderer.texts = unpackedTexts(JSON.parse(byId.texts.textContent));
    const application = new Application(renderer);
    await application.show(model, given);
    return application;
}

window.ready = start().then(
    (application) => (window.application = application),
    (error) => {
        byId.message.textContent = `The model cannot be shown: ${error.message}`;
        byId.message.hidden = false;
        byId.chart.parentElement.hidden = true;
        for (const control of document.querySelectorAll(CONTROLS)) control.hidden = true; // They would do nothing.
        if (!(error instanceof ReadError)) throw error;
    }
);
