"""The result of verify: checks and lighting errors, as text, JSON and JUnit XML."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, NamedTuple

from skinbake.choices import USUAL_TRUTHS, Truth
from skinbake.errors import InputError, Message, Notice, Place, SkinbakeError, printable, warnings_in
from skinbake.report.totals import (
    Totals,
    error_fields,
    notice_list,
    place_fields,
    reason_of,
    timing_fields,
)
from skinbake.wording import counted, gain_in_words

SCHEMA = "skinbake.verify/1"
OUTCOMES = ("passed", "up-to-date", "failed")

SOURCES = "sources"
"""The name of the check of ``--sources``: whether an output is of its source as it is now."""

Outcome = Literal["passed", "failed", "skipped"]

SHOWN_LIGHTINGS = ("standard", "accurate", "exact", "corrected")
"""The rows of the table, by name. Direct lighting equals accurate lighting up to its sign in folds."""

MEMBERS = {
    Truth.TRIANGLES: "normals_by_triangles",
    Truth.TANGENTS: "normals_by_tangents",
}
"""The member of JSON that has the figures by a truth."""

ROUNDING = 1e-4
"""Below this angle in degrees, a mean error is float32 rounding, and dividing by it is meaningless."""

NEGLIGIBLE = 0.3
"""The mean error of standard lighting in degrees under which nobody sees that anything is wrong."""

LITTLE, CLEAR = 1.2, 2.0
"""The gain under which a bake is not worth its bytes, and the one from which it is plain to see."""

XML_DECLARATION = '<?xml version="1.0" encoding="UTF-8"?>\n'
"""Written by hand: ElementTree would name the locale's encoding, but the file is written in UTF-8."""

NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot hold, not even escaped; names in glTF can have them."""


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a file. If it failed, its problems name the place, the defect and the remedy.

    seconds is how long it took, None where nobody took the time.
    """

    name: str
    outcome: Outcome
    problems: tuple[Notice, ...] = ()
    remark: str = ""
    seconds: float | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Worst:
    """The place of the largest error: primitive, vertex, clip and time in seconds.

    If the pose belongs to no clip, time is None, and clip names the pose, like ``random pose 3``.
    """

    place: Place
    vertex: int
    clip: str
    time: float | None


@dataclass(frozen=True, slots=True)
class ErrorFigures:
    """Angular error of normals in degrees, weighted by rest area over all vertices and poses.

    weight is the sum of these areas.
    """

    mean: float
    p95: float
    p99: float
    max: float
    worst: Worst
    weight: float = 0.0


Normals = dict[str, dict[str, ErrorFigures]]
"""Figures by method (lbs, dqs) and lighting (standard, direct, accurate, exact, corrected)."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures by one truth: of the whole file, and of each primitive."""

    whole: Normals
    primitives: tuple[tuple[Place, Normals], ...] = ()


@dataclass(frozen=True, slots=True)
class Reliefs:
    """Figures of mapped normals: of the file, and of each primitive that has a map.

    ``engine_frame`` is accurate lighting under an engine's own frame, rebuilt from n' and t'. by_normal has
    T n0 as third column of the truth, by_area F n0.
    """

    by_normal: Figures
    by_area: Figures


@dataclass(frozen=True, slots=True)
class MorphCount:
    """The number of morph targets of the baked meshes, and the number that move in the poses."""

    targets: int
    moving: int

    @property
    def words(self) -> str:
        """Return the count for people, like ``3 of 8 morph targets move``."""
        if self.targets == 1:
            return f"its morph target {'moves' if self.moving else 'does not move'}"
        return f"{self.moving} of {self.targets} morph targets move"


@dataclass(frozen=True, slots=True)
class Mixture:
    """Poses that no corrective was made for, as applications mix them; mean errors in degrees by truth."""

    name: str
    standard: dict[str, float]
    corrected: dict[str, float]

    @property
    def words(self) -> str:
        """Return the figures for people."""
        told = [f"{self.standard[by]:.2f}° -> {self.corrected[by]:.2f}° by {by}" for by in self.standard]
        return f"{self.name}: {', '.join(told)}"


