"""Draw characters with normal maps in three.js: standard, accurate in three.js's own frame, and as a relief.

``python -m benchmarks.normal_map_picture FOLDER``: a picture of each model into a folder. The fourth panel
has the difference of the last two, eight times. Models whose own normal map is not at hand get round bumps
of 25°.
"""

from __future__ import annotations

import argparse
import base64
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from benchmarks.bend_picture import INK, MARGIN, REPOSITORY, font
from tests.support import browser
from tests.support.baking import bake_file
from tests.support.corpus_folder import find_corpus
from tests.support.node import package_folder

PANEL = (400, 400)
PAGE = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<script type="importmap">
{"imports": {
    "three": "/three/build/three.module.js",
    "three/addons/": "/three/examples/jsm/",
    "skinbake-three": "/package/index.js"
}}
</script>
<body><script type="module">window.ready = import('/benchmarks/normal_map_picture.mjs');</script>
"""
VIEWS: dict[str, dict[str, Any]] = {
    "cases/normal_map_tangent.glb": {"time": 0.3, "from": [0.4, 0.2, 1.0], "zoom": 1.6},
    "public/Butterfly/animated_butterfly.glb": {
        "time": 6.18,
        "from": [0.3, 0.8, 1.0],
        "repeat": 24,
        "zoom": 1.4,
    },
    "public/TRex/trex.gltf": {"time": 1.58, "from": [1.0, 0.25, 0.6], "repeat": 40, "zoom": 1.6},
}
TITLES = {
    "standard": "three.js's own skinning",
    "frame": "accurate, three.js's frame",
    "relief": "accurate, as a relief",
    "difference": "difference, 8 times",
}


def main() -> None:
    """Draw a picture of each model."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    corpus = find_corpus()
    if corpus is None:
        raise SystemExit("no models: set SKINBAKE_CORPUS")
    options.folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="skinbake-maps-") as scratch:
        folder = Path(scratch)
        for name in ("models", "profile"):
            (folder / name).mkdir()
        folders = {"models": folder / "models", "three": package_folder("three")}
        folders |= {"benchmarks": Path(__file__).parent, "package": REPOSITORY / "engines" / "three"}
        with browser.opened(PAGE, folders, folder / "profile") as page:
            for name, view in VIEWS.items():
                stem = Path(name).stem
                bake_file(corpus / name, folder / "models" / f"{stem}.glb")
                found = page.call("pictures", {**view, "url": f"/models/{stem}.glb", "size": PANEL})
                composed(found).save(options.folder / f"{stem}.png", optimize=True)
                print(options.folder / f"{stem}.png")


def composed(found: dict[str, str]) -> Image.Image:
    """Put the panels side by side, with titles."""
    width, height = PANEL
    panels = {
        way: np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[::-1, :, :3]
        for way, text in found.items()
    }
    apart = np.abs(panels["relief"].astype(int) - panels["frame"].astype(int))
    panels["difference"] = (255 - np.clip(8 * apart, 0, 255)).astype(np.uint8)
    sheet = Image.new("RGB", (len(panels) * (width + MARGIN) + MARGIN, 40 + height + MARGIN), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (way, title) in enumerate(TITLES.items()):
        left = MARGIN + number * (width + MARGIN)
        sheet.paste(Image.fromarray(panels[way]), (left, 40))
        draw.text((left + width / 2, 20), title, INK, font(18), "mm")
    return sheet


if __name__ == "__main__":
    main()
