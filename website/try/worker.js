/* Runs skinbake by Pyodide. Files come from the page and go back to it. */

import { dracoCodec } from './draco.js';
import { FILES, NUMPY, PYODIDE } from './sources.js';

let runtime, python, draco;
const say = (text) => postMessage({ kind: 'state', text });

// Whatever is loaded is one of the listed files and has its digest. Pyodide loads its own files by fetch too.
const fetchAny = self.fetch;
self.fetch = async (address, options) => {
  const name = String(address.url ?? address).replace(runtime, '');
  if (!(name in FILES)) throw new TypeError(`${name} is not a file of this page`);
  return fetchAny(runtime + name, { ...options, integrity: FILES[name] });
};
const bytesOf = async (name) => (await fetch(runtime + name)).arrayBuffer();

/* Import a script after its digest was checked. Old scripts export nothing: `exported` names what they define. */
async function imported(name, exported) {
  const end = exported ? `\nexport default ${exported};` : '';
  const script = new Blob([await bytesOf(name), end], { type: 'text/javascript' });
  return import(URL.createObjectURL(script));
}

async function started() {
  const own = fetchAny(new URL('skinbake.zip', import.meta.url)).then((answer) => answer.arrayBuffer());
  const numpy = bytesOf(NUMPY);
  const [{ loadPyodide }, { MeshoptDecoder }, { MeshoptEncoder }] = await Promise.all(
    Object.keys(FILES).filter((name) => /pyodide\.mjs|meshopt_/.test(name)).map((name) => imported(name)),
  );
  await Promise.all([MeshoptDecoder.ready, MeshoptEncoder.ready, imported(`${PYODIDE}pyodide.asm.js`)]);
  say('Python starts …');
  const found = await loadPyodide({ indexURL: runtime + PYODIDE });
  const site = found.runPython('import sysconfig; sysconfig.get_path("purelib")');
  found.unpackArchive(await numpy, 'wheel', { extractDir: site });
  found.unpackArchive(await own, 'zip', { extractDir: site });
  found.registerJsModule('page_codecs', { decoder: MeshoptDecoder, encoder: MeshoptEncoder, draco: () => draco, fromEntries: Object.fromEntries });
  const words = new TextDecoder();
  const write = (bytes) => { postMessage({ kind: 'said', text: words.decode(bytes, { stream: true }) }); return bytes.length; };
  found.setStdout({ write });
  found.setStderr({ write });
  say('skinbake is being imported …');
  return found.pyimport('in_browser');
}

async function work({ files, model, output, options }) {
  const skinbake = await python;
  const isDraco = files.some(({ bytes }) => new TextDecoder('latin1').decode(bytes).includes('KHR_draco_mesh_compression'));
  if (isDraco && !draco) draco = await dracoCodec(imported, bytesOf);
  say('It bakes …');
  const made = (name) => { const proxy = skinbake.taken(name), bytes = proxy.toJs(); proxy.destroy(); return bytes; };
  skinbake.put(files);
  if (files.length === 0) skinbake.run('example', '-o', model, '--quiet');
  let code = skinbake.run('bake', model, '-o', output, ...options);
  if (code === 0) {
    postMessage({ kind: 'baked', name: output, bytes: made(output) });
    say('It draws …');
    code = skinbake.run('view', output, '-o', 'page.html', '--quiet');
  }
  if (code === 0) {
    postMessage({ kind: 'picture', page: new TextDecoder().decode(made('page.html')) });
    say('It measures …');
    code = skinbake.run('verify', output);
  }
  say(code === 0 ? 'Done.' : 'It ended with an error.');
}

let before = null; // one after the other
onmessage = ({ data }) => {
  if (data.runtime) {
    runtime = data.runtime;
    before = python = started();
    python.then(async (skinbake) => {
      say('Ready: give it a file.');
      postMessage({ kind: 'ready' });
      do await new Promise((next) => setTimeout(next)); // a file goes first
      while (skinbake.prepare());
    });
  } else {
    before = before.then(() => work(data)).catch((error) => say(`Python ended: ${error.message}`));
  }
};
