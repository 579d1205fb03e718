"""The calls of a function while a test runs: how much work was done, whatever the time."""

from __future__ import annotations

from typing import Any

import pytest


def count_calls(monkeypatch: pytest.MonkeyPatch, module: object, name: str) -> list[tuple[Any, ...]]:
    """Return a list that gets the arguments of each call of a module's function, which works as before."""
    function = getattr(module, name)
    calls: list[tuple[Any, ...]] = []

    def counted(*given: Any, **named: Any) -> Any:
        calls.append(given)
        return function(*given, **named)

    monkeypatch.setattr(module, name, counted)
    return calls
