"""The rest frame that a primitive is baked for, and what the findings count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import FrameChoice
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients.baker import bake_primitives
from tests.support.baked_arrays import bake_one, meshes_of, path_of
from tests.support.baking import bake_settings
from tests.support.whole_fields import rest_frame


def square(*, lean: float = 0.0, unused: int = 0) -> SkinnedPrimitive:
    """Return a unit square on +Z with tangents along +Y; the first leans by degrees towards the normal.

    Joint 1 takes over along x. ``unused`` vertices at the end belong to no triangle and have no tangent.
    """
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], *[[5, 5, 5]] * unused], dtype=float)
    tangents = np.tile([0.0, 1.0, 0.0, 1.0], (4 + unused, 1))
    tangents[0, 1:3] = np.cos(np.radians(lean)), np.sin(np.radians(lean))
    tangents[4:] = 0.0
    share = np.clip(corners[:, 0], 0.0, 1.0)
    return SkinnedPrimitive(
        corners,
        np.tile([0.0, 0.0, 1.0], (4 + unused, 1)),
        tangents,
        np.tile([0, 1, 2, 3], (4 + unused, 1)),
        np.column_stack([1 - share, share, np.zeros((4 + unused, 2))]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )


def test_alpha_and_beta_are_along_the_files_tangent_and_its_bitangent() -> None:
    # t0 = Y and b0 = Z × Y = −X, so joint 1, which grows along X, has α = 0 and β = −1.
    baked, findings = bake_one(square())
    assert baked.frame == "tangent"
    assert baked.alpha[:, 0].tolist() == [0.0] * 4
    assert baked.beta[:, 0].tolist() == [-1.0] * 4
    assert (findings.tangent_deviation, findings.bad_tangents) == (0.0, 0)


def test_alpha_and_beta_are_along_the_normals_own_frame_where_asked() -> None:
    # The frame of +Z is X, Y.
    baked, findings = bake_one(square(), bake_settings(frame=FrameChoice.NORMAL))
    assert baked.frame == "normal"
    assert baked.alpha[:, 0].tolist() == [1.0] * 4
    assert baked.beta[:, 0].tolist() == [0.0] * 4
    assert (findings.tangent_deviation, findings.bad_tangents) == (0.0, 0)


def test_a_mirrored_tangent_turns_the_bitangent_round() -> None:
    primitive = square()
    assert primitive.tangents is not None
    mirrored = replace(primitive, tangents=primitive.tangents * [1.0, 1.0, 1.0, -1.0])
    baked, _ = bake_one(mirrored)
    assert baked.beta[:, 0].tolist() == [1.0] * 4


@pytest.mark.parametrize(
    ("lean", "frame", "bad"), [(0.09, "tangent", 0), (0.11, "normal", 1), (30.0, "normal", 1)]
)
def test_a_tangent_that_leans_by_more_than_a_tenth_of_a_degree_is_not_used(
    lean: float, frame: str, bad: int
) -> None:
    baked, findings = bake_one(square(lean=lean))
    assert baked.frame == frame
    assert findings.bad_tangents == bad
    # The tangents are float64 and n0 is exact: only rounding of the arc tangent is left.
    assert findings.tangent_deviation == pytest.approx(lean, abs=1e-9)


def test_a_leaning_tangent_is_used_where_asked_and_counted_all_the_same() -> None:
    baked, findings = bake_one(square(lean=30.0), bake_settings(frame=FrameChoice.TANGENT))
    assert baked.frame == "tangent"
    assert (findings.bad_tangents, round(findings.tangent_deviation, 9)) == (1, 30.0)


def test_vertices_of_no_triangle_do_not_decide_on_the_frame() -> None:
    baked, findings = bake_one(square(unused=3))
    assert (baked.frame, findings.bad_tangents) == ("tangent", 0)
    assert not baked.alpha[4:].any()


def test_tangents_of_length_two_double_alpha() -> None:
    # α = ∇w · t0 with t0 as the file has it: a shader reads the same TANGENT.
    primitive = square()
    assert primitive.tangents is not None
    long = replace(primitive, tangents=primitive.tangents * [2.0, 2.0, 2.0, 1.0])
    baked, _ = bake_one(long)
    assert baked.beta[:, 0].tolist() == [-2.0] * 4


def test_without_tangents_the_frame_is_the_normals_and_normals_may_have_any_length() -> None:
    plain = replace(square(), tangents=None)
    stretched = replace(plain, normals=plain.normals * [[1.0], [0.25], [3.0], [1e-6]])
    for primitive in (plain, stretched):
        frame = rest_frame(primitive, "auto")
        assert frame.kind == "normal"
        assert frame.tangents.tolist() == [[1.0, 0.0, 0.0]] * 4
        assert frame.bitangents.tolist() == [[0.0, 1.0, 0.0]] * 4


def test_findings_count_zero_normals_and_triangles_without_area_by_primitive() -> None:
    first = replace(square(), tangents=None, triangles=np.array([[0, 1, 2], [0, 2, 3], [0, 0, 1], [1, 1, 1]]))
    second = replace(
        square(), tangents=None, normals=np.array([[0, 0, 1], [0, 0, 0], [0, 0, 0], [0, 0, 1.0]])
    )
    [(_, one), (_, other)] = bake_primitives([first, second], bake_settings())
    assert (one.degenerate_triangles, one.zero_normals) == (2, 0)
    assert (other.degenerate_triangles, other.zero_normals) == (0, 2)


def test_the_mirrored_fixture_bakes_mirrored() -> None:
    # The sheet is symmetric but for its weights: where w = −1, b0 = −(n0 × t0).
    [part] = meshes_of(path_of("mirrored_tangent.glb"))[0]
    assert part.tangents is not None
    frame = rest_frame(part, "auto")
    assert frame.kind == "tangent"
    # The fixture's bitangent points up the image, along +y, on both sides.
    assert (frame.bitangents[:, 1] > 0.5).all()
    assert set(part.tangents[:, 3].tolist()) == {-1.0, 1.0}


def test_bake_leaves_its_input_alone() -> None:
    primitives = meshes_of(path_of("foreign_joints.glb"))[0]
    fields = ("positions", "normals", "joints", "weights", "triangles")
    copies = [[getattr(part, name).copy() for name in fields] for part in primitives]
    bake_primitives(primitives, bake_settings())
    for part, before in zip(primitives, copies, strict=True):
        for name, values in zip(fields, before, strict=True):
            assert np.array_equal(getattr(part, name), values)
