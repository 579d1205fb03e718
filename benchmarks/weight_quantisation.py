"""Measure what weights stored in 8 and 16 bits do to accurate normals, and whether smoothing ∇w undoes it.

``python -m benchmarks.weight_quantisation [MODEL...] [--output FILE]``: characters with FLOAT weights; where
none is named, those of the corpus (SKINBAKE_CORPUS, or ../shared/corpus). Their weights are rounded here, and
baked as skinbake bakes them, but for the step under study: a denoiser gets the stored weights and returns the
gradients. The tables go to docs/weight_quantisation.md, under a text that is kept there.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from fixtures import make_fixtures
from skinbake.geometry import frames
from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray, SkinnedPrimitive
from skinbake.geometry.triangles import mark_proper, smooth_normals
from skinbake.gltf.animation import read_clips, skins_of
from skinbake.gltf.document import read_document
from skinbake.gltf.primitives import PrimitiveSource, read_primitive, reason_to_skip, skinned_sources
from skinbake.gradients.field import concatenate_fields
from skinbake.gradients.influences import weight_field
from skinbake.gradients.normals import with_smooth_normals
from skinbake.gradients.slots import assign, shared_capacity
from skinbake.gradients.weight_gradients import VertexGradients
from skinbake.gradients.weld import weld
from skinbake.lighting.influences import normalised_weights
from skinbake.lighting.metrics import vertex_areas
from skinbake.lighting.operator import gradient_operator
from skinbake.lighting.poses import PoseRequest, pose_set
from skinbake.lighting.rest_truth import rest_frames
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.rest import RestPrimitive
from tests.support.derivatives import derivatives
from tests.support.replay import replay
from tests.support.whole_fields import angular_errors, reference_normals, rest_frame, summarise

REPOSITORY = Path(__file__).resolve().parents[1]
DEFAULT_OUTPUT = REPOSITORY / "docs" / "weight_quantisation.md"
MARK = "<!-- benchmarks/weight_quantisation.py writes the rest of this page. -->\n"
CREASE_ANGLE = float(np.radians(15.0))
POSES = 8
CHARACTERS = (
    "CesiumMan/CesiumMan.glb",
    "Fox/fox.glb",
    "TRex/trex.gltf",
    "XRHand/hand_l.gltf",
    "Mannequiny/mannequiny-0.3.0.glb",
    "BaseFemale/BaseFemale.glb",
    "Barbarian/Barbarian.glb",
    "RiggedElf/RiggedElf.gltf",
    "pbrTest/pbrTest.gltf",
    "VRM/cryptovoxels.vrm",
    "Alien/Alien_Scolitex.gltf",
    "RobotMantis/animated_robot_mantis.glb",
    "Butterfly/animated_butterfly.glb",
    "RiggedFigure/RiggedFigure.gltf",
    "AFrameHands/leftHandLow.glb",
)
"""Below public/ of the corpus: those with FLOAT weights that blend and joints that move."""


class Surface:
    """Primitives that are baked together, as matrices.

    N points are vertices of equal position and influences; C classes are points split at hard edges.
    weights (N, J) are w / Σw; gradient is three sparse (C, N): the derivative along each axis.
    """

    def __init__(self, primitives: Sequence[SkinnedPrimitive]) -> None:
        self.primitives = list(primitives)
        self.fields = [weight_field(primitive)[0] for primitive in primitives]
        self.field = concatenate_fields(self.fields)
        positions = np.concatenate([primitive.positions for primitive in primitives])
        normals = np.concatenate([primitive.normals for primitive in primitives])
        self.starts = np.cumsum([0, *(len(primitive.positions) for primitive in primitives)])
        self.classes = weld(positions, normals, self.field, crease_angle=CREASE_ANGLE)
        self.points = weld(positions, normals, self.field, crease_angle=np.pi)
        self.operator = gradient_operator(primitives)
        self.areas = np.concatenate([vertex_areas(p.positions, p.triangles) for p in primitives])
        self.triangles = np.concatenate(
            [p.triangles + start for p, start in zip(primitives, self.starts, strict=False)]
        )
        first_of_point = np.unique(self.points, return_index=True)[1]
        self.first_of_class = np.unique(self.classes, return_index=True)[1]
        self.positions = positions[first_of_point].astype(np.float64)
        self.normals = frames.unit_normals(normals[self.first_of_class]).astype(np.float64)
        ones, rows = np.ones(len(positions)), np.arange(len(positions))
        to_points = sparse.csr_array((ones, (rows, self.points)))
        axes = derivatives(self.operator)
        self.gradient = [sparse.csr_array(axis[self.first_of_class] @ to_points) for axis in axes]
        self.weights = self._weights()[first_of_point]

    def _weights(self) -> Float64Array:
        joints = self.field.joints
        weights = np.zeros((len(joints), int(joints.max()) + 1))
        vertex, slot = np.nonzero(joints >= 0)
        weights[vertex, joints[vertex, slot]] = self.field.weights[vertex, slot]
        return weights

    def gradients(self, weights: Float64Array) -> Float64Array:
        """Return the gradient (C, J, 3) of weights (N, J)."""
        return np.stack([axis @ weights for axis in self.gradient], axis=2)

    def noise(self, quantum: float) -> Float64Array:
        """Return the standard deviation (C,) of a gradient whose weights are off by up to half a quantum."""
        squares = sum(np.asarray(axis.multiply(axis).sum(axis=1)).ravel() for axis in self.gradient)
        return np.asarray(quantum / np.sqrt(12.0) * np.sqrt(squares))

    def neighbours(self, labels: IntArray) -> sparse.csr_array:
        """Return the sparse 0/1 matrix of which labels an edge joins, each with itself."""
        ends = labels[
            np.concatenate([self.triangles[:, [0, 1]], self.triangles[:, [1, 2]], self.triangles[:, [2, 0]]])
        ]
        ends = np.concatenate([ends, ends[:, ::-1], np.stack([labels, labels], axis=1)])
        joined = sparse.csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])))
        joined.data[:] = 1.0
        return joined

    def laplacian(self) -> tuple[sparse.csr_array, Float64Array]:
        """Return the cotangent Laplacian of the points, its cotangents cut at ±20, and the points' areas."""
        corners = self.points[self.triangles]
        size = len(self.positions)
        total = sparse.csr_array((size, size))
        for turn in range(3):
            a, b, c = np.roll(corners, -turn, axis=1).T
            u, v = self.positions[b] - self.positions[a], self.positions[c] - self.positions[a]
            sine = np.maximum(np.linalg.norm(np.cross(u, v), axis=1), 1e-30)
            half = np.clip(np.einsum("ij,ij->i", u, v) / sine, -20, 20) / 2
            total = total + sparse.csr_array((half, (b, c)), shape=(size, size))
        total = total + total.T
        degree = np.asarray(total.sum(axis=1)).ravel()
        areas = np.bincount(self.points, self.areas, size)
        return sparse.csr_array(sparse.diags_array(degree) - total), np.maximum(areas, 1e-12 * areas.max())


