"""The two ways to measure lighting, compiled loops and whole arrays: one result, on good and on bad input."""

from __future__ import annotations

import runpy
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import DTypeLike

from skinbake.choices import Weighting
from skinbake.errors import ChoiceError
from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.truth import by_numpy, kernel, normals
from skinbake.truth.mesh import Int32Array
from skinbake.truth.normals import ClassBlock, ClassSums, RestFrames, class_blocks
from skinbake.truth.operator import GradientOperator, gradient_operator
from skinbake.truth.truths import carried_normals, rest_frames
from skinbake.truth.values import BINS, BINS_OF_OCTAVE, Forms, end_of_bin
from tests.support.baked_files import verify
from tests.support.kernels import OTHERWISE, bits_here, compiled_otherwise
from tests.support.models import FOLDER, baked
from tests.support.odd_surfaces import odd_surface
from tests.support.strictness import missing_tool
from tests.support.surfaces import analytic_surface

if not kernel.IS_COMPILED:
    missing_tool("skinbake was installed without its compiled loops")

from skinbake.gradients import _kernel
from skinbake.truth import _loops, by_loops

POSES = [1, 3, 4, 8, 13, 64, 65, 131]
"""The loops take eight, four and one pose at a time, and at most 64 of them before they start again."""


def deformed(positions: Float64Array, poses: int, seed: int = 0) -> Float64Array:
    """Return positions (3, V, P) that linear maps and some noise move; in the last pose some are broken."""
    rng = np.random.default_rng(seed)
    maps = np.eye(3) + rng.uniform(-0.7, 0.7, (poses, 3, 3))
    moved = np.einsum("pij,vj->ivp", maps, positions) + rng.uniform(-0.05, 0.05, (3, len(positions), poses))
    moved[:, ::17, -1] = 0.25
    moved[0, ::29, -1] = np.nan
    moved[1, 5, -1] = np.inf
    return np.ascontiguousarray(moved)


class Mesh:
    """A mesh with hard edges and normals that do not exist, at rest and in some poses."""

    def __init__(self, poses: int) -> None:
        primitive = analytic_surface(300, "jittered").primitive
        self.positions = primitive.positions.astype(np.float64)
        self.normals = primitive.normals.astype(np.float64)
        self.normals[3] = 0.0
        self.operator: GradientOperator = gradient_operator([primitive])
        count = len(self.positions)
        parts = tuple(slice(start, min(start + 57, count)) for start in range(0, count, 57))
        self.rest: RestFrames = rest_frames(self.operator, self.positions, self.normals, parts=parts)
        self.deformed = deformed(self.positions, poses)
        carried = carried_normals(self.operator, self.rest, self.positions, self.normals)
        blocks = class_blocks(self.operator)
        sums = np.empty((3, len(self.operator.ends) - 1, poses), np.float32)
        for block in blocks:
            by_numpy.class_sums(self.operator, self.deformed, block, sums)
        self.sums = ClassSums(carried, self.operator.classes, sums)


def random_forms(count: int, slots: int) -> Forms:
    """Return forms of 19 vertices with 15 joints; some slots hold nothing, as does vertex 4."""
    rng = np.random.default_rng(count + slots)
    weights = rng.random((19, slots)) * (rng.random((19, slots)) < 0.7)
    changes = rng.normal(size=(count, 19, slots)) * (rng.random((count, 19, slots)) < 0.7)
    weights[4], changes[:, 4] = 0.0, 0.0
    joints = rng.integers(0, 15, (19, slots))
    return Forms(joints, weights, rng.normal(size=(19, 3)), rng.normal(size=(count, 19, 3)), changes)


def random_table(poses: int) -> Float64Array:
    """Return the columns of the matrices of 15 joints."""
    return np.random.default_rng(poses).normal(size=(60, 3, poses))


def blended(operations: Any, forms: Forms, count: int, table: Float64Array) -> Float64Array:
    out = np.full((count, 3, len(forms.joints), table.shape[2]), np.nan)
    operations.blend(forms, table, out)
    return out


def by_definition(forms: Forms, table: Float64Array) -> Float64Array:
    """Return Σ w M u + Σ c M p̃: (F, 3, B, P)."""
    assert forms.directions is not None
    assert forms.changes is not None
    matrices = table.reshape(-1, 4, 3, table.shape[2])[forms.joints]
    found = np.einsum("vk,fvj,vkjip->fivp", forms.weights, forms.directions, matrices[:, :, :3])
    found += np.einsum("fvk,vj,vkjip->fivp", forms.changes, forms.points, matrices[:, :, :3])
    return np.asarray(found + np.einsum("fvk,vkip->fivp", forms.changes, matrices[:, :, 3]))


