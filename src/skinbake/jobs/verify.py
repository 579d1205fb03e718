"""Verifying as work on many files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from skinbake.commands.verify import verify_file
from skinbake.errors import SkinbakeError
from skinbake.files.bounds import Within
from skinbake.jobs.file_work import on_files
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import Check, FileVerdict

if TYPE_CHECKING:
    from skinbake.jobs import state


@dataclass(frozen=True, slots=True)
class Verify:
    """Verify the source of a job. ``sources`` has the check of ``--sources`` by its name.

    A name in ``without_output`` is a source, of which that check alone is made. finds_places: whether it is
    found where the bake shows, which is no part of what passes. ``pages`` has the path of the page to write
    of a source for a sheet, and sync tells whether to wait until it is on the disk.
    """

    undone: ClassVar[str] = "not verified"
    seconds: ClassVar[tuple[float, float]] = (0.05, 2e-6)
    options: VerifyOptions
    sources: Mapping[str, Check] = field(default_factory=dict)
    without_output: frozenset[str] = frozenset()
    finds_places: bool = False
    pages: Mapping[str, Path] = field(default_factory=dict)
    sync: bool = True

    def result_of(self, job: Job, *, traced: bool) -> FileVerdict:
        """Verify the file. Raises SkinbakeError if it cannot be read. Nothing is written or traced."""
        if job.source in self.without_output:
            return FileVerdict(job.source, self._checks(job))
        options = replace(self.options, finds_places=self.finds_places or job.source in self.pages)

        def verified(source: str, target: str | None, within: Within) -> FileVerdict:
            verdict = verify_file(source, options, within.bounds)
            if job.source not in self.pages:
                return verdict
            from skinbake.commands.view import entry_of  # most runs make no pages

            path = self.pages[job.source]
            return replace(verdict, entry=entry_of(verdict, options, path, within.bounds, sync=self.sync))

        found = on_files(job._replace(target=None), verified)
        return replace(found, checks=(*found.checks, *self._checks(job)))

    def failed(self, job: Job, error: SkinbakeError) -> FileVerdict:
        """Return that the file could not be verified."""
        return FileVerdict(job.source, notices=error.notices, error=error)

    def up_to_date(self, job: Job) -> FileVerdict:
        """Return that the file passed before and has not changed since."""
        return FileVerdict(job.source, self._checks(job), up_to_date=True)

    def _checks(self, job: Job) -> tuple[Check, ...]:
        return (self.sources[job.source],) if job.source in self.sources else ()

    def is_noted(self, job: Job) -> bool:
        """Tell whether a state file can hold the verdict."""
        return job.source not in self.without_output

    def evidence(
        self, job: Job, result: FileVerdict, before: state.Seen
    ) -> tuple[state.Digests, state.Digests] | None:
        """Return the digests of the files read, if a bake in it passed and no file changed meanwhile."""
        was_checked = result.passed and not result.found_no_bake and not result.left
        return (before.digests, {}) if was_checked and before.still_there else None
