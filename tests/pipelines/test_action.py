"""The GitHub Action: its steps are run by bash as a runner of GitHub runs them."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.pipelines.programs import environment_with_skinbake
from tests.support.models import FOLDER, SHARED, copied
from tests.support.strictness import missing_tool
from tests.support.tools import required_program

try:
    import yaml
except ImportError:
    missing_tool("PyYAML is not installed; the extra dev has it with pre-commit")

REPOSITORY = Path(__file__).parents[2]
ACTION: dict[str, Any] = yaml.safe_load((REPOSITORY / "action.yml").read_text("utf-8"))
STEPS: list[dict[str, Any]] = ACTION["runs"]["steps"]
HOOKS: list[dict[str, Any]] = yaml.safe_load((REPOSITORY / ".pre-commit-hooks.yaml").read_text("utf-8"))
INPUT = re.compile(r"\$\{\{ inputs\.([a-z-]+) \}\}")


@dataclass(frozen=True)
class Ran:
    """What a step left: its process, its outputs, and the summary of the job."""

    process: subprocess.CompletedProcess[str]
    outputs: dict[str, str]
    summary: str


@dataclass(frozen=True)
class Runner:
    """A runner with a workspace and a folder of its own for the rest."""

    workspace: Path
    own: Path

    def step(self, name: str, **given: str) -> Ran:
        """Run a step with some inputs, the others by default."""
        bash = required_program("bash")
        step = next(step for step in STEPS if step.get("name") == name)
        inputs = {key: str(one.get("default", "")) for key, one in ACTION["inputs"].items()}
        inputs |= {key.replace("_", "-"): value for key, value in given.items()}
        script, outputs, summary = (self.own / each for each in ("step.sh", "outputs", "summary"))
        for file in (outputs, summary):
            file.write_text("")
        script.write_text(step["run"], encoding="utf-8")
        values = {key: INPUT.sub(lambda found: inputs[found[1]], text) for key, text in step["env"].items()}
        process = subprocess.run(
            [bash, "--noprofile", "--norc", "-eo", "pipefail", str(script)],
            cwd=self.workspace,
            env=environment_with_skinbake(
                self.own / "bin",
                GITHUB_ACTION_PATH=str(REPOSITORY),
                GITHUB_OUTPUT=str(outputs),
                GITHUB_STEP_SUMMARY=str(summary),
                RUNNER_TEMP=str(self.own),
                **values,
            ),
            capture_output=True,
            text=True,
            check=False,
        )
        found = dict(line.split("=", 1) for line in outputs.read_text("utf-8").splitlines())
        return Ran(process, found, summary.read_text("utf-8"))


@pytest.fixture
def runner(tmp_path: Path) -> Runner:
    workspace, own = tmp_path / "workspace", tmp_path / "runner"
    (workspace / "art").mkdir(parents=True)
    (workspace / ".git").mkdir()
    own.mkdir()
    shutil.copyfile(FOLDER / "seam.glb", workspace / "art" / "my hero.glb")
    shutil.copyfile(FOLDER / "two_sets.glb", workspace / "art" / "two.glb")
    return Runner(workspace, own)


def test_no_input_is_text_of_a_script() -> None:
    """It would be run: a branch's name is enough to take over a runner."""
    for step in STEPS:
        assert "${{" not in step.get("run", "")
    used = set(INPUT.findall((REPOSITORY / "action.yml").read_text("utf-8")))
    assert used | {"artifact"} == set(ACTION["inputs"])


def test_the_form_is_that_of_a_composite_action() -> None:
    assert ACTION["runs"]["using"] == "composite"
    assert all(("run" in step) != ("uses" in step) for step in STEPS)
    assert all(step["shell"] == "bash" for step in STEPS if "run" in step)
    ids = {step["id"] for step in STEPS if "id" in step}
    for output in ACTION["outputs"].values():
        found = re.fullmatch(r"\$\{\{ steps\.(\w+)\.outputs\.[\w-]+ \}\}", output["value"])
        assert found is not None
        assert found[1] in ids
    keep = STEPS[-1]
    assert keep["uses"].startswith("actions/upload-artifact@")
    assert "always()" in keep["if"]  # the reports matter most when the step before has failed


