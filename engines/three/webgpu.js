// Accurate lighting in three.js for skinned meshes that skinbake has baked. For its WebGPURenderer, with both its
// backends, and for node materials.
//
// Use:
//
//     import { SkinbakePlugin } from 'skinbake-three/webgpu';
//
//     loader.register((parser) => new SkinbakePlugin(parser)); // GLTFLoader; or applySkinbake(scene)
//
// Algorithm 3 of M. Tarini, D. Panozzo, O. Sorkine-Hornung, "Accurate and Efficient Lighting for Skinned Models",
// Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330. Dual quaternions: algorithm 6 of skinbake, the exact
// derivative of their blend. Frame: T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.

import {
    BufferAttribute,
    DataTexture,
    FloatType,
    InstancedBufferAttribute,
    NodeMaterial,
    NormalMapNode,
    REVISION,
    SkinnedMesh,
    Vector4,
} from 'three/webgpu';
import {
    abs,
    attribute,
    cameraViewMatrix,
    cross,
    dot,
    float,
    If,
    int,
    inverseSqrt,
    ivec2,
    length,
    Loop,
    mat4,
    max,
    modelNormalMatrix,
    morphReference,
    normalGeometry,
    normalize,
    normalLocal,
    normalView,
    normalViewGeometry,
    OnObjectUpdate,
    positionLocal,
    positionPrevious,
    reference,
    referenceBuffer,
    select,
    skinning,
    sqrt,
    tangentLocal,
    texture,
    textureSize,
    uniform,
    uniformArray,
    varyingProperty,
    vec2,
    vec3,
    vec4,
    vertexIndex,
} from 'three/tsl';
import {
    ALPHA,
    apply,
    applyToAll,
    ATTRIBUTES,
    BETA,
    CAPPED,
    coordinatesOf,
    DUAL,
    framedBy,
    isBaked,
    isStandard,
    MOVED,
    serve,
    sheetOf,
    state,
    watch,
    WIDTH,
} from './core.js';

export { dispose, lighting, report } from './core.js';

const METHOD = 'lbs';

/**
 * Light the baked skinned meshes below an object accurately. Meshes that are not baked stay as they are.
 * Doing it again repairs what was changed since.
 *
 * @param {Object3D} root - A scene, a model, or a mesh.
 * @param {{ method?: 'lbs' | 'dqs', cap?: number }} [options] - Linear blending, as three.js has it, or dual
 * quaternions; and the largest correction of a tangent, in parts of its length. It has no limit by default.
 * @returns {MeshReport[]} What each skinned mesh is drawn with, baked or not. It stays up to date.
 */
export function applySkinbake(root, { method = METHOD, cap } = {}) {
    serveWebGPU();
    return apply(root, { method, cap });
}

/** A plugin of GLTFLoader, with the options of applySkinbake: `loader.register((parser) => new SkinbakePlugin(parser))`. */
export class SkinbakePlugin {
    constructor(parser, { method = METHOD, cap } = {}) {
        this.name = 'SKINBAKE';
        this.parser = parser;
        this.method = method;
        this.cap = cap;
    }

    // The report is in userData.skinbake of what the loader returns.
    afterRoot(gltf) {
        serveWebGPU();
        return applyToAll(gltf, this.parser, this);
    }
}

const OFF = new Vector4();
// Meshes whose program has asked for their constants since the last look -> whether it has dual quaternions.
const asked = new WeakMap();
let usual;

// Meshes that three.js's own program draws.
const plain = new WeakSet();

// The version lets WebGPURenderer look whether it needs another program.
function choose(mesh, material, isPlain) {
    if (plain.has(mesh) === isPlain) return;
    if (isPlain) plain.add(mesh);
    else plain.delete(mesh);
    for (const one of new Set([mesh.material, material].flat())) one.needsUpdate = true;
}

// Scale; frame: 2 normal, 3 tangent, and 2 more for dual quaternions; cap; row of the sheet.
function constantsOf(object, isDual) {
    asked.set(object, isDual);
    const adopted = state.geometries.get(object.geometry);
    if (!adopted || adopted.problem || isStandard(object, adopted)) return OFF;
    return new Vector4().fromArray(adopted.constants);
}

