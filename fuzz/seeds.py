"""The models that are damaged: the repository's fixtures, the corpus where it is, shrunk, and their bakes.

Runs cost what a model's vertices cost, and a defect needs few of them: each model is cut down to its first
vertices, the triangles among them, and a few key frames.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fuzz.directed import directed_seeds
from fuzz.models import COMPONENT_COUNTS, GLB, JsonObject, Model, read_model, span
from tests.support.corpus_folder import REPOSITORY, find_corpus

MOST_BYTES = 20_000
VERTICES, FRAMES = 24, 3

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

BAKES: tuple[tuple[str, ...], ...] = (
    (),
    ("--encoding", "packed8"),
    ("--encoding", "snorm16", "--layout", "custom"),
    ("--layout", "texcoord"),
    ("--limit-influences", "4", "--weld", "skin"),
    ("--compress", "draco"),
    ("--compress", "draco", "--position-bits", "11", "--normal-bits", "8", "--encoding", "packed8"),
    ("--compress", "meshopt"),
    ("--compress", "meshopt", "--layout", "texcoord"),
    ("--frame", "normal", "--generate-normals"),
)
"""The ways in which models are baked for the corpus: what they store differs."""


def plain_seeds() -> list[Model]:
    """Return the models that nothing was baked into, small ones as they are."""
    models = [_small(read_model(path)) for path in sorted((REPOSITORY / "fixtures").glob("*.gl[bt]*"))]
    models += [
        read_model(path)
        for path in sorted((REPOSITORY / "fixtures").glob("*.gl[bt]*"))
        if path.stat().st_size < MOST_BYTES
    ]
    corpus = find_corpus()
    for path in [] if corpus is None else sorted(corpus.rglob("*")):
        if path.suffix in {".glb", ".gltf", ".vrm"} and not {"invalid", "hostile"} & set(path.parts):
            found = _read_small(path)
            models += [] if found is None else [found]
    return _distinct([*models, *made_seeds(models)])


def all_seeds(cache: Path | None = None) -> list[Model]:
    """Return plain models and their bakes; where ``cache`` is given they are kept there, and read from it."""
    if cache is not None and (cache / "done").is_file():
        return _weighted([_loaded(path) for path in sorted(cache.glob("*.model"))])
    plain = plain_seeds()
    baked = list(_baked(plain))
    models = _distinct([*plain, *baked])
    if cache is not None:
        cache.mkdir(parents=True, exist_ok=True)
        for number, model in enumerate(models):
            head = json.dumps({"name": model.name, "json": model.json}).encode()
            (cache / f"{number:04}.model").write_bytes(
                len(head).to_bytes(8, "little") + head + bytes(model.binary)
            )
        (cache / "done").touch()
    return _weighted(models)


def _weighted(models: list[Model]) -> list[Model]:
    """Return the models, those with what few have three times: cases take each entry equally often."""
    rare = (b'"targets"', b"compression", b'"sparse"', b"CUBICSPLINE", b"TANGENT", b"JOINTS_1")
    return [model for model in models for _ in range(3 if any(word in model.text() for word in rare) else 1)]


def _loaded(path: Path) -> Model:
    data = path.read_bytes()
    end = 8 + int.from_bytes(data[:8], "little")
    head = json.loads(data[8:end])
    return Model(head["name"], head["json"], bytearray(data[end:]))


def _distinct(models: list[Model]) -> list[Model]:
    found: dict[bytes, Model] = {}
    for model in models:
        found.setdefault(model.text() + bytes(model.binary), model)
    return list(found.values())


def _read_small(path: Path) -> Model | None:
    """Return a model of the corpus cut down, None where it is damaged or stays large."""
    try:
        model = _small(read_model(path))
    except (ValueError, KeyError, IndexError, TypeError, OSError, ArithmeticError):
        return None
    return model if len(model.text()) + len(model.binary) <= MOST_BYTES else None


# Cutting down


def _small(model: Model) -> Model:
    """Return the model with its first vertices and frames, each accessor in a view of its own."""
    if _is_compressed(model) or len(model.json.get("buffers", [])) != 1:
        return model
    kept = {
        key: value
        for key, value in model.json.items()
        if key not in {"images", "textures", "samplers", "materials"}
    }
    small = Model(f"small-{model.name}", json.loads(json.dumps(kept)), bytearray())
    accessors = small.json.get("accessors", [])
    counts = [accessor["count"] for accessor in accessors]
    chosen: dict[int, npt.NDArray[Any]] = {}
    corners: dict[int, npt.NDArray[Any]] = {}
    for mesh in small.json.get("meshes", []):
        for primitive in mesh["primitives"]:
            primitive.pop("material", None)
            _choose(model, primitive, chosen, corners)
    for animation in small.json.get("animations", []):
        animation["channels"] = animation["channels"][:6]
        for sampler in animation["samplers"]:
            times = accessors[sampler["input"]]["count"]
            counts[sampler["input"]] = min(times, FRAMES)
            counts[sampler["output"]] = accessors[sampler["output"]]["count"] // times * min(times, FRAMES)
    views: list[JsonObject] = []
    for number, accessor in enumerate(accessors):
        rows = _rows(model, model.json["accessors"][number])
        if rows is None:
            accessor["count"] = len(chosen[number]) if number in chosen else counts[number]
            continue
        rows = corners[number] if number in corners else rows[chosen.get(number, slice(counts[number]))]
        accessor.update(count=len(rows), bufferView=len(views))
        accessor.pop("byteOffset", None)
        _bounded(accessor, rows)
        _append(small, views, rows.tobytes())
    small.json["bufferViews"] = views
    small.json["buffers"] = [{"byteLength": max(len(small.binary), 1)}]
    return small


def _is_compressed(model: Model) -> bool:
    text = model.text()
    return b"compression" in text or b'"sparse"' in text


def _vertex_accessors(primitive: JsonObject) -> Iterator[int]:
    yield from primitive["attributes"].values()
    for target in primitive.get("targets", []):
        yield from target.values()


def _rows(model: Model, accessor: JsonObject) -> npt.NDArray[Any] | None:
    """Return an accessor's elements (count, components), None where it has no data."""
    found = span(model, accessor)
    if found is None:
        return None
    start, stride, count = found
    dtype, columns = np.dtype(DTYPES[accessor["componentType"]]), COMPONENT_COUNTS[accessor["type"]]
    return np.ndarray((count, columns), dtype, bytes(model.binary), start, (stride, dtype.itemsize)).copy()


