"""Changes of baked files: 45 kinds of change, harmful and harmless ones, each drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from skinbake.format.digests import array_digest
from tests.support import gltf_reading
from tests.support.baked_files import AnyArray, Editable, JsonObject

Rng = np.random.Generator
Edit = Callable[[Editable, Rng], None]

ALPHA, BETA = "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"


@dataclass(frozen=True)
class Mutation:
    """A kind of change, and whether the note of the bake is made to agree with the new weights."""

    name: str
    edit: Edit
    rewrites_digest: bool = False


def both(model: Editable) -> tuple[AnyArray, AnyArray]:
    return model.array(ALPHA), model.array(BETA)


def alpha_scaled(model: Editable, rng: Rng) -> None:
    model.array(ALPHA)[:] *= np.float32(rng.choice([0.0, 0.5, 0.8, 1.3, 3.0]))


def both_scaled(model: Editable, rng: Rng) -> None:
    factor = np.float32(rng.choice([0.0, 0.6, 1.4, 100.0]))
    for array in both(model):
        array[:] *= factor


def sign_of_one(model: Editable, rng: Rng) -> None:
    both(model)[rng.integers(2)][:] *= -1


def sign_of_a_slot(model: Editable, rng: Rng) -> None:
    slot = rng.integers(3)
    for array in both(model):
        array[:, slot] *= -1


def exchanged(model: Editable, rng: Rng) -> None:
    attributes = model.primitive()["attributes"]
    attributes[ALPHA], attributes[BETA] = attributes[BETA], attributes[ALPHA]


def slots_permuted(model: Editable, rng: Rng) -> None:
    order = np.roll(np.arange(3), rng.integers(1, 3))
    for array in both(model):
        array[:] = array[:, order]


def rows_rolled(model: Editable, rng: Rng) -> None:
    for array in both(model):
        array[:] = np.roll(array, rng.integers(1, 5), axis=0)


def some_zeroed(model: Editable, rng: Rng) -> None:
    rows = rng.random(len(model.array(ALPHA))) < 0.1
    for array in both(model):
        array[rows] = 0.0


def noise(model: Editable, rng: Rng) -> None:
    for array in both(model):
        array[:] += (rng.normal(size=array.shape) * 0.3 * np.abs(array).max()).astype(np.float32)


def one_vertex(model: Editable, rng: Rng) -> None:
    alpha = model.array(ALPHA)
    alpha[np.abs(alpha).sum(axis=1).argmax()] *= np.float32(-rng.uniform(1, 3))


def influences_swapped(model: Editable, rng: Rng) -> None:
    first, second = rng.choice(4, 2, replace=False)
    for name in ("JOINTS_0", "WEIGHTS_0"):
        array = model.array(name)
        array[:, [first, second]] = array[:, [second, first]]


def joints_swapped(model: Editable, rng: Rng) -> None:
    array = model.array("JOINTS_0")
    array[:, [0, 1]] = array[:, [1, 0]]


def joints_renumbered(model: Editable, rng: Rng) -> None:
    joints = len(model.content["skins"][0]["joints"])
    array = model.array("JOINTS_0")
    array[:] = rng.permutation(joints)[array]


def weights_of(model: Editable, edit: Callable[[AnyArray], AnyArray]) -> None:
    stored = model.array("WEIGHTS_0")
    total = stored.astype(float).sum(axis=1, keepdims=True)
    edited = edit(stored / total)
    edited *= total / edited.sum(axis=1, keepdims=True)
    stored[:] = np.round(edited) if stored.dtype.kind == "u" else edited


def weights_sharpened(model: Editable, rng: Rng) -> None:
    weights_of(model, lambda weights: weights ** rng.uniform(1.5, 3.0))


def weights_shifted(model: Editable, rng: Rng) -> None:
    weights_of(model, lambda weights: np.where(weights > 0.01, weights + rng.uniform(0.1, 0.5), weights))


def normals_turned(model: Editable, rng: Rng) -> None:
    normals = model.array("NORMAL")
    turn = Rotation.from_rotvec(np.radians(rng.uniform(5, 120)) * unit(rng.normal(size=3)))
    normals[:] = turn.apply(normals).astype(np.float32)


def some_normals_turned(model: Editable, rng: Rng) -> None:
    normals = model.array("NORMAL")
    rows = rng.random(len(normals)) < 0.2
    turn = Rotation.from_rotvec(np.radians(rng.uniform(5, 60)) * unit(rng.normal(size=3)))
    normals[rows] = turn.apply(normals[rows]).astype(np.float32)


def normals_flipped(model: Editable, rng: Rng) -> None:
    model.array("NORMAL")[:] *= -1


def positions_bent(model: Editable, rng: Rng) -> None:
    positions = model.array("POSITION")
    size = np.ptp(positions, axis=0).max()
    positions[:, 1] += (rng.uniform(0.05, 0.3) * size * np.sin(8 * positions[:, 0] / size)).astype(np.float32)


def positions_stretched(model: Editable, rng: Rng) -> None:
    model.array("POSITION")[:, rng.integers(3)] *= np.float32(rng.uniform(1.2, 3.0))


def positions_scaled(model: Editable, rng: Rng) -> None:
    model.array("POSITION")[:] *= np.float32(rng.choice([0.01, 0.5, 2.0, 100.0]))


def some_positions_moved(model: Editable, rng: Rng) -> None:
    positions = model.array("POSITION")
    rows = rng.random(len(positions)) < 0.1
    size = np.ptp(positions, axis=0).max()
    positions[rows] += (rng.normal(size=(int(rows.sum()), 3)) * 0.05 * size).astype(np.float32)


def triangles_lost(model: Editable, rng: Rng) -> None:
    indices = model.array("indices")
    triangles = len(indices) // 3
    start = int(rng.integers(triangles // 2))
    indices[3 * start : 3 * (start + triangles // 3)] = indices[0]


def vertices_exchanged(model: Editable, rng: Rng) -> None:
    """Vertices in another order, but α and β stay where they were."""
    rearrange(model, rng, [ALPHA, BETA])


def frame_noted(model: Editable, rng: Rng) -> None:
    model.metadata()["frame"] = "tangent" if model.metadata()["frame"] == "normal" else "normal"


HARMFUL = [
    Mutation("α scaled", alpha_scaled),
    Mutation("α and β scaled", both_scaled),
    Mutation("α or β negated", sign_of_one),
    Mutation("a slot negated", sign_of_a_slot),
    Mutation("α and β exchanged", exchanged),
    Mutation("slots of α and β permuted", slots_permuted),
    Mutation("α and β moved to other vertices", rows_rolled),
    Mutation("some α and β zero", some_zeroed),
    Mutation("noise on α and β", noise),
    Mutation("α of one vertex negated", one_vertex),
    Mutation("influences swapped", influences_swapped),
    Mutation("joints swapped", joints_swapped),
    Mutation("joints renumbered", joints_renumbered),
    Mutation("weights sharpened", weights_sharpened),
    Mutation("weights shifted", weights_shifted),
    Mutation("weights and digest sharpened", weights_sharpened, rewrites_digest=True),
    Mutation("weights and digest shifted", weights_shifted, rewrites_digest=True),
    Mutation("normals turned", normals_turned),
    Mutation("some normals turned", some_normals_turned),
    Mutation("normals flipped", normals_flipped),
    Mutation("positions bent", positions_bent),
    Mutation("positions stretched", positions_stretched),
    Mutation("positions scaled", positions_scaled),
    Mutation("some positions moved", some_positions_moved),
    Mutation("triangles lost", triangles_lost),
    Mutation("vertices in another order than α and β", vertices_exchanged),
    Mutation("another frame noted", frame_noted),
]


def renumbered(
    model: Editable, rng: Rng, key: str, references: Callable[[JsonObject], Sequence[Any]]
) -> None:
    """Give the entries of a top-level array other numbers; references are (holder, member) of each."""
    entries = model.content[key]
    order = rng.permutation(len(entries))
    model.content[key] = [entries[old] for old in order]
    now = np.argsort(order).tolist()
    for holder, member in references(model.content):
        holder[member] = now[holder[member]]


def accessor_references(content: JsonObject) -> list[Any]:
    found: list[Any] = []
    for mesh in content["meshes"]:
        for primitive in mesh["primitives"]:
            maps = [primitive["attributes"], *primitive.get("targets", [])]
            found += [(attributes, name) for attributes in maps for name in attributes]
            found += [(primitive, "indices")] if "indices" in primitive else []
    found += [(skin, "inverseBindMatrices") for skin in content["skins"]]
    for animation in content.get("animations", []):
        found += [(sampler, end) for sampler in animation["samplers"] for end in ("input", "output")]
    # One attribute map may stand in several primitives.
    return list({(id(holder), member): (holder, member) for holder, member in found}.values())


def accessors_renumbered(model: Editable, rng: Rng) -> None:
    renumbered(model, rng, "accessors", accessor_references)


def views_renumbered(model: Editable, rng: Rng) -> None:
    def references(content: JsonObject) -> list[Any]:
        holders = [*content["accessors"], *content.get("images", [])]
        return [(holder, "bufferView") for holder in holders if "bufferView" in holder]

    renumbered(model, rng, "bufferViews", references)


def nodes_renumbered(model: Editable, rng: Rng) -> None:
    def references(content: JsonObject) -> list[Any]:
        lists = [node["children"] for node in content["nodes"] if "children" in node]
        lists += [scene["nodes"] for scene in content["scenes"]]
        lists += [skin["joints"] for skin in content["skins"]]
        found: list[Any] = [(entries, place) for entries in lists for place in range(len(entries))]
        found += [(skin, "skeleton") for skin in content["skins"] if "skeleton" in skin]
        for animation in content.get("animations", []):
            found += [(channel["target"], "node") for channel in animation["channels"]]
        return found

    renumbered(model, rng, "nodes", references)


def padded(model: Editable, rng: Rng) -> None:
    length = 4 * int(rng.integers(1, 100))
    model.binary = bytearray(rng.bytes(length)) + model.binary
    for view in model.content["bufferViews"]:
        view["byteOffset"] = view.get("byteOffset", 0) + length


def padded_behind(model: Editable, rng: Rng) -> None:
    model.binary += rng.bytes(4 * int(rng.integers(1, 100)))


def extras_added(model: Editable, rng: Rng) -> None:
    for key in ("nodes", "meshes", "accessors", "materials"):
        for entry in model.content.get(key, []):
            entry.setdefault("extras", {})["note"] = int(rng.integers(1000))
    model.primitive()["extras"]["tool"] = {"version": 3}


def materials_edited(model: Editable, rng: Rng) -> None:
    materials = model.content.setdefault("materials", [{}])
    materials.append({"name": "unlit", "pbrMetallicRoughness": {"metallicFactor": 0.0}})
    model.primitive()["material"] = len(materials) - 1


def names_edited(model: Editable, rng: Rng) -> None:
    for key in ("meshes", "materials", "animations", "skins", "accessors"):
        for number, entry in enumerate(model.content.get(key, [])):
            entry["name"] = f"{key} {number}"


def animations_removed(model: Editable, rng: Rng) -> None:
    model.content.pop("animations", None)


def asset_edited(model: Editable, rng: Rng) -> None:
    model.content["asset"] |= {"generator": "another tool", "copyright": "2026"}


def bounds_removed(model: Editable, rng: Rng) -> None:
    for accessor in model.content["accessors"]:
        accessor.pop("min", None)
        accessor.pop("max", None)


def keys_reordered(model: Editable, rng: Rng) -> None:
    def turned(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: turned(value[key]) for key in rng.permutation(list(value))}
        return [turned(entry) for entry in value] if isinstance(value, list) else value

    model.content = turned(model.content)


def moved_elsewhere(model: Editable, rng: Rng) -> None:
    name = str(rng.choice(["POSITION", "NORMAL", ALPHA, BETA]))
    number = model.add(model.array(name).copy())
    model.primitive()["attributes"][name] = number


def colours_added(model: Editable, rng: Rng) -> None:
    count = len(model.array("POSITION"))
    model.primitive()["attributes"]["_TINT"] = model.add(rng.random((count, 3)).astype(np.float32))


def node_added(model: Editable, rng: Rng) -> None:
    nodes = model.content["nodes"]
    nodes.append({"name": "sword", "translation": rng.normal(size=3).tolist()})
    model.content["scenes"][0]["nodes"].append(len(nodes) - 1)


def triangles_reordered(model: Editable, rng: Rng) -> None:
    indices = model.array("indices")
    indices[:] = rng.permutation(indices.reshape(-1, 3)).reshape(-1, 1)


def triangles_begun_elsewhere(model: Editable, rng: Rng) -> None:
    indices = model.array("indices")
    indices[:] = np.roll(indices.reshape(-1, 3), 1, axis=1).reshape(-1, 1)


def vertices_reordered(model: Editable, rng: Rng) -> None:
    rearrange(model, rng, [])


def rearrange(model: Editable, rng: Rng, left: Sequence[str]) -> None:
    """Put vertices into another order, with all attributes but those in ``left``."""
    order = rng.permutation(len(model.array("POSITION")))
    primitive = model.primitive()
    accessors = {number for name, number in primitive["attributes"].items() if name not in left}
    accessors |= {number for target in primitive.get("targets", []) for number in target.values()}
    for number in accessors:
        values = model.stored(number)
        values[:] = values[order]
    indices = model.array("indices")
    indices[:, 0] = np.argsort(order)[indices[:, 0]]


HARMLESS = [
    Mutation("accessors renumbered", accessors_renumbered),
    Mutation("buffer views renumbered", views_renumbered),
    Mutation("nodes renumbered", nodes_renumbered),
    Mutation("bytes before", padded),
    Mutation("bytes behind", padded_behind),
    Mutation("extras added", extras_added),
    Mutation("materials edited", materials_edited),
    Mutation("names edited", names_edited),
    Mutation("animations removed", animations_removed),
    Mutation("asset edited", asset_edited),
    Mutation("bounds removed", bounds_removed),
    Mutation("keys of JSON reordered", keys_reordered),
    Mutation("an array elsewhere in the buffer", moved_elsewhere),
    Mutation("an attribute added", colours_added),
    Mutation("a node added", node_added),
    Mutation("triangles reordered", triangles_reordered),
    Mutation("triangles begun at another corner", triangles_begun_elsewhere),
    Mutation("vertices reordered", vertices_reordered),
]


def mutated(mutation: Mutation, baked: Path, target: Path, seed: int) -> Path:
    """Write what a mutation makes of a baked file."""
    model = Editable(baked)
    mutation.edit(model, np.random.default_rng(seed))
    model.write(target)
    if mutation.rewrites_digest:
        weights = gltf_reading.read(target).influences()[1]
        model.metadata()["digest"]["WEIGHTS"] = array_digest(weights, "<f4")
        model.write(target)
    return target


def unit(vector: AnyArray) -> AnyArray:
    return np.asarray(vector / np.linalg.norm(vector))
