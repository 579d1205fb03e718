"""The add-on in Godot itself: the editor's import, then each renderer on software drivers.

Normals are those that light shows, at each pixel: on a matte surface, and in linear colours, it is a cosine.
It comes from six sides. The normals are held against the replay, which is rasterised here.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER as FIXTURES
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.godot import native
from tests.support import corpus
from tests.support.characters import Array, Character, Placement, Pose, angles, baked, unit
from tests.support.morphed_files import morphed
from tests.support.rasterised import covering, eroded

pytestmark = pytest.mark.slow

HERE = Path(__file__).resolve().parent
SIZE = 160
RENDERERS = ["forward_plus", "mobile", "gl_compatibility"]
CASES: dict[str, dict[str, Any]] = {
    "normal": {},
    "tangent": {},
    "real": {},
    "dual": {"method": "dqs"},
    "morphed": {"morphs": (0.0, 1.0)},
    "undone": {"isStandard": True},
}
DEGREES = 0.15
"""Godot stores normals in 16 bits, and the pictures have half floats."""


@dataclass(frozen=True)
class Shown:
    """What a renderer has drawn of a case: its answer, and the normals of both lightings, (H, W, 3)."""

    told: dict[str, Any]
    normals: Array


class Project:
    """The project of the tests, whose characters the editor has imported."""

    def __init__(self, folder: Path, godot: native.Godot) -> None:
        self.folder, self.godot = folder, godot
        shutil.copytree(HERE / "native", folder / "project")
        shutil.copytree(engines_folder() / "godot", folder / "project", dirs_exist_ok=True)
        pose = Pose(clip=None)
        tube, mirrored = FIXTURES / "bent_tube.glb", FIXTURES / "mirrored_tangent.glb"
        shaped = morphed(mirrored, folder / "shaped.glb")
        sources = {
            "normal": (tube, "normal"),
            "tangent": (mirrored, "tangent"),
            "real": (corpus.character("CesiumMan/CesiumMan.glb"), "auto"),
            "dual": (mirrored, "normal"),
            "morphed": (shaped, "tangent"),
            "undone": (tube, "normal"),
        }
        self.characters = {
            name: Character(baked(source, folder / "project", frame), pose, CASES[name].get("morphs", ()))
            for name, (source, frame) in sources.items()
        }
        godot.run(folder / "project", "--headless", "--import")
        self._drawn: dict[str, dict[str, Shown]] = {}

    def drawn(self, renderer: str) -> dict[str, Shown]:
        """Return what a renderer draws of all cases: one start serves them."""
        if renderer not in self._drawn:
            folder = self.folder / renderer
            folder.mkdir()
            asked = [
                {"file": one.path.name, "pose": one.pose, "size": SIZE, **CASES[name]}
                for name, one in self.characters.items()
            ]
            (folder / "asked.json").write_text(json.dumps(asked))
            words = [str(folder / "asked.json"), str(folder)]
            said = self.godot.run(self.folder / "project", "--rendering-method", renderer, "--", *words)
            assert "ERROR" not in said, said
            told = json.loads((folder / "told.json").read_text("utf-8"))
            assert told["renderer"] == renderer
            self._drawn[renderer] = {
                name: Shown(one, normals_of(folder / str(number), is_linear=renderer != "gl_compatibility"))
                for number, (name, one) in enumerate(zip(CASES, told["drawn"], strict=True))
            }
        return self._drawn[renderer]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    folder = tmp_path_factory.mktemp("godot")
    with native.opened(folder) as godot:
        yield Project(folder, godot)


def normals_of(path: Path, *, is_linear: bool) -> Array:
    """Return the normals (H, W, 3) of a picture lit along the axes and one lit against them."""
    lit = [np.fromfile(f"{path}.{side}", "<f4").astype(np.float64) for side in (1, -1)]
    if not is_linear:
        lit = [np.where(sent <= 0.04045, sent / 12.92, ((sent + 0.055) / 1.055) ** 2.4) for sent in lit]
    return (lit[0] - lit[1]).reshape(SIZE, SIZE, 3)


def replayed(character: Character, told: dict[str, Any], algorithm: Algorithm) -> tuple[np.ndarray, Array]:
    """Return the pixels (H, W) well inside what the camera sees, and the normals (H, W, 3) there."""
    placement = replace(Placement(), world=np.array(told["world"]).reshape(4, 4).T)
    points = character.positions(placement, algorithm)
    normals = character.expected(algorithm, placement).normals
    across = (points[:, :2] - told["centre"]) / told["extent"] * [1, -1] + 0.5
    places = np.column_stack([across * SIZE, -points[:, 2]])
    covered, corners, shares = covering(places, np.ones(len(points)), character.triangles, (SIZE, SIZE))
    mixed = np.einsum("hwk,hwki->hwi", shares, normals[corners])
    return eroded(covered, 1), mixed


def errors(shown: Shown, character: Character, algorithm: Algorithm) -> Array:
    """Return the angles, in degrees, at the pixels of a character."""
    inside, wanted = replayed(character, shown.told, algorithm)
    assert inside.sum() > 500
    return angles(shown.normals[inside], unit(wanted[inside]))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("renderer", RENDERERS)
def test_light_falls_on_the_normals_of_the_replay(project: Project, renderer: str, case: str) -> None:
    shown, character = project.drawn(renderer)[case], project.characters[case]
    assert {entry["lighting"] for entry in shown.told["report"]} == {"accurate"}
    right, other = Algorithm.LBS_ACCURATE, Algorithm.LBS_STANDARD
    if case == "undone":
        right, other = other, right
    elif case == "dual":
        right = Algorithm.DQS_EXACT
    assert errors(shown, character, right).max() < DEGREES
    assert np.percentile(errors(shown, character, other), 90) > 20 * DEGREES


def test_motion_vectors_of_forward_plus_are_those_of_godot_s_own_skinning(project: Project) -> None:
    """While a joint turns, and when it has stopped."""
    project.drawn("forward_plus")
    folder = project.folder / "forward_plus"
    for frame, moves in ((6, True), (8, False)):
        own, ours = (
            np.fromfile(folder / f"{lighting}.{frame}", "<f4") for lighting in ("standard", "accurate")
        )
        assert (np.abs(own).max() > 0.01) == moves
        assert np.abs(own - ours).max() < 1e-3
