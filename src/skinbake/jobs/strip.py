"""Stripping as work on many files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from skinbake.commands.strip import strip_file
from skinbake.errors import SkinbakeError
from skinbake.files.bounds import Within
from skinbake.gltf.writing.output import AS_USUAL, Writing
from skinbake.jobs.file_work import on_files
from skinbake.jobs.work import Job
from skinbake.report.strip import StripResult


@dataclass(frozen=True, slots=True)
class Strip:
    """Write the target of a job: its source as it was before bake."""

    undone: ClassVar[str] = "not stripped"
    seconds: ClassVar[tuple[float, float]] = (3e-3, 4e-9)
    writing: Writing = AS_USUAL
    warnings_as_errors: bool = False

    def result_of(self, job: Job, *, traced: bool) -> StripResult:
        """Strip the file. Raises SkinbakeError; then nothing has been written. Nothing is traced."""

        def stripped(source: str, target: str | None, within: Within) -> StripResult:
            as_errors = self.warnings_as_errors
            return strip_file(source, str(target), self.writing, within, warnings_as_errors=as_errors)

        return on_files(job, stripped)

    def failed(self, job: Job, error: SkinbakeError) -> StripResult:
        """Return that the file failed."""
        return StripResult(job.source, str(job.target), 0, error.notices, error)
