"""Undo looks for other users: what strip, or a bake again, makes of a file that a tool has changed since.

The Khronos validator finds no more in it than before, and data of others stays. What is another's is read by
the tests' own reader.
"""

from __future__ import annotations

import base64
import copy
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from tests.correctives.models import rewritten
from tests.support import gltf_transform, khronos
from tests.support.baked_files import Editable
from tests.support.command_line import invoke
from tests.support.compressed import draco_twin, meshopt_twin
from tests.support.corpus import require_corpus
from tests.support.decoders import read_plain_many
from tests.support.gltf_reading import GltfFile, JsonObject, read
from tests.support.models import sheet, write_model

TUBE, MORPHED = FOLDER / "bent_tube.glb", FOLDER / "morphed_sheet.glb"

GRADIENTS: dict[str, list[str]] = {
    "default": [],
    "packed8": ["--encoding", "packed8"],
    "snorm16": ["--encoding", "snorm16"],
    "texcoord": ["--layout", "texcoord"],
    "custom": ["--layout", "custom"],
    "extend": ["--neighbours", "extend"],
    "limit": ["--limit-influences", "4"],
    "meshopt": ["--compress", "meshopt"],
    "draco": ["--compress", "draco"],
    "morph-normals": ["--morph-normals"],
    "morph-frames": ["--morph-normals", "--morph-frames"],
}
CORRECTIVES: dict[str, list[str]] = {
    "correctives": ["--correctives", "2"],
    "correctives in snorm16": ["--correctives", "2", "--encoding", "snorm16"],
    "correctives in packed8": ["--correctives", "2", "--encoding", "packed8"],
}
TOOLS = (
    *("copy", "dedup", "dequantize", "draco", "flatten", "join", "meshopt", "metalrough", "normals"),
    *("palette", "prune", "quantize", "reorder", "resample", "simplify", "sortWeights", "sparse"),
    *("tangents", "unpartition", "unweld", "weld"),
)
OURS = ("JOINTS_", "WEIGHTS_", "TANGENT", "_SKINBAKE", "_CUSTOM")
"""The attributes that bake adds or replaces; strip may bring former ones back."""


def baked(source: Path, target: Path, options: Sequence[str]) -> bool:
    """Bake a file, and tell whether there was anything to bake."""
    own = [] if "--correctives" in options else ["--generate-normals"]
    result = invoke("bake", source, "-o", target, *own, *options)
    assert result.exit_code in {0, 3}, result.output
    return result.exit_code == 0 and "skinbake" in json.dumps(read(target).content.get("meshes"))


def of_others(file: GltfFile, counts: Mapping[int, int]) -> dict[str, Any]:
    """Return all content of a file that is of no bake. counts are a mesh's own morph targets, by number."""
    content = file.content
    ours = {"meshes", "nodes", "animations", "accessors", "bufferViews", "buffers", "asset", "skins"}
    found: dict[str, Any] = {
        key: value
        for key, value in content.items()
        if key not in ours and key not in ("extensionsUsed", "extensionsRequired")
    }
    found["nodes"] = [{**node, "weights": None} for node in content["nodes"]]
    for number, skin in enumerate(content.get("skins", [])):
        found[f"skin {number}"] = skin["joints"], file.values(skin["inverseBindMatrices"]).tolist()
    found |= of_meshes(file, counts) | of_extensions(file)
    for number, animation in enumerate(content.get("animations", [])):
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            if channel["target"]["path"] != "weights":
                at = f"animation {number}: {json.dumps(channel['target'])}"
                found[at] = [file.values(sampler[key]).tolist() for key in ("input", "output")]
    return found


def of_meshes(file: GltfFile, counts: Mapping[int, int]) -> dict[str, Any]:
    """Return the triangles, attributes and targets of all primitives that are of no bake."""
    content, found = file.content, dict[str, Any]()
    for number, mesh in enumerate(content["meshes"]):
        for position, primitive in enumerate(mesh["primitives"]):
            at = f"mesh {number}, primitive {position}"
            note = (primitive.get("extras") or {}).get("skinbake", {})
            added = {*note.get("alpha", ()), *note.get("beta", ()), *note.get("generated", ())}
            found[at] = primitive.get("material"), primitive.get("mode")
            if "indices" in primitive:
                found[f"{at}, indices"] = file.values(primitive["indices"]).tolist()
            for name, accessor in primitive["attributes"].items():
                if name not in added and not name.startswith(OURS):
                    found[f"{at}, {name}"] = file.values(accessor).tolist()
            for target, entries in enumerate(primitive.get("targets", ())[: counts.get(number)]):
                if "POSITION" in entries:
                    found[f"{at}, target {target}"] = file.values(entries["POSITION"]).tolist()
    return found


