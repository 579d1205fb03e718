// What the tests call in the browser: scenes of Babylon.js, drawn as a page draws them, with whatever a page does to
// materials and meshes. What comes back are the normals that the vertex shaders handed on.

import '@babylonjs/core/Animations/animatable.js';
import { BakedVertexAnimationManager } from '@babylonjs/core/BakedVertexAnimation/bakedVertexAnimationManager.js';
import { FreeCamera } from '@babylonjs/core/Cameras/freeCamera.js';
import { Engine } from '@babylonjs/core/Engines/engine.js';
import '@babylonjs/core/Engines/Extensions/index.js';
import { WebGPUEngine } from '@babylonjs/core/Engines/webgpuEngine.js';
import { DirectionalLight } from '@babylonjs/core/Lights/directionalLight.js';
import { ShadowGenerator } from '@babylonjs/core/Lights/Shadows/shadowGenerator.js';
import '@babylonjs/core/Lights/Shadows/shadowGeneratorSceneComponent.js';
import { ImportMeshAsync, LoadAssetContainerAsync } from '@babylonjs/core/Loading/sceneLoader.js';
import { MaterialPluginBase } from '@babylonjs/core/Materials/materialPluginBase.js';
import { OpenPBRMaterial } from '@babylonjs/core/Materials/PBR/openpbrMaterial.js';
import { ShaderMaterial } from '@babylonjs/core/Materials/shaderMaterial.js';
import { StandardMaterial } from '@babylonjs/core/Materials/standardMaterial.js';
import { RawTexture } from '@babylonjs/core/Materials/Textures/rawTexture.js';
import { RenderTargetTexture } from '@babylonjs/core/Materials/Textures/renderTargetTexture.js';
import { RawCubeTexture } from '@babylonjs/core/Materials/Textures/rawCubeTexture.js';
import { SphericalPolynomial } from '@babylonjs/core/Maths/sphericalPolynomial.js';
import { Color4 } from '@babylonjs/core/Maths/math.color.js';
import { Matrix, Quaternion, Vector3 } from '@babylonjs/core/Maths/math.vector.js';
import { DracoDecoder } from '@babylonjs/core/Meshes/Compression/dracoDecoder.js';
import { Mesh } from '@babylonjs/core/Meshes/mesh.js';
import { MeshoptCompression } from '@babylonjs/core/Meshes/Compression/meshoptCompression.js';
import '@babylonjs/core/Meshes/instancedMesh.js';
import '@babylonjs/core/Meshes/thinInstanceMesh.js';
import '@babylonjs/core/Rendering/geometryBufferRendererSceneComponent.js';
import { Scene } from '@babylonjs/core/scene.js';
import '@babylonjs/loaders/glTF/2.0/index.js';
import * as skinbake from 'skinbake-babylon';
import { base64 } from '/support/base64.mjs';

WEBGPU_CAPTURE.dialect = {
    struct: 'struct FragmentInputs {',
    returns: 'return vertexOutputs;',
    position: 'vertexOutputs.position',
    captured: 'vertexOutputs.captured',
    indexed: (code) => [code, 'vertexInputs.vertexIndex'],
};

const wasm = '/draco/draco_decoder_gltf';
DracoDecoder.DefaultConfiguration = { wasmUrl: `${wasm}_nodejs.js`, wasmBinaryUrl: `${wasm}.wasm`, numWorkers: 0 };
MeshoptCompression.Configuration.decoder.url = '/meshopt/meshopt_decoder.cjs';

// SwiftShader's WebGPU cannot present to a canvas: what is drawn there goes into a texture.
if (window.GPUCanvasContext) {
    const textures = new WeakMap();
    GPUCanvasContext.prototype.configure = function ({ device, format }) {
        const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC;
        textures.set(this, device.createTexture({ size: [this.canvas.width, this.canvas.height], format, usage }));
    };
    GPUCanvasContext.prototype.getCurrentTexture = function () {
        return textures.get(this);
    };
}

