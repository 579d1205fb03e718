from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.budget import Cost
from skinbake.truth import mesh
from skinbake.truth.mesh import weld_classes
from tests.support.labels import as_met

UP = [0.0, 0.0, 1.0]


def copies(
    *,
    positions: object = (0.0, 0.0, 0.0),
    normals: object = UP,
    joints: object = (0, 1, 2, 3),
    weights: object = (0.5, 0.5, 0.0, 0.0),
    dtype: type = np.float32,
) -> SkinnedPrimitive:
    parts = [np.atleast_2d(np.asarray(part)) for part in (positions, normals, joints, weights)]
    count = max(len(part) for part in parts)
    at, along, bound, shares = (np.array(np.broadcast_to(part, (count, part.shape[1]))) for part in parts)
    return SkinnedPrimitive(
        at.astype(dtype),
        along.astype(dtype),
        None,
        bound,
        shares.astype(dtype),
        np.zeros((0, 3), dtype=np.int64),
    )


def tilted(*degrees: float) -> list[list[float]]:
    return [[math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))] for angle in degrees]


def partition(*primitives: SkinnedPrimitive, crease: float = 15.0) -> list[int]:
    """Number the classes in the order in which they appear."""
    return as_met(weld_classes(primitives, crease_angle_degrees=crease))


def test_positions_must_be_equal() -> None:
    assert partition(copies(positions=[[0, 0, 0], [-0.0, 0, -0.0], [0, 1e-30, 0]])) == [0, 0, 1]


@pytest.mark.parametrize(
    ("angles", "classes"),
    [
        ((0.0, 14.99), [0, 0]),
        ((0.0, 15.01), [0, 1]),
        ((0.0, 20.0), [0, 1]),
        ((0.0, 20.0, 10.0), [0, 0, 0]),
        ((0.0, 20.0, 40.0, 10.0, 100.0, 90.0), [0, 0, 1, 0, 2, 2]),
        ((0.0, 180.0), [0, 1]),
    ],
)
def test_normals_chain_up_to_the_crease_angle(angles: tuple[float, ...], classes: list[int]) -> None:
    assert partition(copies(normals=tilted(*angles))) == classes


def test_the_crease_angle_is_an_option_from_0_to_180() -> None:
    normals = copies(normals=tilted(0.0, 0.001, 0.0, 180.0))
    assert partition(normals, crease=0.0) == [0, 1, 0, 2]
    assert partition(normals, crease=180.0) == [0, 0, 0, 0]


def test_chains_do_not_leap_between_places() -> None:
    places = [[0, 0, 0], [1, 0, 0], [0, 0, 0]]
    assert partition(copies(positions=places, normals=tilted(0.0, 10.0, 20.0))) == [0, 1, 2]


def test_normals_may_have_any_length() -> None:
    long = np.array(tilted(0.0, 10.0, 30.0)) * [[1e-200], [1e200], [7.0]]
    assert partition(copies(normals=long, dtype=np.float64)) == [0, 0, 1]


def test_broken_normals_weld_only_with_their_own_bits() -> None:
    zero, nan, infinite = [0.0, 0.0, 0.0], [math.nan, 0.0, 1.0], [math.inf, 0.0, 0.0]
    normals = [UP, zero, zero, nan, nan, infinite, [1.0, 0.0, 0.0], UP, infinite]
    assert partition(copies(normals=normals)) == [0, 1, 1, 2, 2, 3, 4, 0, 3]
    assert partition(copies(normals=normals), crease=180.0) == [0, 1, 1, 2, 2, 3, 0, 0, 3]


def test_minus_zero_in_a_normal_is_zero() -> None:
    """Of a normal without a direction too, which has no angle to the other sign."""
    normals = [[0.0, 0.0, 0.0], [-0.0, 0.0, -0.0], UP, [-0.0, -0.0, 1.0]]
    assert partition(copies(normals=normals), crease=0.0) == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("joints", "weights", "welds"),
    [
        ([[0, 1, 2, 3], [1, 0, 3, 2]], [[0.7, 0.3, 0.0, 0.0], [0.3, 0.7, 0.0, 0.0]], True),
        ([[0, 1, 2, 3], [0, 1, 9, 9]], [[0.7, 0.3, 0.0, 0.0], [0.7, 0.3, 0.0, 0.0]], True),
        ([[0, 1, 2, 3], [0, 1, 0, 1]], [[0.7, 0.3, 0.0, 0.0], [0.35, 0.15, 0.35, 0.15]], True),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.7, 0.3, 0.0, 0.0], [1.4, 0.6, 0.0, 0.0]], True),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.7, 0.3, 0.0, 0.0], [0.7, 0.3, -0.2, 0.0]], True),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.7, 0.3, 0.0, 0.0], [0.7, 0.3, 1e-50, 0.0]], True),
        ([[4, 1, 2, 3], [4, 2, 1, 3]], [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]], True),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.7, 0.3, 0.0, 0.0], [0.6999, 0.3001, 0.0, 0.0]], False),
        ([[0, 1, 2, 3], [0, 2, 1, 3]], [[0.7, 0.3, 0.0, 0.0], [0.7, 0.3, 0.0, 0.0]], False),
        ([[0, 1, 2, 3], [1, 0, 2, 3]], [[0.7, 0.3, 0.0, 0.0], [0.7, 0.3, 0.0, 0.0]], False),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], [[0.7, 0.3, 0.0, 0.0], [0.7, 0.3, 1e-4, 0.0]], False),
    ],
)
def test_influences_are_compared_as_a_map(joints: object, weights: object, welds: bool) -> None:
    assert (partition(copies(joints=joints, weights=weights, dtype=np.float64)) == [0, 0]) == welds


