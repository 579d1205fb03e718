"""Whether α and β light primitives no worse than standard lighting in the clips that move them.

The fit has the tangents of the mesh in view. On a coarse mesh the normals of its triangles may go another
way, above all where clips stretch joints. Both truths of ``verify`` tell, on a sample of the vertices, at
other moments than those of the fit. A primitive that is worse keeps some eighths of its α and β. Its metadata
note how many. If all parts are worse, it is left to standard lighting: under joints of uneven scale that
differs from accurate lighting even where α and β are 0. A file without clips has no moments to judge by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skinbake.choices import USUAL_TRUTHS
from skinbake.errors import InputError, Notice
from skinbake.format.baked import Baked
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray, bincount, blocks
from skinbake.gltf.budget import Cost, shown
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.reading.clips import animations_of, read_clips
from skinbake.gltf.reading.scenes import meshes_of_one_skin
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.gradients import kernel as loops
from skinbake.gradients.baker import EIGHTHS
from skinbake.gradients.surface import bit_patterns
from skinbake.measure.draws import Draw, PosedBlock, Surface
from skinbake.skinning.components import cross
from skinbake.skinning.rest import Algorithm
from skinbake.threads import Threads
from skinbake.truth import kernel
from skinbake.truth.operator import true_operator
from skinbake.truth.poses import PoseRequest, PoseSet, moving_clips, pose_set
from skinbake.truth.truths import Truths
from skinbake.wording import counted

GLANCE, CLOSE = (128, 0.75), (2048, 0.98)
"""How many vertices of a surface are looked at, and the share of standard lighting's error that may be left.

The first look tells that most primitives are sound. A sample of so few vertices may tell a gain much too
large. The second one decides. Of a gain that is told too large by 2 %, at most 1 % is lost.
"""

LEAST_VERTICES, FEWEST_VERTICES = 128, 32
"""The vertices of each primitive, at least: the second number if they are very many."""

POSES, OF_EACH, OFFSET = 24, 12, 0.75
"""The poses that all clips share, and those of each skin at least.

OFFSET is where they lie in equal parts of the first clip: the fit has others. In the next clips they lie
elsewhere, because many clips stand still at one share of their time.
"""

BYTES_A_PLACE, BYTES_A_SAMPLE, MOST_BYTES = 24, 320, 1 << 28
"""The memory of a vertex in a pose, of one that is looked at, and of a look.

Only vertices at which thousands of triangles meet take more.
"""

GOLDEN, ROOT_OF_2 = 0.6180339887498949, 1.4142135623730951
"""The golden section and another number. The fractions of their multiples lie evenly between 0 and 1."""

UNSEEN, FEW = 0.1, 0.01
"""An error in degrees that nobody sees, and the share of the area that may have a larger one.

A smaller angle changes a light's cosine by less than half a step of 8 bits.
"""

WORSE = 1.005
"""The error over that of standard lighting from which a primitive is left unbaked, if anybody can see it.

