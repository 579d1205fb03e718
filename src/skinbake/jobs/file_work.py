"""The work on one file of many, the same for every command: state, timings, memory and failures."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, runtime_checkable

from skinbake.errors import InputError, Place, SkinbakeError
from skinbake.files.urls import STDIO, is_url
from skinbake.gltf.budget import memory_limited
from skinbake.jobs.work import Job, ResultT, changed, survived
from skinbake.threads import threads_limited
from skinbake.timing import Told, stage, tell, timed

if TYPE_CHECKING:
    from skinbake.jobs import state
    from skinbake.jobs.work import Makes, Result


def on_files(job: Job, makes: Makes[ResultT], *, pack: bool = False) -> ResultT:
    """Return what ``makes`` returns for the files of a job, which may have URLs. Raises SkinbakeError.

    ``pack`` tells that images are needed to make it, also if they are not copied.
    """
    if not is_url(job.source) and (job.target is None or not is_url(job.target)):
        return makes(job.source, job.target, job.within)
    from skinbake.jobs.remote.staging import staged  # only URLs need it

    return staged(job, makes, pack=pack)


ResultT_co = TypeVar("ResultT_co", bound="Result", covariant=True)


class FileCommand(Protocol[ResultT_co]):
    """The work of a command on one file, and the results that it can return."""

    @property
    def undone(self) -> str:
        """The words before the reason why a file was lost, like ``not baked``."""

    @property
    def seconds(self) -> tuple[float, float]:
        """The approximate time of a file, and of each byte of it. It decides if workers are worthwhile."""

    def result_of(self, job: Job, *, traced: bool) -> ResultT_co:
        """Do the work. If ``traced``, the result has digests of the written files. Raises SkinbakeError."""

    def failed(self, job: Job, error: SkinbakeError) -> ResultT_co:
        """Return the result of a file that failed."""


@runtime_checkable
class NotedCommand(FileCommand[ResultT], Protocol[ResultT]):
    """A command whose outcomes a state file can hold."""

    def up_to_date(self, job: Job) -> ResultT:
        """Return the result of a file that is up to date."""

    def is_noted(self, job: Job) -> bool:
        """Tell whether a state file can hold the outcome of this file."""

    def evidence(
        self, job: Job, result: ResultT, before: state.Seen
    ) -> tuple[state.Digests, state.Digests] | None:
        """Return the digests of the files read and of the files made, or None if anything is in doubt.

        May raise OSError or ValueError. Both mean doubt too.
        """


@dataclass(frozen=True, slots=True)
class FileWork(Generic[ResultT]):
    """Have a command work on a file, unless there is a recipe and the file is known to be up to date.

    Files may have different options: ``commands`` has the command with each set of them, and a job the number
    of its set. ``recipes`` has a recipe for each, or none. A recipe needs a NotedCommand. max_memory is the
    memory that a file may take, in bytes. threads is the number of threads for it, None for one on each core.
    An error in a file raises nothing.
    """

    commands: tuple[FileCommand[ResultT], ...]
    recipes: tuple[state.Recipe, ...] = ()
    is_timed: bool = False
    max_memory: int | None = None
    threads: int | None = None

    def __call__(self, job: Job) -> ResultT:
        """Return the result of the file."""
        tell(Told(job.source))  # stages and steps belong to it from now on
        with memory_limited(self.max_memory), threads_limited(self.threads):
            if not self.is_timed:
                return self._survived(job)
            result, timings = timed(lambda: self._survived(job))
        return changed(result, timings=timings)

    def failed(self, job: Job, error: SkinbakeError) -> ResultT:
        """Return the result of a file that failed."""
        return self.commands[job.variant].failed(job, error)

    def lost(self, job: Job, reason: str, *, is_written: bool = False) -> ResultT:
        """Return the result of a file whose process died before it reported, though it may have written."""
        what = (
            "its output is written, but not its report" if is_written else self.commands[job.variant].undone
        )
        return self.failed(job, InputError(f"{what}: {reason}", Place(job.source)))

    def _survived(self, job: Job) -> ResultT:
        return survived(lambda: self._result(job), lambda error: self.failed(job, error), job.source)

    def _result(self, job: Job) -> ResultT:
        """Return the result of the file, with its record if a state file can hold the outcome."""
        if job.missing is not None:
            raise InputError(job.missing, Place(job.source))
        command = self.commands[job.variant]
        is_kept = self.recipes and STDIO not in {job.source, job.target}
        recipe = self.recipes[job.variant] if is_kept else None
        if recipe is None or not isinstance(command, NotedCommand) or not command.is_noted(job):
            return command.result_of(job, traced=False)
        noted: NotedCommand[ResultT] = command
        from skinbake.jobs import state  # only --skip-unchanged needs it

        with stage("state"):
            if job.known is not None and recipe.still_holds(job.known, job.source, job.target, job.within):
                return noted.up_to_date(job)
            before = state.seen(job.source, job.within.bounds)
        result = noted.result_of(job, traced=True)
        with stage("state"), suppress(OSError, ValueError):  # if anything is in doubt, there is no record
            found = None if before is None else noted.evidence(job, result, before)
            if found is not None:
                record = recipe.record(job.source, job.target, *found, job.within)
                return changed(result, record=record)
        return result