def of_extensions(file: GltfFile) -> dict[str, Any]:
    """Return the data that two extensions name: instances, and a table of properties."""
    content, found = file.content, dict[str, Any]()
    for number, node in enumerate(content["nodes"]):
        instances = node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {"attributes": {}})
        for name, accessor in instances["attributes"].items():
            found[f"node {number}, {name}"] = file.values(accessor).tolist()
    for table in content.get("extensions", {}).get("EXT_structural_metadata", {}).get("propertyTables", ()):
        found["property table"] = file.buffer_view(table["properties"]["a"]["values"])
    return found


def own_targets(path: Path) -> dict[int, int]:
    """Return the number of morph targets of each mesh."""
    meshes = read(path).content["meshes"]
    return {number: len(mesh["primitives"][0].get("targets", ())) for number, mesh in enumerate(meshes)}


def undone(path: Path, options: Sequence[str]) -> Iterator[Path]:
    """Strip a file, and bake it again; yield the results."""
    for name, command in (
        ("stripped", ["strip"]),
        ("again", ["bake", *([] if "--correctives" in options else ["--generate-normals"]), *options]),
    ):
        target = path.with_name(f"{path.stem} {name}.glb")
        result = invoke(command[0], path, "-o", target, *command[1:])
        assert result.exit_code == 0, f"{path.name}, {name}: {result.output}"
        yield target


def check_tools(source: Path, folder: Path, bakes: Mapping[str, list[str]], tools: Sequence[str]) -> None:
    """Bake a file in each way, let each tool change it, strip it and bake it again, and hold the results."""
    gltf_transform.require_node()
    made = {}
    for name, options in bakes.items():
        if baked(source, folder / f"{name}.glb", options):
            made[name] = folder / f"{name}.glb"
            (back, _) = undone(made[name], options)
            if not {"draco", "meshopt"} & {name}:
                assert back.read_bytes() == source.read_bytes(), name
    jobs = [
        (path, folder / f"{name} {tool}.glb", tool)
        for (name, path), tool in itertools.product(made.items(), tools)
    ]
    failures = gltf_transform.transform(jobs)
    pairs = [
        (changed, result, path.stem)
        for (path, changed, _), failure in zip(jobs, failures, strict=True)
        if not failure
        for result in undone(changed, bakes[path.stem])
    ]
    assert pairs
    reports = khronos.validate_many(path for pair in pairs for path in pair[:2])
    files = read_plain_many(path for pair in pairs for path in pair[:2])
    counts = own_targets(source)
    for changed, result, name in pairs:
        assert not khronos.new_findings(reports[changed], reports[result]), result.name
        if name in ("meshopt", "draco") and result.stem.endswith("again"):
            continue  # compressed once more, in another order
        kept = {number: counts.get(number, 0) for number in range(len(files[changed].content["meshes"]))}
        before, after = (of_others(files[path], kept) for path in (changed, result))
        assert {key for key in before if before[key] != after.get(key)} == set(), result.name


@pytest.mark.slow
def test_strip_and_a_bake_after_common_tools_give_valid_files_with_the_data_of_others(tmp_path: Path) -> None:
    bakes = {"default": [], "correctives in packed8": CORRECTIVES["correctives in packed8"]}
    check_tools(TUBE, tmp_path, bakes, ["copy", "quantize"])


