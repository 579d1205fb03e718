"""The passes that are timed compute what they are said to: the replay's normals, or those of the triangles.

All on Mesa's software driver. No time is judged.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import igl
import numpy as np
import pytest

from benchmarks.gpu.meshes import Mesh, Palettes
from benchmarks.gpu.records import COMPUTE, DRAWN, read_records
from benchmarks.gpu.variants import BY_NAME, GATHER, SCATTER, VARIANTS, Counts, gradient_scale
from skinbake.choices import Encoding, FrameChoice, PoseKind
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_file
from skinbake.format.encodings import rounded
from skinbake.geometry import frames
from skinbake.measure.options import VerifyOptions
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.truth.poses import PoseRequest
from tests.benchmarks.gpu_outputs import Outputs, matrices, smooth_sheet, split_sheet
from tests.support import corpus
from tests.support.replay import SkinnedSurface, replay
from tests.support.webgpu import NAGA

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]
TIMEOUT_SECONDS = 300
SHADERS = [variant.name for variant in VARIANTS if variant.choices is not None]
RECOMPUTES = [SCATTER, GATHER]
SAMPLES = 2


def in_software(*command: str) -> subprocess.CompletedProcess[str]:
    """Run Python on the software driver."""
    driver = str(NAGA.require())
    environment = {
        **os.environ,
        "VK_DRIVER_FILES": driver,
        "VK_ICD_FILENAMES": driver,
        "GALLIVM_PERF": "nopt",
    }
    done = subprocess.run(
        [sys.executable, *command],
        env={**environment, "PYTHONIOENCODING": "utf-8"},
        cwd=REPOSITORY,
        capture_output=True,
        encoding="utf-8",
        timeout=TIMEOUT_SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> Outputs:
    path = tmp_path_factory.mktemp("gpu") / "outputs"
    in_software(
        "-c", "import sys; from tests.benchmarks.gpu_outputs import write; write(sys.argv[1])", str(path)
    )
    found: Outputs = pickle.loads(path.read_bytes())
    return found


def rest(mesh: Mesh, encoding: Encoding) -> RestPrimitive:
    """Return the mesh as the replay takes it, α and β as an encoding leaves them."""
    tangents, bitangents = frames.frame_from_normal(mesh.normals)
    alpha, beta = (rounded(values, encoding, gradient_scale(mesh)) for values in (mesh.alpha, mesh.beta))
    return RestPrimitive(
        mesh.positions, mesh.normals, tangents, bitangents, mesh.joints, mesh.weights, alpha, beta
    )


def replayed(mesh: Mesh, name: str) -> SkinnedSurface:
    choices = BY_NAME[name].choices
    assert choices is not None
    return replay(Algorithm(choices.algorithm), rest(mesh, choices.encoding), matrices())


def largest(differences: Any) -> float:
    return float(np.abs(differences).max())


@pytest.mark.parametrize("name", SHADERS)
class TestShaders:
    def test_the_compute_pass_gives_what_the_replay_gives(self, name: str, outputs: Outputs) -> None:
        expected = replayed(split_sheet(), name)
        found = outputs.frames[name]
        # All vectors have a length of about 1.
        assert largest(outputs.positions[name] - expected.positions) < 1e-5
        assert largest(found[..., :3] - expected.normals) < 1e-5
        assert largest(found[..., 3:] - expected.tangents) < 1e-5

    def test_the_vertex_shader_draws_them(self, name: str, outputs: Outputs) -> None:
        posed = replayed(smooth_sheet(), name)
        picture = outputs.pictures[name].astype(np.float64) / 255.0
        side = len(picture)
        x, y = posed.positions[0, :, 0], posed.positions[0, :, 1]
        columns, rows = (np.floor((1 + axis) / 2 * side).astype(int) for axis in (x, -y))
        inside = (np.abs(x) < 0.7) & (np.abs(y) < 0.7)
        drawn = picture[rows[inside], columns[inside], :3]
        normals = posed.normals[0, inside]
        expected = 0.5 + 0.5 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
        # A colour has steps of 0.004, and the pixel of a vertex shows a point up to a pixel away.
        apart = np.abs(drawn - expected)
        assert np.median(apart) < 0.002
        assert np.quantile(apart, 0.95) < 0.012

    def test_lightings_differ_by_more_than_the_tolerance(self, name: str, outputs: Outputs) -> None:
        """So that no test above passes with another variant's results. Floats and 16 bits are too near."""
        alike = {"LBS accurate, float32", "LBS accurate, snorm16"}
        for other in SHADERS:
            if other != name and not {name, other} <= alike:
                assert largest(outputs.frames[name] - outputs.frames[other]) > 2e-5, other


@pytest.mark.parametrize("name", RECOMPUTES)
class TestRecomputes:
    def expected(self, mesh: Mesh) -> Any:
        """The authored normals and tangents (P, V, 6), carried by rotation matrices of libigl's normals."""
        surface = replay(Algorithm.LBS_STANDARD, rest(mesh, Encoding.FLOAT32), matrices()).positions
        tangents, _ = frames.frame_from_normal(mesh.normals)
        at_rest = surface_frames(mesh, mesh.positions)
        found = []
        for positions in surface:
            turn = surface_frames(mesh, positions) @ np.swapaxes(at_rest, 1, 2)
            pair = [np.einsum("vij,vj->vi", turn, vectors) for vectors in (mesh.normals, tangents)]
            found.append(np.hstack(pair))
        return np.stack(found)

    def test_recomputing_carries_the_authored_normals_along(self, name: str, outputs: Outputs) -> None:
        mesh = split_sheet()
        expected = self.expected(mesh)
        surface = np.stack([surface_frames(mesh, mesh.positions)[:, :, 2]] * 2)
        # They lean from the surface's own normals, so that carrying shows.
        assert np.linalg.norm(mesh.normals - surface[0], axis=1).mean() > 0.1
        # Edges are differences of float32 positions: in the sharpest bends few of their digits are left.
        assert largest(outputs.frames[name] - expected) < 1e-3
        assert np.abs(outputs.frames[name] - expected).mean() < 1e-6

    def test_copies_at_a_seam_have_one_normal(self, name: str, outputs: Outputs) -> None:
        classes = split_sheet().classes
        copies = np.flatnonzero(classes != np.arange(len(classes)))
        assert len(copies) == 30
        found = outputs.frames[name]
        assert largest(found[:, copies] - found[:, classes[copies]]) < 1e-6

    def test_positions_are_those_of_linear_blending(self, name: str, outputs: Outputs) -> None:
        assert largest(outputs.positions[name] - replayed(split_sheet(), SHADERS[0]).positions) < 1e-5


def surface_frames(mesh: Mesh, positions: Any) -> Any:
    """Return frames (V, 3, 3) of libigl's normals by angle and of the edges that the adjacency names."""
    welded = mesh.classes[mesh.triangles].astype(np.int64)
    weighting = igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE
    n = igl.per_vertex_normals(positions.astype(np.float64), welded, weighting)[mesh.classes]
    copies, edges = mesh.adjacency.places.T
    t = positions[edges] - positions[copies]
    s = np.cross(n, t)
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    return np.stack([np.cross(s, n), s, n], axis=2)


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: str(variant.name))
def test_bytes_are_those_of_the_buffers(variant: Any, outputs: Outputs) -> None:
    counts = Counts.of(split_sheet(), Palettes.of(matrices()))
    sizes = outputs.sizes[variant.name]
    moved = sum(sizes[name] for step in variant.steps for name in (*step.buffers, *step.updates))
    assert variant.bytes_moved(counts) == moved


def test_the_clocks_of_gpu_and_host_tell_seconds(outputs: Outputs) -> None:
    assert 0.0 < outputs.clocks[False] < TIMEOUT_SECONDS
    assert 0.0 <= outputs.clocks[True] < TIMEOUT_SECONDS


def test_a_buffer_that_is_too_large_costs_one_variant_its_time(outputs: Outputs) -> None:
    reasons = {(entry.variant, entry.stage): entry.missing for entry in outputs.cramped}
    assert reasons[GATHER, COMPUTE].startswith("does not fit: ")
    assert "the adapter binds 15,000" in reasons[GATHER, COMPUTE]
    for entry in outputs.cramped:
        assert bool(entry.missing) != bool(entry.seconds), entry


@corpus.needed
def test_the_script_measures_and_writes(tmp_path: Path) -> None:
    """One character's errors are those that verify measures, since the GPU computes the same normals."""
    results, page = tmp_path / "results", tmp_path / "gpu.md"
    sizes = ["--vertices", "100", "200", "--crowd", "3", "--crowd-vertices", "50", "--rounds", "1"]
    written = ["--samples", str(SAMPLES), "--results", str(results), "--output", str(page)]
    in_software(
        "-m", "benchmarks.shader_speed", "--adapter", "llvmpipe", "--clock", "timestamps", *sizes, *written
    )
    (record,) = read_records(results)
    assert record.software and record.clock == "timestamps of the adapter" and record.copy_rate > 0
    assert len(record.times) == 3 * (len(VARIANTS) + len(SHADERS))
    assert all(len(entry.seconds) == 1 for entry in record.times)
    assert {entry.stage for entry in record.times} == {COMPUTE, DRAWN}
    assert "No GPU has been measured yet" in page.read_text(encoding="utf-8")
    ElementTree.parse(page.with_suffix(".svg"))
    assert_like_verify(json.loads(next(results.iterdir()).read_text(encoding="utf-8"))["errors"], tmp_path)


def assert_like_verify(errors: list[dict[str, Any]], folder: Path) -> None:
    source, target = corpus.model("CesiumMan/CesiumMan.glb"), folder / "baked.glb"
    bake_file(str(source), str(target), BakeOptions(frame=FrameChoice.NORMAL))
    verdict = verify_file(
        str(target), VerifyOptions(methods=("lbs", "dqs"), poses=PoseRequest(PoseKind.ANIMATION, SAMPLES))
    )
    means = {
        (entry["variant"], entry["truth"]): entry["mean"]
        for entry in errors
        if entry["character"] == source.parent.name
    }
    assert set(verdict.by_truth) == {"tangents", "triangles"}
    for truth, figures in verdict.by_truth.items():
        for lighting, name in (("standard", "LBS standard"), ("accurate", "LBS accurate, float32")):
            assert means[name, truth] == pytest.approx(figures["lbs"][lighting].mean, abs=1e-3)
        assert means["DQS exact", truth] == pytest.approx(figures["dqs"]["exact"].mean, abs=1e-3)
    # The rule of the recompute is that of this truth, up to the edge in place of a tangent.
    assert all(5 * means[name, "triangles"] < 1.0 < means[name, "tangents"] for name in RECOMPUTES)
