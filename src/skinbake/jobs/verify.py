"""Verifying as work on many files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from skinbake.commands.verify import verify_file
from skinbake.errors import SkinbakeError
from skinbake.jobs import state
from skinbake.jobs.elsewhere import elsewhere_of
from skinbake.jobs.work import Job
from skinbake.lighting.measured import Progress, VerifyOptions
from skinbake.report.verify import FileVerdict

MODULES = ("skinbake.cli.main", "skinbake.jobs.verify", "skinbake.jobs.file_work")
"""What a worker needs, to be imported before it starts."""

SECONDS_A_FILE, SECONDS_A_BYTE = 0.05, 2e-6
"""What verifying a file takes, about: enough to know whether workers are worth starting."""


@dataclass(frozen=True, slots=True)
class Verify:
    """Verifies a job's source. ``progress`` cannot go to another process."""

    undone: ClassVar[str] = "not verified"
    options: VerifyOptions
    progress: Progress | None = None

    def result_of(self, job: Job, *, traced: bool) -> FileVerdict:
        """Verify the file; raises SkinbakeError where it cannot be read. It writes nothing to trace."""
        there = elsewhere_of(job)
        if there is not None:
            return there.verify_file(job.source, self.options, self.progress, job.within)
        return verify_file(job.source, self.options, self.progress, job.within.bounds)

    def failed(self, job: Job, error: SkinbakeError) -> FileVerdict:
        """Return that the file could not be verified."""
        return FileVerdict(job.source, notices=error.notices, error=error)

    def up_to_date(self, job: Job) -> FileVerdict:
        """Return that the file has passed as it is."""
        return FileVerdict(job.source, up_to_date=True)

    def is_noted(self, job: Job) -> bool:
        """Tell that every file's verdict can be noted."""
        return True

    def evidence(
        self, job: Job, result: FileVerdict, before: state.Seen
    ) -> tuple[state.Digests, state.Digests] | None:
        """Return the digests of what was read, of a file that passed and that has not changed meanwhile."""
        return (before.digests, {}) if result.passed and before.still_there else None
