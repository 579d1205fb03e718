"""The options that a configuration file sets, checked like those of the command line."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, NoReturn

import click

from skinbake.cli.configuration import Configuration, Keys, read_configuration, spelt
from skinbake.cli.names import STDIO
from skinbake.files.urls import on_disk
from skinbake.wording import did_you_mean

# A line for each name would take a page.
# fmt: off
OF_A_BAKE = frozenset((
    "gradients", "fit_poses", "weighting", "crease_angle", "weld", "neighbours", "frame", "limit_influences",
    "generate_normals", "encoding", "layout", "alpha_name", "beta_name", "compress", "compress_level",
    "position_bits", "normal_bits", "texcoord_bits", "require_baked", "warnings_as_errors",
))
OF_A_CHECK = frozenset((
    "methods", "poses", "samples", "angle", "seed", "baseline", "cap", "truth", "max_mean_error",
    "max_p95_error", "min_gain", "require_baked", "warnings_as_errors",
))
PER_FILE: Mapping[str, frozenset[str]] = {"bake": OF_A_BAKE, "verify": OF_A_CHECK}
"""The options that may differ from file to file, by command."""

SETTABLE = frozenset((
    "language", "target", "method", "lighting", "influences", "morphs", "mirrored_joints", "clip", "time",
    "mode", "split", "clay", "turntable", "size", "as_json", "changed", "timings", "jobs", "threads",
    "skip_unchanged", "pack", "timeout", "isolate", "verbose", "quiet", "color",
)).union(*PER_FILE.values())
# fmt: on
"""The options that a file may set.

A file may come with a stranger's repository. So it sets none that names a file or a host, decides what is
written, or lifts a limit. An option that is not listed is refused.
"""

GUARDS = frozenset(("max_memory", "allow_outside", "no_sync"))
"""The options that protect the user."""

POSES = re.compile("animations?|random:.*", re.DOTALL)
"""The values of --fit-poses that name no file."""

ANYWHERE = "**"


@dataclass(frozen=True, slots=True)
class Setting:
    """The value of an option in the file, as it is written there, its key, and the pattern it is for."""

    value: Any
    keys: Keys
    pattern: str | None = None


Settings = dict[str, Setting]
"""Settings by the names of click's parameters."""


@dataclass(frozen=True, slots=True)
class Override:
    """Patterns of files, and the options for them, as click converts them."""

    patterns: tuple[str, ...]
    settings: Settings
    given: Mapping[str, Any]

    def pattern_for(self, parts: Sequence[str]) -> str | None:
        """Return the first pattern that matches the parts of a path, or None."""
        return next((one for one in self.patterns if matches(parts, one)), None)


@dataclass(frozen=True, slots=True)
class Configured:
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

    def origin_of(self, chosen: Iterable[int]) -> str:
        """Return where overrides are."""
        return ", ".join(
            f"{self.configuration.place(('overrides', number, 'files'))}: {spelt(('overrides', number))}"
            for number in chosen
        )

    def settings_of(self, source: str) -> Settings:
        """Return the settings for an input, those of its overrides included."""
        found = dict(self.settings)
        parts = _parts_below(self.configuration.folder, source) or ()
        for number in self.overrides_of(source):
            pattern = self.overrides[number].pattern_for(parts)
            for name, setting in self.overrides[number].settings.items():
                found[name] = replace(setting, pattern=pattern)
        return found

    def in_words(self) -> str:
        """Return which options the file sets."""
        options = ", ".join(str(setting.keys[-1]) for setting in self.settings.values())
        return f"{self.configuration.name} sets {options}" if options else self.configuration.name

    def keys_in(self, message: str) -> Keys | None:
        """Return the keys of the first option in an error that comes from the file, or None without one."""
        return next((setting.keys for setting in self._named_in(message)), None)

    def explained(self, message: str) -> str:
        """Return an error with the places of the options in it that come from the file."""
        places = [
            f"{self.configuration.place(setting.keys)} sets {setting.keys[-1]}"
            for setting in self._named_in(message)
        ]
        return f"{message} ({', '.join(places)}; --no-config leaves it out)" if places else message

    def _named_in(self, message: str) -> Iterable[Setting]:
        """Return the settings of the options that an error names."""
        return (
            setting
            for setting in self.settings.values()
            if re.search(rf"--{re.escape(str(setting.keys[-1]))}\b", message)
        )


