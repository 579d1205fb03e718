"""The normals of a pose, for ports: held to the fixtures' formulas, to verify, and to a replay of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from fixtures.builder import JsonObject, grid
from fixtures.make_fixtures import (
    ELBOW_DEGREES,
    FOLDER,
    TUBE_JOINTS,
    TUBE_LENGTH,
    TUBE_RADIUS,
    WRIST_DEGREES,
    tube_surface,
    tube_weights,
)
from skinbake.gltf.budget import memory_limited
from tests.support import analytic, corpus, straightforward
from tests.support.analytic import Array, degrees_between
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import edited

BENT = 0.5
"""The time of the tube's clip at which its joints turn the most."""

TUBE = FOLDER / "bent_tube.glb"


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tube, baked with the gradients of its surface."""
    path = tmp_path_factory.mktemp("normals") / "tube.glb"
    skinbake.bake(TUBE, path, gradients="surface")
    return path


def joint_matrices() -> Array:
    """The joint matrices of the tube at its most bent, by the formulas of its maker."""
    found = [np.eye(4)]
    turns = (([0.0, 0.0, 1.0], ELBOW_DEGREES), ([1.0, 0.0, 0.0], WRIST_DEGREES))
    for pivot, (axis, degrees) in zip(TUBE_JOINTS[1:], turns, strict=True):
        turned = np.eye(4)
        turned[:3, :3] = analytic.rotation_matrix(np.array(axis), np.radians(degrees))
        turned[:3, 3] = pivot - turned[:3, :3] @ pivot
        found.append(found[-1] @ turned)
    return np.array(found)


def skinned(theta: Array, height: Array) -> Array:
    """The skinned tube at parameters (V,), by linear blending."""
    points = tube_surface(theta, height, TUBE_RADIUS)[0]
    return analytic.linear_blend(joint_matrices())(points, tube_weights(theta, height))


def unit(vectors: Array) -> Array:
    found: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return found


def test_normals_are_those_of_the_formula_of_a_bent_tube(tube: Path) -> None:
    [posed] = skinbake.normals(tube, "bend", BENT)
    height, theta, _ = grid(np.linspace(0, TUBE_LENGTH, 46), np.linspace(0, 2 * np.pi, 33))
    # float32 in the file
    assert np.abs(posed.joint_matrices - joint_matrices()).max() < 1e-6
    assert np.abs(posed.positions - skinned(theta, height)).max() < 1e-6
    along, around = analytic.differences(height, theta, lambda h, t: skinned(t, h))
    true = unit(np.cross(along, around))
    errors = {name: degrees_between(normals, true).mean() for name, normals in posed.normals.items()}
    # The tube has 32 segments around: its triangles tell slopes of second order.
    assert errors["accurate"] < 0.05 * errors["standard"]
    assert errors["standard"] > 5.0
    assert all(degrees_between(one, true).mean() < 0.4 for one in posed.truths.values())


def test_lightings_are_the_lines_of_the_paper_on_the_stored_numbers(tube: Path) -> None:
    [posed] = skinbake.normals(tube, "bend", BENT)
    file = read(tube)
    attributes = file.content["meshes"][0]["primitives"][0]["attributes"]
    points, normals, weights, alpha, beta = (
        file.values(attributes[name]).astype(np.float64)
        for name in ("POSITION", "NORMAL", "WEIGHTS_0", "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0")
    )
    matrices = joint_matrices()[file.values(attributes["JOINTS_0"]).astype(np.int64)]
    blended = np.einsum("vk,vkij->vij", weights, matrices[..., :3, :3])
    moved = np.einsum("vkij,vj->vki", matrices[..., :3, :3], points) + matrices[..., :3, 3]
    t0, b0 = straightforward.duff(normals)
    t, b = (
        np.einsum("vij,vj->vi", blended, axis)
        + np.einsum("vk,vki->vi", slopes[:, :3], moved[:, 1:] - moved[:, :1])
        for axis, slopes in ((t0, alpha), (b0, beta))
    )
    found = {"standard": np.einsum("vij,vj->vi", blended, normals), "accurate": np.cross(t, b)}
    for name, vectors in found.items():
        assert degrees_between(posed.normals[name], unit(vectors)).max() < 1e-3, name


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"correctives": "auto"}], ids=["shader", "correctives"])
@pytest.mark.parametrize(
    "source",
    [
        FOLDER / "bent_tube.glb",
        pytest.param(FOLDER / "morphed_sheet.glb", marks=pytest.mark.slow),
        pytest.param(corpus.CHARACTERS / "barbarian_walking.glb", marks=pytest.mark.slow),
    ],
    ids=lambda path: path.name,
)
def test_the_worst_normals_of_verify_are_found_again(
    source: Path, options: dict[str, Any], tmp_path: Path
) -> None:
    """By each truth and method, at the vertex, clip and time that verify names."""
    path = tmp_path / "baked.glb"
    skinbake.bake(source, path, **options)
    verdict = skinbake.verify(path, samples=3)
    for truth in ("triangles", "tangents"):
        for method, lightings in verdict[f"normals_by_{truth}"].items():
            assert ("corrected" in lightings) == bool(options)
            for lighting in {"standard", "accurate", "exact", "corrected"} & lightings.keys():
                worst = lightings[lighting]["worst"]
                found = skinbake.normals(path, worst["clip"], worst["time"], methods=[method])
                [posed] = [
                    one for one in found if (one.mesh, one.primitive) == (worst["mesh"], worst["primitive"])
                ]
                own = posed.normals[lighting], posed.truths[truth]
                error = degrees_between(*own)[worst["vertex"]]
                assert abs(error - lightings[lighting]["max"]) < 0.01, (truth, method, lighting)


@pytest.mark.slow
def test_correctives_are_the_targets_that_a_clip_plays_under_standard_lighting(tmp_path: Path) -> None:
    path, time = tmp_path / "tube.glb", 0.41
    skinbake.bake(TUBE, path, correctives=2)
    [posed] = skinbake.normals(path, "bend", time)
    file = read(path)
    [mesh], [clip] = file.content["meshes"], file.content["animations"]
    [channel] = [one for one in clip["channels"] if one["target"]["path"] == "weights"]
    sampler = clip["samplers"][channel["sampler"]]
    times, values = (file.values(sampler[name]).ravel() for name in ("input", "output"))
    weights = [np.interp(time, times, column) for column in values.reshape(-1, 2).T]
    assert posed.node == channel["target"]["node"]
    assert np.abs(posed.morph_weights - weights).max() < 1e-6
    [primitive] = mesh["primitives"]
    normals, slots = file.attribute("NORMAL"), file.influences()
    for weight, target in zip(weights, primitive["targets"], strict=True):
        normals = normals + weight * file.values(target["NORMAL"])
    blended = np.einsum("vk,vkij->vij", slots[1], posed.joint_matrices[slots[0]][..., :3, :3])
    lit = unit(np.einsum("vij,vj->vi", blended, normals))
    assert degrees_between(posed.normals["corrected"], lit).max() < 1e-3
    true = posed.truths["tangents"]
    before, after = (degrees_between(posed.normals[name], true).mean() for name in ("standard", "corrected"))
    assert after < 0.1 * before


@pytest.mark.slow
def test_a_dump_has_the_same_numbers_as_lines_of_json(tmp_path: Path) -> None:
    path, dump = tmp_path / "sheet.glb", tmp_path / "sheet.jsonl"
    skinbake.bake(FOLDER / "two_primitives.glb", path)
    result = invoke("verify", path, "--dump-normals", dump, "--method", "dqs", "--method", "lbs")
    found = skinbake.normals(path, methods=["dqs", "lbs"])
    assert result.exit_code == 0
    lines = [json.loads(line) for line in dump.read_text(encoding="ascii").splitlines()]
    kinds = [f"{one['method']} {one['primitive']}" for one in lines]
    assert kinds == ["dqs 0", "dqs 1", "lbs 0", "lbs 1"]
    for line, one in zip(lines, found, strict=True):
        assert line["schema"] == "skinbake.normals/1"
        assert line["file"] == str(path)
        for name in ("mesh", "primitive", "skin", "node", "clip", "time"):
            assert line[name] == getattr(one, name)
        same(line["positions"], one.positions)
        same(line["joint_matrices"], one.joint_matrices.transpose(0, 2, 1))
        assert line["morph_weights"] == []
        for written, arrays in ((line["normals"], one.normals), (line["truths"], one.truths)):
            assert list(written) == list(arrays)
            for name, vectors in arrays.items():
                same(written[name], vectors)
    again = invoke("verify", path, "--dump-normals", dump, "--json")  # its own file is replaced
    assert json.loads(again.stdout)["exit_code"] == 0


def same(numbers: list[float | None], array: Array) -> None:
    """Hold numbers of a line to an array; null stands for NaN."""
    read_back = np.array([np.nan if one is None else one for one in numbers])
    assert np.allclose(read_back, array.ravel(), rtol=1e-8, atol=1e-12, equal_nan=True)


@pytest.mark.slow
def test_by_default_the_pose_is_the_one_in_which_the_bake_shows_most(tube: Path, tmp_path: Path) -> None:
    [posed] = skinbake.normals(tube)
    assert posed.clip == "bend"
    assert abs(posed.time - BENT) < 0.08  # it may show more a little before or after, seen from elsewhere
    dump = tmp_path / "dump.jsonl"
    result = invoke("verify", tube, "--dump-normals", dump)
    assert f'{dump}: written, clip "bend" at {posed.time:.9g} s\n' in result.stdout
    assert json.loads(dump.read_text())["time"] == posed.time


def test_morph_targets_and_their_weights_are_in_the_pose(tmp_path: Path) -> None:
    """Without its joints' turns the sheet is the formula of the morphed one, and so is every normal."""

    def only_morphs(content: JsonObject) -> None:
        clip = content["animations"][0]
        clip["channels"] = [one for one in clip["channels"] if one["target"]["path"] == "weights"]

    path = edited("morphed_sheet.glb", tmp_path, only_morphs)
    skinbake.bake(path, path)
    [posed] = skinbake.normals(path, 0, 0.5)
    [still] = skinbake.normals(path, 0, 0.0)
    assert posed.node is not None
    assert posed.morph_weights.shape == (2,)
    file = read(path)
    primitive = file.content["meshes"][0]["primitives"][0]
    deltas = [file.values(target["POSITION"]) for target in primitive["targets"]]
    moved = np.einsum("n,nvi->vi", posed.morph_weights - still.morph_weights, np.array(deltas))
    assert np.abs(moved).max() > 0.1
    assert np.abs(posed.positions - still.positions - moved).max() < 1e-6