SOURCES: dict[str, Callable[[Path], Path]] = {
    "tube": lambda folder: TUBE,
    "adopting": lambda folder: FOLDER / "foreign_joints.glb",
    "morphed": lambda folder: MORPHED,
    "parts": lambda folder: FOLDER / "two_primitives.glb",
    "two sets": lambda folder: FOLDER / "two_sets.glb",
    "without normals": lambda folder: write_model(folder / "in.glb", [sheet(NORMAL=None)]),
    "draco": lambda folder: draco_twin(TUBE, folder / "in.glb"),
    "meshopt": lambda folder: meshopt_twin(FOLDER / "foreign_joints.glb", folder / "in.glb"),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "bakes", "tools"),
    [
        ("tube", CORRECTIVES, TOOLS[::2]),
        ("morphed", CORRECTIVES, TOOLS[1::2]),
        *((source, GRADIENTS, TOOLS[number % 4 :: 4]) for number, source in enumerate(SOURCES)),
    ],
    ids=["tube, correctives", "morphed, correctives", *SOURCES],
)
def test_strip_and_a_bake_after_any_tool_give_valid_files_with_the_data_of_others(
    source: str, bakes: dict[str, list[str]], tools: tuple[str, ...], tmp_path: Path
) -> None:
    """Every tool meets every kind of bake, of gradients on two of the sources."""
    check_tools(SOURCES[source](tmp_path), tmp_path, bakes, tools)


@pytest.mark.slow
def test_a_real_file_that_was_quantised_after_its_correctives_keeps_the_extension(tmp_path: Path) -> None:
    source = require_corpus() / "hostile" / "turn4" / "quantised_after_correctives.glb"
    result = invoke("strip", source, "-o", tmp_path / "out.glb")
    assert result.exit_code == 0, result.output
    content = read(tmp_path / "out.glb").content
    assert "KHR_mesh_quantization" in content["extensionsUsed"]
    assert "KHR_mesh_quantization" in content["extensionsRequired"]
    assert not khronos.validate(tmp_path / "out.glb")["errors"]


def put(content: JsonObject, values: Any, kind: str, **members: Any) -> int:
    """Add an accessor with bytes of its own, in a buffer behind all others; return its number."""
    array = np.ascontiguousarray(values)
    code = {"i1": 5120, "u2": 5123, "f4": 5126}[array.dtype.str[1:]]
    text = base64.b64encode(array.tobytes()).decode()
    uri = f"data:application/octet-stream;base64,{text}"
    content["buffers"].append({"uri": uri, "byteLength": array.nbytes})
    content["bufferViews"].append({"buffer": len(content["buffers"]) - 1, "byteLength": array.nbytes})
    content["accessors"].append(
        {
            "bufferView": len(content["bufferViews"]) - 1,
            "componentType": code,
            "count": len(array),
            "type": kind,
            **members,
        }
    )
    return len(content["accessors"]) - 1


def drawn(content: JsonObject, mesh: JsonObject, **members: Any) -> int:
    """Add a mesh and a node that draws it; return the node's number."""
    content["meshes"].append(mesh)
    content["nodes"].append({"mesh": len(content["meshes"]) - 1, **members})
    content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)
    return len(content["nodes"]) - 1


def first(content: JsonObject) -> JsonObject:
    primitive: JsonObject = content["meshes"][0]["primitives"][0]
    return primitive


def our_accessor(content: JsonObject) -> int:
    """Return an accessor with three floats a vertex that the bake has added."""
    primitive = first(content)
    targets = primitive.get("targets", [])
    number: int = targets[-1]["NORMAL"] if targets else primitive["attributes"]["_SKINBAKE_ALPHA_0"]
    return number


def another_attribute(content: JsonObject) -> None:
    position = first(content)["attributes"]["POSITION"]
    drawn(content, {"primitives": [{"attributes": {"POSITION": position, "_MINE": our_accessor(content)}}]})


def another_accessor_of_the_view(content: JsonObject) -> None:
    ours = content["accessors"][our_accessor(content)]
    view = ours["bufferView"] if "bufferView" in ours else ours["sparse"]["values"]["bufferView"]
    content["bufferViews"][view]["byteStride"] = 12
    content["bufferViews"][view].setdefault("target", 34962)
    count = content["bufferViews"][view]["byteLength"] // 12
    content["accessors"].append({"bufferView": view, "componentType": 5126, "count": count, "type": "VEC3"})
    position = put(content, np.zeros((count, 3), "<f4"), "VEC3", min=[0, 0, 0], max=[0, 0, 0])
    number = len(content["accessors"]) - 2
    drawn(content, {"primitives": [{"attributes": {"POSITION": position, "_MINE": number}, "mode": 0}]})


def instances(content: JsonObject) -> None:
    position = first(content)["attributes"]["POSITION"]
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": our_accessor(content)}}}
    drawn(content, {"primitives": [{"attributes": {"POSITION": position}}]}, extensions=extension)
    content.setdefault("extensionsUsed", []).append("EXT_mesh_gpu_instancing")


