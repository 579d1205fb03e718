"""Process long arrays in pieces, so that temporary arrays stay in the processor's cache."""

from __future__ import annotations

from collections.abc import Iterator

ROWS = 1 << 14


def blocks(count: int, rows: int = ROWS) -> Iterator[slice]:
    """Yield slices that cover ``count`` rows in order."""
    for start in range(0, count, rows):
        yield slice(start, min(start + rows, count))
