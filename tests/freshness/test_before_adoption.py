"""The weights that adopted slots took go back to the slots that paid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.format.digests import array_digest
from skinbake.format.influences import with_adopted
from skinbake.freshness.baked_views import baked_views
from skinbake.freshness.expected import before_adoption, returned
from skinbake.geometry.skinned import TINY_WEIGHT, UNIT
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.accessors import StoredArray
from skinbake.gltf.reading.meshes import StoredInfluences, skinned_sources
from tests.support.baked_files import Editable, baked, source, verify
from tests.support.models import sheet, write_model


def stored(values: object, dtype: type) -> StoredArray:
    return StoredArray(np.array(values, dtype=dtype), normalized=dtype is np.uint16)


@pytest.mark.parametrize(
    "units",
    [
        [40000, 25535, 0, 0],
        [32768, 32767, 0, 0],
        [21845, 21845, 21845, 0],
        [16384, 16384, 32767, 0],
        [65535, 0, 0, 0],
    ],
)
def test_copies_that_paid_different_amounts_agree_again(units: list[int]) -> None:
    free = [slot for slot in range(4) if units[slot] == 0]
    influences = StoredInfluences(stored([[1, 3, 2, 0]] * 4, np.uint8), stored([units] * 4, np.uint16))
    adopted = np.full((4, 4), -1)
    for copy in range(1, 4):
        names = free[:copy]
        adopted[copy, names] = np.arange(5, 5 + len(names))
    (baked,) = with_adopted([influences], np.arange(4), adopted)
    weights, took = baked.weights.values.astype(np.float64) / UNIT, adopted >= 0
    joints = baked.joints.values.astype(np.int64)
    found = returned(weights, np.where(took, 1.0 / UNIT, 0.0), joints)
    assert np.any(weights[1:] != weights[0])
    assert np.array_equal(found, np.array([units] * 4) / UNIT)


def test_a_bake_of_weights_with_a_small_sum_is_fresh(tmp_path: Path) -> None:
    """Bake divides weights by their sum, so the unit of an adopted slot is a larger share of a small sum."""
    model = Editable(source("weights_u8.glb"))
    weights = model.array("WEIGHTS_0")
    weights[:] = np.round(0.3 * weights)
    written = baked(model.write(tmp_path / "small.glb"), tmp_path / "baked", gradients="surface")
    assert "adopted" in Editable(written).metadata()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("gradients", ["surface", "fitted"])
@pytest.mark.parametrize("total", [1.0, 0.01, 0.002])
def test_slots_of_tiny_weights_that_adopt_are_known_at_any_sum(
    total: float, gradients: str, tmp_path: Path
) -> None:
    """Some exporters leave weights of 1e-11. 2⁻³⁰ in their place is a millionth and more of a small sum."""
    model = Editable(source("foreign_joints.glb"))
    weights = model.array("WEIGHTS_0")
    left = weights == 0.0
    weights[:] = total * np.where(left, 1e-11, weights)
    written = baked(model.write(tmp_path / "tiny.glb"), tmp_path / "baked", gradients=gradients)
    assert (Editable(written).array("WEIGHTS_0")[left] == TINY_WEIGHT).any()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("gradients", ["surface", "fitted"])
def test_a_joint_named_again_before_its_own_slot_at_a_tiny_weight_is_fresh(
    gradients: str, tmp_path: Path
) -> None:
    """Such a weight counts as 0, so the later slot has the joint's gradient. Without adoption it stays."""
    weights = sheet().attributes["WEIGHTS_0"].astype(np.float32)[:, [3, 0, 1, 2]]
    weights[:, 0] = 1e-11
    joints = np.tile(np.array([[1, 0, 1, 0]], dtype=np.uint8), (len(weights), 1))
    original = write_model(tmp_path / "again.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)])
    written = baked(original, tmp_path / "baked", gradients=gradients, neighbours="drop")
    model = Editable(written)
    assert np.array_equal(model.array("WEIGHTS_0"), weights)
    assert model.array("_SKINBAKE_ALPHA_0")[:, 1].any()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("neighbours", ["adopt", "extend"])
def test_a_stored_weight_of_one_unit_is_none_that_a_slot_was_given(neighbours: str, tmp_path: Path) -> None:
    """The file still has the weights from before the bake, so also before a set was added."""
    steps = (sheet().attributes["POSITION"][:, :1] > 0.1).astype(int)
    joints = np.where(steps, [[1, 2, 0, 0]], [[1, 0, 1, 0]]).astype(np.uint8)
    weights = np.where(steps, [[35535, 30000, 0, 0]], [[1, 35533, 30000, 1]]).astype(np.uint16)
    original = write_model(tmp_path / "unit.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=3)
    written = baked(original, tmp_path / "baked", gradients="fitted", neighbours=neighbours)
    model = Editable(written)
    assert "adopted" in model.metadata()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("neighbours", ["adopt", "drop"])
@pytest.mark.parametrize("seed", range(4))
def test_a_stored_weight_of_one_unit_is_none_that_a_slot_was_given_after_a_limit(
    seed: int, neighbours: str, tmp_path: Path
) -> None:
    """The file still has the weights from before the limit. Σw is small, so that a unit shows."""
    random = np.random.default_rng(seed)
    units = random.choice([0, 0, 1, 1, 5, 30], (20, 8))
    units[:, 0] += 66  # enough to adopt
    joints = random.permuted(np.tile(np.arange(8), (20, 1)), axis=1)
    arrays: dict[str, npt.NDArray[Any]] = {}
    for number, slots in enumerate((slice(0, 4), slice(4, 8))):
        arrays[f"WEIGHTS_{number}"] = units[:, slots].astype(np.uint16)
        arrays[f"JOINTS_{number}"] = np.where(units == 0, 0, joints)[:, slots].astype(np.uint8)
    original = write_model(tmp_path / "unit.glb", [sheet(**arrays)], joints=8)
    written = baked(original, tmp_path / "baked", limit_influences=4, neighbours=neighbours)
    assert (Editable(written).array("WEIGHTS_0") == 1).any()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


def two_primitives(folder: Path, gradients: str, left: float = 0.0) -> Editable:
    """Bake two primitives, at whose border joint 4 takes the slot of joint 0. One has further free slots.

    Free slots hold the weight ``left``.
    """
    place = sheet().attributes["POSITION"].astype(np.float64)
    border = place[:, 0] == place[:, 0].max()
    joints = np.where(border[:, None], [1, 2, 3, 0], [4, 0, 1, 0]).astype(np.uint8)
    weights = np.where(border[:, None], [0.5, 0.3, 0.2, 0.0], [0.6, 0.3, 0.1, 0.0]).astype(np.float32)
    mirrored = [2 * place[:, 0].max(), 0, 0] + place * [-1, 1, 1]
    weights[weights == 0.0] = left
    none = np.full((len(place), 4), left)
    parts = [
        sheet(JOINTS_0=joints, WEIGHTS_0=weights),
        sheet(
            POSITION=mirrored.astype(np.float32),
            JOINTS_0=joints,
            WEIGHTS_0=weights,
            JOINTS_1=none.astype(np.uint8),
            WEIGHTS_1=none.astype(np.float32),
        ),
    ]
    parts[1] = replace(parts[1], indices=np.asarray(parts[1].indices)[:, ::-1])
    original = write_model(folder / "two.glb", parts, joints=5)
    model = Editable(baked(original, folder / "baked", gradients=gradients))
    assert (model.array("JOINTS_0", 1)[border] == [1, 2, 3, 4]).all()
    assert not model.array("_SKINBAKE_ALPHA_1", 1)[border].any()
    return model


@pytest.mark.parametrize("left", [0.0, 1e-11])
@pytest.mark.parametrize("gradients", ["surface", "fitted"])
def test_a_border_of_primitives_with_one_and_two_sets_is_fresh(
    gradients: str, left: float, tmp_path: Path
) -> None:
    model = two_primitives(tmp_path, gradients, left)
    answer = verify(model.write(tmp_path / "fresh.glb"), "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("gradients", ["surface", "fitted"])
@pytest.mark.parametrize("damaged", [0, 1])
def test_damage_beside_slots_whose_joint_has_left_them_is_found_where_it_is(
    damaged: int, gradients: str, tmp_path: Path
) -> None:
    model = two_primitives(tmp_path, gradients)
    alpha = model.array("_SKINBAKE_ALPHA_0", damaged)
    alpha[np.abs(alpha).max(axis=1).argmax()] *= -1.0
    answer = verify(model.write(tmp_path / "damaged.glb"), "--poses", "rest")
    assert [(one["primitive"], one["count"]) for one in answer.problems("freshness")] == [(damaged, 1)]


def test_a_slot_that_lost_its_gradient_is_no_slot_whose_joint_has_left_it(tmp_path: Path) -> None:
    """A joint leaves a slot only for a slot that adopts it, and no slot of this bake adopts any."""
    steps = np.digitize(sheet().attributes["POSITION"][:, 0], [-0.6, 0.1])
    joints = np.array([[0, 1, 0, 0], [1, 2, 0, 0], [2, 1, 0, 0]])[steps].astype(np.uint8)
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (len(steps), 1))
    original = write_model(tmp_path / "hard.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=3)
    model = Editable(baked(original, tmp_path / "baked", gradients="surface", neighbours="drop"))
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        slots = model.array(name)
        assert slots[:, 0].any()
        slots[:] = 0.0
    answer = verify(model.write(tmp_path / "zeroed.glb"), "--poses", "rest")
    assert answer.failed == ["freshness"], answer.messages


@pytest.mark.parametrize("slot", range(4))
@pytest.mark.parametrize("gradients", ["surface", "fitted"])
def test_a_vertex_with_a_negative_weight_adopts_nothing_and_is_fresh(
    gradients: str, slot: int, tmp_path: Path
) -> None:
    """The slot of negative weight has the gradient of its joint 0, which no other slot may name."""
    place = sheet().attributes["POSITION"]
    border = place[:, :1] == place[:, 0].max()
    joints = np.where(border, [1, 2, 3, 0], [4, 0, 1, 0]).astype(np.uint8)
    weights = np.where(border, [0.5, 0.3, 0.3, -0.1], [0.6, 0.3, 0.1, 0.0]).astype(np.float32)
    part = sheet(JOINTS_0=np.roll(joints, slot - 3, axis=1), WEIGHTS_0=np.roll(weights, slot - 3, axis=1))
    original = write_model(tmp_path / "negative.glb", [part], joints=5)
    written = baked(original, tmp_path / "baked", gradients=gradients, neighbours="extend")
    assert (Editable(written).array("JOINTS_0") == part.attributes["JOINTS_0"])[border[:, 0]].all()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("gradients", ["surface", "fitted"])
@pytest.mark.parametrize(
    ("kind", "multiples"),
    [(np.uint8, [1, 2, 12]), (np.uint16, [30, 7, 3000]), (np.float32, [1.0, 0.25, 2**-6])],
)
def test_copies_that_store_other_multiples_of_their_weights_are_fresh(
    kind: type, multiples: list[float], gradients: str, tmp_path: Path
) -> None:
    """They are one point of the surface. What an adopted slot takes is another share of each of them."""
    part = sheet()
    place, corners = part.attributes["POSITION"], np.asarray(part.indices).ravel()
    steps = np.digitize(place[:, 0], [-0.6, 0.1, 0.6])
    joints = np.array([[0, 1, 0, 0], [1, 2, 0, 0], [3, 0, 0, 0], [4, 3, 0, 0]])[steps][corners]
    weights = np.array([[12, 8, 0, 0], [15, 5, 0, 0], [20, 0, 0, 0], [11, 9, 0, 0]])[steps][corners]
    multiple = np.array(multiples)[np.arange(len(corners)) % 3][:, None] * (0.05 if kind is np.float32 else 1)
    arrays = {name: array[corners] for name, array in part.attributes.items()}
    arrays |= {"JOINTS_0": joints.astype(np.uint8), "WEIGHTS_0": (weights * multiple).astype(kind)}
    corner_by_corner = replace(part, attributes=arrays, indices=np.arange(len(corners)).reshape(-1, 3))
    original = write_model(tmp_path / "multiples.glb", [corner_by_corner], joints=5)
    written = baked(original, tmp_path / "baked", gradients=gradients)
    assert "adopted" in Editable(written).metadata()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


def test_copies_whose_payer_cannot_be_told_are_fresh(tmp_path: Path) -> None:
    """34 and 32 units are left of 36 and 32, or of 34 and 34. The file still has the weights from before."""
    part = sheet()
    place, corners = part.attributes["POSITION"], np.asarray(part.indices).ravel()
    steps = (place[:, 0] > 0.1).astype(int)
    joints = np.array([[0, 1, 0, 0], [2, 3, 0, 0]])[steps][corners]
    multiple = np.array([4, 5, 400])[np.arange(len(corners)) % 3][:, None]
    arrays = {name: array[corners] for name, array in part.attributes.items()}
    arrays["JOINTS_0"] = joints.astype(np.uint8)
    arrays["WEIGHTS_0"] = (multiple * [9, 8, 0, 0]).astype(np.uint16)
    corner_by_corner = replace(part, attributes=arrays, indices=np.arange(len(corners)).reshape(-1, 3))
    original = write_model(tmp_path / "ties.glb", [corner_by_corner], joints=4)
    written = baked(original, tmp_path / "baked", gradients="surface")
    assert [34, 32] in Editable(written).array("WEIGHTS_0")[:, :2].tolist()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("gradients", ["surface", "fitted"])
@pytest.mark.parametrize("kept", [True, False])
def test_the_weights_from_before_do_not_hide_an_edit_of_those_that_paid(
    kept: bool, gradients: str, tmp_path: Path
) -> None:
    """A sixth of the largest weight went to the second one or nowhere, and the digest was made anew."""
    model = Editable(baked(source("weights_u8.glb"), tmp_path, gradients=gradients))
    weights = model.array("WEIGHTS_0")
    assert weights.dtype == np.uint16
    edited = np.flatnonzero((weights == 1).any(axis=1) & (np.count_nonzero(weights > 1, axis=1) >= 2))
    order = np.argsort(weights[edited].astype(int), axis=1)
    step = weights[edited, order[:, -1]] // 6
    weights[edited, order[:, -1]] -= step
    if kept:
        weights[edited, order[:, -2]] += step
    model.metadata()["digest"]["WEIGHTS"] = array_digest(weights / np.float32(UNIT), "<f4")
    answer = verify(model.write(tmp_path / "edited.glb"), "--poses", "rest")
    assert answer.failed == ["freshness"], answer.messages
    (problem,) = answer.problems("freshness")
    assert problem["message"].startswith("α/β are wrong at")


def test_float_weights_beside_integer_ones_come_back_as_they_were(tmp_path: Path) -> None:
    """Only integer weights paid for adopted slots, in whole units."""
    part = sheet()
    joints = np.array([[0, 1, 0, 0], [1, 2, 0, 0]])[(part.attributes["POSITION"][:, 0] > 0.1).astype(int)]
    shares = np.tile([0.7654321, 1.0 - 0.7654321, 0, 0], (len(joints), 1))
    kinds = shares.astype(np.float32), np.round(255 * shares).astype(np.uint8)
    parts = [sheet(JOINTS_0=joints.astype(np.uint8), WEIGHTS_0=weights) for weights in kinds]
    written = baked(write_model(tmp_path / "two.glb", parts, joints=3), tmp_path / "baked")
    document = read_document(str(written))
    views = baked_views(document, skinned_sources(document))
    assert not list(document.notices) and all(view.note.adopted for view in views)
    found = [primitive.weights for primitive in before_adoption(document, views)]
    assert np.array_equal(found[0], kinds[0])
    assert np.array_equal(found[1], kinds[1] / 255.0)


@pytest.mark.parametrize("total", [1.0, 0.01])
def test_float_weights_of_a_small_sum_come_back_without_the_given_ones(total: float, tmp_path: Path) -> None:
    """2⁻³⁰ is rounding of 1, and more than that of 0.01: copies in two meshes would no longer be one."""
    model = Editable(source("foreign_joints.glb"))
    weights = model.array("WEIGHTS_0")
    weights *= np.float32(total)
    before = weights.copy()
    written = baked(model.write(tmp_path / "small.glb"), tmp_path / "baked")
    assert (Editable(written).array("WEIGHTS_0") == TINY_WEIGHT).any()
    document = read_document(str(written))
    (found,) = before_adoption(document, baked_views(document, skinned_sources(document)))
    assert np.array_equal(found.weights == 0.0, before == 0.0) == (total < 1.0)
    assert np.abs(found.weights - before).max() <= TINY_WEIGHT * (total == 1.0)
