"""Whether another bake lights a file better than the one in it, measured as verify measures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from skinbake.choices import Encoding, Gradients
from skinbake.commands.bake import Baker
from skinbake.errors import Notices, SkinbakeError
from skinbake.format.metadata import corrective_notes, read_metadata
from skinbake.format.strip import stripped
from skinbake.gltf.document import Document
from skinbake.gltf.morphs import targets_without_normal
from skinbake.gltf.primitives import PrimitiveSource, skinned_sources
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
    method = next(iter(verdict.normals or verdict.by_triangles or {"lbs": {}}))
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
    lacking = any(_lacks_normals(plain, source) for source in sources)
    ways: list[tuple[str, dict[str, Any]]] = []
    if corrects:
        from skinbake.commands.verify_correctives import corrected_verdict as measured

        if plain.asset.animations and options.methods == ("lbs",):  # which correctives are for
            ways.append(("--correctives auto", {"correctives": "auto"}))
            both = {"correctives": "auto", "morph_normals": True}
            ways += [("--correctives auto --morph-normals", both)] if lacking else []
    else:
        from skinbake.measure.lighting import lighting_of as measured

        ways.append((_default(document, sources), {}))
        if lacking:
            ways.append(("--morph-normals", {"morph_normals": True}))
        elif any(source.has_targets for source in sources):
            ways.append(("--morph-frames", {"morph_frames": True}))
        ways.append(("--neighbours extend", {"neighbours": "extend"}))
        ways += [("--gradients poses", {"gradients": "poses"})] if plain.asset.animations else []
    overflows, is_corrected = True, bool(corrective_notes(document))
    for words, chosen in ways:
        if "neighbours" in chosen and not overflows:
            continue
        held = plain.budget.held
        try:
            made = Baker(**chosen).bake_document(plain)
            figures = by_worse_truth(measured(made.document, options)) if made.is_baked else {}
        except SkinbakeError:
            continue
        finally:
            plain.budget.held = held  # of one at a time
        if not chosen:
            overflows = any(count.overflowing_vertices for _, count in made.primitives)
        if figures:
            without = " without --correctives" if is_corrected and not corrects else ""
            yield OtherBake(f"{words}{without}", figures[baked_lighting(figures)].mean)


def _lacks_normals(document: Document, source: PrimitiveSource) -> bool:
    try:
        return bool(targets_without_normal(document, source))
    except SkinbakeError:
        return False


def _default(document: Document, sources: list[PrimitiveSource]) -> str:
    """Return what the default bake has that the bake of a file lacks."""
    notes = [read_metadata(document, document.asset.counterpart(one).json) for one in sources]
    held = [note for note in notes if note is not None]
    found = []
    if any(note.get("gradients") != Gradients.RIG for note in held):
        found.append("--gradients rig")
    if any(note.get("encoding", Encoding.FLOAT32) != Encoding.FLOAT32 for note in held):
        found.append("--encoding float32")
    return " ".join(found) or "the defaults"
