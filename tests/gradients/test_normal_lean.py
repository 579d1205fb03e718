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
from skinbake.commands.inspect import inspect_file
from skinbake.commands.verify import verify_file
from skinbake.errors import Notice, Place
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from skinbake.gradients import kernel
from skinbake.gradients.normals import (
    SAMPLED_VERTICES,
    NormalLean,
    lean_notices,
    normal_leans,
    with_smooth_normals,
)
from skinbake.measure.options import VerifyOptions
from skinbake.truth.poses import PoseRequest
from tests.support import corpus
from tests.support.analytic import grid, sample, triangles
from tests.support.baked_arrays import CESIUM_MAN, FIXTURES, meshes_of, path_of
from tests.support.baked_files import Editable, baked
from tests.support.baking import bake_file
from tests.support.calls import count_calls
from tests.support.models import Part, write_model

HERE = Place("here.glb", 0, None, 0)
FEW = VerifyOptions(methods=("lbs",), poses=PoseRequest(PoseKind.RANDOM, 2))
BROKEN = {"unassigned-skeleton/unassigned-skeleton.gltf": 10, "VRM/modifier_shapekey_vrm1.vrm": 1}
"""Vertices whose normals are wrong in the two models that have any: a flat sheet whose normals lie in it, and
a triangle with a corner that is lit from behind."""


def notices_of(primitive: SkinnedPrimitive) -> list[Notice]:
    return lean_notices([(primitive, HERE)])


def lean_of(primitive: SkinnedPrimitive) -> NormalLean:
    [lean] = normal_leans([primitive])
    return lean


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
    lean = lean_of(primitive)
    assert lean.far == pytest.approx(len(primitive.positions) / 2, abs=1)
    # The sheet's own normals lie within a few degrees of its triangles' mean.
    assert lean.degrees == pytest.approx(degrees, abs=6.0)
    [notice] = notices_of(primitive)
    assert (notice.code, notice.count, notice.place.attribute) == ("normals-off-surface", lean.far, "NORMAL")
    assert f"at {lean.far:,} of {len(primitive.positions):,} vertices" in notice.message
    assert "--generate-normals" in notice.message


@pytest.mark.parametrize(("degrees", "share"), [(0.0, 1.0), (35.0, 1.0), (180.0, 0.04)])
def test_normals_that_lean_less_or_seldom_are_let_pass(degrees: float, share: float) -> None:
    assert notices_of(turned(smooth(), degrees, share)) == []


def test_a_surface_that_is_inside_out_is_told_from_odd_normals() -> None:
    [notice] = notices_of(turned(smooth(), 180.0))
    assert "face opposite ways" in notice.message