@dataclass(frozen=True, slots=True)
class Spot:
    """A place in a pose: what a bake changes there, and from where it is seen.

    number is that of the clip, None in a pose of no clip. standard and baked are mean errors in degrees,
    weighted by area, by the truth with the smaller difference. place and vertex name its middle, which
    ``skin`` and ``node`` draw. radius is its size in the scene, and towards (3,) leads to who sees it.
    is_hidden: other triangles of the draw are in front of it from wherever it was looked at.
    """

    clip: str
    number: int | None
    time: float | None
    joint: str
    standard: float
    baked: float
    place: Place
    vertex: int
    skin: int
    node: int | None
    towards: tuple[float, float, float]
    radius: float
    is_hidden: bool = False

    @property
    def where(self) -> str:
        """Return the joint and the moment for people, like ``upper arm, Walk 2.70 s``."""
        return f"{self.joint}, {self.clip}" + ("" if self.time is None else f" {self.time:.2f} s")

    @property
    def words(self) -> str:
        """Return the mean errors for people, like ``41° → 3.2°``."""
        return f"{in_degrees(self.standard)} → {in_degrees(self.baked)}"


def in_degrees(value: float) -> str:
    """Return an angle as it reads at a glance: "41°", "3.2°"."""
    return f"{value:.{0 if value >= 10 else 1}f}°"


@dataclass(frozen=True, slots=True)
class Spots:
    """Where a bake shows, and where it makes lighting worse: the best, and the worst, first."""

    shows: tuple[Spot, ...] = ()
    worse: tuple[Spot, ...] = ()


class OtherBake(NamedTuple):
    """Another bake of the same file: its options, and the mean error in degrees that it leaves.

    The truth is the one with the smaller gain.
    """

    options: str
    error: float


@dataclass(frozen=True, slots=True)
class Entry:
    """What the sheet of several files shows of one, whose page is written.

    verdict has the figures of a bake in memory if the file has none. pictures are PNGs: the whole figure and
    the best place, each by standard lighting and by the bake's. byte_length is that of α and β. notices are
    what the page tells. error: the page could not be made.
    """

    verdict: FileVerdict
    pictures: tuple[bytes, ...] = ()
    byte_length: int | None = None
    notices: tuple[Notice, ...] = ()
    error: SkinbakeError | None = None


@dataclass(frozen=True, slots=True)
class FileVerdict:
    """The result of verify for one file.

    poses describes the poses of the lighting figures. scaled_joints are the names of joints that dual
    quaternions take with scale or shear. morphs is None if no baked mesh has morph targets. up_to_date: the
    file was not verified again, because it has passed and is unchanged. record is the entry for a state file.
    timings are seconds by stage, None if they were not requested. figures are those by each truth that was
    measured, all of the same places. reliefs are of mapped normals, None if no primitive has a normal map and
    TANGENT.
    left: a bake has left the file unbaked on purpose, and noted it. mixtures are further poses of a file with
    correctives. others are bakes that light the file better, the one to choose first. command is what bakes a
    file without a bake, empty if nothing in it can be baked. is_partial: it was too much work to measure in
    all poses. unplayed is why no clip was played, None if all could be. spots are its places, if asked for.
    entry is that of a sheet, if any.
    """

    input: str
    checks: tuple[Check, ...] = ()
    figures: Mapping[Truth, Figures] = field(default_factory=dict)
    poses: str = ""
    scaled_joints: tuple[str, ...] = ()
    morphs: MorphCount | None = None
    notices: tuple[Notice, ...] = ()
    error: SkinbakeError | None = None
    up_to_date: bool = False
    record: bytes | None = None
    timings: dict[str, float] | None = None
    reliefs: Reliefs | None = None
    left: bool = False
    mixtures: tuple[Mixture, ...] = ()
    others: tuple[OtherBake, ...] = ()
    command: str = ""
    is_partial: bool = False
    unplayed: InputError | None = None
    spots: Spots | None = None
    entry: Entry | None = None

    @classmethod
    def damaged(cls, name: str, problems: Iterable[Notice]) -> FileVerdict:
        """Return the verdict on a file whose bake is damaged, so that nothing else of it was checked."""
        structure = Check("structure", "failed", tuple(problems))
        rest = [Check(one, "skipped", (), "structure failed") for one in ("freshness", "lighting")]
        return cls(name, (structure, *rest))

    @property
    def by_truth(self) -> dict[str, Normals]:
        """Return the figures of the whole file by each truth; a truth that has none is left out."""
        return {truth: found.whole for truth, found in self.figures.items() if found.whole}

    @property
    def primitives(self) -> list[tuple[Place, Normals]]:
        """Return the figures of each primitive by each truth."""
        return [one for found in self.figures.values() for one in found.primitives]

    @property
    def passed(self) -> bool:
        """Tell whether the file was read and no check failed."""
        return self.error is None and all(check.outcome != "failed" for check in self.checks)

    @property
    def found_no_bake(self) -> bool:
        """Tell whether the file passed only because nothing in it is baked, so that nothing was checked."""
        found = self.passed and bool(self.checks) and not self.left
        return found and all(one.outcome == "skipped" for one in self.checks if one.name != SOURCES)

    @property
    def outcome(self) -> str:
        """Return the outcome in words: passed, failed, not baked, or left unbaked."""
        if not self.passed:
            return "failed"
        return "left unbaked" if self.left else "not baked" if self.found_no_bake else "passed"