def _choose(
    model: Model,
    primitive: JsonObject,
    chosen: dict[int, npt.NDArray[Any]],
    corners: dict[int, npt.NDArray[Any]],
) -> None:
    """Note which vertices of a primitive's accessors stay, and the indices of the triangles among them."""
    accessors = list(_vertex_accessors(primitive))
    number = primitive.get("indices")
    indices = _rows(model, model.json["accessors"][number]) if number is not None else None
    count = model.json["accessors"][accessors[0]]["count"]
    order = np.arange(count) if indices is None else indices.ravel()
    _, first = np.unique(order, return_index=True)
    vertices = np.sort(order[np.sort(first)[:VERTICES]])
    vertices = next((chosen[each] for each in accessors if each in chosen), vertices)
    chosen.update(dict.fromkeys(accessors, vertices))
    if indices is not None and number is not None:
        place = np.full(max(count, int(indices.max()) + 1), -1)
        place[vertices] = np.arange(len(vertices))
        triangles = place[indices.ravel()[: len(indices) // 3 * 3].reshape(-1, 3)]
        inside = triangles[(triangles >= 0).all(axis=1)]
        inside = inside if len(inside) else np.zeros((1, 3))
        corners[number] = inside.reshape(-1, 1).astype(indices.dtype)


def _bounded(accessor: JsonObject, rows: npt.NDArray[Any]) -> None:
    if "min" in accessor:
        accessor["min"], accessor["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()


def _append(model: Model, views: list[JsonObject], data: bytes) -> None:
    model.binary += bytes(-len(model.binary) % 4)
    views.append({"buffer": 0, "byteOffset": len(model.binary), "byteLength": len(data)})
    model.binary += data


# Made by hand: what neither fixtures nor bakes have


def made_seeds(models: list[Model]) -> list[Model]:
    """Return models with filters of meshopt, an edgebreaker stream, strips, fans, splines and steps."""
    named = {model.name: model for model in models}
    plain, morphed = named["small-bent_tube.glb"], named["small-morphed_sheet.glb"]
    edgebreaker = edgebreaker_twin(plain)
    made = [
        filtered_twin(plain, "EXT"),
        filtered_twin(plain, "KHR"),
        edgebreaker,
        _strips(plain),
        _cubic(plain),
    ]
    return [*made, *directed_seeds(plain, morphed, edgebreaker)]


def filtered_twin(model: Model, prefix: str) -> Model:
    """Return the model with views under each of meshopt's filters: any bytes decode to something."""
    import meshopt

    made = model.copied()
    made.name = f"{prefix}-filters"
    extension = f"{prefix}_meshopt_compression"
    made.json["extensionsUsed"] = made.json["extensionsRequired"] = [extension, "KHR_mesh_quantization"]
    primitive = made.json["meshes"][0]["primitives"][0]
    count = made.json["accessors"][primitive["attributes"]["POSITION"]]["count"]
    values = np.random.default_rng(1)
    length = 0
    for name, kind, component, stride, chosen in (
        ("NORMAL", "VEC3", 5120, 4, "OCTAHEDRAL"),
        ("TANGENT", "VEC4", 5122, 8, "OCTAHEDRAL"),
        ("_TURN", "VEC4", 5122, 8, "QUATERNION"),
        ("POSITION", "VEC3", 5126, 12, "EXPONENTIAL"),
        *([("COLOR_0", "VEC4", 5121, 4, "COLOR")] if prefix == "KHR" else []),
    ):
        rows = values.integers(0, 60, (count, stride), dtype=np.uint8)
        if chosen == "OCTAHEDRAL":
            rows.view("<i1" if stride == 4 else "<i2")[:, 2] = 127 if stride == 4 else 32767
        elif chosen == "EXPONENTIAL":
            rows.view("<i4")[:] = values.integers(-9000, 9000, (count, 3)) & 0xFFFFFF | (0xF4 << 24)
        data = bytes(meshopt.encode_vertex_buffer_level(rows, 2, int(prefix == "KHR")))
        _append(made, views := made.json["bufferViews"], data)
        stored = {**views[-1], "byteStride": stride, "count": count, "mode": "ATTRIBUTES", "filter": chosen}
        views[-1] = {
            "buffer": 1, "byteOffset": length, "byteLength": stride * count, "byteStride": stride,
            "extensions": {extension: stored},
        }  # fmt: skip
        length += stride * count
        made.json["accessors"].append(
            {"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": count}
            | ({"normalized": True} if component != 5126 else {"min": [-9.0] * 3, "max": [9.0] * 3})
        )
        primitive["attributes"][name] = len(made.json["accessors"]) - 1
    made.json["buffers"] = [
        {"byteLength": len(made.binary)},
        {"byteLength": length, "extensions": {extension: {"fallback": True}}},
    ]
    return made


def edgebreaker_twin(model: Model) -> Model:
    """Return the model with its first primitive in a stream of Draco's other method."""
    import DracoPy

    made = model.copied()
    made.name = "edgebreaker"
    primitive = made.json["meshes"][0]["primitives"][0]
    arrays = {
        name: _rows(model, model.json["accessors"][number])
        for name, number in primitive["attributes"].items()
    }
    generic = [name for name in arrays if name != "POSITION"]
    indices = _rows(model, model.json["accessors"][primitive["indices"]])
    if indices is None:
        raise ValueError(f"{model.name}: the indices have no data")
    stream = DracoPy.encode(
        arrays["POSITION"],
        indices.reshape(-1, 3).astype(np.uint32),
        quantization_bits=12,
        generic_attributes={number: arrays[name] for number, name in enumerate(generic)},
    )
    decoded = DracoPy.decode(stream)
    names = dict(enumerate(generic))
    inside = {names.get(entry["unique_id"], "POSITION"): entry["unique_id"] for entry in decoded.attributes}
    for number in primitive["attributes"].values():
        made.json["accessors"][number] = {**made.json["accessors"][number], "count": len(decoded.points)}
        made.json["accessors"][number].pop("bufferView")
    made.json["accessors"][primitive["indices"]].update(count=3 * len(decoded.faces), componentType=5125)
    made.json["accessors"][primitive["indices"]].pop("bufferView")
    _append(made, made.json["bufferViews"], bytes(stream))
    made.json["buffers"][0]["byteLength"] = len(made.binary)
    extension = {"bufferView": len(made.json["bufferViews"]) - 1, "attributes": inside}
    primitive["extensions"] = {"KHR_draco_mesh_compression": extension}
    made.json["extensionsUsed"] = made.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return made


def _strips(model: Model) -> Model:
    """Return the model as a fan, a strip and triangles without indices, one more primitive each."""
    made = model.copied()
    made.name = "strips"
    mesh = made.json["meshes"][0]
    first = mesh["primitives"][0]
    for mode in (5, 6, 4):
        mesh["primitives"].append(
            {key: value for key, value in first.items() if key != "indices"} | {"mode": mode}
        )
    return made


def _cubic(model: Model) -> Model:
    """Return the model with splines, steps, and all that an animation can move."""
    made = model.copied()
    made.name = "cubic"
    animation = made.json["animations"][0]
    times = animation["samplers"][0]["input"]
    count = made.json["accessors"][times]["count"]
    paths = {"translation": ("VEC3", 3), "scale": ("VEC3", 3), "rotation": ("VEC4", 4)}
    for number, (path, (kind, width)) in enumerate(paths.items()):
        values = np.ones((3 * count, width), "<f4") * np.float32(0.5)
        _append(made, made.json["bufferViews"], values.tobytes())
        made.json["accessors"].append(
            {
                "bufferView": len(made.json["bufferViews"]) - 1,
                "componentType": 5126,
                "type": kind,
                "count": 3 * count,
            }
        )
        animation["samplers"].append(
            {"input": times, "output": len(made.json["accessors"]) - 1, "interpolation": "CUBICSPLINE"}
        )
        animation["channels"].append(
            {"sampler": len(animation["samplers"]) - 1, "target": {"node": 1 + number, "path": path}}
        )
    animation["samplers"][0]["interpolation"] = "STEP"
    made.json["buffers"][0]["byteLength"] = len(made.binary)
    return made


# Bakes


def _baked(models: list[Model]) -> Iterator[Model]:
    """Yield models as bake stores them, a few ways each, all by one process for each way."""
    always = {"small-two_sets.glb", "edgebreaker"}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for number, options in enumerate(BAKES):
            source, target = root / f"in{number}", root / f"out{number}"
            source.mkdir()
            # Draco's search for a grid and the measuring of encodings cost half a second a model.
            every = 12 if {"draco", "--encoding", "--limit-influences"} & set(options) else 5
            for at, model in enumerate(models):
                if (
                    (at + number) % every == 0
                    or model.name in always
                    or (not options and "directed" in model.name)
                ):
                    _, files = model.packed(GLB, f"{at:03}-{model.name.partition('.')[0]}-{number}")
                    for name, data in files.items():
                        (source / name).write_bytes(data)
            command = [
                sys.executable,
                "-m",
                "skinbake",
                "bake",
                str(source),
                "--out-dir",
                str(target),
                "-q",
                *options,
            ]
            subprocess.run(command, check=False, capture_output=True)  # those that cannot be baked stay out
            for path in sorted(target.glob("*.glb")):
                model = read_model(path)
                if len(model.binary) <= 2 * MOST_BYTES:
                    yield model
