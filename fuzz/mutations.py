"""Damage to a model: to the structure of its JSON, to its bytes, and to its container."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from random import Random
from typing import Any

from fuzz.models import JsonObject, Model, element_size, span
from fuzz.uris import uri

FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-39, 5e-45, 1e-20, 1e20, 3e38, -3e38, 0.5, 1e-6, float("nan"), float("inf"))
INTEGERS = (
    0,
    1,
    -1,
    2,
    3,
    4,
    127,
    255,
    256,
    65535,
    65536,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**32,
    2**53,
    2**63,
    2**64,
)
COMPONENTS = (5120, 5121, 5122, 5123, 5124, 5125, 5126, 5130)
TYPES = ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4", "vec3", "")
NAMES = (
    "POSITION", "NORMAL", "TANGENT", "JOINTS_0", "WEIGHTS_0", "JOINTS_1", "WEIGHTS_1", "JOINTS_2",
    "WEIGHTS_2", "TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_9", "COLOR_0", "_CUSTOM0", "_CUSTOM1",
    "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0", "JOINTS_01", "JOINTS_-1", "JOINTS_99999999999", "WEIGHTS_x",
    "_\x1b[31m", "",
)  # fmt: skip
KEYS = (
    "accessors", "animations", "asset", "buffers", "bufferViews", "cameras", "images", "materials",
    "meshes", "nodes", "samplers", "scene", "scenes", "skins", "textures", "extras", "extensions",
    "extensionsUsed", "extensionsRequired", "uri", "byteLength", "byteOffset", "byteStride", "bufferView",
    "componentType", "count", "type", "normalized", "sparse", "indices", "values", "min", "max",
    "primitives", "attributes", "mode", "targets", "weights", "joints", "skeleton", "inverseBindMatrices",
    "mesh", "skin", "children", "matrix", "translation", "rotation", "scale", "channels", "sampler",
    "target", "node", "path", "input", "output", "interpolation", "skinbake", "version", "minVersion",
    "name", "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression",
    "KHR_mesh_quantization", "filter", "fallback", "before",
)  # fmt: skip
TEXTS = (
    "", "POSITION", "\0", "\x1b[2J\x1b[31m", "\u202egnp", "\ud800", "a\nb: error: c", "2.0", "2.1", "1.0",
    "3", "x" * 5000, "STEP", "LINEAR", "CUBICSPLINE", "rotation", "translation", "scale", "weights",
    "pointer", "tangent", "normal", "packed8", "snorm16", "float32", "texcoord", "custom", "ATTRIBUTES",
    "TRIANGLES", "INDICES", "NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR", "VEC3", "true",
    "../secret.bin", "{set}",
)  # fmt: skip


def mutate(model: Model, random: Random) -> list[str]:
    """Damage a model in place in a few ways, and return their names; now and then in none."""
    count = random.choice((0, 1, 1, 1, 1, 2, 2, 3, 6))
    done = []
    for _ in range(count):
        mutation = random.choices(MUTATIONS, WEIGHTS)[0]
        # What an earlier one has damaged, a later one may not find its way in: then it does nothing more.
        with suppress(ArithmeticError, AttributeError, LookupError, TypeError, ValueError, struct.error):
            mutation(model, random)
        done.append(mutation.__name__.lstrip("_"))
    return done


# Values


def _number(random: Random, old: Any) -> Any:
    kind = random.randrange(8)
    if kind < 3 and isinstance(old, int | float):
        return old + random.choice((-1, 1, -2, 4, 0.5))
    if kind == 3 and isinstance(old, int | float) and not isinstance(old, bool):
        return float(old) if isinstance(old, int) else -old
    return random.choice(INTEGERS) if kind < 6 else random.choice(FLOATS[:-2])


def _junk(model: Model, random: Random, old: Any) -> Any:
    """Return a value of some other kind than the old one."""
    kind = random.randrange(12)
    if kind < 4:
        return _number(random, old)
    if kind == 4:
        return random.choice(TEXTS)
    if kind == 5:
        return random.choice((None, True, False))
    if kind == 6:
        return random.choice(
            ([], {}, [None], {"x": 1}, [0], [[]], [{}], [0, 1, 2], {"skinbake": {"version": 1}})
        )
    if kind == 7:
        return [old]
    if kind == 8:
        return {"x": old} if random.random() < 0.5 else str(old)[:200]
    if kind == 9:
        return _raw(model, random)
    if kind == 10:
        return _deep(random)
    return uri(random)


def _raw(model: Model, random: Random) -> str:
    """Return a mark for a piece of text that json.dumps would not write."""
    piece = random.choice(
        (
            "1e999",
            "-1e999",
            "NaN",
            "Infinity",
            "1" * 5000,
            "1e-999",
            "-0",
            "1.0e0",
            '"\\ud800"',
            '"\\u0000"',
            "[]]",
        )
    )
    mark = f"@raw{len(model.raw)}@"
    model.raw[mark] = piece
    return mark


def _deep(random: Random) -> Any:
    value: Any = 0
    for _ in range(random.choice((10, 60, 200, 600))):
        value = [value] if random.random() < 0.5 else {"a": value}
    return value


# The structure of the JSON


def _spot(model: Model, random: Random) -> tuple[Any, Any]:
    """Return a container somewhere in the JSON and a key of it."""
    container: Any = model.json
    key: Any = None
    while True:
        keys = list(container) if isinstance(container, dict) else range(len(container))
        if not keys:
            return (container, key) if key is not None else (model.json, "asset")
        key = random.choice(keys)
        inner = container[key]
        if not isinstance(inner, dict | list) or not inner or random.random() < 0.15:
            return container, key
        container = inner


def _value(model: Model, random: Random) -> None:
    container, key = _spot(model, random)
    if _has(container, key):
        container[key] = _junk(model, random, container[key])


def _delete(model: Model, random: Random) -> None:
    container, key = _spot(model, random)
    if _has(container, key):
        del container[key]


def _insert(model: Model, random: Random) -> None:
    container, key = _spot(model, random)
    if isinstance(container, dict):
        container[random.choice(KEYS)] = _junk(model, random, key)
    elif container:
        number = random.randrange(len(container))
        container.insert(number, container[random.randrange(len(container))])


def _move(model: Model, random: Random) -> None:
    """Put what stands in one place into another too."""
    (one, first), (other, second) = _spot(model, random), _spot(model, random)
    if not _has(one, first) or not _has(other, second):
        return
    before = (one[first], other[second])
    other[second] = before[0]
    if random.random() < 0.5:
        one[first] = before[1]
    if _is_cyclic(model.json):
        one[first], other[second] = before


def _is_cyclic(root: Any) -> bool:
    open_: set[int] = set()

    def visit(value: Any) -> bool:
        if not isinstance(value, dict | list):
            return False
        if id(value) in open_:
            return True
        open_.add(id(value))
        found = any(map(visit, value.values() if isinstance(value, dict) else value))
        open_.discard(id(value))
        return found

    try:
        return visit(root)
    except RecursionError:
        return True


def _has(container: Any, key: Any) -> bool:
    return key in container if isinstance(container, dict) else isinstance(key, int) and key < len(container)


# What glTF means by it


def _objects(parent: Any, key: str) -> list[JsonObject]:
    found = parent.get(key) if isinstance(parent, dict) else None
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def _primitives(model: Model) -> Iterator[JsonObject]:
    for mesh in _objects(model.json, "meshes"):
        yield from _objects(mesh, "primitives")


def _used(model: Model, random: Random) -> JsonObject:
    """Return an accessor, mostly one that a primitive names; an empty object where there is none."""
    accessors = _objects(model.json, "accessors")
    primitives = list(_primitives(model))
    if primitives and random.random() < 0.7:
        primitive = random.choice(primitives)
        attributes = primitive.get("attributes")
        numbers = [*(attributes.values() if isinstance(attributes, dict) else ()), primitive.get("indices")]
        numbers = [number for number in numbers if type(number) is int and 0 <= number < len(accessors)]
        if numbers:
            number: int = random.choice(numbers)
            return accessors[number]
    return random.choice(accessors) if accessors else {}


def _accessor(model: Model, random: Random) -> None:
    """Change how an accessor says its data are stored."""
    accessor = _used(model, random)
    key = random.choice(
        ("componentType", "type", "count", "byteOffset", "bufferView", "normalized", "sparse", "gone")
    )
    if key == "gone":
        accessor.pop("bufferView", None)
        if random.random() < 0.5:
            accessor["count"] = random.choice((1, 24, 10**5, 2**20, 2**20 + 1, 2**40))
    elif key == "componentType":
        accessor[key] = random.choice(COMPONENTS)
    elif key == "type":
        accessor[key] = random.choice(TYPES)
    elif key == "normalized":
        accessor[key] = not accessor.get(key)
    elif key == "sparse":
        accessor[key] = _sparse(model, random, accessor)
    else:
        accessor[key] = _number(random, accessor.get(key, 0))


def _sparse(model: Model, random: Random, accessor: JsonObject) -> JsonObject:
    """Return a sparse substitution, its indices and values put at the end of the binary."""
    views = model.json.setdefault("bufferViews", [])
    count = random.choice((1, 2, 3))
    size = max(element_size(accessor), 1)
    kind, code = random.choice(((5121, "B"), (5123, "H"), (5125, "I"), (5126, "f")))
    limit = random.choice((3, 3, 8, 200))
    numbers = (
        sorted(random.sample(range(limit), count))
        if random.random() < 0.9
        else [random.randrange(limit)] * count
    )
    pieces = (struct.pack(f"<{count}{code}", *numbers), random.randbytes(size * count))
    made = []
    for piece in pieces:
        start = len(model.binary) + -len(model.binary) % 4
        model.binary += bytes(start - len(model.binary)) + piece
        if isinstance(views, list):
            views.append({"buffer": 0, "byteOffset": start, "byteLength": len(piece)})
        made.append(len(views) - 1 if isinstance(views, list) else 0)
    _lengthen(model)
    return {
        "count": count,
        "indices": {"bufferView": made[0], "componentType": kind},
        "values": {"bufferView": made[1]},
    }


def _lengthen(model: Model) -> None:
    buffers = _objects(model.json, "buffers")
    if buffers:
        buffers[0]["byteLength"] = len(model.binary)


def _attribute(model: Model, random: Random) -> None:
    """Rename, share, add or drop an attribute, or change how a primitive is drawn."""
    primitives = list(_primitives(model))
    if not primitives:
        return
    primitive = random.choice(primitives)
    attributes = primitive.get("attributes")
    kind = random.randrange(7)
    count = len(_objects(model.json, "accessors"))
    if kind == 0:
        primitive["mode"] = random.choice((0, 1, 2, 3, 4, 4, 5, 6, 7, -1, 4.0, "4"))
    elif kind == 1:
        primitive.pop("indices", None)
    elif kind == 2:
        primitive["indices"] = random.randrange(-1, count + 1)
    elif isinstance(attributes, dict) and attributes:
        name = random.choice(list(attributes))
        if kind == 3:
            attributes[random.choice(NAMES)] = attributes.pop(name)
        elif kind == 4:
            attributes[random.choice(NAMES)] = random.randrange(-1, count + 1)
        elif kind == 5:
            attributes[name] = random.choice(list(attributes.values()))
        else:
            del attributes[name]


def _view(model: Model, random: Random) -> None:
    """Shift, cut or stride a buffer view."""
    views = _objects(model.json, "bufferViews")
    if views:
        view = random.choice(views)
        key = random.choice(("byteOffset", "byteLength", "byteStride", "buffer", "target"))
        view[key] = (
            random.choice((1, 2, 3, 4, 6, 12, 16, 252, 255))
            if key == "byteStride"
            else _number(random, view.get(key, 0))
        )


def _skin(model: Model, random: Random) -> None:
    """Change joints, the matrices of a skin, or the tree of nodes."""
    nodes, skins = _objects(model.json, "nodes"), _objects(model.json, "skins")
    kind = random.randrange(5)
    if kind < 2 and skins:
        skin = random.choice(skins)
        joints = skin.get("joints")
        if kind == 0 and isinstance(joints, list) and joints:
            action = random.choice((joints.clear, joints.pop, joints.reverse, lambda: joints.extend(joints)))
            action()
        else:
            key = random.choice(("inverseBindMatrices", "skeleton", "joints"))
            skin[key] = random.randrange(-1, 30)
    elif nodes:
        node = random.choice(nodes)
        numbers = random.choice((FLOATS[:-2], (1e20, -1e20), (0.0,), (3e38,)))
        key, length = random.choice(
            (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3), ("children", 2))
        )
        if key == "children":
            node[key] = [random.randrange(len(nodes)) for _ in range(length)]
        else:
            node[key] = [random.choice(numbers) for _ in range(length + (random.random() < 0.1))]


def _animation(model: Model, random: Random) -> None:
    """Change what an animation moves, and how."""
    animations = _objects(model.json, "animations")
    if not animations:
        return
    animation = random.choice(animations)
    samplers, channels = _objects(animation, "samplers"), _objects(animation, "channels")
    if random.random() < 0.3:
        holder = random.choice(
            [*samplers, *channels, *(channel.get("target") for channel in channels)] or [{}]
        )
        if isinstance(holder, dict) and holder:
            holder.pop(random.choice(list(holder)))
    elif samplers and random.random() < 0.5:
        sampler = random.choice(samplers)
        key = random.choice(("interpolation", "input", "output"))
        sampler[key] = (
            random.choice(("STEP", "LINEAR", "CUBICSPLINE"))
            if key == "interpolation"
            else random.randrange(20)
        )
    elif channels:
        channel = random.choice(channels)
        channel["target"] = {
            "node": random.randrange(12),
            "path": random.choice(("rotation", "translation", "scale", "weights", "pointer", 3)),
        }
        channel["sampler"] = random.randrange(max(len(samplers), 1) + 1)


def _morph(model: Model, random: Random) -> None:
    """Change morph targets, or the weights of a mesh or node."""
    primitives, count = list(_primitives(model)), len(_objects(model.json, "accessors"))
    holders = [*_objects(model.json, "meshes"), *_objects(model.json, "nodes")]
    if primitives and random.random() < 0.6:
        primitive = random.choice(primitives)
        targets = _objects(primitive, "targets")
        name = random.choice(("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0"))
        if targets and random.random() < 0.8:
            random.choice(targets)[name] = random.choice((None, "0", *range(-1, count + 1)))
        else:
            primitive["targets"] = random.choice(([], [{}], [{name: random.randrange(count + 1)}] * 2, {}))
    elif holders:
        random.choice(holders)["weights"] = random.choice(
            ([], [0.5], [0.5] * 2, ["x"], [None, 1], 1, [1e300] * 2)
        )


def _packing(model: Model, random: Random) -> None:
    """Change what an extension says of a compressed stream."""
    extensions = [
        extension
        for holder in [
            *_objects(model.json, "bufferViews"),
            *_primitives(model),
            *_objects(model.json, "buffers"),
        ]
        if isinstance(found := holder.get("extensions"), dict)
        for extension in found.values()
        if isinstance(extension, dict)
    ]
    if not extensions:
        _accessor(model, random)
        return
    extension = random.choice(extensions)
    key = random.choice([*extension, "filter", "mode"])
    inside = extension.get("attributes")
    if isinstance(inside, dict) and inside and random.random() < 0.6:
        name = random.choice(list(inside))
        if random.random() < 0.4:
            del inside[name]
        else:
            inside[random.choice((name, *NAMES))] = random.choice((0, 1, 2, 3, 9, -1, None, 1.0))
    elif key in {"filter", "mode"}:
        extension[key] = random.choice(TEXTS)
    elif random.random() < 0.3:
        extension.pop(key, None)
    else:
        extension[key] = _number(random, extension.get(key))


def _many(model: Model, random: Random) -> None:
    """Add more attributes than a codec or a layout has room for, or images named many times."""
    primitives = list(_primitives(model))
    if random.random() < 0.3:
        model.json["images"] = [{"uri": random.choice(("tex.png", "sub/tex.png"))}] * random.choice((3, 500))
    elif primitives and isinstance(attributes := random.choice(primitives).get("attributes"), dict):
        value = random.choice([*attributes.values(), 0])
        prefix, count = random.choice(
            (("TEXCOORD_", 12), ("_X", 140), ("_X", 300), ("JOINTS_", 5), ("COLOR_", 9))
        )
        for number in range(count):
            attributes.setdefault(f"{prefix}{number}", value)


def _resource(model: Model, random: Random) -> None:
    """Give the document URIs of images and buffers."""
    if random.random() < 0.7:
        images = model.json.get("images")
        images = images if isinstance(images, list) else []
        model.json["images"] = [*images, *({"uri": uri(random)} for _ in range(random.randint(1, 3)))]
        return
    buffers = _objects(model.json, "buffers")
    if buffers and random.random() < 0.5:
        random.choice(buffers)["uri"] = uri(random)
    elif isinstance(model.json.get("buffers"), list):
        length = random.choice((1, 10, 60, len(model.binary)))
        model.json["buffers"].append({"uri": uri(random), "byteLength": length})
        for view in random.sample(
            _objects(model.json, "bufferViews"), 1 if _objects(model.json, "bufferViews") else 0
        ):
            view["buffer"] = len(model.json["buffers"]) - 1


def _note(model: Model, random: Random) -> None:
    """Change what an earlier bake noted."""
    notes = [note for primitive in _primitives(model) for note in _notes(primitive)]
    if notes:
        note = random.choice(notes)
        key = random.choice(list(note) or ["version"])
        note[key] = _junk(model, random, note.get(key))


def _notes(primitive: JsonObject) -> Iterator[JsonObject]:
    extension = primitive.get("extensions")
    holders = [primitive, *(extension.values() if isinstance(extension, dict) else ())]
    for holder in holders:
        extras = holder.get("extras") if isinstance(holder, dict) else None
        note = extras.get("skinbake") if isinstance(extras, dict) else None
        if isinstance(note, dict):
            yield note


# Bytes


def _data(model: Model, random: Random) -> None:
    """Write special numbers over an accessor's data."""
    accessor = _used(model, random)
    found = span(model, accessor)
    if found is None:
        _bytes(model, random)
        return
    start, stride, count = found
    is_float = accessor.get("componentType") == 5126
    size = element_size(accessor)
    step = 4 if is_float else 1
    rows = (
        range(count)
        if random.random() < 0.2
        else [random.randrange(count) for _ in range(random.choice((1, 2, 8)))]
    )
    one = random.choice(FLOATS)
    for row in rows:
        for at in range(0, size, step):
            if random.random() < 0.7:
                place = start + stride * row + at
                value = one if random.random() < 0.6 else random.choice(FLOATS)
                piece = (
                    struct.pack("<f", value) if is_float else bytes([random.choice((0, 1, 2, 127, 128, 255))])
                )
                model.binary[place : place + step] = piece