// three.js morphs and skins in this method, for every material. Here it is told that both are done, so that
// displacement maps, instances and nodes of the application follow.
function setupPosition(builder) {
    const { object, geometry } = builder;
    if (!object.isSkinnedMesh || !isBaked(geometry) || plain.has(object)) return usual.call(this, builder);
    const { morphAttributes } = geometry;
    if (morphAttributes.position || morphAttributes.normal || morphAttributes.color) morphReference(object);
    const position = positionLocal.toVar();
    const normal = normalLocal.toVar();
    skinning(object);
    light(builder, position, normal);
    object.isSkinnedMesh = false;
    geometry.morphAttributes = {};
    try {
        return usual.call(this, builder);
    } finally {
        object.isSkinnedMesh = true;
        geometry.morphAttributes = morphAttributes;
    }
}

function light(builder, position, normal) {
    const { geometry, object } = builder;
    const isDual = geometry.hasAttribute(DUAL);
    const constants = uniform(new Vector4()).onObjectUpdate(({ object }) => constantsOf(object, isDual));
    const tangent = geometry.hasAttribute('tangent') ? attribute('tangent', 'vec4') : null;
    // What is displaced along the normal moves as three.js moves normals.
    const carried = normalLocal.div(max(length(normal), 1e-20)).toVar();
    if (tangent && hasRelief(builder)) {
        passRelief(tangentLocal, cross(normalLocal, tangentLocal).mul(tangent.w), null);
    }
    If(constants.y.greaterThan(1.5), () => {
        const isTangentFrame = int(constants.y).bitAnd(1).equal(1).toVar();
        const rest = restFrame(tangent, isTangentFrame);
        const byNormal = geometry.morphAttributes.normal ? morphed(rest, normal) : rest;
        const frame = geometry.hasAttribute(MOVED) ? movedFrame(object, rest, byNormal, constants.w) : byNormal;
        const bind = reference('bindMatrix', 'mat4');
        const back = reference('bindMatrixInverse', 'mat4');
        const turned = (matrix, vector) => matrix.mul(vec4(vector, 0)).xyz;
        const inBind = bind.mul(vec4(position, 1)).xyz.toVar();
        const joints = attribute('skinIndex', 'uvec4');
        const matricesOf = (bones) => parts(joints).map((joint) => bones.element(joint).toVar());
        const stored = gradients(builder);
        const weights = attribute('skinWeight', 'vec4');
        const cap = geometry.hasAttribute(CAPPED) ? constants.z : null;
        const move = isDual ? dualQuaternions : blended;
        const moved = move(inBind, matricesOf(boneMatrices(builder, 'bone')), weights, cap);
        if (isDual) positionLocal.assign(back.mul(vec4(moved.position, 1)).xyz);
        if (isDual && builder.needsPreviousData()) {
            const before = move(inBind, matricesOf(boneMatrices(builder, 'previousBone')), weights);
            positionPrevious.assign(back.mul(vec4(before.position, 1)).xyz);
        }
        const alongOf = (vector, which) => moved.along(turned(bind, vector).toVar(), decoded(stored(which), constants.x));
        const image = turned(back, alongOf(frame.tangent, 0)).toVar();
        const other = turned(back, alongOf(frame.bitangent, 1)).toVar();
        normalLocal.assign(cross(image, other).mul(frame.handedness));
        if (tangent && hasRelief(builder)) {
            if (isDual || geometry.hasAttribute(MOVED)) {
                carried.assign(turned(back, moved.carried(turned(bind, frame.normal))));
            }
            const first = cross(other, carried).mul(frame.handedness).toVar();
            const second = cross(carried, image).mul(frame.handedness).toVar();
            // Cofactors are linear: those of t and b follow from those of t0, b0 and n0. t may lean from n0.
            const t = normalize(tangent.xyz).toVar();
            const b = normalize(cross(rest.normal, t)).mul(tangent.w).toVar();
            const along = (axis) =>
                first.mul(dot(axis, rest.tangent)).add(second.mul(dot(axis, rest.bitangent))).toVar();
            const size = length(rest.tangent);
            passRelief(
                select(isTangentFrame, first.mul(size), along(t).add(normalLocal.mul(dot(t, rest.normal)))),
                select(isTangentFrame, second.mul(size), along(b)),
                normalLocal,
            );
        }
        if (tangent) {
            const along = (axis) => dot(tangent.xyz, axis);
            const mixed = image.mul(along(rest.tangent)).add(other.mul(along(rest.bitangent)));
            tangentLocal.assign(select(isTangentFrame, image, mixed));
        }
    });
}

