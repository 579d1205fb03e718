"""``skinbake config``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded
from skinbake.cli.plan import Plan, planned
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
@planned()
def command(plan: Plan[Any], inputs: tuple[str, ...], *, changed: bool) -> None:
    """Show the value of each option, and where it comes from: the default, or a line of a configuration file.

    With INPUT, a file, a folder or a quoted pattern, also show the options of bake and verify for each file,
    overrides included. The files are not read. The whole configuration file is checked.
    """
    found, code = expanded(inputs) if inputs else [], exit_codes.OK
    for entry in found:
        if entry.missing is not None:
            plan.say.error(InputError(entry.missing, Place(entry.source)))
            code = exit_codes.INPUT
    ctx, sources = click.get_current_context(), [one.source for one in found if one.missing is None]
    configured, top = configured_in(ctx), ctx.find_root()
    # A context for each command, without any option of this run.
    group, contexts = top.command, dict[str, click.Context]()
    assert isinstance(group, click.Group)
    for name in group.list_commands(top):
        if (one := group.get_command(top, name)) is not None:
            contexts[name] = click.Context(one, click.Context(group), info_name=name)
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
        settings = dict(chosen.settings)
        for number, pattern in {} if source is None else chosen.patterns_for(source).items():
            for option, setting in chosen.overrides[number].settings.items():
                settings[option] = setting._replace(pattern=pattern)
        return _options(contexts[name], chosen, settings)

    result = ConfigResult(
        None if configured is None else configured.configuration.name,
        (folders[0], folders[-1]),
        {name: options(name, None) for name in contexts},
        {source: {name: options(name, source) for name in PER_FILE} for source in sources},
    )
    if plan.as_json:
        plan.say.document(as_json(result, only_changed=changed))
    else:
        plan.say.result(as_text(result, only_changed=changed))
    sys.exit(code)


def _refuse_contradictions(
    contexts: Mapping[str, click.Context], by_command: Mapping[str, Configured | None], sources: Sequence[str]
) -> None:
    """Raise ConfigurationError if options contradict each other, in a table or for one of the sources."""
    from skinbake.cli.bake import options_of
    from skinbake.cli.shader import check_together

    checks: dict[str, Callable[[Mapping[str, Any]], object]] = {"bake": options_of, "shader": check_together}
    for name, check in checks.items():
        configured = by_command[name]
        if configured is None:
            continue
        # The options of the command as click has them, with the table of the file and nothing typed.
        ctx, values = contexts[name], {key: one.value for key, one in configured.settings.items()}
        given = ctx.command.make_context(
            ctx.info_name, [], ctx.parent, resilient_parsing=True, default_map=values
        ).params

        if configured.settings and (error := _refusal(check, given, configured, ())):
            keys = [configured.settings[one].keys for one in error.options if one in configured.settings]
            configured.configuration.refuse(keys[0] if keys else (name,), error.worded(in_toml))
        chosen = {tuple(configured.patterns_for(source)) for source in sources}
        alone = {(number,) for number, one in enumerate(configured.overrides) if one.settings}
        for numbers in sorted(chosen | alone):
            error = _refusal(check, given, configured, numbers)
            # An override may rely on those before it, which often are for its files too.
            if error and (numbers in chosen or _refusal(check, given, configured, range(numbers[0] + 1))):
                raise ConfigurationError(f"{configured.origin_of(numbers)}: {error.worded(in_toml)}")


def _refusal(
    check: Callable[[Mapping[str, Any]], object],
    given: Mapping[str, Any],
    configured: Configured,
    overrides: Iterable[int],
) -> ChoiceError | None:
    """Return why the options of a command are refused with the options of overrides, None if they are not."""
    try:
        check({**given, **configured.converted_by(overrides)})
    except ChoiceError as error:
        return error
    return None


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
