"""The page that bakes in the browser: Pyodide and the codecs from a folder beside it, in Chromium."""

from __future__ import annotations

import base64
import functools
import hashlib
import http.server
import importlib.util
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from tests.support import browser
from tests.support.command_line import invoke
from tests.support.compressed import draco_twin, meshopt_twin
from tests.support.corpus_folder import REPOSITORY
from tests.support.models import FOLDER
from tests.support.node import package_folder, require_node
from tests.support.strictness import missing_tool
from website.build import put_trial

SOURCES = (REPOSITORY / "website" / "try" / "sources.js").read_text("utf-8")
FILES = dict(re.findall(r"'(\S+/\S+)': 'sha256-(\S+)'", SOURCES))
"""The digests of the files of others, by their paths at the CDN."""

NEWEST = Path(__file__).parents[1] / "support" / "other_versions" / "node_modules" / "pyodide-newest"
ARM = REPOSITORY / "src" / "skinbake" / "example" / "arm.glb"
TUBE = FOLDER / "bent_tube.glb"


def source_of(name: str) -> Path:
    """Return where a file of the CDN is on this machine."""
    kind, _, rest = name.partition("/")
    if kind == "npm":
        package, _, file = rest.partition("/")
        return package_folder(package.partition("@")[0]) / file
    return REPOSITORY.parent / "shared" / "wasm" / Path(rest).name


def require_runtime() -> None:
    """Skip where the runtime is not here. numpy for Pyodide is on no registry: it is data, not a tool."""
    require_node("pyodide", "meshoptimizer", "draco3dgltf")
    for name in FILES:
        if not source_of(name).is_file():
            pytest.skip(f"{Path(name).name} is not here: no registry has it")
    if importlib.util.find_spec("ziglang") is None:
        missing_tool("ziglang is not installed: pip install 'skinbake[browser]'")


@pytest.mark.parametrize("name", FILES)
def test_the_digests_are_those_of_the_files_that_the_tests_run(name: str) -> None:
    require_node("pyodide", "meshoptimizer", "draco3dgltf")
    if not source_of(name).is_file():
        pytest.skip("no registry has it")
    digest = hashlib.sha256(source_of(name).read_bytes()).digest()
    assert base64.b64encode(digest).decode() == FILES[name]


CHROMIUMS_OWN = re.compile(r"^(http://)?[\w-]+\.(google|googleapis)\.com[:/]")
"""What the browser itself asks for, such as updates. The policy of the page names no such host."""


class _Everything(http.server.SimpleHTTPRequestHandler):
    """The browser's proxy for all addresses. It serves the page, notes each request, and sends none on."""

    extensions_map = {  # noqa: RUF012 - as the base class has it
        ".html": "text/html",
        ".css": "text/css",
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
        "": "application/octet-stream",
    }

    def __init__(
        self, *arguments: Any, seen: list[tuple[str, str, str]], folder: Path, **options: Any
    ) -> None:
        self._seen, self._folder = seen, folder
        super().__init__(*arguments, **options)

    def do_GET(self) -> None:
        self._note()
        if urlsplit(self.path).path == "/":
            data = b"<link rel=icon href=data:,><script>window.ready = Promise.resolve();</script>"
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)
        else:
            super().do_GET()

    def do_POST(self) -> None:
        self._note()
        self.send_error(502)

    def do_CONNECT(self) -> None:  # for https
        self.do_POST()

    def _note(self) -> None:
        self._seen.append((self.command, self.path, self.headers.get("Content-Length", "")))

    def translate_path(self, path: str) -> str:
        first, _, rest = urlsplit(path).path.lstrip("/").partition("/")
        if first == "try" and rest.startswith("runtime/"):
            return str(source_of(rest.removeprefix("runtime/")))
        return str(self._folder / rest)

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


class Trial:
    """The page, open in the browser, and all requests of that browser so far."""

    def __init__(self, page: browser.Page, seen: list[tuple[str, str, str]]) -> None:
        self.page, self.seen = page, seen

    def bake(self, *paths: Path, lighting: str = "", encoding: str = "") -> dict[str, Any]:
        """Drop files on the page, and wait until it has ended. The result has the saved file's bytes."""
        held = [[path.name, base64.b64encode(path.read_bytes()).decode()] for path in paths]
        found: dict[str, Any] = self.page.call(BAKE, held, lighting, encoding)
        found["bytes"] = base64.b64decode(found["bytes"])
        return found


