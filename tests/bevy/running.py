"""Run the Bevy targets' vertex stages on arrays: as compute shaders, with stand-ins for Bevy's modules."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Frame, Language, Lighting
from skinbake.geometry.frames import frame_from_normal, frame_from_tangent
from skinbake.geometry.morphs import Differences, MorphTarget, MorphTargets
from skinbake.shaders.choices import ShaderChoices
from skinbake.skinning.rest import RestPrimitive
from tests.bevy.compose import compose
from tests.bevy.link import link
from tests.support import gltf_reading
from tests.support.characters import Character, Pose
from tests.support.webgpu import NAGA, Job, answers
from tests.support.whole_fields import shader_text

Single = npt.NDArray[np.float32]
Wide = npt.NDArray[np.float64]

WESL = "bevy-wesl"
"""The target for Bevy 0.20."""

VERTICES, JOINTS, SKIN_INDEX, FIRST_VERTEX = 192, 7, 3, 5
"""The matrices of another skin and the vertices of another mesh come first in Bevy's buffers."""
PLAIN = ("VERTEX_POSITIONS", "VERTEX_NORMALS", "VERTEX_TANGENTS", "SKINNED")
BAKED = (*PLAIN, "SKINBAKE")


@dataclass(frozen=True)
class Scene:
    """Vertices (V, …) and joint matrices (J, 4, 4), all float32.

    alpha and beta (V, 3) are what they mean. Where a file has them otherwise, stored (2, V, 4) is what a
    vertex buffer of its normalised integers gives.
    """

    positions: Single
    normals: Single
    tangents: Single
    joints: npt.NDArray[np.uint32]
    weights: Single
    alpha: Single
    beta: Single
    matrices: Single
    stored: Single | None = None

    def rest(self, frame: str) -> RestPrimitive:
        """The same as a replay takes it, in the frame of TANGENT or of NORMAL."""
        tangents, bitangents = (
            frame_from_tangent(self.normals, self.tangents)
            if frame == Frame.TANGENT
            else frame_from_normal(self.normals)
        )
        return RestPrimitive(
            self.positions,
            self.normals,
            tangents,
            bitangents,
            self.joints.astype(np.int64),
            self.weights,
            self.alpha,
            self.beta,
        )


@dataclass(frozen=True)
class Seen:
    """The outputs of the vertex stage: positions (V, 4), unit normals (V, 3), tangents (V, 4)."""

    positions: Single
    normals: Single
    tangents: Single


@dataclass(frozen=True)
class Morph:
    """Deltas (targets, V, 3) of position, normal and tangent, and the targets' weights."""

    positions: Single
    normals: Single
    tangents: Single
    weights: Single

    def buffers(self) -> tuple[bytes, ...]:
        """Return weights, deltas and descriptors as the stand-in of bevy_pbr::morph lays them out."""
        padded = [np.pad(deltas, ((0, 0), (0, 0), (0, 1))) for deltas in self._deltas()]
        targets = np.stack(padded, axis=2).astype(np.float32)
        descriptors = np.array([[9, 9], [len(self.weights), targets.shape[1]]], np.uint32)
        return self.weights.tobytes(), targets.tobytes(), descriptors.tobytes()

    def applied(self, scene: Scene) -> Scene:
        """Return the scene with the deltas added; normals and tangents are not of unit length then."""
        position, normal, tangent = (
            np.tensordot(self.weights, deltas, axes=1).astype(np.float32) for deltas in self._deltas()
        )
        return replace(
            scene,
            positions=scene.positions + position,
            normals=scene.normals + normal,
            tangents=scene.tangents + np.pad(tangent, ((0, 0), (0, 1))),
        )

    def targets(self, *, with_tangents: bool) -> MorphTargets:
        """Return the same as a replay takes it."""
        each = [MorphTarget(*map(Differences.of, deltas)) for deltas in zip(*self._deltas(), strict=True)]
        return MorphTargets(tuple(each), with_tangents)

    def _deltas(self) -> tuple[Single, Single, Single]:
        return self.positions, self.normals, self.tangents


@dataclass(frozen=True)
class Case:
    """A run: a text, a scene, the definitions that Bevy and the Rust lines set, and morph targets."""

    choices: ShaderChoices
    given: Scene
    defines: tuple[str, ...] = BAKED
    deltas: Morph | None = None

    @property
    def all_defines(self) -> tuple[str, ...]:
        """The definitions, with the one that Bevy sets for morph targets."""
        return (*self.defines, "MORPH_TARGETS") if self.deltas else self.defines


