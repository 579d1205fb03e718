// Tidy the models of art/ by glTF-Transform, then bake and verify them. skinbake comes last.

import { execFileSync } from 'node:child_process';
import { mkdirSync, readdirSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { NodeIO } from '@gltf-transform/core';
import { ALL_EXTENSIONS } from '@gltf-transform/extensions';
import { dedup, prune, resample } from '@gltf-transform/functions';

const io = new NodeIO().registerExtensions(ALL_EXTENSIONS);
const models = readdirSync('art', { recursive: true }).filter((name) => /\.(glb|gltf)$/.test(name));

for (const name of models) {
    const document = await io.read(join('art', name));
    // Add what you use: simplify, weld, textureCompress … Leave out quantize, draco and meshopt, because skinbake compresses.
    await document.transform(dedup(), resample(), prune({ keepAttributes: true }));
    const tidied = join('tidied', name);
    mkdirSync(dirname(tidied), { recursive: true });
    await io.write(tidied, document);
}

function skinbake(...options) {
    try {
        execFileSync('skinbake', options, { stdio: 'inherit' });
    } catch ({ message, status }) {
        if (status == null) console.error(message); // skinbake did not start; else it has said what is wrong
        process.exit(status ?? 1);
    }
}

skinbake('bake', 'tidied', '--out-dir', 'build/models', '--skip-unchanged');
skinbake('verify', 'build/models', '--require-baked', '--skip-unchanged', '--state', 'build/verified.jsonl');
