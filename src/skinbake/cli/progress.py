"""The progress of slow work: a bar on stderr if it is a terminal, with -v a line at times in a log."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import PurePath
from types import TracebackType
from typing import Any

from skinbake.cli.console import Console
from skinbake.errors import printable

SHOWN_AFTER = 2.0
"""Seconds of work before anything is shown."""

LINES_EVERY = 10.0
"""Seconds between two lines in a log."""

REFRESH_EVERY = 0.1
"""Seconds between two pictures of the bar, and between two prints above it."""


class Progress:
    """A bar that appears when work takes long, and disappears when it is done. Messages stand above it."""

    def __init__(self, say: Console) -> None:
        self._say = say
        self._started = self._shown = self._logged = time.monotonic()
        self._bar: Any = None
        self._tasks: dict[str, Any] = {}
        self._held: list[Callable[[], None]] = []

    def __enter__(self) -> Progress:
        """Begin to count the time."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the bar, and print the messages that were held back."""
        self._pause()

    def print(self, action: Callable[[], None]) -> None:
        """Print a message without disturbing the bar: now, or together with messages that follow soon."""
        if self._bar is None:
            action()
        else:
            self._held.append(action)

    def step(self, what: str, done: int, total: int) -> None:
        """Note the progress of one piece of work."""
        now = time.monotonic()
        if self._say.verbosity < 0 or now - self._started < SHOWN_AFTER:
            return
        if self._bar is None:
            self._bar = _bar(self._say)
        if self._bar.disable:
            self._log(what, done, total, now)
            self._pause()
            return
        if what not in self._tasks:
            from rich.markup import escape

            # A whole path would leave no room for the bar.
            self._tasks[what] = self._bar.add_task(
                escape(printable(PurePath(what).name)), rate="", total=total
            )
        if done == total or now - self._shown >= REFRESH_EVERY:
            self._shown = now
            if self._held:
                self._pause()
            rate = f"{done / (now - self._started):.3g}/s"
            self._bar.start()
            self._bar.update(self._tasks[what], completed=done, total=total, rate=rate, refresh=True)

    def _pause(self) -> None:
        if self._bar is not None:
            self._bar.stop()
        held, self._held = self._held, []
        for action in held:
            action()

    def _log(self, what: str, done: int, total: int, now: float) -> None:
        if self._say.verbosity < 1 or now - self._logged < LINES_EVERY or done == total:
            return
        self._logged = now
        spent = now - self._started
        left = spent / done * (total - done) if done else 0.0
        self._say.details([f"{what}: {done:,} of {total:,}, {done / spent:.3g}/s, {left:.0f} s left"])


def _bar(say: Console) -> Any:
    from rich.console import Console as RichConsole
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar

    stderr = RichConsole(stderr=True, no_color=say.color is False)
    return Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=stderr,
        transient=True,
        auto_refresh=False,  # no thread: workers may start, and interrupts come, at any time
        redirect_stdout=False,
        redirect_stderr=False,
        disable=not stderr.is_terminal,
    )
