"""Baking as work on many files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import DEFAULTS, BakeOptions
from skinbake.errors import SkinbakeError
from skinbake.files.bounds import Bounds, Within
from skinbake.gltf.document import read_document
from skinbake.gltf.writing.beside import files_read
from skinbake.gltf.writing.output import AS_USUAL, Writing
from skinbake.jobs.file_work import on_files
from skinbake.jobs.work import Job
from skinbake.report.bake import FileResult

if TYPE_CHECKING:
    from skinbake.jobs import state


@dataclass(frozen=True, slots=True)
class BakeRecipe:
    """What decides what a bake writes, for the recipe of a state file."""

    options: BakeOptions
    pack: bool = False


@dataclass(frozen=True, slots=True)
class Bake:
    """Bake the source of a job into its target."""

    undone: ClassVar[str] = "not baked"
    seconds: ClassVar[tuple[float, float]] = (5e-3, 1.8e-8)
    options: BakeOptions = DEFAULTS
    writing: Writing = AS_USUAL

    def result_of(self, job: Job, *, traced: bool) -> FileResult:
        """Bake the file. Raises SkinbakeError; then nothing has been written."""
        how = self.writing._replace(traced=traced)

        def baked(source: str, target: str | None, within: Within) -> FileResult:
            return bake_file(source, target, self.options, how, within)

        return on_files(job, baked, pack=how.pack)

    def failed(self, job: Job, error: SkinbakeError) -> FileResult:
        """Return that the file failed."""
        return FileResult(job.source, job.target, "failed", notices=error.notices, error=error)

    def up_to_date(self, job: Job) -> FileResult:
        """Return that the target is already the result of this bake."""
        read: tuple[str, ...] = ()
        if self.writing.lists_read:
            from skinbake.report.depfile import prerequisites  # only --depfile needs it

            document = read_document(job.source, job.within.bounds)
            read = prerequisites(job.source, files_read(document, job.target, pack=self.writing.pack))
        return FileResult(job.source, job.target, "up-to-date", read=read)

    def is_noted(self, job: Job) -> bool:
        """Tell whether there is a target to note."""
        return job.target is not None

    def evidence(
        self, job: Job, result: FileResult, before: state.Seen
    ) -> tuple[state.Digests, state.Digests] | None:
        """Return the digests of the files read and of the files made, or None if anything is in doubt."""
        if self.writing.dry_run:
            return None
        written = result.written or {}
        if job.source != job.target:
            made = self._made(job, written, before)
            return None if made is None or not before.still_there else (before.digests, made)
        # A bake of a baked file changes nothing: the file is its own input.
        after = self._made(job, written, before) if written else before.digests
        is_unharmed = bool(written) or before.still_there
        return (after, after) if after and is_unharmed else None

    def _made(self, job: Job, written: dict[str, str], before: state.Seen) -> state.Digests | None:
        from skinbake.jobs import state  # only --skip-unchanged needs it

        bounds = Bounds(job.within.output, job.within.bounds.allowed)
        if job.source == job.target:
            bounds = job.within.bounds
        return state.made(str(job.target), written, before.digests, bounds)
