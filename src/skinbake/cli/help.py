"""The help of the commands: options in groups, examples at the end; completion; and a man page of it all.

``python -m skinbake.cli.help`` prints the page.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import click
from click.core import ParameterSource

from skinbake.cli.configuration import CHOOSES_FILE, configured_in, load
from skinbake.cli.options import DeclaredOption, PathName
from skinbake.cli.terminal import stdout_told
from skinbake.errors import ChoiceError, printable
from skinbake.options import OPTIONS, PATHS, on_command_line
from skinbake.version import __version__
from skinbake.wording import SUFFIXES

PAGE = "skinbake"

LAST = "Messages"
"""The heading of --help, which is click's."""

EVERYTHING = "skinbake.help_all"
"""The key in a context's meta that has help show every option."""


class Helpful(click.Command):
    """A command whose help has its options in groups, and whose options a configuration file can set.

    ``words`` are those that are known only at run time, by option. ``examples`` end the help, one a line.
    ``usual`` are the names of the options that --help shows; none: all of them. --help-all, completion, the
    man page and the reference show all. ``second`` is the option that a user means by a name more than the
    command takes, and the suffixes of such names.
    """

    def __init__(
        self,
        name: str,
        *arguments: Any,
        words: Mapping[str, Sequence[str]] | None = None,
        examples: tuple[str, ...] = (),
        usual: Collection[str] = (),
        second: tuple[str, tuple[str, ...]] | None = None,
        **of_click: Any,
    ) -> None:
        """Take what the class describes, besides the parameters of click."""
        self.examples, self._second = examples, second
        self.usual = usual
        super().__init__(name, *arguments, **of_click)
        for param in self.params:
            if (param.metavar or "").strip("[].") in PATHS:
                param.type = PathName("file")
        for declared in OPTIONS[name]:
            option = DeclaredOption(declared, (words or {}).get(declared.name))
            if option.name in CHOOSES_FILE:
                option.callback, option.is_eager, option.expose_value = load, True, False
            self.params.append(option)
        if usual:
            told = f"Show all {len(OPTIONS[name])} options and exit."
            every = click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all, help=told
            )
            self.params.append(every)

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
            # ``-hero.glb`` is read as the options -h, -e … ``-ohero.glb`` is -o and its value.
            valued = {
                name
                for param in self.params
                if isinstance(param, click.Option) and not param.is_flag and not param.count
                for name in param.opts
            }
            for name in given:
                is_meant = name[:2] not in valued and error.option_name.strip("-") in name
                if name.startswith("-") and name.lower().endswith(SUFFIXES) and is_meant:
                    ctx.fail(f"{error.message} A name that begins with - is written ./{name}")
            raise
        ctx.allow_extra_args = False
        if not ctx.resilient_parsing:
            # Options after ``--`` were read as names of files.
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
            if left:
                message = f"unexpected {'argument' if len(left) == 1 else 'arguments'} {' '.join(left)}"
                option, suffixes = self._second or ("", ())
                is_second = len(left) == 1 and left[0].lower().endswith(suffixes)
                ctx.fail(f"{message}; write {option} {left[0]}" if is_second else message)
        return left

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command. -v and errors tell of the options that come from a configuration file."""
        configured = configured_in(ctx)
        if configured is not None:
            # The command line's -v drops quiet of a configuration file, and -q its verbose.
            for typed, other in (("verbose", "quiet"), ("quiet", "verbose")):
                if (
                    ctx.get_parameter_source(typed) is ParameterSource.COMMANDLINE
                    and ctx.get_parameter_source(other) is ParameterSource.DEFAULT_MAP
                ):
                    ctx.params[other] = 0
            if ctx.params.get("verbose") and not ctx.params.get("quiet"):
                keys = ", ".join(str(setting.keys[-1]) for setting in configured.settings.values())
                name = configured.configuration.name
                click.echo(printable(f"{name} sets {keys}" if keys else name), err=True)
        try:
            return super().invoke(ctx)
        except ChoiceError as error:
            if error.option not in {param.name for param in self.params}:
                raise  # a variable of the environment
            # The error in words of the command line, with the places of the options that a file has set.
            message = error.worded(on_command_line)
            places = [
                configured.settings[name].keys
                for name in dict.fromkeys(error.options)
                if configured is not None and ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP
            ]
            if configured is not None and places:
                told = [f"{configured.configuration.place(one)} sets {one[-1]}" for one in places]
                message += f" ({', '.join(told)}; --no-config leaves it out)"
            raise click.UsageError(message, ctx) from error

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, one group after the other."""
        shown = () if ctx.meta.get(EVERYTHING) else self.usual
        for heading, rows in grouped(self, ctx, shown):
            with formatter.section(heading):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")


def _show_all(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        ctx.meta[EVERYTHING] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


def grouped(
    command: click.Command, ctx: click.Context, names: Collection[str] = ()
) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Yield each heading with its options and their help, as they are declared; ``names``: only these."""
    headings: dict[str, list[tuple[str, str]]] = {}
    for param in command.get_params(ctx):
        declared = param.declared if isinstance(param, DeclaredOption) else None
        is_left_out = declared is not None and names and declared.name not in names
        row = param.get_help_record(ctx) if isinstance(param, click.Option) and not is_left_out else None
        if row:
            headings.setdefault(declared.heading if declared else LAST, []).append(row)
    yield from headings.items()


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
            ctx = click.Context(command, top, info_name=name)
            usage = " ".join(command.collect_usage_pieces(ctx))
            lines.append(f".SS {_plain(ctx.command_path)} {_plain(usage)}")
            for number, paragraph in enumerate((command.help or "").split("\n\n")):
                lines += [".PP"] if number else []
                lines.append(_plain(" ".join(paragraph.split())))
            for heading, rows in grouped(command, ctx):
                lines += [".PP", f".B {_plain(heading)}"]
                for option, text in rows:
                    lines += [".TP", f".B {_plain(option)}", _plain(text)]
            examples = getattr(command, "examples", ())
            lines += [".PP", ".B Examples", ".PP", ".nf", *map(_plain, examples), ".fi"] if examples else []
    return "\n".join([*lines, ".SH EXIT STATUS", _plain(main.epilog or ""), ""])


def _plain(text: str) -> str:
    """Return text without a meaning for troff."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{escaped}" if escaped.startswith((".", "'")) else escaped


if __name__ == "__main__":
    from skinbake.cli.main import main

    click.echo(manual(main), nl=False)
