"""Buffer views compressed by meshopt: read like the reference decoder reads them, or refused."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshopt
import numpy as np
import pytest

from fixtures.builder import AnyArray, JsonObject, pack_glb
from skinbake.commands.inspect import inspect_file
from skinbake.errors import InputError, Place
from skinbake.gltf.codecs import meshopt as codec
from skinbake.gltf.codecs.meshopt import view_bytes
from skinbake.gltf.codecs.meshopt_filters import unfiltered
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from tests.support import corpus
from tests.support.command_line import invoke
from tests.support.compressed import EXT, KHR, meshopt_twin
from tests.support.decoders import read_plain
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, bake

PLACE = Place("x")
RANDOM = np.random.default_rng(8)
COUNT = 3000


def unit_vectors(columns: int) -> AnyArray:
    vectors = RANDOM.normal(size=(COUNT, 4))
    return np.asarray(vectors / np.linalg.norm(vectors[:, :columns], axis=1)[:, None])


@pytest.mark.parametrize("name", ["barbarian-EXT_meshopt-high.glb", "barbarian-EXT_meshopt-medium.glb"])
def test_reads_what_the_reference_decoder_reads(name: str) -> None:
    path = corpus.model(name)
    document, theirs = read_document(str(path)), read_plain(path)
    for number in range(len(theirs.content["bufferViews"])):
        assert bytes(view_bytes(document, number, PLACE)) == theirs.buffer_view(number)


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("name", [EXT, KHR])
@pytest.mark.parametrize("fixture", ["foreign_joints.glb", "two_sets.glb", "bent_tube.glb"])
def test_a_twin_reads_like_its_original(fixture: str, name: str, beside: bool, tmp_path: Path) -> None:
    path = meshopt_twin(FOLDER / fixture, tmp_path / "twin.glb", name=name, beside=beside)
    arrays = []
    for file in (FOLDER / fixture, path):
        document = read_document(str(file))
        arrays.append([read_primitive(document, source) for source in skinned_sources(document)])
    for ours, theirs in zip(*arrays, strict=True):
        for attribute in ("positions", "normals", "joints", "weights", "triangles"):
            assert np.array_equal(getattr(ours, attribute), getattr(theirs, attribute))


FILTERS: list[tuple[str, AnyArray, str, int]] = [
    ("OCTAHEDRAL", meshopt.encode_filter_oct(unit_vectors(3), 4, 8), "<i1", 1),
    ("OCTAHEDRAL", meshopt.encode_filter_oct(unit_vectors(3), 8, 12), "<i2", 1),
    ("QUATERNION", meshopt.encode_filter_quat(unit_vectors(4), 8, 12), "<i2", 1),
    ("EXPONENTIAL", meshopt.encode_filter_exp(unit_vectors(3)[:, :3], 15), "<f4", 0),
    ("COLOR", meshopt.encode_filter_color(RANDOM.random((COUNT, 4)), 4, 8), "<u1", 1),
    ("COLOR", meshopt.encode_filter_color(RANDOM.random((COUNT, 4)), 8, 12), "<u2", 1),
]


@pytest.mark.parametrize(("name", "rows", "dtype", "units"), FILTERS)
def test_filters_give_what_both_of_meshoptimizers_builds_give(
    name: str, rows: AnyArray, dtype: str, units: int, tmp_path: Path
) -> None:
    """Within a unit: the native build and that for browsers themselves differ by one, at halves.

    Octahedral bytes use the processor's estimate of 1 / sqrt, and the two round halves in different ways.
    """
    stream = meshopt.encode_vertex_buffer_level(rows, 2, 1)
    found = unfiltered(rows.copy(), name).view(dtype).astype(np.float64)
    native = meshopt.decode_vertex_buffer(stream, len(rows), rows.shape[1], name)
    extension = {
        "buffer": 0,
        "byteLength": len(stream),
        "mode": "ATTRIBUTES",
        "filter": name,
        "count": len(rows),
        "byteStride": rows.shape[1],
    }
    content: JsonObject = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [KHR],
        "buffers": [{"byteLength": len(stream)}, {"byteLength": rows.size}],
        "bufferViews": [{"buffer": 1, "byteLength": rows.size, "extensions": {KHR: extension}}],
    }
    path = tmp_path / "filtered.glb"
    path.write_bytes(pack_glb(content, stream + bytes(-len(stream) % 4)))
    for theirs in (native.tobytes(), read_plain(path).buffer_view(0)):
        difference = np.abs(found.reshape(-1) - np.frombuffer(theirs, dtype).astype(np.float64))
        assert difference.max() <= units
        assert np.count_nonzero(difference) < 0.005 * difference.size
    assert bytes(view_bytes(read_document(str(path)), 0, PLACE)) == found.astype(dtype).tobytes()


def test_octahedral_vectors_have_length_one() -> None:
    vectors = unit_vectors(3)
    found = unfiltered(meshopt.encode_filter_oct(vectors, 8, 16), "OCTAHEDRAL").view("<i2") / 32767
    np.testing.assert_allclose(found[:, :3], vectors[:, :3], atol=1e-4)  # three steps of 16 bits
    np.testing.assert_allclose(np.linalg.norm(found[:, :3], axis=1), 1, atol=3e-5)


def test_no_number_breaks_a_filter() -> None:
    """Whatever is stored: zeros, extremes and noise end in numbers, without a warning."""
    for name, strides in codec.STRIDES_OF_FILTERS.items():
        for stride in {strides[0], strides[-1]}:
            noise = RANDOM.integers(0, 256, (64, stride)).astype(np.uint8)
            for rows in (np.zeros((4, stride), np.uint8), np.full((4, stride), 0x80, np.uint8), noise):
                assert unfiltered(rows.copy(), name).shape == rows.shape


def edit(**members: Any) -> Callable[[JsonObject], None]:
    """Change the extension of the view of POSITION (12 bytes an element, 112 of them)."""
    return lambda content: extension_of(content).update(members)


def extension_of(content: JsonObject) -> JsonObject:
    found: JsonObject = view_of(content)["extensions"][EXT]
    return found


def view_of(content: JsonObject) -> JsonObject:
    number = content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    found: JsonObject = content["bufferViews"][content["accessors"][number]["bufferView"]]
    return found


def shorten(content: JsonObject) -> None:
    extension_of(content)["byteLength"] -= 20


def lie(content: JsonObject) -> None:
    extension_of(content)["count"] = 1 << 28
    view_of(content)["byteLength"] = 12 << 28


WRONG: list[tuple[Callable[[JsonObject], Any], str]] = [
    (shorten, "cannot be decoded: Malformed buffer data"),
    (lie, "bytes for 268,435,456 elements of 12 bytes, but its codec needs at least 3,145,728"),
    (edit(count=111), "that is 1,332 bytes, but its byteLength is 1344"),
    (edit(count=0), '"count" must be an integer of at least 1'),
    (edit(byteStride=16), "that is 1,792 bytes, but its byteLength is 1344"),
    (edit(byteStride=6, count=224), "which contradict each other"),
    (edit(byteStride=336, count=4), "which contradict each other"),
    (edit(mode="TRIANGLES"), "mode 'TRIANGLES', filter 'NONE', byteStride 12, count 112, which contradict"),
    (edit(mode="TRIANGLES", byteStride=4, count=336), "cannot be decoded"),
    (edit(mode="INDICES", byteStride=2, count=672), "cannot be decoded"),
    (edit(mode="TRIANGLES", byteStride=4, count=335), "which contradict each other"),
    (edit(mode="WORDS"), "mode 'WORDS'"),
    (edit(filter="OCTAHEDRAL"), "filter 'OCTAHEDRAL', byteStride 12, count 112, which contradict each other"),
    (edit(filter="BLUR"), "filter 'BLUR'"),
    (edit(buffer=7), '"buffer" refers to entry 7'),
    (edit(buffer=1), "buffer 1 has no URI"),
    (edit(byteOffset=1 << 20), "ends at byte"),
    (lambda content: extension_of(content).pop("buffer"), "names no buffer"),
    (lambda content: view_of(content).update(extensions={EXT: 3}), f'"{EXT}" must be an object'),
    (lambda content: view_of(content).pop("extensions"), "buffer 1 has no URI and there is no BIN chunk"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_wrong_views_are_refused(change: Callable[[JsonObject], Any], message: str, tmp_path: Path) -> None:
    path = meshopt_twin(FOLDER / "foreign_joints.glb", tmp_path / "twin.glb", change=change)
    document = read_document(str(path))
    (source,) = skinned_sources(document)
    with pytest.raises(InputError, match=message) as caught:
        read_primitive(document, source)
    whole_file = "has no URI" in message
    where = "" if whole_file else 'mesh 0 "limb", primitive 0, POSITION'
    assert str(caught.value).startswith(f"{path}: {where}")


def test_a_fallback_buffer_whose_file_was_left_out_is_not_missed(tmp_path: Path) -> None:
    def named(content: JsonObject) -> None:
        content["buffers"][1]["uri"] = "fallback.bin"

    path = meshopt_twin(FOLDER / "foreign_joints.glb", tmp_path / "twin.glb", change=named)
    assert inspect_file(str(path)).primitives[0].vertices == 112
    bake(path, tmp_path / "baked.glb")


def test_on_stdout_a_fallback_buffer_is_brought_along_if_its_file_is_there(tmp_path: Path) -> None:
    def named(content: JsonObject) -> None:
        content["buffers"][1]["uri"] = "fallback.bin"

    path = meshopt_twin(FOLDER / "foreign_joints.glb", tmp_path / "twin.glb", change=named)
    for content in (None, bytes(read(path).content["buffers"][1]["byteLength"])):
        if content is not None:
            (tmp_path / "fallback.bin").write_bytes(content)
        answer = invoke("bake", path, "-o", "-")
        assert answer.exit_code == 0, answer.stderr
        (tmp_path / "out.glb").write_bytes(answer.stdout_bytes)
        uri = read(tmp_path / "out.glb").content["buffers"][1]["uri"]
        if content is None:
            assert uri == "fallback.bin"
        else:
            assert base64.b64decode(uri.removeprefix("data:application/octet-stream;base64,")) == content


@pytest.mark.parametrize("left_out", [{}, {"uri": "fallback.bin"}])
def test_a_hollow_first_buffer_does_not_become_the_bin_chunk(left_out: JsonObject, tmp_path: Path) -> None:
    """In a .gltf any buffer may be the fallback. It may name a file that was left out."""

    def swapped(content: JsonObject) -> None:
        content["buffers"].reverse()
        for view in content["bufferViews"]:
            for holder in (view, *view.get("extensions", {}).values()):
                holder["buffer"] = 1 - holder["buffer"]
        content["buffers"][0].update(left_out)
        content["buffers"][1]["uri"] = "data.bin"

    twin = meshopt_twin(FOLDER / "foreign_joints.glb", tmp_path / "twin.glb")
    (tmp_path / "data.bin").write_bytes(read(twin).binary_chunk or b"")
    path = meshopt_twin(FOLDER / "foreign_joints.glb", tmp_path / "twin.gltf", change=swapped)
    bake(path, tmp_path / "baked.glb")
    assert read(tmp_path / "baked.glb").content["buffers"][0] == read(path).content["buffers"][0]
    assert read_plain(tmp_path / "baked.glb").has_attribute("_SKINBAKE_ALPHA_0")
    for options in (["-o", "-"], ["-o", tmp_path / "packed.glb", "--pack"]):
        answer = invoke("bake", path, *options)
        assert answer.exit_code == 0, answer.stderr


class TestEncoder:
    @pytest.mark.parametrize("name", [EXT, KHR])
    @pytest.mark.parametrize("level", [0, 3])
    def test_attributes_come_back_exactly(self, name: str, level: int) -> None:
        values = (RANDOM.normal(size=(500, 3)) * 10.0 ** RANDOM.integers(-30, 30, (500, 1))).astype(
            np.float32
        )
        data, mode = codec.encoded(values, codec.ATTRIBUTES, name, level)
        assert mode == "ATTRIBUTES"
        assert data[0] == (0xA0 if name == EXT else 0xA1)  # the version of the codec
        assert meshopt.decode_gltf_buffer(data, 500, 12, "ATTRIBUTES").tobytes() == values.tobytes()

    @pytest.mark.parametrize("dtype", [np.uint16, np.uint32])
    def test_indices_come_back_in_their_order(self, dtype: type[np.unsignedinteger[Any]]) -> None:
        for values in (
            np.array([0, 1, 2, 2, 1, 3], dtype),
            np.array([2, 0, 1, 5, 9, 9], dtype),
            RANDOM.integers(0, 300, 999).astype(dtype),
        ):
            data, mode = codec.encoded(values[:, None], codec.TRIANGLES, EXT, 2)
            size = values.dtype.itemsize
            found = meshopt.decode_gltf_buffer(data, len(values), size, mode)
            assert np.array_equal(found, values)

    def test_triangles_take_their_own_codec_where_it_keeps_their_corners(self) -> None:
        for corners, mode in (([2, 1, 3], "TRIANGLES"), ([1, 3, 2], "INDICES")):
            values = np.array([0, 1, 2, *corners], np.uint16)[:, None]
            assert codec.encoded(values, codec.TRIANGLES, EXT, 2)[1] == mode
