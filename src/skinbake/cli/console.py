"""The output for a person: results on stdout, messages on stderr, colour if it is wanted."""

from __future__ import annotations

import errno
import json
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import click

from skinbake.cli import exit_codes
from skinbake.cli.terminal import fitted, width_of, with_colours
from skinbake.errors import (
    ChoiceError,
    Notice,
    Place,
    ReaderGoneError,
    SkinbakeError,
    not_written,
    printable,
    printable_lines,
)

ALIKE = 3
"""The number of warnings of a file that are printed in full if they differ by numbers alone."""

NUMBER = re.compile(r"\d[\d.,]*(?:e[+-]?\d+)?")

NOT_ASCII = re.compile("[^\\x00-\\x7e]")


class Console(NamedTuple):
    """The amount of output. Verbosity −1 prints only errors, 0 warnings and results too, 1 also details."""

    verbosity: int
    color: bool | None
    results_on_stderr: bool = False

    def result(self, line: str) -> None:
        """Print a line of the result."""
        if self.verbosity >= 0:
            self._fitted(printable_lines(line), err=self.results_on_stderr)

    def verdict(self, text: str) -> None:
        """Print the lines of a verdict, with colours on a terminal."""
        if self.verbosity >= 0:
            self._fitted(with_colours(printable_lines(text)), err=self.results_on_stderr)

    def written(self, line: str) -> None:
        """Print the line on a file that was to be written. It may be lost: the file is the result."""
        if self.results_on_stderr or sys.stdout is not None:
            self.verdict(line)

    def document(self, content: Any) -> None:
        """Print a JSON document at any verbosity, because it is the result that scripts asked for."""
        text = json_text(content, indent=2)
        try:
            text.encode(sys.stdout.encoding or "utf-8")
        except (UnicodeEncodeError, AttributeError):  # stdout's encoding cannot represent it
            text = json.dumps(content, indent=2)
        _echo(text, err=False, color=self.color)

    def notices(self, notices: Iterable[Notice]) -> None:
        """Print warnings and advice: many that are alike in one line, but with -v each by itself."""
        if self.verbosity >= 0:
            for notice, text in (
                ((one, str(one)) for one in notices) if self.verbosity else without_repeats(notices)
            ):
                self._message(*(("note", "cyan") if notice.is_advice else ("warning", "yellow")), text)

    def details(self, lines: Iterable[str]) -> None:
        """Print the details that only -v shows."""
        if self.verbosity > 0:
            for line in lines:
                self._fitted(printable_lines(line), err=True)

    def note(self, line: str) -> None:
        """Print a remark on stderr."""
        if self.verbosity >= 0:
            self._fitted(printable_lines(line), err=True)

    def listing(self, lines: Iterable[str]) -> None:
        """Print lines on stderr at any verbosity."""
        for line in lines:
            self._fitted(printable_lines(line), err=True)

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
        self._fitted(f"{styled} {printable(text)}", err=True)

    def _fitted(self, text: str, *, err: bool) -> None:
        _echo(fitted(text, width_of(err=err)), err=err, color=self.color)


def without_repeats(notices: Iterable[Notice]) -> Iterator[tuple[Notice, str]]:
    """Yield each notice and its text, but one text for many that are alike: a file may have 84 meshes.

    Notices on data of a file are alike if they differ in places and numbers alone. The text stands for them
    where the first of them is.
    """
    groups: dict[object, list[Notice]] = {}
    keyed: list[tuple[object, Notice]] = []
    for notice in notices:
        alike = notice.place.file, notice.code, NUMBER.sub("#", notice.message)
        key: object = len(keyed) if notice.place.mesh is None else alike
        groups.setdefault(key, []).append(notice)
        keyed.append((key, notice))
    told: set[object] = set()
    for key, notice in keyed:
        group = groups[key]
        if len(group) <= ALIKE:
            yield notice, str(notice)
        elif key not in told:
            told.add(key)
            named = "; ".join(other.place.within_file for other in group[1:ALIKE])
            yield notice, f"{notice} ({len(group) - 1:,} more are alike: {named}; -v shows all)"


def json_text(content: Any, *, indent: int | None = None) -> str:
    """Return JSON with letters as they are, and with escapes for characters that control a terminal."""
    text = json.dumps(content, indent=indent, ensure_ascii=False)
    return NOT_ASCII.sub(
        lambda found: found[0] if found[0].isprintable() else json.dumps(found[0])[1:-1], text
    )


def _echo(text: str, *, err: bool, color: bool | None) -> None:
    """Print a line. Raises OutputError if the stream cannot take it, unless its reader has left."""
    if not err and sys.stdout is None:  # ``>&-``: click prints nothing then, and says nothing of it
        raise not_written("it is closed", Place("<stdout>"))
    try:
        click.echo(text, err=err, color=color)
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise SystemExit(exit_codes.READER_GONE) from error
        raise not_written(error.strerror, Place("<stdout>")) from error


@contextmanager
def ended_by_errors(say: Console) -> Iterator[None]:
    """Print an error of the block, and end with its exit code. Errors about options leave it."""
    try:
        yield
    except ChoiceError:
        raise
    except SkinbakeError as error:
        say.error(error)
        sys.exit(exit_codes.of_error(error))


def console(*, verbose: int, quiet: bool, color: str, results_on_stderr: bool = False) -> Console:
    """Return the console for the message options, and set up logging to match."""
    import os

    chosen = {"always": True, "never": False, "auto": False if os.environ.get("NO_COLOR") else None}[color]
    if verbose and not quiet:
        import logging  # it takes some milliseconds

        from skinbake.jobs.work import log_to_stderr

        log_to_stderr(logging.DEBUG if verbose > 1 else logging.INFO)
    return Console(-1 if quiet else verbose, chosen, results_on_stderr)
