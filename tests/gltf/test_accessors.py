"""Accessors of every format and layout against hand-packed bytes and the tests' own reader."""

from __future__ import annotations

import base64
import contextlib
import json
import struct
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.errors import InputError, Place
from skinbake.gltf.document import Document, parse_gltf
from skinbake.gltf.reading.accessors import StoredArray, read_accessor
from tests.support.gltf_reading import GltfFile

HERE = Place("made.gltf", 0, "body", 0, "POSITION")
# component type: (struct code, bytes, values at both ends and between)
FORMATS: dict[int, tuple[str, int, Sequence[float]]] = {
    5120: ("b", 1, (-128, -127, -1, 0, 1, 126, 127)),
    5121: ("B", 1, (0, 1, 2, 127, 128, 254, 255)),
    5122: ("h", 2, (-32768, -32767, -1, 0, 1, 32766, 32767)),
    5123: ("H", 2, (0, 1, 255, 256, 32768, 65534, 65535)),
    5125: ("I", 4, (0, 1, 65535, 65536, 2**31, 2**32 - 2, 2**32 - 1)),
    5126: ("f", 4, (-1.5, -0.0, 0.0, 2.0**-149, 0.5, 1.0, 2.0**127)),
}
LAYOUTS = ("packed", "offset", "interleaved", "sparse", "sparse over nothing")


def content(data: bytes, accessor: JsonObject, views: Sequence[JsonObject]) -> JsonObject:
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [{"buffer": 0, **view} for view in views],
        "accessors": [accessor],
    }


def document(of: JsonObject) -> Document:
    return parse_gltf(json.dumps(of).encode(), "made.gltf", Path())


def read(of: JsonObject) -> StoredArray:
    return read_accessor(document(of), 0, HERE)


def laid_out(layout: str, rows: Sequence[Sequence[float]], code: str, size: int) -> JsonObject:
    """Return buffer, views and accessor members that hold two-component rows in a layout."""
    packed = [struct.pack(f"<2{code}", *row) for row in rows]
    plain: JsonObject = {"count": len(rows), "type": "VEC2"}
    if layout == "packed":
        data = b"".join(packed)
        return content(data, {"bufferView": 0, **plain}, [{"byteLength": len(data)}])
    if layout == "offset":
        data = b"\xaa" * 8 + b"".join(packed) + b"\xbb" * 4
        view = {"byteOffset": 4, "byteLength": len(data) - 4}
        return content(data, {"bufferView": 0, "byteOffset": 4, **plain}, [view])
    if layout == "interleaved":
        stride = 2 * size + 8
        # The last element ends where the buffer ends: the stride's rest is not there.
        data = b"\xcc" * 4 + (b"\xdd" * 8).join(packed)
        view = {"byteStride": stride, "byteLength": len(data)}
        return content(data, {"bufferView": 0, "byteOffset": 4, **plain}, [view])
    replaced = [number for number, row in enumerate(rows) if layout == "sparse" or any(row)]
    kept = range(0) if layout == "sparse over nothing" else range(len(rows))
    base = b"".join(packed[number] if number % 2 else bytes(2 * size) for number in kept)
    indices = b"".join(struct.pack("<H", number) for number in replaced).ljust(16, b"\xee")
    values = b"".join(packed[number] for number in replaced)
    sparse: JsonObject = {
        "count": len(replaced),
        "indices": {"bufferView": 0, "componentType": 5123},
        "values": {"bufferView": 1, "byteOffset": 0},
    }
    data = indices + values + base
    views = [
        {"byteLength": 16},
        {"byteOffset": 16, "byteLength": len(values)},
        {"byteOffset": 16 + len(values), "byteLength": max(len(base), 1)},
    ]
    backed: JsonObject = {"bufferView": 2} if base else {}
    return content(data + b"\0", {**backed, **plain, "sparse": sparse}, views)


@pytest.mark.parametrize(
    ("kind", "component", "normalized", "expected"),
    [
        ("VEC3", 5126, False, ("VEC3 FLOAT", 12)),
        ("VEC4", 5121, True, ("VEC4 UNSIGNED_BYTE normalised", 4)),
        # Section 3.6.2.4 of glTF 2.0: each column begins at a multiple of 4 bytes.
        ("MAT2", 5121, False, ("MAT2 UNSIGNED_BYTE", 8)),
        ("MAT3", 5121, False, ("MAT3 UNSIGNED_BYTE", 12)),
        ("MAT3", 5123, False, ("MAT3 UNSIGNED_SHORT", 24)),
        ("MAT4", 5126, False, ("MAT4 FLOAT", 64)),
    ],
)
def test_a_format_is_told_with_its_bytes(
    kind: str, component: int, normalized: bool, expected: tuple[str, int]
) -> None:
    accessor = {"type": kind, "componentType": component, "normalized": normalized, "count": 5}
    made = document(content(b"", accessor, []))
    assert made.asset.accessors[0].described(HERE) == (expected[0], 5 * expected[1])


