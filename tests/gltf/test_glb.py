"""The GLB container against bytes packed by hand (glTF 2.0 specification, §4)."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence

import pytest

from skinbake.errors import InputError, OutputError, Place, UnsupportedFeatureError
from skinbake.gltf import glb
from skinbake.gltf.glb import GlbChunks, join_glb, split_glb

HERE = Place("test.glb")
Chunk = tuple[bytes, bytes]
JSON: Chunk = (b"JSON", b"{}  ")
BIN: Chunk = (b"BIN\0", b"\x01\x02\x03\x04")
EXTRA: Chunk = (b"XTRA", b"abcdefgh")
XTRA = int.from_bytes(b"XTRA", "little")


def packed(chunks: Sequence[Chunk], *, magic: bytes = b"glTF", version: int = 2, longer: int = 0) -> bytes:
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)
    return struct.pack("<4sII", magic, version, 12 + len(body) + longer) + body


def split(data: bytes) -> GlbChunks:
    return split_glb(data, HERE)


def test_chunks_come_apart() -> None:
    chunks = split(packed([JSON, BIN]))
    assert (bytes(chunks.json), bytes(chunks.binary or b"")) == (JSON[1], BIN[1])
    assert (chunks.others, bytes(chunks.trailing)) == ((), b"")


def test_a_glb_needs_no_bin_chunk() -> None:
    assert split(packed([JSON])).binary is None


def test_an_empty_bin_chunk_is_one() -> None:
    assert split(packed([JSON, (b"BIN\0", b"")])).binary == b""


def test_unknown_chunks_and_trailing_bytes_are_kept() -> None:
    chunks = split(packed([JSON, BIN, EXTRA, (b"MORE", b"")]) + b"tail")
    assert [(kind, bytes(data)) for kind, data in chunks.others] == [
        (XTRA, EXTRA[1]),
        (int.from_bytes(b"MORE", "little"), b""),
    ]
    assert bytes(chunks.trailing) == b"tail"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "it is empty"),
        (b'\xef\xbb\xbf {"asset": {}}', r"this is JSON text, not a GLB: name it \.gltf"),
        (b"glTF\x02\0\0\0", "8 bytes"),
        (packed([JSON], magic=b"gltf"), "does not begin with 'glTF'"),
        (b'{"asset": {"version": "2.0"}}', r"name it \.gltf"),
        (packed([JSON], longer=1), r"is cut short: .*; copy or download it again$"),
        (packed([JSON, BIN])[:-1], "cut short"),
        (packed([]), "first chunk of the GLB is not JSON"),
        (struct.pack("<4sII", b"glTF", 2, 0) + packed([JSON])[12:], "first chunk of the GLB is not JSON"),
        (packed([BIN, JSON]), "first chunk of the GLB is not JSON"),
        (packed([EXTRA, JSON]), "first chunk of the GLB is not JSON"),
        (packed([JSON, JSON]), "second JSON or BIN"),
        (packed([JSON, BIN, BIN]), "second JSON or BIN"),
        (packed([JSON, EXTRA, BIN]), "in the wrong place"),
        (packed([JSON], longer=4) + b"\0\0\0\0", "inside the chunk header at byte 24"),
    ],
)
def test_a_container_that_contradicts_itself_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        split(data)
    assert str(caught.value).startswith("test.glb: ")
    assert not isinstance(caught.value, UnsupportedFeatureError)


@pytest.mark.parametrize(
    ("kind", "name"), [(b"JSON", "JSON chunk"), (b"BIN\0", "BIN chunk"), (b"XTRA", "chunk")]
)
def test_a_chunk_of_a_wrong_length_is_told_which_of_two_things_is_wrong(kind: bytes, name: str) -> None:
    front = [] if kind == b"JSON" else [JSON]
    at = len(packed(front))
    for held, declared in itertools.product(range(9), [*range(13), 2**32 - 4, 2**32 - 1]):
        data = bytearray(packed([*front, (kind, bytes(held))]))
        struct.pack_into("<I", data, at, declared)
        wrong = [
            *(["not a multiple of 4"] if declared % 4 else []),
            *([f"more than the {held} byte{'' if held == 1 else 's'} left"] if declared > held else []),
        ]
        if not wrong:
            continue
        with pytest.raises(InputError) as caught:
            split(bytes(data))
        assert str(caught.value) == (
            f"test.glb: the GLB's {name} at byte {at} has the length {declared:,}, {' and '.join(wrong)}: "
            "export the file again"
        )


@pytest.mark.parametrize("version", [0, 1, 3])
def test_container_versions_but_2_are_unsupported(version: int) -> None:
    with pytest.raises(UnsupportedFeatureError, match=f"version {version}"):
        split(packed([JSON], version=version))


def test_every_truncation_is_refused() -> None:
    whole = packed([JSON, BIN, EXTRA])
    for length in range(len(whole)):
        with pytest.raises(InputError):
            split(whole[:length])


def test_joining_pads_json_with_spaces_and_bin_with_zeros() -> None:
    joined = b"".join(join_glb(b"{}", [b"\x01\x02", b"\x03\x04\x05"], [(XTRA, b"x")]))
    assert joined == packed([JSON, (b"BIN\0", b"\x01\x02\x03\x04\x05\0\0\0"), (b"XTRA", b"x\0\0\0")])


def test_joining_what_was_split_gives_the_same_bytes() -> None:
    whole = packed([JSON, BIN, EXTRA]) + b"tail"
    chunks = split(whole)
    assert chunks.binary is not None
    assert b"".join([*join_glb(bytes(chunks.json), [chunks.binary], chunks.others), chunks.trailing]) == whole


def test_joining_without_a_bin_chunk_writes_none() -> None:
    assert b"".join(join_glb(b"{}  ", None, [])) == packed([JSON])


def test_more_bytes_than_the_header_can_say_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glb, "MAX_LENGTH", 36)
    assert sum(map(len, join_glb(b"{}  ", [b"1234"], []))) == 36
    monkeypatch.setattr(glb, "MAX_LENGTH", 35)
    with pytest.raises(OutputError, match=r"36 bytes.*write \.gltf"):
        join_glb(b"{}  ", [b"1234"], [])
