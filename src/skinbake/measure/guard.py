"""Whether fitted α and β light a primitive no worse than standard lighting, judged on a sample of it.

The fit knows turns of the joints. A mesh of few triangles, or joints that stretch, may make it worse than no
correction at all, or than the gradients of the surface. Both truths of ``verify`` tell, in the file's own
clips, or in random poses if it has none. A primitive that is worse keeps only a part of its fit, and each of
its vertices as many eighths of α and β as light it best.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from skinbake.choices import USUAL_TRUTHS, PoseKind
from skinbake.errors import InputError, Notice
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray
from skinbake.gltf.budget import Cost, shown
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.reading.clips import animations_of, read_clips
from skinbake.gltf.reading.scenes import meshes_of_one_skin
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.gradients.baker import BakeSettings, bake_primitives
from skinbake.gradients.kept import EIGHTHS
from skinbake.measure.unwritten import UnwrittenBake, cut_out, joined
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.components import cross
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.threads import Threads
from skinbake.truth import kernel
from skinbake.truth.areas import RestAreas
from skinbake.truth.blending import BlendedPrimitive, sides_of
from skinbake.truth.operator import GradientOperator, true_operator
from skinbake.truth.poses import FALLBACK_POSES, LEAST_SAMPLES, PoseRequest, pose_set
from skinbake.truth.truths import Truths
from skinbake.wording import counted

LEAST_POSES = 12
"""The poses in which a surface is looked at, at least. Many clips and skins share them."""


class _Look(NamedTuple):
    """How closely to look at a surface, and how much error a primitive may have there to keep all it has.

    vertices are those of the surface to look at, among those whose light α and β change. poses are the most
    of them. of_standard is the share of the error of
    standard lighting that may be left, and of_surface that of the surface's gradients where joints stretch.
    """

    vertices: int
    poses: int
    of_standard: float
    of_surface: float


GLANCE = _Look(128, LEAST_POSES, 0.75, 0.85)
"""It tells that most primitives are sound. A sample of so few vertices may tell a gain much too large."""

CLOSE = _Look(2048, 96, 0.98, 1.02)
"""It decides. Of a gain that is told too large by 2 %, at most 1 % is lost against standard lighting."""

WHOLE = _Look(1 << 14, 96, 0.98, 1.02)
"""It chooses for each vertex of the primitives that keep a part. Vertices of larger ones keep the same."""

LEAST_VERTICES, FEWEST_VERTICES = 128, 32
"""The vertices of each primitive, at least: the second number if they are very many."""

SAMPLES = 1 << 16
"""The vertices × poses of a look, with the vertices around those that are looked at."""

BYTES_A_PLACE, BYTES_A_SAMPLE = 24, 320
"""The memory of a vertex in a pose, and of one that is looked at."""

MOST_BYTES = 1 << 28
"""The memory of a look. Only vertices at which thousands of triangles meet take more."""

GOLDEN = 0.6180339887498949
"""The golden section. Its multiples, without their whole parts, lie evenly between 0 and 1."""

UNSEEN, FEW = 0.1, 0.01
"""An error in degrees that nobody sees, and the share of the area that may have a larger one.

A smaller angle changes a light's cosine by less than half a step of 8 bits.
"""

STRETCHED = 0.01
"""The share by which joints must move or scale against those that carry them, not to count as rigid."""

TINY = 1e-9
"""Degrees. An error below it is rounding."""

TIE = 1e-6
"""The share of an error up to which two are the same. Rounding must not choose between them."""

STEPS = np.arange(EIGHTHS, -1, -1)
"""The eighths of a fit, of α and β, and of one truth's importance that are tried, the largest first."""


class KeptShare(NamedTuple):
    """How much of its fit a primitive keeps, 0 to 1, how many eighths of α and β each vertex (V,), and lit.

    lit are the vertices whose α or β is not 0.
    """

    fit: float
    eighths: IntArray
    lit: IntArray

    @property
    def mean(self) -> float:
        """The share of α and β that is kept, on average."""
        return float(self.eighths[self.lit].mean() / EIGHTHS)


class Judged(NamedTuple):
    """The bakes of one surface, and the rig to which α and β are fitted, None if they are not."""

    bakes: Sequence[UnwrittenBake]
    rig: Rig | None


