"""The add-on in Blender itself: install, export, failures, and Blender's own normals as a third truth."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import skinbake
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from skinbake.skinning.rest import Algorithm
from tests.blender.running import Session
from tests.support import corpus, gltf_reading
from tests.support.characters import Array, Character, Placement, Pose, angles
from tests.support.triangle_truth import true_normals

FAILURES = ("disk_full", "without_skinbake", "defect")
NOT_BAKED = (*FAILURES, "no_normals", "no_skins")
CHARACTERS = [
    "arm",
    pytest.param("CesiumMan", marks=corpus.needed),
    pytest.param("Alien_Scolitex", marks=corpus.needed),
]


class Posed:
    """An exported character in one pose, beside the corners that Blender evaluates there."""

    def __init__(self, session: Session, name: str) -> None:
        self.path = session.files / f"{name}.glb"
        corners = np.load(session.files / f"{name}.npz")
        self.character = Character(self.path, Pose(0, float(corners["time"])))
        rest = self.character.rest
        self.size = float(np.ptp(rest.positions, axis=0).max())
        # A vertex of glTF is a corner with its normal: their order is the exporter's own affair.
        places = np.hstack([corners["rest_positions"] / self.size, corners["rest_normals"]])
        distance, corner = cKDTree(places).query(np.hstack([rest.positions / self.size, rest.normals]))
        assert distance.max() < 1e-4
        self.positions: Array = corners["posed_positions"][corner]
        self.normals: Array = corners["posed_normals"][corner]

    def angles_to(self, algorithm: Algorithm) -> Array:
        return angles(self.character.expected(algorithm, Placement()).normals, self.normals)

    def angles_to_triangle_truth(self) -> Array:
        document = read_document(str(self.path))
        primitive = read_primitive(document, skinned_sources(document)[0])
        return angles(true_normals(primitive, self.positions[None])[0], self.normals)


def text_of(outcome: dict[str, Any]) -> str:
    return "\n".join(f"{level}: {text}" for level, text in outcome["lines"])


def metadata(path: Path) -> dict[str, Any]:
    return dict(gltf_reading.read(path).primitive(0)["extras"]["skinbake"])


def json_and_binary(path: Path) -> tuple[Any, bytes]:
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def test_the_zip_installs_and_brings_skinbake(session: Session) -> None:
    found = session.results["install"]
    assert found["enabled"]
    assert found["valid"] == 0, found["validation"]
    assert re.search(r"/blender/home/extensions/user_default/skinbake/__init__\.py$", found["addon"])
    assert re.search(r"/extensions/\.local/lib/.*/site-packages/skinbake/__init__\.py$", found["skinbake"])


@pytest.mark.parametrize("name", CHARACTERS)
def test_an_export_is_baked_and_gains(session: Session, name: str) -> None:
    outcome = session.results["characters"][name]
    assert outcome["status"] == "baked", text_of(outcome)
    assert outcome["raised"] is None
    verdict = skinbake.verify(session.files / f"{name}.glb", methods=["lbs"], require_baked=True)
    assert verdict["passed"], verdict["checks"]
    gains = []
    for truth in ("normals_by_triangles", "normals_by_tangents"):
        lbs = verdict[truth]["lbs"]
        gains.append(lbs["standard"]["mean"] / lbs["accurate"]["mean"])
    assert outcome["gain"] == pytest.approx(min(gains), rel=1e-4)
    assert outcome["gain"] > 2
    assert f"gain {min(gains):.2f}x" in text_of(outcome)


@pytest.mark.parametrize(
    ("name", "standard", "accurate"),
    [
        # Mean degrees, with a margin of a tenth and more. Blender derives its normals anew from the triangles
        # of the posed mesh: on coarse meshes they are not those of the surface.
        ("arm", 4.5, 0.08),
        pytest.param("CesiumMan", 2.2, 1.3, marks=corpus.needed),
        pytest.param("Alien_Scolitex", 0.5, 0.2, marks=corpus.needed),
    ],
)
def test_blenders_own_normals_agree(session: Session, name: str, standard: float, accurate: float) -> None:
    posed = Posed(session, name)
    moved = np.abs(posed.character.positions(Placement()) - posed.positions).max()
    assert moved < 1e-4 * posed.size
    assert posed.angles_to(Algorithm.LBS_STANDARD).mean() > standard
    assert posed.angles_to(Algorithm.LBS_ACCURATE).mean() < accurate


def test_verifys_truth_by_triangles_is_blenders(session: Session) -> None:
    # Both weigh the normals of triangles by angles. Blender has float32.
    found = Posed(session, "arm").angles_to_triangle_truth()
    assert found.mean() < 0.005
    assert found.max() < 0.05


def test_an_export_changes_nothing_but_the_bake(session: Session) -> None:
    stripped = session.files / "stripped.glb"
    skinbake.strip(session.files / "usual.glb", stripped)
    assert json_and_binary(stripped) == json_and_binary(session.files / "defect-plain.glb")


def test_every_option_arrives(session: Session) -> None:
    usual, others = (metadata(session.files / f"{name}.glb") for name in ("usual", "others"))
    assert (usual["gradients"], usual["neighbours"], usual["creaseAngle"]) == ("fitted", "adopt", 15)
    assert "encoding" not in usual
    assert "gradients" not in others  # those of the surface
    assert (others["neighbours"], others["weld"]) == ("drop", "skin")
    assert (others["creaseAngle"], others["encoding"], others["frame"]) == (40, "packed8", "normal")
    assert others["alpha"] == ["_CUSTOM0"]
    outcome = session.results["choices"]["others"]
    assert outcome["gain"] == 0
    assert re.search(r"packed8 turns normals by 0\.0\d° on average", text_of(outcome))


@pytest.mark.parametrize("name", ["separate.gltf", "draco.glb"])
def test_every_format_of_the_exporter_is_baked(session: Session, name: str) -> None:
    outcome = session.results["choices"][Path(name).stem]
    assert outcome["status"] == "baked", text_of(outcome)
    verdict = skinbake.verify(session.files / name, methods=["lbs"], samples=2, require_baked=True)
    assert verdict["passed"], verdict["checks"]


def test_correctives_are_baked_without_what_they_do_not_read(session: Session) -> None:
    outcome = session.results["choices"]["correctives"]
    assert (outcome["status"], outcome["raised"]) == ("baked", None), text_of(outcome)
    assert outcome["gain"] > 2
    mesh = gltf_reading.read(session.files / "correctives.glb").content["meshes"][0]
    assert mesh["extras"]["targetNames"][0].startswith("corrective normal")
    assert "_SKINBAKE_ALPHA_0" not in mesh["primitives"][0]["attributes"]


def test_the_panel_offers_the_options(session: Session) -> None:
    before = session.results["panel"]
    assert ["prop", "Bake on export"] in before
    labels = {label for kind, label in before if kind == "prop"}
    assert {"Gradients", "Encoding", "Layout", "Weld", "Crease angle"} <= labels


@pytest.mark.parametrize(
    ("kind", "name", "icons"),
    [
        ("choices", "usual", ["INFO", "INFO"]),
        # Blender's icon ERROR is the triangle of a warning.
        ("failures", "no_normals", ["ERROR", "ERROR"]),
        ("failures", "defect", ["CANCEL"]),
    ],
)
def test_the_panel_shows_the_outcome(session: Session, kind: str, name: str, icons: list[str]) -> None:
    before, outcome = session.results["panel"], session.results[kind][name]
    assert outcome["panel"][: len(before)] == before
    shown = outcome["panel"][len(before) :]
    assert " ".join(text for _, text in shown) == " ".join(text for _, text in outcome["lines"])
    assert [icon for icon, _ in shown if icon != "BLANK1"] == icons


@pytest.mark.parametrize("name", NOT_BAKED)
def test_the_plain_export_stays_whole(session: Session, name: str) -> None:
    plain, kept = (session.files / f"{name}{end}.glb" for end in ("-plain", ""))
    assert kept.read_bytes() == plain.read_bytes()
    outcome = session.results["failures"][name]
    assert outcome["status"] == ("failed" if name in FAILURES else "unchanged")
    assert f"{name}.glb: the plain export was kept" in text_of(outcome)
    assert (outcome["raised"] is not None) == (name in FAILURES)


def test_an_export_without_a_bake_has_no_outcome_of_the_one_before(session: Session) -> None:
    before = session.results["panel"]
    for name in NOT_BAKED:
        outcome = session.results["failures"][f"{name}-plain"]
        assert (outcome["path"], outcome["status"], outcome["gain"], outcome["lines"]) == ("", "", 0, [])
        assert outcome["panel"] == before


def test_a_failure_leaves_no_file_behind(session: Session) -> None:
    found = {path.name for path in session.files.iterdir() if "disk_full" in path.name or "tmp" in path.name}
    assert found == {"disk_full.glb", "disk_full-plain.glb"}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("disk_full", "cannot be written: File too large"),
        ("without_skinbake", "this Blender has no skinbake"),
        ("defect", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_failure_is_reported_and_raised(session: Session, name: str, reason: str) -> None:
    raised = session.results["failures"][name]["raised"]
    assert f"skinbake: {name}.glb: the plain export was kept: {reason}" in raised
    assert f"Error: skinbake: {name}.glb: the plain export was kept: {reason}" in session.said


def test_a_mesh_that_cannot_be_baked_is_named(session: Session) -> None:
    outcome = session.results["failures"]["no_normals"]
    assert "WARNING: no_normals.glb: the plain export was kept" in text_of(outcome)
    assert re.search(r'WARNING: mesh "arm", primitive 0: .*turn on Data > Mesh > Normals', text_of(outcome))


def test_a_scene_without_skins_is_no_warning(session: Session) -> None:
    outcome = session.results["failures"]["no_skins"]
    assert [level for level, _ in outcome["lines"]] == ["INFO"]
    assert "turn on Data > Skinning" in text_of(outcome)


def test_the_exporter_reports_the_outcome(session: Session) -> None:
    for _, text in session.results["characters"]["arm"]["lines"]:
        assert f"Info: skinbake: {text}\n" in session.said


def test_a_disabled_addon_leaves_nothing_behind(session: Session) -> None:
    assert session.results["disabled"] == {"properties": False, "panel": False}
    plain = (session.files / "defect-plain.glb").read_bytes()
    assert (session.files / "disabled.glb").read_bytes() == plain