def _bytes(model: Model, random: Random) -> None:
    """Flip bytes anywhere in the binary."""
    for _ in range(random.choice((1, 2, 8, 64))):
        if model.binary:
            model.binary[random.randrange(len(model.binary))] = random.choice(
                (0, 1, 127, 128, 255, random.randrange(256))
            )


def _stream(model: Model, random: Random) -> None:
    """Flip bytes of a compressed stream, its beginning more than the rest."""
    views = _objects(model.json, "bufferViews")
    spans = [
        extension
        for view in views
        for extension in (view.get("extensions") or {}).values()
        if isinstance(view.get("extensions"), dict) and isinstance(extension, dict)
    ]
    for primitive in _primitives(model):
        extensions = primitive.get("extensions")
        draco = extensions.get("KHR_draco_mesh_compression") if isinstance(extensions, dict) else None
        number = draco.get("bufferView") if isinstance(draco, dict) else None
        if type(number) is int and 0 <= number < len(views):
            spans.append(views[number])
    chosen = random.choice(spans) if spans else {}
    start, length = chosen.get("byteOffset", 0), chosen.get("byteLength")
    if not (
        type(start) is int and type(length) is int and start >= 0 and 0 < length <= len(model.binary) - start
    ):
        _bytes(model, random)
        return
    if random.random() < 0.15:
        chosen["byteLength"] = max(length - random.randrange(1, length + 1), 1)
    for _ in range(random.choice((1, 1, 2, 4, 16))):
        at = start + random.randrange(min(length, 64) if random.random() < 0.4 else length)
        model.binary[at] = random.choice(
            (0, 1, 127, 128, 255, random.randrange(256), model.binary[at] ^ (1 << random.randrange(8)))
        )


