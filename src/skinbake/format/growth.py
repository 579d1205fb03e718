"""A notice where ``--compress draco`` makes a file larger."""

from __future__ import annotations

from skinbake.errors import Notice
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import integer, objects
from skinbake.wording import percent

LARGER = 1.15
"""The growth from which it is told as a factor: below it, "1.0 times" would say nothing."""


def tell_draco_growth(before: Document, after: Document) -> None:
    """Tell if a bake with ``--compress draco`` needs more bytes than its input.

    An input that is in Draco already grows by α and β alone, and is not a case for a remedy. Nor is an output
    that Draco could not take.
    """
    if _is_in_draco(before) or not _is_in_draco(after):
        return
    first, last = _bytes_of_buffers(before), _bytes_of_buffers(after)
    if last <= first or not first:
        return
    growth = last / first
    by = f"{growth:.2g} times as large" if growth >= LARGER else f"{percent(growth - 1.0, 1)} larger"
    sizes = f"{by} ({first:,} to {last:,} bytes)"
    message = (
        f"--compress draco makes its buffers {sizes}, because floats stay exact: use --compress meshopt; "
        "--position-bits 14 --normal-bits 10 helps less"
    )
    after.notices.tell(Notice("draco-larger", message, before.place))


def _is_in_draco(document: Document) -> bool:
    return any(
        draco.extension_of(primitive) is not None
        for mesh in document.objects("meshes")
        for primitive in objects(mesh, "primitives", document.place)
    )


def _bytes_of_buffers(document: Document) -> int:
    """Return the bytes of all buffers, without those that only stand for compressed ones."""
    return sum(
        integer(buffer, "byteLength", document.place)
        for buffer in document.objects("buffers")
        if not meshopt.is_fallback(buffer, document.place)
    )
