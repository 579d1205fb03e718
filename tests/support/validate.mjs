// Run the Khronos glTF validator over many files in one process.
//
// stdin: one JSON string a line, the path of a .glb, .gltf or .vrm file.
// stdout: one JSON line a file, in the same order: {"issues": [[severity, code, pointer], ...]}, or
// {"failure": "..."} where the validator could not recognise the file.

import { readFile } from 'node:fs/promises';
import { dirname, resolve } from 'node:path';
import { createInterface } from 'node:readline';
import validator from 'gltf-validator';

const SEVERITIES = ['error', 'warning', 'info', 'hint'];

// URIs in glTF are percent-encoded; what is not decodable is tried as it stands.
function resourcePath(asset, uri) {
    let name = uri;
    try {
        name = decodeURIComponent(uri);
    } catch {
        // keep the raw name
    }
    return resolve(dirname(asset), name);
}

async function validate(path) {
    const report = await validator.validateBytes(new Uint8Array(await readFile(path)), {
        uri: path,
        maxIssues: 0,
        writeTimestamp: false,
        externalResourceFunction: async (uri) => new Uint8Array(await readFile(resourcePath(path, uri))),
    });
    return report.issues.messages.map((m) => [SEVERITIES[m.severity], m.code, m.pointer ?? '']);
}

for await (const line of createInterface({ input: process.stdin })) {
    let answer;
    try {
        answer = { issues: await validate(JSON.parse(line)) };
    } catch (reason) {
        answer = { failure: String(reason) };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
}
