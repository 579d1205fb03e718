"""Correctives of meshes whose own morph targets move: made and measured at the weights that play."""

from __future__ import annotations

import base64
import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.correctives.models import SHEET, mean_errors, rewritten
from tests.support import corpus, gltf_reading, khronos
from tests.support.baked_files import verify
from tests.support.command_line import invoke

TIMES = [0.11, 0.37, 0.52, 0.81]


def added(content: Any, values: Any, kind: str, **described: Any) -> int:
    """Add an accessor whose bytes are in a buffer of its own, and return its number."""
    raw = np.ascontiguousarray(values).tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(raw).decode()
    content["buffers"].append({"uri": uri, "byteLength": len(raw)})
    stride = {"byteStride": values.strides[0]} if values.ndim > 1 and values.itemsize < 4 else {}
    content["bufferViews"].append({"buffer": len(content["buffers"]) - 1, "byteLength": len(raw), **stride})
    code = {"f": 5126, "i": 5120}[values.dtype.kind]
    view = {"bufferView": len(content["bufferViews"]) - 1, "componentType": code}
    content["accessors"].append({**view, "count": len(values), "type": kind, **described})
    return len(content["accessors"]) - 1


def _sampler(content: Any) -> Any:
    """Return the sampler of the weights of the first clip."""
    animation = content["animations"][0]
    (channel,) = (one for one in animation["channels"] if one["target"]["path"] == "weights")
    return animation["samplers"][channel["sampler"]]


def _weights(content: Any, keys: Any, method: str = "LINEAR") -> None:
    """Let the first clip play other weights (N, 2), or (N, 3, 2) for CUBICSPLINE."""
    sampler = _sampler(content)
    keys = np.asarray(keys, np.float32)
    end = content["accessors"][sampler["input"]]["max"][0]
    times = np.linspace(0.0, end, len(keys)).astype(np.float32)
    bounds = {"min": [0.0], "max": [float(times[-1])]}
    sampler["input"] = added(content, times, "SCALAR", **bounds)
    sampler["output"] = added(content, keys.ravel(), "SCALAR")
    sampler["interpolation"] = method


def _still(content: Any, weights: list[float]) -> None:
    """Take the weights out of the clip, and let the mesh have others by default."""
    animation = content["animations"][0]
    animation["channels"] = [one for one in animation["channels"] if one["target"]["path"] != "weights"]
    content["meshes"][0]["weights"] = weights


def outside(content: Any) -> None:
    _weights(content, [[-0.6, 0.4], [1.7, -0.8], [0.5, 1.3], [-0.6, 0.4]])


def stepped(content: Any) -> None:
    _weights(content, [[0.9, 0.2], [0.3, 1.0], [1.0, -0.3], [0.9, 0.2]], "STEP")


def cubic(content: Any) -> None:
    keys = np.zeros((4, 3, 2))
    keys[:, 1] = [[0.2, 0.9], [1.2, 0.1], [0.4, 1.1], [0.2, 0.9]]
    keys[:, 0] = keys[:, 2] = [[0.5, -0.5], [0.0, 0.3], [-0.6, 0.0], [0.5, -0.5]]
    _weights(content, keys, "CUBICSPLINE")


def by_mesh(content: Any) -> None:
    _still(content, [1.0, 0.7])


def by_node(content: Any) -> None:
    _still(content, [0.0, 0.0])
    next(node for node in content["nodes"] if "skin" in node)["weights"] = [1.1, -0.8]


def in_one_of_two_clips(content: Any) -> None:
    """Let a second clip move the joints alone, while the targets rest at weights of their own."""
    content["meshes"][0]["weights"] = [0.8, 0.9]
    other = copy.deepcopy(content["animations"][0])
    other["name"] = "other"
    other["channels"] = [one for one in other["channels"] if one["target"]["path"] != "weights"]
    content["animations"].append(other)


def by_two_nodes(content: Any) -> None:
    """Draw the mesh once more, with a skin of its own and other weights that no clip moves."""
    content["skins"].append(copy.deepcopy(content["skins"][0]))
    drawer = next(node for node in content["nodes"] if "skin" in node)
    again = {**drawer, "name": "again", "skin": len(content["skins"]) - 1, "weights": [-0.5, 1.2]}
    content["nodes"].append(again)
    content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)


def one_without_normal(content: Any) -> None:
    outside(content)
    del content["meshes"][0]["primitives"][0]["targets"][1]["NORMAL"]


def none_with_normal(content: Any) -> None:
    for target in content["meshes"][0]["primitives"][0]["targets"]:
        target.pop("NORMAL")
        target.pop("TANGENT", None)