@pytest.mark.parametrize(("version", "package"), [("", str(REPOSITORY)), ("1.2.3", "skinbake==1.2.3")])
def test_the_action_installs_its_own_code_or_a_version(version: str, package: str, runner: Runner) -> None:
    (runner.own / "bin").mkdir()
    python = runner.own / "bin" / "python"
    python.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    python.chmod(0o755)
    ran = runner.step("Install skinbake", version=version)
    assert ran.process.returncode == 0
    arguments = ran.process.stdout.splitlines()
    assert arguments[:4] == ["-I", "-m", "pip", "install"]
    assert arguments[-1] == package


@pytest.mark.slow
def test_bake_then_verify_passes_and_fails(runner: Runner) -> None:
    baked = runner.step(
        "Run skinbake", command="bake", files="  art/my hero.glb\n\nart/t*.glb\n", out_dir="out"
    )
    assert (baked.process.returncode, baked.process.stderr) == (0, "")
    assert baked.outputs["exit-code"] == "0"
    assert {path.name for path in (runner.workspace / "out").iterdir()} == {"my hero.glb", "two.glb"}

    verified = runner.step(
        "Run skinbake", files="\r\nout\r\n", options="--poses random:2\r\n --min-gain 1\r\n"
    )
    reports = Path(verified.outputs["reports"])
    assert (verified.process.returncode, verified.outputs["exit-code"]) == (0, "0")
    assert {path.name for path in reports.iterdir()} >= {
        "skinbake.xml",
        "skinbake.html",
        "skinbake.jsonl",
        "skinbake.txt",
    }
    assert "out/my hero.glb" in verified.summary
    assert verified.summary.startswith("### skinbake verify: exit code 0\n")

    failed = runner.step(
        "Run skinbake", files="out", options="--poses random:2 --min-gain 1000000", html="no"
    )
    assert (failed.process.returncode, failed.outputs["exit-code"]) == (1, "1")
    assert "exit code 1" in failed.summary
    assert "<failure" in (reports / "skinbake.xml").read_text("utf-8")


HOSTILE = ("secrets", "json", "signal", "sitecustomize", "pip", "skinbake", "multiprocessing", "numpy")


def hostile(folder: Path) -> Path:
    """Put modules with the names of Python's and ours into a folder. Return the file that each appends to."""
    ran = folder.parent / "ran"
    for name in HOSTILE:
        (folder / name).mkdir()
        for part in ("__init__", "__main__"):
            (folder / name / f"{part}.py").write_text(f"open({str(ran)!r}, 'a').write({name + ' '!r})")
    return ran


