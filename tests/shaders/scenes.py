"""The inputs of the shaders: a surface that no artist would model, and baked characters in their own clips.

A scene is float32 throughout, so that the shader and every replay begin with the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from skinbake.choices import SLOTS_PER_SET, Frame, Method, PoseKind
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.geometry import frames
from skinbake.geometry.dual_quaternions import RigidMotions, rigid_motions, scaled_motions
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.shaders.choices import ShaderChoices
from skinbake.skinning.components import PosedVertex
from skinbake.skinning.normal_maps import engine_mapped_normal, in_frame, mapped_normal
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.truth.poses import PoseRequest, pose_set
from tests.shaders.combinations import ATTRIBUTES, TEXELS, columns
from tests.support import analytic, corpus
from tests.support.baking import bake_file
from tests.support.replay import SkinnedSurface, blended_replay, replay

Single = npt.NDArray[np.float32]
Wide = npt.NDArray[np.float64]

VERTICES, JOINTS = 300, 9
NARROW = (1.0, -1.0, 0.0)
"""Turned by about 180° round this axis, joints have real parts of either sign: two components tie."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Vertices at rest and P poses. K is at least the influences of the shaders that run on it.

    positions, normals (V, 3); tangents (V, 4), handedness last; joints, weights (V, K); alpha, beta
    (V, K − 1); matrices (P, J, 4, 4).
    """

    positions: Single
    normals: Single
    tangents: Single
    joints: npt.NDArray[np.int64]
    weights: Single
    alpha: Single
    beta: Single
    matrices: Single

    def rest(self, choices: ShaderChoices) -> RestPrimitive:
        """Return the surface as the replay takes it, in the frame of the choices."""
        count = choices.influences
        if choices.frame == Frame.NORMAL:
            tangents, bitangents = frames.frame_from_normal(self.normals)
        else:
            tangents, bitangents = (
                np.asarray(vectors, np.float32)
                for vectors in frames.frame_from_tangent(self.normals, self.tangents)
            )
        return RestPrimitive(
            self.positions,
            self.normals,
            tangents,
            bitangents,
            self.joints[:, :count],
            self.weights[:, :count],
            self.alpha[:, : count - 1],
            self.beta[:, : count - 1],
            blend=self.blend,
        )

    @property
    def blend(self) -> Single:
        """Return blend weights from 0 to 1, and derivatives as large as those of weights: (V, 3)."""
        rng = np.random.default_rng(len(self.positions))
        derivatives = rng.normal(scale=1.5, size=(len(self.positions), 2))
        return np.column_stack([rng.random(len(self.positions)), derivatives]).astype(np.float32)

    def texture_tangents(self, choices: ShaderChoices) -> Single:
        """Return TANGENT (V, 4), which a normal map follows. Beside a normal frame it leans by 11°."""
        if choices.frame == Frame.TANGENT:
            return self.tangents
        leaning = self.tangents.copy()
        leaning[:, :3] += 0.2 * self.normals
        return leaning

    def rigid(self, choices: ShaderChoices) -> RigidMotions:
        """Return the poses as a scale and dual quaternions."""
        in_use = self.rest(choices).joints_in_use(self.matrices.shape[1])
        return rigid_motions(self.matrices, in_use=in_use)

    def scale(self, choices: ShaderChoices) -> Wide:
        """Return the scale of each pose (P,) that is applied to p, t0 and b0 beforehand."""
        if choices.method is Method.DQS and not choices.scaled_joints:
            return self.rigid(choices).scale
        return np.ones(len(self.matrices))

    def posed(self, choices: ShaderChoices, dtype: npt.DTypeLike) -> Wide:
        """Return the replay's position, normal, tangent and bitangent: (P V, 4, 3), poses outermost.

        With a normal map, the last two are the mapped normals of TEXELS.
        """
        algorithm, rest = Algorithm(choices.algorithm), self.rest(choices)
        if choices.method is Method.BLEND:
            found = blended_replay(algorithm, rest, self.matrices, dtype=dtype, cap=choices.cap)
        else:
            found = replay(
                algorithm, rest, self.matrices, dtype=dtype, cap=choices.cap, normal_map=choices.normal_map
            )
        vectors = [getattr(found, f"{name}s").astype(np.float64) for name in ATTRIBUTES]
        if choices.normal_map:
            vectors[2:] = [self._mapped(choices, found, texel) for texel in TEXELS]
        if choices.mirrored_joints:
            sides = np.sign(np.linalg.det(self.matrices[:, :, :3, :3].astype(np.float64)))
            # A joint of scale 0 has no side: what it hides lies on that of the others, which share one.
            sides = np.where(sides == 0, sides[:, :1], sides)
            for number in range(1, 4 if choices.normal_map else 2):
                vectors[number] *= sides[:, self.joints[:, 0], None]
        return np.stack(vectors, axis=2).reshape(-1, 4, 3)

    def _mapped(self, choices: ShaderChoices, found: SkinnedSurface, texel: tuple[float, ...]) -> Wide:
        """Return mapped normals (P, V, 3) of a texture that follows TANGENT, whatever the frame is."""
        rest = self.rest(choices)
        t0, b0, n0 = (tuple(v.T.astype(np.float64)) for v in (rest.tangents, rest.bitangents, rest.normals))
        tangent = tuple(self.texture_tangents(choices).T.astype(np.float64))
        drawn = engine_mapped_normal(n0, tangent[:3], tangent[3], texel)
        assert found.cotangents is not None
        assert found.cobitangents is not None
        vectors = (found.normals, found.tangents, found.bitangents, found.cotangents, found.cobitangents)
        posed = PosedVertex((), *(tuple(np.moveaxis(one.astype(np.float64), 2, 0)) for one in vectors))
        scale = self.scale(choices)[:, None]
        length = scale * np.linalg.norm(rest.tangents.astype(np.float64), axis=1)
        return np.stack(mapped_normal(posed, length, in_frame(drawn, t0, b0, n0)), axis=2)

    def columns(self, choices: ShaderChoices) -> Single:
        """Return attributes as ``combinations.columns`` has them, each vertex in each pose: (P V, C, 4)."""
        poses, joint_count = self.matrices.shape[:2]
        scale = self.scale(choices)
        sets = choices.influence_sets
        found: dict[str, npt.NDArray[np.number]] = {
            "normal": self.normals,
            "tangent": self.texture_tangents(choices),
            "blend": self.blend,
        }
        width = SLOTS_PER_SET * sets
        weights = _wide(self.weights[:, : choices.influences], width)
        # Slots beyond the last influence hold what no shader may read.
        weights[:, choices.influences :] = np.nan
        for name, values in (("weights", weights), *self._gradients(choices, width)):
            for number in range(sets):
                found[f"{name}_{number}"] = values[:, SLOTS_PER_SET * number :][:, :SLOTS_PER_SET]
        result = np.zeros((poses, len(self.positions), len(columns(choices)), 4), np.float32)
        joints = _wide(self.joints[:, : choices.influences], width)
        for pose in range(poses):
            found["point"] = np.column_stack([self.positions, np.full(len(self.positions), scale[pose])])
            for number in range(sets):
                chosen = joints[:, SLOTS_PER_SET * number :][:, :SLOTS_PER_SET] + pose * joint_count
                found[f"joints_{number}"] = chosen.astype(np.uint32).view(np.float32)
            for number, column in enumerate(columns(choices)):
                result[pose, :, number, : column.size] = found[column.name][:, : column.size]
        return result.reshape(-1, *result.shape[2:])

    def _gradients(self, choices: ShaderChoices, width: int) -> list[tuple[str, Single]]:
        """Return α and β padded to whole sets, the first of them without slot 0 and moved up."""
        found = []
        for name, values in (("alpha", self.alpha), ("beta", self.beta)):
            padded = np.full((len(values), width), np.nan, np.float32)
            padded[:, 1 : choices.influences] = values[:, : choices.influences - 1]
            padded[:, :SLOTS_PER_SET] = np.roll(padded[:, :SLOTS_PER_SET], -1, axis=1)
            found.append((name, padded))
        return found

    def columns_of_matrices(self) -> Single:
        """Return all poses' joint matrices, column by column, (P J, 16)."""
        return np.swapaxes(self.matrices, 2, 3).reshape(-1, 16)

    def motions(self, choices: ShaderChoices) -> Single:
        """Return all poses' joint matrices (``columns_of_matrices``), or dual quaternions, (P J, 8).

        Of joints that scale: scaled motions (P J, 20). Every other quaternion is given as its negative, which
        is the same motion.
        """
        if choices.scaled_joints:
            found = np.swapaxes(scaled_motions(self.matrices), 2, 3).reshape(-1, 20)
            found[::2] *= np.where(found.reshape(-1, 5, 4)[::2, 4].any(axis=1, keepdims=True), -1, 1)
            return np.roll(found.reshape(-1, 5, 4), -1, axis=2).reshape(-1, 20).astype(np.float32)
        if choices.method is Method.LBS:
            return self.columns_of_matrices()
        found = self.rigid(choices).dual_quaternions.reshape(-1, 8)
        found[::2] *= -1
        return shader_order(found)


