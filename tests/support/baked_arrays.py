"""Baked files read back by the tests' own reader, and arrays rearranged in ways that must not matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Frame, Gradients
from skinbake.geometry import frames
from skinbake.geometry.skinned import BakedPrimitive, Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gradients.baker import BakeFindings, BakeSettings, bake_primitives
from tests.support import corpus
from tests.support.baking import bake_file, bake_settings
from tests.support.gltf_reading import GltfFile, read

CESIUM_MAN = "CesiumMan/CesiumMan.glb"
MANNEQUINY = "Mannequiny/mannequiny-0.3.0.glb"
BARBARIAN = "Barbarian/Barbarian.glb"
TREX = "TRex/trex.gltf"
PBR_TEST = "pbrTest/pbrTest.gltf"
ELF = "RiggedElf/RiggedElf.gltf"
MANTIS = "RobotMantis/animated_robot_mantis.glb"
AFRAME_HAND = "AFrameHands/leftHandLow.glb"
HAND_U8 = "hand_l-weights-u8.glb"
HAND_U16 = "hand_l-weights-u16.glb"

FIXTURES = sorted(path.name for path in FOLDER.glob("*.gl[bt]*"))
INTEGER_WEIGHTS = {"weights_u8.glb", "weights_u16.glb", HAND_U8, HAND_U16}


@dataclass(frozen=True)
class StoredPrimitive:
    """One primitive of a baked file as any reader finds it, and the frame that its metadata declares."""

    arrays: SkinnedPrimitive
    alpha: Float64Array
    beta: Float64Array
    frame: str

    @property
    def rest_frame(self) -> tuple[FloatArray, FloatArray]:
        """t0 and b0, (V, 3) each."""
        normals = frames.unit_normals(self.arrays.normals)
        if self.frame == Frame.NORMAL:
            return frames.frame_from_normal(normals)
        assert self.arrays.tangents is not None
        return frames.frame_from_tangent(normals, self.arrays.tangents)


def path_of(name: str) -> Path:
    """Return a fixture, or a model of the corpus; without the corpus, its stand-in, or skip."""
    return FOLDER / name if name in FIXTURES else corpus.character(name)


def bake_to(
    name: str,
    folder: Path,
    settings: BakeSettings | None = None,
    gradients: Gradients = Gradients.FITTED,
) -> Path:
    """Bake a fixture or a corpus model into a folder and return the written file."""
    source = path_of(name)
    target = folder / source.name
    how = settings or bake_settings()
    result = bake_file(str(source), str(target), settings=how, gradients=gradients)
    assert result.status == "baked", result.notices
    return target


def meshes_of(path: Path) -> dict[int, list[SkinnedPrimitive]]:
    """Return the primitives with joints and normals of every mesh, by the mesh's index."""
    file = read(path)
    found = {
        number: [
            arrays(file, number, primitive)
            for primitive in range(len(mesh["primitives"]))
            if file.has_attribute("JOINTS_0", number, primitive)
            and file.has_attribute("NORMAL", number, primitive)
        ]
        for number, mesh in enumerate(file.content["meshes"])
    }
    return {number: primitives for number, primitives in found.items() if primitives}


def baked_meshes_of(path: Path) -> dict[int, list[StoredPrimitive]]:
    """Return the primitives of every mesh of a baked file, all of which must be baked."""
    file = read(path)
    return {
        number: [_stored(file, number, place, primitive) for place, primitive in enumerate(primitives)]
        for number, primitives in meshes_of(path).items()
    }


def arrays(file: GltfFile, mesh: int, primitive: int) -> SkinnedPrimitive:
    """Return one primitive as the independent reader reads it."""
    joints, weights = file.influences(mesh, primitive)
    has_tangent = file.has_attribute("TANGENT", mesh, primitive)
    return SkinnedPrimitive(
        file.attribute("POSITION", mesh, primitive),
        file.attribute("NORMAL", mesh, primitive),
        file.attribute("TANGENT", mesh, primitive) if has_tangent else None,
        joints.astype(np.int64),
        weights,
        file.triangles(mesh, primitive),
    )


def _stored(file: GltfFile, mesh: int, primitive: int, found: SkinnedPrimitive) -> StoredPrimitive:
    sets = found.joints.shape[1] // 4
    alpha, beta = (
        np.concatenate(
            [file.attribute(f"_SKINBAKE_{name}_{number}", mesh, primitive) for number in range(sets)], axis=1
        )
        for name in ("ALPHA", "BETA")
    )
    accessors = file.content["accessors"]
    first = accessors[file.primitive(mesh, primitive)["attributes"]["_SKINBAKE_ALPHA_0"]]
    extras = file.primitive(mesh, primitive).get("extras")
    # Extras that are not an object stay; the note is then in the first α's accessor (file-format.md).
    note = extras if isinstance(extras, dict) and "skinbake" in extras else first["extras"]
    return StoredPrimitive(found, alpha, beta, note["skinbake"]["frame"])


def bake_one(
    primitive: SkinnedPrimitive, settings: BakeSettings | None = None
) -> tuple[BakedPrimitive, BakeFindings]:
    """Bake a mesh of one primitive."""
    [result] = bake_primitives([primitive], settings or bake_settings())
    return result


def by_joint(
    primitive: SkinnedPrimitive, baked: BakedPrimitive, joint_count: int
) -> tuple[Float64Array, Float64Array]:
    """Return α and β by joint, (V, J) each, slot 0's as minus the sum of the others.

    So whatever depends on the order of slots is gone. A slot without a joint of its own holds 0.
    """
    named = np.where(baked.adopted_joints >= 0, baked.adopted_joints, primitive.joints)
    rows = np.repeat(np.arange(len(named)), named.shape[1])
    result = []
    for values in (baked.alpha.astype(np.float64), baked.beta.astype(np.float64)):
        slots = np.concatenate([-values.sum(axis=1, keepdims=True), values], axis=1)
        table = np.zeros((len(named), joint_count))
        np.add.at(table, (rows, named.ravel()), slots.ravel())
        result.append(table)
    return result[0], result[1]


def shuffled(
    primitive: SkinnedPrimitive, seed: int
) -> tuple[SkinnedPrimitive, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the primitive with vertices, triangles and each triangle's first corner in random order.

    Besides, the permutation of vertices (new → old), and of triangles.
    """
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(primitive.positions))
    faces = rng.permutation(len(primitive.triangles))
    turns = rng.integers(3, size=len(faces))
    turned = primitive.triangles[faces[:, None], (np.arange(3) + turns[:, None]) % 3]
    moved = SkinnedPrimitive(
        primitive.positions[order],
        primitive.normals[order],
        None if primitive.tangents is None else primitive.tangents[order],
        primitive.joints[order],
        primitive.weights[order],
        np.argsort(order)[turned],
    )
    return moved, order, faces


def reslotted(primitive: SkinnedPrimitive, seed: int) -> SkinnedPrimitive:
    """Return the primitive with the slots of every vertex in an order of its own."""
    rng = np.random.default_rng(seed)
    order = rng.permuted(np.tile(np.arange(primitive.joints.shape[1]), (len(primitive.joints), 1)), axis=1)
    return replace(
        primitive,
        joints=np.take_along_axis(primitive.joints, order, axis=1),
        weights=np.take_along_axis(primitive.weights, order, axis=1),
    )


def joint_count(primitives: Sequence[SkinnedPrimitive]) -> int:
    """Return one more than the largest joint index in any slot."""
    return 1 + max(int(primitive.joints.max()) for primitive in primitives)
