"""Whole processes are measured as users run them: in turn, with their own memory, and failures are said."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.processes import MIB, Rounds, in_turn, run

HUNDRED_MIB = f"block = b'x' * {100 * MIB}"


def python(program: str) -> list[str]:
    return [sys.executable, "-c", program]


@pytest.mark.slow
def test_the_memory_is_the_commands_own() -> None:
    held = np.ones(100 * MIB // 8)
    empty, full = run(python("pass")), run(python(HUNDRED_MIB))
    assert empty.mib < 50
    assert 100 < full.mib < 150
    assert held.nbytes == 100 * MIB


def test_a_process_that_the_command_starts_counts() -> None:
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {HUNDRED_MIB!r}])"
    assert run(python(child)).mib > 100


def test_what_is_printed_is_kept() -> None:
    assert run(python("import sys; sys.stdout.write('one\\ntwo')")).printed.split() == ["one", "two"]


def test_bytecode_is_kept_as_users_keep_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    assert run(python("import sys; print(sys.dont_write_bytecode)")).printed.strip() == "False"


def test_a_command_that_fails_ends_the_run() -> None:
    with pytest.raises(SystemExit, match=r"failed \(3\):\nno good"):
        run(python("import sys; print('no good', file=sys.stderr); sys.exit(3)"))


@pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity"), reason="this system cannot bind a process to a core"
)
def test_a_process_on_one_core_sees_one_core() -> None:
    asked = "import os; print(len(os.sched_getaffinity(0)))"
    assert run(python(asked), one_core=True).printed.strip() == "1"


@pytest.mark.slow
def test_commands_take_turns_and_the_first_round_does_not_count(tmp_path: Path) -> None:
    log = tmp_path / "log"
    commands = {name: python(f"open({str(log)!r}, 'a').write({name!r})") for name in "AB"}
    taken = in_turn(commands, Rounds(least=2, most=2))
    assert log.read_text() == "ABABAB"
    assert {name: len(row["seconds"]) for name, row in taken.items()} == {"A": 2, "B": 2}


@pytest.mark.parametrize(("budget", "rounds"), [(0.0, 2), (1e9, 3)])
def test_rounds_beyond_the_least_end_with_the_budget(budget: float, rounds: int) -> None:
    taken = in_turn({"A": python("pass")}, Rounds(least=2, most=3, budget=budget, warm_up=False))
    assert len(taken["A"]["mib"]) == rounds
