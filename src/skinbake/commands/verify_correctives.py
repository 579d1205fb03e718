"""``skinbake verify`` of a file with correctives: whether they fit the file, and how much they improve it."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

from skinbake.choices import PoseKind
from skinbake.commands.bake_options import DEFAULTS, OF_SURFACE
from skinbake.commands.gradient_bake import bake_gradients
from skinbake.errors import Notice
from skinbake.format.note import corrective_notes
from skinbake.format.strip import uncorrected
from skinbake.freshness.baked_views import left_on_purpose
from skinbake.freshness.corrective_freshness import (
    PlayedCorrectives,
    corrective_freshness,
    damaged_correctives,
)
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import skinned_sources, tell_half_skinned
from skinbake.measure.corrected import WORSE, corrected_lighting, mixtures, worse_primitives
from skinbake.measure.measured import bakeable
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import Check, FileVerdict, Mixture
from skinbake.timing import stage
from skinbake.wording import counted


def corrected_verdict(document: Document, options: VerifyOptions) -> FileVerdict:
    """Verify a document with correctives, as it is in memory. Raises InputError if it cannot be read.

    Standard lighting, the correctives, and what α and β would give are measured in the same poses.
    """
    begun = perf_counter()
    with stage("read"):
        sources = skinned_sources(document)
        tell_half_skinned(document)
        problems = list(damaged_correctives(document))
    if problems:
        return FileVerdict.damaged(document.name, problems)
    with stage("freshness"):
        fresh = corrective_freshness(document, sources)
        fresh, begun = replace(fresh, seconds=perf_counter() - begun), perf_counter()
    notes = corrective_notes(document).values()
    if all(note.character and note.plays == () for note in notes):
        of_others = "clips of other files play its correctives (bake --one-character)"
        elsewhere = Check("lighting", "skipped", (), of_others)
        return FileVerdict(document.name, (Check("structure", "passed"), fresh, elsewhere))
    with document.notices.withheld(), stage("α and β"):
        plain, _ = uncorrected(document)
        gradients = bake_gradients(plain, bakeable(plain), DEFAULTS).document
        if any(notice.code == "standard-is-better" for notice in gradients.notices):
            # The bake leaves a primitive to standard lighting: the paper's α and β leave none.
            plain, _ = uncorrected(document)
            gradients = bake_gradients(plain, bakeable(plain), OF_SURFACE).document
    played = PlayedCorrectives(document)
    verdict, drawn = corrected_lighting(played, gradients, options)
    targets = played.targets
    meshes = counted(len(targets), "mesh", "meshes")
    told = f"{counted(sum(targets.values()), 'corrective normal')} of {meshes}"
    told = "; ".join([told, *left_on_purpose(document).values()])
    structure = Check("structure", "passed", (), told)
    # That algorithms 2 and 3 agree says nothing of correctives.
    checks = [check for check in verdict.checks if check.name != "identity"]
    structure = replace(structure, seconds=perf_counter() - begun)  # with the measurement, which has no check
    for place, (before, after) in worse_primitives(verdict).items():
        change = f"from {before:.2f}° to {after:.2f}°: skinbake strip takes them out"
        message = f"its correctives make its lighting worse in these poses, {change}"
        document.notices.tell(Notice("correctives-worse", message, place))
    mixed: list[Mixture] = []
    with stage("mixtures"):
        for place, mixture in mixtures(played, drawn) if options.poses.kind is PoseKind.ANIMATION else ():
            mixed.append(mixture)
            if any(mixture.corrected[by] > WORSE * mixture.standard[by] for by in mixture.standard):
                message = f"its correctives are worse than standard lighting {mixture.words}"
                document.notices.tell(Notice("correctives-mixed", message, place))
    return replace(
        verdict,
        input=document.name,
        checks=(structure, fresh, *checks),
        mixtures=tuple(mixed),
    )
