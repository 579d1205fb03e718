"""Bake an exported file where it is, measure it, and put both into words. Nothing here needs Blender."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from .options import CHOICES, CREASE_LABEL, NO_SKINBAKE

Level = Literal["INFO", "WARNING", "ERROR"]
"""The levels of Blender's reports."""

Status = Literal["baked", "unchanged", "failed"]
"""``unchanged``: nothing in the file can be baked. ``failed``: the file is the plain export."""

KEPT = "the plain export was kept"

NOTHING_SKINNED = (
    "nothing is skinned. To bake a character, turn on Data > Skinning, and export its mesh with its armature"
)
SKIPPED = {
    "no-normals": "skipped: it has no NORMAL; turn on Data > Mesh > Normals in the exporter",
    "no-tangents": "skipped: it has no TANGENT; turn on Data > Mesh > Tangents in the exporter",
    "no-skin": (
        "skipped: it has joints, but no node gives its mesh a skin; turn on Data > Skinning in the exporter, "
        "export the armature too, and give the mesh vertex groups with the names of bones"
    ),
}
"""What to say of a skipped mesh in Blender, by the code of skinbake's notice."""

OFF_SURFACE = (
    ". In Blender: if the scale of the mesh or of its armature is negative or uneven, select both and "
    "choose Object > Apply > Scale"
)
"""What to add to the notice ``normals-off-surface``."""

BAD_LOSS = 0.05
"""The share of the gradient left out from which ``skinbake bake`` advises another option."""

LITTLE = 1.2
"""The gain under which ``skinbake verify`` advises to leave a file unbaked."""

SHOWN = 0.005
"""A mean error in degrees below this value is shown as 0.00°."""


@dataclass(frozen=True, slots=True)
class Line:
    """A sentence for the user."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of one export.

    gain is the mean error of standard lighting divided by that of accurate lighting, by that one of the two
    true normals of ``skinbake verify`` that shows less of it. None: it was not measured, or the accurate
    error is only rounding, for example if nothing bends.
    """

    path: str
    status: Status
    lines: tuple[Line, ...]
    gain: float | None = None


def bake_export(path: str, options: Mapping[str, Any], *, measure: bool) -> Outcome:
    """Replace an exported file by the baked one. If that fails, the file stays as it was exported."""
    try:
        import skinbake
    except ImportError as error:
        return _failed(path, NO_SKINBAKE.format(reason=error))
    try:
        result = skinbake.bake(path, path, **options)
    except skinbake.SkinbakeError as error:
        place = error.place.within_file if error.place else ""
        message = _in_panel_words(error if isinstance(error, skinbake.ChoiceError) else error.message)
        return _failed(path, f"{place}: {message}" if place else message)
    except Exception as error:  # a defect of skinbake must not cost the export
        traceback.print_exc()
        return _failed(path, f"{type(error).__name__}: {error}")
    warnings = _warnings(result["warnings"])
    if result["status"] != "baked":
        is_told = bool(warnings) and options.get("correctives") is not None
        line = Line("INFO", f"{Path(path).name}: {KEPT}") if is_told else _unchanged(path, result["skipped"])
        return Outcome(path, "unchanged", (line, *warnings))
    lines = (Line("INFO", f"{Path(path).name}: {_baked(result)}"), *warnings)
    if not measure:
        return Outcome(path, "baked", lines)
    measured, gain = _measured(path)
    # Bake and verify say some things alike.
    return Outcome(path, "baked", tuple(dict.fromkeys((*lines, *measured))), gain)


def _failed(path: str, reason: str) -> Outcome:
    return Outcome(path, "failed", (Line("ERROR", f"{Path(path).name}: {KEPT}: {reason}"),))


def _unchanged(path: str, skipped: int) -> Line:
    """Return the line for a file in which nothing is baked: a scene of props is nothing to worry about."""
    if skipped == 0:
        return Line("INFO", f"{Path(path).name}: {KEPT}: {NOTHING_SKINNED}")
    return Line("WARNING", f"{Path(path).name}: {KEPT}: none of its skinned meshes can be baked")


def _baked(result: Mapping[str, Any]) -> str:
    """Return what bake did, with what the encoding and the limit of influences cost."""
    if correctives := result["correctives"]:
        targets = " or ".join(str(count) for count in sorted({mesh["targets"] for mesh in correctives}))
        added = sum(mesh["added_bytes"] for mesh in correctives)
        meshes = "1 mesh" if len(correctives) == 1 else f"{len(correctives)} meshes"
        plural = "" if targets == "1" else "s"
        return f"baked: correctives: {meshes}, {targets} morph target{plural}, {added:,} bytes added"
    primitives = result["primitives"]
    vertices = sum(primitive["vertices"] for primitive in primitives)
    added = sum(primitive["added_bytes"] for primitive in primitives)
    count = "1 primitive" if len(primitives) == 1 else f"{len(primitives)} primitives"
    costs = [*_encoding_cost(result["encoding"]), *_limit_cost(primitives), *_loss(primitives)]
    return "; ".join([f"baked: {count}, {vertices:,} vertices, {added:,} bytes added", *costs])


def _encoding_cost(encoding: Mapping[str, Any]) -> Iterator[str]:
    if (error := encoding["added_error"]) is not None:
        yield f"{encoding['name']} turns normals by {error['mean']:.2f}° on average"


