// Decode the compressed geometry of glTF files with the reference decoders: draco3dgltf and meshoptimizer.
//
// stdin: one JSON string a line, the path of a .glb, .gltf or .vrm file.
// stdout: one JSON line a file, in the same order:
// {"views": {index: base64}, "primitives": [{"mesh", "primitive", "attributes": {name: base64}, "indices": base64}]}
// with attributes in the component type that their accessor declares and indices as 32 bit integers, or
// {"failure": "..."}.

import { readFile } from 'node:fs/promises';
import { dirname, resolve } from 'node:path';
import { createInterface } from 'node:readline';
import draco3d from 'draco3dgltf';
import { MeshoptDecoder } from 'meshoptimizer';

const MESHOPT = ['EXT_meshopt_compression', 'KHR_meshopt_compression'];
const DRACO = 'KHR_draco_mesh_compression';
const decoderModule = await draco3d.createDecoderModule();
const TYPES = {
    5120: [decoderModule.DT_INT8, 1],
    5121: [decoderModule.DT_UINT8, 1],
    5122: [decoderModule.DT_INT16, 2],
    5123: [decoderModule.DT_UINT16, 2],
    5125: [decoderModule.DT_UINT32, 4],
    5126: [decoderModule.DT_FLOAT32, 4],
};

async function parse(path) {
    const data = await readFile(path);
    if (data.toString('latin1', 0, 4) !== 'glTF') {
        return [JSON.parse(data.toString('utf8')), undefined];
    }
    const length = data.readUInt32LE(12);
    const json = JSON.parse(data.toString('utf8', 20, 20 + length));
    return [json, data.subarray(20 + length + 8)];
}

async function bytesOf(path, json, binary, holder) {
    const { uri } = json.buffers[holder.buffer];
    let data = binary;
    if (uri !== undefined) {
        data = uri.startsWith('data:')
            ? Buffer.from(uri.slice(uri.indexOf(',') + 1), 'base64')
            : await readFile(resolve(dirname(path), decodeURIComponent(uri)));
    }
    const start = holder.byteOffset ?? 0;
    return data.subarray(start, start + holder.byteLength);
}

function heapArray(size, fill) {
    const pointer = decoderModule._malloc(size);
    try {
        if (!fill(pointer)) {
            throw new Error('Draco cannot give it in the type that the accessor declares');
        }
        return Buffer.from(new Uint8Array(decoderModule.HEAPF32.buffer, pointer, size).slice());
    } finally {
        decoderModule._free(pointer);
    }
}

function decodeDraco(json, primitive, data) {
    const decoder = new decoderModule.Decoder();
    const mesh = new decoderModule.Mesh();
    if (!decoder.DecodeArrayToMesh(data, data.length, mesh).ok()) {
        throw new Error('Draco cannot decode it');
    }
    const attributes = {};
    for (const [name, id] of Object.entries(primitive.extensions[DRACO].attributes)) {
        const accessor = json.accessors[primitive.attributes[name]];
        const [type, bytes] = TYPES[accessor.componentType];
        const attribute = decoder.GetAttributeByUniqueId(mesh, id);
        const size = mesh.num_points() * attribute.num_components() * bytes;
        attributes[name] = heapArray(size, (pointer) =>
            decoder.GetAttributeDataArrayForAllPoints(mesh, attribute, type, size, pointer),
        ).toString('base64');
    }
    const size = mesh.num_faces() * 3 * 4;
    const indices = heapArray(size, (pointer) => decoder.GetTrianglesUInt32Array(mesh, size, pointer));
    return { attributes, indices: indices.toString('base64') };
}

async function decompress(path) {
    const [json, binary] = await parse(path);
    const views = {};
    for (const [index, view] of (json.bufferViews ?? []).entries()) {
        const name = MESHOPT.find((extension) => view.extensions?.[extension] !== undefined);
        if (name !== undefined) {
            const packed = view.extensions[name];
            const result = new Uint8Array(packed.count * packed.byteStride);
            const source = await bytesOf(path, json, binary, packed);
            MeshoptDecoder.decodeGltfBuffer(result, packed.count, packed.byteStride, source, packed.mode, packed.filter);
            views[index] = Buffer.from(result).toString('base64');
        }
    }
    const primitives = [];
    for (const [mesh, entry] of (json.meshes ?? []).entries()) {
        for (const [number, primitive] of entry.primitives.entries()) {
            const extension = primitive.extensions?.[DRACO];
            if (extension !== undefined) {
                const data = await bytesOf(path, json, binary, json.bufferViews[extension.bufferView]);
                primitives.push({ mesh, primitive: number, ...decodeDraco(json, primitive, data) });
            }
        }
    }
    return { views, primitives };
}

await MeshoptDecoder.ready;
for await (const line of createInterface({ input: process.stdin })) {
    let answer;
    try {
        answer = await decompress(JSON.parse(line));
    } catch (reason) {
        answer = { failure: String(reason) };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
}
