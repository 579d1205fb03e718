"""Whatever is done to a baked file, verify fails and says what happened; every case is a file on disk."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from skinbake.choices import FrameChoice, PoseKind, Weighting
from skinbake.format.digests import array_digest
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.verify import Verify
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.truth.poses import PoseRequest
from skinbake.version import FIT
from tests.support import gltf_reading
from tests.support.baked_files import CESIUM_MAN, Answer, Editable, baked, source, verify
from tests.support.baking import bake_settings
from tests.support.models import sheet, write_model

HERE = "here.glb"
FEW = ("--poses", "random:2", "--method", "lbs")
MODELS = [
    "bent_tube.glb",
    "two_sets.glb",
    CESIUM_MAN,
]


class Case(NamedTuple):
    """A change of a file, the notice's code, and words that its message holds."""

    edit: Callable[[Editable], None]
    code: str
    words: Sequence[str]


@pytest.fixture(scope="module")
def bakes(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that bakes a model once for the whole module."""
    made: dict[str, Path] = {}

    def of(name: str) -> Path:
        if name not in made:
            made[name] = baked(source(name), tmp_path_factory.mktemp("baked"))
        return made[name]

    return of


def scaled(*names: str, by: float) -> Callable[[Editable], None]:
    def edit(model: Editable) -> None:
        for name in names:
            model.array(name)[:] *= np.float32(by)

    return edit


def baked_scaled(*keys: str) -> Callable[[Editable], None]:
    def edit(model: Editable) -> None:
        for key in keys:
            scaled(*model.metadata()[key], by=1.01)(model)

    return edit


def two_slots_swapped(model: Editable) -> None:
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        model.array(name)[:] = model.array(name)[:, [1, 0, 2]]


def influences_swapped(model: Editable) -> None:
    for name in ("JOINTS_0", "WEIGHTS_0"):
        model.array(name)[:] = model.array(name)[:, [1, 0, 2, 3]]


def influences_sorted(model: Editable) -> None:
    order = np.argsort(model.array("WEIGHTS_0").astype(float), axis=1, kind="stable")
    for name in ("JOINTS_0", "WEIGHTS_0"):
        model.array(name)[:] = np.take_along_axis(model.array(name), order, axis=1)


def one_negated(model: Editable) -> None:
    alpha = model.array("_SKINBAKE_ALPHA_0")
    # Of a vertex with two influences, this would be as if they were exchanged.
    alpha[np.sort(np.abs(alpha), axis=1)[:, -2].argmax()] *= -1


def one_vertex_of_other_joints(model: Editable) -> None:
    joints = model.array("JOINTS_0")
    joints[0] = (joints[0] + 1) % 3


def indices_reordered(model: Editable) -> None:
    indices = model.array("indices")
    indices[:] = np.roll(indices, 3, axis=0)


def vertices_reordered(model: Editable) -> None:
    order = np.random.default_rng(3).permutation(len(model.array("POSITION")))
    for name in model.primitive()["attributes"]:
        model.array(name)[:] = model.array(name)[order]
    indices = model.array("indices")
    indices[:, 0] = np.argsort(order)[indices[:, 0]]


def triangles_lost(model: Editable) -> None:
    indices = model.array("indices")
    indices[: len(indices) // 6 * 3] = indices[0]


def weights_edited(model: Editable) -> None:
    weights = model.array("WEIGHTS_0")
    edited = weights.astype(float) ** 2
    weights[:] = edited / edited.sum(axis=1, keepdims=True) * weights.sum(axis=1, keepdims=True)


def vertices_moved(model: Editable) -> None:
    positions = model.array("POSITION")
    positions[:, 1] += 0.1 * np.sin(9 * positions[:, 0])


def renamed(model: Editable) -> None:
    attributes = model.primitive()["attributes"]
    attributes["_skinbake_beta_0"] = attributes.pop("_SKINBAKE_BETA_0")


def metadata_removed(model: Editable) -> None:
    del model.primitive()["extras"]


def attributes_removed(model: Editable) -> None:
    attributes = model.primitive()["attributes"]
    for name in [name for name in attributes if name.startswith("_SKINBAKE_")]:
        del attributes[name]


def not_finite(value: float) -> Callable[[Editable], None]:
    def edit(model: Editable) -> None:
        model.array("_SKINBAKE_ALPHA_0")[5, 1] = value

    return edit


def shorter(model: Editable) -> None:
    accessor = model.primitive()["attributes"]["_SKINBAKE_ALPHA_0"]
    model.content["accessors"][accessor]["count"] -= 1


def normal_removed(model: Editable) -> None:
    del model.primitive()["attributes"]["NORMAL"]


def joints_removed(model: Editable) -> None:
    attributes = model.primitive()["attributes"]
    for name in [name for name in attributes if name.startswith(("JOINTS", "WEIGHTS"))]:
        del attributes[name]


def note(key: str, value: Any) -> Callable[[Editable], None]:
    def edit(model: Editable) -> None:
        model.metadata()[key] = value

    return edit


def bind_moved(model: Editable) -> None:
    """Move the joints' pivots, as a tool does that binds the skin in another pose."""
    matrices = model.stored(model.content["skins"][0]["inverseBindMatrices"])
    matrices[1:, 13] += np.float32(0.2 * np.abs(model.array("POSITION")).max())


def hierarchy_flattened(model: Editable) -> None:
    """Let all joints hang from the scene, so that none carries another."""
    joints = set(model.content["skins"][0]["joints"])
    for number in joints:
        model.content["nodes"][number].pop("children", None)
    scene = model.content["scenes"][0]["nodes"]
    model.content["scenes"][0]["nodes"] = [*dict.fromkeys([*scene, *joints])]


def mesh_scaled(by: float) -> Callable[[Editable], None]:
    """Scale the mesh and the bind pose together, as tools do."""

    def edit(model: Editable) -> None:
        scaled("POSITION", by=by)(model)
        matrices = model.stored(model.content["skins"][0]["inverseBindMatrices"])
        matrices[:, :12] /= np.float32(by)

    return edit


UNCHANGED = ["No array of it changed since its bake", "run skinbake bake"]

STALE = {
    "alpha scaled by 1.01": Case(baked_scaled("alpha"), "stale", UNCHANGED),
    "both scaled by 1.01": Case(baked_scaled("alpha", "beta"), "stale", UNCHANGED),
    "two slots swapped": Case(two_slots_swapped, "stale", UNCHANGED),
    "influences swapped": Case(influences_swapped, "stale", ["JOINTS and WEIGHTS changed", "Bake last"]),
    "influences sorted": Case(influences_sorted, "stale", ["JOINTS and WEIGHTS changed", "Bake last"]),
    "one vertex's alpha negated": Case(one_negated, "stale", ["wrong at 1 of", *UNCHANGED]),
    "POSITION doubled": Case(scaled("POSITION", by=2), "stale", ["POSITION changed", "Bake last"]),
    "mesh doubled": Case(mesh_scaled(2), "stale", ["POSITION changed", "Bake last"]),
    "mesh by 1.01": Case(mesh_scaled(1.01), "stale", ["POSITION changed", "Bake last"]),
    "bind pose moved": Case(bind_moved, "stale", ["skeleton changed", "bind pose", "run skinbake bake"]),
    "hierarchy flattened": Case(hierarchy_flattened, "stale", ["skeleton changed", "run skinbake bake"]),
    "POSITION moved": Case(vertices_moved, "stale", ["POSITION changed", "Bake last"]),
    "triangles lost": Case(triangles_lost, "stale", ["indices changed", "Bake last"]),
    "normals flipped": Case(scaled("NORMAL", by=-1), "stale", ["NORMAL changed", "Bake last"]),
    "weights edited": Case(weights_edited, "stale", ["WEIGHTS changed", "Bake last"]),
}
REARRANGED = {
    "indices reordered": (indices_reordered, ["indices"]),
    "vertices reordered": (vertices_reordered, ["POSITION", "NORMAL", "WEIGHTS", "indices"]),
}
BROKEN = {
    "attribute renamed": Case(renamed, "attribute-missing", ["_SKINBAKE_BETA_0", "removed or renamed"]),
    "metadata removed": Case(metadata_removed, "metadata-missing", ["no metadata", "on its source"]),
    "attributes removed": Case(attributes_removed, "attribute-missing", ["_SKINBAKE_ALPHA_0", "removed"]),
    "alpha NaN": Case(not_finite(np.nan), "attribute-not-finite", ["_SKINBAKE_ALPHA_0", "finite"]),
    "alpha infinite": Case(not_finite(np.inf), "attribute-not-finite", ["_SKINBAKE_ALPHA_0", "finite"]),
    "alpha shorter": Case(shorter, "attribute-format", ["_SKINBAKE_ALPHA_0", "expected"]),
    "NORMAL removed": Case(normal_removed, "no-normals", ["it is baked", "NORMAL"]),
    "JOINTS removed": Case(joints_removed, "no-joints", ["it is baked", "JOINTS_0"]),
    "version 2": Case(note("version", 2), "version", ["version 2", "update skinbake"]),
    "version 0": Case(note("version", 0), "version", ["version 0", "run skinbake bake"]),
    "another fit": Case(note("fit", 99), "version", ["version 99 of the fit", "update skinbake"]),
    "fit unknown": Case(note("fit", None), "version", ["fit", "missing"]),
    "fewer influences": Case(note("influences", 12), "metadata-broken", ["influences", "12"]),
    "frame unknown": Case(note("frame", "uv"), "metadata-broken", ["frame", "uv"]),
    "no digest": Case(note("digest", None), "metadata-broken", ["digest", "missing"]),
    "digest of numbers": Case(
        note("digest", {"POSITION": 7}), "metadata-broken", ["digest", "7", "POSITION"]
    ),
}


@pytest.mark.parametrize("case", STALE.values(), ids=STALE.keys())
@pytest.mark.parametrize("name", MODELS)
def test_an_edit_is_stale(bakes: Callable[[str], Path], tmp_path: Path, name: str, case: Case) -> None:
    model = Editable(bakes(name))
    case.edit(model)
    check_failure(model.write(tmp_path / HERE), case, "freshness")


def test_a_skeleton_that_no_fit_can_use_any_more_has_changed(tmp_path: Path) -> None:
    """Inverse bind matrices of zeros are singular, so no joint has a place at rest."""
    model = Editable(baked(source("bent_tube.glb"), tmp_path))
    model.stored(model.content["skins"][0]["inverseBindMatrices"])[:] = 0.0
    answer = verify(model.write(tmp_path / HERE), *FEW)
    assert "freshness" in answer.failed
    (problem,) = answer.problems("freshness")
    assert "The skeleton changed since the bake" in problem["message"]


@pytest.mark.parametrize(
    ("edit", "changed"),
    [
        (indices_reordered, "indices"),
        (vertices_reordered, "POSITION, NORMAL"),
        (one_vertex_of_other_joints, "JOINTS"),
    ],
)
def test_one_wrong_vertex_does_not_hide_what_was_done_to_the_mesh(
    edit: Callable[[Editable], None],
    changed: str,
    bakes: Callable[[str], Path],
    tmp_path: Path,
) -> None:
    """α and β are right at all other vertices, so they moved along with them."""
    model = Editable(bakes("bent_tube.glb"))
    edit(model)
    one_negated(model)
    check_failure(model.write(tmp_path / HERE), Case(edit, "stale", [changed, "Bake last"]), "freshness")


def normals_turned(model: Editable) -> None:
    """Turn the normals about x, at each vertex by another angle."""
    normals = model.array("NORMAL")
    angles = np.sin(9.0 * model.array("POSITION")[:, 0])
    y, z = normals[:, 1].copy(), normals[:, 2].copy()
    normals[:, 1] = np.cos(angles) * y - np.sin(angles) * z
    normals[:, 2] = np.sin(angles) * y + np.cos(angles) * z


def joints_shifted(model: Editable) -> None:
    joints = model.array("JOINTS_0")
    joints[:] = (joints + 1) % 3


@pytest.mark.parametrize(
    ("name", "edits", "changed"),
    [
        (
            "mirrored_tangent.glb",
            (scaled("NORMAL", by=-1), scaled("TANGENT", by=-1)),
            "NORMAL and TANGENT",
        ),
        ("bent_tube.glb", (vertices_moved, normals_turned), "POSITION and NORMAL"),
        ("bent_tube.glb", (joints_shifted, weights_edited), "JOINTS and WEIGHTS"),
        ("bent_tube.glb", (triangles_lost, weights_edited), "indices and WEIGHTS"),
    ],
)
def test_several_edits_are_all_named(
    name: str,
    edits: Sequence[Callable[[Editable], None]],
    changed: str,
    bakes: Callable[[str], Path],
    tmp_path: Path,
) -> None:
    model = Editable(bakes(name))
    for edit in edits:
        edit(model)
    words = [f"{changed} changed since its bake", "Bake last"]
    check_failure(model.write(tmp_path / HERE), Case(edits[0], "stale", words), "freshness")


@pytest.mark.parametrize("case", REARRANGED.values(), ids=REARRANGED.keys())
@pytest.mark.parametrize("name", MODELS)
def test_vertices_in_another_order_pass_with_a_remark(
    bakes: Callable[[str], Path],
    tmp_path: Path,
    name: str,
    case: tuple[Callable[[Editable], None], list[str]],
) -> None:
    edit, changed = case
    model = Editable(bakes(name))
    edit(model)
    answer = verify(model.write(tmp_path / HERE), *FEW)
    assert (answer.exit_code, answer.failed) == (0, [])
    remark = freshness_remark(answer)
    assert remark.endswith(" changed since the bake, and α/β still fit")
    assert all(array in remark for array in changed)
    assert ("POSITION" in remark) == ("POSITION" in changed)


def freshness_remark(answer: Answer) -> str:
    (remark,) = (check["remark"] for check in answer.file["checks"] if check["name"] == "freshness")
    return str(remark)


@pytest.mark.parametrize("is_flat", [True, False])
def test_a_rigid_part_in_another_order_passes_with_a_remark(is_flat: bool, tmp_path: Path) -> None:
    """Its joints and weights are the same in any order, and so are the normals if it is flat."""
    part = sheet()
    arrays = part.attributes
    arrays["WEIGHTS_0"][:] = [1, 0, 0, 0]
    arrays["JOINTS_0"][:] = 0
    if is_flat:
        arrays["POSITION"][:, 2] = 0.0
        arrays["NORMAL"][:] = [0, 0, 1]
    model = Editable(baked(write_model(tmp_path / "rigid.glb", [part]), tmp_path / "baked"))
    vertices_reordered(model)
    answer = verify(model.write(tmp_path / HERE), *FEW)
    assert (answer.exit_code, answer.failed) == (0, []), answer.messages
    assert freshness_remark(answer).endswith(" changed since the bake, and α/β still fit")


@pytest.mark.parametrize("name", ["bent_tube.glb", "weights_u8.glb", CESIUM_MAN])
def test_weights_edited_with_their_digest_are_stale(
    bakes: Callable[[str], Path], tmp_path: Path, name: str
) -> None:
    """The influences from before adoption are still in the file, and α/β fit those."""
    model = Editable(bakes(name))
    weights_edited(model)
    path = model.write(tmp_path / HERE)
    model.metadata()["digest"]["WEIGHTS"] = array_digest(gltf_reading.read(path).influences()[1], "<f4")
    answer = verify(model.write(path), *FEW)
    assert (answer.exit_code, answer.failed) == (1, ["freshness"])
    (problem,) = answer.problems("freshness")
    assert "No array of it changed" in problem["message"]
    assert "α/β are wrong at" in problem["message"]


@pytest.mark.parametrize("case", BROKEN.values(), ids=BROKEN.keys())
@pytest.mark.parametrize("name", MODELS)
def test_what_is_missing_is_named(
    bakes: Callable[[str], Path], tmp_path: Path, name: str, case: Case
) -> None:
    model = Editable(bakes(name))
    case.edit(model)
    check_failure(model.write(tmp_path / HERE), case, "structure")


@pytest.mark.parametrize(
    "older", [{"fit": FIT - 1}, {"gradients": "rig", "fit": 3}, {"gradients": "poses", "fit": 3}]
)
def test_a_fit_of_an_older_version_is_baked_again(
    older: dict[str, Any], bakes: Callable[[str], Path], tmp_path: Path
) -> None:
    model = Editable(bakes("bent_tube.glb"))
    model.metadata().update(older)
    answer = verify(model.write(tmp_path / HERE), *FEW)
    assert answer.exit_code == 1
    assert "of the fit, this skinbake has" in answer.messages
    assert "run skinbake bake" in answer.messages


POSES = {"from": ["animations"], "fingerprint": [1.0], "slots": "0"}


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"version": True}, "version", ["version true", "run skinbake bake"]),
        ({"fit": True}, "version", ["version true of the fit", "run skinbake bake"]),
        ({"fit": 0}, "version", ["version 0 of the fit", "run skinbake bake"]),
        ({"fit": "1"}, "version", ["of the fit", "run skinbake bake"]),
        ({"weld": "scene"}, "metadata-broken", ["\"weld\" is 'scene'"]),
        ({"gradients": "texture"}, "metadata-broken", ["\"gradients\" is 'texture'"]),
        ({"weighting": None}, "metadata-broken", ['"weighting" is missing']),
        ({"creaseAngle": 180.5}, "metadata-broken", ['"creaseAngle" is 180.5']),
        ({"creaseAngle": -1}, "metadata-broken", ['"creaseAngle" is -1']),
        ({"creaseAngle": True}, "metadata-broken", ['"creaseAngle" is true']),
        ({"creaseAngle": "15"}, "metadata-broken", ["\"creaseAngle\" is '15'"]),
        ({"poses": None}, "metadata-broken", ['"poses" is missing']),
        *(
            ({"gradients": "fitted", "poses": {**POSES, **broken}}, "metadata-broken", ['"poses" is {'])
            for broken in (
                {"from": "animations"},
                {"from": [7]},
                {"fingerprint": 7},
                {"fingerprint": ["1"]},
                {"slots": None},
            )
        ),
    ],
)
def test_metadata_that_no_bake_writes_are_told(
    change: Mapping[str, object],
    code: str,
    words: Sequence[str],
    bakes: Callable[[str], Path],
    tmp_path: Path,
) -> None:
    model = Editable(bakes("bent_tube.glb"))
    model.metadata().update(change)
    check_failure(model.write(tmp_path / HERE), Case(metadata_removed, code, words), "structure")


