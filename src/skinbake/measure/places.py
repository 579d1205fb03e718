"""The places of a model that a bake improves or harms most, over the poses in which it is measured anyway.

A place is the surface within ``RADIUS`` of a small cell of it at rest. What it improves in a pose is the sum
of area at rest × (error of standard lighting − error of the bake's lighting), by the truth with the smaller
sum. Cells are cubes of the mesh, parted by the side that the surface faces: two thighs are two places.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray
from skinbake.gltf.reading.scenes import shown_by
from skinbake.measure.angles import MeasuredBlock
from skinbake.measure.draws import Draw
from skinbake.measure.scene import measure
from skinbake.report.verify import NEGLIGIBLE, Spot, Spots

CELL, RADIUS = 0.04, 0.07
"""The width of a cell and the radius of a place, as shares of the diagonal of the surface's box."""

FOLD = 90.0
"""Degrees from which on an error is that of a fold, which no lighting shows: it counts as so many."""

WORSE = 5.0
"""Degrees by which a bake is farther off than standard lighting, by every truth, where it gets worse."""

NEAR = 0.004
"""What lies so near before a place does not hide it, as a share of the model's size."""

TURNS, PITCHES = (0.0, 0.4, -0.4, 0.8, -0.8), (0.16, 0.5, -0.2)
"""The directions from which a place may be seen, in radians: around it, and above the level."""

STILL = 0.005
"""A clip stands still if no number of a joint's rotation and scale changes by more, of the largest one."""

LISTED, SEEDS = 5, 64
"""The most places that are told, and the cells around which places are tried."""

LEAST = 0.02
"""A place is told if it improves at least this share of what the best one does."""

SUMS = 1 << 20
"""The most poses × cells of a draw that are summed. Of more poses, some are passed by."""


NUMBERED = re.compile(r"(?<=[^\W_])_\d{2,}$")
SEPARATORS = re.compile(r"[\s_.\-]+|(?<=[a-z])(?=[A-Z])")
SIDES = {"l": "left", "r": "right"}
OF_RIGS = {
    "mixamorig",
    "bip01",
    "bip001",
    "def",
    "org",
    "jnt",
    "bind",
    "b",
    "bone",
    "joint",
    "skeleton",
    "armature",
}
"""How names end that an exporter has numbered, where their words part, and words that say little."""