def baked_lighting(figures: Mapping[str, ErrorFigures]) -> str:
    """Return the lighting that the bake of a file gives: corrected by targets, or accurate by α and β."""
    return "corrected" if "corrected" in figures else "accurate"


def gain(figures: Mapping[str, ErrorFigures], lighting: str | None = None) -> float | None:
    """Return the standard mean error divided by that of a lighting, None if the latter is rounding.

    Without a name it is the ``baked_lighting``.
    """
    lighting = lighting or baked_lighting(figures)
    if lighting not in figures or figures[lighting].mean < ROUNDING:
        return None
    return figures["standard"].mean / figures[lighting].mean


class Led(NamedTuple):
    """The figures of a file's first method by one truth."""

    truth: str
    method: str
    figures: dict[str, ErrorFigures]


def shown(verdict: FileVerdict) -> Led | None:
    """Return the figures that stand where there is room for one: by triangles; None without figures."""
    return next(_led(verdict), None)


def by_worse_truth(verdict: FileVerdict) -> dict[str, ErrorFigures]:
    """Return the figures that the verdict is on: by the truth with the lower gain; empty without figures."""
    found = _worse(verdict)
    return found.figures if found else {}


def _worse(verdict: FileVerdict) -> Led | None:
    return min(_led(verdict), key=lambda found: gain(found.figures) or math.inf, default=None)


def _led(verdict: FileVerdict) -> Iterator[Led]:
    return (Led(truth, *next(iter(normals.items()))) for truth, normals in verdict.by_truth.items())


def leaves_room(verdict: FileVerdict) -> bool:
    """Tell whether another bake is worth a try: the gain is not clear, or misses a limit.

    A file whose lighting could be measured in part only has no work left for more.
    """
    figures, failed = by_worse_truth(verdict), [one.name for one in verdict.checks if one.outcome == "failed"]
    if not figures or figures["standard"].mean < NEGLIGIBLE or set(failed) - {"limits"}:
        return False
    if verdict.is_partial:
        return False
    factor = gain(figures)
    return factor is not None and (bool(failed) or round(factor, 2) < CLEAR)


def count(totals: Totals, verdict: FileVerdict) -> None:
    """Count a file."""
    if verdict.error:
        totals.add("failed", reason_of(verdict.input, verdict.error), verdict.timings)
    elif not verdict.passed:
        totals.add("failed", f"{verdict.input}: {first_problem(verdict)}", verdict.timings)
    else:
        totals.not_baked += verdict.found_no_bake
        totals.left += verdict.left
        totals.command = verdict.command or totals.command
        factor = gain(found.figures) if (found := shown(verdict)) else None
        totals.gains += [] if factor is None else [(factor, verdict.input)]
        totals.add("up-to-date" if verdict.up_to_date else "passed", "", verdict.timings)


def first_problem(verdict: FileVerdict) -> str:
    """Return the first problem of a verdict that failed, and the number of further ones."""
    problems = [problem for check in verdict.checks for problem in check.problems]
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    where = problems[0].place.within_file
    return f"{f'{where}: ' if where else ''}{problems[0].message}{more}"