BAKE = """(async (held, lighting, encoding) => {
    const element = (id) => document.getElementById(id);
    element('lighting').value = lighting;
    element('encoding').value = encoding;
    const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const given = new DataTransfer();
    for (const [name, text] of held) given.items.add(new File([bytes(text)], name));
    let saved = new Blob([]);
    element('state').textContent = ''; // what is left there tells of the file before
    const made = URL.createObjectURL;
    URL.createObjectURL = (blob) => { saved = blob; return made.call(URL, blob); };
    if (held.length) document.dispatchEvent(new DragEvent('drop', { dataTransfer: given }));
    else element('example').click();
    do await new Promise((next) => setTimeout(next, 30));
    while (!/^(Done|It ended|Python ended)/.test(element('state').textContent));
    URL.createObjectURL = made;
    let letters = '';
    for (const byte of new Uint8Array(await saved.arrayBuffer())) letters += String.fromCharCode(byte);
    const text = (id) => element(id).textContent;
    return { bytes: btoa(letters), state: text('state'), said: text('said'), command: text('command'),
        saves: !element('save').hidden, shows: !element('view').hidden };
})"""


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    require_runtime()
    folder, scratch = tmp_path_factory.mktemp("try"), tmp_path_factory.mktemp("profile")
    put_trial(folder)
    index = folder / "index.html"
    text = index.read_text("utf-8")
    setting = 'name="runtime" content="https://cdn.jsdelivr.net/"'
    assert setting in text
    index.write_text(text.replace(setting, 'name="runtime" content="runtime/"'), "utf-8")
    seen: list[tuple[str, str, str]] = []
    handler = functools.partial(_Everything, seen=seen, folder=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"127.0.0.1:{server.server_address[1]}"
        through = [f"--proxy-server={address}", "--proxy-bypass-list=<-loopback>"]
        with browser.opened("", {}, scratch, through) as page:
            page.go(f"http://{address}/try/index.html")
            yield Trial(page, seen)
        server.shutdown()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "options"),
    [
        (TUBE, {}),
        (TUBE, {"encoding": "packed8"}),
        (ARM, {"correctives": "auto"}),
        (FOLDER / "characters" / "barbarian_walking.glb", {"correctives": "auto", "encoding": "snorm16"}),
    ],
)
def test_the_page_bakes_the_bytes_of_the_command_line(
    source: Path, options: dict[str, str], trial: Trial, tmp_path: Path
) -> None:
    words = {name: f"--{name} {value}" for name, value in options.items()}
    found = trial.bake(source, lighting=words.get("correctives", ""), encoding=words.get("encoding", ""))
    assert found["state"] == "Done."
    target = tmp_path / "expected.glb"
    flat = " ".join(words.values()).split()
    assert invoke("bake", source, "-o", target, *flat).exit_code == 0
    assert hashlib.sha256(found["bytes"]).digest() == hashlib.sha256(target.read_bytes()).digest()
    named = " ".join([f"skinbake bake {source.name} -o {source.stem}-baked.glb", *flat])
    assert found["command"] == named
    assert f"{source.stem}-baked.glb: passed" in found["said"]


@pytest.mark.slow
def test_the_example_is_baked_and_its_picture_shown(trial: Trial) -> None:
    trial.page.show_as(1000, 1400, "light")
    found = trial.bake()
    assert (found["state"], found["saves"], found["shows"]) == ("Done.", True, True)
    assert found["command"] == "skinbake bake arm.glb -o arm-baked.glb"
    # The frame has another origin and cannot be asked: what it draws is looked at.
    box = trial.page.call(
        "(() => { const { x, y, width, height } = document.getElementById('view').getBoundingClientRect();"
        " return [x, y + scrollY, x + width, y + scrollY + height]; })"
    )
    colours: set[bytes] = set()
    for _ in range(120):  # the frame draws when it likes, in a process of its own
        time.sleep(0.5)
        shot = Image.open(BytesIO(trial.page.screenshot())).convert("RGB").crop(box)
        colours = {bytes(colour) for colour in np.asarray(shot).reshape(-1, 3)}
        if len(colours) > 500:
            break
    # A shaded surface, and not a blank frame or words alone.
    assert len(colours) > 500, trial.page.messages()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["meshopt", "draco"])
