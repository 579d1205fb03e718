"""The common part of all targets for atheris: their start, and the exceptions that are answers."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

MISSING = "atheris is not installed: pip install 'skinbake[fuzz]' (Linux, CPython)"


def is_here() -> bool:
    """Tell whether atheris can be imported."""
    return importlib.util.find_spec("atheris") is not None


def tolerant(target: Callable[[bytes], object]) -> Callable[[bytes], None]:
    """Return a target that takes skinbake's own errors for answers."""
    from skinbake.errors import SkinbakeError

    def run(data: bytes) -> None:
        with suppress(SkinbakeError):  # a refusal is an answer
            target(data)

    return run


def fuzz(load: Callable[[], Callable[[bytes], object]]) -> None:
    """Fuzz what ``load`` imports, all of skinbake that it imports instrumented; arguments are libFuzzer's."""
    if not is_here():
        sys.exit(MISSING)
    atheris: Any = __import__("atheris")
    with atheris.instrument_imports(include=["skinbake"]):
        target = load()
    atheris.Setup(sys.argv, tolerant(target))
    atheris.Fuzz()
