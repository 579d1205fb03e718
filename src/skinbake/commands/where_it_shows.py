"""Where a bake shows: the visible patches, clips and moments at which it improves the lighting most.

A patch is what lies within a geodesic distance of a vertex at rest. Its improvement is the sum, over its
visible vertices, of area at rest × (error of standard lighting − error of the bake's lighting), along
tangents. A vertex is visible if it faces a camera that looks at the patch, and no triangle lies before it.
First a grid of patches is added up in sampled poses without regard to the camera, which bounds what can be
seen. Then the most promising ones are looked at, and the best are refined in place and time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from skinbake.choices import Truth
from skinbake.commands.shown import asked_clips
from skinbake.errors import ChoiceError, InputError, printable
from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray
from skinbake.gltf.budget import Work
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import Clip, random_clip, read_clips
from skinbake.measure.angles import MeasuredBlock
from skinbake.measure.draws import Draw
from skinbake.measure.scene import attachments, claim_draws, errors_of, measure
from skinbake.report.verify import NEGLIGIBLE
from skinbake.truth.areas import vertex_areas

RADIUS = 0.07
"""The geodesic radius of a patch, as a share of the diagonal of the box around the model at rest."""

EACH, MOST_POSES, MOST_SAMPLES, MOST_STEPS = 25, 250, 24_000_000, 150_000
"""The most poses of a clip that are sampled, and of all clips; the most poses × vertices, and × nodes."""

SAMPLES_FREE, SAMPLES_A_BYTE = 2_000_000, 6
"""The most sampled poses × vertices of a small file, and how many more for each of its bytes."""

LOOKS_FREE, LOOKS_A_BYTE, LOOKS_A_DRAW = 300_000, 1, 1_000
"""The most moments × vertices that are looked at, and how many more for each byte. A draw is so many more.

A moment takes 1 to 3 µs for each.
"""

PROMISING, LOOKS, GUESSES = 4, 40, 12
"""The clips that are sampled ``EACH`` times, the poses that are looked at, and the patches in each."""

REFINED = 8
"""The moments around the best sampled one that are tried, and half of the patches around the best."""

STILL = 0.005
"""A clip stands still if no vertex moves by more than this share of the model's diagonal."""

FACING, PITCHES = 0.15, (-0.35, 0.9)
"""The least cosine of a visible normal to the camera, and the camera's angles above the level, radians."""

BEFORE = 0.02
"""What lies before a vertex is nearer to the camera by more than this share of the patch's radius."""

AWAY = 4.0
"""The distance of the camera in radii of the patch."""

INSIDE_OUT = 90.0
"""Degrees from which on an error is that of a fold, which no lighting shows."""

CELLS = 1 << 22
"""The entries of a table of distances: 32 MiB at a time."""

TESTS, BLOCK = 1 << 16, 1 << 14
"""The most vertices × triangles of a look, and at a time. If there are more, some vertices are tested."""

