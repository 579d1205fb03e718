"""The cost of each algorithm, counted by running it on a counting scalar (Tarini et al. 2014, supplement).

The rules come from the paper. If it states none, they are the only rules that give its figures:

- A multiplication costs one multiply-add. An addition costs one, unless it meets a product of the same line:
  then the two fuse, and the addition is free. A product fuses once.
- A division and a reciprocal square root cost one each.
- The sign of a hemisphere or of a handedness is free: instruction sets have it as a modifier of an operand.

These rules give every line of the paper except three kinds, where the paper counts more than the code needs:
SURCHARGES.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache

from skinbake.skinning.components import RestVertex, Rows, Vector
from skinbake.skinning.rest import Algorithm, Options
from skinbake.skinning.run import SCALED_STEPS, STEPS

SURCHARGES = {
    # T p is charged 12, the homogeneous 1 included, where q = M p of the same size is charged 9.
    (Algorithm.LBS_STANDARD, 2): 3,
    (Algorithm.LBS_DIRECT, 5): 3,
    # Mixing is charged 12 an influence, 8 to add and 4 for the hemisphere, also of slot 0, its pivot.
    (Algorithm.DQS_STANDARD, 1): 4,
    (Algorithm.DQS_ACCURATE, 1): 4,
    (Algorithm.DQS_EXACT, 1): 4,
    # A position is charged 27, one for differences 24: adding p to its displacement is charged apart.
    (Algorithm.DQS_STANDARD, 3): 3,
    (Algorithm.DQS_ACCURATE, 3): 3,
    (Algorithm.DQS_EXACT, 3): 3,
}
"""What the paper counts beyond the needs of a line: all assumptions about its figures, by algorithm and line.