def shader_order(dual_quaternions: Wide) -> Single:
    """Return dual quaternions (…, 8), scalars first, as shaders have them: scalars last."""
    return dual_quaternions[..., [1, 2, 3, 0, 5, 6, 7, 4]].astype(np.float32)


def _wide(values: npt.NDArray[np.number], width: int) -> npt.NDArray[np.number]:
    padded = np.zeros((len(values), width), values.dtype)
    padded[:, : values.shape[1]] = values
    return padded


@cache
def irregular(influences: int, *, stretches: bool) -> Scene:
    """Return random vertices, no two alike, with random influences of JOINTS joints, in three or five poses.

    A fifth of the weights is 0, slot 0's too, and has a derivative all the same. α and β are those of joints
    that give way to each other within a third of the body. Frames of either hand; tangents not of length 1.
    Poses: bent; turned by 180° beforehand, so that equal rotations have opposite quaternions; a hundredth
    of the size. On demand also joints that stretch and shear, and joints that mirror.
    """
    rng = np.random.default_rng(influences)
    axes = np.linalg.qr(rng.normal(size=(VERTICES, 3, 3))).Q
    normals = frames.unit_normals(axes[:, 0])
    length = rng.uniform(0.8, 1.25, (VERTICES, 1))
    hand = rng.choice([-1.0, 1.0], (VERTICES, 1))
    weights = rng.random((VERTICES, influences)) * (rng.random((VERTICES, influences)) > 0.2)
    weights[~weights.any(axis=1), -1] = 1.0
    poses = [_bent(rng), _rotation(NARROW, 180.0) @ _bent(rng, 40.0), _scaled(0.01) @ _bent(rng)]
    if stretches:
        affine = np.tile(np.eye(4), (JOINTS, 1, 1))
        affine[:, :3, :3] += rng.uniform(-0.25, 0.25, (JOINTS, 3, 3))
        poses += [_bent(rng) @ affine, np.diag([-1.0, 1.0, 1.0, 1.0]) @ _bent(rng)]
    scene = Scene(
        rng.uniform(-1, 1, (VERTICES, 3)).astype(np.float32),
        normals,
        np.hstack([axes[:, 1] * length, hand]).astype(np.float32),
        rng.permuted(np.tile(np.arange(max(JOINTS, influences)), (VERTICES, 1)), axis=1)[:, :influences]
        % JOINTS,
        (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        rng.normal(scale=1.5, size=(VERTICES, influences - 1)).astype(np.float32),
        rng.normal(scale=1.5, size=(VERTICES, influences - 1)).astype(np.float32),
        np.array(poses).astype(np.float32),
    )
    for field in fields(scene):
        getattr(scene, field.name).flags.writeable = False  # all tests have the same one
    return scene


def with_hidden_joint(scene: Scene) -> Scene:
    """Return a scene with one more pose: the second, in which a joint has scale 0."""
    hidden = scene.matrices[1:2].copy()
    hidden[:, 1, :3, :3] = 0.0
    return replace(scene, matrices=np.concatenate([scene.matrices, hidden]))


def _bent(rng: np.random.Generator, degrees: float = 80.0) -> Wide:
    """Return JOINTS joints, each turned about a point of its own by up to ``degrees``, (J, 4, 4)."""
    found = []
    for axis, pivot, angle in zip(
        rng.normal(size=(JOINTS, 3)),
        rng.uniform(-1, 1, (JOINTS, 3)),
        rng.uniform(-degrees, degrees, JOINTS),
        strict=True,
    ):
        matrix = _rotation(axis, angle)
        matrix[:3, 3] = pivot - matrix[:3, :3] @ pivot
        found.append(matrix)
    return np.array(found)


def _rotation(axis: npt.ArrayLike, degrees: float) -> Wide:
    matrix = np.eye(4)
    matrix[:3, :3] = analytic.rotation_matrix(np.asarray(axis, np.float64), np.radians(degrees))
    return matrix


def _scaled(factor: float) -> Wide:
    return np.diag([factor, factor, factor, 1.0])


@dataclass(frozen=True, slots=True)
class Character:
    """A model of the corpus by its path, its frame when baked, its influences; or its stand-in."""

    path: str
    frame: Frame
    influences: int

    def scene(self, folder: Path, samples: int) -> Scene:
        """Bake the model into a folder and pose it ``samples`` times by its own clip; skip without it."""
        source = corpus.character(self.path)
        target = folder / f"{source.stem}.glb"
        bake_file(str(source), str(target))
        document = read_document(str(target))
        sources = skinned_sources(document)
        views = baked_views(document, sources)
        assert not list(document.notices)
        view = views[0]
        assert view.note.frame == self.frame
        rest = rest_primitive(view)
        assert rest.joints.shape[1] == self.influences
        skin = next(node["skin"] for node in document.objects("nodes") if "skin" in node)
        poses = pose_set(document, skin, read_clips(document), PoseRequest(PoseKind.ANIMATION, samples))
        assert poses.times[0] is not None
        tangents = view.now.tangents
        return Scene(
            rest.positions.astype(np.float32),
            rest.normals.astype(np.float32),
            np.zeros((len(rest.positions), 4), np.float32)
            if tangents is None
            else tangents.astype(np.float32),
            rest.joints.astype(np.int64),
            rest.weights.astype(np.float32),
            rest.alpha.astype(np.float32),
            rest.beta.astype(np.float32),
            poses.joint_matrices.astype(np.float32),
        )


CHARACTERS = (
    Character("CesiumMan/CesiumMan.glb", Frame.NORMAL, 4),
    Character("Butterfly/animated_butterfly.glb", Frame.TANGENT, 4),
    Character("pbrTest/pbrTest.gltf", Frame.TANGENT, 8),
)
"""Rigid all three, so that every algorithm applies; the butterfly's joints share a scale of 0.01."""
