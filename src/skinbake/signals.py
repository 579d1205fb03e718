"""The signals that end the work on the way out of a terminal, a shell or a service."""

from __future__ import annotations

import signal

ENDING = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
    if name in signal.Signals.__members__
)
"""Ctrl-C, the request to end, and the end of the terminal. What is begun is undone first."""
