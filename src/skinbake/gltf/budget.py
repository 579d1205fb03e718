"""Count the memory that a document claims, before the program allocates it.

A small file can claim any amount of memory: by accessors without data, by streams that expand, by arrays that
a thousand primitives share. Each codec has limits for one stream. These limits hold for all together.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from skinbake.errors import InputError, Place
from skinbake.threads import GROUP_ROOT, GROUPS, group_folders

SHARE = 4
"""Without ``--max-memory`` a file may take the memory of the machine divided by this."""

UNCOUNTED = 1 << 26
"""Below this number of bytes, the memory of the machine is not looked up."""

RATIO, FREE = 2048, 1 << 30
"""All memory that a run allocates for a document is at most RATIO times its bytes, or FREE bytes.

The larger of the two counts. Time grows with this memory, so it grows with the file. A bake takes 300 bytes
for a vertex that is stored in 50 bytes, a verification 3,000. Twenty primitives that share their vertices
take twenty times as much.
"""

ZEROS_RATIO, ZEROS_FREE = 256, 1 << 24
"""Accessors without a buffer view may claim ZEROS_RATIO times the document's bytes, and ZEROS_FREE more.

Only sparse morph targets use such zeros in practice: six hundred of them, on a face of 100,000 vertices,
claim 150 times the bytes of the file.
"""

UNPACKED_RATIO, UNPACKED_FREE = 100, 1 << 27
"""Compressed data may expand to UNPACKED_RATIO times its bytes, or to UNPACKED_FREE if that is more.

Real characters expand 2 to 12 times.
"""

ELEMENTS_RATIO, ELEMENTS_FREE = 4, 1 << 19
"""Skinned primitives may have ELEMENTS_RATIO vertices and triangles for each byte, and ELEMENTS_FREE more.

Each counts as often as a primitive uses it, because each use is work. Compressed characters have 0.1 for a
byte. Thirty primitives that share the vertices of one of them have 3.
"""

WELDING_RATIO, WELDING_FREE = 512, 1 << 27
"""Welding may make a surface larger by WELDING_RATIO bytes for each byte, and by WELDING_FREE more.

Every copy of a vertex has the neighbours of all its copies, so a thousand copies have a million neighbours.
The seams and poles of characters have some tens of copies.
"""

STEPS_RATIO, STEPS_FREE = 1, 1_250_000
"""Work that small files can ask for by repeating a few bytes takes at most STEPS_RATIO steps for each byte.

And STEPS_FREE more. A step is about a microsecond. Skins, clips, nodes in poses, draws of primitives and
poses of morph targets have steps; vertices in poses have a bound of their own. Of the real characters that
were tried, the one with the most has about 2 steps for a byte, in 84 skins.
"""

STEPS_A_PART, STEPS_A_VERTEX = 24_000, 3_000
"""Each skinned primitive with vertices of its own may take STEPS_A_PART steps more.