@pytest.mark.slow
def test_a_file_without_clips_is_dumped_in_a_random_pose(tmp_path: Path) -> None:
    path = edited("bent_tube.glb", tmp_path, lambda content: content.pop("animations"))
    skinbake.bake(path, path)
    [posed] = skinbake.normals(path)
    assert posed.clip is None
    assert np.abs(posed.joint_matrices[1:] - np.eye(4)).max() > 0.1
    dump = tmp_path / "tube.jsonl"
    result = invoke("verify", path, "--dump-normals", dump)
    assert f"{dump}: written, random poses (no clip moves it) at {posed.time:.9g} s\n" in result.stdout


def test_characters_of_vrm_0_stay_in_the_space_of_their_scene(tube: Path, tmp_path: Path) -> None:
    path = edited("bent_tube.glb", tmp_path, lambda content: content.update(extensions={"VRM": {}}))
    skinbake.bake(path, path, gradients="surface")
    [one], [other] = skinbake.normals(path, "bend", BENT), skinbake.normals(tube, "bend", BENT)
    assert np.array_equal(one.positions, other.positions)


def test_a_vertex_without_triangles_has_no_true_normal(tmp_path: Path) -> None:
    def fewer(content: JsonObject) -> None:
        content["accessors"][content["meshes"][0]["primitives"][0]["indices"]]["count"] //= 2

    path = edited("bent_tube.glb", tmp_path, fewer)
    skinbake.bake(path, path)
    [posed] = skinbake.normals(path, 0, BENT)
    for vectors in posed.truths.values():
        assert 600 < np.isnan(vectors[:, 0]).sum() < 900
    assert np.isfinite(posed.normals["standard"]).all()
    invoke("verify", path, "--dump-normals", tmp_path / "dump.jsonl", "--clip", "bend", "--time", str(BENT))
    line = json.loads((tmp_path / "dump.jsonl").read_text())
    same(line["truths"]["triangles"], posed.truths["triangles"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"clip": "wave"}, "clip='wave': the file has no such clip; it has bend"),
        ({"clip": 1}, "clip='1': the file has no such clip"),
        ({"clip": True}, "clip=True: expected a text"),
        ({"time": 2.0}, 'time=2.0: clip "bend" goes from 0 to 0.958333 s'),
        ({"time": "now"}, "time='now': expected a number"),
        ({"methods": ["both"]}, "methods='both': expected one of lbs, dqs"),
    ],
)
def test_a_pose_that_does_not_exist_is_refused(given: dict[str, Any], message: str, tube: Path) -> None:
    with pytest.raises(skinbake.ChoiceError) as caught:
        skinbake.normals(tube, **given)
    assert message in str(caught.value)


