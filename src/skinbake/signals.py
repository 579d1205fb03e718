"""The signals by which a terminal, a shell or a service ends the work, and how to put them off."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

ENDING = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
    if name in signal.Signals.__members__
)
"""Ctrl-C, the request to end, and the end of the terminal. What is begun is undone first."""

_putting_off: list[bool] = []
"""Not empty while the main thread delays interrupts."""


@contextmanager
def interrupts_put_off() -> Iterator[None]:
    """Delay the signals that end the work until the block is done, so that the clean-up knows all new files.

    This uses Python's handlers, not a signal mask. A mask holds for one thread, and numpy has more threads.
    Handlers run only in the main thread.
    """
    if threading.current_thread() is not threading.main_thread() or _putting_off:
        yield
        return
    late: list[int] = []
    before = {
        number: handler
        for number in ENDING
        if (handler := signal.getsignal(number)) not in {None, signal.SIG_IGN}
    }
    try:
        for number in before:
            signal.signal(number, lambda number, frame: late.append(number))
        _putting_off.append(True)
        yield
    finally:
        _putting_off.clear()
        for number, handler in before.items():
            signal.signal(number, handler)
        for received in dict.fromkeys(late):
            signal.raise_signal(received)
