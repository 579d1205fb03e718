"""The progress of slow work: bars on stderr if it is a terminal, with -v a line at times in a log."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import PurePath
from types import TracebackType
from typing import Any

from skinbake.cli.console import Console
from skinbake.errors import printable
from skinbake.timing import Told

SHOWN_AFTER = 1.0
"""Seconds of work before anything is shown, unless the work is known to be long."""

LINES_EVERY = 10.0
"""Seconds between two lines in a log."""

REFRESH_EVERY = 0.1
"""Seconds between two pictures of the bars, and between two prints above them."""


class Progress:
    """Bars that appear when work takes long, and disappear when it is done. Messages stand above them.

    Of several files, one bar counts those that are done, and each file in work has a bar of its own.
    """

    def __init__(self, say: Console, files: int, *, at_once: bool = False) -> None:
        self._say, self._total, self._done = say, files, 0
        self._due = 0.0 if at_once else SHOWN_AFTER
        self._started = self._logged = time.monotonic()
        self._shown = self._started - REFRESH_EVERY
        self._bar: Any = None
        self._tasks: dict[str, Any] = {}
        self._working: dict[str, Told] = {}
        self._held: list[Callable[[], None]] = []

    def __enter__(self) -> Progress:
        """Begin to count the time, and show the bar of long work."""
        if self._total > 1:
            self._show(at_once=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the bars, and print the messages that were held back."""
        self.pause()

    def print(self, action: Callable[[], None]) -> None:
        """Print a message without disturbing the bars: now, or together with messages that follow soon."""
        if self._bar is None or self._is_log:
            action()
            return
        self._held.append(action)
        if self._total > 1:
            self._show(at_once=False)

    def hear(self, told: Told) -> None:
        """Note the progress of the work on one file."""
        self._working[told.source] = told
        if self._is_log and self._total > 1:
            return
        # Nothing is heard of a stage until it ends, so each one of a single file is drawn.
        begins = told.total == 0 and self._total == 1
        self._show(at_once=begins or 0 < told.total == told.done)

    def finish(self, source: str) -> None:
        """Note that a file is done, though its result may have to wait for those before it."""
        self._done += 1
        self._working.pop(source, None)
        if self._total > 1:
            self._show(at_once=self._done == self._total)

    @property
    def _is_log(self) -> bool:
        return self._bar is not None and self._bar.disable

    def _show(self, *, at_once: bool) -> None:
        now = time.monotonic()
        if self._say.verbosity < 0 or now - self._started < self._due:
            return
        if self._bar is None:
            # Where rich takes stderr for no terminal, it would show nothing, and its import takes a while.
            asked = any(os.environ.get(name) for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"))
            if self._say.verbosity < 1 and not asked and not sys.stderr.isatty():
                return
            self._bar = _bar(self._say)
        if self._bar.disable:
            self._log(now)
        elif at_once or now - self._shown >= REFRESH_EVERY:
            self._shown = now
            if self._held:
                self.pause()
            self._draw(now)

    def _draw(self, now: float) -> None:
        self._bar.start()
        if self._total > 1:
            rate = f"{self._done / (now - self._started):.3g}/s" if now > self._started else ""
            self._draw_row("files", "files", self._done, self._total, rate)
        for source in [source for source in self._tasks if source not in self._working and source != "files"]:
            self._bar.remove_task(self._tasks.pop(source))
        for source, told in self._working.items():
            # A whole path would leave no room for the bar.
            name = printable(PurePath(source).name)
            what = f"{name}: {told.stage}" if told.stage and not told.total else name
            self._draw_row(source, what, told.done, told.total)
        self._bar.refresh()

    def _draw_row(self, key: str, what: str, done: int, total: int, rate: str = "") -> None:
        from rich.markup import escape

        state = f"{done / total:>4.0%} {done:,}/{total:,} {rate}" if total else ""
        if key not in self._tasks:
            self._tasks[key] = self._bar.add_task(escape(what), state=state, total=total or None)
        self._bar.update(
            self._tasks[key], description=escape(what), completed=done, total=total or None, state=state
        )

    def pause(self) -> None:
        """Remove the bars until there is progress to show, and print the messages that were held back."""
        if self._bar is not None:
            self._bar.stop()
        held, self._held = self._held, []
        for action in held:
            action()

    def _log(self, now: float) -> None:
        if self._say.verbosity < 1 or now - self._logged < LINES_EVERY:
            return
        what, done, total = "files", self._done, self._total
        if self._total == 1:
            source, told = next(iter(self._working.items()))
            what, done, total = source, told.done, told.total
            if not total and told.stage:
                what = f"{source}: {told.stage}"
        if done == total > 0:
            return
        self._logged = now
        spent = now - self._started
        left = f", {done / spent:.3g}/s, {spent / done * (total - done):.0f} s left" if done else ""
        self._say.details([f"{what}: {done:,} of {total:,}{left}" if total else what])


def _bar(say: Console) -> Any:
    from rich.console import Console as RichConsole
    from rich.progress import (
        BarColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar

    stderr = RichConsole(stderr=True, no_color=say.color is False)
    return Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}"),
        TimeRemainingColumn(),
        console=stderr,
        transient=True,
        auto_refresh=False,  # no thread: workers may start, and interrupts come, at any time
        redirect_stdout=False,
        redirect_stderr=False,
        disable=not stderr.is_terminal,
    )
