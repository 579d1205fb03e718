"""The α and β that a bake of the present arrays would give, by the kind that the metadata notes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from skinbake.choices import SLOTS_PER_SET, Gradients, Weighting
from skinbake.errors import Place
from skinbake.format.encodings import shortened
from skinbake.format.former import former_attributes, former_sets
from skinbake.format.influences import with_limit
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import TINY_WEIGHT, UNIT, Float64Array, FloatArray, IntArray, SkinnedPrimitive
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.reading.accessors import read_attribute
from skinbake.gltf.reading.meshes import StoredInfluences, joints_of_skin, side_by_side
from skinbake.gradients.baker import EIGHTHS, slots_of_surface
from skinbake.gradients.influences import limited_slots
from skinbake.truth.mesh import free_slots
from skinbake.truth.operator import GradientOperator, expected_alpha_beta, true_operator

ROUNDING = 1e-6
"""The rounding of a weight that was decoded in float32, relative to it."""

Expected = list[tuple[Float64Array, Float64Array]]

Fit = Callable[[], Expected]
"""A fit to a rig that is prepared, or that another thread has begun."""


def expected_slots(
    document: Document,
    views: Sequence[BakedView],
    operator: GradientOperator,
    fit: Fit | None = None,
) -> Expected:
    """Return α and β (V, K − 1) of each view of one surface, of the noted kind.

    fit is the result of ``prepared_rig_fit``, if it is there already.

    The gradients of a surface come from the operator, which shares no code with bake. Fitted gradients come
    from bake's own loops: how good they are is measured against the true normals, not here.
    """
    if views[0].kind is Gradients.SURFACE:
        slots = surface_slots(views, operator)
    else:
        fit = fit or prepared_rig_fit(document, views, operator.weighting)
        slots = fit() if fit else surface_slots(views, operator)
    # An encoding has shortened what is beyond its scale.
    found: Expected = []
    for pair, view in zip(slots, views, strict=True):
        alpha, beta = shortened(*pair, np.inf if view.note.scale is None else view.note.scale)
        found.append((alpha.astype(np.float64, copy=False), beta.astype(np.float64, copy=False)))
    return found


def given_weights(document: Document, view: BakedView) -> Float64Array:
    """Return the weights (V, K) that adopted slots were given: all that are exactly the smallest ones.

    If the file still holds the weights from before the bake, only slots that were free then count. A slot is
    free too if its weight moves nothing. Where weights sum to little, what it was given is a large share.
    """
    weights = np.asarray(view.now.weights, dtype=np.float64)
    if view.note.adopted is None:
        return np.zeros(weights.shape)
    given = (weights == TINY_WEIGHT) | (np.abs(weights * UNIT - 1.0) < ROUNDING)
    before = former_weights(document, view)
    if before is not None and before.shape == given.shape:
        given &= free_slots(before)
    return np.where(given, weights, 0.0)


def former_weights(document: Document, view: BakedView) -> FloatArray | None:
    """Return the weights (V, K) before adoption, 0 in the slots of a set that the bake added.

    They are the noted ones, or what a limit makes of these. None if they are gone.
    """
    attributes, place = view.source.attributes, view.source.place
    former = former_attributes(document, attributes, view.note, place)
    if former is None:
        return None
    before = former_sets({**attributes, **former}, view.note)
    count = view.now.weights.shape[1] // SLOTS_PER_SET
    names = [name for name in (f"WEIGHTS_{number}" for number in range(count)) if name in before]
    if not names:
        return None
    # A limit takes sets away. So if none was added, the noted ones are from before a limit.
    if view.note.former_attributes is not None and len(names) == count:
        limited = _limited(document)
        if place not in limited:
            limited[place] = _limited_weights(document, view, before)
        return limited[place]
    stored = [read_attribute(document, before, name, place) for name in names]
    weights = np.concatenate([one.decoded() for one in stored], axis=1)
    return np.pad(weights, ((0, 0), (0, view.now.weights.shape[1] - weights.shape[1])))


@once_a_document
def _limited(document: Document) -> dict[Place, FloatArray]:
    """Return what a limit made of the noted weights, by primitive."""
    return {}


def _limited_weights(document: Document, view: BakedView, before: Mapping[str, Any]) -> FloatArray:
    """Return the weights (V, K) that a limit to K influences leaves of the sets before it."""
    sets: list[StoredInfluences] = []
    while f"JOINTS_{len(sets)}" in before:
        names = (f"JOINTS_{len(sets)}", f"WEIGHTS_{len(sets)}")
        sets.append(
            StoredInfluences(*(read_attribute(document, before, name, view.source.place) for name in names))
        )
    joints, weights = side_by_side(sets)
    whole = view.now.with_influences(joints_of_skin(joints, weights, view.source), weights)
    kept = limited_slots(whole, view.now.weights.shape[1])
    after = with_limit(sets, kept.slots, kept.shares, kept.rewritten)
    return np.concatenate([entry.weights.decoded() for entry in after], axis=1)


def surface_slots(views: Sequence[BakedView], operator: GradientOperator) -> Expected:
    """Return the gradients of the surface of each view, (V, K − 1)."""
    expected = expected_alpha_beta(
        operator,
        [view.now for view in views],
        [(view.tangents, view.bitangents) for view in views],
    )
    return [(alpha[:, 1:], beta[:, 1:]) for alpha, beta in expected]


def frames_of(views: Sequence[BakedView]) -> list[FloatArray]:
    """Return the tangents and the bitangents (V, 3) of all vertices of a surface."""
    return [np.concatenate([getattr(one, name) for one in views]) for name in ("tangents", "bitangents")]


def prepared_rig_fit(document: Document, views: Sequence[BakedView], weighting: Weighting) -> Fit | None:
    """Prepare the fit of the gradients of one surface to its poses and turns. None: no joint can turn.

    It gives α and β (V, K − 1) of each view, of the joints that the slots name. It no longer reads the
    document, so any thread may do it.
    """
    rig = noted_rig(document, views[0])
    if rig is None:
        return None
    crease_angle = float(np.radians(views[0].note.crease_angle))
    # Without the weights that bake gave to adopted slots.
    given = [given_weights(document, view) for view in views]
    primitives = [
        view.now.with_influences(view.now.joints, np.asarray(view.now.weights, dtype=np.float64) - own)
        for view, own in zip(views, given, strict=True)
    ]
    tangents, bitangents = (frame.astype(np.float64, copy=False) for frame in frames_of(views))
    # Bakes that keep all of α and β note nothing.
    kept = [round(EIGHTHS * (1.0 if view.note.kept is None else view.note.kept)) for view in views]

    def fit() -> Expected:
        slots = slots_of_surface(
            primitives,
            (tangents, bitangents),
            weighting=weighting,
            crease_angle=crease_angle,
            rig=rig,
            kept=kept,
        )
        return [(alpha.astype(np.float64), beta.astype(np.float64)) for alpha, beta in slots]

    return fit


def noted_rig(document: Document, view: BakedView) -> Rig | None:
    """Return the rig with the poses that the metadata names, as far as they are in the file. Files are not.

    None if no joint can turn.
    """
    from skinbake.truth.fit_poses import ANIMATIONS, is_random, posed_rig  # few files hold bakes

    named = (view.note.poses and view.note.poses.sources) or ()
    sources = tuple(source for source in named if source == ANIMATIONS or is_random(source))
    with document.notices.withheld():
        # Without a name the clips may be broken.
        return posed_rig(document, view.source, () if sources == (ANIMATIONS,) else sources)


NO_PAYMENT = 1e-7
"""Below this share, what adopted slots took is rounding: 2⁻³⁰ each, if FLOAT weights sum to 1."""


def before_adoption(document: Document, views: Sequence[BakedView]) -> list[SkinnedPrimitive]:
    """Return the primitives of a surface with the weights from before the bake.

    Copies of a vertex in two meshes may have adopted other joints, and integer weights paid a unit for each.
    They are one point of the surface all the same. Integer weights come back in whole units.
    """
    given = [given_weights(document, view) for view in views]
    paid = [paid_share(view, own).max(initial=0.0) for view, own in zip(views, given, strict=True)]
    if max(paid) < NO_PAYMENT:
        return [view.now for view in views]
    return [
        replace(view.now, weights=weights_before(view.now, own))
        for view, own in zip(views, given, strict=True)
    ]


def paid_share(view: BakedView, given: Float64Array) -> Float64Array:
    """Return the share of each vertex's weights (V,) that adopted slots were given, (V, K)."""
    whole = np.maximum(view.now.weights, 0.0).sum(axis=1, dtype=np.float64)
    share: Float64Array = np.divide(given.sum(axis=1), whole, out=np.zeros(len(whole)), where=whole > 0.0)
    return share


