"""The policy for weights that are not what glTF asks for, each case worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import Neighbours
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients.influences import weight_field
from skinbake.gradients.surface import NO_JOINT, WeightDefects, WeightField
from tests.support.baked_arrays import AFRAME_HAND, ELF, MANTIS, TREX, bake_one, meshes_of, path_of
from tests.support.baking import bake_file, bake_settings
from tests.support.gltf_reading import read

FINE = WeightDefects(negative=0, all_zero=0, not_normalised=0, repeated_joint=0)


def triangle(joints: object, weights: object, *, dtype: type = np.float64) -> SkinnedPrimitive:
    """Return the right triangle (0, 0), (1, 0), (0, 1): with f at its corners, ∇f = (f1 − f0, f2 − f0).

    Its normals are +Z, so t0 is X and b0 is Y: α = f1 − f0 and β = f2 − f0, exactly, at all three corners.
    """
    return SkinnedPrimitive(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=dtype),
        np.tile(np.array([0, 0, 1], dtype=dtype), (3, 1)),
        None,
        np.array(np.broadcast_to(np.asarray(joints), (3, 4))),
        np.array(np.broadcast_to(np.asarray(weights, dtype=dtype), (3, 4))),
        np.array([[0, 1, 2]]),
    )


def field_of(joints: list[int], weights: list[float]) -> tuple[WeightField, WeightDefects]:
    """Return the field of one vertex, three times over."""
    return weight_field(triangle(joints, weights))


@pytest.mark.parametrize(
    ("joints", "weights", "mended_joints", "mended_weights", "free", "defects"),
    [
        pytest.param(
            [4, 2, 0, 0],
            [0.75, 0.25, 0, 0],
            [4, 2, 0, -1],
            [0.75, 0.25, 0, 0],
            [False, False, True, True],
            {},
            id="sound",
        ),
        pytest.param(
            [4, 2, 7, 0],
            [0.5, 0.25, 0.25, 1.0],
            [4, 2, 7, 0],
            [0.25, 0.125, 0.125, 0.5],
            [False] * 4,
            {"not_normalised": 3},
            id="sum of 2",
        ),
        pytest.param(
            [4, 2, 7, 0],
            [0.125, 0.0, 0.0, 0.125],
            [4, 2, 7, 0],
            [0.5, 0, 0, 0.5],
            [False, True, True, False],
            {"not_normalised": 3},
            id="sum of 1/4",
        ),
        pytest.param(
            [4, 2, 7, 0],
            [0.0, 0.0, 0.0, 0.0],
            [4, 2, 7, 0],
            [1, 0, 0, 0],
            [False] * 4,
            {"all_zero": 3},
            id="no weight at all",
        ),
        pytest.param(
            [4, 2, 7, 0],
            [1.0, -0.5, 0.0, 0.0],
            [4, 2, 7, 0],
            [1, 0, 0, 0],
            [False] * 4,
            {"negative": 3},
            id="negative",
        ),
        pytest.param(
            [4, 2, 7, 0],
            [-0.5, 0.0, -0.5, 0.0],
            [4, 2, 7, 0],
            [1, 0, 0, 0],
            [False] * 4,
            {"negative": 3, "all_zero": 3},
            id="nothing but negative",
        ),
        pytest.param(
            [4, 2, 7, 0],
            [3e-5, 1e-5, 0.0, 0.0],
            [4, 2, 7, 0],
            [0.75, 0.25, 0, 0],
            [False] * 4,
            {"not_normalised": 3},
            id="next to no weight",
        ),
        pytest.param(
            [5, 5, 1, 5],
            [0.25, 0.25, 0.375, 0.125],
            [5, NO_JOINT, 1, NO_JOINT],
            [0.625, 0, 0.375, 0],
            [False] * 4,
            {"repeated_joint": 3},
            id="a joint three times",
        ),
        pytest.param(
            [5, 5, 1, 5],
            [0.0, 0.25, 0.5, 0.25],
            [NO_JOINT, 5, 1, NO_JOINT],
            [0, 0.5, 0.5, 0],
            [True, False, False, False],
            {"repeated_joint": 3},
            id="a joint twice, named first without weight",
        ),
        pytest.param(
            [5, 5, 5, 1],
            [0.0, 0.0, 1.0, 0.0],
            [NO_JOINT, NO_JOINT, 5, 1],
            [0, 0, 1, 0],
            [True, True, False, True],
            {},
            id="a joint named twice without weight before the slot that has it",
        ),
        pytest.param(
            [9, 0, 0, 0],
            [1.0, 0.0, 0.0, 0.0],
            [9, 0, NO_JOINT, NO_JOINT],
            [1, 0, 0, 0],
            [False, True, True, True],
            {},
            id="padding",
        ),
        pytest.param(
            [5, 5, 1, 1],
            [1.0, -1.0, -1.0, 1.0],
            [5, NO_JOINT, NO_JOINT, 1],
            [0.5, 0, 0, 0.5],
            [False] * 4,
            {"negative": 3, "not_normalised": 3},
            id="a joint twice, once with a negative weight",
        ),
    ],
)
def test_a_vertexs_influences_are_mended(
    joints: list[int],
    weights: list[float],
    mended_joints: list[int],
    mended_weights: list[float],
    free: list[bool],
    defects: dict[str, int],
) -> None:
    field, found = field_of(joints, weights)
    assert field.joints.tolist() == [mended_joints] * 3
    # Quarters and eighths: exact, except where a decimal was divided by its sum.
    assert field.weights == pytest.approx(np.tile(mended_weights, (3, 1)), rel=1e-15, abs=0)
    assert field.free.tolist() == [free] * 3
    assert found == WeightDefects(**{name: defects.get(name, 0) for name in FINE._fields})


@pytest.mark.parametrize(("total", "counted"), [(1.0, 0), (0.9991, 0), (1.0009, 0), (0.998, 3), (1.002, 3)])
def test_a_sum_counts_as_wrong_beyond_a_thousandth(total: float, counted: int) -> None:
    _, defects = field_of([0, 1, 2, 3], [total - 0.25, 0.25, 0.0, 0.0])
    assert defects.not_normalised == counted


def test_the_stored_arrays_are_left_alone() -> None:
    primitive = triangle([5, 5, 1, 1], [0.5, -0.25, 0.0, 0.5])
    joints, weights = primitive.joints.copy(), primitive.weights.copy()
    weight_field(primitive)
    assert np.array_equal(primitive.joints, joints)
    assert np.array_equal(primitive.weights, weights)


def test_the_gradient_is_that_of_the_normalised_weights() -> None:
    # Shares of joint 1: 0, 1/2, 1, whatever the sums of 2, 8 and 1/2.
    weights = [[2.0, 0.0, 0.0, 0.0], [4.0, 4.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]]
    baked, findings = bake_one(triangle([0, 1, 2, 3], weights))
    assert baked.alpha.tolist() == [[0.5, 0.0, 0.0]] * 3
    assert baked.beta.tolist() == [[1.0, 0.0, 0.0]] * 3
    assert findings.weights.not_normalised == 3


def test_a_vertex_without_weight_follows_slot_0s_joint() -> None:
    # Joint 6 holds the first corner alone: its weight falls from 1 to 0 along both edges.
    joints = [[6, 1, 0, 0], [1, 6, 0, 0], [1, 6, 0, 0]]
    weights = [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    baked, findings = bake_one(triangle(joints, weights))
    # Slot 1 holds joint 1 at the first corner, which gains what joint 6 loses, and joint 6 at the others.
    assert baked.alpha.tolist() == [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]
    assert baked.beta.tolist() == [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]
    assert findings.weights == WeightDefects(negative=0, all_zero=1, not_normalised=0, repeated_joint=0)


def test_negative_weights_have_no_gradient() -> None:
    weights = [[1.0, -0.5, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [1.0, -9.0, 0.0, 0.0]]
    baked, findings = bake_one(triangle([0, 1, 2, 3], weights))
    # Joint 1 weighs 0, 1/2, 0. Another slot may not name it where its own slot holds a negative weight.
    assert baked.alpha.tolist() == [[0.5, 0.0, 0.0]] * 3
    assert not baked.beta.any()
    assert not baked.adopts
    assert findings.weights.negative == 2


@pytest.mark.parametrize("slots", [(1, 2), (2, 1)])
def test_a_repeated_joints_gradient_stands_in_one_slot(slots: tuple[int, int]) -> None:
    # Joint 5 weighs 0, 3/4, 1/2 in two parts; the first slot with weight carries it at each corner.
    first, second = slots
    weights = np.zeros((3, 4))
    weights[:, 0] = [1.0, 0.25, 0.5]
    weights[1, first], weights[1, second] = 0.5, 0.25
    weights[2, second] = 0.5
    baked, findings = bake_one(triangle([1, 5, 5, 5], weights), bake_settings(neighbours=Neighbours.DROP))
    carried = [1, 1, second]
    expected = np.zeros((3, 3))
    expected[np.arange(3), np.array(carried) - 1] = 0.75
    assert baked.alpha.tolist() == expected.tolist()
    assert baked.beta.tolist() == (expected * (2 / 3)).tolist()
    assert findings.weights.repeated_joint == 1


def test_joints_past_the_skin_at_weight_zero_are_ignored() -> None:
    weights = [[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
    outside, _ = bake_one(triangle([0, 1, 60000, 60000], weights))
    padded, _ = bake_one(triangle([0, 1, 0, 0], weights))
    assert np.array_equal(outside.alpha, padded.alpha)
    assert np.array_equal(outside.beta, padded.beta)
    assert not (outside.adopted_joints == 60000).any()


def test_integer_weights_need_no_mending() -> None:
    primitive = meshes_of(path_of("weights_u8.glb"))[0][0]
    _, defects = weight_field(primitive)
    assert defects == FINE


def notices_of(name: str, tmp_path: Path) -> dict[str, int]:
    source = path_of(name)
    result = bake_file(str(source), str(tmp_path / source.name))
    return {notice.code: notice.count for notice in result.notices}


@pytest.mark.slow
def test_real_files_defects_are_counted_once_each(tmp_path: Path) -> None:
    def count(name: str, code: str) -> int:
        """Count by plain loops over the independently read file."""
        found = 0
        file = read(path_of(name))
        skin = file.content["skins"][0]["joints"]
        for primitives in meshes_of(path_of(name)).values():
            for primitive in primitives:
                for joints, weights in zip(
                    primitive.joints.tolist(), primitive.weights.tolist(), strict=True
                ):
                    used = [joint for joint, weight in zip(joints, weights, strict=True) if weight > 0]
                    found += {
                        "weights-sum": bool(used) and abs(sum(weights) - 1.0) > 1e-3,
                        "weights-zero": not used,
                        "joints-repeated": len(set(used)) < len(used),
                        "joints-outside-skin": max(joints) >= len(skin),
                    }[code]
        return found

    for name, code in (
        (TREX, "weights-sum"),
        (AFRAME_HAND, "weights-zero"),
        (MANTIS, "joints-repeated"),
        (ELF, "joints-outside-skin"),
    ):
        expected = count(name, code)
        assert expected > 0
        assert notices_of(name, tmp_path)[code] == expected


def test_weights_that_move_nothing_leave_their_slots_free() -> None:
    field, defects = field_of([3, 5, 7, 9], [0.75, 0.25, 1e-11, 0.0])
    assert defects == FINE
    np.testing.assert_array_equal(field.free[0], [False, False, True, True])
    np.testing.assert_array_equal(field.weights[0], [0.75, 0.25, 0.0, 0.0])


def test_the_weight_of_an_adopted_slot_is_kept() -> None:
    field, _ = field_of([3, 5, 7, 9], [1.0, 2.0**-30, 0.0, 0.0])
    np.testing.assert_array_equal(field.free[0], [False, False, True, True])
    assert field.weights[0, 1] > 0.0
