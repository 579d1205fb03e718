"""Cases that are each aimed at one branch of the readers: what chance takes too long to find.

They run before all others, under the same judges. Each model of ``directed.py`` is put undamaged through
every command too.
"""

from __future__ import annotations

import base64
import hashlib
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import meshopt
import numpy as np

from fuzz.cases import Case
from fuzz.models import GLB, GLTF, WRAPPED, JsonObject, Model, glb, read_model
from fuzz.seeds import edgebreaker_twin, filtered_twin

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
PICTURE = b"\x89PNG\r\n"
DRACO = "KHR_draco_mesh_compression"

TO_GLB, TO_GLTF = ("bake", "in/m.glb", "-o", "out/m.glb"), ("bake", "in/m.gltf", "-o", "out/m.gltf")
UNDER_COMMANDS: tuple[tuple[str, ...], ...] = (
    TO_GLB,
    (*TO_GLB, "--compress", "none"),
    (*TO_GLB, "--compress", "draco", "--texcoord-bits", "12"),
    (*TO_GLB, "--compress", "meshopt"),
    ("verify", "in/m.glb", "--poses", "random:2"),
    ("inspect", "in/m.glb"),
    ("strip", "in/m.glb", "-o", "out/m.glb"),
)
"""The command lines for each directed model."""


def aimed_cases(models: Sequence[Model]) -> list[Case]:
    """Return the cases; ``models`` are those that are damaged, among them the directed ones."""
    found = [*_directed(models), *_edits(), *_streams(), *_beside(), *_pictures(), *_containers(), *_places()]
    return [
        Case(-1 - number, case.arguments, case.files, case.links, case.stdin, case.plain, case.about)
        for number, case in enumerate(found)
    ]


def _case(
    about: str,
    files: dict[str, bytes],
    arguments: Sequence[str] = TO_GLB,
    links: dict[str, str] | None = None,
) -> Case:
    return Case(0, tuple(arguments), files, links or {}, about=f"aimed: {about}")


def _of(about: str, model: Model, *arguments: str, way: str = GLB) -> Case:
    """Return the case of a model, by default that it is baked with more options."""
    _, files = model.packed(way)
    if not arguments or arguments[0].startswith("-"):
        arguments = (*(TO_GLB if way == GLB else TO_GLTF), *arguments)
    return _case(about, files, arguments)


def _directed(models: Sequence[Model]) -> Iterator[Case]:
    seen = set()
    for model in models:
        if ("directed" in model.name or "filters" in model.name) and model.name not in seen:
            seen.add(model.name)
            for arguments in UNDER_COMMANDS:
                yield _of(f"{model.name} as it is", model, *arguments)


# Models with one edit each


def _sheet() -> Model:
    """Return a skinned sheet: POSITION, NORMAL, JOINTS_0, WEIGHTS_0 and indices are accessors 0 to 4."""
    return read_model(FIXTURES / "weights_u8.glb")


def _primitive(model: Model) -> JsonObject:
    found: JsonObject = model.json["meshes"][0]["primitives"][0]
    return found


def _added(model: Model, values: Any, kind: str, code: int, **more: Any) -> int:
    """Append an accessor with data of its own; return its number."""
    data = np.ascontiguousarray(values).tobytes()
    views, accessors = model.json["bufferViews"], model.json["accessors"]
    model.binary += bytes(-len(model.binary) % 4)
    views.append({"buffer": 0, "byteOffset": len(model.binary), "byteLength": len(data)})
    model.binary += data
    model.json["buffers"][0]["byteLength"] = len(model.binary)
    entry = {"bufferView": len(views) - 1, "componentType": code, "count": len(values), "type": kind}
    accessors.append({**entry, **more})
    return len(accessors) - 1


def _with_attribute(name: str, values: Any, kind: str, code: int, **more: Any) -> Model:
    """Return the sheet with one more attribute."""
    model = _sheet()
    _primitive(model)["attributes"][name] = _added(model, values, kind, code, **more)
    return model


