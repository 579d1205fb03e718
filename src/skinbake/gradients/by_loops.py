"""The operations of the kernel by the compiled loops, with arrays of the types and layout that they read.

The same operations in numpy, ``by_numpy``, describe the results.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray, blocks
from skinbake.geometry.triangles import DEGENERATE_AREA
from skinbake.gradients import _kernel as loops
from skinbake.gradients import fit_rules
from skinbake.gradients.surface import NEGLIGIBLE, Labels, Surface, SurfaceSlots, WeightDefects, WeightField
from skinbake.timing import tell_steps

NO_RIG = Rig(np.empty(0, dtype=np.int32), np.empty((0, 3)))

PART = 1 << 15
"""The weld classes that one thread bakes at a time. It is fixed, so sums are the same for any threads."""

ROWS_A_THREAD = 1 << 17
"""The vertices or triangles that one thread prepares at a time: about 3 ms of work."""

Found = TypeVar("Found")

WEIGHTINGS = {
    "max": loops.BY_MAX,
    "angle": loops.BY_ANGLE,
    "area": loops.BY_AREA,
    "angle-area": loops.BY_ANGLE_AREA,
}


def label_equal_rows(rows: npt.NDArray[np.generic]) -> Labels:
    """Return a label (V,) from 0 for every row (V, M). Equal rows have the same label.

    Rows with hashes that were made alike on purpose are sorted instead.
    """
    labels = np.empty(len(rows), dtype=np.int32)
    try:
        loops.label_equal_rows(np.ascontiguousarray(rows), labels)
    except loops.CollisionError:
        from skinbake.gradients import by_numpy

        return by_numpy.label_equal_rows(rows)
    return labels


def normalise_influences(
    joints: npt.NDArray[Any],
    weights: npt.NDArray[Any],
    *,
    adopting_sum: float,
    adopting_weight: float,
    tolerance: float,
    least: float,
) -> tuple[WeightField, WeightDefects]:
    """Return the weight field of stored influences (V, K), with the assumptions made."""
    shape = joints.shape
    field = WeightField(np.empty(shape, np.int32), np.empty(shape), np.empty(shape, np.bool_))

    def normalise(rows: slice) -> dict[str, int]:
        part = field.rows(rows)
        part.joints[:], part.weights[:] = joints[rows], weights[rows]
        return loops.normalise_influences(*part, adopting_sum, adopting_weight, tolerance, least)

    found = _by_rows(normalise, len(joints))
    defects = {name: sum(part[name] for part in found) for name in found[0]}
    return field, WeightDefects(**defects)


def mark_proper(positions: FloatArray, triangles: IntArray) -> BoolArray:
    """Tell for each triangle (T, 3) whether it has an area, as a mask (T,)."""
    mask = np.empty(len(triangles), dtype=np.bool_)
    corners = np.ascontiguousarray(triangles, dtype=np.uint32)
    points = np.ascontiguousarray(positions)

    def mark(rows: slice) -> None:
        loops.mark_proper(points, corners[rows], mask[rows], DEGENERATE_AREA)

    _by_rows(mark, len(corners))
    return mask


def bake_surface(surface: Surface, *, weighting: str, adopt: bool) -> SurfaceSlots:
    """Return α and β of a surface, as ``by_numpy`` does.

    Several threads bake a large surface. The result does not depend on their number.
    """
    vertices, slots = surface.field.joints.shape
    alpha, beta = (np.empty((vertices, slots - 1), dtype=np.float32) for _ in range(2))
    adopted = np.zeros((vertices, slots), dtype=np.int32)  # memory stays untouched if no slot adopts
    tangents, bitangents = surface.frame or (np.zeros((0, 3)), np.zeros((0, 3)))
    rig = surface.rig or NO_RIG
    # The matrices of joints in groups of four poses, (J, groups, 12, 4). The last group may have less than
    # four.
    poses, joints = len(rig.poses), len(rig.parents)
    groups = -(-poses // 4)
    wide = np.zeros((4 * groups, joints, 12))
    wide[:poses] = rig.poses.reshape(poses, joints, 12)
    lanes = wide.reshape(groups, 4, joints, 12).transpose(2, 0, 3, 1).reshape(joints, 48 * groups)
    shares = np.where(np.arange(4 * groups) < poses, 1.0 / max(poses, 1), 0.0)
    triangles = np.ascontiguousarray(surface.triangles, dtype=np.uint32)
    classes = np.ascontiguousarray(surface.classes, dtype=np.int32)
    count = int(classes.max(initial=-1)) + 1
    bake = partial(
        loops.bake_surface,
        positions=np.ascontiguousarray(surface.positions),
        triangles=triangles,
        joints=surface.field.joints,
        weights=surface.field.weights,
        free=surface.field.free,
        classes=classes,
        normals=np.ascontiguousarray(surface.normals),
        tangents=np.ascontiguousarray(tangents),
        bitangents=np.ascontiguousarray(bitangents),
        alpha=alpha,
        beta=beta,
        adopted=adopted,
        ends=np.array(surface.ends, dtype=np.uint64),
        parents=np.ascontiguousarray(rig.parents, dtype=np.int32),
        ranks=np.ascontiguousarray(rig.ranks, dtype=np.int32),
        pivots=np.ascontiguousarray(rig.pivots, dtype=np.float64),
        chains=np.ascontiguousarray(rig.chains, dtype=np.int32),
        poses=np.ascontiguousarray(lanes),
        shares=shares,
        class_count=count,
        weighting=WEIGHTINGS[weighting],
        adopts=adopt,
        negligible=NEGLIGIBLE,
        stiffness=fit_rules.STIFFNESS,
        turn=fit_rules.TURN,
        together=fit_rules.TOGETHER,
        collapsed=fit_rules.COLLAPSED,
        ray=fit_rules.RAY,
        even=fit_rules.EVEN,
        unfelt=fit_rules.UNFELT,
        narrow=fit_rules.NARROW,
        flat=fit_rules.FLAT,
        flat_tilt=fit_rules.FLAT_TILT,
        bounded=fit_rules.BOUNDED,
        small=fit_rules.SMALL,
    )
    if count <= PART:
        sums = np.zeros((len(surface.ends), 4))
        bake(sums=sums, grouped=None, first=0, last=0)
    else:
        grouped = loops.group_surface(triangles, surface.field.joints, surface.field.weights, classes, count)
        sums = _baked_in_parts(partial(bake, grouped=grouped), count, len(surface.ends))
    adopts = np.zeros(vertices, dtype=np.bool_)
    for column in adopted.T:  # half the time that whole rows take
        adopts |= column != 0
    rows = np.flatnonzero(adopts)
    return SurfaceSlots(alpha, beta, rows, adopted[rows] - 1, sums)


def _by_rows(work: Callable[[slice], Found], rows: int) -> list[Found]:
    """Return the results of work on parts of some rows, done side by side if they are many."""
    if rows <= ROWS_A_THREAD:
        return [work(slice(0, rows))]
    from skinbake.threads import Threads, thread_count

    with Threads(thread_count()) as threads:
        return list(threads.each(work, blocks(rows, ROWS_A_THREAD)))


def _baked_in_parts(bake: Callable[..., None], classes: int, primitives: int) -> Float64Array:
    """Bake parts of the classes side by side. Return the sums (P, 4), added in the order of the parts.

    Each part is a step of the present stage.
    """
    from skinbake.threads import Threads, thread_count  # small models need no threads

    def baked(first: int) -> Float64Array:
        sums = np.zeros((primitives, 4))
        bake(sums=sums, first=first, last=min(first + PART, classes))
        return sums

    total, starts = np.zeros((primitives, 4)), range(0, classes, PART)
    with Threads(thread_count()) as threads:
        for done, sums in enumerate(threads.each(baked, starts), 1):
            total += sums
            tell_steps(done, len(starts))
    return total
