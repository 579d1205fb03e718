"""What an encoding of α and β costs on a file: the normals it moves, over the poses that verify looks at."""

from __future__ import annotations

from collections.abc import Iterator

from skinbake.format.metadata import read_metadata
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document
from skinbake.gltf.primitives import skinned_sources
from skinbake.lighting.baked_views import BakedView, baked_views
from skinbake.lighting.encoding import AddedError, EncodedSurface, added_error
from skinbake.lighting.measured import rest_surface
from skinbake.lighting.metrics import vertex_areas
from skinbake.lighting.poses import PoseRequest, PoseSet, pose_set, skins_of


def added_by_encoding(encoded: Document, plain: Document) -> AddedError | None:
    """Return how far the accurate normals of two bakes of one file lie apart: encoded, and as float32.

    None where there is no normal in any pose. Raises InputError where the file's animations are broken.
    """
    return added_error(_surfaces(encoded, plain))


def _surfaces(encoded: Document, plain: Document) -> Iterator[EncodedSurface]:
    clips, sets = read_clips(plain), dict[int, PoseSet]()
    for stored, exact in zip(_views(encoded), _views(plain), strict=True):
        areas = vertex_areas(exact.now.positions, exact.now.triangles)
        for skin in skins_of(plain, exact.source.mesh):
            if skin not in sets:
                sets[skin] = pose_set(plain, skin, clips, PoseRequest())
            yield EncodedSurface(
                rest_surface(stored), exact.alpha, exact.beta, areas, sets[skin].joint_matrices
            )


def _views(document: Document) -> list[BakedView]:
    sources, _ = skinned_sources(document)
    baked = [source for source in sources if read_metadata(document, source.json) is not None]
    return baked_views(document, baked)[0]