// What a normal map needs at the pixel: a direction in xyz, and its length over that of the normal in w.
const RELIEF = ['Cotangent', 'Cobitangent'].map((name) => varyingProperty('vec4', `skinbake${name}`));

// three.js moves instances after this module has lit a mesh.
const hasRelief = ({ object, material }) => !object.isInstancedMesh && framedBy(object, material) === 'tangent';

// Pass vectors of the mesh that are carried as its normal is. Without a normal they have length 1, as in three.js.
function passRelief(cotangent, cobitangent, normal) {
    const viewed = (vector) => cameraViewMatrix.mul(vec4(modelNormalMatrix.mul(vector), 0)).xyz.toVar();
    const unit = normal && length(viewed(normal)).toVar();
    [cotangent, cobitangent].forEach((vector, index) => {
        const seen = viewed(vector);
        RELIEF[index].assign(vec4(normalize(seen), unit ? length(seen).div(unit) : 1));
    });
}

let usualMap;

// three.js sets up each normal map in this method, that of the clear coat too.
function setupNormalMap(builder) {
    const { object, geometry } = builder;
    const isLit = object?.isSkinnedMesh !== undefined && isBaked(geometry) && !plain.has(object);
    if (!isLit || this.normalMapType !== 0 || this.unpackNormalMode || !hasRelief(builder) || builder.isFlatShading()) {
        return usualMap.call(this, builder);
    }
    const texel = this.node.mul(2).sub(1).toVar();
    const slopes = this.scaleNode === null ? texel.xy : texel.xy.mul(this.scaleNode);
    const side = dot(normalView, normalViewGeometry).sign(); // a back may be seen
    const [x, y] = RELIEF.map((one, index) => normalize(one.xyz).mul(one.w).mul(index ? slopes.y : slopes.x));
    return normalize(x.add(y).mul(side).add(normalView.mul(texel.z)));
}

const GRADIENTS = [ALPHA, BETA];

// Return what reads alpha (0) or beta (1) as it is stored. WebGPU has eight vertex buffers, if the page does not ask
// for more, and three.js has each attribute in one. Where the other attributes leave too few, a texture has both.
function gradients({ geometry, renderer }) {
    const { maxVertexBuffers = Infinity } = renderer.backend?.device?.limits ?? {};
    // Geometries whose attributes have the same names share a program.
    if (othersOf(geometry).length + GRADIENTS.length <= maxVertexBuffers) {
        return (which) => attribute(GRADIENTS[which], 'vec4');
    }
    const image = texture(imageOf(geometry));
    OnObjectUpdate(({ object }) => {
        if (isBaked(object.geometry)) image.value = imageOf(object.geometry);
    });
    return (which) => {
        const texel = int(vertexIndex).mul(GRADIENTS.length).add(which).toVar();
        const y = texel.div(WIDTH).toVar();
        return image.load(ivec2(texel.sub(y.mul(WIDTH)), y));
    };
}

// Names of the attributes that materials may read.
function othersOf(geometry) {
    const unread = ['_skinbake_morph', '_skinbake_morph_up'];
    const own = new Set([...coordinatesOf(geometry.userData.skinbake), ...ATTRIBUTES, ...unread]);
    return Object.keys(geometry.attributes).filter((name) => !own.has(name));
}