Half of what is promised: the sample is not all. Of 300 random rigs ten are left, all with joints that are
scaled by 40 %, and no primitive of 107 real files.
"""

UNBAKED = -1
"""What stands for a primitive that is left."""

TIE = 1e-6
"""The share of an error up to which two are the same. Rounding must not choose between them."""


DIGEST_BITS = 16
"""The digests of positions fill a table of so many bits. In a cache it is read fast."""

ODD = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D], dtype=np.uint32)
"""Odd numbers that spread the bits of a coordinate over the upper half of a product, one for each axis."""


def kept_eighths(document: Document, surfaces: Sequence[Sequence[Baked]]) -> list[list[int]]:
    """Return for each surface how many eighths of its α and β each primitive should keep, or ``UNBAKED``.

    surfaces are all of the document. Meshes are judged without their morph targets. Those that no clip moves,
    or that cannot be posed, keep everything, with a notice on the latter.
    """
    kept = [[EIGHTHS] * len(bakes) for bakes in surfaces]
    # The numbers of the surfaces that the truths take as one, as ``whole_surfaces`` does.
    meshes = [bakes[0].source.mesh for bakes in surfaces]
    morphed = [any(bake.source.has_targets for bake in bakes) for bakes in surfaces]
    plain = [mesh for mesh, morphs in zip(meshes, morphed, strict=True) if not morphs]
    groups = meshes_of_one_skin(document, plain) if len(plain) > 1 else [plain] if plain else []
    alone = [[number] for number, morphs in enumerate(morphed) if morphs]
    for group in [[meshes.index(mesh) for mesh in group] for group in groups] + alone:
        bakes = [bake for number in group for bake in surfaces[number]]
        try:
            what = f"judging the lighting of {counted(len(bakes), 'primitive')}"
            document.budget.claim(Cost.JUDGED_PRIMITIVE * len(bakes), what, document.place)
            with document.budget.passing():
                found = _eighths_of(document, bakes)
        except InputError as error:
            message = f"its lighting was not compared with standard lighting: {error.message}"
            document.notices.tell(
                Notice("not-judged", message, bakes[0].source.place._replace(primitive=None))
            )
            continue
        for number in group:
            kept[number] = [found.pop(0) for _ in kept[number]]
    return kept


def _eighths_of(document: Document, bakes: Sequence[Baked]) -> list[int]:
    """Return the eighths of each primitive of what the truths take as one surface."""
    kept = [EIGHTHS] * len(bakes)
    skins = tuple(document.asset.skins_of(bakes[0].source.mesh))
    poses = _poses(document, skins)
    lit = [_lit(bake) for bake in bakes] if poses else []
    for vertices, most in (GLANCE, CLOSE):
        if not any(map(len, lit)):
            return kept
        rows, shares = _evenly_spread(lit, vertices)
        errors = _Errors.of(document, bakes, rows, shares, poses)
        whole, standard = errors.means(1.0), errors.means(None)
        is_large = (errors.means(1.0, at_least=UNSEEN) >= FEW) & (whole > most * standard)
        lit = [own if large else own[:0] for own, large in zip(lit, map(np.any, is_large), strict=True)]
    # The eighths by which the worse truth leaves least, over what standard lighting leaves.
    steps = np.arange(EIGHTHS, -1, -1)
    tried = np.array([errors.means(step / EIGHTHS) for step in steps]) / np.maximum(standard, 1e-9)
    for number, own in enumerate(lit):
        if len(own):
            worst = tried[:, number].max(axis=1)
            place = int((worst <= worst.min() + TIE).argmax())
            lost = (tried[place, number] - 1.0) * standard[number]
            is_worse = ((tried[place, number] > WORSE) & (lost > UNSEEN / 2.0)).any()
            kept[number] = UNBAKED if is_worse else int(steps[place])
    return kept


def _lit(bake: Baked) -> BoolArray:
    """Tell which vertices (V,) of a primitive have α or β other than 0."""
    by_slot = (bake.result.alpha != 0.0) | (bake.result.beta != 0.0)
    lit = np.zeros(len(by_slot), dtype=np.bool_)
    for column in by_slot.T:  # a fifth of the time that whole rows take
        lit |= column
    return lit


def _evenly_spread(lit: Sequence[BoolArray], count: int) -> tuple[list[IntArray], list[Float64Array]]:
    """Return about so many lit vertices of all primitives, and a quarter as many others, evenly spread.

    lit tells which vertices (V,) of a primitive are. Returns also how many vertices each of these stands for.
    """
    least = max(FEWEST_VERTICES, min(LEAST_VERTICES, 2 * CLOSE[0] // len(lit)))
    found: list[IntArray] = []
    stand_for: list[Float64Array] = []
    every = [max(1, sum(int(np.count_nonzero(own == kind)) for own in lit)) for kind in (True, False)]
    for of_primitive in lit:
        shares = np.zeros(len(of_primitive))
        for kind, total, part in zip((True, False), every, (1, 4), strict=True):
            rows = np.flatnonzero(of_primitive == kind)
            own = max(least, count * len(rows) // total) // part
            taken = np.ones(len(rows), dtype=np.bool_)
            if len(rows) > own:
                taken[:] = False
                taken[(np.arange(1, own + 1) * GOLDEN % 1.0 * len(rows)).astype(np.int64)] = True
            shares[rows[taken]] = len(rows) / max(1, int(np.count_nonzero(taken)))
        found.append(np.flatnonzero(shares))
        stand_for.append(shares[found[-1]])
    return found, stand_for


@once_a_document
def _poses(document: Document, skins: tuple[int, ...]) -> list[tuple[int, PoseSet]]:
    """Return the skins that clips move, each with poses in which to judge.

    Skins with other joints share the poses, and so do the clips that move a skin. Raises InputError as
    ``pose_set``, or if a clip is broken.
    """
    different = list({id(read_skeleton(document, skin)): skin for skin in skins}.values())
    some_skins = different[: POSES // OF_EACH]
    each, found = POSES // len(some_skins), []
    for skin in some_skins:
        numbers = animations_of(document, set(read_skeleton(document, skin).nodes))
        some = min(len(numbers), each)
        # Of many clips one of each of so many equal parts, at another place in it: variants may alternate.
        places = ((place + GOLDEN * place % 1.0) * len(numbers) / max(1, some) for place in range(some))
        chosen = list(dict.fromkeys(numbers[int(place)] for place in places))
        clips = moving_clips(document, skin, read_clips(document, chosen))
        requests = (
            PoseRequest(samples=each // len(clips), offset=(OFFSET + ROOT_OF_2 * place) % 1.0)
            for place in range(len(clips))
        )
        sets = [pose_set(document, skin, [clip], one) for clip, one in zip(clips, requests, strict=True)]
        if sets:
            matrices = np.concatenate([one.joint_matrices for one in sets])
            names = tuple(name for one in sets for name in one.clips)
            times = tuple(time for one in sets for time in one.times)
            found.append((skin, PoseSet(sets[0].joint_names, matrices, names, times)))
    return found


class _Light(NamedTuple):
    """The light of B vertices in P poses of a skin.

    standard (3, B, P) is the standard normal. still, added (2, 3, B, P) are t' and b' without α and β, and
    what these add. expected (2, 3, B, P) is the true normal by each truth, and weights (2, B, P) is the area
    of the vertex, 0 where there is none. sides (B, P) is −1 where joints mirror.
    """

    standard: Float64Array
    still: Float64Array
    added: Float64Array
    expected: Float64Array
    weights: Float64Array
    sides: Float64Array

    @classmethod
    def of(cls, block: PosedBlock, draw: Draw, rows: IntArray) -> _Light:
        """Return the light of those vertices of a block that are among some rows of its primitive."""
        start, stop = block.at.rows.start, block.at.rows.stop
        own = rows[slice(*np.searchsorted(rows, (start, stop)))]
        every, skinned = slice(0, block.poses.stop - block.poses.start), block.skinned
        [standard] = skinned.normals((Algorithm.LBS_STANDARD,), every, own)
        still, added = skinned.tangents(every, own)
        areas = draw.areas[block.at.primitive][own]
        sides = np.ones((len(own), every.stop)) if block.side is None else block.side.T[own - start]
        return cls(
            np.stack([axis.T for axis in standard]),
            still,
            added,
            block.normals[:, :, own - start],
            areas[:, None] * block.exist[:, own - start],
            sides,
        )

    def errors(self, share: float | None) -> Float64Array:
        """Return the angles to both truths (2, B, P) by a share of α and β, None for standard lighting.

        They are in degrees.
        """
        normal = self.standard
        if share is not None:
            t, b = self.still + share * self.added
            normal = self.sides * np.stack(cross(tuple(t), tuple(b)))
        found = kernel.angles(tuple(axis.T for axis in normal), self.expected)
        return np.where(np.isnan(found), 180.0, found)  # a normal without direction


class _Errors(NamedTuple):
    """The light of vertices of N primitives in the poses of each skin, and the owners of the vertices."""

    lights: Sequence[_Light]
    owners: IntArray
    primitives: int

    @classmethod
    def of(
        cls,
        document: Document,
        bakes: Sequence[Baked],
        rows: Sequence[IntArray],
        shares: Sequence[Float64Array],
        poses: Sequence[tuple[int, PoseSet]],
    ) -> _Errors:
        """Light some vertices of each primitive, each of which stands for a share of all.

        Raises InputError if they take too much memory.
        """
        numbers, cut, places = cut_out(bakes, rows)
        counts = [len(own) for own in places]
        most = max((len(own.joint_matrices) for _, own in poses), default=0)
        vertices = sum(len(part.primitive.positions) for part in cut)
        size = most * (BYTES_A_PLACE * vertices + BYTES_A_SAMPLE * sum(counts) * len(poses))
        if size > MOST_BYTES:
            message = f"so many triangles meet at its vertices that it would take {shown(size)}"
            raise InputError(message, bakes[0].source.place)
        # Weights from before adoption: what a slot adopts has none yet, and tears no surface apart.
        operator = true_operator([part.primitive for part in cut])
        surface = Surface(document, [BakedView.unwritten(part) for part in cut], lambda: operator)
        truths, lights = Truths.of(operator, surface.rest, most, USUAL_TRUTHS), []
        for skin, own in poses:
            draw = Draw(surface, skin, None, read_skeleton(document, skin), own)

            def light(block: PosedBlock, draw: Draw = draw) -> _Light:
                return _Light.of(block, draw, places[block.at.primitive])

            with Threads(1) as threads:
                found = list(draw.true_normals(truths, light, threads))
            # Fancy indices give arrays of any order in memory; the loops read rows.
            whole = (np.concatenate(parts, axis=-2) for parts in zip(*found, strict=True))
            lit = _Light(*map(np.ascontiguousarray, whole))
            lights.append(lit._replace(weights=lit.weights * np.concatenate(shares)[:, None]))
        return cls(lights, np.repeat(numbers, counts), len(bakes))

    def means(self, share: float | None, at_least: float | None = None) -> Float64Array:
        """Return the mean errors (N, 2 S) in the poses of S skins by both truths, 0 without any area.

        share is as for ``_Light.errors``. With at_least, return the share of the area that has such an error.
        """
        found = []
        for light in self.lights:
            errors = light.errors(share)
            values = errors if at_least is None else 1.0 * (errors >= at_least)
            for row, areas in zip((light.weights * values).sum(2), light.weights.sum(2), strict=True):
                total, area = (bincount(self.owners, each, self.primitives) for each in (row, areas))
                found.append(np.divide(total, area, out=np.zeros(len(area)), where=area > 0.0))
        return np.array(found).reshape(-1, self.primitives).T


def cut_out(
    bakes: Sequence[Baked], rows: Sequence[IntArray]
) -> tuple[list[int], list[Baked], list[IntArray]]:
    """Cut vertices out of primitives in one space, with all vertices at their places and all triangles there.

    rows are the vertices of each primitive. Return the numbers of the primitives that have any part, the part
    of each, and where its vertices are. Only these have all around them that they have in the whole.
    """
    near = _with_copies([bake.primitive.positions for bake in bakes], rows)
    numbers: list[int] = []
    parts: list[Baked] = []
    places: list[IntArray] = []
    for number, (bake, own, there) in enumerate(zip(bakes, rows, near, strict=True)):
        primitive, baked = bake.primitive, bake.result
        if not len(there):
            continue
        used = np.zeros(len(primitive.positions), dtype=np.bool_)
        used[there] = True
        # The triangles that have one of the used vertices.
        corners = primitive.triangles.ravel()
        at = [block.start + np.flatnonzero(used[corners[block]]) for block in blocks(len(corners))]
        owners = np.concatenate(at or [np.empty(0, dtype=np.int64)]) // 3
        triangles = primitive.triangles[owners[np.diff(owners, prepend=-1) > 0]]
        used[triangles] = True
        kept = np.flatnonzero(used)
        adopting = used[baked.adopting]
        part = replace(
            primitive,
            positions=primitive.positions[kept],
            normals=primitive.normals[kept],
            tangents=None if primitive.tangents is None else primitive.tangents[kept],
            joints=primitive.joints[kept],
            weights=primitive.weights[kept],
            triangles=np.searchsorted(kept, triangles),
        )
        result = baked._replace(
            alpha=baked.alpha[kept],
            beta=baked.beta[kept],
            adopting=np.searchsorted(kept, baked.adopting[adopting]),
            adopted=baked.adopted[adopting],
            classes=baked.classes[kept],
        )
        numbers.append(number)
        parts.append(bake._replace(primitive=part, result=result))
        places.append(np.searchsorted(kept, own))
    return numbers, parts, places


def _with_copies(positions: Sequence[FloatArray], rows: Sequence[IntArray]) -> list[IntArray]:
    """Return some vertices of primitives, and all others at their places. positions are (V, 3)."""
    places = np.concatenate([each[own] for each, own in zip(positions, rows, strict=True)])
    # A table of digests tells that most vertices are at no such place. Only the rest is compared.
    table = np.zeros(1 << DIGEST_BITS, dtype=np.bool_)
    table[_digests(places)] = True
    maybe = [
        np.concatenate(
            [part.start + np.flatnonzero(table[_digests(each[part])]) for part in blocks(len(each))]
        )
        for each in positions
    ]
    candidates = (each[own] for each, own in zip(positions, maybe, strict=True))
    labels = loops.label_equal_rows(np.concatenate([places, *candidates]))
    wanted = np.zeros(len(labels), dtype=np.bool_)
    wanted[labels[: len(places)]] = True
    found = np.split(wanted[labels[len(places) :]], np.cumsum([*map(len, maybe)])[:-1])
    return [own[there] for own, there in zip(maybe, found, strict=True)]


def _digests(positions: FloatArray) -> IntArray:
    """Return a number of DIGEST_BITS bits for each position (V, 3), the same for equal ones."""
    x, y, z = bit_patterns(positions.astype(np.float32, copy=False)).T
    mixed: IntArray = (x * ODD[0]) ^ (y * ODD[1]) ^ (z * ODD[2])
    return mixed >> np.uint32(32 - DIGEST_BITS)
