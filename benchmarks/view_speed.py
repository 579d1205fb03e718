"""Time the page of ``skinbake view`` against three.js with the same file: the first frame, and each frame.

Usage: python -m benchmarks.view_speed MODEL.glb [--rounds N]

Both draw the baked file in a canvas of the same size, with antialiasing, in Chromium without a window, on
SwiftShader, and wait until the pixels are there. A frame is counted in processor time of the whole browser,
which other work on the machine changes less than wall time. three.js draws the file once with its standard
material and two lights. The page draws each half of the canvas with its own lighting. Rounds take turns.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skinbake.commands.bake import Baker
from skinbake.commands.view import view_file
from tests.support import browser
from tests.support.node import package_folder

SIZE = (928, 637)
FRAMES = 24

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
    Object.assign(canvas, { width: WIDTH, height: HEIGHT });
    window.drawn = (share) => {
        const { start, end } = application.clip;
        application.seek(start + share * (end - start));
        application.draw();
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    };
    return [application.firstFrame, canvas.width, canvas.height];
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


@contextmanager
def pages(model: Path, folder: Path) -> Iterator[dict[str, browser.Page]]:
    """Open both pages, each in a browser of its own."""
    path = folder / "page.html"
    path.write_bytes(view_file(str(model)).page)
    for name in ("ours", "theirs"):
        (folder / name).mkdir()
    folders = {"three": package_folder("three"), "models": model.parent}
    with (
        browser.opened(THREE_PAGE, folders, folder / "theirs") as theirs,
        browser.opened_file(path, folder / "ours") as ours,
    ):
        yield {"three.js": theirs, "skinbake view": ours}


def measured(model: Path, rounds: int) -> dict[str, Any]:
    """Return the milliseconds to the first frame, and of each frame, of both pages."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        baked = folder / "models" / "model.glb"
        baked.parent.mkdir()
        Baker(generate_normals=True).bake_file(str(model), str(baked))
        with pages(baked, folder) as found:
            first = {"three.js": found["three.js"].call("(() => first)")}
            first["skinbake view"], *size = found["skinbake view"].call(OURS)
            profiles = {"three.js": folder / "theirs", "skinbake view": folder / "ours"}
            times: dict[str, list[float]] = {page: [] for page in found}
            for number in range(rounds + 1):
                for page, opened in found.items():
                    before = processor_seconds(profiles[page])
                    opened.call(DRAW, FRAMES)
                    spent = processor_seconds(profiles[page]) - before
                    if number:  # the first round compiles
                        times[page].append(1000 * spent / FRAMES)
    return {
        "first": first,
        "frame": {page: statistics.median(own) for page, own in times.items()},
        "size": size,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    found = measured(options.model, options.rounds)
    print(f"{options.model.name}, {found['size'][0]} × {found['size'][1]} pixels, SwiftShader")
    for page, first in found["first"].items():
        print(f"  {page:<14} first frame {first:7.0f} ms    a frame {found['frame'][page]:6.1f} ms")
    ratio = found["frame"]["skinbake view"] / found["frame"]["three.js"]
    print(f"  skinbake view takes {ratio:.2f} × the time of three.js for a frame")


if __name__ == "__main__":
    main()
