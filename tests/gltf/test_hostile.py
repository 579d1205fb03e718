"""Files that mean harm, or are broken in odd ways: a sentence each, never a crash or a fault of ours."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import pack_glb
from skinbake.files.folders import open_regular
from skinbake.gltf import resources
from tests.support import corpus
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import GltfFile, read
from tests.support.kernels import use_numpy
from tests.support.models import FOLDER, Change, baked, edited, note, rewritten, sheet, write_model

COMPRESSIONS = ["keep", "none", "draco", "meshopt"]


def refused(source: Path, *options: str) -> str:
    """Bake a file, which must be refused with nothing written, and return the message."""
    target = source.parent / "refused.glb"
    result = invoke("bake", source, "-o", target, *options)
    assert result.exit_code == 3, result.output
    assert not target.exists()
    assert "failed where it should not" not in result.stderr
    assert str(source) in result.stderr
    return result.stderr


def _uncounted(size: int) -> None:
    """Let a file of any size be read."""


class TestFilesThatChange:
    """A file of the size from which pages of its own are taken, changed by somebody else."""

    @pytest.fixture
    def large(self, tmp_path: Path) -> Path:
        path = tmp_path / "large.bin"
        path.write_bytes(bytes(range(256)) * (2 * resources.PAGES_FROM // 256) + b"end")
        return path

    def test_a_large_file_is_read_whole(self, large: Path) -> None:
        assert bytes(resources.read_open_file(open_regular(str(large)), _uncounted)) == large.read_bytes()

    def test_what_was_read_of_a_large_file_stays(self, large: Path) -> None:
        before = large.read_bytes()
        data = resources.read_open_file(open_regular(str(large)), _uncounted)
        with large.open("r+b") as file:
            file.write(b"\xff" * len(before))
        assert bytes(data) == before
        with large.open("r+b") as file:
            file.truncate(1)
        assert bytes(data) == before

    def test_what_was_read_of_a_large_file_is_read_only(self, large: Path) -> None:
        assert memoryview(resources.read_open_file(open_regular(str(large)), _uncounted)).readonly

    @pytest.mark.parametrize("length", [0, 5000, 3 * resources.PAGES_FROM])
    def test_a_large_file_that_changes_its_length_is_refused(self, large: Path, length: int) -> None:
        def cut(size: int) -> None:
            """Change the file when its size has been found, and nothing has been read yet."""
            with large.open("r+b") as file:
                file.truncate(length)

        with pytest.raises(OSError, match="it changed while it was read"):
            resources.read_open_file(open_regular(str(large)), cut)

    def test_a_small_file_that_changes_its_length_is_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "small.bin"
        path.write_bytes(b"small")
        states = [path.stat()]
        path.write_bytes(b"smaller")
        monkeypatch.setattr(os, "fstat", lambda descriptor: states[0])
        with path.open("rb") as file, pytest.raises(OSError, match="it changed while it was read"):
            resources.read_open_file(os.dup(file.fileno()), _uncounted)


class TestEncoders:
    """Input that Draco's and meshoptimizer's encoders would read past, or abort on."""

    @pytest.mark.parametrize("options", [[], ["--texcoord-bits", "12"]])
    @pytest.mark.parametrize("name", ["TEXCOORD_0", "COLOR_0", "_OTHER"])
    def test_an_attribute_of_another_count_is_named(
        self, tmp_path: Path, name: str, options: list[str]
    ) -> None:
        short = np.zeros((3, 4 if name == "COLOR_0" else 2), np.float32)
        path = write_model(tmp_path / "short.glb", [sheet(**{name: short})])
        message = refused(path, "--compress", "draco", *options)
        assert f'mesh 0 "sheet", primitive 0, {name}: it has 3 elements, POSITION has 20' in message

    @pytest.mark.parametrize("scheme", ["draco", "meshopt"])
    def test_an_index_past_the_vertices_is_refused(self, tmp_path: Path, scheme: str) -> None:
        part = sheet()
        assert part.indices is not None
        part.indices[3, 1] = 20
        path = write_model(tmp_path / "past.glb", [part])
        message = refused(path, "--compress", scheme)
        assert 'mesh 0 "sheet", primitive 0, indices: index 20 is too large for 20 vertices' in message

    @pytest.mark.parametrize("scheme", ["draco", "meshopt"])
    @pytest.mark.parametrize("member", [{"componentType": 5120}, {"componentType": 5126}, {"type": "VEC2"}])
    def test_indices_that_are_none_are_refused(
        self, tmp_path: Path, scheme: str, member: dict[str, Any]
    ) -> None:
        def change(content: Any) -> None:
            number = content["meshes"][0]["primitives"][0]["indices"]
            content["accessors"][number] |= {"count": 6} | member

        path = write_model(tmp_path / "indices.glb", [sheet()], change=change)
        assert "indices must be scalars of an unsigned integer type" in refused(path, "--compress", scheme)

    @pytest.mark.parametrize(
        ("member", "found"),
        [
            ({"type": "VEC4", "count": 15}, "it has 4 components, 3 are needed"),
            ({"componentType": 5125}, "positions must be floats, or signed or unsigned bytes or shorts"),
        ],
    )
    def test_positions_that_are_none_are_refused(
        self, tmp_path: Path, member: dict[str, Any], found: str
    ) -> None:
        def change(content: Any) -> None:
            number = content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
            content["accessors"][number] |= member

        path = write_model(tmp_path / "positions.glb", [sheet()], change=change)
        assert found in refused(path, "--compress", "draco", "--position-bits", "11")


@pytest.mark.slow
@pytest.mark.parametrize(
    "compression",
    ["keep", *(pytest.param(name, marks=pytest.mark.slow) for name in ("none", "meshopt")), "draco"],
)
@pytest.mark.parametrize("name", ["POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0", "indices"])
def test_what_lies_unaligned_is_read(tmp_path: Path, name: str, compression: str) -> None:
    """The same values one byte further on give the same α and β."""
    shorts = sheet().attributes["JOINTS_0"].astype(np.uint16)
    plain = write_model(tmp_path / "plain.glb", [sheet(JOINTS_0=shorts)])
    model = read(plain)
    primitive = model.content["meshes"][0]["primitives"][0]
    number = primitive["indices"] if name == "indices" else primitive["attributes"][name]
    accessor = model.content["accessors"][number]
    view = model.content["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0)
    data = model.buffer(0)
    chunk = data + b"\0" * (-len(data) % 4 + 1) + data[start : start + view["byteLength"]]
    moved = {**view, "byteOffset": len(chunk) - view["byteLength"]}
    model.content["bufferViews"].append(moved)
    accessor["bufferView"] = len(model.content["bufferViews"]) - 1
    model.content["buffers"][0]["byteLength"] = len(chunk)
    odd = tmp_path / "odd.glb"
    odd.write_bytes(pack_glb(model.content, chunk))
    digests = []
    for source in (plain, odd):
        target = tmp_path / f"baked-{source.name}"
        result = invoke("bake", source, "-o", target, "--compress", compression)
        assert result.exit_code == 0, result.output
        found = note(read(target).content)
        assert found is not None
        result = invoke("verify", target)
        assert result.exit_code == 0, result.output
        digests.append(found["digest"])
    assert digests[0] == digests[1]


def deep(depth: int, *, objects: bool) -> str:
    return '{"a":' * depth + "1" + "}" * depth if objects else "[" * depth + "]" * depth


class TestNesting:
    """JSON nested deep at every place where anything may stand."""

    def nested(self, tmp_path: Path, depth: int) -> Path:
        def change(content: Any) -> None:
            content["asset"]["extras"] = content["accessors"][0]["extras"] = "DEEP"
            content["meshes"][0]["primitives"][0]["extras"] = {"mine": "DEEP"}

        path = write_model(tmp_path / "nested.glb", [sheet()], change=change)
        model = read(path)
        text = json.dumps(model.content).replace('"DEEP"', deep(depth, objects=True))
        return self.glb(path, text, model.buffer(0))

    @staticmethod
    def glb(path: Path, text: str, chunk: bytes) -> Path:
        encoded = text.encode()
        encoded += b" " * (-len(encoded) % 4)
        chunk += b"\0" * (-len(chunk) % 4)
        parts = [
            len(encoded).to_bytes(4, "little") + b"JSON" + encoded,
            len(chunk).to_bytes(4, "little") + b"BIN\0" + chunk,
        ]
        length = 12 + sum(map(len, parts))
        path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + length.to_bytes(4, "little") + b"".join(parts))
        return path

    @pytest.mark.parametrize("suffix", [".glb", ".gltf"])
    def test_a_hundred_levels_are_baked_verified_and_stripped(self, tmp_path: Path, suffix: str) -> None:
        nested = self.nested(tmp_path, 100)
        target, back = tmp_path / f"baked{suffix}", tmp_path / f"back{suffix}"
        commands: list[list[str | Path]] = [["bake", nested, "-o", target], ["verify", target]]
        commands.append(["strip", target, "-o", back])
        for command in commands:
            result = invoke(*command)
            assert result.exit_code == 0, result.output
        for path in (target, back):
            assert b"".join(path.read_bytes().split()).count(deep(100, objects=True).encode()) == 3

    @pytest.mark.skipif(sys.version_info >= (3, 14), reason="Python's parser goes deeper from 3.14 on")
    def test_ten_thousand_levels_are_refused_by_every_command(self, tmp_path: Path) -> None:
        nested, out = self.nested(tmp_path, 10_000), tmp_path / "out.glb"
        commands: list[list[str | Path]] = [["bake", nested, "-o", out], ["verify", nested]]
        commands.append(["strip", nested, "-o", out])
        for command in commands:
            result = invoke(*command)
            assert result.exit_code == 3, result.output
            assert "its JSON cannot be parsed: its arrays and objects are nested too deep" in result.stderr
        assert not out.exists()

    @pytest.mark.slow
    def test_a_note_that_is_nested_deep_is_a_problem_of_the_file(self, tmp_path: Path) -> None:
        """Whatever the metadata says, it is a problem of the file."""
        whole = tmp_path / "whole.glb"
        model = baked(FOLDER / "bent_tube.glb", whole)
        for key in ("frame", "weighting", "alpha", "digest", "scale", "encoding", "adopted", "influences"):
            content = json.loads(json.dumps(model.content))
            content["meshes"][0]["primitives"][0]["extras"]["skinbake"][key] = "DEEP"
            text = json.dumps(content).replace('"DEEP"', deep(300, objects=False))
            path = self.glb(tmp_path / f"{key}.glb", text, model.buffer(0))
            for command in (["verify"], ["inspect"], ["inspect", "--json"], ["bake", "--dry-run"], ["strip"]):
                target = ["-o", str(tmp_path / "stripped.glb")] if command == ["strip"] else []
                result = invoke(command[0], path, *command[1:], *target)
                assert result.exit_code in (0, 1, 3), result.output
                assert "failed where it should not" not in result.output

    @pytest.mark.parametrize("place", ["accessors", "bufferViews", "nodes", "meshes"])
    def test_deep_values_in_the_wrong_place_are_shown_short(self, tmp_path: Path, place: str) -> None:
        model = read(FOLDER / "bent_tube.glb")
        content = json.loads(json.dumps(model.content))
        content[place] = "DEEP"
        text = json.dumps(content).replace('"DEEP"', deep(300, objects=False))
        message = refused(self.glb(tmp_path / "wrong.glb", text, model.buffer(0)))
        assert "must be an array of objects" in message or "[[[[" in message


def set_member(*where: str | int, value: Any) -> Change:
    """Return a change that sets the member of the JSON to which the keys lead."""

    def change(content: Any) -> None:
        *parents, last = where
        for key in parents:
            content = content[key]
        if isinstance(content, list) and last == len(content):
            content.append(value)
        else:
            content[last] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)


@pytest.mark.parametrize("compression", ["none", "draco", "meshopt"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_member("accessors", 0, "bufferView", value=[0]), '"bufferView" must be an integer'),
        (set_member("accessors", 0, "componentType", value=[]), "glTF does not define"),
        (set_member("accessors", 0, "type", value={}), "glTF does not define"),
        (set_member("bufferViews", 0, "buffer", value=5123), '"buffer" refers to entry 5123 of an array'),
        (set_member("bufferViews", 0, "buffer", value=None), '"buffer" must be an integer'),
        (set_member("bufferViews", 0, "extensions", value=[]), '"extensions" must be an object'),
        (set_member(*PRIMITIVE, "attributes", value=[]), '"attributes" must be an object'),
        (set_member(*PRIMITIVE, "attributes", "POSITION", value={}), '"POSITION" must be an integer'),
        (set_member(*PRIMITIVE, "extensions", value=[]), '"extensions" must be an object'),
        (set_member(*PRIMITIVE, "indices", value=[1]), '"indices" must be an integer'),
        (set_member("meshes", 0, "primitives", value={}), '"primitives" must be an array of objects'),
        (set_member("meshes", 0, "name", value=[]), '"name" must be a string'),
        (set_member("skins", 0, "joints", value={}), "skin 0 has no joints"),
    ],
)
def test_members_of_a_wrong_type_are_named(
    tmp_path: Path, change: Change, message: str, compression: str
) -> None:
    path = edited("foreign_joints.glb", tmp_path, change)
    assert message in refused(path, "--compress", compression)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_counts_of_all_digits_that_python_reads_are_refused(tmp_path: Path, compression: str) -> None:
    """Python cannot write the sum of such counts in a message, because it has more digits."""
    change = set_member("accessors", 0, "count", value=int("9" * 4300))
    path = edited("foreign_joints.glb", tmp_path, change)
    assert '"count" must be an integer of at most' in refused(path, "--compress", compression)


@pytest.mark.parametrize("compression", ["draco", "meshopt"])
@pytest.mark.parametrize("key", ["extensionsUsed", "extensionsRequired"])
@pytest.mark.parametrize("value", [["A_b", {}], {}, [[]], [None], "A_b"])
def test_extensions_that_are_no_names_are_refused(
    tmp_path: Path, key: str, value: object, compression: str
) -> None:
    path = edited("foreign_joints.glb", tmp_path, set_member(key, value=value))
    assert f'"{key}" must be an array of strings' in refused(path, "--compress", compression)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize(
    "change",
    [
        set_member(*PRIMITIVE, "extensions", value=None),
        set_member(*PRIMITIVE, "extras", value=[1, None]),
        set_member("accessors", 0, "min", value=[]),
        set_member("accessors", 0, "min", value=[-1, 2**70, 1e300]),
        set_member("accessors", 0, "max", value=[None, [], "1"]),
        set_member("accessors", 0, "max", value={}),
        set_member("extensionsUsed", value=None),
        set_member("bufferViews", 0, "extensions", value=None),
    ],
)
def test_what_does_no_harm_is_let_pass(tmp_path: Path, change: Change, compression: str) -> None:
    path = edited("foreign_joints.glb", tmp_path, change)
    options = ["--position-bits", "11"] if compression == "draco" else []
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--compress", compression, *options)
    assert result.exit_code == 0, result.output
    bounds = read(tmp_path / "out.glb")
    if compression == "draco" and isinstance(bounds.content["accessors"][0].get("min"), list):
        assert len(bounds.content["accessors"][0]["min"]) == 3  # quantising wrote right ones


BAKES = [
    [],
    ["--encoding", "snorm16"],
    ["--encoding", "packed8"],
    ["--layout", "texcoord"],
    ["--layout", "custom"],
    ["--limit-influences", "4"],
    ["--weld", "skin"],
    ["--compress", "draco"],
    ["--compress", "meshopt"],
    ["--dry-run"],
]


class TestGradientsThatAreNotFinite:
    @pytest.fixture
    def tiny(self, tmp_path: Path) -> Path:
        positions = (sheet().attributes["POSITION"].astype(np.float64) * 1e-40).astype(np.float32)
        return write_model(tmp_path / "tiny.glb", [sheet(), sheet(POSITION=positions)])

    @pytest.mark.parametrize("by_numpy", [False, True])
    @pytest.mark.parametrize("options", BAKES, ids=" ".join)
    def test_are_refused(
        self, tiny: Path, options: list[str], by_numpy: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        if by_numpy:
            use_numpy(monkeypatch)
        message = refused(tiny, *options)
        assert f'{tiny}: mesh 0 "sheet", primitive 1: α or β of 16 vertices are not finite numbers' in message
        assert "scale the model up" in message

    def test_tangents_of_another_length_are_blamed(self, tmp_path: Path) -> None:
        tangents = np.tile(np.array([1, 0, 0, 1], np.float32), (20, 1))
        tangents[7, :2] = 3e38
        positions = sheet().attributes["POSITION"] * np.float32(0.01)
        path = write_model(tmp_path / "tangents.glb", [sheet(POSITION=positions, TANGENT=tangents)])
        message = refused(path, "--frame", "tangent")
        assert "α or β of 1 vertex are not finite numbers" in message
        assert "--frame normal" in message
        assert invoke("bake", path, "-o", tmp_path / "out.glb").exit_code == 0


class TestJoints:
    """Joint matrices that no renderer can use, in a file that was baked before."""

    @pytest.fixture
    def whole(self, tmp_path: Path) -> Path:
        path = tmp_path / "whole.glb"
        baked(FOLDER / "two_primitives.glb", path)
        return path

    def verify(self, whole: Path, change: Callable[[Any], object]) -> tuple[int, str]:
        model = read(whole)
        change(model.content)
        path = whole.with_name("changed.glb")
        rewritten(GltfFile(path, model.content, model.binary_chunk), path)
        result = invoke("verify", path)  # in this process numpy's warnings are errors
        for words in ("failed where it should not", "fault of skinbake"):
            assert words not in result.output
        return result.exit_code, result.output

    @staticmethod
    def joint(content: Any, number: int = 1) -> Any:
        return content["nodes"][content["skins"][0]["joints"][number]]

    @pytest.mark.parametrize("scale", [1e13, 1e30, 3e38])
    def test_joint_matrices_past_float32_are_an_input_error(self, whole: Path, scale: float) -> None:
        def change(content: Any) -> None:
            for node in content["skins"][0]["joints"]:
                content["nodes"][node]["scale"] = [scale] * 3

        code, text = self.verify(whole, change)
        assert code == 3
        assert "is past all numbers of float32" in text
        assert "joint" in text

    def test_the_joint_whose_matrix_is_past_float32_is_named(self, whole: Path) -> None:

        def change(content: Any) -> None:
            self.joint(content, -2)["scale"] = [1e3] * 3
            self.joint(content, -1)["scale"] = [1e37] * 3

        code, text = self.verify(whole, change)
        name = self.joint(read(whole).content, -1)["name"]
        assert code == 3
        assert f'the matrix of "{name}" of skin 0 is past all numbers of float32' in text

    @pytest.mark.parametrize("distance", [1e10, 1e20, 3e38])
    def test_joint_matrices_too_unlike_in_size_are_blamed(self, whole: Path, distance: float) -> None:
        code, text = self.verify(
            whole, lambda content: self.joint(content).update(translation=[distance, 0, 0])
        )
        assert code in (0, 1)
        if code:
            assert "joint matrices are singular or too unlike in size" in text

    @pytest.mark.parametrize("scale", [[0, 0, 0], [1, 0, 1], [1e-38] * 3, [-1, 1e-20, 0]])
    def test_singular_ones_are_no_fault_of_ours(self, whole: Path, scale: list[float]) -> None:
        code, _ = self.verify(whole, lambda content: self.joint(content).update(scale=scale))
        assert code in (0, 1)

    def test_matrices_of_equal_numbers_are_blamed(self, whole: Path) -> None:
        def change(content: Any) -> None:
            node = self.joint(content)
            for key in ("translation", "rotation", "scale"):
                node.pop(key, None)
            node["matrix"] = [1e10] * 16

        code, text = self.verify(whole, change)
        assert code == 1
        assert "joint matrices are singular or too unlike in size" in text


@pytest.mark.parametrize("by_numpy", [False, True])
@pytest.mark.parametrize("name", ["NORMAL", "TANGENT"])
def test_nan_of_every_kind_draws_no_warning(
    tmp_path: Path, name: str, by_numpy: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signalling NaN is one that processors announce when they convert it."""
    if by_numpy:
        use_numpy(monkeypatch)
    tangents = np.tile(np.array([1, 0, 0, 1], np.float32), (20, 1))
    part = sheet(TANGENT=tangents)
    part.attributes[name].view(np.uint32)[7, 1] = 0x7F800001
    path, target = write_model(tmp_path / "nan.glb", [part]), tmp_path / "out.glb"
    assert read(path).buffer(0).count(b"\x01\x00\x80\x7f") == 1
    result = invoke("bake", path, "-o", target)
    assert result.exit_code == 0, result.output
    result = invoke("verify", target)
    assert result.exit_code == 0, result.output


