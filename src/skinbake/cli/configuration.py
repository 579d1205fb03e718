"""The file that sets options, ``skinbake.toml`` or ``[tool.skinbake]`` of ``pyproject.toml``: found and read.

Its values are checked like those of the command line, and are the defaults of click. Every command imports
this module. What reads a file imports its libraries if there is one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from itertools import accumulate, chain
from operator import or_
from typing import IO, Any, NamedTuple, NoReturn

import click

from skinbake.cli import exit_codes
from skinbake.cli.options import DeclaredOption
from skinbake.files.urls import STDIO, on_disk
from skinbake.options import SAFETY, By, Range, Text
from skinbake.wording import did_you_mean

OWN_CONFIG, SHARED_CONFIG = "skinbake.toml", "pyproject.toml"
"""The configuration file of skinbake alone, and that of all tools of a Python project."""

LARGEST_CONFIG = 1 << 16
"""The bytes of the largest configuration file. tomllib takes 10 s for a key of so many, made to be slow."""

REPOSITORY = ".git"
"""The name that the root of a repository has. No search goes beyond it."""

META = "skinbake.configured"

MOST_PARSED = 1 << 21
"""The number of characters that are parsed to find the line of a message."""

PER_FILE = ("bake", "verify")
"""The commands that have options which may differ from file to file."""

POSES = re.compile("animations?|random:.*", re.DOTALL)
"""The values of --fit-poses that name no file."""

Keys = tuple[str | int, ...]
"""The names of nested tables, and the numbers of entries of arrays, from the outside in."""


class ConfigurationError(click.ClickException):
    """A configuration file cannot be read, or has a mistake."""

    exit_code = exit_codes.USAGE

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the message without the usage of the command, which is not at fault."""
        click.echo(f"error: {self.message}", file=file, err=file is None)


class Configuration(NamedTuple):
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

    def refuse(self, keys: Keys, message: str, known: Iterable[str] = ()) -> NoReturn:
        """Raise ConfigurationError about a key. The message asks for the nearest of the known names."""
        meant = did_you_mean(str(keys[-1]), known)
        question = f"; {meant}" if meant else ""
        raise ConfigurationError(f"{self.place(keys)}: {spelt(keys)}: {message}{question}")

    def table(self, keys: Keys, value: object) -> Mapping[str, Any]:
        """Return the value of a key, which is a table. Raises ConfigurationError if it is none."""
        return value if isinstance(value, dict) else self.refuse(keys, "expected a table")


class Setting(NamedTuple):
    """The value of an option, as the file has it and as click converts it, its key, and its pattern."""

    value: Any
    converted: Any
    keys: Keys
    pattern: str | None = None


Settings = dict[str, Setting]
"""Settings by the names of click's parameters."""


class Override(NamedTuple):
    """Patterns of files, and the options for them."""

    patterns: tuple[str, ...]
    settings: Settings


class Configured(NamedTuple):
    """The options of one command in a file."""

    configuration: Configuration
    settings: Settings
    overrides: tuple[Override, ...]

    def patterns_for(self, source: str) -> dict[int, str]:
        """Return the numbers of the overrides that set options for an input, and the pattern of each."""
        path = None if source == STDIO or not self.overrides else on_disk(source)
        if path is None:
            return {}
        try:
            within = os.path.realpath(os.path.dirname(path) or os.curdir)
            place = os.path.join(within, os.path.basename(path))
            relative = os.path.relpath(place, self.configuration.folder)
        except (OSError, ValueError):
            return {}
        parts = relative.split(os.sep)
        if parts[0] == os.pardir:
            return {}
        found = {
            number: next((one for one in override.patterns if matches(parts, one)), None)
            for number, override in enumerate(self.overrides)
            if override.settings
        }
        return {number: pattern for number, pattern in found.items() if pattern is not None}

    @property
    def path(self) -> str:
        """Return the absolute path of the file."""
        return os.path.abspath(self.configuration.name)

    def converted_by(self, chosen: Iterable[int]) -> dict[str, Any]:
        """Return the options of overrides, as click converts them. The last one wins."""
        every = chain.from_iterable(self.overrides[number].settings.items() for number in chosen)
        return {name: setting.converted for name, setting in every}

    def origin_of(self, chosen: Sequence[int]) -> str:
        """Return where the last three overrides are, which win."""
        return ", ".join(
            f"{self.configuration.place(('overrides', number, 'files'))}: {spelt(('overrides', number))}"
            for number in chosen[-3:]
        )


def configured_in(ctx: click.Context) -> Configured | None:
    """Return the options that the file sets for the command of a context, or None without a file."""
    found: Configured | None = ctx.meta.get(META)
    return found


def load(ctx: click.Context, param: click.Parameter, value: str | bool | None) -> None:
    """Have click take the options of the file as defaults, or have no file if --no-config is given.

    It is what the options that choose the file do, before others are looked at.
    """
    has_none = param.name == "no_config"
    if ctx.resilient_parsing or (has_none and not value):
        return
    if META in ctx.meta:
        if value is not None:
            raise click.UsageError("--config and --no-config contradict each other")
        return
    ctx.meta[META] = None
    if has_none:
        return
    found = _nearest() if value is None else read_configuration(str(value))
    if found is not None:
        configured = ctx.meta[META] = configured_options(found, ctx)
        ctx.default_map = {name: setting.value for name, setting in configured.settings.items()}
    elif value is not None:
        raise click.UsageError(f"--config: {value} has no [tool.skinbake]")


