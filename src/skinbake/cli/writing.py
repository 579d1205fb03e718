"""The way of writing outputs and reports, from the options of a command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from skinbake.cli import exit_codes
from skinbake.errors import OutputError, Place, printable

if TYPE_CHECKING:
    from skinbake.cli.console import Console
    from skinbake.cli.given import Given
    from skinbake.gltf.output import Writing


def writing_of(given: Given) -> Writing:
    """Return how outputs are written, from the options of the command line."""
    from skinbake.gltf.output import Writing

    return Writing(
        dry_run=given.get("dry_run", False),
        sync=not given["no_sync"],
        pack=given.get("pack", False),
        lists_read=bool(given.get("depfile")),
    )


def write_report(path: str, text: str, say: Console, *, sync: bool) -> int:
    """Write the file of a report, whole or not at all. Return the exit code."""
    from skinbake.files.writing import write_file

    data, file = text.encode("utf-8", "surrogateescape"), Path(path)
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            file.write_bytes(data)  # for example a pipe
        else:
            write_file([data], path, sync=sync)
    except OSError as error:
        say.error(OutputError(f"cannot be written: {error.strerror}", Place(path)))
        return exit_codes.OUTPUT
    except OutputError as error:
        message = error.message.removeprefix("cannot be written: ")
        say.error(OutputError(f"cannot be written: {message}", Place(path)))
        return exit_codes.OUTPUT
    return exit_codes.OK


def tell_of_report(path: str, given: Given, say: Console, *, pages: Path | None = None) -> None:
    """Say that a report was written, and where its pages are, unless the result on stdout is JSON."""
    if not given["as_json"]:
        say.written(f"{printable(path)}: written{f', its pages in {printable(str(pages))}' if pages else ''}")