def true_operator_of(document: Document, views: Sequence[BakedView]) -> GradientOperator:
    """Build the operator of the truths for one surface, with the weights from before the bake.

    The settings of the bake do not change it. The memory that welding adds counts to the document's budget.
    Raises InputError if it is too much for the file.
    """
    return true_operator(
        before_adoption(document, views),
        claim=document.budget.welding(views[0].source.place),
    )


def weights_before(
    primitive: SkinnedPrimitive, given: Float64Array, former: FloatArray | None = None
) -> FloatArray:
    """Return the weights (V, K) as bake read them, without the given ones (V, K) of ``given_weights``.

    former are the ``former_weights`` (V, K), if there are any. They count at each vertex at which adoption
    makes the present weights of them. Nothing paid for weights that were given to FLOAT slots.
    """
    weights = primitive.weights
    if given.max(initial=0.0) <= TINY_WEIGHT:
        return np.where(given > 0.0, 0.0, weights)
    found = returned(weights, given, primitive.joints)
    if former is None or former.shape != found.shape:
        return found
    due = np.rint(UNIT * former) - np.rint(UNIT * (np.asarray(weights, dtype=np.float64) - given))
    paid_by_one = np.count_nonzero(due, axis=1) <= 1
    explains = paid_by_one & (due.sum(axis=1) == np.rint(UNIT * given.sum(axis=1)))
    return np.where(explains[:, None], former, found)


def returned(weights: FloatArray, given: Float64Array, joints: IntArray) -> Float64Array:
    """Return weights (V, K) with the given ones (V, K) back where they came from.

    The largest weight paid, of equal ones that of the lowest joint. Of all weights that may have been it, the
    smallest one is taken: two copies that paid different amounts then agree, but for a few ties.
    """
    units = np.rint(UNIT * (np.asarray(weights, dtype=np.float64) - given))
    paid = np.rint(UNIT * given.sum(axis=1))
    largest = units + paid[:, None] >= units.max(axis=1, keepdims=True)
    least = np.where(largest, units, np.inf)
    equal = least == least.min(axis=1, keepdims=True)
    payer = np.where(equal, joints.astype(np.int64), np.iinfo(np.int64).max).argmin(axis=1)
    units[np.arange(len(units)), payer] += paid
    return units / UNIT
