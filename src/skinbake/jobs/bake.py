"""Baking as work on many files."""

from __future__ import annotations

from dataclasses import dataclass, replace

from skinbake.commands.bake import BakeOptions
from skinbake.containment import OWN_FOLDERS, Bounds, Within
from skinbake.errors import InputError, Place
from skinbake.gltf.budget import memory_limited
from skinbake.gltf.document import STDIO
from skinbake.jobs import state
from skinbake.jobs.remote.staging import bake_anywhere
from skinbake.jobs.runners import timed
from skinbake.report.bake import FileResult
from skinbake.timing import stage

MODULES = ("skinbake.cli.main", "skinbake.jobs.bake")
"""What a worker needs, to be imported before it starts."""

SECONDS_A_FILE, SECONDS_A_BYTE = 5e-3, 1.3e-8
"""What baking a file takes, about: enough to know whether workers are worth starting."""


@dataclass(frozen=True, slots=True)
class BakeJob:
    """One file to bake; known is what a state file has on it, missing why there is none after all.

    ``within`` are the folders that reading and writing stay in.
    """

    source: str
    target: str | None
    known: bytes | None = None
    missing: str | None = None
    within: Within = OWN_FOLDERS


@dataclass(frozen=True, slots=True)
class BakeWork:
    """Bakes a file, unless ``recipe`` is given and what is known of the file says that it is up to date.

    max_memory is what a file may take, in bytes.
    """

    options: BakeOptions
    recipe: state.Recipe | None = None
    timed: bool = False
    max_memory: int | None = None

    def __call__(self, job: BakeJob) -> FileResult:
        """Return what became of the file."""
        with memory_limited(self.max_memory):
            if not self.timed:
                return self._done(job)
            result, timings = timed(lambda: self._done(job))
        return replace(result, timings=timings)

    def lost(self, job: BakeJob, reason: str) -> FileResult:
        """Return that the file failed."""
        return _failed(job, f"not baked: {reason}")

    def _done(self, job: BakeJob) -> FileResult:
        if job.missing is not None:
            return _failed(job, job.missing)
        if self.recipe is None or job.target is None or STDIO in {job.source, job.target}:
            return bake_anywhere(job.source, job.target, self.options, job.within)
        with stage("state"):
            if job.known is not None and self.recipe.still_holds(job.known, job.source, job.target):
                return FileResult(job.source, job.target, "up-to-date")
            before = state.seen(job.source, job.within.bounds)
        result = bake_anywhere(job.source, job.target, replace(self.options, traced=True), job.within)
        if before is None or result.error is not None or self.options.dry_run:
            return result
        with stage("state"):
            return replace(result, record=self._record(job, before, result.written or {}))

    def _record(self, job: BakeJob, before: state.Seen, written: dict[str, str]) -> bytes | None:
        """Return what to note of a file that was just baked, None where anything casts doubt on it."""
        if self.recipe is None or job.target is None:
            return None
        try:
            if job.source == job.target:  # baking what was baked changes nothing: it is its own input
                after = self._made(job, written, before) if written else before.digests
                unharmed = bool(written) or before.still_there
                return (
                    self.recipe.record(job.source, job.target, after, after) if after and unharmed else None
                )
            made = self._made(job, written, before)
            if made is None or not before.still_there:
                return None
            return self.recipe.record(job.source, job.target, before.digests, made)
        except (OSError, ValueError):
            return None

    def _made(self, job: BakeJob, written: dict[str, str], before: state.Seen) -> state.Digests | None:
        bounds = Bounds(job.within.output, job.within.bounds.allowed)
        return state.made(str(job.target), written, before.digests, bounds)


def _failed(job: BakeJob, reason: str) -> FileResult:
    return FileResult(job.source, job.target, "failed", error=InputError(reason, Place(job.source)))
