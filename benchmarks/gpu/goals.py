"""The goals that the shaders are held to, judged from the figures of a run."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.gpu.records import COMPUTE, RunRecord, TimeRecord
from benchmarks.gpu.variants import BY_NAME, FLOATS, GATHER, PACKED8, SCATTER, STANDARD, VARIANTS

GOAL_VERTICES = 10_000_000
MET, NOT_MET = "met", "not met"
NOT_ON_GPU = "not measured on a GPU"
NOT_AT_SIZE = f"not measured at {GOAL_VERTICES:,} vertices"
RECOMPUTES = (SCATTER, GATHER)
ACCURATE = tuple(name for name in BY_NAME if name.startswith("LBS accurate"))

Cost = Callable[[str], float]
"""The cost of a variant by its name."""


@dataclass(frozen=True, slots=True)
class Goal:
    """A ratio of costs, and the most that it may be."""

    text: str
    ratio: Callable[[Cost], float]
    most: float


GOALS = (
    Goal("accurate, packed8: at most 1.10 × standard", lambda cost: cost(PACKED8) / cost(STANDARD), 1.10),
    Goal("accurate, float32: at most 1.15 × standard", lambda cost: cost(FLOATS) / cost(STANDARD), 1.15),
    Goal(
        "accurate, packed8: at most 0.25 × the cheaper recompute",
        lambda cost: cost(PACKED8) / min(map(cost, RECOMPUTES)),
        0.25,
    ),
    Goal(
        "accurate, float32: at most 0.25 × the cheaper recompute",
        lambda cost: cost(FLOATS) / min(map(cost, RECOMPUTES)),
        0.25,
    ),
)
MOST_BYTES = 8
BYTES_GOAL = f"accurate, packed8: at most {MOST_BYTES} bytes a vertex more than standard"


def median_time(entry: TimeRecord) -> float | None:
    """Return the seconds of a posed vertex: the median of the rounds, or None if nothing was measured."""
    return statistics.median(entry.seconds) / entry.posed_vertices if entry.seconds else None


def by_variant(record: RunRecord, scene: str, stage: str) -> dict[str, TimeRecord]:
    """Return the times of one scene and stage, by variant."""
    return {entry.variant: entry for entry in record.times if (entry.scene, entry.stage) == (scene, stage)}


def largest_mesh(record: RunRecord) -> str:
    """Return the scene of one mesh that has the most vertices."""
    meshes = [entry for entry in record.times if entry.instances == 1]
    return max(meshes or record.times, key=lambda entry: entry.posed_vertices).scene


def times_ratio(goal: Goal, record: RunRecord) -> float | None:
    """Return a goal's ratio of times in the largest mesh, or None if a time is missing."""
    entries = by_variant(record, largest_mesh(record), COMPUTE)
    times = {name: median_time(entry) for name, entry in entries.items()}
    if any(times.get(variant.name) is None for variant in VARIANTS):
        return None
    return goal.ratio(lambda name: times[name] or 0.0)


def bytes_ratio(goal: Goal, record: RunRecord) -> float:
    """Return a goal's ratio of the bytes that move: the ratio of times if nothing else takes time."""
    entries = by_variant(record, largest_mesh(record), COMPUTE)
    return goal.ratio(lambda name: entries[name].bytes_moved)


def verdict(goal: Goal, record: RunRecord) -> str:
    """Judge a goal. Only graphics hardware and a mesh of the goal's size count."""
    if record.software:
        return NOT_ON_GPU
    scene = largest_mesh(record)
    found = times_ratio(goal, record)
    vertices = by_variant(record, scene, COMPUTE)[STANDARD].posed_vertices
    # A sheet of rows and columns has a few vertices less than asked for.
    if found is None or vertices < 0.99 * GOAL_VERTICES:
        return NOT_AT_SIZE
    return MET if found <= goal.most else NOT_MET


def bytes_verdict(record: RunRecord) -> str:
    """Judge the bytes that α and β add. They follow from the layout, so any adapter will do."""
    entries = by_variant(record, largest_mesh(record), COMPUTE)
    return MET if entries[PACKED8].more <= MOST_BYTES else NOT_MET