def judged_shares(
    document: Document, surfaces: Sequence[Judged], settings: BakeSettings
) -> list[list[KeptShare | None]]:
    """Return for each surface how much each primitive should keep, None for all.

    surfaces are all of the document. Meshes are judged without their morph targets. Those that cannot be
    posed keep everything, and a notice tells.
    """
    shares: list[list[KeptShare | None]] = [[None] * len(surface.bakes) for surface in surfaces]
    # The numbers of the surfaces that the truths take as one, as ``whole_surfaces`` does.
    meshes = [surface.bakes[0].source.mesh for surface in surfaces]
    morphed = [any(bake.source.has_targets for bake in surface.bakes) for surface in surfaces]
    plain = [mesh for mesh, morphs in zip(meshes, morphed, strict=True) if not morphs]
    groups = meshes_of_one_skin(document, plain) if len(plain) > 1 else [plain] if plain else []
    alone = [[number] for number, morphs in enumerate(morphed) if morphs]
    for group in [[meshes.index(mesh) for mesh in group] for group in groups] + alone:
        if not any(surfaces[number].rig for number in group):
            continue
        try:
            count = sum(len(surfaces[number].bakes) for number in group)
            what = f"judging the lighting of {counted(count, 'primitive')}"
            document.budget.claim(Cost.JUDGED_PRIMITIVE * count, what, document.place)
            with document.budget.passing():
                found = _Whole(document, [surfaces[number] for number in group], settings).shares()
        except InputError as error:
            message = f"its lighting was not compared with standard lighting: {error.message}"
            place = surfaces[group[0]].bakes[0].source.place._replace(primitive=None)
            document.notices.tell(Notice("not-judged", message, place))
            continue
        for number in group:
            shares[number] = [found.pop(0) for _ in shares[number]]
    return shares


class _Whole:
    """The surfaces of a document that the truths take as one."""

    def __init__(self, document: Document, surfaces: Sequence[Judged], settings: BakeSettings) -> None:
        self._document, self._settings = document, settings
        self._bakes = [bake for surface in surfaces for bake in surface.bakes]
        self._rigs = [surface.rig for surface in surfaces for _ in surface.bakes]
        # Bake gathers the primitives of each surface by itself.
        self._surface_of = [number for number, surface in enumerate(surfaces) for _ in surface.bakes]

    def shares(self) -> list[KeptShare | None]:
        """Return how much each primitive should keep, None for all."""
        shares: list[KeptShare | None] = [None] * len(self._bakes)
        lit = [
            _lit(bake) if rig else np.empty(0, dtype=np.int64)
            for bake, rig in zip(self._bakes, self._rigs, strict=True)
        ]
        for look in (GLANCE, CLOSE):
            if not any(map(len, lit)):
                return shares
            rows = _evenly_spread(lit, look.vertices)
            found = self._seen(rows, look)
            lit = [own if large else own[:0] for own, large in zip(lit, found.are_large(look), strict=True)]
        if sum(map(len, rows)) < sum(map(len, lit)) <= WHOLE.vertices:
            rows = lit
            found = self._seen(rows, WHOLE)
        for number in np.flatnonzero([len(own) for own in lit]).tolist():
            classes, own = self._bakes[number].baked.classes, rows[number]
            points = classes[own] if len(own) == len(lit[number]) else np.zeros(len(own), dtype=np.int64)
            fit, kept = found.best(number, points)
            eighths = np.full(len(classes), EIGHTHS)
            eighths[lit[number]] = kept if len(own) == len(lit[number]) else kept[0]
            if fit < 1.0 or (eighths < EIGHTHS).any():
                shares[number] = KeptShare(fit, eighths, lit[number])
        return shares

    def _seen(self, rows: Sequence[IntArray], look: _Look) -> _Errors:
        """Return the errors of some vertices of each primitive, in the poses of a look."""
        document, place = self._document, self._bakes[0].source.place
        numbers, parts, rows = cut_out(self._bakes, rows)
        primitive, rest = joined(parts)
        counts = np.zeros(len(self._bakes), dtype=np.int64)
        counts[numbers] = [len(own) for own in rows]
        starts = np.cumsum([0, *(len(part.primitive.positions) for part in parts)])[:-1]
        looked_at = np.concatenate([start + own for start, own in zip(starts, rows, strict=True)])
        poses = _poses(document, place.mesh or 0, len(primitive.positions), look)
        most = max(len(matrices) for _, matrices in poses)
        size = most * (
            BYTES_A_PLACE * len(primitive.positions) + BYTES_A_SAMPLE * len(looked_at) * len(poses)
        )
        if size > MOST_BYTES:
            raise InputError(
                f"so many triangles meet at its vertices that it would take {shown(size)}", place
            )
        rig = next(rig for rig in self._rigs if rig)
        plain = None
        with np.errstate(over="ignore", invalid="ignore"):  # positions near the largest float32
            stretches = any(_stretch(rig, matrices, primitive.positions) for _, matrices in poses)
        if stretches:
            _, plain = joined(list(self._plain(numbers, parts)))
        operator = true_operator([primitive])
        lights = []
        for skin, matrices in poses:
            areas = RestAreas(document, skin).of(primitive)[looked_at]
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no normal gets NaN
                true = _true_normals(operator, rest, matrices, looked_at)
                surface = plain and plain.rows(looked_at)
                lights.append(_Light.of(rest.rows(looked_at), surface, matrices, areas, true))
        return _Errors(lights, counts)

    def _plain(self, numbers: Sequence[int], parts: Sequence[UnwrittenBake]) -> Iterator[UnwrittenBake]:
        """Yield parts of some primitives with the gradients of their surfaces."""
        for _, own in groupby(zip(numbers, parts, strict=True), key=lambda pair: self._surface_of[pair[0]]):
            of_surface = [part for _, part in own]
            found = bake_primitives([part.primitive for part in of_surface], self._settings)
            for part, (made, _) in zip(of_surface, found, strict=True):
                yield part._replace(baked=made)


