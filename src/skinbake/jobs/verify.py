"""Verifying as work on many files."""

from __future__ import annotations

from dataclasses import dataclass, replace

from skinbake.containment import OWN_FOLDERS, Within
from skinbake.errors import InputError, Place
from skinbake.gltf.budget import memory_limited
from skinbake.gltf.document import STDIO
from skinbake.jobs import state
from skinbake.jobs.remote.staging import verify_anywhere
from skinbake.jobs.runners import timed
from skinbake.lighting.measured import Progress, VerifyOptions
from skinbake.report.verify import FileVerdict

MODULES = ("skinbake.cli.main", "skinbake.jobs.verify")
"""What a worker needs, to be imported before it starts."""

SECONDS_A_FILE, SECONDS_A_BYTE = 0.05, 2e-6
"""What verifying a file takes, about: enough to know whether workers are worth starting."""


@dataclass(frozen=True, slots=True)
class VerifyJob:
    """One file to verify; known is what a state file has on it, missing why there is none after all.

    ``within`` are the folders that reading stays in.
    """

    source: str
    known: bytes | None = None
    missing: str | None = None
    within: Within = OWN_FOLDERS


@dataclass(frozen=True, slots=True)
class VerifyWork:
    """Verifies a file, unless ``recipe`` is given and what is known says that it passed as it is.

    ``progress`` cannot go to another process. max_memory is what a file may take, in bytes.
    """

    options: VerifyOptions
    recipe: state.Recipe | None = None
    timed: bool = False
    progress: Progress | None = None
    max_memory: int | None = None

    def __call__(self, job: VerifyJob) -> FileVerdict:
        """Return the verdict on the file."""
        with memory_limited(self.max_memory):
            if not self.timed:
                return self._done(job)
            verdict, timings = timed(lambda: self._done(job))
        return replace(verdict, timings=timings)

    def lost(self, job: VerifyJob, reason: str) -> FileVerdict:
        """Return that the file could not be verified."""
        return _failed(job, f"not verified: {reason}")

    def _done(self, job: VerifyJob) -> FileVerdict:
        if job.missing is not None:
            return _failed(job, job.missing)
        if self.recipe is None or job.source == STDIO:
            return verify_anywhere(job.source, self.options, self.progress, job.within)
        if job.known is not None and self.recipe.still_holds(job.known, job.source, None):
            return FileVerdict(job.source, up_to_date=True)
        before = state.seen(job.source, job.within.bounds)
        verdict = verify_anywhere(job.source, self.options, self.progress, job.within)
        if before is None or not verdict.passed or not _is_still_there(before):
            return verdict
        return replace(verdict, record=self.recipe.record(job.source, None, before.digests, {}))


def _is_still_there(files: state.Seen) -> bool:
    try:
        return files.still_there
    except (OSError, ValueError):
        return False


def _failed(job: VerifyJob, reason: str) -> FileVerdict:
    return FileVerdict(job.source, error=InputError(reason, Place(job.source)))