// One texel for alpha, and the next one for beta.
function imageOf(geometry) {
    const adopted = state.geometries.get(geometry);
    if (adopted.image) return adopted.image;
    const { attributes } = geometry;
    const { count, itemSize } = attributes[ALPHA];
    const height = Math.ceil((GRADIENTS.length * count) / WIDTH);
    const values = new Float32Array(4 * WIDTH * height).fill(1); // w, where nothing is encoded
    for (let texel = 0; texel < GRADIENTS.length * count; texel++) {
        const source = attributes[GRADIENTS[texel % 2]];
        for (let part = 0; part < itemSize; part++) {
            values[4 * texel + part] = source.getComponent(Math.floor(texel / 2), part);
        }
    }
    adopted.image = new DataTexture(values, WIDTH, height, undefined, FloatType);
    adopted.image.needsUpdate = true;
    geometry.addEventListener('dispose', freeImage);
    return adopted.image;
}

function freeImage({ target }) {
    state.geometries.get(target)?.image?.dispose();
}

function decoded(stored, scale) {
    return stored.xyz.mul(scale.mul(stored.w).mul(stored.w)).toVar();
}

function restFrame(tangent, isTangentFrame) {
    const given = normalGeometry;
    const n = select(dot(given, given).greaterThan(0), normalize(given), vec3(0, 0, 1)).toVar();
    const side = select(n.z.greaterThanEqual(0), float(1), float(-1)).toVar();
    const a = float(-1).div(side.add(n.z)).toVar();
    const b = n.x.mul(n.y).mul(a).toVar();
    const t0 = vec3(n.x.mul(n.x).mul(a).mul(side).add(1), side.mul(b), side.mul(n.x).negate());
    const b0 = vec3(b, side.mul(n.y.mul(n.y).mul(a).mul(side).add(1)), n.y.negate());
    if (!tangent) return { normal: n, tangent: t0.toVar(), bitangent: b0.toVar(), handedness: float(1) };
    return {
        normal: n,
        tangent: select(isTangentFrame, tangent.xyz, t0).toVar(),
        bitangent: select(isTangentFrame, cross(n, tangent.xyz).mul(tangent.w), b0).toVar(),
        handedness: select(isTangentFrame, tangent.w, float(1)).toVar(),
    };
}

// The smallest rotation that takes the normal at rest to the morphed one turns the frame.
function morphed(rest, morphedNormal) {
    const square = dot(morphedNormal, morphedNormal);
    const n = select(square.greaterThan(0), morphedNormal.mul(inverseSqrt(square)), rest.normal).toVar();
    const s = rest.normal.add(n).toVar();
    const d = n.sub(rest.normal).toVar();
    const opposite = dot(s, s).lessThan(1e-4).toVar();
    const k = select(opposite, float(0), float(2).div(dot(s, s))).toVar();
    const turned = (vector) => vector.sub(s.mul(k.mul(dot(d, vector)))).toVar();
    const bitangent = turned(rest.bitangent);
    return {
        normal: n,
        tangent: turned(rest.tangent),
        bitangent: select(opposite, bitangent.negate(), bitangent).toVar(),
        handedness: rest.handedness,
    };
}

