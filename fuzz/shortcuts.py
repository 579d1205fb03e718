"""Steps that many runs in one process need not repeat: the parser, options not given, templates, a device.

None of it is judged: what a command does with its file is done anew in each run.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import wraps
from typing import Any

import click
from click._utils import UNSET
from click.core import ParameterSource


def remember_what_never_changes() -> None:
    """Keep what click makes anew for each command line, and compile all templates of shaders once."""
    _keep_parsers()
    _keep_defaults()
    _draw_on_paper()
    from skinbake.shaders import text

    environment = text._environment()
    for path in text.TEMPLATES.rglob("*.*"):
        environment.get_template(path.relative_to(text.TEMPLATES).as_posix())


def _draw_on_paper() -> None:
    """Let pictures be empty: all that goes to the device is made, and no device is started."""
    import numpy as np

    from skinbake.commands import render
    from skinbake.render import studio

    class Paper(studio.Studio):
        def __init__(self, subjects: Any, camera: Any) -> None:
            self._subjects, self._camera, self._light = subjects, camera, np.asarray(studio.LIGHT)

        def picture(self, shot: Any, sides: Any, look: Any) -> Any:
            for number, subject in enumerate(self._subjects):
                for lighting in sides:
                    errors = shot.errors.get(lighting)
                    rest = shot.morphed.get(lighting, {}).get(number, subject.rest)
                    studio._rows(subject, rest, None if errors is None else errors[number])
                self._scene(subject, shot, look, subject.material.ranges[0])
            return np.zeros((look.height, look.width, 3), np.uint8)

    render.Studio = Paper  # type: ignore[attr-defined]  # only for the fuzzer


def _keep_parsers() -> None:
    """Keep each command's parser and parameters: both depend on its declaration alone."""
    for name in ("make_parser", "get_params", "get_help_option_names"):
        _keep(name)


def _keep(name: str) -> None:
    made = getattr(click.Command, name)
    kept: dict[click.Command, Any] = {}

    @wraps(made)
    def method(self: click.Command, ctx: click.Context) -> Any:
        if self not in kept:
            kept[self] = made(self, ctx)
        found = kept[self]
        if name == "make_parser":
            found.ctx = ctx
        return list(found) if isinstance(found, list) else found

    setattr(click.Command, name, method)


def _keep_defaults() -> None:
    """Keep what an option becomes that is not given: its default, checked and converted."""
    handled = click.Parameter.handle_parse_result
    kept: dict[click.Parameter, Any] = {}

    @wraps(handled)
    def method(
        self: click.Parameter, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        if self in kept and self.name not in opts:
            ctx.set_parameter_source(self.name, ParameterSource.DEFAULT)
            ctx.params[self.name] = kept[self]
            return kept[self], args
        value, rest = handled(self, ctx, opts, args)
        is_constant = (
            self.name not in opts
            and self.expose_value
            and self.callback is None
            and (value is UNSET or value is None or isinstance(value, bool | int | float | str))
        )
        if is_constant and ctx.get_parameter_source(self.name) is ParameterSource.DEFAULT:
            kept[self] = value
        return value, rest

    click.Parameter.handle_parse_result = method  # type: ignore[method-assign]  # only for the fuzzer's speed