def _changed(change: Callable[[Model], object], base: Callable[[], Model] = _sheet) -> Model:
    """Return a model after one change."""
    model = base()
    change(model)
    return model


def _unskinned(model: Model) -> Model:
    """Return the model drawn without its skin: only ``--compress`` touches its mesh."""
    model.json["nodes"][0].pop("skin")
    model.json["meshes"].append({"primitives": [dict(_primitive(_sheet()))]})
    model.json["nodes"].append({"mesh": 1, "skin": 0})
    return model


VERTICES = 187


def _edits() -> Iterator[Case]:
    """Yield cases of documents with one thing wrong, or odd."""
    yield _of("no joints", _changed(lambda m: m.json["skins"][0].update(joints=[])))
    yield _of("null offset", _changed(lambda m: m.json["bufferViews"][0].update(byteOffset=None)))
    yield _of("no triangles", _changed(lambda m: m.json["accessors"][4].update(count=2)))
    yield _of("views without buffers", _changed(lambda m: m.json["bufferViews"][0].pop("buffer")))
    sets = {f"{kind}_{n}": at for n in range(70) for kind, at in (("JOINTS", 2), ("WEIGHTS", 3))}
    yield _of("70 sets", _changed(lambda m: _primitive(m)["attributes"].update(sets)))
    many = {f"_X{number}": 0 for number in range(140)}
    yield _of(
        "140 attributes", _changed(lambda m: _primitive(m)["attributes"].update(many)), "--compress", "draco"
    )
    yield _of("VEC9", _changed(lambda m: m.json["accessors"][0].update(type="VEC9")))
    nines = _with_attribute("_NINES", np.zeros((VERTICES, 9), np.float32), "VEC9", 5126)
    yield _of("VEC9 that only inspect reads", nines, "inspect", "in/m.glb")
    yield _of("component type 1", _changed(lambda m: m.json["accessors"][0].update(componentType=1)))
    yield _of("many vertices of zeros", _changed(_hollow))
    yield _of("more zeros than its bytes allow", _changed(_all_zeros))
    yield _of(
        "extensions by number", _changed(lambda m: m.json.update(extensionsUsed=[7])), "--compress", "draco"
    )
    for way in ("draco", "meshopt"):
        yield _of("no indices", _changed(lambda m: _primitive(m).pop("indices")), "--compress", way)
    yield from _bounds()
    yield from _skins()
    yield from _morphs()


def _hollow(model: Model, count: int = 300_000) -> None:
    """Let all attributes claim so many zeros that the memory of the machine is looked up."""
    for accessor in model.json["accessors"][:4]:
        del accessor["bufferView"]
        accessor["count"] = count


def _all_zeros(model: Model) -> None:
    """Let tangents claim zeros too: more than a file of these bytes may."""
    _hollow(model, 510_000)
    accessors = model.json["accessors"]
    accessors.append({"componentType": 5126, "count": 510_000, "type": "VEC4"})
    _primitive(model)["attributes"]["TANGENT"] = len(accessors) - 1


def _bounds() -> Iterator[Case]:
    """Yield cases of attributes that codecs take in a special way."""
    draco, bits = ("--compress", "draco"), ("--compress", "draco", "--texcoord-bits", "12")
    ones, three = np.ones((VERTICES, 1), "<u4"), np.ones((VERTICES, 3), "<f4")
    yield _of("32-bit integers", _with_attribute("_X", ones, "SCALAR", 5125), *draco)
    yield _of("short", _with_attribute("_X", three[1:], "VEC3", 5126), *draco)
    shorts = np.ones((VERTICES, 2), "<u2")
    yield _of("integer texture", _with_attribute("TEXCOORD_0", shorts, "VEC2", 5123, normalized=True), *bits)
    yield _of("texture of three", _with_attribute("TEXCOORD_0", three, "VEC3", 5126), *bits)
    yield _of("huge", _changed(_spread), *draco)
    yield _of("indices past the end", _unskinned(_changed(_past_the_end)), *draco)
    yield _of(
        "65 indices", _changed(lambda m: m.json["accessors"][4].update(count=65)), "--compress", "meshopt"
    )


