"""Draco streams: read like the reference decoder reads them, refused before they do harm."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.errors import InputError, Place, UnsupportedFeatureError
from skinbake.gltf.codecs import draco_stream
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.meshes import read_primitive, reason_to_skip, skinned_sources
from tests.support import corpus, gltf_transform
from tests.support.baking import bake_file
from tests.support.compressed import draco_stream as encoded
from tests.support.compressed import draco_twin
from tests.support.decoders import read_plain
from tests.support.gltf_reading import DRACO, GltfFile, read
from tests.support.models import FOLDER, primitives, rewritten

TWIN = "foreign_joints.glb"
PLACE = Place("model.glb")
CORPUS = [
    "BathDay/bath_day.glb",  # JOINTS_0 of unsigned shorts
    "barbarian-draco-edgebreaker.glb",
    "hand_l-draco-sequential.glb",
]


def values(document: Document, accessor: int) -> Any:
    return read_accessor(document, accessor, document.place).values


@pytest.mark.slow
@pytest.mark.parametrize("name", CORPUS)
def test_reads_what_the_reference_decoder_reads(name: str) -> None:
    path = corpus.model(name)
    document, theirs = read_document(str(path)), read_plain(path)
    for _, _, primitive in primitives(theirs.content):
        for accessor in primitive["attributes"].values():
            stored = theirs.stored(accessor)
            found = values(document, accessor)
            assert (found.dtype, found.tobytes()) == (stored.dtype, stored.tobytes())
        assert np.array_equal(values(document, primitive["indices"]), theirs.stored(primitive["indices"]))


@pytest.mark.parametrize("name", ["foreign_joints.glb", "two_sets.glb", "weights_u16.glb", "weights_u8.glb"])
def test_a_lossless_twin_reads_like_its_original(name: str, tmp_path: Path) -> None:
    path = draco_twin(FOLDER / name, tmp_path / "twin.glb")
    arrays = []
    for file in (FOLDER / name, path):
        document = read_document(str(file))
        arrays.append([read_primitive(document, source) for source in skinned_sources(document)])
    for ours, theirs in zip(*arrays, strict=True):
        assert ours.positions.tobytes() == theirs.positions.tobytes()
        for attribute in ("normals", "joints", "weights", "triangles"):
            assert np.array_equal(getattr(ours, attribute), getattr(theirs, attribute))


def test_the_stream_counts_where_there_is_plain_data_too(tmp_path: Path) -> None:
    """A file for loaders without the extension: its plain vertices may have another order."""

    def with_wrong_fallback(content: JsonObject) -> None:
        position = content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
        content["accessors"][position]["bufferView"] = 0

    path = draco_twin(FOLDER / TWIN, tmp_path / "twin.glb", change=with_wrong_fallback)
    original = read(FOLDER / TWIN)
    accessor = original.content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    assert values(read_document(str(path)), accessor).tobytes() == original.stored(accessor).tobytes()


def test_a_missing_decoder_is_told_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = draco_twin(FOLDER / TWIN, tmp_path / "twin.glb")
    monkeypatch.setitem(sys.modules, "DracoPy", None)  # as where no package of that name is
    document = read_document(str(path))
    with pytest.raises(UnsupportedFeatureError, match="needs the package DracoPy, which is not installed"):
        read_primitive(document, next(iter(skinned_sources(document))))


@pytest.mark.parametrize("normalised", [False, True])
def test_signed_integers_come_back_as_such(normalised: bool) -> None:
    """DracoPy gives them as floats, divided by the largest value where the stream says so."""
    stored = np.array([[-127, 0, 127], [5, -6, 64]], np.int8)
    floats = (stored / np.float32(127) if normalised else stored).astype(np.float32)
    from skinbake.gltf.codecs.draco import _of_type

    found = _of_type(floats, (np.dtype(np.int8), 3, 2), 127, Place("x"))
    assert found.tolist() == stored.tolist()


def stream_of(path: Path) -> tuple[JsonObject, bytes, int, int]:
    """Return a model's JSON, its BIN chunk, and where in it the first stream begins and ends."""
    model = read(path)
    view = model.content["bufferViews"][
        model.content["meshes"][0]["primitives"][0]["extensions"][DRACO]["bufferView"]
    ]
    start = view["byteOffset"]
    return model.content, model.binary_chunk or b"", start, start + view["byteLength"]