def a_property_table(content: JsonObject) -> None:
    table = {"class": "a", "count": 1, "properties": {"a": {"values": len(content["bufferViews"]) - 1}}}
    schema = {
        "id": "a",
        "classes": {"a": {"properties": {"a": {"type": "SCALAR", "componentType": "FLOAT32"}}}},
    }
    metadata = {"schema": schema, "propertyTables": [table]}
    content["extensions"] = {"EXT_structural_metadata": metadata}
    content.setdefault("extensionsUsed", []).append("EXT_structural_metadata")


def a_second_scene(content: JsonObject) -> None:
    content["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    content["nodes"].append({"camera": 0})
    content["scenes"].append({"nodes": [len(content["nodes"]) - 1, *content["scenes"][0]["nodes"]]})


def a_quantised_mesh(content: JsonObject) -> None:
    corners = np.array([[0, 0, 0, 0], [127, 0, 0, 0], [0, 127, 0, 0]], "<i1")
    bounds = {"min": [0, 0, 0], "max": [127, 127, 0], "normalized": True}
    position = put(content, corners, "VEC3", **bounds)
    content["bufferViews"][-1] |= {"byteStride": 4, "target": 34962}
    drawn(content, {"primitives": [{"attributes": {"POSITION": position}}]})
    for key in ("extensionsUsed", "extensionsRequired"):
        content[key] = list(dict.fromkeys([*content.get(key, []), "KHR_mesh_quantization"]))


def another_mesh_in_our_clip(content: JsonObject) -> None:
    """A copy of the mesh plays the weights that the bake has added, by a channel and a sampler of its own."""
    mesh = copy.deepcopy(content["meshes"][0])
    del mesh["extras"]
    node = drawn(content, mesh)
    (clip, *_) = content["animations"]
    ours = [one["sampler"] for one in clip["channels"] if one["target"]["path"] == "weights"]
    clip["channels"].append({"sampler": ours[-1], "target": {"node": node, "path": "weights"}})


def a_channel_behind_ours(content: JsonObject) -> None:
    (clip, *_) = content["animations"]
    content["nodes"].append({"name": "moved"})
    content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)
    times = put(content, np.array([[0.0], [1.0]], "<f4"), "SCALAR", min=[0], max=[1])
    places = put(content, np.array([[0, 0, 0], [1, 2, 3]], "<f4"), "VEC3")
    clip["samplers"].append({"input": times, "output": places})
    target = {"node": len(content["nodes"]) - 1, "path": "translation"}
    clip["channels"].append({"sampler": len(clip["samplers"]) - 1, "target": target})


def reordered_clips(content: JsonObject) -> None:
    """Channels and samplers in the reverse order, as a tool may write them."""
    for clip in content["animations"]:
        last = len(clip["samplers"]) - 1
        clip["samplers"].reverse()
        clip["channels"] = [{**one, "sampler": last - one["sampler"]} for one in reversed(clip["channels"])]


def an_unused_buffer(content: JsonObject) -> None:
    put(content, np.arange(6, dtype="<f4").reshape(2, 3), "VEC3")


GRADIENT_EDITS = (
    *(another_attribute, another_accessor_of_the_view, instances, a_property_table, a_second_scene),
    *(a_quantised_mesh, a_channel_behind_ours, reordered_clips, an_unused_buffer),
)
CORRECTIVE_EDITS = (*GRADIENT_EDITS, another_mesh_in_our_clip)


