from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz import branches

TEXT = """def first(x):
    if x is None:  # pragma: no cover: why
        return 1
    return 2

first(1)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "missed"),
    [
        (TEXT, []),
        (TEXT.replace("# pragma", "#"), ["a.py:2 is missed: if x is None:  #: no cover: why -> return 1"]),
    ],
)
def test_a_missed_branch_is_told_unless_its_line_is_marked(
    text: str, missed: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.py").write_text(text)
    for arguments in (["run", "--branch", "a.py"], ["json", "-o", "report.json", "-q"]):
        subprocess.run([sys.executable, "-m", "coverage", *arguments], check=True)
    monkeypatch.setattr(branches, "REPOSITORY", tmp_path)
    assert branches.missed(json.loads(Path("report.json").read_text())) == missed
