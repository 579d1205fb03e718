"""``bake --limit-influences`` through the file: what is stored, what it costs, and that strip undoes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fixtures.builder import pack_glb
from skinbake.commands.strip import strip_file
from tests.support import corpus, gltf_transform, khronos
from tests.support.baked_arrays import path_of
from tests.support.baked_files import verify
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import read
from tests.support.models import assert_buffers_kept, bake, baked, note, rewritten, stripped

TWO_SETS = "two_sets.glb"
MODELS = [
    TWO_SETS,
    "pbrTest/pbrTest.gltf",
    *(pytest.param(name, marks=corpus.needed) for name in ("hand_l-two-sets.glb", "quad_skin/quad_skin.glb")),
]
FEW = ("--poses", "random:2", "--method", "lbs")

Array = npt.NDArray[np.float64]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
@pytest.mark.parametrize("name", MODELS)
def test_a_limited_file_verifies_and_strip_brings_back_every_byte(
    name: str, kind: str, tmp_path: Path
) -> None:
    original = stored_as(kind, path_of(name), tmp_path / "model.glb")
    after = baked(original, tmp_path / "out.glb", limit_influences=4)
    [primitive] = after.content["meshes"][0]["primitives"]
    assert "JOINTS_1" not in primitive["attributes"]
    assert "WEIGHTS_1" not in primitive["attributes"]
    assert after.stored_attribute("_SKINBAKE_ALPHA_0").shape[1] == 3
    answer = verify(tmp_path / "out.glb", *FEW)
    assert answer.exit_code == 0, answer.messages
    assert_buffers_kept(read(original), after)
    back = stripped(tmp_path / "out.glb", tmp_path / "back.glb")
    assert json.dumps(back.content) == json.dumps(read(original).content)
    assert back.binary_chunk == read(original).binary_chunk


def stored_as(kind: str, path: Path, target: Path) -> Path:
    """Write a GLB with the file's weights in another component type, their sums kept."""
    bake(path, target)
    strip_file(str(target), str(target))
    if kind == "f4":
        return target
    model = read(target)
    top = np.iinfo(kind).max
    joints, weights = model.influences()
    weights = weights / weights.sum(axis=1, keepdims=True)
    floors = np.floor(weights * top)
    rank = np.argsort(np.argsort(floors - weights * top, axis=1), axis=1)
    units = (floors + (rank < top - floors.sum(axis=1, keepdims=True))).astype(kind)
    attributes = model.content["meshes"][0]["primitives"][0]["attributes"]
    binary = bytearray(model.binary_chunk or b"")
    for number in range(joints.shape[1] // 4):
        binary += bytes(-len(binary) % 4)
        data = np.ascontiguousarray(units[:, 4 * number : 4 * number + 4]).tobytes()
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)}
        model.content["bufferViews"].append(view)
        accessor = {
            "bufferView": len(model.content["bufferViews"]) - 1,
            "componentType": {"u1": 5121, "u2": 5123}[kind],
            "normalized": True,
            "count": len(units),
            "type": "VEC4",
        }
        model.content["accessors"].append(accessor)
        attributes[f"WEIGHTS_{number}"] = len(model.content["accessors"]) - 1
        binary += data
    model.content["buffers"][0]["byteLength"] = len(binary)
    target.write_bytes(pack_glb(model.content, bytes(binary)))
    return target


@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_integer_weights_keep_type_and_sum(kind: str, tmp_path: Path) -> None:
    original = stored_as(kind, path_of(TWO_SETS), tmp_path / "model.glb")
    after = baked(original, tmp_path / "out.glb", limit_influences=4)
    weights = after.stored_attribute("WEIGHTS_0")
    assert weights.dtype == kind
    if kind == "f4":
        # Four roundings to float32 of numbers below 1.
        assert np.abs(weights.astype(np.float64).sum(axis=1) - 1).max() < 4 * 2.0**-25
    else:
        assert set(weights.astype(np.int64).sum(axis=1).tolist()) == {np.iinfo(kind).max}


def test_a_limit_that_nothing_exceeds_changes_no_byte(tmp_path: Path) -> None:
    for name, limit in ((TWO_SETS, 8), ("seam.glb", 4), ("foreign_joints.glb", 4)):
        result = bake(path_of(name), tmp_path / "limited.glb", limit_influences=limit)
        bake(path_of(name), tmp_path / "plain.glb")
        assert (tmp_path / "limited.glb").read_bytes() == (tmp_path / "plain.glb").read_bytes()
        assert [count.limited for _, count in result.primitives] == [None]


def test_a_bake_again_with_and_without(tmp_path: Path) -> None:
    baked(path_of(TWO_SETS), tmp_path / "once.glb", limit_influences=4)
    baked(tmp_path / "once.glb", tmp_path / "twice.glb", limit_influences=4)
    assert (tmp_path / "twice.glb").read_bytes() == (tmp_path / "once.glb").read_bytes()
    baked(tmp_path / "once.glb", tmp_path / "whole.glb")
    baked(path_of(TWO_SETS), tmp_path / "never.glb")
    assert (tmp_path / "whole.glb").read_bytes() == (tmp_path / "never.glb").read_bytes()