def _length(model: Model, random: Random) -> None:
    """Cut the binary, lengthen it, or shift what is in it."""
    kind = random.randrange(4)
    at = random.randrange(len(model.binary) + 1)
    if kind == 0:
        del model.binary[at:]
    elif kind == 1:
        model.binary += random.randbytes(random.choice((1, 4, 33)))
    elif kind == 2:
        model.binary[at:at] = bytes(random.choice((1, 2, 4)))
    else:
        del model.binary[at : at + random.choice((1, 2, 4))]


def _nest(model: Model, random: Random) -> None:
    """Nest a member deeper than json's own reader and writer go, here and there with an error inside."""
    depth = random.choice((1100, 1100, 1100, 3000, 70_000))
    before, after = random.choice(
        (("[", "]"), ('{"a":', "}"), ('[1,{"b":[],"c":', ',"d":2}]'), ("[ {}, ", ", null ]"))
    )
    text = before * depth + random.choice(("1", "{}", "[]", '"x"')) + after * depth
    if random.random() < 0.3:
        at = random.randrange(len(text))
        text = text[:at] + random.choice(("", "]", "}", ",", '"', ":", "x")) + text[at + 1 :]
    mark = f"@raw{len(model.raw)}@"
    model.raw[mark] = text
    holders = [model.json, *(model.json.get("nodes") or [])[:2], *(model.json.get("meshes") or [])[:1]]
    random.choice(holders)[random.choice(("extras", "name", "extensions"))] = mark