def test_files_without_sound_gradients_are_refused(tube: Path, tmp_path: Path) -> None:
    with pytest.raises(skinbake.InputError, match="no α and β in it are sound"):
        skinbake.normals(TUBE)
    result = invoke("verify", TUBE, "--dump-normals", tmp_path / "dump.jsonl")
    assert result.exit_code == 3
    assert "no accurate normals: run skinbake bake, which says what it skips and why" in result.stderr
    assert not (tmp_path / "dump.jsonl").exists()


def test_work_and_memory_are_bounded(tube: Path, tmp_path: Path) -> None:
    with memory_limited(3 << 20), pytest.raises(skinbake.InputError, match="memory"):
        skinbake.normals(tube)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--clip", "bend"], "--clip is for --dump-normals"),
        (["--time", "0"], "--time is for --dump-normals"),
        (["--dump-normals", "-"], "--dump-normals needs the name of a file"),
        (["{tube}", "--dump-normals", "{made}"], "--dump-normals takes one input"),
        (["--dump-normals", "{other}"], "other.json exists and was not written by an earlier run"),
        (["--dump-normals", "{made}", "--clip", "wave"], "--clip wave: the file has no such clip"),
    ],
)
def test_options_of_a_dump_that_make_no_sense_are_refused(
    arguments: list[str], message: str, tube: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.json"
    other.write_text("{}")
    names = {"tube": tube.with_name("other.glb"), "made": tmp_path / "made.jsonl", "other": other}
    names["tube"].write_bytes(tube.read_bytes())
    result = invoke("verify", tube, *(one.format(**names) for one in arguments))
    assert (result.exit_code, message in result.stderr) == (2, True), result.stderr
    assert not names["made"].exists()
    assert other.read_text() == "{}"