@corpus.needed
def test_joints_are_adopted_within_the_limit(tmp_path: Path) -> None:
    original = corpus.model("hand_l-two-sets.glb")
    result = bake(original, tmp_path / "out.glb", limit_influences=4)
    [(_, counts)] = result.primitives
    assert counts.adopting_vertices > 0
    after = read(tmp_path / "out.glb")
    adopted = after.stored_attribute("WEIGHTS_0") == np.float32(2.0**-30)
    assert np.count_nonzero(adopted.any(axis=1)) == counts.adopting_vertices


def test_the_weight_that_is_lost_is_counted(tmp_path: Path) -> None:
    result = bake(path_of(TWO_SETS), tmp_path / "limited.glb", limit_influences=4)
    [(_, counts)] = result.primitives
    assert counts.limited is not None
    _, weights = read(path_of(TWO_SETS)).influences()
    dropped = np.sort(weights / weights.sum(axis=1, keepdims=True), axis=1)[:, :4].sum(axis=1)
    assert counts.limited.vertices == np.count_nonzero(dropped)
    assert counts.limited.left_out == pytest.approx(dropped[dropped > 0].mean(), rel=1e-6)


def vertex_areas(positions: Array, triangles: npt.NDArray[np.int64]) -> Array:
    areas = np.zeros(len(positions))
    for triangle in triangles:
        a, b, c = positions[triangle]
        areas[triangle] += np.linalg.norm(np.cross(b - a, c - a)) / 6
    return areas


def test_the_command_line_says_what_it_cost(tmp_path: Path) -> None:
    given = ("bake", path_of(TWO_SETS), "-o", tmp_path / "out.glb", "--limit-influences", "4")
    line = invoke(*given).stdout
    assert "limited to 4 influences: 256 vertices lost 10.30 % of their weight" in line
    cost = document(invoke(*given, "--json"))["files"][0]["primitives"][0]["limited"]
    assert cost["influences"] == 4
    assert invoke(*given, "--warnings-as-errors").exit_code == 0


@pytest.mark.parametrize("limit", ["0", "3", "6", "many"])
def test_limits_that_are_no_whole_sets_are_refused(limit: str, tmp_path: Path) -> None:
    result = invoke("bake", path_of(TWO_SETS), "-o", tmp_path / "out.glb", "--limit-influences", limit)
    assert result.exit_code == 2
    assert "--limit-influences" in result.stderr
    assert not (tmp_path / "out.glb").exists()


def edited_weights(folder: Path) -> Path:
    """Bake with a limit, and point WEIGHTS_0 at those of before, which do not sum to 1."""
    model = baked(path_of(TWO_SETS), folder / "baked.glb", limit_influences=4)
    [primitive] = model.content["meshes"][0]["primitives"]
    primitive["attributes"]["WEIGHTS_0"] = primitive["extras"]["skinbake"]["adopted"]["WEIGHTS_0"]
    return rewritten(model, folder / "edited.glb")


def test_edited_influences_stay(tmp_path: Path) -> None:
    """Divided by their sum, the weights are those of the limit again, so α and β fit them."""
    path = edited_weights(tmp_path)
    edited, limited = (read(each).influences()[1] for each in (path, tmp_path / "baked.glb"))
    sums = edited.sum(axis=1, keepdims=True)
    assert sums.min() < 0.99
    assert np.allclose(edited / sums, limited, atol=1e-6)
    answer = verify(path, *FEW)
    remarks = [check["remark"] for check in answer.file["checks"] if check["name"] == "freshness"]
    assert (answer.failed, remarks) == ([], ["WEIGHTS changed since the bake, and α/β still fit"])
    result = strip_file(str(path), str(tmp_path / "out.glb"))
    assert "limited-kept" in [notice.code for notice in result.notices]
    assert "JOINTS_1" not in read(tmp_path / "out.glb").content["meshes"][0]["primitives"][0]["attributes"]


def test_the_metadata_names_what_was_there(tmp_path: Path) -> None:
    before = read(path_of(TWO_SETS))
    found = note(baked(path_of(TWO_SETS), tmp_path / "out.glb", limit_influences=4).content)
    assert found is not None
    attributes = before.content["meshes"][0]["primitives"][0]["attributes"]
    assert found["formerAttributes"] == list(attributes)
    assert found["adopted"] == {
        name: attributes[name] for name in ("JOINTS_0", "WEIGHTS_0", "JOINTS_1", "WEIGHTS_1")
    }
    assert found["influences"] == 4


@pytest.mark.slow
def test_verify_still_proves_a_file_whose_former_influences_another_tool_pruned(tmp_path: Path) -> None:
    gltf_transform.require_node()
    baked(path_of(TWO_SETS), tmp_path / "baked.glb", limit_influences=4)
    process = gltf_transform.run(["copy", tmp_path / "baked.glb", tmp_path / "copied.glb"])
    assert process.returncode == 0, process.stderr
    answer = verify(tmp_path / "copied.glb", *FEW)
    assert answer.exit_code == 0, answer.messages


def test_the_khronos_validator_finds_nothing_new(tmp_path: Path) -> None:
    khronos.require_node()
    pairs = []
    for kind in ("u1", "u2", "f4"):
        original = stored_as(kind, path_of(TWO_SETS), tmp_path / f"{kind}.glb")
        baked(original, tmp_path / f"{kind}_out.glb", limit_influences=4)
        pairs.append((original, tmp_path / f"{kind}_out.glb"))
    reports = khronos.validate_many([path for pair in pairs for path in pair])
    assert [khronos.new_findings(reports[one], reports[other]) for one, other in pairs] == [{}, {}, {}]