def test_primitives_of_other_types_and_widths_weld() -> None:
    narrow = copies(positions=[[0.5, 0.25, 0.0], [1.0, 0.0, 0.0]], weights=[0.5, 0.25, 0.25, 0.0])
    wide = copies(
        positions=[[1.0, 0.0, 0.0], [0.5, 0.25, 0.0]],
        joints=[9, 9, 9, 9, 2, 1, 0, 9],
        weights=[0.0, 0.0, 0.0, 0.0, 0.25, 0.25, 0.5, 0.0],
        dtype=np.float64,
    )
    assert partition(narrow, wide) == [0, 1, 1, 0]


@pytest.mark.parametrize(
    ("count", "classes"), [pytest.param(4_096, 1, marks=pytest.mark.slow), (4_097, 4_097), (20_000, 20_000)]
)
def test_many_vertices_at_one_place_stay_cheap(count: int, classes: int) -> None:
    """A sphere of normals at one point, as collapsed geometry has. Past a limit only equal ones weld."""
    angles = np.random.default_rng(0).random((count, 2)) * [2.0 * math.pi, math.pi]
    across = np.sin(angles[:, 1])
    normals = np.column_stack(
        [across * np.cos(angles[:, 0]), across * np.sin(angles[:, 0]), np.cos(angles[:, 1])]
    )
    assert len(set(partition(copies(normals=normals, dtype=np.float64), crease=15.0))) == classes


@pytest.mark.parametrize("crease", [0.0, 15.0, 70.0, 180.0])
@pytest.mark.parametrize("places", [2, 9])
def test_normals_at_a_place_weld_as_a_tree_and_a_graph_find_them(crease: float, places: int) -> None:
    """SciPy finds the pairs: places lie 4 apart, so only normals at one place are near each other."""
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(3000, 3))
    normals[rng.random(3000) < 0.3] = UP
    units = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32).astype(np.float64)
    positions = rng.integers(0, places, (3000, 3))
    tree = cKDTree(np.hstack([4.0 * positions, units]))
    pairs = tree.query_pairs(2.0 * np.sin(np.radians(crease) / 2.0) + 1e-7, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(3000, 3000))
    expected = as_met(connected_components(graph, directed=False)[1])
    assert partition(copies(positions=positions, normals=units), crease=crease) == expected


def test_long_chains_are_one_class() -> None:
    angles = np.random.default_rng(1).permutation(np.arange(0.0, 180.0, 6.0)).tolist()
    assert set(partition(copies(normals=tilted(*angles)), crease=7.0)) == {0}
    assert len(set(partition(copies(normals=tilted(*angles)), crease=5.0))) == 30


def test_pairs_at_crowded_places_are_claimed_before_they_are_listed() -> None:
    count = 64
    close = copies(normals=tilted(*np.linspace(0, 10, count)))
    claimed: list[int] = []
    weld_classes([close], claim=claimed.append)
    assert sum(claimed) >= Cost.WELDED_PAIR.bytes * count * (count - 1)

    class RefusedError(Exception):
        pass

    def refuse(size: int) -> None:
        raise RefusedError

    with pytest.raises(RefusedError):
        weld_classes([close], claim=refuse)


def test_classes_are_numbered_by_their_first_vertices() -> None:
    """Neighbours of a mesh then lie near in memory, also in arrays with a row for each class."""
    rng = np.random.default_rng(0)
    classes = weld_classes([copies(positions=rng.integers(0, 5, (200, 3)))]).tolist()
    assert list(dict.fromkeys(classes)) == list(range(max(classes) + 1))
    assert max(classes) + 1 < 200


def test_rows_of_one_hash_are_told_apart() -> None:
    first = np.random.default_rng(1).integers(0, 9, (200, 1))
    # A column equal to the hash of the columns before it makes the hash 0.
    rows = np.hstack([first, mesh.row_hashes(first).view(np.int64)[:, None]])
    assert set(mesh.row_hashes(rows).tolist()) == {0}
    expected = as_met(np.unique(first, return_inverse=True)[1].reshape(-1))
    assert len(set(expected)) == 9
    assert as_met(mesh.row_numbers(rows)) == expected