@pytest.mark.parametrize(
    ("kind", "component"),
    [
        ([], 5126),
        ({}, 5126),
        (None, 5126),
        (7, 5126),
        ("VEC9", 5126),
        ("VEC3", 1),
        ("MAT2", None),
        ("MAT3", []),
    ],
)
def test_a_format_that_the_standard_does_not_define_is_no_format(kind: object, component: object) -> None:
    made = document(content(b"", {"type": kind, "componentType": component, "count": 5}, []))
    with pytest.raises(InputError, match="glTF does not define"):
        made.asset.accessors[0].described(HERE)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("normalized", [False, True, None])
@pytest.mark.parametrize("component", FORMATS)
def test_every_format_reads_back(component: int, normalized: bool | None, layout: str) -> None:
    code, size, numbers = FORMATS[component]
    rows = list(zip(numbers, reversed(numbers), strict=True))
    made = laid_out(layout, rows, code, size)
    made["accessors"][0]["componentType"] = component
    if normalized is not None:
        made["accessors"][0]["normalized"] = normalized
    stored = read(made)
    assert stored.values.dtype == np.dtype(f"<{'f' if code == 'f' else 'iu'[code.isupper()]}{size}")
    assert stored.values.tolist() == [list(row) for row in rows]
    assert stored.normalized is (normalized is True and code != "f")
    if code == "f":
        # The specification allows no normalized floats; the member is ignored.
        made["accessors"][0].pop("normalized", None)
        assert stored.decoded().dtype == np.float32
    independent = GltfFile(Path("made.gltf"), made, None).values(0)
    assert stored.decoded().tolist() == independent.tolist()


@pytest.mark.parametrize(
    ("component", "code", "value", "expected"),
    [
        (5120, "b", -128, -1.0),
        (5120, "b", 127, 1.0),
        (5121, "B", 51, 0.2),
        (5122, "h", -32768, -1.0),
        (5123, "H", 13107, 0.2),
    ],
)
def test_normalised_integers_mean_what_the_specification_says(
    component: int, code: str, value: int, expected: float
) -> None:
    data = struct.pack(f"<{code}", value).ljust(4, b"\0")
    accessor = {
        "bufferView": 0,
        "componentType": component,
        "count": 1,
        "type": "SCALAR",
        "normalized": True,
    }
    made = content(data, accessor, [{"byteLength": 4}])
    assert read(made).decoded()[0, 0] == expected


@pytest.mark.parametrize(("kind", "components"), [("SCALAR", 1), ("VEC3", 3), ("VEC4", 4), ("MAT4", 16)])
def test_the_type_says_how_many_components(kind: str, components: int) -> None:
    numbers = [float(number) for number in range(2 * components)]
    data = struct.pack(f"<{len(numbers)}f", *numbers)
    accessor = {"bufferView": 0, "componentType": 5126, "count": 2, "type": kind}
    made = content(data, accessor, [{"byteLength": len(data)}])
    assert read(made).values.tolist() == [numbers[:components], numbers[components:]]


def test_an_accessor_without_a_view_is_all_zeros() -> None:
    made = content(b"\xff", {"componentType": 5123, "count": 3, "type": "VEC2"}, [])
    assert read(made).values.tolist() == [[0, 0]] * 3


def test_sparse_values_do_not_reach_the_buffer() -> None:
    made = laid_out("sparse", [(1, 2), (3, 4)], "H", 2)
    made["accessors"][0]["componentType"] = 5123
    parsed = document(made)
    before = bytes(parsed.buffer(0))
    read_accessor(parsed, 0, HERE)
    assert bytes(parsed.buffer(0)) == before


def test_whole_floats_count_as_integers() -> None:
    """Some exporters write 2.0 for 2."""
    made = content(
        struct.pack("<4H", 1, 2, 3, 4),
        {"bufferView": 0.0, "byteOffset": 4.0, "componentType": 5123, "count": 2.0, "type": "SCALAR"},
        [{"byteLength": 8.0, "byteStride": 2.0}],
    )
    assert read(made).values.tolist() == [[3], [4]]


def test_the_declared_count_needs_no_data() -> None:
    made = content(b"\0", {"bufferView": 7, "componentType": 5126, "count": 10**12, "type": "VEC3"}, [])
    assert document(made).asset.accessors[0].count(HERE) == 10**12