def _spread(model: Model) -> None:
    struct.pack_into("<6f", model.binary, 0, -3e38, 0, 0, 3e38, 0, 0)


def _past_the_end(model: Model) -> None:
    struct.pack_into("<H", model.binary, 6732, VERTICES)


def _skins() -> Iterator[Case]:
    """Yield cases of skins: two groups of meshes that share no joint, and each way to have no rig or two."""

    def apart(model: Model) -> None:
        nodes = model.json["nodes"]
        nodes += [{"mesh": 1, "skin": 1}, {}]
        model.json["meshes"].append({"primitives": [dict(_primitive(model))]})
        model.json["skins"].append({"joints": [len(nodes) - 1] * 4})

    def crossed(model: Model) -> None:
        apart(model)
        model.json["skins"][1]["joints"] = model.json["skins"][0]["joints"][::-1]

    yield _of("skins apart", _changed(apart), "--weld", "skin")
    yield _of("skins that share joints", _changed(crossed), "--weld", "skin")
    yield _of("a skin of one joint", _changed(_one_joint))
    yield _of("joints that cannot turn", _changed(_flattened))
    yield _of("skins of two bind poses", _changed(_posed_twice))


def _one_joint(model: Model) -> None:
    skin = model.json["skins"][0]
    skin["joints"] = skin["joints"][:1]
    joints = _added(model, np.zeros((VERTICES, 4), "|u1"), "VEC4", 5121)
    _primitive(model)["attributes"]["JOINTS_0"] = joints


def _bound(model: Model, matrix: Any) -> int:
    """Add an inverse bind matrix for each joint of the sheet; return the accessor."""
    count = len(model.json["skins"][0]["joints"])
    matrices = np.tile(np.asarray(matrix, "<f4").ravel(), (count, 1))
    return _added(model, matrices, "MAT4", 5126)


def _flattened(model: Model) -> None:
    model.json["skins"][0]["inverseBindMatrices"] = _bound(model, np.diag([0, 0, 0, 1]))


def _posed_twice(model: Model) -> None:
    skins, nodes = model.json["skins"], model.json["nodes"]
    shift = np.eye(4)
    shift[3, :3] = 1.0, 2.0, 3.0  # the columns of the matrix one after another
    skins.append({**skins[0], "inverseBindMatrices": _bound(model, shift)})
    nodes.append({"mesh": 0, "skin": 1})


def _morphs() -> Iterator[Case]:
    """Yield cases of morph targets and channels that do not fit their mesh, as ``verify`` reads them."""
    verify = ("verify", "in/m.glb", "--poses", "random:1")

    def targets(*given: JsonObject) -> Callable[[Model], object]:
        return lambda model: _primitive(model).update(targets=list(given))

    def two_numbers(model: Model) -> None:
        first = _primitive(model)
        first["targets"] = [{"POSITION": 0}]
        model.json["meshes"][0]["primitives"].append({**first, "targets": [{"POSITION": 0}] * 2})

    yield _of("targets of two numbers", _changed(two_numbers, _bake), *verify)
    yield _of("targets of another count", _changed(targets({"POSITION": 4}), _bake), *verify)
    yield _of("targets of four numbers", _changed(targets({"NORMAL": 2}), _bake), *verify)
    shorts = _bake()
    number = _added(shorts, np.ones((VERTICES, 3), "<u2"), "VEC3", 5123)
    yield _of("targets of shorts", _changed(targets({"POSITION": number}), lambda: shorts), *verify)
    yield _of("targets of one primitive of two", _changed(_half_morphed, _bake), *verify)
    yield _of("a circle of joints", _changed(_circle, _bake), *verify)
    yield _of("channels of nothing", _changed(_pointing, _bake), *verify)
    yield _of("a sampler of two channels", _changed(_moved_twice, _bake), "verify", "in/m.glb")
    yield _of("channels by pointers", _changed(_moved_by_pointers, _bake), "verify", "in/m.glb")
    yield _of("weights of another count", _changed(_weighted_by_three, _bake), "verify", "in/m.glb")


