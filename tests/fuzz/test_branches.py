"""A missed branch needs an explanation, and an explanation a missed branch."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz import branches
from fuzz.explained import EXPLAINED, WINDOWS
from fuzz.measuring import REPOSITORY, SOURCE

TEXT = """def first(x):
    if x:
        return 1
    if x:
        return 1
    return 2
"""

REACHED = ("a.py", "first", "if x: -> return 1")
MISSED = ("a.py", "first", "if x: -> return 1 #2")


def test_branches_are_told_by_function_and_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / SOURCE
    folder.mkdir(parents=True)
    (folder / "a.py").write_text(TEXT)
    monkeypatch.setattr(branches, "REPOSITORY", tmp_path)
    content = {"executed_branches": [[2, 3], [2, 4], [4, 6]], "missing_branches": [[4, 5]]}
    reached, missed = branches.branches({"files": {f"{SOURCE}/a.py": content}})
    assert REACHED in reached
    assert len(reached) == 3
    assert missed == {MISSED: "a.py:4"}


@pytest.mark.parametrize(
    ("explained", "wrong"),
    [
        ({MISSED: "why"}, None),
        ({}, "is missed, and nothing explains it"),
        ({MISSED: "why", REACHED: "why"}, "explained, but reached"),
        ({MISSED: "why", REACHED: WINDOWS}, None),
        ({MISSED: "why", ("b.py", "", "x"): "why"}, "explained, but not there"),
    ],
)
def test_each_missed_branch_has_its_explanation(
    explained: dict[tuple[str, str, str], str], wrong: str | None
) -> None:
    lines, found = branches.judged({REACHED: "a.py:2"}, {MISSED: "a.py:4"}, explained)
    assert lines[0].endswith("reached: 50.0 %")
    assert [wrong is not None and wrong in line for line in found] == ([] if wrong is None else [True])


def test_each_explanation_is_of_lines_that_are_there() -> None:
    """A run of minutes finds out which branches are missed, but an edit of a line shows at once."""
    for file, _, branch in EXPLAINED:
        lines = {line.strip() for line in (REPOSITORY / SOURCE / file).read_text("utf-8").splitlines()}
        start, _, goal = branch.partition(" -> ")
        assert start in lines, (file, branch)
        assert goal.partition(" #")[0] in {*lines, "the end"} or goal in lines, (file, branch)