Denoiser = Callable[[Surface, float], Float64Array]
"""From a surface with rounded weights, and their quantum, to gradients (C, J, 3)."""


def as_stored(surface: Surface, quantum: float) -> Float64Array:
    """Differentiate the stored weights: what bake does."""
    return surface.gradients(surface.weights)


def averaged(surface: Surface, quantum: float) -> Float64Array:
    """Average the gradients over the 1-ring, weighted by area."""
    areas = np.maximum(np.bincount(surface.classes, surface.areas), 1e-30)
    ring = sparse.csr_array(surface.neighbours(surface.classes) @ sparse.diags_array(areas))
    mean = sparse.diags_array(1.0 / np.asarray(ring.sum(axis=1)).ravel()) @ ring
    found = as_stored(surface, quantum)
    return np.asarray(mean @ found.reshape(len(found), -1)).reshape(found.shape)


def averaged_within_noise(surface: Surface, quantum: float) -> Float64Array:
    """Go towards the 1-ring's average by at most one standard deviation of the noise."""
    found = as_stored(surface, quantum)
    step = averaged(surface, quantum) - found
    length = np.maximum(np.linalg.norm(step, axis=2), 1e-300)
    return np.asarray(found + step * np.minimum(1.0, surface.noise(quantum)[:, None] / length)[:, :, None])


def wiener(surface: Surface, quantum: float) -> Float64Array:
    """Go towards the 1-ring's average, d away, by the share σ² / (σ² + d²)."""
    found = as_stored(surface, quantum)
    step = averaged(surface, quantum) - found
    variance = surface.noise(quantum)[:, None] ** 2
    share = variance / np.maximum(variance + (step**2).sum(axis=2), 1e-300)
    return np.asarray(found + step * share[:, :, None])


