"""``bake --blend``: the gradient of weights between linear blending and dual quaternions, and its readers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from fixtures.make_fixtures import FOLDER
from tests.support import gltf_reading, gltf_transform, khronos
from tests.support.baked_files import Editable, verify
from tests.support.blended_files import NAME, waves, with_blend_weights
from tests.support.command_line import invoke
from tests.support.compressed import draco_twin, meshopt_twin

TUBE = FOLDER / "bent_tube.glb"
GRADIENT = "_SKINBAKE_BLEND"


def bake(source: Path, target: Path, *options: str, code: int = 0) -> str:
    result = invoke("bake", source, "-o", target, "--blend", NAME, *options)
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def of_joint(path: Path, joint: int) -> tuple[Any, Any]:
    """The derivatives (V, 2) of one joint's weight as α and β hold them, and the weight itself (V,)."""
    file = gltf_reading.read(path)
    joints, weights = file.influences()
    found = []
    for kind in ("ALPHA", "BETA"):
        others = file.attribute(f"_SKINBAKE_{kind}_0")
        every = np.concatenate([-others.sum(axis=1, keepdims=True), others], axis=1)
        found.append(np.where(joints == joint, every, 0.0).sum(axis=1))
    return np.stack(found, axis=1), np.where(joints == joint, weights, 0.0).sum(axis=1)


@pytest.mark.parametrize("options", [(), ("--weighting", "area"), ("--crease-angle", "5")], ids=" ".join)
@pytest.mark.parametrize("name", ["bent_tube.glb", "hard_edge.glb", "seam.glb", "mirrored_tangent.glb"])
def test_the_gradient_of_a_joint_s_weight_is_the_one_that_alpha_and_beta_hold(
    tmp_path: Path, name: str, options: tuple[str, ...]
) -> None:
    """The same welds, hard edges, means over triangles and frames: a blend weight that is a skin weight."""
    plain = tmp_path / "plain.glb"
    options = ("--gradients", "surface", *options)
    assert invoke("bake", FOLDER / name, "-o", plain, *options).exit_code == 0
    expected, weight = of_joint(plain, 1)
    given = with_blend_weights(FOLDER / name, tmp_path / "in.glb", lambda _: weight)
    bake(given, tmp_path / "out.glb", *options)
    found = gltf_reading.read(tmp_path / "out.glb").attribute(GRADIENT)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["glb", "gltf", "draco", "meshopt"])
def test_strip_gives_the_input_back_and_a_second_bake_changes_nothing(tmp_path: Path, kind: str) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb")
    # glTF wants SCALAR, which the tests' own writer of attributes of one component gives.
    assert gltf_reading.read(given).attribute(NAME).shape[1] == 1
    if kind == "draco":
        given = draco_twin(given, tmp_path / "draco.glb")
    elif kind == "meshopt":
        given = meshopt_twin(given, tmp_path / "meshopt.glb")
    elif kind == "gltf":
        content = gltf_reading.read(given)
        (tmp_path / "in.bin").write_bytes(content.binary_chunk or b"")
        content.content["buffers"][0]["uri"] = "in.bin"
        given = tmp_path / "in.gltf"
        given.write_text(json.dumps(content.content, indent=2))
    made, again, back = (tmp_path / f"{name}{given.suffix}" for name in ("made", "again/made", "back"))
    bake(given, made)
    bake(made, again)
    assert again.read_bytes() == made.read_bytes()
    assert not verify(made).failed
    assert invoke("strip", made, "-o", back).exit_code == 0
    assert back.read_bytes() == given.read_bytes()
    assert not khronos.new_findings(khronos.validate(given), khronos.validate(made))
    plain = tmp_path / f"plain{given.suffix}"
    assert invoke("bake", made, "-o", plain).exit_code == 0
    assert GRADIENT not in gltf_reading.read(plain).primitive(0)["attributes"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        "--layout texcoord",
        "--layout custom --encoding snorm16",
        "--encoding packed8 --neighbours extend",
        "--gradients fitted --fit-poses random:3 --weld skin",
    ],
)
def test_a_blend_goes_with_every_kind_of_alpha_and_beta(tmp_path: Path, options: str) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb")
    bake(given, tmp_path / "out.glb", *options.split())
    answer = verify(tmp_path / "out.glb", "--method", "blend")
    assert not answer.failed
    assert answer.file["normals_by_tangents"]["blend"]["gain"] > 10
    assert invoke("strip", tmp_path / "out.glb", "-o", tmp_path / "back.glb").exit_code == 0
    assert (tmp_path / "back.glb").read_bytes() == given.read_bytes()


