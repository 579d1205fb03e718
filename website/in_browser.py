"""What the page of website/try runs in Pyodide: the command line, and codecs by their JavaScript builds."""

from __future__ import annotations

import os
import shutil
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import page_codecs
from pyodide.ffi import JsException, to_js

import skinbake.cli.bake
import skinbake.commands.bake  # noqa: F401  # so that the first file need not wait for them
from skinbake.cli.main import entry_point

FOLDER = Path("/files")
LATER = ["cli.view", "commands.view", "cli.verify", "cli.example"]


def prepare() -> bool:
    """Do a part of what the first picture needs, while there is no file. Return whether any is left."""
    if LATER:
        import_module(f"skinbake.{LATER.pop(0)}")
        return True
    from skinbake.view.texts import packed_texts

    packed_texts()  # it is kept
    return False


def put(files: Any) -> None:
    """Put the user's files, and nothing else, into the folder where the command line runs."""
    os.chdir("/")
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    os.chdir(FOLDER)
    for file in files:
        path = FOLDER / file.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.bytes.to_bytes())


def run(*arguments: str) -> int:
    """Run the command line. Return its exit code."""
    sys.argv = ["skinbake", *arguments]
    try:
        entry_point()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def taken(name: str) -> bytes:
    """Return a file that the command line has written."""
    return (FOLDER / name).read_bytes()


def _shared(values: Any) -> Any:
    """Return values of numpy as a typed array of JavaScript, and bytes as its Uint8Array."""
    return to_js(
        np.frombuffer(values, np.uint8) if isinstance(values, bytes) else np.ascontiguousarray(values)
    )


class Meshopt:
    """The functions of the package ``meshopt`` that skinbake calls, by meshoptimizer's JavaScript build."""

    @staticmethod
    def decode_gltf_buffer(data: bytes, count: int, stride: int, mode: str) -> Any:
        """Decode. Raises ValueError for damaged data."""
        target = _shared(np.zeros(count * stride, np.uint8))
        try:
            page_codecs.decoder.decodeGltfBuffer(target, count, stride, _shared(data), mode)
        except JsException as error:
            raise ValueError(str(error)) from error
        return np.frombuffer(target.to_bytes(), np.uint8).reshape(count, stride)

    @classmethod
    def decode_index_buffer(cls, data: bytes, count: int, size: int) -> Any:
        """Decode triangles."""
        return cls.decode_gltf_buffer(data, count, size, "TRIANGLES").view(f"<u{size}").ravel()

    @staticmethod
    def encode_vertex_buffer_level(values: Any, level: int, version: int) -> Any:
        """Encode attributes."""
        raw = values.view(np.uint8).ravel()
        encode = page_codecs.encoder.encodeVertexBufferLevel
        return encode(_shared(raw), len(values), len(raw) // len(values), level, version).to_bytes()

    @staticmethod
    def encode_index_buffer(values: Any) -> Any:
        """Encode triangles."""
        raw = _shared(values.view(np.uint8))
        return page_codecs.encoder.encodeIndexBuffer(raw, len(values), values.itemsize).to_bytes()

    @staticmethod
    def encode_index_sequence(values: Any) -> Any:
        """Encode indices in their order."""
        raw = _shared(values.view(np.uint8))
        return page_codecs.encoder.encodeIndexSequence(raw, len(values), values.itemsize).to_bytes()


class Draco:
    """The functions of the package ``DracoPy`` that skinbake calls, by Google's JavaScript build."""

    @staticmethod
    def decode(data: bytes) -> Any:
        """Decode a mesh. Raises JsException for damaged data."""
        found = page_codecs.draco().decode(_shared(data))
        kinds = {2: np.uint8, 4: np.uint16, 6: np.uint32}  # all others come as floats, as from DracoPy
        attributes = []
        for one in found.attributes:
            values = np.frombuffer(one.data.to_bytes(), kinds.get(one.data_type, np.float32))
            told = {name: getattr(one, name) for name in ("unique_id", "attribute_type", "data_type")}
            attributes.append({**told, "data": values.reshape(-1, one.width)})
        return SimpleNamespace(
            attributes=attributes, faces=np.frombuffer(found.faces.to_bytes(), np.uint32).reshape(-1, 3)
        )

    @staticmethod
    def encode(points: Any, faces: Any, *, generic_attributes: dict[int, Any], **options: Any) -> Any:
        """Encode a mesh. The unique ids of generic attributes are their numbers, so they come first."""
        parts = [("GENERIC", values, 0) for _, values in sorted(generic_attributes.items())]
        parts.append(("POSITION", points, options["quantization_bits"]))
        for kind, values, name in (("NORMAL", "normals", "normal"), ("TEX_COORD", "tex_coord", "tex_coord")):
            if options[values] is not None:
                parts.append((kind, options[values].astype(np.float32), options[f"{name}_quantization_bits"]))
        attributes = [
            {"type": kind, "width": values.shape[1], "data": _shared(values.ravel()), "bits": bits}
            for kind, values, bits in parts
        ]
        if options["quantization_origin"] is not None:
            origin = _shared(np.asarray(options["quantization_origin"], np.float32))
            attributes[len(generic_attributes)] |= {"origin": origin, "range": options["quantization_range"]}
        told = to_js(attributes, dict_converter=page_codecs.fromEntries)
        return (
            page_codecs.draco().encode(_shared(faces.ravel()), told, options["compression_level"]).to_bytes()
        )


sys.modules |= {"meshopt": Meshopt, "DracoPy": Draco}  # type: ignore[dict-item]
