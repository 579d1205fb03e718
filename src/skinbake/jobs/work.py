"""Work on many files: a job for each file, a result for each job, and the result of a job that failed."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, TypeVar

from skinbake.containment import OWN_FOLDERS, Within
from skinbake.errors import Notice, SkinbakeError

if TYPE_CHECKING:
    from skinbake.commands.bake import Baker
    from skinbake.gltf.output import Writing
    from skinbake.lighting.measured import Progress, VerifyOptions
    from skinbake.report.bake import FileResult
    from skinbake.report.verify import FileVerdict


class Elsewhere(Protocol):
    """Fetches files that are not on this machine's disk, and stores what is written.

    Its methods do what the commands' functions of the same names do, and raise what these raise.
    """

    def bake_file(
        self, source: str, target: str | None, baker: Baker, how: Writing, within: Within
    ) -> FileResult:
        """Bake a file."""

    def verify_file(
        self, source: str, options: VerifyOptions, progress: Progress | None, within: Within
    ) -> FileVerdict:
        """Verify a file."""


@dataclass(frozen=True, slots=True)
class Job:
    """One file to work on, and the file that is made of it, None where none is.

    known is what a state file has on it, missing why there is no such file after all. ``within`` are the
    folders that reading and writing stay in. elsewhere is given where even plain paths are another
    machine's.
    """

    source: str
    target: str | None = None
    known: bytes | None = None
    missing: str | None = None
    within: Within = OWN_FOLDERS
    elsewhere: Elsewhere | None = None


class Result(Protocol):
    """What every command's result of a file has; results are frozen dataclasses."""

    @property
    def error(self) -> SkinbakeError | None:
        """Why the file failed, None where it did not."""

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What had to be assumed."""

    @property
    def record(self) -> bytes | None:
        """What a state file is to hold of the file."""

    @property
    def timings(self) -> Mapping[str, float] | None:
        """Seconds by stage, None where they were not asked for."""


JobT = TypeVar("JobT")
ReturnT = TypeVar("ReturnT")
ResultT = TypeVar("ResultT", bound=Result)
JobT_contra = TypeVar("JobT_contra", contravariant=True)
ReturnT_co = TypeVar("ReturnT_co", covariant=True)


def changed(result: ResultT, **fields: object) -> ResultT:
    """Return a result with other values in some of its fields."""
    return replace(result, **fields)  # type: ignore[type-var]  # no protocol says: a dataclass


class Work(Protocol[JobT_contra, ReturnT_co]):
    """What is done with each job; a value that can be pickled, as its jobs and results can."""

    def __call__(self, job: JobT_contra, /) -> ReturnT_co:
        """Return what became of one job; raises nothing for a file's sake."""

    def failed(self, job: JobT_contra, error: SkinbakeError, /) -> ReturnT_co:
        """Return the result of a job that an error ended."""

    def lost(self, job: JobT_contra, reason: str, /) -> ReturnT_co:
        """Return the result of a job that no process lived to report on."""


class Runner(Protocol[JobT, ReturnT]):
    """Does one work on many jobs, somewhere."""

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number of the job, ``work(job)``) as jobs are done, in any order, each exactly once.

        ``work`` and the jobs can be pickled. A runner that loses a worker (killed, out of memory) tries its
        job again, and at last yields ``work.lost(job, reason)``. Closing the generator stops what has not
        begun.
        """
