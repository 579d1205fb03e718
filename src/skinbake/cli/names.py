"""The kind of file that the name of an input shows."""

from __future__ import annotations

from pathlib import Path

import click

from skinbake.urls import SUFFIXES
from skinbake.wording import not_gltf

STDIO = "-"


def check_readable_suffix(source: str) -> None:
    """Raise click.UsageError if an input's name does not show its kind of file."""
    if source != STDIO and Path(source).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{source}: {not_gltf(source)}")