@pytest.fixture(scope="module")
def bakes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path, list[str]]]:
    """Bakes by name: the source, the baked file, the options."""
    folder, found = tmp_path_factory.mktemp("bakes"), {}
    for name, source, options in (
        ("gradients", TUBE, []),
        ("adopting", FOLDER / "foreign_joints.glb", []),
        ("correctives", TUBE, CORRECTIVES["correctives"]),
        ("packed8", MORPHED, CORRECTIVES["correctives in packed8"]),
    ):
        assert baked(source, folder / f"{name}.glb", options)
        found[name] = source, folder / f"{name}.glb", options
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "edit"),
    [
        *itertools.product(("gradients", "adopting"), GRADIENT_EDITS),
        *itertools.product(("correctives", "packed8"), CORRECTIVE_EDITS),
    ],
)
def test_strip_and_a_bake_leave_what_another_user_needs(
    name: str,
    edit: Callable[[JsonObject], None],
    bakes: dict[str, tuple[Path, Path, list[str]]],
    tmp_path: Path,
) -> None:
    source, made, options = bakes[name]
    if edit in (a_channel_behind_ours, reordered_clips) and "animations" not in read(made).content:
        pytest.skip("it has no clip")
    if edit in (another_attribute, another_accessor_of_the_view, instances) and name == "packed8":
        pytest.skip("three floats a vertex are not there")
    changed = rewritten(made, tmp_path / "changed.glb", edit)
    reports = khronos.validate_many([changed, *(results := list(undone(changed, options)))])
    kept = own_targets(source)
    for result in results:
        assert not khronos.new_findings(reports[changed], reports[result]), reports[result]
        assert len(read(result).content["meshes"]) == len(read(changed).content["meshes"])
        before, after = (of_others(read(path), kept) for path in (changed, result))
        assert {key for key in before if before[key] != after.get(key)} == set()


@pytest.mark.slow
def test_weights_and_names_that_a_user_gives_own_targets_later_stay(
    bakes: dict[str, tuple[Path, Path, list[str]]], tmp_path: Path
) -> None:
    source, made, _ = bakes["packed8"]
    own = own_targets(source)[0]
    count = own_targets(made)[0]
    names = [f"mine {number}" for number in range(count)]
    weights = [0.25] * own + [0] * (count - own)

    def edit(content: JsonObject) -> None:
        content["meshes"][0]["extras"]["targetNames"] = names
        content["meshes"][0]["weights"] = weights

    changed = rewritten(made, tmp_path / "changed.glb", edit)
    assert invoke("strip", changed, "-o", tmp_path / "back.glb").exit_code == 0
    (mesh,) = read(tmp_path / "back.glb").content["meshes"]
    assert mesh["weights"] == weights[:own]
    assert mesh["extras"] == {"targetNames": names[:own]}


@pytest.mark.parametrize("holder", ["/meshes/0/weights", "/nodes/{node}/weights"])
def test_a_pointer_to_a_weight_goes_with_its_target_alone(
    holder: str, bakes: dict[str, tuple[Path, Path, list[str]]], tmp_path: Path
) -> None:
    source, made, _ = bakes["packed8"]
    own, count = own_targets(source)[0], own_targets(made)[0]
    node = next(number for number, one in enumerate(read(made).content["nodes"]) if "skin" in one)
    pointers = [f"{holder.format(node=node)}/{number}" for number in (0, own - 1, own, count - 1)]

    def edit(content: JsonObject) -> None:
        times = put(content, np.array([[0.0], [1.0]], "<f4"), "SCALAR", min=[0], max=[1])
        sampler = {"input": times, "output": put(content, np.array([[0.0], [0.5]], "<f4"), "SCALAR")}
        extensions = [{"KHR_animation_pointer": {"pointer": pointer}} for pointer in pointers]
        targets = [{"path": "pointer", "extensions": one} for one in extensions]
        channels = [{"sampler": 0, "target": target} for target in targets]
        content["animations"].append({"samplers": [sampler], "channels": channels})
        content["extensionsUsed"] = [*content.get("extensionsUsed", []), "KHR_animation_pointer"]

    changed = rewritten(made, tmp_path / "changed.glb", edit)
    assert invoke("strip", changed, "-o", tmp_path / "back.glb").exit_code == 0
    content = read(tmp_path / "back.glb").content
    targets = [one["target"]["extensions"] for one in content["animations"][-1]["channels"]]
    assert [one["KHR_animation_pointer"]["pointer"] for one in targets] == pointers[:2]
    assert "KHR_animation_pointer" in content["extensionsUsed"]


@pytest.mark.slow
def test_normals_that_a_user_gives_a_target_later_stay(tmp_path: Path) -> None:
    """The bake has filled the target with zeros."""
    source = rewritten(
        MORPHED, tmp_path / "in.glb", lambda content: first(content)["targets"][0].pop("NORMAL")
    )
    assert baked(source, tmp_path / "made.glb", CORRECTIVES["correctives"])
    vertices = len(read(source).attribute("POSITION"))

    def edit(content: JsonObject) -> None:
        first(content)["targets"][0]["NORMAL"] = put(content, np.full((vertices, 3), 0.5, "<f4"), "VEC3")

    changed = rewritten(tmp_path / "made.glb", tmp_path / "changed.glb", edit)
    for path in (tmp_path / "made.glb", changed):
        assert invoke("strip", path, "-o", path.with_suffix(".back.glb")).exit_code == 0
    assert (tmp_path / "made.back.glb").read_bytes() == source.read_bytes()
    back = read(tmp_path / "changed.back.glb")
    assert (back.values(first(back.content)["targets"][0]["NORMAL"]) == 0.5).all()


