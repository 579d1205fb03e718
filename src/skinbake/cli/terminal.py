"""Text on stdout: verdicts and gains in colour, lines that fit a terminal, and errors of writing it."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import click

from skinbake.errors import Place, not_written

COLOURS = {"passed": "green", "FAILED": "red", "failed": "red"}
VERDICT = re.compile(r"(: |\n  \w+ +)(passed|FAILED|failed)\b")
"""The verdict after the name of a file, and after the name of a check."""

GAIN = re.compile(r"(?:\n  |, )(?:LBS|DQS) gain .*")
FACTOR = re.compile(r"(\d+\.\d+)x")
WORD = re.compile(r"[ \t]*[^ \t]+")
CONTINUED = 4
"""The spaces by which the rest of a line stands further in."""


@contextmanager
def stdout_told() -> Iterator[None]:
    """Raise OutputError if stdout cannot take the help that click prints. A reader may leave, though."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise not_written(error.strerror, Place("<stdout>")) from error


def with_colours(verdict: str) -> str:
    """Return the text of a verdict with colours: green for passed and gains, red for failed and losses."""
    coloured = VERDICT.sub(lambda found: found[1] + click.style(found[2], fg=COLOURS[found[2]]), verdict)

    def factor(found: re.Match[str]) -> str:
        return click.style(found[0], fg="green" if float(found[1]) >= 1.0 else "red")

    return GAIN.sub(lambda line: FACTOR.sub(factor, line[0]), coloured)


def fitted(text: str, width: int | None) -> str:
    """Return text whose lines are broken between words to fit a width. Words, as paths, stay whole."""
    if width is None:
        return text
    return "\n".join(_broken(line, width) for line in text.split("\n"))


def _broken(line: str, width: int) -> str:
    if len(click.unstyle(line)) <= width:
        return line
    indent = " " * (len(line) - len(line.lstrip(" ")) + CONTINUED)
    lines = [""]
    for word in WORD.findall(line):
        if lines[-1].strip() and len(click.unstyle(lines[-1] + word)) > width:
            lines.append(indent + word.lstrip())
        else:
            lines[-1] += word
    return "\n".join(lines)


def width_of(*, err: bool) -> int | None:
    """Return the width of the terminal behind stdout or stderr, or None if there is none or it is unknown."""
    stream = sys.stderr if err else sys.stdout
    try:
        if not stream.isatty():
            return None
        return int(os.environ.get("COLUMNS") or 0) or os.get_terminal_size(stream.fileno()).columns or None
    except (OSError, ValueError, AttributeError):
        return None
