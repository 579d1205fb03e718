"""Baked characters in a pose: what the browser is told of them, and what the replay makes of them.

Arrays are read by the tests' own reader, joint matrices come from skinbake's animation; three.js has its
loader and its mixer.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Baseline, Frame
from skinbake.format.encodings import GradientFormat
from skinbake.geometry import frames
from skinbake.geometry.poses import random_rotations
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import clip_poses, read_clips
from skinbake.gltf.reading.skins import random_poses, read_skeleton
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.support import gltf_reading
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.replay import replay

Array = npt.NDArray[np.float64]
JsonObject = dict[str, Any]

IDENTITY: Array = np.eye(4)
AS_USUAL = GradientFormat()


@dataclass(frozen=True)
class Pose:
    """A time of a clip, or with clip None every joint turned at random by up to ``angle`` radians."""

    clip: int | None = 0
    time: float = 0.0
    angle: float = 0.9
    seed: int = 5


@dataclass(frozen=True)
class Placement:
    """Where three.js has the mesh: the scene's root R, the bind matrix X, and the mesh's world matrix W."""

    root: Array = field(default_factory=lambda: IDENTITY)
    bind: Array = field(default_factory=lambda: IDENTITY)
    world: Array = field(default_factory=lambda: IDENTITY)


@dataclass(frozen=True)
class Normals:
    """Unit vectors (V, 3) in the world, that of TANGENT only where there is one."""

    normals: Array
    tangents: Array | None


class Character:
    """A baked file of one mesh of one primitive, at rest or morphed, and its joints in one pose.

    Slots without weight may name joints that do not exist, as exporters write them.
    """

    def __init__(self, path: Path, pose: Pose, morphs: tuple[float, ...] = ()) -> None:
        self.path, self.morphs = path, morphs
        file = gltf_reading.read(path)
        normals = frames.unit_normals(file.attribute("NORMAL"))
        metadata = file.primitive(0)["extras"]["skinbake"]
        self.tangents = file.attribute("TANGENT") if file.has_attribute("TANGENT") else None
        self.frame = Frame(metadata["frame"])
        if self.frame == Frame.NORMAL:
            tangents, bitangents = frames.frame_from_normal(normals)
        else:
            assert self.tangents is not None
            tangents, bitangents = (
                part.astype(np.float32) for part in frames.frame_from_tangent(normals, self.tangents)
            )
        self.joints, self.pose = _posed(path, pose)
        joints, weights = file.influences()
        alpha, beta = _gradients(file, metadata)
        self.rest = RestPrimitive(
            positions=file.attribute("POSITION"),
            normals=normals,
            tangents=tangents,
            bitangents=bitangents,
            joints=np.where(joints < len(self.joints), joints, 0),
            weights=_normalized(weights),
            alpha=alpha,
            beta=beta,
        )
        self._along = self._tangents_in_frame()
        self.unmorphed = self.rest
        self.triangles = file.triangles()
        self._morph(file)

    def _tangents_in_frame(self) -> Array | None:
        """The weight gradients' share along TANGENT: what α and β would be for it, (2, V)."""
        if self.tangents is None:
            return None
        directions = (self.rest.tangents, self.rest.bitangents)
        square = np.einsum("vi,vi->v", self.rest.tangents, self.rest.tangents)
        return np.array([np.einsum("vi,vi->v", self.tangents[:, :3], d) / square for d in directions])

    def _morph(self, file: gltf_reading.GltfFile) -> None:
        """Move positions and normals by the morph targets, and turn the frame with the normal."""
        if not self.morphs:
            return
        targets = file.primitive(0)["targets"]
        positions, normals = (
            base
            + sum(w * file.values(t[name]) for w, t in zip(self.morphs, targets, strict=True) if name in t)
            for base, name in ((self.rest.positions, "POSITION"), (file.attribute("NORMAL"), "NORMAL"))
        )
        normals = unit(normals)
        turn = smallest_rotations(self.rest.normals.astype(np.float64), normals)
        tangents, bitangents = (
            np.einsum("vij,vj->vi", turn, part) for part in (self.rest.tangents, self.rest.bitangents)
        )
        self.rest = replace(
            self.rest, positions=positions, normals=normals, tangents=tangents, bitangents=bitangents
        )

    def told(self, placement: Placement) -> JsonObject:
        """Return what page.mjs needs to draw it."""
        told: JsonObject = {"url": f"/models/{self.path.name}", "pose": self.pose}
        told |= {"morphs": list(self.morphs)} if self.morphs else {}
        for name, matrix in (("root", placement.root), ("bind", placement.bind)):
            if matrix is not IDENTITY:
                told[name] = column_by_column(matrix)
        return told

    def matrices(self, placement: Placement) -> Array:
        """Return the joint matrices (J, 4, 4) in mesh space, W⁻¹ R joint X."""
        return np.asarray(
            np.linalg.inv(placement.world) @ placement.root @ self.joints @ placement.bind, np.float64
        )

    def positions(self, placement: Placement, algorithm: Algorithm = Algorithm.LBS_ACCURATE) -> Array:
        """Return the skinned positions (V, 3) in the world."""
        posed = replay(algorithm, self.rest, self.matrices(placement)[None])
        return np.asarray(posed.positions[0] @ placement.world[:3, :3].T + placement.world[:3, 3])

    def expected(
        self,
        algorithm: Algorithm,
        placement: Placement,
        *,
        cap: float | None = None,
        baseline: Baseline = Baseline.BLENDED,
    ) -> Normals:
        """Return the normals that an algorithm gives in the world, and the images of TANGENT."""
        posed = replay(algorithm, self.rest, self.matrices(placement)[None], cap=cap, baseline=baseline)
        normals = unit(posed.normals[0] @ np.linalg.inv(placement.world[:3, :3]))
        if self._along is None:
            return Normals(normals, None)
        a, b = self._along[:, :, None]
        images = a * posed.tangents[0] + b * posed.bitangents[0]
        return Normals(normals, unit(images @ placement.world[:3, :3].T))

    def expected_anew(self, placement: Placement) -> Array:
        """Return the normals of a frame derived from the morphed normal, which is not the one of α and β."""
        tangents, bitangents = frames.frame_from_normal(self.rest.normals.astype(np.float32))
        rest = replace(self.rest, tangents=tangents, bitangents=bitangents)
        posed = replay(Algorithm.LBS_ACCURATE, rest, self.matrices(placement)[None])
        return unit(posed.normals[0] @ np.linalg.inv(placement.world[:3, :3]))


