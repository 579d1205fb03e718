"""The draft of the extension says enough: a reader that knows nothing else lights every fixture alike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from fixtures import skinned_normals_test
from fixtures.make_fixtures import FOLDER
from tests.docs import draft_reader
from tests.support import analytic
from tests.support.baked_files import Editable
from tests.support.command_line import invoke
from tests.support.decoders import read_plain
from tests.support.gltf_reading import read

LIMIT = 0.001
"""Degrees."""

FILES = sorted(
    [
        *FOLDER.glob("*.gl[bt]*"),
        *(FOLDER / "characters").glob("*.gl[bt]*"),
        FOLDER / f"{skinned_normals_test.FOLDER}/{skinned_normals_test.NAME}.gltf",
    ]
)

Change = Callable[[Editable], object]


def assert_lit_alike(path: Path) -> None:
    """Bring a baked file into several poses, and compare the reader with what skinbake gives there."""
    file = read_plain(path)
    first = skinbake.normals(path)
    poses = [first, skinbake.normals(path, first[0].clip, 0.3 * first[0].time)]
    for posed in (one for pose in poses for one in pose):
        pair = posed.mesh, posed.primitive
        positions, normals = draft_reader.normals(file, *pair, posed.joint_matrices, posed.morph_weights)
        assert np.abs(positions - posed.positions).max() < 1e-6 * max(1.0, np.abs(posed.positions).max())
        expected = posed.normals["accurate"]
        assert (np.isfinite(normals) == np.isfinite(expected)).all()
        lit = np.isfinite(expected).all(axis=1)
        assert lit.any()
        assert analytic.degrees_between(normals[lit], expected[lit]).max() < LIMIT, pair


def assert_told_alike(path: Path) -> None:
    """Find the digests and ``positions`` of all primitives by the words of the draft."""
    file = read_plain(path)
    for mesh, entry in enumerate(file.content["meshes"]):
        for number, primitive in enumerate(entry["primitives"]):
            told = draft_reader.properties(file, primitive)
            if told is None:
                continue
            digests = draft_reader.digests(file, mesh, number)
            assert told["digest"] == {name: digests[name] for name in told["digest"]}
            found = draft_reader.positions(file, mesh, number)
            assert told["positions"] == {name: found[name] for name in told["positions"]}
            assert set(found) - set(told["positions"]) <= {"min", "max"}


def baked(source: Path, folder: Path, options: str = "") -> Path:
    target = folder / "baked.glb"
    result = invoke("bake", source, "-o", target, "--pack", *options.split())
    assert result.exit_code == 0, result.output
    return target


@pytest.mark.slow
@pytest.mark.parametrize("source", FILES, ids=lambda path: path.name)
def test_a_reader_of_the_draft_alone_lights_every_fixture_alike(source: Path, tmp_path: Path) -> None:
    path = baked(source, tmp_path, "--generate-normals")
    assert_lit_alike(path)
    assert_told_alike(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bent_tube.glb", "--encoding packed8"),
        ("bent_tube.glb", "--layout texcoord"),
        ("two_sets.glb", "--layout texcoord"),
        ("two_sets.glb", "--layout custom --encoding snorm16"),
        ("two_sets.glb", "--encoding packed8 --alpha-name _A{set} --beta-name _B{set}"),
        ("mirrored_tangent.glb", "--frame normal"),
        ("mirrored_tangent.glb", "--encoding packed8"),
        ("morphed_sheet.glb", "--frame normal"),
        ("morphed_sheet.glb", "--morph-frames"),
        ("morphed_sheet.glb", "--morph-frames --frame normal --encoding snorm16"),
        ("foreign_joints.glb", "--neighbours extend"),
        ("weights_u8.glb", "--gradients surface"),
    ],
)
def test_a_reader_of_the_draft_reads_every_storage(name: str, options: str, tmp_path: Path) -> None:
    path = baked(FOLDER / name, tmp_path, options)
    assert_lit_alike(path)
    assert_told_alike(path)


def with_root_mirrored(file: Editable) -> None:
    """Hang the root joint of each skin under a node of negative scale."""
    joints = {joint for skin in file.content["skins"] for joint in skin["joints"]}
    nodes = file.content["nodes"]
    children = {child for joint in joints for child in nodes[joint].get("children", [])}
    for root in sorted(joints - children):
        nodes.append({"scale": [-1, 1, 1], "children": [root]})
        for holder in [*file.content["scenes"], *nodes[:-1]]:
            for key in ("nodes", "children"):
                if root in holder.get(key, []):
                    holder[key] = [len(nodes) - 1 if one == root else one for one in holder[key]]


def with_a_limb_mirrored(file: Editable) -> None:
    """Mirror the last joint alone, about its own origin."""
    node = file.content["nodes"][file.content["skins"][0]["joints"][-1]]
    node["scale"] = [1, 1, -1]


def with_scaled(name: str, least: float, most: float) -> Change:
    """Give the vectors or weights of an attribute other lengths, vertex by vertex."""

    def change(file: Editable) -> None:
        for number in range(len(file.content["meshes"][0]["primitives"])):
            if name in file.primitive(number)["attributes"]:
                values = file.array(name, number)
                values[:, :3] *= np.linspace(least, most, len(values), dtype=np.float32)[:, None]

    return change


def with_short_weights(file: Editable) -> None:
    """Let the weights of a vertex sum to 0.4 … 1.7, and to 0 at one, with a negative one at another."""
    weights = file.array("WEIGHTS_0")
    weights *= np.linspace(0.4, 1.7, len(weights), dtype=np.float32)[:, None]
    weights[5] = 0
    weights[9, 2] = -0.1


def with_joints_that_the_skin_lacks(file: Editable) -> None:
    """Let slots of weight 0 name joints that are not there, as some exporters do."""
    joints, weights = file.array("JOINTS_0"), file.array("WEIGHTS_0")
    joints[weights == 0] = 200


def with_unlit_vertices(file: Editable) -> None:
    file.array("NORMAL")[3:6] = 0


def quantised(file: Editable) -> None:
    """Store POSITION in 16 bits, NORMAL and TANGENT in 8, as KHR_mesh_quantization allows."""
    for number, primitive in enumerate(file.content["meshes"][0]["primitives"]):
        for name, limit, kind, width in (
            ("POSITION", 32767, np.int16, 3),
            ("NORMAL", 127, np.int8, 3),
            ("TANGENT", 127, np.int8, 4),
        ):
            if name not in primitive["attributes"]:
                continue
            values = file.array(name, number)
            whole = np.rint(np.clip(values, -1, 1) * limit).astype(kind)
            padded = np.pad(whole, ((0, 0), (0, 4 - width)))
            accessor = file.add(padded.view(np.float32))
            description: dict[str, Any] = file.content["accessors"][accessor]
            description |= {"type": f"VEC{width}", "normalized": True}
            description["componentType"] = 5122 if kind is np.int16 else 5120
            view = file.content["bufferViews"][description["bufferView"]]
            view |= {"byteStride": padded.itemsize * 4, "target": 34962}
            if name == "POSITION":
                description |= {"min": whole.min(axis=0).tolist(), "max": whole.max(axis=0).tolist()}
            primitive["attributes"][name] = accessor
    file.content["extensionsUsed"] = file.content["extensionsRequired"] = ["KHR_mesh_quantization"]


def with_extras_of_text(file: Editable) -> None:
    file.primitive()["extras"] = "made by hand"


CHANGES: dict[str, Change] = {
    "mirrored root": with_root_mirrored,
    "mirrored limb": with_a_limb_mirrored,
    "long normals": with_scaled("NORMAL", 0.2, 3.0),
    "long tangents": with_scaled("TANGENT", 0.5, 2.0),
    "weights of other sums": with_short_weights,
    "joints that the skin lacks": with_joints_that_the_skin_lacks,
    "normals of no length": with_unlit_vertices,
    "quantised": quantised,
    "metadata in an accessor": with_extras_of_text,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bent_tube.glb", ""),
        ("mirrored_tangent.glb", ""),
        ("mirrored_tangent.glb", "--encoding packed8 --frame normal"),
        ("two_sets.glb", "--layout texcoord"),
        ("morphed_sheet.glb", ""),
    ],
)
@pytest.mark.parametrize("change", CHANGES)
def test_a_reader_of_the_draft_reads_odd_files(change: str, name: str, options: str, tmp_path: Path) -> None:
    file = Editable(FOLDER / name)
    CHANGES[change](file)
    path = baked(file.write(tmp_path / "source.glb"), tmp_path, options)
    assert_lit_alike(path)
    assert_told_alike(path)


def test_the_reader_imports_nothing_of_skinbake() -> None:
    text = Path(draft_reader.__file__).read_text("utf-8")
    assert "import skinbake" not in text
    assert "from skinbake" not in text
    assert read(FOLDER / "bent_tube.glb").content
