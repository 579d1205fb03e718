"""Fixtures that several modules of the command line's tests share."""

from __future__ import annotations

from typing import Any

import pytest

from skinbake.jobs import processes


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Have workers started for the least work; the list tells how many each run may have."""
    counts: list[int] = []
    original = processes.Processes.run

    def counted(self: Any, work: Any, jobs: Any) -> Any:
        counts.append(self.workers)
        return original(self, work, jobs)

    monkeypatch.setattr(processes.Processes, "run", counted)
    monkeypatch.setattr("skinbake.cli.runners.WORTHWHILE", 0.0)
    return counts
