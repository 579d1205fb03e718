"""Corrective normals of the meshes of a surface: key times, targets, and weights that clips play.

1. Keys are set where they are needed: an interval is cut in half while the change of the normals in its
   middle is not the mean of those at its ends (``_keyed``).
2. The targets and weights of a mesh in all clips together come from ``principal``.
3. What does not help is taken out. The errors of standard and corrected lighting are measured at times that
   are no keys. A vertex that is worse with its targets gets none, a primitive likewise, and a clip that is
   worse gets the weights 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skinbake.choices import USUAL_TRUTHS
from skinbake.correctives.principal import gram, leading, normalise, refined
from skinbake.correctives.surface import CorrectedSurface
from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, IntArray
from skinbake.gltf.budget import Cost, Work
from skinbake.gltf.reading.clips import Clip
from skinbake.measure.draws import Draw
from skinbake.skinning.rest import RestPrimitive

MOST_TARGETS = 4
"""The targets that ``auto`` adds at most. glTF guarantees eight morphed attributes, two of each target."""

LEFT = 0.03
"""The share of the squared changes that ``auto`` leaves at most, if so few targets can."""

FIRST_KEYS, LEAST_KEYS = 33, 5
"""The keys that all clips share at first, and the least number of each clip's own."""

LEAST_STEP = 1.0 / 60.0
"""The seconds between keys at least, but for the first ones: a frame."""

MOST_KEYS = 192
"""The keys of all clips together, but for the first ones."""

TOLERANCE = 0.1
"""The mean change between two keys that needs no further key, relative to the mean change in the clip."""

LEAST_TOLERANCE = float(np.radians(0.1))

SAMPLES = 1 << 23
"""Vertices × keys of a fit. A mesh of more vertices has fewer keys."""

HELD_BACK, LEAST_HELD_BACK = 60, 6
"""The poses between keys in which what does not help is found: of all clips, and of each one at least."""

BETWEEN = 0.382
"""Where these poses lie, as a share of each of N equal parts of a clip: at no half of a half."""

UNSEEN = float(np.radians(0.1))
"""A vertex whose targets never turn its normal by more than this angle has none."""

WEIGHT_STEP = 2.0**-14
"""The steps of weights, of which each moves the longest vector of a target by this length."""

WORSE = 1.005
"""A clip or a primitive is given up if its mean error grows over this share by either truth."""


@dataclass(frozen=True, slots=True)
class Motion:
    """A clip as it moves what a node draws."""

    node: int
    draw: Draw
    clip: Clip

    def at(self, times: Float64Array) -> Draw:
        """Return the draw at times (P,) of the clip, in the space of the file."""
        return self.draw.at(self.clip, times, turned=False)


@dataclass(frozen=True, slots=True)
class Track:
    """The weights (N, K) of the targets at times (N,) in seconds, float32, for one clip and skin."""

    motion: Motion
    times: Float32Array
    weights: Float32Array

    @property
    def plays(self) -> bool:
        """Tell whether any weight is not 0."""
        return bool(self.weights.any())

    def at(self, times: Float64Array) -> Float64Array:
        """Return the weights (P, K) at times (P,), linear between keys."""
        columns = [np.interp(times, self.times, column) for column in self.weights.T.astype(np.float64)]
        return np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))

    def at_rest(self, count: int) -> Track:
        """Return a track of the same length with so many weights of 0."""
        ends = np.unique(self.times[[0, -1]])
        return Track(self.motion, ends, np.zeros((len(ends), count), dtype=np.float32))


@dataclass(frozen=True, slots=True)
class Correctives:
    """The correctives of one mesh.

    targets are changes of unit normals by primitive: (K, V, 3) float64, 0 where a vertex has none. K is 0 if
    nothing helps. standard are the mean errors of standard lighting in degrees by each of ``USUAL_TRUTHS``,
    weighted by area. left is the share of the squared changes that K targets leave. given_up are the vertices
    whose targets were taken out because they did not help.
    """

    targets: tuple[Float64Array, ...]
    tracks: tuple[Track, ...]
    standard: tuple[float, ...]
    left: float
    given_up: int

    @property
    def count(self) -> int:
        """The number of targets."""
        return len(self.targets[0])


