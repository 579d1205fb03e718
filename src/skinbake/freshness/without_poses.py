"""Whether α and β are fresh whose fit cannot be made again: it was made to poses that are not in the file.

They are those of clips of another file, of clips that have changed, or of nodes that are stored otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from skinbake.choices import Gradients
from skinbake.errors import Notice
from skinbake.format.digests import slots_digest
from skinbake.freshness.baked_views import BakedView
from skinbake.freshness.expected import noted_rig
from skinbake.geometry.poses import is_fingerprint_of
from skinbake.gltf.document import Document
from skinbake.gltf.reading.accessors import read_attribute

BAKE_AGAIN = "run skinbake bake again"

BAKE_LAST = "Bake last: run skinbake bake on the file that the last tool wrote"

WITHOUT_POSES = "the poses of the fit are not in the file, so α/β were checked by their digest"


def has_poses(document: Document, view: BakedView) -> bool:
    """Tell whether the poses of a fit follow from the file as it is now."""
    if view.kind is Gradients.SURFACE or view.note.poses is None:
        return True
    rig = noted_rig(document, view)
    return rig is not None and is_fingerprint_of(rig.fingerprint, view.note.poses.fingerprint)


def rig_changed(document: Document, view: BakedView) -> bool:
    """Tell whether the rig is another one than the noted one, or is gone."""
    if view.kind is Gradients.SURFACE or view.note.rig is None:
        return False
    rig = noted_rig(document, view)
    return rig is None or rig.digest != view.note.rig


def problems_without_poses(document: Document, views: Sequence[BakedView]) -> Iterator[Notice]:
    """Yield a problem for each view of a surface whose arrays, skeleton or α/β changed."""
    gone = "the poses that α/β were fitted to are not in the file"
    for view in views:
        attributes, place = view.source.attributes, view.source.place
        stored = {
            name: read_attribute(document, attributes, name, place).values for name in view.note.slot_names
        }
        if view.changed:
            message = f"{', '.join(view.changed)} changed since its bake, and {gone}. {BAKE_LAST}"
            yield Notice("stale", message, place)
        elif rig_changed(document, view):
            message = "The skeleton changed since the bake (its hierarchy or its bind pose)"
            yield Notice("stale", f"{message}: {BAKE_AGAIN}", place)
        elif view.note.poses is None or slots_digest(stored) != view.note.poses.slots:
            yield Notice("stale", f"α/β changed since its bake, and {gone}: {BAKE_AGAIN}", place)
