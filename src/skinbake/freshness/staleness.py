"""Whether what a bake has made is fresh; if it is not, which arrays changed since the bake, and where.

That is α and β of each primitive, the gradient of its blend weights, and what its morph targets got.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skinbake.choices import Gradients, Weighting, Weld
from skinbake.errors import BrokenPassedOver, InputError, Notice
from skinbake.format.digests import slots_digest
from skinbake.format.morph_targets import morph_digest
from skinbake.format.note import MorphTargets, made_targets
from skinbake.freshness.baked_views import BakedView, gathered_together
from skinbake.freshness.expected import (
    NO_PAYMENT,
    Expected,
    Fit,
    expected_slots,
    former_weights,
    frames_of,
    given_weights,
    noted_rig,
    paid_share,
    prepared_rig_fit,
    weights_before,
)
from skinbake.geometry.poses import is_fingerprint_of
from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.accessors import read_attribute
from skinbake.gltf.reading.meshes import read_primitive
from skinbake.gltf.reading.morphs import read_targets
from skinbake.report.verify import Check
from skinbake.skinning.rest import all_slots
from skinbake.threads import Threads
from skinbake.truth.mesh import free_slots
from skinbake.truth.operator import GradientOperator, gradient_operator
from skinbake.wording import counted

BAKE_AGAIN = "run skinbake bake again"

BAKE_LAST = "Bake last: run skinbake bake on the file that the last tool wrote"

WITHOUT_POSES = "the poses of the fit are not in the file, so α/β were checked by their digest"

NAMED = 16
"""The number of primitives that a message names. Each of a thousand stale ones would name all others."""

RELATIVE_TOLERANCE = 1e-3
"""The largest allowed difference between stored and recomputed, relative to the vertex's largest entry.

float32 storage and two routes to the same mean differ by 1e-6. An α scaled by 1.01 differs by 1e-2.
"""

FEW, NEAR = 100, 0.1
"""One vertex in FEW may differ by up to NEAR if a tool has changed the arrays.

Tools that resample clips move the poses of the fit a little: of 7,228 vertices 29 differed, by at most 5 %.
Where α and β are nearly 0, the fit magnifies rounding: 6 of 11,856 in another order differed by 10 %.
"""

FLOOR = 1e-4
"""Entries below this share of the primitive's largest entry, or of the vertex's reach, are rounding.

