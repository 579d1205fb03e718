"""The lighting of a document that has just been baked, measured as verify measures it."""

from __future__ import annotations

from collections.abc import Sequence

from skinbake.errors import BudgetError, InputError
from skinbake.freshness.baked_views import BakedView, baked_views, gathered_together
from skinbake.freshness.staleness import claim_freshness, surface_operator
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document
from skinbake.gltf.primitives import PrimitiveSource, reason_to_skip, skinned_sources
from skinbake.measure.draws import draws, true_surfaces
from skinbake.measure.measured import lighting_verdict
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import FileVerdict
from skinbake.truth.operator import GradientOperator


def bakeable(document: Document) -> list[PrimitiveSource]:
    """Return the skinned primitives that can be baked as they are."""
    every = skinned_sources(document)
    return [one for one in every if reason_to_skip(document, one, generate_normals=False) is None]


def surfaces_of(
    document: Document, views: Sequence[BakedView]
) -> tuple[list[list[BakedView]], list[GradientOperator]]:
    """Return baked primitives by surface, and the gradient operator of each surface."""
    surfaces = gathered_together(document, views)
    return surfaces, [surface_operator(document, surface) for surface in surfaces]


def lighting_of(document: Document, options: VerifyOptions) -> FileVerdict:
    """Return the lighting of a document that has just been baked. Its freshness is not in question."""
    with document.notices.withheld():
        views = baked_views(document, bakeable(document))
    return lighting_verdict(document, options, *surfaces_of(document, views))


def claim_verification(document: Document) -> None:
    """Count the work of verifying a document that has just been baked. Raises InputError if it is too much.

    Other faults of the document raise nothing: verify says them.
    """
    wanted = bakeable(document)
    claim_freshness(document, len(wanted))
    try:
        with document.notices.withheld():
            surfaces = surfaces_of(document, baked_views(document, wanted))
        draws(document, true_surfaces(document, *surfaces), read_clips(document), VerifyOptions().poses)
    except BudgetError:
        raise
    except InputError:
        pass
