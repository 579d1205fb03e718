"""How adopted joints are stored, and that no position shows them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.choices import Neighbours
from skinbake.format.influences import with_adopted
from skinbake.geometry.skinned import TINY_WEIGHT, UNIT, Float64Array
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.accessors import StoredArray
from skinbake.gltf.reading.meshes import StoredInfluences
from skinbake.gltf.reading.skins import random_poses, read_skeleton
from tests.support import khronos
from tests.support.baked_arrays import (
    AFRAME_HAND,
    CESIUM_MAN,
    HAND_U8,
    HAND_U16,
    MANTIS,
    PBR_TEST,
    TREX,
    bake_to,
    path_of,
)
from tests.support.baking import bake_file, bake_settings
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import sheet, write_model

FLOAT_FILES = ["foreign_joints.glb", CESIUM_MAN, TREX, MANTIS, PBR_TEST, AFRAME_HAND]
INTEGER_FILES = ["weights_u8.glb", "weights_u16.glb", HAND_U8, HAND_U16]
NONE = [-1, -1, -1, -1]


def adopted_into(sets: Sequence[StoredInfluences], adopted: npt.NDArray[np.int64]) -> list[StoredInfluences]:
    """Adopt joints given for every vertex."""
    rows = np.flatnonzero((adopted >= 0).any(axis=1))
    return with_adopted(sets, rows, adopted[rows])


def influences(joints: object, weights: object, joint_type: str, weight_type: str) -> StoredInfluences:
    return StoredInfluences(
        StoredArray(np.array(joints, dtype=joint_type), normalized=False),
        StoredArray(np.array(weights, dtype=weight_type), normalized=weight_type != "f4"),
    )


def adopt(
    stored: StoredInfluences, adopted: object
) -> tuple[npt.NDArray[np.generic], npt.NDArray[np.generic]]:
    [result] = adopted_into([stored], np.array(adopted))
    assert result.joints.normalized == stored.joints.normalized
    assert result.weights.normalized == stored.weights.normalized
    return result.joints.values, result.weights.values


def test_float_weights_keep_their_bits_and_adopted_slots_get_a_billionth() -> None:
    third = np.float32(1) / np.float32(3)
    stored = influences([[4, 2, 0, 0], [4, 2, 0, 0]], [[third, 1 - third, 0, 0]] * 2, "u1", "f4")
    joints, weights = adopt(stored, [[-1, -1, 7, 9], NONE])
    assert joints.tolist() == [[4, 2, 7, 9], [4, 2, 0, 0]]
    assert joints.dtype == np.uint8
    assert weights.dtype == np.float32
    assert weights.tolist() == [[third, 1 - third, 2.0**-30, 2.0**-30], [third, 1 - third, 0, 0]]
    assert TINY_WEIGHT == 2.0**-30


def test_shorts_stay_shorts_and_the_largest_weight_pays() -> None:
    stored = influences([[4, 2, 0, 0], [4, 2, 0, 0]], [[30000, 35535, 0, 0]] * 2, "u1", "u2")
    joints, weights = adopt(stored, [[-1, -1, 7, 9], NONE])
    assert joints.tolist() == [[4, 2, 7, 9], [4, 2, 0, 0]]
    assert weights.dtype == np.uint16
    assert weights.tolist() == [[30000, 35533, 1, 1], [30000, 35535, 0, 0]]


def test_bytes_become_shorts_of_the_same_value() -> None:
    stored = influences([[4, 2, 0, 0]] * 2, [[200, 55, 0, 0], [1, 254, 0, 0]], "u1", "u1")
    _, weights = adopt(stored, [[-1, -1, 7, -1], NONE])
    # v / 255 = 257 v / 65535.
    assert weights.dtype == np.uint16
    assert weights.tolist() == [[51399, 14135, 1, 0], [257, 65278, 0, 0]]


@pytest.mark.parametrize(("joints", "payer"), [([4, 2, 0, 0], 1), ([2, 4, 0, 0], 0)])
def test_of_equal_weights_the_lower_joint_pays_whatever_its_slot(joints: list[int], payer: int) -> None:
    expected = [32767, 32767, 1, 0]
    expected[payer] -= 1
    _, weights = adopt(influences([joints], [[32767, 32767, 0, 0]], "u1", "u2"), [[-1, -1, 9, -1]])
    assert weights.tolist() == [expected]


def test_joints_widen_where_the_adopted_number_needs_it() -> None:
    stored = influences([[254, 2, 0, 0]], [[1, 0, 0, 0]], "u1", "f4")
    for joint, dtype in ((255, np.uint8), (256, np.uint16), (65535, np.uint16)):
        joints, _ = adopt(stored, [[-1, -1, joint, -1]])
        assert joints.dtype == dtype
        assert joints.tolist() == [[254, 2, joint, 0]]


def test_free_slots_whose_joint_is_adopted_elsewhere_become_joint_0_without_weight() -> None:
    """Joint 7 has a tiny weight, joint 9 none, in two slots of other sets. Joint 5 stays where it is."""
    first = influences([[4, 0, 7, 9]], [[1, 0, 1e-12, 0]], "u1", "f4")
    second = influences([[5, 9, 0, 7]], [[0, 0, 0, 1e-11]], "u2", "f4")
    found = adopted_into([first, second], np.array([[-1, 7, 9, -1, -1, -1, -1, -1]]))
    assert [one.joints.values.tolist() for one in found] == [[[4, 7, 9, 0]], [[5, 0, 0, 0]]]
    tiny = 2.0**-30
    assert [one.weights.values.tolist() for one in found] == [[[1, tiny, tiny, 0]], [[0, 0, 0, 0]]]


def test_sets_without_a_change_are_the_same_objects() -> None:
    first = influences([[4, 2, 1, 0]], [[0.4, 0.3, 0.2, 0.1]], "u1", "f4")
    second = influences([[5, 0, 0, 0]], [[0, 0, 0, 0]], "u1", "f4")
    found = adopted_into([first, second], np.array([[*NONE, -1, 8, -1, -1]]))
    assert found[0] == first
    assert found[0].joints is first.joints
    assert found[0].weights is first.weights
    assert found[1].joints.values.tolist() == [[5, 8, 0, 0]]


def test_a_vertexs_largest_weight_pays_from_another_set_and_type() -> None:
    first = influences([[4, 2, 1, 0]], [[60000, 5000, 0, 0]], "u1", "u2")
    second = influences([[5, 0, 0, 0]], [[0, 0, 0, 0]], "u1", "u1")
    found = adopted_into([first, second], np.array([[-1, -1, -1, 9, 7, 8, -1, -1]]))
    assert found[0].weights.values.tolist() == [[59997, 5000, 0, 1]]
    assert found[1].weights.values.tolist() == [[1, 1, 0, 0]]
    # A float pays its part as a float: two of 65535 from one half.
    third = influences([[4, 2, 1, 0]], [[0.75, 0, 0, 0]], "u1", "f4")
    found = adopted_into([third, second], np.array([[-1, 3, -1, -1, 7, 8, -1, -1]]))
    assert found[0].weights.values == pytest.approx(np.array([[0.75 - 2 / UNIT, 2.0**-30, 0, 0]]), rel=1e-7)
    assert found[1].weights.values.tolist() == [[1, 1, 0, 0]]


def test_the_input_is_left_alone() -> None:
    stored = influences([[4, 2, 0, 0]], [[255, 0, 0, 0]], "u1", "u1")
    adopt(stored, [[-1, 5, -1, -1]])
    assert stored.joints.values.tolist() == [[4, 2, 0, 0]]
    assert stored.weights.values.tolist() == [[255, 0, 0, 0]]


# Whole files


def primitives_of(path: Path) -> list[tuple[int, int]]:
    return [
        (mesh, primitive)
        for mesh, description in enumerate(read(path).content["meshes"])
        for primitive, each in enumerate(description["primitives"])
        if "JOINTS_0" in each["attributes"]
    ]


def stored_weights(path: Path, place: tuple[int, int]) -> npt.NDArray[np.generic]:
    file, sets = read(path), 0
    while file.has_attribute(f"WEIGHTS_{sets}", *place):
        sets += 1
    return np.concatenate([file.stored_attribute(f"WEIGHTS_{n}", *place) for n in range(sets)], axis=1)


@pytest.mark.parametrize("name", FLOAT_FILES)
def test_float_files_keep_every_weight_that_was_not_zero(name: str, tmp_path: Path) -> None:
    target = bake_to(name, tmp_path)
    adopted_any = False
    for place in primitives_of(target):
        before, after = stored_weights(path_of(name), place), stored_weights(target, place)
        joints, written = (read(path).influences(*place)[0] for path in (path_of(name), target))
        adopted = before.view(np.uint32) != after.view(np.uint32)
        adopted_any |= bool(adopted.any())
        assert (after[adopted] == 2.0**-30).all()
        # Weights that move nothing count as none: their slots are free.
        assert (before[adopted] < 2.0**-30).all()
        taken = (joints[:, :, None] == np.where(adopted, written.astype(int), -1)[:, None, :]).any(axis=2)
        assert np.array_equal(np.where(taken, 0, joints)[~adopted], written[~adopted])
    assert adopted_any


@pytest.mark.parametrize("name", INTEGER_FILES)
def test_integer_files_keep_their_sums_exactly(name: str, tmp_path: Path) -> None:
    target = bake_to(name, tmp_path)
    for place in primitives_of(target):
        before = stored_weights(path_of(name), place).astype(np.int64)
        after = stored_weights(target, place)
        assert after.dtype == np.uint16
        widened = before * (UNIT // int(np.iinfo(stored_weights(path_of(name), place).dtype.name).max))
        sums = after.astype(np.int64).sum(axis=1)
        assert np.array_equal(sums, widened.sum(axis=1))
        assert (sums == UNIT).all()
        moved = after.astype(np.int64) - widened
        adopted = (before == 0) & (after == 1)
        assert adopted.any()
        assert (moved[adopted] == 1).all()
        # One slot of each vertex pays for all that it adopts.
        assert (np.count_nonzero(moved < 0, axis=1) <= 1).all()
        assert np.array_equal(-moved.min(axis=1), adopted.sum(axis=1))


def joint_images(
    path: Path, mesh: int, positions: Float64Array, joints: npt.NDArray[np.int64]
) -> Float64Array:
    """Return where each slot's joint alone would put each vertex, (P, V, K, 3), in random poses."""
    document = read_document(str(path))
    [skin] = {node["skin"] for node in document.objects("nodes") if node.get("mesh") == mesh}
    matrices = random_poses(read_skeleton(document, skin), 8, angle=np.pi, seed=9)
    joints = np.minimum(joints, matrices.shape[1] - 1)  # past the skin's, at weight zero
    homogeneous = np.column_stack([positions, np.ones(len(positions))])
    images: Float64Array = np.einsum("pvkij,vj->pvki", matrices[:, joints, :3], homogeneous)
    return images