@pytest.mark.slow
def test_triangles_that_are_there_twice_have_no_plane_to_lean_from() -> None:
    """Each triangle is there once for each side. What rounding leaves of their sum is no direction."""
    one_side = smooth()
    both_sides = np.concatenate([one_side.triangles, one_side.triangles[:, ::-1]])
    lean = lean_of(replace(one_side, triangles=both_sides))
    assert (lean.far, lean.looked_at) == (0, 0)
    partly = replace(one_side, triangles=both_sides[: len(both_sides) * 3 // 4])
    assert notices_of(partly) == []
    assert notices_of(turned(partly, 60.0)) != []


@pytest.mark.slow
def test_of_a_large_mesh_some_are_looked_at() -> None:
    whole = turned(smooth(300, 200), 60.0, 0.5)
    lean = lean_of(whole)
    assert lean.looked_at <= SAMPLED_VERTICES
    [notice] = notices_of(whole)
    assert notice.count == pytest.approx(len(whole.positions) / 2, rel=0.1)
    assert "at about" in notice.message
    assert notices_of(smooth(300, 200)) == []


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
    assert notices_of(cube(normals)) == []
    assert len(notices_of(turned(cube(normals), 180.0))) == 1


def sides_of(primitive: SkinnedPrimitive) -> list[SkinnedPrimitive]:
    """Return the six sides of ``cube`` as primitives, as six materials cut it."""
    return [
        replace(
            primitive,
            positions=primitive.positions[first : first + 4],
            normals=primitive.normals[first : first + 4],
            joints=primitive.joints[first : first + 4],
            weights=primitive.weights[first : first + 4],
            triangles=primitive.triangles[first // 2 : first // 2 + 2] - first,
        )
        for first in range(0, 24, 4)
    ]


def notices_of_mesh(primitives: Sequence[SkinnedPrimitive]) -> list[Notice]:
    return lean_notices(
        (primitive, Place("here.glb", 0, None, number)) for number, primitive in enumerate(primitives)
    )


def test_a_smooth_cube_is_sound_if_its_sides_are_primitives() -> None:
    """Each side alone has normals that lean 54.7° from it."""
    sides = sides_of(cube("corners"))
    assert all(len(notices_of(side)) == 1 for side in sides)
    assert notices_of_mesh(sides) == []


def test_a_side_with_wrong_normals_is_told_from_its_neighbours() -> None:
    sides = sides_of(cube("corners"))
    sides[2] = turned(sides[2], 180.0)
    assert [notice.place.primitive for notice in notices_of_mesh(sides)] == [2]
    assert len(notices_of_mesh(sides_of(turned(cube("corners"), 180.0)))) == 6


def test_meshes_do_not_excuse_each_other() -> None:
    sides = sides_of(cube("corners"))
    apart = [(side, Place("here.glb", number, None, 0)) for number, side in enumerate(sides)]
    assert len(lean_notices(apart)) == 6


def test_the_primitives_of_a_mesh_are_joined_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the work would grow with the square of their number."""
    calls = count_calls(monkeypatch, kernel, "label_equal_rows")
    sides = sides_of(turned(cube("corners"), 180.0))
    assert len(notices_of_mesh(sides * 4)) == 24
    assert len([call for call in calls if len(call[0]) > 4]) == 3  # of the mesh, planes, generated normals


def test_of_a_mesh_of_large_primitives_some_vertices_are_looked_at() -> None:
    wrong = turned(smooth(100, 60), 60.0, 0.5)
    found = notices_of_mesh([wrong] * 4)
    assert [notice.place.primitive for notice in found] == [0, 1, 2, 3]
    for notice in found:
        assert notice.count == pytest.approx(len(wrong.positions) / 2, rel=0.15)
        assert "at about" in notice.message
    assert notices_of_mesh([smooth(100, 60)] * 4) == []


def test_commands_say_nothing_of_a_smooth_box_of_several_materials(tmp_path: Path) -> None:
    """The second time bake makes the normals itself."""
    for name, generate in (("smooth", False), ("bare", True)):
        parts = [
            Part(
                {
                    "POSITION": side.positions.astype(np.float32),
                    **({} if generate else {"NORMAL": side.normals.astype(np.float32)}),
                    "JOINTS_0": side.joints,
                    "WEIGHTS_0": side.weights.astype(np.float32),
                },
                side.triangles,
            )
            for side in sides_of(cube("corners"))
        ]
        source = write_model(tmp_path / f"{name}.glb", parts)
        made = bake_file(source, tmp_path / "baked.glb", generate_normals=generate)
        assert made.status == "baked"
        verdict = verify_file(str(tmp_path / "baked.glb"), FEW)
        shown = inspect_file(str(source))
        for notices in (made.notices, verdict.notices, shown.notices):
            assert [notice for notice in notices if notice.code == "normals-off-surface"] == []


def test_generated_normals_are_sound() -> None:
    """At vertex 0 the tall triangle has the larger angle, and the short one the larger weight after Max."""
    points = np.array([[0, 0, 0], [0, 10, 0], [0, 0, 10], [1, 0, 0], [0.87, 0.5, 0]], dtype=np.float64)
    joints, weights = np.zeros((5, 4), np.uint8), np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))
    bare = SkinnedPrimitive(points, points[:0], None, joints, weights, np.array([[0, 1, 2], [0, 3, 4]]))
    [generated] = with_smooth_normals([bare])
    assert generated.normals[0, 2] > 0.99
    assert notices_of(generated) == []
    assert len(notices_of(turned(generated, 100.0))) == 1


def test_normals_without_a_direction_are_another_notice() -> None:
    normals = smooth().normals.copy()
    normals[::3], normals[1::3], normals[2::3] = 0.0, np.nan, np.inf
    assert notices_of(replace(smooth(), normals=normals)) == []


@pytest.mark.parametrize("name", FIXTURES)
def test_fixtures_are_sound(name: str) -> None:
    for mesh in meshes_of(path_of(name)).values():
        for primitive in mesh:
            assert notices_of(primitive) == []


@pytest.mark.parametrize("path", corpus.parameters(corpus.valid_models))
def test_real_models_are_sound_but_for_two(path: Path) -> None:
    wanted = next((count for name, count in BROKEN.items() if path.as_posix().endswith(name)), 0)
    document = read_document(str(path))
    found = [
        notice
        for source in skinned_sources(document)
        if "NORMAL" in source.attributes
        for notice in lean_notices([(read_primitive(document, source), source.place)])
    ]
    assert sum(notice.count for notice in found) == wanted


@pytest.mark.slow
@corpus.needed
@pytest.mark.parametrize("degrees", [60, 180])
def test_inspect_bake_and_verify_say_it(tmp_path: Path, degrees: int) -> None:
    model = Editable(corpus.model(CESIUM_MAN))
    normals = model.array("NORMAL")
    document = read_document(str(corpus.model(CESIUM_MAN)))
    [source] = skinned_sources(document)
    normals[:] = turned(read_primitive(document, source), degrees).normals
    path = model.write(tmp_path / "turned.glb")

    def codes(notices: Sequence[Notice]) -> list[tuple[str, int]]:
        return [(notice.code, notice.count) for notice in notices if notice.code.startswith("normals")]

    [(code, count)] = codes(inspect_file(str(path)).notices)
    assert code == "normals-off-surface"
    assert count > 0.95 * len(normals)
    result = bake_file(path, tmp_path / "baked.glb")
    assert codes(result.notices) == [(code, count)]
    assert codes(verify_file(str(tmp_path / "baked.glb"), FEW).notices) == [(code, count)]
    sound = baked(corpus.model(CESIUM_MAN), tmp_path)
    assert codes(verify_file(str(sound), FEW).notices) == []
