"""The fuzzer's shortcuts change nothing that a command does; they alter click: a child process has them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

PROGRAM = """
import sys
sys.path.insert(0, {root!r})
from click.testing import CliRunner
from fuzz.shortcuts import remember_what_never_changes
from skinbake.cli.main import main

LINES = (
    ["bake", {model!r}, "--dry-run", "--json"],
    ["bake", {model!r}, "--dry-run", "--json", "--encoding", "packed8", "--weld", "skin"],
    ["bake", {model!r}, "--dry-run", "--json"],
    ["bake", {model!r}, "--weighting", "none"],
    ["bake", {model!r}, "--dry-run", "--in-place"],
    ["bake", {model!r}, "--no-such-option"],
    ["bake"],
    ["shader", "--for", {model!r}, "--cap"],
    ["shader", "--for", {model!r}],
    ["inspect", {model!r}, "--json"],
    ["inspect", "--help"],
)


def outcomes():
    results = [CliRunner().invoke(main, line) for line in LINES]
    return [(result.exit_code, result.output) for result in results]


before = outcomes()
remember_what_never_changes()
assert len(set(code for code, _ in before)) > 1, before
for again in range(2):
    for line, one, other in zip(LINES, before, outcomes(), strict=True):
        assert one == other, (line, one, other)
"""


@pytest.mark.slow
def test_shortcuts_change_no_output_and_no_exit_code() -> None:
    """Each line prints and ends the same, before the shortcuts and twice after them."""
    model = str(REPOSITORY / "fixtures" / "bent_tube.glb")
    program = PROGRAM.format(root=str(REPOSITORY), model=model)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
