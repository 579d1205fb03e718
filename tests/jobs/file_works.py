"""Works that Dask workers can import: ordinary ones, and ones that behave badly on purpose."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skinbake.errors import SkinbakeError
from skinbake.jobs import verify
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import FileResult
from skinbake.report.verify import FileVerdict
from tests.support.baking import bake_work


def baking(**options: Any) -> FileWork[FileResult]:
    """Return the work that bakes."""
    return FileWork((bake_work(**options),))


def verifying(options: VerifyOptions | None = None) -> FileWork[FileVerdict]:
    """Return the work that verifies."""
    return FileWork((verify.Verify(options or VerifyOptions()),))


@dataclass(frozen=True)
class Bake:
    """Bakes, and is there to be varied."""

    work: FileWork[FileResult] = field(default_factory=baking)

    def __call__(self, job: Job) -> FileResult:
        return self.work(job)

    def failed(self, job: Job, error: SkinbakeError) -> FileResult:
        return self.work.failed(job, error)

    def lost(self, job: Job, reason: str, *, is_written: bool = False) -> FileResult:
        return self.work.lost(job, reason, is_written=is_written)


@dataclass(frozen=True)
class BakeOrDie(Bake):
    """Kills its process over files whose name begins with ``killer``; notes each attempt in a folder."""

    notes: str = ""

    def __call__(self, job: Job) -> FileResult:
        name = Path(job.source).name
        descriptor = os.open(Path(self.notes, name), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(descriptor, b".")
        if name.startswith("killer"):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().__call__(job)


@dataclass(frozen=True)
class Raise(Bake):
    """Raises, which works must not."""

    def __call__(self, job: Job) -> FileResult:
        raise RuntimeError("on purpose")