def _half_morphed(model: Model) -> None:
    first = _primitive(model)
    model.json["meshes"][0]["primitives"].append(dict(first))
    first["targets"] = [{"POSITION": 0}]


def _circle(model: Model) -> None:
    model.json["nodes"][1]["children"] = [2]
    model.json["nodes"][2]["children"] = [1]


def _pointing(model: Model) -> None:
    channels = [{"sampler": 0, "target": {"path": "pointer"}}]
    model.json["animations"] = [{"channels": channels, "samplers": [{"input": 0, "output": 0}]}] * 2


def _moved_twice(model: Model) -> None:
    times = _added(model, np.arange(2, dtype="<f4"), "SCALAR", 5126, min=[0], max=[1])
    output = _added(model, np.ones((2, 4), "<f4"), "VEC4", 5126)
    channels = [{"sampler": 0, "target": {"node": node, "path": "rotation"}} for node in (1, 2)]
    samplers = [{"input": times, "output": output}]
    model.json["animations"] = [{"channels": channels, "samplers": samplers}]


def _moved_by_pointers(model: Model) -> None:
    _moved_twice(model)
    for channel in model.json["animations"][0]["channels"]:
        extensions = {"KHR_animation_pointer": {"pointer": f"/nodes/{channel['target']['node']}/rotation"}}
        channel["target"] = {"path": "pointer", "extensions": extensions}


def _weighted_by_three(model: Model) -> None:
    """Animate the weight of one target by three values at two times."""
    times, output = (_added(model, np.arange(count)[:, None], "SCALAR", 5126) for count in (2, 3))
    _primitive(model)["targets"] = [{"POSITION": 0}]
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    sampler = {"input": times, "output": output}
    model.json["animations"] = [{"channels": [channel], "samplers": [sampler]}]


@cache
def _kept_bake() -> Model:
    return baked(_sheet())


def _bake() -> Model:
    """Return the baked sheet."""
    return _kept_bake().copied()


# Compressed streams


def _in_draco() -> Model:
    return edgebreaker_twin(_sheet())


def _extension(model: Model) -> JsonObject:
    found: JsonObject = _primitive(model)["extensions"][DRACO]
    return found


def _streams() -> Iterator[Case]:
    """Yield cases of Draco streams and views of meshopt."""
    plain = ("--compress", "none")
    yield _of("no such array", _changed(lambda m: _extension(m)["attributes"].update(NORMAL=77), _in_draco))
    yield _of("no view", _changed(lambda m: _extension(m).pop("bufferView"), _in_draco))
    bytes_of_three = _with_attribute("_X", np.ones((VERTICES, 3), "|u1"), "VEC3", 5121)
    for way in ("none", "meshopt"):
        yield _of("three bytes", edgebreaker_twin(bytes_of_three), "--compress", way)
        yield _of(
            "indices of bytes",
            _changed(lambda m: m.json["accessors"][4].update(componentType=5121), _in_draco),
            "--compress",
            way,
        )
    yield _of("signed bytes", _signed(edgebreaker_twin(bytes_of_three)), *plain)
    short = _changed(lambda m: m.json["accessors"][4].update(componentType=5122), _in_draco)
    yield _of("signed indices", _beside_a_skin(short), *plain)
    yield _of(
        "bound of one", _changed(lambda m: m.json["accessors"][0].update(min=[0], max=[1]), _in_draco), *plain
    )
    infinite = np.full((VERTICES, 1), np.inf, "<f4")
    with_bounds = _with_attribute("_X", infinite, "SCALAR", 5126, min=[0], max=[1])
    yield _of("no bound", edgebreaker_twin(with_bounds), *plain)
    beside = _beside_a_skin(_in_draco())
    _primitive(beside)["attributes"]["NORMAL"] = 999
    yield _of("a stream of no accessor", beside, *plain)
    yield _of("another version", _changed(_of_the_future, _in_draco))
    yield _of("two streams of one accessor", _changed(_streamed_twice, _in_draco), *plain)
    yield _of("a sparse accessor over a stream", _changed(_sparse, _in_draco), "--compress", "draco")
    yield from _baked_twice()
    yield from _packed_views()