def _limit_cost(primitives: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    limits = [primitive["limited"] for primitive in primitives if primitive["limited"]]
    if limits:
        yield f"{sum(limit['vertices'] for limit in limits):,} vertices lost influences"


def _loss(primitives: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield which share of the gradient is left out, if it is large, and what helps."""
    whole = sum(primitive["gradient"] for primitive in primitives)
    lost = sum(primitive["lost_gradient"] * primitive["gradient"] for primitive in primitives)
    if lost < BAD_LOSS * whole or not lost:
        return
    remedy = f"; try {_in_panel(('neighbours', 'extend'))}"
    if any(primitive["limited"] for primitive in primitives):
        remedy = "; try a larger limit of influences"
    elif any(primitive["extended"] for primitive in primitives):
        remedy = ""
    share = f"{lost / whole:.1%}".replace("%", " %")
    yield f"joints of neighbours left out: {share} of the gradient{remedy}"


def _measured(path: str) -> tuple[tuple[Line, ...], float | None]:
    """Verify the baked file. Return what is wrong with it and what it gained."""
    import skinbake

    try:
        verdict = skinbake.verify(path, methods=["lbs"])
    except Exception as error:  # the bake is written and whole: only its measurement is missing
        if not isinstance(error, skinbake.SkinbakeError):
            traceback.print_exc()
        return (Line("WARNING", f"baked, but not measured: {error}"),), None
    problems = tuple(
        Line("ERROR", f"verify, {check['name']}: {_said(problem)}")
        for check in verdict["checks"]
        for problem in check["problems"]
    )
    lines, gain = _figures(verdict)
    is_advised = any(notice["code"] == "lighting-worse" for notice in verdict["warnings"])
    if gain is not None and round(gain, 2) < LITTLE and not problems and not is_advised:
        text = f"little to win: the gain is under {LITTLE}. Turn off the bake for this file"
        lines = (*lines, Line("INFO", text))
    return (*problems, *lines, *_warnings(verdict["warnings"])), gain


def _figures(verdict: Mapping[str, Any]) -> tuple[tuple[Line, ...], float | None]:
    """Return the errors by triangles, and the lower gain of both kinds of true normals."""
    kinds = "normals_by_triangles", "normals_by_tangents"
    truths = [verdict[kind]["lbs"] for kind in kinds if verdict[kind]]
    if not truths:
        return (), None
    lbs = truths[0]
    lowest = min((found["gain"] for found in truths if found["gain"] is not None), default=None)
    standard, accurate = lbs["standard"]["mean"], lbs.get("corrected", lbs["accurate"])["mean"]
    if lbs["gain"] is None and max(found["standard"]["mean"] for found in truths) < SHOWN:
        text = "nothing bends: standard normals are right already"
    else:
        gain = "" if lbs["gain"] is None else f", gain {_gain_in_words(lbs['gain'])}x"
        text = f"error of normals {standard:.2f}° -> {accurate:.2f}°{gain}"
    return (Line("INFO", f"{text}, over {verdict['poses']}"),), lowest


def _gain_in_words(gain: float) -> str:
    """Return a gain as ``skinbake verify`` shows it. A loss has up to four decimals that keep it under 1."""
    if gain >= 1.0:
        return f"{gain:.2f}" if gain < 100.0 else f"{gain:,.0f}"
    texts = [f"{min(gain, 0.9999):.{decimals}f}" for decimals in (2, 3, 4)]
    return next(text for text in texts if float(text) < 1.0)


def _warnings(notices: Iterable[Mapping[str, Any]]) -> tuple[Line, ...]:
    lines = (Line("WARNING", _said(notice)) for notice in notices if notice["code"] != "nothing-baked")
    return tuple(dict.fromkeys(lines))  # the exporter writes one mesh several times, by one name


def _said(notice: Mapping[str, Any]) -> str:
    """Return a notice of skinbake with its place, such as ``mesh "Body", primitive 0: …``, and its hint."""
    place = []
    if (mesh := notice.get("mesh_name") or notice.get("mesh")) is not None:
        place.append(f'mesh "{mesh}"')
    if "primitive" in notice:
        place.append(f"primitive {notice['primitive']}")
    if "attribute" in notice:
        place.append(notice["attribute"])
    message = SKIPPED.get(notice["code"]) or _in_panel_words(notice["message"])
    if notice["code"] == "normals-off-surface":
        message += OFF_SURFACE
    return ": ".join(filter(None, (", ".join(place), message)))


def _in_panel_words(message: Any) -> str:
    """Return a message of skinbake with the names that the panel gives to options and their values.

    Messages that name options of the panel have them as data.
    """
    return str(message.worded(_in_panel) if hasattr(message, "worded") else message)


def _in_panel(chosen: tuple[str, object]) -> str:
    """Return an option, and its value if it has one, as the panel shows them."""
    name, value = chosen
    word = "" if value is ... else f" {value}"
    if name == "crease_angle" and word:
        return f'"{CREASE_LABEL}:{word}°"'
    if name not in CHOICES:
        return f"{name}{word}"
    label, items = CHOICES[name]
    shown = {item[0]: item[1] for item in items}.get(word.strip())
    return f'"{label}: {shown}"' if shown else f'"{label}"{word}'