def check_failure(path: Path, case: Case, check: str) -> None:
    answer = verify(path, *FEW)
    assert answer.exit_code == 1
    assert answer.failed == [check]
    (problem,) = answer.problems(check)
    assert problem["code"] == case.code
    assert (problem["mesh"], problem["primitive"]) == (0, 0)
    for word in case.words:
        assert word in problem["message"] or word == problem.get("attribute"), problem
    assert problem["message"] in answer.messages


@pytest.mark.parametrize("name", MODELS)
def test_an_untouched_copy_is_fresh(bakes: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    answer = verify(Editable(bakes(name)).write(tmp_path / HERE), *FEW)
    assert answer.exit_code == 0
    assert answer.failed == []


@pytest.mark.parametrize(
    "weighting",
    [
        *(pytest.param(one, marks=pytest.mark.slow) for one in (Weighting.ANGLE, Weighting.AREA)),
        Weighting.ANGLE_AREA,
    ],
)
@pytest.mark.parametrize("name", MODELS)
def test_a_weighting_falsely_noted_as_max_is_stale(tmp_path: Path, name: str, weighting: Weighting) -> None:
    path = baked(source(name), tmp_path, bake_settings(weighting=weighting))
    assert verify(path, *FEW).exit_code == 0
    model = Editable(path)
    model.metadata()["weighting"] = "max"
    case = Case(note("weighting", "max"), "stale", UNCHANGED)
    check_failure(model.write(tmp_path / HERE), case, "freshness")


@pytest.mark.slow
@pytest.mark.parametrize("noted", ["fitted", "surface"])
@pytest.mark.parametrize("name", MODELS)
def test_gradients_of_another_kind_than_noted_are_stale(
    bakes: Callable[[str], Path], tmp_path: Path, name: str, noted: str
) -> None:
    made = "surface" if noted == "fitted" else "fitted"
    path = baked(source(name), tmp_path, gradients=made)
    assert verify(path, *FEW).exit_code == 0
    model = Editable(path)
    if noted == "fitted":
        fitted = Editable(bakes(name)).metadata()
        model.metadata().update({key: fitted[key] for key in ("gradients", "fit", "rig", "poses")})
    else:
        for key in ("gradients", "fit", "rig", "poses"):
            del model.metadata()[key]
    check_failure(model.write(tmp_path / HERE), Case(note("", None), "stale", UNCHANGED), "freshness")


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_one_percent_of_any_fitted_alpha_is_stale(
    bakes: Callable[[str], Path], tmp_path: Path, name: str
) -> None:
    """One vertex's largest α of a slot, at vertices from the flattest to the steepest.

    Where β is over 4 times as large, a hundredth of α is near what rounding may change.
    """
    whole = Editable(bakes(name))
    alpha, beta = (np.abs(whole.array(f"_SKINBAKE_{kind}_0")) for kind in ("ALPHA", "BETA"))
    steep = np.flatnonzero(alpha.max(axis=1) > np.maximum(0.01 * alpha.max(), 0.25 * beta.max(axis=1)))
    order = steep[alpha[steep].max(axis=1).argsort()]
    for vertex in order[:: max(1, len(order) // 6)]:
        model = Editable(bakes(name))
        model.array("_SKINBAKE_ALPHA_0")[vertex, alpha[vertex].argmax()] *= np.float32(1.01)
        answer = verify(model.write(tmp_path / HERE), "--poses", "rest", "--method", "lbs")
        assert answer.failed == ["freshness"], vertex
        assert f"most at vertex {vertex}" in answer.problems("freshness")[0]["message"]


@pytest.mark.parametrize("name", MODELS)
def test_a_truncated_buffer_cannot_be_read(bakes: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    whole = bakes(name).read_bytes()
    for number, cut in enumerate((whole[:-4000], whole[:1000], whole[:10], b"")):
        path = tmp_path / f"{number}.glb"
        path.write_bytes(cut)
        answer = verify(path)
        assert answer.exit_code == 3
        assert answer.file["error"]["kind"] == "InputError"
        assert answer.messages.startswith(f"error: {path}: ")
    model = Editable(bakes(name))
    model.binary = model.binary[:-4000]
    answer = verify(model.write(tmp_path / HERE))
    assert answer.exit_code == 3
    assert "buffer" in answer.file["error"]["message"].lower()


def test_a_primitive_that_is_not_baked_is_named(bakes: Callable[[str], Path], tmp_path: Path) -> None:
    model = Editable(bakes("two_primitives.glb"))
    attributes = model.primitive(1)["attributes"]
    for name in [name for name in attributes if name.startswith("_SKINBAKE_")]:
        del attributes[name]
    del model.primitive(1)["extras"]
    answer = verify(model.write(tmp_path / HERE), *FEW)
    assert (answer.exit_code, answer.failed) == (1, ["structure"])
    (problem,) = answer.problems("structure")
    assert (problem["code"], problem["primitive"]) == ("metadata-missing", 1)
    assert "is not baked" in problem["message"]


def test_primitives_of_a_mesh_must_be_of_one_bake(bakes: Callable[[str], Path], tmp_path: Path) -> None:
    model = Editable(bakes("two_primitives.glb"))
    model.metadata(1)["weighting"] = "area"
    answer = verify(model.write(tmp_path / HERE), *FEW)
    (problem,) = answer.problems("structure")
    assert (problem["code"], problem["primitive"]) == ("metadata-broken", 1)
    assert "'area'" in problem["message"]


def tangent_removed(model: Editable) -> None:
    del model.primitive()["attributes"]["TANGENT"]


def handedness_flipped(model: Editable) -> None:
    model.array("TANGENT")[:, 3] *= -1


def test_a_bake_for_tangent_needs_it(bakes: Callable[[str], Path], tmp_path: Path) -> None:
    model = Editable(bakes("mirrored_tangent.glb"))
    tangent_removed(model)
    check_failure(
        model.write(tmp_path / HERE),
        Case(tangent_removed, "frame", ["TANGENT", "removed", "Bake last"]),
        "structure",
    )
    model = Editable(bakes("mirrored_tangent.glb"))
    handedness_flipped(model)
    words = ["TANGENT changed", "Bake last"]
    check_failure(model.write(tmp_path / HERE), Case(handedness_flipped, "stale", words), "freshness")


def test_a_skewed_rest_frame_fails(tmp_path: Path) -> None:
    model = Editable(source("mirrored_tangent.glb"))
    model.array("TANGENT")[:, :3] += 0.02 * model.array("NORMAL")
    skewed = model.write(tmp_path / "skewed.glb")
    folder = tmp_path / "baked"
    folder.mkdir()
    answer = verify(baked(skewed, folder, bake_settings(frame=FrameChoice.TANGENT)), *FEW)
    assert (answer.exit_code, answer.failed) == (1, ["structure"])
    (problem,) = answer.problems("structure")
    assert problem["code"] == "tangents-skewed"
    assert problem["count"] == 198
    assert "up to 1.1" in problem["message"]
    # bake's own choice is the other frame, and that is sound.
    assert verify(baked(skewed, folder), *FEW).exit_code == 0


ODD: list[Any] = [None, True, 0, -3, 1.5, 10**400, "", "x", [], [None], [[]], [{}], ["NORMAL"], {}, {"a": []}]
NEEDED = {"version", "frame", "influences", "weighting", "creaseAngle", "digest", "alpha", "beta"}


@pytest.mark.parametrize(
    "key",
    [
        *sorted(NEEDED),
        # A file whose metadata is sound is measured, which takes longer than to see what is wrong.
        *(
            pytest.param(key, marks=pytest.mark.slow)
            for key in ("adopted", "generated", "generator", "keepExtras", "neighbours")
        ),
    ],
)
def test_metadata_of_odd_types_is_told_in_a_sentence(
    bakes: Callable[[str], Path], tmp_path: Path, key: str
) -> None:
    options = VerifyOptions(methods=("lbs",), poses=PoseRequest(PoseKind.RANDOM, 1))
    for number, value in enumerate(ODD):
        model = Editable(bakes("foreign_joints.glb"))
        model.metadata()[key] = value
        path = model.write(tmp_path / f"{number}.glb")
        verdict = FileWork((Verify(options),))(Job(str(path)))
        if key == "creaseAngle" and value in (0, 1.5) and value is not True:
            continue  # an angle as good as any
        if key in NEEDED:
            problems = [problem for check in verdict.checks for problem in check.problems]
            told = str(verdict.error) if verdict.error else problems[0].message
            assert not verdict.passed, (key, value)
            assert len(told) > 20
        elif key != "adopted":
            assert verdict.passed, (key, value)


@pytest.mark.parametrize("digest", ["POSITION", "NORMAL", "JOINTS", "WEIGHTS", "indices"])
def test_every_digest_is_needed(bakes: Callable[[str], Path], tmp_path: Path, digest: str) -> None:
    odd: list[Any] = [None, 5, []]
    for value in odd:
        model = Editable(bakes("bent_tube.glb"))
        model.metadata()["digest"][digest] = value
        answer = verify(model.write(tmp_path / HERE), *FEW)
        assert answer.exit_code == 1
        assert digest in answer.problems("structure")[0]["message"]
    model = Editable(bakes("bent_tube.glb"))
    model.metadata()["digest"][digest] = "0" * 32
    answer = verify(model.write(tmp_path / HERE), *FEW)
    # α and β fit the arrays. Which arrays they were, only the remark asks.
    assert answer.failed == []
    assert freshness_remark(answer) == f"{digest} changed since the bake, and α/β still fit"


def test_the_former_influences_may_be_gone(bakes: Callable[[str], Path], tmp_path: Path) -> None:
    """Another tool drops accessors that nothing uses, and whatever stands at their index is not believed."""
    for name in ("foreign_joints.glb", "two_sets.glb", "weights_u8.glb"):
        model = Editable(bakes(name))
        assert model.metadata()["adopted"]
        model.metadata()["adopted"] = dict.fromkeys(model.metadata()["adopted"], 0)
        answer = verify(model.write(tmp_path / HERE), *FEW)
        assert answer.exit_code == 0, (name, answer.messages)
    model = Editable(bakes("foreign_joints.glb"))
    others = model.stored(model.metadata()["adopted"]["JOINTS_0"])
    others[:] = np.where(others > 0, others - 1, 3)
    assert verify(model.write(tmp_path / HERE), *FEW).exit_code == 0


def test_an_unbaked_file_passes_unless_it_must_be_baked(tmp_path: Path) -> None:
    path = source("bent_tube.glb")
    answer = verify(path)
    assert answer.exit_code == 0
    assert [notice["code"] for notice in answer.file["warnings"]] == ["not-baked"]
    assert answer.file["normals_by_tangents"] is None
    answer = verify(path, "--require-baked")
    assert (answer.exit_code, answer.failed) == (1, ["structure"])
    (problem,) = answer.problems("structure")
    assert problem["code"] == "not-baked"
    assert "run skinbake bake" in problem["message"]
    assert verify(path, "--warnings-as-errors").exit_code == 1


LIMITS = (
    (["--min-gain", "0"], "--min-gain"),
    (["--max-mean-error", "180"], "--max-mean-error"),
    (["--max-p95-error", "180"], "--max-p95-error"),
    (["--max-mean-error", "180", "--min-gain", "0"], "--max-mean-error and --min-gain"),
)
"""Limits that any baked file meets, and their names in a message."""


@pytest.mark.parametrize(("options", "named"), LIMITS)
def test_an_unbaked_file_meets_no_limit(options: list[str], named: str) -> None:
    answer = verify(source("bent_tube.glb"), *options)
    assert (answer.exit_code, answer.failed) == (1, ["limits"])
    (problem,) = answer.problems("limits")
    assert problem["code"] == "not-baked"
    assert problem["message"] == (f"it is not baked, so it cannot meet {named}: run skinbake bake first")
    assert answer.file["warnings"] == []
    assert answer.file["passed"] is False


def test_an_unbaked_file_without_normals_meets_no_limit(tmp_path: Path) -> None:
    model = Editable(source("bent_tube.glb"))
    del model.primitive()["attributes"]["NORMAL"]
    path = model.write(tmp_path / HERE)
    answer = verify(path, "--min-gain", "0")
    assert (answer.exit_code, answer.failed) == (1, ["limits"])
    (problem,) = answer.problems("limits")
    assert "run skinbake bake --generate-normals first" in problem["message"]
    assert [notice["code"] for notice in answer.file["warnings"]] == ["no-normals"]


def test_skinned_points_have_no_lighting_to_limit(tmp_path: Path) -> None:
    model = Editable(source("bent_tube.glb"))
    model.primitive()["mode"] = 0
    assert verify(model.write(tmp_path / HERE), "--min-gain", "0").exit_code == 0


def test_a_file_without_skins_passes_unless_it_must_be_baked(tmp_path: Path) -> None:
    model = Editable(source("bent_tube.glb"))
    del model.content["skins"], model.content["nodes"][0]["skin"]
    for node in model.content["nodes"]:
        node.pop("skin", None)
    path = model.write(tmp_path / HERE)
    assert verify(path).exit_code == 0
    assert verify(path, "--min-gain", "9", "--max-mean-error", "0").exit_code == 0
    assert verify(path, "--require-baked").exit_code == 1
    (tmp_path / "empty.gltf").write_text(json.dumps({"asset": {"version": "2.0"}}))
    assert verify(tmp_path / "empty.gltf").exit_code == 0
    assert verify(tmp_path / "empty.gltf", "--require-baked").exit_code == 1


def test_vrm_is_read_as_glb(bakes: Callable[[str], Path], tmp_path: Path) -> None:
    model = Editable(bakes("bent_tube.glb"))
    assert verify(model.write(tmp_path / "avatar.vrm"), *FEW).exit_code == 0
    scaled("_SKINBAKE_ALPHA_0", by=1.01)(model)
    assert verify(model.write(tmp_path / "avatar.vrm"), *FEW).exit_code == 1
