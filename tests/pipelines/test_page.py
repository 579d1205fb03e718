"""The page about pipelines against the files that it describes."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.support.command_line import invoke
from tests.support.models import FOLDER
from tests.support.strictness import missing_tool

try:
    import yaml
except ImportError:
    missing_tool("PyYAML is not installed; the extra dev has it with pre-commit")

REPOSITORY = Path(__file__).parents[2]
TEXT = (REPOSITORY / "docs" / "pipelines.md").read_text("utf-8")
OPTIONS = (REPOSITORY / "docs" / "reference" / "configuration.md").read_text("utf-8")
BLOCKS: list[tuple[str, str]] = re.findall(r"```(\w+)\n(.*?)```", TEXT, re.DOTALL)


def block(kind: str, words: str = "") -> str:
    """Return the block of a kind that has some words."""
    return next(text for one, text in BLOCKS if one == kind and words in text)


def rows(heading: str) -> set[str]:
    """Return the names in the first column of the table below a heading."""
    return set(
        re.findall(r"^\| `([\w-]+)` \|", TEXT.partition(f"\n## {heading}\n")[2].partition("\n## ")[0], re.M)
    )


def test_inputs_and_hooks_are_those_of_the_files() -> None:
    action: dict[str, Any] = yaml.safe_load((REPOSITORY / "action.yml").read_text("utf-8"))
    hooks = {
        hook["id"] for hook in yaml.safe_load((REPOSITORY / ".pre-commit-hooks.yaml").read_text("utf-8"))
    }
    assert rows("GitHub Actions") == set(action["inputs"])
    assert rows("pre-commit") == hooks
    (job,) = yaml.safe_load(block("yaml", "actions/checkout"))["jobs"].values()
    assert set(job["steps"][-1]["with"]) <= set(action["inputs"])
    (repository,) = yaml.safe_load(block("yaml", "hooks:"))["repos"]
    assert {hook["id"] for hook in repository["hooks"]} <= hooks


@pytest.mark.slow
def test_the_commands_for_a_folder_work_as_they_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".git").mkdir()
    options = OPTIONS.partition("```toml\n")[2].partition("```")[0]
    (tmp_path / "skinbake.toml").write_text(options, encoding="utf-8")
    (tmp_path / "art" / "heroes").mkdir(parents=True)
    shutil.copyfile(FOLDER / "bent_tube.glb", tmp_path / "art" / "heroes" / "knight.glb")
    for turn in range(2):
        for line in block("sh").splitlines():
            program, *arguments = shlex.split(line)
            assert program == "skinbake"
            result = invoke(*arguments)
            assert result.exit_code == 0
            assert ("up to date" in result.stdout) is (turn == 1)
    assert "for **/heroes/**" in invoke("config", "--changed", "art/heroes/knight.glb").stdout
