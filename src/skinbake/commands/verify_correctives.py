"""``skinbake verify`` of a file with correctives: whether they fit the file, and how much they improve it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.choices import PoseKind
from skinbake.commands.bake import Baker
from skinbake.errors import Notice, Place
from skinbake.format.metadata import corrective_notes
from skinbake.format.strip import uncorrected
from skinbake.freshness.made_targets import made_states
from skinbake.gltf.animation import Clip
from skinbake.gltf.budget import Work
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, is_number, text
from skinbake.gltf.primitives import PrimitiveSource, read_primitive, skinned_sources, tell_half_skinned
from skinbake.measure.corrected import WORSE, corrected_lighting, worse_primitives
from skinbake.measure.options import VerifyOptions
from skinbake.measure.played_correctives import (
    BAKE,
    NUMBERS,
    SAME,
    changed_since,
    damaged_correctives,
    played_clips,
)
from skinbake.report.verify import Check, FileVerdict, Mixture
from skinbake.timing import stage
from skinbake.wording import counted


def corrected_verdict(document: Document, options: VerifyOptions) -> FileVerdict:
    """Verify a document with correctives, as it is in memory. Raises InputError if it cannot be read.

    Standard lighting, the correctives, and what α and β would give are measured in the same poses.
    """
    with stage("read"):
        sources = skinned_sources(document)
        with document.notices.withheld() as notices:
            tell_half_skinned(document)
        problems = list(damaged_correctives(document))
    if problems:
        structure = Check("structure", "failed", tuple(problems))
        skipped = [Check(name, "skipped", (), "structure failed") for name in ("freshness", "lighting")]
        return FileVerdict(document.name, (structure, *skipped), notices=tuple(notices))
    with stage("freshness"):
        fresh = _freshness(document, sources)
    with document.notices.withheld(), stage("α and β"):
        plain, _ = uncorrected(document)
        gradients = Baker().bake_document(plain).document
    verdict, measured = corrected_lighting(document, gradients, options)
    if measured is None:
        return verdict
    targets = measured.played.targets
    meshes = counted(len(targets), "mesh", "meshes")
    told = f"{counted(sum(targets.values()), 'corrective normal')} of {meshes}"
    structure = Check("structure", "passed", (), told)
    # That algorithms 2 and 3 agree says nothing of correctives.
    checks = [check for check in verdict.checks if check.name != "identity"]
    worse = []
    for place, (before, after) in worse_primitives(verdict).items():
        change = f"from {before:.2f}° to {after:.2f}°: skinbake strip takes them out"
        message = f"its correctives make its lighting worse in these poses, {change}"
        worse.append(Notice("correctives-worse", message, place))
    mixtures: list[Mixture] = []
    with stage("mixtures"):
        for place, mixture in measured.mixtures() if options.poses.kind is PoseKind.ANIMATION else ():
            mixtures.append(mixture)
            if any(mixture.corrected[by] > WORSE * mixture.standard[by] for by in mixture.standard):
                message = f"its correctives are worse than standard lighting {mixture.words}"
                worse.append(Notice("correctives-mixed", message, place))
    return replace(
        verdict,
        input=document.name,
        checks=(structure, fresh, *checks),
        notices=(*notices, *verdict.notices, *worse),
        mixtures=tuple(mixtures),
    )


def _freshness(document: Document, sources: Sequence[PrimitiveSource]) -> Check:
    """Return whether meshes, targets, weights and clips are those of the bake."""
    problems = [state.notice for state in made_states(document) if state.changed]
    moved: dict[str, None] = {}
    for source in sources:
        note = corrective_notes(document).get(source.mesh)
        if note is None:
            continue
        changed, fit = changed_since(document, source, read_primitive(document, source), note)
        if fit:
            moved |= dict.fromkeys(changed)
        elif changed:
            message = f"{' and '.join(changed)} changed since the bake of its correctives: {BAKE}"
            problems.append(Notice("stale", message, source.place))
        else:
            message = f"its corrective normals are not those of the bake any more: {BAKE}"
            problems.append(Notice("stale-targets", message, source.place))
    for number, note in corrective_notes(document).items():
        place = Place(document.name, number, text(document.objects("meshes")[number], "name", document.place))
        stale = dict.fromkeys(_stale_clips(document, number, note))
        problems += [Notice("stale-clips", f"{message}: {BAKE}", place) for message in stale]
    remark = f"{', '.join(moved)} changed since the bake, and the correctives still fit" if moved else ""
    return Check("freshness", "failed" if problems else "passed", tuple(problems), remark)


def _stale_clips(document: Document, mesh: int, note: JsonObject) -> Iterator[str]:
    """Yield what is wrong if clips play correctives of a mesh in other poses than those of the bake.

    Names, numbers and the order of clips do not count, nor do clips that are gone.
    """
    rows = note.get("plays")
    rows = [one for one in rows if isinstance(one, list)] if isinstance(rows, list) else []
    width = 2 * NUMBERS
    noted = np.array(
        [one for one in rows if len(one) == width and all(map(is_number, one))], dtype=np.float64
    ).reshape(-1, width)
    found = played_clips(document, mesh, int(note["targets"]))
    if not any(one.plays for one in found):
        yield "no clip plays its correctives any more"
    steps = 1 + noted.size // 1000
    document.budget.claim(Work(steps=steps * len(found)), "comparing what its clips play", document.place)
    is_played, silent = np.zeros(len(noted), dtype=np.bool_), dict[int, Clip]()
    for one in found:
        same = np.abs(noted - [*one.poses, *one.weights]) <= SAME
        in_poses = same[:, :NUMBERS].all(axis=1)
        is_noted = in_poses & same[:, NUMBERS:].all(axis=1)
        is_played |= is_noted
        if not one.plays:
            silent |= dict.fromkeys(np.flatnonzero(in_poses).tolist(), one.clip)
        elif not is_noted.any():
            if in_poses.any():
                yield f'clip "{one.clip.name}" plays its correctives by other weights than those of the bake'
            else:
                yield f'clip "{one.clip.name}" or its rig changed since the bake of its correctives'
    for number, clip in silent.items():
        if not is_played[number]:
            yield f'clip "{clip.name}" does not play its correctives any more'
