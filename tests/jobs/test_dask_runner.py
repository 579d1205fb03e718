"""A real scheduler and real workers, some of which die: every job has its result, and the bytes are right."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

import skinbake
from skinbake.cli import exit_codes
from skinbake.errors import InputError
from skinbake.jobs.remote import dask_runner
from skinbake.jobs.remote.dask_runner import DaskRunner
from skinbake.jobs.work import Job
from skinbake.report.bake import FileResult
from tests.jobs.clusters import PATIENCE, cluster, observer, require_dask, wait_for_workers
from tests.jobs.file_works import BakeOrDie, Raise, baking, verifying
from tests.support.command_line import document, invoke
from tests.support.kernels import use_numpy
from tests.support.libraries import tree, write_library, write_sheets

require_dask()


def jobs_of(folder: Path, sources: list[Path], *, url: str = "") -> list[Job]:
    return [Job(f"{url}{source}", f"{url}{folder}/{source.name}") for source in sources]


def message_of(result: FileResult) -> str:
    assert result.error is not None
    return result.error.message


@pytest.mark.slow
def test_a_worker_is_killed_midway(tmp_path: Path) -> None:
    sources = write_sheets(tmp_path / "in", 200)
    for job in jobs_of(tmp_path / "here", sources):
        assert baking()(job).error is None
    jobs = jobs_of(tmp_path / "away", sources, url="file://")
    results: dict[int, Any] = {}
    with cluster(tmp_path / "cluster", options=["--no-nanny"]) as found, observer(found.address) as client:
        wait_for_workers(client, 2)
        with closing(DaskRunner(found.address)) as runner:
            assert runner.connect() == []
            held: tuple[str, ...] = ()
            for number, result in runner.run(baking(), jobs):
                assert number not in results
                results[number] = result
                if len(results) == 40:
                    held = _killed(client, found.workers[0])
            assert held
            assert len(client.nthreads()) == 1
    assert sorted(results) == list(range(200))
    for number, result in results.items():
        assert (result.status, result.error) == ("baked", None)
        assert (result.input, result.output) == (jobs[number].source, jobs[number].target)
    assert whole(tmp_path / "away") == tree(tmp_path / "here")


def whole(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder but what a killed worker was about to write."""
    return {name: data for name, data in tree(folder).items() if not re.search(r"\.skinbake-\w+\.tmp$", name)}


def _killed(client: Any, worker: Any) -> tuple[str, ...]:
    """Kill a worker that holds tasks, and return their keys: it is stopped first, so that it keeps them."""
    address = next(a for a, pid in client.run(os.getpid).items() if pid == worker.pid)
    os.kill(worker.pid, signal.SIGSTOP)
    held = tuple(client.processing()[address])
    os.kill(worker.pid, signal.SIGKILL)
    return held


@pytest.mark.slow
def test_a_file_that_kills_its_workers_harms_no_other_file(tmp_path: Path) -> None:
    sources = write_sheets(tmp_path / "in", 24)
    killer = write_sheets(tmp_path / "in", 1, prefix="killer")
    sources[7:7] = killer
    for job in jobs_of(tmp_path / "here", sources):
        if "killer" not in job.source:
            assert baking()(job).error is None
    (tmp_path / "notes").mkdir()
    work = BakeOrDie(notes=str(tmp_path / "notes"))
    jobs = jobs_of(tmp_path / "away", sources)
    # Nannies start killed workers anew. At the first death all tasks that the worker held are given up.
    with cluster(tmp_path / "cluster", allowed_failures=0) as found:
        with observer(found.address) as client:
            wait_for_workers(client, 2)
        with closing(DaskRunner(found.address)) as runner:
            results = dict(runner.run(work, jobs))
    assert sorted(results) == list(range(25))
    failed = [number for number, result in results.items() if result.error is not None]
    assert failed == [7]
    assert isinstance(results[7].error, InputError)
    assert "each worker that took it died" in results[7].error.message
    assert (results[7].input, results[7].output) == (jobs[7].source, jobs[7].target)
    assert whole(tmp_path / "away") == tree(tmp_path / "here")
    assert len((tmp_path / "notes" / killer[0].name).read_bytes()) == 2  # among others, and alone


@pytest.mark.slow
def test_a_cluster_in_which_nobody_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    sources = write_sheets(tmp_path / "in", 30)
    baked = jobs_of(tmp_path / "baked", sources)
    for job in baked:
        baking()(job)
    with (
        cluster(tmp_path / "cluster", workers=1, options=["--no-nanny"]) as found,
        observer(found.address) as client,
    ):
        wait_for_workers(client, 1)
        _verdicts_are_those_of_this_process(found.address, baked)
        if sys.platform == "linux":
            _a_worker_with_another_disk_says_so(found.address, tmp_path, monkeypatch)
        _the_command_line_bakes_on_workers(found.address, tmp_path, monkeypatch)
        _jobs_are_sent_in_a_bounded_number(found.address, client, monkeypatch, tmp_path, sources)
        _closing_forgets_what_has_not_begun(found.address, client, tmp_path, sources)
        _work_that_raises_loses_its_job(found.address, jobs_of(tmp_path, sources[:2]))
        _another_version_is_refused(found.address, monkeypatch, jobs_of(tmp_path, sources[:3]))
        _without_workers_jobs_are_lost(found, client, jobs_of(tmp_path, sources[:3]))
    assert capfd.readouterr() == ("", "")


