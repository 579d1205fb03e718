"""Accurate lighting in float32, as GPUs compute it, at the distances of a file's own poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import skinbake
from skinbake.geometry.skinned import Float64Array
from skinbake.measure.float32 import TOLERANCE, rounding_of
from skinbake.skinning.rest import RestPrimitive
from tests.support import corpus
from tests.support.baked_files import Answer, Editable, verify
from tests.support.gltf_reading import JsonObject, read
from tests.support.models import FOLDER, rewritten

ALPHA, BETA = "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"
PIVOTS = Path("cases/turn4/vertex_on_pivots.glb")
TUBE = FOLDER / "bent_tube.glb"


def moved(path: Path, folder: Path, far: float) -> Path:
    """Write a copy whose roots all hang below a node far from the origin."""
    model = read(path)
    content = model.content
    (scene,) = content["scenes"]
    content["nodes"].append({"name": "far", "translation": [far, 0.0, -far], "children": scene["nodes"]})
    scene["nodes"] = [len(content["nodes"]) - 1]
    return rewritten(model, folder / f"far{path.suffix}")


def told(answer: Answer) -> list[JsonObject]:
    return [notice for notice in answer.file["warnings"] if notice["code"] == "float32"]


def turned(rest: RestPrimitive, matrices: Float64Array) -> float:
    """Return the largest angle between the normals of floats and of doubles, one vertex after the other."""
    largest = 0.0
    for pose in matrices:
        for vertex in range(len(rest.positions)):
            normals = []
            for number in (np.float32, np.float64):
                tangents = []
                joints = [pose[joint].astype(number) for joint in rest.joints[vertex]]
                point = np.append(rest.positions[vertex], 1.0).astype(number)
                for at_rest, slopes in ((rest.tangents, rest.alpha), (rest.bitangents, rest.beta)):
                    tangent = np.zeros(3, number)
                    for weight, joint in zip(rest.weights[vertex].astype(number), joints, strict=True):
                        tangent = tangent + weight * (joint[:3, :3] @ at_rest[vertex].astype(number))
                    for slope, joint in zip(slopes[vertex].astype(number), joints[1:], strict=True):
                        tangent = tangent + slope * ((joint @ point)[:3] - (joints[0] @ point)[:3])
                    tangents.append(tangent.astype(np.float64))
                normal = np.cross(tangents[0], tangents[1])
                normals.append(normal / np.linalg.norm(normal))
            largest = max(largest, float(np.degrees(np.arccos(min(1.0, float(normals[0] @ normals[1]))))))
    return largest


def quad(slope: float, far: float) -> tuple[RestPrimitive, Float64Array]:
    """Return 40 vertices of a plane in 3 poses of three joints, all of them ``far`` from the origin.

    Two joints alone would round alike: with one difference of positions there is one direction of t' and b'.
    """
    random = np.random.default_rng(6)
    count, axes = 40, np.eye(3)
    rest = RestPrimitive(
        positions=np.pad(random.uniform(-1.0, 1.0, (count, 2)), ((0, 0), (0, 1))),
        normals=np.tile(axes[2], (count, 1)),
        tangents=np.tile(axes[0], (count, 1)),
        bitangents=np.tile(axes[1], (count, 1)),
        joints=np.tile([0, 1, 2], (count, 1)),
        weights=np.full((count, 3), 1.0 / 3.0),
        alpha=slope * random.uniform(0.5, 1.0, (count, 2)),
        beta=slope * random.uniform(-1.0, -0.5, (count, 2)),
    )
    matrices = np.tile(np.eye(4), (3, 3, 1, 1))
    for pose, angle in enumerate((0.01, 0.02, 0.03)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        matrices[pose, 1, 1:3, 1:3] = turn
        matrices[pose, 2, ::2, ::2][:2, :2] = turn.T
    matrices[:, :, :3, 3] = far * np.array([1.0, 0.3, -0.7])
    return rest, matrices


@pytest.mark.parametrize(("slope", "far"), [(30.0, 1e4), (1e6, 10.0), (2.0, 1e5)])
def test_the_angle_is_that_of_single_vertices_by_floats_and_doubles(slope: float, far: float) -> None:
    rest, matrices = quad(slope, far)
    found = rounding_of(rest, matrices)
    assert found is not None
    assert found.angle == pytest.approx(turned(rest, matrices), rel=1e-3)
    assert found.is_steep == (slope > 1e3)
    assert found.distance == pytest.approx(far, rel=0.2)


@pytest.mark.parametrize(("slope", "far"), [(30.0, 10.0), (1e3, 1.0), (0.0, 1e6)])
def test_rounding_that_nobody_sees_is_passed_over(slope: float, far: float) -> None:
    rest, matrices = quad(slope, far)
    assert rounding_of(rest, matrices) is None
    assert turned(rest, matrices) < TOLERANCE


def test_parts_that_joints_hide_do_not_count() -> None:
    rest, matrices = quad(30.0, 10.0)
    hidden = replace(rest, joints=np.where(np.arange(40)[:, None] < 20, [[3, 4, 5]], rest.joints))
    small = np.tile(np.diag([1e-7, 1e-7, 1e-7, 1.0]), (3, 3, 1, 1))
    small[:, :, :3, 3] = 10.0
    assert rounding_of(hidden, np.concatenate([matrices, small], axis=1)) is None


@corpus.needed
def test_a_file_with_far_too_large_numbers_is_warned_of(tmp_path: Path) -> None:
    skinbake.bake(corpus.require_corpus() / PIVOTS, tmp_path / "baked.glb")
    model = Editable(tmp_path / "baked.glb")
    for name in (ALPHA, BETA):
        model.array(name)[0] *= 1e5
    answer = verify(model.write(tmp_path / "edited.glb"))
    (notice,) = told(answer)
    assert "run skinbake bake again" in notice["message"]
    assert answer.failed == ["freshness"]


@pytest.mark.parametrize(("far", "count"), [(100.0, 0), (1e5, 1)])
def test_a_model_too_far_from_the_origin_is_warned_of(far: float, count: int, tmp_path: Path) -> None:
    source = moved(TUBE, tmp_path, far)
    skinbake.bake(source, tmp_path / "baked.glb")
    answer = verify(tmp_path / "baked.glb")
    assert answer.exit_code == 0
    assert len(told(answer)) == count
    assert all("move it nearer" in notice["message"] for notice in told(answer))


@corpus.needed
@pytest.mark.parametrize("gradients", ["fitted"])
@pytest.mark.parametrize("far", [0.0, 100.0])
def test_a_vertex_on_the_pivots_of_its_joints_is_sound(far: float, gradients: str, tmp_path: Path) -> None:
    source = corpus.require_corpus() / PIVOTS
    skinbake.bake(moved(source, tmp_path, far), tmp_path / "baked.glb", gradients=gradients)  # type: ignore[call-overload]
    answer = verify(tmp_path / "baked.glb")
    assert answer.exit_code == 0
    assert not told(answer)
    assert np.abs(Editable(tmp_path / "baked.glb").array(ALPHA)).max() < 100.0
