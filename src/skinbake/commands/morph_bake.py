"""``skinbake bake --morph-normals``: NORMAL for morph targets that only move points.

Engines light a target without NORMAL by the normals at rest. The normals that it should have are those of
the moved surface, measured over the same welds and hard edges as α and β, and in the same frame. A mesh needs
no skin for that.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.choices import Frame
from skinbake.commands.surface_bake import PrimitiveBake
from skinbake.errors import InputError, Notice, Place
from skinbake.format.morph_targets import MadeNormals, check_extras, morph_digest
from skinbake.geometry.morphs import NO_DIFFERENCES, Differences
from skinbake.geometry.skinned import Float64Array, IntArray, SkinnedPrimitive
from skinbake.gltf.document import Document
from skinbake.gltf.morphs import read_targets, target_count
from skinbake.gltf.primitives import PrimitiveSource, plain_sources, read_primitive, reason_to_skip
from skinbake.gradients import kernel
from skinbake.gradients.baker import BakeSettings
from skinbake.gradients.morph_gradients import BYTES_A_TRIANGLE, BYTES_A_VERTEX, MorphSurface
from skinbake.gradients.surface import WeightField
from skinbake.gradients.tangents import frame_vectors
from skinbake.gradients.weld import weld
from skinbake.report.bake import MorphNormalCounts
from skinbake.report.verify import NEGLIGIBLE
from skinbake.timing import stage
from skinbake.wording import counted

LEAST = 2.0**-14
"""The change of a unit normal below which it stays: 0.0035°."""

TRIED = 8
"""The targets of a primitive whose normals are made where they are only told of."""


@dataclass(frozen=True, slots=True)
class MorphBake:
    """The normals made for the targets of a document, their numbers, and notices."""

    made: Sequence[MadeNormals] = ()
    counts: Sequence[MorphNormalCounts] = ()
    notices: Sequence[Notice] = ()

    def reported(self, lengths: Sequence[int]) -> tuple[tuple[Place, MorphNormalCounts], ...]:
        """Return the numbers of each primitive with its place. lengths are the added bytes."""
        return tuple(
            (item.source.place, replace(count, added_bytes=length))
            for item, count, length in zip(self.made, self.counts, lengths, strict=True)
        )


@dataclass(frozen=True, slots=True)
class _Part:
    """One primitive of a mesh with targets, with its weld classes (V,) and the kind of its frame."""

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    classes: IntArray
    frame: str


def morph_bake(
    document: Document, bakes: Sequence[PrimitiveBake], settings: BakeSettings, *, wanted: bool
) -> MorphBake:
    """Make NORMAL for the targets of primitives that lack it. Raises InputError for targets that are broken.

    bakes are those of the skinned primitives. If normals are not wanted, the notices say what these targets
    would gain, by a few of them; meshes without a skin are not looked at then.
    """
    made: list[MadeNormals] = []
    counts: list[MorphNormalCounts] = []
    notices: list[Notice] = []
    meshes: dict[int, list[_Part]] = {}
    for bake in bakes:
        own = _Part(bake.source, bake.primitive, bake.result.classes, bake.result.frame)
        meshes.setdefault(bake.source.mesh, []).append(own)
    with stage("morph targets"):
        surfaces = [parts for parts in meshes.values() if any(_lacking(one.source) for one in parts)]
        if wanted:
            plain, notices = _plain(document, settings)
            surfaces += plain
        for parts in surfaces:
            source = parts[0].source
            try:
                if wanted:
                    check_extras(document, source.mesh, source.place)
                found = list(_made(document, parts, settings, None if wanted else TRIED))
            except InputError:
                if wanted:
                    raise
                continue  # a bake does not need its targets
            made += [item for item, _ in found]
            counts += [count for _, count in found]
    if wanted:
        return MorphBake(made, counts, notices)
    pairs = zip(made, counts, strict=True)
    return MorphBake(notices=[_missing(*pair) for pair in pairs if pair[1].mean >= NEGLIGIBLE])


def _lacking(source: PrimitiveSource) -> list[int]:
    """Return the numbers of the targets of a primitive without NORMAL."""
    return [number for number, target in enumerate(source.json.get("targets", [])) if "NORMAL" not in target]


def _missing(made: MadeNormals, count: MorphNormalCounts) -> Notice:
    have, them = ("has", "it") if count.targets == 1 else ("have", "them")
    message = (
        f"{counted(count.targets, 'morph target')} of {count.of:,} {have} no NORMAL, so engines light {them} "
        f"as at rest. At weight 1 that is {count.mean:.1f}° off in the mean where normals turn: "
        "--morph-normals adds NORMAL"
    )
    return Notice("morph-normals", message, made.source.place, count.targets)


def _plain(document: Document, settings: BakeSettings) -> tuple[list[list[_Part]], list[Notice]]:
    """Return the meshes of primitives without a skin that have targets without NORMAL, and notices."""
    meshes: dict[int, list[PrimitiveSource]] = {}
    notices = []
    for source in plain_sources(document):
        reason = reason_to_skip(document, source, generate_normals=False)
        if reason is None:
            meshes.setdefault(source.mesh, []).append(source)
        elif reason.code == "no-normals" and _lacking(source):
            message = "its morph targets get no NORMAL, because it has none itself, and is flat by glTF"
            notices.append(Notice("no-normals", message, source.place))
    found = []
    for sources in meshes.values():
        if not any(map(_lacking, sources)):
            continue
        primitives = [read_primitive(document, source) for source in sources]
        positions, normals = (
            np.concatenate([getattr(one, name) for one in primitives]) for name in ("positions", "normals")
        )
        count = len(positions)
        alike = WeightField(
            np.zeros((count, 1), np.int32), np.ones((count, 1)), np.zeros((count, 1), np.bool_)
        )
        classes = weld(positions, normals, alike, crease_angle=settings.crease_angle)
        own = np.split(classes, np.cumsum([len(one.positions) for one in primitives])[:-1])
        found.append([_Part(*part, str(Frame.NORMAL)) for part in zip(sources, primitives, own, strict=True)])
    return found, notices


def _made(
    document: Document, parts: Sequence[_Part], settings: BakeSettings, most: int | None
) -> Iterable[tuple[MadeNormals, MorphNormalCounts]]:
    """Yield the normals made for each primitive of a mesh, and their numbers, for ``most`` targets or all."""
    target_count(document, parts[0].source.mesh)  # refuses primitives with different numbers
    surface, slices = _surface(document, parts, settings)
    lacking = [_lacking(part.source) for part in parts]
    wanted = sorted(set().union(*lacking))
    if most is not None:
        wanted = wanted[:: -(-len(wanted) // most)]
    read = [
        read_targets(document, part.source, wanted, count=len(part.primitive.positions), tangents=False)
        for part in parts
    ]
    moves = [
        [NO_DIFFERENCES if own is None else own.targets[place].positions for own in read]
        for place in range(len(wanted))
    ]
    # Targets of the same accessors have the same normals, which are made once.
    known: dict[tuple[int, ...], list[Differences]] = {}
    normals: list[list[Differences]] = []
    for move in moves:
        key = tuple(map(id, move))
        if key not in known:
            known[key] = _turned(surface, slices, parts, move)
            size = sum(one.rows.nbytes + one.values.nbytes for one in known[key])
            document.budget.claim(size, "its normals under morph targets", parts[0].source.place)
        normals.append(known[key])
    for number, part in enumerate(parts):
        places = {target: place for place, target in enumerate(wanted) if target in lacking[number]}
        if places:
            own = {target: normals[place][number] for target, place in places.items()}
            moving = {target: moves[place][number] for target, place in places.items()}
            angles = [_degrees(part, one).tolist() for one in own.values()]
            yield (
                MadeNormals(part.source, own, morph_digest(part.primitive, moving)),
                MorphNormalCounts.of_angles(angles, len(lacking[number]), len(part.source.json["targets"])),
            )


def _surface(
    document: Document, parts: Sequence[_Part], settings: BakeSettings
) -> tuple[MorphSurface, list[slice]]:
    """Return the mesh of some primitives as one surface, and the slice of each in it."""
    ends = np.cumsum([len(part.primitive.positions) for part in parts]).tolist()
    starts = [0, *ends[:-1]]
    triangles = []
    for part, start in zip(parts, starts, strict=True):
        own = part.primitive.triangles
        size = BYTES_A_TRIANGLE * len(own) + BYTES_A_VERTEX * len(part.primitive.positions)
        document.budget.claim(size, "differentiating its morph targets", part.source.place)
        triangles.append(own[kernel.mark_proper(part.primitive.positions, own)].astype(np.int64) + start)
    frames = [frame_vectors(part.primitive, part.frame) for part in parts]
    surface = MorphSurface.of(
        np.concatenate([part.primitive.positions for part in parts]),
        np.concatenate(triangles),
        np.unique(np.concatenate([part.classes for part in parts]), return_inverse=True)[1],
        np.concatenate([part.primitive.normals for part in parts]),
        (np.concatenate([frame[0] for frame in frames]), np.concatenate([frame[1] for frame in frames])),
        weighting=settings.weighting,
    )
    return surface, [slice(*one) for one in zip(starts, ends, strict=True)]


def _turned(
    surface: MorphSurface, slices: Sequence[slice], parts: Sequence[_Part], move: Sequence[Differences]
) -> list[Differences]:
    """Return what one target adds to NORMAL in each primitive, for normals of the length that is stored."""
    whole = Differences(
        np.concatenate([one.rows + part.start for one, part in zip(move, slices, strict=True)]),
        np.concatenate([one.values for one in move]),
    )
    if not len(whole.rows):
        return [NO_DIFFERENCES for _ in parts]
    change = surface.differential(whole)
    normals = surface.normals_at(change)
    turned = np.linalg.norm(normals - surface.normals[change.rows], axis=1) >= LEAST
    rows, normals = change.rows[turned], normals[turned]
    found = []
    for part, here in zip(parts, slices, strict=True):
        first, last = np.searchsorted(rows, (here.start, here.stop))
        own = rows[first:last] - here.start
        stored = part.primitive.normals[own].astype(np.float64)
        added = normals[first:last] * np.linalg.norm(stored, axis=1, keepdims=True) - stored
        sound = np.isfinite(added).all(axis=1)
        found.append(Differences(own[sound], added[sound].astype(np.float32)))
    return found


def _degrees(part: _Part, normals: Differences) -> Float64Array:
    """Return the angles (R,) by which a target turns normals at weight 1."""
    before = part.primitive.normals[normals.rows].astype(np.float64)
    after = before + normals.values
    sine = np.linalg.norm(np.cross(before, after), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("ri,ri->r", before, after))))
