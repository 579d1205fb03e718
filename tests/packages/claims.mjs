// Ask bake.js about a small file that claims much, and count what it reads. Print a JSON object by case: the reasons, and
// the reads of elements and of primitives. The first argument is the path of bake.js.

import { pathToFileURL } from 'node:url';

const { problemOf, staleOf } = await import(pathToFileURL(process.argv[2]));
const HUGE = 4e9;
let reads = 0;

// An array whose elements are counted as they are read.
function counted(array) {
    const get = (target, key) => {
        if (typeof key === 'string' && /^\d+$/.test(key)) reads++;
        const value = target[key];
        return typeof value === 'function' ? value.bind(target) : value;
    };
    return new Proxy(array, { get });
}

function file({ count = 3, corners = 3, sets = 1, bare = false, bound = [0, 0, 0] } = {}) {
    const positions = { componentType: 5126, joints: 1, min: bound, max: bound };
    const attributes = { POSITION: 0 };
    for (let set = 0; set < sets; set++) attributes[`JOINTS_${set}`] = 1;
    const skinbake = { version: 1, influences: 4 * sets, positions };
    const primitive = { attributes, extras: { skinbake }, ...(bare ? {} : { indices: 2 }) };
    const accessors = [{ componentType: 5126, count, min: bound, max: bound }, { count }, { count: corners }];
    return { accessors, meshes: [{ name: 'body', primitives: [primitive] }], nodes: [{ mesh: 0, skin: 0 }] };
}

// Many meshes, of which the first is stale; so are the others of its skin, and of the skins that share one with it.
function drawn(meshCount, primitiveCount, nodes) {
    const one = file().meshes[0].primitives[0];
    const stale = { ...one, extras: { skinbake: { version: 1, influences: 4, positions: { componentType: 1 } } } };
    const plain = { attributes: {} };
    const primitives = (first) => counted([first, ...new Array(primitiveCount - 1).fill(plain).map(() => ({ ...plain }))]);
    const meshes = Array.from({ length: meshCount }, (_, number) => {
        return { name: `mesh ${number}`, primitives: primitives(number ? { ...plain } : stale) };
    });
    return { accessors: file().accessors, meshes, nodes };
}

function asked(gltf, indices = 3) {
    const arrays = new Map([[1, counted(new Uint16Array(12))], [2, counted(new Uint16Array(indices))]]);
    reads = 0;
    const found = [...staleOf(gltf, arrays).values()];
    return { stale: found.length, first: found[0] ?? '', reads };
}

const manySkins = Array.from({ length: 60_000 }, (_, skin) => ({ mesh: 0, skin }));
const manyNodes = Array.from({ length: 60_000 }, () => ({ mesh: 0, skin: 0 }));
const chain = Array.from({ length: 60_000 }, (_, node) => ({ mesh: (node + 1) >> 1 & 1023, skin: node >> 1 }));
const names = counted(new Array(50_000).fill('_A'));
const metadata = { version: 1, frame: 'normal', influences: 4, alpha: names, beta: names };
reads = 0;
const damaged = problemOf(metadata, (name) => (name === 'POSITION' ? { count: 3 } : undefined), 'three.js', 4);
const ofNames = { stale: 0, first: damaged, reads };

console.log(JSON.stringify({
    sound: asked(file()),
    vertices: asked(file({ count: HUGE })),
    'vertices without indices': asked(file({ count: HUGE, bare: true })),
    corners: asked(file({ corners: HUGE })),
    sets: asked(file({ sets: 10_000 })),
    bounds: asked(file({ bound: new Array(200_000).fill(0) })),
    'many nodes': asked(drawn(1, 2_000, manyNodes)),
    'many skins': asked(drawn(1, 2_000, manySkins)),
    'a chain of skins': asked(drawn(1024, 3, chain)),
    names: ofNames,
}));
