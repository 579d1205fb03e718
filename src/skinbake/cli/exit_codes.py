"""Exit codes. For several files, the worst code is returned."""

from __future__ import annotations

from collections.abc import Sequence

from skinbake.errors import ChoiceError, OutputError, ReaderGoneError, SkinbakeError

OK = 0
VERIFICATION = 1
USAGE = 2
INPUT = 3
OUTPUT = 4
HUNG_UP, INTERRUPTED, READER_GONE, TERMINATED = 129, 130, 141, 143
"""The codes after SIGHUP, Ctrl-C, SIGPIPE and SIGTERM, as in shells: 128 and the number of the signal."""


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