@pytest.mark.parametrize("name", ["foreign_joints.glb", CESIUM_MAN, PBR_TEST, HAND_U8, HAND_U16])
def test_no_pose_moves_a_vertex_beyond_the_stated_bound(name: str, tmp_path: Path) -> None:
    target = bake_to(name, tmp_path)
    moves_at_all = False
    for mesh, primitive in primitives_of(target):
        file, original = read(target), read(path_of(name))
        positions = file.attribute("POSITION", mesh, primitive)
        joints, weights = file.influences(mesh, primitive)
        _, before = original.influences(mesh, primitive)
        images = joint_images(path_of(name), mesh, positions, joints.astype(np.int64))
        # As the vertex shader does it: no division by the sum.
        moved = np.einsum("pvki,vk->pvi", images, weights - before)
        adopted = (before == 0) & (weights > 0)
        span = np.linalg.norm(images[:, :, :, None] - images[:, :, None], axis=-1).max(axis=(2, 3))
        if name in (HAND_U8, HAND_U16):
            # A 65535th of the way from the largest weight's image to the adopted joint's, for each.
            bound = adopted.sum(axis=1) / UNIT * span
        else:
            # 2⁻³⁰ of the adopted joint's image: the shader adds weighted images up as they are.
            bound = np.einsum("pvk,vk->pv", np.linalg.norm(images, axis=-1), adopted * 2.0**-30)
        distance = np.linalg.norm(moved, axis=-1)
        # Values of 65535ths are float64 quotients: rounding of 1e-16 of the images.
        assert (distance <= bound * (1 + 1e-9) + 1e-15 * np.abs(images).max()).all()
        moves_at_all |= bool((distance > 0).any())
    assert moves_at_all