def shrunk(surface: Surface, quantum: float) -> Float64Array:
    """Shorten each gradient by the share of the noise in it; below the noise it is 0 (James and Stein)."""
    found = as_stored(surface, quantum)
    variance, squares = surface.noise(quantum)[:, None] ** 2, (found**2).sum(axis=2)
    share = np.divide(variance, squares, out=np.ones_like(squares), where=squares > variance)
    return np.asarray(found * (1.0 - share)[:, :, None])


def smoothest(order: int, *, hold_zeros: bool = False) -> Denoiser:
    """Differentiate the smoothest weights within half a quantum: least |∇w|² (order 1) or |Δw|² (order 2).

    With ``hold_zeros`` weights of exactly 0 and 1 stay. Accelerated projected gradient descent (Beck and
    Teboulle 2009), preconditioned by absolute row sums, 200 steps.
    """

    def denoise(surface: Surface, quantum: float) -> Float64Array:
        laplacian, areas = surface.laplacian()
        energy = laplacian if order == 1 else laplacian @ sparse.diags_array(1.0 / areas) @ laplacian
        scale = np.maximum(np.asarray(abs(energy).sum(axis=1)).ravel(), 1e-30)[:, None]
        stored = surface.weights
        slack = np.where((stored == 0) | (stored == 1), 0.0 if hold_zeros else quantum / 2, quantum / 2)
        low, high = np.maximum(stored - slack, 0.0), np.minimum(stored + slack, 1.0)
        found, ahead, momentum = stored, stored, 1.0
        for _ in range(200):
            following = np.clip(ahead - (energy @ ahead) / scale, low, high)
            grown = (1.0 + np.sqrt(1.0 + 4.0 * momentum**2)) / 2.0
            ahead = following + (momentum - 1.0) / grown * (following - found)
            found, momentum = following, grown
        return surface.gradients(found / found.sum(axis=1, keepdims=True))

    return denoise


def discrepancy(share: float) -> Denoiser:
    """Differentiate weights of least |w̃ − w|² + λ |Δw̃|², λ as large as leaves a residual of ``share`` noise.

    Morozov's principle: the root mean square residual over the weights between 0 and 1 is to be that of
    rounding, quantum / √12, times ``share``.
    """

    def denoise(surface: Surface, quantum: float) -> Float64Array:
        laplacian, areas = surface.laplacian()
        energy = laplacian @ sparse.diags_array(1.0 / areas) @ laplacian
        scale = np.asarray(abs(energy).sum(axis=1)).ravel()
        scale = np.maximum(scale, 1e-12 * np.median(scale))
        between = (surface.weights > 0) & (surface.weights < 1)
        found, low, high = surface.weights, -6.0, 6.0
        for _ in range(12 if between.any() else 0):
            middle = (low + high) / 2
            factor = splu(sparse.csc_matrix(sparse.diags_array(scale) + 10.0**middle * energy))
            tried = factor.solve(scale[:, None] * surface.weights)
            residual = np.sqrt(((tried - surface.weights)[between] ** 2).mean())
            if residual > share * quantum / np.sqrt(12.0):
                high = middle
            else:
                low, found = middle, tried
        return surface.gradients(found)

    return denoise


def fitted(surface: Surface, quantum: float) -> Float64Array:
    """Fit a quadratic to the weights over the 2-ring by least squares, and take its gradient."""
    found = as_stored(surface, quantum)
    ring = surface.neighbours(surface.points)
    ring = sparse.csr_array(ring @ ring)
    tangents, bitangents = frames.frame_from_normal(surface.normals.astype(np.float32))
    for number, point in enumerate(surface.points[surface.first_of_class]):
        near = ring.indices[ring.indptr[point] : ring.indptr[point + 1]]
        away = surface.positions[near] - surface.positions[point]
        axes = np.stack([tangents[number], bitangents[number]]).astype(np.float64)
        u, v = axes @ away.T
        reach = float(np.sqrt((u * u + v * v).max()))
        if len(near) < 8 or reach == 0.0:
            continue
        u, v = u / reach, v / reach
        columns = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
        nearness = np.exp(-(u * u + v * v))[:, None]
        active = np.flatnonzero(surface.weights[near].any(axis=0))
        values = surface.weights[near][:, active]
        solution = np.linalg.lstsq(columns * nearness, values * nearness, rcond=1e-6)[0]
        found[number, active] = solution[1:3].T @ axes / reach
    return found