def noted(path: Path) -> list[list[str]]:
    """Return the command lines that once failed on a hostile file, without their file names."""
    found = json.loads((path.parent / "_note.json").read_text(encoding="utf-8"))
    return [[word for word in case[2] if "WORKDIR" not in word and word != "-o"] for case in found[1]]


@pytest.mark.parametrize("path", corpus.parameters(lambda: corpus.hostile_files("F06")))
def test_the_defects_of_an_audit_have_a_sentence(path: Path, tmp_path: Path) -> None:
    shutil.copytree(path.parent, tmp_path / "in")
    for command, *options in noted(path):
        for suffix in (".glb", ".gltf"):
            target = [] if "--dry-run" in options else ["-o", str(tmp_path / f"out{suffix}")]
            result = invoke(command, tmp_path / "in" / path.name, *target, *options)
            assert result.exit_code in (0, 3), result.output
            assert "failed where it should not" not in result.output
            if "--json" in options and result.exit_code == 3:
                assert document(result)["files"][0]["error"]


@pytest.mark.parametrize("path", corpus.parameters(lambda: corpus.hostile_files("F03")))
@pytest.mark.parametrize("options", [[], ["--texcoord-bits", "12"]])
def test_the_draco_encoder_is_not_let_past_the_end(path: Path, options: list[str], tmp_path: Path) -> None:
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--compress", "draco", *options)
    assert result.exit_code == 3
    assert "TEXCOORD_0: it has" in result.stderr


@pytest.mark.parametrize("path", corpus.parameters(lambda: corpus.hostile_files("F07")))
def test_the_audits_tiny_positions_are_refused(path: Path, tmp_path: Path) -> None:
    result = invoke("bake", path, "-o", tmp_path / "out.glb")
    assert result.exit_code == 3
    assert "not finite numbers" in result.stderr


def test_metadata_of_any_scale_is_a_problem_of_the_file(tmp_path: Path) -> None:
    whole = tmp_path / "whole.glb"
    result = invoke("bake", FOLDER / "bent_tube.glb", "-o", whole, "--encoding", "snorm16")
    assert result.exit_code == 0
    for scale in (10**400, 1e300, -1, True, "1"):
        model = read(whole)
        model.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["scale"] = scale
        path = tmp_path / "scale.glb"
        path.write_bytes(pack_glb(model.content, model.buffer(0)))
        result = invoke("verify", path, "--json")
        assert result.exit_code == 1
        assert '"scale" is' in json.dumps(document(result), ensure_ascii=False).replace('\\"', '"')