def with_stream(path: Path, change: Callable[[bytes], bytes]) -> Path:
    """Rewrite a model with its first stream, the last thing in its BIN chunk, changed."""
    content, binary, start, end = stream_of(path)
    data = change(binary[start:end])
    view = content["bufferViews"][-1]
    view["byteLength"] = len(data)
    content["buffers"][0]["byteLength"] = start + len(data)
    return rewritten(GltfFile(path, content, binary[:start] + data), path)


def read_first(path: Path) -> Any:
    document = read_document(str(path))
    (source,) = skinned_sources(document)
    assert reason_to_skip(document, source, generate_normals=False) is None
    return read_primitive(document, source)


def varint(number: int) -> bytes:
    parts = []
    while number > 0x7F:
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*parts, number])


def with_counts(first: int, second: int) -> Callable[[bytes], bytes]:
    """Replace the two counts at the beginning of a sequential stream: triangles, vertices."""
    return lambda data: data[:11] + varint(first) + varint(second) + data[11 + len(varint(208)) + 1 :]


BROKEN: list[tuple[str, Callable[[bytes], bytes], str]] = [
    ("no stream", lambda data: b"DRACA" + data[5:], "does not begin with 'DRACO'"),
    ("empty", lambda data: b"D", "does not begin with 'DRACO'"),
    ("cut in the header", lambda data: data[:8], "is cut short"),
    ("cut in the counts", lambda data: data[:12], "is cut short"),
    ("cut in the data", lambda data: data[:-100], "cannot be decoded"),
    ("an old version", lambda data: data[:5] + b"\1\3" + data[7:], "version 1.3; glTF has 2.2"),
    ("a point cloud", lambda data: data[:7] + b"\0" + data[8:], "kind 0 and method 0: it is not a mesh"),
    ("an unknown method", lambda data: data[:8] + b"\7" + data[9:], "kind 1 and method 7: it is not a mesh"),
    (
        "more triangles",
        with_counts(209, 112),
        "declares 112 vertices and 627 indices, but its accessors declare 112",
    ),
    ("more vertices", with_counts(208, 1 << 31), "declares 2,147,483,648 vertices and 624 indices"),
    ("fewer vertices", with_counts(208, 111), "declares 111 vertices"),
    ("an endless number", lambda data: data[:11] + b"\xff" * 8 + data[19:], "a number that does not end"),
    (
        "endless metadata",
        lambda data: data[:9] + b"\0\x80\0" + b"\0\1\0" * 40 + data[11:],
        "nested too deep",
    ),
]


@pytest.mark.parametrize(("change", "message"), [case[1:] for case in BROKEN], ids=[c[0] for c in BROKEN])
def test_a_broken_stream_is_refused(change: Callable[[bytes], bytes], message: str, tmp_path: Path) -> None:
    path = with_stream(draco_twin(FOLDER / TWIN, tmp_path / "twin.glb"), change)
    with pytest.raises(InputError, match=message) as caught:
        read_first(path)
    assert str(caught.value).startswith(f'{path}: mesh 0 "limb", primitive 0')


def extension(**members: Any) -> Callable[[JsonObject], None]:
    return lambda content: content["meshes"][0]["primitives"][0]["extensions"][DRACO].update(members)


def accessor(name: str, **members: Any) -> Callable[[JsonObject], None]:
    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        number = primitive["indices"] if name == "indices" else primitive["attributes"][name]
        content["accessors"][number] |= members

    return change


WRONG_JSON: list[tuple[Callable[[JsonObject], Any], str]] = [
    (extension(bufferView=99), '"bufferView" refers to entry 99'),
    (
        extension(attributes={"POSITION": 9}),
        "its Draco stream has no attribute 9; it has 0, 1, 2, 3",
    ),
    (extension(attributes={"POSITION": 3, "COLOR_0": 1}), "has COLOR_0, but the primitive does not"),
    (extension(attributes={"POSITION": 1}), "values that do not fit the float32 of its accessor|components"),
    (extension(attributes=[]), '"attributes" must be an object'),
    (lambda content: content["meshes"][0]["primitives"][0].pop("indices"), "or the primitive has no indices"),
    (
        lambda content: content["meshes"][0]["primitives"][0]["extensions"][DRACO].pop("bufferView"),
        "names no buffer view",
    ),
    (
        accessor("NORMAL", count=111),
        "POSITION: it has 112 elements, but other attributes of its Draco stream have 111",
    ),
    (
        accessor("indices", count=621),
        "declares 112 vertices and 624 indices, but its accessors declare 112 and 621",
    ),
    (
        accessor("NORMAL", type="VEC4"),
        "holds 112 elements of 3 components, but the accessor declares 112 of 4",
    ),
    (accessor("POSITION", componentType=5123), "values that do not fit the uint16 of its accessor"),
]


