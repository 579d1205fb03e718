"""The page that draws baked characters with Babylon.js, and the normals that it should have drawn."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skinbake.format.layouts import GradientFormat
from skinbake.skinning.algorithms import Algorithm
from tests.babylon.write_package import FOLDER as PACKAGE
from tests.support import browser
from tests.support.characters import AS_USUAL, Array, Character, Placement, Pose, baked
from tests.support.node import SUPPORT, package_folder, require_node

HERE = Path(__file__).resolve().parent
PAGE = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<script src="/support/capture.js"></script>
<script src="/three/capture_webgpu.js"></script>
<body><script type="module">window.ready = import('/built/app.js');</script>
"""
DEGREES = 0.01
"""Between the browser and the replay: Babylon.js has bone matrices, and we all else, in float32."""


class Stage:
    """The page, and the models that it can load."""

    def __init__(self, page: browser.Page, models: Path) -> None:
        self.page, self.models = page, models

    def character(
        self, source: Path, pose: Pose, frame: str = "auto", storage: GradientFormat = AS_USUAL
    ) -> Character:
        return Character(baked(source, self.models, frame, storage), pose)

    def call(self, function: str, options: dict[str, Any]) -> Any:
        """Call a function of the page; whatever the console says of it fails the test."""
        value = self.page.call(function, options)
        assert self.messages() == []
        return value

    def messages(self) -> list[str]:
        """Return the console since the last time. The corpus has no images beside its models."""
        others = ("Failed to load resource",)
        return [line for line in self.page.messages() if not line.startswith(others)]

    def normals(self, character: Character, **options: object) -> dict[str, Any]:
        return dict(self.call("normals", {**character.told(Placement()), **options}))


def expected(
    character: Character, algorithm: Algorithm = Algorithm.LBS_ACCURATE, *, left: bool = False
) -> Array:
    """Return the normals in the world. Babylon.js's own world, left-handed, is the mirror image in x."""
    normals = character.expected(algorithm, Placement()).normals
    return normals * (-1, 1, 1) if left else normals


@contextmanager
def opened_stage(folder: Path) -> Iterator[Stage]:
    """Bundle the page, open it, and yield it. ``folder`` is empty."""
    for name in ("models", "profile", "project"):
        (folder / name).mkdir()
    build(folder / "project")
    folders = {"models": folder / "models", "built": folder / "project" / "dist"}
    folders |= {"three": HERE.parent / "three", "support": SUPPORT}
    with browser.opened(PAGE, folders, folder / "profile") as page:
        yield Stage(page, folder / "models")


def build(project: Path) -> None:
    """Bundle drawing.mjs, the package and Babylon.js: its modules are too many to be fetched one by one."""
    node = require_node("vite", "@babylonjs/core", "@babylonjs/loaders")
    (project / "app.mjs").write_bytes((HERE / "drawing.mjs").read_bytes())
    (project / "package.json").write_text('{"name": "project", "private": true, "type": "module"}')
    packages = {name: str(package_folder(name)) for name in ("@babylonjs/core", "@babylonjs/loaders")}
    configuration = {
        "resolve": {"alias": {"skinbake-babylon": str(PACKAGE / "index.js"), **packages}},
        "build": {"minify": False, "lib": {"entry": "app.mjs", "formats": ["es"], "fileName": "app"}},
        "logLevel": "warn",
    }
    (project / "vite.config.mjs").write_text(f"export default {json.dumps(configuration)};")
    vite = package_folder("vite") / "bin" / "vite.js"
    done = subprocess.run(
        [node, str(vite), "build"],
        cwd=project,
        capture_output=True,
        encoding="utf-8",
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