const engines = {};

function engineOf(backend) {
    engines[backend] ??= started(backend);
    return engines[backend];
}

async function started(backend) {
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = 16;
    document.body.append(canvas);
    if (backend === 'webgl') return new Engine(canvas, false);
    if (!navigator.gpu || !(await navigator.gpu.requestAdapter())) return null;
    const engine = new WebGPUEngine(canvas, { antialias: false });
    await engine.initAsync();
    return engine;
}

// Scenes are not disposed of: so Babylon.js keeps the programs, and later scenes need not compile them again.
async function stageOf({ backend = 'webgl', left = false, plugin = true, method }) {
    const scene = new Scene(await engineOf(backend));
    scene.useRightHandedSystem = !left;
    new DirectionalLight('sun', new Vector3(-1, -2, -3), scene);
    scene.activeCamera = new FreeCamera('camera', new Vector3(0, 0, -3), scene);
    if (plugin) skinbake.registerSkinbake({ method });
    else skinbake.unregisterSkinbake();
    return scene;
}

// Options: those of stageOf; url; pose; morphs; a change of them; material; bones: where the shader reads them.
async function load({ url, pose, morphs = [], change = 'nothing', material = 'pbr', bones = 'texture', ...options }) {
    const scene = await stageOf(options);
    const loaded = await ImportMeshAsync(url, scene, { pluginExtension: '.glb' });
    posed(loaded, pose);
    const meshes = skinned(scene);
    for (const mesh of meshes) {
        mesh.alwaysSelectAsActiveMesh = true;
        morphs.forEach((weight, index) => (mesh.morphTargetManager.getTarget(index).influence = weight));
        MORPH_CHANGES[change](mesh);
        if (bones === 'uniforms') mesh.skeleton.useTextureToStoreBoneMatrices = false;
        if (material !== 'pbr') mesh.material = new MATERIALS[material](material, scene);
    }
    return { scene, mesh: meshes[0], loaded };
}

// What a page does to morph targets.
const MORPH_CHANGES = {
    nothing: () => {},
    'targets in attributes': ({ morphTargetManager }) => (morphTargetManager.useTextureToStoreTargets = false),
    'targets in another order': ({ morphTargetManager }) => {
        const first = morphTargetManager.getTarget(0);
        morphTargetManager.removeTarget(first);
        morphTargetManager.addTarget(first);
    },
    clone: (mesh) => {
        mesh.morphTargetManager = mesh.morphTargetManager.clone();
    },
};

const MATERIALS = { standard: StandardMaterial, openpbr: OpenPBRMaterial };

const skinned = (scene) => scene.meshes.filter((mesh) => mesh.geometry && mesh.skeleton);

function posed({ animationGroups, skeletons }, { clip, time, turned = [] } = {}) {
    for (const group of animationGroups) group.stop();
    if (clip !== undefined) {
        animationGroups[clip].start(false);
        animationGroups[clip].pause();
        animationGroups[clip].goToFrame(60 * time);
    }
    for (const [joint, [w, x, y, z]] of turned.entries()) {
        const node = skeletons[0].bones.find((bone) => bone.getIndex() === joint).getTransformNode();
        node.rotationQuaternion = node.rotationQuaternion.multiply(new Quaternion(x, y, z, w));
    }
}

// Draw until everything is compiled, then once more, recorded: each draw of a varying of that name.
async function draw(scene, name = 'vNormalW') {
    await ready(scene);
    const engine = scene.getEngine();
    const capture = engine.isWebGPU ? WEBGPU_CAPTURE : CAPTURE;
    frame(scene);
    frame(scene);
    capture.draws = [];
    capture.on = true;
    frame(scene);
    capture.on = false;
    if (!engine.isWebGPU) return CAPTURE.draws.filter((one) => one.name === name).map(({ values }) => base64(values));
    WEBGPU_CAPTURE.name = name;
    const found = [];
    for (const one of capture.draws) {
        for (let instance = 0; instance < one.instances; instance++) {
            const { varying } = await WEBGPU_CAPTURE.read(one, instance);
            found.push(base64(varying.filter((_, index) => index % 4 < 3)));
        }
    }
    return found;
}

