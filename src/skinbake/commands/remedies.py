"""Options that improve the lighting if a bake makes it worse. They are tried on the file itself."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from skinbake.choices import FrameChoice, Gradients, Neighbours, Weld
from skinbake.errors import InputError, Notice, Place
from skinbake.freshness.baked_views import BakedView, gathered_together, sound_views
from skinbake.freshness.expected import noted_kind, noted_sources
from skinbake.freshness.staleness import surface_operator
from skinbake.gltf.document import Document
from skinbake.measure.measured import lighting_verdict
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import BAKE_SO, LITTLE, FileVerdict, Normals, gain
from skinbake.wording import gain_in_words

if TYPE_CHECKING:
    from skinbake.commands.bake import Baker

WORSE = 0.995
"""The gain below which lighting is worse. A loss of half a percent is too small for a notice."""

UNSEEN = 0.1
"""The degrees that the 99th percentile of the error must reach for lighting to be worse.

A smaller angle changes a light's cosine by less than half a step of 8 bits.
"""

KEPT = 0.98
"""The share of the gain all in all that a remedy must keep."""


@dataclass(frozen=True, slots=True)
class Remedy:
    """Options of bake, as a user types them, and the settings that they stand for."""

    words: str
    gradients: Gradients | None = None
    neighbours: Neighbours | None = None
    crease_angle: float | None = None

    def applied(self, baker: Baker) -> Baker:
        """Return a baker with the options of the remedy."""
        return replace(
            baker if self.gradients is None else baker.with_gradients(self.gradients),
            neighbours=baker.neighbours if self.neighbours is None else self.neighbours,
            crease_angle=baker.crease_angle if self.crease_angle is None else self.crease_angle,
        )


DROP, NO_CREASE = "--neighbours drop", "--crease-angle 180"
REMEDIES = (
    Remedy("--gradients rig", Gradients.RIG),
    Remedy("--gradients surface", Gradients.SURFACE),
    Remedy(DROP, neighbours=Neighbours.DROP),
    Remedy(NO_CREASE, crease_angle=180.0),
    Remedy(f"{DROP} {NO_CREASE}", neighbours=Neighbours.DROP, crease_angle=180.0),
)
"""The options that help on primitives of real models that a bake lights worse."""

LAST = Remedy("--gradients poses", Gradients.POSES)
"""The remedy that takes the longest to try, so only where no other one helps much.

