"""What ``bake`` and ``verify`` have in common: many files, in several processes, told of as they are done."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import Command, Console, json_text
from skinbake.cli.progress import Progress
from skinbake.cli.targets import STDIO, sync_option
from skinbake.containment import flush
from skinbake.errors import OutputError, Place, SkinbakeError
from skinbake.urls import is_url

if TYPE_CHECKING:
    from skinbake.cli.inputs import Input
    from skinbake.jobs.processes import Limits
    from skinbake.jobs.runners import Runner, Work
    from skinbake.jobs.state import Recipe, State
    from skinbake.report.totals import Totals

STATE_NAME = ".skinbake-state.jsonl"

MANY = 20
"""Files whose lines one still takes in at a glance; of more a line tells the sum."""

SECONDS_A_URL = 0.1
"""What it takes to fetch and store a file, about."""

WORTHWHILE = 0.5
"""Seconds of work from which on other processes are started for it."""


def _jobs(ctx: click.Context, param: click.Parameter, value: str) -> int:
    if value == "auto":
        return 0
    if not value.isdecimal():
        raise click.BadParameter("must be a number of processes, 0 or auto")
    return int(value)


def many_options(command: Command) -> Command:
    """Add the options for many files."""
    for option in (
        click.option(
            "--timings", is_flag=True, help="Say where the time goes, by stage; in --json and --summary too."
        ),
        click.option(
            "--summary",
            metavar="FILE",
            help="Also write JSON lines: each file's result as soon as it is there, totals at the end.",
        ),
        click.option(
            "--state",
            metavar="FILE",
            help=f"Where --skip-unchanged keeps its notes; in --out-dir: {STATE_NAME}.",
        ),
        click.option(
            "--skip-unchanged",
            is_flag=True,
            help="Pass over files whose input, options and output are what they were, by digest.",
        ),
        click.option(
            "-j",
            "--jobs",
            default="1",
            show_default=True,
            callback=_jobs,
            metavar="N",
            help="Processes to work in; 0 or auto: one for each usable core.",
        ),
    ):
        command = option(command)
    return sync_option(command)


def state_of(
    command: str, options: Any, path: str | None, inputs: Iterable[Input], *, sync: bool
) -> tuple[State, Recipe] | tuple[None, None]:
    """Return the state file, and what its records are compared with; None where none is wanted."""
    if path is None:
        return None, None
    from skinbake.jobs.state import State, recipe

    roots = {entry.root for entry in inputs if os.sep in entry.kept}  # that arguments were searched in
    return State(path, sync=sync), recipe(command, options, path, sorted(roots))


def state_path(given: Mapping[str, Any]) -> str | None:
    """Return where the state file is, None where none is wanted; click.UsageError where it has no place."""
    if not given["skip_unchanged"]:
        if given["state"]:
            raise click.UsageError("--state is for --skip-unchanged")
        return None
    if given["state"]:
        return str(given["state"])
    if given.get("out_dir"):
        return str(Path(given["out_dir"], STATE_NAME))
    raise click.UsageError(
        "--skip-unchanged needs --state FILE to keep its notes in; only --out-dir has a place"
    )


class Clock:
    """How long the process has run, and what it spent before its work began."""

    def __init__(self) -> None:
        self._begun = self._imported = time.perf_counter()

    def imports_done(self) -> None:
        """Note that all that is imported late has been."""
        self._imported = time.perf_counter()

    @property
    def working(self) -> float:
        """Seconds since the imports."""
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
    """Return the process's age in seconds, to 0.01 s; None where the system does not tell it cheaply."""
    try:
        fields = (
            Path("/proc/self/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        )
        return time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def chosen_runner(
    given: Mapping[str, Any],
    sources: Sequence[str],
    turns: Sequence[int],
    modules: Sequence[str],
    guess: tuple[float, float],
    limits: Limits | None = None,
) -> Runner:
    """Return who does the work on the sources.

    ``turns`` are the numbers of those that must be done in order, ``modules`` what workers need, ``guess``
    how long a file takes and each byte of it. With ``limits`` a file too has a process that keeps them.
    """
    from skinbake.jobs.runners import FirstThese, InThisProcess

    count = given["jobs"]
    alone = count == 1 or len(sources) == 1 or STDIO in sources
    if limits is None and (alone or not _is_worthwhile(sources, guess)):
        return InThisProcess()
    from skinbake.jobs.processes import Limits, Processes, usable_cores

    limits = limits or Limits()
    whole = Processes(count or usable_cores(), modules, limits)
    return FirstThese(turns, Processes(1, modules, limits), whole) if turns else whole


def _is_worthwhile(sources: Sequence[str], guess: tuple[float, float]) -> bool:
    """Tell whether the work is enough to start processes for."""
    seconds = 0.0
    for source in sources:
        try:
            seconds += guess[0] + guess[1] * Path(source).stat().st_size
        except (OSError, ValueError):
            seconds += SECONDS_A_URL if is_url(source) else 0.0
        if seconds > WORTHWHILE:
            return True
    return False


class Summary:
    """Writes JSON lines, one a file, and totals at last; says once where it cannot."""

    def __init__(self, path: str | None, schema: str, say: Console, *, sync: bool = True) -> None:
        """Begin the file; raises OutputError. ``sync`` waits until it is on the disk when it is closed."""
        self._path, self._schema, self._say, self._sync = path, schema, say, sync
        self.failed = False
        self._file = None
        if path is not None:
            try:
                self._file = Path(path).open("w", encoding="utf-8", newline="\n")  # noqa: SIM115
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise OutputError(f"cannot be written: {reason}", Place(path)) from error

    def file(self, content: Mapping[str, Any]) -> None:
        """Add a file's line."""
        self.line({"schema": self._schema, "kind": "file", **content})

    def line(self, content: Mapping[str, Any]) -> None:
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
        with suppress(OSError):
            if file is not None:
                file.close()
        self._say.error(OutputError(f"cannot be written: {error.strerror}", Place(str(self._path))))

    def close(self) -> None:
        """Let go of the file."""
        if self._file is None:
            return
        try:
            if self._sync:
                flush(self._file.fileno())
            self._file.close()
        except OSError as error:
            self._fail(error)


class Notes:
    """What --skip-unchanged keeps; says once where it cannot."""

    def __init__(self, state: State | None, say: Console) -> None:
        self._state, self._say = state, say
        self.failed = False

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
        """Let go of the state file."""
        if self._state is not None:
            self._state.close()


@contextmanager
def outcomes(
    say: Console,
    totals: Totals,
    clock: Clock,
    kept: Sequence[Summary | Notes],
    begin: Callable[[Progress], Generator[Any, None, None]],
) -> Iterator[Iterator[Any]]:
    """Yield the results that ``begin`` gives, and when they are done with, or an interrupt came, end it all.

    That ends the work, takes the bar away, says what became of all files, and lets go of what is kept.
    """
    from skinbake.report.totals import closing_line, failure_lines

    with ExitStack() as stack:
        for one in kept:
            stack.enter_context(closing(one))
        try:
            with Progress(say) as progress, closing(begin(progress)) as results:
                yield results
        except KeyboardInterrupt:
            if totals.files > 1:
                say.note(closing_line(totals, clock.working, interrupted=True))
            raise
    say.listing(failure_lines(totals))
    if totals.files > MANY or len(totals.failures) > 1 or (totals.files > 1 and say.verbosity > 0):
        say.note(closing_line(totals, clock.working))


def each(
    runner: Runner, work: Work, jobs: Sequence[Any], progress: Progress, tell: Callable[[Any], None]
) -> Generator[Any, None, None]:
    """Yield the results in order as they come, each told of above the bar; close it to end the work."""
    from skinbake.jobs.runners import in_order

    with closing(in_order(runner.run(work, jobs))) as results:
        for number, result in enumerate(results, 1):
            progress.print(lambda result=result: tell(result))  # type: ignore[misc]
            yield result
            if len(jobs) > 1:
                progress.step("files", number, len(jobs))


def worst(code: int, error: SkinbakeError) -> int:
    """Return the worse of a code and an error's."""
    return max(code, exit_codes.of_error(error))


def show_timings(say: Console, totals: Totals, clock: Clock) -> None:
    """Print where the time went, to stderr, whatever the verbosity: it was asked for."""
    from skinbake.report.totals import timing_lines

    say.listing(timing_lines(totals, clock.process()))