// As whenReadyAsync(), which looks every tenth of a second, and waits forever for a program that does not compile.
async function ready(scene) {
    const end = performance.now() + 60000;
    while (!scene.isReady()) {
        if (performance.now() > end) throw new Error('the scene is never ready');
        await new Promise((resolve) => setTimeout(resolve, 2));
    }
}

function frame(scene) {
    scene.getEngine().beginFrame();
    scene.render();
    scene.getEngine().endFrame();
}

const told = (root) => skinbake.report(root).map(({ lighting, reason }) => [lighting, reason]);

// A page that adds a normal map.
function addBump(scene, { material }, texel = [128, 128, 255]) {
    const texture = RawTexture.CreateRGBATexture(new Uint8Array([...texel, 255]), 1, 1, scene);
    material[material instanceof OpenPBRMaterial ? 'geometryNormalTexture' : 'bumpTexture'] = texture;
}

// A page's own code, in both languages, which turns normals before Babylon.js skins them.
class Turning extends MaterialPluginBase {
    constructor(material) {
        super(material, 'Turning', 100, { TURNING: true }, true, true); // Babylon.js shares programs with equal defines
    }

    isCompatible() {
        return true;
    }

    getCustomCode(type, language = 0) {
        const vector = language === 0 ? 'vec3' : 'vec3f';
        return type === 'vertex' ? { CUSTOM_VERTEX_UPDATE_NORMAL: `normalUpdated += ${vector}(0.5, 0.25, -0.5);` } : null;
    }
}

// A page's own code that draws each vertex as a point into a pixel of its own, in its mapped normal.
const SIDE = 64; // of a picture with a pixel for each vertex

class Reading extends MaterialPluginBase {
    constructor(material) {
        super(material, 'Reading', 300, { READING: true }, true, true);
    }

    getClassName() {
        return 'ReadingPlugin';
    }

    getCustomCode(type) {
        if (type === 'fragment') return { CUSTOM_FRAGMENT_MAIN_END: 'gl_FragColor = vec4(normalW, 1.0);' };
        return {
            CUSTOM_VERTEX_MAIN_END: `
                vec2 pixel = vec2(gl_VertexID % ${SIDE}, gl_VertexID / ${SIDE}) + 0.5;
                gl_Position = vec4(2.0 * pixel / ${SIDE}.0 - 1.0, 0.0, 1.0);
                gl_PointSize = 1.0;`,
        };
    }
}

// What applications do after the first frame. Each returns the meshes that it leaves.
const CHANGES = {
    nothing: () => {},
    'material.clone()': ({ mesh }) => (mesh.material = mesh.material.clone('other')),
    'another material': ({ mesh, scene }) => (mesh.material = new StandardMaterial('other', scene)),
    'material.freeze()': ({ mesh }) => mesh.material.freeze(),
    'mesh.clone()': ({ mesh }) => {
        mesh.clone('copy');
        mesh.setEnabled(false);
    },
    'mesh without materials': ({ mesh }) => (mesh.material = null),
    'registered twice': () => skinbake.registerSkinbake(),
    'standard and back': ({ scene }) => {
        skinbake.lighting(scene, 'standard');
        frame(scene);
        skinbake.lighting(scene, 'accurate');
    },
};

