"""The two ways to gather gradients, whole-array and compiled: one result, on good and on bad input."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.bake import gradients
from skinbake.bake.baker import BakeFindings, BakeSettings, bake_mesh
from skinbake.bake.corner import WEIGHTINGS
from skinbake.bake.gradients import VertexGradients, weight_gradients
from skinbake.bake.influences import weight_field
from skinbake.bake.weld import concatenated, weld
from skinbake.geometry.skinned import BakedPrimitive, Float64Array, SkinnedPrimitive
from skinbake.geometry.triangles import proper
from tests.bake.models import (
    AFRAME_HAND,
    BARBARIAN,
    CESIUM_MAN,
    ELF,
    HAND_U8,
    MANTIS,
    PBR_TEST,
    TREX,
    meshes_of,
    path_of,
)
from tests.surfaces import analytic_surface

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="numba, which compiles one of the two, is not installed"
)

FIXTURES = ["bent_tube.glb", "two_primitives.glb", "two_sets.glb", "foreign_joints.glb", "weights_u8.glb"]
MODELS = [CESIUM_MAN, BARBARIAN, TREX, PBR_TEST, HAND_U8, ELF, MANTIS, AFRAME_HAND]

COMPILED, WHOLE_ARRAYS = 0, 1 << 60
"""COMPILED_FROM, the number of triangles from which the compiled kernel is taken: always, never."""


def gathered(
    primitives: Sequence[SkinnedPrimitive], weighting: str, path: int, monkeypatch: pytest.MonkeyPatch
) -> tuple[VertexGradients, int]:
    """Return the gradients of one mesh, and how many joints it has."""
    field = concatenated([weight_field(part)[0] for part in primitives])
    positions = np.concatenate([part.positions for part in primitives])
    starts = np.cumsum([0, *(len(part.positions) for part in primitives)])
    triangles = np.concatenate(
        [part.triangles + start for part, start in zip(primitives, starts, strict=False)]
    )
    triangles = triangles[proper(positions, triangles)]
    normals = np.concatenate([part.normals for part in primitives])
    classes = weld(positions, normals, field, crease_angle=np.radians(15.0))
    monkeypatch.setattr(gradients, "COMPILED_FROM", path)
    found = weight_gradients(positions, triangles, field, classes, weighting=weighting)
    return found, int(field.joints.max()) + 1


def dense(found: VertexGradients, joints: int) -> Float64Array:
    """Return the gradients as (C, J, 3)."""
    table = np.zeros((len(found.offsets) - 1, joints, 3))
    owner = np.repeat(np.arange(len(table)), np.diff(found.offsets))
    table[owner, found.joints] = found.gradients
    return table


def assert_sound(found: VertexGradients) -> None:
    """Check the rows as the docstring promises them."""
    assert found.offsets[0] == 0
    assert found.offsets[-1] == len(found.joints) == len(found.gradients)
    assert found.joints.dtype == found.offsets.dtype == np.int64
    for start, end in zip(found.offsets[:-1], found.offsets[1:], strict=True):
        assert (np.diff(found.joints[start:end]) > 0).all()
    assert np.isfinite(found.gradients).all()


def assert_paths_agree(
    primitives: Sequence[SkinnedPrimitive], weighting: str, monkeypatch: pytest.MonkeyPatch
) -> Float64Array:
    tables = []
    for path in (WHOLE_ARRAYS, COMPILED):
        found, joints = gathered(primitives, weighting, path, monkeypatch)
        assert_sound(found)
        tables.append(dense(found, joints))
    plain, compiled = tables
    # Copies of a vertex may differ in their weights' last digits below float32: each array corner takes its
    # own copy's weights, the compiled class those of its first corner.
    assert np.abs(compiled - plain).max() <= 1e-7 * np.abs(plain).max(initial=0.0)
    for table in tables:
        # Weights sum to one, so their gradients sum to zero, up to float64's rounding times some ten terms.
        assert np.abs(table.sum(axis=1)).max() <= 1e-12 * max(np.abs(table).max(), 1.0)
    return plain


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("name", FIXTURES)
def test_both_paths_agree_on_fixtures(name: str, weighting: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for primitives in meshes_of(path_of(name)).values():
        assert assert_paths_agree(primitives, weighting, monkeypatch).any()


@pytest.mark.parametrize("name", MODELS)
def test_both_paths_agree_on_real_models(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for primitives in meshes_of(path_of(name)).values():
        assert_paths_agree(primitives, "max", monkeypatch)


def test_the_compiled_path_is_taken_from_a_number_of_triangles_on(monkeypatch: pytest.MonkeyPatch) -> None:
    [primitives] = meshes_of(path_of("foreign_joints.glb")).values()
    compiled = gradients._compiled_gather()
    assert compiled is not None
    calls: list[int] = []

    def counted(*arguments: object) -> object:
        calls.append(1)
        return compiled(*arguments)

    monkeypatch.setattr(gradients, "_compiled_gather", lambda: counted)
    count = len(primitives[0].triangles)
    for least, taken in ((count + 1, 0), (count, 1)):
        gathered(primitives, "max", least, monkeypatch)
        assert len(calls) == taken


def test_without_a_compiler_large_meshes_take_the_other_path(monkeypatch: pytest.MonkeyPatch) -> None:
    [primitives] = meshes_of(path_of("foreign_joints.glb")).values()
    expected, joints = gathered(primitives, "max", WHOLE_ARRAYS, monkeypatch)
    # None in sys.modules makes the import fail, as where numba is not installed.
    monkeypatch.setitem(sys.modules, "skinbake.bake.compiled", None)
    found, _ = gathered(primitives, "max", COMPILED, monkeypatch)
    assert np.array_equal(dense(found, joints), dense(expected, joints))


def degenerate() -> SkinnedPrimitive:
    """Return a mesh with all that has no area or no triangle, next to slivers and huge and tiny triangles."""
    surface = analytic_surface(100, "random", seed=4).primitive
    count = len(surface.positions)
    extra = np.array(
        [
            [0.0, 0.0, 9.0],
            [1.0, 0.0, 9.0],
            [2.0, 0.0, 9.0],  # on the line of the two above
            [1.0, 1e-12, 9.0],  # a sliver's height away from it
            [1e6, 1e6, 9.0],
            [1e-6, 0.0, 9.0],
            [0.0, 1e-6, 9.0],
            [5.0, 5.0, 5.0],  # of no triangle
        ]
    )
    faces = np.array([[0, 1, 2], [0, 1, 1], [2, 2, 2], [0, 1, 3], [0, 2, 4], [0, 5, 6]]) + count
    faces = np.concatenate([faces, [[0, 0, 1], [0, 1, 0]]])
    return SkinnedPrimitive(
        np.concatenate([surface.positions, extra]),
        np.concatenate([surface.normals, np.tile([0.0, 0.0, 1.0], (len(extra), 1))]),
        None,
        np.concatenate([surface.joints.astype(np.int64), np.tile([[0, 5, 5, 9]], (len(extra), 1))]),
        np.concatenate([surface.weights, np.random.default_rng(0).random((len(extra), 4))]),
        np.concatenate([surface.triangles, faces]),
    )


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_both_paths_ignore_what_has_no_area_without_a_warning(
    weighting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Warnings are errors in this suite: a division by an area of zero would not pass.
    table = assert_paths_agree([degenerate()], weighting, monkeypatch)
    assert not table[-1].any()


def empty(vertices: int) -> SkinnedPrimitive:
    return SkinnedPrimitive(
        np.zeros((vertices, 3), dtype=np.float32),
        np.tile(np.array([0, 0, 1], dtype=np.float32), (vertices, 1)),
        None,
        np.tile([3, 0, 0, 0], (vertices, 1)),
        np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (vertices, 1)),
        np.zeros((0, 3), dtype=np.int64),
    )


@pytest.mark.parametrize("path", [WHOLE_ARRAYS, COMPILED])
@pytest.mark.parametrize("faces", [[], [[0, 1, 2]]])
def test_a_mesh_without_any_area_has_alpha_zero(
    path: int, faces: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gradients, "COMPILED_FROM", path)
    part = empty(3)
    flat = SkinnedPrimitive(
        part.positions,
        part.normals,
        None,
        part.joints,
        part.weights,
        np.array(faces, dtype=np.int64).reshape(-1, 3),
    )
    [(found, numbers)] = bake_mesh([flat], BakeSettings())
    assert found.alpha.tolist() == np.zeros((3, 3)).tolist()
    assert numbers.degenerate_triangles == len(faces)
    assert numbers.lost == 0.0
    assert not found.adopts


@pytest.mark.parametrize("name", ["foreign_joints.glb", CESIUM_MAN, BARBARIAN])
def test_both_paths_bake_the_same_file(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def bake(path: int) -> list[tuple[BakedPrimitive, BakeFindings]]:
        monkeypatch.setattr(gradients, "COMPILED_FROM", path)
        return [
            outcome
            for primitives in meshes_of(path_of(name)).values()
            for outcome in bake_mesh(primitives, BakeSettings())
        ]

    def joints(outcome: BakedPrimitive) -> list[list[int]]:
        listed: list[list[int]] = np.sort(outcome.adopted_joints, axis=1).tolist()
        return listed

    for (plain, own), (compiled, numbers) in zip(bake(WHOLE_ARRAYS), bake(COMPILED), strict=True):
        assert joints(compiled) == joints(plain)
        assert numbers.overflowing_vertices == own.overflowing_vertices
        assert numbers.lost == pytest.approx(own.lost, abs=1e-9)


def test_many_joints_at_one_vertex_outgrow_the_kernels_first_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    # A fan whose hub sees a new joint on every spoke: far more entries than six a class.
    spokes = 400
    angles = np.linspace(0.0, 2.0 * np.pi, spokes, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(spokes)])
    numbers = np.arange(spokes)
    joints: npt.NDArray[np.int64] = np.zeros((spokes + 1, 4), dtype=np.int64)
    joints[1:, 0] = spokes - numbers
    part = SkinnedPrimitive(
        np.concatenate([[[0.0, 0.0, 0.0]], rim]),
        np.tile([0.0, 0.0, 1.0], (spokes + 1, 1)),
        None,
        joints,
        np.tile([1.0, 0.0, 0.0, 0.0], (spokes + 1, 1)),
        np.column_stack([np.zeros(spokes, dtype=np.int64), 1 + numbers, 1 + (numbers + 1) % spokes]),
    )
    table = assert_paths_agree([part], "max", monkeypatch)
    assert np.count_nonzero(table[0].any(axis=1)) == spokes + 1
    # By symmetry every spoke's joint has a gradient c (cos θ, sin θ) along its spoke. The mean is exact for
    # the linear field x, which is cos θ at the rim: Σ cos θ · c cos θ = c · spokes / 2 = 1.
    assert np.linalg.norm(table[0], axis=1)[1:] == pytest.approx(np.full(spokes, 2.0 / spokes), rel=1e-9)
