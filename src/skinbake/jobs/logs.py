"""The log messages that -v prints on stderr, in this process and in workers."""

from __future__ import annotations

import logging

from skinbake.errors import printable_lines


class _Printable(logging.Formatter):
    """Escape the control characters that a name from a file could send to a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return printable_lines(super().format(record))


def log_to_stderr(level: int) -> None:
    """Print log messages of this level and above, unless logging is configured already."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Printable("%(name)s: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])