def _normalized(weights: Array) -> Array:
    """Return weights (V, K) whose sums are 1: slot 0 has all where a file gives none, as in three.js."""
    sums = weights.sum(axis=1, keepdims=True)
    first = np.eye(1, weights.shape[1])
    return np.asarray(np.divide(weights, sums, out=np.repeat(first, len(weights), 0), where=sums > 0))


def _gradients(file: gltf_reading.GltfFile, metadata: JsonObject) -> tuple[Array, Array]:
    """Return α and β of all slots but the first, (V, K - 1) each, decoded (docs/reference/file-format.md)."""
    if metadata.get("layout") == "texcoord":
        names = dict.fromkeys([*metadata["alpha"], *metadata["beta"]])
        row = np.hstack([file.attribute(name) for name in names])
        return row[:, : row.shape[1] // 2], row[:, row.shape[1] // 2 :]
    return _decoded(file, metadata, "alpha"), _decoded(file, metadata, "beta")


def _decoded(file: gltf_reading.GltfFile, metadata: JsonObject, kind: str) -> Array:
    first, *further = (file.attribute(name) for name in metadata[kind])
    if "encoding" not in metadata:
        return np.hstack([first, *further])
    return np.asarray(np.hstack([first[:, :3], *further]) * first[:, 3:] ** 2 * metadata["scale"])


def _posed(path: Path, pose: Pose) -> tuple[Array, JsonObject]:
    """Return the joints' matrices (J, 4, 4) in the scene, and the pose in the page's words."""
    document = read_document(str(path))
    skeleton = read_skeleton(document, 0)
    if pose.clip is not None:
        clip = read_clips(document)[pose.clip]
        joints = clip_poses(skeleton, clip, np.array([pose.time]))[0]
        return joints, {"clip": pose.clip, "time": pose.time}
    joints = random_poses(skeleton, 1, angle=pose.angle, seed=pose.seed)[0]
    turned = random_rotations((len(skeleton.joints), 1), pose.angle, pose.seed)[:, 0]
    return joints, {"turned": turned.tolist()}


def baked(source: Path, folder: Path, frame: str = "auto", storage: GradientFormat = AS_USUAL) -> Path:
    """Bake a file into a folder, frame and storage in its name, and return what was written."""
    target = folder / f"{source.stem}-{frame}-{storage.encoding}-{storage.layout}.glb"
    if not target.exists():
        result = bake_file(source, target, frame=frame, storage=storage)
        assert result.status == "baked", result.notices
    return target


def by_numbers(
    source: Path,
    folder: Path,
    numbers: int,
    frame: str,
    weights: tuple[float, float] = (0.7, -0.4),
    pose: Pose | None = None,
    normals: int = 0,
) -> tuple[Character, Character, npt.NDArray[np.bool_]]:
    """Bake a file of two targets with so many numbers of the differential, and morph it, in any pose.

    Of targets with six numbers, so many keep NORMAL.

    Return the character with the frame that docs/reference/frame.md says, the same by NORMAL, and (V,) where
    the frame turns little enough for four numbers.
    """
    file, pose = Editable(source), pose or Pose(clip=None)
    for one in file.primitive()["targets"][normals:] if numbers == 6 else ():
        del one["NORMAL"]
    path = folder / f"numbers-{numbers}-{normals}-{frame}.glb"
    made = bake_file(file.write(path), path, frame=frame, morph_frames=True)
    assert made.morphs[0][1].frames == numbers
    plain, character = (Character(path, pose, morphs) for morphs in ((), weights))
    read = gltf_reading.read(path)

    def total(name: str) -> Array:
        targets = read.primitive(0)["targets"]
        return np.asarray(sum(w * read.values(one[name]) for w, one in zip(weights, targets, strict=True)))

    t0, b0, n0 = plain.rest.tangents, plain.rest.bitangents, plain.rest.normals
    m = total("_SKINBAKE_MORPH")
    t, b = t0 + m[:, :1] * t0 + m[:, 1:2] * b0, b0 + m[:, 2:3] * t0 + m[:, 3:] * b0
    clear, n = np.ones(len(t), dtype=np.bool_), character.rest.normals
    if numbers == 6:
        up = total("_SKINBAKE_MORPH_UP")
        t, b = t + up[:, :1] * n0, b + up[:, 1:] * n0
        side = np.sign(np.einsum("vi,vi->v", np.cross(t0, b0), n0))[:, None]
        n = unit(side * np.cross(t, b))
    else:
        cosine = np.einsum("vi,vi->v", n, n0)[:, None]
        t, b = (v - n0 * np.einsum("vi,vi->v", v, n)[:, None] / cosine for v in (t, b))
        clear = np.abs(cosine[:, 0]) > 0.25
    assert clear.mean() > 0.5
    by_rule = Character(path, pose, weights)
    character.rest = replace(character.rest, tangents=t, bitangents=b, normals=n)
    return character, by_rule, clear


def with_scaled_joints(folder: Path, source: Path) -> Path:
    """Scale two joints unevenly, of which one carries the other. So the second one shears, too."""
    file = Editable(source)
    joints = file.content["skins"][0]["joints"]
    for joint, scale in zip(joints[:2], ([1.4, 0.8, 1.0], [0.9, 1.0, 1.3]), strict=True):
        file.content["nodes"][joint]["scale"] = scale
    return file.write(folder / f"{source.stem}-scaled.glb")


def unit(vectors: npt.NDArray[Any]) -> Array:
    """Return vectors (V, 3) divided by their lengths."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float64)


def angles(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> Array:
    """Return the angles (…) between vectors (…, 3), in degrees."""
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("...i,...i->...", one, other))))


def smallest_rotations(before: Array, after: Array) -> Array:
    """Return the rotations (V, 3, 3) of least angle between unit vectors, by axis and angle (Rodrigues)."""
    axes = np.cross(before, after)
    sine = np.linalg.norm(axes, axis=1)
    cosine = np.einsum("vi,vi->v", before, after)
    x, y, z = np.divide(axes, sine[:, None], out=np.zeros_like(axes), where=sine[:, None] > 0).T
    zero = np.zeros_like(x)
    crosses = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    return np.asarray(
        np.eye(3) + sine[:, None, None] * crosses + (1 - cosine)[:, None, None] * (crosses @ crosses)
    )


def column_by_column(matrix: Array) -> list[float]:
    """Return a matrix (4, 4) as three.js stores it."""
    return [float(value) for value in matrix.T.ravel()]
