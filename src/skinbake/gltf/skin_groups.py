"""Which meshes are one character: those that the same skins draw (glTF 2.0, §3.7.3)."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence

from skinbake.errors import Notice, Place
from skinbake.gltf.animation import read_skeleton
from skinbake.gltf.document import Document

Skins = frozenset[int]


def meshes_of_one_skin(document: Document, meshes: Iterable[int]) -> tuple[list[list[int]], list[Notice]]:
    """Return the given meshes in groups that the same skins draw, and a notice on those kept apart.

    Groups, and the meshes in each, stand in the given order. Two skins with the same joints in the same
    order and equal inverse bind matrices count as one: some exporters write one for each mesh. Meshes are
    one group only where they have *all* skins in common: a mesh that a further skin draws by itself ends
    there where it is cut. Only meshes of equal inverse bind matrices have a mesh space in common, so the
    notice also counts meshes that share joints with another group and bind them otherwise: quantisation
    gives every mesh its own.

    Raises InputError where a skin cannot be read.
    """
    drawn_by = _skins_by_mesh(document)
    groups: dict[Skins, list[int]] = {}
    for mesh in dict.fromkeys(meshes):
        groups.setdefault(drawn_by[mesh], []).append(mesh)
    return list(groups.values()), _kept_apart(document, groups)


def _skins_by_mesh(document: Document) -> dict[int, Skins]:
    """Return the skins that nodes draw each mesh with, the first skin standing for all that equal it."""
    # Some exporters write 3.0; that they are indices was seen when the primitives were read.
    pairs = [
        (int(node["mesh"]), int(node["skin"]))
        for node in document.objects("nodes")
        if "mesh" in node and "skin" in node
    ]
    first: dict[Hashable, int] = {}
    number = {
        skin: first.setdefault(_binding(document, skin), skin) for skin in sorted({s for _, s in pairs})
    }
    drawn_by: dict[int, set[int]] = {}
    for mesh, skin in pairs:
        drawn_by.setdefault(mesh, set()).add(number[skin])
    return {mesh: frozenset(skins) for mesh, skins in drawn_by.items()}


def _binding(document: Document, skin: int) -> Hashable:
    """Return what makes a skin the same as another: its joints, in order, and their inverse bind matrices."""
    matrices = read_skeleton(document, skin).inverse_bind
    return tuple(_joints(document, skin)), (matrices + 0.0).tobytes()  # −0 = +0


def _joints(document: Document, skin: int) -> Sequence[int]:
    """Return a skin's joint nodes; that they are a list of indices was seen when it was read."""
    return [int(node) for node in document.objects("skins")[skin]["joints"]]


def _kept_apart(document: Document, groups: dict[Skins, list[int]]) -> list[Notice]:
    """Return a notice where joints of one group also move another."""
    moved = {skins: {node for skin in skins for node in _joints(document, skin)} for skins in groups}
    apart = [
        meshes[0]
        for skins, meshes in groups.items()
        for other in groups
        if other is not skins and moved[skins] & moved[other]
    ]
    concerned = dict.fromkeys(apart)
    if not concerned:
        return []
    message = (
        f"{len(concerned)} groups of meshes share joints but are not welded by --weld skin. Meshes "
        "are welded only if all their skins are the same: equal joints, in order, and equal "
        f"inverse bind matrices. The groups begin with meshes {', '.join(map(str, concerned))}"
    )
    return [Notice("weld-apart", message, Place(document.name), len(concerned))]
