"""Call the compiled loops of verify with arrays of any shape, type and content."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.native.arrays import SPECIAL, Array, Call, floats, varied


def executions(seed: int) -> int:
    """Call each loop with the arrays of a seed and variations of them; return how many calls that were."""
    from skinbake.truth import _loops

    random = np.random.default_rng(seed)
    with np.errstate(over="ignore", invalid="ignore"):  # special values are cast to other types
        of_loops = _blends, _turns, _normals, _errors
        return varied([call for calls in of_loops for call in calls(_loops, random)], random)


def _size(random: np.random.Generator, *further: int) -> int:
    return int(random.choice([0, 1, 2, 3, 5, 17, *further]))


def _places(random: np.random.Generator, shape: int | tuple[int, ...], count: int) -> Array:
    """Return indices below a count. Some are not."""
    beyond = 0 if random.random() < 0.9 else int(random.choice([1, 5, 2**30]))
    return random.integers(0, max(count, 1) + beyond, shape).astype("i4")


def _blends(loops: Any, random: np.random.Generator) -> list[Call]:
    """Return the loops that blend the rows of a table."""
    vertices, slots, poses = (_size(random, 40, 300) for _ in range(3))
    joints, forms, first_row = _size(random), int(random.choice([1, 2, 3])), int(random.integers(0, 3))
    normals = floats(random, (vertices, 3), "f8") if random.random() < 0.5 else None

    def arguments(count: int) -> dict[str, Any]:
        directions, changes = (
            floats(random, (count, vertices, size), "f8") if random.random() < 0.7 else None
            for size in (3, slots)
        )
        return {
            "joints": _places(random, (vertices, slots), joints),
            "weights": floats(random, (vertices, slots), "f8"),
            "points": floats(random, (vertices, 3), "f8"),
            "directions": directions,
            "changes": changes,
            "table": floats(random, (4 * joints, 3, poses), "f8"),
        }

    out = np.empty((forms, 3, vertices + 2, poses))
    crossed = {
        **arguments(2 if normals is None else 3),
        "normals": normals,
        "out": np.empty((3, vertices, poses)),
    }
    return [
        (loops.blend, {**arguments(forms), "out": out, "first_row": first_row}, False),
        (loops.blended_normals, crossed, False),
    ]


def _turns(loops: Any, random: np.random.Generator) -> list[Call]:
    """Return the loops of dual quaternions."""
    vertices, joints, poses = (_size(random, 40) for _ in range(3))
    slots = int(random.choice([0, 1, 2, 4, 9]))
    first, first_row = (int(random.integers(0, 3)) for _ in range(2))
    moved = {
        "motions": floats(random, (int(random.choice([8, 20])), joints, first + poses), "f8"),
        "scales": floats(random, (first + poses,), "f8") if random.random() < 0.5 else None,
        "joints": _places(random, (vertices, slots), joints),
        "weights": floats(random, (vertices, slots), "f8"),
        "positions": floats(random, (vertices, 3), "f8"),
        "out": np.empty((3, vertices + 2, poses)),
    }
    turned = {
        **moved,
        "out": np.empty((3, 3, vertices, poses)),
        "frame": floats(random, (3, 3, vertices), "f8"),
        "alpha": floats(random, (vertices, max(slots - 1, 0)), "f8"),
        "beta": floats(random, (vertices, max(slots - 1, 0)), "f8"),
        "handedness": floats(random, (vertices,), "f8"),
        "first": first,
    }
    return [
        (loops.dqs_positions, {**moved, "first": first, "first_row": first_row}, False),
        (loops.dqs_normals, turned, False),
    ]


def _normals(loops: Any, random: np.random.Generator) -> list[Call]:
    """Return the loops that find true normals on a mesh."""
    vertices, poses = _size(random, 40), _size(random)
    triangles = _places(random, (_size(random, 60), 3), vertices)
    classes = _places(random, vertices, vertices)
    count = max(vertices, 1)
    block = int(random.integers(0, vertices + 1))
    directions = int(random.choice([1, 2, 3]))
    corners, ends = _corners(random, triangles, classes, count)
    rows = {
        "positions": floats(random, (vertices, 3), "f8"),
        "triangles": triangles,
        "corners": corners,
        "ends": ends,
        "classes": classes[:block],
        "totals": floats(random, (count,), "f8"),
        "directions": floats(random, (directions, block, 3), "f8"),
        "starts": np.empty(block + 1, "i4"),
        "columns": np.empty(room := _room(random, ends, classes[:block]), "i4"),
        "values": np.empty((directions, room)),
        "weighting": int(random.integers(0, 4)),
    }
    first = int(random.integers(0, count + 1))
    sums = {
        "positions": floats(random, (3, vertices, poses), "f8"),
        "triangles": triangles,
        "met": np.flatnonzero(random.random(len(triangles)) < 0.8).astype("i4"),
        "classes": classes,
        "sums": np.empty((3, count, poses), random.choice(["f4", "f8"])),
        "first_class": first,
        "class_count": int(random.integers(0, count - first + 1)),
        "flat": float(random.choice([1e8, *SPECIAL])),
    }
    return [
        (loops.gradient_rows, rows, False),
        (loops.class_sums, sums, False),
        (loops.true_normals, _true_normals(random, vertices, block, poses, count), False),
    ]


def _corners(
    random: np.random.Generator, triangles: Array, classes: Array, count: int
) -> tuple[Array, Array]:
    """Return the corners by class, as an operator has them; mostly."""
    named = triangles.reshape(-1)
    if not len(classes) or named.max(initial=0) >= len(classes) or random.random() < 0.1:
        corners = _places(random, named.size, max(named.size, 1))
        return corners, np.sort(random.integers(0, named.size + 1, count + 1)).astype("i8")
    owners = classes[named]
    ends = np.concatenate([[0], np.cumsum(np.bincount(np.minimum(owners, count - 1), minlength=count))])
    return np.argsort(owners, kind="stable").astype("i4"), ends.astype("i8")


def _room(random: np.random.Generator, ends: Array, classes: Array) -> int:
    """Return the entries that the rows of a block may take. Some blocks have fewer."""
    if (classes >= len(ends) - 1).any():
        return 8
    room = 3 * int(np.maximum(ends[classes + 1] - ends[classes], 0).sum())
    return room if random.random() < 0.9 else room // 2


def _true_normals(
    random: np.random.Generator, vertices: int, block: int, poses: int, count: int
) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for name in "tb":
        starts = np.cumsum([0, *random.integers(0, 5, block)]).astype("i4")
        rows[f"{name}_starts"] = starts
        rows[f"{name}_columns"] = _places(random, starts[-1], vertices)
        rows[f"{name}_values"] = floats(random, (int(starts[-1]),), "f8")
    both, sided = random.random() < 0.6, random.random() < 0.5
    truths = 2 if both else 1
    return {
        **rows,
        "positions": floats(random, (3, vertices, poses), "f8"),
        "coefficients": floats(random, (3, block), "f8"),
        "areas": floats(random, (block,), "f8"),
        "valid": random.random(block) < 0.8,
        "carried": floats(random, (3, block), "f8") if both else None,
        "classes": _places(random, block, count) if both else None,
        "sums": floats(random, (3, count, poses), "f4") if both else None,
        "sides": floats(random, (block, poses), "f8") if sided else None,
        "normals": np.empty((truths, 3, block, poses)),
        "exist": np.empty((truths, block, poses), "?"),
        "flat": float(random.choice([1e-6, *SPECIAL])),
    }


def _errors(loops: Any, random: np.random.Generator) -> list[Call]:
    """Return the loops that measure and count errors."""
    vertices, poses, truths = _size(random, 64), _size(random, 64), int(random.choice([1, 2]))
    angles = {axis: floats(random, (vertices, poses), "f8") for axis in "xyz"}
    angles["expected"] = floats(random, (truths, 3, vertices, poses), "f8")
    angles["angles"] = np.empty((truths, vertices, poses), "f4")
    counted = {
        "errors": floats(random, (vertices, poses), "f4"),
        "weights": floats(random, (vertices,), "f8"),
        "valid": random.random((vertices, poses)) < 0.9 if random.random() < 0.5 else None,
        "bins": np.zeros(int(random.choice([0, 100, 8192]))),
    }
    return [
        (loops.angles, angles, False),
        (loops.count_errors, counted, False),
    ]
