"""Bound the work and the memory that a file asks for, before the program spends them.

A small file can ask for any amount: by accessors without data, by streams that expand, by arrays that a
thousand primitives share, by clips and skins that a few bytes repeat. Whoever is about to spend something
claims it, as ``Cost.BAKED_VERTEX * count``; the limits hold for all claims of a document together.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from operator import add, attrgetter
from pathlib import Path
from typing import NamedTuple

from skinbake.errors import BudgetError, Place
from skinbake.threads import GROUP_ROOT, GROUPS, group_limits


@dataclass(frozen=True, slots=True)
class Work:
    """What something takes: ``steps`` of about a microsecond, and ``bytes`` of memory.

    Of the bytes, ``zeros`` are those of accessors without data, ``unpacked`` those to which so many
    ``packed`` ones expand, and ``welded`` those by which welding makes a surface larger.
    """

    steps: float = 0
    bytes: int = 0
    zeros: int = 0
    packed: int = 0
    unpacked: int = 0
    welded: int = 0

    def __mul__(self, count: int) -> Work:
        """Return the work on so many of what this is the work on one of."""
        return Work(*(part * count for part in PARTS(self)))

    def __add__(self, other: Work) -> Work:
        """Return the work on both."""
        return Work(*map(add, PARTS(self), PARTS(other)))


PARTS = attrgetter(*Work.__dataclass_fields__)


class Cost:
    """What one of each thing takes: steps as measured on small models, bytes at most.

    Only what a file can repeat in a few bytes has steps: the work on each vertex grows with the file.
    """

    # Reading
    NODE = Work(bytes=1024)  # of a skeleton, with its numbers
    RIG_JOINT = Work(bytes=160)
    DIGESTED_NUMBER = Work(bytes=32)
    NOTE_ENTRY = Work(bytes=256)  # of a note in the extras of an accessor, which many primitives may name
    SUMMED_PRIMITIVE = Work(steps=500)  # by inspect
    SUMMED_VERTEX = Work(bytes=64)
    SUMMED_SLOT = Work(bytes=40)
    UNDONE_NUMBER = Work(steps=1 / 200)  # of correctives: it is read and compared

    # Poses: of a clip, of a channel, and of a node and a joint in each pose
    SAMPLED_CLIP = Work(steps=700)
    SAMPLED_CHANNEL = Work(steps=30)
    POSED_NODE = Work(steps=1)
    POSED_JOINT = Work(steps=5)
    NODE_MATRIX = Work(bytes=640)  # while the poses of a clip are made
    NODE_TRANSFORM = Work(bytes=128)  # of a node in a pose of a clip, kept for other skins
    CHANNEL_VALUE = Work(bytes=256)  # likewise
    JOINT_MATRIX = Work(bytes=512)
    TARGET_WEIGHT = Work(bytes=24)

    # Bakes
    BAKED_PRIMITIVE = Work(steps=700)
    BAKED_VERTEX = Work(bytes=128)
    BAKED_SLOT = Work(bytes=48)
    BAKED_TRIANGLE = Work(bytes=24)
    BLENDED_CORNER = Work(bytes=256)  # for the gradient of blend weights
    FITTED_SURFACE = Work(steps=4_000)  # to poses
    JUDGED_PRIMITIVE = Work(steps=4_300)  # by the guard
    MORPHED_VERTEX = Work(bytes=256)  # of a surface that is differentiated, and of the work on one target
    MORPHED_TRIANGLE = Work(bytes=768)
    DRACO_STREAM = Work(steps=6_000)  # the search for grids included
    DRACO_TABLE_ENTRY = Work(steps=1 / 250)  # quantising to n bits fills a table of 2ⁿ
    FITTED_MOTION = Work(steps=5_000)  # of correctives: a clip that moves a skin, but for its poses
    FITTED_KEY = Work(steps=1 / 2)  # a vertex at each key of it
    FITTED_SAMPLE = Work(bytes=48)  # a vertex at a key, while correctives are fitted

    # Verification
    COMPARED_PRIMITIVE = Work(steps=3_000)  # for its freshness
    COMPARED_VERTEX = Work(bytes=800)  # its gradient operator takes the largest part
    COMPARED_SLOT = Work(bytes=128)
    COMPARED_TRIANGLE = Work(bytes=400)
    WELDED_PAIR = Work(bytes=32)  # two vertices that may be one, in each order: their numbers, twice over
    COPIED_CORNER = Work(bytes=192)  # of a triangle, at each copy of its vertices
    MEASURED_PRIMITIVE = Work(steps=10_000)  # in each draw
    MEASURED_SAMPLE = Work(bytes=32)  # a vertex in a pose: its errors, while they may be among the largest
    MEASURED_MORPH = Work(steps=3_000)  # a primitive with morph targets, in each pose
    MEASURED_TARGET = Work(steps=20)  # and for each target
    VERIFIED_PRIMITIVE = Work(steps=22_000)  # all of these, its first poses included
    VERIFIED_TARGET = Work(steps=60)
    VERIFIED_JOINT = Work(steps=30)

    # Pictures, pages and normals
    SHOWN_CLIP = Work(steps=150)
    DRAWN_PRIMITIVE = Work(steps=3_000)
    DRAWN_VERTEX = Work(bytes=2048)
    DRAWN_AGAIN = Work(steps=1)  # a vertex of a mesh without a skin, for each node that draws it
    POSED_VERTEX = Work(bytes=64)  # in each pose
    DRAWN_MORPH = Work(steps=1_500)  # a primitive with morph targets, in each pose
    DRAWN_TARGET = Work(steps=3)  # and for each target
    READ_TARGET = Work(steps=7)  # a target of a primitive, for each clip
    COVERING_TRIANGLE = Work(bytes=256)  # while its area in a picture is found
    SAMPLED_PIXEL = Work(bytes=224)  # while it is drawn, with all its samples
    DRAWN_PIXEL = Work(bytes=10)  # in each picture, until the end
    DECODED_PIXEL = Work(bytes=21)  # of an image: Pillow takes the most for WebP
    TEXTURE_PIXEL = Work(bytes=11)  # of an image's levels, and of their copies in Pillow
    PAGE_BYTE = Work(bytes=4)  # of a model in a page: as base64, filled in, and encoded
    WRITTEN_NUMBER = Work(bytes=20)  # as text


class Limit(NamedTuple):
    """So much for each byte of a file, and so much for a file of any size."""

    ratio: float
    free: int

    def most(self, size: int) -> int:
        """Return the two together for a file of so many bytes."""
        return self.free + int(self.ratio * size)


MEMORY = Limit(2048, 1 << 30)
"""All memory that a run allocates for a document: the larger of the two counts.

