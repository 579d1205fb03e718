"""The kind of file that the name of an input shows."""

from __future__ import annotations

import os
from pathlib import Path

import click

from skinbake.files.urls import on_disk
from skinbake.wording import SUFFIXES, not_gltf

STDIO = "-"


def check_readable_suffix(source: str) -> None:
    """Raise click.UsageError if an input's name does not show its kind of file, or is that of a folder."""
    if os.path.isdir(source):  # noqa: PTH112  # pathlib fails for long names
        raise click.UsageError(f"{source} is a folder: name one file in it")
    if source != STDIO and Path(source).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{source}: {not_gltf(source)}")


def path_on_disk(source: str) -> str:
    """Return the path of an input of a command that reads no URLs. A ``file:`` URL is a path too.

    Raises click.UsageError for another URL, and as ``check_readable_suffix`` does.
    """
    path = on_disk(source)
    if path is None:
        raise click.UsageError(
            f"{source}: this command reads no URLs. Copy the file, and the files that it names, to this disk"
        )
    check_readable_suffix(path)
    return path