def plain() -> JsonObject:
    """Return six VEC2 shorts with a stride of eight, and a sparse substitution of the second."""
    rows = b"".join(struct.pack("<hh4x", number, -number) for number in range(6))
    sparse = struct.pack("<I", 1) + struct.pack("<hh", 7, 8)
    return content(
        rows + sparse,
        {
            "bufferView": 0,
            "componentType": 5122,
            "count": 6,
            "type": "VEC2",
            "sparse": {
                "count": 1,
                "indices": {"bufferView": 1, "componentType": 5125},
                "values": {"bufferView": 2},
            },
        },
        [
            {"byteLength": 48, "byteStride": 8},
            {"byteOffset": 48, "byteLength": 4},
            {"byteOffset": 52, "byteLength": 4},
        ],
    )


ACCESSOR, SPARSE = ("accessors", 0), ("accessors", 0, "sparse")
INDICES, VALUES = (*SPARSE, "indices"), (*SPARSE, "values")
VIEW, INDEX_VIEW = ("bufferViews", 0), ("bufferViews", 1)
REJECTIONS: list[tuple[tuple[str | int, ...], str, Any, str]] = [
    (ACCESSOR, "componentType", 5124, "glTF does not define"),
    (ACCESSOR, "componentType", 5122.5, "glTF does not define"),
    (ACCESSOR, "componentType", "5122", "glTF does not define"),
    (ACCESSOR, "componentType", True, "glTF does not define"),
    (ACCESSOR, "componentType", None, "of component type null, which glTF does not define"),
    (ACCESSOR, "componentType", [5122], "glTF does not define"),
    (ACCESSOR, "type", "VEC5", "glTF does not define"),
    (ACCESSOR, "type", "vec2", "glTF does not define"),
    (ACCESSOR, "type", 2, "glTF does not define"),
    (ACCESSOR, "type", ["VEC2"], "glTF does not define"),
    (ACCESSOR, "count", 0, '"count" must be an integer of at least 1, found 0'),
    (ACCESSOR, "count", -1, '"count" must be'),
    (ACCESSOR, "count", 2.5, '"count" must be'),
    (ACCESSOR, "count", "6", "\"count\" must be an integer of at least 1, found '6'"),
    (ACCESSOR, "count", True, '"count" must be an integer of at least 1, found true'),
    (ACCESSOR, "count", None, '"count" must be an integer of at least 1, found null'),
    (ACCESSOR, "count", 7, "7 elements need 52 bytes of buffer view 0, which has 48"),
    (ACCESSOR, "count", 2**53, "which has 48"),
    (ACCESSOR, "count", 2**53 + 1, '"count" must be an integer of at most 9,007,199,254,740,992, found 9007'),
    (ACCESSOR, "count", 1e300, '"count" must be an integer of at most'),
    (ACCESSOR, "bufferView", 3, '"bufferView" refers to entry 3 of an array of 3'),
    (ACCESSOR, "bufferView", -1, '"bufferView" must be'),
    (ACCESSOR, "bufferView", "0", '"bufferView" must be'),
    (ACCESSOR, "bufferView", None, '"bufferView" must be'),
    (ACCESSOR, "byteOffset", 5, "6 elements need 49 bytes of buffer view 0, which has 48"),
    (ACCESSOR, "byteOffset", -4, '"byteOffset" must be'),
    (ACCESSOR, "byteOffset", False, '"byteOffset" must be'),
    (ACCESSOR, "byteOffset", 2**53, "which has 48"),
    (ACCESSOR, "sparse", [], '"sparse" must be an object'),
    (VIEW, "byteStride", 3, "byteStride 3 for elements of 4 bytes"),
    (VIEW, "byteStride", 0, '"byteStride" must be'),
    (VIEW, "byteStride", 12, "6 elements need 64 bytes"),
    (VIEW, "byteStride", "8", '"byteStride" must be'),
    (VIEW, "byteLength", 57, "buffer view 0 ends at byte 57 of buffer 0, which has 56"),
    (VIEW, "byteLength", 0, '"byteLength" must be'),
    (VIEW, "byteLength", 1.5, '"byteLength" must be'),
    (VIEW, "byteOffset", 9, "ends at byte 57"),
    (VIEW, "byteOffset", -1, '"byteOffset" must be'),
    (VIEW, "buffer", 1, '"buffer" refers to entry 1 of an array of 1'),
    (VIEW, "buffer", {}, '"buffer" must be'),
    (SPARSE, "count", 0, '"count" must be'),
    (SPARSE, "count", 2, "2 elements need 8 bytes of buffer view 1, which has 4"),
    (SPARSE, "indices", 1, '"indices" must be an object'),
    (SPARSE, "values", [], '"values" must be an object'),
    (INDICES, "componentType", 5122, "not unsigned integers"),
    (INDICES, "componentType", 5126, "not unsigned integers"),
    (INDICES, "bufferView", 9, '"bufferView" refers to entry 9'),
    (INDICES, "byteOffset", 1, "1 element needs 5 bytes of buffer view 1"),
    (VALUES, "byteOffset", 4, "1 element needs 8 bytes of buffer view 2"),
    (VALUES, "bufferView", 2.5, '"bufferView" must be'),
    (INDEX_VIEW, "byteOffset", 44, "a sparse accessor replaces element 327685, but it has only 6"),
]


