"""Call the compiled loops of bake with arrays of any shape, type and content."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.native.arrays import REFUSALS, SPECIAL, Call, floats, varied


def executions(seed: int) -> int:
    """Call each loop with the arrays of a seed and variations of them; return how many calls that were."""
    from skinbake.gradients import _kernel

    random = np.random.default_rng(seed)
    with np.errstate(over="ignore", invalid="ignore"):  # special values are cast to other types
        return varied(_calls(_kernel, random), random, (*REFUSALS, _kernel.CollisionError))


def _calls(kernel: Any, random: np.random.Generator) -> list[Call]:
    """Return each loop with arguments that fit together, mostly."""
    vertices = int(random.choice([0, 1, 2, 3, 5, 10, 40, 120]))
    slots = int(random.choice([1, 2, 4, 4, 4, 8, 12, 40]))
    triangles = int(random.choice([0, 1, 2, 5, 30, 150]))
    joints = int(random.choice([1, 4, 64, 70000]))
    width = random.choice(["f4", "f8"])
    most = max(vertices, 1)
    positions = floats(random, (vertices, 3), width)
    corners = random.integers(0, most if random.random() < 0.95 else most + 3, (triangles, 3)).astype("u4")
    named = random.integers(-1 if random.random() < 0.7 else 0, joints, (vertices, slots)).astype("i4")
    weights = (
        np.abs(floats(random, (vertices, slots), "f8"))
        if random.random() < 0.7
        else floats(random, (vertices, slots), "f8")
    )
    if random.random() < 0.9:
        weights[named < 0] = 0
    free = random.random((vertices, slots)) < 0.4
    count = most if random.random() < 0.4 else int(random.integers(1, most + 1))
    classes = random.integers(0, count, vertices).astype("i4")
    if random.random() < 0.3:
        count, classes = vertices, np.arange(vertices, dtype="i4")
    has_frame = random.random() < 0.5
    frame = [floats(random, (vertices if has_frame else 0, 3), width) for _ in range(2)]
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
        "normals": floats(random, (vertices, 3), width),
        "tangents": frame[0],
        "bitangents": frame[1],
        "alpha": np.empty((vertices, slots - 1), "f4"),
        "beta": np.empty((vertices, slots - 1), "f4"),
        "adopted": np.zeros((vertices, slots), "i4"),
        "ends": ends,
        "sums": np.zeros((primitives, 4)),
        **_rig(random, joints),
        "class_count": count,
        "weighting": int(random.integers(0, 4)),
        "adopts": bool(random.integers(2)),
        **{name: _number(random, usual) for name, usual in USUAL.items()},
        "grouped": None,
        "first": 0,
        "last": 0,
    }
    groups = {name: surface[name] for name in ("triangles", "joints", "weights", "classes", "class_count")}
    in_parts = {**surface, **_part(kernel, random, groups)}
    influences = {
        "joints": named,
        "weights": weights,
        "free": free,
        "adopting_sum": float(random.choice([0, 0.99, np.nan])),
        "adopting_weight": float(random.choice([0, 6e-5, np.nan])),
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
        (kernel.bake_surface, in_parts, True),
        (kernel.group_surface, groups, False),
        (kernel.normalise_influences, influences, False),
        (kernel.mark_proper, areas, False),
        (kernel.label_equal_rows, rows, False),
    ]


USUAL = {
    "negligible": 1e-4, "stiffness": 0.25, "turn": 0.2, "together": 10.0, "collapsed": 0.1, "ray": 1.5,
    "even": 1e-9, "unfelt": 1e-4, "narrow": 0.2, "flat": 1e-6, "flat_tilt": 1e-12, "bounded": 3.0,
    "small": 0.02,
}  # fmt: skip
"""The numbers of bake_surface, as bake chooses them."""


def _number(random: np.random.Generator, usual: float) -> float:
    return usual if random.random() < 0.9 else float(random.choice(SPECIAL))


def _rig(random: np.random.Generator, joints: int) -> dict[str, Any]:
    """Return a rig of all joints, mostly a sound one, or none."""
    count = 0 if random.random() < 0.2 else joints + int(random.integers(0, 3))
    numbers = np.arange(count)
    is_chain = random.random() < 0.5
    parents = numbers - 1 if is_chain else random.integers(-1, np.maximum(numbers, 1)) if count else numbers
    ranks = numbers.copy()
    if random.random() < 0.2:  # circles, joints that carry themselves, ranks that do not rise
        parents, ranks = random.integers(-1, max(count, 1), count), random.integers(0, max(count, 1), count)
    pivots = floats(random, (count, 3), "f8")
    pivots[random.random(count) < 0.1] = np.nan
    chains = np.zeros(count) if is_chain else random.integers(-1, 3, count)
    # Matrices of joints in groups of four poses, (J, groups · 48), and the share of each pose.
    groups = int(random.integers(0, 3))
    poses = floats(random, (count, 48 * groups), "f8")
    if random.random() < 0.5:
        usual = np.tile(np.repeat(np.eye(3, 4).ravel(), 4), (count, groups))
        poses = usual + 0.5 * random.normal(size=poses.shape)
    shares = floats(random, (4 * groups,), "f8")
    if random.random() < 0.5:
        shares = np.full(4 * groups, 1.0 / max(4 * groups, 1))
    return {
        "parents": parents.astype("i4"),
        "ranks": ranks.astype("i4"),
        "pivots": pivots,
        "chains": chains.astype("i4"),
        "poses": poses,
        "shares": shares,
    }


def _part(kernel: Any, random: np.random.Generator, groups: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments that bake a part of the classes. Arrays that cannot be grouped are baked whole."""
    try:
        grouped = kernel.group_surface(*groups.values())
    except REFUSALS:
        return {}
    first, last = np.sort(random.integers(0, groups["class_count"] + 1, 2)).tolist()
    return {"grouped": grouped, "first": first, "last": last}
