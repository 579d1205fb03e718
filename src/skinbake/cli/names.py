"""What the name of an input says."""

from __future__ import annotations

from pathlib import Path

import click

from skinbake.urls import SUFFIXES

STDIO = "-"


def check_readable_suffix(source: str) -> None:
    """Raise click.UsageError where an input's name does not say which kind of file it is."""
    if source != STDIO and Path(source).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{source}: expected a name that ends in {', '.join(SUFFIXES)}, or -")