After a tool that unwelds a mannequin, six entries of 0 are 2e-5 of the largest: sums have another order.
"""


def surface_operator(document: Document, views: Sequence[BakedView]) -> GradientOperator:
    """Return the gradient operator of one surface, weighted as its metadata says."""
    note = views[0].note
    return gradient_operator(
        [view.now for view in views],
        weighting=Weighting(note.weighting),
        crease_angle_degrees=float(note.crease_angle),
        claim=document.budget.welding(views[0].source.place),
    )


def fits_begun(
    document: Document, surfaces: Sequence[Sequence[BakedView]], threads: Threads
) -> list[Fit | None]:
    """Begin the fits of surfaces to their rigs that ``freshness_check`` needs, beside other work."""
    fits: list[Fit | None] = []
    for views in surfaces:
        is_fitted = views[0].kind is Gradients.FITTED
        fit = prepared_rig_fit(document, views, Weighting(views[0].note.weighting)) if is_fitted else None
        fits.append(threads.begun(fit) if fit else None)
    return fits


def freshness_check(
    document: Document,
    surfaces: Sequence[Sequence[BakedView]],
    operators: Sequence[GradientOperator],
    fits: Sequence[Fit | None] | None = None,
) -> Check:
    """Return whether α/β fit the arrays that are in the file now.

    That is what fresh means: a bake of the file as it is now would light it in the same way. If the arrays
    have changed and α/β still fit them, the check passes, with a remark that names the arrays. If α/β were
    fitted to poses that are not in the file any more, they must be the ones that bake wrote. fits is the
    result of ``fits_begun``, if there is one.
    """
    problems: list[Notice] = []
    changed: list[BakedView] = []
    unchecked: set[str] = set()
    for views, operator, fit in zip(surfaces, operators, fits or [None] * len(surfaces), strict=True):
        compared = _comparisons(document, views, operator, fit)
        # In other poses α/β may still agree: the nodes may only stand elsewhere, all together.
        fresh = [
            one.agrees or (one.is_near and bool(own.changed))
            for one, own in zip(compared, views, strict=True)
        ]
        if not all(fresh) and not has_poses(document, views[0]):
            problems += problems_without_poses(document, views)
            unchecked.add(WITHOUT_POSES)
            continue
        for number, (view, found) in enumerate(zip(views, compared, strict=True)):
            if not fresh[number]:
                problems.append(_staleness_notice(document, views, number, found))
            elif view.changed:
                changed.append(view)
        if any(view.blend is not None for view in views):
            problems += _stale_blends(document, views, operator)
    if problems:
        return Check("freshness", "failed", tuple(problems))
    remarks = sorted(unchecked)
    if changed:
        names = _listed(list(dict.fromkeys(name for view in changed for name in view.changed)))
        places = changed[0].source.place.within_file if len(changed) == 1 else f"{len(changed)} primitives"
        where = f" in {places}" if sum(map(len, surfaces)) > 1 else ""
        remarks = [f"{names} changed since the bake{where}, and α/β still fit", *remarks]
    return Check("freshness", "passed", (), "; ".join(remarks))


def _stale_blends(
    document: Document, views: Sequence[BakedView], operator: GradientOperator
) -> Iterator[Notice]:
    """Yield a problem for each view of a surface whose stored gradient is not that of its blend weights."""
    fields = [np.zeros((len(view.now.positions), 3)) if view.blend is None else view.blend for view in views]
    frames = frames_of(views)

    def compared(by: GradientOperator) -> list[Comparison]:
        expected = np.empty((len(by.positions), 2))
        weights = np.concatenate(fields)[:, 0]
        for part in by.row_blocks():
            rows = by.rows(part, [directions[part] for directions in frames])
            expected[part] = rows.times(weights).reshape(2, -1).T
        reach = by.reach()
        return [
            compare(
                (field[:, 1:2], field[:, 2:]), (expected[rows, :1], expected[rows, 1:]), reach=reach[rows]
            )
            for field, rows in zip(fields, by.slices, strict=True)
        ]

    found = compared(operator)
    if not all(one.agrees for one in found):
        # The bake has welded by the influences from before adoption.
        with document.budget.passing():
            before = [_before_adoption(document, view) for view in views]
            again = compared(surface_operator(document, before))
        found = [min(pair, key=lambda one: one.differing) for pair in zip(found, again, strict=True)]
    for view, one in zip(views, found, strict=True):
        if view.note.blend is not None and not one.agrees:
            name = view.note.blend.weights
            vertices = counted(one.count, "vertex", "vertices")
            message = (
                f"the gradient of its blend weights {name} is wrong at {one.differing:,} of {vertices}, most "
                f"at vertex {one.worst}: run skinbake bake --blend {name} on the last tool's output"
            )
            yield Notice("stale", message, view.source.place, one.differing)


def claim_freshness(document: Document, count: int) -> None:
    """Count the work of reading so many bakes and comparing them. Raises InputError if it is too much."""
    what = f"the freshness of {counted(count, 'primitive')}"
    document.budget.claim(Cost.COMPARED_PRIMITIVE * count, what, document.place)


def refuse_stale(document: Document, views: Sequence[BakedView]) -> None:
    """Raise InputError if α/β of a primitive do not fit its arrays, because its lighting would be wrong."""
    surfaces = gathered_together(document, views)
    operators = [surface_operator(document, surface) for surface in surfaces]
    problems = freshness_check(document, surfaces, operators).problems
    if problems:
        first, more = problems[0], len(problems) - 1
        others = f" ({counted(more, 'more primitive')} of it likewise)" if more else ""
        raise InputError(f"its bake is stale: {first.message}{others}", first.place)


def _comparisons(
    document: Document, views: Sequence[BakedView], operator: GradientOperator, fit: Fit | None
) -> list[Comparison]:
    """Compare α and β of each view with those of the present weights, or of the weights before adoption.

    The second comparison is made only if the first one finds a difference. A view agrees if either does.
    """
    found = _compared(document, views, operator, expected_slots(document, views, operator, fit=fit))
    if all(one.agrees for one in found):
        return found
    before = [_before_adoption(document, view) for view in views]
    if all(other is view for other, view in zip(before, views, strict=True)):
        return found
    with document.budget.passing():
        welded = surface_operator(document, before)
        expected = expected_slots(document, before, welded)
        again = _compared(document, before, welded, expected, _roundings(document, views, operator))
    # The weights that explain more vertices show the damage alone.
    return [min(pair, key=lambda one: one.differing) for pair in zip(found, again, strict=True)]


def _before_adoption(document: Document, view: BakedView) -> BakedView:
    """Return the view with its influences as they were before slots adopted joints.

    Copies of a vertex may have stored other multiples of the same weights, from which adoption takes other
    shares. So only the weights from before it tell which vertices were welded.
    """
    stored, weights, given = view.now.joints, view.now.weights, given_weights(document, view)
    # Slots without weight whose joint has left them in the bake name the joint of the largest weight here. If
    # several such slots name a joint, the first of them has its gradient. α and β of the others are 0 if the
    # first of them adopted another joint, and bake lost the gradient: this happens only if a copy of the
    # vertex has fewer free slots. Slot 0 is none of them, since bake fills the free slots in order.
    vacated = free_slots(weights) & (given <= 0.0) & (given > 0.0).any(axis=1, keepdims=True)
    vacated[:, 0] = False
    vacated[:, 1:] &= (view.alpha == 0.0) & (view.beta == 0.0)
    largest = np.take_along_axis(stored, weights.argmax(axis=1)[:, None], axis=1)
    joints = np.where(vacated, largest, stored)
    if given.any():
        weights = weights_before(view.now, given, former_weights(document, view))
    elif (joints == stored).all():
        return view
    return replace(view, now=view.now.with_influences(joints, weights))


def _compared(
    document: Document,
    views: Sequence[BakedView],
    operator: GradientOperator,
    expected: Expected,
    roundings: Sequence[Float64Array] | None = None,
) -> list[Comparison]:
    """Compare α and β of each view with expected ones. roundings come from ``_roundings``."""
    roundings = roundings or _roundings(document, views, operator)
    found = [
        compare((view.alpha, view.beta), slots, rounding=rounding)
        for view, slots, rounding in zip(views, expected, roundings, strict=True)
    ]
    if all(one.agrees for one in found):
        return found
    # The reach only allows more, and takes longer than all else here.
    reach = operator.reach()
    return [
        compare((view.alpha, view.beta), slots, reach=reach[rows], rounding=rounding)
        for view, slots, rounding, rows in zip(views, expected, roundings, operator.slices, strict=True)
    ]


def _roundings(
    document: Document, views: Sequence[BakedView], operator: GradientOperator
) -> list[Float64Array]:
    """Return the allowed difference of α and β of each view (V, 2) from α and β of its present weights.

    It is the rounding of an encoding, and the weight that adopted slots were given. They take a unit of
    integer weights each from the vertex's largest weight. α/β come from the weights before adoption, divided
    by their sum, so the less they sum to, the more a unit is.
    """
    paid = np.concatenate([paid_share(view, given_weights(document, view)) for view in views])
    if paid.max(initial=0.0) < NO_PAYMENT:
        return [view.rounding for view in views]
    forgiven = operator.reach_along(frames_of(views), paid).T.copy()
    return [view.rounding + forgiven[rows] for view, rows in zip(views, operator.slices, strict=True)]


def _staleness_notice(
    document: Document, views: Sequence[BakedView], number: int, found: Comparison
) -> Notice:
    """Return which arrays of a view changed, where α and β are wrong, and what to do."""
    view = views[number]
    vertices = counted(found.count, "vertex", "vertices")
    message = f"α/β are wrong at {found.differing:,} of {vertices}, most at vertex {found.worst}"
    neighbours = [other.source.place.within_file for other in views if other.changed]
    if view.changed:
        message = f"{_listed(view.changed)} changed since its bake, and {message}. {BAKE_LAST}"
    elif rig_changed(document, view):
        message += f". The skeleton changed since the bake (its hierarchy or its bind pose): {BAKE_AGAIN}"
    elif neighbours:
        more = [f"{len(neighbours) - NAMED} more"] if len(neighbours) > NAMED else []
        welded = _listed([*neighbours[:NAMED], *more])
        message += f". It is welded with {welded}, which changed: {BAKE_AGAIN}"
    else:
        is_skin = view.note.weld == Weld.SKIN
        other = ", but perhaps the meshes that its skin draws" if is_skin else ""
        message += f". No array of it changed since its bake{other}: {BAKE_AGAIN}"
    return Notice("stale", message, view.source.place, found.differing)


def _listed(words: Sequence[str]) -> str:
    return ", ".join(words[:-1]) + (" and " if len(words) > 1 else "") + words[-1]


@dataclass(frozen=True, slots=True)
class Comparison:
    """The differences between stored α and β (V, K − 1) and recomputed ones.

    differing is the number of vertices, out of count, that exceed the tolerance. largest is the largest
    difference relative to the vertex's largest entry. worst is the vertex of that difference.
    """

    differing: int
    count: int
    largest: float
    worst: int

    @property
    def agrees(self) -> bool:
        """Tell whether no vertex differs."""
        return self.differing == 0

    @property
    def is_near(self) -> bool:
        """Tell whether few of many vertices differ, and by little."""
        return self.differing <= self.count // FEW and self.largest <= NEAR


def compare(
    stored: tuple[FloatArray, FloatArray],
    expected: tuple[FloatArray, FloatArray],
    *,
    reach: FloatArray | None = None,
    rounding: FloatArray | None = None,
) -> Comparison:
    """Compare stored with recomputed α and β, each a pair of (V, K − 1), in 1 / length unit of POSITION.

    reach (V,), in the same unit, is the largest possible derivative of a weight at each vertex. If a weight
    is constant, both sides are rounding, and only reach shows it. rounding (V, 2), in the same unit, is the
    largest change that an encoding may have made to a stored α, and to a stored β. Differences up to it are
    allowed. A vertex whose recomputed α or β float32 cannot hold differs from anything.
    """
    given, wanted = (np.stack(pair, axis=2).astype(np.float64) for pair in (stored, expected))
    known = np.asarray(np.isfinite(wanted).all(axis=(1, 2)))
    wanted = all_slots(np.where(known[:, None, None], wanted, 0.0))
    # The scale (V,) to which the difference at each vertex is compared.
    own = np.abs(wanted).max(axis=(1, 2), initial=0.0)
    scale = np.maximum(own, FLOOR * own.max(initial=0.0))
    if reach is not None:
        scale = np.maximum(scale, FLOOR * reach)
    scale = np.where(scale > 0.0, scale, 1.0)
    allowed = np.zeros((len(given), 1, 2)) if rounding is None else np.asarray(rounding)[:, None]
    off: Float64Array = (np.abs(given - wanted[:, 1:]) - allowed).max(axis=(1, 2), initial=0.0)
    difference = np.where(known, off / scale, np.inf)
    return Comparison(
        differing=int(np.count_nonzero(difference > RELATIVE_TOLERANCE)),
        count=len(difference),
        largest=float(difference.max(initial=0.0)),
        worst=int(difference.argmax()) if len(difference) else 0,
    )


class MadeState(NamedTuple):
    """A primitive of whose targets some have NORMAL by bake, or all numbers of the differential.

    frames is how many numbers these are. changed: what both follow from is not what it was.
    """

    source: PrimitiveSource
    targets: int
    frames: int
    of: int
    changed: bool

    @property
    def notice(self) -> Notice:
        """Return what is wrong if they changed."""
        made = " and ".join(["NORMAL"] * bool(self.targets) + ["the differential"] * bool(self.frames))
        options = " ".join(["--morph-normals"] * bool(self.targets) + ["--morph-frames"] * bool(self.frames))
        message = (
            f"what bake has made for its morph targets ({made}) does not belong to its positions and normals "
            f"now: run skinbake bake {options}"
        )
        return Notice("morphs-stale", message, self.source.place, self.of)


def made_states(document: Document) -> Iterator[MadeState]:
    """Yield the primitives whose targets have NORMAL by bake, with or without a skin."""
    meshes = [made_targets(document, mesh.number) for mesh in document.asset.meshes]
    for source in document.asset.primitives:
        noted = meshes[source.mesh][source.primitive]
        if noted:
            with document.budget.passing():
                changed = _digest_of_targets(document, source, noted) != noted.digest
            count = len(source.whole_targets)
            yield MadeState(source, len(noted.normals), noted.frames, count, changed)


def _digest_of_targets(document: Document, source: PrimitiveSource, noted: MorphTargets) -> str | None:
    """Return the digest of what was made for the targets of a primitive, None if it is not all there."""
    targets = source.whole_targets
    if any(not 0 <= number < len(targets) or "NORMAL" not in targets[number] for number in noted.normals):
        return None
    if any(name not in target for target in targets for name in noted.names):
        return None
    made = list(range(len(targets))) if noted.frames else list(noted.normals)
    with BrokenPassedOver():
        primitive = read_primitive(document, source)
        read = read_targets(document, source, made, count=len(primitive.positions), tangents=False)
        assert read is not None
        moves = dict(zip(made, (target.positions for target in read.targets), strict=True))
        return morph_digest(primitive, moves)
    return None


def has_poses(document: Document, view: BakedView) -> bool:
    """Tell whether the poses of a fit follow from the file as it is now."""
    if view.kind is Gradients.SURFACE or view.note.poses is None:
        return True
    rig = noted_rig(document, view)
    return rig is not None and is_fingerprint_of(rig.fingerprint, view.note.poses.fingerprint)


def rig_changed(document: Document, view: BakedView) -> bool:
    """Tell whether the rig is another one than the noted one, or is gone."""
    if view.kind is Gradients.SURFACE or view.note.rig is None:
        return False
    rig = noted_rig(document, view)
    return rig is None or rig.digest != view.note.rig


def problems_without_poses(document: Document, views: Sequence[BakedView]) -> Iterator[Notice]:
    """Yield a problem for each view whose arrays, skeleton or α/β changed: its fit cannot be made again.

    It was made to poses of clips of another file or that changed, or of nodes that are stored otherwise.
    """
    gone = "the poses that α/β were fitted to are not in the file"
    for view in views:
        attributes, place = view.source.attributes, view.source.place
        stored = {
            name: read_attribute(document, attributes, name, place).values for name in view.note.slot_names
        }
        if view.changed:
            message = f"{', '.join(view.changed)} changed since its bake, and {gone}. {BAKE_LAST}"
            yield Notice("stale", message, place)
        elif rig_changed(document, view):
            message = "The skeleton changed since the bake (its hierarchy or its bind pose)"
            yield Notice("stale", f"{message}: {BAKE_AGAIN}", place)
        elif view.note.poses is None or slots_digest(stored) != view.note.poses.slots:
            yield Notice("stale", f"α/β changed since its bake, and {gone}: {BAKE_AGAIN}", place)