// The frame moves by the numbers that the file has for each target: by four of them and the morphed normal, by six.
function movedFrame(mesh, rest, byNormal, place) {
    const influences = uniformArray(mesh.morphTargetInfluences, 'float');
    OnObjectUpdate(({ object }) => {
        influences.array = object.morphTargetInfluences;
        influences.update();
    });
    const sheet = texture(sheetOf());
    const numbers = (texel) => {
        const y = texel.div(WIDTH).toVar();
        return sheet.load(ivec2(texel.sub(y.mul(WIDTH)), y));
    };
    const isFour = place.lessThan(0).toVar();
    const texels = select(isFour, int(1), int(2)).toVar();
    const count = mesh.geometry.morphAttributes.position.length;
    const first = int(abs(place)).sub(1).mul(WIDTH).add(texels.mul(count).mul(int(vertexIndex))).toVar();
    const m = vec4(0).toVar();
    const up = vec2(0).toVar();
    Loop(count, ({ i }) => {
        const influence = influences.element(i).toVar();
        If(influence.notEqual(0), () => {
            const texel = first.add(texels.mul(i)).toVar();
            m.addAssign(numbers(texel).mul(influence));
            If(isFour.not(), () => {
                up.addAssign(numbers(texel.add(1)).xy.mul(influence));
            });
        });
    });
    const { normal: n0, handedness } = rest;
    const t = rest.tangent.mul(m.x.add(1)).add(rest.bitangent.mul(m.y)).add(n0.mul(up.x)).toVar();
    const b = rest.tangent.mul(m.z).add(rest.bitangent.mul(m.w.add(1))).add(n0.mul(up.y)).toVar();
    const outward = cross(t, b).mul(handedness).toVar();
    const isMoved = dot(m, m).add(dot(up, up)).greaterThan(0).and(dot(outward, outward).greaterThan(0));
    const moved = { normal: select(isMoved, normalize(outward), n0).toVar(), tangent: t, bitangent: b };
    const cosine = dot(n0, byNormal.normal).toVar();
    const side = m.x.add(1).mul(m.w.add(1)).sub(m.y.mul(m.z)).mul(cosine);
    // Then m tells too little, or of the other side of the surface.
    const isSteep = abs(cosine).lessThan(0.2).or(side.lessThanEqual(0)).toVar();
    const lain = (vector, steep) => {
        const flat = vector.sub(n0.mul(dot(vector, byNormal.normal).div(select(isSteep, float(1), cosine))));
        return select(isSteep, steep, flat);
    };
    return {
        normal: select(isFour, byNormal.normal, moved.normal).toVar(),
        tangent: select(isFour, lain(t, byNormal.tangent), moved.tangent).toVar(),
        bitangent: select(isFour, lain(b, byNormal.bitangent), moved.bitangent).toVar(),
        handedness,
    };
}

// Return what reads the joints of a skeleton: kind is bone, or previousBone for those of the frame before.
function boneMatrices(builder, kind) {
    const { skeleton } = builder.object;
    const isOurs = kind === 'previousBone' && keepPrevious(builder.object);
    const count = skeleton.bones.length;
    if (isOurs || count * 64 <= builder.getUniformBufferLimit()) {
        return referenceBuffer(`skeleton.${kind}Matrices`, 'mat4', count);
    }
    if (skeleton.boneTexture === null) skeleton.computeBoneTexture();
    const matrices = texture(skeleton[`${kind}Texture`]);
    OnObjectUpdate(({ object }) => {
        if (object.skeleton.boneTexture === null) object.skeleton.computeBoneTexture();
        matrices.value = object.skeleton[`${kind}Texture`];
    });
    const element = (index) => {
        const size = int(textureSize(matrices).x).toVar();
        const first = int(index).mul(4).toVar();
        const y = first.div(size).toVar();
        const x = first.sub(y.mul(size)).toVar();
        return mat4(...[0, 1, 2, 3].map((column) => matrices.load(ivec2(x.add(column), y))));
    };
    return { element };
}

const latest = new WeakMap(); // skeleton -> { frameId, matrices } of its last frame

// Keep the joints of the frame before, which three.js does itself from 0.187 on. Return whether that is done here. It comes
// after three.js's skinning, which moves the joints.
function keepPrevious({ skeleton }) {
    if (skeleton.previousBoneMatrices !== undefined && !latest.has(skeleton)) return false;
    const act = (kept, frameId) => {
        const { boneMatrices } = kept;
        if (!latest.has(kept)) {
            kept.previousBoneMatrices = boneMatrices.slice();
            latest.set(kept, { frameId, matrices: boneMatrices.slice() });
        }
        const last = latest.get(kept);
        if (last.frameId === frameId) return;
        kept.previousBoneMatrices.set(last.matrices);
        last.matrices.set(boneMatrices);
        last.frameId = frameId;
    };
    act(skeleton);
    OnObjectUpdate(({ object, frameId }) => act(object.skeleton, frameId));
    return true;
}

// base + correction. The correction is shortened to at most cap * |base|, if there is a cap.
function capped(base, correction, cap) {
    if (!cap) return base.add(correction);
    const allowed = cap.mul(cap).mul(dot(base, base)).toVar();
    const square = dot(correction, correction).toVar();
    const isTooLong = square.greaterThan(allowed).and(allowed.greaterThan(0));
    return base.add(correction.mul(select(isTooLong, sqrt(allowed.div(square)), float(1))));
}