def _of_the_future(model: Model) -> None:
    start = model.json["bufferViews"][_extension(model)["bufferView"]]["byteOffset"]
    model.binary[start + 5] = 9


def _streamed_twice(model: Model) -> None:
    """Add a primitive of the same accessors, with a stream of other positions."""
    other = edgebreaker_twin(_changed(_nudged))
    view = other.json["bufferViews"][_extension(other)["bufferView"]]
    start, length = view["byteOffset"], view["byteLength"]
    model.json["bufferViews"].append({"buffer": 0, "byteOffset": len(model.binary), "byteLength": length})
    model.binary += other.binary[start : start + length]
    model.json["buffers"][0]["byteLength"] = len(model.binary)
    extension = {**_extension(model), "bufferView": len(model.json["bufferViews"]) - 1}
    model.json["meshes"][0]["primitives"].append({**_primitive(model), "extensions": {DRACO: extension}})


def _nudged(model: Model) -> None:
    start = model.json["bufferViews"][model.json["accessors"][0]["bufferView"]]["byteOffset"]
    struct.pack_into("<f", model.binary, start, 0.5)


def _sparse(model: Model) -> None:
    """Replace the first position beside its stream."""
    at = _added(model, [[0]], "SCALAR", 5125), _added(model, [[0, 0, 0]], "VEC3", 5126)
    index, value = (model.json["accessors"][number]["bufferView"] for number in at)
    indices = {"bufferView": index, "componentType": 5125}
    model.json["accessors"][0]["sparse"] = {"count": 1, "indices": indices, "values": {"bufferView": value}}


def _beside_a_skin(model: Model) -> Model:
    """Return a model in Draco, drawn without a skin, beside the skinned sheet."""
    accessors, first = model.json["accessors"], len(model.json["accessors"])
    accessors += _sheet().json["accessors"]
    primitive = _primitive(_sheet())
    attributes = {name: first + number for name, number in primitive["attributes"].items()}
    plain = {"attributes": attributes, "indices": first + primitive["indices"]}
    model.json["nodes"][0].pop("skin")
    model.json["meshes"].append({"primitives": [plain]})
    model.json["nodes"].append({"mesh": 1, "skin": 0})
    return model


def _signed(model: Model) -> Model:
    """Return a model in Draco whose attribute of three bytes is of normalised signed ones."""
    view = model.json["bufferViews"][_extension(model)["bufferView"]]
    start = view["byteOffset"]
    at = model.binary.index(b"\x04\x02\x03\x00", start)  # generic, unsigned bytes, three, not normalised
    model.binary[at : at + 4] = b"\x04\x01\x03\x01"
    number = _primitive(model)["attributes"]["_X"]
    model.json["accessors"][number].update(componentType=5120, normalized=True)
    return model


