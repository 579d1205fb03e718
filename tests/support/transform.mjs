// Apply functions of glTF-Transform to glTF files, many in one process: its command line takes a second to start.
//
// stdin: one JSON object a line: {"source", "target", "command"}. A command is a key of COMMANDS.
// stdout: one JSON line an object, in the same order: {} or {"failure": "..."}.

import { createInterface } from 'node:readline';
import { Logger, NodeIO } from '@gltf-transform/core';
import { ALL_EXTENSIONS } from '@gltf-transform/extensions';
import * as functions from '@gltf-transform/functions';
import draco3d from 'draco3dgltf';
import { MeshoptDecoder, MeshoptEncoder, MeshoptSimplifier } from 'meshoptimizer';
import { generateTangents } from 'mikktspace';

const KEPT = { keepAttributes: true, keepExtras: true, keepLeaves: true };

function eachPrimitive(edit) {
    return (document) => {
        for (const mesh of document.getRoot().listMeshes()) {
            mesh.listPrimitives().forEach(edit);
        }
    };
}

const COMMANDS = {
    copy: () => [],
    center: () => [functions.center()],
    dedup: () => [functions.dedup()],
    dequantize: () => [functions.dequantize()],
    draco: () => [functions.draco()],
    dracoSequential: () => [functions.draco({ method: 'sequential' })],
    flatten: () => [functions.flatten()],
    instance: () => [functions.instance()],
    join: () => [functions.join()],
    metalrough: () => [functions.metalRough()],
    meshopt: () => [functions.meshopt({ encoder: MeshoptEncoder })],
    normals: () => [functions.normals()],
    palette: () => [functions.palette()],
    prune: () => [functions.prune(KEPT)],
    quantize: () => [functions.quantize()],
    reorder: () => [functions.reorder({ encoder: MeshoptEncoder })],
    resample: () => [functions.resample()],
    simplify: () => [functions.simplify({ simplifier: MeshoptSimplifier, ratio: 0.5, error: 0.01 })],
    sortWeights: () => [eachPrimitive((primitive) => functions.sortPrimitiveWeights(primitive, 4))],
    sparse: () => [functions.sparse({ ratio: 0.8 })],
    tangents: () => [functions.tangents({ generateTangents })],
    unlit: () => [functions.unlit()],
    unpartition: () => [functions.unpartition()],
    unweld: () => [functions.unweld()],
    vertexColorSpace: () => [functions.vertexColorSpace({ inputEncoding: 'srgb' })],
    weld: () => [functions.weld()],
};

async function transform({ source, target, command }) {
    const document = await io.read(source);
    document.setLogger(new Logger(Logger.Verbosity.SILENT));
    await document.transform(...COMMANDS[command]());
    await io.write(target, document);
}

await Promise.all([MeshoptDecoder.ready, MeshoptEncoder.ready, MeshoptSimplifier.ready]);
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({
    'draco3d.decoder': await draco3d.createDecoderModule(),
    'draco3d.encoder': await draco3d.createEncoderModule(),
    'meshopt.decoder': MeshoptDecoder,
    'meshopt.encoder': MeshoptEncoder,
});
io.setLogger(new Logger(Logger.Verbosity.SILENT));
for await (const line of createInterface({ input: process.stdin })) {
    let answer = {};
    try {
        await transform(JSON.parse(line));
    } catch (reason) {
        answer = { failure: String(reason) };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
}
