"""``skinbake config``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.configuration import (
    PER_FILE,
    ConfigurationError,
    Configured,
    Settings,
    configured_in,
    configured_options,
    options_of,
    searched_folders,
)
from skinbake.cli.console import console
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded
from skinbake.errors import ChoiceError, InputError, Place
from skinbake.options import in_toml
from skinbake.report.config import ConfigResult, Options, OptionValue, as_json, as_text

VARIABLES = {"threads": "OMP_NUM_THREADS", "color": "NO_COLOR"}
"""The environment variables that replace the default of an option."""


@click.command(
    "config",
    cls=Helpful,
    examples=(
        "skinbake config --changed",
        "skinbake config art/heroes/knight.glb",
    ),
)
@click.argument("inputs", nargs=-1, metavar="[INPUT]...")
@click.pass_context
def command(ctx: click.Context, /, inputs: tuple[str, ...], **given: Any) -> None:
    """Show the value of each option, and where it comes from: the default, or a line of a configuration file.

    With INPUT, a file, a folder or a quoted pattern, also show the options of bake and verify for each file,
    overrides included. The files are not read. The whole configuration file is checked.
    """
    say = console(given)
    found, code = expanded(inputs) if inputs else [], exit_codes.OK
    for entry in found:
        if entry.missing is not None:
            say.error(InputError(entry.missing, Place(entry.source)))
            code = exit_codes.INPUT
    result = _result(ctx, [entry.source for entry in found if entry.missing is None])
    if given["as_json"]:
        say.document(as_json(result, only_changed=given["changed"]))
    else:
        say.result(as_text(result, only_changed=given["changed"]))
    sys.exit(code)


def _result(ctx: click.Context, sources: Sequence[str]) -> ConfigResult:
    configured = configured_in(ctx)
    contexts = {str(one.command.name): one for one in _contexts(ctx)}
    by_command: dict[str, Configured | None] = {
        name: None if configured is None else configured_options(configured.configuration, one)
        for name, one in contexts.items()
    }
    _refuse_contradictions(contexts, by_command, sources)
    folders = list(searched_folders())

    def options(name: str, source: str | None) -> Options:
        chosen = by_command[name]
        if chosen is None:
            return _options(contexts[name], None, {})
        return _options(
            contexts[name], chosen, chosen.settings if source is None else chosen.settings_of(source)
        )

    return ConfigResult(
        None if configured is None else configured.configuration.name,
        (folders[0], folders[-1]),
        {name: options(name, None) for name in contexts},
        {source: {name: options(name, source) for name in PER_FILE} for source in sources},
    )


def _refuse_contradictions(
    contexts: Mapping[str, click.Context], by_command: Mapping[str, Configured | None], sources: Sequence[str]
) -> None:
    """Raise ConfigurationError if options contradict each other, in a table or for one of the sources."""
    from skinbake.cli.bake import baker_of
    from skinbake.cli.shader import check_together

    checks: dict[str, Callable[[Mapping[str, Any]], object]] = {"bake": baker_of, "shader": check_together}
    for name, check in checks.items():
        configured = by_command[name]
        if configured is None:
            continue
        refusal = _Refusal(configured, contexts[name], check)
        if configured.settings and (error := refusal.of(())):
            keys = [configured.settings[one].keys for one in error.options if one in configured.settings]
            configured.configuration.refuse(keys[0] if keys else (name,), error.worded(in_toml))
        chosen = {configured.overrides_of(source) for source in sources}
        alone = {(number,) for number, one in enumerate(configured.overrides) if one.settings}
        for numbers in sorted(chosen | alone):
            error = refusal.of(numbers)
            # An override may rely on those before it, which often are for its files too.
            if error and (numbers in chosen or refusal.of(range(numbers[0] + 1))):
                raise ConfigurationError(f"{configured.origin_of(numbers)}: {error.worded(in_toml)}")


class _Refusal:
    """The check of a command's options with those of overrides."""

    def __init__(
        self, configured: Configured, ctx: click.Context, check: Callable[[Mapping[str, Any]], object]
    ) -> None:
        values = {name: setting.value for name, setting in configured.settings.items()}
        command = ctx.command.make_context(
            ctx.info_name, [], ctx.parent, resilient_parsing=True, default_map=values
        )
        self._configured, self._given, self._check = configured, command.params, check

    def of(self, overrides: Iterable[int]) -> ChoiceError | None:
        """Return why the options are refused with those of overrides, None if they are not."""
        try:
            self._check({**self._given, **self._configured.given_by(overrides)})
        except ChoiceError as error:
            return error
        return None


def _contexts(ctx: click.Context) -> Iterator[click.Context]:
    """Yield a context for each command, without any option of this run."""
    top = ctx.find_root()
    group = top.command
    if not isinstance(group, click.Group):
        return
    for name in group.list_commands(top):
        if (found := group.get_command(top, name)) is not None:
            yield click.Context(found, click.Context(group), info_name=name)


def _options(ctx: click.Context, configured: Configured | None, settings: Settings) -> Options:
    """Return the value and the origin of each option of a command."""
    options = {}
    for key, option in options_of(ctx.command).items():
        setting = settings.get(str(option.name))
        variable = VARIABLES.get(str(option.name))
        if setting is not None and configured is not None:
            place = configured.configuration.place(setting.keys)
            origin = "override" if setting.pattern else "file"
            options[key] = OptionValue(setting.value, origin, place, setting.pattern)
        elif variable and os.environ.get(variable):
            options[key] = OptionValue(_default(ctx, option), "environment", variable)
        else:
            options[key] = OptionValue(_default(ctx, option))
    return options


def _default(ctx: click.Context, option: click.Option) -> Any:
    """Return the default of an option as a file would spell it, or None for none."""
    value = option.get_default(ctx, call=False)
    if option.multiple:
        return list(value) if isinstance(value, list | tuple) else []
    return value if isinstance(value, str | int | float | bool) else None