LISTED = 5


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A visible patch at a moment of a clip at which the bake improves the lighting.

    improvement is in degrees × squared units. standard and baked are the mean errors in degrees of the
    visible vertices, weighted by area. middle (3,) and radius enclose them in the scene that ``Draw.at``
    gives; towards (3,) leads from there to the camera. members are all vertices of the patch, numbered over
    the primitives of the draw of that number.
    """

    clip: Clip
    time: float
    improvement: float
    standard: float
    baked: float
    middle: Float64Array
    radius: float
    towards: Float64Array
    draw: int
    members: IntArray


class _Surface:
    """A draw at rest: welded positions, areas (V,), triangles over all its primitives, and its patches."""

    def __init__(self, draw: Draw) -> None:
        from scipy.sparse import coo_array

        self.draw = draw
        starts = np.cumsum([0, *(len(rest.positions) for rest in draw.surface.rest)])
        parts = [view.now.triangles + start for view, start in zip(draw.surface.views, starts, strict=False)]
        self.triangles = np.concatenate(parts).astype(np.int64)
        self.starts = starts
        rest = next(_positions(draw))  # the draw is at rest
        self.areas = vertex_areas(rest, self.triangles)
        extent = np.abs(rest).max(initial=0.0)
        if not 1e-12 * extent**2 < self.areas.sum() < np.inf:  # joints that are scaled to 0 hide it at rest
            rest = np.concatenate([one.positions for one in draw.surface.rest]).astype(np.float64)
            self.areas = vertex_areas(rest, self.triangles)
        self.rest = rest
        # The edges between places, each once, with its length.
        packed = np.ascontiguousarray(rest + 0.0).view(np.dtype((np.void, 24))).ravel()
        _, first, self.places = np.unique(packed, return_index=True, return_inverse=True)
        self.first = first
        ends = np.sort(self.places[self.triangles[:, [0, 1, 1, 2, 2, 0]]].reshape(-1, 2), axis=1)
        ends = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
        lengths = np.linalg.norm(rest[first[ends[:, 0]]] - rest[first[ends[:, 1]]], axis=1)
        shape = len(first), len(first)
        self.graph = coo_array((np.maximum(lengths, 1e-300), ends.T), shape=shape).tocsr()

    def patches(self, seeds: IntArray, radius: float) -> Any:
        """Return a sparse matrix (V, K) with 1 for each vertex within a geodesic distance of each place."""
        from scipy.sparse import csr_array, hstack
        from scipy.sparse.csgraph import dijkstra

        step = max(1, CELLS // len(self.first))
        parts = []
        for start in range(0, len(seeds), step):
            chosen = seeds[start : start + step]
            reached = np.isfinite(dijkstra(self.graph, directed=False, indices=chosen, limit=radius))
            parts.append(csr_array(reached.T.astype(np.float32))[self.places])
        return hstack(parts, format="csr")

    def seeds(self, radius: float) -> IntArray:
        """Return one place in each occupied cell of a grid, half a radius wide."""
        used = np.unique(self.places[self.triangles])
        cells = np.floor(self.rest[self.first[used]] / (radius / 2))
        _, chosen = np.unique(cells, axis=0, return_index=True)
        return np.asarray(used[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    """All draws in one of some poses: positions and normals (V, 3).

    errors holds, for the draws that were looked at, errors (2, P, V) and where they count (P, V), in all of
    those poses.
    """

    time: float
    pose: int
    posed: list[Draw]
    positions: Float64Array
    normals: Float64Array
    errors: dict[int, tuple[Float64Array, BoolArray]]


class _Search:
    def __init__(self, document: Document, draws: Sequence[Draw]) -> None:
        from scipy.sparse import coo_array

        self.document = document
        with document.notices.withheld():
            self.rigid = attachments(document)
        self.surfaces = [_Surface(draw) for draw in draws]
        every = np.concatenate([one.rest[np.unique(one.triangles)] for one in self.surfaces])
        self.size = float(np.linalg.norm(every.max(axis=0) - every.min(axis=0)))
        self.radius = RADIUS * self.size
        self.truths: dict[tuple[int, int], Any] = {}
        self.patches: list[Any] = []
        # What hangs on the character may hide some of it.
        parts = [(one.triangles, one.places) for one in self.surfaces]
        parts += [(one.triangles.astype(np.int64), np.arange(len(one.rest.positions))) for one in self.rigid]
        self.starts = np.cumsum([0, *(len(places) for _, places in parts)])
        self.triangles, self.places = (
            np.concatenate([part + start for part, start in zip(one, self.starts, strict=False)])
            for one in zip(*parts, strict=True)
        )
        # The triangles around each place: copies of a vertex have one normal.
        ends, faces = self.places[self.triangles].ravel(), np.repeat(np.arange(len(self.triangles)), 3)
        shape = len(self.places), len(self.triangles)
        self.around = coo_array((np.ones(len(ends)), (ends, faces)), shape=shape).tocsr()

    def stands_still(self, clip: Clip) -> bool:
        """Tell whether no vertex moves over a clip, by some vertices and the joint that moves each most."""
        times = np.linspace(clip.start, clip.duration, EACH)
        for surface in self.surfaces:
            posed = surface.draw.at(clip, times)
            morphing = posed.morphing
            if morphing is not None and np.ptp(morphing.weights, axis=0).any():
                return False
            for rest in surface.draw.surface.rest:
                some = slice(0, None, max(1, len(rest.positions) // 200))
                joints = rest.joints[some][
                    np.arange(len(rest.positions[some])), rest.weights[some].argmax(axis=1)
                ]
                moved = np.einsum(
                    "pvij,vj->pvi",
                    posed.matrices[:, joints][..., :3, :3],
                    rest.positions[some].astype(np.float64),
                )
                moved += posed.matrices[:, joints][..., :3, 3]
                if np.abs(moved - moved[0]).max() > STILL * self.size:
                    return False
        return True

    def totals(self, clip: Clip, times: Float64Array) -> list[Float64Array]:
        """Return, by draw, the improvement (P, K) of each patch at each time, where it improves anything."""
        found = []
        for number, surface in enumerate(self.surfaces):
            posed = surface.draw.at(clip, times)
            improved = "corrected" if posed.corrections else "accurate"
            total = np.zeros((len(times), self.patches[number].shape[1]))
            before: list[MeasuredBlock] = []

            def record(
                block: MeasuredBlock,
                surface: _Surface = surface,
                improved: str = improved,
                total: Float64Array = total,
                number: int = number,
                before: list[MeasuredBlock] = before,
            ) -> None:
                if block.lighting == "standard":
                    before[:] = [block]
                elif block.lighting == improved:
                    first = surface.starts[block.primitive] + block.vertex
                    rows = slice(first, first + block.errors.shape[1])
                    gains = _gains(before[0].errors, block.errors, block.valid) * surface.areas[rows]
                    poses = slice(block.pose, block.pose + len(gains))
                    total[poses] += np.maximum(gains, 0.0) @ self.patches[number][rows]

            measure(posed, record, self._truths(number, posed))
            found.append(total)
        return found

    def _truths(self, number: int, posed: Draw) -> Any:
        key = number, len(posed.matrices)
        if posed.morphing is not None:
            return posed.truths((Truth.TANGENTS,))
        if key not in self.truths:
            self.truths[key] = posed.truths((Truth.TANGENTS,))
        return self.truths[key]

    def moments(self, clip: Clip, times: Float64Array) -> Iterator[_Moment]:
        """Yield all draws, posed at each time. Errors are measured when a draw is looked at."""
        errors = dict[int, tuple[Float64Array, BoolArray]]()
        posed = [surface.draw.at(clip, times) for surface in self.surfaces]
        held = [one.at(self.document, clip, times) for one in self.rigid]
        moving = list(map(_positions, posed))
        for pose, time in enumerate(times):
            parts = [next(positions) for positions in moving]
            parts += [one.positions(pose) for one in held]
            every = np.concatenate(parts)
            first, second, third = (every[self.triangles[:, corner]] for corner in range(3))
            normals = (self.around @ np.cross(second - first, third - first))[self.places]
            normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
            yield _Moment(float(time), pose, posed, every, normals, errors)

    def errors(self, moment: _Moment, draw: int) -> tuple[Float64Array, BoolArray]:
        """Return the errors (2, V) of a draw, standard and with the bake, and where they count (V,)."""
        if draw not in moment.errors:
            posed = moment.posed[draw]
            improved = "corrected" if posed.corrections else "accurate"
            known = errors_of(posed, self._truths(draw, posed))
            found = np.array(
                [np.concatenate([one[name][0] for one in known], axis=1) for name in ("standard", improved)],
                np.float64,
            )
            sound = np.concatenate([one["standard"][1] > 0 for one in known], axis=1)
            moment.errors[draw] = found, sound & (found < INSIDE_OUT).all(axis=0)
        errors, counts = moment.errors[draw]
        return errors[:, moment.pose], counts[moment.pose]

    def seen(
        self, clip: Clip, moment: _Moment, draw: int, members: IntArray, least: float = 0.0
    ) -> Spot | None:
        """Look at a patch. None if nothing visible improves, or if it cannot improve by more than least."""
        surface = self.surfaces[draw]
        errors, counts = self.errors(moment, draw)
        counted = members[counts[members]]
        standard, baked = errors[:, counted]
        areas, at = surface.areas[counted], counted + self.starts[draw]
        gains = areas * (standard - baked)
        pulls = np.maximum(gains, 0.0)
        if not pulls.sum() > least:
            return None
        points, normals = moment.positions[at], moment.normals[at]
        middle = pulls @ points / pulls.sum()
        mean = pulls @ normals
        level = np.hypot(mean[0], mean[2])
        pitch, yaw = np.clip(np.arctan2(mean[1], level), *PITCHES), np.arctan2(mean[0], mean[2])
        towards = np.array([np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)])
        eye = middle + AWAY * self.radius * towards
        away = eye - points
        away /= np.linalg.norm(away, axis=1)[:, None]
        visible = np.flatnonzero((away * normals).sum(axis=1) > FACING)
        visible = visible[~self._hidden(moment, eye, towards, at[visible])]
        total = areas[visible].sum()
        improvement = float(gains[visible].sum())
        if not total > 0 or not improvement > 0:
            return None
        low, high = points[visible].min(axis=0), points[visible].max(axis=0)
        return Spot(
            clip,
            moment.time,
            improvement,
            float(areas[visible] @ standard[visible] / total),
            float(areas[visible] @ baked[visible] / total),
            (low + high) / 2,
            float(np.linalg.norm(high - low) / 2) or self.radius,
            towards,
            draw,
            members,
        )

    def _hidden(self, moment: _Moment, eye: Float64Array, towards: Float64Array, at: IntArray) -> BoolArray:
        """Return, for some vertices, whether a triangle lies between them and the eye."""
        if not len(at):
            return np.zeros(0, np.bool_)
        x = np.array([towards[2], 0.0, -towards[0]])
        x /= np.linalg.norm(x)
        axes = np.stack([x, np.cross(towards, x), -towards])
        flat_x, flat_y, depth = axes @ (moment.positions - eye).T
        behind = ~(depth > 0)
        inverse = 1.0 / np.where(behind, np.nan, depth)
        flat_x, flat_y = flat_x * inverse, flat_y * inverse
        # Only triangles in the part of the picture that the vertices cover, and before the farthest of them.
        sides = [side for flat in (flat_x, flat_y) for side in (flat < flat[at].min(), flat > flat[at].max())]
        outside = np.packbits([behind, *sides, depth >= depth[at].max()], axis=0)[0]
        first, second, third = (outside[self.triangles[:, corner]] for corner in range(3))
        triangles = self.triangles[((first & second & third) == 0) & (first | second | third < 1 << 7)]
        every = len(at) * len(triangles) // TESTS + 1
        tested = at[::every]
        px, py = flat_x[tested, None], flat_y[tested, None]
        least = 1.0 / (depth[tested, None] - BEFORE * self.radius)
        hidden = np.zeros(len(tested), np.bool_)
        step = max(1, BLOCK // max(len(tested), 1))
        for start in range(0, len(triangles), step):
            some = triangles[start : start + step].T
            (ax, bx, cx), (ay, by, cy), near = flat_x[some], flat_y[some], inverse[some]
            doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            second = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / doubled
            third = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / doubled
            first = 1.0 - second - third
            inside = (first > 0) & (second > 0) & (third > 0)
            before = first * near[0] + second * near[1] + third * near[2]  # 1/depth is linear in a picture
            hidden |= (inside & (before > least)).any(axis=1)
        return np.repeat(hidden, every)[: len(at)]


def _gains(standard: Any, improved: Any, valid: BoolArray) -> Float64Array:
    sound = valid & (standard < INSIDE_OUT) & (improved < INSIDE_OUT)
    return np.where(sound, standard.astype(np.float64) - improved, 0.0)


def telling_pose(
    document: Document,
    draws: Sequence[Draw],
    asked: str | None,
    time: float | None,
    *,
    is_close: bool = False,
) -> tuple[Clip, float, Spot | None]:
    """Return a clip by its name or number, a time in it in seconds, and for a close-up the best place then.

    Where they are not asked for, the bake shows most there. If it shows nowhere, they are the middle of the
    first clip. Raises ChoiceError for a clip that does not exist, and for a time outside it. Raises
    InputError if a close-up has no place, or if the work is too much.
    """
    clips, spots = asked_clips(document, asked) or [random_clip(document)], list[Spot]()
    if time is None or len(clips) > 1:
        spots = where_it_shows(document, draws, None if asked is None else clips)
    clip = spots[0].clip if spots else clips[0]
    if time is None:
        time = spots[0].time if spots else (clip.start + clip.duration) / 2
    elif not clip.start <= time <= clip.duration:
        reason = f': clip "{printable(clip.name)}" goes from {clip.start:g} to {clip.duration:g} s'
        raise ChoiceError("time", time, reason=(reason,))
    elif is_close:
        spots = where_it_shows(document, draws, [clip._replace(start=time, duration=time)])
    if is_close and not spots:
        raise InputError("no clip has a place where the bake shows: leave out --closeup", document.place)
    return clip, time, spots[0] if is_close else None


def where_it_shows(
    document: Document, draws: Sequence[Draw], asked: Sequence[Clip] | None = None
) -> list[Spot]:
    """Return what a bake improves most, the best first: at most ``LISTED`` patches that do not overlap.

    If no clips are asked for, they are all that do not stand still, or random poses if all do. What has
    nothing to correct is left out. Raises InputError if the work is too much.
    """
    vertices = sum(len(rest.positions) for draw in draws for rest in draw.surface.rest)
    nodes = sum(len(draw.skeleton.nodes) + len(draw.skeleton.joints) for draw in draws)
    clips = read_clips(document) if asked is None else asked
    backed = document.budget.backed
    samples = min(MOST_SAMPLES, SAMPLES_FREE + SAMPLES_A_BYTE * backed)
    affordable = min(MOST_POSES, samples // max(vertices, 1), MOST_STEPS // nodes)
    # The rest of the work that the file may ask for is not all for this.
    affordable = min(affordable, document.budget.steps_left // (4 * nodes) - EACH)
    poses = int(max(PROMISING * 2, affordable))
    some = clips[: poses // 2]
    claim_draws(document, draws, some, EACH)
    document.budget.claim(
        Work(steps=2 * nodes * poses), "looking for what a bake improves most", document.place
    )
    search = _Search(document, draws)
    if not search.size > 0 or not np.isfinite(search.size):
        return []
    moving = list(some)
    if asked is None:
        moving = [clip for clip in some if not search.stands_still(clip)] or [random_clip(document)]
    search.patches = [one.patches(one.seeds(search.radius), search.radius) for one in search.surfaces]
    # Sample all clips, then the promising ones more often.
    each = int(np.clip(poses // len(moving), 2, EACH))
    sampled = {number: _sampled(search, clip, each) for number, clip in enumerate(moving)}
    if each < EACH:
        best = sorted(sampled, key=lambda number: -max(total.max(initial=0) for total in sampled[number][1]))
        more = int(np.clip(poses // PROMISING, 2, EACH))
        sampled |= {number: _sampled(search, moving[number], more) for number in best[:PROMISING]}
    # Half of the moments that can be afforded are looked at, and the best spots refined with the rest.
    moments = (LOOKS_FREE + LOOKS_A_BYTE * backed) // (vertices + LOOKS_A_DRAW * len(draws))
    looks = min(LOOKS, max(1, moments // 2))
    spots = _looked_at(search, moving, sampled, looks)
    for number, spot in enumerate(spots[: max(0, moments - looks) // (REFINED + 1)]):
        [of_clip] = (one for one, clip in enumerate(moving) if clip is spot.clip)
        spots[number] = _refined(search, spot, sampled[of_clip][0])
    told = (spot for spot in spots if spot.standard >= NEGLIGIBLE)
    return sorted(told, key=lambda spot: -spot.improvement)


def _sampled(search: _Search, clip: Clip, count: int) -> tuple[Float64Array, list[Float64Array]]:
    times = np.linspace(clip.start, clip.duration, count if clip.duration > clip.start else 1)
    return times, search.totals(clip, times)


def _looked_at(search: _Search, clips: Sequence[Clip], sampled: dict[int, Any], looks: int) -> list[Spot]:
    """Look at the patches that may show most, in so many poses, and return the best that do not overlap."""
    moments = [(clip, time) for clip in sampled for time in sampled[clip][0]]
    bounds = [
        np.concatenate([sampled[clip][1][draw] for clip in sampled]) for draw in range(len(search.surfaces))
    ]
    draw_of = np.repeat(np.arange(len(bounds)), [one.shape[1] for one in bounds])
    patch_of = np.concatenate([np.arange(one.shape[1]) for one in bounds])
    hoped = np.concatenate(bounds, axis=1)
    clip_of = np.array([clip for clip, _ in moments])
    columns = [patches.tocsc() for patches in search.patches]
    found: dict[int, Spot] = {}
    for _ in range(min(looks, len(moments))):
        pose, patch = np.unravel_index(int(np.argmax(hoped)), hoped.shape)
        least = sorted((spot.improvement for spot in _apart(search, found.values())), reverse=True)
        if not hoped[pose, patch] > (least[-1] if len(least) == LISTED else 0.0):
            break
        clip, time = clips[moments[pose][0]], float(moments[pose][1])
        moment = next(search.moments(clip, np.array([time])))
        for number in np.argsort(-hoped[pose])[:GUESSES]:
            if not hoped[pose, number] > 0.5 * hoped[pose, patch]:
                break
            draw, column = int(draw_of[number]), int(patch_of[number])
            starts = columns[draw].indptr
            members = columns[draw].indices[starts[column] : starts[column + 1]]
            spot = search.seen(clip, moment, draw, members)
            share = 0.0 if spot is None else spot.improvement / hoped[pose, number]
            # Much the same of it will be seen in other poses of the clip.
            hoped[clip_of == moments[pose][0], number] *= min(1.0, 1.1 * share + 0.02)
            if spot is not None and (number not in found or spot.improvement > found[number].improvement):
                found[int(number)] = spot
        hoped[pose] = 0.0
    return _apart(search, found.values())


def _apart(search: _Search, spots: Any) -> list[Spot]:
    """Return the best spots, each farther than two radii from the better ones."""
    kept: list[Spot] = []
    for spot in sorted(spots, key=lambda one: -one.improvement):
        middle = search.surfaces[spot.draw].rest[spot.members].mean(axis=0)
        others = (search.surfaces[one.draw].rest[one.members].mean(axis=0) for one in kept)
        if all(np.linalg.norm(middle - other) > 2 * search.radius for other in others):
            kept.append(spot)
        if len(kept) == LISTED:
            break
    return kept


def _refined(search: _Search, spot: Spot, times: Float64Array) -> Spot:
    """Return the best spot at moments between the sampled ones, then of patches around its own."""
    step = times[1] - times[0] if len(times) > 1 else 0.0
    times = np.clip(spot.time + step * np.linspace(-0.6, 0.6, REFINED), spot.clip.start, spot.clip.duration)
    best = spot
    for moment in search.moments(spot.clip, times) if step else ():
        found = search.seen(spot.clip, moment, spot.draw, spot.members, best.improvement)
        best = found if found is not None and found.improvement > best.improvement else best
    surface = search.surfaces[spot.draw]
    near = np.unique(surface.places[spot.members])
    middle = surface.rest[spot.members].mean(axis=0)
    far = np.linalg.norm(surface.rest[surface.first[near]] - middle, axis=1)
    near = near[far < search.radius / 2]
    near = near[:: max(1, len(near) // (2 * REFINED))]
    if len(near):
        moment = next(search.moments(best.clip, np.array([best.time])))
        patches = surface.patches(near, search.radius).tocsc()
        for number in range(patches.shape[1]):
            members = patches.indices[patches.indptr[number] : patches.indptr[number + 1]]
            found = search.seen(best.clip, moment, spot.draw, members, best.improvement)
            best = found if found is not None and found.improvement > best.improvement else best
    return best


def in_degrees(value: float) -> str:
    """Return an angle as it reads at a glance: "41°", "3.2°"."""
    return f"{value:.{0 if value >= 10 else 1}f}°"


def in_words(spot: Spot) -> str:
    """Return the mean errors of a spot: "41° → 3.2°"."""
    return f"{in_degrees(spot.standard)} → {in_degrees(spot.baked)}"


def followed(spot: Spot, draw: Draw) -> Iterator[Float64Array]:
    """Yield the mean (3,) of a spot's patch in each pose of its draw."""
    return (positions[spot.members].mean(axis=0) for positions in _positions(draw))


def _positions(draw: Draw) -> Iterator[Float64Array]:
    """Yield the positions (V, 3) of all primitives of a draw, in each pose."""
    primitives = draw.positions()
    if draw.morphing is None:
        yield from map(np.concatenate, zip(*primitives, strict=True))
        return
    for _ in draw.matrices:  # with morph targets, each pose gives its own arrays
        yield np.concatenate([part[0] for part in islice(primitives, len(draw.surface.rest))])
