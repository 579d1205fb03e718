"""Labels of vertices, to be compared without regard to their numbers."""

from __future__ import annotations

from skinbake.geometry.skinned import IntArray


def as_met(labels: IntArray) -> list[int]:
    """Number classes in the order in which vertices meet them."""
    seen: dict[int, int] = {}
    return [seen.setdefault(label, len(seen)) for label in labels.tolist()]
