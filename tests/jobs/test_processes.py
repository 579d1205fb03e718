"""Workers: all jobs are done once, if any worker dies; begun work is undone when they are told to stop."""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from multiprocessing.connection import wait
from operator import length_hint
from pathlib import Path
from typing import Any

import pytest

from skinbake.errors import SkinbakeError
from skinbake.jobs import processes, starting
from skinbake.jobs.processes import Processes
from skinbake.jobs.work import FirstThese, InThisProcess, Job, in_order
from skinbake.jobs.worker import BASE, Limits
from skinbake.timing import heard
from tests.jobs.file_works import baking
from tests.jobs.works import (
    Crashing,
    Deadly,
    DeadlyOnce,
    Deaf,
    DyingBesideOthers,
    Echoing,
    Hungry,
    Lingering,
    Raising,
    Slow,
    SlowToStart,
    SlowToStop,
    Stillborn,
    Surroundings,
    ToldTooLate,
    Unborn,
    Work,
    WritingFirst,
)

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="needs the signals of POSIX")


def outcomes(work: Any, count: int, workers: int = 2) -> dict[int, Any]:
    """Run jobs 0 … count − 1, none of which may be told of twice."""
    found: dict[int, Any] = {}
    with closing(Processes(workers).run(work, range(count))) as results:
        for number, result in results:
            assert number not in found
            found[number] = result
    return found


def test_several_processes_do_all_jobs_and_this_one_does_none() -> None:
    found = outcomes(Work(), 300)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(300)}
    workers = {pid for _, pid in found.values()}
    assert len(workers) == 2
    assert os.getpid() not in workers


def test_no_more_workers_than_jobs() -> None:
    assert len({pid for _, pid in outcomes(Work(), 1, workers=8).values()}) == 1
    assert outcomes(Work(), 0) == {}


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_a_job_that_kills_two_workers_is_lost_and_no_other(by: signal.Signals, tmp_path: Path) -> None:
    found = outcomes(Deadly((7, 20), by, tmp_path), 40)
    lost = {number: result for number, result in found.items() if result[0] == "lost"}
    assert sorted(lost) == [7, 20]
    assert all(result[0] == 2 * number for number, result in found.items() if number not in lost)
    assert sorted(found) == list(range(40))
    is_heard = by != signal.SIGKILL and signal.getsignal(by) != signal.SIG_IGN
    for number in lost:
        assert lost[number][1] == number
        assert ("exit code" if is_heard else by.name) in lost[number][2]


@pytest.mark.slow
@POSIX
def test_a_suspect_is_tried_again_alone(tmp_path: Path) -> None:
    found = outcomes(DeadlyOnce((7,), signal.SIGKILL, tmp_path), 40)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(40)}
    # The dead worker's next job had not begun: everything but job 7 was begun once.
    begun = [int(path.name.split("-")[0]) for path in tmp_path.iterdir()]
    assert sorted(begun) == list(range(40))


@POSIX
@pytest.mark.slow
def test_while_a_suspect_is_tried_again_nobody_else_works(tmp_path: Path) -> None:
    outcomes(Deadly((5,), signal.SIGKILL, tmp_path), 30)
    log = [[int(part) for part in path.name.split("-")] for path in tmp_path.iterdir()]
    (_, _, _, _), (_, _, began, died) = sorted((entry for entry in log if entry[0] == 5), key=lambda e: e[2])
    others = [start for job, _, start, *_ in log if job != 5]
    assert died - began >= 500_000_000
    assert [start for start in others if began - 2_000_000 < start < died] == []
    assert any(start > died for start in others)


@POSIX
@pytest.mark.slow
def test_a_suspect_waits_until_all_others_are_done(tmp_path: Path) -> None:
    found = outcomes(DyingBesideOthers(tmp_path), 3, workers=3)
    assert {number: result[0] for number, result in found.items()} == {0: 0, 1: 2, 2: 4}
    times = {(job, what): int(when) for job, what, when in (p.name.split("-") for p in tmp_path.iterdir())}
    began = max(int(path.name.split("-")[2]) for path in tmp_path.glob("0-began-*"))
    assert began > times["2", "ended"]


@POSIX
def test_a_crash_in_native_code_costs_one_job() -> None:
    found = outcomes(Crashing(), 10)
    assert found[3][0] == "lost"
    assert "SIGSEGV" in found[3][2]
    assert [found[n][0] for n in range(10) if n != 3] == [2 * n for n in range(10) if n != 3]


