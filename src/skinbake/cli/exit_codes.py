"""Exit codes: the worst of several files is the one returned."""

from __future__ import annotations

import signal
from collections.abc import Sequence

from skinbake.errors import ChoiceError, OutputError, ReaderGoneError, SkinbakeError

OK = 0
VERIFICATION = 1
USAGE = 2
INPUT = 3
OUTPUT = 4
INTERRUPTED = 130
"""By Ctrl-C, as shells have it."""

TERMINATED = 143
"""By SIGTERM, as shells have it."""

READER_GONE = 141
"""What a command returns that SIGPIPE ends, as shells have it."""


def of_error(error: SkinbakeError) -> int:
    """Return the exit code that an error stands for."""
    if isinstance(error, ChoiceError):
        return USAGE
    if isinstance(error, ReaderGoneError):
        return READER_GONE
    return OUTPUT if isinstance(error, OutputError) else INPUT


def of_signal(received: Sequence[int]) -> int:
    """Return the exit code of a command that these signals have ended, the first of which counts."""
    return TERMINATED if received and received[0] == signal.SIGTERM else INTERRUPTED
