"""Convert a document between its two containers: ``.glb``, and ``.gltf`` with files beside it."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from skinbake.errors import Notice, OutputError, Place
from skinbake.files import Bytes
from skinbake.files.bounds import RefusedError, is_relative, path_uri, relative_names
from skinbake.files.urls import STDIO
from skinbake.gltf import resources
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.document import GLB_SUFFIXES, Document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.writing.beside import files_of_extensions, is_elsewhere
from skinbake.wording import counted, one_or_many


def for_target(document: Document, target: str, *, pack: bool = False) -> Document:
    """Return the document in the container that the suffix of ``target`` means; ``-`` is a GLB.

    Notices tell what stays outside, or is lost.

    With ``pack``, a GLB takes the files of buffers and images into its BIN chunk. Otherwise:

    If a ``.gltf`` becomes a GLB, its first buffer becomes the BIN chunk, and the buffers and images of data:
    URIs go there too. Further buffers stay where they are. On standard output they go into the chunk, or
    become data: URIs if the document was a GLB before. If a GLB becomes a ``.gltf``, its BIN chunk becomes a
    file named after the target.

    The files that extensions name are neither packed nor copied; a notice names them.
    """
    moves = target != STDIO and is_elsewhere(document, target)
    converted = document
    if target == STDIO or Path(target).suffix.lower() in GLB_SUFFIXES:
        unpacked: Collection[Notice] = ()
        if pack or not document.is_glb:
            from skinbake.gltf.writing.packing import (  # most files are GLBs, and stay so
                packed,
                packed_with_files,
            )

            converted = document if document.is_glb else _as_glb(document)
            if pack:
                with document.notices.withheld() as unpacked:
                    converted = packed_with_files(converted, moves=moves)
            else:
                converted = packed(converted, buffer_files=target == STDIO)
        # Of images that stay files, standard output has a word of its own.
        loose = [uri for image in converted.objects("images") if isinstance(uri := image.get("uri"), str)]
        count = sum(map(is_relative, loose)) if target == STDIO else 0
        if count:
            message = one_or_many(
                count,
                f"1 image is a file; on standard output its URI still starts at {document.folder}",
                f"{count:,} images are files; on standard output their URIs still start at {document.folder}",
            )
            document.notices.tell(Notice("images-outside", message, document.place, count))
        else:
            document.notices.tell(*unpacked)
        if target == STDIO:  # each buffer that is a file becomes a data: URI
            buffers = converted.objects("buffers")
            inside = [
                {**buffer, "uri": resources.encode_data_uri(bytes(converted.buffer(number)))}
                if isinstance(uri := buffer.get("uri"), str)
                and not resources.is_data_uri(uri)
                and not _is_hollow(converted, buffer)
                else buffer
                for number, buffer in enumerate(buffers)
            ]
            if inside != buffers:
                converted = converted.edited(json={**converted.json, "buffers": inside})
    elif pack:  # pragma: no cover: refused before: tests/gltf/test_packing.py
        raise OutputError("--pack needs a .glb or .vrm: a .gltf has no binary chunk", Place(target))
    elif document.is_glb:
        converted = _as_gltf(document, Path(target).stem)
    uris = files_of_extensions(document.json) if pack or moves else []
    if uris:  # pragma: no cover: tests/gltf/test_container.py
        files = one_or_many(
            len(uris), "1 file that its extensions name is", "{} files that its extensions name are"
        )
        what = ("neither packed nor copied" if moves else "not packed") if pack else "not copied"
        stay = one_or_many(len(uris), "its URI stays as it is", "their URIs stay as they are")
        message = f"{files} {what}, and {stay}: {resources.listed(uris)}"
        document.notices.tell(Notice("uri-not-copied", message, document.place, len(uris)))
    return converted


def _as_glb(document: Document) -> Document:
    buffers = document.objects("buffers")
    # Fallback buffers of meshopt may have no bytes.
    if not buffers or buffers[0].get("uri") is None or _is_hollow(document, buffers[0]):
        return document.edited(is_glb=True, indent=None, former=None)
    data: Bytes = document.buffer(0)
    first = {key: value for key, value in buffers[0].items() if key != "uri"}
    root = {**document.json, "buffers": [first, *buffers[1:]]}
    padding = bytes(-len(data) % 4)
    return document.edited(
        json=root,
        is_glb=True,
        indent=None,
        former=None,
        binary=(data, padding) if padding else (data,),
    )


def _as_gltf(document: Document, stem: str) -> Document:
    changes = {
        "is_glb": False,
        "indent": "  ",
        "former": None,
        "binary": None,
        "other_chunks": (),
        "trailing": b"",
    }
    # The parts of a GLB that a .gltf cannot hold.
    lost = []
    if document.other_chunks:
        lost.append(f"{counted(len(document.other_chunks), 'GLB chunk')} of unknown type")
    if document.binary is not None and not document.has_binary_buffer:
        lost.append("an unreferenced BIN chunk")
    if document.trailing:
        lost.append(counted(len(document.trailing), "trailing byte"))
    if lost:
        verb = "has" if len(lost) == 1 and lost[0].startswith(("1 ", "an ")) else "have"
        message = f"{' and '.join(lost)} {verb} no place in a .gltf"
        document.notices.tell(Notice("chunks-dropped", message, document.place))
    if not document.has_binary_buffer:
        return document.edited(**changes)
    buffers = document.objects("buffers")
    taken: set[str] = set()
    for entry in (*buffers, *document.objects("images")):
        if isinstance(uri := entry.get("uri"), str):
            with suppress(RefusedError):  # then it names no file
                taken.update(relative_names(uri))
    names = (f"{stem}{'' if n == 0 else f'-{n}'}.bin" for n in itertools.count())
    uri = path_uri(next(name for name in names if name not in taken))
    root = {**document.json, "buffers": [{**buffers[0], "uri": uri}, *buffers[1:]]}
    new_files = {**document.new_files, uri: (document.buffer(0),)}
    return document.edited(json=root, new_files=new_files, **changes)


def _is_hollow(document: Document, buffer: JsonObject) -> bool:
    """Tell whether a buffer is a fallback of meshopt whose file was left out."""
    uri = buffer.get("uri")
    return (
        isinstance(uri, str)
        and not resources.is_data_uri(uri)
        and meshopt.is_fallback(buffer, document.place)
        and not resources.is_there(uri, document.folder, document.bounds)
    )
