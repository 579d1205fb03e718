"""How much all compressed data of a document may expand to: hostile files must not fill the memory."""

from __future__ import annotations

from skinbake.errors import InputError, Place
from skinbake.gltf.document import Document

RATIO, FREE = 100, 1 << 29
"""What is decoded of one document may be RATIO times its compressed bytes, or FREE bytes where that is more.

A codec's own limits hold for one stream at a time; a small file can name many. Real characters expand 2 to
12 times.
"""


def charge(document: Document, decoded: int, stored: int, place: Place) -> None:
    """Count ``decoded`` bytes that ``stored`` ones will expand to; InputError where it becomes too much."""
    spent = document.derived.setdefault("expansion", {})
    spent["decoded"] = spent.get("decoded", 0) + decoded
    spent["stored"] = spent.get("stored", 0) + stored
    if spent["decoded"] > max(RATIO * spent["stored"], FREE):
        raise InputError(
            f"{spent['stored']} bytes of compressed data, this included, would expand to {spent['decoded']}, "
            f"over the limit of {RATIO} times as many",
            place,
        )