@pytest.mark.parametrize("poses", POSES)
@pytest.mark.parametrize(("count", "slots"), [(1, 1), (2, 4), (5, 8), (2, 16), (2, 17), (2, 40)])
def test_linear_blending_is_that_of_numpy(poses: int, count: int, slots: int) -> None:
    forms, table = random_forms(count, slots), random_table(poses)
    found = blended(by_loops, forms, count, table)
    # pytest.approx compares numbers one by one, which takes a second here.
    np.testing.assert_allclose(found, blended(by_numpy, forms, count, table), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found, by_definition(forms, table), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("operations", [by_loops, by_numpy])
def test_forms_without_directions_or_changes_are_those_of_points_and_zeros(operations: Any) -> None:
    forms, table = random_forms(2, 4), random_table(9)
    unchanged = blended(operations, forms._replace(changes=None), 2, table)
    zeros = np.zeros((2, 19, 4))
    expected = by_definition(forms._replace(changes=zeros), table)
    np.testing.assert_allclose(unchanged, expected, rtol=1e-12, atol=1e-12)
    moved = blended(operations, forms._replace(directions=None, changes=None), 1, table)[0]
    matrices = table.reshape(-1, 4, 3, 9)[forms.joints]
    points = np.concatenate([forms.points, np.ones((19, 1))], axis=1)
    expected = np.einsum("vk,vkjip,vj->ivp", forms.weights, matrices, points)
    np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("operations", [by_loops, by_numpy])
def test_only_the_rows_of_the_block_are_written(operations: Any) -> None:
    forms, table = random_forms(2, 4), random_table(9)
    alone = blended(operations, forms, 2, table)
    out = np.full((2, 3, 30, 9), 7.0)
    operations.blend(forms, table, out, 5)
    np.testing.assert_array_equal(out[:, :, 5:24], alone)
    assert (out[:, :, :5] == 7.0).all()
    assert (out[:, :, 24:] == 7.0).all()
    skinning = moved_by_dqs(9, 4)
    all_of_it, some = np.empty((3, 23, 9)), np.full((3, 30, 9), 7.0)
    operations.dqs_positions(skinning, slice(0, 9), slice(0, 23), all_of_it)
    operations.dqs_positions(skinning, slice(0, 9), slice(3, 20), some, 4)
    np.testing.assert_array_equal(some[:, 4:21], all_of_it[:, 3:20])
    assert (some[:, :4] == 7.0).all()
    assert (some[:, 21:] == 7.0).all()


@pytest.mark.parametrize("poses", POSES)
@pytest.mark.parametrize("slots", [1, 4, 40])
def test_blended_normals_are_those_of_numpy(poses: int, slots: int) -> None:
    forms, table = random_forms(3, slots), random_table(poses)
    assert forms.directions is not None
    assert forms.changes is not None
    forms.weights[5:] += 0.1
    for of_forms in (forms.directions, forms.changes):
        of_forms[2, 7] = of_forms[1, 7]
    normals = np.random.default_rng(5).normal(size=(19, 3))
    pair = forms._replace(directions=forms.directions[:2], changes=forms.changes[:2])
    t, b = np.moveaxis(by_definition(pair, table), 1, -1)
    crossed = by_loops.blended_normals(pair, table)
    np.testing.assert_allclose(crossed, np.moveaxis(np.cross(t, b), 2, 0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(crossed, by_numpy.blended_normals(pair, table), rtol=1e-9, atol=1e-9)
    found = by_loops.blended_normals(forms, table, normals)
    assert not found[:, 4].any(), "a matrix of zeros has no inverse, and its cofactors are zero"
    matrices = by_definition(forms, table).transpose(2, 3, 1, 0)
    determinants = np.linalg.det(matrices)
    sound = np.setdiff1d(np.flatnonzero((np.abs(determinants) > 1e-12).all(axis=1)), [7])
    assert len(sound) > 10
    assert np.isfinite(found[:, sound]).all()
    determinants = determinants[sound]
    # Near a singular matrix, only the product with its determinant is exact.
    inverted = np.linalg.solve(np.swapaxes(matrices[sound], -1, -2), normals[sound][:, None, :, None])
    expected = np.moveaxis(inverted[..., 0], 2, 0) * determinants
    np.testing.assert_allclose(found[:, sound] * determinants, expected, rtol=1e-6, atol=1e-6)
    numpys = by_numpy.blended_normals(forms, table, normals)[:, sound]
    np.testing.assert_allclose(found[:, sound] * determinants, numpys * determinants, rtol=1e-6, atol=1e-9)


def moved_by_dqs(poses: int, slots: int, *, scaled: str = "", cap: float | None = None) -> Skinning:
    """Return 23 vertices of random frames and numbers under random motions; some slots hold nothing."""
    rng = np.random.default_rng(poses + slots)
    frames = np.linalg.qr(rng.normal(size=(23, 3, 3))).Q
    weights = rng.random((23, slots)) * (rng.random((23, slots)) < 0.8)
    weights[:, 0] += 0.1
    alpha, beta = rng.normal(size=(2, 23, slots - 1)) * (rng.random((23, slots - 1)) < 0.8)
    rest = RestPrimitive(
        positions=rng.normal(size=(23, 3)),
        normals=frames[:, 0],
        tangents=frames[:, 1],
        bitangents=frames[:, 2],
        joints=rng.integers(0, 9, (23, slots)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        alpha=alpha,
        beta=beta,
    )
    turns = np.linalg.qr(rng.normal(size=(poses, 9, 3, 3))).Q
    matrices = np.tile(np.eye(4), (poses, 9, 1, 1))
    matrices[..., :3, :3] = turns * np.linalg.det(turns)[..., None, None]
    if scaled == "alike":
        matrices[..., :3, :3] *= rng.uniform(0.1, 3.0, (poses, 1, 1, 1))
    if scaled == "unlike":
        matrices[..., :3, :3] @= np.eye(3) + 0.3 * rng.normal(size=(poses, 9, 3, 3))
    matrices[..., :3, 3] = rng.normal(size=(poses, 9, 3))
    return Skinning.of(rest, matrices, dual_quaternions=True, options=Options(cap=cap))


@pytest.mark.parametrize("scaled", ["", "alike", "unlike"])
@pytest.mark.parametrize("slots", [1, 2, 4, 8])
@pytest.mark.parametrize(
    "poses", [*(pytest.param(poses, marks=pytest.mark.slow) for poses in (1, 3, 31, 32, 70)), 4, 33]
)
def test_dual_quaternions_are_those_of_numpy(poses: int, slots: int, scaled: str) -> None:
    skinning = moved_by_dqs(poses, slots, scaled=scaled)
    assert skinning.has_scaled_joints == (scaled == "unlike")
    for pose in (slice(0, poses), slice(poses // 3, max(poses - 1, 1))):
        for part in (slice(0, 23), slice(3, 20), slice(5, 5)):
            shape = 3, part.stop - part.start, pose.stop - pose.start
            moved, expected = np.empty((2, *shape))
            by_loops.dqs_positions(skinning, pose, part, moved)
            by_numpy.dqs_positions(skinning, pose, part, expected)
            np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-13)
            normals = by_loops.dqs_normals(skinning, pose, part)
            assert normals.shape == (3, *shape)
            expected = by_numpy.dqs_normals(skinning, pose, part)
            size = np.abs(expected).max(axis=1, keepdims=True)
            np.testing.assert_allclose(normals / size, expected / size, rtol=0, atol=1e-11)


def test_dual_quaternions_that_cancel_out_leave_the_vertex() -> None:
    skinning = moved_by_dqs(5, 1)
    still = replace(skinning.vertices, rest=replace(skinning.vertices.rest, weights=np.zeros((23, 1))))
    nowhere = replace(skinning, vertices=still)
    for operations in (by_loops, by_numpy):
        moved = np.empty((3, 23, 5))
        operations.dqs_positions(nowhere, slice(0, 5), slice(0, 23), moved)
        assert np.allclose(moved, still.rest.positions.T[:, :, None], rtol=1e-14)
        normals = operations.dqs_normals(nowhere, slice(0, 5), slice(0, 23))
        assert np.allclose(np.abs(np.einsum("aivp,vi->avp", normals, still.rest.normals)), 1.0)


def test_a_limited_correction_is_that_of_numpy() -> None:
    limited, free = (moved_by_dqs(9, 4, cap=cap) for cap in (0.3, None))
    here = slice(0, 9), slice(0, 23)
    found = by_loops.dqs_normals(limited, *here)
    assert np.array_equal(found, by_numpy.dqs_normals(limited, *here))
    assert not np.allclose(found, by_loops.dqs_normals(free, *here), rtol=1e-3)


@pytest.mark.parametrize("weighting", list(Weighting))
@pytest.mark.parametrize("directions", [1, 2, 3])
def test_rows_of_the_operator_are_those_of_libigl(weighting: Weighting, directions: int) -> None:
    primitive = analytic_surface(300, "jittered").primitive
    operator = gradient_operator([primitive], weighting=weighting, crease_angle_degrees=60.0)
    count = len(operator.positions)
    along = np.random.default_rng(5).normal(size=(directions, count, 3))
    for part in (slice(0, count), slice(7, 8), slice(count // 2, count), slice(3, 3)):
        here = [direction[part] for direction in along]
        found = by_loops.gradient_rows(operator, part, here)
        expected = by_numpy.gradient_rows(operator, part, here)
        assert len(found) == len(expected) == directions * (part.stop - part.start)
        ours, numpys = (rows.matrix(count).toarray() for rows in (found, expected))
        np.testing.assert_allclose(ours, numpys, rtol=1e-9, atol=1e-9)
        neighbours = set(zip(found.owners().tolist(), found.columns.tolist(), strict=True))
        assert len(neighbours) == len(found.columns), "an entry for each neighbour"


@pytest.mark.parametrize("poses", POSES)
def test_sums_at_weld_classes_are_those_of_numpy(poses: int) -> None:
    mesh = Mesh(poses)
    count = len(mesh.operator.ends) - 1
    for part in (slice(0, count), slice(7, 8), slice(count // 2, count), slice(3, 3)):
        block = ClassBlock.of(mesh.operator, part)
        found, expected = sums_of_block(mesh, block, by_loops), sums_of_block(mesh, block, by_numpy)
        # The loops find these angles to a few units of float32, and both round the sums of about six.
        assert np.allclose(found, expected, rtol=2e-7, atol=2e-6, equal_nan=True)
        wide, expected = (sums_of_block(mesh, block, twin, np.float64) for twin in (by_loops, by_numpy))
        assert np.allclose(wide, expected, rtol=1e-12, atol=1e-13, equal_nan=True)


def sums_of_block(
    mesh: Mesh, block: ClassBlock, twin: ModuleType, dtype: DTypeLike = np.float32
) -> FloatArray:
    """Return the sums of a block alone, after a check that no other class is written to."""
    sums: FloatArray = np.full((3, len(mesh.operator.ends) - 1, mesh.deformed.shape[2]), 99.0, dtype)
    twin.class_sums(mesh.operator, mesh.deformed, block, sums)
    found = sums[:, block.part].copy()
    sums[:, block.part] = 99.0
    np.testing.assert_array_equal(sums, 99.0)
    return found


def test_sums_at_weld_classes_do_not_depend_on_the_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = Mesh(35)
    count = len(mesh.operator.ends) - 1
    at_once = sums_of_block(mesh, ClassBlock.of(mesh.operator, slice(0, count)), by_loops)
    monkeypatch.setattr(normals, "CLASS_CORNERS", 40)
    blocks = class_blocks(mesh.operator)
    found = [sums_of_block(mesh, block, by_loops) for block in blocks]
    assert len(blocks) > 20
    np.testing.assert_array_equal(np.concatenate(found, axis=1), at_once)


@pytest.mark.parametrize("sided", [False, True])
@pytest.mark.parametrize("poses", POSES)
def test_true_normals_are_those_of_numpy(poses: int, sided: bool) -> None:
    mesh = Mesh(poses)
    rng = np.random.default_rng(3)
    missing = 0
    for sums in (None, mesh.sums):
        for number, part in enumerate(mesh.rest.parts):
            shape = poses, part.stop - part.start
            sides = np.where(rng.random(shape) < 0.5, -1.0, 1.0) if sided else None
            found, exist = by_loops.true_normals(mesh.rest, number, mesh.deformed, sides, sums)
            expected, there = by_numpy.true_normals(mesh.rest, number, mesh.deformed, sides, sums)
            assert np.array_equal(exist, there)
            assert found.shape == expected.shape == (1 if sums is None else 2, 3, *shape[::-1])
            assert np.allclose(found, expected, rtol=0, atol=1e-10, equal_nan=True)
            missing += int(np.count_nonzero(~exist))
    assert missing, "some vertices are broken or have no n0"


@pytest.mark.slow
@pytest.mark.parametrize("weighting", list(Weighting))
def test_truths_of_odd_surfaces_are_those_of_numpy(weighting: Weighting) -> None:
    exist = 0
    for seed in range(40):
        primitives = odd_surface(seed)
        operator = gradient_operator(primitives, weighting=weighting)
        positions, normals = operator.positions, np.concatenate([one.normals for one in primitives])
        rng, whole = np.random.default_rng(seed), slice(0, len(positions))
        directions = list(rng.normal(size=(2, len(positions), 3)))
        rows, expected = (
            twin.gradient_rows(operator, whole, directions).matrix(len(positions)).toarray()
            for twin in (by_loops, by_numpy)
        )
        assert (np.abs(rows - expected) <= 1e-9 * np.abs(expected).max(axis=1, keepdims=True)).all(), seed
        # Some vertices come together, so that triangles collapse.
        posed = np.einsum("pij,vj->ivp", rng.normal(size=(5, 3, 3)), positions)
        posed[:, rng.random(len(positions)) < 0.2] = posed[:, :1]
        rest = rest_frames(operator, positions, normals, parts=(whole,))
        sums = np.empty((2, 3, len(operator.ends) - 1, 5))
        for block in class_blocks(operator):
            for twin, own in zip((by_loops, by_numpy), sums, strict=True):
                twin.class_sums(operator, posed, block, own)
        assert np.allclose(sums[0], sums[1], rtol=0, atol=1e-9), seed
        carried = carried_normals(operator, rest, positions, normals)
        by_triangles = ClassSums(carried, operator.classes, sums[1].astype(np.float32))
        found, there = by_loops.true_normals(rest, 0, posed, None, by_triangles)
        expected, as_there = by_numpy.true_normals(rest, 0, posed, None, by_triangles)
        assert np.array_equal(there, as_there), seed
        assert np.allclose(found, expected, rtol=0, atol=1e-10, equal_nan=True), seed
        exist += int(np.count_nonzero(there))
    assert exist > 1000


@pytest.mark.parametrize("truths", [1, 2])
def test_angles_are_those_of_numpy(truths: int) -> None:
    rng = np.random.default_rng(2)
    measured = rng.normal(size=(3, 7, 83)) * 10.0 ** rng.uniform(-9, 9, (7, 83))
    expected = rng.normal(size=(truths, 3, 7, 83))
    # Nearly the same, nearly opposite, the same, opposite.
    nearly = 10.0 ** rng.uniform(-12, 0, (3, 7, 20))
    expected[0, :, :, :20] = measured[:, :, :20] / np.linalg.norm(measured[:, :, :20], axis=0) + nearly
    expected[0, :, :, 20:30] = -expected[0, :, :, :10]
    measured[:, 0, 30], measured[:, 1, 30], measured[:, 2, 30] = np.nan, 0.0, np.inf
    measured[:, 3, 30] = 1e200
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    expected[:, :, 4, 30] = np.nan
    measured[:, 5, 30], expected[:, :, 5, 30] = [1, 0, 0], [1, 0, 0]
    measured[:, 6, 30], expected[:, :, 6, 30] = [1, 0, 0], [-1, 0, 0]
    components = tuple(component.T for component in measured)
    found, plain = by_loops.angles(components, expected), by_numpy.angles(components, expected)
    # float32 has seven digits. Its arctangent is another one than numpy's.
    assert np.allclose(found, plain, rtol=6e-7, atol=0, equal_nan=True)
    assert np.isnan(found[0, :5, 30]).all()
    assert found[0, 5:, 30].tolist() == [0.0, 180.0]
    with np.errstate(over="ignore", invalid="ignore"):  # the case has vectors too long to square
        across = np.linalg.norm(np.cross(measured, expected[0], axis=0), axis=0)
        by_arctangent = np.degrees(np.arctan2(across, (measured * expected[0]).sum(axis=0)))
    sane = np.isfinite(across) & (across > 0)
    assert found[0][sane] == pytest.approx(by_arctangent[sane], rel=1e-5, abs=2e-6)


@pytest.mark.parametrize("largest", [1.0, 44.9, 45.1, 60.0])
def test_angles_below_45_degrees_are_those_of_larger_ones(largest: float) -> None:
    """Strips of small angles alone take a shorter way."""
    wanted = np.linspace(0.0, largest, 3 * 200).reshape(3, 200)
    angles = np.radians(wanted)
    turned = np.cos(angles), np.sin(angles), np.zeros_like(angles)
    expected = np.zeros((1, 3, 3, 200))
    expected[0, 0] = 1.0
    found = by_loops.angles(tuple(component.T for component in turned), expected)
    assert found[0] == pytest.approx(wanted, rel=3e-7, abs=1e-12)


def test_an_opposite_normal_among_small_angles_is_180_degrees() -> None:
    """Rounding makes the chord of opposite vectors a little shorter or longer than the diameter."""
    units = np.random.default_rng(7).normal(size=(3, 400, 1))
    measured = np.repeat(units / np.linalg.norm(units, axis=0), 64, axis=2)
    expected = measured.copy()
    expected[:, :, 30] *= -1.0
    turned = tuple(component.T for component in measured)
    found = by_loops.angles(turned, expected[None])
    # Nearly opposite by rounding: the float32 next to 180 is 1.5e-5 off.
    assert found[0, :, 30] == pytest.approx(180.0, abs=1e-4)
    assert np.allclose(found, by_numpy.angles(turned, expected[None]), rtol=6e-7, atol=3e-6)


def errors_to_count(seed: int) -> tuple[Any, Any, Any]:
    """Few values, so that there are ties; some missing, some not valid, some without weight."""
    rng = np.random.default_rng(seed)
    rows, poses = 11, int(rng.integers(1, 40))
    errors = np.round(rng.gamma(1.0, 3.0, (rows, poses)), 1).astype(np.float32)
    errors[rng.random(errors.shape) < (0.02 if seed % 3 else 0.0)] = np.nan
    weights = rng.random(rows) * (rng.random(rows) < 0.8)
    valid = rng.random(errors.shape) < 0.9 if seed % 2 else None
    return errors, weights, valid


@pytest.mark.parametrize(
    "seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 30))]
)
def test_counts_of_errors_are_those_of_numpy(seed: int) -> None:
    errors, weights, valid = errors_to_count(seed)
    mask = None if valid is None else valid.T
    found = by_loops.count_errors(errors.T, weights, mask)
    expected = by_numpy.count_errors(errors.T, weights, mask)
    for name in ("samples", "undefined", "largest", "pose", "vertex"):
        assert getattr(found, name) == getattr(expected, name), name
    assert found.weight == pytest.approx(expected.weight, rel=1e-12)
    assert found.total == pytest.approx(expected.total, rel=1e-12)
    assert found.bins == pytest.approx(expected.bins, rel=1e-12)
    assert found.bins.sum() == pytest.approx(found.weight, rel=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_the_first_of_the_largest_errors_is_found(seed: int) -> None:
    errors, weights, _ = errors_to_count(3 * seed)
    counted = np.where(weights[:, None] > 0, errors, -1.0)
    first = np.flatnonzero(counted.max() == counted.T)[0]
    for count in (by_loops.count_errors, by_numpy.count_errors):
        found = count(errors.T, weights)
        assert (found.pose, found.vertex) == divmod(int(first), len(errors))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_each_value_is_counted_in_the_bin_that_holds_it(dtype: type[np.floating]) -> None:
    """By the edges of the bins: whole multiples of 2⁻⁷ of each power of two."""
    edges = np.ldexp(1.0 + np.arange(BINS_OF_OCTAVE) / BINS_OF_OCTAVE, np.arange(-32, 32)[:, None]).ravel()
    small, large = [0.0, 1e-30, np.ldexp(1.0, -33)], [np.ldexp(1.0, 32), 1e30]
    middles = np.sqrt(edges[:-1] * edges[1:])
    values = np.array([*small, *edges, *middles, *large], dtype=dtype)
    wanted = [0] * 3 + [*range(BINS)] + [*range(BINS - 1)] + [BINS - 1] * 2
    for count in (by_loops.count_errors, by_numpy.count_errors):
        found = count(values[None], np.arange(1.0, len(values) + 1.0))
        assert np.array_equal(found.bins, np.bincount(wanted, np.arange(1.0, len(values) + 1.0)))
    assert [end_of_bin(place) for place in range(1, BINS - 1)] == edges[2:].tolist()
    assert (end_of_bin(0), end_of_bin(BINS - 1)) == (0.0, np.inf)


def test_no_vertices_and_no_poses_are_no_errors() -> None:
    for shape in ((0, 5), (5, 0)):
        found = by_loops.count_errors(np.zeros(shape, dtype=np.float32).T, np.ones(shape[0]))
        assert (found.samples, found.largest, found.bins.sum()) == (0, -1.0, 0.0)
    nothing = Forms(np.zeros((0, 4), dtype=np.int32), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros((2, 0, 3)))
    assert by_loops.blended_normals(nothing, np.zeros((4, 3, 5))).shape == (3, 0, 5)


def figures_of(path: Path) -> list[float]:
    """Return all figures that verify reports of a file."""
    found = verify(path, "--poses", "random:5").file
    return [
        figures[name]
        for truth in ("normals_by_triangles", "normals_by_tangents")
        for lightings in found[truth].values()
        for lighting, figures in lightings.items()
        if lighting != "gain"
        for name in ("mean", "p95", "p99", "max")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bent_tube.glb", "two_primitives.glb", "morphed_sheet.glb"])
def test_figures_of_verify_are_those_of_numpy(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    baked(FOLDER / name, tmp_path / "baked.glb")
    compiled = figures_of(tmp_path / "baked.glb")
    for operation in kernel.__all__:
        monkeypatch.setattr(kernel, operation, getattr(by_numpy, operation))
    assert len(compiled) == 4 * 11, (
        "three lightings of LBS by one truth, two by the other; three of DQS by both"
    )
    # The loops find the angles of posed triangles as floats: a part in 10⁷ of a radian is 6e-6 degrees.
    assert compiled == pytest.approx(figures_of(tmp_path / "baked.glb"), rel=1e-6, abs=6e-6)


def test_the_environment_can_ask_for_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    assert runpy.run_path(kernel.__file__)["IS_COMPILED"]
    monkeypatch.setenv("SKINBAKE_KERNEL", "numpy")
    chosen = runpy.run_path(kernel.__file__)
    assert not chosen["IS_COMPILED"]
    assert all(chosen[name] is getattr(by_numpy, name) for name in kernel.__all__)
    monkeypatch.setenv("SKINBAKE_KERNEL", "")
    assert runpy.run_path(kernel.__file__)["IS_COMPILED"]


def test_the_environment_cannot_ask_for_anything_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKINBAKE_KERNEL", "nump")
    with pytest.raises(ChoiceError, match='SKINBAKE_KERNEL is "nump" in the environment: expected numpy'):
        runpy.run_path(kernel.__file__)


@pytest.mark.slow
@pytest.mark.parametrize("otherwise", OTHERWISE, ids=str)
def test_the_bits_of_verify_are_the_same_however_the_loops_are_compiled(
    otherwise: tuple[int, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = compiled_otherwise("truth/_loops", tmp_path, *otherwise)
    mesh = Mesh(67)

    def results() -> list[Any]:
        normals, exist = by_loops.true_normals(mesh.rest, 1, mesh.deformed, None, mesh.sums)
        part = mesh.rest.parts[1]
        vectors = tuple(component[part].T for component in mesh.deformed)
        errors = by_loops.angles(vectors, normals)
        counted = by_loops.count_errors(errors[0].T, np.ones(part.stop - part.start), exist[0].T)
        sums = sums_of_block(mesh, ClassBlock.of(mesh.operator, part), by_loops)
        skinning = moved_by_dqs(45, 4, scaled="alike")
        here = skinning, slice(0, 45), slice(0, 23)
        posed = np.empty((3, 23, 45))
        by_loops.dqs_positions(*here, posed)
        forms, table = random_forms(2, 4), random_table(67)
        turned = by_loops.dqs_normals(*here)
        forms, table = random_forms(2, 4), random_table(67)
        linear = [blended(by_loops, forms, 2, table), by_loops.blended_normals(forms, table)]
        figures = counted.bins, counted.total, counted.largest
        return [posed, turned, *linear, normals, exist, errors, sums, *figures]

    expected = results()
    monkeypatch.setattr(by_loops, "loops", other)
    for found, wanted in zip(results(), expected, strict=True):
        assert np.array_equal(found, wanted, equal_nan=np.asarray(wanted).dtype != np.bool_)


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux what the processor has")
def test_the_loops_use_the_widest_vectors_that_the_processor_has() -> None:
    assert _loops.VECTOR_BITS == _kernel.VECTOR_BITS == bits_here()


def int32(*values: int) -> Int32Array:
    return np.array(values, dtype=np.int32)


class TestArguments:
    """Wrong arguments of the compiled loops are an exception, never memory read past its end."""

    BLEND: tuple[Any, ...] = (
        np.zeros((5, 2), np.int32),
        np.zeros((5, 2)),
        np.zeros((5, 3)),
        np.zeros((2, 5, 3)),
        np.zeros((2, 5, 2)),
        np.zeros((8, 3, 7)),
        np.zeros((2, 3, 9, 7)),
        4,
    )
    FORMS: tuple[Any, ...] = (
        *BLEND[:3],
        np.zeros((3, 5, 3)),
        np.zeros((3, 5, 2)),
        BLEND[5],
        np.zeros((5, 3)),
        np.zeros((3, 5, 7)),
    )
    MOVED: tuple[Any, ...] = (
        np.zeros((8, 6, 7)),
        None,
        np.zeros((5, 3), np.int32),
        np.zeros((5, 3)),
        np.zeros((5, 3)),
        np.zeros((3, 9, 4)),
        3,
        4,
    )
    TURNED: tuple[Any, ...] = (
        np.zeros((8, 6, 7)),
        np.zeros(7),
        np.zeros((5, 3), np.int32),
        np.zeros((5, 3)),
        np.zeros((5, 3)),
        np.zeros((3, 3, 5, 4)),
        np.zeros((3, 3, 5)),
        np.ones((5, 2)),
        np.zeros((5, 2)),
        np.ones(5),
        3,
    )
    ROWS: tuple[Any, ...] = (
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]),
        np.array([[0, 1, 2], [1, 3, 2]], np.int32),
        int32(0, 1, 3, 2, 5, 4),
        np.array([0, 1, 3, 5, 6]),
        int32(0, 1, 2),
        np.ones(4),
        np.ones((2, 3, 3)),
        np.zeros(4, np.int32),
        np.zeros(18, np.int32),
        np.zeros((2, 18)),
        0,
    )
    SUMS: tuple[Any, ...] = (
        np.zeros((3, 4, 7)),
        np.array([[0, 1, 2], [1, 2, 3]], np.int32),
        int32(0, 1),
        int32(0, 0, 1, 1),
        np.zeros((3, 4, 7), np.float32),
        2,
        2,
        1e10,
    )
    TRUE: tuple[Any, ...] = (
        *(int32(0, 1, 2), int32(0, 3), np.zeros(2)) * 2,
        np.zeros((3, 4, 7)),
        np.zeros((3, 2)),
        np.zeros(2),
        np.ones(2, np.bool_),
        np.zeros((3, 2)),
        int32(0, 1),
        np.zeros((3, 2, 7), np.float32),
        np.zeros((2, 7)),
        np.zeros((2, 3, 2, 7)),
        np.zeros((2, 2, 7), np.bool_),
        1e-6,
    )
    ANGLES: tuple[Any, ...] = (
        *[np.zeros((2, 7))] * 3,
        np.zeros((2, 3, 2, 7)),
        np.zeros((2, 2, 7), np.float32),
    )
    COUNT: tuple[Any, ...] = (
        np.zeros((2, 7), np.float32),
        np.ones(2),
        np.ones((2, 7), np.bool_),
        np.zeros(BINS),
    )

    CASES: tuple[tuple[Callable[..., Any], tuple[Any, ...], int, Any, type[Exception]], ...] = (
        (_loops.blend, BLEND, 0, np.full((5, 2), 2, np.int32), IndexError),
        (_loops.blend, BLEND, 0, np.full((5, 2), -1, np.int32), IndexError),
        (_loops.blend, BLEND, 0, np.full((5, 2), 2**30, np.int32), IndexError),
        (_loops.blend, BLEND, 0, np.zeros((5, 2), np.int64), TypeError),
        (_loops.blend, BLEND, 0, np.zeros((5, 3), np.int32), ValueError),
        (_loops.blend, BLEND, 1, np.zeros((4, 2)), ValueError),
        (_loops.blend, BLEND, 1, np.zeros((10, 2))[::2], ValueError),
        (_loops.blend, BLEND, 2, np.zeros((5, 3), np.float32), TypeError),
        (_loops.blend, BLEND, 2, np.zeros((5, 4)), ValueError),
        (_loops.blend, BLEND, 2, None, TypeError),
        (_loops.blend, BLEND, 3, np.zeros((2, 4, 3)), ValueError),
        (_loops.blend, BLEND, 3, np.zeros((1, 5, 3)), ValueError),
        (_loops.blend, BLEND, 4, np.zeros((2, 5, 1)), ValueError),
        (_loops.blend, BLEND, 5, np.zeros((8, 4, 7)), ValueError),
        (_loops.blend, BLEND, 5, np.zeros((3, 3, 7)), IndexError),
        (_loops.blend, BLEND, 6, np.zeros((2, 3, 9, 8)), ValueError),
        (_loops.blend, BLEND, 6, np.zeros((3, 3, 9, 7)), ValueError),
        (_loops.blend, BLEND, 6, np.zeros((2, 3, 4, 7)), ValueError),
        (_loops.blend, BLEND, 6, None, TypeError),
        (_loops.blend, BLEND, 7, 5, ValueError),
        (_loops.blend, BLEND, 7, -1, ValueError),
        (_loops.blended_normals, FORMS, 0, np.full((5, 2), 2, np.int32), IndexError),
        (_loops.blended_normals, FORMS, 0, np.full((5, 2), -1, np.int32), IndexError),
        (_loops.blended_normals, FORMS, 3, np.zeros((2, 5, 3)), ValueError),
        (_loops.blended_normals, FORMS, 4, np.zeros((4, 5, 2)), ValueError),
        (_loops.blended_normals, FORMS, 5, np.zeros((8, 4, 7)), ValueError),
        (_loops.blended_normals, FORMS, 6, None, ValueError),
        (_loops.blended_normals, FORMS, 6, np.zeros((4, 3)), ValueError),
        (_loops.blended_normals, FORMS, 6, np.zeros((5, 3), np.float32), TypeError),
        (_loops.blended_normals, FORMS, 7, np.zeros((3, 5, 8)), ValueError),
        (_loops.dqs_positions, MOVED, 0, np.zeros((7, 6, 7)), ValueError),
        (_loops.dqs_positions, MOVED, 0, np.zeros((8, 0, 7)), IndexError),
        (_loops.dqs_positions, MOVED, 0, np.zeros((8, 6, 6)), ValueError),
        (_loops.dqs_positions, MOVED, 1, np.zeros(6), ValueError),
        (_loops.dqs_positions, MOVED, 2, np.full((5, 3), 6, np.int32), IndexError),
        (_loops.dqs_positions, MOVED, 2, np.full((5, 3), -1, np.int32), IndexError),
        (_loops.dqs_positions, MOVED, 3, np.zeros((5, 4)), ValueError),
        (_loops.dqs_positions, MOVED, 4, np.zeros((5, 3), np.float32), TypeError),
        (_loops.dqs_positions, MOVED, 5, np.zeros((3, 9, 5)), ValueError),
        (_loops.dqs_positions, MOVED, 5, np.zeros((3, 4, 4)), ValueError),
        (_loops.dqs_positions, MOVED, 6, 4, ValueError),
        (_loops.dqs_positions, MOVED, 6, -1, ValueError),
        (_loops.dqs_positions, MOVED, 7, 5, ValueError),
        (_loops.dqs_positions, MOVED, 7, -1, ValueError),
        (_loops.dqs_normals, TURNED, 0, np.zeros((8, 6, 6)), ValueError),
        (_loops.dqs_normals, TURNED, 1, np.zeros(6), ValueError),
        (_loops.dqs_normals, TURNED, 2, np.array([[0, 1, 6]] * 5, np.int32), IndexError),
        (_loops.dqs_normals, TURNED, 2, np.array([[0, -1, 0]] * 5, np.int32), IndexError),
        (_loops.dqs_normals, TURNED, 3, np.zeros((4, 3)), ValueError),
        (_loops.dqs_normals, TURNED, 5, np.zeros((3, 5, 4)), ValueError),
        (_loops.dqs_normals, TURNED, 6, np.zeros((3, 3, 4)), ValueError),
        (_loops.dqs_normals, TURNED, 7, np.zeros((5, 3)), ValueError),
        (_loops.dqs_normals, TURNED, 8, np.zeros((4, 2)), ValueError),
        (_loops.dqs_normals, TURNED, 9, np.ones(4), ValueError),
        (_loops.dqs_normals, TURNED, 10, 4, ValueError),
        (_loops.gradient_rows, ROWS, 1, np.array([[0, 1, 2], [1, 3, 4]], np.int32), IndexError),
        (_loops.gradient_rows, ROWS, 1, np.array([[0, 1, 2], [1, -1, 2]], np.int32), IndexError),
        (_loops.gradient_rows, ROWS, 2, int32(0, 1, 3, 6, 5, 4), IndexError),
        (_loops.gradient_rows, ROWS, 2, int32(0, 1, 3, -1, 5, 4), IndexError),
        (_loops.gradient_rows, ROWS, 3, np.array([0, 1, 3, 7, 6]), IndexError),
        (_loops.gradient_rows, ROWS, 3, np.array([0, -1, 3, 5, 6]), IndexError),
        (_loops.gradient_rows, ROWS, 3, np.array([0, 1, 3, 5]), ValueError),
        (_loops.gradient_rows, ROWS, 4, int32(0, 1, 4), IndexError),
        (_loops.gradient_rows, ROWS, 4, int32(0, 1, -1), IndexError),
        (_loops.gradient_rows, ROWS, 6, np.ones((2, 2, 3)), ValueError),
        (_loops.gradient_rows, ROWS, 7, np.zeros(5, np.int32), ValueError),
        (_loops.gradient_rows, ROWS, 9, np.zeros((2, 3)), ValueError),
        (_loops.class_sums, SUMS, 1, np.array([[0, 1, 2], [1, 2, 4]], np.int32), IndexError),
        (_loops.class_sums, SUMS, 1, np.array([[0, 1, 2], [1, -1, 3]], np.int32), IndexError),
        (_loops.class_sums, SUMS, 1, np.zeros((2, 4), np.int32), ValueError),
        (_loops.class_sums, SUMS, 2, int32(0, 2), IndexError),
        (_loops.class_sums, SUMS, 2, int32(0, -1), IndexError),
        (_loops.class_sums, SUMS, 3, int32(0, 0, 1), ValueError),
        (_loops.class_sums, SUMS, 4, np.zeros((2, 4, 6), np.float32), ValueError),
        (_loops.class_sums, SUMS, 5, -1, ValueError),
        (_loops.class_sums, SUMS, 5, 3, ValueError),
        (_loops.class_sums, SUMS, 6, -1, ValueError),
        (_loops.class_sums, SUMS, 6, 3, ValueError),
        (_loops.class_sums, SUMS, 6, 2**63 - 1, ValueError),
        (_loops.true_normals, TRUE, 0, int32(0, 1, 3), IndexError),
        (_loops.true_normals, TRUE, 0, int32(0, 2, 1), IndexError),
        (_loops.true_normals, TRUE, 0, int32(-1, 1, 2), IndexError),
        (_loops.true_normals, TRUE, 0, int32(0, 2), ValueError),
        (_loops.true_normals, TRUE, 1, int32(0, 4), IndexError),
        (_loops.true_normals, TRUE, 1, int32(-1, 0), IndexError),
        (_loops.true_normals, TRUE, 4, int32(9, 0), IndexError),
        (_loops.true_normals, TRUE, 2, np.zeros(3), ValueError),
        (_loops.true_normals, TRUE, 6, np.zeros((3, 4, 6)), ValueError),
        (_loops.true_normals, TRUE, 10, None, ValueError),
        (_loops.true_normals, TRUE, 11, int32(0, 2), IndexError),
        (_loops.true_normals, TRUE, 11, int32(0, -1), IndexError),
        (_loops.true_normals, TRUE, 12, None, ValueError),
        (_loops.true_normals, TRUE, 13, np.zeros((7, 2)), ValueError),
        (_loops.true_normals, TRUE, 14, np.zeros((1, 3, 2, 7)), ValueError),
        (_loops.true_normals, TRUE, 15, np.zeros((2, 2, 7), np.int8), TypeError),
        (_loops.angles, ANGLES, 0, np.zeros((2, 6)), ValueError),
        (_loops.angles, ANGLES, 3, np.zeros((1, 3, 2, 7)), ValueError),
        (_loops.angles, ANGLES, 4, np.zeros((2, 2, 7)), TypeError),
        (_loops.count_errors, COUNT, 1, np.ones(3), ValueError),
        (_loops.count_errors, COUNT, 2, np.ones((7, 2), np.bool_), ValueError),
        (_loops.count_errors, COUNT, 3, np.zeros(0), ValueError),
        (_loops.count_errors, COUNT, 3, np.zeros(BINS, np.float32), TypeError),
        (_loops.count_errors, COUNT, 3, np.zeros(2 * BINS)[::2], ValueError),
        (_loops.count_errors, COUNT, 0, np.zeros((2, 7)), TypeError),
    )

    def test_right_arguments_of_the_loops_raise_nothing(self) -> None:
        for function, right in {case[0]: case[1] for case in self.CASES}.items():
            function(*right)
        counting: tuple[Any, ...] = (*self.COUNT[:2], None, *self.COUNT[3:])
        _loops.count_errors(*counting)
        by_tangents = (
            *self.TRUE[:10],
            None,
            None,
            None,
            None,
            np.zeros((1, 3, 2, 7)),
            np.zeros((1, 2, 7), np.bool_),
            1e-6,
        )
        _loops.true_normals(*by_tangents)

    @pytest.mark.parametrize(("function", "right", "number", "value", "error"), CASES)
    def test_wrong_ones_are_refused(
        self,
        function: Callable[..., Any],
        right: tuple[Any, ...],
        number: int,
        value: Any,
        error: type[Exception],
    ) -> None:
        with pytest.raises((error, BufferError) if error is ValueError else error):
            function(*right[:number], value, *right[number + 1 :])


RACE = """
import threading
import numpy as np
from skinbake.truth import _loops
chance, V, P = np.random.default_rng(3), 4_000, 20
positions = chance.normal(size=(3, V, P))
triangles = chance.integers(0, V, (2 * V, 3)).astype(np.int32)
corners, ends = np.arange(6 * V, dtype=np.int32), np.arange(0, 6 * V + 1, 6)
met = np.arange(2 * V, dtype=np.int32)
columns, starts = chance.integers(0, V, 7 * V).astype(np.int32), np.arange(0, 7 * V + 1, 7, dtype=np.int32)
classes = np.arange(V, dtype=np.int32)
errors = np.ones((V, P), np.float32)
changing = [triangles, met, corners, ends, columns, starts, classes]
changing += [errors.view(np.int32)]
kept = [array.copy() for array in changing]
going = True

def spoil():
    chance = np.random.default_rng(7)
    while going:
        for array in changing:
            array.ravel()[chance.integers(array.size, size=50)] = chance.choice([2**31 - 1, -1, V, -(2**31)])

for turn in range(12):
    for array, before in zip(changing, kept):
        array[...] = before
    sums = np.zeros((3, V, P), np.float32)
    going, other = True, threading.Timer(0.0005 * turn, spoil)
    other.start()
    try:
        for _ in range(20 * (turn % 3)):
            _loops.count_errors(errors, np.ones(V), None, np.zeros(1 << 13))
        _loops.gradient_rows(
            np.ones((V, 3)), triangles, corners, ends, classes, np.ones(V), np.ones((2, V, 3)),
            np.zeros(V + 1, np.int32), np.zeros(18 * V, np.int32), np.zeros((2, 18 * V)), 0)
        _loops.class_sums(positions, triangles, met, classes, sums, 0, V, 1e10)
        _loops.true_normals(
            *(starts, columns, np.ones(7 * V)) * 2, positions, np.ones((3, V)), np.ones(V),
            np.ones(V, np.bool_), np.ones((3, V)), classes, sums, None,
            np.zeros((2, 3, V, P)), np.zeros((2, V, P), np.bool_), 1e-6)
        forms = columns.reshape(V, 7), np.ones((V, 7)), np.ones((V, 3))
        table = np.ones((4 * V, 3, P))
        _loops.blend(*forms, None, None, table, np.zeros((2, 3, V, P)), 0)
        _loops.blended_normals(
            *forms, np.ones((3, V, 3)), np.ones((3, V, 7)), table, np.ones((V, 3)), np.zeros((3, V, P)))
        _loops.dqs_normals(
            np.ones((8, V, 9)), None, columns.reshape(V, 7), np.ones((V, 7)), np.ones((V, 3)),
            np.zeros((3, 3, V, 9)), np.ones((3, 3, V)), np.ones((V, 6)), np.ones((V, 6)), np.ones(V), 0)
    except (IndexError, ValueError):
        pass
    going = False
    other.join()
"""


@pytest.mark.slow
def test_arrays_that_change_meanwhile_never_lead_the_loops_astray() -> None:
    """Another thread writes to the arrays while the compiled loops, without the GIL, read them."""
    process = subprocess.run([sys.executable, "-c", RACE], capture_output=True, timeout=120, check=False)
    assert process.returncode == 0, process.stderr.decode()
