"""Exit codes. For several files, the worst code is returned."""

from __future__ import annotations

import signal
from collections.abc import Sequence

from skinbake.errors import ChoiceError, OutputError, ReaderGoneError, SkinbakeError

OK = 0
VERIFICATION = 1
USAGE = 2
INPUT = 3
OUTPUT = 4
INTERRUPTED = 128 + signal.SIGINT
"""The code after Ctrl-C, as in shells."""

READER_GONE = 141
"""The code of a command that SIGPIPE ends, as in shells."""


def of_error(error: SkinbakeError | None) -> int:
    """Return the exit code for the error of a file or a command, None if it succeeded."""
    if error is None:
        return OK
    if isinstance(error, ChoiceError):
        return USAGE
    if isinstance(error, ReaderGoneError):
        return READER_GONE
    return OUTPUT if isinstance(error, OutputError) else INPUT


def of_signal(received: Sequence[int]) -> int:
    """Return the exit code of a command that these signals have ended, as in shells. The first counts."""
    return 128 + received[0] if received else INTERRUPTED