def test_compressed_files_stay_compressed_and_verify(name: str, trial: Trial, tmp_path: Path) -> None:
    source = tmp_path / "twin.glb"
    (meshopt_twin if name == "meshopt" else draco_twin)(FOLDER / "foreign_joints.glb", source)
    found = trial.bake(source)
    assert found["state"] == "Done.", found["said"]
    baked = tmp_path / "twin-baked.glb"
    baked.write_bytes(found["bytes"])
    assert f"_{name}" in found["bytes"].decode("latin1").lower()  # the name of the extension
    assert invoke("verify", baked).exit_code == 0
    if name == "meshopt":
        assert invoke("bake", source, "-o", tmp_path / "expected.glb").exit_code == 0
        assert found["bytes"] == (tmp_path / "expected.glb").read_bytes()


@pytest.mark.slow
def test_a_gltf_comes_with_its_files(trial: Trial, tmp_path: Path) -> None:
    parts = FOLDER / "shared_accessors.gltf", FOLDER / "shared accessors.bin"
    found = trial.bake(*parts)
    assert found["state"] == "Done.", found["said"]
    assert found["command"] == "skinbake bake shared_accessors.gltf -o shared_accessors-baked.glb"
    assert invoke("bake", parts[0], "-o", tmp_path / "expected.glb").exit_code == 0
    assert found["bytes"] == (tmp_path / "expected.glb").read_bytes()


@pytest.mark.slow
def test_errors_are_those_of_skinbake(trial: Trial, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.glb"
    damaged.write_bytes(TUBE.read_bytes()[:500])
    found = trial.bake(damaged)
    assert (found["state"], found["saves"], found["shows"]) == ("It ended with an error.", False, False)
    result = invoke("bake", damaged, "-o", tmp_path / "out.glb")
    assert found["said"].strip() == result.stderr.replace(f"{tmp_path}/", "").strip()
    assert trial.bake(TUBE)["state"] == "Done."  # the next file is baked all the same


@pytest.mark.slow
def test_nothing_is_sent(trial: Trial) -> None:
    """The browser's proxy sees every request, those of the worker too."""
    trial.bake(TUBE)
    assert trial.seen
    host = re.match(r"http://[^/]+/try/", trial.page.call("(() => location.href)"))
    assert host
    own = {
        "index.html",
        "style.css",
        "page.js",
        "worker.js",
        "sources.js",
        "draco.js",
        "skinbake.zip",
        "frame.html",
    }
    allowed = {f"{host[0]}{name}" for name in {*own, *(f"runtime/{name}" for name in FILES)}}
    theirs = [one for one in trial.seen if urlsplit(one[1]).path != "/" and not CHROMIUMS_OWN.search(one[1])]
    assert {method for method, _, _ in theirs} == {"GET"}
    assert {length for _, _, length in theirs} == {""}
    assert {address for _, address, _ in theirs} - allowed == set()


@pytest.mark.slow
def test_the_policy_lets_neither_page_nor_worker_reach_another_host(trial: Trial) -> None:
    tries = """(async () => {
        const code = `fetch('http://example.org/x').then(() => 'sent', () => 'refused').then(postMessage)`;
        const inside = new Worker(URL.createObjectURL(new Blob([code])));
        const said = new Promise((found) => { inside.onmessage = ({ data }) => found(data); });
        return [await fetch('http://example.org/x').then(() => 'sent', () => 'refused'), await said];
    })"""
    before = len(trial.seen)
    assert trial.page.call(tries) == ["refused", "refused"]
    assert [one for one in trial.seen[before:] if "example.org" in one[1]] == []
    trial.page.messages()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1280, 800), (360, 740)], ids=str)