Moment: TypeAlias = tuple[int | None, str, float | None]
"""The number and the name of a clip, and a time in it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """Cells (C,) of a draw around a seed, in one of its poses; figures are its two mean errors in degrees."""

    value: float
    draw: Draw
    cells: _Cells
    pose: int
    seed: int
    members: BoolArray
    figures: tuple[float, float]


class Places:
    """Sums of errors over the cells of one draw after the other, and the best places of all.

    Without skips_still, the poses of clips that stand still count, too: of one pose nobody can tell.
    """

    def __init__(self, *, skips_still: bool = True) -> None:
        self._skips_still = skips_still
        self._shows: list[list[_Candidate]] = []
        self._worse: list[_Candidate] = []
        self._moments: dict[Moment, float] = {}
        self._draw: Draw | None = None
        self._sums: dict[tuple[str, str], Float64Array] = {}

    def begin(self, draw: Draw) -> None:
        """Begin to sum the errors of a draw, which ``end`` ends. What no node of the scene draws is left."""
        self._draw = None
        if not any(_drawn(draw)):
            return
        self._draw, self._cells = draw, _Cells(draw)
        self._every = max(1, -(-len(draw.matrices) * self._cells.count // SUMS))
        self._poses = np.arange(0, len(draw.matrices), self._every)
        self._baked = "corrected" if draw.corrections else "accurate"
        self._sums = {}

    def counted(self, block: MeasuredBlock) -> tuple[IntArray, Float64Array] | None:
        """Return the cells (U,) of a block, and their sums (2, P, U) of area × degrees, and of area.

        It may be called on any thread. None: the block does not count.
        """
        if self._draw is None or block.lighting not in {"standard", self._baked}:
            return None
        cells, some = self._cells, slice(-block.pose % self._every, None, self._every)
        start = cells.starts[block.primitive] + block.vertex
        rows = slice(start, start + block.errors.shape[1])
        order = np.argsort(cells.of[rows], kind="stable")
        own = cells.of[rows][order]
        starts = np.flatnonzero(np.diff(own, prepend=-1))
        valid = block.valid[some][:, order]
        errors = np.where(valid, np.fmin(block.errors[some][:, order], np.float32(FOLD)), 0.0)
        weighted = np.stack([errors, valid]) * cells.areas[rows][order]
        return own[starts], np.add.reduceat(weighted, starts, axis=2)

    def add(self, block: MeasuredBlock, found: tuple[IntArray, Float64Array] | None) -> None:
        """Add the sums of a block, in the order of the blocks."""
        if found is None:
            return
        own, sums = found
        key = block.truth, block.lighting
        if key not in self._sums:
            self._sums[key] = np.zeros((2, len(self._poses), self._cells.count))
        first = -(-block.pose // self._every)
        self._sums[key][:, first : first + sums.shape[1], own] += sums

    def end(self) -> None:
        """Find the candidates of the draw that was begun."""
        draw = self._draw
        truths = sorted({truth for truth, _ in self._sums})
        if draw is None or not truths:
            return
        cells = self._cells
        sums = np.stack(
            [[self._sums[truth, name][0] for name in ("standard", self._baked)] for truth in truths]
        )
        areas = np.stack([self._sums[truth, "standard"][1] for truth in truths])
        gains = (sums[:, 0] - sums[:, 1]).min(axis=0)
        if self._skips_still:
            gains[_stands_still(draw)[self._poses]] = 0.0
        seen = gains * cells.seen(draw.matrices[self._poses])
        for pose, total in zip(self._poses.tolist(), np.maximum(seen, 0.0).sum(axis=1), strict=True):
            moment = _moment(draw, pose)
            self._moments[moment] = self._moments.get(moment, 0.0) + float(total)

        def candidate(value: float, row: int, seed: int, members: BoolArray) -> _Candidate:
            of_place = (
                sums[:, :, row, members].sum(axis=2)
                / np.maximum(areas[:, row, members].sum(axis=1), 1e-300)[:, None]
            )
            standard, baked = min(of_place.tolist(), key=lambda one: abs(one[0] - one[1]))
            return _Candidate(value, draw, cells, int(self._poses[row]), seed, members, (standard, baked))

        for seed in np.argsort(-seen.max(axis=0), kind="stable")[:SEEDS].tolist():
            members = cells.around(seed)
            values = seen[:, members].sum(axis=1)
            self._shows.append(
                [candidate(float(value), row, seed, members) for row, value in enumerate(values) if value > 0]
            )
        # Where it gets worse, each cell speaks for itself: around it there may be a gain.
        with np.errstate(invalid="ignore", divide="ignore"):
            excess = ((sums[:, 1] - sums[:, 0]) / areas).min(axis=0)
        harm = np.where(excess > WORSE, -gains, 0.0)
        rows = harm.argmax(axis=0)
        worst = harm[rows, np.arange(cells.count)]
        for seed in np.argsort(-worst, kind="stable")[:SEEDS].tolist():
            if worst[seed] > 0:
                alone = np.arange(cells.count) == seed
                self._worse.append(candidate(float(worst[seed]), int(rows[seed]), seed, alone))

    def spots(self) -> Spots:
        """Return the places: the first in the pose in which all improve most, the others in their best."""
        best = [max(of_seed, key=lambda one: one.value) for of_seed in self._shows if of_seed]
        if self._moments:
            moment = max(self._moments, key=lambda key: self._moments[key])
            then = [
                one for of_seed in self._shows for one in of_seed if _moment(one.draw, one.pose) == moment
            ]
            best = [*sorted(then, key=lambda one: -one.value)[:1], *sorted(best, key=lambda one: -one.value)]
        shows = [one for one in _apart(best) if one.figures[0] >= NEGLIGIBLE]
        shows = [one for one in shows if one.value >= LEAST * max(other.value for other in shows)]
        worse = _apart(sorted(self._worse, key=lambda one: -one.value))
        # A picture is of a place that can be seen: one deep in a fold comes after those.
        seen_first = sorted(map(_spot, shows), key=lambda spot: spot.is_hidden)
        return Spots(tuple(seen_first), tuple(map(_spot, worse)))


def _drawn(draw: Draw) -> list[bool]:
    """Tell of each primitive of a draw whether a node of the shown scene draws it by this skin."""
    meshes = [view.source.mesh for view in draw.surface.views]
    shown = shown_by(draw.surface.document, draw.skin, meshes)
    return [mesh in shown for mesh in meshes]


def _stands_still(draw: Draw) -> BoolArray:
    """Tell of each pose (P,) whether its clip turns no joint and moves no target: nothing would be played."""
    numbers, weights = np.array(draw.poses.numbers), draw.poses.morph_weights
    found = np.zeros(len(draw.matrices), np.bool_)
    for number in np.unique(numbers):
        rows = numbers == number
        linear = draw.matrices[rows, :, :3, :3]
        turns = np.ptp(linear, axis=0).max(initial=0.0) > STILL * np.abs(linear).max(initial=0.0)
        found[rows] = not (turns or (weights is not None and np.ptp(weights[rows], axis=0).any()))
    return found


def _moment(draw: Draw, pose: int) -> Moment:
    poses = draw.poses
    return poses.numbers[pose] if poses.numbers else None, poses.clips[pose], poses.times[pose]


class _Cells:
    """The cells of a draw: their number of each vertex (V,), and by cell (C, 3) their middles and sides.

    What is not drawn has no area.
    """

    def __init__(self, draw: Draw) -> None:
        rest = draw.surface.rest
        self.starts = np.cumsum([0, *(len(one.positions) for one in rest)])
        areas = zip(draw.areas, _drawn(draw), strict=True)
        self.areas = np.nan_to_num(np.concatenate([own * shown for own, shown in areas]), posinf=0.0)
        points = np.nan_to_num(np.concatenate([one.positions for one in rest]).astype(np.float64))
        normals = np.nan_to_num(np.concatenate([one.normals for one in rest]).astype(np.float64))
        drawn = points[self.areas > 0] if (self.areas > 0).any() else points
        low = drawn.min(axis=0)
        self.size = float(np.linalg.norm(np.ptp(drawn, axis=0))) or 1.0
        columns = np.clip((points - low) / (CELL * self.size), 0.0, 63.0).astype(np.int64)
        axis = np.abs(normals).argmax(axis=1)
        faces = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] < 0)
        keys = columns @ np.array([64 * 64 * 6, 64 * 6, 6]) + faces
        _, self.of = np.unique(keys, return_inverse=True)
        self.count = int(self.of.max()) + 1
        self.points = points
        members = np.maximum(np.bincount(self.of), 1)[:, None]
        self.middles = np.stack([np.bincount(self.of, axis) for axis in points.T], axis=1) / members
        self.sides = np.stack([np.bincount(self.of, axis) for axis in normals.T], axis=1)
        strongest = [one.joints[np.arange(len(one.weights)), one.weights.argmax(axis=1)] for one in rest]
        _, first = np.unique(self.of, return_index=True)
        self.joints = np.concatenate(strongest)[first]

    def seen(self, matrices: Float64Array) -> Float64Array:
        """Return how well each cell can be seen in poses (P, J, 4, 4): (P, C), 0 if it faces down, else 1.

        Cameras look from the level, or from above. A cell turns with its joint.
        """
        turned = np.einsum("pcij,cj->pci", matrices[:, self.joints][..., :3, :3], self.sides)
        with np.errstate(invalid="ignore", divide="ignore"):
            heights: Float64Array = turned[..., 1] / np.linalg.norm(turned, axis=2)
        return 1.0 + np.minimum(np.nan_to_num(heights), 0.0)

    def around(self, seed: int) -> BoolArray:
        """Return which cells (C,) belong to the place around a cell: near it, and facing its way."""
        far = np.linalg.norm(self.middles - self.middles[seed], axis=1)
        found: BoolArray = (far < RADIUS * self.size) & (self.sides @ self.sides[seed] > 0)
        found[seed] = True
        return found


def _apart(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """Return the first candidates, each farther than two radii from the ones before in the same mesh."""
    kept = list[tuple[_Candidate, Float64Array, float]]()
    for one in candidates:
        if len(kept) == LISTED:
            break
        middle, far = one.cells.middles[one.seed], 2 * RADIUS * one.cells.size
        if all(np.linalg.norm(middle - other) > max(far, of_other) for _, other, of_other in kept):
            kept.append((one, middle, far))
    return [one for one, _, _ in kept]


def _spot(one: _Candidate) -> Spot:
    """Return a candidate as a place: where its middle is drawn, and the joint that moves it most."""
    draw, poses, cells = one.draw, one.draw.poses, one.cells
    weights = None if poses.morph_weights is None else poses.morph_weights[one.pose : one.pose + 1]
    then = replace(
        draw,
        poses=poses._replace(joint_matrices=draw.matrices[one.pose : one.pose + 1], morph_weights=weights),
    )
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        positions = np.concatenate([part[0] for part in then.positions()]).astype(np.float64)
    inside = one.members[cells.of] & (cells.areas > 0)
    inside = inside if inside.any() else one.members[cells.of]
    members = np.flatnonzero(inside)
    middle = np.average(positions[members], axis=0)
    vertex = int(members[np.linalg.norm(positions[members] - middle, axis=1).argmin()])
    # Triangles tell the side that faces out: normals may lean. Mirroring joints turn the surface inside out.
    triangles = np.concatenate(
        [view.now.triangles + start for view, start in zip(draw.surface.views, cells.starts, strict=False)]
    )
    corners = positions[triangles[inside[triangles].any(axis=1)]]
    towards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    moved = np.zeros(len(poses.joint_names) + draw.matrices.shape[1])
    for rest, start in zip(draw.surface.rest, cells.starts, strict=False):
        own = members[(members >= start) & (members < start + len(rest.positions))] - start
        np.add.at(moved, rest.joints[own], rest.weights[own])
    joint = int(moved.argmax())
    towards *= np.sign(np.linalg.det(draw.matrices[one.pose, joint, :3, :3])) or 1.0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        outward = np.nan_to_num(towards / np.linalg.norm(towards))
        towards, is_hidden = _seen_from(positions, positions[triangles], vertex, outward)
    primitive = int(np.searchsorted(cells.starts, vertex, side="right")) - 1
    number, clip, time = _moment(draw, one.pose)
    return Spot(
        clip=clip,
        number=number,
        time=time,
        joint=_called(draw, joint),
        standard=one.figures[0],
        baked=one.figures[1],
        place=draw.surface.views[primitive].source.place,
        vertex=vertex - int(cells.starts[primitive]),
        skin=draw.skin,
        node=draw.node,
        towards=towards,
        radius=1.0 * float(np.sqrt(np.square(positions[members] - positions[vertex]).sum(axis=1).mean()))
        or 1.0,
        is_hidden=is_hidden,
    )


def _seen_from(
    positions: Float64Array, corners: Float64Array, vertex: int, outward: Float64Array
) -> tuple[tuple[float, float, float], bool]:
    """Return the direction (3,) to a camera that sees a vertex, not too steeply, and the model at its widest.

    With it: whether the vertex is hidden even so.

    positions are (V, 3), corners of triangles (T, 3, 3). Triangles of other draws are not in the way.
    """
    wide = np.ptp(positions, axis=0)
    first, second, third = (corners[:, corner] for corner in range(3))
    start = positions[vertex] + NEAR * np.linalg.norm(wide) * outward
    one, other, away = second - first, third - first, start - first
    # Möller and Trumbore 1997, where rays meet the planes of triangles: here the factors that no ray changes.
    facing, aside, turned = np.cross(other, one), np.cross(other, away), np.cross(away, one)
    height = (other * turned).sum(axis=1)
    best, score = ((0.0, 0.0, 1.0), True), -1.0
    for most, ray in sorted(_views(wide, outward), key=lambda one: -one[0]):
        if most <= score:  # no better one follows
            break
        volume = facing @ ray
        u, v, far = (aside @ ray) / volume, (turned @ ray) / volume, height / volume
        is_hidden = bool(((u > 0) & (v > 0) & (u + v < 1) & (far > 0)).any())
        found = most * (0.01 if is_hidden else 1.0)
        if found > score:
            best, score = ((float(ray[0]), float(ray[1]), float(ray[2])), is_hidden), found
    return best


def _views(wide: Float64Array, outward: Float64Array) -> Iterator[tuple[float, Float64Array]]:
    """Yield directions (3,) to cameras, each after what it is worth if nothing hides the place."""
    yaw = np.arctan2(outward[0], outward[2])
    for turn in TURNS:
        for pitch in PITCHES:
            x, y, z = np.cos(pitch) * np.sin(yaw + turn), np.sin(pitch), np.cos(pitch) * np.cos(yaw + turn)
            ray = np.array([x, y, z])
            spread = abs(z) * wide[0] + abs(x) * wide[2] + wide[1]
            yield float(spread * max(float(ray @ outward), 0.05)), ray


def _called(draw: Draw, joint: int) -> str:
    """Return the name of a joint as people read it."""
    skeleton = draw.skeleton
    name = draw.surface.document.asset.nodes[skeleton.nodes[skeleton.joints[joint]]].name
    return readable(name or "") or f"joint {joint}"


def readable(name: str) -> str:
    """Return a joint's name as people read it: of "mixamorig:LeftArm_012", "left arm"; empty if none is left.

    The names of rigs and the numbers of exporters go, the side comes first, and words are apart.
    """
    every = SEPARATORS.sub(" ", name.rpartition(":")[2]).casefold().split()
    plain = SEPARATORS.sub(" ", NUMBERED.sub("", name.rpartition(":")[2])).casefold().split()
    words = [SIDES.get(word, word) for word in plain if word not in OF_RIGS] or every
    return " ".join(sorted(words, key=lambda word: word not in {"left", "right"}))


def spots_of(draws: Iterable[Draw], *, skips_still: bool = True) -> Spots:
    """Return the ``Places`` of posed draws. Raises InputError if they cannot be measured."""
    places = Places(skips_still=skips_still)
    for draw in draws:
        places.begin(draw)
        measure(draw, lambda block: places.add(block, places.counted(block)))
        places.end()
    return places.spots()
