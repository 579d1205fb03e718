"""The output for a person: results on stdout, messages on stderr, colour if it is wanted."""

from __future__ import annotations

import errno
import json
import math
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar

import click

from skinbake.cli import exit_codes
from skinbake.errors import (
    Notice,
    OutputError,
    Place,
    ReaderGoneError,
    SkinbakeError,
    printable,
    printable_lines,
)

NOT_ASCII = re.compile("[^\\x00-\\x7e]")

Command = TypeVar("Command", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class Console:
    """The amount of output. Verbosity −1 prints only errors, 0 warnings and results too, 1 also details."""

    verbosity: int
    color: bool | None
    results_on_stderr: bool = False

    def result(self, line: str) -> None:
        """Print a line of the result."""
        if self.verbosity >= 0:
            _echo(printable_lines(line), err=self.results_on_stderr, color=self.color)

    def document(self, content: Any) -> None:
        """Print a JSON document at any verbosity, because it is the result that scripts asked for."""
        text = json_text(content, indent=2)
        if not _encodable(text):
            text = json.dumps(content, indent=2)
        _echo(text, err=False, color=self.color)

    def notices(self, notices: Iterable[Notice]) -> None:
        """Print warnings."""
        if self.verbosity >= 0:
            for notice in notices:
                self._message("warning", "yellow", str(notice))

    def details(self, lines: Iterable[str]) -> None:
        """Print the details that only -v shows."""
        if self.verbosity > 0:
            for line in lines:
                _echo(printable_lines(line), err=True, color=self.color)

    def note(self, line: str) -> None:
        """Print a remark on stderr."""
        if self.verbosity >= 0:
            _echo(printable_lines(line), err=True, color=self.color)

    def listing(self, lines: Iterable[str]) -> None:
        """Print lines on stderr at any verbosity."""
        for line in lines:
            _echo(printable_lines(line), err=True, color=self.color)

    def problems(self, problems: Iterable[Notice]) -> None:
        """Print the errors that a check found, at any verbosity."""
        for problem in problems:
            self._message("error", "red", str(problem))

    def error(self, error: SkinbakeError) -> None:
        """Print an error. If the error is that the reader of stdout has left, end the program."""
        if isinstance(error, ReaderGoneError):
            raise SystemExit(exit_codes.READER_GONE)
        self._message("error", "red", str(error))

    def _message(self, kind: str, color: str, text: str) -> None:
        styled = click.style(f"{kind}:", fg=color, bold=True)
        _echo(f"{styled} {printable(text)}", err=True, color=self.color)


def json_text(content: Any, *, indent: int | None = None) -> str:
    """Return JSON with letters as they are, and with escapes for characters that control a terminal."""
    text = json.dumps(content, indent=indent, ensure_ascii=False)
    return NOT_ASCII.sub(
        lambda found: found[0] if found[0].isprintable() else json.dumps(found[0])[1:-1], text
    )


def _encodable(text: str) -> bool:
    """Tell whether stdout's encoding can represent the text."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except (UnicodeEncodeError, AttributeError):
        return False
    return True


def _echo(text: str, *, err: bool, color: bool | None) -> None:
    """Print a line. Raises OutputError if the stream cannot take it, unless its reader has left."""
    try:
        click.echo(text, err=err, color=color)
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise SystemExit(exit_codes.READER_GONE) from error
        raise OutputError(f"cannot be written: {error.strerror}", Place("<stdout>")) from error


def finite(ctx: click.Context, param: click.Parameter, value: float | None) -> float | None:
    """Refuse NaN, which all ranges of click accept."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter("must be a finite number")
    return value


def one_of(choices: type[StrEnum]) -> click.Choice[str]:
    """Return the type of an option whose values are the members of an enumeration."""
    return click.Choice([choice.value for choice in choices])


def message_options(command: Command) -> Command:
    """Add the options for the amount of output: -v, -q, --color."""
    for option in (
        click.option(
            "--color",
            type=click.Choice(["auto", "always", "never"]),
            default="auto",
            help="Colour of messages; auto uses colours on a terminal if NO_COLOR is not set.",
        ),
        click.option("-q", "--quiet", is_flag=True, help="Print errors only."),
        click.option("-v", "--verbose", count=True, help="Print more; give it twice for debugging."),
    ):
        command = option(command)
    return command


def outside_option(command: Command) -> Command:
    """Add the option for further folders that may hold files of a document."""
    return click.option(
        "--allow-outside",
        metavar="DIR",
        multiple=True,
        help="Also read files of this folder that a document names. Without it, only files in the "
        "document's own folder, or in the folder given as INPUT, are read. May be given several "
        "times.",
    )(command)


def console(*, verbose: int, quiet: bool, color: str, results_on_stderr: bool = False) -> Console:
    """Return the console for the message options, and set up logging to match."""
    import os

    chosen = {"always": True, "never": False, "auto": False if os.environ.get("NO_COLOR") else None}[color]
    if verbose:
        import logging  # it takes some milliseconds

        from skinbake.jobs.logs import log_to_stderr

        log_to_stderr(logging.DEBUG if verbose > 1 else logging.INFO)
    return Console(-1 if quiet else verbose, chosen, results_on_stderr)