Time grows with this memory, so it grows with the file. A bake takes 300 bytes for a vertex that is stored in
50 bytes, a verification 3,000. Twenty primitives that share their vertices take twenty times as much.
"""

ZEROS = Limit(256, 1 << 24)
"""The bytes of accessors without a buffer view.

Only sparse morph targets use such zeros in practice: six hundred of them, on a face of 100,000 vertices,
claim 150 times the bytes of the file.
"""

UNPACKED = Limit(100, 1 << 27)
"""The bytes to which compressed data may expand, for each of its own bytes: the larger of the two counts.

Entropy codes have no minimum size: a stream of 100 bytes can hold a billion equal vertices. Real characters
expand 2 to 12 times.
"""

ELEMENTS = Limit(4, 1 << 19)
"""The vertices and triangles of skinned primitives.

Each counts as often as a primitive uses it, because each use is work. Compressed characters have 0.1 for a
byte. Thirty primitives that share the vertices of one of them have 3.
"""

WELDING = Limit(512, 1 << 27)
"""The bytes by which welding may make surfaces larger.

Every copy of a vertex has the neighbours of all its copies, so a thousand copies have a million neighbours.
The seams and poles of characters have some tens of copies.
"""

STEPS = Limit(1, 1_250_000)
"""The steps of work that small files can ask for by repeating a few bytes.

Skins, clips, nodes in poses, draws of primitives and poses of morph targets have steps; vertices in poses
have a bound of their own, ``SAMPLES``. Of the real characters that were tried, the one with the most has
about 2 steps for a byte, in 84 skins.
"""

STEPS_A_PART, STEPS_A_VERTEX = 24_000, 3_000
"""Each skinned primitive with vertices of its own may take STEPS_A_PART steps more.

