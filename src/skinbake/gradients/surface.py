"""α and β of all primitives that are baked as one surface, by the compiled loops or by numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.skinned import Float32Array, FloatArray, IntArray
from skinbake.gradients import kernel
from skinbake.gradients.corner import WEIGHTINGS
from skinbake.gradients.influences import NO_JOINT, WeightField
from skinbake.gradients.slots import NEGLIGIBLE, assign, shared_capacity
from skinbake.gradients.weight_gradients import weight_gradients


@dataclass(frozen=True, slots=True)
class Surface:
    """One surface of P primitives, their V vertices one after the other.

    positions (V, 3) in mesh space; triangles (T, 3) into them, all with an area; field the normalised
    weights (V, K); classes (V,) each vertex's weld class; normals (V, 3) of any length; frame the tangents
    and bitangents at rest, each (V, 3) and of one type, None for those that follow from the normals.
    ends (P,) is where each primitive's vertices end.
    """

    positions: FloatArray
    triangles: IntArray
    field: WeightField
    classes: IntArray
    normals: FloatArray
    frame: tuple[FloatArray, FloatArray] | None
    ends: Sequence[int]


@dataclass(frozen=True, slots=True)
class SurfaceSlots:
    """α and β of every slot but the first, and what the slots could not hold.

    alpha, beta (V, K − 1) float32, 1 / length unit. adopting (A,) names the vertices that adopt, ascending;
    adopted (A, K) integer the joint that each of their slots adopts, −1 where it stays. counts (P, 4)
    float64, by primitive: vertices that adopt; vertices with more foreign joints than free slots (all that
    have any, where none are adopted); the lengths of all joints' gradients summed over the vertices, in 1 /
    length unit; and the part of that sum that no slot holds, which falls to s0.
    """

    alpha: Float32Array
    beta: Float32Array
    adopting: IntArray
    adopted: IntArray
    counts: npt.NDArray[np.float64]


def surface_slots(surface: Surface, *, weighting: str, adopt: bool) -> SurfaceSlots:
    """Return α and β of a surface; weighting is a key of WEIGHTINGS.

    With ``adopt``, joints that vary around a vertex without being its own move into free slots.
    """
    if kernel.compiled is None:
        with np.errstate(over="ignore", invalid="ignore"):  # the compiled loops overflow without a word too
            return _by_numpy(surface, weighting=weighting, adopt=adopt)
    shape = surface.field.joints.shape
    alpha, beta = (np.empty((shape[0], shape[1] - 1), dtype=np.float32) for _ in range(2))
    adopted = np.zeros(shape, dtype=np.int32)  # memory that stays untouched where nothing is adopted
    tangents, bitangents = surface.frame or (np.zeros((0, 3)), np.zeros((0, 3)))
    counts = np.zeros((len(surface.ends), 4))
    kernel.compiled.bake(
        np.ascontiguousarray(surface.positions),
        np.ascontiguousarray(surface.triangles, dtype=np.uint32),
        surface.field.joints,
        surface.field.weights,
        surface.field.free,
        np.ascontiguousarray(surface.classes, dtype=np.int32),
        np.ascontiguousarray(surface.normals),
        np.ascontiguousarray(tangents),
        np.ascontiguousarray(bitangents),
        alpha,
        beta,
        adopted,
        np.array(surface.ends, dtype=np.uint64),
        counts,
        int(surface.classes.max(initial=-1)) + 1,
        WEIGHTINGS[weighting],
        adopt,
        NEGLIGIBLE,
    )
    adopts = np.zeros(shape[0], dtype=np.bool_)
    adopts[np.flatnonzero(adopted) // shape[1]] = True
    rows = np.flatnonzero(adopts)
    return SurfaceSlots(alpha, beta, rows, adopted[rows] - 1, counts)


def _by_numpy(surface: Surface, *, weighting: str, adopt: bool) -> SurfaceSlots:
    field, classes = surface.field, surface.classes
    gradients = weight_gradients(surface.positions, surface.triangles, field, classes, weighting=weighting)
    capacity = shared_capacity(field, classes) if adopt else None
    tangents, bitangents = surface.frame or frame_from_normal(unit_normals(surface.normals))
    parts, counts, start = [], [], 0
    for end in surface.ends:
        rows = slice(start, end)
        frame = (tangents[rows], bitangents[rows])
        room = None if capacity is None else capacity[rows]
        part = assign(gradients, classes[rows], field.rows(rows), frame, room)
        takers = np.count_nonzero((part.adopted != NO_JOINT).any(axis=1))
        counts.append([takers, part.overflowing, part.magnitude, part.lost * part.magnitude])
        parts.append(part)
        start = end
    adopted = np.concatenate([part.adopted for part in parts])
    adopting = np.flatnonzero((adopted != NO_JOINT).any(axis=1))
    return SurfaceSlots(
        alpha=np.concatenate([part.alpha[:, 1:] for part in parts]).astype(np.float32),
        beta=np.concatenate([part.beta[:, 1:] for part in parts]).astype(np.float32),
        adopting=adopting,
        adopted=adopted[adopting],
        counts=np.array(counts),
    )