const sum = (terms) => terms.reduce((total, term) => total.add(term));
const parts = (vector) => [vector.x, vector.y, vector.z, vector.w];

// The frame moves by the derivative of the skinned position along t0 and b0: algorithm 3.
function blended(position, M, weights, cap) {
    const w = parts(weights);
    const q = M.map((matrix) => matrix.mul(vec4(position, 1)).xyz.toVar());
    const d = q.slice(1).map((one) => one.sub(q[0]).toVar());
    const carried = (n) => sum(M.map((matrix, slot) => matrix.mul(vec4(n, 0)).xyz.mul(w[slot]))).toVar();
    const along = (vector, slopes) =>
        capped(carried(vector), sum(d.map((one, slot) => one.mul(parts(slopes)[slot]))).toVar(), cap).toVar();
    return { along, carried };
}

// The frame moves by the derivative of the blended motion: algorithm 6 of skinbake. A parent of the skeleton may
// scale, shear or mirror all joints alike. The motions that the inverse of M[0] leaves are rigid even so. They are
// blended, and M[0] moves the result: for rigid joints that is the same blend.
function dualQuaternions(p, M, weights, cap) {
    const columns = (matrix) => [0, 1, 2, 3].map((column) => matrix.element(column).xyz);
    const [a, b, c, origin] = columns(M[0]).map((column) => column.toVar());
    const cofactors = [cross(b, c), cross(c, a), cross(a, b)].map((column) => column.toVar());
    const determinant = dot(a, cofactors[0]).toVar();
    const back = (vector) => vec3(...cofactors.map((column) => dot(column, vector))).div(determinant).toVar();
    const forth = (vector) => a.mul(vector.x).add(b.mul(vector.y)).add(c.mul(vector.z)).toVar();
    const others = M.slice(1).map((matrix) => {
        const [x, y, z, shift] = columns(matrix);
        return dualQuaternion(back(x), back(y), back(z), back(shift.sub(origin)));
    });
    const Q = [{ real: vec4(0, 0, 0, 1), dual: vec4(0) }, ...others];
    const w = parts(weights);
    const near = Q.map(({ real, dual }, slot) => {
        const sign = select(dot(real, Q[0].real).lessThan(0), float(-1), float(1)).toVar();
        return slot === 0 ? Q[0] : { real: real.mul(sign).toVar(), dual: dual.mul(sign).toVar() };
    });
    const mix = {
        real: sum(near.map(({ real }, slot) => real.mul(w[slot]))).toVar(),
        dual: sum(near.map(({ dual }, slot) => dual.mul(w[slot]))).toVar(),
    };
    const square = dot(mix.real, mix.real).toVar();
    const k = select(square.equal(0), float(2), float(2).div(square)).toVar();
    const i = p.mul(mix.real.w).add(mix.dual.xyz).add(cross(mix.real.xyz, p)).toVar();
    const shift = mix.dual.xyz.mul(mix.real.w).sub(mix.real.xyz.mul(mix.dual.w));
    const delta = shift.add(cross(mix.real.xyz, i)).mul(k).toVar();
    const turn = (n) => cross(mix.real.xyz, n.mul(mix.real.w).add(cross(mix.real.xyz, n))).toVar();
    const along = (t, slopes) => {
        const differences = near.slice(1).map((one) => ({
            real: one.real.sub(near[0].real),
            dual: one.dual.sub(near[0].dual),
        }));
        const real = sum(differences.map((one, slot) => one.real.mul(parts(slopes)[slot]))).toVar();
        const dual = sum(differences.map((one, slot) => one.dual.mul(parts(slopes)[slot]))).toVar();
        const di = sum([
            t.mul(mix.real.w),
            dual.xyz,
            cross(mix.real.xyz, t),
            p.mul(real.w),
            cross(real.xyz, p),
        ]).toVar();
        const dh = sum([dual.xyz.mul(mix.real.w), cross(mix.real.xyz, di), cross(real.xyz, i)])
            .add(mix.dual.xyz.mul(real.w))
            .sub(mix.real.xyz.mul(dual.w))
            .sub(real.xyz.mul(mix.dual.w))
            .sub(delta.mul(dot(mix.real, real)));
        if (!cap) return forth(t.add(dh.mul(k)).toVar());
        const own = turn(t);
        return forth(capped(t.add(own.mul(k)).toVar(), dh.sub(own).mul(k).toVar(), cap));
    };
    const carried = (n) => forth(n.add(turn(n).mul(k)).toVar());
    return { position: forth(p.add(delta).toVar()).add(origin), along, carried };
}

