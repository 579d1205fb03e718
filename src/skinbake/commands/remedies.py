"""Where α and β make lighting worse, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from skinbake.choices import Gradients
from skinbake.errors import Chosen, Message, Notice, Place
from skinbake.freshness.baked_views import BakedView
from skinbake.gltf.document import Document
from skinbake.measure.guard import UNSEEN
from skinbake.report.verify import FileVerdict, gain
from skinbake.wording import gain_in_words

WORSE = 0.995
"""The gain below which lighting is worse. A loss of half a percent is too small for a notice."""

_LightingOf = tuple[str, str]
"""A skinning method and a lighting of it."""

_Gains = dict[_LightingOf, float]
"""The gains of a primitive, each by the worse truth."""

LBS_ACCURATE: _LightingOf = ("lbs", "accurate")
DQS_ACCURATE: _LightingOf = ("dqs", "accurate")
DQS_EXACT: _LightingOf = ("dqs", "exact")


def tell_worse_lighting(
    document: Document,
    views: Sequence[BakedView],
    verdict: FileVerdict,
    methods: Sequence[str] = ("lbs", "dqs", "blend"),
) -> None:
    """Tell of each primitive whose lighting α/β make worse, by one of the methods.

    Accurate and exact lighting of dual quaternions read the same α and β: the better one counts. The default
    bake compares its lighting with standard lighting, and so it is the remedy for all other bakes. It is the
    remedy of the whole file, and no file is lit worse by it. So is a bake that was measured to be better.
    """
    by_place = {view.source.place: view for view in views}
    better = verdict.others[0].options if verdict.others else None
    for place, gains in _gains(verdict, methods).items():
        if gains[_least(gains)] < WORSE:
            # Whether the bake compared its lighting with standard lighting.
            view = by_place.get(place)
            guarded = view is None or view.kind is Gradients.FITTED
            message = _worse(gains, is_guarded=guarded, better=better)
        elif gains.get(DQS_ACCURATE, WORSE) < WORSE:
            message = _exact_is_better(gains)
        else:
            continue
        document.notices.tell(Notice("lighting-worse", message, place))


def _gains(verdict: FileVerdict, methods: Sequence[str]) -> dict[Place, _Gains]:
    """Return the gains of the primitives that have any by the methods."""
    found: dict[Place, _Gains] = {}
    for place, normals in verdict.primitives:
        own = found.setdefault(place, {})
        for method, figures in normals.items():
            if method not in methods or gain(figures) is None:
                continue
            for lighting in sorted({"accurate", "exact"} & set(figures)):
                factor = gain(figures, lighting)
                factor = math.inf if factor is None else factor  # None: but for rounding it is right
                if figures[lighting].p99 < UNSEEN:
                    factor = max(factor, 1.0)
                own[method, lighting] = min(factor, own.get((method, lighting), math.inf))
    return {place: gains for place, gains in found.items() if gains}


def _least(gains: _Gains) -> _LightingOf:
    """Return the method that gains less, and its better lighting."""
    ranked = sorted(gains, key=gains.__getitem__)
    better = {method: (method, lighting) for method, lighting in ranked}
    return min(better.values(), key=gains.__getitem__)


def _worse(own: _Gains, *, is_guarded: bool, better: str | None) -> str:
    """Return what is told of a primitive. is_guarded: its bake was held to standard lighting already.

    ``better`` are the options of a bake that lights the file better.
    """
    lbs, least = own.get(LBS_ACCURATE, 0.0), _least(own)
    only_dqs = lbs >= WORSE
    called = "exact DQS" if least == DQS_EXACT else least[0].upper()
    message = f"α/β make its lighting worse: the {called} gain is {gain_in_words(own[least])}"
    message += f", and the LBS gain is {gain_in_words(lbs)}. " if only_dqs else ". "
    if better is not None and not only_dqs:
        return f"{message}A bake with {better} lights the file better"
    if not is_guarded and not only_dqs:
        fitted = Chosen("gradients", Gradients.FITTED)
        advice = ", compares itself with standard lighting in the file's own clips: bake so"
        return Message(f"{message}The default, ", fitted, advice)
    other = "Blended" if least[0] == "blend" else "With dual quaternions"
    message += f"{other}, light" if only_dqs else "Light"
    return f"{message} it the standard way (in skinbake-three: lighting(mesh, 'standard'))"


def _exact_is_better(own: _Gains) -> str:
    """Return what is told of a primitive whose lighting only accurate dual quaternions make worse."""
    accurate, exact = own[DQS_ACCURATE], own[DQS_EXACT]
    better = "is right" if math.isinf(exact) else f"gains {gain_in_words(exact)}"
    message = (
        "accurate lighting of dual quaternions makes it worse: the DQS gain is "
        f"{gain_in_words(accurate)}. Exact lighting {better}: take that with dual quaternions, as skinbake "
        "shader --method dqs does"
    )
    lbs = own.get(LBS_ACCURATE)
    return message + ("" if lbs is None else f". The LBS gain is {gain_in_words(lbs)}")
