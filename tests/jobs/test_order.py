"""The order in which several processes begin files: large ones first, results in the order of the inputs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from skinbake.jobs import processes
from tests.support.command_line import document, invoke
from tests.support.models import FOLDER

SMALL = (FOLDER / "seam.glb").read_bytes()


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let the runner work in this process, and return a list of the files in the order of their beginning."""
    names: list[str] = []

    def run(self: Any, work: Any, jobs: Any) -> Any:
        early = list(self.early(jobs))
        for number in [*early, *(n for n in range(len(jobs)) if n not in early)]:
            names.append(Path(jobs[number].source).name)
            yield number, work(jobs[number])

    monkeypatch.setattr(processes.Processes, "run", run)
    monkeypatch.setattr("skinbake.cli.runners.WORTHWHILE", 0.0)
    return names


def files(folder: Path, sizes: dict[str, int]) -> None:
    """Write valid files of these sizes: what follows the last chunk of a GLB is no part of the document."""
    folder.mkdir()
    for name, size in sizes.items():
        (folder / name).write_bytes(SMALL)
        os.truncate(folder / name, size)


@pytest.mark.slow
def test_a_huge_file_begins_before_small_ones(tmp_path: Path, begun: list[str]) -> None:
    sizes = {f"{number:02}.glb": len(SMALL) for number in range(60)}
    files(tmp_path / "in", {**sizes, "m.glb": 30 << 20, "p.glb": 60 << 20, "z.glb": 20 << 20})
    result = document(invoke("bake", tmp_path / "in", "--dry-run", "--jobs", "2", "--json"))
    assert begun == ["p.glb", "m.glb", "z.glb", *sorted(sizes)]
    told = [Path(entry["input"]).name for entry in result["files"]]
    assert told == [*sorted(sizes), "m.glb", "p.glb", "z.glb"]


def test_files_of_one_size_begin_in_order(tmp_path: Path, begun: list[str]) -> None:
    sizes = {f"{number:02}.glb": len(SMALL) for number in range(30)}
    files(tmp_path / "in", sizes)
    assert invoke("verify", tmp_path / "in", "--jobs", "2", "-q").exit_code == 0
    assert begun == sorted(sizes)
