"""Normals that do not belong to their surface are named, sound ones are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from skinbake.choices import PoseKind
from skinbake.commands.bake import Baker
from skinbake.commands.inspect import inspect_file
from skinbake.commands.verify import verify_file
from skinbake.errors import Notice, Place
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.document import read_document
from skinbake.gltf.primitives import read_primitive, skinned_sources
from skinbake.gradients.normal_lean import SAMPLED_VERTICES, lean_notices, normal_lean
from skinbake.gradients.normals import with_smooth_normals
from skinbake.lighting.poses import PoseRequest
from skinbake.lighting.verify_options import VerifyOptions
from tests.support import corpus
from tests.support.analytic import grid, sample, triangles
from tests.support.baked_arrays import CESIUM_MAN, FIXTURES, meshes_of, path_of
from tests.support.baked_files import Editable, baked

HERE = Place("here.glb", 0, None, 0)
FEW = VerifyOptions(methods=("lbs",), poses=PoseRequest(PoseKind.RANDOM, 2))
BROKEN = {"unassigned-skeleton/unassigned-skeleton.gltf": 10, "VRM/modifier_shapekey_vrm1.vrm": 1}
"""Vertices whose normals are wrong in the two models that have any: a flat sheet whose normals lie in it, and
a triangle with a corner that is lit from behind."""


def smooth(columns: int = 40, rows: int = 30) -> SkinnedPrimitive:
    u, v = grid(columns, rows)
    surface = sample(u, v)
    count = len(surface.positions)
    joints, weights = np.zeros((count, 4), np.uint8), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return SkinnedPrimitive(
        surface.positions, surface.normals, None, joints, weights, triangles(columns, rows)
    )


def turned(primitive: SkinnedPrimitive, degrees: float, share: float = 1.0) -> SkinnedPrimitive:
    """Return the primitive with some normals turned, each about an axis of its own across it."""
    rng = np.random.default_rng(4)
    normals = primitive.normals.astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes = np.cross(normals, rng.normal(size=normals.shape))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    chosen = rng.permutation(len(normals)) < share * len(normals)
    normals[chosen] = Rotation.from_rotvec(np.radians(degrees) * axes[chosen]).apply(normals[chosen])
    return replace(primitive, normals=normals)


@pytest.mark.parametrize("degrees", [60.0, 90.0, 180.0])
def test_turned_normals_are_counted_and_measured(degrees: float) -> None:
    primitive = turned(smooth(), degrees, 0.5)
    lean = normal_lean(primitive)
    assert lean.far == pytest.approx(len(primitive.positions) / 2, abs=1)
    # The sheet's own normals lie within a few degrees of its triangles' mean.
    assert lean.degrees == pytest.approx(degrees, abs=6.0)
    [notice] = lean_notices(primitive, HERE)
    assert (notice.code, notice.count, notice.place.attribute) == ("normals-off-surface", lean.far, "NORMAL")
    assert f"at {lean.far:,} of {len(primitive.positions):,} vertices" in notice.message
    assert "--generate-normals" in notice.message


@pytest.mark.parametrize(("degrees", "share"), [(0.0, 1.0), (35.0, 1.0), (180.0, 0.04)])
def test_normals_that_lean_less_or_seldom_are_let_pass(degrees: float, share: float) -> None:
    assert lean_notices(turned(smooth(), degrees, share), HERE) == []


def test_a_surface_that_is_inside_out_is_told_from_odd_normals() -> None:
    [notice] = lean_notices(turned(smooth(), 180.0), HERE)
    assert "face opposite ways" in notice.message


@pytest.mark.slow
def test_triangles_that_are_there_twice_have_no_plane_to_lean_from() -> None:
    """Each triangle is there once for each side. What rounding leaves of their sum is no direction."""
    one_side = smooth()
    both_sides = np.concatenate([one_side.triangles, one_side.triangles[:, ::-1]])
    lean = normal_lean(replace(one_side, triangles=both_sides))
    assert (lean.far, lean.looked_at) == (0, 0)
    partly = replace(one_side, triangles=both_sides[: len(both_sides) * 3 // 4])
    assert lean_notices(partly, HERE) == []
    assert lean_notices(turned(partly, 60.0), HERE) != []


def test_of_a_large_mesh_some_are_looked_at() -> None:
    whole = turned(smooth(300, 200), 60.0, 0.5)
    lean = normal_lean(whole)
    assert lean.looked_at <= SAMPLED_VERTICES
    [notice] = lean_notices(whole, HERE)
    assert notice.count == pytest.approx(len(whole.positions) / 2, rel=0.1)
    assert "at about" in notice.message
    assert lean_notices(smooth(300, 200), HERE) == []


def cube(normals: str) -> SkinnedPrimitive:
    """A cube of six sides with corners of their own, its normals those of the sides or of the corners."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    positions: list[npt.NDArray[np.float64]] = []
    found: list[npt.NDArray[np.float64]] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            own = corners[corners[:, axis] == side]
            order = [0, 2, 3, 1] if (side > 0) == (axis != 1) else [0, 1, 3, 2]
            start = len(positions) * 4
            positions.append(own[order])
            found.append(own[order] if normals == "corners" else np.tile(side * np.eye(3)[axis], (4, 1)))
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    points = np.concatenate(positions)
    joints, weights = np.zeros((24, 4), np.uint8), np.tile([1.0, 0.0, 0.0, 0.0], (24, 1))
    return SkinnedPrimitive(points, np.concatenate(found), None, joints, weights, np.array(faces))