def scene(*, mirrored: bool = False, influences: int = 4, seed: int = 5) -> Scene:
    """Return random vertices under random joints: rotated, sheared, scaled, and half of them mirrored."""
    rng = np.random.default_rng(seed)
    normals = _unit(rng.normal(size=(VERTICES, 3)))
    tangents = _unit(np.cross(normals, rng.normal(size=(VERTICES, 3))))
    handedness = rng.choice([-1.0, 1.0], size=(VERTICES, 1))
    weights = rng.uniform(size=(VERTICES, 4))
    weights[:, influences:] = 0.0
    matrices = np.tile(np.eye(4), (JOINTS, 1, 1))
    matrices[:, :3, :3] = np.linalg.qr(rng.normal(size=(JOINTS, 3, 3)))[0]
    matrices[:, :3, 0] *= np.sign(np.linalg.det(matrices))[:, None]
    matrices[:, :3, :3] += rng.uniform(-0.2, 0.2, size=(JOINTS, 3, 3))
    matrices[:, :3, 3] = rng.uniform(-1, 1, size=(JOINTS, 3))
    if mirrored:
        matrices[::2, :3, 0] *= -1.0
    slopes = rng.normal(size=(2, VERTICES, 3))
    slopes[:, :, influences - 1 :] = 0.0
    return Scene(
        positions=rng.uniform(-1, 1, size=(VERTICES, 3)).astype(np.float32),
        normals=normals.astype(np.float32),
        tangents=np.hstack([tangents, handedness]).astype(np.float32),
        joints=np.argsort(rng.uniform(size=(VERTICES, JOINTS)))[:, :4].astype(np.uint32),
        weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        alpha=slopes[0].astype(np.float32),
        beta=slopes[1].astype(np.float32),
        matrices=matrices.astype(np.float32),
    )


def character(path: Path, pose: Pose) -> Scene:
    """Return VERTICES of a baked character in a pose, spread over all of it."""
    found = Character(path, pose)
    file = gltf_reading.read(path)
    metadata = file.primitive(0)["extras"]["skinbake"]
    rows = np.linspace(0, len(found.rest.positions) - 1, VERTICES).astype(int)
    integers = [file.attribute(metadata[kind][0])[rows] for kind in ("alpha", "beta")]

    def chosen(array: npt.NDArray[Any]) -> Single:
        return np.asarray(array[rows], np.float32)

    rest = found.rest
    return Scene(
        positions=chosen(rest.positions),
        normals=chosen(rest.normals),
        tangents=np.pad(chosen(rest.tangents), ((0, 0), (0, 1)), constant_values=1.0),
        joints=rest.joints[rows].astype(np.uint32),
        weights=chosen(rest.weights),
        alpha=chosen(rest.alpha),
        beta=chosen(rest.beta),
        matrices=found.joints.astype(np.float32),
        stored=np.array(integers, np.float32) if "encoding" in metadata else None,
    )


def morph(targets: int = 2, seed: int = 8) -> Morph:
    """Return random deltas that bend normals by up to some 40°."""
    rng = np.random.default_rng(seed)
    deltas = (0.4 * rng.normal(size=(3, targets, VERTICES, 3))).astype(np.float32)
    return Morph(deltas[0], deltas[1], deltas[2], np.array([0.7, 0.0, 0.4][:targets], np.float32))


def run(cases: Mapping[str, Case]) -> dict[str, Seen]:
    """Skin every scene by the target's own vertex function; raise RuntimeError where one does not compile."""
    wgsl = plain_wgsl({name: (case.choices, case.all_defines) for name, case in cases.items()})
    found = answers(NAGA, {name: _job(case, wgsl[name]) for name, case in cases.items()})
    if complaints := [answer.complaint for answer in found.values() if answer.complaint]:
        raise RuntimeError(complaints[0])
    rows = {name: np.frombuffer(answer.results, np.float32) for name, answer in found.items()}
    shaped = {name: row.reshape(VERTICES, 3, 4) for name, row in rows.items()}
    return {name: Seen(row[:, 0], row[:, 1, :3], row[:, 2]) for name, row in shaped.items()}


def plain_wgsl(shaders: Mapping[str, tuple[ShaderChoices, tuple[str, ...]]]) -> dict[str, str]:
    """Return each shader under its definitions, with the stand-ins of its target for what it imports."""
    texts = {name: (shader_text(choices), defines) for name, (choices, defines) in shaders.items()}
    wesl = {name for name, (choices, _) in shaders.items() if choices.target == WESL}
    linked = link({name: texts[name] for name in texts if name in wesl})
    return linked | {name: compose(*texts[name]) for name in texts if name not in wesl}


