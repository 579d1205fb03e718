"""The ``skinbake`` command: subcommands imported only when they run."""

from __future__ import annotations

import errno
import importlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.terminal import stdout_told
from skinbake.errors import SkinbakeError, printable_lines
from skinbake.signals import ENDING
from skinbake.version import FILE_FORMAT, __version__

COMMANDS = {
    "example": "Write a small model to try the other commands on.",
    "bake": "Add α/β to every skinned primitive of glTF files.",
    "verify": "Check a baked file, and measure its lighting in degrees.",
    "view": "Show a file in the browser: standard and accurate lighting side by side.",
    "render": "Draw pictures of a file without a browser.",
    "shader": "Write the GLSL, WGSL or HLSL that reads α/β.",
    "inspect": "Show the skinned primitives of a file, and their bakes.",
    "strip": "Restore a file from before its bake.",
    "cost": "Count multiply-adds and bytes per vertex of the paper's algorithms.",
    "config": "Show the value of each option, and where it comes from.",
}


class LazyGroup(click.Group):
    """A group that knows its commands by name. It imports a command's module when the command is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order in which a new user meets them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command's module, or return None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"skinbake.cli.{cmd_name}").command
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read what stands before the command. For the option of a command, say where it stands."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if error.possibilities:
                raise
            ctx.fail(f"{error.format_message()} The options of a command stand after its name")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; ``help bake`` is ``bake --help``. For an unknown name, ask about the nearest."""
        if args[0] == "help":
            if args[1:]:
                args = [args[1], "--help-all" if "--help-all" in args else "--help"]
            elif ctx.resilient_parsing:  # a shell completes the name of a command
                return None, None, []
            else:
                click.echo(ctx.get_help(), color=ctx.color)
                ctx.exit()
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            from skinbake.wording import SUFFIXES, did_you_mean

            if args[0].lower().endswith(SUFFIXES):
                ctx.fail(f"{error.message} A command comes before the file, like skinbake view {args[0]}")
            meant = did_you_mean(args[0], COMMANDS)
            if meant:
                ctx.fail(f"{error.message} {meant[0].upper()}{meant[1:]}")
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table, so that help imports no command."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def make_context(self, *arguments: Any, **options: Any) -> click.Context:
        """Make the context. --help and --version print and end in this method."""
        with stdout_told(), _readers_may_leave():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        with _readers_may_leave():
            return super().invoke(ctx)


@contextmanager
def _readers_may_leave() -> Iterator[None]:
    """End with the right code if the reader of stdout has left. click would return 1."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.EPIPE:
            raise
        raise SystemExit(exit_codes.READER_GONE) from error


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 fine, 1 verification failed, 2 usage, 3 input cannot be read or is invalid, "
    "4 output cannot be written, 129 the terminal was closed, 130 Ctrl-C, 141 the reader of stdout has "
    "left, 143 SIGTERM. "
    "With several files the worst is returned.",
)
@click.version_option(
    __version__, prog_name="skinbake", message=f"%(prog)s, version %(version)s, file format {FILE_FORMAT}"
)
def main() -> None:
    """Correct lighting for skinned glTF models: bake skin-weight gradients into vertex attributes."""


def entry_point() -> None:
    """Run the command line. No fault of a file, a disk or a terminal ends in a traceback."""
    # A standard stream that is closed becomes the null device.
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # it gets the lowest free number, this one
    if sys.stderr is None:  # so messages, and a look whether it is a terminal, need no care
        sys.stderr = os.fdopen(2, "w", closefd=False)
    # No work here needs a thread of numpy's linear algebra, and its threads take a tenth of a second to
    # start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # α on a terminal without Greek letters
    # Signals that end the work are noted before they are raised as exceptions.
    received: list[int] = []

    def note(signum: int, frame: object) -> None:
        received.append(signum)
        raise _Stopped

    for number in ENDING if current_thread() is main_thread() else ():
        if signal.getsignal(number) in {signal.SIG_DFL, signal.default_int_handler}:
            signal.signal(number, note)  # otherwise the signal is to be ignored
    code = _code(received)
    # Further signals end the process without a word: nothing is left to undo.
    for number in ENDING if current_thread() is main_thread() else ():
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    for stream in (sys.stdout, sys.stderr):
        if not isinstance(stream, io.TextIOWrapper):
            continue
        try:
            stream.flush()
        except (OSError, ValueError) as error:
            # Text that it could not write is dropped, so that exit does not fail.
            with suppress(OSError):  # a stream without a descriptor has nothing to flush at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            code = exit_codes.READER_GONE if isinstance(error, BrokenPipeError) else code
    sys.exit(code)


def _code(received: list[int]) -> int:
    """Return the exit code of the command line. ``received`` lists the signals that came."""
    try:
        return int(main(prog_name="skinbake", standalone_mode=False) or exit_codes.OK)
    except SystemExit as end:
        return int(end.code or exit_codes.OK)
    except click.ClickException as error:
        text = io.StringIO()
        error.show(file=text)
        return _said(text.getvalue().removesuffix("\n"), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        return exit_codes.of_signal(received)
    except Exception as error:
        # A signal becomes an ImportError during an import. A closed terminal takes no last words.
        return exit_codes.of_signal(received) if received else _failed(error)


def _failed(error: Exception) -> int:
    """Report an error, which may be a defect of skinbake, and return the exit code."""
    if isinstance(error, SkinbakeError):
        return _said(f"error: {error}", exit_codes.of_error(error))
    if isinstance(error, FileNotFoundError):
        try:
            Path.cwd()
        except OSError:  # no relative path has a meaning
            return _said("error: the current folder was deleted: change to another one", exit_codes.INPUT)
    import logging  # it takes a sixth of the time of --help

    logging.getLogger(__name__).debug("where it failed", exc_info=True)
    return _said(
        f"error: skinbake failed where it should not: {type(error).__name__}: {error}\n"
        "Please report it with the file that caused it; -vv shows where.",
        exit_codes.INPUT,
    )


def _said(text: str, code: int) -> int:
    """Print why the command ends, and return its code, or another code if the reader has left."""
    try:
        click.echo(printable_lines(text), err=True)
    except OSError as error:
        return exit_codes.READER_GONE if error.errno == errno.EPIPE else code
    return code


class _Stopped(KeyboardInterrupt):
    """A signal of ``ENDING``. KeyboardInterrupt itself kills Python once it left an exec, even if caught."""
