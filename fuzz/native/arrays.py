"""Call compiled loops with arrays of any shape, type and content.

What they refuse they must refuse by an exception of Python; whatever they take, the sanitizers watch.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

Array = Any
Call = tuple[Callable[..., Any], dict[str, Any], bool]
"""A loop, its arguments in order, and whether it takes them by name."""

SPECIAL = np.array(
    [0, -0.0, 1, -1, 1e30, -1e30, 1e300, 1e-300, 5e-324, 1e-39, np.nan, np.inf, -np.inf, 0.5, 1e-6, 3.4e38]
)
REFUSALS = (ValueError, IndexError, BufferError, MemoryError, OverflowError)
"""How a loop refuses arguments whose types are right."""

VARIATIONS = 40


def varied(
    calls: Sequence[Call], random: np.random.Generator, refusals: tuple[type[Exception], ...] = REFUSALS
) -> int:
    """Make calls, first as they are, then with an argument or two that do not fit. Return their number.

    As they are, all arguments must have the right names and types: a TypeError is a find then.
    """
    done = 0
    for variation in range(VARIATIONS):
        for function, arguments, by_name in calls:
            given = {
                name: value.copy() if isinstance(value, np.ndarray) else value
                for name, value in arguments.items()
            }
            if variation:
                for _ in range(random.integers(1, 3)):
                    name = list(given)[int(random.integers(len(given)))]
                    given[name] = _other(random, given[name])
            with contextlib.suppress(*refusals, *([TypeError] if variation else [])):
                function(**given) if by_name else function(*given.values())
            done += 1
    return done


def floats(random: np.random.Generator, shape: tuple[int, ...], dtype: str) -> Array:
    """Return floats: ordinary ones, special ones, whole ones, or ordinary ones with a few special."""
    kind = random.integers(4)
    values = random.normal(size=shape)
    if kind == 0:
        values = random.choice(SPECIAL, size=shape)
    elif kind == 1:
        values = np.round(values)
    elif kind == 2:
        values = np.where(random.random(shape) < 0.05, random.choice(SPECIAL, size=shape), values)
    return np.ascontiguousarray(values.astype(dtype))


def _other(random: np.random.Generator, value: Any) -> Any:
    """Return an argument that does not fit: another shape, type, content, layout or alignment."""
    if not isinstance(value, np.ndarray):
        return random.choice(np.array([-1, 0, 1, 5, 1000, 1e308, np.nan], object))
    kind = random.integers(14)
    if kind == 0:
        return value[:-1]
    if kind == 1:
        return value.astype(random.choice(["f2", "f4", "f8", "i4", "u4", "u8", "i8", "?", "u1"]))
    if kind == 2:
        return value.reshape(-1)
    if kind == 3:
        return value[::2]
    if kind == 4:
        return random.choice(np.array([b"", None, 0, "x", bytearray(16)], object))
    if kind == 5:
        return np.zeros((0, 0), value.dtype)
    if kind == 6:
        return np.asfortranarray(value)
    if kind == 7:
        return np.concatenate([value, value])
    if kind == 8:
        shifted = np.zeros(value.nbytes + 1, "u1")[1:]
        return shifted.view(value.dtype).reshape(value.shape) if value.nbytes else value
    if kind == 9:
        value.flags.writeable = False
        return value
    return _changed(random, value)


def _changed(random: np.random.Generator, value: Array) -> Array:
    """Return the array with a few extreme elements."""
    if not value.size or not value.flags.writeable:
        return value
    flat = value.reshape(-1)
    for _ in range(random.integers(1, 4)):
        at = random.integers(flat.size)
        if value.dtype.kind == "f":
            flat[at] = random.choice(SPECIAL)
        elif value.dtype.kind == "b":
            flat[at] = not flat[at]
        else:
            limits = np.iinfo(value.dtype)
            flat[at] = random.choice(
                np.array(
                    [limits.min, limits.max, 0, min(len(value), limits.max), limits.max - 1], value.dtype
                )
            )
    return value