def _lit(bake: UnwrittenBake) -> IntArray:
    """Return the vertices whose light α and β change."""
    by_slot = (bake.baked.alpha != 0.0) | (bake.baked.beta != 0.0)
    lit = np.zeros(len(by_slot), dtype=np.bool_)
    for column in by_slot.T:  # a fifth of the time that whole rows take
        lit |= column
    return np.flatnonzero(lit)


def _evenly_spread(lit: Sequence[IntArray], count: int) -> list[IntArray]:
    """Return about so many of the vertices of a surface's primitives, evenly spread over them."""
    every, found = max(1, sum(map(len, lit))), []
    least = max(FEWEST_VERTICES, min(LEAST_VERTICES, 2 * CLOSE.vertices // len(lit)))
    for rows in lit:
        own = max(least, count * len(rows) // every)
        places = np.arange(1, own + 1) * GOLDEN % 1.0 * len(rows)
        # np.unique would import masked arrays: as long as all the rest takes
        found.append(rows if len(rows) <= own else rows[sorted({*places.astype(np.int64).tolist()})])
    return found


def _poses(document: Document, mesh: int, vertices: int, look: _Look) -> list[tuple[int, Float64Array]]:
    """Return skins that draw a mesh, each with sets of joint matrices (P, J, 4, 4) in which to judge it.

    Skins with other joints share the poses, and so do the clips that move a skin. Where no clip does, each
    joint turns at random by up to 30°, as ``verify`` does, and in further sets if the mesh is small. vertices
    are those of the look. Raises InputError as ``pose_set``, or if a clip is broken.
    """
    count = min(max(SAMPLES // vertices, LEAST_POSES), look.poses)
    skins = list({id(read_skeleton(document, skin)): skin for skin in document.asset.skins_of(mesh)}.values())
    skins = skins[: count // LEAST_POSES]
    return [entry for skin in skins for entry in _poses_of_skin(document, skin, count // len(skins))]


@once_a_document
def _poses_of_skin(document: Document, skin: int, each: int) -> list[tuple[int, Float64Array]]:
    """Return sets of about ``each`` joint matrices (P, J, 4, 4) of a skin, each with its number."""
    numbers = animations_of(document, set(read_skeleton(document, skin).nodes))
    some = min(len(numbers), each)
    clips = read_clips(document, [numbers[place * len(numbers) // some] for place in range(some)])
    samples = max(1, each // max(1, len(clips)))
    # The moments of verify, if there are as many as it takes at least.
    requests = [PoseRequest(samples=samples, offset=None if samples >= LEAST_SAMPLES else 0.5)]
    if not clips:
        seeds = range(max(1, each // FALLBACK_POSES))
        requests = [PoseRequest(PoseKind.RANDOM, min(each, FALLBACK_POSES), seed=seed) for seed in seeds]
    return [(skin, pose_set(document, skin, clips, request).joint_matrices) for request in requests]


class _Light(NamedTuple):
    """The light of B vertices of a primitive in P poses of a skin.

    standard (3, B, P) is the standard normal. still, by_fit, by_surface (2, 3, B, P) are t' and b' without α
    and β, and what these add: those of the fit, and those of the surface, None if they were not made.
    expected (2, 3, B, P) is the true normal by each truth, and weights (2, B, P) is the area of the vertex,
    0 where there is none. sides (B, P) is −1 where joints mirror.
    """

    standard: Float64Array
    still: Float64Array
    by_fit: Float64Array
    by_surface: Float64Array | None
    expected: Float64Array
    weights: Float64Array
    sides: Float64Array

    @classmethod
    def of(
        cls,
        rest: RestPrimitive,
        plain: RestPrimitive | None,
        matrices: Float64Array,
        areas: Float64Array,
        true: tuple[Float64Array, BoolArray, Float64Array],
    ) -> _Light:
        """Light vertices with areas (B,) by the joint matrices (P, J, 4, 4).

        plain are the same vertices with the gradients of the surface. true is the result of
        ``_true_normals`` for them.
        """
        poses, rows, (expected, exist, sides) = slice(0, len(matrices)), slice(0, len(areas)), true
        posed = BlendedPrimitive(rest, matrices, Options())
        [standard] = posed.normals((Algorithm.LBS_STANDARD,), poses, rows)
        still, by_fit = posed.tangents(poses, rows)
        by_surface = None
        if plain is not None:
            by_surface = BlendedPrimitive(plain, matrices, Options()).tangents(poses, rows)[1]
        return cls(
            np.stack([axis.T for axis in standard]),
            still,
            by_fit,
            by_surface,
            np.ascontiguousarray(expected),
            areas[:, None] * exist,
            sides,
        )

    def rows(self, part: slice) -> _Light:
        """Return the light of some of the vertices."""
        by_surface = None if self.by_surface is None else self.by_surface[:, :, part]
        return self._replace(
            standard=self.standard[:, part],
            still=self.still[:, :, part],
            by_fit=self.by_fit[:, :, part],
            by_surface=by_surface,
            expected=np.ascontiguousarray(self.expected[:, :, part]),
            weights=self.weights[:, part],
            sides=self.sides[part],
        )

    def errors(self, fit: float | None, share: float = 1.0) -> Float64Array:
        """Return the angles to both truths (2, B, P), in degrees, of parts of the fit and of α and β.

        With None, return those of standard lighting.
        """
        normal = self.standard
        if fit is not None:
            added = self.by_fit
            if self.by_surface is not None and fit < 1.0:
                added = self.by_surface + fit * (added - self.by_surface)
            t, b = self.still + share * added
            normal = self.sides * np.stack(cross(tuple(t), tuple(b)))
        found = kernel.angles(tuple(axis.T for axis in normal), self.expected)
        return np.where(np.isnan(found), 180.0, found)  # a normal without direction


def _true_normals(
    operator: GradientOperator, rest: RestPrimitive, matrices: Float64Array, rows: IntArray
) -> tuple[Float64Array, BoolArray, Float64Array]:
    """Return the normals (2, 3, B, P) of some vertices by both truths, where they exist, and the sides.

    rows (B,) ascend. The sides (B, P) are −1 where joints mirror.
    """
    vertices, poses, count = len(operator.positions), len(matrices), len(rows)
    deformed = BlendedPrimitive(rest, matrices, Options()).positions(slice(0, poses), slice(0, vertices))
    truths, sides = Truths.of(operator, [rest], poses, USUAL_TRUTHS), sides_of([rest], matrices)
    sums = truths.sums(deformed, Threads(1))
    expected, exist = np.empty((2, 3, count, poses)), np.empty((2, count, poses), dtype=np.bool_)
    for block in truths.vertex_blocks:
        first, last = np.searchsorted(rows, (block.part.start, block.part.stop))
        own, side = rows[first:last] - block.part.start, None if sides is None else sides[:, block.part]
        normals, exists = truths.normals(block.number, deformed, sums, side)
        expected[:, :, first:last], exist[:, first:last] = normals[:, :, own], exists[:, own]
    return expected, exist, np.ones((count, poses)) if sides is None else sides[:, rows].T


def _stretch(rig: Rig, matrices: Float64Array, positions: FloatArray) -> bool:
    """Tell whether a joint moves against the joint that carries it, or scales a direction or all of them.

    matrices are (P, J, 4, 4), positions (V, 3). The fit knows turns only.
    """
    count = min(len(rig.parents), matrices.shape[1])
    held = np.flatnonzero((rig.parents[:count] != NO_PARENT) & np.isfinite(rig.pivots[:count]).all(axis=1))
    held = held[rig.parents[held] < count]
    own, above = matrices[:, held], matrices[:, rig.parents[held]]
    pivots = np.append(rig.pivots[held], np.ones((len(held), 1)), axis=1)
    against = np.einsum("pjik,jk->pji", (own - above)[..., :3, :], pivots)
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    lengths = np.linalg.norm(above[..., :3, :3], axis=(2, 3))
    moves = np.linalg.norm(against, axis=2) > STRETCHED * extent * lengths
    # A turn keeps all products of the columns. They are those of the identity, but for one factor.
    squares = np.einsum("pjki,pjkl->pjil", own[..., :3, :3], own[..., :3, :3])
    scales = np.abs(squares - (lengths**2 / 3.0)[..., None, None] * np.eye(3)).max(axis=(2, 3))
    return bool((moves | (scales > 2.0 * STRETCHED * lengths**2 / 3.0)).any())


class _Errors:
    """The mean errors of N primitives over their vertices: in each of S sets of poses, by both truths."""

    def __init__(self, lights: Sequence[_Light], counts: IntArray) -> None:
        """Take the lights of all primitives' vertices, one after the other, and the number of each."""
        self._lights, self._counts = lights, counts
        self._owners = np.repeat(np.arange(len(counts)), counts)

    def of(self, fit: float | None) -> Float64Array:
        """Return the mean errors (N, 2 S) of a part of the fit, None for standard lighting, in degrees."""
        return self._means([light.errors(fit) for light in self._lights])

    def _means(self, values: Sequence[FloatArray]) -> Float64Array:
        """Return the means (N, 2 S) of values (2, B, P) in each set, 0 where nothing has an area."""
        found = []
        for light, own in zip(self._lights, values, strict=True):
            for row, areas in zip((light.weights * own).sum(2), light.weights.sum(2), strict=True):
                total, area = (np.bincount(self._owners, each, len(self._counts)) for each in (row, areas))
                found.append(np.divide(total, area, out=np.zeros(len(area)), where=area > 0.0))
        return np.array(found).T

    def are_large(self, look: _Look) -> BoolArray:
        """Tell which primitives (N,) may not keep all they have. One may if nobody sees its errors."""
        errors = [light.errors(1.0) for light in self._lights]
        whole, seen = self._means(errors), self._means([1.0 * (own >= UNSEEN) for own in errors]) >= FEW
        within = whole <= look.of_standard * self.of(None)
        if self._lights[0].by_surface is not None:
            within &= whole <= look.of_surface * self.of(0.0)
        return np.asarray(seen.any(axis=1) & ~within.all(axis=1))

    def best(self, number: int, points: IntArray) -> tuple[float, IntArray]:
        """Return the part of its fit that a primitive should keep, and the eighths (B,) of α and β.

        points (B,) numbers the points of the surface: all vertices of one keep as much. Less of the fit is
        kept only where joints stretch, and less of α and β only if they are still worse than standard
        lighting then.
        """
        first = int(self._counts[:number].sum())
        part, count = slice(first, first + len(points)), np.array([len(points)])
        own = _Errors([light.rows(part) for light in self._lights], count)
        [standard], fit = own.of(None), 1.0
        if self._lights[0].by_surface is not None:
            surface = np.maximum(own.of(0.0)[0], TINY)
            if not (own.of(1.0)[0] <= CLOSE.of_surface * surface).all():
                parts = (STEPS / EIGHTHS).tolist()
                fit = parts[_first_least(np.array([(own.of(one)[0] / surface).max() for one in parts]))]
        if (own.of(fit)[0] <= CLOSE.of_standard * standard).all():
            return fit, np.full(len(points), EIGHTHS)
        # The share of each point in the error of standard lighting: steps × sets and truths × points.
        _, place = np.unique(points, return_inverse=True)
        errors = np.array([own._by_point(fit, step / EIGHTHS, place) for step in STEPS])
        errors /= np.maximum(own._by_point(None, 1.0, place).sum(axis=1), TINY)[:, None]
        tried = []
        for step in STEPS:
            # Each point is lit best by a mean of both truths. That mean is best in which the worse one is.
            importance = np.tile([step, EIGHTHS - step], len(self._lights))
            chosen = _first_least(np.einsum("t,stp->sp", importance / EIGHTHS, errors))
            worst = np.take_along_axis(errors, chosen[None, None], axis=0)[0].sum(axis=1).max()
            tried.append((float(worst), chosen))
        return fit, STEPS[tried[_first_least(np.array([worst for worst, _ in tried]))][1]][place]

    def _by_point(self, fit: float | None, share: float, place: IntArray) -> Float64Array:
        """Return the summed errors of all points, in each set of poses and by both truths: (2 S, points)."""
        sums = [(light.weights * light.errors(fit, share)).sum(axis=2) for light in self._lights]
        return np.array([np.bincount(place, row) for pair in sums for row in pair])


def _first_least(values: Float64Array) -> Any:
    """Return the place of the least of the values along the first axis, and of equal ones of the first."""
    return (values <= values.min(axis=0) + TIE * np.abs(values).max(initial=TINY)).argmax(axis=0)
