// Draw a model in WebGL 2: each pane of the canvas with its own lighting, and read normals back.

import { determinant } from './matrices.js';
import { isUnlit, readImage, samplingOf, shownTextures } from './reader.js';
import {
    fragmentText, GROUND_FRAGMENT_TEXT, GROUND_VERTEX_TEXT, LOCATIONS, RIGID_TEXT, TEXCOORDS, textName, vertexText,
} from './shading.js';

const CAPTURED = ['v_position', 'v_normal'];
const CLAY = [0.60, 0.585, 0.56, 1];

// What blends is drawn by ranges of alpha: from SOLID on nothing behind shows through, to the eye. From HOLE on it hides
// what is drawn behind it later, so that triangles in any order cost the picture the smaller part of a colour only.
const [HOLE, SOLID, EVERY] = [0.5, 0.99, 1e9];

// How each lighting is drawn: the algorithm, the kind of its α and β, and whether its normals are the true ones.
export const LIGHTINGS = {
    standard: { stem: 'lbs_standard', method: 'lbs' },
    corrected: { stem: 'lbs_standard', method: 'lbs', isCorrected: true },
    surface: { stem: 'lbs_accurate', method: 'lbs', gradients: 'surface' },
    fitted: { stem: 'lbs_accurate', method: 'lbs', gradients: 'fitted' },
    dqs: { stem: 'dqs_exact', method: 'dqs' },
    truth: { stem: 'lbs_standard', method: 'lbs', isTrue: true },
};

export class Renderer {
    constructor(canvas) {
        const gl = canvas.getContext('webgl2', { antialias: false, alpha: true });
        if (!gl) throw new Error('it is drawn by WebGL 2, which this browser does not have, or has switched off');
        Object.assign(this, { canvas, gl, texts: {}, parts: [] });
        this.begin();
    }

    // Make what every model needs: at first, and again when the browser has the GPU back.
    begin() {
        Object.assign(this, { programs: new Map(), buffers: [], arrays: [], textures: [] });
        this.parallel = this.gl.getExtension('KHR_parallel_shader_compile');
        this.sheets = [];
        this.started('ground', () => [GROUND_VERTEX_TEXT, GROUND_FRAGMENT_TEXT], []);
    }

    // Take a model. texts must hold what skinbake shader has written. isMirrored: some of its joints mirror the surface.
    setModel(model, isMirrored) {
        this.dispose();
        this.model = model;
        this.isMirrored = isMirrored;
        this.geometries = new Map();
        this.parts = model.draws.map((draw) => {
            const { targets, correctives } = draw.primitive;
            const key = targets.length || correctives.length ? draw : draw.primitive; // Each node has its own morph weights.
            if (!this.geometries.has(key)) this.geometries.set(key, this.geometry(draw.primitive));
            return { ...draw, ...this.geometries.get(key), truth: {} };
        });
        this.palettes = model.skins.map(({ joints }) => this.palette(joints.length));
        this.materials = model.materials.map((material) => this.material(material));
        return Promise.all(this.materials.map(({ loading }) => loading));
    }

    get isLost() {
        return this.gl.isContextLost();
    }

