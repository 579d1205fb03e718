"""``bake --morph-normals`` and ``--morph-frames``: what morph targets that only move points lack."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from hypothesis import given
from hypothesis import strategies as st

import skinbake
from fixtures.make_fixtures import FOLDER
from skinbake.format.morph_targets import morph_digest
from skinbake.geometry.morphs import Differences
from skinbake.geometry.skinned import SkinnedPrimitive
from tests.support import corpus, gltf_reading, gltf_transform, khronos
from tests.support.baked_files import Editable, verify
from tests.support.characters import Array, angles
from tests.support.command_line import invoke
from tests.support.compressed import draco_twin, meshopt_twin
from tests.support.morphed_files import morphed, warped

TUBE = FOLDER / "bent_tube.glb"


def bake(source: Path, target: Path, *options: str, code: int = 0) -> str:
    result = invoke("bake", source, "-o", target, *options)
    assert result.exit_code == code, result.output
    return result.output


def without_normals(path: Path, target: Path, *, keep: int = 0, **changes: Any) -> Path:
    """A model with two morph targets, of which only the first ``keep`` have NORMAL."""
    file = Editable(morphed(path, target, **changes))
    for one in file.primitive()["targets"][keep:]:
        del one["NORMAL"]
    return file.write(target)


def with_zero_normals(path: Path, target: Path, *, kind: str = "float", keep: int = 0) -> Path:
    """A model with two morph targets whose NORMAL is zeros, but for the first ``keep``, in its first clip.

    The zeros are of one accessor: floats, bytes, or an accessor without a buffer view. A third target moves
    all points alike, and its zeros are right.
    """
    file = Editable(morphed(path, target, weights=[0.8, 0.5, 0.0]))
    count = file.content["accessors"][file.primitive()["attributes"]["POSITION"]]["count"]
    zeros = file.add(np.zeros((count, 3), np.float32))
    accessor = file.content["accessors"][zeros]
    if kind == "bytes":
        accessor |= {"componentType": 5120, "normalized": True}
        file.content["bufferViews"][-1]["byteStride"] = 4
        file.content["extensionsUsed"] = file.content["extensionsRequired"] = ["KHR_mesh_quantization"]
    elif kind == "no view":
        del accessor["bufferView"]
        file.content["bufferViews"].pop()
    targets = file.primitive()["targets"]
    targets.append({"NORMAL": zeros, "POSITION": file.add(np.ones((count, 3), np.float32))})
    for one in targets[keep:]:
        one["NORMAL"] = zeros
    return file.write(target)


def unskinned(path: Path) -> Path:
    """Take the skin of a model's first mesh away, with its joints, weights and clips."""
    file = Editable(path)
    for node in file.content["nodes"]:
        node.pop("skin", None)
    for primitive in file.content["meshes"][0]["primitives"]:
        for name in ("JOINTS_0", "WEIGHTS_0"):
            del primitive["attributes"][name]
    for name in ("skins", "animations"):
        file.content.pop(name, None)
    return file.write(path)


def made_normals(path: Path, number: int) -> Array:
    """The unit normals of the first primitive with one target at weight 1."""
    file = gltf_reading.read(path)
    accessor = file.primitive(0)["targets"][number]["NORMAL"]
    total = file.attribute("NORMAL") + file.values(accessor)
    normals: Array = total / np.linalg.norm(total, axis=1, keepdims=True)
    return normals


def warped_normals(path: Path, number: int) -> Array:
    file = gltf_reading.read(path)
    normals = file.attribute("NORMAL")
    warped_ones: Array = normals + warped(file.attribute("POSITION"), normals, number)[1]
    return warped_ones


@pytest.mark.parametrize("skinned", [True, False])
def test_made_normals_are_those_of_the_moved_surface(tmp_path: Path, skinned: bool) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb")
    if not skinned:
        unskinned(source)
    bake(source, tmp_path / "out.glb", "--morph-normals")
    for number in (0, 1):
        truth, found = warped_normals(source, number), made_normals(tmp_path / "out.glb", number)
        before = angles(gltf_reading.read(source).attribute("NORMAL"), truth).mean()
        assert before > 2.0
        assert angles(found, truth).mean() < before / 10