def _verdicts_are_those_of_this_process(address: str, baked: list[Job]) -> None:
    jobs = [Job(job.target or "") for job in baked[:4]]
    with closing(DaskRunner(address)) as runner:
        verdicts = dict(runner.run(verifying(), jobs))
    assert verdicts == {number: verifying()(job) for number, job in enumerate(jobs)}
    assert all(verdict.passed for verdict in verdicts.values())


def _a_worker_with_another_disk_says_so(address: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The folder in which a process runs has one name in all processes, and is another one in each.
    here, there = folder / "here", folder / "cluster"
    write_sheets(here, 1, prefix="both")
    write_sheets(here, 1, prefix="only-here")
    sheet = write_sheets(folder / "large", 1, prefix="both")[0].read_bytes()
    (both,) = (path.name for path in here.glob("both*"))
    (only_here,) = (path.name for path in here.glob("only-here*"))
    shared = write_sheets(folder / "shared", 1)[0]
    (there / both).write_bytes(sheet + b" ")
    own = Path("/proc/self/cwd")
    jobs = [
        Job(str(own / only_here), str(folder / "away" / only_here)),
        Job(str(own / both), str(folder / "away" / both)),
        Job(str(shared), str(own / "baked.glb")),
        Job(str(shared), str(folder / "away" / "shared.glb")),
    ]
    with monkeypatch.context() as patch, closing(DaskRunner(address)) as runner:
        patch.chdir(here)
        results = dict(runner.run(baking(), jobs))
    assert [results[number].status for number in range(4)] == ["failed", "failed", "failed", "baked"]
    worker = r"the worker tcp://127.0.0.1:\d+"
    assert re.match(f"{worker} cannot open it", message_of(results[0]))
    size = len(sheet)
    assert re.match(
        rf"{worker} sees another file under this path \({size + 1} bytes, {size} expected\)",
        message_of(results[1]),
    )
    assert re.match(
        f"{worker} has written it on a disk that this machine does not see", message_of(results[2])
    )
    assert [str(results[number].error).partition(": ")[0] for number in range(3)] == [
        jobs[0].source,
        jobs[1].source,
        jobs[2].target,
    ]
    assert list((folder / "away").iterdir()) == [folder / "away" / "shared.glb"]


def _the_command_line_bakes_on_workers(address: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("one", "two"):  # of two trees, whose files may meet
        write_library(folder / "trees" / name / name)
    roots = [folder / "trees/one", folder / "trees/two"]
    sent: list[str | Path] = ["bake", *roots, "--out-dir", folder / "trees/away", "--dask", address, "--json"]
    here: list[str | Path] = ["bake", *roots, "--out-dir", folder / "trees/here", "--json"]
    away, there = document(invoke(*sent)), document(invoke(*here))
    assert [file["status"] for file in away["files"]] == ["baked"] * 8
    assert json.dumps(away).replace("/away/", "/here/") == json.dumps(there)
    assert tree(folder / "trees/away") == tree(folder / "trees/here")
    files = [folder / "trees/away/one/characters", folder / "gone.glb"]
    sent, here = ["verify", *files, "--dask", address, "--json"], ["verify", *files, "--json"]
    checked = invoke(*sent)
    assert document(checked) == document(invoke(*here))
    assert checked.exit_code == exit_codes.INPUT
    with monkeypatch.context() as patch:  # relative names are those of the folder where the work starts
        patch.chdir(folder / "trees")
        sent, here = ["verify", "away", "--dask", address, "--json"], ["verify", "away", "--json"]
        assert document(invoke(*sent)) == document(invoke(*here))


def _jobs_are_sent_in_a_bounded_number(
    address: str, client: Any, monkeypatch: pytest.MonkeyPatch, folder: Path, sources: list[Path]
) -> None:
    jobs = jobs_of(folder / "bounded", sources)
    most = 0
    with monkeypatch.context() as patch, closing(DaskRunner(address)) as runner:
        patch.setattr(dask_runner, "LEAST_WINDOW", 2)
        patch.setattr(dask_runner, "WINDOW_PER_THREAD", 3)
        for _ in runner.run(baking(), jobs):
            most = max(most, _count_of_tasks(client))
    # Three are sent. Of those that are done, some count until the scheduler hears that nobody wants them.
    assert 0 < most < len(jobs) // 3


def _count_of_tasks(client: Any) -> int:
    # A lambda is sent by value: the scheduler finds no module of these tests.
    return int(client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))


def _closing_forgets_what_has_not_begun(address: str, client: Any, folder: Path, sources: list[Path]) -> None:
    runner = DaskRunner(address)
    results = runner.run(baking(), jobs_of(folder / "closed", sources))
    with closing(results):
        next(results)
    while _count_of_tasks(client):
        time.sleep(0.05)
    runner.close()
    written = len(tree(folder / "closed"))
    assert 0 < written < len(sources)
    assert all(name.endswith(".glb") for name in tree(folder / "closed"))


def _work_that_raises_loses_its_job(address: str, jobs: list[Job]) -> None:
    with closing(DaskRunner(address)) as runner:
        results = dict(runner.run(Raise(), jobs))
    assert [message_of(results[number]) for number in range(2)] == [
        "not baked: its worker failed: RuntimeError: on purpose"
    ] * 2


def _another_version_is_refused(address: str, monkeypatch: pytest.MonkeyPatch, jobs: list[Job]) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("skinbake.jobs.remote.dask_runner.__version__", "9.9.9")
        runner = DaskRunner(address)
        with pytest.raises(InputError, match=f"has skinbake {skinbake.__version__}, this is 9.9.9") as raised:
            runner.connect()
        assert raised.value.place is not None
        assert raised.value.place.file == address
    # All is well at first; then a worker of another version comes.
    with closing(DaskRunner(address)) as runner, monkeypatch.context() as patch:
        assert runner.connect() == []
        patch.setattr("skinbake.jobs.remote.dask_runner.__version__", "9.9.9")
        results = dict(runner.run(baking(), jobs))
    assert sorted(results) == [0, 1, 2]
    assert all("has skinbake 0" in message_of(result) for result in results.values())
    with monkeypatch.context() as patch:  # whose last bits may differ
        use_numpy(patch)
        with pytest.raises(InputError, match=r"has skinbake [0-9.]+, this is [0-9.]+ without compiled loops"):
            DaskRunner(address).connect()
    with monkeypatch.context() as patch:
        patch.setattr("platform.python_version", lambda: "3.99.0")
        with closing(DaskRunner(address)) as other:
            (notice,) = other.connect()
    assert (notice.code, notice.place.file) == ("worker-versions", address)
    assert "this is Python 3.99.0" in notice.message


def _without_workers_jobs_are_lost(found: Any, client: Any, jobs: list[Job]) -> None:
    found.workers[0].kill()
    while client.nthreads():
        time.sleep(0.05)
    with closing(DaskRunner(found.address, patience=1.0)) as runner:
        results = dict(runner.run(baking(), jobs))
    assert sorted(results) == [0, 1, 2]
    assert {message_of(result) for result in results.values()} == {
        "not baked: the scheduler has had no worker for 1 s"
    }


def test_a_pipe_among_the_inputs_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.glb")
    (tmp_path / "file.glb").write_bytes(b"abc")
    assert dask_runner.content(str(tmp_path / "pipe.glb")) is None
    assert dask_runner.content(str(tmp_path / "gone.glb")) is None
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # of FIPS 180-2
    assert dask_runner.content(str(tmp_path / "file.glb")) == (3, digest)


@pytest.mark.slow
def test_the_scheduler_goes_away(tmp_path: Path) -> None:
    write_sheets(tmp_path / "in", 120)
    out = tmp_path / "out"
    with cluster(tmp_path / "cluster", workers=1, options=["--no-nanny"]) as found:
        with observer(found.address) as client:
            wait_for_workers(client, 1)
        arguments = ["bake", f"{tmp_path}/in", "--out-dir", str(out), "--dask", found.address, "--json"]
        process = subprocess.Popen(
            [sys.executable, "-m", "skinbake", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        while not (out.exists() and tree(out)):
            assert process.poll() is None
            time.sleep(0.01)
        found.scheduler.kill()
        stdout, stderr = process.communicate(timeout=PATIENCE)
    files = json.loads(stdout)["files"]
    assert process.returncode == exit_codes.INPUT
    lost = {file["input"] for file in files if file["status"] == "failed"}
    assert len(files) == 120
    assert lost
    assert {Path(file["output"]).name for file in files if file["status"] == "baked"} <= whole(out).keys()
    lines = stderr.decode().splitlines()
    # Nothing but ours: a line for each, and at the end the list of failures and the sum.
    errors = [line for line in lines if line.startswith("error: ")]
    assert errors == [f"error: {file}: not baked: {dask_runner.GONE}" for file in sorted(lost)]
    assert len(lines) <= 2 * len(lost) + 3
    assert not any("distributed" in line or "Traceback" in line for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere.invalid:8786", "what://is this"])
def test_no_scheduler_answers(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_runner, "CONNECT_SECONDS", 0.5)
    with pytest.raises(InputError, match="no Dask scheduler answers") as raised:
        DaskRunner(address).connect()
    assert raised.value.place is not None
    assert raised.value.place.file == address


@pytest.mark.slow
def test_a_scheduler_that_takes_connections_and_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_runner, "CONNECT_SECONDS", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as listener:  # the system takes connections for it
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(InputError, match="no Dask scheduler answers: it takes the connection, and then"):
            DaskRunner(address).connect()
