"""The correctives of a file as it stores them: whether they are sound, and what its clips play."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from skinbake.errors import InputError, Notice, Place
from skinbake.format.correctives import nodes_with
from skinbake.format.metadata import VERSION, corrective_note, read_metadata
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.animation import Clip, clip_weights, read_clips
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import entries_of, reference, text
from skinbake.gltf.morphs import resting_weights
from skinbake.gltf.primitives import PrimitiveSource

BAKE = "run skinbake bake --correctives again"


def damaged_correctives(document: Document) -> Iterator[Notice]:
    """Yield a problem for each mesh whose targets or metadata are not those of a bake."""
    for number, mesh in enumerate(document.objects("meshes")):
        note = corrective_note(mesh)
        if note is None:
            continue
        place = Place(document.name, number, text(mesh, "name", document.place))
        primitives = entries_of(mesh.get("primitives"))
        if note["version"] != VERSION:
            message = f"its metadata has version {note['version']}, this skinbake reads {VERSION}"
            yield Notice("version", f"{message}: update skinbake", place)
        elif any(read_metadata(document, one) for one in primitives):
            yield Notice("both-bakes", f"it has α/β and correctives, which correct it twice: {BAKE}", place)
        elif any(len(entries_of(one.get("targets"))) < int(note["targets"]) for one in primitives):
            yield Notice("targets-missing", f"its morph targets were removed since the bake: {BAKE}", place)
        elif len(entries_of(note.get("primitives"))) != len(primitives):
            yield Notice("metadata-broken", f'its metadata is damaged: "primitives"; {BAKE}', place)


def corrective_targets(document: Document, source: PrimitiveSource, added: int, count: int) -> Float64Array:
    """Return the last targets of a primitive, (K, V, 3), as a renderer reads them. Raises InputError."""
    found = np.zeros((added, count, 3))
    for number, target in enumerate(entries_of(source.json.get("targets"))[-added:]):
        accessor = reference(target.get("NORMAL"))
        if accessor is not None:
            values = read_accessor(document, accessor, source.place.at("NORMAL")).decoded()
            if values.shape != found[number].shape:
                raise InputError("its corrective normals do not fit its vertices", source.place)
            found[number] = values
    return found


class PlayedCorrectives:
    """The correctives of a document, as its clips play them.

    targets are their numbers by mesh, clips_of the names of the clips that play them.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        notes = {
            n: note for n, one in enumerate(document.objects("meshes")) if (note := corrective_note(one))
        }
        self.targets = {mesh: int(note["targets"]) for mesh, note in notes.items()}
        self.clips_of = {mesh: list(note.get("clips", [])) for mesh, note in notes.items()}

    @cached_property
    def clips(self) -> dict[int, Clip]:
        """The clips by number. Reading many takes long, and most documents have no correctives."""
        return {clip.number: clip for clip in read_clips(self._document)}

    def of_views(self, views: Sequence[BakedView]) -> list[Float64Array]:
        """Return the changes (K, V, 3) of unit normals of primitives; K is 0 in a mesh without correctives.

        The views may be those of a document whose correctives were stripped. Raises InputError.
        """
        found = []
        for view in views:
            added, count = self.targets.get(view.source.mesh, 0), len(view.now.positions)
            source = view.source.in_document(self._document)
            lengths = np.linalg.norm(view.now.normals.astype(np.float64), axis=1)
            own = np.zeros((0, count, 3))
            if added:
                own = corrective_targets(self._document, source, added, count)
            with np.errstate(invalid="ignore", divide="ignore"):
                found.append(np.nan_to_num(own / lengths[:, None]))
        return found

    def weights(
        self, mesh: int, draw: tuple[int, int | None], clip: Clip, times: Float64Array
    ) -> Float64Array:
        """Return the weights (P, K) that a clip gives a mesh's correctives at times (P,).

        draw are the skin that draws the mesh, and the node if the file has morph targets of its own there.
        """
        skin, node = draw
        added, node = self.targets.get(mesh, 0), self.node(mesh, skin) if node is None else node
        if not added or node is None:
            return np.zeros((len(times), added))
        resting = resting_weights(self._document, node)
        # A clip of a stripped document, or of joints alone, has no channels of morph weights.
        whole = self.clips.get(clip.number, clip)
        return clip_weights(node, whole, times, resting)[:, -added:]

    def node(self, mesh: int, skin: int) -> int | None:
        """Return the first node that draws a mesh with a skin, whose weights its correctives have."""
        nodes = nodes_with(self._document, mesh, skin) or nodes_with(self._document, mesh)
        return nodes[0] if nodes else None