@pytest.mark.slow
@pytest.mark.parametrize("path", [None, "", "."])
def test_no_code_of_the_workspace_runs(
    path: str | None, runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pull request brings it, and it would see the secrets of the job, or choose what the runner obeys."""
    ran = hostile(runner.workspace)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    if path is not None:
        monkeypatch.setenv("PYTHONPATH", path)
    runner.step("Install skinbake", version="1.2.3")  # fails, because no index has it
    baked = runner.step("Run skinbake", command="bake", files="art", options="--timeout 100", out_dir="out")
    verified = runner.step("Run skinbake", files="out", options="--timeout 100 --poses random:1", html="no")
    assert not ran.exists(), ran.read_text()
    assert (baked.process.returncode, verified.process.returncode) == (0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("hook", HOOKS, ids=lambda hook: str(hook["id"]))
def test_no_hook_runs_code_of_the_repository(hook: dict[str, Any], runner: Runner) -> None:
    """Workers are new processes of Python, and they searched the current folder too."""
    ran = hostile(runner.workspace)
    environment = environment_with_skinbake(runner.own / "bin")
    subprocess.run(["git", "init", "-q"], cwd=runner.workspace, env=environment, check=True)
    call = shlex.split(str(hook["entry"]))
    if hook.get("pass_filenames", True):
        call += ["--timeout", "100", "art/my hero.glb", "art/two.glb"]
    done = subprocess.run(call, cwd=runner.workspace, env=environment, capture_output=True, check=False)
    assert not ran.exists(), ran.read_text()
    assert done.returncode in {0, 1}, done.stderr  # 1: they are not baked


@pytest.mark.slow
def test_a_folder_that_looks_like_a_repository_runs_nothing(runner: Runner) -> None:
    """Git would take its settings, which name a program that tells of changed files."""
    art, ran = runner.workspace / "art", runner.own / "ran"
    environment = environment_with_skinbake(runner.own / "bin")
    for folder in (runner.workspace, art):
        subprocess.run(
            ["git", "init", "-q", *(["--bare"] if folder == art else []), "."], cwd=folder, check=True
        )
    (art / "config").write_text(f"[core]\nbare = false\nworktree = .\nfsmonitor = \"touch '{ran}';:\"\n")
    copied(SHARED, art)
    call = ["skinbake", "bake", f"art/{SHARED}", "--in-place", "--require-tracked"]
    done = subprocess.run(call, cwd=runner.workspace, env=environment, capture_output=True, check=False)
    assert not ran.exists()
    assert done.returncode == 4


@pytest.mark.slow
def test_a_file_that_is_not_there_fails_the_step(runner: Runner) -> None:
    ran = runner.step("Run skinbake", files="art/none.glb", html="false")
    assert (ran.process.returncode, ran.outputs["exit-code"]) == (3, "3")
    assert "art/none.glb: cannot be read: No such file" in ran.process.stderr


@pytest.mark.slow
def test_the_summary_has_the_reason_of_a_failure(runner: Runner) -> None:
    (runner.workspace / "art" / "broken.glb").write_bytes(b"glTF, but no more than that")
    for command in ("verify", "bake"):
        ran = runner.step("Run skinbake", command=command, files="art/broken.glb\nart/two.glb", html="false")
        (line,) = [one for one in ran.process.stderr.splitlines() if "broken.glb" in one]
        assert ran.process.returncode != 0
        assert line in ran.summary
        assert "art/two.glb" in ran.summary


@pytest.mark.slow
@pytest.mark.parametrize("command", ["bake", "verify"])
def test_names_of_files_are_no_commands_to_the_runner(command: str, runner: Runner) -> None:
    """A runner obeys lines that begin with ::, on stdout and on stderr, unless it was told to stop."""
    for name in ("::error::mine.glb", "::set-output name=a::b.glb", "::add-mask::e.glb"):
        shutil.copyfile(FOLDER / "seam.glb", runner.workspace / name)
        (runner.workspace / f"{name[:-4]}2.glb").write_bytes(b"glTF, but no more than that")
    tokens = set()
    for _ in range(2):
        ran = runner.step("Run skinbake", command=command, files="*.glb", html="false")
        lines = ran.process.stdout.splitlines()
        first, *_, last = [number for number, line in enumerate(lines) if line.startswith("::")]
        token = lines[first].removeprefix("::stop-commands::")
        assert len(token) == 32
        assert lines[last] == f"::{token}::"
        assert "::error::mine2.glb: " in ran.process.stderr
        tokens.add(token)
    assert len(tokens) == 2


@pytest.mark.slow
def test_an_input_is_not_run_by_the_shell(runner: Runner) -> None:
    ran = runner.step(
        "Run skinbake", files="$(touch taken)`touch taken`.glb", options="$(touch${IFS}taken) *", html="no"
    )
    assert ran.process.returncode == 3
    assert [path.name for path in runner.workspace.iterdir() if path.name == "taken"] == []
    assert runner.step("Run skinbake", files="--in-place", html="no").process.returncode == 2
    ran = runner.step("Run skinbake", command="strip", files="a.glb")
    assert ran.process.stdout.startswith("::error::command: expected bake or verify, not strip")
    assert ran.outputs["exit-code"] == "2"
