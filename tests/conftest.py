"""Rules for all tests; a run's first lines say what may be skipped, and why."""

from __future__ import annotations

import gc
import os
import signal
from typing import TYPE_CHECKING, Any, TypeVar

import pytest

from tests.godot import native
from tests.support.corpus import NOT_HERE
from tests.support.corpus_folder import find_corpus
from tests.support.strictness import is_strict

if TYPE_CHECKING:  # it imports numpy
    from tests.support.stage import Stage

StageT = TypeVar("StageT", bound="Stage")


def pytest_configure() -> None:
    """Hear Ctrl-C also in a background job of a shell, whose children ignore it: tests send it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_report_header() -> list[str]:
    """Say which models are used, and what a missing tool does."""
    return [
        f"corpus: {find_corpus() or NOT_HERE}",
        f"Godot: {native.version() or 'the web build alone, without make setup-godot'}",
        f"a missing tool: its tests {'fail (SKINBAKE_STRICT=1)' if is_strict() else 'are skipped'}",
    ]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that opens the browser as slow, before the marked ones are left out.

    Their fixtures are ``opened``, of a page that draws with an engine, and ``browsing``, of one of ours.
    """
    for item in items:
        if isinstance(item, pytest.Function) and not {"opened", "browsing"}.isdisjoint(item.fixturenames):
            item.add_marker(pytest.mark.slow)


def pytest_collection() -> None:
    """Keep the garbage collector from walking through the thousands of tests as they are collected."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Let it collect again, but not walk through the collected tests."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture
def stage(opened: StageT) -> StageT:
    """The page of a module's ``opened``, of which no earlier test has left a message."""
    opened.page.messages()
    return opened


@pytest.fixture(autouse=True)
def _nothing_waits_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test cuts the power: waiting for the disk would only take ten times as long."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Have workers started for the least work; the list tells how many each run may have."""
    from skinbake.jobs import processes

    counts: list[int] = []
    original = processes.Processes.run

    def counted(self: Any, work: Any, jobs: Any) -> Any:
        counts.append(self.workers)
        return original(self, work, jobs)

    monkeypatch.setattr(processes.Processes, "run", counted)
    monkeypatch.setattr("skinbake.cli.runners.WORTHWHILE", 0.0)
    return counts
