"""Whether α and β are fresh that were fitted to poses which are not in the file, or not any more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from skinbake.choices import Gradients
from skinbake.errors import Notice
from skinbake.format.metadata import POSES, slot_names, slots_digest
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.document import Document
from skinbake.gltf.rigs import fitting_rig
from skinbake.lighting.baked_views import BakedView
from skinbake.lighting.expected import noted_kind, noted_poses, rest_primitives_of, surface_slots
from skinbake.lighting.metrics import vertex_areas
from skinbake.lighting.operator import GradientOperator, true_operator

BAKE_AGAIN = "run skinbake bake again"

WITHOUT_POSES = (
    "the poses of the fit are not in the file, so α/β were checked by their digest and their effect"
)

NO_BETTER = 1.02
"""The tilt that fitted gradients may leave, relative to that of the surface's gradients.

A fit to other poses than the present ones left at most 0.9 of it on all models of the corpus.
"""


def has_poses(document: Document, view: BakedView) -> bool:
    """Tell whether the poses of a fit follow from the file as it is now."""
    return noted_poses(document, view).are(view.metadata[POSES]["fingerprint"])


def rig_changed(document: Document, view: BakedView) -> bool:
    """Tell whether the rig is another one than the noted one, or is gone."""
    if noted_kind(view) is Gradients.SURFACE or "rig" not in view.metadata:
        return False
    rig, _ = fitting_rig(document, view.source)
    return rig is None or rig.digest != view.metadata.get("rig")


def problems_without_poses(
    document: Document, views: Sequence[BakedView], operator: GradientOperator
) -> Iterator[Notice]:
    """Yield a problem for each view of a surface whose arrays or α/β changed, or whose α/β do not help."""
    problems = {view.source.place: _change(document, view) for view in views}
    if not any(problems.values()):
        problems = dict(zip(problems, _without_effect(document, views, operator), strict=True))
    for place, problem in problems.items():
        if problem is not None:
            yield Notice("stale", problem, place)


def _change(document: Document, view: BakedView) -> str | None:
    """Return what changed since the bake, None for nothing."""
    gone = "the poses that α/β were fitted to are not in the file"
    if view.changed:
        return f"{', '.join(view.changed)} changed since its bake, and {gone}: {BAKE_AGAIN}"
    if rig_changed(document, view):
        return f"The skeleton changed since the bake (its hierarchy or its bind pose): {BAKE_AGAIN}"
    attributes, place = view.source.attributes, view.source.place
    stored = {
        name: read_accessor(document, attributes[name], place).values for name in slot_names(view.metadata)
    }
    if slots_digest(stored) != view.metadata[POSES]["slots"]:
        return f"α/β changed since its bake, and {gone}: {BAKE_AGAIN}"
    return None


def _without_effect(
    document: Document, views: Sequence[BakedView], operator: GradientOperator
) -> Iterator[str | None]:
    """Yield for each view why its α/β are no fit to any poses, None if they may be one."""
    from skinbake.lighting.pose_fit import tilts  # few files are fitted to poses

    groups = noted_poses(document, views[0]).groups
    true = true_operator(
        [view.now for view in views],
        claim=lambda size: document.budget.claim_welding(size, views[0].source.place),
    )
    slots = [(view.alpha.astype(np.float64), view.beta.astype(np.float64)) for view in views]
    stored = rest_primitives_of(document, views, slots)
    plain = rest_primitives_of(document, views, surface_slots(views, operator))
    both = [tilts(true, surfaces, groups) for surfaces in (stored, plain)]
    for number, view in enumerate(views):
        areas = vertex_areas(view.now.positions, view.now.triangles)
        fitted, usual = (float(np.nansum(areas * found[number])) for found in both)
        if fitted > NO_BETTER * usual:
            yield (
                f"α/β leave {fitted / usual:.3g} times the error of the gradients of the surface, "
                f"although they are noted as fitted to poses: {BAKE_AGAIN}"
            )
        else:
            yield None
