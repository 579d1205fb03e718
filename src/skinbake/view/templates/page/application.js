// The page: what is chosen, what is drawn, and when.

import { Camera, CLOSE } from './camera.js';
import { Chart, isKnown } from './chart.js';
import { degrees, showFigures, showNotes } from './figures.js';
import { fromBase64, gradientsOf, ReadError, readModel } from './reader.js';
import { movedBy, plus } from './matrices.js';
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
const LENS = 0.36; // The share of a pane that shows the place from close up.
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
        Object.assign(this, { split: 0.5, mode: 'shaded', speed: 1, isPlaying: false, turn: 0, places: [] });
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
        byId.divided.addEventListener('change', () => this.arrange());
        byId.divider.addEventListener('input', () => this.setSplit(byId.divider.value / 100));
        byId.flip.addEventListener('pointerdown', () => this.hold(true));
        for (const kind of ['pointerup', 'pointercancel', 'blur']) addEventListener(kind, () => this.hold(false));
        byId.open.addEventListener('change', () => {
            this.take([...byId.open.files]);
            byId.open.value = ''; // A file may be baked anew and chosen again.
        });
        for (const name of OF_SHADED) byId[name].addEventListener('change', () => this.changed());
        for (const radio of document.querySelectorAll('input[name=mode]')) {
            radio.addEventListener('change', () => this.setMode(radio.value));
        }
        this.listenToFiles();
        this.listenToContext();
        document.addEventListener('keydown', (event) => {
            if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest('select')) return;
            if (event.key.toLowerCase() === 'a') this.hold(true);
            if (event.key !== ' ' || event.target.closest('button, input, select, label')) return;
            event.preventDefault();
            this.play(!this.isPlaying);
        });
        document.addEventListener('keyup', () => this.hold(false));
    }

    listenToFiles() {
        const show = (isShown) => (byId.drop.hidden = !isShown);
        addEventListener('dragenter', () => show(true));
        addEventListener('dragleave', ({ relatedTarget }) => show(relatedTarget !== null)); // It has left the page.
        addEventListener('dragover', (event) => event.preventDefault());
        addEventListener('drop', (event) => {
            event.preventDefault();
            show(false);
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
        Object.assign(this, { given, clip: null });
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
        this.subjects = isMixed ? skinned : this.scene.parts;
        this.ground = [middle[0], low, middle[2], 2.4 * radius];
        this.measures = new Map();
        this.chart.expected = 1.5 * (given.by_triangles?.lbs?.standard.mean ?? 6);
        Object.assign(this, { place: null, isClose: false });
        this.arrange();
        this.camera.frame(middle, radius, isMixed ? this.scene.bounds(skinned) : undefined, model.facesBackward ? Math.PI : 0);
        const [places, worse] = [given.places ?? [], given.worse].map((list) => list?.filter(({ clip }) => this.clipOf(clip)));
        byId.worse.hidden = !worse;
        byId['worse-words'].textContent = worse?.length ? 'Over 5° farther off than standard lighting, by both truths.' : 'Nowhere by over 5°, by both truths, in the poses measured.';
        this.places = [...this.listPlaces('places', places), ...this.listPlaces('worse', worse ?? [])];
        byId.places.hidden = !places.length;
        this.choose(this.scene.clips[0]);
        if (places.length) this.go(places[0], false);
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

    // Show a list of places. Return them with their buttons.
    listPlaces(name, places) {
        const buttons = places.map((place) => {
            const button = document.createElement('button');
            Object.assign(button, { type: 'button', className: 'button', textContent: `${place.where}: ${place.words}` });
            button.addEventListener('click', () => this.go(place, !(this.isClose && this.place === place)));
            return [place, button];
        });
        byId[`${name}-list`].replaceChildren(
            ...buttons.map(([, button]) => {
                const item = document.createElement('li');
                item.append(button);
                return item;
            })
        );
        return buttons;
    }

    // Go to the clip and the moment of a place: to all of the figure with the place marked, or close up.
    go(place, isClose) {
        Object.assign(this, { place, isClose });
        this.choose(this.clipOf(place.clip));
        this.seek(place.time, true);
        this.arrange();
        this.applyPose();
        const seen = isClose ? { middle: this.scene.positionOf(place), radius: CLOSE * place.radius } : this.scene.bounds(this.subjects, [place.time]);
        this.camera.show(seen.middle, seen.radius, place.towards);
        for (const [one, button] of this.places) button.setAttribute('aria-pressed', String(isClose && one === place));
    }

    // Lay out both panes, or one picture with a divider.
    arrange() {
        const { clientWidth: width, clientHeight: height } = byId.canvas;
        this.isDivided = byId.divided.checked;
        document.body.dataset.panes = this.isDivided ? 'divided' : height > width ? 'stacked' : 'beside';
        this.hasLens = Boolean(this.place && !this.isClose && !this.isDivided);
        document.body.dataset.lens = this.hasLens && height <= width ? 'below' : '';
        [[, , ...this.camera.size]] = this.boxes(width, height);
        this.camera.fit();
        byId.here.hidden = !this.place;
        byId.here.textContent = this.place ? `${this.place.where}: ${this.place.words}` : '';
        this.changed();
    }

    // The boxes of the panes, [left, bottom, width, height], and of the lenses in them: beside or below the figure.
    boxes(width, height) {
        if (this.isDivided) return [0, 1].map(() => [0, 0, width, height]);
        const isStacked = height > width;
        const [w, h] = isStacked ? [width, Math.floor(height / 2)] : [Math.floor(width / 2), height];
        const [x, y] = isStacked ? [0, height - h] : [width - w, 0];
        const share = this.hasLens ? LENS : 0;
        const part = isStacked ? [Math.round(share * w), 0] : [0, Math.round(share * h)];
        const panes = isStacked ? [[0, y], [0, 0]] : [[0, 0], [x, 0]];
        const figures = panes.map(([left, bottom]) => [left, bottom + part[1], w - part[0], h - part[1]]);
        if (!this.hasLens) return figures;
        return [...figures, ...panes.map(([left, bottom]) => (isStacked ? [left + w - part[0], bottom, part[0], h] : [left, bottom, w, part[1]]))];
    }

    // While it is held, the first pane shows the other lighting. All else stands still.
    hold(isHeld) {
        if (!this.sides || Boolean(this.isHeld) === isHeld) return;
        this.isHeld = isHeld;
        byId.left.value = this.sides[Number(isHeld)];
        this.changed();
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
        this.split = share;
        byId.line.style.left = `${100 * share}%`;
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
        this.isShown ? this.measure(clip) : this.showChart();
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
        this.showChart();
        this.measureAll(clip, (this.measuring = {}));
    }

    measuresOf(clip) {
        if (!this.measures.has(clip)) {
            const times = Array.from({ length: SAMPLES }, (_, i) => clip.start + (i / (SAMPLES - 1)) * (clip.end - clip.start));
            const lightings = Object.keys(NAMES).filter((name) => name !== 'truth' && !this.scene.reasonWithout(name));
            const lines = Object.fromEntries(lightings.map((name) => [name, new Array(SAMPLES)]));
            const tasks = ORDER.flatMap((number) => lightings.map((lighting) => ({ number, lighting })));
            this.measures.set(clip, { times, lines, tasks, next: 0 });
        }
        return this.measures.get(clip);
    }

    stopMeasuring() {
        this.measuring = null;
    }

    // Measure when the browser and the GPU have nothing else to do.
    async measureAll(clip, own) {
        const lightings = Object.keys(this.measuresOf(clip).lines);
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
        if (found.next === found.tasks.length || this.renderer.isLost) return false;
        const { number, lighting } = found.tasks[found.next];
        this.isPosed = false;
        this.scene.pose(clip, found.times[number]);
        const key = `${number} ${LIGHTINGS[lighting].method}`;
        if (found.key !== key) {
            Object.assign(found, { key, truths: this.scene.truths(LIGHTINGS[lighting].method) });
            return true;
        }
        const { mean, isPartial } = this.scene.errors(lighting, found.truths);
        if (this.renderer.isLost) return false;
        found.lines[lighting][number] = mean;
        if (lighting === 'standard') found.isPartial ||= isPartial;
        found.next += 1;
        const samples = (found.next * SAMPLES) / found.tasks.length;
        if (samples === 1 || samples % 8 === 0 || samples === SAMPLES) this.showMeasures(found);
        return samples < SAMPLES;
    }

    showMeasures(found) {
        this.nameUnknown(found.isPartial);
        this.setLegend(4 * Math.max(...found.lines.standard.filter(isKnown)));
        this.showChart();
        this.changed();
    }

    showChart() {
        if (!this.clip) return;
        const found = this.measuresOf(this.clip);
        const shown = [...new Set(this.sides)].filter((lighting) => found.lines[lighting]);
        this.chart.set(this.clip, found.times, found.lines, shown, NAMES);
    }

    goHome() {
        this.isClose = false;
        this.arrange();
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
        if (this.isPlaying && !this.isHeld) {
            const { start, end } = this.clip;
            const length = end - start;
            if (length > 0) this.seek(start + ((this.time - start + step * this.speed) % length));
        }
        const isTurning = byId.moving.checked && this.mode === 'shaded' && !calm.matches && !this.isHeld;
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
        const { width, height } = byId.canvas;
        const middle = this.place && this.scene.positionOf(this.place);
        const cameras = [this.camera, middle && this.camera.near({ ...this.place, middle })];
        const boxes = this.boxes(width, height);
        const at = Math.round(this.split * width);
        const sides = this.isHeld ? [this.sides[1], this.isDivided ? this.sides[0] : this.sides[1]] : this.sides;
        const views = boxes.map((box, i) => ({
            lighting: sides[i % 2],
            box,
            edges: !this.isDivided ? [0, box[2]] : i ? [at, width] : [0, at],
            projected: cameras[i >> 1].projected(box[2] / box[3] || 1),
            eye: cameras[i >> 1].eye,
        }));
        const { projected } = views[0];
        this.showRings(views, middle);
        const [right, up, back] = this.camera.axes;
        const [cosine, sine] = [Math.cos(this.turn), Math.sin(this.turn)];
        this.renderer.draw({
            views,
            studio: [...plus(right.map((one) => cosine * one), back, -sine), ...up, ...plus(back.map((one) => cosine * one), right, sine)],
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

    // Put a ring around the place in each pane.
    showRings(views, middle) {
        const ratio = byId.canvas.width / byId.canvas.clientWidth;
        document.querySelectorAll('.ring').forEach((ring, i) => {
            const { projected: m, box: [left, bottom, width, height] } = views[i];
            ring.hidden = !this.hasLens || !middle;
            if (ring.hidden) return;
            const [x, y, , w] = movedBy(m, middle);
            const size = Math.max(28, (m[5] * this.place.radius * height) / w / ratio);
            const place = [left + (0.5 + x / w / 2) * width, byId.canvas.height - bottom - (0.5 + y / w / 2) * height].map((one) => one / ratio - size / 2);
            Object.assign(ring.style, { transform: `translate(${place[0]}px, ${place[1]}px)`, width: `${size}px`, height: `${size}px` });
        });
    }

    showReadings() {
        this.sides.forEach((side, i) => {
            const mean = this.chart.at(side, this.time);
            const text = LIGHTINGS[side].isTrue ? 'of the deformed triangles' : isKnown(mean) ? `${degrees(mean)} mean error` : mean === null ? 'no true normals' : 'measuring …';
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
        this.arrange();
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
const ORDER = [...new Set([16, 8, 4, 2, 1].flatMap((step) => Array.from({ length: Math.ceil(SAMPLES / step) }, (_, i) => step * i)))];

function factsOf(model) {
    const primitives = [...model.primitives.values()].filter(Boolean);
    const [count, skinned] = [primitives, primitives.filter(({ slots }) => slots)].map((some) =>
        some.reduce((sum, { count }) => sum + count, 0)
    );
    const baked = primitives.find(({ metadata }) => metadata)?.metadata;
    const targets = Math.max(...primitives.map(({ correctives }) => correctives.length));
    const how = targets ? `${targets} corrective normals` : baked ? `${baked.frame} frame, ${baked.encoding ?? 'float32'}` : 'not baked';
    const all = `${count.toLocaleString('en')} vertices`;
    return `${all}${skinned < count ? `, ${skinned.toLocaleString('en')} of them skinned` : ''}, ${how}`;
}

// Put the other kind of α and β beside the one that the file holds. A bake may have adopted other joints for it.
function addOther(model, other) {
    for (const one of other?.primitives ?? []) {
        const primitive = model.primitives.get(`${one.mesh}/${one.primitive}/true`);
        if (primitive && one.frame) primitive.metadata ??= { frame: one.frame }; // Of a file with correctives.
        if (!primitive?.metadata) continue;
        const floats = (text) => new Float32Array(fromBase64(text).buffer);
        const [alpha, beta] = [one.alpha, one.beta].map(floats);
        const others = alpha.length / primitive.count;
        const own = gradientsOf(primitive, (vertex, slot) => [alpha[others * vertex + slot], beta[others * vertex + slot]]);
        if (one.joints) Object.assign(own, { joints: Uint16Array.from(floats(one.joints)), weights: floats(one.weights) });
        primitive.gradients[one.kind] = own;
    }
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