``--weld skin`` and ``--neighbours extend`` help on none of these primitives.
"""


def worse_lighting(
    document: Document, views: Sequence[BakedView], verdict: FileVerdict, options: VerifyOptions
) -> list[Notice]:
    """Return a notice for each primitive whose lighting α/β make worse, with an option that was tried.

    Accurate and exact lighting of dual quaternions read the same α and β: the better one counts. A remedy is
    named if it brings the gain to 1 at that primitive, by all methods and truths. It is advised if it brings
    ``LITTLE``, and if the meshes with such primitives keep their gain all in all. The file is baked once more
    for each remedy that differs from its own settings, so at most six times, and these meshes are measured.
    A file without such primitives takes no extra time.
    """
    found = _gains(verdict)
    worse = {place: gains for place, gains in found.items() if gains.least < WORSE}
    meshes = {place.mesh for place in worse}
    tried = list(_tried(document, views, options, meshes, REMEDIES)) if worse else []
    if not all(any(trial.helps(place) for trial in tried) for place in worse):
        tried += _tried(document, views, options, meshes, [LAST])
    now = math.nan
    if any(trial.helps(place) for trial in tried for place in worse):
        alone = meshes == {place.mesh for place in found}
        # What has been measured twice may be too much work a third time.
        with suppress(InputError), document.budget.passing():
            now = _all_in_all(verdict if alone else _measured(document, options, meshes))
    notices = [_notice(place, gains, tried, now) for place, gains in worse.items()]
    return notices + [
        _exact_is_better(place, gains)
        for place, gains in found.items()
        if place not in worse and gains.by_lighting.get(DQS_ACCURATE, WORSE) < WORSE
    ]


_LightingOf = tuple[str, str]
"""A skinning method and a lighting of it."""

LBS_ACCURATE: _LightingOf = ("lbs", "accurate")
DQS_ACCURATE: _LightingOf = ("dqs", "accurate")
DQS_EXACT: _LightingOf = ("dqs", "exact")


class _Gains(NamedTuple):
    """The gains of a primitive, each by the worse truth."""

    by_lighting: dict[_LightingOf, float]

    def add(self, normals: Normals) -> None:
        """Add the gains by one truth."""
        for method, figures in normals.items():
            if gain(figures) is None:
                continue
            for lighting in sorted({"accurate", "exact"} & set(figures)):
                found = gain(figures, lighting)
                factor = math.inf if found is None else found  # None: but for rounding it is right
                if figures[lighting].p99 < UNSEEN:
                    factor = max(factor, 1.0)
                known = self.by_lighting.get((method, lighting), math.inf)
                self.by_lighting[method, lighting] = min(factor, known)

    @property
    def least(self) -> float:
        """Return the gain of the method that gains less, with its better lighting."""
        return self.by_lighting[self.least_of]

    @property
    def least_of(self) -> _LightingOf:
        """Return the method that gains less, and its better lighting."""
        ranked = sorted(self.by_lighting, key=self.by_lighting.__getitem__)
        better = {method: (method, lighting) for method, lighting in ranked}
        return min(better.values(), key=self.by_lighting.__getitem__)


class _Trial(NamedTuple):
    """A remedy, the gains of the primitives under it, and the least gain of their meshes all in all."""

    remedy: Remedy
    gains: dict[Place, _Gains]
    all_in_all: float

    def helps(self, place: Place) -> bool:
        """Tell whether a primitive gains more than little."""
        return place in self.gains and self.gains[place].least >= LITTLE


def _gains(verdict: FileVerdict) -> dict[Place, _Gains]:
    """Return the gains of the primitives that have any."""
    found: dict[Place, _Gains] = {}
    for place, normals in (*verdict.primitives, *verdict.primitives_by_triangles):
        found.setdefault(place, _Gains({})).add(normals)
    return {place: gains for place, gains in found.items() if gains.by_lighting}


def _all_in_all(verdict: FileVerdict) -> float:
    """Return the least gain of all that was measured, infinite if nothing has one."""
    found = _Gains({})
    for normals in verdict.by_truth.values():
        found.add(normals)
    return found.least if found.by_lighting else math.inf


def _tried(
    document: Document,
    views: Sequence[BakedView],
    options: VerifyOptions,
    meshes: Container[int | None],
    some: Sequence[Remedy],
) -> Iterator[_Trial]:
    """Yield each of some remedies that can be tried on the surfaces of some meshes."""
    from skinbake.format.strip import stripped  # most files need no remedy

    baker = noted_baker(views[0])
    plain, _, _ = stripped(document)
    for remedy in some:
        changed = remedy.applied(baker)
        if changed == baker:
            continue
        try:
            with document.budget.passing():
                made = changed.bake_document(plain).document
                verdict = _measured(made, options, meshes)
                yield _Trial(remedy, _gains(verdict), _all_in_all(verdict))
        except InputError:
            continue  # an option that cannot be baked is not a remedy


def noted_baker(view: BakedView) -> Baker:
    """Return a baker with the settings that the metadata of a primitive name."""
    from skinbake.commands.bake import Baker  # most files need no remedy

    noted = view.metadata
    known = noted.get("neighbours")
    return Baker(
        gradients=noted_kind(view),
        fit_poses=noted_sources(view),
        weighting=noted["weighting"],
        crease_angle=noted["creaseAngle"],
        neighbours=Neighbours(known) if known in list(Neighbours) else Neighbours.ADOPT,
        frame=FrameChoice(noted["frame"]),
        weld=noted.get("weld", Weld.MESH),
        generate_normals=True,  # strip takes generated ones away
    )


def _measured(document: Document, options: VerifyOptions, meshes: Container[int | None]) -> FileVerdict:
    """Measure the surfaces that some meshes belong to."""
    surfaces = [
        surface
        for surface in gathered_together(document, sound_views(document))
        if any(view.source.mesh in meshes for view in surface)
    ]
    operators = [surface_operator(document, surface) for surface in surfaces]
    return lighting_verdict(document, replace(options, min_gain=None), surfaces, operators)


def _notice(place: Place, own: _Gains, tried: Sequence[_Trial], now: float) -> Notice:
    """Return the notice for a primitive. now is the gain all in all that a remedy must keep."""
    lbs = own.by_lighting.get(LBS_ACCURATE, 0.0)
    only_dqs = lbs >= WORSE
    message = f"α/β make its lighting worse: the {_called(own.least_of)} gain is {gain_in_words(own.least)}"
    message += f", and the LBS gain is {gain_in_words(lbs)}. " if only_dqs else ". "
    # The trial that helps most. One that keeps the gain all in all comes first.
    best = max(
        (trial for trial in tried if place in trial.gains and trial.gains[place].least >= WORSE),
        key=lambda trial: (not trial.all_in_all < KEPT * now, trial.gains[place].least),
        default=None,
    )
    if best is not None:
        then = best.gains[place]
        message += f"With {best.remedy.words} it is {gain_in_words(then.least)}"
        if only_dqs:
            message += f", and the LBS gain {gain_in_words(then.by_lighting.get(LBS_ACCURATE, 0.0))}"
        if round(then.least, 2) < LITTLE:
            message += ", which is little: "
        elif best.all_in_all < KEPT * now:
            kept = gain_in_words(best.all_in_all)
            message += f", but all in all the gain falls from {gain_in_words(now)} to {kept}: "
        else:
            advice = f"{BAKE_SO} for dual quaternions" if only_dqs else BAKE_SO
            return Notice("lighting-worse", f"{message}: {advice}", place)
    elif tried:
        message += f"No option that was tried helps ({', '.join(trial.remedy.words for trial in tried)}): "
    with_dqs = "with dual quaternions, " if only_dqs else ""
    advice = f"{with_dqs}light it the standard way (in skinbake-three: lighting(mesh, 'standard'))"
    if not tried:
        advice = advice[0].upper() + advice[1:]  # it is a sentence of its own
    return Notice("lighting-worse", message + advice, place)


def _exact_is_better(place: Place, own: _Gains) -> Notice:
    """Return the notice for a primitive whose lighting only accurate dual quaternions make worse."""
    accurate, exact = own.by_lighting[DQS_ACCURATE], own.by_lighting[DQS_EXACT]
    better = "is right" if math.isinf(exact) else f"gains {gain_in_words(exact)}"
    message = (
        "accurate lighting of dual quaternions makes it worse: the DQS gain is "
        f"{gain_in_words(accurate)}. Exact lighting {better}: take that with dual quaternions, as skinbake "
        "shader --method dqs does"
    )
    lbs = own.by_lighting.get(LBS_ACCURATE)
    return Notice(
        "lighting-worse", message + ("" if lbs is None else f". The LBS gain is {gain_in_words(lbs)}"), place
    )


def _called(one: _LightingOf) -> str:
    return "exact DQS" if one == DQS_EXACT else one[0].upper()