// What a page does to the attributes of a mesh that has been drawn.
const ALTERED = {
    'normals flattened': ({ mesh }) => mesh.convertToFlatShadedMesh(),
    'normals in place': ({ mesh, scene }) => {
        const normals = mesh.getVerticesData('normal').slice();
        mesh.setVerticesData('normal', normals, true);
        frame(scene);
        frame(scene);
        mesh.updateVerticesData('normal', normals.map((one) => -one));
    },
    'a buffer of normals in place': ({ mesh, scene }) => {
        const normals = mesh.getVerticesData('normal').slice();
        mesh.setVerticesData('normal', normals, true);
        frame(scene);
        mesh.getVertexBuffer('normal').updateDirectly(normals.map((one) => -one), 0);
    },
    'positions stretched': ({ mesh }) =>
        mesh.setVerticesData('position', mesh.getVerticesData('position').map((one, index) => (index % 3 ? one : 2 * one))),
    'other weights': ({ mesh }) =>
        mesh.setVerticesData('matricesWeights', mesh.getVerticesData('matricesWeights').map((_, index) => (index % 4 < 2 ? 0.5 : 0))),
    'weights cleaned': ({ mesh }) => mesh.cleanMatrixWeights(),
    'normals as they were': ({ mesh, scene }) => {
        mesh.setVerticesData('normal', mesh.getVerticesData('normal').slice(), true);
        frame(scene);
        mesh.updateVerticesData('normal', mesh.getVerticesData('normal').slice());
    },
    'arrays freed': ({ scene }) => scene.clearCachedVertexData(),
    'tangents replaced': ({ mesh }) => mesh.setVerticesData('tangent', mesh.getVerticesData('tangent').map((one) => -one)),
    'tangents removed': ({ mesh }) => mesh.geometry.removeVerticesData('tangent'),
    'beta removed': ({ mesh }) => mesh.geometry.removeVerticesData('skinbakeBeta0'),
    'processor and back': ({ mesh, scene }) => {
        mesh.computeBonesUsingShaders = false;
        frame(scene);
        mesh.computeBonesUsingShaders = true;
    },
};

// What report() takes, or does not take, by its names below.
const ROOTS = {
    nothing: () => undefined,
    text: () => 'hero',
    'a skeleton': ({ mesh }) => mesh.skeleton,
    'a list of nothing': () => [null],
    'what a container returns': ({ entries }) => entries,
    'a container': ({ container }) => container,
};

const BLOCKS = {
    frozen: ({ mesh }) => mesh.material.freeze(),
    'blocked in the scene': ({ scene }) => (scene.blockMaterialDirtyMechanism = true),
    'blocked in the material': ({ mesh }) => (mesh.material.blockDirtyMechanism = true),
};

const PLACES = [Matrix.RotationY(1), Matrix.Scaling(1, -2, 0.5).multiply(Matrix.RotationX(2))];

const MANY = {
    instances: ({ mesh }) => {
        for (const place of PLACES) {
            const instance = mesh.createInstance('instance');
            instance.alwaysSelectAsActiveMesh = true;
            instance.rotationQuaternion = new Quaternion();
            place.decompose(instance.scaling, instance.rotationQuaternion, instance.position);
        }
    },
    'thin instances': ({ mesh }) => mesh.thinInstanceAdd([Matrix.Identity(), ...PLACES]),
};

