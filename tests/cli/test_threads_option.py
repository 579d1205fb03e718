"""--threads: the same bytes and figures at any number, and as many threads as were asked for."""

from __future__ import annotations

import concurrent.futures
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import skinbake
from benchmarks.skinned_grid import grid_of, write_grid
from skinbake import threads
from skinbake.errors import InputError
from skinbake.gradients.by_loops import PART
from skinbake.jobs.processes import Processes
from skinbake.jobs.work import InThisProcess
from tests.support.command_line import document, invoke
from tests.support.models import FOLDER

COUNTS = (1, 2, 3, 8)
POSES = ("--poses", "random:1", "--method", "lbs")


@pytest.fixture
def pools(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that tells of the threads of each pool."""
    made: list[int] = []

    class Counted(concurrent.futures.ThreadPoolExecutor):
        def __init__(self, count: int) -> None:
            made.append(count)
            super().__init__(count)

    monkeypatch.setattr(concurrent.futures, "ThreadPoolExecutor", Counted)
    return made


def cores(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Let the process have so many cores, and no word of threads."""
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr(threads, "cpu_quotas", lambda: iter(()))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(count)), raising=False)


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a surface of more weld classes than one thread bakes at a time."""
    path = tmp_path_factory.mktemp("grid") / "grid.glb"
    grid = grid_of(36_000)
    assert grid.vertices > PART
    write_grid(path, grid)
    return path


def outcome(source: Path, folder: Path, *options: str) -> tuple[bytes, dict[str, Any]]:
    """Bake and verify a file. Return the baked bytes, and what verify says of them."""
    target = folder / "baked.glb"
    assert invoke("bake", source, "-o", target, "-q", "--no-sync", *options).exit_code == 0
    verdict = document(invoke("verify", target, *POSES, "--json", *options))
    return target.read_bytes(), verdict


@pytest.mark.slow
def test_a_small_file_is_the_same_at_any_number_of_threads(tmp_path: Path) -> None:
    found = [outcome(FOLDER / "bent_tube.glb", tmp_path, "--threads", str(count)) for count in COUNTS]
    assert found[0][1]["files"][0]["passed"]
    assert all(one == found[0] for one in found)


@pytest.mark.slow
def test_a_large_file_is_the_same_at_any_number_of_threads(
    large: Path, tmp_path: Path, pools: list[int]
) -> None:
    found = []
    for count in COUNTS:
        pools.clear()
        found.append(outcome(large, tmp_path, "--threads", str(count)))
        # A bake and a measurement have threads; one thread needs no pool.
        assert set(pools) == ({count} if count > 1 else set())
        assert len(pools) >= (2 if count > 1 else 0)
    assert found[0][1]["files"][0]["passed"]
    for baked, verdict in found[1:]:
        assert baked == found[0][0]
        assert verdict == found[0][1]


@pytest.mark.parametrize("given", ["0", "65", "-1", "two", "", "1.5", "9" * 5000])
def test_a_number_that_is_none_is_a_usage_error(given: str) -> None:
    result = invoke("bake", FOLDER / "seam.glb", "--dry-run", "--threads", given)
    assert result.exit_code == 2
    assert "expected a number of threads from 1 to 64, or auto, found " in result.stderr


@pytest.mark.parametrize(
    ("options", "files", "expected"),
    [
        ([], 3, None),  # the process looks for itself
        (["--threads", "5"], 3, 5),
        (["--threads", "5", "--jobs", "2"], 3, 5),
        (["--jobs", "2"], 3, 6),
        (["--jobs", "8"], 3, 4),  # no more processes than files
        (["--jobs", "auto"], 30, 1),
        (["--jobs", "5"], 30, 2),
        (["--jobs", "1", "--timeout", "60"], 3, 8),
        (["--isolate", "--jobs", "2"], 3, 1),
    ],
)
def test_auto_is_the_cores_divided_by_the_jobs(
    options: list[str], files: int, expected: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []

    def run(self: Any, work: Any, jobs: Any) -> Iterator[tuple[int, Any]]:
        found.append(work.threads)
        yield from ((number, work.failed(job, InputError("not done"))) for number, job in enumerate(jobs))

    cores(monkeypatch, 12)
    for runner in (InThisProcess, Processes):
        monkeypatch.setattr(runner, "run", run)
    for number in range(files):
        (tmp_path / f"{number}.glb").touch()
    assert invoke("bake", tmp_path, "--dry-run", *options).exit_code == 3
    assert found == [expected]


def test_affinity_quotas_and_the_environment_bound_auto(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cores(monkeypatch, 6)
    assert threads.usable_cores() == threads.thread_count() == 6
    for quotas, count in (([2.5], 3), ([0.2], 1), ([32.0, 4.0], 4)):
        monkeypatch.setattr(threads, "cpu_quotas", lambda quotas=quotas: iter(quotas))
        assert threads.usable_cores() == count
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert threads.thread_count() == 2
    with threads.threads_limited(7):
        assert threads.thread_count() == 7
    assert threads.thread_count() == 2


def test_quotas_are_read_from_control_groups(tmp_path: Path) -> None:
    groups, root = tmp_path / "cgroup", tmp_path / "fs"
    (root / "a" / "b").mkdir(parents=True)
    (root / "cpu" / "c").mkdir(parents=True)
    groups.write_text("0::/a/b\n")
    (root / "a" / "cpu.max").write_text("150000 100000\n")
    (root / "a" / "b" / "cpu.max").write_text("max 100000\n")
    assert list(threads.cpu_quotas(groups, root)) == [1.5]
    groups.write_text("4:memory:/c\n1:cpu,cpuacct:/c\n")
    for folder, quota in (("cpu", -1), ("cpu/c", 400_000)):
        (root / folder / "cpu.cfs_quota_us").write_text(f"{quota}\n")
        (root / folder / "cpu.cfs_period_us").write_text("100000\n")
    assert list(threads.cpu_quotas(groups, root)) == [4.0]
    assert list(threads.cpu_quotas(tmp_path / "none", root)) == []


@pytest.mark.parametrize("given", [0, 65, -1, "two", "2", 1.5])
def test_python_refuses_a_number_that_is_none(given: Any, tmp_path: Path) -> None:
    source = FOLDER / "seam.glb"
    with pytest.raises(skinbake.ChoiceError, match="expected a number of threads from 1 to 64, or auto"):
        skinbake.bake(source, tmp_path / "out.glb", threads=given)
    with pytest.raises(skinbake.ChoiceError, match="expected a number of threads from 1 to 64, or auto"):
        skinbake.verify(source, threads=given)


def test_python_takes_a_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pools: list[int]
) -> None:
    monkeypatch.setattr("skinbake.gradients.by_loops.PART", 7)
    skinbake.bake(FOLDER / "bent_tube.glb", tmp_path / "out.glb", threads=3, sync=False)
    assert set(pools) == {3}
    pools.clear()
    skinbake.verify(tmp_path / "out.glb", poses="random", samples=1, threads=2)
    assert set(pools) == {2}
