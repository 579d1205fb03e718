"""Real characters in their own clips: what each way's normals, as the GPU computes them, are off by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.corpus_table import corpus_folders
from benchmarks.gpu.meshes import Mesh, Palettes, Wide
from benchmarks.gpu.passes import compute_pass, parts_of_instances
from benchmarks.gpu.records import ErrorRecord
from benchmarks.gpu.variants import Variant
from skinbake.choices import USUAL_TRUTHS, FrameChoice, Method, PoseKind, Truth
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.freshness.baked_views import baked_views, rest_primitive, whole_surfaces
from skinbake.freshness.expected import true_operator_of
from skinbake.geometry.dual_quaternions import rigid_motions
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.threads import Threads
from skinbake.truth.areas import RestAreas
from skinbake.truth.operator import GradientOperator
from skinbake.truth.poses import PoseRequest, draws_of, pose_set
from skinbake.truth.truths import Truths, truths_at_rest
from tests.support.replay import SkinnedSurface, replay
from tests.support.whole_fields import angular_errors, summarise

PATHS = ("CesiumMan/CesiumMan.glb", "Fox/fox.glb", "TRex/trex.gltf")
"""Characters of the corpus of one mesh, four influences a vertex, and rigid joints of one constant scale."""


@dataclass(frozen=True)
class Character:
    """A baked character in P poses: its surface, joint matrices (P, J, 4, 4), and areas (V,) as weights."""

    name: str
    rest: RestPrimitive
    operator: GradientOperator
    matrices: Wide
    areas: Wide

    @classmethod
    def of(cls, path: Path, samples: int | None = None) -> Character:
        """Bake a file in the normal frame, and sample its clips as ``skinbake verify`` does.

        A file without normals gets some, by the angles of its triangles.
        """
        with TemporaryDirectory() as folder:
            target = Path(folder) / f"{path.stem}.glb"
            options = BakeOptions(frame=FrameChoice.NORMAL, generate_normals=True)
            bake_file(str(path), str(target), options)
            document = read_document(str(target))
            views = baked_views(document, skinned_sources(document))
            ((view,),) = whole_surfaces(document, views)
            clips = read_clips(document)
            ((skin, node),) = draws_of(document, view.source.mesh, clips)
            poses = pose_set(document, skin, clips, PoseRequest(PoseKind.ANIMATION, samples), node)
            assert not list(document.notices)
            return cls(
                path.parent.name,
                rest_primitive(view),
                true_operator_of(document, [view]),
                poses.joint_matrices,
                RestAreas(document, skin).of(view.now),
            )

    @cached_property
    def mesh(self) -> Mesh:
        """The surface as the GPU gets it, float32."""
        rest = self.rest
        vectors = (rest.positions, rest.normals)
        positions, normals = (np.ascontiguousarray(values, np.float32) for values in vectors)
        weights, alpha, beta = (
            np.ascontiguousarray(values, np.float32) for values in (rest.weights, rest.alpha, rest.beta)
        )
        joints = rest.joints.astype(np.uint8)
        triangles, classes = self.operator.triangles, self.operator.classes
        return Mesh(positions, normals, joints, weights, alpha, beta, triangles, classes)

    @cached_property
    def palettes(self) -> Palettes:
        """The poses as the GPU gets them."""
        return Palettes.of(self.matrices, self._rigid.dual_quaternions.reshape(*self.matrices.shape[:2], 8))

    @cached_property
    def _rigid(self) -> Any:
        found = rigid_motions(self.matrices, in_use=self.rest.joints_in_use(self.matrices.shape[1]))
        assert found.is_rigid and np.ptp(found.scale) < 1e-4 * found.scale[0]
        return found

    def mesh_for(self, method: Method) -> Mesh:
        """Return the mesh in the unit in which a method skins it."""
        return self.mesh if method is Method.LBS else self.mesh.scaled(float(self._rigid.scale[0]))

    def replayed(self, algorithm: Algorithm) -> SkinnedSurface:
        """Return the surface in all poses, in float64."""
        return replay(algorithm, self.rest, self.matrices)

    @cached_property
    def truths(self) -> Truths:
        """Both true normals at rest."""
        return truths_at_rest(self.operator, [self.rest], len(self.matrices), None)


def corpus_characters(samples: int | None = None) -> Iterator[Character]:
    """Yield the characters that are here."""
    for folder in corpus_folders():
        for name in PATHS:
            if (path := folder / name).is_file():
                yield Character.of(path, samples)


def method_of(variant: Variant) -> Method:
    """Return the blending that moves the positions of a variant."""
    return Method.LBS if variant.choices is None else variant.choices.method


def gpu_normals(device: Any, variant: Variant, character: Character) -> Wide:
    """Return the normals (P, V, 3) that the variant's compute pass gives a character in all its poses."""
    parts = parts_of_instances(device, character.mesh_for(method_of(variant)), character.palettes)
    compute_pass(device, variant, parts)()
    found = np.concatenate([part.read("posed_frame")[..., :3] for part in parts])
    for part in parts:
        part.destroy()
    return found.astype(np.float64)


def true_normals(character: Character, method: Method) -> dict[Truth, tuple[Wide, Any]]:
    """Return by each truth the normals (P, V, 3) of the surface that a method moves, and where they exist."""
    algorithm = Algorithm.LBS_STANDARD if method is Method.LBS else Algorithm.DQS_STANDARD
    positions = character.replayed(algorithm).positions
    deformed = np.ascontiguousarray(np.transpose(positions, (2, 1, 0)), np.float64)
    truths, normals = character.truths, np.empty((len(USUAL_TRUTHS), *positions.shape))
    exist = np.empty(normals.shape[:-1], np.bool_)
    with Threads(1) as threads:
        sums = truths.sums(deformed, threads)
    for block in truths.vertex_blocks:
        found, sound = truths.normals(block.number, deformed, sums, None)
        normals[:, :, block.part] = np.transpose(found, (0, 3, 2, 1))
        exist[:, :, block.part] = np.swapaxes(sound, 1, 2)
    return {truth: (normals[number], exist[number]) for number, truth in enumerate(USUAL_TRUTHS)}


def measured_errors(device: Any, character: Character, variants: Sequence[Variant]) -> list[ErrorRecord]:
    """Return how far each variant's normals are from both truths, over all poses, weighted by rest area."""
    truths = {method: true_normals(character, method) for method in (Method.LBS, Method.DQS)}
    found = []
    for variant in variants:
        normals = gpu_normals(device, variant, character)
        for truth, (expected, exist) in truths[method_of(variant)].items():
            summary = summarise(angular_errors(normals, expected), character.areas, valid=exist)
            assert summary is not None
            figures = summary.mean, summary.p95
            found.append(ErrorRecord(character.name, len(normals), variant.name, str(truth), *figures))
    return found
