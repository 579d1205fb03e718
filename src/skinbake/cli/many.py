"""The common part of commands for many files: several processes, and results reported as they are done."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from skinbake.cli import exit_codes
from skinbake.cli.console import Console, json_text
from skinbake.cli.limits import memory_of_each
from skinbake.cli.progress import Progress
from skinbake.cli.runners import LONG, runner_of, seconds_of, threads_of_each
from skinbake.cli.writing import tell_of_report
from skinbake.errors import ChoiceError, Chosen, OutputError, Place
from skinbake.files.folders import flush
from skinbake.options import STATE_NAME
from skinbake.timing import heard

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from skinbake.cli.given import Given
    from skinbake.cli.inputs import Input
    from skinbake.jobs.file_work import FileCommand
    from skinbake.jobs.state import Recipe, State
    from skinbake.jobs.work import Job, Result, Runner, Work
    from skinbake.report.totals import Totals

FEW = 5
"""The number of files whose lines tell enough. If there are more, a last line has the totals."""

ResultT = TypeVar("ResultT", bound="Result")
ResultT_contra = TypeVar("ResultT_contra", bound="Result", contravariant=True)


def state_path(given: Given) -> str | None:
    """Return the path of the state file, None if unwanted. Raises ChoiceError if it has no place."""
    if not given["skip_unchanged"]:
        if given["state"] and not given.get("sources"):
            raise ChoiceError("state", reason=(" is for ", Chosen("skip_unchanged")))
        return None
    if given["state"]:
        return given["state"]
    out_dir = given.get("out_dir")
    if out_dir:
        return str(Path(out_dir, STATE_NAME))
    instead = "; with --out-dir it needs none" if "out_dir" in given else ""
    raise ChoiceError(
        "skip_unchanged", reason=(" needs ", Chosen("state"), f" FILE, to keep its notes in{instead}")
    )


class Clock:
    """The time that the process has run, and the time before its work began."""

    def __init__(self) -> None:
        self._begun = self._imported = time.perf_counter()

    def imports_done(self) -> None:
        """Note that all late imports are done."""
        self._imported = time.perf_counter()

    @property
    def working(self) -> float:
        """Return the seconds since the imports."""
        return time.perf_counter() - self._imported

    def process(self) -> dict[str, float | None]:
        """Return the seconds of the process: before the command began, of its imports, and until now."""
        age, command = _age(), time.perf_counter() - self._begun
        return {
            "start_up": None if age is None else max(0.0, age - command),
            "imports": self._imported - self._begun,
            "elapsed": command if age is None else max(age, command),
        }


def _age() -> float | None:
    """Return the process's age in seconds, to 0.01 s, or None if the system does not tell it quickly."""
    try:
        fields = (
            Path("/proc/self/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        )
        return time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


class Summary:
    """Write JSON lines, one a file, and the totals at the end. Report once if writing fails."""

    def __init__(self, path: str | None, schema: str, say: Console, *, sync: bool = True) -> None:
        """Begin the file, in folders that are made. Raises OutputError.

        With ``sync``, closing it waits until it is on the disk.
        """
        self._path, self._schema, self._say, self._sync = path, schema, say, sync
        self.failed = False
        self._file = None
        if path is not None:
            try:
                if not Path(path).parent.exists():
                    Path(path).parent.mkdir(parents=True, exist_ok=True)
                self._file = Path(path).open("w", encoding="utf-8", newline="\n")  # noqa: SIM115  # close() closes it
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise OutputError(f"cannot be written: {reason}", Place(path)) from error

    def file(self, content: Mapping[str, object]) -> None:
        """Add a file's line."""
        self.line({"schema": self._schema, "kind": "file", **content})

    def line(self, content: Mapping[str, object]) -> None:
        """Add a line."""
        if self._file is None:
            return
        try:
            self._file.write(json_text(content) + "\n")
            self._file.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failed, file, self._file = True, self._file, None
        with suppress(OSError):  # closing writes again what could not be written
            if file is not None:
                file.close()
        self._say.error(OutputError(f"cannot be written: {error.strerror}", Place(str(self._path))))

    def close(self) -> None:
        """Close the file."""
        if self._file is None:
            return
        try:
            if self._sync:
                flush(self._file.fileno())
            self._file.close()
        except OSError as error:
            self._fail(error)


class Notes:
    """The records of --skip-unchanged, if it was given. A failure to write is reported once."""

    def __init__(self, say: Console, state: State | None = None, recipes: Sequence[Recipe] = ()) -> None:
        self._say, self._state, self.recipes = say, state, recipes
        self.failed = False

    def known(self, path: str) -> bytes | None:
        """Return the record of the file that is made, or read, at a path, or None if there is none."""
        return None if self._state is None else self._state.known(self.recipes[0].key(path))

    def add(self, record: bytes | None) -> None:
        """Keep a record."""
        if record is None or self._state is None:
            return
        try:
            self._state.add(record)
        except OutputError as error:
            self.failed, self._state = True, None
            self._say.error(error)

    def close(self) -> None:
        """Close the state file."""
        if self._state is not None:
            self._state.close()


def notes_of(
    command: str,
    options: Sequence[DataclassInstance],
    path: str | None,
    inputs: Iterable[Input],
    say: Console,
    *,
    sync: bool,
) -> Notes:
    """Return the notes in the state file at ``path``, and warn if it holds something else.

    They have a recipe for each set of options.
    If it is not a state file, or for None, the notes are empty and no record is kept. Raises InputError if
    the system cannot read the file.
    """
    if path is None:
        return Notes(say)
    from skinbake.jobs.state import State, recipe

    state = State(path, sync=sync)
    say.notices(state.notices)
    if not state.is_ours:
        return Notes(say)
    roots = {entry.root for entry in inputs if os.sep in entry.kept}  # the folders that were searched
    first = recipe(command, options[0], path, sorted(roots))
    return Notes(say, state, [first, *map(first.with_options, options[1:])])


@dataclass(frozen=True, slots=True)
class Run(Generic[ResultT]):
    """The jobs of a command, their runner, the work, and the seconds that it takes, approximately."""

    jobs: Sequence[Job]
    runner: Runner[Job, ResultT]
    work: Work[Job, ResultT]
    seconds: float


def run_of(
    commands: Sequence[FileCommand[ResultT]],
    jobs: Sequence[Job],
    given: Given,
    say: Console,
    notes: Notes,
    turns: Sequence[int] = (),
) -> Run[ResultT]:
    """Return the run of a command on jobs, as the options ask for. Parameters are as for ``runner_of``.

    ``commands`` are those of each set of options, in the order of the jobs' ``variant``.
    Raises ChoiceError for options that do not go together, and InputError if a cluster cannot be used.
    """
    from skinbake.jobs.file_work import ByVariant, FileWork

    sources, guess = [job.source for job in jobs], commands[0].seconds
    modules = ("skinbake.cli.main", type(commands[0]).__module__, "skinbake.jobs.file_work")
    runner: Runner[Job, ResultT] = runner_of(given, sources, turns, modules, guess, say)
    memory, threads = memory_of_each(given, sources), threads_of_each(given, sources)
    recipes: Sequence[Recipe | None] = notes.recipes or [None] * len(commands)
    works = [
        FileWork(command, recipe, given["timings"], memory, threads)
        for command, recipe in zip(commands, recipes, strict=True)
    ]
    work = works[0] if len(works) == 1 else ByVariant(tuple(works))
    return Run(jobs, runner, work, seconds_of(sources, guess))


class ResultsJson(Protocol[ResultT_contra]):
    """Make the JSON object of a run."""

    def __call__(
        self,
        results: Sequence[ResultT_contra],
        /,
        *,
        exit_code: int,
        process: Mapping[str, float | None] | None,
    ) -> Mapping[str, object] | None:
        """Return the object of all results. ``process`` has the seconds of the process, if requested.

        None if there is nothing to print.
        """


def of_one(
    one_json: Callable[[ResultT, Mapping[str, float | None] | None], Mapping[str, object] | None],
) -> ResultsJson[ResultT]:
    """Return the function for a run on a single file, which has its own schema, without the exit code."""

    def document(
        results: Sequence[ResultT], /, *, exit_code: int, process: Mapping[str, float | None] | None
    ) -> Mapping[str, object] | None:
        return one_json(results[0], process)

    return document


@dataclass(frozen=True, slots=True)
class Reporting(Generic[ResultT]):
    """How a command's results are reported, counted and written, and the exit code of each.

    outcomes are the kinds by which files are counted. document makes the JSON of all results. If write is
    given, it writes another report of all results and returns its exit code.
    """

    schema: str
    outcomes: tuple[str, ...]
    tell: Callable[[ResultT], None]
    count: Callable[[Totals, ResultT], None]
    code: Callable[[ResultT], int]
    file_json: Callable[[ResultT], Mapping[str, object]]
    document: ResultsJson[ResultT]
    write: Callable[[Sequence[ResultT]], int] | None = None


def work_through(
    run: Run[ResultT], reporting: Reporting[ResultT], given: Given, say: Console, clock: Clock, notes: Notes
) -> int:
    """Do all jobs, report each result as it comes and all at the end, and return the exit code."""
    from skinbake.report.totals import Totals, timing_lines, totals_json

    totals, results, code = Totals(len(run.jobs), reporting.outcomes), list[ResultT](), exit_codes.OK
    summary = Summary(given["summary"], reporting.schema, say, sync=not given["no_sync"])
    with _outcomes(run, reporting.tell, say, totals, clock, [summary, notes]) as found:
        for result in found:
            notes.add(result.record)
            summary.file(reporting.file_json(result))
            reporting.count(totals, result)
            code = max(code, reporting.code(result))
            if given["as_json"] or reporting.write:
                results.append(result)
        if reporting.write:
            code = max(code, reporting.write(results))
        code = max(code, exit_codes.OUTPUT if notes.failed else code)
        summary.line(totals_json(totals, clock.working, schema=reporting.schema, exit_code=code))
    code = max(code, exit_codes.OUTPUT if summary.failed else code)
    if given["summary"] and not summary.failed:
        tell_of_report(given["summary"], given, say)
    if given["timings"]:  # at any verbosity, because it was asked for
        say.listing(timing_lines(totals, clock.process()))
    if given["as_json"]:
        spent = clock.process() if given["timings"] else None
        content = reporting.document(results, exit_code=code, process=spent)
        if content is not None:
            say.document(content)
    return code


@contextmanager
def _outcomes(
    run: Run[ResultT],
    tell: Callable[[ResultT], None],
    say: Console,
    totals: Totals,
    clock: Clock,
    kept: Sequence[Summary | Notes],
) -> Iterator[Iterator[ResultT]]:
    """Yield the results. After the last one, or after an interrupt, close everything.

    Closing ends the work, removes the bar, reports the outcome of all files, and closes the kept files.
    """
    from skinbake.report.totals import closing_line, failure_lines, lowest_lines

    with ExitStack() as stack:
        for one in kept:
            stack.enter_context(closing(one))
        try:
            progress = Progress(say, len(run.jobs), at_once=run.seconds > LONG)
            with progress, heard(progress.hear), closing(_told(run, tell, progress)) as results:
                yield results
        except KeyboardInterrupt:
            if totals.files > 1:
                say.note(closing_line(totals, clock.working, interrupted=True))
            raise
    for line in failure_lines(totals):
        say.note(line)
    if totals.files > FEW or len(totals.failures) > 1 or (totals.files > 1 and say.verbosity > 0):
        for line in lowest_lines(totals):
            say.note(line)
        say.note(closing_line(totals, clock.working))


def _told(
    run: Run[ResultT], tell: Callable[[ResultT], None], progress: Progress
) -> Generator[ResultT, None, None]:
    """Yield the results in order as they come, each reported above the bar. Closing it ends the work.

    After the last one no bar is shown: what is written of all results is reported below them.
    """
    from skinbake.jobs.runners import in_order

    with closing(in_order(_counted(run, progress))) as results:
        for _, result in zip(run.jobs, results, strict=True):
            progress.print(partial(tell, result))
            yield result
    progress.pause()


def _counted(run: Run[ResultT], progress: Progress) -> Generator[tuple[int, ResultT], None, None]:
    """Yield the number and the result of each job as it is done, in any order. Closing it ends the work."""
    with closing(run.runner.run(run.work, run.jobs)) as results:
        for number, result in results:
            progress.finish(run.jobs[number].source)
            yield number, result
