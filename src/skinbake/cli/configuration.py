"""The file that sets options: ``skinbake.toml``, or ``[tool.skinbake]`` of ``pyproject.toml``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import IO, Any, NoReturn

import click

from skinbake.cli import exit_codes
from skinbake.cli.names import LARGEST_CONFIG, SHARED_CONFIG
from skinbake.files.folders import open_regular

MOST_TRIES = 100
"""The number of lines that are tried to find the one of a message."""

Keys = tuple[str | int, ...]
"""The names of nested tables, and the numbers of entries of arrays, from the outside in."""


class ConfigurationError(click.ClickException):
    """A configuration file cannot be read, or has a mistake."""

    exit_code = exit_codes.USAGE

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the message without the usage of the command, which is not at fault."""
        click.echo(f"error: {self.message}", file=file, err=file is None)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A configuration file: its name as messages show it, its folder, its text, and its tables.

    ``above`` are the keys of the table that holds the others.
    """

    name: str
    folder: str
    text: str
    above: Keys
    tables: Mapping[str, Any]

    def place(self, keys: Keys) -> str:
        """Return ``skinbake.toml:3`` for the key that begins in line 3, or the name if no line is found."""
        line = _line_of(self.text, (*self.above, *keys))
        return self.name if line is None else f"{self.name}:{line}"

    def refuse(self, keys: Keys, message: str) -> NoReturn:
        """Raise ConfigurationError about a key."""
        raise ConfigurationError(f"{self.place(keys)}: {spelt(keys)}: {message}")

    def table(self, keys: Keys, value: object) -> Mapping[str, Any]:
        """Return the value of a key, which is a table. Raises ConfigurationError if it is none."""
        return value if isinstance(value, dict) else self.refuse(keys, "expected a table")


def spelt(keys: Keys) -> str:
    """Return keys as a person writes them: ``bake.encoding``, ``overrides[0].files``."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


def read_configuration(path: str) -> Configuration | None:
    """Return the configuration in a file, or None for a pyproject.toml without one.

    Raises ConfigurationError if it cannot be read or is not TOML.
    """
    data = _content(path)
    import tomllib

    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path} is no valid TOML: {_fault(error)}") from error
    found = Configuration(path, os.path.realpath(os.path.dirname(path) or os.curdir), text, (), tables)
    if os.path.basename(path) != SHARED_CONFIG:
        return found
    above = ("tool", "skinbake")
    inner = _at(tables, above)
    if inner is None:
        return None
    return Configuration(path, found.folder, text, above, found.table(above, inner))


def _fault(error: Exception) -> str:
    """Return what is wrong with a text that is no TOML, and the usual cause of an invalid value."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not text in UTF-8"
    return f"{error}{'; text stands in quotes' if str(error).startswith('Invalid value') else ''}"


def _content(path: str) -> bytes:
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            data = file.read(LARGEST_CONFIG + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigurationError(f"{path} cannot be read: {reason}") from error
    if len(data) > LARGEST_CONFIG:
        raise ConfigurationError(f"{path} is larger than {LARGEST_CONFIG:,} bytes, too large for options")
    return data


@cache
def _line_of(text: str, keys: Keys) -> int | None:
    """Return the line in which a key begins, counted from 1, or None if it is not found.

    tomllib tells no lines. A key begins in a line if the text before it is valid without the key, and the
    text up to this line, or to a later one for a long value, is valid with the key.
    """
    lines = text.split("\n")
    name = next(key for key in reversed(keys) if isinstance(key, str))
    candidates = (number for number, line in enumerate(lines) if name in line)
    for number in islice(candidates, MOST_TRIES):
        if _has(lines[:number], keys) is False:
            later = (_has(lines[: end + 1], keys) for end in range(number, len(lines))[:MOST_TRIES])
            if next((found for found in later if found is not None), False):
                return number + 1
    return None


def _has(lines: Sequence[str], keys: Keys) -> bool | None:
    """Tell whether a text has a key, or None if the text is no valid TOML."""
    import tomllib

    with suppress(ValueError, RecursionError):
        return _at(tomllib.loads("\n".join(lines)), keys) is not None
    return None


def _at(value: Any, keys: Keys) -> Any:
    """Return the value of nested keys, or None if there is none."""
    for key in keys:
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return None
    return value