def in_parts(content: Any) -> None:
    outside(content)
    primitive = content["meshes"][0]["primitives"][0]
    whole = content["accessors"][primitive["indices"]]
    half, parts = whole["count"] // 6 * 3, []
    for start, count in ((0, half), (half, whole["count"] - half)):
        content["accessors"].append({**whole, "byteOffset": 2 * start, "count": count})
        parts.append({**copy.deepcopy(primitive), "indices": len(content["accessors"]) - 1})
        for bound in ("min", "max"):
            content["accessors"][-1].pop(bound, None)
    content["meshes"][0]["primitives"] = parts


def quantised(content: Any) -> None:
    """Store the changes of NORMAL in bytes."""
    outside(content)
    source = gltf_reading.read(SHEET)
    for target in content["meshes"][0]["primitives"][0]["targets"]:
        values = source.values(target["NORMAL"])
        padded = np.zeros((len(values), 4), np.int8)
        padded[:, :3] = np.clip(np.rint(values * 127), -127, 127)
        target["NORMAL"] = added(content, padded, "VEC3", normalized=True)
    for name in ("extensionsUsed", "extensionsRequired"):
        content[name] = [*content.get(name, []), "KHR_mesh_quantization"]


VARIANTS: list[Callable[[Any], None]] = [
    outside,
    stepped,
    cubic,
    by_mesh,
    by_node,
    in_one_of_two_clips,
    by_two_nodes,
    one_without_normal,
    none_with_normal,
    in_parts,
    quantised,
]


@pytest.mark.slow
@pytest.mark.parametrize("change", VARIANTS, ids=lambda change: change.__name__)
def test_correctives_fit_the_morph_weights_that_play(change: Callable[[Any], None], tmp_path: Path) -> None:
    given, made = rewritten(SHEET, tmp_path / "in.glb", change), tmp_path / "out.glb"
    result = invoke("bake", given, "-o", made, "--correctives", "auto")
    assert result.exit_code == 0, result.output
    for clip in range(len(gltf_reading.read(made).content["animations"])):
        standard, corrected = mean_errors(made, clip, TIMES)
        assert corrected < 0.3 * standard
    figures = verify(made).file["normals_by_triangles"]["lbs"]
    assert figures["corrected"]["mean"] < 0.3 * figures["standard"]["mean"]


@pytest.mark.slow
@corpus.needed
@pytest.mark.parametrize(
    "name", ["correctives_clip_plays_morphs", "morphs_without_normal_in_clip", "default_morph_weights"]
)
def test_files_of_strangers_gain_what_their_clips_show(name: str, tmp_path: Path) -> None:
    made = tmp_path / "out.glb"
    result = invoke("bake", corpus.case(f"turn4/{name}.glb"), "-o", made, "--correctives", "auto")
    assert result.exit_code == 0, result.output
    standard, corrected = mean_errors(made, 0, [0.3, 0.9, 1.6])
    assert corrected < 0.3 * standard
    answer = verify(made)
    assert not answer.file["warnings"]
    figures = answer.file["normals_by_triangles"]["lbs"]
    assert figures["corrected"]["mean"] < 0.2 * figures["standard"]["mean"]


@pytest.mark.slow
@pytest.mark.parametrize("change", [outside, by_mesh, by_node], ids=lambda change: change.__name__)
def test_mixtures_are_measured_at_the_morph_weights_that_play(
    change: Callable[[Any], None], tmp_path: Path
) -> None:
    """Half-way between a clip and the same clip again is that clip."""

    def twice(content: Any) -> None:
        change(content)
        content["animations"].append({**copy.deepcopy(content["animations"][0]), "name": "again"})

    made = tmp_path / "out.glb"
    invoke("bake", rewritten(SHEET, tmp_path / "in.glb", twice), "-o", made, "--correctives", "auto")
    file = verify(made).file
    between, turned = file["mixtures"]
    assert between["name"].startswith("half-way between")
    for truth, normals in (("triangles", "normals_by_triangles"), ("tangents", "normals_by_tangents")):
        for lighting in ("standard", "corrected"):
            figure = file[normals]["lbs"][lighting]["mean"]
            assert between[lighting][truth] == pytest.approx(figure, rel=0.1, abs=0.05)
        assert turned["corrected"][truth] < turned["standard"][truth]


