"""Time by stage, in seconds, and word of each stage. Both only if a caller asks for them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

T = TypeVar("T")

WRITTEN = "written"
"""The word that the output of a file is in place. What follows does not change it."""

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


class Told(NamedTuple):
    """Word of work on a file: its stage, and how many steps of how many are done (0 of 0: it has none)."""

    source: str
    stage: str = ""
    done: int = 0
    total: int = 0


Listener = Callable[[Told], None]
"""A function that hears of the work. It is called often, and must return at once."""


@dataclass(slots=True)
class _Hearing:
    """A listener, and the file and the stage that it heard of last."""

    listener: Listener
    told: Told


_hearing: ContextVar[_Hearing | None] = ContextVar("_hearing", default=None)


@contextmanager
def heard(listener: Listener) -> Iterator[None]:
    """Tell a listener of the work in the block, on this thread."""
    token = _hearing.set(_Hearing(listener, Told("")))
    try:
        yield
    finally:
        _hearing.reset(token)


def is_heard() -> bool:
    """Tell whether anyone listens."""
    return _hearing.get() is not None


def tell(told: Told) -> None:
    """Pass on word of work, for example from another process."""
    hearing = _hearing.get()
    if hearing is not None:
        hearing.told = told
        hearing.listener(told)


def tell_steps(done: int, total: int) -> None:
    """Tell how many steps of the present stage are done."""
    hearing = _hearing.get()
    if hearing is not None:
        tell(Told(hearing.told.source, hearing.told.stage, done, total))


def tell_written() -> None:
    """Tell that the output of the present file is in place."""
    hearing = _hearing.get()
    if hearing is not None:
        tell(Told(hearing.told.source, WRITTEN))


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
    """Count the block's time as that of a stage, and tell of it. Both cost almost nothing unasked."""
    hearing = _hearing.get()
    # Between the first and the last step, the stage alternates with others many times a second.
    if hearing is not None and not 0 < hearing.told.done < hearing.told.total:
        tell(Told(hearing.told.source, name))
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
