"""Draw docs/three-webgl.png and docs/three-webgpu.png: baked characters in three.js, standard and accurate.

Usage: python -m benchmarks.three_picture [FOLDER]

The npm package of engines/three draws the bent tube of the fixtures in headless Chromium: by WebGLRenderer,
and another view by WebGPURenderer on WebGPU (SwiftShader).
"""

from __future__ import annotations

import argparse
import base64
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from benchmarks.bend_picture import GREY, INK, MARGIN, REPOSITORY, Array, font
from fixtures.make_fixtures import FOLDER
from skinbake.commands.bake import bake_file
from tests.support import browser
from tests.support.node import package_folder

PANEL = (484, 380)
HEADER = 64
SUPERSAMPLING = 3
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
<body><script type="module">window.ready = import('/benchmarks/three_picture.mjs');</script>
"""
VIEWS: dict[str, dict[str, Any]] = {
    "webgl": {
        "clip": 0,
        "time": 0.5,
        "from": [0.3, 0.1, 1.0],
        "at": [-0.25, 1.2, 0.0],
        "across": 2.5,
        "colour": 0xD1693E,
    },
    "webgpu": {
        "clip": 0,
        "time": 0.5,
        "from": [0.9, -0.5, 0.7],
        "at": [-0.25, 1.2, 0.0],
        "across": 2.4,
        "colour": 0x4C7FB0,
    },
}
RENDERERS = {"webgl": "WebGLRenderer", "webgpu": "WebGPURenderer (WebGPU)"}


def main() -> None:
    """Draw both pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, nargs="?", default=REPOSITORY / "docs")
    options = parser.parse_args()
    with TemporaryDirectory(prefix="skinbake-three-") as scratch:
        folder = Path(scratch)
        for name in ("models", "profile"):
            (folder / name).mkdir()
        bake_file(str(FOLDER / "bent_tube.glb"), str(folder / "models" / "bent_tube.glb"))
        folders = {"models": folder / "models", "three": package_folder("three")}
        folders |= {"benchmarks": Path(__file__).parent, "package": REPOSITORY / "engines" / "three"}
        with browser.opened(PAGE, folders, folder / "profile") as page:
            for backend, view in VIEWS.items():
                target = options.folder / f"three-{backend}.png"
                composed(drawn(page, backend, view), RENDERERS[backend]).save(target, optimize=True)
                print(f"{target}: {target.stat().st_size:,} bytes")


def drawn(page: browser.Page, backend: str, view: dict[str, Any]) -> dict[str, Image.Image]:
    """Return what the page draws, one image for each lighting."""
    size = [SUPERSAMPLING * side for side in PANEL]
    asked = {**view, "url": "/models/bent_tube.glb", "backend": backend, "size": size}
    found = page.call("pictures", asked)
    if found is None:
        raise SystemExit("this browser has no WebGPU adapter")
    if set(found["lightings"]) != {"accurate"}:
        raise SystemExit(f"the last picture is not accurate: {page.messages()}")
    images = {}
    for lighting in ("standard", "accurate"):
        pixels = np.frombuffer(base64.b64decode(found[lighting]), "<f4").reshape(size[1], size[0], 4)
        rows = pixels if backend == "webgpu" else pixels[::-1]
        images[lighting] = image(rows[..., :3].astype(np.float64))
    return images


def image(light: Array) -> Image.Image:
    """Return linear light (H, W, 3) as sRGB, one pixel for each block of samples."""
    width, height = PANEL
    blocks = light.clip(0, 1).reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3).mean(axis=(1, 3))
    encoded = np.where(blocks <= 0.0031308, 12.92 * blocks, 1.055 * blocks ** (1 / 2.4) - 0.055)
    return Image.fromarray(np.round(255 * encoded).astype(np.uint8))


def composed(images: dict[str, Image.Image], renderer: str) -> Image.Image:
    """Put the images side by side, with titles."""
    width, height = PANEL
    sheet = Image.new("RGB", (2 * width + 3 * MARGIN, HEADER + height + MARGIN), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (lighting, panel) in enumerate(images.items()):
        left = MARGIN + number * (width + MARGIN)
        sheet.paste(panel, (left, HEADER))
        title = "three.js's own skinning" if lighting == "standard" else "skinbake-three"
        draw.text((left + width / 2, 24), title, INK, font(24), "mm")
        draw.text((left + width / 2, 50), renderer, GREY, font(15), "mm")
    return sheet


if __name__ == "__main__":
    main()