def _baked_twice() -> Iterator[Case]:
    """Yield cases of bakes of one stream that two primitives share, and of one with a wrong note."""

    def shared(model: Model) -> None:
        first = _primitive(model)
        model.json["meshes"][0]["primitives"].append({**first, "material": 0})

    strip = ("strip", "in/m.glb", "-o", "out/m.glb")
    with_note = baked(_changed(shared, _in_draco))
    yield _of("shared stream", with_note, *strip)
    wrong = with_note.copied()
    before = _extension(wrong)["extras"]["skinbake"]["before"]["attributes"]
    name = next(name for name in before if name not in {"POSITION", "JOINTS_0", "WEIGHTS_0"})
    _primitive(wrong)["attributes"][name] = 9999
    yield _of("wrong note", wrong, *strip)


def baked(model: Model, *options: str) -> Model:
    """Return what a bake makes of a model."""
    with tempfile.TemporaryDirectory() as name:
        source, target = Path(name, "m.glb"), Path(name, "out.glb")
        source.write_bytes(model.packed(GLB)[1]["m.glb"])
        command = [sys.executable, "-m", "skinbake", "bake", str(source), "-o", str(target), "-q", *options]
        subprocess.run(command, check=True, capture_output=True)
        return read_model(target)


def _packed_views() -> Iterator[Case]:
    """Yield cases of meshopt's views: one too short for what it claims, one with bounds that are infinite."""
    count = 1 << 20
    claim = {
        "buffer": 0,
        "byteOffset": 0,
        "byteLength": 8,
        "byteStride": 4,
        "count": count,
        "mode": "ATTRIBUTES",
    }
    view = {"buffer": 0, "byteLength": 4 * count, "extensions": {"EXT_meshopt_compression": claim}}

    def short(model: Model) -> None:
        model.json["bufferViews"][1] = view

    yield _of("short view", _changed(short))
    longer = filtered_twin(_sheet(), "EXT")
    for view in longer.json["bufferViews"]:
        if "extensions" in view:
            view["extensions"]["EXT_meshopt_compression"]["count"] += 1
    yield _of("a view of one row more", longer)
    model = filtered_twin(_sheet(), "EXT")
    attributes = _primitive(model)["attributes"]
    number = attributes["POSITION"]
    attributes["POSITION"], attributes["_E"] = 0, number
    extension = model.json["bufferViews"][model.json["accessors"][number]["bufferView"]]["extensions"]
    stored = extension["EXT_meshopt_compression"]
    rows = np.full((stored["count"], 12), 0x7F, np.uint8)
    data = bytes(meshopt.encode_vertex_buffer_level(rows, 2, 0))
    stored.update(byteOffset=len(model.binary), byteLength=len(data))
    model.binary += data
    model.json["buffers"][0]["byteLength"] = len(model.binary)
    yield _of("infinite bounds", model, "--compress", "none")


# What lies beside a document


def _with_images(*uris: str) -> Model:
    return _changed(lambda m: m.json.update(images=[{"uri": uri} for uri in uris]))


def _beside() -> Iterator[Case]:
    """Yield cases of files that a document names."""
    picture = {"tex.png": PICTURE}
    digest = hashlib.sha256(PICTURE).hexdigest()[:16]

    def files(model: Model, folder: str = "") -> dict[str, bytes]:
        return {f"{folder}{name}": data for name, data in model.packed(GLTF)[1].items()}

    once, twice = _with_images("tex.png"), _with_images("tex.png", "./tex.png", "%74ex.png")
    yield _case("one picture by three names", {**files(twice), **picture}, TO_GLTF)
    taken = {"../out/tex.png": b"other", f"../out/tex-{digest}.png": b"another"}
    yield _case("both names taken", {**files(once), **picture, **taken}, TO_GLTF)
    deep = _with_images("a/b/tex.png")
    yield _case("two folders deep", {**files(deep), "a/b/tex.png": PICTURE}, TO_GLTF)
    above = files(_with_images("../tex.png"), "sub/")
    allowed = ("bake", "in/sub/m.gltf", "-o", "out/m.gltf", "--allow-outside", "in")
    yield _case("allowed, and not below", {**above, **picture}, allowed)
    data = _changed(lambda m: m.json["buffers"][0].update(uri="data:nothing"))
    yield _case("a data: URI without data", data.packed(GLTF)[1], TO_GLTF)
    yield _case("one buffer by two names", _changed(_by_two_names).packed(GLTF)[1], TO_GLTF)
    for about, change in (("read", _first_buffer), ("not read", _second_buffer)):
        model = _changed(change)
        yield _case(f"a buffer through a link, {about}", model.packed(GLTF)[1], TO_GLTF, {"link": "../other"})
    far = _changed(lambda m: m.json["buffers"].append({"byteLength": 8, "uri": "far.bin"}))
    outside = {**far.packed(GLB)[1], "far.bin": bytes(8)}
    yield _case("a far buffer for stdout", outside, ("bake", "in/m.glb", "-o", "-"))
    itself = _with_images("x.gltf").packed(GLTF)[1]
    yield _case("its own picture", {**itself, "x.gltf": b"{}"}, ("bake", "in/m.gltf", "-o", "in/x.gltf"))


