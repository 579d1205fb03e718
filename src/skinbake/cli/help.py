"""The help of the commands: options in groups, examples at the end; completion; and a man page of it all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from skinbake.cli.chosen_config import config_options, configured_in
from skinbake.cli.terminal import stdout_told
from skinbake.errors import printable
from skinbake.files.urls import SUFFIXES
from skinbake.version import __version__

GROUPS = {
    "Output": ("output", "out_dir", "in_place", "pack", "dry_run", "port", "no_browser"),
    "α and β": (
        "gradients",
        "fit_poses",
        "weighting",
        "crease_angle",
        "weld",
        "neighbours",
        "frame",
        "limit_influences",
        "generate_normals",
    ),
    "Storage": (
        "encoding",
        "layout",
        "alpha_name",
        "beta_name",
        "compress",
        "compress_level",
        "position_bits",
        "normal_bits",
        "texcoord_bits",
    ),
    "Shader": (
        "language",
        "target",
        "source",
        "method",
        "lighting",
        "influences",
        "morphs",
        "mirrored_joints",
    ),
    "Poses": ("poses", "samples", "angle", "seed", "clip", "time"),
    "Measurement": ("methods", "baseline", "cap", "truth"),
    "Picture": ("mode", "split", "clay", "turntable", "size"),
    "Conditions": ("max_mean_error", "max_p95_error", "min_gain", "require_baked", "warnings_as_errors"),
    "Reports": ("as_json", "changed", "junit", "html", "summary", "depfile", "timings"),
    "Many files": ("jobs", "threads", "skip_unchanged", "state", "dask"),
    "Limits and safety": ("max_memory", "timeout", "isolate", "allow_outside", "no_sync"),
    "Configuration": ("config", "no_config"),
    "Messages": ("verbose", "quiet", "color", "help"),
}
"""The names of the parameters of all commands, by the heading under which help shows them."""

ELSEWHERE = {("shader", "cap"): "Shader", ("cost", "influences"): "Reports"}
"""Parameters that mean something else in one command, with their heading there. They come last under it."""

PATHS = {"INPUT", "FILE", "BAKED_FILE", "PAGE", "PICTURE", "DIR"}
"""The metavars of parameters that are paths."""

PAGE = "skinbake"


class PathName(click.types.StringParamType):
    """Text that a shell completes as a path. It may be a URL or ``-``, unlike that of click.Path."""

    def __init__(self, kind: str) -> None:
        """Take ``file`` or ``dir``."""
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path. Raises click.UsageError if it is empty, because a script's variable may be."""
        if not value:
            option = f"{param.opts[-1]}: " if isinstance(param, click.Option) else ""
            name = "the name" if option else "the name of an input"
            raise click.UsageError(f"{option}{name} is empty; is a variable of your script not set?", ctx)
        return super().convert(value, param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Have the shell complete the path."""
        return [CompletionItem(incomplete, type=self._kind)]


class Helpful(click.Command):
    """A command whose help has its options in groups, and whose options a configuration file can set.

    ``examples`` end the help, one a line. ``second`` is the option that a user means by a name more than the
    command takes, and the suffixes of such names.
    """

    def __init__(
        self,
        *arguments: Any,
        examples: tuple[str, ...] = (),
        second: tuple[str, tuple[str, ...]] | None = None,
        **options: Any,
    ) -> None:
        """Take the examples and the option of a second name besides the parameters of click."""
        self.examples, self._second = examples, second
        super().__init__(*arguments, **options)
        self.params += config_options()
        for param in self.params:
            if param.type is click.STRING and (param.metavar or "").strip("[].") in PATHS:
                param.type = PathName("dir" if param.metavar == "DIR" else "file")

    def make_context(self, *arguments: Any, **options: Any) -> click.Context:
        """Make the context. --help prints and ends in this method."""
        with stdout_told():
            return super().make_context(*arguments, **options)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments. A name too many is answered with the option that it may be meant for."""
        ctx.allow_extra_args, given = True, list(args)
        try:
            left = super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            dashed = self._dashed(given, error.option_name)
            if dashed is not None:
                ctx.fail(f"{error.message} A name that begins with - is written ./{dashed}")
            raise
        ctx.allow_extra_args = False
        if not ctx.resilient_parsing:
            self._refuse_options_as_names(ctx, left)
            if left:
                ctx.fail(self._unexpected(left))
        return left

    def _refuse_options_as_names(self, ctx: click.Context, left: list[str]) -> None:
        """Fail if an option was read as the name of a file, because it stands after ``--``."""
        names = list(left)
        for param in self.params:
            if isinstance(param, click.Argument):
                value = ctx.params.get(str(param.name)) or ()
                names += [value] if isinstance(value, str) else value
        known = {name for param in self.params for name in param.opts if isinstance(param, click.Option)}
        for name in names:
            if name.partition("=")[0] in known and not os.path.lexists(name):
                why = "was taken for the name of a file, because it stands after --"
                ctx.fail(f"{name} {why}. Write options before --")

    def _dashed(self, given: list[str], unknown: str) -> str | None:
        """Return the name of a model that was read as the unknown option, or None if there is none.

        ``-hero.glb`` is read as the options -h, -e … ``-ohero.glb`` is -o and its value.
        """
        valued = {
            name
            for param in self.params
            if isinstance(param, click.Option) and not param.is_flag and not param.count
            for name in param.opts
        }
        for name in given:
            is_meant = name[:2] not in valued and unknown.strip("-") in name
            if name.startswith("-") and name.lower().endswith(SUFFIXES) and is_meant:
                return name
        return None

    def _unexpected(self, names: list[str]) -> str:
        """Return the message for names that the command does not take."""
        message = f"unexpected {'argument' if len(names) == 1 else 'arguments'} {' '.join(names)}"
        if self._second is None or len(names) > 1:
            return message
        option, suffixes = self._second
        return f"{message}; write {option} {names[0]}" if names[0].lower().endswith(suffixes) else message

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command. -v and errors tell of the options that come from a configuration file."""
        configured = configured_in(ctx)
        if configured is None:
            return super().invoke(ctx)
        _let_the_command_line_win(ctx)
        if ctx.params.get("verbose") and not ctx.params.get("quiet"):
            click.echo(printable(configured.in_words()), err=True)
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            raise click.UsageError(configured.explained(error.message), error.ctx) from error

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, one group after the other."""
        for heading, rows in grouped(self, ctx):
            with formatter.section(heading):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")


def _let_the_command_line_win(ctx: click.Context) -> None:
    """Drop quiet of a file if -v is on the command line, and verbose of a file if -q is."""
    for typed, other in (("verbose", "quiet"), ("quiet", "verbose")):
        if (
            ctx.get_parameter_source(typed) is ParameterSource.COMMANDLINE
            and ctx.get_parameter_source(other) is ParameterSource.DEFAULT_MAP
        ):
            ctx.params[other] = 0


def grouped(command: click.Command, ctx: click.Context) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Yield each heading with its options and their help. Options of no group come first."""
    left: dict[str | None, tuple[str, str]] = {}
    for param in command.get_params(ctx):
        row = param.get_help_record(ctx) if isinstance(param, click.Option) else None
        if row:
            left["help" if "--help" in param.opts else param.name] = row
    known = {name for names in GROUPS.values() for name in names}
    others = [row for name, row in left.items() if name not in known]
    if others:
        yield "Options", others
    elsewhere = {name: heading for (of, name), heading in ELSEWHERE.items() if of == command.name}
    for heading, names in GROUPS.items():
        here = [name for name in names if elsewhere.get(name, heading) == heading]
        here += [name for name, place in elsewhere.items() if place == heading and name not in names]
        rows = [left[name] for name in here if name in left]
        if rows:
            yield heading, rows


def manual(main: click.Group) -> str:
    """Return the man page of all commands, in the macros of man(7)."""
    top = main.context_class(main, info_name=PAGE, **main.context_settings)
    lines = [
        f'.TH SKINBAKE 1 "" "skinbake {__version__}" "User Commands"',
        ".SH NAME",
        f"{PAGE} \\- {_plain(main.help or '')}",
        ".SH SYNOPSIS",
        f".B {PAGE}",
        "COMMAND [OPTIONS] [ARGUMENTS]",
        ".SH COMMANDS",
    ]
    for name in main.list_commands(top):
        command = main.get_command(top, name)
        if command is not None:
            lines += _command_lines(command, click.Context(command, top, info_name=name))
    return "\n".join([*lines, ".SH EXIT STATUS", _plain(main.epilog or ""), ""])


def _command_lines(command: click.Command, ctx: click.Context) -> Iterator[str]:
    yield f".SS {_plain(ctx.command_path)} {_plain(' '.join(command.collect_usage_pieces(ctx)))}"
    for number, paragraph in enumerate((command.help or "").split("\n\n")):
        if number:
            yield ".PP"
        yield _plain(" ".join(paragraph.split()))
    for heading, rows in grouped(command, ctx):
        yield ".PP"
        yield f".B {_plain(heading)}"
        for option, text in rows:
            yield from (".TP", f".B {_plain(option)}", _plain(text))
    examples = getattr(command, "examples", ())
    if examples:
        yield from (".PP", ".B Examples", ".PP", ".nf", *map(_plain, examples), ".fi")


def _plain(text: str) -> str:
    """Return text without a meaning for troff."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{escaped}" if escaped.startswith((".", "'")) else escaped