def as_text(verdict: FileVerdict) -> str:
    """Return the verdict in full, as -v shows it: every check, a short aligned table, and the conclusion."""
    if verdict.up_to_date:
        return _head(verdict)
    lines = [_head(verdict), *_check_lines(verdict.checks)]
    if verdict.by_truth:
        lines += _table(verdict.figures)
        morphs = f"; {verdict.morphs.words}" if verdict.morphs else ""
        over = f"{verdict.poses}{morphs}"
        lines.append(f"  Angle in degrees between each method's normals and the true ones, over {over}.")
        lines += _relief_lines(verdict.reliefs)
    if verdict.spots is not None:
        for title, spots in (
            ("Where it shows", verdict.spots.shows),
            ("Where it gets worse, by over 5° by every truth", verdict.spots.worse),
        ):
            lines.append(f"  {title}:{'' if spots else ' nowhere in these poses'}")
            lines += [f"    {printable(spot.where)}: {spot.words}" for spot in spots]
    lines += [f"  Correctives {printable(mixture.words)}." for mixture in verdict.mixtures]
    lines += [f"  {printable(remark)}" for remark in _scaled(verdict)]
    return "\n".join([*lines, *_advised(verdict)])


def as_brief(verdict: FileVerdict) -> str:
    """Return the verdict on a single file: what failed, the figures by triangles, and the conclusion."""
    lines = [_head(verdict)]
    if verdict.up_to_date:
        return lines[0]
    lines += _check_lines([check for check in verdict.checks if check.outcome == "failed"])
    if found := shown(verdict):
        truth, method, figures = found
        baked = baked_lighting(figures)
        errors = f"standard {figures['standard'].mean:.2f}°, {baked} {figures[baked].mean:.2f}°"
        lines.append(
            f"  {method.upper()} error by {truth}: {errors}, in the mean over {verdict.poses}. -v shows more"
        )
        lines += list(_relief_lines(verdict.reliefs))[:1]
    return "\n".join([*lines, *_advised(verdict)])


def as_line(verdict: FileVerdict) -> str:
    """Return the line of one file among many: the outcome, the gain by triangles, and what is to be done."""
    head = _head(verdict)
    failed = [check.name for check in verdict.checks if check.outcome == "failed"]
    parts = [f"{head} ({', '.join(failed)})" if failed else head]
    parts += [f"run {verdict.command}"] if verdict.command else []
    if (found := shown(verdict)) and (worse := _worse(verdict)):
        truth, method, figures = found
        factor = gain(figures)
        parts += [] if factor is None else [f"{method.upper()} gain {gain_in_words(factor)}x by {truth}"]
        parts += [
            f"mean error {figures['standard'].mean:.2f}° -> {figures[baked_lighting(figures)].mean:.2f}°"
        ]
        verdict_words = conclusion(verdict)
        if verdict_words is not None and verdict_words.leave:
            by = "" if worse.truth == truth else f" by {worse.truth}"
            parts += [f"{verdict_words.short}{by}: leave it unbaked"]
        elif verdict_words is not None and verdict.others:
            parts += [verdict_words.short]
    # The outcome says that it is not baked.
    warnings = sum(notice.code != "not-baked" for notice in warnings_in(verdict.notices))
    parts += [counted(warnings, "warning")] if warnings else []
    return ", ".join(parts)


def _relief_lines(reliefs: Reliefs | None) -> Iterator[str]:
    """Yield a line for each method on the mean errors of mapped normals."""
    for method, figures in ({} if reliefs is None else reliefs.by_normal.whole).items():
        assert reliefs is not None
        best = "exact" if "exact" in figures else "accurate"
        shown = {"standard": "standard", "engine_frame": f"{best} in an engine's frame", best: best}
        words = ", ".join(f"{words} {figures[name].mean:.2f}°" for name, words in shown.items())
        other = reliefs.by_area.whole[method][best].mean
        yield f"  {method.upper()} error of normal maps: {words} ({other:.2f}° if area lifts the relief)"


def _check_lines(checks: Sequence[Check]) -> Iterator[str]:
    width = max((len(check.name) for check in checks), default=0)
    for check in checks:
        remark = f"  {printable(check.remark)}" if check.remark else ""
        yield f"  {check.name:<{width}}  {check.outcome}{remark}"