DENOISERS: dict[str, Denoiser] = {
    "as stored": as_stored,
    "1-ring mean": averaged,
    "… within σ": averaged_within_noise,
    "… Wiener": wiener,
    "shrunk": shrunk,
    "least ∇w in ±q/2": smoothest(1),
    "least Δw in ±q/2": smoothest(2),
    "… zeros held": smoothest(2, hold_zeros=True),
    "Morozov, σ/2": discrepancy(0.5),
    "2-ring quadratic": fitted,
}


def rounded(primitive: SkinnedPrimitive, top: int) -> SkinnedPrimitive:
    """Return the primitive with w / Σw in steps of 1 / top; of a vertex's, the largest remainders go up."""
    exact = normalised_weights(primitive.weights, primitive.joints) * top
    floors = np.floor(exact)
    rank = np.argsort(np.argsort(floors - exact, axis=1, kind="stable"), axis=1, kind="stable")
    missing = np.rint(top - floors.sum(axis=1, keepdims=True))
    return primitive.with_influences(primitive.joints, (floors + (rank < missing)) / top)


def rest_primitives(surface: Surface, gradients: Float64Array) -> list[RestPrimitive]:
    """Return what a shader gets of gradients (C, J, 3): slots assigned and joints adopted as bake does."""
    lengths = np.linalg.norm(gradients, axis=2)
    owner, joint = np.nonzero(lengths > 1e-9 * lengths.max(initial=0.0))
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(gradients)))])
    sparse_ones = VertexGradients(offsets, joint.astype(np.int64), gradients[owner, joint])
    capacity = shared_capacity(surface.field, surface.classes)
    result = []
    for number, primitive in enumerate(surface.primitives):
        rows = slice(surface.starts[number], surface.starts[number + 1])
        frame = rest_frame(primitive, "auto")
        pair = (frame.tangents, frame.bitangents)
        slots = assign(sparse_ones, surface.classes[rows], surface.fields[number], pair, capacity[rows])
        named = np.where(slots.adopted >= 0, slots.adopted, primitive.joints)
        result.append(
            RestPrimitive(
                primitive.positions.astype(np.float64),
                frames.unit_normals(primitive.normals).astype(np.float64),
                frame.tangents.astype(np.float64),
                frame.bitangents.astype(np.float64),
                named,
                normalised_weights(primitive.weights, named),
                slots.alpha[:, 1:],
                slots.beta[:, 1:],
            )
        )
    return result


