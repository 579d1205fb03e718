"""Bake the primitives of one surface: weight field, welded surface, gradients, slots.

A surface is one mesh, or all meshes that the same skins draw.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skinbake.choices import Frame, FrameChoice, Neighbours, Weighting
from skinbake.geometry import frames
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import (
    BakedPrimitive,
    BoolArray,
    Float64Array,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
)
from skinbake.gradients import kernel
from skinbake.gradients.influences import ADOPTING_SUM, needs_tiny_weights, weight_field
from skinbake.gradients.surface import Surface, SurfaceSlots, WeightDefects, WeightField, concatenate_fields
from skinbake.gradients.tangents import ChosenFrame, chosen_frame, frame_vectors
from skinbake.gradients.weld import rigid_parts_apart, weld
from skinbake.timing import stage

EIGHTHS = 8
"""The parts of α and β of which a primitive may keep some."""

Slots = tuple[FloatArray, FloatArray]
"""α and β (V, K − 1) of a primitive."""


class BakeSettings(NamedTuple):
    """The settings of a bake. crease_angle is in radians; others are as on the command line."""

    weighting: Weighting
    crease_angle: float
    neighbours: Neighbours
    frame: FrameChoice


class BakeFindings(NamedTuple):
    """The findings of baking one primitive, in numbers.

    tangent_deviation is the largest angle in degrees between t0 × b0 and n0, 0 without TANGENT. bad_tangents
    is the number of vertices that exceed TANGENT_TOLERANCE, unhanded that of those among them at which
    TANGENT.w is neither 1 nor −1. magnitude is the summed length of the gradients, in 1 / length unit. lost
    is the share of it that no slot holds. Vertices with too little or negative weight count in neither
    overflowing_vertices nor lost: no further slot would help them.
    """

    weights: WeightDefects
    degenerate_triangles: int
    zero_normals: int
    tangent_deviation: float
    bad_tangents: int
    unhanded: int
    adopting_vertices: int
    overflowing_vertices: int
    magnitude: float
    lost: float


def bake_primitives(
    primitives: Sequence[SkinnedPrimitive], settings: BakeSettings, rig: Rig | None = None
) -> list[tuple[BakedPrimitive, BakeFindings]]:
    """Return α and β of every primitive of one surface, gathered across their borders.

    All primitives to bake are given, in the same mesh space, all skinned by the same joints. With
    ``frame="tangent"`` every primitive must have tangents. With a rig, α and β are fitted to its turns. The
    result has the order of the primitives.
    """
    gathered = _gathered(primitives, settings.crease_angle)
    with stage("frames"):
        chosen = [chosen_frame(primitive, settings.frame) for primitive in primitives]
        frame = None
        if any(choice.kind == Frame.TANGENT for choice in chosen):
            pairs = [
                frame_vectors(primitive, choice.kind)
                for primitive, choice in zip(primitives, chosen, strict=True)
            ]
            frame = _concatenate([pair[0] for pair in pairs]), _concatenate([pair[1] for pair in pairs])
    with stage("gradients"):
        surface = gathered.surface(frame, rig)
        adopt = settings.neighbours != Neighbours.DROP
        slots = kernel.bake_surface(surface, weighting=settings.weighting, adopt=adopt)
        leaves_out = bool(slots.sums[:, 1].any())
        if any(
            found.all_zero
            or found.not_normalised
            or found.negative
            or (leaves_out and needs_tiny_weights(one.weights).any())
            for found, one in zip(gathered.defects, primitives, strict=True)
        ):
            slots.sums[:, [1, 3]] -= _unadoptable(primitives, gathered, settings.weighting)
    return [
        _of_primitive(number, primitive, choice, gathered, slots)
        for number, (primitive, choice) in enumerate(zip(primitives, chosen, strict=True))
    ]


def _unadoptable(
    primitives: Sequence[SkinnedPrimitive], gathered: _Gathered, weighting: Weighting
) -> Float64Array:
    """Return what copies of vertices that may never adopt leave out, for each primitive (P, 2).

    The columns are the number of such vertices that leave out joints of neighbours, and the summed length of
    the gradients left out, in 1 / length unit.
    """
    field, classes, found = gathered.field, gathered.classes, np.zeros((len(primitives), 2))
    sums = np.concatenate([part.weights.clip(0.0).sum(axis=1, dtype=np.float64) for part in primitives])
    unsafe = [(part.weights < 0.0).any(axis=1) | needs_tiny_weights(part.weights) for part in primitives]
    closed = np.zeros(int(classes.max(initial=-1)) + 1, dtype=np.bool_)
    closed[classes[((sums <= ADOPTING_SUM) | np.concatenate(unsafe)) & ~field.free.any(axis=1)]] = True
    if not closed.any():
        return found
    from skinbake.gradients.slots import assign  # in most files all vertices have weights
    from skinbake.gradients.weight_gradients import weight_gradients

    near = closed[classes[gathered.triangles]].any(axis=1)
    gradients = weight_gradients(
        gathered.positions, gathered.triangles[near], field, classes, weighting=weighting
    )
    for number, (start, end) in enumerate(itertools.pairwise([0, *gathered.ends])):
        rows = start + np.flatnonzero(closed[classes[start:end]])
        no_frame = np.zeros((len(rows), 3))
        left = assign(gradients, classes[rows], field.rows(rows), (no_frame, no_frame), None)
        found[number] = left.overflowing, left.unheld
    return found


def _of_primitive(
    number: int, primitive: SkinnedPrimitive, choice: ChosenFrame, gathered: _Gathered, slots: SurfaceSlots
) -> tuple[BakedPrimitive, BakeFindings]:
    """Take the part of one primitive out of the result of its surface."""
    end, influences = gathered.ends[number], primitive.joints.shape[1]
    rows = slice(end - len(primitive.positions), end)
    adopting, overflowing, magnitude, unheld = slots.sums[number].tolist()
    findings = BakeFindings(
        weights=gathered.defects[number],
        degenerate_triangles=gathered.degenerate[number],
        zero_normals=frames.without_direction(primitive.normals),
        tangent_deviation=choice.deviation,
        bad_tangents=choice.deviating,
        unhanded=choice.unhanded,
        adopting_vertices=int(adopting),
        overflowing_vertices=int(overflowing),
        magnitude=magnitude,
        lost=unheld / magnitude if magnitude > 0 else 0.0,
    )
    own = slice(*np.searchsorted(slots.adopting, [rows.start, rows.stop]))
    result = BakedPrimitive(
        alpha=slots.alpha[rows, : influences - 1],
        beta=slots.beta[rows, : influences - 1],
        adopting=slots.adopting[own] - rows.start,
        adopted=slots.adopted[own, :influences],
        frame=choice.kind,
        classes=gathered.classes[rows],
    )
    return result, findings


def slots_of_surface(
    primitives: Sequence[SkinnedPrimitive],
    frame: tuple[FloatArray, FloatArray],
    *,
    weighting: Weighting,
    crease_angle: float,
    rig: Rig | None,
    kept: Sequence[int] = (),
) -> list[Slots]:
    """Return α and β of each primitive of one surface, for given t0 and b0, each (V, 3). No slot adopts.

    The arguments are as for ``bake_primitives``; crease_angle is in radians. kept are the eighths of α and β
    that each primitive keeps, all if it is empty.
    """
    gathered = _gathered(primitives, crease_angle)
    with stage("gradients"):
        found = kernel.bake_surface(gathered.surface(frame, rig), weighting=weighting, adopt=False)
    parts = [slice(*part) for part in itertools.pairwise([0, *gathered.ends])]
    widths = [primitive.joints.shape[1] - 1 for primitive in primitives]
    slots = [
        (found.alpha[part, :width], found.beta[part, :width])
        for part, width in zip(parts, widths, strict=True)
    ]
    return kept_slots(slots, [gathered.classes[part] for part in parts], kept) if kept else slots


def kept_slots(slots: Sequence[Slots], classes: Sequence[IntArray], eighths: Sequence[int]) -> list[Slots]:
    """Return some eighths of α and β (V, K − 1) of the primitives of a surface.

    classes (V,) of each primitive number the weld classes of the surface. Where primitives meet, both keep
    the lesser part: light must not change abruptly there.
    """
    least = np.full(max(int(own.max(initial=-1)) for own in classes) + 1, EIGHTHS)
    for own, kept in zip(classes, eighths, strict=True):
        least[own] = np.minimum(least[own], kept)
    shares = [(least[own] / np.float32(EIGHTHS)).astype(np.float32)[:, None] for own in classes]
    return [(alpha * share, beta * share) for (alpha, beta), share in zip(slots, shares, strict=True)]


class _Gathered(NamedTuple):
    """The arrays of all primitives of one surface, one after the other; see ``Surface``.

    defects and degenerate have an entry for each primitive: what its weights needed, and how many of its
    triangles have no area and were left out.
    """

    positions: FloatArray
    triangles: IntArray
    field: WeightField
    classes: IntArray
    normals: FloatArray
    ends: list[int]
    defects: Sequence[WeightDefects]
    degenerate: Sequence[int]

    def surface(self, frame: tuple[FloatArray, FloatArray] | None, rig: Rig | None) -> Surface:
        """Return the surface with a frame, and with a rig that has all joints."""
        joints = int(self.field.joints.max(initial=-1)) + 1
        return Surface(
            self.positions,
            self.triangles,
            self.field,
            self.classes,
            self.normals,
            frame,
            self.ends,
            None if rig is None else rig.with_joints(joints),
        )


def _gathered(primitives: Sequence[SkinnedPrimitive], crease_angle: float) -> _Gathered:
    """Gather and weld the arrays of one surface. crease_angle is in radians."""
    with stage("weights"):
        fields, defects = zip(*(weight_field(primitive) for primitive in primitives), strict=True)
        field = concatenate_fields(fields)
    ends = np.cumsum([len(primitive.positions) for primitive in primitives]).tolist()
    positions = _concatenate([primitive.positions for primitive in primitives])
    with stage("triangles"):
        masks = [kernel.mark_proper(part.positions, part.triangles) for part in primitives]
        triangles = _concatenate_triangles(primitives, masks, [0, *ends])
    with stage("weld"):
        normals = _concatenate([primitive.normals for primitive in primitives])
        classes = weld(positions, normals, field, crease_angle=crease_angle)
        classes = rigid_parts_apart(classes, triangles, field, ends)
    degenerate = [len(mask) - int(np.count_nonzero(mask)) for mask in masks]
    return _Gathered(positions, triangles, field, classes, normals, ends, defects, degenerate)


def _concatenate_triangles(
    primitives: Sequence[SkinnedPrimitive], masks: Sequence[BoolArray], starts: Sequence[int]
) -> IntArray:
    """Return the triangles that have an area, as indices into the vertices of all primitives together."""
    parts = [
        primitive.triangles if mask.all() else primitive.triangles[mask]
        for primitive, mask in zip(primitives, masks, strict=True)
    ]
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([part + np.uint32(start) for part, start in zip(parts, starts, strict=False)])


def _concatenate(arrays: Sequence[FloatArray]) -> FloatArray:
    """Return the rows of several arrays in one array. A single array is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
