"""The line about all files that stands at the end of many."""

from __future__ import annotations

import pytest

from skinbake.report.totals import Totals, closing_line


def totals_of(**counts: int) -> Totals:
    totals = Totals(30, ("passed", "up-to-date", "failed"))
    for outcome, count in counts.items():
        for _ in range(count):
            totals.add(outcome.replace("_", "-"), "", None)
    return totals


@pytest.mark.parametrize(
    ("seconds", "rate"),
    [
        (0.0, "at once"),
        (2.0, "15 files/s"),
        (3.0, "10 files/s"),
        (3.2, "9.38 files/s"),
        (60.0, "0.50 files/s"),
    ],
)
def test_the_rate_has_as_many_digits_as_it_needs(seconds: float, rate: str) -> None:
    line = closing_line(totals_of(passed=27, up_to_date=1, failed=2), seconds)
    assert line == f"30 files: 27 passed, 1 up to date, 2 failed, in {seconds:.1f} s ({rate})"


@pytest.mark.parametrize(
    ("counts", "line"),
    [
        ({}, "interrupted after 0 of 30 files: none done, in 2.0 s"),
        ({"passed": 1}, "interrupted after 1 of 30 files: 1 passed, in 2.0 s (0.50 files/s)"),
    ],
)
def test_an_interrupted_run_says_what_was_done(counts: dict[str, int], line: str) -> None:
    assert closing_line(totals_of(**counts), 2.0, interrupted=True) == line
