"""How far mapped normals err: those of a relief over the surface, as a normal map shows one.

The relief tilts the normal of each vertex by RELIEF_TILT in a direction of its own. Its truth is the relief
displaced along n0 and skinned with the mesh. So it is carried by the cofactors of a map whose columns are F t
and F b, the true images of the tangents (``truth.normals``, along tangents), and a third one: what skinning
does to n0. Morph targets come first: they take t and b to their true images on the moved surface, and n0 to
the true normal there.

Two things can stand for the third column. T n0 is what skinning does to a displacement. It is the same vector
that accurate lighting uses, so a fault of it would not show. The other one is F n0 of the truth itself, which
grows by the root of the change of area, and knows nothing of T. Figures are made with both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import Baseline
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.morphs import carried_by_normal
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray
from skinbake.gltf.document import Document
from skinbake.gltf.reading.materials import material_of
from skinbake.measure.angles import INSIDE_OUT, METHODS
from skinbake.measure.draws import Draw
from skinbake.measure.tally import Tallies
from skinbake.report.verify import Reliefs
from skinbake.skinning.components import Vector, cross, dot, plus_scaled, scaled
from skinbake.skinning.normal_maps import engine_mapped_normal, in_frame, mapped_normal
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.truth import kernel
from skinbake.truth.blending import BlendedPrimitive, sides_of
from skinbake.truth.kernel import dqs_positions
from skinbake.truth.normals import FLAT_FRAME
from skinbake.truth.truths import Truths, VertexBlock, joined
from skinbake.truth.values import SparseRows

if TYPE_CHECKING:
    from skinbake.truth.morphing import Morphing

RELIEF_TILT = 25.0
"""Degrees by which the relief tilts the normal: a deep normal map, as of cloth or scales."""

GOLDEN_TURN = math.pi * (3.0 - math.sqrt(5.0))
"""From one vertex to the next, the direction of the tilt turns by so much: all directions are as frequent."""

RELIEF_SAMPLES = 1 << 17
"""The vertices × poses that a relief is measured in, of evenly spread poses. Each takes 5 µs."""

CHUNK_POSES, CHUNK_SAMPLES = 16, 1 << 20
"""The poses in work at a time, and the vertices × poses, each at most."""

THIRDS = ("carried", "area")
"""The two kinds of the third column: T n0, and F n0."""


def has_normal_map(document: Document, view: BakedView) -> bool:
    """Tell whether the material of a primitive has a normal map, or one for its clear coat."""
    material = material_of(document, view.source.material)
    return material is not None and material.has_normal_map


class ReliefTallies:
    """The errors of the reliefs of a file, draw by draw."""

    def __init__(self, document: Document, options: Options) -> None:
        self._document, self._options = document, options
        self._tallies, self._is_measured = Tallies(()), False

    def expect(self, drawn: Sequence[Draw]) -> None:
        """Take the draws of the file."""
        self._tallies = Tallies(
            draw.surface.views[number].source.place for draw in drawn for number in self._mapped(draw)
        )

    def _mapped(self, draw: Draw) -> list[int]:
        """Return the numbers of a draw's primitives that have a normal map, and TANGENT for its frame."""
        return [
            number
            for number, view in enumerate(draw.surface.views)
            if view.now.tangents is not None and has_normal_map(self._document, view)
        ]

    def measure(self, method: str, draw: Draw, truths: Truths, morphing: Morphing | None) -> None:
        """Measure the primitives of a draw that have a normal map. truths are the draw's, at rest."""
        mapped = self._mapped(draw)
        samples = sum(len(draw.surface.rest[number].positions) for number in mapped) * len(draw.poses.clips)
        if not samples:
            return
        chosen = np.arange(0, len(draw.poses.clips), -(-samples // RELIEF_SAMPLES))
        first = self._tallies.begin(
            (view.source.place for view in draw.surface.views),
            [draw.poses.clips[pose] for pose in chosen],
            [draw.poses.times[pose] for pose in chosen],
        )
        self._is_measured = True
        size = max(1, min(CHUNK_POSES, CHUNK_SAMPLES // len(draw.surface.operator.positions)))
        size = 1 if morphing is not None else size
        for start in range(0, len(chosen), size):
            poses = chosen[start : start + size]
            rests = _Rests.of(draw.surface.rest, truths, morphing, int(poses[0]))
            posed = _PosedRelief.of(method, rests, draw.poses.joint_matrices[poses], self._options)
            for block in truths.vertex_blocks:
                if block.primitive not in mapped:
                    continue
                view, areas = draw.surface.views[block.primitive], draw.areas[block.primitive][block.rows]
                texel = _texels(view, draw.surface.rest[block.primitive], block.rows)
                for kind, lighting, errors, valid in posed.errors(truths, block, texel):
                    counted = kernel.count_errors(errors, areas, valid)
                    where = first + block.primitive, start, block.rows.start
                    self._tallies.take((kind, method, lighting), counted, where)

    def reliefs(self) -> Reliefs | None:
        """Return the figures of what was measured; None if no primitive has a normal map with TANGENT."""
        return Reliefs(*map(self._tallies.figures, THIRDS)) if self._is_measured else None


@dataclass(frozen=True, slots=True)
class _Texel:
    """The relief at B vertices: the texel itself, in TANGENT's frame, and in that of bake at rest.

    tangent is TANGENT, and handedness its sign. parts (3, B) are those of unit TANGENT along unit t0, b0, n0.
    All are components.
    """

    texel: Vector
    drawn: Vector
    parts: Vector
    handedness: FloatArray


def _texels(view: BakedView, rest: RestPrimitive, rows: slice) -> _Texel:
    """Return the relief at some vertices of a primitive, at rest and before morph targets."""
    assert view.now.tangents is not None
    turns = GOLDEN_TURN * np.arange(rows.start, rows.stop)
    tilt = math.radians(RELIEF_TILT)
    texel = (
        math.sin(tilt) * np.cos(turns),
        math.sin(tilt) * np.sin(turns),
        np.full(turns.shape, math.cos(tilt)),
    )
    x, y, z, w = view.now.tangents[rows].T.astype(np.float64)
    frame = tuple(
        tuple(vectors[rows].T.astype(np.float64))
        for vectors in (rest.tangents, rest.bitangents, rest.normals)
    )
    handedness = np.where(w < 0, -1.0, 1.0)
    drawn = engine_mapped_normal(frame[2], (x, y, z), handedness, texel)
    along = in_frame((x, y, z), *frame)
    length = np.sqrt(dot(along, along))
    return _Texel(texel, in_frame(drawn, *frame), scaled(1.0 / length, along), handedness)


@dataclass(frozen=True, slots=True)
class _Rests:
    """The primitives of a draw before skinning: at rest, and under the morph targets of a pose.

    moved is for accurate lighting, standard for that of engines. true has the true normals.
    """

    still: Sequence[RestPrimitive]
    moved: Sequence[RestPrimitive]
    standard: Sequence[RestPrimitive]
    true: Sequence[RestPrimitive]

    @classmethod
    def of(
        cls, still: Sequence[RestPrimitive], truths: Truths, morphing: Morphing | None, pose: int
    ) -> _Rests:
        """Move primitives by the targets of a pose. truths are those at rest."""
        moved = standard = true = still
        if morphing is not None:
            moved, standard = morphing.accurate(still, pose), morphing.standard(still, pose)
            true = morphing.as_true(moved, truths)
        return cls(still, moved, standard, true)


@dataclass(frozen=True, slots=True)
class _PosedRelief:
    """The primitives of a draw in some poses of a method: positions (3, V, P), and what skins each of them.

    plain and engine have T n of both frames, standard the normals of the baseline, true T n of the true ones.
    sides (P, V) come from ``sides_of``.
    """

    method: str
    rests: _Rests
    positions: Float64Array
    plain: Sequence[Skinning]
    engine: Sequence[Skinning]
    standard: Sequence[Skinning]
    true: Sequence[Skinning]
    sides: Float64Array | None

    @classmethod
    def of(cls, method: str, rests: _Rests, joint_matrices: Float64Array, options: Options) -> _PosedRelief:
        """Skin the primitives (V vertices in all) by joint matrices (P, J, 4, 4)."""
        mapped = options._replace(baseline=Baseline.BLENDED, normal_map=True)
        of_baseline = mapped._replace(baseline=options.baseline)
        is_dual = method == "dqs"

        def skinned(primitives: Sequence[RestPrimitive], by: Options) -> list[Skinning]:
            return Skinning.of_mesh(primitives, joint_matrices, by, dual_quaternions=is_dual)

        plain = skinned(rests.moved, mapped)
        whole, count = slice(0, len(joint_matrices)), sum(len(rest.positions) for rest in rests.moved)
        positions = np.empty((3, count, len(joint_matrices)))
        row = 0
        for rest, skinning in zip(rests.moved, plain, strict=True):
            part = slice(0, len(rest.positions))
            if is_dual:
                dqs_positions(skinning, whole, part, positions, row)
            else:
                BlendedPrimitive(rest, joint_matrices, options).put_positions(whole, part, positions, row)
            row += len(rest.positions)
        engine = plain if rests.standard is rests.moved else skinned(rests.standard, mapped)
        return cls(
            method,
            rests,
            positions,
            plain,
            engine,
            engine if options.baseline is Baseline.BLENDED else skinned(rests.standard, of_baseline),
            plain if rests.true is rests.moved else skinned(rests.true, mapped),
            sides_of(rests.moved, joint_matrices),
        )

    def errors(
        self, truths: Truths, block: VertexBlock, at: _Texel
    ) -> Iterator[tuple[str, str, FloatArray, BoolArray]]:
        """Yield kind of third column, lighting, errors (P, B) in degrees, and where they are valid."""
        rests, number, whole = self.rests, block.primitive, slice(0, self.positions.shape[2])
        skinning = self.plain[number]
        every = METHODS[self.method]
        standard, algorithms = every["standard"], {name: every[name] for name in every if name in INSIDE_OUT}
        accurate = skinning.run([*algorithms.values()], whole, block.rows)
        scale = skinning.motions.scale
        times = 1.0 if scale is None else scale[:, None]
        length = times * rests.moved[number].rows(block.rows).tangent_lengths()
        side = 1.0 if self.sides is None else self.sides[:, block.part]
        # The standard frame has T t of TANGENT, the accurate one its image under the differential.
        found = {"standard": self._standard(block, standard, times, at)}
        for lighting, posed in zip(algorithms, accurate, strict=True):
            found[lighting] = scaled(side, mapped_normal(posed, length, at.drawn))
        tangent = plus_scaled(scaled(at.parts[0], posed.tangent), at.parts[1], posed.bitangent)
        outside = scaled(side, posed.normal)
        found["engine_frame"] = engine_mapped_normal(outside, tangent, at.handedness, at.texel)

        # What morph targets make of unit t0 and b0, turned onto the true normal before skinning.
        rest = rests.still[number].rows(block.rows)
        unit: list[FloatArray] = [
            _unit(vectors) for vectors in (rest.tangents, rest.bitangents, rest.normals)
        ]
        along = truths.frames.derivatives[block.number]
        both = (joined(primitives, "positions") for primitives in (rests.still, rests.moved))
        states = [positions.astype(np.float64).T[:, :, None] for positions in both]
        before, moved, after = (
            [_derivative(rows, positions) for rows in along] for positions in (*states, self.positions)
        )
        valid: BoolArray | bool = True
        if rests.moved is not rests.still:
            images, third, valid = _images(before, moved, [tuple(one.T) for one in unit], 1.0)
            normals = rests.true[number].normals[block.rows].astype(np.float64)
            surface, *turned = (np.stack([part[0] for part in one], axis=1) for one in (third, *images))
            unit = [*carried_by_normal(_unit(surface), turned, normals), normals]
        images, third, known = _images(moved, after, [tuple(one.T) for one in unit], side)
        (true,) = self.true[number].run((standard,), whole, block.rows)
        for kind, column in zip(THIRDS, (scaled(times, true.normal), third), strict=True):
            wanted = plus_scaled(
                plus_scaled(
                    scaled(at.drawn[0], cross(images[1], column)), at.drawn[1], cross(column, images[0])
                ),
                at.drawn[2],
                cross(*images),
            )
            wanted = scaled(side * rest.handedness(), wanted)
            exists = valid & known & np.isfinite(wanted[0]) & (dot(wanted, wanted) > 0)
            for lighting, shown in found.items():
                across = cross(shown, wanted)
                angles = np.degrees(np.arctan2(np.sqrt(dot(across, across)), dot(shown, wanted)))
                angles[dot(shown, shown) == 0] = np.nan
                yield kind, lighting, angles.astype(np.float32), exists

    def _standard(
        self, block: VertexBlock, algorithm: Algorithm, times: FloatArray | float, at: _Texel
    ) -> Vector:
        number, rows, poses = block.primitive, block.rows, slice(0, self.positions.shape[2])
        (plain,) = self.engine[number].run((algorithm,), poses, rows)
        posed = plain
        if self.standard is not self.engine:
            (posed,) = self.standard[number].run((algorithm,), poses, rows)
        length = times * self.rests.standard[number].rows(rows).tangent_lengths()
        images = scaled(1.0 / length, plain.tangent), scaled(1.0 / length, plain.bitangent), plain.normal
        tangent = scaled(at.parts[0], images[0])
        for part, image in zip(at.parts[1:], images[1:], strict=True):
            tangent = plus_scaled(tangent, part, image)
        return engine_mapped_normal(posed.normal, tangent, at.handedness, at.texel)


def _derivative(rows: SparseRows, positions: Float64Array) -> Vector:
    """Differentiate positions (3, V, P) along one tangent: components (P, B). It needs no SciPy."""
    entries, starts = rows.entries, rows.starts - rows.starts[0]
    columns, values = rows.columns[entries], rows.values[entries, None]
    filled = np.flatnonzero(np.diff(starts))
    result = np.zeros((3, len(rows), positions.shape[2]))
    for axis, component in enumerate(positions):
        if len(filled):
            result[axis, filled] = np.add.reduceat(values * component[columns], starts[filled], axis=0)
    return tuple(component.T for component in result)


def _images(
    before: Sequence[Vector], after: Sequence[Vector], frame: Sequence[Vector], side: FloatArray | float
) -> tuple[tuple[Vector, Vector], Vector, BoolArray]:
    """Return F t and F b, F n, all components (P, B), and where F is known, for frame (t, b, n).

    F maps the frame (a, b, ĉ) before, c = a × b, onto (a', b', ĉ') after, where ĉ' is as long as the root of
    the change of area.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is not valid
        (a0, b0), (a, b) = before, after
        c0, c = cross(a0, b0), cross(a, b)
        area0, area = np.sqrt(dot(c0, c0)), np.sqrt(dot(c, c))
        m = scaled(side / np.sqrt(area * area0), c)
        images = []
        for vector in frame:
            up = dot(vector, c0) / area0
            by_a, by_b = dot(cross(b0, c0), vector) / area0**2, dot(cross(c0, a0), vector) / area0**2
            images.append(plus_scaled(plus_scaled(scaled(by_a, a), by_b, b), up, m))
        valid = (area > FLAT_FRAME * np.sqrt(dot(a, a) * dot(b, b))) & np.isfinite(images[0][0])
        valid &= area0 > FLAT_FRAME * np.sqrt(dot(a0, a0) * dot(b0, b0))
    return (images[0], images[1]), images[2], valid


def _unit(vectors: FloatArray) -> Float64Array:
    """Return vectors (B, 3) at length 1."""
    with np.errstate(invalid="ignore", divide="ignore"):  # what is not finite is not valid
        found: Float64Array = vectors / np.linalg.norm(vectors.astype(np.float64), axis=1, keepdims=True)
    return found
