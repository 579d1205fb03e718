"""Time the page of ``skinbake view`` against three.js with the same file: the first frame, and each frame.

Usage: python -m benchmarks.view_speed MODEL.glb|VERTICES [--rounds N] [--frames N]

A number of vertices stands for a skinned grid of that size. Both draw the baked file in a canvas of the
same size, with antialiasing, in Chromium without a window, on SwiftShader, and wait until the pixels are
there. The first frame is counted from the navigation, in a browser that has drawn WebGL before, as a user's
has, with a new profile each time: the least of all rounds, for other work on the machine only adds to it.
A frame is counted in processor time of the whole browser, which other work changes less than wall time.
three.js draws the file once with its standard material and two lights. The page draws each half of the
canvas with its own lighting. Rounds take turns.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.skinned_grid import grid_of, grid_vertices, write_grid
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.view import view_file
from tests.support import browser
from tests.support.node import package_folder

SIZE = (928, 637)

THREE_PAGE = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<style>body { margin: 0 } canvas { display: block }</style>
<script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}
</script>
<body><script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

async function start() {
    const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    renderer.setSize(WIDTH, HEIGHT);
    document.body.append(renderer.domElement);
    const gltf = await new GLTFLoader().loadAsync('/models/model.glb');
    const scene = new THREE.Scene();
    const light = new THREE.DirectionalLight(0xffffff, 2);
    light.position.set(1, 1, 1);
    scene.add(gltf.scene, light, new THREE.HemisphereLight(0xffffff, 0x444444, 1));
    const sphere = new THREE.Box3().setFromObject(gltf.scene).getBoundingSphere(new THREE.Sphere());
    const camera = new THREE.PerspectiveCamera(32, WIDTH / HEIGHT, sphere.radius / 50, sphere.radius * 20);
    const away = new THREE.Vector3(0.43, 0.16, 0.88).multiplyScalar(sphere.radius * 3.6);
    camera.position.copy(sphere.center).add(away);
    camera.lookAt(sphere.center);
    const mixer = new THREE.AnimationMixer(gltf.scene);
    const clip = gltf.animations[0];
    if (clip) mixer.clipAction(clip).play();
    const gl = renderer.getContext();
    const pixel = new Uint8Array(4);
    window.drawn = (share) => {
        if (clip) mixer.setTime(share * clip.duration);
        renderer.render(scene, camera);
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    };
    drawn(0);
    window.first = performance.now();
}
window.ready = start();
</script>
""".replace("WIDTH", str(SIZE[0])).replace("HEIGHT", str(SIZE[1]))

OURS = """(() => {
    const { gl, canvas } = application.renderer;
    const pixel = new Uint8Array(4);
    application.play(false);
    application.stopMeasuring();
    document.getElementById('moving').checked = false;
    Object.assign(canvas, { width: WIDTH, height: HEIGHT });
    window.drawn = (share) => {
        const { start, end } = application.clip;
        application.seek(start + share * (end - start));
        application.draw();
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    };
})""".replace("WIDTH", str(SIZE[0])).replace("HEIGHT", str(SIZE[1]))

DRAW = "((frames) => { for (let i = 0; i < frames; i++) drawn(i / frames); })"
TICKS = os.sysconf("SC_CLK_TCK")


def processor_seconds(profile: Path) -> float:
    """Return the processor time of the browser with this profile: of all processes of its group."""
    stats = []
    group = None
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if str(profile) in (entry / "cmdline").read_text():
                group = group or fields[2]
            stats.append((fields[2], int(fields[11]) + int(fields[12])))
        except (OSError, IndexError):
            continue
    return sum(ticks for own, ticks in stats if own == group) / TICKS


WARM = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<canvas id="canvas"></canvas>
<script>
const gl = canvas.getContext('webgl2');
gl.clear(gl.COLOR_BUFFER_BIT);
gl.finish();
window.ready = Promise.resolve();
</script>
"""
FIRST = {"three.js": "(() => first)", "skinbake view": "(() => application.firstFrame)"}


class Pages:
    """Both pages of a model, as files, and browsers to open them in."""

    def __init__(self, model: Path, folder: Path) -> None:
        self._folder, self._opened = folder, 0
        (folder / "pages").mkdir()
        (folder / "pages" / "three.html").write_text(THREE_PAGE)
        self._ours = folder / "page.html"
        self._ours.write_bytes(view_file(str(model)).page)
        self._folders = {"three": package_folder("three"), "models": model.parent, "pages": folder / "pages"}

    @contextmanager
    def opened(self, name: str) -> Iterator[tuple[browser.Page, Path]]:
        """Open a page in a browser with a profile of its own, which has drawn before; yield both."""
        self._opened += 1
        profile = self._folder / f"profile-{self._opened}"
        profile.mkdir()
        with browser.opened(WARM, self._folders, profile) as page:
            page.go(
                f"{page.address}/pages/three.html" if name == "three.js" else self._ours.resolve().as_uri()
            )
            yield page, profile


def measured(model: Path, rounds: int, count: int) -> dict[str, dict[str, float]]:
    """Return the milliseconds to the first frame, and of each frame, of both pages."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        baked = folder / "models" / "model.glb"
        baked.parent.mkdir()
        bake_file(str(model), str(baked), BakeOptions(generate_normals=True))
        pages = Pages(baked, folder)
        first: dict[str, list[float]] = {page: [] for page in FIRST}
        for _ in range(rounds):
            for page, asked in FIRST.items():
                with pages.opened(page) as (opened, _):
                    first[page].append(opened.call(asked))
        return {
            "first": {page: min(own) for page, own in first.items()},
            "frame": frames(pages, rounds, count),
        }


def frames(pages: Pages, rounds: int, count: int) -> dict[str, float]:
    """Return the milliseconds of processor time of a frame of both pages: medians of rounds of ``count``."""
    times: dict[str, list[float]] = {page: [] for page in FIRST}
    with pages.opened("three.js") as theirs, pages.opened("skinbake view") as ours:
        ours[0].call(OURS)
        for number in range(rounds + 1):
            for page, (opened, profile) in zip(FIRST, (theirs, ours), strict=True):
                before = processor_seconds(profile)
                opened.call(DRAW, count)
                spent = processor_seconds(profile) - before
                if number:  # the first round compiles
                    times[page].append(1000 * spent / count)
    return {page: statistics.median(own) for page, own in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=model_or_vertices, metavar="MODEL.glb|VERTICES")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=24, help="frames of a round")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        model = options.model
        if isinstance(model, int):
            model = Path(folder, f"grid-{options.model}.glb")
            write_grid(model, grid_of(options.model))
        found = measured(model, options.rounds, options.frames)
    busy = os.getloadavg()[0]
    print(f"{model.name}, {SIZE[0]} × {SIZE[1]} pixels, SwiftShader, {os.cpu_count()} cores, load {busy:.1f}")
    for page, first in found["first"].items():
        print(f"  {page:<14} first frame {first:7.0f} ms    a frame {found['frame'][page]:6.1f} ms")
    ratio = found["frame"]["skinbake view"] / found["frame"]["three.js"]
    print(f"  skinbake view takes {ratio:.2f} × the time of three.js for a frame")


def model_or_vertices(text: str) -> Path | int:
    """Read the argument: the path of a model, or the number of vertices of a grid."""
    return grid_vertices(text) if text.isdecimal() else Path(text)


if __name__ == "__main__":
    main()
