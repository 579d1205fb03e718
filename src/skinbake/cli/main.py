"""The ``skinbake`` command: subcommands imported only when they run."""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
from contextlib import suppress
from threading import Event, current_thread, main_thread

import click

from skinbake import __version__
from skinbake.cli import exit_codes
from skinbake.errors import SkinbakeError

COMMANDS = {
    "bake": "Add α/β to every skinned primitive of glTF files.",
    "verify": "Check a baked file, and measure its lighting in degrees.",
    "shader": "Write the GLSL or WGSL that reads α/β.",
    "inspect": "Show what is skinned in a file, and what is baked into it.",
    "strip": "Write a file as it was before bake.",
    "cost": "Multiply-adds and bytes per vertex of the paper's algorithms.",
}


class LazyGroup(click.Group):
    """A group that knows its commands by name and imports a command's module when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order in which people meet them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command's module, None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"skinbake.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table, so that help imports none of them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 fine, 1 verification failed, 2 usage, 3 input cannot be read or is invalid, "
    "4 output cannot be written. With several files the worst is returned.",
)
@click.version_option(__version__, prog_name="skinbake")
def main() -> None:
    """Correct lighting for skinned glTF models: bake skin-weight gradients into vertex attributes."""


def entry_point() -> None:
    """Run the command line; nothing that a file, a disk or a terminal can do ends in a traceback."""
    # Nothing here is worth a thread of numpy's linear algebra, and those it starts cost a tenth of a second.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # α on a terminal that knows no Greek
    interrupted = _watch_for_interrupts()
    try:
        sys.exit(main(prog_name="skinbake", standalone_mode=False))
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except click.Abort:
        sys.exit(exit_codes.INTERRUPTED)
    except SkinbakeError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(exit_codes.of_error(error))
    except Exception as error:
        if interrupted.is_set():  # in an import Ctrl-C comes out as an ImportError
            sys.exit(exit_codes.INTERRUPTED)
        import logging  # a sixth of the time of --help

        logging.getLogger(__name__).debug("where it failed", exc_info=True)
        click.echo(
            f"error: skinbake failed where it should not: {type(error).__name__}: {error}\n"
            "Please report it with the file that caused it; -vv shows where.",
            err=True,
        )
        sys.exit(exit_codes.INPUT)
    finally:
        _settle(sys.stdout)
        _settle(sys.stderr)


def _watch_for_interrupts() -> Event:
    """Return an event that Ctrl-C sets before it raises KeyboardInterrupt as ever."""
    interrupted = Event()

    def note(signum: int, frame: object) -> None:
        interrupted.set()
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler and current_thread() is main_thread():
        signal.signal(signal.SIGINT, note)
    return interrupted


def _settle(stream: object) -> None:
    """Let go of what a stream could not write, lest the interpreter trips over it at its end."""
    if not isinstance(stream, io.TextIOWrapper):
        return
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