MUTATIONS: tuple[Callable[[Model, Random], None], ...] = (
    _value, _delete, _insert, _move, _accessor, _attribute, _view, _skin, _animation, _resource, _note, _data,
    _bytes, _stream, _length, _morph, _packing, _many, _nest,
)  # fmt: skip
WEIGHTS = (10, 6, 4, 4, 7, 8, 4, 6, 5, 5, 4, 12, 2, 5, 2, 4, 4, 1, 1)


# The container


def damaged_container(data: bytes, random: Random) -> bytes:
    """Return a file's bytes with its headers, its length or its text damaged."""
    content = bytearray(data)
    kind = random.randrange(11)
    if kind == 9 and len(content) > 20:  # cut, and the header says so
        del content[random.choice((20, 24, len(content) - 3, random.randrange(20, len(content)))) :]
        struct.pack_into("<I", content, 8, len(content))
    elif kind == 10 and len(content) > 20:  # without its BIN chunk, or so long that it is mapped
        end = 20 + int.from_bytes(content[12:16], "little")
        content = content[:end] if random.random() < 0.8 else content + bytes(1 << 20)
        struct.pack_into("<I", content, 8, min(len(content), end))
    if kind == 0:
        return bytes(content[: random.randrange(len(content) + 1)])
    if kind == 1:
        return bytes(content) + random.randbytes(random.choice((1, 3, 4, 64)))
    if kind == 2 and len(content) > 20:
        struct.pack_into(
            "<I",
            content,
            random.choice((0, 4, 8, 12, 16)),
            random.choice(INTEGERS) % 2**32 if random.random() < 0.8 else 2,
        )
    elif kind == 3:
        return b"\xef\xbb\xbf" + bytes(content)
    elif kind == 4:
        return bytes(content).decode("latin-1").encode(random.choice(("utf-16", "utf-8", "utf-32")))
    elif kind == 5 and len(content) > 12:
        chunk = struct.pack("<I4s", 4, random.choice((b"XXXX", b"BIN\0", b"JSON"))) + b"abcd"
        content += chunk
        struct.pack_into("<I", content, 8, len(content))
    elif kind == 6:
        return random.choice(
            (b"", b"{}", b"[]", b"null", b"glTF", b"\0" * 64, b'{"asset":{"version":"2.0"}}', b"{" * 9000)
        )
    elif kind == 7:
        at = random.randrange(len(content) + 1)
        content[at:at] = random.choice((b"\0", b'"', b"{", b"\xff", b"}", b",", b" " * 7))
    elif kind == 8 and content:
        content[random.randrange(len(content))] ^= 1 << random.randrange(8)
    return bytes(content)