def posed(rest: Sequence[RestPrimitive], matrices: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return accurate normals and positions, (P, V, 3) each."""
    skinned = [replay(Algorithm.LBS_ACCURATE, part, matrices) for part in rest]
    return (
        np.concatenate([part.normals for part in skinned], axis=1).astype(np.float64),
        np.concatenate([part.positions for part in skinned], axis=1).astype(np.float64),
    )


@dataclass(frozen=True)
class Sample:
    """Angles (S,) in degrees and rest areas (S,) of some samples, invalid ones NaN."""

    angles: Float64Array
    areas: Float64Array


Samples = dict[str, list[Sample]]
TRUE, FLOOR = "true", "exact ∇w"


def measure(
    primitives: Sequence[SkinnedPrimitive], matrices: Float64Array, top: int, denoisers: dict[str, Denoiser]
) -> dict[str, Sample]:
    """Return angles to the accurate normals of the FLOAT bake, by denoiser; and to true ones (``true …``)."""
    exact, coarse = Surface(primitives), Surface([rounded(primitive, top) for primitive in primitives])
    gradients = as_stored(exact, 0.0)
    rest = rest_primitives(exact, gradients)
    wanted, positions = posed(rest, matrices)
    areas = np.tile(exact.areas, len(matrices))
    stacked = [
        np.concatenate([getattr(part, name) for part in rest])
        for name in ("positions", "normals", "tangents", "bitangents")
    ]
    sides = mirrored_sides(rest, matrices)
    expected, valid = reference_normals(rest_frames(exact.operator, *stacked), positions, sides)

    def sample(found: Float64Array, other: Float64Array, mask: BoolArray | None = None) -> Sample:
        angles = angular_errors(found, other)
        return Sample((angles if mask is None else np.where(mask, angles, np.nan)).ravel(), areas)

    result = {f"{TRUE} FLOAT": sample(wanted * sides[..., None], expected, valid)}
    # Copies of a point stay together when rounded, so each class of the rounded mesh has one exact gradient.
    kept = gradients[exact.classes[coarse.first_of_class]]
    result[FLOOR] = sample(posed(rest_primitives(coarse, kept), matrices)[0], wanted)
    for name, denoiser in denoisers.items():
        found = posed(rest_primitives(coarse, denoiser(coarse, 1.0 / top)), matrices)[0]
        result[name] = sample(found, wanted)
        if denoiser is as_stored:
            result[f"{TRUE} rounded"] = sample(found * sides[..., None], expected, valid)
    return result


def mirrored_sides(rest: Sequence[RestPrimitive], matrices: Float64Array) -> Float64Array:
    """Return −1 (P, V) where the joint of the largest weight mirrors, and turns t' × b' inside; else 1."""
    mirrors = np.linalg.det(matrices[..., :3, :3]) < 0
    largest = [part.joints[np.arange(len(part.joints)), part.weights.argmax(axis=1)] for part in rest]
    return np.where(mirrors[:, np.concatenate(largest)], -1.0, 1.0)


def mean_and_p99(samples: Sequence[Sample]) -> tuple[float, float]:
    """Return the mean and the 99th percentile of all samples together, weighted by area."""
    angles = np.concatenate([sample.angles for sample in samples])[None]
    areas = np.concatenate([sample.areas for sample in samples])
    summary = summarise(angles, areas, valid=np.isfinite(angles))
    return (np.nan, np.nan) if summary is None else (summary.mean, summary.p99)


def character(path: Path, poses: int) -> Iterator[tuple[list[SkinnedPrimitive], Float64Array]]:
    """Yield the primitives of each skinned mesh of a file, and joint matrices (P, J, 4, 4)."""
    document = read_document(str(path))
    sources, _ = skinned_sources(document)
    by_mesh: dict[int, list[PrimitiveSource]] = defaultdict(list)
    for source in sources:
        if reason_to_skip(document, source, generate_normals=True) is None:
            by_mesh[source.mesh].append(source)
    clips = read_clips(document)
    for mesh, entries in by_mesh.items():
        matrices = pose_set(document, skins_of(document, mesh)[0], clips, PoseRequest()).joint_matrices
        primitives = with_smooth_normals([read_primitive(document, source) for source in entries])
        inside = [
            primitive.with_influences(
                np.where(primitive.joints < source.joint_count, primitive.joints, 0),
                # An empty vertex would be repaired by the rounding, which is not what is measured.
                normalised_weights(primitive.weights, primitive.joints).astype(np.float32),
            )
            for primitive, source in zip(primitives, entries, strict=True)
        ]
        yield inside, matrices[:: max(1, len(matrices) // poses)]


def tube(times: int) -> SkinnedPrimitive:
    """Return the tube of the fixtures, its rows and columns divided ``times`` as finely."""
    rows, columns = np.linspace(0, 4.5, 45 * times + 1), np.linspace(0, 2 * np.pi, 32 * times + 1)
    height, theta, triangles = make_fixtures.grid(rows, columns)
    positions, normals = make_fixtures.tube_surface(theta, height, make_fixtures.TUBE_RADIUS)
    joints, weights = make_fixtures.influences(make_fixtures.tube_weights(theta, height))
    return SkinnedPrimitive(
        positions.astype(np.float32),
        normals.astype(np.float32),
        None,
        joints,
        weights.astype(np.float32),
        triangles,
    )


def subdivided(primitives: Sequence[SkinnedPrimitive], levels: int) -> SkinnedPrimitive:
    """Return a denser character: positions and weights after Loop 1987, the four largest weights kept."""
    surface = Surface(primitives)
    triangles = surface.points[surface.triangles]
    triangles = triangles[mark_proper(surface.positions, triangles)]
    values = np.hstack([surface.positions, surface.weights])
    if levels:
        values, triangles = igl.loop(values, triangles.astype(np.int64), levels)
    positions, weights = np.asarray(values)[:, :3], np.asarray(values)[:, 3:]
    triangles = np.asarray(triangles)[mark_proper(positions, np.asarray(triangles))]
    joints, kept = make_fixtures.influences(weights)
    normals = smooth_normals(positions, triangles, np.arange(len(positions)))
    return SkinnedPrimitive(
        positions.astype(np.float32),
        normals.astype(np.float32),
        None,
        joints,
        kept.astype(np.float32),
        triangles,
    )


def dense_rows(folder: Path | None, poses: int) -> Iterator[str]:
    """Yield table rows of surfaces at several densities, 8-bit weights."""
    document = read_document(str(make_fixtures.FOLDER / "bent_tube.glb"))
    matrices = pose_set(document, 0, read_clips(document), PoseRequest()).joint_matrices[::6]
    meshes = [("closed-form tube", [tube(times)], matrices) for times in (1, 2, 4)]
    if folder is not None:
        ((primitives, own),) = character(folder / "public" / CHARACTERS[0], poses)
        meshes += [(f"CesiumMan, Loop {n}×", [subdivided(primitives, n)], own) for n in (0, 1, 2)]
    for name, parts, moving in meshes:
        found = measure(parts, moving, 255, DENOISERS)
        figures = [f"{mean_and_p99([found[key]])[0]:.3f}" for key in (FLOOR, *DENOISERS)]
        print(name, len(parts[0].positions), figures, flush=True)
        yield f"| {name} | {len(parts[0].positions):,} | " + " | ".join(figures) + " |"


def model_rows(paths: Sequence[Path], poses: int) -> tuple[list[str], list[str], dict[str, int]]:
    """Return rows of what rounding costs, rows of what denoisers do, and how many models each one helps."""
    costs, methods = [], []
    helped = dict.fromkeys(DENOISERS, 0)
    for path in paths:
        samples: dict[int, Samples] = {255: defaultdict(list), 65535: defaultdict(list)}
        vertices = 0
        for primitives, matrices in character(path, poses):
            vertices += sum(len(primitive.positions) for primitive in primitives)
            plain: dict[str, Denoiser] = {"as stored": as_stored}
            for top, chosen in ((255, DENOISERS), (65535, plain)):
                for name, sample in measure(primitives, matrices, top, chosen).items():
                    samples[top][name].append(sample)
        figures = {
            top: {key: mean_and_p99(value) for key, value in found.items()} for top, found in samples.items()
        }
        eight, sixteen = figures[255], figures[65535]
        added = eight["as stored"][0]
        costs.append(
            f"| {path.stem} | {vertices:,} | {eight['true FLOAT'][0]:.3f} | {eight['true rounded'][0]:.3f} | "
            f"{sixteen['true rounded'][0]:.3f} | {added:.3f} / {eight['as stored'][1]:.2f} | "
            f"{eight[FLOOR][0]:.3f} | {sixteen['as stored'][0]:.4f} / {sixteen['as stored'][1]:.3f} |"
        )
        methods.append(f"| {path.stem} | " + " | ".join(f"{eight[name][0]:.3f}" for name in DENOISERS) + " |")
        for name in DENOISERS:
            helped[name] += eight[name][0] < 0.9 * added
        print(costs[-1], methods[-1], sep="\n", flush=True)
    return costs, methods, helped


def main() -> int:
    """Write the tables; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "models", type=Path, nargs="*", help="characters with FLOAT weights (default: the corpus)"
    )
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page whose table is renewed")
    parser.add_argument("--poses", type=int, default=POSES, help="about how many poses of each")
    options = parser.parse_args()
    folder = Path(os.environ.get("SKINBAKE_CORPUS") or REPOSITORY.parent / "shared" / "corpus")
    corpus = folder if folder.is_dir() else None
    paths = options.models or ([folder / "public" / name for name in CHARACTERS] if corpus else [])
    if not paths:
        print("no models: name some, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    costs, methods, helped = model_rows(paths, options.poses)
    dense = list(dense_rows(corpus, options.poses))
    head = options.output.read_text(encoding="utf-8").split(MARK)[0] if options.output.is_file() else ""
    options.output.write_text(head + MARK + tables(costs, methods, helped, dense), encoding="utf-8")
    return 0


def tables(costs: list[str], methods: list[str], helped: dict[str, int], dense: list[str]) -> str:
    """Return the page's tables."""
    names = " | ".join(DENOISERS)
    dashes = "--:|" * len(DENOISERS)
    better = " | ".join(f"{count}" for count in helped.values())
    return "\n".join(
        [
            "\n## The cost of rounding",
            "| model | vertices | error, FLOAT | 8 bits | 16 bits | added by 8 bits: mean / p99 "
            "| of it with exact ∇w | added by 16 bits: mean / p99 |",
            "|---|--:|--:|--:|--:|--:|--:|--:|",
            *costs,
            "\n## The effect of denoising: added by 8 bits, mean",
            f"| model | {names} |",
            f"|---|{dashes}",
            *methods,
            f"| *models on which it adds less than 90 % of as stored* | {better} |",
            "\n## The same on denser surfaces",
            f"| surface | vertices | {FLOOR} | {names} |",
            f"|---|--:|--:|{dashes}",
            *dense,
            "",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
