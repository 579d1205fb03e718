"""The file that sets options, ``skinbake.toml`` or ``[tool.skinbake]`` of ``pyproject.toml``: found and read.

Its values are checked like those of the command line, and are the defaults of click. Every command imports
this module. What reads a file imports its libraries if there is one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from itertools import chain
from typing import IO, TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

import click
from click.core import ParameterSource

from skinbake.cli import exit_codes
from skinbake.cli.options import DeclaredOption
from skinbake.errors import ChoiceError
from skinbake.files.urls import STDIO
from skinbake.options import SAFETY, By, Option, Range, Text, on_command_line

if TYPE_CHECKING:
    from skinbake.jobs.work import Job

OWN_CONFIG, SHARED_CONFIG = "skinbake.toml", "pyproject.toml"
"""The configuration file of skinbake alone, and that of all tools of a Python project."""

LARGEST_CONFIG = 1 << 20
"""The size in bytes of the largest configuration file that is read."""

REPOSITORY = ".git"
"""The name that the root of a repository has. No search goes beyond it."""

MENTION = re.compile(rb"""tool["']?\s*\.\s*["']?skinbake""")
"""The bytes without which pyproject.toml says nothing to skinbake. It is not parsed then."""

META = "skinbake.configured"

MOST_PARTS = 64
_PART = rb"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+"""
DEEP_KEY = re.compile(rb"(?<![\w-])(?:%s){%d}" % (_PART, MOST_PARTS - 1))
"""A key of so many parts between dots, wherever it stands: ``a.b.c``."""

LONGEST_TEXT = 4096
"""The characters of a pattern or another text. No path is longer."""

LARGEST_INTEGER = 2**63
"""The size of the integers that TOML promises. Larger ones are no texts, and no floats."""

MOST_PARSED = 1 << 21
"""The number of characters that are parsed to find the line of a message."""

MOST_NAMED = 3
"""The number of overrides that a message names."""

PER_FILE = ("bake", "verify")
"""The commands that have options which may differ from file to file."""

POSES = re.compile("animations?|random:.*", re.DOTALL)
"""The values of --fit-poses that name no file."""

ANYWHERE = "**"

Keys = tuple[str | int, ...]
"""The names of nested tables, and the numbers of entries of arrays, from the outside in."""

MadeT = TypeVar("MadeT")


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

    def refuse(self, keys: Keys, message: str) -> NoReturn:
        """Raise ConfigurationError about a key."""
        raise ConfigurationError(f"{self.place(keys)}: {spelt(keys)}: {message}")

    def refuse_name(self, keys: Keys, expected: str, known: Iterable[str]) -> NoReturn:
        """Raise ConfigurationError about a key of a name that does not exist."""
        from skinbake.wording import did_you_mean

        meant = did_you_mean(str(keys[-1]), known)
        question = f"; {meant}" if meant else ""
        self.refuse(keys, f"unknown key: expected {expected}{question}")

    def table(self, keys: Keys, value: object) -> Mapping[str, Any]:
        """Return the value of a key, which is a table. Raises ConfigurationError if it is none."""
        return value if isinstance(value, dict) else self.refuse(keys, "expected a table")


class Setting(NamedTuple):
    """The value of an option in the file, as it is written there, its key, and the pattern it is for."""

    value: Any
    keys: Keys
    pattern: str | None = None


Settings = dict[str, Setting]
"""Settings by the names of click's parameters."""


class Override(NamedTuple):
    """Patterns of files, and the options for them, as click converts them."""

    patterns: tuple[str, ...]
    settings: Settings
    given: Mapping[str, Any]

    def pattern_for(self, parts: Sequence[str]) -> str | None:
        """Return the first pattern that matches the parts of a path, or None."""
        return next((one for one in self.patterns if matches(parts, one)), None)


class Configured(NamedTuple):
    """The options of one command in a file."""

    configuration: Configuration
    settings: Settings
    overrides: tuple[Override, ...]

    def overrides_of(self, source: str) -> tuple[int, ...]:
        """Return the numbers of the overrides that set options for an input, in order."""
        parts = _parts_below(self.configuration.folder, source) if self.overrides else None
        if parts is None:
            return ()
        return tuple(
            number
            for number, one in enumerate(self.overrides)
            if one.settings and one.pattern_for(parts) is not None
        )

    def given_by(self, chosen: Iterable[int]) -> dict[str, Any]:
        """Return the options of overrides, as click converts them. The last one wins."""
        return {name: one for number in chosen for name, one in self.overrides[number].given.items()}

    def origin_of(self, chosen: Sequence[int]) -> str:
        """Return where overrides are. The last of them win, and are named."""
        return ", ".join(
            f"{self.configuration.place(('overrides', number, 'files'))}: {spelt(('overrides', number))}"
            for number in chosen[-MOST_NAMED:]
        )

    def settings_of(self, source: str) -> Settings:
        """Return the settings for an input, those of its overrides included."""
        found = dict(self.settings)
        parts = _parts_below(self.configuration.folder, source) or ()
        for number in self.overrides_of(source):
            pattern = self.overrides[number].pattern_for(parts)
            for name, setting in self.overrides[number].settings.items():
                found[name] = setting._replace(pattern=pattern)
        return found

    def in_words(self) -> str:
        """Return which options the file sets."""
        options = ", ".join(str(setting.keys[-1]) for setting in self.settings.values())
        return f"{self.configuration.name} sets {options}" if options else self.configuration.name


class OptionSets(NamedTuple):
    """The different sets of options that the inputs have. ``numbers`` has the number of each input's set.

    The first set is that without overrides. ``origins`` tell where the others come from, for an error.
    """

    given: Sequence[Mapping[str, Any]]
    origins: Sequence[Callable[[], str] | None]
    numbers: Sequence[int]

    def each(self, make: Callable[[Mapping[str, Any]], MadeT]) -> list[MadeT]:
        """Return what is made from each set. An error about an override's set says which override it is.

        Raises ChoiceError, and ConfigurationError for an override.
        """
        made = []
        for given, origin in zip(self.given, self.origins, strict=True):
            try:
                made.append(make(given))
            except ChoiceError as error:
                if origin is None:
                    raise
                message = error.worded(on_command_line)
                raise ConfigurationError(f"{origin()}: {message}") from error
        return made

    def numbered(self, jobs: Sequence[Job]) -> Sequence[Job]:
        """Return the jobs of the inputs with the numbers of their sets."""
        if len(self.given) == 1:
            return jobs
        return [job._replace(variant=number) for job, number in zip(jobs, self.numbers, strict=True)]


def option_sets(ctx: click.Context, given: Mapping[str, Any], sources: Sequence[str]) -> OptionSets:
    """Return the sets of options of the inputs. An option of the command line is the same for all."""
    configured = configured_in(ctx)
    if configured is None or not configured.overrides:
        return OptionSets([given], [None], [0] * len(sources))
    typed = {name for name in given if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    known: dict[tuple[int, ...], int] = {(): 0}
    sets, numbers, origins = [given], list[int](), list[Callable[[], str] | None]([None])
    for source in sources:
        chosen = configured.overrides_of(source)
        if chosen not in known:
            known[chosen] = len(sets)
            changes = configured.given_by(chosen)
            sets.append({**given, **{name: one for name, one in changes.items() if name not in typed}})
            origins.append(partial(configured.origin_of, chosen))
        numbers.append(known[chosen])
    return OptionSets(sets, origins, numbers)


def configured_in(ctx: click.Context) -> Configured | None:
    """Return the options that the file sets for the command of a context, or None without a file."""
    found: Configured | None = ctx.meta.get(META)
    return found


def config_files(ctx: click.Context) -> list[str]:
    """Return the absolute path of the file that was read, in a list, which is empty without one."""
    configured = configured_in(ctx)
    return [] if configured is None else [os.path.abspath(configured.configuration.name)]


def explained(ctx: click.Context, error: ChoiceError) -> str:
    """Return an error in words of the command line, with the places of the options that a file has set."""
    message, configured = error.worded(on_command_line), configured_in(ctx)
    places = [
        f"{configured.configuration.place(configured.settings[name].keys)} sets "
        f"{configured.settings[name].keys[-1]}"
        for name in dict.fromkeys(error.options)
        if configured is not None and ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP
    ]
    return f"{message} ({', '.join(places)}; --no-config leaves it out)" if places else message


def leave_out(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    """Have no configuration file, if --no-config is given."""
    if value and META in ctx.meta:
        raise click.UsageError("--config and --no-config contradict each other")
    if value:
        ctx.meta[META] = None


def load(ctx: click.Context, param: click.Parameter, value: str | None) -> None:
    """Have click take the options of the file as defaults."""
    if ctx.resilient_parsing:
        return
    if META in ctx.meta:
        if value is not None:
            raise click.UsageError("--config and --no-config contradict each other")
        return
    paths = _candidates() if value is None else iter([value])
    first = next(paths, None)
    ctx.meta[META] = None
    if first is None:
        return
    found = next(filter(None, map(read_configuration, chain([first], paths))), None)
    if found is not None:
        configured = ctx.meta[META] = configured_options(found, ctx)
        ctx.default_map = {name: setting.value for name, setting in configured.settings.items()}
    elif value is not None:
        raise click.UsageError(f"--config: {value} has no [tool.skinbake]")


CALLBACKS: Mapping[str | None, Callable[[click.Context, click.Parameter, Any], None]] = {
    "config": load,
    "no_config": leave_out,
}
"""What the options that choose the file do, before others are looked at."""


def _candidates() -> Iterator[str]:
    """Yield the files that may have options, the nearest first, relative to the current folder."""
    try:
        start = os.path.realpath(os.curdir)
    except OSError:
        return  # the current folder was deleted
    for folder in searched_folders():
        for name, holds_options in ((OWN_CONFIG, os.path.lexists), (SHARED_CONFIG, _is_mentioned)):
            path = os.path.join(folder, name)
            if holds_options(path):
                yield os.path.relpath(path, start)


def searched_folders() -> Iterator[str]:
    """Yield the current folder and those above it, up to the root of a repository or of the file system."""
    folder = os.path.realpath(os.curdir)
    while True:
        yield folder
        above = os.path.dirname(folder)
        if above == folder or os.path.lexists(os.path.join(folder, REPOSITORY)):
            return
        folder = above


def _is_mentioned(path: str) -> bool:
    """Tell whether a file of a Python project may have options of skinbake."""
    if not os.path.lexists(path):
        return False
    from skinbake.files.folders import open_regular

    with suppress(OSError), os.fdopen(open_regular(path), "rb") as file:
        return MENTION.search(file.read(LARGEST_CONFIG)) is not None
    return False


def spelt(keys: Keys) -> str:
    """Return keys as a person writes them: ``bake.encoding``, ``overrides[0].files``."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


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
    if len(data) > LARGEST_CONFIG:
        raise ConfigurationError(f"{path} is larger than {LARGEST_CONFIG:,} bytes, too large for options")
    import tomllib

    if DEEP_KEY.search(data):  # tomllib takes the square of its parts to read it
        raise ConfigurationError(f"{path} has a key of {MOST_PARTS} parts or more, too many for options")
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
        tables = tomllib.loads(text)
        waiting: list[Any] = [tables]
        while waiting:
            value = waiting.pop()
            if isinstance(value, int) and not -LARGEST_INTEGER <= value < LARGEST_INTEGER:
                raise ValueError
            waiting += value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path} is not valid TOML: {_fault(error)}") from error
    found = Configuration(path, os.path.realpath(os.path.dirname(path) or os.curdir), text, (), tables)
    if os.path.basename(path) != SHARED_CONFIG:
        return found
    above = ("tool", "skinbake")
    inner = _at(tables, above)
    if inner is None:
        return None
    return Configuration(path, found.folder, text, above, found.table(above, inner))


def _fault(error: Exception) -> str:
    """Return what is wrong with a text that is not TOML, and the usual cause of an invalid value."""
    from tomllib import TOMLDecodeError

    if isinstance(error, UnicodeDecodeError):
        return "it is not text in UTF-8"
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    if not isinstance(error, TOMLDecodeError):
        return "an integer has more than 64 bits"
    return f"{error}{'; text stands in quotes' if str(error).startswith('Invalid value') else ''}"


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


def configured_options(configuration: Configuration, ctx: click.Context) -> Configured:
    """Return the options of the context's command, checked. Raises ConfigurationError.

    The tables of other commands are not looked at, so that they need not be imported.
    """
    group = ctx.find_root().command
    commands = group.list_commands(ctx.find_root()) if isinstance(group, click.Group) else []
    for key in configuration.tables:
        if key == "tool" and not configuration.above:
            configuration.refuse((key,), "this is for pyproject.toml: name the tables [bake], [verify] …")
        if key not in {*commands, "overrides"}:
            expected = "the table of a command, like [bake], or [[overrides]]"
            configuration.refuse_name((key,), expected, [*commands, "overrides"])
    name = str(ctx.command.name)
    table = configuration.table((name,), configuration.tables.get(name, {}))
    settings, _ = _checked(configuration, ctx, (name,), table, By.TABLE)
    return Configured(configuration, settings, tuple(_overrides(configuration, ctx)))


def _overrides(configuration: Configuration, ctx: click.Context) -> Iterable[Override]:
    entries = configuration.tables.get("overrides", [])
    if not isinstance(entries, list):
        configuration.refuse(("overrides",), "expected an array of tables: [[overrides]]")
    name = str(ctx.command.name)
    for number, entry in enumerate(entries):
        keys: Keys = ("overrides", number)
        table = configuration.table(keys, entry)
        for key in table:
            if key not in {"files", *PER_FILE}:
                configuration.refuse_name((*keys, key), "files, bake or verify", ["files", *PER_FILE])
        patterns = _patterns(configuration, (*keys, "files"), table.get("files"))
        inner = configuration.table((*keys, name), table.get(name, {})) if name in PER_FILE else {}
        settings, given = _checked(configuration, ctx, (*keys, name), inner, By.OVERRIDE)
        yield Override(patterns, settings, given)


def _patterns(configuration: Configuration, keys: Keys, value: object) -> tuple[str, ...]:
    if value is None:
        configuration.refuse(keys[:-1], 'it needs files = ["…"], the patterns of the files that it is for')
    if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
        configuration.refuse(keys, "expected an array of patterns")
    for pattern in value:
        if len(pattern) > LONGEST_TEXT:
            configuration.refuse(keys, f"a pattern has {len(pattern):,} characters: expected a path")
        if not pattern or "\\" in pattern or {"", ".", ".."} & {*pattern.split("/")}:
            configuration.refuse(
                keys,
                f"{pattern!r}: expected a path from the folder of {configuration.name}, with / between "
                "folders, and *, ? or ** for any",
            )
    return tuple(value)


def _checked(
    configuration: Configuration, ctx: click.Context, above: Keys, table: Mapping[str, Any], by: By
) -> tuple[Settings, dict[str, Any]]:
    """Return the settings of a table, and the values as click converts them. Raises ConfigurationError."""
    options = options_of(ctx.command)
    settings, given = Settings(), dict[str, Any]()
    for key, value in table.items():
        keys = (*above, key)
        if key not in options:
            known = [one for one, option in options.items() if by in option.declared.by]
            configuration.refuse_name(keys, f"an option of skinbake {ctx.command.name}", known)
        declared = options[key].declared
        if by not in declared.by:
            configuration.refuse(keys, _reason(declared, key))
        settings[declared.name] = Setting(value, keys)
        given[declared.name] = _converted(configuration, ctx, keys, options[key], value)
    return settings, given


def options_of(command: click.Command) -> dict[str, DeclaredOption]:
    """Return the options of a command by their keys in a file, without those that choose the file."""
    return {
        param.declared.flag[2:]: param
        for param in command.params
        if isinstance(param, DeclaredOption) and param.name not in CALLBACKS
    }


def _reason(declared: Option, key: str) -> str:
    """Return why a file may not set an option."""
    if By.TABLE in declared.by:
        return "this option is the same for all files: set it in the table of the command"
    if declared.heading == SAFETY:
        why = "because it lifts a limit that protects you"
    else:
        why = "because it decides which files or machines are used, or what is written"
    return f"a configuration file cannot set this option, {why}; give --{key} on the command line"


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
        configuration.refuse(keys, f"{_toml(value)}: expected {expected}")
    if option.name == "fit_poses" and not all(map(POSES.fullmatch, value)):
        configuration.refuse(
            keys, 'expected "animations" or "random:N"; a file is given on the command line, by --fit-poses'
        )
    for text in value if isinstance(value, list) else [value]:
        if isinstance(text, str) and len(text) > LONGEST_TEXT:
            configuration.refuse(keys, f"a text has {len(text):,} characters, over {LONGEST_TEXT:,}")
    try:
        return option.type_cast_value(ctx, value)
    except click.BadParameter as error:
        configuration.refuse(keys, error.message)


def _toml(value: Any) -> str:
    """Return a value as TOML writes it, cut if it is long."""
    plain = str(value) if isinstance(value, str) else value
    text = str(value).lower() if isinstance(value, bool) else repr(plain)
    return text if len(text) <= 60 else f"{text[:60]}…"


def matches(parts: Sequence[str], pattern: str) -> bool:
    """Tell whether a path matches a pattern. ``**`` is any number of folders; at the end, all below them.

    It takes time in proportion to both lengths, whatever the pattern.
    """
    from fnmatch import fnmatchcase

    steps = pattern.split("/")
    if steps[-1] == ANYWHERE:
        steps.append("*")

    def with_skips(at: Iterable[int]) -> set[int]:
        reached = set(at)
        for step in range(len(steps)):
            if step in reached and steps[step] == ANYWHERE:
                reached.add(step + 1)
        return reached

    reached = with_skips([0])
    for part in parts:
        further = {step for step in reached if step < len(steps) and steps[step] == ANYWHERE}
        further |= {
            step + 1
            for step in reached
            if step < len(steps) and steps[step] != ANYWHERE and fnmatchcase(part, steps[step])
        }
        reached = with_skips(further)
    return len(steps) in reached


def _parts_below(folder: str, source: str) -> tuple[str, ...] | None:
    """Return the parts of a file's path below a folder, or None if it is not below it."""
    from skinbake.files.urls import on_disk

    path = None if source == STDIO else on_disk(source)
    if path is None:
        return None
    try:
        within = os.path.realpath(os.path.dirname(path) or os.curdir)
        relative = os.path.relpath(os.path.join(within, os.path.basename(path)), folder)
    except (OSError, ValueError):
        return None
    parts = tuple(relative.split(os.sep))
    return None if parts[:1] == (os.pardir,) else parts
