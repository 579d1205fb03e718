"""Draco bitstreams: one mesh in, one mesh out (Draco Bitstream Specification 2.2; DracoPy is Google's code).

The decoder allocates memory for any count that a stream claims. So the counts are read first and compared
with the declarations of the glTF file. The counts do not show the width of the attributes. For this, a memory
limit holds while the stream is decoded.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.errors import InputError, Place, UnsupportedFeatureError
from skinbake.gltf.codecs import codec
from skinbake.wording import counted

MAGIC = b"DRACO"
VERSION = (2, 2)
HEADER_LENGTH = 11
TRIANGULAR_MESH = 1
SEQUENTIAL, EDGEBREAKER = 0, 1
METADATA_FLAG = 1 << 15
DEEPEST_METADATA = 16

MEMORY_BASE, MEMORY_FACTOR = 1 << 28, 16
"""Decoding may take MEMORY_BASE bytes, and MEMORY_FACTOR times the bytes that the file declares.

Measured on a million vertices: twice the decoded bytes, by either method.
"""

REMEDY = (
    "; decode the file first with a tool that writes the true counts, such as gltf-transform copy, or export "
    "it without Draco"
)
"""What to do about counts that differ. Encoders drop degenerate triangles, some exporters do not recount."""

INT_MAXIMA = {1: 127, 3: 32767, 5: 2147483647}
"""The largest value of each signed integer type, by Draco's number; DracoPy returns it as floats."""


@dataclass(frozen=True, slots=True)
class Counts:
    """The counts at the beginning of a stream: vertices (points at least), triangles, its method."""

    vertices: int
    faces: int
    method: int


@dataclass(frozen=True, slots=True)
class DracoMesh:
    """A decoded stream: attributes (V, components) by unique id, triangles (T, 3) uint32, and its method.

    Signed integers come as float32. ``signed`` holds the largest value of their type, by id.
    """

    attributes: dict[int, npt.NDArray[Any]]
    faces: npt.NDArray[np.uint32]
    method: int
    signed: dict[int, int]


def check_counts(data: memoryview, vertices: int, corners: int, place: Place) -> Counts:
    """Return the counts of a stream, compared with the declarations of the accessors, without decoding.

    vertices and corners are the declared numbers. Raises InputError if the stream has another version than
    2.2, or contradicts the declarations.
    """
    counts = read_counts(data, place)
    # A point of edgebreaker is a vertex with one set of attributes, so there are at least as many points.
    too_many = counts.vertices > vertices if counts.method == EDGEBREAKER else counts.vertices != vertices
    if 3 * counts.faces != corners or too_many:
        raise InputError(
            f"its Draco stream declares {counted(counts.vertices, 'vertex', 'vertices')} and "
            f"{3 * counts.faces:,} indices, but its accessors declare {vertices:,} and {corners:,}"
            f"{REMEDY}",
            place,
        )
    return counts


def decode(data: memoryview, method: int, size: int, place: Place) -> DracoMesh:
    """Return the mesh of a stream of that method whose counts were checked.

    ``size`` is the number of bytes of its accessors.

    Raises InputError if the stream is damaged, or needs more memory than the accessors justify. Who takes an
    array of it checks its shape. The decoder never crashed on 6,000 cut or altered streams of real files.
    """
    decoder = codec("DracoPy", place)
    try:
        with _memory_limit(MEMORY_BASE + MEMORY_FACTOR * size):
            mesh = decoder.decode(bytes(data))
            attributes = {int(entry["unique_id"]): entry for entry in mesh.attributes}
            faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3), np.uint32)), dtype=np.uint32)
    except MemoryError as error:
        raise InputError("its Draco stream needs more memory than its accessors justify", place) from error
    except Exception as error:  # C++ may throw anything: DracoPy has no class for damaged data
        raise InputError(f"its Draco stream cannot be decoded: {error}", place) from error
    return DracoMesh(
        {number: np.atleast_2d(entry["data"]) for number, entry in attributes.items()},
        faces,
        method,
        {
            number: INT_MAXIMA[entry["data_type"]]
            for number, entry in attributes.items()
            if entry["data_type"] in INT_MAXIMA
        },
    )