def _textured(images: Sequence[JsonObject], texture: JsonObject | None = None) -> Model:
    """Return the sheet with a texture of its colours; None: a texture past the end."""

    def change(model: Model) -> None:
        model.json["images"] = list(images)
        model.json["textures"] = [] if texture is None else [texture]
        model.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        _primitive(model)["material"] = 0
        places = np.zeros((VERTICES, 2), np.float32)
        _primitive(model)["attributes"]["TEXCOORD_0"] = _added(model, places, "VEC2", 5126)

    return _changed(change)


def _pictures() -> Iterator[Case]:
    """Yield cases of images that are drawn, packed, or named in a depfile."""
    drawn, render = {"source": 0}, ("render", "in/m.glb", "-o", "out/m.png", "--size", "16x16")
    picture, within = {"uri": "tex.png"}, {"bufferView": 0, "mimeType": "image/png"}
    webp, inner = "EXT_texture_webp", f"data:image/png;base64,{base64.b64encode(PICTURE).decode()}"
    textures: list[tuple[str, JsonObject, JsonObject | None]] = [
        ("no such texture", picture, None),
        ("a file", picture, drawn),
        ("WebP", picture, {"extensions": {webp: drawn}}),
        ("WebP without an image", picture, {**drawn, "extensions": {webp: {}}}),
        ("KTX2 alone", picture, {"extensions": {"KHR_texture_basisu": drawn}}),
        ("no image", picture, {}),
        ("a view", within, drawn),
        ("a data: URI", {"uri": inner}, drawn),
        ("neither", {}, drawn),
    ]
    for about, image, texture in textures:
        yield _case(f"texture: {about}", {**_files(_textured([image], texture)), "tex.png": PICTURE}, render)
    yield from _packed_pictures(inner)
    names = _files(_with_images("tex.png", "gone.png", "../up.png"))
    depfile = ("-o", "out/m.glb", "--depfile", "out/m.d")
    for about, more in (("depfile", ()), ("depfile, packed", ("--pack",))):
        yield _case(about, {**names, "tex.png": PICTURE}, ("bake", "in/m.glb", *depfile, *more))
    own = {"../out/own.glb": names["m.glb"], "../out/tex.png": PICTURE}
    yield _case("depfile, same folder", own, ("bake", "out/own.glb", *depfile))
    above = {"sub/m.glb": _files(_with_images("../tex.png"))["m.glb"], "tex.png": PICTURE}
    yield _case("depfile, allowed", above, ("bake", "in/sub/m.glb", *depfile, "--allow-outside", "in"))


