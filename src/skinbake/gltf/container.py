"""Move a document between its two containers, ``.gltf`` with files beside it and ``.glb``."""

from __future__ import annotations

import itertools
from pathlib import Path

from skinbake.errors import Notice
from skinbake.gltf import resources
from skinbake.gltf.document import GLB_SUFFIXES, STDIO, Document, joined
from skinbake.gltf.glb import Bytes
from skinbake.gltf.json_access import integer


def for_target(document: Document, target: str) -> tuple[Document, list[Notice]]:
    """Return the document in the container that ``target`` asks for by suffix, ``-`` being a GLB.

    A ``.gltf`` that becomes a GLB has its first buffer in the BIN chunk; further buffers stay where they
    are, except on standard output, where they move into data: URIs. A GLB that becomes a ``.gltf`` has its
    BIN chunk in a file named after the target.
    """
    if target == STDIO or Path(target).suffix.lower() in GLB_SUFFIXES:
        packed = document if document.is_glb else _as_glb(document)
        return (_self_contained(packed), _loose_images(packed)) if target == STDIO else (packed, [])
    return _as_gltf(document, Path(target).stem) if document.is_glb else (document, [])


def _as_glb(document: Document) -> Document:
    buffers = document.objects("buffers")
    if not buffers:
        return document.edited(is_glb=True, indent=None)
    data: Bytes = document.buffer(0)
    first = {key: value for key, value in buffers[0].items() if key != "uri"}
    root = {**document.json, "buffers": [first, *buffers[1:]]}
    padding = bytes(-len(data) % 4)
    return document.edited(
        json=root, is_glb=True, indent=None, binary=(data, padding) if padding else (data,)
    )


def _as_gltf(document: Document, stem: str) -> tuple[Document, list[Notice]]:
    notices = []
    buffers = document.objects("buffers")
    meant = bool(buffers) and "uri" not in buffers[0]
    unmeant = document.binary is not None and not meant
    if document.other_chunks or document.trailing or unmeant:
        chunks = f"{len(document.other_chunks)} GLB chunks of unknown type"
        also = " and a BIN chunk that no buffer means" if unmeant else ""
        message = f"{chunks} and {len(document.trailing)} trailing bytes{also} have no place in a .gltf"
        notices.append(Notice("chunks-dropped", message, document.place))
    changes = {"is_glb": False, "indent": "  ", "binary": None, "other_chunks": (), "trailing": b""}
    if document.binary is None or not meant:
        return document.edited(**changes), notices
    taken = {buffer.get("uri") for buffer in buffers} | {i.get("uri") for i in document.objects("images")}
    names = (f"{stem}{'' if n == 0 else f'-{n}'}.bin" for n in itertools.count())
    uri = next(uri for uri in map(resources.path_uri, names) if uri not in taken)
    length = integer(buffers[0], "byteLength", document.place)
    data = memoryview(joined(document.binary))[:length]
    root = {**document.json, "buffers": [{**buffers[0], "uri": uri}, *buffers[1:]]}
    return document.edited(json=root, new_files={**document.new_files, uri: (data,)}, **changes), notices


def _self_contained(document: Document) -> Document:
    """Return the GLB with every buffer that is in a file moved into a data: URI."""
    buffers = document.objects("buffers")
    inside = [
        {**buffer, "uri": resources.encode_data_uri(bytes(document.buffer(number)))}
        if isinstance(uri := buffer.get("uri"), str) and not resources.is_data_uri(uri)
        else buffer
        for number, buffer in enumerate(buffers)
    ]
    if inside == buffers:
        return document
    return document.edited(json={**document.json, "buffers": inside})


def _loose_images(document: Document) -> list[Notice]:
    loose = [uri for image in document.objects("images") if isinstance(uri := image.get("uri"), str)]
    count = sum(resources.is_relative(uri) for uri in loose)
    if not count:
        return []
    message = f"{count} images are files; on standard output their URIs still start at {document.folder}"
    return [Notice("images-outside", message, document.place, count)]
