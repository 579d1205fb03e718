"""Smooth normals for primitives without any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gradients.baker import bake_primitives
from skinbake.gradients.normals import with_smooth_normals
from tests.support.baked_arrays import meshes_of, path_of
from tests.support.baking import bake_settings
from tests.support.whole_fields import angular_errors


def without_normals(primitive: SkinnedPrimitive) -> SkinnedPrimitive:
    return replace(primitive, normals=np.zeros((0, 3)), tangents=np.zeros((len(primitive.positions), 4)))


def test_made_normals_come_close_to_a_smooth_surfaces_own() -> None:
    parts = meshes_of(path_of("two_primitives.glb"))[0]
    made = with_smooth_normals([without_normals(part) for part in parts])
    for part, found in zip(parts, made, strict=True):
        assert found.normals.dtype == np.float32
        assert found.tangents is None
        errors = angular_errors(found.normals, part.normals)
        # 0.3° inside; at the sheet's outer border, which has triangles on one side only, a few degrees.
        assert np.median(errors) < 0.5
        assert errors.max() < 6.0


def test_the_border_between_primitives_gets_one_normal() -> None:
    parts = meshes_of(path_of("two_primitives.glb"))[0]
    first, second = with_smooth_normals([without_normals(part) for part in parts])
    shared = 0
    for position, normal in zip(first.positions.tolist(), first.normals.tolist(), strict=True):
        same = (second.positions == position).all(axis=1)
        shared += int(same.sum())
        assert second.normals[same].tolist() == [normal] * int(same.sum())
    assert shared == 11


def test_primitives_with_normals_keep_them_and_lend_them_to_nobody() -> None:
    parts = meshes_of(path_of("two_primitives.glb"))[0]
    kept, made = with_smooth_normals([parts[0], without_normals(parts[1])])
    alone = with_smooth_normals([without_normals(parts[1])])[0]
    assert kept is parts[0]
    assert np.array_equal(made.normals, alone.normals)
    assert with_smooth_normals(parts) == list(parts)


def test_a_mesh_with_made_normals_bakes() -> None:
    parts = meshes_of(path_of("bent_tube.glb"))[0]
    [made] = with_smooth_normals([without_normals(part) for part in parts])
    [(baked, _)] = bake_primitives([made], bake_settings())
    assert baked.frame == "normal"
    assert baked.alpha.any()