Or STEPS_A_VERTEX for each vertex, if these are fewer. A character of a hundred small parts asks for a hundred
bakes, but repeats nothing. ``view`` takes the most: 24,000 steps for a part.
"""

SAMPLES = Limit(24, 1_000_000)
"""The vertices × poses in which lighting is measured. Each takes 3 µs.

A mesh is measured once for each skin that draws it, and in at least three poses of each clip. Fifty soldiers
of one mesh of 3,000 vertices need 20 a byte, a character of a million vertices needs 0.5.
"""

LAYERS = Limit(4e-6, 24)
"""How often triangles may cover a picture.

A software driver takes up to 0.07 s for each time. Of 60 characters none covers it more than 3 times, or 5
close up.
"""

SHARE = 4
"""Without ``--max-memory`` a file may take the memory of the machine divided by this."""

UNCOUNTED = 1 << 26
"""Below this number of bytes, the memory of the machine is not looked up."""

_limit: ContextVar[int | None] = ContextVar("_limit", default=None)


@contextmanager
def memory_limited(size: int | None) -> Iterator[None]:
    """Let each document that is read in the block take ``size`` bytes; None: a share of all memory."""
    token = _limit.set(size)
    try:
        yield
    finally:
        _limit.reset(token)


def fits_memory(size: int) -> bool:
    """Tell whether a document that is read now may take so many bytes."""
    limit = _limit.get()
    return size <= (limit or UNCOUNTED) or (limit is None and size <= default_limit())


def default_limit(workers: int = 1) -> int:
    """Return the default limit of a file in bytes, with ``workers`` processes at work."""
    return machine_memory() // max(SHARE, workers)


def machine_memory() -> int:
    """Return the bytes of memory that this process may use, of the machine or of its control group."""
    try:
        found = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    except (AttributeError, ValueError, OSError):
        found = [8 << 30]  # Windows has no such call
    return min([*found, *memory_limits()])


def memory_limits(groups: Path = GROUPS, root: Path = GROUP_ROOT) -> list[int]:
    """Return the limits of the control groups of this process, version 2 or 1."""
    found = group_limits("memory", [["memory.max"], ["memory.limit_in_bytes"]], groups, root)
    return [int(text) for text in found if text.strip().isdecimal()]


def shown(size: int) -> str:
    """Return a number of bytes in a readable unit."""
    if size == 1:
        return "1 byte"
    units = ("bytes", "KiB", "MiB", "GiB", "TiB")
    scale = min(max(size.bit_length() - 1, 0) // 10, len(units) - 1)
    return f"{size / (1 << 10 * scale):.4g} {units[scale]}" if size < 1 << 50 else "over 1,024 TiB"


@dataclass(slots=True)
class Budget:
    """What a document has claimed so far, in all its edited versions together.

    limit is the most memory that it may hold at a time, None for the default. backed is the size of its
    files. held are its files and the memory that it has claimed and not released, taken all that it has ever
    claimed. parts are the steps that its primitives allow.
    """

    limit: int | None = field(default_factory=_limit.get)
    backed: int = 0
    held: int = 0
    parts: int = 0
    taken: Work = Work()
    _zeros_of: set[int] = field(default_factory=set)
    _files: set[str] = field(default_factory=set)

    def back(self, size: int, path: str | None, what: str, place: Place) -> None:
        """Count the bytes of a file before it is read for ``what``. Raises BudgetError if it is too much.

        A file that is named again counts as memory that the document claims. A stream has no path.
        """
        if path in self._files:
            self.claim(Work(bytes=size), what, place)
            return
        if path is not None:
            self._files.add(path)
        self._hold(size, what, place)
        self.backed += size

    def claim(self, work: Work, what: str, place: Place, *, passing: bool = False) -> None:
        """Count work before it is done for ``what``. Raises BudgetError if it is too much.

        What is refused does not count. passing: the memory is released at once, and only counts as spent.
        The message begins with ``what``, and goes on with ``would take``.
        """
        taken, of_file = self.taken + work, f"A file of {shown(self.backed)}"
        if work.zeros and taken.zeros > (most := ZEROS.most(self.backed)):
            message = (
                f"{what} has no buffer view and claims {shown(work.zeros)} of zeros, {shown(taken.zeros)} "
                f"with others. {of_file} may claim at most {shown(most)}, whatever --max-memory says"
            )
            raise BudgetError(message, place)
        if work.zeros:
            what = f"{what}, which has no buffer view,"
        if work.unpacked and taken.unpacked > max(UNPACKED.ratio * taken.packed, UNPACKED.free):
            message = (
                f"{taken.packed} bytes of compressed data, this included, would expand to {taken.unpacked}. "
                f"The limit is {UNPACKED.ratio} times as many"
            )
            raise BudgetError(message, place)
        if work.welded and taken.welded > (most := WELDING.most(self.backed)):
            message = (
                "its vertices have so many copies at one place that welding them would take "
                f"{shown(taken.welded)}. {of_file} may take at most {shown(most)} for it"
            )
            raise BudgetError(message, place)
        if work.steps > self.steps_left:
            message = (
                f"{what} would take {int(work.steps):,} steps of work, so the file would take "
                f"{int(taken.steps):,} in all. {of_file} may take {STEPS.most(self.backed) + self.parts:,}: "
                "it uses its skins, clips, nodes, primitives or morph targets too often"
            )
            raise BudgetError(message, place)
        if work.bytes and taken.bytes > max(MEMORY.free, MEMORY.ratio * self.backed):
            message = (
                f"{what} would take {shown(work.bytes)}, so the file would take {shown(taken.bytes)} in all. "
                f"The limit is {MEMORY.ratio:,} times its {shown(self.backed)}, whatever --max-memory says"
            )
            raise BudgetError(message, place)
        held = self.held
        self._hold(work.bytes, what, place)
        self.taken = taken
        if passing:
            self.held = held

    def claim_zeros(self, size: int, accessor: int, place: Place) -> None:
        """Count the zeros of an accessor without a buffer view. Read again, they are memory alone."""
        is_new = accessor not in self._zeros_of
        self.claim(Work(bytes=size, zeros=size if is_new else 0), f"accessor {accessor}", place)
        self._zeros_of.add(accessor)

    def claiming(self, what: str, place: Place) -> Callable[[int], None]:
        """Return what claims so many bytes for ``what``: for a reader that finds the size of a file."""
        return lambda size: self.claim(Work(bytes=size), what, place)

    def welding(self, place: Place) -> Callable[[int], None]:
        """Return what claims the bytes by which welding makes a surface larger."""
        return lambda size: self.claim(Work(bytes=size, welded=size), "welding it", place)

    def afresh(self, added: int = 0) -> Budget:
        """Return the budget of the document as if it were read anew, with so many bytes more."""
        return Budget(limit=self.limit, backed=self.backed + added, parts=self.parts)

    def _hold(self, size: int, what: str, place: Place) -> None:
        held = self.held + size
        if self.limit is None and held > UNCOUNTED:
            self.limit = default_limit()
        if self.limit is not None and held > self.limit:
            raise BudgetError(
                f"{what} would take {shown(size)}, so the file would take {shown(held)} in "
                f"all. The limit is {shown(self.limit)}: raise --max-memory",
                place,
            )
        self.held = held

    def look_at(self, elements: int, vertices: Iterable[int], place: Place) -> None:
        """Hold the vertices and triangles of all skinned primitives against the size of the document.

        ``vertices`` are the numbers of vertices that each primitive has of its own: it allows steps for them.
        Raises BudgetError.
        """
        if elements > (most := ELEMENTS.most(self.backed)):
            message = (
                f"its skinned primitives have {elements:,} vertices and triangles, each counted as often as "
                f"a primitive uses it. A file of {shown(self.backed)} may have at most {most:,}"
            )
            raise BudgetError(message, place)
        self.parts = max(self.parts, sum(min(STEPS_A_PART, STEPS_A_VERTEX * count) for count in vertices))

    @property
    def steps_left(self) -> int:
        """The steps that the document may still claim."""
        return int(STEPS.most(self.backed) + self.parts - self.taken.steps)

    @contextmanager
    def passing(self) -> Iterator[None]:
        """Release at the end of the block all that is claimed in it."""
        held = self.held
        try:
            yield
        finally:
            self.held = held
