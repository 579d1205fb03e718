"""Works that Dask workers can import: ordinary ones, and ones that behave badly on purpose."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path

from skinbake.commands.bake import BakeOptions
from skinbake.containment import OWN_FOLDERS, Within
from skinbake.errors import InputError, Place
from skinbake.jobs.remote.staging import bake_anywhere, verify_anywhere
from skinbake.lighting.measured import VerifyOptions
from skinbake.report.bake import FileResult
from skinbake.report.verify import FileVerdict


@dataclass(frozen=True)
class Job:
    """One file to work on."""

    source: str
    target: str | None = None
    within: Within = OWN_FOLDERS


@dataclass(frozen=True)
class Bake:
    """Bakes."""

    options: BakeOptions = field(default_factory=lambda: BakeOptions(make_folder=True))

    def __call__(self, job: Job) -> FileResult:
        return bake_anywhere(job.source, job.target, self.options, job.within)

    def lost(self, job: Job, reason: str) -> FileResult:
        return FileResult(job.source, job.target, "failed", error=InputError(reason, Place(job.source)))


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


@dataclass(frozen=True)
class Verify:
    """Verifies."""

    options: VerifyOptions = field(default_factory=VerifyOptions)

    def __call__(self, job: Job) -> FileVerdict:
        return verify_anywhere(job.source, self.options, within=job.within)

    def lost(self, job: Job, reason: str) -> FileVerdict:
        return FileVerdict(job.source, error=InputError(reason, Place(job.source)))
