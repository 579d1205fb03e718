"""A character's lighting computed once more, from the file's bytes, without skinbake's reader or replay.

One pose at a time, matrices composed node by node; only the gradient operator is skinbake's, and that has an
oracle of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.truth.operator import gradient_operator
from tests.support import gltf_reading
from tests.support.derivatives import derivative_along
from tests.support.gltf_reading import GltfFile

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Character:
    """A baked file with one mesh of one primitive, one skin and LINEAR animations; frame from NORMAL."""

    file: GltfFile
    clip: int

    @staticmethod
    def read(path: Path, clip: int = 0) -> Character:
        return Character(gltf_reading.read(path), clip)

    def middles(self, count: int) -> list[float]:
        """The middles of equal parts of the clip, from its first key to its last."""
        samplers = self.file.content["animations"][self.clip]["samplers"]
        times = np.concatenate([self.file.values(sampler["input"]).ravel() for sampler in samplers])
        first, part = float(times.min()), float(np.ptp(times)) / count
        return [first + part * (number + 0.5) for number in range(count)]

    def joint_matrices(self, time: float) -> list[Array]:
        nodes = self.file.content["nodes"]
        parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
        animated = self._animated(time)

        def world(number: int) -> Array:
            own = local(nodes[number], animated.get(number, {}))
            return world(parents[number]) @ own if number in parents else own

        skin = self.file.content["skins"][0]
        bind = self.file.matrices(skin["inverseBindMatrices"])
        return [world(joint) @ bind[number] for number, joint in enumerate(skin["joints"])]

    def _animated(self, time: float) -> dict[int, dict[str, Array]]:
        animation = self.file.content["animations"][self.clip]
        result: dict[int, dict[str, Array]] = {}
        for channel in animation["channels"]:
            sampler, target = animation["samplers"][channel["sampler"]], channel["target"]
            assert sampler.get("interpolation", "LINEAR") == "LINEAR"
            times, values = self.file.values(sampler["input"])[:, 0], self.file.values(sampler["output"])
            if target["path"] == "weights":
                values = values.reshape(len(times), -1)
            value = between(times, values, time, rotation=target["path"] == "rotation")
            result.setdefault(target["node"], {})[target["path"]] = value
        return result

    def errors(self, time: float) -> tuple[Array, Array, Array]:
        """Return the errors of standard and accurate LBS normals in degrees, and the areas: (V,) each."""
        file = self.file
        positions, normals = self.morphed(time)
        joints, weights = file.influences()
        weights = weights / weights.sum(axis=1, keepdims=True)
        rest_normals = unit(file.attribute("NORMAL"))
        tangents, bitangents = (turned(vectors, rest_normals, normals) for vectors in duff(rest_normals))
        alpha, beta = file.attribute("_SKINBAKE_ALPHA_0"), file.attribute("_SKINBAKE_BETA_0")
        matrices = np.array(self.joint_matrices(time))
        count = len(positions)
        moved, standard, accurate = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
        for vertex in range(count):
            each = [
                matrices[joint][:3, :3] @ positions[vertex] + matrices[joint][:3, 3]
                for joint in joints[vertex]
            ]
            blend = sum(
                weight * matrices[joint][:3, :3]
                for weight, joint in zip(weights[vertex], joints[vertex], strict=True)
            )
            moved[vertex] = sum(w * q for w, q in zip(weights[vertex], each, strict=True))
            t = blend @ tangents[vertex]
            b = blend @ bitangents[vertex]
            for slot in (1, 2, 3):
                t = t + alpha[vertex, slot - 1] * (each[slot] - each[0])
                b = b + beta[vertex, slot - 1] * (each[slot] - each[0])
            standard[vertex] = blend @ normals[vertex]
            accurate[vertex] = np.cross(t, b)
        true = self._true_normals(positions, normals, moved)
        corners = file.attribute("POSITION")[file.triangles(0)]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        areas = np.zeros(count)
        for number, triangle in enumerate(file.triangles(0)):
            areas[triangle] += area[number] / 6
        return degrees(standard, true), degrees(accurate, true), areas

    def morphed(self, time: float) -> tuple[Array, Array]:
        """Return positions and unit normals before skinning, by the weights that the clip gives node 0."""
        file = self.file
        positions, normals = file.attribute("POSITION"), unit(file.attribute("NORMAL"))
        targets = file.content["meshes"][0]["primitives"][0].get("targets", [])
        weights = self._animated(time).get(0, {}).get("weights", np.zeros(len(targets)))
        moved, turned_normals = positions.copy(), normals.copy()
        for weight, target in zip(weights, targets, strict=True):
            if "POSITION" in target:
                moved += weight * file.values(target["POSITION"])
            if "NORMAL" in target:
                turned_normals += weight * file.values(target["NORMAL"])
        return moved, unit(turned_normals)

    def _true_normals(self, positions: Array, normals: Array, moved: Array) -> Array:
        joints, weights = self.file.influences()
        rest, rest_normals = self.file.attribute("POSITION"), unit(self.file.attribute("NORMAL"))
        primitive = SkinnedPrimitive(rest, rest_normals, None, joints, weights, self.file.triangles(0))
        operator = gradient_operator([primitive])
        tangents, bitangents = duff(rest_normals)
        before = [derivative_along(operator, axis) @ positions for axis in (tangents, bitangents)]
        after = [derivative_along(operator, axis) @ moved for axis in (tangents, bitangents)]
        result = np.full((len(positions), 3), np.nan)
        for vertex in range(len(positions)):
            c0, c1 = (np.cross(pair[0][vertex], pair[1][vertex]) for pair in (before, after))
            lengths = np.linalg.norm(c0), np.linalg.norm(c1)
            if min(lengths) == 0:
                continue
            rest = np.column_stack([before[0][vertex], before[1][vertex], c0 / lengths[0]])
            stretch = np.sqrt(lengths[1] / lengths[0])
            posed = np.column_stack([after[0][vertex], after[1][vertex], c1 / lengths[1] * stretch])
            f = posed @ np.linalg.inv(rest)
            result[vertex] = np.linalg.det(f) * np.linalg.inv(f).T @ normals[vertex]
        return result


def local(node: dict[str, Any], animated: dict[str, Array]) -> Array:
    """The node's transform: its matrix, or T R S with what is animated."""
    if "matrix" in node:
        return np.array(node["matrix"]).reshape(4, 4).T
    result = np.eye(4)
    x, y, z, w = unit(np.asarray(animated.get("rotation", node.get("rotation", [0, 0, 0, 1])), float)[None])[
        0
    ]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    result[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    result[:3, :3] *= animated.get("scale", node.get("scale", [1, 1, 1]))
    result[:3, 3] = animated.get("translation", node.get("translation", [0, 0, 0]))
    return result


def between(times: Array, values: Array, time: float, *, rotation: bool) -> Array:
    """Interpolate LINEAR keys; quaternions along the shorter arc."""
    if time <= times[0] or len(times) == 1:
        return np.array(values[0])
    if time >= times[-1]:
        return np.array(values[-1])
    after = int(np.argmax(times > time))
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    first, second = values[after - 1], values[after]
    if not rotation:
        return np.array((1 - share) * first + share * second)
    first, second = unit(first[None])[0], unit(second[None])[0]
    cosine = float(first @ second)
    if cosine < 0:
        second, cosine = -second, -cosine
    if cosine > 1 - 1e-12:
        return np.array(second)
    angle = np.arccos(cosine)
    arc: Array = (np.sin((1 - share) * angle) * first + np.sin(share * angle) * second) / np.sin(angle)
    return arc


def duff(normals: Array) -> tuple[Array, Array]:
    """Duff et al. 2017, the published listing, in float64."""
    x, y, z = normals.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangents = np.column_stack([1.0 + sign * x * x * a, sign * b, -sign * x])
    return tangents, np.column_stack([b, sign + y * y * a, -y])


def turned(vectors: Array, before: Array, after: Array) -> Array:
    """Vectors turned by the rotation of least angle that takes one unit normal to the other."""
    axes = np.cross(before, after)
    sines = np.linalg.norm(axes, axis=1)
    angles = np.arctan2(sines, (before * after).sum(axis=1))
    axes = axes / np.where(sines > 0, sines, 1.0)[:, None]
    result: Array = Rotation.from_rotvec(axes * angles[:, None]).apply(vectors)
    return result


def unit(vectors: Array) -> Array:
    length: Array = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / length


def degrees(first: Array, second: Array) -> Array:
    """Angles by the arccos, which is good enough for degrees; NaN where a normal is missing."""
    with np.errstate(invalid="ignore"):
        angles: Array = np.degrees(np.arccos(np.clip((unit(first) * unit(second)).sum(axis=1), -1, 1)))
    return angles