@pytest.mark.parametrize(
    ("suffix", "kind", "options"),
    [
        pytest.param(
            suffix, kind, options, marks=[pytest.mark.slow] if suffix == ".gltf" or len(options) == 1 else []
        )
        for suffix in (".glb", ".gltf")
        for kind in ("skinned", "plain", "draco", "meshopt")
        for options in (("--morph-normals",), ("--morph-frames",), ("--morph-normals", "--morph-frames"))
        if kind != "plain" or options == ("--morph-normals",)
    ],
)
def test_strip_gives_the_input_back_and_a_second_bake_changes_nothing(
    tmp_path: Path, kind: str, suffix: str, options: tuple[str, ...]
) -> None:
    given = without_normals(TUBE, tmp_path / "in.glb")
    if kind == "plain":
        unskinned(given)
    elif kind == "draco":
        given = draco_twin(given, tmp_path / "draco.glb")
    elif kind == "meshopt":
        given = meshopt_twin(given, tmp_path / "meshopt.glb")
    if suffix == ".gltf":
        content = gltf_reading.read(given)
        (tmp_path / "in.bin").write_bytes(content.binary_chunk or b"")
        content.content["buffers"][0]["uri"] = "in.bin"
        given = tmp_path / "in.gltf"
        given.write_text(json.dumps(content.content, indent=2))
    made, again, back = (tmp_path / f"{name}{suffix}" for name in ("made", "again/made", "back"))
    said = bake(given, made, *options)
    if "--morph-normals" in options:
        assert "NORMAL made for 2 morph targets of 1 primitive" in said
    if "--morph-frames" in options:
        assert f"{6 if len(options) == 1 else 4} numbers of the differential for 2 morph targets" in said
    bake(made, again, *options)
    assert again.read_bytes() == made.read_bytes()
    assert invoke("strip", made, "-o", back).exit_code == 0
    assert back.read_bytes() == given.read_bytes()
    assert not khronos.new_findings(khronos.validate(given), khronos.validate(made))


