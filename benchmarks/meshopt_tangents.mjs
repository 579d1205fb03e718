// Time meshoptimizer's tangents on the mesh that our_gradients.py reads: WebAssembly, one thread.
//
// Usage: node meshopt_tangents.mjs MODULE MESH REPEATS
//
// MODULE is meshoptimizer's index.js. Prints the seconds of each repeat, one a line, after one that does not
// count. Normals point up and texture coordinates are x and z: the mesh is a grid over that plane.
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [module, mesh, repeats] = process.argv.slice(2);
const { MeshoptTangents } = await import(pathToFileURL(module).href);
await MeshoptTangents.ready;

const { buffer } = new Uint8Array(readFileSync(mesh));
const [vertices, triangles] = [...new BigInt64Array(buffer, 0, 2)].map(Number);
const positions = new Float32Array(buffer, 16, 3 * vertices);
const indices = new Uint32Array(buffer, 16 + 12 * vertices, 3 * triangles);
const normals = Float32Array.from({ length: 3 * vertices }, (_, n) => (n % 3 === 1 ? 1 : 0));
const coordinates = new Float32Array(2 * vertices);
for (let n = 0; n < vertices; n++) coordinates.set([positions[3 * n], positions[3 * n + 2]], 2 * n);

const generate = () => MeshoptTangents.generateTangents(indices, positions, 3, normals, 3, coordinates, 2);
generate();
for (let n = 0; n < Number(repeats); n++) {
  const start = performance.now();
  const found = generate();
  console.log(((performance.now() - start) / 1e3).toFixed(6));
  if (found.length !== 4 * indices.length) throw new Error(`${found.length} numbers for ${indices.length} corners`);
}
