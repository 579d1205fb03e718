"""The limits of verify: whether the accurate lighting of a file keeps them, and the words if it does not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeAlias

from skinbake.choices import Truth
from skinbake.errors import Notice, Place
from skinbake.lighting.verify_options import VerifyOptions
from skinbake.report.verify import Check, ErrorFigures, Normals, gain
from skinbake.wording import told_apart


def limits_check(by_truth: Mapping[Truth, Normals], options: VerifyOptions, place: Place) -> Check:
    """Return whether the accurate lighting keeps the limits by all of the truths."""
    problems = tuple(_exceeded(by_truth, options, place))
    if problems:
        return Check("limits", "failed", problems, "; ".join(problem.message for problem in problems))
    bends = any(gain(figures) is not None for normals in by_truth.values() for figures in normals.values())
    remark = "no gain to hold to --min-gain: nothing bends in these poses"
    return Check("limits", "passed", (), remark if options.min_gain is not None and not bends else "")


def _exceeded(by_truth: Mapping[Truth, Normals], options: VerifyOptions, place: Place) -> Iterator[Notice]:
    """Yield a problem for each limit that the accurate lighting of a method exceeds, by the worst truth."""
    for method in options.methods or ("lbs",):
        of_truths = {truth: normals.get(method, {}) for truth, normals in by_truth.items()}
        found = {truth: figures for truth, figures in of_truths.items() if "accurate" in figures}
        if found:
            yield from _errors_over(method, found, options, place)
            yield from _gain_under(method, found, options, place)
        else:
            message = (
                f"{method.upper()}: it cannot meet {' and '.join(options.limits)}, because there is no true "
                "normal at any vertex in these poses"
            )
            yield Notice("no-figures", message, place)


_OfTruths: TypeAlias = Mapping[Truth, dict[str, ErrorFigures]]
"""The figures of one method by truth, then by lighting. Accurate lighting is among them."""


def _errors_over(method: str, found: _OfTruths, options: VerifyOptions, place: Place) -> Iterator[Notice]:
    """Yield a problem for each figure of the error in degrees that is over its limit."""
    for name, limit, values in (
        ("mean", options.max_mean_error, {by: one["accurate"].mean for by, one in found.items()}),
        ("95th percentile", options.max_p95_error, {by: one["accurate"].p95 for by, one in found.items()}),
    ):
        worst = max(values, key=lambda truth: values[truth])
        if limit is not None and not values[worst] <= limit:
            message = (
                f"{method.upper()} accurate: the {name} of the error is "
                f"{told_apart(values[worst], limit, 3)}° by {worst}, over {limit:.15g}°"
            )
            yield Notice("limit", message, place)


def _gain_under(method: str, found: _OfTruths, options: VerifyOptions, place: Place) -> Iterator[Notice]:
    """Yield a problem if the gain is under its limit. No gain is required where nothing bends."""
    gains = {truth: factor for truth, one in found.items() if (factor := gain(one)) is not None}
    least = min(gains, key=lambda truth: gains[truth], default=None)
    if options.min_gain is not None and least is not None and gains[least] < options.min_gain:
        found_gain = told_apart(gains[least], options.min_gain, 2)
        message = f"{method.upper()}: the gain is {found_gain} by {least}, below {options.min_gain:.15g}"
        yield Notice("limit", message, place)
