"""Stages: the time that each one counts."""

from __future__ import annotations

import time

import pytest

from skinbake.timing import recorded, stage


def test_stages_inside_others_count_for_themselves() -> None:
    start = time.perf_counter()
    with recorded() as timings, stage("outer"):
        with stage("inner"):
            time.sleep(0.02)
        with stage("inner"):
            time.sleep(0.02)
    spent = time.perf_counter() - start
    assert list(timings.seconds) == ["inner", "outer"]
    assert timings.seconds["inner"] >= 0.04 > timings.seconds["outer"]
    assert sum(timings.seconds.values()) == pytest.approx(spent, abs=0.01)


def test_stages_are_not_recorded_unasked() -> None:
    with recorded() as timings:
        pass
    with stage("later"):
        pass
    assert timings.seconds == {}


def test_a_stage_that_fails_counts_too() -> None:
    with recorded() as timings, pytest.raises(ValueError, match="on purpose"), stage("failing"):
        raise ValueError("on purpose")
    assert list(timings.seconds) == ["failing"]
