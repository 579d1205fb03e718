"""Call the compiled loops with arrays of any shape, type and content.

What they refuse they must refuse by an exception of Python; whatever they take, the sanitizers watch.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np

Array = Any
Call = tuple[Callable[..., Any], dict[str, Any], bool]
"""A loop, its arguments in order, and whether it takes them by name."""

SPECIAL = np.array(
    [0, -0.0, 1, -1, 1e30, -1e30, 1e300, 1e-300, 5e-324, 1e-39, np.nan, np.inf, -np.inf, 0.5, 1e-6, 3.4e38]
)
REFUSALS = (ValueError, TypeError, IndexError, BufferError, MemoryError, OverflowError)
VARIATIONS = 40


def executions(seed: int) -> int:
    """Call each loop with the arrays of a seed and variations of them; return how many calls that were."""
    from skinbake.gradients import _kernel

    random = np.random.default_rng(seed)
    with np.errstate(all="ignore"):
        return _varied(_kernel, _calls(_kernel, random), random)


def _varied(kernel: Any, calls: list[Call], random: np.random.Generator) -> int:
    """Make calls, first as they are, then with an argument or two that do not fit."""
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
            with contextlib.suppress(*REFUSALS, kernel.CollisionError):
                function(**given) if by_name else function(*given.values())
            done += 1
    return done


def _calls(kernel: Any, random: np.random.Generator) -> list[Call]:
    """Return each loop with arguments that fit together, mostly."""
    vertices = int(random.choice([0, 1, 2, 3, 5, 10, 40, 120]))
    slots = int(random.choice([1, 2, 4, 4, 4, 8, 12, 40]))
    triangles = int(random.choice([0, 1, 2, 5, 30, 150]))
    joints = int(random.choice([1, 4, 64, 70000]))
    floats = random.choice(["f4", "f8"])
    most = max(vertices, 1)
    positions = _floats(random, (vertices, 3), floats)
    corners = random.integers(0, most if random.random() < 0.95 else most + 3, (triangles, 3)).astype("u4")
    named = random.integers(-1 if random.random() < 0.7 else 0, joints, (vertices, slots)).astype("i4")
    weights = (
        np.abs(_floats(random, (vertices, slots), "f8"))
        if random.random() < 0.7
        else _floats(random, (vertices, slots), "f8")
    )
    if random.random() < 0.9:
        weights[named < 0] = 0
    free = random.random((vertices, slots)) < 0.4
    count = most if random.random() < 0.4 else int(random.integers(1, most + 1))
    classes = random.integers(0, count, vertices).astype("i4")
    if random.random() < 0.3:
        count, classes = vertices, np.arange(vertices, dtype="i4")
    has_frame = random.random() < 0.5
    frame = [_floats(random, (vertices if has_frame else 0, 3), floats) for _ in range(2)]
    primitives = int(random.choice([1, 1, 2, 3]))
    ends = np.sort(random.integers(0, vertices + 1, primitives)).astype("u8")
    ends[-1] = vertices
    surface = {
        "positions": positions,
        "triangles": corners,
        "joints": named,
        "weights": weights,
        "free": free,
        "classes": classes,
        "normals": _floats(random, (vertices, 3), floats),
        "tangents": frame[0],
        "bitangents": frame[1],
        "alpha": np.empty((vertices, slots - 1), "f4"),
        "beta": np.empty((vertices, slots - 1), "f4"),
        "adopted": np.zeros((vertices, slots), "i4"),
        "ends": ends,
        "sums": np.zeros((primitives, 4)),
        "class_count": count,
        "weighting": int(random.integers(0, 4)),
        "adopts": bool(random.integers(2)),
        "negligible": float(random.choice([0, 1e-3, np.nan])),
    }
    influences = {
        "joints": named,
        "weights": weights,
        "free": free,
        "adopting_sum": float(random.choice([0, 0.99, np.nan])),
        "tolerance": 1e-3,
        "least": float(random.choice([0, 2.0**-30, np.nan])),
    }
    areas = {
        "positions": positions,
        "triangles": corners,
        "mask": np.zeros(triangles, "?"),
        "least": float(random.choice([0, 1e-12, np.nan])),
    }
    table = [positions, named, corners, weights, named.astype("u8")][random.choice(5)]
    rows = {"rows": np.ascontiguousarray(table), "labels": np.zeros(len(table), "i4")}
    return [
        (kernel.bake_surface, surface, True),
        (kernel.normalise_influences, influences, False),
        (kernel.mark_proper, areas, False),
        (kernel.label_equal_rows, rows, False),
    ]


def _floats(random: np.random.Generator, shape: tuple[int, ...], dtype: str) -> Array:
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