@contextmanager
def _memory_limit(size: int) -> Iterator[None]:
    """Make allocations of the block fail past ``size`` bytes; no limit if the system has none.

    The code of Draco then throws std::bad_alloc, which arrives as MemoryError. Only Linux reports the memory
    of a process and enforces the limit. It would hold for all threads of the process, so a program with
    several threads gets none: there the counts of the stream are the only bound.
    """
    if threading.active_count() > 1:  # pragma: no cover: takes threads: tests/gltf/test_draco.py
        yield
        return
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError, ValueError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + size
    if soft != resource.RLIM_INFINITY and soft <= limit:  # pragma: no cover: takes a tight limit of memory
        yield
        return
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


class _Reader:
    """Read the plain numbers at the beginning of a stream; InputError past its end."""

    def __init__(self, data: memoryview, place: Place) -> None:
        self._data, self._at, self._place = data, 0, place

    def skip(self, count: int) -> memoryview:
        if count > len(self._data) - self._at:
            raise InputError("its Draco stream is cut short", self._place)
        self._at += count
        return self._data[self._at - count : self._at]

    def byte(self) -> int:
        return self.skip(1)[0]

    def varint(self) -> int:
        """Return a number of up to 32 bits in groups of seven, least first (§ "LEB128")."""
        value = 0
        for shift in range(0, 35, 7):
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise InputError("its Draco stream has a number that does not end", self._place)


def read_counts(data: memoryview, place: Place) -> Counts:
    """Return the counts at the beginning of a stream, without decoding it; InputError if it is none."""
    if bytes(data[:5]) != MAGIC:
        raise InputError("its Draco stream does not begin with 'DRACO'", place)
    reader = _Reader(data, place)
    header = reader.skip(HEADER_LENGTH)
    version, kind, method = (header[5], header[6]), header[7], header[8]
    if version != VERSION:
        found = ".".join(map(str, version))
        raise UnsupportedFeatureError(f"its Draco stream has version {found}; glTF has 2.2", place)
    if kind != TRIANGULAR_MESH or method not in {SEQUENTIAL, EDGEBREAKER}:
        raise InputError(f"its Draco stream has kind {kind} and method {method}: it is not a mesh", place)
    if int.from_bytes(header[9:11], "little") & METADATA_FLAG:
        for _ in range(reader.varint()):
            reader.varint()
            _skip_metadata(reader, DEEPEST_METADATA, place)
        _skip_metadata(reader, DEEPEST_METADATA, place)
    if method == SEQUENTIAL:
        faces, vertices = reader.varint(), reader.varint()
    else:
        reader.byte()
        vertices, faces = reader.varint(), reader.varint()
    return Counts(vertices, faces, method)


def _skip_metadata(reader: _Reader, depth: int, place: Place) -> None:
    if depth == 0:  # pragma: no cover: fuzz.targets reaches it
        raise InputError("the metadata of its Draco stream is nested too deep", place)
    for _ in range(reader.varint()):
        reader.skip(reader.byte())
        reader.skip(reader.varint())
    for _ in range(reader.varint()):
        reader.skip(reader.byte())
        _skip_metadata(reader, depth - 1, place)


QUANTISABLE = {"POSITION": 3, "NORMAL": 3, "TEXCOORD_0": 2}
"""Components of the attributes that DracoPy can quantise."""

GRID_BITS, GRID_SAMPLES = range(4, 21), 64
"""The numbers of bits to try, and the number of vertices that exclude most of them before all are tried.

Past them a few floats lie on a grid by chance, and Draco's tables of 2^bits take 10 to 100 ms.
"""

WIDEST = float(np.finfo(np.float32).max) / 16
"""The largest range of values that Draco quantises."""

