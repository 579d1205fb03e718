"""Time by stage, in seconds. Stages are recorded only if a caller asks for them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")

OTHER = "other"
"""The stage for time outside any recorded stage."""


class Timings:
    """Seconds by stage, in the order in which stages first ended.

    A stage inside another counts only for itself. The clock of the outer stage stands still meanwhile. So the
    seconds add up to the time that was spent in any stage.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner: list[float] = []

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        self._inner.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            inner = self._inner.pop()
            if self._inner:
                self._inner[-1] += spent
            self.seconds[name] = self.seconds.get(name, 0.0) + spent - inner


_recording: ContextVar[Timings | None] = ContextVar("_recording", default=None)


@contextmanager
def recorded() -> Iterator[Timings]:
    """Record the stages that run in the block, on this thread."""
    timings = Timings()
    token = _recording.set(timings)
    try:
        yield timings
    finally:
        _recording.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Count the block's time as that of a stage. It costs almost nothing if no caller records."""
    timings = _recording.get()
    if timings is None:
        yield
        return
    with timings._stage(name):
        yield


def timed(call: Callable[[], T]) -> tuple[T, dict[str, float]]:
    """Return the result of the call, and its seconds by stage. ``other`` is the time outside any stage."""
    start = time.perf_counter()
    with recorded() as timings:
        result = call()
    spent = time.perf_counter() - start
    return result, {**timings.seconds, OTHER: max(0.0, spent - sum(timings.seconds.values()))}
