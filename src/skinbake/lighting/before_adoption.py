"""The weights of a baked file as they were before bake gave some of them to the slots that it adopted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skinbake.format.adoption import TINY_WEIGHT, UNIT
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray, SkinnedPrimitive
from skinbake.gltf.document import Document
from skinbake.lighting.baked_views import BakedView
from skinbake.lighting.expected import given_weights
from skinbake.lighting.operator import GradientOperator, true_operator

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
        claim=lambda size: document.budget.claim_welding(size, views[0].source.place),
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
