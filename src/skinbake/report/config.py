"""The options and where their values come from, as text for people and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skinbake.errors import printable

SCHEMA = "skinbake.config/1"

DEFAULT = "default"


@dataclass(frozen=True, slots=True)
class OptionValue:
    """The value of an option, and its origin: ``default``, ``file``, ``override`` or ``environment``.

    ``place`` is the line of the file, or the name of the variable. ``pattern`` is that of an override.
    """

    value: Any
    origin: str = DEFAULT
    place: str | None = None
    pattern: str | None = None


Options = Mapping[str, OptionValue]
"""The options of a command by their names in the file."""


@dataclass(frozen=True, slots=True)
class ConfigResult:
    """The file, None without one, the folders that were searched, and the options.

    ``commands`` has the options of each command, ``files`` the options of those that work on each input.
    """

    file: str | None
    searched: tuple[str, str]
    commands: Mapping[str, Options]
    files: Mapping[str, Mapping[str, Options]]


def as_text(result: ConfigResult, *, only_changed: bool) -> str:
    """Return the options, one a line, below the name of their command."""
    first, last = map(printable, result.searched)
    where = f"in {first}" if first == last else f"from {first} up to {last}"
    found = (
        f"no configuration file {where}" if result.file is None else f"options from {printable(result.file)}"
    )
    paragraphs = [found]
    titled = dict(result.commands)
    for source, commands in result.files.items():
        titled |= {f"{printable(source)}: {name}": options for name, options in commands.items()}
    for title, options in titled.items():
        lines = [title]
        for name, one in options.items():
            if one.origin == DEFAULT and only_changed:
                continue
            # A value stands as TOML writes it, or as a dash for none.
            value = "-" if one.value is None else printable(json.dumps(one.value, ensure_ascii=False))
            place = "" if one.place is None else printable(one.place)
            origin = f"{place}, for {printable(one.pattern)}" if one.pattern else place or one.origin
            if one.origin == "environment":
                origin = f"environment: {place}"
            lines.append(f"  {name:<20} {value:<16} {origin}")
        if lines[1:]:
            paragraphs.append("\n".join(lines))
    return "\n\n".join(paragraphs)


def as_json(result: ConfigResult, *, only_changed: bool) -> dict[str, Any]:
    """Return the options as one JSON object."""

    def members(commands: Mapping[str, Options]) -> dict[str, Any]:
        return {
            name: {
                option: {"value": one.value, "origin": one.origin, "place": one.place, "pattern": one.pattern}
                for option, one in options.items()
                if one.origin != DEFAULT or not only_changed
            }
            for name, options in commands.items()
        }

    return {
        "schema": SCHEMA,
        "file": result.file,
        "commands": members(result.commands),
        "files": [
            {"input": source, "commands": members(commands)} for source, commands in result.files.items()
        ],
    }