def _head(verdict: FileVerdict) -> str:
    outcome = "passed before, up to date" if verdict.up_to_date else verdict.outcome
    return f"{printable(verdict.input)}: {'FAILED' if not verdict.passed else outcome}"


def _advised(verdict: FileVerdict) -> list[str]:
    """Return the last line of a verdict: the conclusion and the next step."""
    found = conclusion(verdict)
    return [] if found is None else [f"  {found.sentence} Next: {found.step}."]


def remarks(verdict: FileVerdict) -> list[str]:
    """Return sentences on the figures: which form a method took, and what they come to."""
    found = conclusion(verdict)
    return [*_scaled(verdict), *([found.sentence] if found is not None and found.short else [])]


def _scaled(verdict: FileVerdict) -> list[str]:
    names = verdict.scaled_joints
    if not names:
        return []
    shown = ", ".join(names[:4]) + (", …" if len(names) > 4 else "")
    return [f"Dual quaternions with scale: {shown} {'scales' if len(names) == 1 else 'scale'} or shear."]


@dataclass(frozen=True, slots=True)
class Conclusion:
    """What a verdict comes to: a sentence, and the next step. ``short`` is the verdict on a gain, if any.

    leave: the file is better left unbaked.
    """

    sentence: str
    step: str
    short: str = ""
    leave: bool = False

    @property
    def headline(self) -> str:
        """Return the verdict in a few words, like "Clear gain", or "Leave it unbaked"."""
        if self.leave and self.short == "little to win":
            return "Leave it unbaked"
        return self.sentence.partition(":")[0].rstrip(".")


def conclusion(verdict: FileVerdict) -> Conclusion | None:
    """Return what a verdict comes to; None for a file that was not read now."""
    if verdict.error is not None or verdict.up_to_date:
        return None
    failed = [check.name for check in verdict.checks if check.outcome == "failed"]
    if failed and failed != ["limits"]:
        return Conclusion(f"Failed: {', '.join(failed)}.", "do what the error says, then verify again")
    if verdict.left:
        return Conclusion("A bake has left it as it is, on purpose.", "nothing")
    name, found = shlex.quote(printable(verdict.input)), _worse(verdict)
    if found is not None:
        # Whether a notice advises to bake in another way, not to leave the file.
        advised = any(
            notice.code == "lighting-worse" and isinstance(notice.message, Message)
            for notice in verdict.notices
        )
        if verdict.others:
            now = found.figures[baked_lighting(found.figures)].mean
            told = ", ".join(f"{one.error:.2f}° with {one.options}" for one in verdict.others)
            better = " or ".join(one.options for one in verdict.others)
            sentence = f"Another bake is better: {told}, {now:.2f}° with this one."
            judged = Conclusion(sentence, f"bake with {better}", f"better with {better}")
            meet = f"{judged.step}, or "
        else:
            judged = _on_gain(found.figures, f"skinbake view {name}", advised=advised)
            if not judged.leave and any(one.code == "normals-off-surface" for one in verdict.notices):
                told = judged.sentence.partition(": ")[2]
                sentence = f"Normals do not belong to the surface: {told}"
                judged = Conclusion(sentence, "do what the warning says")
            elif verdict.command and not judged.leave:
                judged = replace(judged, step=f"{verdict.command} {name} --out-dir baked")
            meet = "leave it unbaked by bake --leave-under, or " if judged.leave else ""
        return replace(judged, step=f"{meet}change the limit") if failed else judged
    if any(check.name == "structure" and check.outcome == "skipped" for check in verdict.checks):
        step = (
            f"{verdict.command} {name} --out-dir baked"
            if verdict.command
            else f"skinbake inspect {name} shows why"
        )
        return Conclusion("There is no bake to judge.", step)
    again = (
        f"skinbake view {name} shows them"
        if "random" in verdict.poses
        else f"skinbake verify {name} --poses random"
    )
    sentence = "No light was measured in these poses."
    step = "do what the warning says" if verdict.notices else again
    if verdict.passed and not verdict.poses and any(check.name == "lighting" for check in verdict.checks):
        sentence, step = "Clips of other files play its correctives.", "verify these files"
    return Conclusion(sentence, step)