def test_alpha_and_beta_are_those_of_a_bake_without_a_blend(tmp_path: Path) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb")
    bake(given, tmp_path / "out.glb")
    assert invoke("bake", given, "-o", tmp_path / "plain.glb").exit_code == 0
    both = [gltf_reading.read(tmp_path / name) for name in ("out.glb", "plain.glb")]
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        np.testing.assert_array_equal(both[0].attribute(name), both[1].attribute(name))
    made = both[0].content["accessors"][both[0].primitive(0)["attributes"][GRADIENT]]
    assert (made["type"], made["componentType"]) == ("VEC2", 5126)
    note = both[0].primitive(0)["extras"]["skinbake"]
    assert note["blend"] == {"weights": NAME, "gradient": GRADIENT}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["every", "blend"])
def test_verify_measures_the_blended_surface(tmp_path: Path, method: str) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb")
    bake(given, tmp_path / "out.glb")
    options = () if method == "every" else ("--method", "blend")
    answer = verify(tmp_path / "out.glb", *options)
    found = answer.file["normals_by_tangents"]
    assert set(found) == ({"lbs", "dqs", "blend"} if method == "every" else {"blend"})
    blend = found["blend"]
    assert blend["accurate"]["mean"] < 0.1
    assert blend["standard"]["mean"] > 2.0
    # Without the gradient of the weights, α and β alone leave twice the error at least.
    file = Editable(tmp_path / "out.glb")
    file.array(GRADIENT)[:] = 0.0
    answer = verify(file.write(tmp_path / "flat.glb"), *options)
    assert answer.file["normals_by_tangents"]["blend"]["accurate"]["mean"] > 2 * blend["accurate"]["mean"]
    assert answer.failed == ["freshness"]


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_constant_blend_weights_of_0_and_1_have_the_figures_of_one_method(
    tmp_path: Path, weight: float
) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb", lambda positions: np.full(len(positions), weight))
    bake(given, tmp_path / "out.glb")
    found = verify(tmp_path / "out.glb").file["normals_by_tangents"]
    other = found["dqs"]["exact"] if weight else found["lbs"]["accurate"]
    for key in ("mean", "p95", "max"):
        assert found["blend"]["accurate"][key] == pytest.approx(other[key], abs=1e-5)
        standard = found["dqs" if weight else "lbs"]["standard"]
        assert found["blend"]["standard"][key] == pytest.approx(standard[key], abs=1e-5)


def test_normals_of_a_pose_are_dumped_for_a_blend_too(tmp_path: Path) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb")
    bake(given, tmp_path / "out.glb")
    (posed,) = skinbake.normals(tmp_path / "out.glb", "bend", 0.5, methods=["blend"])
    assert set(posed.normals) == {"standard", "accurate"}
    truth, found = posed.truths["tangents"], posed.normals["accurate"]
    cosine = np.einsum("vi,vi->v", truth, found)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 0.2
    assert invoke("bake", given, "-o", tmp_path / "plain.glb").exit_code == 0
    with pytest.raises(skinbake.InputError, match="run skinbake bake --blend"):
        skinbake.normals(tmp_path / "plain.glb", "bend", 0.5, methods=["blend"])


def test_a_file_without_a_blend_is_not_measured_as_one(tmp_path: Path) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb")
    assert invoke("bake", given, "-o", tmp_path / "plain.glb").exit_code == 0
    assert set(verify(tmp_path / "plain.glb").file["normals_by_tangents"]) == {"lbs", "dqs"}
    answer = verify(tmp_path / "plain.glb", "--method", "blend")
    assert answer.exit_code == 3
    assert "run skinbake bake --blend" in " ".join(answer.messages.split())


def edit_weights(file: Editable) -> None:
    file.array(NAME)[100:200] *= 0.5


def edit_gradient(file: Editable) -> None:
    file.array(GRADIENT)[7] += 1.0


def drop_weights(file: Editable) -> None:
    del file.primitive()["attributes"][NAME]


def drop_gradient(file: Editable) -> None:
    del file.primitive()["attributes"][GRADIENT]


def break_gradient(file: Editable) -> None:
    file.array(GRADIENT)[3] = np.nan


def break_note(file: Editable) -> None:
    file.metadata()["blend"] = {"weights": NAME}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "check", "code"),
    [
        pytest.param(edit_weights, "freshness", "stale", marks=pytest.mark.slow),
        (edit_gradient, "freshness", "stale"),
        (drop_weights, "structure", "attribute-missing"),
        (drop_gradient, "structure", "attribute-missing"),
        (break_gradient, "structure", "attribute-not-finite"),
        (break_note, "structure", "metadata-broken"),
    ],
)
def test_what_a_later_tool_breaks_of_a_blend_is_a_problem(
    tmp_path: Path, edit: Callable[[Editable], None], check: str, code: str
) -> None:
    bake(with_blend_weights(TUBE, tmp_path / "in.glb"), tmp_path / "out.glb")
    file = Editable(tmp_path / "out.glb")
    edit(file)
    answer = verify(file.write(tmp_path / "edited.glb"))
    assert answer.failed == [check]
    (problem,) = answer.problems(check)
    assert problem["code"] == code
    if code == "stale":
        assert f"--blend {NAME}" in problem["message"]
        assert 1 <= problem["count"] < 400


