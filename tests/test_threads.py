"""Work in threads: results in order, errors passed on, the same figures at any number of threads."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from skinbake.choices import PoseKind
from skinbake.commands.verify import verify_file
from skinbake.measure import angles
from skinbake.measure.options import VerifyOptions
from skinbake.threads import MOST, Threads, thread_count, threads_limited
from skinbake.truth import blending
from skinbake.truth.poses import PoseRequest
from tests.support.baked_files import baked, source


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(count: int) -> None:
    late = threading.Event()

    def work(number: int) -> int:
        if count > 1 and number == 0:
            late.wait(5.0)
        if number == 1:
            late.set()
        return number * number

    with Threads(count) as threads:
        assert list(threads.each(work, range(50))) == [number * number for number in range(50)]


@pytest.mark.parametrize("count", [1, 3])
def test_an_error_is_the_callers(count: int) -> None:
    def work(number: int) -> int:
        if number == 7:
            raise MemoryError("no more")
        return number

    before = threading.active_count()
    with Threads(count) as threads, pytest.raises(MemoryError, match="no more"):
        list(threads.each(work, range(100)))
    assert threading.active_count() == before


@pytest.mark.parametrize("count", [1, 3])
def test_work_that_was_begun_goes_on_beside_other_work_and_its_error_is_the_callers(count: int) -> None:
    passed, counts = threading.Event(), []

    def work() -> str:
        counts.append(thread_count())
        assert passed.wait(5.0)
        return "done"

    def broken() -> None:
        raise MemoryError("no more")

    with threads_limited(count), Threads(count) as threads:
        found, fails = threads.begun(work), threads.begun(broken)
        passed.set()  # neither has stopped this thread
        assert found() == "done"
        with pytest.raises(MemoryError, match="no more"):
            fails()
    assert counts == [1]  # work beside other work has no threads of its own


def test_a_worker_process_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    for told, count in (("1", 1), ("3", 3), ("400", MOST)):
        monkeypatch.setenv("OMP_NUM_THREADS", told)
        assert thread_count() == count
    for told in ("", "0", "many"):
        monkeypatch.setenv("OMP_NUM_THREADS", told)
        assert 1 <= thread_count() <= MOST


@pytest.mark.slow
def test_figures_are_the_same_to_the_last_bit_at_any_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = baked(source("two_primitives.glb"), tmp_path)
    monkeypatch.setattr(blending, "BLOCK_SAMPLES", 100)
    options = VerifyOptions(poses=PoseRequest(PoseKind.RANDOM, 9))
    found = []
    for count in ("1", "2", "7"):
        monkeypatch.setenv("OMP_NUM_THREADS", count)
        found.append(verify_file(str(path), options))
    assert found[0].passed
    assert set(found[0].by_truth) == {"tangents", "triangles"}
    assert found[1] == found[0]
    assert found[2] == found[0]


def test_algorithm_2_is_compared_in_some_poses_where_there_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = baked(source("bent_tube.glb"), tmp_path)
    options = VerifyOptions(("lbs",), PoseRequest(PoseKind.RANDOM, 24))
    whole = verify_file(str(path), options)
    monkeypatch.setattr(blending, "CHUNK_SAMPLES", 1518 * 8)
    monkeypatch.setattr(angles, "IDENTITY_SAMPLES", 1518 * 8)
    some = verify_file(str(path), options)
    assert some.passed
    # The first eight poses of 24; accurate lighting is measured in all.
    assert some.by_truth["tangents"]["lbs"]["accurate"].mean == pytest.approx(
        whole.by_truth["tangents"]["lbs"]["accurate"].mean
    )
    worst = int(some.by_truth["triangles"]["lbs"]["direct"].worst.clip.split()[-1])
    assert worst < 8
    assert some.by_truth["triangles"]["lbs"]["direct"].mean != pytest.approx(
        whole.by_truth["triangles"]["lbs"]["direct"].mean, rel=1e-6
    )
