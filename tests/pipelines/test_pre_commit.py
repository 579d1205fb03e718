"""The hooks of pre-commit, run by pre-commit itself in a repository of its own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.pipelines.programs import environment_with_skinbake
from tests.support.command_line import invoke
from tests.support.models import FOLDER, SHARED, copied
from tests.support.strictness import missing_tool
from tests.support.tools import required_program

HOOKS = Path(__file__).parents[2] / ".pre-commit-hooks.yaml"

CONFIG = """
repos:
  - repo: {repository}
    rev: {revision}
    hooks:
      - {{id: skinbake-inspect, language: system}}
      - {{id: skinbake-config, language: system}}
      - {{id: skinbake-verify, language: system, args: [--require-baked, "--poses=random:1"]}}
      - {{id: skinbake-bake, language: system, stages: [manual]}}
"""


class Commits:
    """A repository whose hooks are those of a copy of ours, with this environment instead of a new one.

    ``language: system`` replaces the installation by pip, which takes minutes and a network.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "project"
        self.environment = environment_with_skinbake(
            folder / "bin",
            PRE_COMMIT_HOME=str(folder / "cache"),
            GIT_CONFIG_GLOBAL="/dev/null",
            GIT_CONFIG_NOSYSTEM="1",
            **{f"GIT_{who}_{what}": "a@b.c" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")},
        )
        ours = folder / "hooks"
        for repository in (ours, self.folder):
            repository.mkdir()
            self.git("init", "-q", folder=repository)
        shutil.copyfile(HOOKS, ours / HOOKS.name)
        self.git("add", ".", folder=ours)
        self.git("commit", "-qm", "Add hooks", folder=ours)
        revision = self.git("rev-parse", "HEAD", folder=ours).strip()
        self.write(".pre-commit-config.yaml", CONFIG.format(repository=ours, revision=revision))

    def git(self, *arguments: str, folder: Path | None = None) -> str:
        return subprocess.run(
            ["git", *arguments],
            cwd=folder or self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    def write(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text, encoding="utf-8")

    def hook(self, name: str, *options: str, adds: str = "-A") -> tuple[int, str]:
        """Add files, and run a hook on those that are to be committed."""
        self.git("add", adds)
        process = subprocess.run(
            [sys.executable, "-m", "pre_commit", "run", "--color=never", *options, name],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return process.returncode, process.stdout + process.stderr


@pytest.fixture(scope="module")
def commits(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Commits]:
    if find_spec("pre_commit") is None:
        missing_tool("pre-commit is not installed; the extra dev has it")
    required_program("git")
    yield Commits(tmp_path_factory.mktemp("commits"))


@pytest.mark.slow
def test_the_manifest_is_valid(commits: Commits) -> None:
    command = [sys.executable, "-m", "pre_commit", "validate-manifest", str(HOOKS)]
    process = subprocess.run(command, env=commits.environment, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout) == (0, "")


@pytest.mark.slow
def test_hooks_pass_and_fail(commits: Commits) -> None:
    """They get the files of the commit that are models, and no others."""
    (commits.folder / "a b.glb").write_bytes(b"glTF, but no more than that")
    commits.write("notes.txt", "no model")
    code, text = commits.hook("skinbake-inspect")
    assert code == 1
    assert "a b.glb" in text
    assert "notes.txt" not in text
    shutil.copyfile(FOLDER / "seam.glb", commits.folder / "a b.glb")
    assert commits.hook("skinbake-inspect")[0] == 0

    code, text = commits.hook("skinbake-verify")
    assert code == 1
    assert "a b.glb: FAILED" in text

    code, text = commits.hook("skinbake-bake", "--hook-stage", "manual")
    assert code == 1
    assert "files were modified by this hook" in text
    assert commits.hook("skinbake-bake", "--hook-stage", "manual")[0] == 0  # a second bake changes nothing
    assert commits.hook("skinbake-verify")[0] == 0
    assert (
        invoke("verify", commits.folder / "a b.glb", "--require-baked", "--poses", "random:1").exit_code == 0
    )

    commits.write("skinbake.toml", "[verify]\nmin-gain = 1000000.0\n")
    code, text = commits.hook("skinbake-verify")
    assert code == 1
    assert commits.hook("skinbake-config")[0] == 0
    commits.write("skinbake.toml", "[verify]\nmin-gian = 2\n")
    code, text = commits.hook("skinbake-config")
    assert code == 1
    assert "skinbake.toml:2: verify.min-gian" in text


@pytest.mark.slow
def test_a_commit_without_a_buffer_stops(commits: Commits) -> None:
    """The second bake changes nothing: git knows the model, but not the buffer that the first one made."""
    (commits.folder / "skinbake.toml").unlink(missing_ok=True)
    source = copied(SHARED, commits.folder / "buffers")
    commits.git("add", "-A")
    manual = "--hook-stage", "manual"
    code, text = commits.hook("skinbake-bake", *manual)
    assert code == 1
    code, text = commits.hook("skinbake-bake", *manual, adds=f"buffers/{source.name}")
    assert code == 1
    (made,) = source.parent.glob("skinbake-*.bin")
    assert f"git does not track {made.name}" in text
    code, text = commits.hook("skinbake-bake", *manual)
    assert code == 0, text