def test_a_defect_is_a_job_s_own_and_kills_nobody() -> None:
    found = outcomes(Raising(), 10, workers=1)
    assert found[3][:2] == ("lost", 3)
    assert found[3][2].startswith("skinbake failed where it should not: RuntimeError: a defect of skinbake. ")
    assert found[4][:2] == ("lost", 4)
    assert len({found[n][1] for n in range(10) if n not in {3, 4}}) == 1


@POSIX
def test_workers_that_never_start_end_the_run(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SkinbakeError, match=r"worker processes cannot be started .*try --jobs 1"):
        outcomes(Unborn(), 10)


@POSIX
@pytest.mark.slow
def test_workers_that_start_in_the_end_do_all_jobs(tmp_path: Path) -> None:
    """Each of two workers may fail to start, and once more."""
    found = outcomes(Stillborn(2 * processes.ATTEMPTS - 1, tmp_path), 10)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(10)}


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_worker_is_one_thread() -> None:
    assert set(outcomes(Surroundings(), 4).values()) == {("1", 1, True)}
    assert "OPENBLAS_NUM_THREADS" not in os.environ


@POSIX
def test_closing_ends_what_is_at_work_and_undoes_it(tmp_path: Path) -> None:
    start = time.monotonic()
    results = Processes(2).run(Slow(tmp_path), [0.0, 600.0, 600.0, 600.0])
    assert next(results)[0] == 0
    while len(list(tmp_path.iterdir())) < 2 and time.monotonic() - start < 100:
        time.sleep(0.01)
    busy = [int(path.stem) for path in tmp_path.iterdir()]
    results.close()
    assert len(busy) == 2
    assert list(tmp_path.iterdir()) == []
    for pid in busy:
        assert not Path(f"/proc/{pid}").exists() or "Z" in Path(f"/proc/{pid}/stat").read_text()
    assert time.monotonic() - start < 300


def test_one_slow_job_does_not_fill_memory_with_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "WINDOW", 10)
    order = [number for number, _ in Processes(2).run(Slow(tmp_path), [0.3] + [0.0] * 50)]
    assert sorted(order) == list(range(51))
    assert 9 <= order.index(0) <= 10


def test_results_come_in_the_order_of_the_jobs() -> None:
    pairs = iter([(2, "c"), (0, "a"), (1, "b"), (3, "d")])
    results = in_order(pair for pair in pairs)
    assert next(results) == "a"
    assert length_hint(pairs) == 2  # none is waited for that need not be
    assert list(results) == ["b", "c", "d"]


def test_an_interrupt_comes_after_the_results_that_wait_for_earlier_ones() -> None:
    def interrupted() -> Any:
        yield from [(3, "d"), (0, "a"), (2, "c")]
        raise KeyboardInterrupt

    results = in_order(interrupted())
    assert [next(results) for _ in range(3)] == ["a", "c", "d"]
    with pytest.raises(KeyboardInterrupt):
        next(results)


def test_jobs_that_take_turns_come_first_in_order() -> None:
    class Backwards:
        def run(self, work: Any, jobs: Any) -> Any:
            return ((number, work(jobs[number])) for number in reversed(range(len(jobs))))

    runner = FirstThese((4, 1), InThisProcess(), Backwards())
    found = [(number, result[0]) for number, result in runner.run(Work(), range(6))]
    assert found == [(1, 2), (4, 8), (5, 10), (3, 6), (2, 4), (0, 0)]


def limited(work: Any, jobs: Sequence[Any], limits: Limits, workers: int = 2) -> dict[int, Any]:
    """Run jobs within limits."""
    with closing(Processes(workers, limits=limits).run(work, jobs)) as results:
        return dict(results)


@pytest.mark.slow
@POSIX
def test_a_job_that_takes_too_long_is_told_to_stop_and_lost_alone(tmp_path: Path) -> None:
    start = time.monotonic()
    found = limited(Slow(tmp_path), [0.0, 60.0, 0.0, 0.0, 60.0, 0.0], Limits(seconds=0.5))
    assert time.monotonic() - start < 30
    assert {number for number, result in found.items() if result[0] == "lost"} == {1, 4}
    assert found[1] == ("lost", 60.0, "it took longer than 0.5 s (--timeout)")
    assert list(tmp_path.iterdir()) == []  # what it had begun is undone


