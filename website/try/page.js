/* Takes files, hands them to the worker that runs skinbake, and shows what comes back. */

const [form, drop, choose, example, lighting, encoding, save, state, same, command, said] = [
  ...['form', 'drop', 'choose', 'example', 'lighting', 'encoding', 'save', 'state', 'same', 'command', 'said'],
].map((id) => document.getElementById(id));
const runtime = new URL(document.querySelector('meta[name=runtime]').content, location.href).href;

// A worker of a blob keeps to the policy of this page. One of an address would keep to none.
const start = new Blob([`import ${JSON.stringify(new URL('worker.js', location.href).href)};`], { type: 'text/javascript' });
const worker = new Worker(URL.createObjectURL(start), { type: 'module' });
worker.postMessage({ runtime });
let last = null; // the files that were taken last
let view = document.getElementById('view'); // a frame for each picture: one that is hidden and shown again may stay blank
let shown = ''; // the page of `skinbake view`, which the frame asks for
addEventListener('message', ({ source }) => { if (source === view.contentWindow) source.postMessage(shown, '*'); });

const hear = {
  state: ({ text }) => { state.textContent = text; },
  said: ({ text }) => { said.hidden = false; said.textContent += text; },
  baked: ({ name, bytes }) => {
    URL.revokeObjectURL(save.href);
    save.href = URL.createObjectURL(new Blob([bytes], { type: 'model/gltf-binary' }));
    Object.assign(save, { hidden: false, download: name, textContent: `Save ${name} (${(bytes.length / 1e6).toFixed(2)} MB)` });
  },
  picture: ({ page }) => {
    shown = page;
    view.replaceWith(view = Object.assign(view.cloneNode(), { hidden: false, src: 'frame.html' }));
  },
};
window.ready = new Promise((resolve, reject) => {
  hear.ready = resolve;
  worker.onerror = ({ message }) => {
    state.textContent = `Python could not be started: ${message || 'a file could not be loaded'}`;
    reject(new Error(message));
  };
});
worker.onmessage = ({ data }) => hear[data.kind](data);

function bake() {
  if (last === null) return;
  const options = [lighting.value, encoding.value].filter(Boolean).flatMap((option) => option.split(' '));
  const model = last.find(({ name }) => /\.(glb|gltf|vrm)$/i.test(name))?.name ?? last[0]?.name ?? 'arm.glb';
  const output = `${model.split('/').pop().replace(/\.\w+$/, '')}-baked.${/\.vrm$/i.test(model) ? 'vrm' : 'glb'}`;
  const quoted = (word) => (/^[\w./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);
  command.textContent = ['skinbake', 'bake', model, '-o', output, ...options].map(quoted).join(' ');
  same.hidden = false;
  save.hidden = true;
  view.hidden = true;
  said.textContent = '';
  state.textContent = 'It waits for Python …';
  worker.postMessage({ files: last, model, output, options });
}

async function take(files) {
  last = await Promise.all(files.map(async ([name, file]) => ({ name, bytes: new Uint8Array(await file.arrayBuffer()) })));
  bake();
}

/* The files of a dropped file or folder, each with its path in what was dropped. */
async function filesOf(entry, folder = '') {
  if (entry.isFile) return [[folder + entry.name, await new Promise((found, failed) => entry.file(found, failed))]];
  const reader = entry.createReader(), found = [];
  for (let part = [null]; part.length; found.push(...part)) part = await new Promise((...both) => reader.readEntries(...both));
  return (await Promise.all(found.map((inner) => filesOf(inner, `${folder}${entry.name}/`)))).flat();
}

choose.onchange = () => take([...choose.files].map((file) => [file.name, file]));
example.onclick = () => take([]);
form.onsubmit = (event) => event.preventDefault();
lighting.onchange = encoding.onchange = bake;
document.ondragover = (event) => { event.preventDefault(); drop.classList.add('over'); };
document.ondragleave = () => drop.classList.remove('over');
document.ondrop = async (event) => {
  event.preventDefault();
  drop.classList.remove('over');
  const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
  const files = [...event.dataTransfer.files].map((file) => [file.name, file]);
  take(entries.length ? (await Promise.all(entries.map((entry) => filesOf(entry)))).flat() : files);
};