    // Wait until the GPU has done what it was given so far.
    async finished() {
        const { gl } = this;
        const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
        gl.flush();
        while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) await pause(2);
        gl.deleteSync(fence);
    }

    // Begin to compile what draws the model with these lightings, once its images are there.
    prepare(lightings, mode, isTextured) {
        return lightings.flatMap((lighting) =>
            this.parts.map((part) => {
                const { has } = this.shownMaterial(part, isTextured, mode, 'expected');
                const { name, texts } = this.chosen(part, lighting, mode, has);
                return this.started(name, texts);
            })
        );
    }

    // Wait until programs that were begun are compiled, where the browser tells it.
    async compiled(programs) {
        const { gl, parallel } = this;
        for (const { program } of parallel ? programs : []) {
            while (!gl.getProgramParameter(program, parallel.COMPLETION_STATUS_KHR) && !this.isLost) await pause(8);
        }
    }

    dispose() {
        const { gl } = this;
        for (const buffer of this.buffers) gl.deleteBuffer(buffer);
        for (const array of this.arrays) gl.deleteVertexArray(array);
        for (const texture of this.textures) gl.deleteTexture(texture);
        Object.assign(this, { buffers: [], arrays: [], textures: [] });
    }

    geometry(primitive) {
        const { gl } = this;
        const indices = this.buffer(primitive.triangles, gl.ELEMENT_ARRAY_BUFFER);
        const [first, second, third] = primitive.texcoords;
        const isMorphed = primitive.targets.length > 0 || primitive.correctives.length > 0;
        const { numbers } = primitive;
        const zeros = (size) => this.buffer(new Float32Array(size * primitive.count));
        const shared = [
            ['position', this.buffer(primitive.positions), 3],
            ['normal', this.buffer(primitive.normals), 3],
            ['tangent', primitive.tangents && this.buffer(primitive.tangents), 4],
            ['texcoord', first && this.buffer(second ? pairedVectors(first, second) : first), second ? 4 : 2],
            ['further_texcoord', third && this.buffer(third), 2],
            ['color', primitive.colors && this.buffer(primitive.colors.array), primitive.colors?.size],
        ];
        const normal = ['morphed_normal', isMorphed ? this.buffer(primitive.normals.slice()) : null, 3];
        const tangent = ['morphed_tangent', isMorphed && primitive.directions && this.buffer(primitive.directions), 3];
        const six = () => [['morph', zeros(4), 4], ['morph_up', zeros(2), 2]];
        const moved = numbers === 6 ? six() : [normal, numbers === 4 ? ['morph_by_normal', zeros(4), 4] : tangent];
        const arrays = { '': this.array(indices, [...shared, normal, tangent], primitive, null) };
        for (const [kind, gradients] of Object.entries(primitive.gradients)) {
            arrays[kind] = this.array(indices, [...shared, ...moved], primitive, gradients);
        }
        const buffers = Object.fromEntries([...shared, normal, tangent, ...moved].map(([name, buffer]) => [name, buffer]));
        if (primitive.correctives.length) {
            buffers.corrected = this.buffer(primitive.stored);
            arrays.corrected = this.array(indices, [...shared, ['morphed_normal', buffers.corrected, 3], tangent], primitive, null);
        }
        return { arrays, shared: buffers, indices };
    }

    // A vertex array for one kind of α and β. A kind may have adopted other joints.
    array(indices, shared, primitive, gradients) {
        const { gl } = this;
        const array = gl.createVertexArray();
        this.arrays.push(array);
        gl.bindVertexArray(array);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indices);
        for (const [name, buffer, size] of shared) if (buffer) this.attribute(name, buffer, size);
        const { joints, weights } = gradients?.joints ? gradients : primitive;
        const { slots } = primitive;
        if (slots) { // Two joints are one integer: WebGL 2 has no attributes for more.
            gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer(joints));
            gl.enableVertexAttribArray(LOCATIONS.joints);
            gl.vertexAttribIPointer(LOCATIONS.joints, slots / 2, gl.UNSIGNED_INT, 0, 0);
        }
        const shares = slots && this.buffer(weights);
        for (let set = 0; set < slots / 4; set++) {
            this.attribute(`weights_${set}`, shares, 4, gl.FLOAT, false, 4 * slots, 16 * set);
            for (const kind of gradients ? ['alpha', 'beta'] : []) {
                const { array: values, size, type, normalized } = gradients[kind][set];
                this.attribute(`${kind}_${set}`, this.buffer(values), size, type, normalized);
            }
        }
        gl.bindVertexArray(null);
        return array;
    }

    attribute(name, buffer, size, type = this.gl.FLOAT, normalized = false, stride = 0, offset = 0) {
        const { gl } = this;
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.enableVertexAttribArray(LOCATIONS[name]);
        gl.vertexAttribPointer(LOCATIONS[name], size, type, normalized, stride, offset);
    }

    buffer(values, target = this.gl.ARRAY_BUFFER) {
        const { gl } = this;
        const buffer = gl.createBuffer();
        this.buffers.push(buffer);
        if (target === gl.ELEMENT_ARRAY_BUFFER) gl.bindVertexArray(null); // It would become that array's own.
        gl.bindBuffer(target, buffer);
        gl.bufferData(target, values, gl.STATIC_DRAW);
        return buffer;
    }

    // A texture of joint motions: a row for each joint, four texels of its matrix, two of its dual quaternion. Where
    // joints scale, the first of these is the joint's rotation.
    palette(joints) {
        const { gl } = this;
        const texture = gl.createTexture();
        this.textures.push(texture);
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, 6, Math.max(joints, 1));
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
        return { texture, values: new Float32Array(24 * joints), joints };
    }

    material(material) {
        const { pbrMetallicRoughness: pbr = {}, normalTexture } = material;
        const made = {
            maps: {},
            expected: {},
            named: shownTextures(material).map(([name]) => name),
            base: pbr.baseColorFactor ?? [1, 1, 1, 1],
            isUnlit: isUnlit(this.model.json, material),
            isUncoloured: !pbr.baseColorTexture && !pbr.baseColorFactor,
            emissive: material.emissiveFactor ?? [0, 0, 0],
            roughness: Math.min(Math.max(pbr.roughnessFactor ?? 1, 0.3), 0.8),
            normalScale: normalTexture?.scale ?? 1,
            cutoff: material.alphaMode === 'MASK' ? material.alphaCutoff ?? 0.5 : 0,
            isBlended: material.alphaMode === 'BLEND',
            isDouble: material.doubleSided === true,
        };
        const load = async ([name, { index }]) => {
            made.expected[name] = true;
            const image = await readImage(this.model, index);
            if (image) made.maps[name] = this.texture(image, samplingOf(this.model, index), name !== 'normal');
        };
        made.loading = Promise.all(shownTextures(material).map(load));
        return made;
    }

    // A texture. Of colours the GPU filters what light adds up to, as three.js has it.
    texture(image, { wraps, magnified }, isColour) {
        const { gl } = this;
        const texture = gl.createTexture();
        this.textures.push(texture);
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, isColour ? gl.SRGB8_ALPHA8 : gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
        gl.generateMipmap(gl.TEXTURE_2D);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, magnified);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wraps[0]);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, wraps[1]);
        return texture;
    }

    // Begin to compile a program. The driver goes on with it beside the page.
    started(name, texts, captured = CAPTURED) {
        if (this.programs.has(name)) return this.programs.get(name);
        const [vertex, fragment] = texts();
        const { gl } = this;
        const program = gl.createProgram();
        for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
            const shader = gl.createShader(kind);
            gl.shaderSource(shader, text);
            gl.compileShader(shader);
            gl.attachShader(program, shader);
        }
        for (const [attribute, location] of Object.entries(LOCATIONS)) {
            gl.bindAttribLocation(program, location, attribute);
            const stored = /^(alpha|beta)_/.test(attribute) ? `stored_${attribute}` : attribute;
            gl.bindAttribLocation(program, location, stored);
        }
        if (captured.length) gl.transformFeedbackVaryings(program, captured, gl.SEPARATE_ATTRIBS);
        gl.linkProgram(program);
        const made = { program, places: null };
        this.programs.set(name, made);
        return made;
    }

    // A program that is compiled, with the places of its uniforms.
    program(name, texts, captured) {
        const made = this.started(name, texts, captured);
        if (made.places) return made;
        const { gl } = this;
        const { program } = made;
        if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
            const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
            throw new Error(`The shader ${name} does not compile: ${[gl.getProgramInfoLog(program), ...logs].join(' ')}`);
        }
        made.places = {};
        const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
        for (let i = 0; i < count; i++) {
            const uniform = gl.getActiveUniform(program, i).name;
            made.places[uniform.replace('[0]', '')] = gl.getUniformLocation(program, uniform);
        }
        return made;
    }

    // The program's name and texts, the vertex array and the gradients with which a lighting draws a part.
    chosen(part, lighting, mode, has) {
        const { primitive } = part;
        const shading = [mode, ...has].join(' ');
        const fragment = () => fragmentText(mode, has);
        if (part.skin === undefined || !primitive.slots) {
            return { name: `rigid ${shading}`, texts: () => [RIGID_TEXT, fragment()], array: part.arrays[''], gradients: null };
        }
        const { stem, gradients: wanted, isCorrected } = LIGHTINGS[lighting];
        const plays = isCorrected && primitive.correctives.length > 0;
        const kinds = Object.keys(primitive.gradients);
        const kind = stem === 'lbs_standard' ? '' : kinds.includes(wanted) ? wanted : kinds[0];
        const isLit = kind !== undefined && stem !== 'lbs_standard';
        const gradients = isLit ? primitive.gradients[kind] : null;
        const frame = primitive.metadata?.frame ?? 'normal';
        const isDual = isLit && stem === 'dqs_exact';
        const choices = {
            stem: isDual && this.motions[part.skin].turns ? 'dqs_scaled' : isLit ? stem : 'lbs_standard',
            sets: primitive.slots / 4,
            frame,
            storage: gradients?.storage ?? 'float32',
            morphs: plays ? (frame === 'tangent' && primitive.tangents ? 'tangent' : 'normal') : morphsOf(primitive, frame, isLit),
            mirrored: this.isMirrored,
        };
        const text = textName(choices);
        return {
            name: `${text} ${shading}`,
            texts: () => [vertexText(this.texts[text], choices), fragment()],
            array: part.arrays[plays ? 'corrected' : isLit ? kind : ''],
            gradients,
            isDual,
        };
    }

    // Upload a pose: joint matrices and dual quaternions by skin, and morphed attributes.
    setPose(pose, motions) {
        const { gl } = this;
        this.pose = pose;
        this.motions = motions;
        this.palettes.forEach(({ texture, values, joints }, skin) => {
            for (let joint = 0; joint < joints; joint++) {
                values.set(pose.skins[skin][joint], 24 * joint);
                const { quaternions, turns } = motions[skin];
                values.set((quaternions ?? turns)[joint], 24 * joint + 16);
            }
            gl.activeTexture(gl.TEXTURE0);
            gl.bindTexture(gl.TEXTURE_2D, texture);
            gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 6, joints, gl.RGBA, gl.FLOAT, values);
        });
    }

    // Upload the attributes of a part under its morph targets, and its normals under its correctives.
    setMorphed(part, { positions, normals, tangents, inPlane, upward, corrected }) {
        const arrays = {
            position: positions, morphed_normal: normals, morphed_tangent: tangents,
            morph: inPlane, morph_by_normal: inPlane, morph_up: upward, corrected,
        };
        for (const [name, values] of Object.entries(arrays)) {
            if (values && part.shared[name]) this.update(part.shared[name], values);
        }
    }

    update(buffer, values) {
        const { gl } = this;
        gl.bindVertexArray(null);
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.bufferSubData(gl.ARRAY_BUFFER, 0, values);
    }

    // Upload the true normals of a part, under linear blending (lbs) or dual quaternions (dqs).
    setTruth(part, method, values) {
        part.truth[method] ??= this.buffer(values);
        this.update(part.truth[method], values);
    }

    bound(part, lighting, projected, mode, has) {
        const { gl } = this;
        const { name, texts, array, gradients, isDual } = this.chosen(part, lighting, mode, has);
        const { program, places } = this.program(name, texts);
        const { method, isTrue } = LIGHTINGS[lighting];
        gl.useProgram(program);
        gl.bindVertexArray(array);
        gl.uniformMatrix4fv(places.projected, false, projected);
        const truth = part.truth[method];
        if (truth) this.attribute('truth', truth, 4);
        else {
            gl.disableVertexAttribArray(LOCATIONS.truth);
            gl.vertexAttrib4f(LOCATIONS.truth, 0, 0, 0, 0);
        }
        if (places.placed) gl.uniformMatrix4fv(places.placed, false, this.pose.nodes[part.node]);
        if (places.motions) {
            gl.activeTexture(gl.TEXTURE0);
            gl.bindTexture(gl.TEXTURE_2D, this.palettes[part.skin].texture);
            gl.uniform1i(places.motions, 0);
            gl.uniform1f(places.scale, isDual ? this.motions[part.skin].scale : 1);
            gl.uniform1f(places.storage_scale, gradients?.scale ?? 1);
            gl.uniform1f(places.is_true, isTrue ? 1 : 0);
        }
        return places;
    }

    // What is drawn on: samples of pixels, and pixels. All views are drawn in one corner and then copied to their
    // places, so that equal views are equal in every pixel.
    sheet() {
        const { gl, canvas: { width, height } } = this;
        if (this.sheets.width === width && this.sheets.height === height) return this.sheets;
        for (const { frame, buffers } of this.sheets) [gl.deleteFramebuffer(frame), ...buffers.map((one) => gl.deleteRenderbuffer(one))];
        this.sheets = [4, 0].map((samples) => {
            const frame = gl.createFramebuffer();
            gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
            const buffers = [[gl.COLOR_ATTACHMENT0, gl.RGBA8], [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24]].map(([place, format]) => {
                const buffer = gl.createRenderbuffer();
                gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
                gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
                gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
                return buffer;
            });
            return { frame, buffers };
        });
        return Object.assign(this.sheets, { width, height });
    }

    // Copy a part of the sheet, from one left edge to another, to the place of its box on the canvas.
    copy([samples, pixels], [left, bottom, , height], [from, to]) {
        const { gl } = this;
        for (const [source, target, x, y] of [[samples, pixels, 0, 0], [pixels, null, left, bottom]]) {
            gl.bindFramebuffer(gl.READ_FRAMEBUFFER, source.frame);
            gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target && target.frame);
            gl.disable(gl.SCISSOR_TEST);
            gl.blitFramebuffer(from, 0, to, height, x + from, y, x + to, y + height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
        }
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }

    // Draw everything in each of the views: a lighting, the box [left, bottom, width, height] of its camera in pixels,
    // the left and the right edge of what is shown of it, its projection and eye. depthOf gives the depth of a part's middle.
    draw({ views, studio, mode, legend, stops, unknown, ink, ground, isTextured, depthOf }) {
        const { gl } = this;
        const sheet = this.sheet();
        gl.clearColor(0, 0, 0, 0);
        gl.enable(gl.DEPTH_TEST);
        gl.depthFunc(gl.LEQUAL); // A layer on another one is seen, as three.js has it.
        gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
        if (!this.model) return;
        // What blends is drawn after all others, the farthest first: what is solid of it, then the rest.
        const shown = new Map(this.parts.map((part) => [part, this.shownMaterial(part, isTextured, mode)]));
        const blended = this.parts.filter((part) => shown.get(part).isBlended);
        const depths = new Map(blended.length > 1 ? blended.map((part) => [part, depthOf(part)]) : []);
        blended.sort((a, b) => depths.get(b) - depths.get(a));
        const solid = this.parts.filter((part) => !shown.get(part).isBlended);
        const passes = [
            ...solid.map((part) => [part, shown.get(part).cutoff, EVERY]),
            ...blended.map((part) => [part, SOLID, EVERY]),
            ...blended.flatMap((part) => [[part, HOLE, SOLID], [part, 0, HOLE]]),
        ];
        for (const { lighting, box, edges: [from, to], projected, eye } of views) {
            if (to <= from) continue;
            gl.bindFramebuffer(gl.FRAMEBUFFER, sheet[0].frame);
            gl.viewport(0, 0, box[2], box[3]);
            gl.enable(gl.SCISSOR_TEST);
            gl.scissor(from, 0, to - from, box[3]);
            gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
            this.drawGround(projected, ground, ink);
            for (const [part, least, below] of passes) {
                const material = shown.get(part);
                const blends = below < EVERY;
                const places = this.bound(part, lighting, projected, mode, material.has);
                gl.uniform3fv(places.eye, eye);
                gl.uniformMatrix3fv(places.studio, false, studio);
                gl.uniform1f(places.legend, legend);
                gl.uniform3fv(places.stops, stops);
                gl.uniform3fv(places.unknown, unknown);
                gl.uniform2f(places.alphas, least, below);
                gl.uniform1i(places.is_blended, Number(blends));
                blends ? gl.enable(gl.BLEND) : gl.disable(gl.BLEND);
                gl.depthMask(!blends || least > 0);
                this.setMaterial(part, places, material);
                for (const face of this.culledFaces(material.own, blends)) {
                    face ? gl.enable(gl.CULL_FACE) : gl.disable(gl.CULL_FACE);
                    if (face) gl.cullFace(face);
                    gl.drawElements(gl.TRIANGLES, part.primitive.triangles.length, gl.UNSIGNED_INT, 0);
                }
            }
            gl.depthMask(true);
            gl.disable(gl.BLEND);
            this.copy(sheet, box, [from, to]);
        }
        gl.bindVertexArray(null);
    }

    drawGround(projected, ground, ink) {
        const { gl } = this;
        const { program, places } = this.program('ground');
        gl.useProgram(program);
        gl.bindVertexArray(null);
        gl.uniformMatrix4fv(places.projected, false, projected);
        gl.uniform4fv(places.ground, ground);
        gl.uniform3fv(places.ink, ink);
        gl.disable(gl.CULL_FACE);
        gl.enable(gl.BLEND);
        gl.depthMask(false);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
        gl.depthMask(true);
        gl.disable(gl.BLEND);
    }

    // What is shown of a part's material: its images, and what the shading has to know of it.
    // In clay only its alpha counts. Modes that show no light have no blending: there half of it counts as a hole.
    shownMaterial({ primitive }, isTextured, mode, kind = 'maps') {
        const own = this.materials[primitive.material];
        const isLit = mode === 'shaded';
        const isPlain = !isTextured || !isLit || !own;
        const isBlended = Boolean(own?.isBlended && isLit);
        const cutoff = own?.isBlended ? HOLE : own?.cutoff ?? 0;
        const { texcoordOf } = primitive;
        const isShown = (name) => name in texcoordOf && (!isPlain || (name === 'base' && (isBlended || cutoff > 0)));
        const maps = Object.fromEntries(Object.entries(own?.[kind] ?? {}).filter(([name]) => isShown(name)));
        const has = Object.keys(maps).sort().map((name) => `${name.toUpperCase()}_TEXCOORD ${TEXCOORDS[texcoordOf[name]]}`);
        if (!isPlain && primitive.colors) has.push('HAS_COLORS');
        if (isPlain && maps.base) has.push('IS_PLAIN');
        if (maps.normal && primitive.tangents) has.push('HAS_TANGENTS');
        if (!isPlain && own.isUnlit) has.push('IS_UNLIT');
        return { own, isPlain, maps, has, isBlended, cutoff };
    }

    setMaterial(part, places, { own, isPlain, maps }) {
        const { gl } = this;
        Object.entries(maps).forEach(([name, texture], i) => {
            gl.activeTexture(gl.TEXTURE1 + i);
            gl.bindTexture(gl.TEXTURE_2D, texture);
            gl.uniform1i(places[`${name}_map`], 1 + i);
        });
        gl.uniform1i(places.is_turned, Number(own?.isDouble === true && !this.isMirrored));
        // An image that is missing or cannot be shown is left out, with the factor that belongs to it.
        const isLost = (name) => isPlain || (own.named.includes(name) && !maps[name]);
        const isClay = isLost('base') || (own.isUncoloured && !own.isUnlit && !part.primitive.colors);
        gl.uniform4fv(places.base_factor, !isClay ? own.base : isPlain && own ? [...CLAY.slice(0, 3), own.base[3]] : CLAY);
        gl.uniform3fv(places.emissive_factor, isLost('emissive') ? [0, 0, 0] : own.emissive);
        gl.uniform1f(places.roughness, isPlain ? 0.42 : own.roughness);
        gl.uniform1f(places.normal_scale, own?.normalScale ?? 1);
        const isTurned = part.skin === undefined && determinant(this.pose.nodes[part.node]) < 0;
        gl.frontFace(isTurned || (part.skin !== undefined && this.isMirrored) ? gl.CW : gl.CCW);
    }

    // The faces that each time are not drawn. Of what blends, those seen from behind come first, as in three.js.
    culledFaces(own, blends) {
        const { gl } = this;
        if (!own?.isDouble && !this.isMirrored) return [gl.BACK];
        return blends ? [gl.FRONT, gl.BACK] : [null];
    }

    // The positions and unit normals that the vertex shader gives a part under a lighting: (3, V) numbers each.
    captured(part, lighting) {
        const { gl } = this;
        const { count } = part.primitive;
        this.bound(part, lighting, new Float32Array(16), 'normals', []);
        const buffers = CAPTURED.map((_, i) => {
            const buffer = gl.createBuffer();
            gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, buffer);
            gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, 12 * count, gl.STREAM_READ);
            gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, i, buffer);
            return buffer;
        });
        gl.bindBuffer(gl.ARRAY_BUFFER, null);
        gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, null);
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.sheet()[0].frame); // A draw on the canvas itself would clear it.
        gl.enable(gl.RASTERIZER_DISCARD);
        gl.beginTransformFeedback(gl.POINTS);
        gl.drawArrays(gl.POINTS, 0, count);
        gl.endTransformFeedback();
        gl.disable(gl.RASTERIZER_DISCARD);
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        const found = buffers.map((buffer, i) => {
            gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, i, null);
            const values = new Float32Array(3 * count);
            gl.bindBuffer(gl.COPY_READ_BUFFER, buffer);
            gl.getBufferSubData(gl.COPY_READ_BUFFER, 0, values);
            gl.bindBuffer(gl.COPY_READ_BUFFER, null);
            gl.deleteBuffer(buffer);
            return values;
        });
        gl.bindVertexArray(null);
        return { positions: found[0], normals: found[1] };
    }
}

export const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

// What the frame follows. Engines, whose lighting is standard, know nothing of the numbers of a differential.
function morphsOf({ targets, tangents, numbers }, frame, isLit) {
    if (!targets.length) return 'none';
    if (isLit && numbers) return numbers === 6 ? 'frames' : 'frames-normal';
    return frame === 'tangent' && tangents && targets.some((target) => target.tangents) ? 'tangent' : 'normal';
}

// Two arrays of vectors of two numbers, as vectors of four.
function pairedVectors(first, second) {
    const found = new Float32Array(2 * first.length);
    for (let i = 0; i < found.length; i++) found[i] = (i & 2 ? second : first)[((i >> 2) << 1) | (i & 1)];
    return found;
}