def _on_gain(figures: Mapping[str, ErrorFigures], look: str, *, advised: bool) -> Conclusion:
    """Return what figures come to, by one table of thresholds (docs/five-minutes.md).

    ``look`` is the command that shows the file. advised: a warning knows a better bake.
    """
    standard, factor = figures["standard"].mean, gain(figures)
    clear = factor is None or round(factor, 2) >= CLEAR  # as it is written, with two decimals
    nearer = "" if factor is None else f"{factor:.1f}" if clear and factor < 100 else gain_in_words(factor)
    told = "exact but for rounding"
    if nearer:
        told = f"{nearer} times nearer to the true normals, by the lower of two measurements"
    if standard < NEGLIGIBLE:
        sentence = f"Nothing to correct: standard lighting errs by {standard:.2f}° in the mean."
        return Conclusion(sentence, "leave the file unbaked", "nothing to correct", leave=True)
    if advised:
        return Conclusion(f"Another bake is better: this one is {told}.", "bake as the warning says")
    shows = f"{look} shows"
    if factor is None or clear:
        return Conclusion(f"Clear gain: {told}.", f"{shows} where", "clear gain")
    if round(factor, 2) >= LITTLE:
        step = f"{shows} whether it is worth its bytes"
        return Conclusion(f"Small gain: {told}.", step, "small gain")
    return Conclusion(f"Little to win: {told}.", "leave the file unbaked", "little to win", leave=True)


def _table(by_truth: Mapping[Truth, Figures]) -> Iterator[str]:
    """Yield the table's lines: figures by triangles, then mean and 95th percentile by tangents."""
    yield f"  {'':<16}{'    by triangles':<32}{'by tangents':>18}"
    yield f"  {'':<16}{'mean':>8}{'p95':>8}{'p99':>8}{'max':>8}{'mean':>10}{'p95':>8}  worst at"
    first, second = (by_truth[truth].whole for truth in USUAL_TRUTHS)
    for method, figures in (second | first).items():
        for lighting in SHOWN_LIGHTINGS:
            if lighting in figures:
                # A mesh that has each triangle twice, once for each side, has no figures by triangles.
                error, other = (found.get(method, {}).get(lighting) for found in (first, second))
                numbers = f"{'—':>8}" * 4
                if error is not None:
                    numbers = f"{error.mean:8.2f}{error.p95:8.2f}{error.p99:8.2f}{error.max:8.2f}"
                numbers += f"{'—':>10}{'—':>8}" if other is None else f"{other.mean:10.2f}{other.p95:8.2f}"
                worst, when = figures[lighting].worst, printable(figures[lighting].worst.clip)
                if worst.time is not None:
                    when = f'clip "{when}" at {worst.time:.2f} s'
                where = f"{worst.place.within_file}, vertex {worst.vertex}, {when}"
                yield f"  {method.upper() + ' ' + lighting:<16}{numbers}  {where}"
        factors = {str(truth): gain(found.whole.get(method, {})) for truth, found in by_truth.items()}
        told = [
            f"{gain_in_words(factor)}x by {truth}" for truth, factor in factors.items() if factor is not None
        ]
        if told:
            ratio = f"(standard mean / {baked_lighting(figures)} mean)"
            yield f"  {method.upper() + ' gain':<16}  {', '.join(told)}  {ratio}"


def file_json(verdict: FileVerdict) -> dict[str, Any]:
    """Return the result of verify for one file as a JSON object (docs/reference/json.md)."""
    reliefs = verdict.reliefs
    mapped = dict(reliefs.by_normal.primitives) if reliefs else {}
    mapped_by_area = dict(reliefs.by_area.primitives) if reliefs else {}
    places = {truth: dict(found.primitives) for truth, found in verdict.figures.items()}
    return {
        "input": verdict.input,
        "passed": verdict.passed,
        "up_to_date": verdict.up_to_date,
        "checks": [
            {
                "name": check.name,
                "outcome": check.outcome,
                "remark": check.remark,
                "problems": notice_list(check.problems),
            }
            for check in verdict.checks
        ],
        "left": verdict.left,
        "conclusion": None if (found := conclusion(verdict)) is None else found.short or None,
        "others": [one._asdict() for one in verdict.others],
        "poses": verdict.poses or None,
        "morphs": None
        if verdict.morphs is None
        else {"targets": verdict.morphs.targets, "moving": verdict.morphs.moving},
        **{
            member: _normals_json(verdict.figures[truth].whole) if truth in verdict.figures else None
            for truth, member in MEMBERS.items()
        },
        "reliefs": None if reliefs is None else _relief_json(reliefs.by_normal.whole, reliefs.by_area.whole),
        "primitives": [
            {
                **place_fields(place),
                **{member: _normals_json(places[truth][place]) for truth, member in MEMBERS.items()},
                "reliefs": _relief_json(mapped[place], mapped_by_area[place]) if place in mapped else None,
            }
            for place in places.get(Truth.TRIANGLES, {})
        ],
        "scaled_joints": list(verdict.scaled_joints),
        "mixtures": [asdict(mixture) for mixture in verdict.mixtures],
        "warnings": notice_list(verdict.notices),
        "error": error_fields(verdict.error),
        **timing_fields(verdict.timings),
    }


