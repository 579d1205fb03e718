"""Which file goes where, checked before anything is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

STDIO = "-"
SUFFIXES = (".glb", ".gltf", ".vrm")


def check_readable_suffix(source: str) -> None:
    """Raise click.UsageError where an input's name does not say which kind of file it is."""
    if source != STDIO and Path(source).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{source}: expected a name that ends in {', '.join(SUFFIXES)}, or -")


def check_target(source: str, target: str, *, instead: str = "use --in-place to replace it") -> None:
    """Raise click.UsageError where the target has no known suffix, or is the input itself.

    ``instead`` is what to do in the latter case.
    """
    if target == STDIO:
        return
    if Path(target).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{target}: expected a name that ends in {', '.join(SUFFIXES)}, or -")
    if source != STDIO and _same_file(source, target):
        raise click.UsageError(f"{target} is the input; {instead}")


def _same_file(first: str, second: str) -> bool:
    """Tell whether two names are one file; names that no disk takes are none."""
    try:
        return Path(first).samefile(second)
    except (OSError, ValueError):
        return False


def pair_up(inputs: Sequence[str], folder: Path) -> list[tuple[str, str | None]]:
    """Return each input with its place in ``folder``; click.UsageError where two would be the same."""
    pairs: list[tuple[str, str | None]] = []
    taken: dict[str, str] = {}
    for source in dict.fromkeys(inputs):
        if source == STDIO:
            raise click.UsageError("--out-dir needs inputs that have a name; use -o for stdin")
        name = Path(source).name
        if name in taken:
            raise click.UsageError(f"{taken[name]} and {source} would both become {folder / name}")
        taken[name] = source
        check_target(source, str(folder / name))
        pairs.append((source, str(folder / name)))
    return pairs
