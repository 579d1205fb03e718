"""Whether α and β are fresh whose fit cannot be made again.

They were fitted to poses which are not in the file, or not any more: those of ``--gradients poses``, or the
stored pose. Or an older version of the fit made them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.choices import Gradients
from skinbake.errors import Notice
from skinbake.format.digests import slots_digest
from skinbake.freshness.baked_views import BakedView
from skinbake.freshness.expected import noted_poses, rest_primitives_of, surface_slots
from skinbake.geometry.poses import is_fingerprint_of
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import Document
from skinbake.gltf.reading.accessors import read_attribute
from skinbake.gltf.reading.skins import fitting_rig
from skinbake.truth.areas import vertex_areas
from skinbake.truth.operator import GradientOperator, true_operator
from skinbake.version import FIT

BAKE_AGAIN = "run skinbake bake again"

WITHOUT_POSES = (
    "the poses of the fit are not in the file, so α/β were checked by their digest and their effect"
)

STORED_OTHERWISE = (
    "the nodes are stored in another pose than at the bake, so α/β were checked by their digest and their "
    "effect"
)

OLDER_FIT = (
    "α/β come from an older version of the fit. They are still right, by their effect; a new bake may light "
    "better"
)

NO_BETTER = 1.02
"""The tilt that fitted gradients may leave, relative to that of the surface's gradients.

A fit to other poses than the present ones left at most 0.9 of it on all models of the corpus.
"""

MANY_TIMES = 1000
"""Beyond it, a message gives no number of times: the error that it is measured against is rounding."""


def has_poses(document: Document, view: BakedView) -> bool:
    """Tell whether the poses of a fit follow from the file as it is now."""
    if view.kind is not Gradients.POSES or view.note.poses is None:
        return True
    return noted_poses(document, view).are(view.note.poses.fingerprint)


def is_stored_as_noted(document: Document, view: BakedView) -> bool:
    """Tell whether the nodes are stored in the pose to which α and β are fitted, if there is one."""
    if view.kind is Gradients.SURFACE or view.note.stored_pose is None:
        return True
    with document.notices.withheld():
        rig = fitting_rig(document, view.source)
    if rig is None or rig.fingerprint is None:
        return False
    return is_fingerprint_of(rig.fingerprint, view.note.stored_pose.fingerprint)


def has_older_fit(view: BakedView) -> bool:
    """Tell whether an older version of the fit made α and β."""
    return view.kind is not Gradients.SURFACE and (view.note.fit or 0) < FIT


def rig_changed(document: Document, view: BakedView) -> bool:
    """Tell whether the rig is another one than the noted one, or is gone."""
    if view.kind is Gradients.SURFACE or view.note.rig is None:
        return False
    with document.notices.withheld():
        rig = fitting_rig(document, view.source)
    return rig is None or rig.digest != view.note.rig


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
    if not is_stored_as_noted(document, view):
        gone = "the nodes are stored in another pose"
    elif not has_poses(document, view):
        gone = "the poses that α/β were fitted to are not in the file"
    else:
        gone = f"version {view.note.fit} of the fit made them, this skinbake has {FIT}"
    if view.changed:
        return f"{', '.join(view.changed)} changed since its bake, and {gone}: {BAKE_AGAIN}"
    if rig_changed(document, view):
        return f"The skeleton changed since the bake (its hierarchy or its bind pose): {BAKE_AGAIN}"
    attributes, place = view.source.attributes, view.source.place
    stored = {name: read_attribute(document, attributes, name, place).values for name in view.note.slot_names}
    noted = view.note.stored_pose or view.note.poses
    if noted and slots_digest(stored) != noted.slots:
        return f"α/β changed since its bake, and {gone}: {BAKE_AGAIN}"
    return None


def _without_effect(
    document: Document, views: Sequence[BakedView], operator: GradientOperator
) -> Iterator[str | None]:
    """Yield for each view why its α/β do not fit any poses, None if they may be one."""
    from skinbake.pose_fit.fit import tilts  # few files are fitted to poses

    groups = noted_poses(document, views[0]).groups
    true = true_operator(
        [view.now for view in views],
        claim=document.budget.welding(views[0].source.place),
    )
    slots = [(view.alpha.astype(np.float64), view.beta.astype(np.float64)) for view in views]
    stored = rest_primitives_of(document, views, slots)
    plain = rest_primitives_of(document, views, surface_slots(views, operator))
    both = [tilts(true, surfaces, groups) for surfaces in (stored, plain)]
    none: list[Float64Array] = []
    if any(view.note.kept for view in views):
        none = tilts(
            true, [replace(one, alpha=0.0 * one.alpha, beta=0.0 * one.beta) for one in stored], groups
        )
    what = "poses" if views[0].kind is Gradients.POSES else "the rig"
    for number, view in enumerate(views):
        areas = vertex_areas(view.now.positions, view.now.triangles)
        fitted, usual = (float(np.nansum(areas * found[number])) for found in both)
        if view.note.kept:  # without any α and β, light may have been better at the bake
            usual = max(usual, float(np.nansum(areas * none[number])))
        if fitted > NO_BETTER * usual:
            yield (
                f"α/β leave {_times(fitted, usual)} the error of the gradients of the surface, "
                f"although they are noted as fitted to {what}: {BAKE_AGAIN}"
            )
        else:
            yield None


def _times(error: float, usual: float) -> str:
    """Return in words how many times another error one error is. On a flat mesh the other one is near 0."""
    if error > MANY_TIMES * usual:
        return f"over {MANY_TIMES:,} times"
    return f"{error / usual:.3g} times"
