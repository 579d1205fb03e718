"""The limits of verify: whether the accurate lighting of a file keeps them, and the words if it does not."""

from __future__ import annotations

from collections.abc import Mapping

from skinbake.choices import Truth
from skinbake.errors import Notice, Place
from skinbake.lighting.verify_options import VerifyOptions
from skinbake.report.verify import Check, Normals, gain


def limits_check(by_truth: Mapping[Truth, Normals], options: VerifyOptions, place: Place) -> Check:
    """Return whether the accurate lighting keeps the limits by all of the truths."""
    problems = _exceeded(by_truth, options, place)
    if problems:
        return Check("limits", "failed", tuple(problems), "; ".join(problem.message for problem in problems))
    bends = any(gain(figures) is not None for normals in by_truth.values() for figures in normals.values())
    remark = "no gain to hold to --min-gain: nothing bends in these poses"
    return Check("limits", "passed", (), remark if options.min_gain is not None and not bends else "")


def _exceeded(by_truth: Mapping[Truth, Normals], options: VerifyOptions, place: Place) -> list[Notice]:
    """Return a problem for each limit that the accurate lighting of a method exceeds, by the worst truth."""
    problems = []
    for method in options.methods or ("lbs",):
        found = {truth: normals.get(method, {}) for truth, normals in by_truth.items()}
        found = {truth: figures for truth, figures in found.items() if "accurate" in figures}
        if not found:
            message = (
                f"{method.upper()}: it cannot meet {' and '.join(options.limits)}, because there is no true "
                "normal at any vertex in these poses"
            )
            problems.append(Notice("no-figures", message, place))
            continue
        for name, limit, values in (
            ("mean", options.max_mean_error, {by: one["accurate"].mean for by, one in found.items()}),
            (
                "95th percentile",
                options.max_p95_error,
                {by: one["accurate"].p95 for by, one in found.items()},
            ),
        ):
            worst = max(values, key=lambda truth: values[truth])
            if limit is not None and not values[worst] <= limit:
                message = (
                    f"{method.upper()} accurate: the {name} of the error is "
                    f"{_told_apart(values[worst], limit, 3)}° by {worst}, over {limit:.15g}°"
                )
                problems.append(Notice("limit", message, place))
        gains = {truth: factor for truth, one in found.items() if (factor := gain(one)) is not None}
        least = min(gains, key=lambda truth: gains[truth], default=None)
        if options.min_gain is not None and least is not None and gains[least] < options.min_gain:
            found_gain = _told_apart(gains[least], options.min_gain, 2)
            message = f"{method.upper()}: the gain is {found_gain} by {least}, below {options.min_gain:.15g}"
            problems.append(Notice("limit", message, place))
    return problems


def _told_apart(value: float, limit: float, decimals: int) -> str:
    """Return a value with some decimals, or with so many more that it is on the right side of a limit."""
    text = f"{value:.{decimals}f}"
    while value != limit and (float(text) == limit or (float(text) > limit) != (value > limit)):
        decimals += 1
        text = f"{value:.{decimals}f}"
    return text