CHOOSES_FILE = frozenset({"config", "no_config"})
"""The options that choose the file."""


def searched_folders() -> Iterator[str]:
    """Yield the current folder and those above it, up to the root of a repository or of the file system."""
    folder = os.path.realpath(os.curdir)
    while True:
        yield folder
        above = os.path.dirname(folder)
        if above == folder or os.path.lexists(os.path.join(folder, REPOSITORY)):
            return
        folder = above


def _nearest() -> Configuration | None:
    """Return the configuration of the nearest folder that has one, by its path from the current folder."""
    with suppress(FileNotFoundError):  # the current folder was deleted
        for folder in searched_folders():
            own, shared = (
                os.path.relpath(os.path.join(folder, name)) for name in (OWN_CONFIG, SHARED_CONFIG)
            )
            if os.path.lexists(own):
                return read_configuration(own)
            if os.path.isfile(shared) and (found := read_configuration(shared)) is not None:
                return found
    return None


def read_configuration(path: str) -> Configuration | None:
    """Return the configuration in a file, or None for a pyproject.toml without one.

    Raises ConfigurationError if it cannot be read or is not TOML.
    """
    from skinbake.files.folders import open_regular

    try:
        with os.fdopen(open_regular(path), "rb") as file:
            data = file.read(LARGEST_CONFIG + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigurationError(f"{path} cannot be read: {reason}") from error
    is_shared = os.path.basename(path) == SHARED_CONFIG
    if is_shared and b"skinbake" not in data:
        return None
    if len(data) > LARGEST_CONFIG:
        raise ConfigurationError(f"{path} is larger than {LARGEST_CONFIG:,} bytes, too large for options")
    import tomllib

    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        fault = str(error)
        if isinstance(error, UnicodeDecodeError):
            fault = "it is not text in UTF-8"
        elif isinstance(error, RecursionError):
            fault = "it is nested too deep"
        elif fault.startswith("Invalid value"):
            fault += "; text stands in quotes"
        raise ConfigurationError(f"{path} is not valid TOML: {fault}") from error
    found = Configuration(path, os.path.realpath(os.path.dirname(path) or os.curdir), text, (), tables)
    if not is_shared:
        return found
    above = ("tool", "skinbake")
    inner = _at(tables, above)
    return None if inner is None else found._replace(above=above, tables=found.table(above, inner))


def configured_options(configuration: Configuration, ctx: click.Context) -> Configured:
    """Return the options of the context's command, checked. Raises ConfigurationError.

    The tables of other commands are not looked at, so that they need not be imported.
    """
    group, name = ctx.find_root().command, str(ctx.command.name)
    commands = group.list_commands(ctx.find_root()) if isinstance(group, click.Group) else []
    for key in configuration.tables:
        if key == "tool" and not configuration.above:
            configuration.refuse((key,), "this is for pyproject.toml: name the tables [bake], [verify] …")
        if key not in {*commands, "overrides"}:
            expected = "unknown key: expected the table of a command, like [bake], or [[overrides]]"
            configuration.refuse((key,), expected, [*commands, "overrides"])
    table = configuration.table((name,), configuration.tables.get(name, {}))
    settings = _checked(configuration, ctx, (name,), table, By.TABLE)
    # The overrides of some files, each with its patterns.
    entries, overrides = configuration.tables.get("overrides", []), list[Override]()
    if not isinstance(entries, list):
        configuration.refuse(("overrides",), "expected an array of tables: [[overrides]]")
    for number, entry in enumerate(entries):
        keys: Keys = ("overrides", number)
        table = configuration.table(keys, entry)
        for key in table:
            if key not in {"files", *PER_FILE}:
                message = "unknown key: expected files, bake or verify"
                configuration.refuse((*keys, key), message, ["files", *PER_FILE])
        patterns, files = table.get("files"), (*keys, "files")
        if patterns is None:
            configuration.refuse(keys, 'it needs files = ["…"], the patterns of the files that it is for')
        if (
            not isinstance(patterns, list)
            or not patterns
            or not all(isinstance(one, str) for one in patterns)
        ):
            configuration.refuse(files, "expected an array of patterns")
        for pattern in patterns:
            if not pattern or "\\" in pattern or {"", ".", ".."} & {*pattern.split("/")}:
                expected = f"expected a path from the folder of {configuration.name}, with / between folders"
                configuration.refuse(files, f"{pattern!r}: {expected}, and *, ? or ** for any")
        inner = configuration.table((*keys, name), table.get(name, {})) if name in PER_FILE else {}
        settings_of = _checked(configuration, ctx, (*keys, name), inner, By.OVERRIDE)
        overrides.append(Override(tuple(patterns), settings_of))
    return Configured(configuration, settings, tuple(overrides))


def _checked(
    configuration: Configuration, ctx: click.Context, above: Keys, table: Mapping[str, Any], by: By
) -> Settings:
    """Return the settings of a table of options. Raises ConfigurationError."""
    options, settings = options_of(ctx.command), Settings()
    for key, value in table.items():
        keys = (*above, key)
        if key not in options:
            known = [one for one, option in options.items() if by in option.declared.by]
            message = f"unknown key: expected an option of skinbake {ctx.command.name}"
            configuration.refuse(keys, message, known)
        declared = options[key].declared
        if By.TABLE not in declared.by:
            why = "because it decides which files or machines are used, or what is written"
            if declared.heading == SAFETY:
                why = "because it lifts a limit that protects you"
            advice = f"give --{key} on the command line"
            configuration.refuse(keys, f"a configuration file cannot set this option, {why}; {advice}")
        if by not in declared.by:
            message = "this option is the same for all files: set it in the table of the command"
            configuration.refuse(keys, message)
        converted = _converted(configuration, ctx, keys, options[key], value)
        settings[declared.name] = Setting(value, converted, keys)
    return settings


def options_of(command: click.Command) -> dict[str, DeclaredOption]:
    """Return the options of a command by their keys in a file, without those that choose the file."""
    return {
        param.declared.flag[2:]: param
        for param in command.params
        if isinstance(param, DeclaredOption) and param.name not in CHOOSES_FILE
    }


def _converted(
    configuration: Configuration, ctx: click.Context, keys: Keys, option: DeclaredOption, value: Any
) -> Any:
    """Return a value as click converts it. Raises ConfigurationError."""
    values = option.declared.values
    is_text, is_whole = isinstance(value, str), isinstance(value, int) and not isinstance(value, bool)
    if option.declared.is_many:
        fits = isinstance(value, list) and all(isinstance(one, str) for one in value)
        expected = "an array of texts"
    elif values is bool:
        fits, expected = isinstance(value, bool), "true or false"
    elif values is int or (isinstance(values, Range) and values.is_whole):
        fits, expected = is_whole, "an integer"
    elif isinstance(values, Range):
        fits, expected = is_whole or isinstance(value, float), "a number"
    elif isinstance(values, Text) and values.is_number:
        fits, expected = is_text or is_whole, "an integer, or a text in quotes"
    else:
        fits, expected = is_text, "a text in quotes"
    if not fits:
        # The value as TOML writes it, cut if it is long.
        text = str(value).lower() if isinstance(value, bool) else repr(value)
        configuration.refuse(keys, f"{text if len(text) <= 60 else f'{text[:60]}…'}: expected {expected}")
    if option.name == "fit_poses" and not all(map(POSES.fullmatch, value)):
        configuration.refuse(
            keys, 'expected "animations" or "random:N"; a file is given on the command line, by --fit-poses'
        )
    try:
        return option.type_cast_value(ctx, value)
    except click.BadParameter as error:
        configuration.refuse(keys, error.message)
    except OverflowError:
        configuration.refuse(keys, "the number is too large")


def matches(parts: Sequence[str], pattern: str) -> bool:
    """Tell whether a path matches a pattern. ``**`` is any number of folders; at the end, all below them.

    It takes time in proportion to both lengths, whatever the pattern.
    """
    from fnmatch import fnmatchcase

    fits = [True] + [False] * len(parts)  # for each number of parts: whether they match the steps so far
    for step in [*pattern.split("/"), *(["*"] if pattern.rpartition("/")[2] == "**" else [])]:
        if step == "**":
            fits = list(accumulate(fits, or_))
        else:
            before = zip(fits, parts, strict=False)
            fits = [False, *(fit and fnmatchcase(part, step) for fit, part in before)]
    return fits[-1]


def spelt(keys: Keys) -> str:
    """Return keys as a person writes them: ``bake.encoding``, ``overrides[0].files``."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


@cache
def _line_of(text: str, keys: Keys) -> int | None:
    """Return the line in which a key begins, counted from 1, or None if it is not found.

    tomllib tells no lines. A key begins in a line if the text before it is valid without the key, and the
    text up to this line, or to a later one for a long value, is valid with the key.
    """
    import tomllib

    lines, left = text.split("\n"), MOST_PARSED
    name = next(key for key in reversed(keys) if isinstance(key, str))

    def has(end: int) -> bool | None:
        """Tell whether the first lines have the key; None if they are not valid TOML, or too much work."""
        nonlocal left
        left -= len(some := "\n".join(lines[:end]))
        with suppress(ValueError, RecursionError):
            return None if left < 0 else _at(tomllib.loads(some), keys) is not None
        return None

    for number, line in enumerate(lines):
        if left < 0:
            break
        if name in line and has(number) is False:
            later = (has(end + 1) for end in range(number, len(lines)) if left >= 0)
            if next((found for found in later if found is not None), False):
                return number + 1
    return None


def _at(value: Any, keys: Keys) -> Any:
    """Return the value of nested keys, or None if there is none."""
    for key in keys:
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return None
    return value
