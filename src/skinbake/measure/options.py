"""The options of ``skinbake verify``, as values that its parts read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from skinbake.choices import USUAL_TRUTHS, Baseline, Truth, pose_choice
from skinbake.errors import Notice, Place
from skinbake.options import VERIFY, By, checked, defaults
from skinbake.report.verify import NEGLIGIBLE, Check, ErrorFigures, Normals, baked_lighting, gain
from skinbake.truth.poses import PoseRequest
from skinbake.wording import told_apart


@dataclass(frozen=True, slots=True)
class VerifyOptions:
    """The options of ``skinbake verify``.

    methods are the requested ones. If empty: both. Limits are degrees, or a factor, of the accurate lighting.
    None sets no limit. They are checked by the named truth, or, if it is None, by each of ``USUAL_TRUTHS``.
    finds_places: where a bake shows, and where it gets worse, is found too.
    """

    methods: tuple[str, ...] = ()
    poses: PoseRequest = field(default_factory=PoseRequest)
    max_mean_error: float | None = None
    max_p95_error: float | None = None
    min_gain: float | None = None
    require_baked: bool = False
    warnings_as_errors: bool = False
    cap: float | None = None
    baseline: Baseline = Baseline.BLENDED
    truth: Truth | None = None
    finds_places: bool = False

    @classmethod
    def of(cls, **given: Any) -> VerifyOptions:
        """Return the options that the words and numbers of a user stand for, under the names of verify's.

        poses is ``animation``, ``random``, ``random:N`` or ``rest``. angle is in degrees. Raises ChoiceError
        for a value that does not exist.
        """
        words = checked(VERIFY, {**defaults(VERIFY, By.OVERRIDE), **given})
        kind, count = pose_choice(words.pop("poses"))
        samples, angle = words.pop("samples"), math.radians(words.pop("angle"))
        return cls(
            methods=tuple(dict.fromkeys(words.pop("methods"))),
            poses=PoseRequest(kind, count or samples, angle, words.pop("seed")),
            **words,
        )

    @property
    def truths(self) -> tuple[Truth, ...]:
        """Return the truths to measure by, in the order of ``Truth``: the named one beside the usual ones."""
        return tuple(truth for truth in Truth if truth in {*USUAL_TRUTHS, self.truth})

    @property
    def limits(self) -> dict[str, float]:
        """Return the limits that are set, by option."""
        given = {
            "--max-mean-error": self.max_mean_error,
            "--max-p95-error": self.max_p95_error,
            "--min-gain": self.min_gain,
        }
        return {option: limit for option, limit in given.items() if limit is not None}


def limits_check(by_truth: Mapping[Truth, Normals], options: VerifyOptions, place: Place) -> Check:
    """Return whether the accurate lighting keeps the limits by all of the truths."""
    problems = tuple(_exceeded(by_truth, options, place))
    if problems:
        return Check("limits", "failed", problems, "; ".join(problem.message for problem in problems))
    counts = any(_gain_counts(figures) for normals in by_truth.values() for figures in normals.values())
    remark = f"no gain to hold to --min-gain: standard lighting is off by under {NEGLIGIBLE}°"
    return Check("limits", "passed", (), remark if options.min_gain is not None and not counts else "")


def _gain_counts(figures: Mapping[str, ErrorFigures]) -> bool:
    """Tell whether there is something to correct: else a small gain is not a fault of the bake."""
    return gain(figures) is not None and figures["standard"].mean >= NEGLIGIBLE


def _exceeded(by_truth: Mapping[Truth, Normals], options: VerifyOptions, place: Place) -> Iterator[Notice]:
    """Yield a problem for each limit that the accurate lighting of a method exceeds, by the worst truth."""
    for method in options.methods or ("lbs",):
        of_truths = {truth: normals.get(method, {}) for truth, normals in by_truth.items()}
        found = {truth: figures for truth, figures in of_truths.items() if baked_lighting(figures) in figures}
        if found:
            messages = *_errors_over(method, found, options), *_gain_under(method, found, options)
            yield from (Notice("limit", message, place) for message in messages)
        else:
            why = "there is no true normal at any vertex in these poses"
            if options.truth is Truth.RELIEF:
                why = "no baked primitive has a normal map and TANGENT"
            message = f"{method.upper()}: it cannot meet {' and '.join(options.limits)}, because {why}"
            yield Notice("no-figures", message, place)


_OfTruths: TypeAlias = Mapping[Truth, dict[str, ErrorFigures]]
"""The figures of one method by truth, then by lighting. Accurate lighting is among them."""


def _errors_over(method: str, found: _OfTruths, options: VerifyOptions) -> Iterator[str]:
    """Yield what is wrong with each figure of the error in degrees that is over its limit."""
    baked = {truth: one[baked_lighting(one)] for truth, one in found.items()}
    for name, limit, values in (
        ("mean", options.max_mean_error, {truth: one.mean for truth, one in baked.items()}),
        ("95th percentile", options.max_p95_error, {truth: one.p95 for truth, one in baked.items()}),
    ):
        worst = max(values, key=lambda truth: values[truth])
        if limit is not None and not values[worst] <= limit:
            yield (
                f"{method.upper()} {baked_lighting(found[worst])}: the {name} of the error is "
                f"{told_apart(values[worst], limit, 3)}° by {worst}, over {limit:.15g}°"
            )


def _gain_under(method: str, found: _OfTruths, options: VerifyOptions) -> Iterator[str]:
    """Yield what is wrong if the gain is under its limit. Where nothing is to be corrected, none is asked."""
    gains = {truth: factor for truth, one in found.items() if (factor := gain(one)) and _gain_counts(one)}
    least = min(gains, key=lambda truth: gains[truth], default=None)
    if options.min_gain is not None and least is not None and gains[least] < options.min_gain:
        found_gain = told_apart(gains[least], options.min_gain, 2)
        yield f"{method.upper()}: the gain is {found_gain} by {least}, below {options.min_gain:.15g}"