@pytest.mark.slow
def test_vertices_in_another_order_keep_a_blend_fresh(tmp_path: Path) -> None:
    bake(with_blend_weights(TUBE, tmp_path / "in.glb"), tmp_path / "out.glb")
    jobs = [(tmp_path / "out.glb", tmp_path / "moved.glb", "reorder")]
    assert gltf_transform.transform(jobs) == [""]
    answer = verify(tmp_path / "moved.glb")
    assert not answer.failed
    assert answer.file["normals_by_tangents"]["blend"]["accurate"]["mean"] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_normalised_integers_are_read_as_0_to_1(tmp_path: Path, kind: type[np.unsignedinteger[Any]]) -> None:
    file = Editable(TUBE)
    weights = waves(file.array("POSITION").astype(np.float64))
    most = np.iinfo(kind).max
    stored = np.round(weights * most).astype(kind)
    padded = np.zeros((len(stored), 4 // stored.itemsize), kind)  # glTF aligns each element of a vertex
    padded[:, 0] = stored
    accessor = file.add(padded.view(np.float32))
    described = file.content["accessors"][accessor]
    described |= {"componentType": 5121 if kind is np.uint8 else 5123, "normalized": True, "type": "SCALAR"}
    file.content["bufferViews"][-1]["byteStride"] = 4
    file.primitive()["attributes"][NAME] = accessor
    bake(file.write(tmp_path / "in.glb"), tmp_path / "out.glb")
    same = with_blend_weights(TUBE, tmp_path / "same.glb", lambda _: stored / most)
    bake(same, tmp_path / "same-out.glb")
    both = [gltf_reading.read(tmp_path / name).attribute(GRADIENT) for name in ("out.glb", "same-out.glb")]
    np.testing.assert_allclose(both[0], both[1], atol=1e-5)
    assert not verify(tmp_path / "out.glb").failed


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (lambda p: np.where(np.arange(len(p)) == 5, 1.5, 0.5), "it is 1.5 at vertex 5, expected 0"),
        (lambda p: np.where(np.arange(len(p)) == 5, np.nan, 0.5), "blend weights are not all finite"),
        (lambda p: np.full(len(p), -0.1), "The number of such vertices is 1,518"),
    ],
)
def test_weights_outside_0_to_1_are_errors(tmp_path: Path, weights: Any, message: str) -> None:
    given = with_blend_weights(TUBE, tmp_path / "in.glb", weights)
    said = bake(given, tmp_path / "out.glb", code=3)
    assert message in said
    assert 'mesh 0 "tube", primitive 0' in said
    assert not (tmp_path / "out.glb").exists()


def as_vec3(file: Editable) -> None:
    file.primitive()["attributes"][NAME] = file.primitive()["attributes"]["POSITION"]


def as_integers(file: Editable) -> None:
    file.primitive()["attributes"][NAME] = file.primitive()["indices"]


def as_another_count(file: Editable) -> None:
    file.primitive()["attributes"][NAME] = file.add(np.zeros((7, 1), np.float32))


def nowhere(file: Editable) -> None:
    del file.primitive()["attributes"][NAME]


def beside_a_gradient(file: Editable) -> None:
    file.primitive()["attributes"][GRADIENT] = file.add(np.zeros((1518, 2), np.float32))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (as_vec3, "it has 3 components, 1 are needed"),
        (as_integers, "8,640 elements, POSITION has 1,518"),
        (as_another_count, "it has 7 elements, POSITION has 1,518"),
        (nowhere, f"--blend {NAME}: nothing that is baked has this attribute"),
        (beside_a_gradient, f"it already has an attribute {GRADIENT}"),
    ],
)
def test_attributes_that_are_not_blend_weights_are_errors(
    tmp_path: Path, edit: Callable[[Editable], None], message: str
) -> None:
    file = Editable(with_blend_weights(TUBE, tmp_path / "in.glb"))
    edit(file)
    assert message in bake(file.write(tmp_path / "edited.glb"), tmp_path / "out.glb", code=3)


def test_a_surface_has_blend_weights_everywhere_or_nowhere(tmp_path: Path) -> None:
    given = with_blend_weights(FOLDER / "two_primitives.glb", tmp_path / "in.glb", without=(1,))
    said = bake(given, tmp_path / "out.glb", code=3)
    assert f"primitive 1: it has no attribute {NAME}, and other primitives of the same surface" in said


