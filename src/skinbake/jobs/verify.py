"""Verifying as work on many files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from skinbake.commands.verify import verify_file
from skinbake.errors import SkinbakeError
from skinbake.jobs import elsewhere
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import FileVerdict

if TYPE_CHECKING:
    from skinbake.jobs import state


@dataclass(frozen=True, slots=True)
class Verify:
    """Verify the source of a job."""

    undone: ClassVar[str] = "not verified"
    seconds: ClassVar[tuple[float, float]] = (0.05, 2e-6)
    options: VerifyOptions

    def result_of(self, job: Job, *, traced: bool) -> FileVerdict:
        """Verify the file. Raises SkinbakeError if it cannot be read. Nothing is written or traced."""
        return elsewhere.read(job, lambda source, bounds: verify_file(source, self.options, bounds))

    def failed(self, job: Job, error: SkinbakeError) -> FileVerdict:
        """Return that the file could not be verified."""
        return FileVerdict(job.source, notices=error.notices, error=error)

    def up_to_date(self, job: Job) -> FileVerdict:
        """Return that the file passed before and has not changed since."""
        return FileVerdict(job.source, up_to_date=True)

    def is_noted(self, job: Job) -> bool:
        """Tell that a state file can hold every verdict."""
        return True

    def evidence(
        self, job: Job, result: FileVerdict, before: state.Seen
    ) -> tuple[state.Digests, state.Digests] | None:
        """Return the digests of the files read, if a bake in it passed and no file changed meanwhile."""
        was_checked = result.passed and not result.found_no_bake and not result.left
        return (before.digests, {}) if was_checked and before.still_there else None
