"""Work on many files: jobs, results, and the runners of this process. Other modules have others."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, Protocol, TypeAlias, TypeVar

from skinbake.errors import InputError, Notice, Place, SkinbakeError, defect, printable_lines
from skinbake.files.bounds import OWN_FOLDERS, Within


class Job(NamedTuple):
    """One file to work on, and the file that is made from it (None: no file is made).

    known is the record of a state file. missing is the reason if the file does not exist after all.
    ``within`` are the folders in which files are read and written. ``variant`` is the number of the options
    for the file.
    """

    source: str
    target: str | None = None
    known: bytes | None = None
    missing: str | None = None
    within: Within = OWN_FOLDERS
    variant: int = 0


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


T = TypeVar("T")
JobT = TypeVar("JobT")
ReturnT = TypeVar("ReturnT")
ResultT = TypeVar("ResultT", bound=Result)
JobT_contra = TypeVar("JobT_contra", contravariant=True)
ReturnT_co = TypeVar("ReturnT_co", covariant=True)

Makes: TypeAlias = "Callable[[str, str | None, Within], ResultT]"
"""The function of a command that makes a file: of the path, the path of the target, and within."""


def changed(result: ResultT, **fields: object) -> ResultT:
    """Return a result with other values in some of its fields."""
    return replace(result, **fields)  # type: ignore[type-var]  # a protocol cannot ask for a dataclass


class Work(Protocol[JobT_contra, ReturnT_co]):
    """The work on each job. The work, its jobs and its results can be pickled."""

    def __call__(self, job: JobT_contra, /) -> ReturnT_co:
        """Return the result of one job. An error in a file raises nothing."""

    def failed(self, job: JobT_contra, error: SkinbakeError, /) -> ReturnT_co:
        """Return the result of a job that an error ended."""

    def lost(self, job: JobT_contra, reason: str, /, *, is_written: bool = False) -> ReturnT_co:
        """Return the result of a job whose process died before it reported, though it may have written."""


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


class InThisProcess:
    """The runner for a single file, and for work that is too small for other processes."""

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number, ``work(job)``) in order."""
        for number, job in enumerate(jobs):
            yield number, work(job)


@dataclass(frozen=True, slots=True)
class FirstThese(Generic[JobT, ReturnT]):
    """A runner for jobs of which some must run in order, because they may use the same file on the disk.

    The jobs numbered in ``turns`` are done first, one at a time. Then the other jobs run side by side.
    """

    turns: Sequence[int]
    one_by_one: Runner[JobT, ReturnT]
    side_by_side: Runner[JobT, ReturnT]

    def run(
        self, work: Work[JobT, ReturnT], jobs: Sequence[JobT]
    ) -> Generator[tuple[int, ReturnT], None, None]:
        """Yield (number, ``work(job)``). The jobs in ``turns`` come first."""
        first = set(self.turns)
        rest = [number for number in range(len(jobs)) if number not in first]
        for runner, numbers in ((self.one_by_one, sorted(first)), (self.side_by_side, rest)):
            if numbers:
                with closing(runner.run(work, [jobs[n] for n in numbers])) as results:
                    for at, result in results:
                        yield numbers[at], result


def in_order(results: Generator[tuple[int, T], None, None]) -> Generator[T, None, None]:
    """Yield results in the order of their numbers, each as soon as all earlier results are there.

    An interrupt comes after the results that wait for earlier ones: their outputs stay. Closing this
    generator closes ``results``.
    """
    waiting: dict[int, T] = {}
    following = 0
    with closing(results):
        try:
            for number, result in results:
                waiting[number] = result
                while following in waiting:
                    yield waiting.pop(following)
                    following += 1
        except KeyboardInterrupt:
            for _, result in sorted(waiting.items(), key=lambda item: item[0]):
                yield result
            raise


def survived(work: Callable[[], T], failed: Callable[[SkinbakeError], T], file: str) -> T:
    """Return the result of ``work``. If an exception ends it, return the result of ``failed``.

    A message names ``file`` if the exception has no place.
    """
    try:
        return work()
    except SkinbakeError as error:
        failure = error
    except MemoryError:
        failure = InputError("it needs more memory than there is or --max-memory allows", Place(file))
    except Exception as error:  # a defect of skinbake must not harm the other files
        import logging  # it takes some milliseconds

        logging.getLogger(__name__).debug("where it failed", exc_info=True)
        failure = defect(error, file)
    return failed(failure)


class _Printable(logging.Formatter):
    """Escape the control characters that a name from a file could send to a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return printable_lines(super().format(record))


def log_to_stderr(level: int) -> None:
    """Print log messages of this level and above, unless logging is configured already."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Printable("%(name)s: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])
