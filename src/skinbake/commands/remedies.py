"""Options that improve the lighting if a bake makes it worse. They are tried on the file itself."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from skinbake.choices import FrameChoice, Gradients, Neighbours, Weld
from skinbake.errors import InputError, Notice, Place
from skinbake.gltf.document import Document
from skinbake.gltf.primitives import skinned_sources
from skinbake.lighting.baked_views import BakedView, baked_views, gathered_together, is_baked
from skinbake.lighting.expected import noted_kind, noted_sources
from skinbake.lighting.measured import Lighting, VerifyOptions
from skinbake.lighting.staleness import mesh_operator
from skinbake.report.verify import BAKE_SO, LITTLE, FileVerdict, gain

if TYPE_CHECKING:
    from skinbake.commands.bake import Baker

WORSE = 0.995
"""The gain below which lighting is worse. From here on, it prints as 1.00."""


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
"""The options that help on primitives of real models that a bake lights worse. No other one did."""


def worse_lighting(
    document: Document, views: Sequence[BakedView], verdict: FileVerdict, options: VerifyOptions
) -> list[Notice]:
    """Return a notice for each primitive whose lighting α/β make worse, with an option that was tried.

    Accurate and exact lighting of dual quaternions read the same α and β: the better one counts. A remedy is
    named if it brings the gain to 1 at that primitive, by all methods and truths. It is advised if it brings
    ``LITTLE``. The file is baked once more for each remedy that differs from its own settings, so at most
    five times, and the surfaces with such primitives are measured. A file without them takes no extra time.
    """
    found = _gains(verdict)
    worse = {place: gains for place, gains in found.items() if gains.least < WORSE}
    tried = list(_tried(document, views, options, {place.mesh for place in worse})) if worse else []
    notices = [_notice(place, gains, tried) for place, gains in worse.items()]
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


def _gains(verdict: FileVerdict) -> dict[Place, _Gains]:
    """Return the gains of the primitives that have any."""
    found: dict[Place, _Gains] = {}
    for place, normals in (*verdict.primitives, *verdict.primitives_by_triangles):
        for method, figures in normals.items():
            if gain(figures) is None:
                continue
            own = found.setdefault(place, _Gains({})).by_lighting
            for lighting in sorted({"accurate", "exact"} & set(figures)):
                factor = gain(figures, lighting) or math.inf  # None: but for rounding it is right
                own[method, lighting] = min(factor, own.get((method, lighting), math.inf))
    return found


def _tried(
    document: Document, views: Sequence[BakedView], options: VerifyOptions, meshes: Container[int | None]
) -> Iterator[tuple[Remedy, dict[Place, _Gains]]]:
    """Yield each remedy that can be tried, and the gains under it on the surfaces of some meshes."""
    from skinbake.format.strip import stripped  # most files need no remedy

    baker = noted_baker(views[0])
    plain, _, _ = stripped(document)
    for remedy in REMEDIES:
        changed = remedy.applied(baker)
        if changed == baker:
            continue
        try:
            with document.budget.passing():
                made = changed.bake_document(plain).document
                yield remedy, _gains(_measured(made, options, meshes))
        except InputError:
            continue  # an option that cannot be baked is no remedy


def noted_baker(view: BakedView) -> Baker:
    """Return a baker with the settings that the metadata of a primitive name."""
    from skinbake.commands.bake import Baker  # most files need no remedy

    noted = view.metadata
    return Baker(
        gradients=noted_kind(view),
        fit_poses=noted_sources(view),
        weighting=noted["weighting"],
        crease_angle=noted["creaseAngle"],
        neighbours=_noted_neighbours(noted),
        frame=FrameChoice(noted["frame"]),
        weld=noted.get("weld", Weld.MESH),
        generate_normals=True,  # strip takes generated ones away
    )


def _noted_neighbours(noted: Mapping[str, Any]) -> Neighbours:
    known = noted.get("neighbours")
    return Neighbours(known) if known in list(Neighbours) else Neighbours.ADOPT


def _measured(document: Document, options: VerifyOptions, meshes: Container[int | None]) -> FileVerdict:
    """Measure the surfaces that some meshes belong to."""
    sources = [source for source in skinned_sources(document)[0] if is_baked(document, source)]
    views, _ = baked_views(document, sources)
    surfaces = [
        surface
        for surface in gathered_together(document, views)
        if any(view.source.mesh in meshes for view in surface)
    ]
    operators = [mesh_operator(document, surface) for surface in surfaces]
    lighting = Lighting(document, replace(options, min_gain=None))
    return lighting.measured(surfaces, operators)


def _notice(place: Place, own: _Gains, tried: Sequence[tuple[Remedy, dict[Place, _Gains]]]) -> Notice:
    better = [(gains[place].least, remedy, gains[place]) for remedy, gains in tried if place in gains]
    best, remedy, then = max(better, key=lambda one: one[0], default=(0.0, None, own))
    lbs = own.by_lighting.get(LBS_ACCURATE, 0.0)
    only_dqs = lbs >= WORSE
    message = f"α/β make its lighting worse: the {_called(own.least_of)} gain is {own.least:.2f}"
    message += f", and the LBS gain is {lbs:.2f}. " if only_dqs else ". "
    if remedy is not None and best >= WORSE:
        message += f"With {remedy.words} it is {best:.2f}"
        if only_dqs:
            message += f", and the LBS gain {then.by_lighting.get(LBS_ACCURATE, 0.0):.2f}"
        if round(best, 2) >= LITTLE:
            advice = f"{BAKE_SO} for dual quaternions" if only_dqs else BAKE_SO
            return Notice("lighting-worse", f"{message}: {advice}", place)
        message += ", which is little: "
    elif tried:
        message += f"No option that was tried helps ({', '.join(remedy.words for remedy, _ in tried)}): "
    way = "light it the standard way (in skinbake-three: lighting(mesh, 'standard'))"
    return Notice("lighting-worse", f"{message}{'with dual quaternions, ' if only_dqs else ''}{way}", place)


def _exact_is_better(place: Place, own: _Gains) -> Notice:
    """Return the notice for a primitive whose lighting only accurate dual quaternions make worse."""
    accurate, exact = own.by_lighting[DQS_ACCURATE], own.by_lighting[DQS_EXACT]
    better = "is right" if math.isinf(exact) else f"gains {exact:.2f}"
    message = (
        f"accurate lighting of dual quaternions makes it worse: the DQS gain is {accurate:.2f}. Exact "
        f"lighting {better}: take that with dual quaternions, as skinbake shader --method dqs does"
    )
    lbs = own.by_lighting.get(LBS_ACCURATE)
    return Notice("lighting-worse", message + ("" if lbs is None else f". The LBS gain is {lbs:.2f}"), place)


def _called(one: _LightingOf) -> str:
    return "exact DQS" if one == DQS_EXACT else one[0].upper()