def test_axe_finds_nothing_on_the_page(size: tuple[int, int], scheme: str, trial: Trial) -> None:
    require_node("axe-core")
    axe = (package_folder("axe-core") / "axe.min.js").read_text(encoding="utf-8")
    trial.page.show_as(*size, scheme)
    trial.page.call(f"(() => {{ {axe} }})")
    found = trial.page.call(
        "(async () => (await axe.run(document, { iframes: false })).violations"
        ".map(({ id, nodes }) => [id, ...nodes.map(({ html }) => html)]))"
    )
    assert found == []
    assert trial.page.call("(() => document.documentElement.scrollWidth)") <= size[0]
    corner = Image.open(BytesIO(trial.page.screenshot())).convert("L").crop((0, 0, 4, 4)).tobytes()
    assert corner == bytes([255] * 16) if scheme == "light" else max(corner) < 60


@pytest.mark.slow
def test_keys_alone_choose_bake_and_save(trial: Trial) -> None:
    """Each control is reached by Tab, in the order of the page, and answers its key."""
    watch = """(() => {
        window.answered = [];
        for (const id of ['choose', 'save'])
            document.getElementById(id).onclick = (event) => { answered.push(id); event.preventDefault(); };
        const top = document.querySelector('h1');
        top.tabIndex = -1;
        top.focus();
    })"""
    ended = """(async () => {
        while (!/^(Done|It ended|Python ended)/.test(document.getElementById('state').textContent))
            await new Promise((next) => setTimeout(next, 30));
        return document.getElementById('command').textContent;
    })"""
    trial.bake(TUBE)
    trial.page.call(watch)
    reached = []
    for key in ("Enter", "Enter", "ArrowDown", None, "Enter"):
        trial.page.press("Tab")
        reached.append(trial.page.call("(() => document.activeElement.id)"))
        if key is not None:
            trial.page.press(key)
        command = trial.page.call(ended)
    assert reached == ["choose", "example", "lighting", "encoding", "save"]
    assert command == "skinbake bake arm.glb -o arm-baked.glb --correctives auto"
    assert trial.page.call("(() => answered)") == ["choose", "save"]


@pytest.mark.slow
def test_the_newest_pyodide_runs_the_loops(tmp_path: Path) -> None:
    require_node()
    if not (NEWEST / "package.json").is_file():
        missing_tool("pyodide-newest is not installed: npm ci --prefix tests/support/other_versions")
    require_runtime()
    put_trial(tmp_path)
    script = f"""
    import {{ readFileSync }} from 'node:fs';
    import {{ loadPyodide }} from '{(NEWEST / "pyodide.mjs").as_uri()}';
    const python = await loadPyodide();
    const archive = new Uint8Array(readFileSync('{tmp_path / "skinbake.zip"}'));
    python.unpackArchive(archive, 'zip', {{ extractDir: '/loops' }});
    console.log(python.runPython(`
        import importlib.util, sys
        from array import array
        def loops(name):
            path = f'/loops/skinbake/{{name}}.abi3.so'
            spec = importlib.util.spec_from_file_location(name.split('/')[1], path)
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module
        kernel, truth = loops('gradients/_kernel'), loops('truth/_loops')
        positions = memoryview(array('f', [0, 0, 0, 1, 0, 0, 0, 1, 0, 2, 0, 0])).cast('B').cast('f', (4, 3))
        triangles = memoryview(array('I', [0, 1, 2, 0, 1, 3])).cast('B').cast('I', (2, 3))
        mask = memoryview(bytearray(2)).cast('?')
        kernel.mark_proper(positions, triangles, mask, 1e-10)
        labels = array('i', [0] * 4)
        rows = memoryview(array('f', [1, 2, 1, 3])).cast('B').cast('f', (4, 1))
        count = kernel.label_equal_rows(rows, labels)
        str([sys.version_info[:2], mask.tolist(), count, labels.tolist(), truth.VECTOR_BITS])
    `));
    """
    (tmp_path / "run.mjs").write_text(script, "utf-8")
    done = subprocess.run(["node", str(tmp_path / "run.mjs")], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[(3, 14), [True, False], 3, [0, 1, 0, 2], 128]", done.stderr[-2000:]