@pytest.mark.parametrize("normals", ["corners", "sides"])
def test_a_cube_is_sound_hard_or_smooth(normals: str) -> None:
    """Smooth normals lean 54.7° from their own side, and not from the three that meet."""
    assert lean_notices(cube(normals), HERE) == []
    assert len(lean_notices(turned(cube(normals), 180.0), HERE)) == 1


def test_generated_normals_are_sound() -> None:
    """At vertex 0 the tall triangle has the larger angle, and the short one the larger weight after Max."""
    points = np.array([[0, 0, 0], [0, 10, 0], [0, 0, 10], [1, 0, 0], [0.87, 0.5, 0]], dtype=np.float64)
    joints, weights = np.zeros((5, 4), np.uint8), np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))
    bare = SkinnedPrimitive(points, points[:0], None, joints, weights, np.array([[0, 1, 2], [0, 3, 4]]))
    [generated] = with_smooth_normals([bare])
    assert generated.normals[0, 2] > 0.99
    assert lean_notices(generated, HERE) == []
    assert len(lean_notices(turned(generated, 100.0), HERE)) == 1


def test_normals_without_a_direction_are_another_notice() -> None:
    normals = smooth().normals.copy()
    normals[::3], normals[1::3], normals[2::3] = 0.0, np.nan, np.inf
    assert lean_notices(replace(smooth(), normals=normals), HERE) == []


@pytest.mark.parametrize("name", FIXTURES)
def test_fixtures_are_sound(name: str) -> None:
    for mesh in meshes_of(path_of(name)).values():
        for primitive in mesh:
            assert lean_notices(primitive, HERE) == []


@pytest.mark.parametrize("path", corpus.parameters(corpus.valid_models))
def test_real_models_are_sound_but_for_two(path: Path) -> None:
    wanted = next((count for name, count in BROKEN.items() if path.as_posix().endswith(name)), 0)
    document = read_document(str(path))
    found = [
        notice
        for source in skinned_sources(document)[0]
        if "NORMAL" in source.attributes
        for notice in lean_notices(read_primitive(document, source), source.place)
    ]
    assert sum(notice.count for notice in found) == wanted


@corpus.needed
@pytest.mark.parametrize("degrees", [60, 180])
def test_inspect_bake_and_verify_say_it(tmp_path: Path, degrees: int) -> None:
    model = Editable(corpus.model(CESIUM_MAN))
    normals = model.array("NORMAL")
    document = read_document(str(corpus.model(CESIUM_MAN)))
    [source] = skinned_sources(document)[0]
    normals[:] = turned(read_primitive(document, source), degrees).normals
    path = model.write(tmp_path / "turned.glb")

    def codes(notices: Sequence[Notice]) -> list[tuple[str, int]]:
        return [(notice.code, notice.count) for notice in notices if notice.code.startswith("normals")]

    [(code, count)] = codes(inspect_file(str(path)).notices)
    assert code == "normals-off-surface"
    assert count > 0.95 * len(normals)
    result = Baker().bake_file(str(path), str(tmp_path / "baked.glb"))
    assert codes(result.notices) == [(code, count)]
    assert codes(verify_file(str(tmp_path / "baked.glb"), FEW).notices) == [(code, count)]
    sound = baked(corpus.model(CESIUM_MAN), tmp_path)
    assert codes(verify_file(str(sound), FEW).notices) == []
