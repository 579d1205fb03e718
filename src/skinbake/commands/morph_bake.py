"""``skinbake bake --morph-normals`` and ``--morph-frames``: what morph targets that only move points lack.

Engines light a target without NORMAL by the normals at rest. The normals that it should have are those of
the moved surface, measured over the same welds and hard edges as α and β, and in the same frame. A mesh needs
no skin for that. The frame of α and β moves by the differential of the targets, which is linear in their
weights: its numbers are stored beside each target.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np

from skinbake.choices import Frame
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.surface_bake import PrimitiveBake
from skinbake.errors import Chosen, InputError, Message, Notice
from skinbake.format.morph_targets import MadeTargets, check_extras, morph_digest
from skinbake.geometry.frames import dot
from skinbake.geometry.morphs import NO_DIFFERENCES, Differences
from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost, Work
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import plain_sources, read_primitive, reason_to_skip
from skinbake.gltf.reading.morphs import read_targets, targets_without_normal
from skinbake.gradients import kernel
from skinbake.gradients.morph_gradients import MorphSurface
from skinbake.gradients.surface import WeightField
from skinbake.gradients.tangents import frame_vectors
from skinbake.gradients.weld import weld
from skinbake.report.bake import MorphCounts
from skinbake.report.verify import NEGLIGIBLE
from skinbake.timing import stage
from skinbake.wording import counted

LEAST = 2.0**-14
"""The change of a unit normal below which it stays: 0.0035°."""

TRIED = 8
"""The targets of a primitive whose normals are made where they are only told of."""


@dataclass(frozen=True, slots=True)
class _Part:
    """One primitive of a mesh with targets, with its weld classes (V,) and the kind of its frame.

    ``normals`` and ``frames`` say whether its targets get NORMAL and the differential. ``without`` are the
    numbers of the targets without NORMAL.
    """

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    classes: IntArray
    frame: str
    without: Sequence[int]
    normals: bool
    frames: bool = False

    @property
    def lacking(self) -> Sequence[int]:
        """The numbers of the targets that get NORMAL."""
        return self.without if self.normals else ()

    @property
    def targets(self) -> Sequence[int]:
        """The numbers of the targets for which anything is made."""
        return range(len(self.source.targets)) if self.frames else self.lacking

    @property
    def numbers(self) -> int:
        """How many numbers of the differential each target gets: four if all have NORMAL then, else six."""
        if not self.frames:
            return 0
        return 4 if self.normals or not self.without else 6


def morph_bake(
    document: Document, bakes: Sequence[PrimitiveBake], options: BakeOptions
) -> list[tuple[MadeTargets, MorphCounts]]:
    """Make NORMAL and the differential of targets. Raises InputError for targets that are broken.

    bakes belong to the skinned primitives. If normals are not asked for, notices say what these targets
    would gain, by a few of them; meshes without a skin are not looked at then.
    """
    made: list[tuple[MadeTargets, MorphCounts]] = []
    meshes: dict[int, list[PrimitiveBake]] = {}
    for bake in bakes:
        meshes.setdefault(bake.source.mesh, []).append(bake)

    def skinned(own: Sequence[PrimitiveBake], *, normals: bool, frames: bool) -> list[_Part]:
        """Return the primitives of a skinned mesh. Raises InputError for targets that are broken."""
        without = [targets_without_normal(document, bake.source) for bake in own]
        return [
            _Part(bake.source, bake.primitive, bake.result.classes, bake.result.frame, one, normals, frames)
            for bake, one in zip(own, without, strict=True)
        ]

    with stage("morph targets"):
        plain = _plain(document, options.crease_angle) if options.morph_normals else ()
        asked = {"normals": options.morph_normals, "frames": options.morph_frames}
        wanted = meshes.values() if any(asked.values()) else ()
        for parts in chain(plain, (skinned(own, **asked) for own in wanted)):
            if any(part.targets for part in parts):
                check_extras(document, parts[0].source.mesh, parts[0].source.place)
                made += _made(document, parts, options, None)
        for own in () if options.morph_normals else meshes.values():
            try:
                parts = skinned(own, normals=True, frames=False)
                told = list(_made(document, parts, options, TRIED)) if any(p.targets for p in parts) else []
            except InputError:
                continue  # a bake does not need its targets
            for item, count in told:
                if count.mean < NEGLIGIBLE:
                    continue
                lacking = count.normals
                have, them = ("has", "it") if lacking == 1 else ("have", "them")
                zeros = ", or only zeros in it" if any("NORMAL" in t for t in item.source.targets) else ""
                message = (
                    f"{counted(lacking, 'morph target')} of {count.targets:,} {have} no NORMAL{zeros}, so "
                    f"engines light {them} as at rest. At weight 1 that is {count.mean:.1f}° off in the mean "
                    "where normals turn: --morph-normals adds NORMAL"
                )
                document.notices.tell(Notice("morph-normals", message, item.source.place, lacking))
    if not made and any(asked.values()):
        option = Chosen("morph_frames" if options.morph_frames else "morph_normals")
        lacked = "morph targets" if options.morph_frames else "a morph target without NORMAL"
        message = Message(option, f" adds nothing: nothing here has {lacked} that it can add to")
        document.notices.tell(Notice("no-targets", message, document.place))
    return made


def _plain(document: Document, crease_angle: float) -> list[list[_Part]]:
    """Return the meshes of primitives without a skin that have targets without NORMAL.

    crease_angle is in degrees. A notice tells of a primitive that has no NORMAL itself.
    """
    meshes: dict[int, list[PrimitiveSource]] = {}
    for source in plain_sources(document):
        reason = reason_to_skip(document, source, generate_normals=False)
        if reason is None:
            meshes.setdefault(source.mesh, []).append(source)
        elif reason.code == "no-normals" and targets_without_normal(document, source):
            message = "its morph targets get no NORMAL, because it has none itself, and is flat by glTF"
            document.notices.tell(Notice("no-normals", message, source.place))
    found = []
    for sources in meshes.values():
        without = [targets_without_normal(document, source) for source in sources]
        if not any(without):
            continue
        primitives = [read_primitive(document, source) for source in sources]
        positions, normals = (
            np.concatenate([getattr(one, name) for one in primitives]) for name in ("positions", "normals")
        )
        count = len(positions)
        alike = WeightField(
            np.zeros((count, 1), np.int32), np.ones((count, 1)), np.zeros((count, 1), np.bool_)
        )
        classes = weld(positions, normals, alike, crease_angle=math.radians(crease_angle))
        own = np.split(classes, np.cumsum([len(one.positions) for one in primitives])[:-1])
        found.append(
            [
                _Part(source, primitive, part, str(Frame.NORMAL), lacking, normals=True)
                for source, primitive, part, lacking in zip(sources, primitives, own, without, strict=True)
            ]
        )
    return found


class _Change(NamedTuple):
    """What one target changes in a primitive: NORMAL (R, 3), and the numbers (R, 4) and (R, 2)."""

    normals: Differences = NO_DIFFERENCES
    in_plane: Differences = NO_DIFFERENCES
    upward: Differences = NO_DIFFERENCES


def _made(
    document: Document, parts: Sequence[_Part], options: BakeOptions, most: int | None
) -> Iterable[tuple[MadeTargets, MorphCounts]]:
    """Yield what is made for each primitive of a mesh, and its numbers, for ``most`` targets or all."""
    document.asset.meshes[parts[0].source.mesh].target_count  # noqa: B018  # refuses different numbers
    # The primitives of the mesh as one surface, and the slice of each in it.
    ends = np.cumsum([len(part.primitive.positions) for part in parts]).tolist()
    slices = [slice(*one) for one in zip([0, *ends[:-1]], ends, strict=True)]
    triangles = []
    for part, here in zip(parts, slices, strict=True):
        # Triangles without an area have no gradient.
        own = part.primitive.triangles
        work = Cost.MORPHED_TRIANGLE * len(own) + Cost.MORPHED_VERTEX * len(part.primitive.positions)
        document.budget.claim(work, "differentiating its morph targets", part.source.place)
        proper = own[kernel.mark_proper(part.primitive.positions, own)]
        triangles.append(proper.astype(np.int64) + here.start)
    frames = [frame_vectors(part.primitive, part.frame) for part in parts]
    surface = MorphSurface.of(
        np.concatenate([part.primitive.positions for part in parts]),
        np.concatenate(triangles),
        np.unique(np.concatenate([part.classes for part in parts]), return_inverse=True)[1],
        np.concatenate([part.primitive.normals for part in parts]),
        (np.concatenate([frame[0] for frame in frames]), np.concatenate([frame[1] for frame in frames])),
        weighting=options.weighting,
    )
    wanted = sorted(set().union(*(part.targets for part in parts)))
    if most is not None:
        wanted = wanted[:: -(-len(wanted) // most)]
    # By target, how the points of each primitive move.
    read = [
        read_targets(document, part.source, wanted, count=len(part.primitive.positions), tangents=False)
        for part in parts
    ]
    moves = {
        target: [NO_DIFFERENCES if own is None else own.targets[place].positions for own in read]
        for place, target in enumerate(wanted)
    }
    # Targets of the same accessors change the same, which is found once.
    known: dict[tuple[int, ...], list[_Change]] = {}
    changes: dict[int, list[_Change]] = {}
    for target, move in moves.items():
        key = tuple(map(id, move))
        if key not in known:
            known[key] = _changes(surface, slices, parts, move)
            size = sum(one.rows.nbytes + one.values.nbytes for own in known[key] for one in own)
            document.budget.claim(
                Work(bytes=size), "what it makes for its morph targets", parts[0].source.place
            )
        changes[target] = known[key]
    # The same by primitive, as it is stored: NORMAL where it lacks, the differential for every target.
    for number, part in enumerate(parts):
        normals = {t: changes[t][number].normals for t in part.lacking if t in changes}
        # Zeros that are right stay.
        there = part.source.targets
        normals = {t: made for t, made in normals.items() if len(made.rows) or "NORMAL" not in there[t]}
        of_frames = [t for t in part.targets if t in changes] if part.numbers else []
        moved = [{t: changes[t][number].in_plane for t in of_frames}] if part.numbers else []
        moved += [{t: changes[t][number].upward for t in of_frames}] if part.numbers > 4 else []
        if not normals and not of_frames:
            continue
        moving = {t: moves[t][number] for t in of_frames or normals}
        # The angles by which targets turn normals at weight 1, in degrees.
        every: list[float] = []
        for change in normals.values():
            before = part.primitive.normals[change.rows].astype(np.float64)
            after = before + change.values
            sine = np.linalg.norm(np.cross(before, after), axis=1)
            every += np.degrees(np.arctan2(sine, dot(before, after))).tolist()
        yield (
            MadeTargets(part.source, normals, moved, morph_digest(part.primitive, moving)),
            MorphCounts(
                targets=len(part.source.targets),
                normals=len(part.lacking) if most else len(normals),
                frames=part.numbers,
                mean=sum(every) / max(len(every), 1),
                max=max(every, default=0.0),
            ),
        )


def _changes(
    surface: MorphSurface, slices: Sequence[slice], parts: Sequence[_Part], move: Sequence[Differences]
) -> list[_Change]:
    """Return what one target changes in each primitive. NORMAL is for normals of the stored length."""
    whole = Differences(
        np.concatenate([one.rows + part.start for one, part in zip(move, slices, strict=True)]),
        np.concatenate([one.values for one in move]),
    )
    if not len(whole.rows):
        return [_Change() for _ in parts]
    # The change of the normal at weight 1, and the numbers by which the frame moves, linear in the weight.
    change = surface.differential(whole)
    normals = surface.normals_at(change)
    turned = np.linalg.norm(normals - surface.normals[change.rows], axis=1) >= LEAST
    numbers = surface.numbers_of(change)
    large: BoolArray = np.abs(numbers) >= LEAST
    found = []
    for part, here in zip(parts, slices, strict=True):
        own = slice(*np.searchsorted(change.rows, (here.start, here.stop)))
        rows = change.rows[own] - here.start
        with np.errstate(over="ignore", invalid="ignore"):  # a NaN may be signalling
            stored = part.primitive.normals[rows].astype(np.float64)
            added = normals[own] * np.linalg.norm(stored, axis=1, keepdims=True) - stored
        found.append(
            _Change(
                _kept(rows, added, turned[own, None]),
                _kept(rows, numbers[own, :4], large[own, :4]),
                _kept(rows, numbers[own, 4:], large[own, 4:]),
            )
        )
    return found


def _kept(rows: IntArray, values: Float64Array, wanted: BoolArray) -> Differences:
    """Return the rows of values (R, C) that float32 holds and of which anything is wanted (R, …)."""
    with np.errstate(over="ignore", invalid="ignore"):
        stored = values.astype(np.float32)
    sound = np.asarray(wanted.any(axis=1)) & np.isfinite(stored).all(axis=1)
    return Differences(rows[sound], stored[sound])