_TYPES = {0: "POSITION", 1: "NORMAL", 3: "TEXCOORD_0"}
"""The attributes that ``_encoded`` stores, by Draco's number of a semantic."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """A stream, and by attribute name its unique id and its decoded values (V, components)."""

    data: bytes
    unique_ids: dict[str, int]
    values: dict[str, npt.NDArray[Any]]


def encode(
    arrays: Mapping[str, npt.NDArray[Any]],
    faces: npt.NDArray[Any],
    place: Place,
    *,
    level: int,
    bits: Mapping[str, int] | None = None,
) -> Encoded:
    """Return a stream of attributes (V, components), POSITION among them, and triangles (T, 3).

    The order of vertices and triangles stays. Only Draco's sequential method keeps it; edgebreaker changes
    it. Values stay exactly, except attributes in ``bits`` (POSITION, NORMAL, TEXCOORD_0 of floats), which are
    quantised to that number of bits. ``level`` is the effort of Draco, 0 (fast) to 10 (small).

    Draco stores floats as they are, and integers as entropy-coded differences. If an earlier quantisation has
    put floats on a grid, they are quantised on the same grid, provided that the stream then returns them
    exactly. This is a tenth smaller on real characters. Arrays other than POSITION must not be signed
    integers. DracoPy has none, and if floats hold them, decoders do not return the largest one as an integer.

    Raises InputError if an attribute has another count than POSITION, or if a triangle names a missing
    vertex: the encoder would read foreign memory.
    """
    # What the encoder does not check.
    count, components = arrays["POSITION"].shape
    if components != 3:  # pragma: no cover: refused before: tests/gltf/test_draco.py
        raise InputError(f"it has {counted(components, 'component')}, 3 are needed", place.at("POSITION"))
    for name, values in arrays.items():
        if len(values) != count:
            raise InputError(
                f"it has {counted(len(values), 'element')}, POSITION has {count:,}", place.at(name)
            )
    if faces.size and faces.max() >= count:  # pragma: no cover: refused before: tests/gltf/test_draco.py
        vertices = counted(count, "vertex", "vertices")
        raise InputError(f"index {faces.max()} is too large for {vertices}", place.at("indices"))
    # A grid is a guess. Where the stream does not return the values exactly, they are stored as floats.
    wanted = {name: number for name, number in (bits or {}).items() if _is_quantisable(name, arrays)}
    grids = {
        name: grid
        for name in QUANTISABLE
        if name not in wanted and _is_quantisable(name, arrays) and (grid := _grid(name, arrays[name]))
    }
    while True:
        try:
            result = _encoded(arrays, faces, level, wanted, grids)
        except Exception as error:  # C++ may throw anything: DracoPy has no class for it
            raise InputError(f"Draco cannot store it ({error}): leave it out of Draco", place) from error
        inexact = [name for name in grids if result.values[name].tobytes() != arrays[name].tobytes()]
        if not inexact:
            return result
        for name in inexact:
            del grids[name]


def reason_against_bits(name: str, values: npt.NDArray[Any]) -> str | None:
    """Return why an attribute's values (V, components) cannot be quantised, None where they can."""
    components = QUANTISABLE.get(name)
    if values.dtype.kind != "f":
        return "it is of integers"
    if components is None or values.shape[1] != components:
        return f"it has {counted(values.shape[1], 'component')}, not {components}"
    if not np.isfinite(values).all():
        return "it holds a not-a-number or an infinite one"
    # Draco computes with the extent in float32, and crashes if it overflows.
    extent = values.max(axis=0, initial=-np.inf).astype(np.float64) - values.min(axis=0, initial=np.inf)
    return None if (extent < WIDEST).all() else "its values lie too far apart for 32-bit floats"


def _is_quantisable(name: str, arrays: Mapping[str, npt.NDArray[Any]]) -> bool:
    return name in arrays and reason_against_bits(name, arrays[name]) is None