// What keeps a mesh standard, whatever this module does.
const STRANGERS = {
    'fewer influences': ({ mesh }) => (mesh.numBoneInfluencers = 2),
    processor: ({ mesh }) => (mesh.computeBonesUsingShaders = false),
    copied: ({ mesh }) => mesh.geometry.copy('copy').applyToMesh(mesh),
    'no skeleton': ({ mesh }) => (mesh.skeleton = null),
    crowded: ({ mesh, scene }) => {
        const caps = scene.getEngine().getCaps();
        const most = caps.maxVertexAttribs;
        caps.maxVertexAttribs = 5;
        mesh.material = new StandardMaterial('other', scene);
        return () => (caps.maxVertexAttribs = most);
    },
    'old engine': ({ mesh, scene }) => {
        const engine = scene.getEngine();
        Object.defineProperty(engine, 'version', { get: () => 1, configurable: true });
        mesh.material = new StandardMaterial('other', scene);
        return () => delete engine.version;
    },
    'baked animation': ({ mesh, scene }) => {
        const width = 4 * (mesh.skeleton.bones.length + 1);
        const floats = new Float32Array(4 * width);
        const texture = RawTexture.CreateRGBATexture(floats, width, 1, scene, false, false, 1, 1); // nearest, float
        mesh.bakedVertexAnimationManager = new BakedVertexAnimationManager(scene);
        mesh.bakedVertexAnimationManager.texture = texture;
    },
    'own shader': ({ mesh, scene }) => {
        const source = {
            vertexSource: `attribute vec3 position; attribute vec3 normal; varying vec3 vNormalW;
                void main(void) { vNormalW = normal; gl_Position = vec4(position, 1.0); }`,
            fragmentSource: `varying vec3 vNormalW; void main(void) { gl_FragColor = vec4(vNormalW, 1.0); }`,
        };
        const options = { attributes: ['position', 'normal'], uniforms: [] };
        mesh.material = new ShaderMaterial('own', scene, source, options);
    },
};

const STRANGERS_OF_WEBGPU = {
    crowded: ({ mesh, scene }) => {
        const engine = scene.getEngine();
        const limits = engine.currentLimits;
        engine._deviceLimits = { ...limitsOf(limits), maxVertexBuffers: 4 };
        mesh.material = new StandardMaterial('other', scene);
        return () => (engine._deviceLimits = limits);
    },
    'pulled vertices': ({ mesh, scene }) => {
        mesh.material = new StandardMaterial('other', scene);
        mesh.material.useVertexPulling = true;
    },
};

function limitsOf(limits) {
    const found = {};
    for (const name in limits) found[name] = limits[name];
    return found;
}

const NAMES = ['vTBN', 'vNormalW', 'gl_Position'];

