"""The nodes of the scene that a picture shows, and the side from which it shows them."""

from __future__ import annotations

from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, entries_of, object_of, reference


def shown_nodes(document: Document) -> set[int]:
    """Return the nodes of the default scene, or, if it draws nothing skinned, of the first scene that does.

    All nodes, if no scene does. The page of ``skinbake view`` chooses in the same way. A reference that is
    broken counts as missing.
    """
    nodes, scenes = document.objects("nodes"), entries_of(document.json.get("scenes"))
    default = reference(document.json.get("scene", 0))
    first = scenes[default : default + 1] if default is not None and default >= 0 else []
    for scene in (*first, *scenes):
        found = _below(nodes, scene.get("nodes"))
        if any("mesh" in nodes[number] and "skin" in nodes[number] for number in found):
            return found
    return set(range(len(nodes)))


def faces_backward(document: Document) -> bool:
    """Tell whether the characters of a file look along −Z, as those of VRM 0 do. Others look along +Z."""
    extensions = object_of(document.json.get("extensions"))
    return isinstance(extensions.get("VRM"), dict) and "VRMC_vrm" not in extensions


def _below(nodes: list[JsonObject], roots: object) -> set[int]:
    """Return some nodes, and all nodes below them."""
    found, left = set[int](), [roots]
    while left:
        listed = left.pop()
        for number in map(reference, listed if isinstance(listed, list) else []):
            if number is not None and 0 <= number < len(nodes) and number not in found:
                found.add(number)
                left.append(nodes[number].get("children"))
    return found
