// Read a GLB without images by three.js, and write it again by its GLTFExporter: node three_copy.mjs SOURCE TARGET

import { readFileSync, writeFileSync } from 'node:fs';

// What browsers have, and the loader and the exporter ask for.
globalThis.self = globalThis;
globalThis.FileReader = class {
    readAsArrayBuffer(blob) {
        blob.arrayBuffer().then((result) => {
            this.result = result;
            this.onloadend();
        });
    }
};
const { GLTFLoader } = await import('three/addons/loaders/GLTFLoader.js');
const { GLTFExporter } = await import('three/addons/exporters/GLTFExporter.js');

const [source, target] = process.argv.slice(2);
const bytes = readFileSync(source);
const content = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
const { scene, animations } = await new GLTFLoader().parseAsync(content, '');
const written = await new GLTFExporter().parseAsync(scene, { binary: true, animations, trs: true });
writeFileSync(target, Buffer.from(written));