@pytest.mark.parametrize(("change", "message"), WRONG_JSON)
def test_json_that_contradicts_the_stream_is_refused(
    change: Callable[[JsonObject], Any], message: str, tmp_path: Path
) -> None:
    path = draco_twin(FOLDER / TWIN, tmp_path / "twin.glb", change=change)
    with pytest.raises(InputError, match=message) as caught:
        read_first(path)
    assert str(caught.value).startswith(f'{path}: mesh 0 "limb", primitive 0')


COUNTS = [
    ({"indices": 630}, "declares 112 vertices and 624 indices, but its accessors declare 112 and 630"),
    ({"NORMAL": 111}, "it has 112 elements, but other attributes of its Draco stream have 111"),
    (dict.fromkeys(("POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0"), 113), "declare 113 and 624"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("counts", "message"), COUNTS)
def test_what_to_do_about_other_counts_works(counts: dict[str, int], message: str, tmp_path: Path) -> None:
    """gltf-transform copy decodes the stream, and its accessors are those of the original again."""
    gltf_transform.require_node()

    def change(content: JsonObject) -> None:
        for name, count in counts.items():
            accessor(name, count=count)(content)

    path, copy = draco_twin(FOLDER / TWIN, tmp_path / "twin.glb", change=change), tmp_path / "copy.glb"
    with pytest.raises(InputError, match=message) as caught:
        read_first(path)
    assert "gltf-transform copy" in caught.value.message
    assert "without Draco" in caught.value.message
    process = gltf_transform.run(["copy", path, copy])
    assert process.returncode == 0, process.stderr
    original, found = read(FOLDER / TWIN), read(copy)
    wanted, decoded = (next(iter(primitives(file.content)))[2] for file in (original, found))
    assert wanted["attributes"].keys() == decoded["attributes"].keys()
    for name, number in wanted["attributes"].items():
        assert np.array_equal(found.stored(decoded["attributes"][name]), original.stored(number)), name
    result = bake_file(copy, tmp_path / "baked.glb")
    assert result.status == "baked", result.notices


def test_a_strip_in_draco_is_refused(tmp_path: Path) -> None:
    path = draco_twin(
        FOLDER / TWIN,
        tmp_path / "twin.glb",
        change=lambda content: content["meshes"][0]["primitives"][0].update(mode=5),
    )
    with pytest.raises(UnsupportedFeatureError, match="a triangle strip in Draco"):
        read_first(path)


def test_an_accessor_of_two_streams_must_mean_the_same_in_both(tmp_path: Path) -> None:
    def with_another(content: JsonObject) -> None:
        first = content["meshes"][0]["primitives"][0]
        extension = {**first["extensions"][DRACO], "attributes": {"POSITION": 0}}
        content["meshes"].append({"primitives": [{**first, "extensions": {DRACO: extension}}]})

    path = draco_twin(FOLDER / TWIN, tmp_path / "twin.glb", change=with_another)
    with pytest.raises(UnsupportedFeatureError, match="stands for different values in two Draco streams"):
        read_first(path)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="only Linux tells what a process has")
