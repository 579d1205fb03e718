"""The records of a document: what is checked, when, and that other rooms read nothing else."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import skinbake
from skinbake.errors import InputError
from skinbake.gltf.document import Document, once_a_document
from tests.support.small_documents import Builder

ROOMS = Path(skinbake.__file__).parent
"""The rooms of the package."""


def arm() -> Builder:
    """Make a node that draws an empty mesh with a skin of one joint."""
    builder = Builder()
    builder.json["nodes"] = [{"name": "joint"}, {"mesh": 0, "skin": 0}]
    builder.json["skins"], builder.json["meshes"] = [{"joints": [0]}], [{"primitives": []}]
    return builder


def documents() -> tuple[Document, Document]:
    """Return a document, and an edited copy of it."""
    document = arm().document()
    return document, document.edited(json={**document.json, "extras": 1})


def test_what_is_found_once_is_found_anew_for_an_edited_copy() -> None:
    calls = []

    @once_a_document
    def found(document: Document, key: str) -> object:
        calls.append(key)
        return object()

    document, copy = documents()
    assert found(document, "a") is found(document, "a")
    assert found(document, "a") is not found(document, "b")
    assert found(document, "a") is not found(copy, "a")
    assert calls == ["a", "b", "a"]


def test_an_error_of_what_is_found_once_is_raised_each_time() -> None:
    calls = []

    @once_a_document
    def found(document: Document) -> None:
        calls.append(document)
        raise InputError("it is broken", document.place)

    document, _ = documents()
    for _ in range(2):
        with pytest.raises(InputError, match="it is broken"):
            found(document)
    assert len(calls) == 2


def test_a_broken_part_is_refused_only_where_it_is_read() -> None:
    document = arm().document()
    document.objects("nodes").append({"children": "none", "translation": [1, 2], "name": 5})
    asset, node = document.asset, document.asset.nodes[-1]
    assert len(asset.drawn) == 1
    assert node.name == ""
    with pytest.raises(InputError, match='"translation" must be 3 numbers'):
        node.stored("translation")
    with pytest.raises(InputError, match="has children that are not an array"):
        len(asset.parents)


@pytest.mark.slow
def test_no_room_but_gltf_and_format_touches_the_json_of_a_file() -> None:
    """They read records: a call of ``objects``, or a member ``json`` of anything but a note, is none."""
    found = []
    for path in sorted(ROOMS.rglob("*.py")):
        room = path.relative_to(ROOMS).parts[0]
        if room in {
            "gltf",
            "format",
            "cli",
            "jobs",
            "report",
        }:  # these have other JSON
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and node.attr in {"json", "objects"}:
                holder = node.value
                name = holder.id if isinstance(holder, ast.Name) else getattr(holder, "attr", "")
                if name != "note":
                    found.append(f"{path.relative_to(ROOMS)}:{node.lineno}: {name}.{node.attr}")
    assert not found
