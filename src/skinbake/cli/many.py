"""The common part of commands for many files: several processes, and results reported as they are done."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from skinbake.cli import exit_codes
from skinbake.cli.console import json_text
from skinbake.cli.plan import Plan
from skinbake.cli.progress import Progress
from skinbake.cli.runners import LONG, memory_of_each, runner_of, seconds_of, threads_of_each
from skinbake.errors import OutputError, Place, not_written, printable
from skinbake.files.bounds import Within
from skinbake.files.folders import flush
from skinbake.timing import heard

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from skinbake.jobs.file_work import FileCommand
    from skinbake.jobs.state import Recipe, State
    from skinbake.jobs.work import Job, Result, Runner
    from skinbake.report.totals import Totals

FEW = 5
"""The number of files whose lines tell enough. If there are more, a last line has the totals."""

ResultT = TypeVar("ResultT", bound="Result")


class Clock:
    """The time that the process has run, and the time before its work began, with all late imports done."""

    def __init__(self, begun: float) -> None:
        """Take the time at which the command began. The work begins now."""
        self._begun, self._imported = begun, time.perf_counter()

    @property
    def working(self) -> float:
        """Return the seconds since the imports."""
        return time.perf_counter() - self._imported

    def process(self) -> dict[str, float | None]:
        """Return the seconds of the process: before the command began, of its imports, and until now."""
        age, command = None, time.perf_counter() - self._begun
        # The process's age to 0.01 s, if the system tells it quickly.
        with suppress(OSError, ValueError, IndexError, AttributeError):
            text = Path("/proc/self/stat").read_text(encoding="ascii", errors="replace")
            begun = int(text.rpartition(")")[2].split()[19]) / os.sysconf("SC_CLK_TCK")
            age = time.clock_gettime(time.CLOCK_BOOTTIME) - begun
        return {
            "start_up": None if age is None else max(0.0, age - command),
            "imports": self._imported - self._begun,
            "elapsed": command if age is None else max(age, command),
        }


class Summary:
    """Write JSON lines, one a file, and the totals at the end. Report once if writing fails."""

    def __init__(self, plan: Plan[Any]) -> None:
        """Begin the file, in folders that are made. Raises OutputError.

        Unless --no-sync is given, closing it waits until it is on the disk.
        """
        self._plan, self.failed = plan, False
        self._file = None
        if plan.summary is not None:
            path = Path(plan.summary)
            try:
                if not path.parent.exists():
                    path.parent.mkdir(parents=True, exist_ok=True)
                self._file = path.open("w", encoding="utf-8", newline="\n")
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise not_written(reason, Place(plan.summary)) from error

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
        self._plan.say.error(not_written(error.strerror, Place(str(self._plan.summary))))

    def close(self) -> None:
        """Close the file."""
        if self._file is None:
            return
        try:
            if not self._plan.no_sync:
                flush(self._file.fileno())
            self._file.close()
        except OSError as error:
            self._fail(error)


class Notes:
    """The records of --skip-unchanged, if it was given. A failure to write is reported once.

    ``recipes`` has one for each set of options. If the file is not a state file, it says so once, and keeps
    no record.
    """

    def __init__(self, plan: Plan[Any], options: Sequence[DataclassInstance]) -> None:
        """Read the state file. Raises InputError if the system cannot read it."""
        self._say = plan.say
        self._state: State | None = None
        self.recipes: Sequence[Recipe] = ()
        self.failed = False
        if plan.notes_at is None or not options:
            return
        from skinbake.jobs.state import State, recipe

        state = State(plan.notes_at, sync=not plan.no_sync)
        self._say.notices(state.notices)
        if state.is_ours:
            roots = {entry.root for entry in plan.inputs if os.sep in entry.kept}  # the folders searched
            first = recipe(plan.command, options[0], plan.notes_at, sorted(roots))
            self._state, self.recipes = state, [first, *map(first.with_options, options[1:])]

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


def code_of(result: Result) -> int:
    """Return the exit code for the result of a file."""
    return exit_codes.of_error(result.error)


@dataclass(frozen=True, slots=True)
class Reporting(Generic[ResultT]):
    """How a command's results are reported, counted and written, and the exit code of each.

    outcomes are the kinds by which files are counted, by their status unless ``count`` does it. The JSON of
    all results has that of each file, and ``chosen``, options of the run. A run on a single file may have the
    JSON that ``alone`` makes of its result in place of it, of another schema, and nothing if it failed. If
    write is given, it writes another report of all results and returns its exit code.
    """

    schema: str
    outcomes: tuple[str, ...]
    tell: Callable[[ResultT], None]
    file_json: Callable[[ResultT], Mapping[str, Any]]
    alone: Callable[[ResultT], dict[str, Any]] | None = None
    chosen: Mapping[str, Any] = field(default_factory=dict)
    write: Callable[[Sequence[ResultT]], int] | None = None
    count: Callable[[Totals, ResultT], None] | None = None
    code: Callable[[ResultT], int] = code_of

    def document(
        self, results: Sequence[ResultT], *, exit_code: int, process: Mapping[str, float | None] | None
    ) -> Mapping[str, object] | None:
        """Return the JSON of a run, with the seconds of the process, if requested; None for nothing."""
        from skinbake.report.totals import run_json, timing_fields

        if self.alone is None:
            files = map(self.file_json, results)
            return run_json(self.schema, files, exit_code=exit_code, process=process, **self.chosen)
        return None if results[0].error else self.alone(results[0]) | timing_fields(process)


def work_through(
    plan: Plan[Any],
    commands: Sequence[FileCommand[ResultT]],
    reporting: Reporting[ResultT],
    noted: Sequence[DataclassInstance] = (),
) -> int:
    """Do a command on all files of a plan, report each result and all at the end; return the exit code.

    ``commands`` belong to each set of options, in the order of the plan's. ``noted`` are the options, one
    for each set, that decide what is written, for the state file. Raises ChoiceError for options that do not
    go together, and InputError if a cluster or a state file cannot be used.
    """
    from skinbake.jobs.file_work import FileWork
    from skinbake.jobs.work import Job, in_order
    from skinbake.report.totals import (
        Totals,
        closing_line,
        count,
        failure_lines,
        lowest_lines,
        timing_lines,
        totals_json,
    )

    say, guess = plan.say, commands[0].seconds
    notes = Notes(plan, noted)
    jobs = [
        Job(
            entry.source,
            target and target.given,
            notes.known(entry.source if target is None else target.given),
            within=Within(plan.bounds(entry.searched), plan.out_dir),
            variant=plan.variants.get(entry.source, 0),
        )
        if entry.missing is None
        else Job(entry.source, missing=entry.missing, variant=plan.variants.get(entry.source, 0))
        for entry, target in plan.targets
    ]
    clock = Clock(plan.begun)
    runner: Runner[Job, ResultT] = runner_of(plan, type(commands[0]).__module__, guess)
    work = FileWork(
        tuple(commands), tuple(notes.recipes), plan.timings, memory_of_each(plan), threads_of_each(plan)
    )

    totals, results, code = Totals(len(jobs), reporting.outcomes), list[ResultT](), exit_codes.OK
    progress = Progress(say, len(jobs), at_once=seconds_of(plan.names, guess) > LONG)

    def done() -> Generator[tuple[int, ResultT], None, None]:
        """Yield the number and the result of each job as it is done, in any order."""
        with closing(runner.run(work, jobs)) as found:
            for number, result in found:
                progress.finish(jobs[number].source)
                yield number, result

    # After the last result, or an interrupt, the work ends, the bar is removed, and the files are closed.
    with closing(Summary(plan)) as summary, closing(notes):
        try:
            with progress, heard(progress.hear), closing(in_order(done())) as found:
                for _, result in zip(jobs, found, strict=True):
                    progress.print(partial(reporting.tell, result))
                    notes.add(result.record)
                    content = reporting.file_json(result)
                    summary.line({"schema": reporting.schema, "kind": "file", **content})
                    (reporting.count or count)(totals, result)
                    code = max(code, reporting.code(result))
                    if plan.as_json or reporting.write:
                        results.append(result)
                progress.pause()  # what is written of all results is reported below them, without a bar
                if reporting.write:
                    code = max(code, reporting.write(results))
                code = max(code, exit_codes.OUTPUT if notes.failed else code)
                summary.line(totals_json(totals, clock.working, schema=reporting.schema, exit_code=code))
        except KeyboardInterrupt:
            if totals.files > 1:
                say.note(closing_line(totals, clock.working, interrupted=True))
            raise
    last = [*failure_lines(totals)]
    if totals.files > FEW or len(totals.failures) > 1 or (totals.files > 1 and say.verbosity > 0):
        last += [*lowest_lines(totals), closing_line(totals, clock.working)]
    for line in last:
        say.note(line)
    code = max(code, exit_codes.OUTPUT if summary.failed else code)
    if plan.summary and not summary.failed:
        tell_of_report(plan, plan.summary)
    spent = clock.process() if plan.timings else None
    if spent is not None:  # at any verbosity, because it was asked for
        say.listing(timing_lines(totals, spent))
    if plan.as_json and (document := reporting.document(results, exit_code=code, process=spent)) is not None:
        say.document(document)
    return code


def write_report(plan: Plan[Any], path: str, text: str) -> int:
    """Write the file of a report, whole or not at all. Return the exit code."""
    from skinbake.files.writing import write_file

    data, file = text.encode("utf-8", "surrogateescape"), Path(path)
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            file.write_bytes(data)  # for example a pipe
        else:
            write_file([data], path, sync=not plan.no_sync)
    except OSError as error:
        plan.say.error(not_written(error.strerror, Place(path)))
        return exit_codes.OUTPUT
    except OutputError as error:
        plan.say.error(not_written(error.reason, Place(path)))
        return exit_codes.OUTPUT
    return exit_codes.OK


def tell_of_report(plan: Plan[Any], path: str, *, pages: Path | None = None) -> None:
    """Say that a report was written, and where its pages are, unless the result on stdout is JSON."""
    if not plan.as_json:
        where = f", its pages in {printable(str(pages))}" if pages else ""
        plan.say.written(f"{printable(path)}: written{where}")