const api = {
    backend: async (name) => (await engineOf(name)) && name,

    async normals({ lighting, bump = false, turned = false, varying = 'vNormalW', ...options }) {
        CAPTURE.names = varying === 'vNormalW' ? NAMES : [varying]; // of programs that are linked from now on
        const { scene, mesh } = await load(options);
        if (turned) new Turning(mesh.material);
        if (lighting) skinbake.lighting(scene, lighting);
        if (bump) addBump(scene, mesh);
        const names = options.backend === 'webgpu' ? ['vTBN0', 'vTBN1', 'vTBN2'] : ['vTBN'];
        const draws = [];
        for (const name of bump ? names : [varying]) draws.push(...(await draw(scene, name)));
        CAPTURE.names = NAMES;
        const report = told(scene);
        return { draws, report };
    },

    // The mapped normal in the pixel of each vertex, with one texel as normal map. By WebGL 2.
    async relief({ texel, ...options }) {
        const { scene, mesh } = await load(options);
        const count = mesh.getTotalVertices();
        addBump(scene, mesh, texel);
        if (mesh.material.anisotropy) mesh.material.anisotropy.isEnabled = true;
        mesh.material.backFaceCulling = false;
        mesh.material.pointsCloud = true;
        new Reading(mesh.material);
        const target = new RenderTargetTexture('relief', SIDE, scene, { generateMipMaps: false, type: 1 });
        target.clearColor = new Color4(0, 0, 0, 0);
        target.renderList = [mesh];
        scene.customRenderTargets.push(target);
        await ready(scene);
        for (let number = 0; number < 3; number++) frame(scene);
        const pixels = await target.readPixels();
        const normals = new Float32Array(3 * count);
        for (let vertex = 0; vertex < count; vertex++) normals.set(pixels.subarray(4 * vertex, 4 * vertex + 3), 3 * vertex);
        return { normals: base64(normals), report: told(scene) };
    },

    // The normals of each view in turn of one character, after a frame as it was and a change.
    async changed({ url, pose }) {
        const found = {};
        for (const [name, change] of Object.entries(CHANGES)) {
            const stage = await load({ url, pose });
            frame(stage.scene);
            change(stage);
            for (const mesh of skinned(stage.scene)) mesh.alwaysSelectAsActiveMesh = true;
            frame(stage.scene);
            found[name] = { draws: await draw(stage.scene), report: told(stage.scene.meshes.filter((one) => one.isEnabled())) };
        }
        return found;
    },

    // What is drawn and told after each change of the attributes.
    async altered(options) {
        const found = {};
        for (const [name, change] of Object.entries(ALTERED)) {
            const stage = await load(options);
            await ready(stage.scene);
            frame(stage.scene);
            change(stage);
            const draws = name === 'normals flattened' ? [] : await draw(stage.scene);
            frame(stage.scene);
            found[name] = { draws, report: told(stage.scene) };
        }
        return found;
    },

    // How often the normals are read back in frames in which a page writes them, while the mesh is switched, and what is
    // told of it when it is switched back.
    async written({ url, pose }) {
        const { scene, mesh } = await load({ url, pose });
        const normals = mesh.getVerticesData('normal').map((one) => -one);
        mesh.setVerticesData('normal', mesh.getVerticesData('normal').slice(), true);
        await ready(scene);
        frame(scene);
        skinbake.lighting(scene, 'standard');
        frame(scene);
        const { getVerticesData } = mesh.geometry;
        let count = 0;
        mesh.geometry.getVerticesData = function (...parameters) {
            count++;
            return getVerticesData.apply(this, parameters);
        };
        for (let time = 0; time < 3; time++) {
            mesh.updateVerticesData('normal', normals);
            frame(scene);
        }
        const read = count;
        skinbake.lighting(scene, 'accurate');
        await draw(scene);
        return { read, report: told(scene) };
    },

    // What is told of each root, and of a mesh that has been disposed of.
    async roots({ url }) {
        const { scene, mesh } = await load({ url });
        const container = await LoadAssetContainerAsync(url, scene, { pluginExtension: '.glb' });
        const entries = container.instantiateModelsToScene();
        await ready(scene);
        frame(scene);
        const found = {};
        for (const [name, rootOf] of Object.entries(ROOTS)) {
            try {
                found[name] = told(rootOf({ mesh, container, entries }));
            } catch (error) {
                found[name] = String(error);
            }
        }
        mesh.dispose();
        return { ...found, disposed: told([mesh]) };
    },

    // The normals in a texture that has a material of its own for the mesh, and on the canvas.
    async rendered({ url, pose }) {
        const { scene, mesh } = await load({ url, pose });
        const target = new RenderTargetTexture('target', 16, scene);
        target.renderList.push(mesh);
        scene.customRenderTargets.push(target);
        target.setMaterialForRendering(mesh, new StandardMaterial('other', scene));
        return draw(scene);
    },

    // The normals by either lighting, of materials that Babylon.js does not look at again.
    async switched({ url, pose, kind }) {
        const { scene, mesh } = await load({ url, pose });
        const found = {};
        await ready(scene);
        frame(scene);
        BLOCKS[kind]({ scene, mesh });
        for (const which of ['standard', 'accurate']) {
            skinbake.lighting(scene, which);
            found[which] = { before: told(scene), draws: await draw(scene), report: told(scene) };
        }
        return found;
    },

    // What is told of a switched mesh before its next frame, and after it.
    async early({ url, pose }) {
        const { scene } = await load({ url, pose });
        await ready(scene);
        frame(scene);
        skinbake.lighting(scene, 'standard');
        const before = told(scene);
        await draw(scene);
        return { before, after: told(scene) };
    },

    // A file that is loaded into a container and put into the scene twice.
    async instantiated({ url, pose }) {
        const scene = await stageOf({});
        const container = await LoadAssetContainerAsync(url, scene, { pluginExtension: '.glb' });
        for (let time = 0; time < 2; time++) {
            const entries = container.instantiateModelsToScene((name) => name, true, { doNotInstantiate: true });
            posed(entries, pose);
        }
        for (const mesh of skinned(scene)) mesh.alwaysSelectAsActiveMesh = true;
        const draws = await draw(scene);
        const report = told(scene);
        return { draws, report };
    },

    async many({ kind, ...options }) {
        const { scene, mesh } = await load(options);
        MANY[kind]({ scene, mesh });
        const draws = await draw(scene);
        const report = told(scene);
        return { draws, report, places: [Matrix.Identity(), ...PLACES].map((place) => [...place.asArray()]) };
    },

    async strangers({ url, pose, backend }) {
        const found = {};
        const changes = backend === 'webgpu' ? STRANGERS_OF_WEBGPU : STRANGERS;
        for (const [name, change] of Object.entries(changes)) {
            const stage = await load({ url, pose, backend });
            frame(stage.scene);
            stage.mesh.name = name;
            const undo = change(stage);
            await ready(stage.scene);
            frame(stage.scene);
            frame(stage.scene);
            found[name] = told(stage.scene);
            if (typeof undo === 'function') undo();
        }
        return found;
    },

    // What is told of a file, which may have several meshes.
    async reports(options) {
        const { scene } = await load(options);
        await ready(scene);
        frame(scene);
        frame(scene);
        return told(scene);
    },

    // What console.info has of a file.
    async information(options) {
        const said = [];
        const { info } = console;
        console.info = (line) => said.push(line);
        const { scene } = await load(options);
        await ready(scene);
        frame(scene);
        console.info = info;
        return said;
    },

    // A scene with a geometry buffer, as IblShadows and others make one.
    async buffered(options) {
        const { scene, mesh } = await load(options);
        mesh.name = 'buffered';
        scene.enableGeometryBufferRenderer();
        await ready(scene);
        for (let number = 0; number < 3; number++) frame(scene);
        const report = told(scene);
        scene.disableGeometryBufferRenderer();
        return report;
    },

    // What is reported of a merged mesh, drawn by the joints of its source.
    async merged({ isAsync, ...options }) {
        const { scene, mesh } = await load(options);
        const parts = [mesh.clone('part'), mesh.clone('another part')];
        const { skeleton } = mesh;
        const merged = isAsync ? await Mesh.MergeMeshesAsync(parts) : Mesh.MergeMeshes(parts);
        merged.name = 'merged';
        Object.assign(merged, { skeleton, material: mesh.material, alwaysSelectAsActiveMesh: true });
        await ready(scene);
        frame(scene);
        frame(scene);
        return told([merged]);
    },

    async loaded({ urls }) {
        for (const url of urls) await load({ url });
    },

    // Whether the vertex shader computes the light of an environment, which it does by the normal.
    async irradiance(options) {
        const { scene, mesh } = await load(options);
        mesh.material.twoSidedLighting = false; // else the fragment shader computes it
        const faces = Array.from({ length: 6 }, () => new Uint8Array([255, 255, 255, 255]));
        scene.environmentTexture = new RawCubeTexture(scene, faces, 1);
        scene.environmentTexture.sphericalPolynomial = new SphericalPolynomial();
        const draws = await draw(scene);
        const [{ text }] = CAPTURE.draws.filter(({ name }) => name === 'vNormalW');
        const report = told(scene);
        return { draws, report, inVertex: text.includes('vEnvironmentIrradiance=') };
    },

    // Where the draws into a shadow map put the vertices, in clip space.
    async shadows(options) {
        const { scene, mesh } = await load(options);
        const generator = new ShadowGenerator(64, scene.lights[0]);
        generator.addShadowCaster(mesh);
        const draws = await draw(scene, 'gl_Position');
        return draws;
    },
};

CAPTURE.names = NAMES;
Object.assign(window, api);