def configured_by(paths: Iterable[str], ctx: click.Context) -> Configured | None:
    """Return the options of the first file that has any, or None if none has. Raises ConfigurationError."""
    for path in paths:
        found = read_configuration(path)
        if found is not None:
            return configured_options(found, ctx)
    return None


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
            _unknown(configuration, (key,), expected, [*commands, "overrides"])
    name = str(ctx.command.name)
    table = configuration.table((name,), configuration.tables.get(name, {}))
    settings, _ = _checked(configuration, ctx, (name,), table, SETTABLE)
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
                _unknown(configuration, (*keys, key), "files, bake or verify", ["files", *PER_FILE])
        patterns = _patterns(configuration, (*keys, "files"), table.get("files"))
        inner = configuration.table((*keys, name), table.get(name, {})) if name in PER_FILE else {}
        settings, given = _checked(configuration, ctx, (*keys, name), inner, PER_FILE.get(name, frozenset()))
        yield Override(patterns, settings, given)


def _patterns(configuration: Configuration, keys: Keys, value: object) -> tuple[str, ...]:
    if value is None:
        configuration.refuse(keys[:-1], 'it needs files = ["…"], the patterns of the files that it is for')
    if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
        configuration.refuse(keys, "expected an array of patterns")
    for pattern in value:
        if not pattern or "\\" in pattern or {"", ".", ".."} & {*pattern.split("/")}:
            configuration.refuse(
                keys,
                f"{pattern!r}: expected a path from the folder of {configuration.name}, with / between "
                "folders, and *, ? or ** for any",
            )
    return tuple(value)


def _checked(
    configuration: Configuration,
    ctx: click.Context,
    above: Keys,
    table: Mapping[str, Any],
    allowed: frozenset[str],
) -> tuple[Settings, dict[str, Any]]:
    """Return the settings of a table, and the values as click converts them. Raises ConfigurationError."""
    options = options_of(ctx.command)
    settings, given = Settings(), dict[str, Any]()
    for key, value in table.items():
        keys = (*above, key)
        if key not in options:
            known = [one for one, option in options.items() if option.name in allowed]
            _unknown(configuration, keys, f"an option of skinbake {ctx.command.name}", known)
        option = options[key]
        name = str(option.name)
        if name not in allowed:
            configuration.refuse(keys, _reason(name, key))
        settings[name] = Setting(value, keys)
        given[name] = _converted(configuration, ctx, keys, option, value)
    return settings, given


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command by their long names, without those that choose the file."""
    return {
        spelling[2:]: param
        for param in command.params
        if isinstance(param, click.Option) and param.name not in {"config", "no_config"}
        for spelling in param.opts
        if spelling.startswith("--")
    }


def _unknown(configuration: Configuration, keys: Keys, expected: str, known: Iterable[str]) -> NoReturn:
    meant = did_you_mean(str(keys[-1]), known)
    question = f"; {meant}" if meant else ""
    configuration.refuse(keys, f"there is nothing of this name: expected {expected}{question}")


def _reason(name: str, key: str) -> str:
    """Return why a file may not set an option."""
    if name in SETTABLE:
        return "this option is the same for all files: set it in the table of the command"
    if name in GUARDS:
        why = "because it lifts a limit that protects you"
    else:
        why = "because it decides which files or machines are used, or what is written"
    return f"a configuration file cannot set this option, {why}; give --{key} on the command line"


def _converted(
    configuration: Configuration, ctx: click.Context, keys: Keys, option: click.Option, value: Any
) -> Any:
    """Return a value as click converts it. Raises ConfigurationError."""
    expected = _kind_missed(option, value)
    if expected is not None:
        configuration.refuse(keys, f"{_toml(value)}: expected {expected}")
    if option.name == "fit_poses" and not all(map(POSES.fullmatch, value)):
        configuration.refuse(
            keys, 'expected "animations" or "random:N"; a file is given on the command line, by --fit-poses'
        )
    try:
        converted = option.type_cast_value(ctx, value)
        return option.callback(ctx, option, converted) if option.callback else converted
    except click.BadParameter as error:
        configuration.refuse(keys, error.message)


def _kind_missed(option: click.Option, value: Any) -> str | None:
    """Return the kind of value that an option needs if this is another kind. click takes 3.7 for 3."""
    if option.multiple:
        is_texts = isinstance(value, list) and all(isinstance(one, str) for one in value)
        return None if is_texts else "an array of texts"
    if option.is_flag:
        return None if isinstance(value, bool) else "true or false"
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if option.count or isinstance(option.type, click.types.IntParamType):
        return None if is_whole else "an integer"
    if isinstance(option.type, click.types.FloatParamType):
        return None if is_whole or isinstance(value, float) else "a number"
    if option.callback:  # those of --jobs and --threads read a number from text
        return None if isinstance(value, str) or is_whole else "an integer, or a text in quotes"
    return None if isinstance(value, str) else "a text in quotes"


def _toml(value: Any) -> str:
    """Return a value as TOML writes it, cut if it is long."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


def matches(parts: Sequence[str], pattern: str) -> bool:
    """Tell whether a path matches a pattern. ``**`` is any number of folders; at the end, all below them.

    It takes time in proportion to both lengths, whatever the pattern.
    """
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
