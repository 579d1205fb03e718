"""Inspecting as work on many files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from skinbake.commands.inspect import inspect_file
from skinbake.errors import SkinbakeError
from skinbake.files.bounds import Within
from skinbake.jobs.file_work import on_files
from skinbake.jobs.work import Job
from skinbake.report.inspect import FileSummary


@dataclass(frozen=True, slots=True)
class Inspect:
    """Sum up the source of a job."""

    undone: ClassVar[str] = "not inspected"
    seconds: ClassVar[tuple[float, float]] = (2e-3, 4e-9)

    def result_of(self, job: Job, *, traced: bool) -> FileSummary:
        """Sum up the file. Raises SkinbakeError if it cannot be read. Nothing is written or traced."""

        def summed_up(source: str, target: str | None, within: Within) -> FileSummary:
            return FileSummary(job.source, inspect_file(source, within.bounds))

        return on_files(job, summed_up)

    def failed(self, job: Job, error: SkinbakeError) -> FileSummary:
        """Return that the file could not be read."""
        return FileSummary(job.source, error=error)