@pytest.mark.parametrize("name", ["foreign_joints.glb", HAND_U8])
def test_without_adoption_the_influences_stay_the_files_own(name: str, tmp_path: Path) -> None:
    source, target = path_of(name), tmp_path / "dropped.glb"
    settings = bake_settings(neighbours=Neighbours.DROP)
    assert bake_file(str(source), str(target), settings=settings).status == "baked"
    before, after = read(source), read(target)
    for place in primitives_of(target):
        for attribute in ("JOINTS_0", "WEIGHTS_0"):
            old = before.primitive(*place)["attributes"][attribute]
            assert after.primitive(*place)["attributes"][attribute] == old


@pytest.mark.parametrize("options", [[], ["--neighbours", "extend"], ["--limit-influences", "4"]])
def test_no_vertex_adopts_a_joint_past_the_skin_from_one_without_weight(
    options: list[str], tmp_path: Path
) -> None:
    """Such a vertex counts as bound to its first joint. Past the skin's, that would be no joint at all."""
    arrays: dict[str, npt.NDArray[np.generic]] = {}
    for number in range(2):
        arrays[f"JOINTS_{number}"] = np.zeros((20, 4), np.uint8)
        arrays[f"WEIGHTS_{number}"] = np.zeros((20, 4), np.float32)
    arrays["JOINTS_0"][:10, 0] = 1
    arrays["WEIGHTS_0"][:, 0] = 1
    arrays["JOINTS_0"][7], arrays["WEIGHTS_0"][7] = [201, 0, 0, 0], 0
    source, target = write_model(tmp_path / "source.glb", [sheet(**arrays)]), tmp_path / "baked.glb"
    assert invoke("bake", source, "-o", target, *options, "-q").exit_code == 0
    joints, weights = read(target).influences()
    assert (weights[6:9:2] == np.float32(2.0**-30)).any(), "its neighbours adopt a joint"
    assert joints[weights > 0].max() == 1
    verdict = invoke("verify", target, "--poses", "rest", "--method", "lbs", "-v")
    assert verdict.exit_code == 0, verdict.output
    assert "changed since" not in verdict.output
    assert not khronos.new_findings(khronos.validate(source), khronos.validate(target))
    assert invoke("strip", target, "-o", tmp_path / "bare.glb").exit_code == 0
    assert (tmp_path / "bare.glb").read_bytes() == source.read_bytes()
    assert invoke("bake", target, "-o", tmp_path / "again.glb", *options, "-q").exit_code == 0
    assert (tmp_path / "again.glb").read_bytes() == target.read_bytes()
