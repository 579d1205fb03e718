"""The assumptions of a bake about a primitive, as notices, and the check that its result is usable."""

from __future__ import annotations

import numpy as np

from skinbake.choices import Frame, FrameChoice, Gradients
from skinbake.errors import Chosen, InputError, Message, Notice, Place
from skinbake.geometry.frames import NO_DIRECTION
from skinbake.geometry.skinned import BakedPrimitive, FloatArray, SkinnedPrimitive, blocks, not_finite
from skinbake.gradients.baker import BakeFindings
from skinbake.gradients.surface import WeightDefects
from skinbake.gradients.tangents import TANGENT_TOLERANCE
from skinbake.wording import counted, one_or_many

COARSE = 0.5
"""The share of adopting vertices above which α and β may well make lighting worse.

Of 16 primitives of real models above it, 11 are lit worse. 4 of the other 5 are single triangles. Of 69 below
it, 1 is lit worse.
"""


def assumptions(
    primitive: SkinnedPrimitive,
    baked: BakedPrimitive,
    findings: BakeFindings,
    joint_count: int,
    place: Place,
    *,
    asked: Gradients,
    fitted: bool,
) -> list[Notice]:
    """Return one notice for each kind of assumption.

    joint_count is the number of joints of the skin. asked is the kind of gradients that the user asked for.
    fitted tells that the gradients are fitted to poses and turns.
    """
    count = len(primitive.positions)
    forced = baked.frame == Frame.TANGENT
    consequence = "used all the same, as asked" if forced else "the frame is taken from NORMAL instead"
    coarse = 0 if fitted or findings.adopting_vertices <= COARSE * count else findings.adopting_vertices
    fit = [", or take ", Chosen("gradients", Gradients.FITTED)] if asked is Gradients.SURFACE else []
    remedy = "; remove NORMAL and bake with --generate-normals" if findings.zero_normals == count else ""
    told = _not_finite(primitive.normals) if findings.zero_normals else None
    broken = "" if told is None else f" ({told[1]})"
    table = [
        *_of_influences(findings.weights, _naming_outside(primitive, joint_count), joint_count),
        (
            "tangents-skewed",
            findings.bad_tangents,
            f"at {{vertices}} {_skewed(findings, primitive)}: {consequence}",
        ),
        (
            "lighting-doubtful",
            coarse,
            f"{{count:,}} of {count:,} vertices take joints of their neighbours: so coarse a mesh is often "
            f"lit worse by the gradients of the surface; measure it with skinbake verify",
        ),
        (
            "normals-zero",
            findings.zero_normals,
            f"{{vertices}} {{have}} a NORMAL without a direction{broken}: taken as (0, 0, 1){remedy}",
        ),
    ]
    further = {"lighting-doubtful": fit}
    return [
        *(_weight_sums(primitive, place) if findings.weights.not_normalised else []),
        *_straightened(primitive, place),
        *(
            Notice(code, Message(_of_vertices(text, count), *further.get(code, ())), place, count)
            for code, count, text in table
            if count
        ),
    ]


def _naming_outside(primitive: SkinnedPrimitive, joint_count: int) -> int:
    """Return the number of vertices that name a joint past the skin's, at weight 0."""
    if primitive.joints.max() < joint_count:
        return 0
    unused = (primitive.joints >= joint_count) & (primitive.weights == 0)
    return int(np.count_nonzero(unused.any(axis=1)))


def _of_influences(weights: WeightDefects, outside: int, joint_count: int) -> list[tuple[str, int, str]]:
    """Return code, number of vertices and text of each assumption about joints and weights."""
    return [
        ("weights-negative", weights.negative, "{vertices} {have} negative weights: taken as 0"),
        (
            "weights-zero",
            weights.all_zero,
            "{vertices} {have} no weight at all: taken as bound to slot 0's joint; give them weights in the "
            "modelling tool",
        ),
        (
            "joints-repeated",
            weights.repeated_joint,
            "{vertices} {name} a joint twice: its weights are added up",
        ),
        (
            "joints-outside-skin",
            outside,
            f"{{vertices}} {{name}} a joint past the skin's {joint_count}, at weight 0: ignored",
        ),
    ]


def _weight_sums(primitive: SkinnedPrimitive, place: Place) -> list[Notice]:
    """Return a notice on weights that do not sum to 1."""
    from skinbake.gradients.influences import weight_sum_notices  # in most files they do

    return weight_sum_notices(primitive, place)