@dataclass(frozen=True, slots=True)
class _Grid:
    """Quantisation to ``bits``; for POSITION with the origin and the extent, which the encoder must know."""

    bits: int
    origin: npt.NDArray[np.float32] | None = None
    extent: float = -1.0


def _grid(name: str, values: npt.NDArray[Any]) -> _Grid | None:
    """Return the grid of values that an earlier quantisation rounded, None if none is found.

    Quantised values are origin + n · extent / (2^bits − 1). Origin and extent belong to their bounding
    box, in float32 (Draco, ``AttributeQuantizationTransform``). The extent is computed from the values with
    an error of a few units in the last place. For NORMAL only the number of bits is sought.
    """
    values = np.ascontiguousarray(values, dtype=np.float32)
    sample = values[:: max(len(values) // GRID_SAMPLES, 1)]
    if name == "NORMAL":
        found = (number for number in GRID_BITS if np.array_equal(_octahedral(sample, number), sample))
        number = next(found, None)
        return None if number is None else _Grid(number)
    origin = values.min(axis=0)
    extent = np.float32((values.max(axis=0) - origin).max())
    # The extent by units in the last place, the nearest first. The sample excludes most grids.
    for steps in (0, -1, 1, -2, 2, -3, 3):
        span = np.float32(extent + steps * np.spacing(extent))
        for number in GRID_BITS:
            spacing = span / np.float32((1 << number) - 1)
            if spacing > 0 and _on_grid(sample, origin, spacing) and _on_grid(values, origin, spacing):
                return _Grid(number, origin, float(span))
    return None


def _on_grid(values: npt.NDArray[np.float32], origin: npt.NDArray[np.float32], spacing: np.float32) -> bool:
    numbers = np.rint((values - origin) / spacing).astype(np.float32)
    return bool(np.array_equal(numbers * spacing + origin, values))


def _octahedral(normals: npt.NDArray[np.float32], number: int) -> npt.NDArray[Any]:
    """Return normals (V, 3) after Draco's octahedral quantisation to ``number`` bits and back."""
    triangle = np.zeros((1, 3), np.uint32)
    grid = {"NORMAL": _Grid(number)}
    arrays = {"POSITION": np.zeros_like(normals), "NORMAL": normals}
    return _encoded(arrays, triangle, 0, {}, grid).values["NORMAL"]


def _encoded(
    arrays: Mapping[str, npt.NDArray[Any]],
    faces: npt.NDArray[Any],
    level: int,
    wanted: Mapping[str, int],
    grids: Mapping[str, _Grid],
) -> Encoded:
    draco = codec("DracoPy")
    bits = {**wanted, **{name: grid.bits for name, grid in grids.items()}}
    native = {name: np.asarray(arrays[name], np.float64) for name in bits}  # its type check needs doubles
    generic = [name for name in arrays if name not in native and name != "POSITION"]
    grid = grids.get("POSITION", _Grid(0))
    data = bytes(
        draco.encode(
            np.ascontiguousarray(arrays["POSITION"]),
            np.ascontiguousarray(faces, dtype=np.uint32),
            quantization_bits=bits.get("POSITION", 0),
            quantization_range=grid.extent,
            quantization_origin=grid.origin,
            compression_level=level,
            preserve_order=True,
            normals=native.get("NORMAL"),
            normal_quantization_bits=bits.get("NORMAL"),
            tex_coord=native.get("TEXCOORD_0"),
            tex_coord_quantization_bits=bits.get("TEXCOORD_0"),
            generic_attributes={
                number: np.ascontiguousarray(arrays[name]) for number, name in enumerate(generic)
            },
        )
    )
    names = dict(enumerate(generic))
    entries = {
        names.get(entry["unique_id"]) or _TYPES[entry["attribute_type"]]: entry
        for entry in draco.decode(data).attributes
    }
    values = {name: entry["data"].astype(arrays[name].dtype) for name, entry in entries.items()}
    return Encoded(data, {name: int(entry["unique_id"]) for name, entry in entries.items()}, values)