Or STEPS_A_VERTEX for each vertex, if these are fewer. A character of a hundred small parts asks for a hundred
bakes, but repeats nothing. ``view`` takes the most: 24,000 steps for a part.
"""

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
    return min([*found, *group_limits()])


def group_limits(groups: Path = GROUPS, root: Path = GROUP_ROOT) -> Iterator[int]:
    """Yield the limits of the control groups of this process, version 2 or 1."""
    for folder in group_folders("memory", groups, root):
        for name in ("memory.max", "memory.limit_in_bytes"):
            try:
                text = (folder / name).read_text(encoding="ascii").strip()
            except (OSError, ValueError):
                continue
            if text.isdecimal():  # pragma: no branch: control groups
                yield int(text)


def shown(size: int) -> str:
    """Return a number of bytes in a readable unit."""
    if size == 1:
        return "1 byte"
    units = ("bytes", "KiB", "MiB", "GiB", "TiB")
    scale = min(max(size.bit_length() - 1, 0) // 10, len(units) - 1)
    return f"{size / (1 << 10 * scale):.4g} {units[scale]}" if size < 1 << 50 else "over 1,024 TiB"


@dataclass(slots=True)
class Budget:
    """The memory that a document has claimed so far, in all its edited versions together.

    limit is the most that it may hold at a time, None for the default. backed is the size of its files. held
    are its files and the memory that it has claimed and not released. spent is all that it has ever claimed.
    steps are the steps of work that it has claimed, parts those that its primitives allow. refusal is the
    last error of this class: a search that passes over what cannot be read must not pass over it.
    """

    limit: int | None = field(default_factory=_limit.get)
    backed: int = 0
    held: int = 0
    spent: int = 0
    zeros: int = 0
    unpacked: int = 0
    packed: int = 0
    welded: int = 0
    steps: int = 0
    parts: int = 0
    refusal: InputError | None = None
    _zeros_of: set[int] = field(default_factory=set)
    _files: set[str] = field(default_factory=set)

    def back(self, size: int, path: str | None, what: str, place: Place) -> None:
        """Count the bytes of a file before it is read for ``what``. Raises InputError if it is too much.

        A file that is named again counts as memory that the document claims. A stream has no path.
        """
        if path in self._files:
            self.claim(size, what, place)
            return
        if path is not None:
            self._files.add(path)
        self._hold(size, what, place)
        self.backed += size

    def claim(self, size: int, what: str, place: Place) -> None:
        """Count ``size`` bytes before they are allocated for ``what``. Raises InputError if it is too much.

        The message begins with ``what`` and goes on with ``would take``.
        """
        spent = self.spent + size
        if spent > max(FREE, RATIO * self.backed):  # pragma: no cover: too large
            raise self._refusal(
                f"{what} would take {shown(size)}, so the file would take {shown(spent)} in "
                f"all. The limit is {RATIO:,} times its {shown(self.backed)}, whatever --max-memory "
                "says",
                place,
            )
        self._hold(size, what, place)
        self.spent = spent

    def _hold(self, size: int, what: str, place: Place) -> None:
        """Count ``size`` bytes as held. What is refused does not count."""
        held = self.held + size
        if self.limit is None and held > UNCOUNTED:
            self.limit = default_limit()
        if self.limit is not None and held > self.limit:
            raise self._refusal(
                f"{what} would take {shown(size)}, so the file would take {shown(held)} in "
                f"all. The limit is {shown(self.limit)}: raise --max-memory",
                place,
            )
        self.held = held

    def claim_zeros(self, size: int, accessor: int, place: Place) -> None:
        """Count the zeros of an accessor without a buffer view, which have no bytes in the file."""
        if accessor not in self._zeros_of:
            self._zeros_of.add(accessor)
            self.zeros += size
        most = ZEROS_RATIO * self.backed + ZEROS_FREE
        if self.zeros > most:
            raise self._refusal(
                f"accessor {accessor} has no buffer view and claims {shown(size)} of zeros, "
                f"{shown(self.zeros)} with others. A file of {shown(self.backed)} may claim at most "
                f"{shown(most)}, whatever --max-memory says",
                place,
            )
        self.claim(size, f"accessor {accessor}, which has no buffer view,", place)

    def claim_unpacked(self, size: int, stored: int, place: Place) -> None:
        """Count ``size`` bytes, to which ``stored`` bytes of compressed data will expand."""
        self.unpacked += size
        self.packed += stored
        if self.unpacked > max(UNPACKED_RATIO * self.packed, UNPACKED_FREE):  # pragma: no cover: too large
            raise self._refusal(
                f"{self.packed} bytes of compressed data, this included, would expand to "
                f"{self.unpacked}. The limit is {UNPACKED_RATIO} times as many",
                place,
            )
        self.claim(size, "compressed data", place)

    def check_elements(self, count: int, place: Place) -> None:
        """Hold the vertices and triangles of all skinned primitives against the size of the document."""
        most = ELEMENTS_RATIO * self.backed + ELEMENTS_FREE
        if count > most:
            raise self._refusal(
                f"its skinned primitives have {count:,} vertices and triangles, each counted as often as a "
                f"primitive uses it. A file of {shown(self.backed)} may have at most {most:,}",
                place,
            )

    def claim_welding(self, size: int, place: Place) -> None:
        """Count ``size`` bytes by which welding makes a surface larger."""
        self.welded += size
        most = WELDING_RATIO * self.backed + WELDING_FREE
        if self.welded > most:  # pragma: no cover: thousands of copies
            raise self._refusal(
                f"its vertices have so many copies at one place that welding them would take "
                f"{shown(self.welded)}. A file of {shown(self.backed)} may take at most {shown(most)} for it",
                place,
            )
        self.claim(size, "welding it", place)

    def allow_parts(self, vertices: Iterable[int]) -> None:
        """Allow the work on primitives with so many vertices of their own each, once for a document."""
        steps = sum(min(STEPS_A_PART, STEPS_A_VERTEX * count) for count in vertices)
        self.parts = max(self.parts, steps)

    @property
    def steps_left(self) -> int:
        """The steps that the document may still claim."""
        return STEPS_RATIO * self.backed + STEPS_FREE + self.parts - self.steps

    def claim_steps(self, count: int, what: str, place: Place) -> None:
        """Count steps of work before they are done for ``what``. Raises InputError if they are too many."""
        if count > self.steps_left:
            most = self.steps_left + self.steps
            raise self._refusal(
                f"{what} would take {count:,} steps of work, so the file would take {self.steps + count:,} "
                f"in all. A file of {shown(self.backed)} may take {most:,}: it uses its skins, clips, nodes, "
                "primitives or morph targets too often",
                place,
            )
        self.steps += count

    def _refusal(self, message: str, place: Place) -> InputError:
        self.refusal = InputError(message, place)
        return self.refusal

    @contextmanager
    def passing(self) -> Iterator[None]:
        """Release at the end of the block all that is claimed in it."""
        held = self.held
        yield
        self.held = held
