"""Whether another bake lights a file better than the one in it, measured as verify measures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from skinbake.choices import Encoding, Gradients
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import DEFAULTS, BakeOptions
from skinbake.commands.corrective_bake import lighting_with_correctives
from skinbake.errors import Notices, SkinbakeError
from skinbake.format.note import corrective_notes, gradient_note
from skinbake.format.strip import stripped
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.morphs import targets_without_normal
from skinbake.measure.measured import lighting_of
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import (
    CLEAR,
    LITTLE,
    FileVerdict,
    OtherBake,
    baked_lighting,
    by_worse_truth,
)
from skinbake.timing import stage

NEARER = 1.1
"""How many times nearer to the true normals another bake is, to be named."""


def other_bakes(document: Document, verdict: FileVerdict, options: VerifyOptions) -> tuple[OtherBake, ...]:
    """Return bakes that light a file better than its own does, the best of its own kind first.

    The kinds are α and β, and correctives. The other kind is measured where the own one has no clear gain to
    offer. A bake that cannot be measured within the work that is left for the file does not count. The
    verdict ``leaves_room``.
    """
    figures = by_worse_truth(verdict)
    method = next(iter(next(iter(verdict.by_truth.values()), {"lbs": {}})))
    asked = replace(options, methods=(method,), max_mean_error=None, max_p95_error=None, min_gain=None)
    own = baked_lighting(figures)
    standard, nearest = figures["standard"].mean, figures[own].mean
    found: list[OtherBake] = []
    with stage("other bakes"):
        plain, _ = stripped(document.edited(budget=replace(document.budget), notices=Notices()))
        for corrects in (False, True) if own == "accurate" else (True, False):
            every = _measured(document, plain, asked, corrects=corrects)
            best = min(every, key=lambda other: other.error, default=None)
            if best is not None and best.error * NEARER <= nearest and best.error * LITTLE <= standard:
                found.append(best)
                nearest = best.error
            if nearest * CLEAR <= standard:
                break
    return tuple(found)


def _measured(
    document: Document, plain: Document, options: VerifyOptions, *, corrects: bool
) -> Iterator[OtherBake]:
    """Yield the bakes of one kind that can be measured."""
    sources = skinned_sources(plain)
    try:
        lacking = any(targets_without_normal(plain, source) for source in sources)
    except SkinbakeError:  # no bake can make what broken targets lack
        lacking = False
    morphs, plays = any(one.has_targets for one in sources), bool(plain.asset.animations)
    ways: list[tuple[str, dict[str, Any], bool]] = [
        (_default(document, sources), {}, not corrects),
        ("--morph-normals", {"morph_normals": True}, not corrects and lacking),
        ("--morph-frames", {"morph_frames": True}, not corrects and morphs and not lacking),
        ("--neighbours extend", {"neighbours": "extend"}, not corrects),
    ]
    # One file of a character alone would get targets that clips of the others do not fit.
    plays = plays and not any(note.character for note in corrective_notes(document).values())
    corrects = corrects and plays and options.methods == ("lbs",)  # which correctives are for
    auto = {"correctives": "auto"}
    ways.append(("--correctives auto", auto, corrects))
    ways.append(("--correctives auto --morph-normals", {**auto, "morph_normals": True}, corrects and lacking))
    overflows, is_corrected = True, bool(corrective_notes(document))
    for words, chosen, is_tried in ways:
        if not is_tried or ("neighbours" in chosen and not overflows):
            continue
        try:
            with plain.budget.passing():  # of one at a time
                made = bake_document(plain, BakeOptions(**chosen))
                if not made.is_baked:
                    figures = {}
                elif corrects:
                    figures = by_worse_truth(lighting_with_correctives(made.document, options, DEFAULTS))
                else:
                    figures = by_worse_truth(lighting_of(made.document, options))
        except SkinbakeError:
            continue
        if not chosen:
            overflows = any(count.overflowing_vertices for _, count in made.primitives)
        if figures:
            without = " without --correctives" if is_corrected and not corrects else ""
            yield OtherBake(f"{words}{without}", figures[baked_lighting(figures)].mean)


def _default(document: Document, sources: list[PrimitiveSource]) -> str:
    """Return what the default bake has that the bake of a file lacks."""
    notes = [gradient_note(document, document.asset.counterpart(one)) for one in sources]
    held = [note for note in notes if note is not None]
    found = []
    if any(note.gradients != Gradients.FITTED for note in held):
        found.append("--gradients fitted")
    if any(note.encoding != Encoding.FLOAT32 for note in held):
        found.append("--encoding float32")
    return " ".join(found) or "the defaults"