Algorithm 6 is counted like 4 and 5. ``dqs_scaled`` is counted by the same rules, but adds no p to a
displacement. It mixes 20 numbers of a joint (16 in algorithm 6) in place of 8, and they are charged one by
one.
"""


class Sign:
    """A factor of ±1, which costs nothing."""

    def __mul__(self, other: Count) -> Count:
        return other


@dataclass(slots=True)
class Tally:
    """Multiply-adds by line of the algorithm that runs."""

    lines: dict[int, int] = field(default_factory=dict)
    current: int = 0

    def mark(self, number: int) -> None:
        """Charge the following operations to a line."""
        self.current = number
        self.lines.setdefault(number, 0)

    def charge(self) -> None:
        """Add one multiply-add to the current line."""
        self.lines[self.current] += 1


class Count:
    """A scalar without a value: its arithmetic is charged to a tally, by the rules of the module."""

    __slots__ = ("_product_of", "_tally")

    def __init__(self, tally: Tally, *, product: bool = False) -> None:
        self._tally = tally
        self._product_of = tally.current if product else None

    def __add__(self, other: Count | float) -> Count:
        fused = [operand._fuses() for operand in (self, other) if isinstance(operand, Count)]
        if not any(fused):
            self._tally.charge()
        return Count(self._tally)

    __radd__ = __sub__ = __rsub__ = __add__

    def __mul__(self, other: Count | float) -> Count:
        self._tally.charge()
        return Count(self._tally, product=True)

    __rmul__ = __mul__

    def __rtruediv__(self, other: float) -> Count:
        return self.reciprocal_root()

    def reciprocal_root(self) -> Count:
        """Charge 1 / √x, which costs one like 1 / x."""
        self._tally.charge()
        return Count(self._tally)

    def sign(self) -> Sign:
        """Return the sign, for free."""
        return Sign()

    def _fuses(self) -> bool:
        """Return whether this is a product of the current line that has not met an addition, and mark it."""
        fresh = self._product_of == self._tally.current
        self._product_of = None
        return fresh


@cache
def multiply_adds(
    algorithm: Algorithm, influences: int, *, normal_map: bool = False, scaled_joints: bool = False
) -> Mapping[int, int]:
    """Return the multiply-adds of each numbered line, for N ≥ 1 influences, in the paper's options.

    Their sum is the cost of the algorithm for a vertex. The lines of algorithm 6 come from ``dqs.exact``:
    36 N + 118 in all. With ``normal_map``, algorithms 3, 5 and 6 have three lines more (``normal_maps``).
    With ``scaled_joints``, the lines of 4, 5 and 6 come from ``dqs_scaled``.
    """
    tally = Tally()
    is_scaled = scaled_joints and algorithm.uses_dual_quaternions
    steps = SCALED_STEPS[algorithm] if is_scaled else STEPS[algorithm]
    # The numbers of a joint, and those of a row.
    size, columns = (20, 5) if is_scaled else (8, 8) if algorithm.uses_dual_quaternions else (12, 4)
    motions = [_components(tally, size) for _ in range(influences)]
    per_slot = motions if size == columns else [_rows(motion, columns) for motion in motions]
    steps(
        (
            RestVertex(
                position=_components(tally, 3),
                normal=_components(tally, 3),
                tangent=_components(tally, 3),
                bitangent=_components(tally, 3),
                weights=_components(tally, influences),
                alpha=_components(tally, influences - 1),
                beta=_components(tally, influences - 1),
                gradients=[_components(tally, 3) for _ in range(influences)],
                handedness=Sign(),
            )
        ),
        per_slot,
        Options(normal_map=normal_map),
        tally.mark,
    )
    for (charged, number), more in SURCHARGES.items():
        if charged is algorithm and (number == 1 or not is_scaled):
            tally.lines[number] += more
    return tally.lines


def normal_map_cost(algorithm: Algorithm, *, scaled_joints: bool = False) -> int | None:
    """Return the multiply-adds that a normal map adds to a vertex; None if an algorithm has none for it.

    They are T n0 and two cross products, for any number of influences.
    """
    plain, mapped = (
        sum(multiply_adds(algorithm, 1, normal_map=asked, scaled_joints=scaled_joints).values())
        for asked in (False, True)
    )
    return mapped - plain or None


def _components(tally: Tally, count: int) -> Vector:
    return tuple(Count(tally) for _ in range(count))


def _rows(components: Vector, columns: int) -> Rows:
    return tuple(components[start : start + columns] for start in range(0, len(components), columns))


@dataclass(frozen=True, slots=True)
class VertexBytes:
    """Bytes of a vertex: for plain skinning with a tangent frame, and the bytes that an algorithm adds."""

    plain: int
    added: int

    @property
    def total(self) -> int:
        """Return the bytes that the shader of the algorithm reads."""
        return self.plain + self.added


def vertex_bytes(algorithm: Algorithm, influences: int) -> VertexBytes:
    """Return the bytes of a vertex with N ≥ 1 influences, in the most common types of glTF.

    These are floats: position (12), normal (12), tangent with handedness (16), weights (4); and joints of a
    byte. The added floats are a[s], 3 numbers for each slot, or α and β, 2 (N − 1) numbers (the paper's §2
    and §3). The normal is counted for all: algorithms 3, 5 and 6 need none, but glTF computes b0 from it. In
    plain skinning, each joint has one index and one weight. A single influence has no derivatives to store.
    """
    is_standard = algorithm in (Algorithm.LBS_STANDARD, Algorithm.DQS_STANDARD)
    numbers = 3 * influences if algorithm is Algorithm.LBS_DIRECT else 2 * (influences - 1)
    return VertexBytes(12 + 12 + 16 + influences * (1 + 4), 0 if is_standard else 4 * numbers)


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one algorithm for a vertex: multiply-adds by line and in all, and bytes."""

    lines: Mapping[int, int]
    vertex_bytes: VertexBytes

    @property
    def multiply_adds(self) -> int:
        """Return the sum over the lines."""
        return sum(self.lines.values())


def cost_table(influences: int) -> dict[Algorithm, Cost]:
    """Return the cost of all six algorithms for vertices with N ≥ 1 influences."""
    return {
        algorithm: Cost(multiply_adds(algorithm, influences), vertex_bytes(algorithm, influences))
        for algorithm in Algorithm
    }
