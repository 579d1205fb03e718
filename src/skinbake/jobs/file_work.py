"""The work on one file of many, whichever command does it: state, timings, memory, and failures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol

from skinbake.errors import InputError, Place, SkinbakeError
from skinbake.gltf.budget import memory_limited
from skinbake.gltf.document import STDIO
from skinbake.jobs import state
from skinbake.jobs.boundary import survived
from skinbake.jobs.work import Job, ResultT, changed
from skinbake.timing import stage, timed


class FileCommand(Protocol[ResultT]):
    """What a command does with one file, and what its results are."""

    @property
    def undone(self) -> str:
        """What is said before the reason why a file was lost, like ``not baked``."""

    def result_of(self, job: Job, *, traced: bool) -> ResultT:
        """Do it, with digests of what is written where the result is traced; raises SkinbakeError."""

    def failed(self, job: Job, error: SkinbakeError) -> ResultT:
        """Return the result of a file that failed."""

    def up_to_date(self, job: Job) -> ResultT:
        """Return the result of a file that need not be done again."""

    def is_noted(self, job: Job) -> bool:
        """Tell whether the file's outcome is something that a state file can hold."""

    def evidence(
        self, job: Job, result: ResultT, before: state.Seen
    ) -> tuple[state.Digests, state.Digests] | None:
        """Return the digests of what was read and of what was made; None where anything is in doubt.

        May raise OSError or ValueError, for doubt too.
        """


@dataclass(frozen=True, slots=True)
class FileWork(Generic[ResultT]):
    """Has a command do a file, unless ``recipe`` is given and the file is known to be up to date.

    max_memory is what a file may take, in bytes. Raises nothing for a file's sake.
    """

    command: FileCommand[ResultT]
    recipe: state.Recipe | None = None
    is_timed: bool = False
    max_memory: int | None = None

    def __call__(self, job: Job) -> ResultT:
        """Return what became of the file."""
        with memory_limited(self.max_memory):
            if not self.is_timed:
                return self._survived(job)
            result, timings = timed(lambda: self._survived(job))
        return changed(result, timings=timings)

    def failed(self, job: Job, error: SkinbakeError) -> ResultT:
        """Return the result of a file that failed."""
        return self.command.failed(job, error)

    def lost(self, job: Job, reason: str) -> ResultT:
        """Return the result of a file that no process lived to report on."""
        return self.failed(job, InputError(f"{self.command.undone}: {reason}", Place(job.source)))

    def _survived(self, job: Job) -> ResultT:
        return survived(lambda: self._result(job), lambda error: self.failed(job, error), job.source)

    def _result(self, job: Job) -> ResultT:
        if job.missing is not None:
            raise InputError(job.missing, Place(job.source))
        recipe = self.recipe
        if recipe is None or STDIO in {job.source, job.target} or not self.command.is_noted(job):
            return self.command.result_of(job, traced=False)
        with stage("state"):
            if job.known is not None and recipe.still_holds(job.known, job.source, job.target):
                return self.command.up_to_date(job)
            before = state.seen(job.source, job.within.bounds)
        result = self.command.result_of(job, traced=True)
        if before is None:
            return result
        with stage("state"):
            return changed(result, record=self._record(recipe, job, result, before))

    def _record(self, recipe: state.Recipe, job: Job, result: ResultT, before: state.Seen) -> bytes | None:
        """Return what to note of a file that was just done, None where anything casts doubt on it."""
        try:
            found = self.command.evidence(job, result, before)
            return None if found is None else recipe.record(job.source, job.target, *found)
        except (OSError, ValueError):
            return None