@POSIX
@pytest.mark.slow
def test_a_job_that_takes_too_long_after_its_output_is_written_is_not_called_undone() -> None:
    with heard(lambda told: None):
        found = limited(WritingFirst(), range(4), Limits(seconds=0.5), workers=1)
    assert [found[number][0] for number in range(4)] == [0, "written", "lost", 6]


def test_the_message_of_a_lost_file_says_whether_its_output_is_written() -> None:
    job, work = Job("a.glb", "b.glb"), baking()
    assert str(work.lost(job, "it died").error) == "a.glb: not baked: it died"
    written = work.lost(job, "it died", is_written=True)
    assert str(written.error) == "a.glb: its output is written, but not its report: it died"


@POSIX
@pytest.mark.slow
def test_a_worker_that_does_not_stop_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "GRACE", 0.5)
    start = time.monotonic()
    found = limited(Deaf(), range(6), Limits(seconds=0.5))
    assert time.monotonic() - start < 30
    assert found[1] == ("lost", 1, "it took longer than 0.5 s (--timeout)")
    assert [found[number][0] for number in (0, 2, 3, 4, 5)] == [0, 4, 6, 8, 10]


@pytest.mark.slow
@POSIX
def test_a_job_done_in_time_is_not_given_up_while_the_caller_is_away() -> None:
    """A caller that prints to a slow reader takes longer than the limit, and finds late what was done."""
    found = {}
    with closing(Processes(2, limits=Limits(seconds=1.0)).run(Work(), range(12))) as results:
        for number, result in results:
            found[number] = result
            if number in {2, 7}:
                time.sleep(1.3)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(12)}
    assert len({pid for _, pid in found.values()}) == 2, "no worker was told to stop"


@pytest.mark.slow
@POSIX
def test_a_worker_that_was_told_to_stop_gets_no_other_job() -> None:
    found = limited(ToldTooLate(), range(12), Limits(seconds=1.0), workers=1)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(12)}
    workers = [found[number][1] for number in range(12)]
    assert workers == [workers[0]] * 4 + [workers[4]] * 8
    assert workers[4] != workers[0]


@pytest.mark.slow
@POSIX
def test_the_start_of_a_worker_does_not_count_as_time_of_its_job() -> None:
    found = limited(SlowToStart(), range(3), Limits(seconds=2.0), workers=1)
    assert {number: result[0] for number, result in found.items()} == {0: 0, 1: 2, 2: 4}


@pytest.mark.slow
@POSIX
def test_a_worker_that_was_told_to_stop_has_time_to_undo_its_work(tmp_path: Path) -> None:
    """Also while messages of another worker come in."""
    found = limited(SlowToStop(tmp_path), [60.0, *[0.05] * 60], Limits(seconds=1.0))
    assert [number for number, result in found.items() if result[0] == "lost"] == [0]
    assert list(tmp_path.iterdir()) == []


@POSIX
def test_waiting_for_a_long_job_is_no_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls = []

    def counted(*arguments: Any) -> Any:
        calls.append(arguments)
        return wait(*arguments)

    monkeypatch.setattr(processes, "wait", counted)
    limited(Slow(tmp_path), [0.0, 0.5], Limits(seconds=60.0))
    assert len(calls) < 60


@pytest.mark.slow
@POSIX
def test_closing_kills_a_worker_that_does_not_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "PATIENCE", 0.5)
    results = Processes(1).run(Deaf(), range(2))
    _, (_, pid) = next(results)
    time.sleep(0.5)  # it is at work on the job that it does not leave
    results.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


