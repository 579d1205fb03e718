"""The weights that adopted slots took go back to the slots that paid."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.format.adoption import UNIT, with_adopted
from skinbake.gltf.accessors import StoredArray
from skinbake.gltf.primitives import StoredInfluences
from skinbake.lighting.before_adoption import returned


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
