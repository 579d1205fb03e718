"""What dump, pictures and pages show of a document: a bake in memory if it has none, and the asked clips."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import ChoiceError, InputError, Notice, Skipped, printable
from skinbake.format.strip import stripped, uncorrected
from skinbake.freshness.baked_views import BakedView, is_baked
from skinbake.freshness.corrective_freshness import damaged_correctives
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import Clip, random_clip, read_clips
from skinbake.gltf.reading.materials import tell_images_unplaced
from skinbake.gltf.reading.meshes import reason_to_skip, skinned_sources, why_nothing
from skinbake.gltf.reading.scenes import faces_backward
from skinbake.measure.draws import Draw
from skinbake.measure.places import spots_of
from skinbake.measure.scene import Scene, claim_draws
from skinbake.report.verify import Spot, Spots
from skinbake.truth.poses import PoseRequest
from skinbake.wording import counted

LISTED = 20
"""The names of clips that a message lists."""

RANDOM_MOMENTS = 25
"""The moments of the random clip at which places are looked for, if no clip of the file has any."""

OF_STORAGE = {"draco-sequential"}
"""The notices of a bake that speak only of the bytes of its output."""


def baked_in_memory(document: Document) -> Document:
    """Bake a document with the defaults. Raises InputError if nothing in it can be baked.

    Nothing is stored, so nothing is told of storage.
    """
    count = len(skinned_sources(document))
    what = f"baking {counted(count, 'primitive')} in memory"
    document.budget.claim(Cost.DRAWN_PRIMITIVE * count, what, document.place)
    with document.notices.withheld():
        plain, _ = uncorrected(document)
        if plain is document or holds_bake(document):
            plain, _ = stripped(document)
    with document.notices.withheld() as told:
        made = bake_document(plain, BakeOptions(generate_normals=True))
    if not made.primitives:
        reasons = "; ".join(notice.reason for notice in told if isinstance(notice, Skipped))
        raise InputError(f"nothing in it can be shown: {reasons or why_nothing(document)}", document.place)
    tell, sources = document.notices.tell, skinned_sources(document)
    message = "its bake is damaged or old, and one made in memory is shown: skinbake verify says why"
    tell(*(Notice("bake-damaged", message, one.place) for one in sources if is_baked(document, one)))
    for problem in damaged_correctives(document):
        message = f"its correctives are left out here, and α and β shown in place of them: {problem.message}"
        tell(Notice("correctives-not-shown", message, problem.place))
    message = "it has no NORMAL: smooth normals are generated here, and in a bake with --generate-normals"
    for one in sources:
        if "NORMAL" not in one.attributes and reason_to_skip(document, one, generate_normals=True) is None:
            tell(Notice("normals-generated", message, one.place))
    tell(*(notice for notice in told if notice.code not in OF_STORAGE))
    return made.document


def holds_bake(document: Document) -> bool:
    """Tell whether a primitive holds a bake, sound or not."""
    return any(is_baked(document, source) for source in skinned_sources(document))


def tell_unplaced(document: Document, view: BakedView, made: str) -> None:
    """Tell if an image of a primitive has no texture coordinates there."""
    ours = {*view.note.alpha, *view.note.beta}  # they may be stored as such sets
    tell_images_unplaced(document, view.source, set(view.source.attributes) - ours, made)


def asked_clips(document: Document, asked: str | None) -> Sequence[Clip]:
    """Return the clip of a name or number, or all. Raises ChoiceError for a clip that does not exist."""
    clips = read_clips(document)
    if asked is None:
        return clips
    named = [clip for clip in clips if clip.name == asked]
    if not named and asked.isdecimal():
        named = [clip for clip in clips if clip.number == int(asked)]
    if not named:
        alike = [clip for clip in clips if document.asset.animations[clip.number].name == asked]
        there = alike or clips
        listed = [printable(clip.name) for clip in there[:LISTED]] or ["none"]
        more = [f"{len(there) - LISTED} more"] if len(there) > LISTED else []
        what = "several clips of this name: choose by number among" if alike else "no such clip; it has"
        raise ChoiceError(
            "clip", printable(asked), reason=(f": the file has {what} {', '.join(listed + more)}",)
        )
    return named


def spots_in_clips(scene: Scene, known: Spots | None = None, asked: Sequence[Clip] | None = None) -> Spots:
    """Return where a bake shows in clips, all or the asked ones, else in those random poses that a page has.

    known are the places of the poses that verify measures, if it has. Raises InputError if the scene cannot
    be posed, or is too much work.
    """
    document = scene.document
    with document.notices.withheld():
        clips = read_clips(document) if asked is None else asked
        if known is None:
            known = spots_of(scene.measured(clips, PoseRequest()))
        if asked is None and not any(spot.number is not None for spot in known.shows):
            random = random_clip(document)
            return spots_at(scene, random, np.linspace(random.start, random.duration, RANDOM_MOMENTS))
    return known


def spots_at(scene: Scene, clip: Clip, times: Float64Array) -> Spots:
    """Return where a bake shows at times (P,) of a clip. Raises InputError as ``spots_in_clips``."""
    draws = scene.shown()
    claim_draws(scene.document, draws, [clip], len(times))
    return spots_of((draw.at(clip, times, turned=False) for draw in draws), skips_still=len(times) > 1)


def telling_pose(
    scene: Scene,
    asked: str | None,
    time: float | None,
    *,
    is_close: bool = False,
    known: Spots | None = None,
) -> tuple[Clip, float, Spot | None]:
    """Return a clip by its name or number, a time in it in seconds, and for a close-up the best place then.

    Where they are not asked for, the bake shows most there. If it shows nowhere, they are the middle of the
    first clip. known is as in ``spots_in_clips``. The place is one in the scene that ``Draw.at`` gives.
    Raises ChoiceError for a clip that does not exist, and for a time outside it. Raises InputError if a
    close-up has no place, or if the work is too much.
    """
    document, spots = scene.document, tuple[Spot, ...]()
    clips = asked_clips(document, asked) or [random_clip(document)]
    if time is None or len(clips) > 1:
        found = spots_in_clips(scene, known, None if asked is None else clips).shows
        spots = tuple(spot for spot in found if spot.number is not None)
    every = [*clips, random_clip(document)]
    clip = next(one for one in every if not spots or one.number == spots[0].number)
    if time is None:
        time = spots[0].time if spots and spots[0].time is not None else (clip.start + clip.duration) / 2
    elif not clip.start <= time <= clip.duration:
        reason = f': clip "{printable(clip.name)}" goes from {clip.start:g} to {clip.duration:g} s'
        raise ChoiceError("time", time, reason=(reason,))
    elif is_close:
        spots = spots_at(scene, clip, np.array([time])).shows
    if is_close and not spots:
        raise InputError("no clip has a place where the bake shows: leave out --closeup", document.place)
    if not is_close:
        return clip, time, None
    x, y, z = spots[0].towards
    return clip, time, replace(spots[0], towards=(-x, y, -z)) if faces_backward(document) else spots[0]


def followed(spot: Spot, draws: Sequence[Draw]) -> Iterator[Float64Array]:
    """Yield the position (3,) of a place's middle in each pose of the draw that shows it."""
    for draw in draws:
        for number, view in enumerate(draw.surface.views):
            if (draw.skin, draw.node, view.source.place) == (spot.skin, spot.node, spot.place):
                parts = list(draw.positions())
                every = parts[number :: len(draw.surface.views)]
                yield from (pose[spot.vertex] for part in every for pose in part)
                return
