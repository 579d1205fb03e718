"""The α and β that a bake of the present arrays would give, by the kind that the metadata notes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import SLOTS_PER_SET, Gradients, Weighting
from skinbake.format.adoption import TINY_WEIGHT, UNIT
from skinbake.format.former import former_attributes, former_sets
from skinbake.format.metadata import FORMER_ATTRIBUTES, POSES, STORED_POSE
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import integer
from skinbake.gltf.rigs import fitting_rig
from skinbake.gradients.baker import slots_of_surface
from skinbake.lighting.baked_views import BakedView
from skinbake.lighting.influences import free_slots
from skinbake.lighting.operator import GradientOperator, expected_alpha_beta, true_operator
from skinbake.lighting.rest_primitives import rest_primitive
from skinbake.skinning.rest import RestPrimitive

if TYPE_CHECKING:
    from skinbake.lighting.poses_to_fit import FoundPoses

ROUNDING = 1e-6
"""The rounding of a weight that was decoded in float32, relative to it."""

Expected = list[tuple[Float64Array, Float64Array]]

Fit = Callable[[], Expected]
"""A fit to a rig that is prepared, or that another thread has begun."""


def expected_slots(
    document: Document,
    views: Sequence[BakedView],
    operator: GradientOperator,
    kind: Gradients | None = None,
    fit: Fit | None = None,
) -> Expected:
    """Return α and β (V, K − 1) of each view of one surface, of the kind that is noted if none is given.

    fit is the result of ``prepared_rig_fit``, if it is there already.

    The gradients of a surface come from the operator, which shares no code with bake. Fitted gradients come
    from bake's own loops: how good they are is measured against the true normals, not here.
    """
    kind = kind or noted_kind(views[0])
    if kind is Gradients.SURFACE:
        return surface_slots(views, operator)
    fit = fit or prepared_rig_fit(document, views, operator.weighting)
    slots = fit() if fit else surface_slots(views, operator)
    return slots if kind is Gradients.RIG else posed_slots(document, views, slots)


def given_weights(document: Document, view: BakedView) -> Float64Array:
    """Return the weights (V, K) that adopted slots were given: all that are exactly the smallest ones.

    If the file still holds the weights from before the bake, only slots that were free then count. A slot is
    free too if its weight moves nothing. Where weights sum to little, what it was given is a large share.
    """
    weights = np.asarray(view.now.weights, dtype=np.float64)
    if "adopted" not in view.metadata:
        return np.zeros(weights.shape)
    given = (weights == TINY_WEIGHT) | (np.abs(weights * UNIT - 1.0) < ROUNDING)
    before = former_weights(document, view)
    if before is not None and before.shape == given.shape:
        given &= free_slots(before)
    return np.where(given, weights, 0.0)


def former_weights(document: Document, view: BakedView) -> FloatArray | None:
    """Return the weights (V, K) before the bake, 0 in the slots of a set that it added.

    None if they are gone, or if a limit changed their slots.
    """
    attributes, place = view.source.attributes, view.source.place
    former = former_attributes(document, attributes, view.metadata, place)
    if former is None:
        return None
    before = former_sets({**attributes, **former}, view.metadata)
    count = view.now.weights.shape[1] // SLOTS_PER_SET
    names = [name for name in (f"WEIGHTS_{number}" for number in range(count)) if name in before]
    # A limit takes sets away. So if none was added, the noted ones are from before a limit.
    if not names or (FORMER_ATTRIBUTES in view.metadata and len(names) == count):
        return None
    numbers = [integer(before, name, place) for name in names]
    weights = np.concatenate([read_accessor(document, number, place).decoded() for number in numbers], axis=1)
    return np.pad(weights, ((0, 0), (0, view.now.weights.shape[1] - weights.shape[1])))


def _without_given_weights(document: Document, view: BakedView) -> SkinnedPrimitive:
    """Return the primitive without the weights that bake gave to adopted slots (``given_weights``)."""
    weights = np.asarray(view.now.weights, dtype=np.float64) - given_weights(document, view)
    return view.now.with_influences(view.now.joints, weights)


def noted_kind(view: BakedView) -> Gradients:
    """Return the kind of α and β. Files of older versions do not name it."""
    return Gradients(view.metadata.get("gradients", Gradients.SURFACE))


def surface_slots(views: Sequence[BakedView], operator: GradientOperator) -> Expected:
    """Return the gradients of the surface of each view, (V, K − 1)."""
    expected = expected_alpha_beta(
        operator,
        [view.now for view in views],
        [(view.tangents, view.bitangents) for view in views],
    )
    return [(alpha[:, 1:], beta[:, 1:]) for alpha, beta in expected]


def prepared_rig_fit(document: Document, views: Sequence[BakedView], weighting: Weighting) -> Fit | None:
    """Prepare the fit of the gradients of one surface to its rig. None: no joint of it can turn.

    It gives α and β (V, K − 1) of each view, of the joints that the slots name. It no longer reads the
    document, so any thread may do it.
    """
    rig, _ = fitting_rig(document, views[0].source)
    if rig is None:
        return None
    if STORED_POSE not in views[0].metadata:
        rig = replace(rig, stored=None)
    crease_angle = float(np.radians(views[0].metadata["creaseAngle"]))
    primitives = [_without_given_weights(document, view) for view in views]
    tangents = np.concatenate([np.asarray(view.tangents, dtype=np.float64) for view in views])
    bitangents = np.concatenate([np.asarray(view.bitangents, dtype=np.float64) for view in views])

    def fit() -> Expected:
        slots = slots_of_surface(
            primitives, (tangents, bitangents), weighting=weighting, crease_angle=crease_angle, rig=rig
        )
        found, start = [], 0
        for vertices, width in (primitive.joints.shape for primitive in primitives):
            own = slice(start, start + vertices), slice(width - 1)
            found.append((slots.alpha[own].astype(np.float64), slots.beta[own].astype(np.float64)))
            start += vertices
        return found

    return fit


def posed_slots(document: Document, views: Sequence[BakedView], slots: Expected) -> Expected:
    """Return α and β (V, K − 1) of each view fitted to the noted poses, from those fitted to the rig."""
    from skinbake.lighting.pose_fit import fitted_to_poses  # few files are fitted to poses

    found = noted_poses(document, views[0])
    return fitted_to_poses(
        true_operator([_without_given_weights(document, view) for view in views]),
        rest_primitives_of(document, views, slots),
        found.groups,
    )


def rest_primitives_of(
    document: Document, views: Sequence[BakedView], slots: Expected
) -> list[RestPrimitive]:
    """Return the views as a replay reads them, without the weights of adoption, and with other α and β."""
    return [
        rest_primitive(replace(view, now=_without_given_weights(document, view), alpha=alpha, beta=beta))
        for view, (alpha, beta) in zip(views, slots, strict=True)
    ]


def noted_poses(document: Document, view: BakedView) -> FoundPoses:
    """Return the poses that the metadata names, as far as they are in the file. Files are not."""
    from skinbake.lighting.poses_to_fit import poses_to_fit

    return poses_to_fit(document, view.source.mesh, noted_sources(view), view.source.place)


def noted_sources(view: BakedView) -> tuple[str, ...]:
    """Return the sources of the poses that the metadata names, without files."""
    from skinbake.lighting.poses_to_fit import ANIMATIONS, is_random

    named = view.metadata.get(POSES, {}).get("from", ())
    return tuple(source for source in named if source == ANIMATIONS or is_random(source))
