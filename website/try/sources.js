/* The files of others that the page loads, by their paths at the CDN, and their digests. */

export const PYODIDE = 'npm/pyodide@0.27.7/';
export const NUMPY = 'pyodide/v0.27.7/full/numpy-2.0.2-cp312-cp312-pyodide_2024_0_wasm32.whl';

export const FILES = {
  'npm/pyodide@0.27.7/pyodide.mjs': 'sha256-BMBSyBWrsL8pgfo4wt+ljjEg7lKIyVbfKyoV4wF4LF8=',
  'npm/pyodide@0.27.7/pyodide.asm.js': 'sha256-a0yQ3ltxcoc/BPIYhNDp0idOMF/jIRZVj+Pk++NhjVE=',
  'npm/pyodide@0.27.7/pyodide.asm.wasm': 'sha256-pQ3RhD+AWgt8RbYQN+4Neybf6F7+DhjvlaNK0k5AH18=',
  'npm/pyodide@0.27.7/pyodide-lock.json': 'sha256-nEW5FgAadQ9BAvwodJTz6rIVkJx1NcYmog24D9YzPiw=',
  'npm/pyodide@0.27.7/python_stdlib.zip': 'sha256-FmEVNHJuXYrCvY+SZBCy3LjW9JqiSRNGNTO0V6IRXBY=',
  'pyodide/v0.27.7/full/numpy-2.0.2-cp312-cp312-pyodide_2024_0_wasm32.whl': 'sha256-67YSQdliuYshWX185DtnZoptW6s6zsT76VhlcyDXzQg=',
  'npm/meshoptimizer@1.2.0/meshopt_decoder.mjs': 'sha256-ywi/U62K2Wk9i7dZstut41DrOLzOY9AFOF4iW1ZMX2o=',
  'npm/meshoptimizer@1.2.0/meshopt_encoder.js': 'sha256-+C8gGneDMykbocpjA1Mh8cbSdw71LSGeaeE/bLIJhCk=',
  'npm/draco3dgltf@1.5.7/draco_decoder_gltf_nodejs.js': 'sha256-i7KVLSun1n4UFPjfgZQQywQ0pma+U/Zx//dfaIQ9dvY=',
  'npm/draco3dgltf@1.5.7/draco_decoder_gltf.wasm': 'sha256-cS2zRJriBB1uiiJMOVvabO20nlEyL644t9ub64s4GIk=',
  'npm/draco3dgltf@1.5.7/draco_encoder_gltf_nodejs.js': 'sha256-hDSt7NFEZFlgF2Pkmb42l1RgVrypCyhqU4rgSDoAhFo=',
  'npm/draco3dgltf@1.5.7/draco_encoder.wasm': 'sha256-0qOsgMkZgNXTIcEWRUg0/zYmSCXG0XlMyE5CKI8ViVg=',
};