def _packed_pictures(inner: str) -> Iterator[Case]:
    """Yield cases of ``--pack``."""
    pack = (*TO_GLB, "--pack")
    contents = {"tex.png": PICTURE, "w": b"RIFF\0\0\0\0WEBPVP8 ", "none": b"", "odd": b"what is it?"}
    images = _with_images(
        "tex.png", "tex.png", "w", "none", "odd", "gone.png", "../up.png", "/up.png", inner, "data:x"
    )
    for about, arguments in {
        "elsewhere": pack,
        "in place": ("bake", "in/m.glb", "--in-place", "--pack"),
        "on stdout": ("bake", "in/m.glb", "-o", "-", "--pack"),
        "as glTF": ("bake", "in/m.glb", "-o", "out/m.gltf", "--pack"),
    }.items():
        yield _case(f"packed {about}", {**_files(images), **contents}, arguments)
    yield _case("nothing to pack", _files(_sheet()), pack)
    to_glb = ("bake", "in/m.gltf", "-o", "out/m.glb", "--pack")
    yield _case("packed meshopt", filtered_twin(_sheet(), "EXT").packed(GLTF)[1], to_glb)
    lost = _changed(lambda m: m.json["bufferViews"].append({"buffer": 7, "byteLength": 1}))
    yield _case("a view of no buffer", lost.packed(WRAPPED)[1], pack)
    folder = {"../out/m.glb/x": b"kept"}
    yield _case(
        "a folder in its place", {**_files(_sheet()), **folder}, ("bake", "in/m.glb", "--out-dir", "out")
    )
    yield _case("one byte", _files(_sheet()), (*TO_GLB, "--max-memory", "1"))


def _files(model: Model) -> dict[str, bytes]:
    return model.packed(GLB)[1]


def _first_buffer(model: Model) -> None:
    model.json["buffers"][0]["uri"] = "link/secret.bin"


def _by_two_names(model: Model) -> None:
    model.json["buffers"].append({**model.json["buffers"][0], "uri": "%6d.bin"})
    model.json["bufferViews"][0]["buffer"] = 1


def _second_buffer(model: Model) -> None:
    model.json["buffers"].append({"byteLength": 8, "uri": "link/secret.bin"})
    model.json["skins"] = []
    model.json["nodes"][0].pop("skin")


def _containers() -> Iterator[Case]:
    """Yield cases of containers and texts that end too early or too late."""
    data = bytearray(glb(b'{"asset":{"version":"2.0"}}', b"") + bytes(4))
    struct.pack_into("<I", data, 8, len(data))
    yield _case("half a chunk header", {"m.glb": bytes(data)})
    deep = b'{"asset":{"version":"2.0"},"extras":' + b"[" * 1100 + b"]" * 1100 + b"}"
    yield _case("a deep text", {"m.gltf": deep}, TO_GLTF)
    chunked = bytearray(_sheet().packed(GLB)[1]["m.glb"] + struct.pack("<II4s", 4, 0x12345678, b"more"))
    struct.pack_into("<I", chunked, 8, len(chunked))
    for target in ("out/m.glb", "out/m.gltf"):
        yield _case("another chunk", {"m.glb": bytes(chunked)}, ("bake", "in/m.glb", "-o", target))
    yield _case("another suffix", {"m.txt": deep}, ("inspect", "in/m.txt"))


def _places() -> Iterator[Case]:
    """Yield cases of inputs and outputs at odd places."""
    model = {"m.glb": _sheet().packed(GLB)[1]["m.glb"]}
    tree = ("bake", "in", "--out-dir", "out")
    yield _case("a folder at the target", {**model, "../out/m.glb/x": b""}, TO_GLB)
    yield _case("a link to a model outside", {}, tree, {"l.glb": "../other/secret.bin"})
    yield _case("a link to nothing", {}, tree, {"l.glb": "gone.glb"})
    below = {"sub/m.glb": model["m.glb"]}
    yield _case("an output folder elsewhere", below, tree, {"../out/sub": "../in"})
    kept = {"../out/.skinbake-00000000_1_1_000000000000.tmp": b""}
    yield _case("a temporary file of another system", {**model, **kept})
