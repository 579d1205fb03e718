"""Causes that the fuzzer found, each cut down to a small file and the command that went wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fixtures.builder import AnyArray, JsonObject, pack_glb
from skinbake.format.digests import array_digest
from skinbake.geometry.frames import tangent_deviation
from skinbake.geometry.rig import Rig
from tests.support.command_line import invoke
from tests.support.compressed import draco_twin
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, bake, baked, edited, rewritten, sheet, write_model

REPOSITORY = Path(__file__).resolve().parents[2]
SIGNALLING = 0x7F800001
"""The bits of a not-a-number that processors announce when they convert it."""


def with_two_sets(path: Path, joints: AnyArray) -> Path:
    """Write a sheet with a second set of influences, whose joints are of another type than the first's."""
    weights = np.zeros((20, 4), np.uint8)
    return write_model(path, [sheet(JOINTS_1=joints, WEIGHTS_1=weights)])


def _with_a_target(content: JsonObject) -> None:
    """Make a morph target of the attribute _MOVED."""
    (primitive,) = content["meshes"][0]["primitives"]
    primitive["targets"] = [{"POSITION": primitive["attributes"].pop("_MOVED")}]


class TestNotANumbers:
    def test_influences_of_different_types_are_joined_without_a_warning(self, tmp_path: Path) -> None:
        """Sets of different types become one array of float64: each weight is converted."""
        path = with_two_sets(tmp_path / "sets.glb", np.zeros((20, 4), np.uint8))
        model = read(path)
        primitive = model.content["meshes"][0]["primitives"][0]
        primitive["extras"] = {"skinbake": {"version": 1, "adopted": {"JOINTS_0": 2}, "digest": {}}}
        number = primitive["attributes"]["WEIGHTS_0"]
        view = model.content["bufferViews"][model.content["accessors"][number]["bufferView"]]
        data = bytearray(model.binary_chunk or b"")
        start = view.get("byteOffset", 0)
        data[start : start + 4] = SIGNALLING.to_bytes(4, "little")
        path.write_bytes(pack_glb(model.content, bytes(data)))
        result = invoke("strip", path, "-o", tmp_path / "out.glb")
        assert result.exit_code == 0, result.output

    def test_tangents_that_are_none_lean_as_far_as_can_be(self) -> None:
        normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
        tangents = np.tile(np.array([1, 0, 0, 1], np.float32), (4, 1))
        tangents[1, :3] = normals[1] = 3e38
        tangents[2].view(np.uint32)[:] = SIGNALLING
        tangents[3, 3] = np.inf
        assert tangent_deviation(normals, tangents).tolist() == [0, 180, 180, 180]  # a huge one overflows

    def test_morph_targets_of_odd_numbers_are_baked_without_a_warning(self, tmp_path: Path) -> None:
        """A normal that is no number, an infinite one, and differences that no float32 holds over slivers."""
        positions, normals = sheet().attributes["POSITION"].copy(), sheet().attributes["NORMAL"].copy()
        positions[:, :2] *= np.float32(1e-19)
        normals.view(np.uint32)[3] = SIGNALLING
        normals[7, 0] = np.inf
        source = write_model(
            tmp_path / "in.glb",
            [sheet(POSITION=positions, NORMAL=normals, _MOVED=positions * np.float32(1e38))],
            change=_with_a_target,
        )
        result = invoke("bake", source, "-o", tmp_path / "out.glb", "--morph-normals", "--morph-frames")
        assert result.exit_code == 0, result.output
        assert invoke("strip", tmp_path / "out.glb", "-o", tmp_path / "back.glb").exit_code == 0
        assert (tmp_path / "back.glb").read_bytes() == source.read_bytes()

    def test_a_digest_is_of_the_bytes_as_they_are_converted(self) -> None:
        """Values that the noted type cannot hold have a digest too, the same each time."""
        values = np.array([[np.nan, -1.0], [1e300, 70_000.0]])
        assert len({array_digest(values, "<u2"), array_digest(values.copy(), "<u2")}) == 1
        assert array_digest(values, "<f4") != array_digest(np.zeros((2, 2)), "<f4")


