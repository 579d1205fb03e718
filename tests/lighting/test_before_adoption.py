"""The weights that adopted slots took go back to the slots that paid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skinbake.format.adoption import UNIT, with_adopted
from skinbake.gltf.accessors import StoredArray
from skinbake.gltf.primitives import StoredInfluences
from skinbake.lighting.before_adoption import returned
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


@pytest.mark.parametrize("gradients", ["surface", "rig"])
def test_a_border_of_primitives_with_one_and_two_sets_is_fresh(gradients: str, tmp_path: Path) -> None:
    """At the border joint 4 takes the slot of joint 0. One primitive alone has further empty slots."""
    place = sheet().attributes["POSITION"].astype(np.float64)
    border = place[:, 0] == place[:, 0].max()
    joints = np.where(border[:, None], [1, 2, 3, 0], [4, 0, 1, 0]).astype(np.uint8)
    weights = np.where(border[:, None], [0.5, 0.3, 0.2, 0.0], [0.6, 0.3, 0.1, 0.0]).astype(np.float32)
    mirrored = [2 * place[:, 0].max(), 0, 0] + place * [-1, 1, 1]
    none = np.zeros((len(place), 4))
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
    original = write_model(tmp_path / "two.glb", parts, joints=5)
    written = baked(original, tmp_path / "baked", gradients=gradients)
    model = Editable(written)
    assert (model.array("JOINTS_0", 1)[border] == [1, 2, 3, 4]).all()
    assert not model.array("_SKINBAKE_ALPHA_1", 1)[border].any()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages


def test_a_joint_that_leaves_a_slot_of_negative_weight_is_fresh(tmp_path: Path) -> None:
    """A slot of negative weight is not empty, so its joint 0 goes into another slot."""
    place = sheet().attributes["POSITION"]
    border = place[:, :1] == place[:, 0].max()
    joints = np.where(border, [1, 2, 3, 0], [4, 0, 1, 0]).astype(np.uint8)
    weights = np.where(border, [0.5, 0.3, 0.3, -0.1], [0.6, 0.3, 0.1, 0.0]).astype(np.float32)
    original = write_model(tmp_path / "negative.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=5)
    written = baked(original, tmp_path / "baked", gradients="rig", neighbours="extend")
    assert (np.sort(Editable(written).array("JOINTS_1")[border[:, 0]]) == [0, 0, 0, 4]).all()
    answer = verify(written, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages
