"""Properties of bakes of any mesh: undone by strip, repeated without change, verified, valid, Σα = Σβ = 0."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import numpy.typing as npt
import pygltflib as gltf
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fixtures.builder import Model
from fuzz.made import made_model
from fuzz.models import GLB
from skinbake.choices import Weighting
from skinbake.truth.operator import expected_alpha_beta, gradient_operator
from tests.support import khronos
from tests.support.baked_arrays import StoredPrimitive, baked_meshes_of
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.kernels import use_numpy
from tests.support.models import sheet, write_model
from tests.support.strictness import is_strict

STORAGES = (
    (),
    ("--layout", "texcoord"),
    ("--layout", "custom"),
    ("--encoding", "packed8"),
    ("--encoding", "snorm16"),
)
GATHERINGS = (
    (),
    ("--weighting", "angle"),
    ("--crease-angle", "90"),
    ("--neighbours", "drop"),
    ("--frame", "normal"),
)
COMPRESSIONS = ((), ("--compress", "meshopt"), ("--compress", "draco"))

EXAMPLES = 40 if is_strict() else 10
"""Of each property: all in a strict run, a quarter where a developer waits."""

# Derandomised: the same examples in every run, so that a failure is a change's and not luck's. The machine
# that runs them may be busy: no deadline.
PROPERTIES = settings(
    derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


@dataclass(frozen=True)
class Mesh:
    """A skinned mesh: points (V, 3), triangles (T, 3), joints and weights (V, 4), perhaps tangents."""

    points: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int64]
    normals: npt.NDArray[np.float32]
    joints: npt.NDArray[np.uint8]
    weights: npt.NDArray[np.float32]
    tangents: npt.NDArray[np.float32] | None

    def glb(self) -> bytes:
        """Return the mesh as a file, skinned by a chain of joints."""
        model = Model()
        attributes: dict[str, npt.NDArray[Any]] = {
            "POSITION": self.points,
            "NORMAL": self.normals,
            "JOINTS_0": self.joints,
            "WEIGHTS_0": self.weights,
        }
        if self.tangents is not None:
            attributes["TANGENT"] = self.tangents
        material = model.add_material("grey", (0.5, 0.5, 0.5))
        mesh = model.add_mesh("any", [model.add_primitive(attributes, self.triangles, material=material)])
        node = gltf.Node(mesh=mesh, name="any")
        model.add_root(node)
        origins = np.zeros((4, 3))
        origins[:, 1] = np.arange(4)
        node.skin = model.add_joint_chain("joint", origins)
        return model.to_glb()


@st.composite
def meshes(draw: st.DrawFn) -> Mesh:
    """Draw meshes on whole coordinates: of few points some coincide, some triangles have no area."""
    count = draw(st.integers(3, 12))
    whole = st.integers(-6, 6)
    points = np.array(draw(st.lists(st.tuples(whole, whole, whole), min_size=count, max_size=count)))
    corner = st.integers(0, count - 1)
    first = st.just((0, 1, 2))
    triangles = [draw(first), *draw(st.lists(st.tuples(corner, corner, corner), max_size=12))]
    parts = np.array(
        draw(st.lists(st.tuples(*[st.integers(0, 5)] * 4), min_size=count, max_size=count)), float
    )
    parts[parts.sum(axis=1) == 0, 0] = 1
    order = np.array(draw(st.lists(st.permutations(range(4)), min_size=count, max_size=count)))
    order[parts == 0] = 0  # as glTF wants it of slots without weight
    directions = st.sampled_from([(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (1, 1, 0), (1, -2, 3)])
    normals = np.array(draw(st.lists(directions, min_size=count, max_size=count)), float)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = None
    if draw(st.booleans()):
        across = np.cross(normals, [0.3, 0.5, -0.8])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        sign = np.array(draw(st.lists(st.sampled_from([1.0, -1.0]), min_size=count, max_size=count)))
        tangents = np.column_stack([across, sign]).astype(np.float32)
    return Mesh(
        points.astype(np.float32),
        np.array(triangles),
        normals.astype(np.float32),
        order.astype(np.uint8),
        (parts / parts.sum(axis=1, keepdims=True)).astype(np.float32),
        tangents,
    )


OPTIONS = st.builds(
    lambda *parts: [word for part in parts for word in part],
    st.sampled_from(STORAGES),
    st.sampled_from(GATHERINGS),
)


@settings(PROPERTIES, max_examples=EXAMPLES)
@given(meshes(), OPTIONS, st.sampled_from(COMPRESSIONS))
@pytest.mark.slow
def test_a_bake_verifies_repeats_and_is_undone(
    mesh: Mesh, options: list[str], compression: tuple[str, ...]
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source, once, twice, back = (folder / f"{each}.glb" for each in ("source", "once", "twice", "back"))
        source.write_bytes(mesh.glb())
        given_options = [*options, *compression, "-q"]
        assert invoke("bake", source, "-o", once, *given_options).exit_code == 0
        assert b"skinbake" in once.read_bytes()
        verdict = invoke("verify", once, "--poses", "rest", "--method", "lbs")
        assert verdict.exit_code == 0, verdict.output
        assert invoke("bake", once, "-o", twice, *given_options).exit_code == 0
        assert twice.read_bytes() == once.read_bytes()
        assert invoke("strip", once, "-o", back, "-q").exit_code == 0
        if not compression:
            assert read(back).content == read(source).content
            assert read(back).binary_chunk == read(source).binary_chunk


@pytest.mark.slow
@settings(PROPERTIES, max_examples=EXAMPLES)
@given(meshes())
def test_alpha_and_beta_of_all_slots_sum_to_zero(mesh: Mesh) -> None:
    """Slot 0 is not stored: its gradient comes from libigl's operator, of which the baker has no code."""
    with tempfile.TemporaryDirectory() as name:
        source, target = Path(name, "source.glb"), Path(name, "target.glb")
        source.write_bytes(mesh.glb())
        assert invoke("bake", source, "-o", target, "--gradients", "surface", "-q").exit_code == 0
        (stored,) = (primitive for group in baked_meshes_of(target).values() for primitive in group)
        for implied, others in zip(_slot_0(stored), (stored.alpha, stored.beta), strict=True):
            largest = max(np.abs(others).max(initial=0.0), np.abs(implied).max(initial=0.0))
            # float32 holds each of three stored values to 6e-8 of it; adopted slots carry a weight of 1e-5.
            assert np.abs(implied + others.sum(axis=1)).max() <= 1e-4 * largest


def _slot_0(stored: StoredPrimitive) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    weights = stored.arrays.weights.astype(np.float64)
    primitive = replace(stored.arrays, weights=weights / weights.sum(axis=1, keepdims=True))
    operator = gradient_operator([primitive], weighting=Weighting.MAX)
    ((alpha, beta),) = expected_alpha_beta(operator, [primitive], [stored.rest_frame])
    return alpha[:, 0], beta[:, 0]


@settings(PROPERTIES, max_examples=2)
@given(st.lists(st.tuples(meshes(), OPTIONS, st.sampled_from(COMPRESSIONS)), min_size=12, max_size=12))
@pytest.mark.slow
def test_own_outputs_are_valid(cases: list[tuple[Mesh, list[str], tuple[str, ...]]]) -> None:
    khronos.require_node()
    with tempfile.TemporaryDirectory() as name:
        pairs = []
        for number, (mesh, options, compression) in enumerate(cases):
            source, target = Path(name, f"{number}.glb"), Path(name, f"{number}-baked.glb")
            source.write_bytes(mesh.glb())
            assert invoke("bake", source, "-o", target, *options, *compression, "-q").exit_code == 0
            pairs.append((source, target))
        reports = khronos.validate_many([path for pair in pairs for path in pair])
        for source, target in pairs:
            assert not khronos.new_findings(reports[source], reports[target]), target.name


MUTATED = (
    ("--neighbours", "adopt"),
    ("--neighbours", "extend"),
    ("--limit-influences", "4"),
    ("--limit-influences", "8"),
    ("--encoding", "snorm16"),
)


def mutated_sheet(seed: int) -> bytes:
    """Return a folded sheet of odd weights in one to five sets.

    They are tiny, 0, repeated, FLOAT or integer. FLOAT ones may be negative, and their sum may be off from 1
    by as much as the validator allows: 2e-7 for each weight that is not 0.
    """
    random, of_floats = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    sets, joint_count = int(random.integers(1, 6)), int(random.integers(4, 30))
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(6.0), np.arange(4.0)))
    corners = np.arange(24).reshape(4, 6)
    ends = [corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]]
    first, second, third, fourth = (each.ravel() for each in ends)
    triangles = np.concatenate([np.stack([first, second, third], 1), np.stack([first, third, fourth], 1)])
    slots = 4 * sets
    if random.random() < 0.3:
        joints = random.integers(0, joint_count, (24, slots))  # a joint may be there twice, or oftener
    else:
        columns = np.arange(slots + int(random.integers(0, 3)))
        joints = np.stack([random.permutation(columns)[:slots] for _ in range(24)])
        joint_count = len(columns)  # few, so that free slots are left over
    weights = random.random((24, slots)) * (random.random((24, slots)) < random.choice([0.1, 0.3, 1.0]))
    weights[np.arange(24), random.integers(0, slots, 24)] += 0.5
    tiny = random.random((24, slots)) < random.choice([0.0, 0.4])
    weights[tiny & (weights < weights.max(axis=1, keepdims=True))] = 10.0 ** -random.integers(10, 38)
    weights /= weights.sum(axis=1, keepdims=True)
    kind = random.choice(["float32", "uint8", "uint16"])
    if kind == "float32" and of_floats.random() < 0.5:
        off = of_floats.uniform(-2e-7, 2e-7, 24) * np.count_nonzero(weights, axis=1)
        weights[np.arange(24), weights.argmax(axis=1)] += off
    if kind == "float32" and of_floats.random() < 0.2:
        weights[(weights == 0) & (of_floats.random((24, slots)) < 0.1)] = -of_floats.choice(
            [1e-20, 1e-3, 0.1]
        )
    stored = weights.astype(np.float32)
    if kind != "float32":
        most = int(np.iinfo(kind).max)
        whole = np.floor(weights * most)
        whole[np.arange(24), whole.argmax(axis=1)] += most - whole.sum(axis=1)
        # A weak vertex: every other slot has just over what lets it adopt.
        if random.random() < 0.3:
            whole[0] = np.where(np.arange(slots) % 2, 0, np.ceil(66 / 65535 * most / (slots // 2)))
        stored = whole.astype(kind)
    if random.random() < 0.7:
        joints = np.where(stored == 0, 0, joints)
    model = Model()
    attributes: dict[str, npt.NDArray[Any]] = {
        "POSITION": np.stack([x, y, np.abs(x - 2.5)], 1).astype(np.float32),
        "NORMAL": np.tile(np.array([0, 0, 1], np.float32), (24, 1)),
    }
    for number in range(sets):
        own = slice(4 * number, 4 * number + 4)
        attributes[f"JOINTS_{number}"] = joints[:, own].astype(np.uint8)
        attributes[f"WEIGHTS_{number}"] = stored[:, own]
    material = model.add_material("grey", (0.5, 0.5, 0.5))
    mesh = model.add_mesh("any", [model.add_primitive(attributes, triangles, material=material)])
    node = gltf.Node(mesh=mesh, name="any")
    model.add_root(node)
    node.skin = model.add_joint_chain("joint", np.arange(joint_count)[:, None] * [0.2, 0.0, 0.0])
    return model.to_glb()


@pytest.mark.slow
@pytest.mark.parametrize("loops", ["compiled", "numpy"])
def test_no_bake_of_mutated_weights_adds_a_finding_of_the_validator(
    loops: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each bake is fresh too."""
    khronos.require_node()
    if loops == "numpy":
        use_numpy(monkeypatch)
    with tempfile.TemporaryDirectory() as name:
        pairs: list[tuple[Path, Path, bool]] = []
        for seed in range(200 if is_strict() else 40 if loops == "compiled" else 10):
            options = MUTATED[seed % len(MUTATED)]
            source, target = Path(name, f"{seed}.glb"), Path(name, f"{seed}-baked.glb")
            source.write_bytes(mutated_sheet(seed))
            assert invoke("bake", source, "-o", target, *options, "-q").exit_code == 0
            verdict = invoke("verify", target, "--poses", "rest", "--method", "lbs")
            assert verdict.exit_code == 0, (seed, verdict.output)
            pairs.append((source, target, "extend" in options))
        reports = khronos.validate_many([path for *pair, _ in pairs for path in pair])
        for source, target, extends in pairs:
            new = khronos.new_findings(reports[source], reports[target])
            if extends:  # sums that are not 1 are told once for each set (docs/reference/gradients.md)
                old = {finding.code for finding in reports[source]["errors"]}
                for code in old & {"ACCESSOR_WEIGHTS_NON_NORMALIZED"}:
                    del new["error", code]
            assert not new, (target.name, new)


@pytest.mark.slow
def test_a_bake_by_either_kernel_is_fresh_for_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Soups of triangles: slivers, points in one place, folds, and weights of odd sums."""
    seeds = [seed for seed in range(60) if made_model(Random(seed)).name == "soup"]
    sources = {seed: tmp_path / f"{seed}.glb" for seed in seeds}
    for seed, source in sources.items():
        [content] = made_model(Random(seed)).packed(GLB)[1].values()
        source.write_bytes(content)
    bakes: dict[str, list[Path]] = {}
    for kernel in ("compiled", "numpy"):
        with monkeypatch.context() as patch:
            if kernel == "numpy":
                use_numpy(patch)
            for seed, source in sources.items():
                target = tmp_path / kernel / f"{seed}.glb"
                made = invoke("bake", source, "-o", target, "--generate-normals", "-q")
                if made.exit_code == 0:
                    bakes.setdefault(kernel, []).append(target)
    assert len(bakes["compiled"]) == len(bakes["numpy"]) > 12
    fresh = 0
    for kernel in ("compiled", "numpy"):
        with monkeypatch.context() as patch:
            if kernel == "numpy":
                use_numpy(patch)
            for target in (path for paths in bakes.values() for path in paths):
                verdict = invoke("verify", target, "--poses", "rest", "--method", "lbs", "--json")
                [told] = json.loads(verdict.stdout)["files"]
                checks = {check["name"]: check for check in told["checks"]}
                # Standard lighting may be better at every part of a fit: then nothing was baked.
                if checks["structure"]["outcome"] == "skipped":
                    continue
                fresh += 1
                assert checks["freshness"]["outcome"] == "passed", (target, kernel, checks["freshness"])
    assert fresh > 4 * 8


@pytest.mark.slow
def test_no_bake_leaves_a_sum_of_weights_that_tiny_ones_made_valid() -> None:
    """The validator allows Σw to be off by 2e-7 for each weight that is not 0, also for those of 1e-20.

    Tiny weights of the joints that a vertex adopts into other slots are cleared, so that it has fewer.
    """
    khronos.require_node()
    with tempfile.TemporaryDirectory() as name:
        paths = []
        for seed in range(24):
            random = np.random.default_rng(seed)
            side = np.repeat([0, 1], 10)  # two halves, and each is bound to a joint of its own
            joints = np.stack([side, 2 + side, 1 - side, 4 + side], axis=1).astype(np.uint8)
            weights = np.full((20, 4), 10.0 ** -random.integers(10, 30))
            tiny = 2 + seed % 2
            weights[:, 1 + tiny :], joints[:, 1 + tiny :] = 0.0, 0
            allowed = random.uniform(0.0, tiny + 0.9, 20)
            weights[:, 0] = 1.0 + 2e-7 * allowed * random.choice([-1.0, 1.0], 20)
            arrays: dict[str, Any] = {"JOINTS_0": joints, "WEIGHTS_0": weights.astype(np.float32)}
            path = write_model(Path(name, f"{seed}.glb"), [sheet(**arrays)], joints=6)
            target = path.with_suffix(".baked.glb")
            assert invoke("bake", path, "-o", target, "-q", *MUTATED[seed % 2]).exit_code == 0
            assert invoke("verify", target, "--poses", "rest", "--method", "lbs").exit_code == 0
            paths.append((path, target))
        reports = khronos.validate_many([path for pair in paths for path in pair])
        for source, target in paths:
            assert not khronos.new_findings(reports[source], reports[target]), target.name
        assert any(b'"adopted"' in target.read_bytes() for _, target in paths)