def _job(case: Case, text: str) -> Job:
    width = (3 if case.given.stored is None else 4) if "SKINBAKE" in case.defines else 0
    call = _call(width, case.deltas is not None, case.choices.target)
    code = _as_compute(text, call, case.deltas is not None)
    other_skin = np.full((SKIN_INDEX, 4, 4), np.nan, np.float32)
    matrices = np.concatenate([other_skin, case.given.matrices]).transpose(0, 2, 1)
    buffers = [_columns(case.given), _meshes(), matrices.tobytes()]
    buffers += case.deltas.buffers() if case.deltas else ()
    return Job(code, tuple(buffers), VERTICES * 12 * 4, VERTICES // 64)


def jacobians(rest: RestPrimitive, matrices: Single) -> Wide:
    """Return the Jacobian Σ w M + Σ (M p) ∇wᵀ of every vertex's skinned position, (V, 3, 3)."""
    chosen = matrices.astype(np.float64)[rest.joints]
    moved = np.einsum("vsij,vj->vsi", chosen[..., :3, :3], rest.positions) + chosen[..., :3, 3]
    blended = np.einsum("vs,vsij->vij", rest.weights, chosen[..., :3, :3])
    return np.asarray(blended + np.einsum("vsi,vsj->vij", moved, rest.weight_gradients()))


def chosen(frame: str, lighting: Lighting = Lighting.ACCURATE, **more: Any) -> ShaderChoices:
    """Return choices of the target for Bevy 0.19, or of another one."""
    options = {"language": Language.WGSL, "target": "bevy", "frame": frame, "lighting": lighting}
    return ShaderChoices(**{**options, **more})


def _columns(given: Scene) -> bytes:
    columns = [
        np.pad(array, ((0, 0), (0, 4 - array.shape[1])))
        for array in (given.positions, given.normals, given.tangents)
    ]
    columns += [given.joints.view(np.float32), given.weights]
    if given.stored is None:
        columns += [np.pad(array, ((0, 0), (0, 1))) for array in (given.alpha, given.beta)]
    else:
        columns += list(given.stored)
    return np.stack(columns, axis=1).astype(np.float32).tobytes()


def _meshes() -> bytes:
    """Two instances of the stand-in's struct Mesh; the vertices belong to the second, on a node far away."""
    words = np.zeros((2, 28), np.uint32)
    words[1, :12] = np.array([1, 0, 0, 50, 0, 1, 0, 60, 0, 0, 1, 70], np.float32).view(np.uint32)
    words[1, 20:] = [0, 0, FIRST_VERTEX, SKIN_INDEX, 1, 0, 0, 0]
    return words.tobytes()


def _call(width: int, morphed: bool, target: str) -> str:
    """Return the call of the vertex function for one vertex.

    α and β are of ``width`` numbers in a vertex buffer; 0: there are none.
    """
    members = ["1u", "row[0].xyz", "row[1].xyz", "row[2]", "bitcast<vec4<u32>>(row[3])", "row[4]"]
    baked = [f"row[{column}].{'xyzw'[:width]}" for column in (5, 6) if width]
    index = [f"id.x + {FIRST_VERTEX}u"] if morphed else []
    if target == WESL:
        vertex = f"Vertex({', '.join([*members, *index])})"
        return f"vertex({', '.join([vertex, *baked])})"
    return f"vertex(Vertex({', '.join([*members, *baked, *index])}))"


def _as_compute(text: str, call: str, morphed: bool) -> str:
    """Turn the vertex stage into a function, and call it for one vertex an invocation."""
    for binding, (group, name) in enumerate(
        [("0", "mesh"), ("1", "joint_matrices"), ("2", "morph_weights"), ("3", "morph_targets"), ("8", "")]
    ):
        text = text.replace(f"@group(2) @binding({group}) ", f"@group(0) @binding({binding + 1}) ")
        assert not name or not morphed or name in text
    body = f"""
@group(0) @binding(0) var<storage> rows: array<array<vec4<f32>, 7>>;
@group(0) @binding({6 if morphed else 3}) var<storage, read_write> results: array<array<vec4<f32>, 3>>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
    let row = rows[id.x];
    let out = {call};
    results[id.x][0] = out.world_position;
    results[id.x][1] = vec4<f32>(out.world_normal, 0.0);
    results[id.x][2] = out.world_tangent;
}}
"""
    # A function that is called has no locations.
    text = re.sub(r"@location\(1[45]\) (?=skinbake_)", "", text)
    return re.sub(r"^@vertex\s", "", text, flags=re.MULTILINE) + body


def _unit(vectors: Wide) -> Wide:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
