"""The lighting of a document that has just been baked, measured as verify measures it."""

from __future__ import annotations

from skinbake.errors import BudgetError, InputError
from skinbake.freshness.baked_views import baked_views
from skinbake.freshness.staleness import claim_freshness
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import reason_to_skip, skinned_sources
from skinbake.measure.measured import Measurement
from skinbake.measure.options import VerifyOptions
from skinbake.measure.scene import Scene
from skinbake.report.verify import FileVerdict

BY_LBS = VerifyOptions(methods=("lbs",))
"""How the lighting of a bake is measured: by linear blend skinning, in the poses of the file."""


def bakeable(document: Document) -> list[PrimitiveSource]:
    """Return the skinned primitives that can be baked as they are."""
    every = skinned_sources(document)
    return [one for one in every if reason_to_skip(document, one, generate_normals=False) is None]


def lighting_of(document: Document, options: VerifyOptions = BY_LBS) -> FileVerdict:
    """Return the lighting of a document that has just been baked. Its freshness is not in question."""
    with document.notices.withheld():
        views = baked_views(document, bakeable(document))
    return Measurement(Scene.of_bakes(document, views), options).verdict()


def claim_verification(document: Document) -> None:
    """Count the work of verifying a document that has just been baked. Raises InputError if it is too much.

    Other faults of the document raise nothing: verify says them.
    """
    wanted = bakeable(document)
    claim_freshness(document, len(wanted))
    try:
        with document.notices.withheld():
            views = baked_views(document, wanted)
        Scene.of_bakes(document, views).measured(read_clips(document), VerifyOptions().poses)
    except BudgetError:
        raise
    except InputError:
        pass