def test_each_target_gets_one_once_another_has_it_and_authored_ones_stay(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb", keep=1)
    bake(source, tmp_path / "out.glb", "--morph-normals")
    before, after = (
        gltf_reading.read(tmp_path / name).primitive(0)["targets"] for name in ("in.glb", "out.glb")
    )
    assert after[0] == before[0]
    assert [set(one) for one in after] == [{"POSITION", "NORMAL"}] * 2
    note = gltf_reading.read(tmp_path / "out.glb").content["meshes"][0]["extras"]["skinbake"]
    assert note["morphTargets"][0]["normals"] == [1]
    bake(tmp_path / "out.glb", tmp_path / "plain.glb")
    assert gltf_reading.read(tmp_path / "plain.glb").primitive(0)["targets"] == before


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["float", "bytes", "no view"])
@pytest.mark.parametrize("skinned", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_zeros_in_normal_where_points_move_count_as_no_normal(
    tmp_path: Path, kind: str, skinned: bool
) -> None:
    source = with_zero_normals(TUBE, tmp_path / "in.glb", kind=kind)
    twin = without_normals(TUBE, tmp_path / "twin.glb")
    if not skinned:
        unskinned(source)
    assert "NORMAL made for 2 morph targets" in bake(source, tmp_path / "out.glb", "--morph-normals") + (
        "" if skinned else "NORMAL made for 2 morph targets"
    )
    bake(twin, tmp_path / "other.glb", "--morph-normals")
    for number in (0, 1):
        found, expected = (made_normals(tmp_path / name, number) for name in ("out.glb", "other.glb"))
        np.testing.assert_array_equal(found, expected)
    before, after = (
        gltf_reading.read(tmp_path / name).primitive(0)["targets"] for name in ("in.glb", "out.glb")
    )
    assert after[2] == before[2]
    invoke("strip", tmp_path / "out.glb", "-o", tmp_path / "back.glb")
    assert (tmp_path / "back.glb").read_bytes() == source.read_bytes()
    bake(tmp_path / "out.glb", tmp_path / "again.glb", "--morph-normals")
    assert (tmp_path / "again.glb").read_bytes() == (tmp_path / "out.glb").read_bytes()


@pytest.mark.slow
def test_bake_and_verify_tell_of_zeros_in_normal_as_of_no_normal(tmp_path: Path) -> None:
    source = with_zero_normals(TUBE, tmp_path / "in.glb", keep=1)
    twin = without_normals(TUBE, tmp_path / "twin.glb", keep=1, weights=[0.8, 0.5])
    found = []
    for name in (source, twin):
        result = json.loads(invoke("bake", "--json", name, "-o", tmp_path / "out.glb").stdout)
        (told,) = [one["message"] for one in result["files"][0]["warnings"] if one["code"] == "morph-normals"]
        figures = verify(tmp_path / "out.glb", "--poses", "rest").file["normals_by_tangents"]["lbs"]
        found.append((told.split(" is ")[1], figures["standard"]["mean"], figures["accurate"]["mean"]))
    assert found[0] == found[1]


@pytest.mark.slow
def test_strip_takes_made_normals_out_where_a_tool_has_removed_the_zeros(tmp_path: Path) -> None:
    source = with_zero_normals(TUBE, tmp_path / "in.glb")
    bake(source, tmp_path / "out.glb", "--morph-normals")
    assert gltf_transform.transform([(tmp_path / "out.glb", tmp_path / "other.glb", "prune")]) == [""]
    invoke("strip", tmp_path / "other.glb", "-o", tmp_path / "back.glb")
    file = gltf_reading.read(tmp_path / "back.glb")
    for target in file.primitive(0)["targets"]:
        assert "NORMAL" not in target or not file.values(target["NORMAL"]).any()


def test_a_target_that_turns_nothing_costs_no_bytes_and_few_vertices_are_sparse(tmp_path: Path) -> None:
    file = Editable(TUBE)
    positions = file.array("POSITION").copy()
    few, rigid = np.zeros_like(positions), np.ones_like(positions)
    few[:3] = 0.05
    file.primitive()["targets"] = [{"POSITION": file.add(few)}, {"POSITION": file.add(rigid)}]
    bake(file.write(tmp_path / "in.glb"), tmp_path / "out.glb", "--morph-normals")
    made = gltf_reading.read(tmp_path / "out.glb")
    first, second = (made.content["accessors"][one["NORMAL"]] for one in made.primitive(0)["targets"])
    assert 3 <= first["sparse"]["count"] < len(positions) / 4
    assert "bufferView" not in second and "sparse" not in second


def test_without_the_option_a_warning_says_what_is_lost(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb")
    truth = np.concatenate([warped_normals(source, number) for number in (0, 1)])
    lost = angles(np.tile(gltf_reading.read(source).attribute("NORMAL"), (2, 1)), truth).mean()
    result = json.loads(invoke("bake", "--json", source, "-o", tmp_path / "out.glb").stdout)
    (found,) = [one for one in result["files"][0]["warnings"] if one["code"] == "morph-normals"]
    assert found["count"] == 2
    told = float(found["message"].split(" is ")[1].split("°")[0])
    assert told == pytest.approx(lost, rel=0.1)
    whole = morphed(TUBE, tmp_path / "whole.glb")
    result = json.loads(invoke("bake", "--json", whole, "-o", tmp_path / "out.glb").stdout)
    assert "morph-normals" not in [one["code"] for one in result["files"][0]["warnings"]]


def test_targets_without_normal_are_advice_that_fails_no_build(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb")
    result = invoke("bake", "--warnings-as-errors", source, "-o", tmp_path / "out.glb")
    assert result.exit_code == 0
    assert "note: " in result.stderr and "--morph-normals adds NORMAL" in " ".join(result.stderr.split())
    assert "warning" not in result.output
    model = pygltflib.GLTF2().load(str(source))
    assert skinbake.bake(model, warnings_as_errors=True) != model


@pytest.mark.slow
def test_verify_measures_the_gain(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb", weights=[0.8, 0.5])
    errors = []
    for options in ((), ("--morph-normals",)):
        bake(source, tmp_path / "out.glb", *options)
        answer = verify(tmp_path / "out.glb", "--poses", "rest")
        errors.append(answer.file["normals_by_tangents"]["lbs"]["standard"]["mean"])
    assert errors[0] > 2.0
    assert errors[1] < errors[0] / 5


@pytest.mark.slow
def test_edited_targets_make_them_stale_and_inspect_and_verify_say_so(tmp_path: Path) -> None:
    for name, prepare in (("skinned", lambda path: path), ("plain", unskinned)):
        source = prepare(without_normals(TUBE, tmp_path / f"{name}.glb"))
        baked = tmp_path / f"{name}-baked.glb"
        bake(source, baked, "--morph-normals")
        assert "2 morph targets: NORMAL made for 2, up to date" in invoke("inspect", baked).stdout
        assert "morphs-stale" not in invoke("verify", "--json", baked).stdout
        file = Editable(baked)
        file.stored(file.primitive()["targets"][1]["POSITION"])[:] *= 2.0
        file.write(baked)
        assert "POSITION or NORMAL changed since: bake again" in invoke("inspect", baked).stdout
        found = invoke("verify", "--json", baked)
        assert "morphs-stale" in found.stdout
        assert found.exit_code == (1 if name == "skinned" else 0)


def test_broken_targets_stop_a_bake_only_if_they_are_asked_for(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb")
    file = Editable(source)
    file.content["accessors"][file.primitive()["targets"][0]["POSITION"]]["count"] -= 1
    file.write(source)
    bake(source, tmp_path / "out.glb")
    assert "POSITION of morph target 0" in bake(source, tmp_path / "out.glb", "--morph-normals", code=3)


def test_extras_of_another_kind_leave_no_place_and_the_file_is_refused(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb")
    file = Editable(source)
    file.content["meshes"][0]["extras"] = "mine"
    file.write(source)
    assert "leave no place for the metadata" in bake(source, tmp_path / "out.glb", "--morph-normals", code=3)


def test_empty_extras_stay_and_names_of_targets_too(tmp_path: Path) -> None:
    for extras in ({}, {"targetNames": ["a", "b"]}):
        source = without_normals(TUBE, tmp_path / "in.glb")
        file = Editable(source)
        file.content["meshes"][0]["extras"] = extras
        file.write(source)
        bake(source, tmp_path / "out.glb", "--morph-normals")
        invoke("strip", tmp_path / "out.glb", "-o", tmp_path / "back.glb")
        assert (tmp_path / "back.glb").read_bytes() == source.read_bytes()


def test_a_flat_mesh_without_a_skin_gets_none_and_a_notice(tmp_path: Path) -> None:
    source = unskinned(without_normals(TUBE, tmp_path / "in.glb"))
    file = Editable(source)
    del file.primitive()["attributes"]["NORMAL"]
    file.write(source)
    said = bake(source, tmp_path / "out.glb", "--morph-normals")
    assert "its morph targets get no NORMAL" in said
    assert (tmp_path / "out.glb").read_bytes() == source.read_bytes()


@pytest.mark.parametrize("option", ["--morph-normals", "--morph-frames"])
def test_a_note_says_that_an_option_finds_no_targets(tmp_path: Path, option: str) -> None:
    """Advice, because a folder may hold models with and without targets."""
    with_targets = without_normals(TUBE, tmp_path / "in.glb")
    for source, is_told in ((TUBE, True), (with_targets, False)):
        result = invoke("bake", "--json", "--warnings-as-errors", source, "-o", tmp_path / "out.glb", option)
        assert result.exit_code == 0
        found = [one["message"] for one in json.loads(result.stdout)["files"][0]["warnings"]]
        assert any(one.startswith(f"{option} adds nothing: nothing here has") for one in found) == is_told
    said = bake(morphed(TUBE, tmp_path / "whole.glb"), tmp_path / "out.glb", option)
    assert ("adds nothing: nothing here has a morph target without NORMAL" in said) == ("normals" in option)


@pytest.mark.slow
def test_a_real_face_is_lit_several_times_nearer_in_its_own_clip(tmp_path: Path) -> None:
    source = corpus.case("face_rig_run.glb")
    errors = []
    for options in ((), ("--morph-normals",)):
        bake(source, tmp_path / "out.glb", *options)
        answer = verify(tmp_path / "out.glb", "--method", "lbs", "--samples", "5")
        errors.append(answer.file["normals_by_tangents"]["lbs"]["accurate"]["mean"])
    assert errors[1] < errors[0] / 4
    invoke("strip", tmp_path / "out.glb", "-o", tmp_path / "back.glb")
    assert (tmp_path / "back.glb").read_bytes() == source.read_bytes()


def skinned_errors(path: Path) -> list[float]:
    """The mean errors of accurate lighting by both truths, in random poses of joints and targets."""
    answer = verify(path, "--method", "lbs", "--poses", "random")
    assert answer.exit_code == 0, answer.messages
    return [
        answer.file[name]["lbs"]["accurate"]["mean"]
        for name in ("normals_by_tangents", "normals_by_triangles")
    ]


@pytest.mark.slow
def test_six_numbers_halve_the_error_of_the_rule_on_a_real_face(tmp_path: Path) -> None:
    """Against the bake whose NORMAL is made, which follows the rule; in the clip and in random poses."""
    source = corpus.case("face_rig_run.glb")
    by_clip, by_random = [], []
    for options in (("--morph-normals",), ("--morph-frames",)):
        bake(source, tmp_path / "out.glb", *options)
        answer = verify(tmp_path / "out.glb", "--method", "lbs", "--samples", "5")
        by_clip.append(answer.file["normals_by_tangents"]["lbs"]["accurate"]["mean"])
        by_random.append(skinned_errors(tmp_path / "out.glb")[0])
    assert by_clip[1] < 0.65 * by_clip[0]
    assert by_random[1] < 0.65 * by_random[0]


@pytest.mark.slow
@pytest.mark.parametrize("option", ["--morph-normals", "--morph-frames"])
def test_what_is_made_for_targets_is_fresh_in_another_order(option: str, tmp_path: Path) -> None:
    bake(without_normals(TUBE, tmp_path / "in.glb"), tmp_path / "out.glb", option)
    for tool in ("reorder", "weld", "unweld"):
        assert gltf_transform.transform([(tmp_path / "out.glb", tmp_path / "other.glb", tool)]) == [""]
        result = invoke("verify", tmp_path / "other.glb", "--poses", "rest")
        assert result.exit_code == 0, result.output


@pytest.mark.slow
@given(st.data())
def test_a_digest_of_targets_sees_edits_and_no_order(data: st.DataObject) -> None:
    """Vertices and triangles change places, each triangle begins elsewhere, and vertices are copied."""
    seed = np.random.default_rng(data.draw(st.integers(0, 1 << 32)))
    given_rows = seed.choice(12, 5, replace=False)
    values = seed.normal(size=(5, 3)).astype(np.float32)
    rest = seed.normal(size=(12, 6)).astype(np.float32)
    triangles = np.array([seed.choice(12, 3, replace=False) for _ in range(9)])
    dense = np.zeros((12, 3), np.float32)
    dense[given_rows] = values

    def digest(rest: Any, triangles: Any, moves: Any, target: int = 1) -> str:
        primitive = SkinnedPrimitive(
            rest[:, :3], rest[:, 3:], None, np.zeros((0, 4), int), np.zeros((0, 4)), triangles
        )
        rows = np.flatnonzero(moves.any(axis=1))
        return morph_digest(primitive, {target: Differences(rows, moves[rows])})

    order = np.concatenate([seed.permutation(12), seed.integers(0, 12, 4)])
    places = [np.flatnonzero(order == number) for number in range(12)]
    moved = np.array([[seed.choice(places[corner]) for corner in corners] for corners in triangles])
    moved = np.array([np.roll(corners, seed.integers(3)) for corners in seed.permutation(moved)])
    first = digest(rest, triangles, dense)
    assert digest(rest[order], moved, dense[order]) == first
    corner = int(triangles[0, 0])
    for changed in (rest.copy(), dense.copy()):
        changed[corner, int(seed.integers(3))] += np.float32(0.001)
        assert (
            digest(*((changed, triangles, dense) if changed.shape[1] == 6 else (rest, triangles, changed)))
            != first
        )
    assert digest(rest, triangles[:, ::-1], dense) != first
    assert digest(rest, triangles[1:], dense) != first
    assert digest(rest, triangles, dense, 2) != first


@pytest.mark.slow
def test_numbers_light_a_morphed_and_skinned_tube_nearer_than_the_rule(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb")
    found = {}
    for options in (("--morph-normals",), ("--morph-normals", "--morph-frames"), ("--morph-frames",)):
        bake(source, tmp_path / "out.glb", *options)
        found[options] = skinned_errors(tmp_path / "out.glb")[0]
    rule, four, six = found.values()
    assert six < four < rule


def test_targets_that_have_normal_get_four_numbers_and_the_primitive_an_attribute_of_zeros(
    tmp_path: Path,
) -> None:
    bake(morphed(TUBE, tmp_path / "in.glb"), tmp_path / "out.glb", "--morph-frames")
    made = gltf_reading.read(tmp_path / "out.glb")
    names = {"POSITION", "NORMAL", "_SKINBAKE_MORPH"}
    assert [set(target) for target in made.primitive(0)["targets"]] == [names] * 2
    base = made.content["accessors"][made.primitive(0)["attributes"]["_SKINBAKE_MORPH"]]
    assert base["type"] == "VEC4" and "bufferView" not in base


@pytest.mark.slow
def test_standard_lighting_is_measured_as_engines_show_it_without_the_numbers(tmp_path: Path) -> None:
    source = without_normals(TUBE, tmp_path / "in.glb", weights=[0.8, 0.5])
    errors = []
    for options in ((), ("--morph-frames",)):
        bake(source, tmp_path / "out.glb", *options)
        figures = verify(tmp_path / "out.glb", "--poses", "rest").file["normals_by_tangents"]["lbs"]
        errors.append((figures["standard"]["mean"], figures["accurate"]["mean"]))
    assert errors[0][0] == pytest.approx(errors[1][0])
    assert errors[1][1] < errors[0][1] / 20


def test_an_attribute_of_the_name_is_refused(tmp_path: Path) -> None:
    file = Editable(without_normals(TUBE, tmp_path / "in.glb"))
    file.primitive()["attributes"]["_SKINBAKE_MORPH"] = file.primitive()["attributes"]["POSITION"]
    source = file.write(tmp_path / "in.glb")
    assert "already has an attribute _SKINBAKE_MORPH" in bake(
        source, tmp_path / "out.glb", "--morph-frames", code=3
    )


@pytest.mark.slow
def test_numbers_of_edited_targets_are_stale(tmp_path: Path) -> None:
    bake(without_normals(TUBE, tmp_path / "in.glb"), tmp_path / "out.glb", "--morph-frames")
    assert verify(tmp_path / "out.glb").exit_code == 0
    file = Editable(tmp_path / "out.glb")
    file.stored(file.primitive()["targets"][0]["POSITION"])[:] *= 1.5
    assert verify(file.write(tmp_path / "out.glb")).failed == ["freshness"]


def test_a_target_that_a_tool_has_removed_leaves_the_authored_normals_of_the_others(tmp_path: Path) -> None:
    bake(without_normals(TUBE, tmp_path / "in.glb", keep=1), tmp_path / "out.glb", "--morph-normals")
    file = Editable(tmp_path / "out.glb")
    authored = file.primitive()["targets"][0]
    file.primitive()["targets"] = [file.primitive()["targets"][1], authored, authored]
    invoke("strip", file.write(tmp_path / "edited.glb"), "-o", tmp_path / "back.glb")
    found = gltf_reading.read(tmp_path / "back.glb").primitive(0)["targets"]
    assert [set(target) for target in found] == [{"POSITION", "NORMAL"}] * 3