def _straightened(primitive: SkinnedPrimitive, place: Place) -> list[Notice]:
    """Return a notice on tangents that were straightened."""
    found = primitive.straightened
    if found is None or not found.vertices:
        return []
    skewed = sorted(set(found.vertices) - set(found.unhanded) - set(dict(found.not_finite)))
    parts = []
    if found.not_finite:
        first, component = found.not_finite[0]
        parts.append(
            one_or_many(
                len(found.not_finite),
                f"at vertex {first} TANGENT is not finite ({component})",
                f"at {{}} vertices TANGENT is not finite (first at vertex {first}, where {component})",
            )
        )
    if skewed:
        one, many = (
            f"at vertex {skewed[0]} TANGENT",
            f"at {{}} vertices, first at vertex {skewed[0]}, TANGENT",
        )
        leans = "is not orthogonal to NORMAL"
        if found.lean == NO_DIRECTION:
            one, many = f"{one} has no direction", f"{many} has no direction, or {leans}"
        else:
            one = f"{one} {leans} ({found.lean:.3g}° off)"
            many = f"{many} {leans} (up to {found.lean:.3g}° off)"
        parts.append(one_or_many(len(skewed), one, many))
    if found.unhanded:
        first = found.unhanded[0]
        parts.append(
            one_or_many(
                len(found.unhanded),
                f"at vertex {first} w of TANGENT is neither 1 nor −1",
                f"at {{}} vertices, first at vertex {first}, w of TANGENT is neither 1 nor −1",
            )
        )
    sound = "an orthogonal one" if skewed or found.not_finite else "w = 1"
    if sound != "w = 1" and (found.unhanded or found.not_finite):
        sound += " with w = 1 or −1"
    message = Message(
        f"{', and '.join(parts)}: the output has {sound} there, and strip restores the former; ",
        Chosen("frame", FrameChoice.NORMAL),
        " leaves it",
    )
    return [Notice("tangents-straightened", message, place, len(found.vertices))]


def _not_finite(vectors: FloatArray) -> tuple[int, str] | None:
    """Return how many vectors (V, C) are not finite, and words on the first; None if all are finite."""
    rows = np.flatnonzero(~np.isfinite(vectors).all(axis=1))
    if not len(rows):
        return None
    first = f"vertex {rows[0]}, where {not_finite(vectors[rows[0]])}"
    told = one_or_many(len(rows), f"not finite at {first}", f"not finite at {{}} vertices, first at {first}")
    return len(rows), told


def _skewed(findings: BakeFindings, primitive: SkinnedPrimitive) -> str:
    """Return what is wrong with tangents that cannot serve as they are. Without such ones, it is not used."""
    handed = "w of TANGENT is neither 1 nor −1"
    broken = None
    if findings.bad_tangents and primitive.tangents is not None:
        used = np.zeros(len(primitive.tangents), dtype=np.bool_)
        used[primitive.triangles.ravel()] = True
        broken = _not_finite(np.where(used[:, None], primitive.tangents, 0.0))
    if broken is not None:
        if broken[0] == findings.bad_tangents:
            return f"TANGENT is {broken[1]}"
        also = f" {handed}," if findings.unhanded else ""
        leans = f"or it leans more than {TANGENT_TOLERANCE}° from NORMAL"
        return f"TANGENT is not finite,{also} {leans} ({broken[1]})"
    if findings.unhanded == findings.bad_tangents:
        return handed
    leans = f"TANGENT × bitangent leans more than {TANGENT_TOLERANCE}° from NORMAL"
    if findings.tangent_deviation == NO_DIRECTION and not findings.unhanded:
        return f"TANGENT has no direction, or {leans}"
    among = f"; at {findings.unhanded:,} of them because {handed}" if findings.unhanded else ""
    return f"{leans} (up to {findings.tangent_deviation:.3g}°{among})"


def _of_vertices(text: str, count: int) -> str:
    """Return a sentence about vertices in singular or plural."""
    one = count == 1
    vertices = counted(count, "vertex", "vertices")
    return text.format(
        count=count, vertices=vertices, have="has" if one else "have", name="names" if one else "name"
    )


def check_finite(primitive: SkinnedPrimitive, baked: BakedPrimitive, place: Place) -> None:
    """Raise InputError if α or β of a vertex are not finite, because no shader can make a normal of them."""
    count, of_tangents = 0, False
    for rows in blocks(len(baked.alpha)):
        slots = np.isfinite(baked.alpha[rows]) & np.isfinite(baked.beta[rows])
        if slots.all():
            continue
        bad = ~slots.all(axis=1)
        count += int(np.count_nonzero(bad))
        if baked.frame == Frame.TANGENT and primitive.tangents is not None:
            of_tangents |= bool((np.abs(primitive.tangents[rows][bad]) > 2.0).any())
    if not count:
        return
    vertices = counted(count, "vertex", "vertices")
    advice: tuple[str | Chosen, ...] = (
        ("their TANGENT is not of length 1: mend it, or take ", Chosen("frame", FrameChoice.NORMAL))
        if of_tangents
        else (
            "they lie closer together than float32 can hold a slope for: scale the model up, or merge them",
        )
    )
    raise InputError(Message(f"α or β of {vertices} are not finite numbers; ", *advice), place)
