"""Limits on errors and gains: a figure that is exactly the limit keeps it, and the worse truth counts."""

from __future__ import annotations

from typing import Any

import pytest

from skinbake.choices import Truth
from skinbake.errors import Place
from skinbake.measure.options import VerifyOptions, limits_check
from skinbake.report.verify import ErrorFigures, Normals, Worst

HERE = Place("hero.glb")


def lit(standard: float, accurate: float) -> Normals:
    """Make figures whose 95th percentile is four times their mean."""
    found = {
        name: ErrorFigures(mean, 4.0 * mean, 5.0 * mean, 6.0 * mean, Worst(HERE, 7, "run", 0.25))
        for name, mean in (("standard", standard), ("accurate", accurate))
    }
    return {"lbs": found}


@pytest.mark.parametrize(
    ("kept", "missed", "words"),
    [
        (
            {"max_mean_error": 2.0},
            {"max_mean_error": 1.875},
            "mean of the error is 2.000° by triangles, over 1.875°",
        ),
        (
            {"max_p95_error": 8.0},
            {"max_p95_error": 7.5},
            "95th percentile of the error is 8.000° by triangles, over 7.5°",
        ),
        ({"min_gain": 2.0}, {"min_gain": 2.125}, "the gain is 2.00 by triangles, below 2.125"),
    ],
)
def test_a_limit_is_kept_by_the_figure_that_is_equal_to_it(
    kept: dict[str, Any], missed: dict[str, Any], words: str
) -> None:
    by_truth = {Truth.TANGENTS: lit(4.0, 1.0), Truth.TRIANGLES: lit(4.0, 2.0)}
    check = limits_check(by_truth, VerifyOptions(**kept), HERE)
    assert (check.outcome, check.problems) == ("passed", ())
    check = limits_check(by_truth, VerifyOptions(**missed), HERE)
    assert check.outcome == "failed"
    (problem,) = check.problems
    assert words in problem.message
