"""The scene that a picture shows, and the meshes that are drawn with the same skins: characters.

Source: glTF 2.0, §3.5 and §3.7.3.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable

from skinbake.errors import Chosen, Message, Notice
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import entries_of, object_of, reference
from skinbake.gltf.reading.skins import read_skeleton


@once_a_document
def shown_nodes(document: Document) -> set[int]:
    """Return the nodes of the default scene, or, if it draws nothing skinned, of the first scene that does.

    All nodes, if no scene does. The page of ``skinbake view`` chooses in the same way. A reference that is
    broken counts as missing.
    """
    nodes, scenes = document.objects("nodes"), entries_of(document.json.get("scenes"))
    default = reference(document.json.get("scene", 0))
    first = scenes[default : default + 1] if default is not None and default >= 0 else []
    for scene in (*first, *scenes):
        # Some nodes, and all nodes below them.
        roots = scene.get("nodes")
        found, left = set[int](), [roots]
        while left:
            listed = left.pop()
            for number in map(reference, listed if isinstance(listed, list) else []):
                if number is not None and 0 <= number < len(nodes) and number not in found:
                    found.add(number)
                    left.append(nodes[number].get("children"))
        skinned = ("mesh" in nodes[number] and "skin" in nodes[number] for number in found)
        if any(skinned):  # pragma: no branch: seldom: tests/render/test_render.py
            return found
    return set(range(len(nodes)))


def faces_backward(document: Document) -> bool:
    """Tell whether the characters of a file look along −Z, as in VRM 0. Others look along +Z."""
    extensions = object_of(document.json.get("extensions"))
    return isinstance(extensions.get("VRM"), dict) and "VRMC_vrm" not in extensions


Skins = frozenset[int]

SEVERAL = -1
"""Stands for more than one group of meshes."""


def meshes_of_one_skin(document: Document, meshes: Iterable[int]) -> list[list[int]]:
    """Return the given meshes in groups that the same skins draw.

    Groups, and the meshes in each, keep the given order. Two skins count as one if they have the same joints
    in the same order and equal inverse bind matrices: some exporters write one skin for each mesh. Meshes are
    one group only if they have *all* skins in common: if one more skin draws a mesh by itself, the mesh
    really ends at its border there. Only meshes with equal inverse bind matrices share a mesh space.

    Raises InputError if a skin cannot be read.
    """
    return list(_groups(document, meshes).values())


def shown_by(document: Document, skin: int, meshes: Iterable[int]) -> dict[int, int]:
    """Return those of some meshes that the shown scene draws by a skin or an equal one, and by which.

    Raises InputError if a skin of theirs cannot be read.
    """
    skins, kind = shown_skins(document), first_equal(document, skin)
    return {mesh: own for mesh in meshes for own in skins.get(mesh, ()) if first_equal(document, own) == kind}


@once_a_document
def shown_skins(document: Document) -> dict[int, dict[int, None]]:
    """Return the skins by which the shown scene draws each mesh."""
    found: dict[int, dict[int, None]] = {}
    for node, mesh, skin in document.asset.drawn:
        if node in shown_nodes(document):
            found.setdefault(mesh, {})[skin] = None
    return found


@once_a_document
def first_equal(document: Document, skin: int) -> int:
    """Return the first skin that was asked for of those that equal a skin.

    Skins are equal by their joints, in order, and their inverse bind matrices.
    """
    matrices = read_skeleton(document, skin).inverse_bind + 0.0  # −0 = +0
    return _known_skins(document).setdefault((document.asset.skins[skin].joints, matrices.tobytes()), skin)


@once_a_document
def _known_skins(document: Document) -> dict[Hashable, int]:
    """Return the first skin of each kind."""
    return {}


def _groups(document: Document, meshes: Iterable[int]) -> dict[Skins, list[int]]:
    """Return meshes by the skins that draw them; one of equal skins stands for all of them."""
    groups: dict[Skins, list[int]] = {}
    for mesh in dict.fromkeys(meshes):
        skins = frozenset(first_equal(document, skin) for skin in document.asset.skins_of(mesh))
        groups.setdefault(skins, []).append(mesh)
    return groups


def _owners(owned: Iterable[tuple[Iterable[int], int]]) -> dict[int, int]:
    """Return the owner of each entry, SEVERAL if it has more than one; given are entries with their owner."""
    owners: dict[int, int] = {}
    for entries, owner in owned:
        for entry in entries:
            if owners.setdefault(entry, owner) != owner:
                owners[entry] = SEVERAL
    return owners


def tell_meshes_apart(document: Document, meshes: Iterable[int]) -> None:
    """Tell of groups of ``meshes_of_one_skin`` if joints of one also move another one.

    Quantisation gives every mesh its own inverse bind matrices: then meshes of the same joints are apart.
    Each joint of each skin is read once, so that many groups of many joints take no longer than reading them.
    """
    groups = _groups(document, meshes)
    group_of = _owners((skins, number) for number, skins in enumerate(groups))
    joints = {skin: document.asset.skins[skin].joints for skin in group_of}
    moved_by = _owners((joints[skin], group) for skin, group in group_of.items())
    of_several = {skin for skin in joints if any(moved_by[node] == SEVERAL for node in joints[skin])}
    concerned = [meshes[0] for skins, meshes in groups.items() if not skins.isdisjoint(of_several)]
    if not concerned:
        return
    message = Message(
        f"{len(concerned)} groups of meshes share joints but are not welded by ",
        Chosen("weld", "skin"),
        ". Meshes are welded only if all their skins are the same: equal joints, in order, and equal "
        f"inverse bind matrices. The groups begin with meshes {', '.join(map(str, concerned))}",
    )
    document.notices.tell(Notice("weld-apart", message, document.place, len(concerned)))
