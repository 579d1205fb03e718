"""The page that draws baked characters with Babylon.js, and the normals that it should have drawn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.support.characters import Array, Character, Placement
from tests.support.node import build_page, package_folder, require_node
from tests.support.stage import Stage, opened_page, page_of

HERE = Path(__file__).resolve().parent
PAGE = page_of("/built/app.js", scripts=["/support/capture.js", "/three/capture_webgpu.js"])
DEGREES = 0.01
"""Between the browser and the replay: Babylon.js has bone matrices, and we all else, in float32."""


def expected(
    character: Character, algorithm: Algorithm = Algorithm.LBS_ACCURATE, *, left: bool = False
) -> Array:
    """Return the normals in the world. Babylon.js's own world, left-handed, is the mirror image in x."""
    normals = character.expected(algorithm, Placement()).normals
    return normals * (-1, 1, 1) if left else normals


@contextmanager
def opened_stage(folder: Path, further: str = "", *needed: str) -> Iterator[Stage]:
    """Bundle the page, open it, and yield it. ``folder`` is empty.

    further is a file whose lines follow those of the page, and needed are the packages that it imports.
    """
    engine = ("@babylonjs/core", "@babylonjs/loaders", *needed)
    require_node("vite", *engine, "draco3dgltf", "meshoptimizer")
    project = folder / "project"
    project.mkdir()
    # Babylon.js's modules are too many to be fetched one by one.
    packages = {name: str(package_folder(name)) for name in engine}
    entry = folder / "page.mjs"
    texts = [(HERE / name).read_text(encoding="utf-8") for name in ("drawing.mjs", further) if name]
    entry.write_text("".join(texts), encoding="utf-8")
    build_page(
        project,
        entry,
        {"skinbake-babylon": str(engines_folder() / "babylon" / "index.js"), **packages},
    )
    folders = {"built": project / "dist", "three": HERE.parent / "three"}
    folders |= {"draco": package_folder("draco3dgltf"), "meshopt": package_folder("meshoptimizer")}
    with opened_page(PAGE, folder, folders) as found:
        yield Stage(*found)
