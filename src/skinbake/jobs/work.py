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
    from skinbake.lighting.measured import VerifyOptions
    from skinbake.report.bake import FileResult
    from skinbake.report.verify import FileVerdict


class Elsewhere(Protocol):
    """Fetch files that are not on the local disk, and store the written files.

    Its methods do the same as the commands' functions of the same names, and raise the same errors.
    """

    def bake_file(
        self, source: str, target: str | None, baker: Baker, how: Writing, within: Within
    ) -> FileResult:
        """Bake a file."""

    def verify_file(self, source: str, options: VerifyOptions, within: Within) -> FileVerdict:
        """Verify a file."""


@dataclass(frozen=True, slots=True)
class Job:
    """One file to work on, and the file that is made from it (None: no file is made).

    known is the record of a state file. missing is the reason if the file does not exist after all.
    ``within`` are the folders in which files are read and written. elsewhere is given if even plain paths
    belong to another machine.
    """

    source: str
    target: str | None = None
    known: bytes | None = None
    missing: str | None = None
    within: Within = OWN_FOLDERS
    elsewhere: Elsewhere | None = None


class Result(Protocol):
    """The members of every command's result of a file. Results are frozen dataclasses."""

    @property
    def error(self) -> SkinbakeError | None:
        """The reason why the file failed, or None if it did not fail."""

    @property
    def notices(self) -> tuple[Notice, ...]:
        """The assumptions that were made."""

    @property
    def record(self) -> bytes | None:
        """The record for the state file."""

    @property
    def timings(self) -> Mapping[str, float] | None:
        """The seconds of each stage, or None if they were not asked for."""


JobT = TypeVar("JobT")
ReturnT = TypeVar("ReturnT")
ResultT = TypeVar("ResultT", bound=Result)
JobT_contra = TypeVar("JobT_contra", contravariant=True)
ReturnT_co = TypeVar("ReturnT_co", covariant=True)


def changed(result: ResultT, **fields: object) -> ResultT:
    """Return a result with other values in some of its fields."""
    return replace(result, **fields)  # type: ignore[type-var]  # a protocol cannot ask for a dataclass


class Work(Protocol[JobT_contra, ReturnT_co]):
    """The work on each job. The work, its jobs and its results can be pickled."""

    def __call__(self, job: JobT_contra, /) -> ReturnT_co:
        """Return the result of one job. An error in a file raises nothing."""

    def failed(self, job: JobT_contra, error: SkinbakeError, /) -> ReturnT_co:
        """Return the result of a job that an error ended."""

    def lost(self, job: JobT_contra, reason: str, /) -> ReturnT_co:
        """Return the result of a job whose process died before it reported."""


class Runner(Protocol[JobT, ReturnT]):
    """Do one work on many jobs, in this process or in others."""

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number of the job, ``work(job)``) as jobs are done, in any order, each exactly once.

        ``work`` and the jobs can be pickled. If a runner loses a worker (killed, out of memory), it tries the
        job again, and at last yields ``work.lost(job, reason)``. Closing the generator stops the jobs that
        have not begun.
        """