@pytest.mark.slow
def test_a_mesh_without_blend_weights_is_left_to_linear_blending_with_a_notice(tmp_path: Path) -> None:
    file = Editable(with_blend_weights(TUBE, tmp_path / "in.glb"))
    other = json.loads(json.dumps(file.content["meshes"][0]))
    del other["primitives"][0]["attributes"][NAME]
    file.content["meshes"].append(other)
    node = next(one for one in file.content["nodes"] if one.get("mesh") == 0)
    # Elsewhere: the truths take meshes of one skin as one surface.
    positions = file.array("POSITION") + np.float32(5.0)
    other["primitives"][0]["attributes"]["POSITION"] = file.add(positions)
    file.content["nodes"].append({"mesh": 1, "skin": node["skin"]})
    file.content["scenes"][0]["nodes"].append(len(file.content["nodes"]) - 1)
    result = invoke(
        "bake", "--json", file.write(tmp_path / "two.glb"), "-o", tmp_path / "out.glb", "--blend", NAME
    )
    assert result.exit_code == 0
    (notice,) = [
        one for one in json.loads(result.stdout)["files"][0]["warnings"] if one["code"] == "no-blend"
    ]
    assert notice["mesh"] == 1
    by_primitive = verify(tmp_path / "out.glb").file["primitives"]
    figures = [one["normals_by_tangents"] for one in by_primitive]
    assert figures[1]["blend"]["accurate"]["mean"] == pytest.approx(
        figures[1]["lbs"]["accurate"]["mean"], abs=1e-6
    )
    assert figures[0]["blend"]["standard"]["mean"] != figures[0]["lbs"]["standard"]["mean"]
    # A shader for the file serves the blended mesh, and says so of the other.
    result = invoke("shader", "--lang", "glsl", "--method", "blend", "--for", tmp_path / "out.glb")
    assert result.exit_code == 0
    assert f"     {NAME} " in result.stdout and f"     {GRADIENT} " in result.stdout
    assert "it is baked without --blend" in " ".join(result.stderr.split())


def test_inspect_names_the_attribute(tmp_path: Path) -> None:
    bake(with_blend_weights(TUBE, tmp_path / "in.glb"), tmp_path / "out.glb")
    told = invoke("inspect", tmp_path / "out.glb").stdout
    assert f"blend weights {NAME}" in told and "up to date" in told
    file = Editable(tmp_path / "out.glb")
    drop_gradient(file)
    told = invoke("inspect", file.write(tmp_path / "lost.glb")).stdout
    assert f"{GRADIENT} changed since: bake again" in told


def test_a_name_that_gltf_does_not_allow_is_wrong_usage(tmp_path: Path) -> None:
    result = invoke("bake", TUBE, "-o", tmp_path / "out.glb", "--blend", "BLEND")
    assert result.exit_code == 2
    assert "begins with an underscore" in result.stderr


def test_a_shader_of_a_blend_needs_a_file_with_one(tmp_path: Path) -> None:
    assert invoke("bake", TUBE, "-o", tmp_path / "plain.glb").exit_code == 0
    result = invoke("shader", "--lang", "wgsl", "--method", "blend", "--for", tmp_path / "plain.glb")
    assert result.exit_code == 3
    assert "does not fit --method blend: it is baked without --blend" in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--target", "three"), "--method blend needs --target plain"),
        (("--lang", "glsl", "--lighting", "exact"), "blend has no exact lighting; take standard or accurate"),
        (("--lang", "glsl", "--stage", "compute"), "--method blend contradicts --stage compute"),
        (
            ("--lang", "glsl", "--normal-map"),
            "--method blend contradicts --normal-map: leave it out, or light the mesh by --method lbs or dqs",
        ),
        (("--lang", "glsl", "--lighting", "standard", "--scaled-joints"), "needs --method blend --lighting"),
    ],
)
def test_what_blended_skinning_has_no_text_for_is_refused(options: tuple[str, ...], message: str) -> None:
    result = invoke("shader", "--method", "blend", *options)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())


def test_a_file_whose_joints_scale_gets_the_text_for_them(tmp_path: Path) -> None:
    """Also by one scale that all share: linear blending takes a vertex as it is."""
    file = Editable(with_blend_weights(TUBE, tmp_path / "in.glb"))
    bake(file.write(tmp_path / "in.glb"), tmp_path / "out.glb")
    command = ("shader", "--lang", "wgsl", "--method", "blend", "--for")
    assert "skinbake_blend_accurate(" in invoke(*command, tmp_path / "out.glb").stdout
    skin = file.content["skins"][0]
    file.stored(skin["inverseBindMatrices"])[:, [0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14]] *= 2.0
    bake(file.write(tmp_path / "in.glb"), tmp_path / "out.glb")
    assert "skinbake_blend_scaled(" in invoke(*command, tmp_path / "out.glb").stdout
    result = invoke(*command, tmp_path / "out.glb", "--lighting", "standard")
    assert result.exit_code == 3
    assert "use --lighting accurate" in " ".join(result.stderr.split())
