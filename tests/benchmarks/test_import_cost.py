"""The benchmark of imports: it reads what Python says, and its budgets can be exceeded. No time is judged."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.import_cost import Budget, cases, least, over, table, times

SAID = """import time: self [us] | cumulative | imported package
import time:       300 |        300 |   numpy.core
import time:       700 |       1000 | numpy
a warning on stderr
import time:       250 |        250 |   skinbake.errors
import time:       500 |       1750 | skinbake
"""


def test_times_are_each_modules_own() -> None:
    assert times(SAID) == {"numpy.core": 300, "numpy": 700, "skinbake.errors": 250, "skinbake": 500}


@pytest.mark.parametrize(
    ("budget", "sentences"),
    [
        (Budget(2, 0.75), []),
        (Budget(1, 0.75), ["2 modules of our own, at most 1 are wanted"]),
        (Budget(2, 0.7), ["our own modules take 0.75 × numpy, at most 0.7"]),
    ],
)
def test_budgets_are_checked(budget: Budget, sentences: list[str]) -> None:
    assert over(budget, times(SAID)) == sentences


@pytest.mark.slow
def test_the_list_names_what_help_imports() -> None:
    found = least(("--help",), 1)
    assert {"skinbake.cli.main", "click", "typing"} <= found.keys()
    assert "numpy" not in found
    assert any(
        line.split()[0] == "skinbake" and line.split()[2] == "ms" for line in table("--help", found)[1:]
    )


@pytest.mark.slow
def test_each_command_imports_as_few_modules_as_its_budget_has(tmp_path: Path) -> None:
    for case in cases(tmp_path):
        too_many = [told for told in over(case.budget, least(case.arguments, 1)) if "are wanted" in told]
        assert not too_many, case.name
