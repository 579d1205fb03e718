"""Whether baked primitives are fresh, and if they are not, what was done to them since."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from skinbake.commands.baked_views import BakedView
from skinbake.errors import InputError, Notice
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.document import Document
from skinbake.verify import freshness
from skinbake.verify.operator import GradientOperator, expected_alpha_beta, gradient_operator

WEIGHTINGS = ("max", "angle", "area", "angle-area")
BAKE_LAST = "bake last: run skinbake bake on what the last tool wrote"


def mesh_operator(views: Sequence[BakedView], weighting: str | None = None) -> GradientOperator:
    """Return the gradient operator of one mesh, weighted as its metadata says or as ``weighting`` does."""
    noted = views[0].metadata
    chosen: Any = weighting or noted.get("weighting")
    crease = noted.get("creaseAngle")
    if chosen not in WEIGHTINGS or not isinstance(crease, int | float):
        raise InputError(
            "its metadata names no weighting or crease angle that is known", views[0].source.place
        )
    return gradient_operator(
        [view.before for view in views], weighting=chosen, crease_angle_degrees=float(crease)
    )


def staleness(document: Document, views: Sequence[BakedView], operator: GradientOperator) -> list[Notice]:
    """Return a problem for each primitive of one mesh whose α/β are not those of its present arrays."""
    problems = []
    for view, comparison in zip(views, _comparisons(views, operator), strict=True):
        if view.changed or not comparison.agrees:
            problems.append(_staleness_notice(document, view, views, comparison))
    return problems


def _comparisons(views: Sequence[BakedView], operator: GradientOperator) -> list[freshness.Comparison]:
    expected = expected_alpha_beta(
        operator,
        [view.before for view in views],
        [(view.tangents, view.bitangents) for view in views],
        named=[view.now for view in views],
    )
    return [
        freshness.compare((view.alpha, view.beta), (alpha[:, 1:], beta[:, 1:]))
        for view, (alpha, beta) in zip(views, expected, strict=True)
    ]


def _staleness_notice(
    document: Document, view: BakedView, views: Sequence[BakedView], comparison: freshness.Comparison
) -> Notice:
    what = _likely_cause(document, view, views, comparison)
    changed = f"{', '.join(view.changed)} changed since its bake; " if view.changed else ""
    differ = (
        "α/β still fit"
        if comparison.agrees
        else f"α/β are wrong at {comparison.differing:,} of {len(view.alpha):,} vertices "
        f"(by up to {comparison.largest:.2g} of the vertex's largest, at vertex {comparison.worst})"
    )
    return Notice("stale", f"{changed}{differ}. {what}", view.source.place, comparison.differing)


def _likely_cause(
    document: Document, view: BakedView, views: Sequence[BakedView], comparison: freshness.Comparison
) -> str:
    """Say what the difference looks like, and what to do."""
    if view.changed:
        causes = _changes_of_tools(document, view, comparison)
        return f"It looks {' and '.join(causes) or 'edited'} after its bake: {BAKE_LAST}"
    if comparison.factor is not None:
        return f"All of them are {comparison.factor:.4g} times what they should be: bake again"
    if comparison.reordered:
        return "They stand in the wrong slots: bake again"
    weighting = _weighting_that_fits(view, views)
    if weighting is not None:
        return f'They were made with the weighting "{weighting}", not as its metadata says: bake again'
    return "α/β themselves were edited or damaged: bake again"


def _changes_of_tools(document: Document, view: BakedView, comparison: freshness.Comparison) -> list[str]:
    """Return which of the usual tools' doings explain the arrays that changed."""
    causes = []
    position = read_accessor(document, view.source.attributes["POSITION"], view.source.place).values
    if "POSITION" in view.changed and position.dtype.kind != "f":
        causes.append("quantised")
    if "POSITION" in view.changed and comparison.factor:
        causes.append(f"rescaled by {comparison.factor:.4g}")
    if {"JOINTS", "WEIGHTS"} & set(view.changed) and (comparison.reordered or _sorted_by_weight(view)):
        causes.append("its influences re-sorted")
    if view.changed == ("indices",) and comparison.agrees:
        causes.append("re-indexed")
    return causes


def _weighting_that_fits(view: BakedView, views: Sequence[BakedView]) -> str | None:
    for weighting in WEIGHTINGS:
        if weighting != view.metadata.get("weighting"):
            comparisons = _comparisons(views, mesh_operator(views, weighting))
            if comparisons[list(views).index(view)].agrees:
                return weighting
    return None


def _sorted_by_weight(view: BakedView) -> bool:
    return bool((np.diff(view.now.weights, axis=1) <= 0).all())