def at(root: JsonObject, path: Sequence[str | int]) -> JsonObject:
    found: Any = root
    for step in path:
        found = found[step]
    result: JsonObject = found
    return result


@pytest.mark.parametrize(("path", "key", "value", "message"), REJECTIONS)
def test_contradictions_are_refused(path: tuple[str | int, ...], key: str, value: Any, message: str) -> None:
    made = plain()
    if path == INDEX_VIEW:
        # Element 5 of the rows, read as one unsigned int: 5 | −5 << 16 without its sign, 5 | 5 << 16 here.
        data = bytearray(base64.b64decode(made["buffers"][0]["uri"].split(",")[1]))
        data[44:48] = struct.pack("<HH", 5, 5)
        made["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(data).decode()
    at(made, path)[key] = value
    with pytest.raises(InputError, match=message) as caught:
        read(made)
    assert str(caught.value).startswith('made.gltf: mesh 0 "body", primitive 0, POSITION: ')


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (["count"], '"count" must be an integer of at least 1, and it is missing'),
        (["type"], 'accessor 0 has no "type"'),
        (["type", "componentType"], 'accessor 0 has no "type" and no "componentType"'),
    ],
)
def test_missing_members_are_told_from_null(keys: list[str], message: str) -> None:
    made = plain()
    for key in keys:
        del made["accessors"][0][key]
    with pytest.raises(InputError) as caught:
        read(made)
    assert caught.value.message == message


def test_a_sparse_index_just_past_the_end_is_refused() -> None:
    for number, refused in ((5, False), (6, True)):
        made = plain()
        data = bytearray(base64.b64decode(made["buffers"][0]["uri"].split(",")[1]))
        data[48:52] = struct.pack("<I", number)
        made["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(data).decode()
        if refused:
            with pytest.raises(InputError, match="a sparse accessor replaces element 6, but it has only 6"):
                read(made)
        else:
            assert read(made).values[5].tolist() == [7, 8]


MISSING: list[tuple[Callable[[JsonObject], Any], str]] = [
    (lambda made: made["accessors"][0].pop("count"), '"count" must be'),
    (lambda made: made["bufferViews"][0].pop("byteLength"), '"byteLength" must be'),
    (lambda made: made["bufferViews"][0].pop("buffer"), "buffer view 0 names no buffer"),
    (lambda made: made["accessors"][0]["sparse"].pop("count"), '"count" must be'),
    (lambda made: made["accessors"][0]["sparse"].pop("indices"), "not unsigned integers"),
    (lambda made: made["accessors"][0]["sparse"].pop("values"), "names no buffer view"),
    (lambda made: made["accessors"][0]["sparse"]["indices"].pop("bufferView"), "names no buffer view"),
]


@pytest.mark.parametrize(("remove", "message"), MISSING)
def test_missing_members_are_refused(remove: Callable[[JsonObject], Any], message: str) -> None:
    made = plain()
    remove(made)
    with pytest.raises(InputError, match=message):
        read(made)


@pytest.mark.parametrize("member", ["count", "byteOffset"])
def test_integers_of_all_digits_that_python_reads_are_refused(member: str) -> None:
    """Their sums and products have more digits, and Python cannot write those in a message."""
    made = plain()
    made["accessors"][0][member] = int("9" * 4300)
    with pytest.raises(InputError, match=f'"{member}" must be an integer of at most'):
        read(made)


def test_the_plain_accessor_is_fine() -> None:
    """The document that the rejections start from would pass."""
    assert read(plain()).values.tolist() == [[0, 0], [7, 8], [2, -2], [3, -3], [4, -4], [5, -5]]


@pytest.mark.parametrize("count", [2**21, 2**31, 2**53])
def test_huge_counts_without_data_take_no_memory(count: int) -> None:
    parsed = document(content(b"\0", {"componentType": 5126, "count": count, "type": "VEC4"}, []))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="has no buffer view"):
            read_accessor(parsed, 0, HERE)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("stride", [2**31, 2**63, 10**30])
def test_a_stride_past_all_memory_does_not_matter_to_one_element(stride: int) -> None:
    made = content(
        struct.pack("<2h", 3, 4),
        {"bufferView": 0, "componentType": 5122, "count": 1, "type": "VEC2"},
        [{"byteLength": 4, "byteStride": stride}],
    )
    with contextlib.suppress(InputError):  # past the 252 that glTF allows, a refusal is as good
        assert read(made).values.tolist() == [[3, 4]]