def test_a_stream_wider_than_its_accessors_is_refused_in_bounded_memory(tmp_path: Path) -> None:
    """20,000 vertices of 4 × 127 constant integers, 40 MB where 0.2 are declared; the limit is lowered."""
    count = 20_000
    wide = np.zeros((count, 127), np.uint32)
    stream, _ = encoded(
        {"POSITION": np.zeros((count, 3), np.int32), **{f"_{n}": wide for n in range(4)}},
        np.zeros((1, 3), np.uint32),
    )
    (tmp_path / "stream.drc").write_bytes(stream)
    script = (
        "import sys, resource\n"
        "from pathlib import Path\n"
        "from skinbake.errors import InputError, Place\n"
        "from skinbake.gltf.codecs import draco_stream\n"
        "draco_stream.MEMORY_BASE = 1 << 26\n"
        "data = memoryview(Path(sys.argv[1]).read_bytes())\n"
        f"declared, place = ({count}, 3), Place('x')\n"
        "counts = draco_stream.check_counts(data, *declared, place)\n"
        f"try: draco_stream.decode(data, counts.method, {count * 12}, place)\n"
        "except InputError as error: print(error.message)\n"
        "status = Path('/proc/self/status').read_text()\n"
        "print(next(line.split()[1] for line in status.splitlines() if line.startswith('VmHWM')))\n"
        "print(resource.getrlimit(resource.RLIMIT_AS)[0])\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "stream.drc")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env=os.environ)
    message, used, limit = run.stdout.splitlines()
    assert message == "its Draco stream needs more memory than its accessors justify"
    assert int(used) < 160_000  # KiB; 64 MiB, 16 times what is declared, and what Python has
    assert limit == "-1"  # as before


def test_metadata_before_the_counts_is_passed_over() -> None:
    points = np.random.default_rng(1).random((30, 3)).astype(np.float32)
    faces = np.arange(30, dtype=np.uint32).reshape(10, 3)
    data = DracoPy.encode(
        points, faces, quantization_bits=0, preserve_order=True, create_metadata=True,
        generic_attributes={"name": points},
    )  # fmt: skip
    assert struct.unpack_from("<H", data, 9)[0] & draco_stream.METADATA_FLAG
    counts = draco_stream.read_counts(memoryview(data), Place("x"))
    assert (counts.vertices, counts.faces, counts.method) == (30, 10, draco_stream.SEQUENTIAL)


class TestEncoder:
    faces = np.array([[0, 1, 2], [2, 1, 3], [3, 1, 0], [0, 0, 0]])

    def arrays(self, count: int = 500, seed: int = 4) -> dict[str, Any]:
        random = np.random.default_rng(seed)
        return {
            "JOINTS_0": random.integers(0, 65536, (count, 4)).astype(np.uint16),
            "JOINTS_1": random.integers(0, 256, (count, 4)).astype(np.uint8),
            "POSITION": random.normal(size=(count, 3)).astype(np.float32),
            "NORMAL": random.normal(size=(count, 3)).astype(np.float32),
            "TEXCOORD_0": random.random((count, 2)).astype(np.float32),
            "_ALPHA": (random.normal(size=(count, 4)) * 10.0 ** random.integers(-30, 30, (count, 1))).astype(
                np.float32
            ),
        }

    def decoded(self, stream: draco_stream.Encoded) -> dict[str, Any]:
        entries = {entry["unique_id"]: entry["data"] for entry in DracoPy.decode(stream.data).attributes}
        return {name: entries[number] for name, number in stream.unique_ids.items()}

    def test_stores_every_value_and_the_order(self) -> None:
        arrays = self.arrays()
        stream = draco_stream.encode(arrays, self.faces, PLACE, level=7)
        found = self.decoded(stream)
        for name, array in arrays.items():
            assert found[name].astype(array.dtype).tobytes() == array.tobytes()
        assert np.array_equal(DracoPy.decode(stream.data).faces, self.faces)

    def test_stores_what_is_no_number(self) -> None:
        arrays = self.arrays(8)
        arrays["NORMAL"][3] = np.nan
        arrays["TEXCOORD_0"][2] = np.inf
        arrays["POSITION"][:] = -0.0
        found = self.decoded(draco_stream.encode(arrays, self.faces, PLACE, level=7))
        for name in ("NORMAL", "TEXCOORD_0", "POSITION"):
            assert found[name].tobytes() == arrays[name].tobytes()
        found = self.decoded(draco_stream.encode(arrays, self.faces, PLACE, level=7, bits={"NORMAL": 10}))
        assert found["NORMAL"].tobytes() == arrays["NORMAL"].tobytes()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"POSITION": np.zeros((8, 2), np.float32)}, "POSITION: it has 2 components, 3 are needed"),
            ({"POSITION": np.zeros((8, 1), np.float32)}, "POSITION: it has 1 component, 3 are needed"),
            ({"TEXCOORD_0": np.zeros((1, 2), np.float32)}, "TEXCOORD_0: it has 1 element, POSITION has 8"),
            ({"POSITION": np.zeros((3, 3), np.float32)}, "JOINTS_0: it has 8 elements, POSITION has 3"),
            ({"TEXCOORD_0": np.zeros((7, 2), np.float32)}, "TEXCOORD_0: it has 7 elements, POSITION has 8"),
            (None, "indices: index 8 is too large for 8 vertices"),
        ],
    )
    def test_gives_the_encoder_no_array_that_it_would_read_past(
        self, change: dict[str, Any] | None, message: str
    ) -> None:
        faces = self.faces if change else np.array([[0, 1, 8]])
        with pytest.raises(InputError) as refusal:
            draco_stream.encode({**self.arrays(8), **(change or {})}, faces, PLACE, level=7)
        assert message in str(refusal.value)

    @pytest.mark.parametrize("bits", [8, 11, 14, 16])
    def test_puts_quantised_floats_back_on_their_grid(self, bits: int) -> None:
        """The values come from Draco's own quantisation; the stream is smaller than one of plain floats."""
        arrays = self.arrays(3000)
        raw = draco_stream.encode(arrays, self.faces, PLACE, level=7)
        numbers = {"POSITION": bits, "NORMAL": bits, "TEXCOORD_0": bits}
        coarse = draco_stream.encode(arrays, self.faces, PLACE, level=7, bits=numbers)
        assert coarse.values["POSITION"].tobytes() != arrays["POSITION"].tobytes()
        again = draco_stream.encode({**arrays, **coarse.values}, self.faces, PLACE, level=7)
        found = self.decoded(again)
        for name in numbers:
            assert found[name].tobytes() == coarse.values[name].tobytes()
        assert len(again.data) < len(raw.data) - 3000 * 11

    def test_values_too_far_apart_to_quantise_stay_exact(self) -> None:
        """Draco would compute their extent as infinite, and die by a segmentation fault."""
        arrays = self.arrays()
        arrays["POSITION"][0], arrays["POSITION"][1] = -3e38, 3e38
        found = self.decoded(draco_stream.encode(arrays, self.faces, PLACE, level=7, bits={"POSITION": 8}))
        assert found["POSITION"].tobytes() == arrays["POSITION"].tobytes()

    def test_quantises_what_is_asked_for_alone(self) -> None:
        arrays = self.arrays()
        found = self.decoded(draco_stream.encode(arrays, self.faces, PLACE, level=7, bits={"POSITION": 10}))
        extent = float(np.ptp(arrays["POSITION"], axis=0).max())
        off = np.abs(found["POSITION"] - arrays["POSITION"]).max()
        assert 0 < off <= extent / 1023 / 2 * 1.001  # half a step, and the rounding of float32
        for name in ("NORMAL", "TEXCOORD_0", "_ALPHA"):
            assert found[name].tobytes() == arrays[name].tobytes()


LIMITED = """
import resource, threading
from skinbake.gltf.codecs import draco_stream

before = resource.getrlimit(resource.RLIMIT_AS)
with draco_stream._memory_limit(1 << 30):
    assert resource.getrlimit(resource.RLIMIT_AS) != before
found = []
is_begun, is_over = threading.Event(), threading.Event()

def decode():
    with draco_stream._memory_limit(1 << 30):
        found.append(resource.getrlimit(resource.RLIMIT_AS))
        is_begun.set()
        is_over.wait(10)

thread = threading.Thread(target=decode)
thread.start()
is_begun.wait(10)
with draco_stream._memory_limit(1 << 30):
    is_over.set()
    thread.join()
    found.append(resource.getrlimit(resource.RLIMIT_AS))
assert found == [before, before]
assert resource.getrlimit(resource.RLIMIT_AS) == before
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the limit")
def test_threads_of_a_program_keep_the_memory_that_it_has() -> None:
    """A limit of the process holds for all of them, and two decoders would restore each other's.

    It takes a program of its own: other tests may have left a thread in this one.
    """
    process = subprocess.run([sys.executable, "-c", LIMITED], capture_output=True, check=False, timeout=60)
    assert process.returncode == 0, process.stderr.decode()
