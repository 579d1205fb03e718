"""``strip`` gives back the bytes from before a bake, however a tool compressed or rearranged the source.

The sources are made by glTF-Transform: each container, each compression, plain and quantised.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import PoseKind
from skinbake.commands.strip import strip_file
from skinbake.commands.verify import verify_file
from skinbake.measure.options import VerifyOptions
from skinbake.truth.poses import PoseRequest
from tests.support import corpus, gltf_transform, khronos
from tests.support.baked_files import source
from tests.support.compressed import EXT, KHR, meshopt_twin
from tests.support.decoders import read_plain
from tests.support.gltf_reading import DRACO, read
from tests.support.models import assert_buffers_kept, bake, primitives

FIXTURES = ["foreign_joints.glb", "two_sets.glb", "weights_u8.glb", "bent_tube.glb", "mirrored_tangent.glb"]
MODELS = ["CesiumMan/CesiumMan.glb", "hand_l-weights-u8.glb", "barbarian-plain.glb"]
COMPRESSED = {"plain": [], "draco": ["draco"], "sequential": ["dracoSequential"], "meshopt": ["meshopt"]}
TOOLS = ["copy", "dedup", "weld"]
SUFFIXES = [".glb", ".gltf", ".uri.gltf"]
REST = VerifyOptions(poses=PoseRequest(PoseKind.REST))
TOLD = {"adopted-kept", "limited-kept", "tangents-kept", "bytes-left", "texcoords-kept"}
pytestmark = pytest.mark.slow


def chain(start: Path, folder: Path, tools: Iterable[str]) -> Path:
    """Apply functions of glTF-Transform, one after the other, and return the last file."""
    path = start
    for number, tool in enumerate(tools):
        target = folder / f"{number}-{tool}.glb"
        (failure,) = gltf_transform.transform([(path, target, tool)])
        assert not failure, (path, tool, failure)
        path = target
    return path


def contained(path: Path, folder: Path, suffix: str) -> Path:
    """Write a GLB in another container, with its buffer in a file or in a data: URI."""
    if suffix == ".glb":
        return path
    model = read(path)
    binary = model.binary_chunk or b""
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    if suffix == ".gltf":
        uri = "source.bin"
        (folder / uri).write_bytes(binary)
    model.content["buffers"][0]["uri"] = uri
    target = folder / "source.gltf"
    target.write_text(json.dumps(model.content, indent=1))
    return target


def assert_lossless(path: Path, folder: Path) -> None:
    """Bake a file, verify it, strip it, and compare every byte with those of the source."""
    before = {each: each.read_bytes() for each in folder.iterdir() if each.is_file()}
    once, bare = folder / f"baked{path.suffix}", folder / f"bare{path.suffix}"
    assert bake(path, once).status == "baked"
    verdict = verify_file(str(once), REST)
    assert not verdict.error, verdict.error
    assert not [problem.message for check in verdict.checks[:2] for problem in check.problems]
    assert_buffers_kept(read(path), read(once))
    added = khronos.new_findings(*khronos.validate_many([path, once]).values())
    assert not added, added
    result = strip_file(str(once), str(bare))
    assert bare.read_bytes() == path.read_bytes()
    assert not TOLD & {notice.code for notice in result.notices}
    assert {each: each.read_bytes() for each in before} == before


@pytest.mark.parametrize("compression", COMPRESSED)
@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("name", FIXTURES)
def test_every_container_and_compression(
    name: str, quantised: bool, compression: str, tmp_path: Path
) -> None:
    tools = [*(["quantize"] if quantised else []), *COMPRESSED[compression]]
    made = chain(source(name), tmp_path, tools)
    for number, suffix in enumerate(SUFFIXES):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = folder / f"source{suffix[-5:]}"
        path.write_bytes(made.read_bytes())
        assert_lossless(contained(path, folder, suffix), folder)


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("name", ["foreign_joints.glb", "weights_u8.glb"])
def test_sources_that_a_tool_rearranged(name: str, tool: str, tmp_path: Path) -> None:
    for number, (quantised, compression) in enumerate(product([False, True], COMPRESSED.values())):
        folder = tmp_path / str(number)
        folder.mkdir()
        tools = [*(["quantize"] if quantised else []), *compression, tool]
        assert_lossless(chain(source(name), folder, tools), folder)


@pytest.mark.parametrize("extension", [EXT, KHR])
@pytest.mark.parametrize("name", FIXTURES)
def test_sources_with_either_extension_of_meshopt(name: str, extension: str, tmp_path: Path) -> None:
    assert_lossless(meshopt_twin(source(name), tmp_path / "source.glb", name=extension), tmp_path)


@corpus.needed
@pytest.mark.parametrize("tools", [["draco"], ["quantize", "draco"], ["quantize", "dracoSequential"]])
@pytest.mark.parametrize("name", MODELS)
def test_real_characters_in_draco(name: str, tools: list[str], tmp_path: Path) -> None:
    assert_lossless(chain(corpus.model(name), tmp_path, tools), tmp_path)


@pytest.mark.parametrize("command", TOOLS)
@pytest.mark.parametrize("tools", [[], ["quantize"], ["draco"], ["quantize", "draco"], ["meshopt"]])
def test_what_strip_cannot_undo_after_a_tool_has_a_notice(
    tools: list[str], command: str, tmp_path: Path
) -> None:
    """The tool writes a baked file anew, so its bytes cannot come back. What stays of the bake is told."""
    made = chain(source("foreign_joints.glb"), tmp_path, tools)
    bake(made, tmp_path / "baked.glb")
    (failure,) = gltf_transform.transform([(tmp_path / "baked.glb", tmp_path / "after.glb", command)])
    assert not failure
    result = strip_file(str(tmp_path / "after.glb"), str(tmp_path / "bare.glb"))
    bare = read_plain(tmp_path / "bare.glb").primitive(0)
    assert not [name for name in bare["attributes"] if name.startswith("_SKINBAKE")]
    assert "skinbake" not in bare.get("extras", {})
    adopted = read_plain(tmp_path / "bare.glb").influences()[1] > 0
    given = read_plain(made).influences()[1] > 0
    codes = {notice.code for notice in result.notices}
    assert codes <= TOLD
    assert ("adopted-kept" in codes) == (adopted.sum() != given.sum())


@pytest.mark.parametrize("tools", [["draco"], ["quantize", "draco"], ["quantize", "dracoSequential"]])
@pytest.mark.parametrize("name", FIXTURES)
def test_attributes_beside_a_stream_are_read_in_the_order_of_its_decoder(
    name: str, tools: list[str], tmp_path: Path
) -> None:
    """The reference decoder gives the vertices, in its order, that ``--compress none`` writes."""
    made = chain(source(name), tmp_path, tools)
    bake(made, tmp_path / "baked.glb")
    bake(made, tmp_path / "plain.glb", compress="none")
    found, expected = read_plain(tmp_path / "baked.glb"), read(tmp_path / "plain.glb")
    for mesh, number, primitive in primitives(expected.content):
        assert DRACO in read(tmp_path / "baked.glb").primitive(mesh, number)["extensions"]
        assert {"_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"} < primitive["attributes"].keys()
        for attribute in primitive["attributes"]:
            ours, theirs = (model.attribute(attribute, mesh, number) for model in (found, expected))
            assert np.array_equal(ours, theirs), attribute
