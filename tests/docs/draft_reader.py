"""A reader of the draft of the extension that knows nothing else: docs/extension/README.md, put into numpy.

It imports nothing of skinbake. Each function follows one section of the page, in its letters.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import numpy.typing as npt

from tests.support.gltf_reading import GltfFile

JsonObject = dict[str, Any]
Wide = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]


def properties(file: GltfFile, primitive: JsonObject) -> JsonObject | None:
    """Names, and how files migrate."""
    extras = primitive.get("extras", {})
    if isinstance(extras, dict):
        return extras.get("skinbake")
    for accessor in primitive["attributes"].values():
        extras = file.content["accessors"][accessor].get("extras")
        if isinstance(extras, dict) and "skinbake" in extras:
            found: JsonObject = extras["skinbake"]
            return found
    return None


def normals(
    file: GltfFile, mesh: int, primitive: int, joint_matrices: Wide, target_weights: Wide
) -> tuple[Wide, Wide]:
    """α and β: positions and unit normals (V, 3). The joint matrices (J, 4, 4) act on columns."""
    held = file.content["meshes"][mesh]["primitives"][primitive]
    told = properties(file, held)
    assert told is not None and told["version"] == 1
    attributes = {name: file.values(number) for name, number in held["attributes"].items()}
    sets = range(told["influences"] // 4)
    joints = np.hstack([attributes[f"JOINTS_{n}"] for n in sets]).astype(int)
    w = np.maximum(np.hstack([attributes[f"WEIGHTS_{n}"] for n in sets]), 0.0)
    w[w.sum(axis=1) == 0, 0] = 1.0
    w /= w.sum(axis=1, keepdims=True)
    alpha, beta = gradients(told, attributes)
    p, t0, b0, h = morphed(file, held, told, attributes, target_weights)
    joints[joints >= len(joint_matrices)] = 0
    matrices = joint_matrices[joints][:, :, :3]  # (V, K, 3, 4)
    points = np.einsum("vkij,vj->vki", matrices[..., :3], p) + matrices[..., 3]
    q = points - points[:, :1]
    blended = np.einsum("vk,vkij->vij", w, matrices[..., :3])
    t = np.einsum("vij,vj->vi", blended, t0) + np.einsum("vk,vki->vi", alpha, q)
    b = np.einsum("vij,vj->vi", blended, b0) + np.einsum("vk,vki->vi", beta, q)
    n = h[:, None] * np.cross(t, b)
    n *= np.where(np.linalg.det(blended) < 0, -1.0, 1.0)[:, None]
    return np.einsum("vk,vki->vi", w, points), unit(n)


def unit(vectors: Wide) -> Wide:
    """Return vectors (V, 3) at length 1, NaN where they have none."""
    with np.errstate(invalid="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def gradients(told: JsonObject, attributes: dict[str, Wide]) -> list[Wide]:
    """Attributes, and the sum rule: α and β of all slots, each (V, K)."""
    others = []
    if told.get("layout") == "texcoord":
        names = list(dict.fromkeys([*told["alpha"], *told["beta"]]))
        numbers = np.hstack([attributes[name] for name in names])
        others = np.split(numbers, 2, axis=1)
    else:
        for names in (told["alpha"], told["beta"]):
            stored = [attributes[name] for name in names]
            if "encoding" in told:
                s = stored[0][:, 3:] ** 2 * told["scale"]
                stored = [s * stored[0][:, :3], *(s * values for values in stored[1:])]
            others.append(np.hstack(stored))
    return [np.hstack([-each.sum(axis=1, keepdims=True), each]) for each in others]


def rest_frame(told: JsonObject, attributes: dict[str, Wide]) -> tuple[Wide, Wide, Wide, Wide]:
    """Frame: n0, t0, b0 (V, 3) and h (V,)."""
    stored = attributes["NORMAL"]
    sound = np.isfinite(stored).all(axis=1, keepdims=True) & stored.any(axis=1, keepdims=True)
    n0 = unit(np.where(sound, stored, [0.0, 0.0, 1.0])).astype(np.float32)
    if told["frame"] == "tangent":
        tangent = attributes["TANGENT"]
        tangent = np.where(np.isfinite(tangent).all(axis=1, keepdims=True), tangent, 0.0)
        t0, h = tangent[:, :3], tangent[:, 3]
        return n0.astype(float), t0, np.cross(n0.astype(float), t0) * h[:, None], h
    x, y, z = n0.T
    one = np.float32(1)
    sign = np.where(z >= 0, one, -one)
    a = -one / (sign + z)
    b = (x * y) * a
    t0 = np.stack([one + sign * ((x * x) * a), sign * b, (-sign) * x], axis=1)
    b0 = np.stack([b, sign + (y * y) * a, -y], axis=1)
    return n0.astype(float), t0.astype(float), b0.astype(float), np.ones(len(n0))


def morphed(
    file: GltfFile, held: JsonObject, told: JsonObject, attributes: dict[str, Wide], v: Wide
) -> tuple[Wide, Wide, Wide, Wide]:
    """Morph targets: p, t, b (V, 3) and h (V,) under the weights v of the targets."""
    n0, t0, b0, h = rest_frame(told, attributes)
    targets = held.get("targets", [])
    kinds = {name for target in targets for name in target}

    def added(name: str, width: int = 3) -> Wide:
        total = np.zeros((len(n0), width))
        for weight, target in zip(v, targets, strict=True):
            total += weight * file.values(target[name]) if name in target else 0.0
        return total

    p = attributes["POSITION"] + added("POSITION")
    if not v.any():
        return p, t0, b0, h
    change = added("NORMAL")
    turns = change.any(axis=1, keepdims=True) & (n0 + change).any(axis=1, keepdims=True)
    n = np.where(turns, unit(np.where(turns, n0 + change, n0)), n0)
    # By NORMAL.
    s = n0 + n
    square = dot(s, s)
    flat = square < 1e-4
    square[flat] = 1.0
    t, b = (a - s * (2 * dot(n - n0, a) / square)[:, None] for a in (t0, b0))
    t, b = np.where(flat[:, None], t0, t), np.where(flat[:, None], -b0, b)
    if "_SKINBAKE_MORPH" in kinds:
        m = added("_SKINBAKE_MORPH", 4)
        u = added("_SKINBAKE_MORPH_UP", 2)
        moved_t = (1 + m[:, :1]) * t0 + m[:, 1:2] * b0 + u[:, :1] * n0
        moved_b = m[:, 2:3] * t0 + (1 + m[:, 3:]) * b0 + u[:, 1:] * n0
        if "_SKINBAKE_MORPH_UP" in kinds:
            return p, moved_t, moved_b, h
        c = dot(n0, n)
        steep = (np.abs(c) < 0.2) | (c * ((1 + m[:, 0]) * (1 + m[:, 3]) - m[:, 1] * m[:, 2]) <= 0)
        c[steep] = 1.0
        moved_t, moved_b = (a - n0 * (dot(a, n) / c)[:, None] for a in (moved_t, moved_b))
        return p, np.where(steep[:, None], t, moved_t), np.where(steep[:, None], b, moved_b), h
    if told["frame"] == "tangent" and "TANGENT" in kinds:
        summed = t0 + added("TANGENT")
        moved_t = summed - n * (dot(n, summed) - dot(n0, t0))[:, None]
        moved_b = np.cross(n, moved_t) * h[:, None]
        gone = (dot(moved_t, moved_t) < 1e-4 * dot(t0, t0))[:, None]
        return p, np.where(gone, t, moved_t), np.where(gone, b, moved_b), h
    return p, t, b, h


def dot(a: Wide, b: Wide) -> Wide:
    found: Wide = np.einsum("vi,vi->v", a, b)
    return found


def positions(file: GltfFile, mesh: int, primitive: int) -> JsonObject:
    """Has the mesh changed: all members that ``positions`` may have."""
    held = file.content["meshes"][mesh]["primitives"][primitive]
    accessor = file.content["accessors"][held["attributes"]["POSITION"]]
    found: JsonObject = {"componentType": accessor["componentType"]}
    triangles = file.triangles(mesh, primitive)
    if held.get("mode", 4) == 4:
        counted = file.content["accessors"][held["indices"]] if "indices" in held else accessor
        joints, _ = file.influences(mesh, primitive)
        sums = []
        for row in joints.tolist():
            h = 0x811C9DC5
            for joint in row:
                h = (h ^ joint) * 0x01000193 % 2**32
            sums.append(h)
        found |= {"corners": counted["count"]}
        found |= {"joints": sum(sums[vertex] for vertex in triangles.ravel().tolist()) % 2**32}
    if accessor["componentType"] == 5126 and len(triangles):
        drawn = file.attribute("POSITION", mesh, primitive)[np.unique(triangles)]
        found |= {"min": drawn.min(axis=0).tolist(), "max": drawn.max(axis=0).tolist()}
    return found


def digests(file: GltfFile, mesh: int, primitive: int) -> dict[str, str]:
    """Has the mesh changed: the digests of all arrays."""
    joints, weights = file.influences(mesh, primitive)
    held = file.content["meshes"][mesh]["primitives"][primitive]["attributes"]
    arrays: dict[str, npt.NDArray[Any]] = {
        **{name: file.attribute(name, mesh, primitive).astype("<f4") for name in ("POSITION", "NORMAL")},
        **(
            {"TANGENT": file.attribute("TANGENT", mesh, primitive).astype("<f4")} if "TANGENT" in held else {}
        ),
        "WEIGHTS": weights.astype("<f4"),
        "JOINTS": joints.astype("<u2"),
        "indices": file.triangles(mesh, primitive).astype("<u4"),
    }
    return {name: hashlib.sha256(array.tobytes()).hexdigest()[:32] for name, array in arrays.items()}
