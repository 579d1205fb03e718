"""Time frames of three.js with accurate lighting beside its own, as ratios, in headless Chromium.

Usage: python -m benchmarks.three_frame [--rounds N] [--vertices N]

Chromium draws on the processor (SwiftShader). Beside pixels, vertices cost far more there than on a GPU, and
SwiftShader runs both sides of every branch of a shader: linear blending pays for dual quaternions too. So the
ratios are of the worst kind. Three scenes: one mesh of many vertices in a picture of 64 × 64, where the
vertex shader is nearly all of a frame; and 25 characters of 1518 vertices in a picture of 512 × 512, without
and with normal maps.

A round draws one frame of each lighting, in turn, and the turn shifts from round to round. Each ratio is of
two frames of one round; printed are the median of the rounds and the quartiles. "three.js" is untouched: its
program was compiled before the package came, and its meshes have no hooks. "switched off" is over a second
after ``lighting(scene, 'standard')``, in a scene that was drawn accurately before. A frame ends when it is
drawn.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.results import processor
from benchmarks.skinned_grid import grid_of, grid_vertices, write_grid
from fixtures.make_fixtures import FOLDER
from skinbake.commands.bake import bake_file
from tests.support import browser
from tests.support.node import package_folder

HERE = Path(__file__).resolve().parent
PAGE = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<script type="importmap">
{"imports": {
    "three": "/three/build/three.module.js",
    "three/webgpu": "/three/build/three.webgpu.js",
    "three/tsl": "/three/build/three.tsl.js",
    "three/addons/": "/three/examples/jsm/",
    "skinbake-three": "/package/index.js",
    "skinbake-three/webgpu": "/package/webgpu.js"
}}
</script>
<body><script type="module">window.ready = import('/benchmarks/three_frame.mjs');</script>
"""
RENDERERS = ("WebGLRenderer", "WebGPURenderer, WebGL 2", "WebGPURenderer, WebGPU")
LIGHTINGS = {"standard": "switched off", "lbs": "accurate", "dqs": "accurate, dqs"}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--vertices", type=grid_vertices, default=20_000)
    options = parser.parse_args()
    print(f"{processor()}, {os.cpu_count()} cores; three.js {three_version()}; drawn by SwiftShader")
    with TemporaryDirectory(prefix="skinbake-bench-") as scratch:
        folder = Path(scratch)
        grid, tube = baked_models(folder, options.vertices)
        scenes = {
            f"one mesh, {options.vertices:,} vertices": {"url": grid, "count": 1, "size": 64},
            "25 characters": {"url": tube, "count": 25, "size": 512},
            "25 characters with normal maps": {"url": tube, "count": 25, "size": 512, "isMapped": True},
        }
        for title, scene in scenes.items():
            for name in RENDERERS:
                found = measured(folder, {**scene, "name": name}, options.rounds)
                print(f"{title} | {name}: {words(found)}", flush=True)


def baked_models(folder: Path, vertices: int) -> list[str]:
    """Bake a grid of so many vertices and the bent tube, and return their addresses."""
    grid = folder / "grid.glb"
    write_grid(grid, grid_of(vertices))
    (folder / "models").mkdir()
    for source in (grid, FOLDER / "bent_tube.glb"):
        bake_file(str(source), str(folder / "models" / source.name))
    return ["/models/grid.glb", "/models/bent_tube.glb"]


def measured(folder: Path, scene: dict[str, Any], rounds: int) -> list[dict[str, float]]:
    """Return the milliseconds of each round, by kind, in a browser of its own: none without WebGPU."""
    folders = {"models": folder / "models", "three": package_folder("three"), "benchmarks": HERE}
    folders["package"] = HERE.parent / "engines" / "three"
    with TemporaryDirectory(dir=folder) as profile, browser.opened(PAGE, folders, Path(profile)) as page:
        if not page.call("prepare", scene):
            return []
        times = [page.call("round", number) for number in range(rounds)]
        drawn = page.call("lightings")
        told = [line for line in page.messages() if "GPU stall due to ReadPixels" not in line]
    if told or drawn != {"standard": ["standard"], "lbs": ["accurate"], "dqs": ["accurate"]}:
        raise SystemExit(f"a lighting was not drawn: {drawn} {told}")
    return times


def words(found: list[dict[str, float]]) -> str:
    """Return the ratios to three.js's own skinning."""
    if not found:
        return "no WebGPU here"
    times = {kind: np.array([row[kind] for row in found]) for kind in ("three", *LIGHTINGS)}
    parts = [f"three.js {np.median(times['three']):.1f} ms"]
    for kind, title in LIGHTINGS.items():
        low, middle, high = np.percentile(times[kind] / times["three"], (25, 50, 75))
        parts.append(f"{title} {middle:.2f} ({low:.2f} to {high:.2f})")
    return ", ".join(parts)


def three_version() -> str:
    """Return the version of three.js that is measured."""
    text = (package_folder("three") / "package.json").read_text(encoding="utf-8")
    return str(json.loads(text)["version"])


if __name__ == "__main__":
    main()