def fitted(
    surface: CorrectedSurface,
    meshes: Sequence[slice],
    motions: Sequence[Motion],
    areas: FloatArray,
    wanted: int | None,
    step: float,
    *,
    accurate: bool = False,
    claim: Callable[[Work], None] = lambda work: None,
) -> list[Correctives]:
    """Return the correctives of each mesh of a surface. wanted is the number of targets, None for ``auto``.

    meshes are parts of the primitives of the surface. areas (V,) weight the vertices of all primitives.
    step is that of the components of targets as they are stored. accurate: toward the normals of α and β.
    ``claim`` is called with the work of the fit before it is done.
    """
    most = max(LEAST_KEYS, min(MOST_KEYS, SAMPLES // max(surface.count, 1)))
    samples = surface.count * max(most, LEAST_KEYS * len(motions))
    claim(Cost.FITTED_SAMPLE * (samples if surface.morphing is None else 2 * samples))
    times, parts = [], []
    for motion in motions:
        of_clip = min(max(most // len(motions), LEAST_KEYS), most)
        own, changes = _keyed(surface, motion, areas, of_clip, len(motions), accurate=accurate)
        times.append(own)
        parts.append(changes)
    shares, changes = np.concatenate([_shares(own) for own in times]), np.concatenate(parts)
    normals = None
    if surface.morphing is not None:
        played = (surface.normals(one.at(own)) for one, own in zip(motions, times, strict=True))
        normals = np.concatenate(list(played))
    starts = np.cumsum([0, *(len(one.positions) for one in surface.rest)])
    tried = []
    for mesh in meshes:
        rows = slice(int(starts[mesh.start]), int(starts[mesh.stop]))
        own_areas = np.asarray(areas[rows], dtype=np.float64)
        targets, weights, left = _fit(
            changes[:, rows], None if normals is None else normals[:, rows], own_areas, shares, wanted
        )
        used = np.asarray(own_areas > 0.0)
        normalise(targets, weights, used)
        # No weight is a fraction that two processors could round in two ways.
        weights = np.rint(weights / WEIGHT_STEP) * WEIGHT_STEP
        targets = np.rint(targets / step) * step
        turned = (np.abs(weights).max(axis=0)[:, None] * np.sqrt(np.square(targets).sum(axis=2))).sum(axis=0)
        targets[:, ~used | (turned < UNSEEN)] = 0.0
        tried.append((targets, weights, left))
    return _helpful(surface, meshes, motions, times, tried, areas, step)


def _fit(
    changes: Float32Array,
    normals: Float32Array | None,
    areas: FloatArray,
    shares: Float64Array,
    wanted: int | None,
) -> tuple[Float64Array, Float64Array, float]:
    """Return targets (K, V, 2), weights (R, K), and the share of the squared changes that they leave.

    normals (R, V, 3) are those that the changes (R, V, 2) are added to, None where all are (0, 0, 1).
    """
    root = np.sqrt(shares)
    matrix = gram(changes, areas) * (root[:, None] * root)
    whole = float(np.trace(matrix))
    most = min(MOST_TARGETS if wanted is None else wanted, len(matrix))
    if whole <= 0.0 or most == 0:
        return np.zeros((0, changes.shape[1], 2)), np.zeros((len(changes), 0)), 1.0
    values, vectors = leading(matrix, most)
    left = 1.0 - np.cumsum(values) / whole
    count = most if wanted is not None else min(int(np.count_nonzero(left > LEFT)) + 1, most)
    count = max(1, min(count, int(np.count_nonzero(values > 1e-9 * values[0]))))
    start = vectors[:, :count] / np.maximum(root, 1e-9)[:, None]
    targets, weights = refined(changes, normals, np.asarray(areas, dtype=np.float64), shares, start)
    return targets, weights, float(max(left[count - 1], 0.0))


def _keyed(
    surface: CorrectedSurface, motion: Motion, areas: FloatArray, most: int, clips: int, *, accurate: bool
) -> tuple[Float64Array, Float32Array]:
    """Return key times (N,) of a clip, and the changes (N, V, 2) there: no more than ``most``."""

    def changes_at(times: Float64Array) -> Float32Array:
        return surface.changes(motion.at(times), accurate=accurate)

    start, end = motion.clip.start, motion.clip.duration
    first = min(max(FIRST_KEYS // clips, LEAST_KEYS), most) if end > start else 1
    # Times of a file are float32, and no two keys may have one.
    times = np.unique(np.linspace(start, end, first).astype(np.float32)).astype(np.float64)
    changes = changes_at(times)
    size = float(np.sqrt(_mean_square(_sines(changes), areas).mean()))
    tolerance = max(TOLERANCE * size, LEAST_TOLERANCE)
    is_open = np.ones(len(times) - 1, dtype=np.bool_)
    while is_open.any() and len(times) < most:
        is_open &= np.diff(times) >= 2.0 * LEAST_STEP
        left = np.flatnonzero(is_open)
        if not len(left):
            break
        middles = ((times[left] + times[left + 1]) / 2.0).astype(np.float32).astype(np.float64)
        between = changes_at(middles)
        sines = _sines(changes)
        bend = np.sqrt(_mean_square(_sines(between) - (sines[left] + sines[left + 1]) / 2.0, areas))
        # The largest errors come first, if not all can have a key.
        order = np.argsort(-bend, kind="stable")[: most - len(times)]
        new = np.sort(order[bend[order] > tolerance])
        is_open[left] = False
        is_open[left[new]] = True
        is_open = np.insert(is_open, left[new] + 1, True)
        times = np.insert(times, left[new] + 1, middles[new])
        changes = np.insert(changes, left[new] + 1, between[new], axis=0)
    return times, changes


def _sines(changes: Float32Array) -> Float32Array:
    """Return changes of lengths sin θ in place of tan θ: so folds are not all that counts. NaN is 0."""
    known = np.nan_to_num(changes)
    return np.asarray(known / np.sqrt(1.0 + np.square(known).sum(axis=2, keepdims=True)), dtype=np.float32)


def _mean_square(changes: Float32Array, areas: FloatArray) -> Float64Array:
    """Return the mean square (P,) of changes (P, V, 2), by area."""
    squares = np.square(changes, dtype=np.float64).sum(axis=2)
    return np.asarray((squares * areas).sum(axis=1) / max(float(np.sum(areas)), 1e-300))


def _shares(times: Float64Array) -> Float64Array:
    """Return the share of the time that each key of a clip stands for. All clips count alike."""
    if len(times) < 2:
        return np.ones(len(times))
    gaps = np.diff(times)
    return np.asarray((np.append(gaps, 0.0) + np.append(0.0, gaps)) / (2.0 * gaps.sum()))


def _in_space(rest: Sequence[RestPrimitive], targets: Float64Array, step: float) -> list[Float64Array]:
    """Return targets (K, V, 2) along t0 and b0 as vectors (K, V, 3), in whole steps, by primitive."""
    found, start = [], 0
    for one in rest:
        part = targets[:, start : start + len(one.positions)]
        vectors = part[:, :, :1] * one.tangents + part[:, :, 1:] * one.bitangents
        found.append(np.rint(vectors / step) * step + 0.0)  # no negative zeros
        start += len(one.positions)
    return found


def held_back_times(clip: Clip, clips: int) -> Float64Array:
    """Return times of a clip that are not keys."""
    count = max(LEAST_HELD_BACK, HELD_BACK // max(clips, 1))
    return clip.start + (clip.duration - clip.start) * (np.arange(count) + BETWEEN) / count


def summed_errors(
    surface: CorrectedSurface,
    targets: Sequence[Float64Array],
    posed: Draw,
    weights: Sequence[Float64Array],
) -> tuple[Float64Array, Float64Array]:
    """Return the summed errors of standard and of corrected lighting, (U, V) each, over poses, in degrees.

    targets (K, V, 3) and weights (P, K) belong to the primitives. A pose without a truth adds 0.
    """
    standard, corrected = np.zeros((2, len(USUAL_TRUTHS), surface.count))
    for poses, block in surface.posed(posed):
        rows, part, number = block.at.rows, block.at.part, block.at.primitive
        plain = block.at_rest[:, :, None]
        moved = np.zeros((3, plain.shape[1], poses.stop - poses.start))
        for target, weight in zip(targets[number], weights[number][poses].T, strict=True):
            moved += target[rows].T[:, :, None] * weight
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # without a truth: NaN
            before, after = (block.errors(block.drawn(one)) for one in (plain, plain + moved))
        # A drawn normal that does not exist is wrong by 180°, as in verify.
        for total, errors in ((standard, before), (corrected, after)):
            worst = np.where(block.exist, np.nan_to_num(errors, nan=180.0), 0.0)
            total[:, part] += worst.sum(axis=2, dtype=np.float64)
    return standard, corrected


def _helpful(
    surface: CorrectedSurface,
    meshes: Sequence[slice],
    motions: Sequence[Motion],
    times: Sequence[Float64Array],
    tried: Sequence[tuple[Float64Array, Float64Array, float]],
    areas: FloatArray,
    step: float,
) -> list[Correctives]:
    """Return the correctives of each mesh without what does not help, measured at times that are no keys.

    tried are the targets (K, V, 2) of each mesh, the weights (R, K) at the times of all clips, and the share
    of the changes that they leave.
    """
    ends = np.cumsum([len(own) for own in times])[:-1]
    targets: list[Float64Array] = []
    tracks: list[list[Track]] = []
    for mesh, (of_mesh, weights, _) in zip(meshes, tried, strict=True):
        targets += _in_space(surface.frames[mesh], of_mesh, step)
        parts = np.split(weights.astype(np.float32), ends)
        at = [own.astype(np.float32) for own in times]
        tracks.append([Track(*one) for one in zip(motions, at, parts, strict=True)])
    standard = np.zeros((len(motions), len(USUAL_TRUTHS), surface.count))
    corrected = standard.copy()
    for number, motion in enumerate(motions):
        held_back = held_back_times(motion.clip, len(motions))
        played = [of_mesh[number].at(held_back) for of_mesh in tracks]
        weights_of = [
            weights
            for mesh, weights in zip(meshes, played, strict=True)
            for _ in range(mesh.start, mesh.stop)
        ]
        found = summed_errors(surface, targets, motion.at(held_back), weights_of)
        standard[number], corrected[number] = (one / len(held_back) for one in found)
    starts = np.cumsum([0, *(len(one.positions) for one in surface.rest)])
    result = []
    for mesh, own, (_, _, left) in zip(meshes, tracks, tried, strict=True):
        rows = slice(int(starts[mesh.start]), int(starts[mesh.stop]))
        ends_of = starts[mesh.start : mesh.stop + 1] - rows.start
        errors = standard[:, :, rows], corrected[:, :, rows]
        has_targets = np.concatenate([one.any(axis=(0, 2)) for one in targets[mesh]])
        kept, plays = _kept(*errors, areas[rows], ends_of, has_targets)
        # The mean is that of all clips, also of those that play nothing.
        area = max(float(np.sum(areas[rows])) * len(own), 1e-300)
        before = ((errors[0] * areas[rows]).sum(axis=(0, 2)) / area).tolist()
        count = len(targets[mesh.start]) if kept.any() else 0
        used = [
            replace(one, weights=one.weights[:, :count]) if playing else one.at_rest(count)
            for one, playing in zip(own, plays, strict=True)
        ]
        of_parts = tuple(
            np.where(kept[start:stop, None], one, 0.0)[:count]
            for one, start, stop in zip(targets[mesh], ends_of[:-1], ends_of[1:], strict=True)
        )
        given_up = int(np.count_nonzero(has_targets & ~kept))
        result.append(Correctives(of_parts, tuple(used), tuple(before), left, given_up))
    return result


def _kept(
    standard: Float64Array,
    corrected: Float64Array,
    areas: FloatArray,
    ends: IntArray,
    has_targets: BoolArray,
) -> tuple[BoolArray, BoolArray]:
    """Return the vertices (V,) of a mesh that keep their targets, and the clips (C,) that play them.

    standard and corrected (C, U, V) are mean errors. ends are where the primitives begin and end. Each step
    only takes something out, so the steps end.
    """
    kept, plays = has_targets.copy(), np.ones(len(standard), dtype=np.bool_)
    before = kept.sum(), plays.sum()
    while True:
        after = np.where(plays[:, None, None] & kept, corrected, standard)
        kept &= after.sum(axis=(0, 1)) < standard.sum(axis=(0, 1))
        for start, stop in pairwise(ends):
            part = slice(start, stop)
            after = np.where(plays[:, None, None] & kept, corrected, standard)
            means = [(one[:, :, part] * areas[part]).sum(axis=(0, 2)) for one in (standard, after)]
            if (means[1] > WORSE * means[0]).any():
                kept[start:stop] = False
        after = np.where(plays[:, None, None] & kept, corrected, standard)
        clips = [(one * areas).sum(axis=2) for one in (standard, after)]
        plays &= ~(clips[1] > WORSE * clips[0]).any(axis=1)
        now = kept.sum(), plays.sum()
        if now == before:
            break
        before = now
    if not kept.any() or not plays.any():
        kept[:], plays[:] = False, False
    return kept, plays