class TestDraco:
    def test_a_stream_under_sparse_accessors_is_not_written_again(self, tmp_path: Path) -> None:
        """Which values it would hold, programs do not agree on: a second bake took them for edited."""
        path = write_model(tmp_path / "plain.glb", [sheet()])

        def cover(content: JsonObject) -> None:
            number = content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
            view = {"buffer": 0, "byteOffset": 0, "byteLength": 12}
            content["bufferViews"] += [dict(view, byteLength=1), view]
            views = len(content["bufferViews"])
            where = {"bufferView": views - 2, "componentType": 5121}
            content["accessors"][number]["sparse"] = {
                "count": 1, "indices": where, "values": {"bufferView": views - 1}
            }  # fmt: skip

        source = draco_twin(path, tmp_path / "sparse.glb", change=cover)
        once, twice = tmp_path / "once.glb", tmp_path / "twice.glb"
        assert bake(source, once).notices == ()
        streams = [read(path).primitive(0)["extensions"] for path in (source, once)]
        assert streams[0] == streams[1]
        bake(once, twice)
        assert once.read_bytes() == twice.read_bytes()
        # With --compress draco it gets another stream, in the first bake and not in the second.
        for source_of, target in ((source, once), (once, twice)):
            assert bake(source_of, target, compress="draco").notices == ()
            assert read(target).content["extensionsUsed"] == ["KHR_draco_mesh_compression"]
        assert once.read_bytes() == twice.read_bytes()
        assert not any("sparse" in accessor for accessor in read(once).content["accessors"])

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["_WIDE", "WEIGHTS_1"])
    def test_integers_of_32_bits_take_no_gigabytes(self, name: str, tmp_path: Path) -> None:
        """Draco's tables for them took 1.2 GB; the launcher's child has a high-water mark of its own."""

        def declare(content: JsonObject) -> None:
            number = content["meshes"][0]["primitives"][0]["attributes"][name]
            content["accessors"][number]["componentType"] = 5125

        numbers = np.full((20, 4), 2**32 - 1, np.uint32).view(np.float32)
        numbers.view(np.uint32)[::2] = 0
        path = write_model(tmp_path / "wide.glb", [sheet(**{name: numbers})], change=declare)
        launch = [sys.executable, "-I", "-S", str(REPOSITORY / "benchmarks" / "launch.py")]
        command = ["bake", str(path), "-o", str(tmp_path / "o.glb"), "--compress", "draco"]
        done = subprocess.run(
            [*launch, sys.executable, "-m", "skinbake", *command], capture_output=True, text=True, check=False
        )
        assert int(done.stdout.split()[-1]) < 512 << 20
        assert f"not put into Draco: its {name} has 32-bit integers" in done.stderr


def test_a_missing_image_that_leads_through_the_parent_keeps_its_uri(tmp_path: Path) -> None:
    """From the second folder it led out, and was written in other words that mean the same."""
    uri = "%2e%2e//in/a.png?"

    def name(content: JsonObject) -> None:
        content["images"] = [{"uri": uri}]

    first = edited("bent_tube.glb", tmp_path / "in", name)
    once, twice = tmp_path / "out" / "m.glb", tmp_path / "again" / "m.glb"
    for source, target in ((first, once), (once, twice)):
        target.parent.mkdir()
        bake(source, target)
        assert read(target).content["images"] == [{"uri": uri}]


ABSOLUTE = "it is an absolute path"
REFUSED = {
    "/etc/passwd": ABSOLUTE,
    "//server/share/a.bin": ABSOLUTE,
    "C:/a.bin": "it has a drive",
    "file:///etc/passwd": "it has a scheme",
    "http://host/a.bin": "it has a scheme",
    "sub\\a.bin": "it holds a backslash",
    "a.bin%00": "it holds a NUL character",
    "con.bin": '"con.bin" is a device on Windows',
}