def lacking_in_parts(content: Any) -> None:
    in_parts(content)
    for primitive in content["meshes"][0]["primitives"]:
        for target in primitive["targets"]:
            target.pop("NORMAL")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize(
    "change", [one_without_normal, none_with_normal, lacking_in_parts], ids=lambda change: change.__name__
)
def test_normals_of_targets_and_correctives_go_together(
    change: Callable[[Any], None], suffix: str, tmp_path: Path
) -> None:
    given = rewritten(SHEET, tmp_path / "in.glb", change)
    if suffix == ".gltf":
        content = gltf_reading.read(given)
        (tmp_path / "in.bin").write_bytes(content.binary_chunk or b"")
        content.content["buffers"][0]["uri"] = "in.bin"
        given = tmp_path / "in.gltf"
        given.write_text(json.dumps(content.content))
    options = ["--correctives", "auto", "--morph-normals"]
    names = ("made", "plain", "again/made", "back")
    made, plain, again, back = (tmp_path / f"{name}{suffix}" for name in names)
    result = invoke("bake", given, "-o", made, *options)
    assert result.exit_code == 0 and "NORMAL made for" in result.output, result.output
    assert invoke("bake", given, "-o", plain, *options[:2]).exit_code == 0
    # Every target has NORMAL, and the figures are those of a reader that knows nothing of bakes.
    file = gltf_reading.read(made)
    assert all("NORMAL" in one for part in file.content["meshes"][0]["primitives"] for one in part["targets"])
    (lit, corrected), (without, _) = (mean_errors(path, 0, TIMES) for path in (made, plain))
    assert corrected < 0.3 * lit < 0.3 * without
    answer = verify(made)
    assert answer.file["passed"] and not answer.file["warnings"]
    # Both bakes are undone, and made again, byte for byte.
    assert invoke("bake", made, "-o", again, *options).exit_code == 0
    assert invoke("strip", made, "-o", back).exit_code == 0
    for path, same in ((again, made), (back, given)):
        assert path.read_bytes() == same.read_bytes()
    if suffix == ".gltf":
        assert not list(tmp_path.glob("back*.bin"))
    report, before = khronos.validate(made), khronos.validate(given)
    assert report["errors"] == before["errors"] and report["warnings"] == before["warnings"]


@pytest.mark.slow
def test_made_normals_of_targets_that_changed_are_stale(tmp_path: Path) -> None:
    given, made = rewritten(SHEET, tmp_path / "in.glb", none_with_normal), tmp_path / "out.glb"
    invoke("bake", given, "-o", made, "--correctives", "auto", "--morph-normals")

    def swapped(content: Any) -> None:
        first, second, *_ = content["meshes"][0]["primitives"][0]["targets"]
        first["POSITION"], second["POSITION"] = second["POSITION"], first["POSITION"]

    (check,) = (
        one
        for one in verify(rewritten(made, tmp_path / "other.glb", swapped)).file["checks"]
        if one["name"] == "freshness"
    )
    assert "morphs-stale" in {one["code"] for one in check["problems"]}


def test_normals_of_targets_stay_where_correctives_do_not_help(tmp_path: Path) -> None:
    def still(content: Any) -> None:
        none_with_normal(content)
        content["animations"] = []

    given, made = rewritten(SHEET, tmp_path / "in.glb", still), tmp_path / "out.glb"
    result = invoke("bake", given, "-o", made, "--correctives", "auto", "--morph-normals")
    assert result.exit_code == 0 and "NORMAL made for 2 morph targets" in result.output
    assert "only clips play correctives" in result.output
    assert all("NORMAL" in target for target in gltf_reading.read(made).primitive(0)["targets"])


@pytest.mark.slow
@pytest.mark.parametrize("weights", [None, [0.0, 0.0], pytest.param([0.0, 0.25], marks=pytest.mark.slow)])
def test_morph_targets_that_only_a_page_moves_get_no_channel(
    weights: list[float] | None, tmp_path: Path
) -> None:
    """Weights that a node or mesh sets count as set by the file. Zeros, as exporters write them, do not."""

    def still(content: Any) -> None:
        _still(content, weights or [])
        if weights is None:
            content["meshes"][0].pop("weights")

    given, made = rewritten(SHEET, tmp_path / "in.glb", still), tmp_path / "out.glb"
    result = invoke("bake", given, "-o", made, "--correctives", "auto", "--json")
    assert result.exit_code == 0
    codes = {one["code"] for one in json.loads(result.stdout)["files"][0]["warnings"]}
    is_free = weights is None or not any(weights)
    assert ("weights-free" in codes) == is_free
    assert (made.read_bytes() == given.read_bytes()) == is_free
    owned = invoke(
        "bake", given, "-o", tmp_path / "owned.glb", "--correctives", "auto", "--clips-own-weights"
    )
    assert owned.exit_code == 0 and "corrective normal" in owned.output
    assert verify(tmp_path / "owned.glb").exit_code == 0
    if is_free:
        back = invoke("strip", tmp_path / "owned.glb", "-o", tmp_path / "back.glb")
        assert back.exit_code == 0
        assert (tmp_path / "back.glb").read_bytes() == given.read_bytes()