@contextmanager
def descriptors_left(count: int) -> Iterator[None]:
    """Let this process open so many more files, and no more."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    free = (number for number in range(before[0]) if not is_open(number))
    resource.setrlimit(resource.RLIMIT_NOFILE, (1 + list(islice(free, count))[-1], before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of descriptors")
def test_no_worker_is_started_with_the_last_descriptors() -> None:
    with descriptors_left(starting.SPARE_DESCRIPTORS):
        starting.check_descriptors()
    with descriptors_left(starting.SPARE_DESCRIPTORS - 1), pytest.raises(OSError, match="Too many open"):
        starting.check_descriptors()


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of descriptors")
def test_the_first_worker_is_started_with_the_descriptors_that_are_spared() -> None:
    with descriptors_left(starting.SPARE_DESCRIPTORS - 1):
        assert outcomes(Work(), 2, workers=1)[1][0] == 2


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of descriptors")
def test_fewer_workers_do_where_the_system_allows_no_more() -> None:
    with descriptors_left(starting.SPARE_DESCRIPTORS + 10):
        found = outcomes(Work(), 200, workers=100)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(200)}
    assert len({pid for _, pid in found.values()}) < 100


@pytest.mark.parametrize("error", [OSError(errno.EAGAIN, "Resource temporarily unavailable"), EOFError()])
def test_a_system_that_allows_no_worker_ends_the_run(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def refused(*arguments: object) -> object:
        calls.append(arguments)
        raise error

    monkeypatch.setattr(processes, "started", refused)
    with pytest.raises(SkinbakeError, match=r"cannot be started \(.*(unavailable|no more).*: try --jobs 1$"):
        outcomes(Work(), 4)
    assert len(calls) == processes.ATTEMPTS
    limited = Processes(1, limits=Limits(seconds=60.0))
    with pytest.raises(SkinbakeError, match="try --jobs 1 without --timeout and --isolate"):
        next(limited.run(Work(), range(4)))


def test_a_start_that_fails_once_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system kills the server that forks workers, and the next start brings up another."""
    started, calls = starting.started, []

    def fails_first(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 1:
            raise EOFError
        return started(*arguments)

    monkeypatch.setattr(processes, "started", fails_first)
    found = outcomes(Work(), 40)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(40)}
    assert len(calls) == 3


def test_each_worker_s_start_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    started, calls = starting.started, []

    def fails_first_for_each(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) in {1, 3}:
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        return started(*arguments)

    monkeypatch.setattr(processes, "started", fails_first_for_each)
    assert len({pid for _, pid in outcomes(Work(), 300).values()}) == 2
    assert len(calls) == 4


def test_descriptors_are_looked_at_before_each_worker_but_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left() -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(processes, "check_descriptors", none_left)
    assert len({pid for _, pid in outcomes(Work(), 40, workers=4).values()}) == 1


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_released_workers_have_ended_when_the_run_is_over() -> None:
    found = limited(Lingering(), range(2), Limits(memory=1 << 30))
    for _, pid in found.values():
        state = Path(f"/proc/{pid}/stat")
        assert not state.exists() or "Z" in state.read_text()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of descriptors")
def test_released_workers_hold_no_descriptors() -> None:
    with descriptors_left(starting.SPARE_DESCRIPTORS + 12):
        found = limited(Work(), range(25), Limits(memory=1 << 30), workers=1)
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(25)}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux holds to the limit")
def test_a_worker_has_no_more_memory_than_its_limit() -> None:
    size = 64 << 20
    found = limited(Hungry(), [size, BASE + 2 * size], Limits(memory=size))
    assert found[0][0] == size
    assert found[1][0] == "too much"


@POSIX
@pytest.mark.parametrize("limits", [Limits(seconds=1e300), Limits(memory=1 << 70)])
def test_limits_beyond_what_the_system_counts_are_none(limits: Limits) -> None:
    found = limited(Work(), range(3), limits)
    assert {number: result[0] for number, result in found.items()} == {0: 0, 1: 2, 2: 4}


@pytest.mark.slow
@POSIX
def test_with_a_limit_of_memory_each_job_has_a_process_of_its_own() -> None:
    found = limited(Work(), range(6), Limits(memory=1 << 30))
    assert {number: result[0] for number, result in found.items()} == {n: 2 * n for n in range(6)}
    assert len({pid for _, pid in found.values()}) == 6
    crashed = limited(Crashing(), range(5), Limits(memory=1 << 30))
    assert [number for number, result in crashed.items() if result[0] == "lost"] == [3]
    assert "SIGSEGV" in crashed[3][2]


@pytest.mark.slow
def test_large_jobs_and_results_do_not_wait_for_each_other() -> None:
    """The parent sent a quick worker more than a pipe holds, while the worker sent back as much."""
    jobs = [b"a", b"b", *(bytes(500_000) for _ in range(3)), b"c"]
    with closing(Processes(1, limits=Limits(seconds=60.0)).run(Echoing(), jobs)) as results:
        signal.alarm(60)
        try:
            found = dict(results)
        finally:
            signal.alarm(0)
    assert found == dict(enumerate(jobs))


def test_large_jobs_begin_first_and_all_are_done_once() -> None:
    jobs = [*range(12)]
    with closing(Processes(1, early=lambda found: [7, 3, found[-1]]).run(Work(), jobs)) as results:
        order = [number for number, _ in results]
    assert order == [7, 3, 11, 0, 1, 2, 4, 5, 6, 8, 9, 10]