@pytest.mark.parametrize("command", ["bake", "strip"])
@pytest.mark.parametrize("target", ["m2.gltf", "other/m.gltf"])
@pytest.mark.parametrize("uri", [*REFUSED, "../a.bin", "%2e%2e/a.bin"])
def test_a_buffer_outside_is_refused_where_nothing_reads_it(
    command: str, target: str, uri: str, tmp_path: Path
) -> None:
    """Nothing in the file is skinned: it passed through, with a URI that another program may follow."""
    source = tmp_path / "in" / "m.gltf"
    source.parent.mkdir()
    (tmp_path / "a.bin").write_bytes(bytes(12))
    (tmp_path / "in" / "other").mkdir()
    buffers = [{"byteLength": 12, "uri": uri}]
    source.write_text(json.dumps({"asset": {"version": "2.0"}, "buffers": buffers}), encoding="utf-8")
    goal = source.parent / target
    result = invoke(command, source, "-o", goal)
    assert result.exit_code == 3, result.output
    assert not goal.exists()
    assert f'its buffer "{uri}" is not read: ' in result.stderr
    if uri in REFUSED:
        assert REFUSED[uri] in result.stderr
        assert "No option changes that: in the document, name the file by a relative path" in result.stderr
    else:
        assert "--allow-outside DIR" in result.stderr
        allowed = invoke(command, source, "-o", goal, "--allow-outside", tmp_path)
        assert allowed.exit_code == 0, allowed.output


def test_a_view_that_ends_in_the_padding_of_the_chunk_is_refused(tmp_path: Path) -> None:
    """The bytes of a bake stood behind it, and no strip could cut them off again."""
    source, goal = write_model(tmp_path / "m.glb", [sheet()]), tmp_path / "out.glb"
    model = read(source)
    data = model.binary_chunk or b""
    model.content["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": 4})
    model.content["buffers"] = [{"byteLength": len(data) + 3}]
    source.write_bytes(pack_glb(model.content, data + bytes(3)))
    result = invoke("bake", source, "-o", goal)
    assert result.exit_code == 3, result.output
    assert f"it ends at byte {len(data) + 4} of buffer 0, which has {len(data) + 3}" in result.stderr
    model.content["bufferViews"][-1]["byteLength"] = 3
    source.write_bytes(pack_glb(model.content, data + bytes(3)))
    assert invoke("bake", source, "-o", goal).exit_code == 0
    assert invoke("strip", goal, "-o", tmp_path / "again.glb").exit_code == 0
    assert (tmp_path / "again.glb").read_bytes() == source.read_bytes()


def test_a_joint_whose_pivot_is_past_all_floats_has_a_digest() -> None:
    """Its inverse bind matrix was nearly singular, and a second skin drew the mesh."""
    parents = np.array([-1, 0], np.int32)
    far, near = (Rig(parents, np.array([[0.0, 0.0, 0.0], [x, 0.0, 0.0]])) for x in (1e60, 1.0))
    assert far.digest == Rig(parents, far.pivots).digest != near.digest


def test_a_pivot_beyond_float32_is_no_warning(tmp_path: Path) -> None:
    """A tiny inverse bind matrix puts its joint there, and its digest in float32 overflowed."""

    def shrink(root: JsonObject) -> None:
        accessor = root["accessors"][root["skins"][0]["inverseBindMatrices"]]
        view = root["bufferViews"][accessor["bufferView"]]
        place.append(view.get("byteOffset", 0) + accessor.get("byteOffset", 0))

    place: list[int] = []
    source = edited("bent_tube.glb", tmp_path, shrink)
    model = read(source)
    data = bytearray(model.binary_chunk or b"")
    matrix = np.diag([1e-38, 1e-38, 1e-38, 1.0]).astype("<f4")
    matrix[3, 0] = 1e30  # the translation, by columns
    data[place[0] : place[0] + 64] = matrix.tobytes()
    source.write_bytes(pack_glb(model.content, bytes(data)))
    result = invoke("bake", source, "-o", tmp_path / "out.glb")
    assert result.exit_code == 0, result.output
    assert "Warning" not in result.stderr


def test_the_page_of_a_baked_model_that_lost_its_normals_has_no_picture_of_it(tmp_path: Path) -> None:
    lost = tmp_path / "lost.glb"
    model = baked(FOLDER / "bent_tube.glb", lost)
    del model.content["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    rewritten(model, lost)
    result = invoke("verify", lost, "--html", tmp_path / "page.html")
    assert result.exit_code == 1
    assert "it has no NORMAL" in result.stderr
    assert (tmp_path / "page.html").read_bytes().startswith(b"<!doctype html>")
