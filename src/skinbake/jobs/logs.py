"""What -v has modules tell, on stderr, in this process and in workers."""

from __future__ import annotations

import logging

from skinbake.errors import printable_lines


class _Printable(logging.Formatter):
    """Escapes what a name from a file could make a terminal do."""

    def format(self, record: logging.LogRecord) -> str:
        return printable_lines(super().format(record))


def log_to_stderr(level: int) -> None:
    """Have log messages of this level and above printed, unless somebody has seen to it."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Printable("%(name)s: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])