def _normals_json(normals: Normals) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for method, figures in normals.items():
        result[method] = {
            lighting: {
                "mean": error.mean,
                "p95": error.p95,
                "p99": error.p99,
                "max": error.max,
                "worst": {
                    **place_fields(error.worst.place),
                    "vertex": error.worst.vertex,
                    "clip": error.worst.clip,
                    "time": error.worst.time,
                },
            }
            for lighting, error in figures.items()
        }
        result[method]["gain"] = gain(figures)
    return result


def _relief_json(normals: Normals, by_area: Normals) -> dict[str, Any]:
    return {"normals": _normals_json(normals), "normals_by_area": _normals_json(by_area)}


def as_junit(verdicts: Sequence[FileVerdict]) -> str:
    """Return the verdicts as JUnit XML: a suite for each file, a case for each check.

    A suite has the gain and both mean errors in degrees as properties, and the seconds of its cases. The
    class of a case is its file, because many programs show and compare cases by class and name only. A
    file that was not verified again has one case, ``up-to-date``: some programs refuse a report without any.
    """
    from xml.etree import ElementTree  # only --junit needs it

    root = ElementTree.Element("testsuites", name="skinbake verify")
    for verdict in verdicts:
        suite = ElementTree.SubElement(root, "testsuite", name=verdict.input)
        suite.set("time", f"{sum(check.seconds or 0.0 for check in verdict.checks):.3f}")
        if figures := by_worse_truth(verdict):
            measured = {"standard": figures["standard"].mean, "gain": gain(figures)}
            measured[baked_lighting(figures)] = figures[baked_lighting(figures)].mean
            properties = ElementTree.SubElement(suite, "properties")
            for name, degrees in measured.items():
                told = "exact" if degrees is None else f"{degrees:.3f}"
                ElementTree.SubElement(properties, "property", name=name, value=told)
        before = (Check("up-to-date", "passed"),) if verdict.up_to_date else ()
        checks = (*before, *verdict.checks)
        cases: list[str] = [check.outcome for check in checks]
        for check in checks:
            case = ElementTree.SubElement(suite, "testcase", name=check.name, classname=verdict.input)
            if check.seconds is not None:
                case.set("time", f"{check.seconds:.3f}")
            if check.outcome == "failed":
                more = f" (and {len(check.problems) - 1} more)" if len(check.problems) > 1 else ""
                failure = ElementTree.SubElement(case, "failure", message=f"{check.problems[0]}{more}")
                failure.text = "\n".join(str(problem) for problem in check.problems)
            elif check.outcome == "skipped":
                ElementTree.SubElement(case, "skipped", message=check.remark)
        if verdict.error is not None:
            case = ElementTree.SubElement(suite, "testcase", name="read", classname=verdict.input)
            ElementTree.SubElement(case, "error", message=str(verdict.error))
            cases.append("error")
        suite.set("tests", str(len(cases)))
        suite.set("failures", str(cases.count("failed")))
        suite.set("errors", str(cases.count("error")))
        suite.set("skipped", str(cases.count("skipped")))
    for element in root.iter():
        element.text = element.text and NOT_IN_XML.sub("\ufffd", element.text)
        for key, value in element.items():
            element.set(key, NOT_IN_XML.sub("\ufffd", value))
    ElementTree.indent(root)
    return XML_DECLARATION + ElementTree.tostring(root, encoding="unicode") + "\n"