// Of the rotation with columns a, b, c, then the shift t.
function dualQuaternion(a, b, c, t) {
    const d = vec3(a.x, b.y, c.z).toVar();
    const squares = vec4(
        d.x.sub(d.y).sub(d.z),
        d.y.sub(d.z).sub(d.x),
        d.z.sub(d.x).sub(d.y),
        d.x.add(d.y).add(d.z),
    ).add(1).toVar();
    const differences = vec3(b.z.sub(c.y), c.x.sub(a.z), a.y.sub(b.x)).toVar();
    const sums = vec3(b.z.add(c.y), c.x.add(a.z), a.y.add(b.x)).toVar();
    const largest = squares.w.toVar();
    const real = vec4(differences, squares.w).toVar();
    const choices = [
        [squares.x, vec4(squares.x, sums.z, sums.y, differences.x)],
        [squares.y, vec4(sums.z, squares.y, sums.x, differences.y)],
        [squares.z, vec4(sums.y, sums.x, squares.z, differences.z)],
    ];
    for (const [value, quaternion] of choices) {
        If(value.greaterThan(largest), () => {
            largest.assign(value);
            real.assign(quaternion);
        });
    }
    real.assign(normalize(real));
    const dual = vec4(cross(t, real.xyz).add(t.mul(real.w)), dot(t, real.xyz).negate()).mul(0.5).toVar();
    return { real, dual };
}

function changeMaterials() {
    if (NodeMaterial.prototype.setupPosition === setupPosition) return;
    usual = NodeMaterial.prototype.setupPosition;
    NodeMaterial.prototype.setupPosition = setupPosition;
    usualMap = NormalMapNode.prototype.setup;
    NormalMapNode.prototype.setup = setupNormalMap;
}

function restoreMaterials() {
    NodeMaterial.prototype.setupPosition = usual;
    NormalMapNode.prototype.setup = usualMap;
}

const ACCURATE = Object.fromEntries(
    ['none', 'accurate', 'derivatives', 'standard'].map((normalMap) => [
        normalMap,
        { lighting: 'accurate', reason: '', normalMap },
    ]),
);
const UNSEEN = { lighting: 'not drawn', reason: '' };

// A program that lights accurately asks for the constants whenever it draws.
function verifyMaterial(renderer, mesh, material, before) {
    const isDual = asked.get(mesh);
    asked.delete(mesh);
    if (isDual === mesh.geometry.hasAttribute(DUAL)) {
        const frame = framedBy(mesh, material);
        if (frame !== 'tangent') return ACCURATE[frame];
        const isRelief = !material.normalMap || (material.normalMapType !== 1 && !mesh.isInstancedMesh);
        return ACCURATE[isRelief ? 'accurate' : 'standard'];
    }
    if (before?.lighting === 'standard') return before;
    if (before !== UNSEEN) {
        // It may be from before the geometry was changed.
        material.needsUpdate = true;
        return UNSEEN;
    }
    const reason = `its ${material.type} "${material.name}" does not skin by three.js's nodes`;
    return { lighting: 'standard', reason };
}

function serveWebGPU() {
    const backend = {
        text: 'tsl',
        install: changeMaterials,
        uninstall: restoreMaterials,
        choose,
        verify: verifyMaterial,
    };
    // Before 0.185 three.js skins after all other lines, wherever it is told to.
    const classes = { BufferAttribute, DataTexture, FloatType, InstancedBufferAttribute, SkinnedMesh };
    serve('webgpu', backend, classes, REVISION, 185);
}

watch(SkinnedMesh);