@pytest.mark.slow
def test_a_former_sampler_is_known_by_its_values_not_by_its_number(tmp_path: Path) -> None:
    """Two meshes have a target each, and samplers of one shape: a tool exchanges these."""
    file = Editable(MORPHED)
    content = file.content
    mesh = content["meshes"][0]
    mesh["primitives"][0]["targets"] = mesh["primitives"][0]["targets"][:1]
    mesh.pop("weights", None)
    mesh.pop("extras", None)
    node = next(number for number, one in enumerate(content["nodes"]) if "skin" in one)
    content["nodes"][node].pop("weights", None)
    content["meshes"].append(copy.deepcopy(mesh))
    content["nodes"].append({**content["nodes"][node], "mesh": 1})
    content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)
    clip = content["animations"][0]
    clip["channels"] = [one for one in clip["channels"] if one["target"]["path"] != "weights"]
    times = file.add(np.array([[0.0], [1.0]], np.float32))
    content["accessors"][times] |= {"min": [0.0], "max": [1.0]}
    for number, values in ((node, [0.0, 1.0]), (len(content["nodes"]) - 1, [0.5, 0.25])):
        output = file.add(np.array(values, np.float32)[:, None])
        clip["samplers"].append({"input": times, "output": output})
        target = {"node": number, "path": "weights"}
        clip["channels"].append({"sampler": len(clip["samplers"]) - 1, "target": target})
    source = file.write(tmp_path / "in.glb")
    assert baked(source, tmp_path / "made.glb", CORRECTIVES["correctives"])

    def exchange(content: JsonObject) -> None:
        clip = content["animations"][0]
        a, b = (len(content["animations"][0]["samplers"]) - 4 + number for number in range(2))
        clip["samplers"][a], clip["samplers"][b] = clip["samplers"][b], clip["samplers"][a]

    changed = rewritten(tmp_path / "made.glb", tmp_path / "changed.glb", exchange)
    result = invoke("strip", changed, "-o", tmp_path / "back.glb")
    assert result.exit_code == 0, result.output
    assert "rearranged the animations" in result.stderr
    back = read(tmp_path / "back.glb")
    found = {}
    for channel in back.content["animations"][0]["channels"]:
        if channel["target"]["path"] == "weights":
            sampler = back.content["animations"][0]["samplers"][channel["sampler"]]
            played = back.values(sampler["output"])[:, 0]
            found[channel["target"]["node"]] = float(played[0]), float(played[-1])
    assert found == {node: (0.0, 1.0), len(content["nodes"]) - 1: (0.5, 0.25)}


@pytest.mark.parametrize(
    ("attribute", "options"), [("TEXCOORD_9", ["--layout", "texcoord"]), ("TANGENT", [])]
)
def test_an_attribute_that_needs_ours_before_it_keeps_them(
    attribute: str, options: list[str], tmp_path: Path
) -> None:
    """Sets of texture coordinates are numbered without a gap, and TANGENT needs NORMAL."""
    source = write_model(tmp_path / "in.glb", [sheet(NORMAL=None)])
    assert baked(source, tmp_path / "made.glb", options)

    def edit(content: JsonObject) -> None:
        attributes = first(content)["attributes"]
        sets = sum(name.startswith("TEXCOORD_") for name in attributes)
        count = content["accessors"][attributes["POSITION"]]["count"]
        if attribute == "TANGENT":
            attributes[attribute] = put(content, np.tile(np.array([1, 0, 0, 1], "<f4"), (count, 1)), "VEC4")
        else:
            attributes[f"TEXCOORD_{sets}"] = put(content, np.zeros((count, 2), "<f4"), "VEC2")

    changed = rewritten(tmp_path / "made.glb", tmp_path / "changed.glb", edit)
    assert invoke("strip", changed, "-o", tmp_path / "back.glb").exit_code == 0
    reports = khronos.validate_many([changed, tmp_path / "back.glb"])
    assert not khronos.new_findings(*reports.values())
