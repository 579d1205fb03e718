"""The two ways to bake a surface, compiled loops and whole arrays: one result, on good and on bad input."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.errors import ChoiceError
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import BakedPrimitive, Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.skins import rig_of_mesh
from skinbake.gradients import by_numpy, kernel
from skinbake.gradients.baker import BakeFindings, bake_primitives
from skinbake.gradients.influences import weight_field
from skinbake.gradients.surface import Surface, SurfaceSlots, WeightDefects, concatenate_fields
from skinbake.gradients.tangents import frame_vectors
from skinbake.gradients.weight_gradients import WEIGHTINGS, VertexGradients, weight_gradients
from skinbake.gradients.weld import weld
from skinbake.threads import threads_limited
from skinbake.timing import Told, heard, stage
from tests.support.baked_arrays import (
    AFRAME_HAND,
    BARBARIAN,
    CESIUM_MAN,
    ELF,
    HAND_U8,
    MANTIS,
    PBR_TEST,
    TREX,
    meshes_of,
    path_of,
)
from tests.support.baking import bake_settings
from tests.support.kernels import OTHERWISE, compiled_otherwise, use_numpy
from tests.support.strictness import missing_tool
from tests.support.surfaces import analytic_surface

if not kernel.IS_COMPILED:
    missing_tool("skinbake was installed without its compiled loops")

from skinbake.gradients import _kernel, by_loops

FIXTURES = ["bent_tube.glb", "two_primitives.glb", "two_sets.glb", "foreign_joints.glb", "weights_u8.glb"]
MODELS = [CESIUM_MAN, BARBARIAN, TREX, PBR_TEST, HAND_U8, ELF, MANTIS, AFRAME_HAND]
Result = TypeVar("Result")


def both(monkeypatch: pytest.MonkeyPatch, work: Callable[[], Result]) -> tuple[Result, Result]:
    """Return the results of the compiled loops and of numpy."""
    compiled = work()
    with monkeypatch.context() as patch:
        use_numpy(patch)
        return compiled, work()


def surface_of(primitives: Sequence[SkinnedPrimitive]) -> Surface:
    field = concatenate_fields([weight_field(part)[0] for part in primitives])
    positions = np.concatenate([part.positions for part in primitives])
    ends = np.cumsum([len(part.positions) for part in primitives]).tolist()
    triangles = np.concatenate(
        [
            part.triangles[kernel.mark_proper(part.positions, part.triangles)].astype(np.int64) + start
            for part, start in zip(primitives, [0, *ends], strict=False)
        ]
    )
    normals = np.concatenate([part.normals for part in primitives])
    classes = weld(positions, normals, field, crease_angle=np.radians(15.0))
    return Surface(positions, triangles, field, classes, normals, None, ends)


def bake(surface: Surface, weighting: str = "max", adopt: bool = True) -> SurfaceSlots:
    return kernel.bake_surface(surface, weighting=weighting, adopt=adopt)


def dense(slots: SurfaceSlots) -> npt.NDArray[np.int64]:
    """Return the joint that each slot of each vertex adopts, −1 for none."""
    adopted = np.full((len(slots.alpha), slots.alpha.shape[1] + 1), -1)
    adopted[slots.adopting] = slots.adopted
    return adopted


def assert_zeros_have_no_sign(*tables: FloatArray) -> None:
    """Arrays of equal numbers must be equal in bits, because a file stores them once."""
    assert not any(np.signbit(table[table == 0.0]).any() for table in tables)


def assert_paths_agree(
    primitives: Sequence[SkinnedPrimitive], weighting: str, monkeypatch: pytest.MonkeyPatch
) -> Float64Array:
    """Compare the surfaces and their slots; return α and β side by side."""
    surface, plain_surface = both(monkeypatch, lambda: surface_of(primitives))
    for name in ("joints", "weights", "free"):
        assert np.array_equal(getattr(surface.field, name), getattr(plain_surface.field, name)), name
    assert np.array_equal(surface.triangles, plain_surface.triangles)
    assert np.array_equal(surface.classes, plain_surface.classes)
    for adopt in (True, False):
        compiled, plain = both(monkeypatch, partial(bake, surface, weighting, adopt))
        found, expected = (np.hstack([slots.alpha, slots.beta]) for slots in (compiled, plain))
        # Copies of a vertex may differ in their weights' last digits below float32: each array corner takes
        # its own copy's weights, the compiled class those of its first vertex. Gradients as large that the
        # order of a sum decides which is larger may change places.
        same = (np.sort(dense(compiled), axis=1) == np.sort(dense(plain), axis=1)).all(axis=1)
        assert np.count_nonzero(~same) <= len(same) // 1000
        placed = (dense(compiled) == dense(plain)).all(axis=1)
        assert_zeros_have_no_sign(found, expected)
        off = np.abs(found - expected)[placed]
        assert off.max(initial=0.0) <= 2e-7 * np.abs(expected).max(initial=0.0)
        assert np.array_equal(compiled.sums[:, :2], plain.sums[:, :2])
        assert compiled.sums[:, 2] == pytest.approx(plain.sums[:, 2], rel=1e-9)
        assert compiled.sums[:, 3] == pytest.approx(plain.sums[:, 3], rel=1e-6, abs=1e-9)
    return np.asarray(expected, dtype=np.float64)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("name", FIXTURES)
def test_loops_and_numpy_agree_on_fixtures(
    name: str, weighting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for primitives in meshes_of(path_of(name)).values():
        assert assert_paths_agree(primitives, weighting, monkeypatch).any()


@pytest.mark.parametrize("name", MODELS)
def test_loops_and_numpy_agree_on_real_models(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for primitives in meshes_of(path_of(name)).values():
        assert_paths_agree(primitives, "max", monkeypatch)


def rigged_meshes_of(path: Path) -> list[tuple[list[SkinnedPrimitive], Rig]]:
    """Return the primitives of every mesh that a skin draws, with its rig."""
    document = read_document(str(path))
    drawn = {node.get("mesh") for node in document.objects("nodes") if "skin" in node}
    return [
        (primitives, rig_of_mesh(document, mesh)[0])
        for mesh, primitives in meshes_of(path).items()
        if mesh in drawn
    ]


def with_rig(surface: Surface, rig: Rig) -> Surface:
    return surface._replace(rig=rig.with_joints(int(surface.field.joints.max()) + 1))


def assert_fits_agree(
    primitives: Sequence[SkinnedPrimitive], rig: Rig, weighting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compare α and β fitted by both paths; they must differ from the surface's."""
    plain = surface_of(primitives)
    surface = with_rig(plain, rig)
    for adopt in (True, False):
        compiled, whole = both(monkeypatch, partial(bake, surface, weighting, adopt))
        found, expected = (np.hstack([slots.alpha, slots.beta]) for slots in (compiled, whole))
        # Gradients as large that the order of a sum decides which is adopted may change places.
        placed = (dense(compiled) == dense(whole)).all(axis=1)
        assert_zeros_have_no_sign(found, expected)
        assert np.count_nonzero(~placed) <= len(placed) // 100
        off = np.abs(found - expected)[placed]
        assert off.max(initial=0.0) <= 1e-5 * np.abs(expected).max(initial=0.0)
        assert np.array_equal(compiled.sums[:, :2], whole.sums[:, :2])
        bent = bake(plain, weighting, adopt)
        if bent.alpha.any() and len(rig.parents) > 1:
            assert not np.array_equal(compiled.alpha, bent.alpha)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("name", FIXTURES)
def test_loops_and_numpy_fit_fixtures_alike(
    name: str, weighting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    meshes = rigged_meshes_of(path_of(name))
    assert meshes
    for primitives, rig in meshes:
        assert_fits_agree(primitives, rig, weighting, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_loops_and_numpy_fit_real_models_alike(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    meshes = rigged_meshes_of(path_of(name))
    assert meshes
    for primitives, rig in meshes:
        assert_fits_agree(primitives, rig, "max", monkeypatch)


@pytest.mark.parametrize("name", [CESIUM_MAN, PBR_TEST])
def test_positions_in_float64_give_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for primitives in meshes_of(path_of(name)).values():
        wide = [replace(part, positions=part.positions.astype(np.float64)) for part in primitives]
        narrow = bake(surface_of(primitives))
        found = bake(surface_of(wide))
        for member in ("alpha", "beta", "adopting", "adopted", "sums"):
            assert np.array_equal(getattr(found, member), getattr(narrow, member))
        assert_paths_agree(wide, "max", monkeypatch)


@pytest.mark.parametrize("name", ["foreign_joints.glb", "two_primitives.glb", "seam.glb"])
def test_any_number_of_threads_bakes_the_same_bytes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ((primitives, rig),) = rigged_meshes_of(path_of(name))
    surface = surface_of(primitives)
    surface = surface._replace(rig=rig.with_joints(int(surface.field.joints.max()) + 1))
    whole = bake(surface)
    monkeypatch.setattr(by_loops, "PART", 7)
    found = []
    for count in (1, 2, 3, 8):
        monkeypatch.setenv("OMP_NUM_THREADS", str(count))
        found.append(bake(surface))
    for slots in found:
        for array in ("alpha", "beta", "adopting", "adopted"):
            assert getattr(slots, array).tobytes() == getattr(whole, array).tobytes(), array
        assert slots.sums.tobytes() == found[0].sums.tobytes()
        assert slots.sums == pytest.approx(whole.sums, rel=1e-12)
    assert found[0].adopted.size or name != "foreign_joints.glb"


def test_the_parts_of_a_large_surface_are_told_as_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    (primitives,) = meshes_of(path_of("seam.glb")).values()
    surface = surface_of(primitives)
    parts = len(np.unique(surface.classes)) // 7 + 1
    monkeypatch.setattr(by_loops, "PART", 7)
    told: list[Told] = []
    with heard(told.append), stage("gradients"):
        bake(surface)
    assert told == [Told("", "gradients", done, parts if done else 0) for done in range(parts + 1)]
    assert parts > 2


@pytest.mark.parametrize("count", [1, 3])
def test_rows_are_prepared_in_parts_as_the_definition_does(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(5)
    joints = random.integers(0, 3, (50, 4), dtype=np.int32)
    weights = np.round(random.uniform(-0.5, 1.0, (50, 4)), 1) * (random.random((50, 1)) < 0.8)
    points = random.integers(0, 2, (50, 3)).astype(np.float32)
    corners = random.integers(0, 50, (90, 3)).astype(np.uint32)
    told = {"adopting_sum": 0.5, "adopting_weight": 0.3, "tolerance": 1e-3, "least": 2.0**-30}
    field, defects = by_numpy.normalise_influences(joints.copy(), weights.copy(), **told)
    monkeypatch.setattr(by_loops, "ROWS_A_THREAD", 7)
    with threads_limited(count):
        found, counted = by_loops.normalise_influences(joints.copy(), weights.copy(), **told)
        mask = by_loops.mark_proper(points, corners)
    assert counted == defects
    assert min(defects.negative, defects.all_zero, defects.not_normalised, defects.repeated_joint) > 0
    assert np.array_equal(found.joints, field.joints)
    assert np.array_equal(found.free, field.free)
    assert found.weights == pytest.approx(field.weights, abs=1e-15)
    assert np.array_equal(mask, by_numpy.mark_proper(points, corners))
    assert 0 < np.count_nonzero(mask) < len(mask)


def test_the_kernels_frame_from_normals_is_the_contracts_bit_by_bit() -> None:
    [primitives] = meshes_of(path_of(CESIUM_MAN)).values()
    lengths = np.random.default_rng(1).uniform(0.1, 30.0, (len(primitives[0].normals), 1))
    normals: FloatArray = (primitives[0].normals * lengths).astype(np.float32)
    normals[:4] = np.array([[0, 0, 0], [np.nan, 0, 1], [0, 0, -1], [0, 0, -0.0]])
    part = replace(primitives[0], normals=normals, tangents=None)
    own = surface_of([part])
    vectors = frame_vectors(part, "normal")
    given = own._replace(frame=vectors)
    one, other = (bake(surface) for surface in (own, given))
    assert np.array_equal(one.alpha, other.alpha)
    assert np.array_equal(one.beta, other.beta)
    assert one.alpha[:4].any()


@pytest.fixture(scope="module", params=OTHERWISE, ids=str)
def otherwise(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    return compiled_otherwise("gradients/_kernel", tmp_path_factory.mktemp("otherwise"), *request.param)


@pytest.mark.slow
@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("name", ["foreign_joints.glb", CESIUM_MAN, PBR_TEST])
def test_the_bits_of_a_bake_are_the_same_however_the_loops_are_compiled(
    name: str, weighting: str, otherwise: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    for primitives in meshes_of(path_of(name)).values():
        expected = bake(surface_of(primitives), weighting)
        with monkeypatch.context() as patch:
            patch.setattr(by_loops, "loops", otherwise)
            found = bake(surface_of(primitives), weighting)
        for member in ("alpha", "beta", "adopting", "adopted", "sums"):
            assert np.array_equal(getattr(found, member), getattr(expected, member)), member


def test_weightings_and_defects_have_the_names_of_the_definition() -> None:
    assert list(by_loops.WEIGHTINGS) == list(WEIGHTINGS)
    assert len(set(by_loops.WEIGHTINGS.values())) == len(WEIGHTINGS)
    field, _ = weight_field(empty(3))
    found = _kernel.normalise_influences(field.joints, field.weights, field.free, 0.99, 0.0, 1e-3, 2.0**-30)
    assert set(found) == {*WeightDefects._fields}


def test_comments_of_the_loops_name_twins_that_exist() -> None:
    package = Path(kernel.__file__).parents[1]
    code: dict[str, str] = {}
    for path in package.rglob("*.py"):  # some modules of two rooms share a name
        code[path.stem] = code.get(path.stem, "") + path.read_text(encoding="utf-8")
    loops = "\n".join(path.read_text(encoding="utf-8") for path in package.rglob("*.h"))
    named = re.findall(r"\b([a-z_]+)\.(_?[a-z_]+)\b", "\n".join(re.findall(r"/\*.*?\*/", loops, re.DOTALL)))
    assert {module for module, name in named if name == "py"} <= code.keys()
    twins = {(module, name) for module, name in named if module in code and name not in {"py", "h"}}
    assert [(module, name) for module, name in twins if name not in code[module]] == []


def test_the_environment_can_ask_for_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    assert runpy.run_path(kernel.__file__)["IS_COMPILED"]
    monkeypatch.setenv("SKINBAKE_KERNEL", "numpy")
    chosen = runpy.run_path(kernel.__file__)
    assert not chosen["IS_COMPILED"]
    assert all(chosen[name] is getattr(by_numpy, name) for name in kernel.__all__)
    monkeypatch.setenv("SKINBAKE_KERNEL", "")
    assert runpy.run_path(kernel.__file__)["IS_COMPILED"]


def test_the_environment_cannot_ask_for_anything_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKINBAKE_KERNEL", "nump")
    with pytest.raises(ChoiceError, match='SKINBAKE_KERNEL is "nump" in the environment: expected numpy'):
        runpy.run_path(kernel.__file__)


class TestArguments:
    """Wrong arguments of the compiled loops are an exception, never memory read past its end."""

    def arguments(self) -> dict[str, Any]:
        field, _ = weight_field(empty(3))
        return {
            "positions": np.zeros((3, 3), dtype=np.float32),
            "triangles": np.array([[0, 1, 2]], dtype=np.uint32),
            "joints": field.joints,
            "weights": field.weights,
            "free": field.free,
            "classes": np.arange(3, dtype=np.int32),
            "normals": np.zeros((3, 3), dtype=np.float32),
            "tangents": np.zeros((0, 3)),
            "bitangents": np.zeros((0, 3)),
            "alpha": np.zeros((3, 3), dtype=np.float32),
            "beta": np.zeros((3, 3), dtype=np.float32),
            "adopted": np.zeros((3, 4), dtype=np.int32),
            "ends": np.array([3], dtype=np.uint64),
            "sums": np.zeros((1, 4)),
            "parents": np.array([-1, 0, 1, 0], dtype=np.int32),
            "ranks": np.arange(4, dtype=np.int32),
            "pivots": np.zeros((4, 3)),
            "chains": np.full(4, -1, dtype=np.int32),
            "poses": np.zeros((4, 48)),
            "shares": np.zeros(4),
            "class_count": 3,
            "weighting": _kernel.BY_MAX,
            "adopts": True,
            "negligible": 1e-4,
            "stiffness": 0.1,
            "together": 10.0,
            "turn": 0.2,
            "collapsed": 0.1,
            "ray": 1.5,
            "even": 1e-9,
            "unfelt": 1e-6,
            "narrow": 0.2,
            "flat": 1e-6,
            "flat_tilt": 1e-12,
            "bounded": 3.0,
            "small": 0.02,
            "grouped": None,
            "first": 0,
            "last": 0,
        }

    def test_right_arguments_of_the_loops_raise_nothing(self) -> None:
        _kernel.bake_surface(**self.arguments())

    @pytest.mark.parametrize(
        ("name", "value", "error"),
        [
            ("triangles", np.array([[0, 1, 3]], dtype=np.uint32), IndexError),
            ("triangles", np.array([[0, 1, -1]], dtype=np.int32), IndexError),
            ("triangles", np.array([[0, 1, 2]], dtype=np.int64), TypeError),
            ("classes", np.array([0, 1, 3], dtype=np.int32), IndexError),
            ("classes", np.array([0, 1, -1], dtype=np.int32), IndexError),
            ("classes", np.arange(2, dtype=np.int32), ValueError),
            ("positions", np.zeros((3, 4), dtype=np.float32), ValueError),
            ("positions", np.zeros((3, 3), dtype=np.float16), TypeError),
            ("positions", np.zeros((6, 3), dtype=np.float32)[::2], BufferError),
            ("joints", np.full((3, 4), -1, dtype=np.int32), ValueError),
            ("weights", np.zeros((3, 5)), ValueError),
            ("tangents", np.zeros((2, 3)), ValueError),
            ("tangents", np.zeros((3, 3)), ValueError),
            ("alpha", np.zeros((3, 4), dtype=np.float32), ValueError),
            ("ends", np.array([4], dtype=np.uint64), ValueError),
            ("ends", np.zeros(0, dtype=np.uint64), ValueError),
            ("sums", np.zeros((2, 4)), ValueError),
            ("class_count", 2, IndexError),
            ("class_count", 4, ValueError),
            ("class_count", -1, ValueError),
            ("joints", np.zeros((3, 1), dtype=np.int32), ValueError),
            ("joints", np.full((3, 4), 2**31 - 1, dtype=np.int32), ValueError),
            ("weighting", -1, ValueError),
            ("weighting", 4, ValueError),
            ("parents", np.zeros(4, dtype=np.int64), TypeError),
            ("parents", np.array([-1, 0, 1], dtype=np.int32), ValueError),
            ("ranks", np.zeros(4), TypeError),
            ("ranks", np.arange(3, dtype=np.int32), ValueError),
            ("pivots", np.zeros((4, 3), dtype=np.float32), TypeError),
            ("pivots", np.zeros((4, 2)), ValueError),
            ("pivots", np.zeros((5, 3)), ValueError),
            ("chains", np.zeros(4), TypeError),
            ("chains", np.zeros(3, dtype=np.int32), ValueError),
            ("poses", np.zeros((4, 48), dtype=np.float32), TypeError),
            ("poses", np.zeros((3, 48)), ValueError),
            ("poses", np.zeros((4, 50)), ValueError),
            ("poses", np.zeros((4, 96)), ValueError),  # the shares are those of four poses
            ("shares", np.zeros(3), ValueError),
            ("joints", np.full((3, 4), 4, dtype=np.int32), ValueError),  # the rig has four joints
        ],
    )
    def test_wrong_ones_are_refused(self, name: str, value: Any, error: type[Exception]) -> None:
        with pytest.raises((error, ValueError) if error is BufferError else error):
            _kernel.bake_surface(**{**self.arguments(), name: value})

    @pytest.mark.parametrize(
        ("changed", "message"),
        [
            ({"first": 1, "last": 4}, "out of range"),
            ({"first": -1, "last": 2}, "out of range"),
            ({"first": 2, "last": 1}, "out of range"),
            ({"triangles": np.array([[0, 1, 2]] * 2, dtype=np.uint32)}, "another surface"),
            ({"class_count": 2}, "another surface"),
        ],
    )
    def test_groups_of_other_classes_are_refused(self, changed: dict[str, Any], message: str) -> None:
        given = self.arguments()
        groups = _kernel.group_surface(
            given["triangles"], given["joints"], given["weights"], given["classes"], 3
        )
        given |= {"grouped": groups, "first": 0, "last": 3}
        _kernel.bake_surface(**given)
        with pytest.raises(ValueError, match=message):
            _kernel.bake_surface(**{**given, **changed})

    def test_groups_are_no_other_object(self) -> None:
        with pytest.raises(ValueError, match="PyCapsule"):
            _kernel.bake_surface(**{**self.arguments(), "grouped": "all"})

    @pytest.mark.parametrize(
        ("parents", "ranks"),
        [
            ([1, 0], [0, 1]),  # a circle
            ([0, 1], [0, 1]),  # joints that carry themselves
            ([-1, 2], [0, 1]),
            ([2**31 - 1, -(2**31)], [0, 1]),
            ([-1, 0], [0, 0]),
            ([-1, 0], [2**31 - 1, -(2**31)]),
        ],
    )
    def test_parents_that_are_none_carry_nothing(self, parents: list[int], ranks: list[int]) -> None:
        """Joints are found by walking up: each step must come nearer to the end, and stay in the array."""
        given = self.varying()
        given |= {"parents": np.array(parents, np.int32), "ranks": np.array(ranks, np.int32)}
        _kernel.bake_surface(**given)
        assert np.isfinite(given["alpha"]).all()

    def varying(self) -> dict[str, Any]:
        """Return the arguments of a triangle over which the weights of two joints change."""
        weights = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
        positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
        normals = np.tile(np.array([0, 0, 1], dtype=np.float32), (3, 1))
        field, _ = weight_field(
            SkinnedPrimitive(
                positions, normals, None, np.tile([0, 1], (3, 1)), weights, np.array([[0, 1, 2]])
            )
        )
        return {
            **self.arguments(),
            "positions": positions,
            "normals": normals,
            "joints": field.joints,
            "weights": field.weights,
            "free": field.free,
            "alpha": np.zeros((3, 1), dtype=np.float32),
            "beta": np.zeros((3, 1), dtype=np.float32),
            "adopted": np.zeros((3, 2), dtype=np.int32),
            "pivots": np.array([[0.3, 0.2, -1.0], [0.1, 0.4, -2.0]]),
            "chains": np.zeros(2, dtype=np.int32),
            "poses": np.zeros((2, 0)),
            "shares": np.zeros(0),
        }

    def test_a_surface_without_vertices_has_no_classes(self) -> None:
        empty: dict[str, Any] = {
            name: value[:0] if isinstance(value, np.ndarray) and name not in KEPT else value
            for name, value in self.arguments().items()
        }
        empty["ends"] = np.zeros(1, dtype=np.uint64)
        _kernel.bake_surface(**{**empty, "class_count": 0})
        with pytest.raises(ValueError, match="weld classes"):
            _kernel.bake_surface(**{**empty, "class_count": -1})

    def test_vertices_without_slots_are_refused(self) -> None:
        joints, weights, free = np.zeros((3, 0), np.int32), np.zeros((3, 0)), np.zeros((3, 0), np.bool_)
        with pytest.raises(ValueError, match="at least 1"):
            _kernel.normalise_influences(joints, weights, free, 0.99, 0.0, 1e-3, 2.0**-30)


KEPT = ("ends", "sums", "parents", "ranks", "pivots", "chains", "poses", "shares")
"""Arguments that have other lengths than vertices and triangles."""

RACE = """
import sys
import threading
import numpy as np
from skinbake.gradients import _kernel
chance, V, S = np.random.default_rng(3), 20_000, 4
positions = chance.normal(size=(V, 3)).astype(np.float32)
triangles = chance.integers(0, V, (2 * V, 3)).astype(np.uint32)
joints = chance.integers(0, 30, (V, S)).astype(np.int32)
parents, ranks = np.arange(-1, 29, dtype=np.int32), np.arange(30, dtype=np.int32)
pivots, chains = chance.normal(size=(30, 3)), np.zeros(30, np.int32)
poses, shares = chance.normal(size=(30, 48)), np.full(4, 0.25)
weights, free = chance.random((V, S)), np.zeros((V, S), np.bool_)
classes, ends = (np.arange(V) // 2).astype(np.int32), np.array([V // 2, V], np.uint64)
kept = [array.copy() for array in (triangles, joints, classes, ends, parents, ranks, chains)]
going = True

def anything():
    chance = np.random.default_rng(7)
    while going:
        triangles[chance.integers(2 * V, size=200)] = chance.choice([2**32 - 1, V, 2**31 - 1, 3])
        joints[chance.integers(V, size=200)] = chance.choice([29, 2**31 - 1, 10**5])
        classes[chance.integers(V, size=200)] = chance.choice([2**31 - 1, 0, 5, V // 2])
        ends[:] = 2**60
        parents[chance.integers(30)] = chance.choice([2**31 - 1, -7, 0, 29])
        ranks[chance.integers(30)] = chance.choice([2**31 - 1, -7, 0, 29])
        chains[chance.integers(30)] = chance.choice([2**31 - 1, -7, 0, -1])

def classes_of_neighbours():
    chance = np.random.default_rng(7)
    while going:
        some = chance.integers(4, V - 4)
        classes[some] = classes[some + chance.integers(-3, 4)]

spoil, wait = {"anything": (anything, 0.001), "classes": (classes_of_neighbours, 0.0)}[sys.argv[1]]
grouped = _kernel.group_surface(triangles, joints, weights, classes, V // 2)

for turn in range(16):
    for array, before in zip((triangles, joints, classes, ends, parents, ranks, chains), kept):
        array[...] = before
    alpha = np.empty((V, S - 1), np.float32)
    frames = np.zeros((0, 3), np.float32)
    going, other = True, threading.Timer(wait * (turn % 8), spoil)
    other.start()
    try:
        _kernel.bake_surface(
            positions=positions, triangles=triangles, joints=joints, weights=weights, free=free,
            classes=classes, normals=positions, tangents=frames, bitangents=frames, alpha=alpha,
            beta=alpha.copy(), adopted=np.zeros((V, S), np.int32), ends=ends, sums=np.zeros((2, 4)),
            parents=parents, ranks=ranks, pivots=pivots, chains=chains, poses=poses, shares=shares,
            class_count=V // 2,
            weighting=_kernel.BY_ANGLE, adopts=True, negligible=1e-4, stiffness=0.1,
            turn=0.2, together=10.0, collapsed=0.1, ray=1.5, even=1e-9, unfelt=1e-6, flat_tilt=1e-12,
            narrow=0.2, flat=1e-6, bounded=3.0, small=0.02,
            grouped=grouped if spoil is anything and turn % 2 else None, first=0, last=V // 2)
    except (IndexError, ValueError):
        pass
    going = False
    other.join()
"""


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", ["anything", "classes"])
def test_arrays_that_change_meanwhile_never_lead_the_loops_astray(spoilt: str) -> None:
    """Another thread writes to the arrays while the compiled loops, without the GIL, read them.

    Classes that change among those that exist are counted wrongly, and no check of an index sees it.
    """
    process = subprocess.run(
        [sys.executable, "-c", RACE, spoilt],
        env={**os.environ, "MALLOC_PERTURB_": "85"},  # new memory holds no zeros, with glibc
        capture_output=True,
        timeout=120,
        check=False,
    )
    assert process.returncode == 0, process.stderr.decode()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_equal_rows_are_found_as_by_sorting(dtype: type, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    positions: FloatArray = rng.integers(-2, 3, (5000, 3)).astype(dtype)
    positions[rng.random(positions.shape) < 0.2] *= -1  # makes −0 of some zeros
    found, expected = both(monkeypatch, lambda: kernel.label_equal_rows(positions))
    assert np.array_equal(found, expected)
    keys = rng.integers(0, 3, (3000, 5)).astype(np.uint64)
    found, expected = both(monkeypatch, lambda: kernel.label_equal_rows(keys))
    assert np.array_equal(found, expected)
    assert len(np.unique(found)) == len(np.unique(keys, axis=0))


def degenerate() -> SkinnedPrimitive:
    """Return a mesh with all that has no area or no triangle, next to slivers and huge and tiny triangles."""
    surface = analytic_surface(100, "random", seed=4).primitive
    count = len(surface.positions)
    extra = np.array(
        [
            [0.0, 0.0, 9.0],
            [1.0, 0.0, 9.0],
            [2.0, 0.0, 9.0],  # on the line of the two above
            [1.0, 1e-12, 9.0],  # a sliver's height away from it
            [1e6, 1e6, 9.0],
            [1e-6, 0.0, 9.0],
            [0.0, 1e-6, 9.0],
            [5.0, 5.0, 5.0],  # of no triangle
        ]
    )
    faces = np.array([[0, 1, 2], [0, 1, 1], [2, 2, 2], [0, 1, 3], [0, 2, 4], [0, 5, 6]]) + count
    faces = np.concatenate([faces, [[0, 0, 1], [0, 1, 0]]])
    return SkinnedPrimitive(
        np.concatenate([surface.positions, extra]),
        np.concatenate([surface.normals, np.tile([0.0, 0.0, 1.0], (len(extra), 1))]),
        None,
        np.concatenate([surface.joints.astype(np.int64), np.tile([[0, 5, 5, 9]], (len(extra), 1))]),
        np.concatenate([surface.weights, np.random.default_rng(0).random((len(extra), 4))]),
        np.concatenate([surface.triangles, faces]),
    )


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_loops_and_numpy_ignore_what_has_no_area_without_a_warning(
    weighting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Warnings are errors in this suite: a division by an area of zero would not pass.
    table = assert_paths_agree([degenerate()], weighting, monkeypatch)
    assert not table[-1].any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bent_tube.glb", CESIUM_MAN])
def test_loops_and_numpy_fit_around_what_has_no_area(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    [(primitives, rig)] = rigged_meshes_of(path_of(name))
    whole, *rest = primitives
    unused, collapsed = whole.triangles[10, 0], whole.triangles[20, 1]
    triangles = whole.triangles[(whole.triangles != unused).all(axis=1)].copy()
    triangles[(triangles == collapsed).any(axis=1)] = collapsed
    broken = [replace(whole, triangles=triangles), *rest]
    assert_fits_agree(broken, rig, "max", monkeypatch)
    slots = bake(with_rig(surface_of(broken), rig))
    table = np.hstack([slots.alpha, slots.beta])
    assert np.isfinite(table).all()
    assert not table[[unused, collapsed]].any()


def fan(rim: Float64Array, hub: Float64Array) -> tuple[SkinnedPrimitive, Rig]:
    """Return a flat fan around a hub, vertex 0, with its rim's weights (R, 4), and a rig of four joints."""
    count = len(rim)
    angles = np.arange(count) / count * 2.0 * np.pi
    circle = np.round(np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1), 6)
    beside = 1 + (np.arange(count) + 1) % count
    primitive = SkinnedPrimitive(
        np.concatenate([np.zeros((1, 3)), circle]).astype(np.float32),
        np.tile(np.array([0, 0, 1], dtype=np.float32), (count + 1, 1)),
        None,
        np.tile([0, 1, 2, 3], (count + 1, 1)),
        np.concatenate([hub[None], rim]),
        np.stack([np.zeros(count, dtype=np.int64), 1 + np.arange(count), beside], axis=1),
    )
    pivots = np.random.default_rng(8).normal(size=(4, 3))
    return primitive, Rig(np.array([-1, 0, 1, 2], dtype=np.int32), pivots)


def test_loops_and_numpy_fit_where_gradients_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    rim, hub = np.tile([0.25, 0.125, 0.25, 0.375], (4, 1)), np.array([0.125, 0.25, 0.125, 0.5])
    primitive, rig = fan(rim, hub)
    assert not bake(surface_of([primitive])).alpha[0].any()
    compiled, whole = both(monkeypatch, partial(bake, with_rig(surface_of([primitive]), rig)))
    assert np.abs(compiled.alpha[0]).max() > 0.01
    assert compiled.alpha[0] == pytest.approx(whole.alpha[0], rel=1e-5)
    # As where they nearly cancel.
    rim[0] += [2.0**-30, 0.0, 0.0, -(2.0**-30)]
    near = bake(with_rig(surface_of([fan(rim, hub)[0]]), rig))
    assert compiled.alpha[0] == pytest.approx(near.alpha[0], rel=1e-5)


@pytest.mark.parametrize(("corners", "fits"), [(4096, True), (4097, False)])
def test_loops_and_numpy_leave_points_with_very_many_corners(
    corners: int, fits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = np.random.default_rng(7).random((corners + 1, 4)) + 0.1
    weights /= weights.sum(axis=1, keepdims=True)
    primitive, rig = fan(weights[1:], weights[0])
    plain = surface_of([primitive])
    compiled, whole = both(monkeypatch, partial(bake, with_rig(plain, rig)))
    assert compiled.alpha[0] == pytest.approx(whole.alpha[0], rel=1e-4)
    assert (compiled.alpha[0] != pytest.approx(bake(plain).alpha[0], rel=1e-3)) == fits


def fan_of_joints(joints: Sequence[int], parents: Sequence[int]) -> tuple[SkinnedPrimitive, Rig]:
    """Return a fan whose vertices all have these joints, random weights, and a rig of their parents."""
    random = np.random.default_rng(7)
    weights = random.random((9, len(joints))) + 0.1
    weights /= weights.sum(axis=1, keepdims=True)
    primitive, _ = fan(weights[1:], weights[0])
    rig = Rig(np.array(parents, dtype=np.int32), random.normal(size=(len(parents), 3)))
    return replace(primitive, joints=np.tile(np.array(joints), (9, 1))), rig


def assert_both_paths_fit(
    primitive: SkinnedPrimitive, rig: Rig, fits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = surface_of([primitive])
    gradients = bake(plain).alpha
    for slots in both(monkeypatch, partial(bake, with_rig(plain, rig))):
        assert (slots.alpha != pytest.approx(gradients, rel=1e-3)) == fits


@pytest.mark.parametrize(("turns", "fits"), [(128, True), (129, False)])
def test_loops_and_numpy_leave_vertices_with_very_many_turns(
    turns: int, fits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On one chain, the turn of each joint but joint 0 parts the first one from the last."""
    primitive, rig = fan_of_joints([0, turns], range(-1, turns))
    assert_both_paths_fit(primitive, rig, fits, monkeypatch)


@pytest.mark.parametrize(("joints", "fits"), [(64, True), (65, False)])
def test_loops_and_numpy_leave_vertices_with_very_many_fitted_joints(
    joints: int, fits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    primitive, rig = fan_of_joints(range(1, joints + 1), [-1, *[0] * joints])
    assert_both_paths_fit(primitive, rig, fits, monkeypatch)


def test_loops_and_numpy_count_no_joint_whose_turn_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A triangle stands upright on the fan. Its hat functions rise along the normal, so no tangent turns."""
    primitive, _ = fan(np.full((8, 4), 0.25), np.array([0.4, 0.3, 0.2, 0.1]))
    joints = np.tile([0, 40, 80, 120], (10, 1))
    joints[9] = [160, 0, 0, 0]  # at the end of a chain of its own: with its joints, 160 would turn
    upright = replace(
        primitive,
        positions=np.concatenate([primitive.positions, [[0, 0, 1]]]).astype(np.float32),
        normals=np.tile(primitive.normals[0], (10, 1)),
        joints=joints,
        weights=np.concatenate([primitive.weights, [[1.0, 0.0, 0.0, 0.0]]]),
        triangles=np.concatenate([primitive.triangles, [[0, 1, 9]]]),
    )
    upright.weights[1] = [0.1, 0.2, 0.3, 0.4]
    parents = np.arange(-1, 160, dtype=np.int32)
    parents[121] = -1
    rig = Rig(parents, np.random.default_rng(7).normal(size=(161, 3)))
    plain = surface_of([upright])
    hub = bake(plain).alpha[0]
    for slots in both(monkeypatch, partial(bake, with_rig(plain, rig))):
        assert slots.alpha[0] != pytest.approx(hub, rel=1e-3)


@pytest.mark.parametrize(("height", "fits"), [(1e-5, True), (1e-7, False)])
def test_loops_and_numpy_leave_rings_of_slivers(
    height: float, fits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rim, hub = np.array([[0.5, 0.5, 0.0, 0.0], [0.3, 0.1, 0.6, 0.0]]), np.array([0.2, 0.3, 0.1, 0.4])
    primitive, rig = fan(rim, hub)
    positions = np.array([[0, 0, 0], [1, 0, 0], [2, height, 0]], dtype=np.float32)
    plain = surface_of([replace(primitive, positions=positions, triangles=np.array([[0, 1, 2]]))])
    gradients = bake(plain).beta
    for slots in both(monkeypatch, partial(bake, with_rig(plain, rig))):
        assert (np.abs(slots.beta - gradients).max() > 1e-4 * np.abs(gradients).max()) == fits


@pytest.mark.parametrize("far", [1e100, 1e200])
def test_loops_and_numpy_leave_gradients_where_levers_overflow(
    far: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint whose inverse bind matrix is nearly singular has its pivot that far away."""
    weights = np.random.default_rng(7).random((9, 4)) + 0.1
    primitive, rig = fan(weights[1:], weights[0])
    plain, whole = surface_of([primitive]), bake(surface_of([primitive]))
    fit = bake(with_rig(plain, rig))
    # The root carries all joints around a vertex, so its pivot does not matter.
    rig.pivots[0] *= far
    for slots in both(monkeypatch, partial(bake, with_rig(plain, rig))):
        assert slots.alpha == pytest.approx(fit.alpha, rel=1e-5)
        assert slots.alpha != pytest.approx(whole.alpha, rel=1e-3)
    rig.pivots[2] *= far
    for slots in both(monkeypatch, partial(bake, with_rig(plain, rig))):
        assert slots.alpha == pytest.approx(whole.alpha, rel=1e-5)
        assert slots.beta == pytest.approx(whole.beta, rel=1e-5)


def test_loops_and_numpy_fit_in_any_slots(monkeypatch: pytest.MonkeyPatch) -> None:
    weights = np.random.default_rng(7).random((9, 4)) + 0.1
    primitive, rig = fan(weights[1:], weights[0])
    few = bake(with_rig(surface_of([primitive]), rig))
    before, after = (np.zeros((9, count), dtype=primitive.joints.dtype) for count in (254, 42))
    many = replace(
        primitive,
        joints=np.hstack([before, primitive.joints, after]),
        weights=np.hstack([before, primitive.weights, after]),
    )
    for slots in both(monkeypatch, partial(bake, with_rig(surface_of([many]), rig))):
        assert slots.alpha[:, 254:257] == pytest.approx(few.alpha, rel=1e-5)


def empty(vertices: int) -> SkinnedPrimitive:
    return SkinnedPrimitive(
        np.zeros((vertices, 3), dtype=np.float32),
        np.tile(np.array([0, 0, 1], dtype=np.float32), (vertices, 1)),
        None,
        np.tile([3, 0, 0, 0], (vertices, 1)),
        np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (vertices, 1)),
        np.zeros((0, 3), dtype=np.int64),
    )


@pytest.mark.parametrize("faces", [[], [[0, 1, 2]]])
def test_a_mesh_without_any_area_has_alpha_zero(
    faces: list[list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    flat = replace(empty(3), triangles=np.array(faces, dtype=np.int64).reshape(-1, 3))
    for [(found, numbers)] in both(monkeypatch, lambda: bake_primitives([flat], bake_settings())):
        assert found.alpha.tolist() == np.zeros((3, 3)).tolist()
        assert numbers.degenerate_triangles == len(faces)
        assert numbers.lost == 0.0
        assert not found.adopts


@pytest.mark.parametrize("name", ["foreign_joints.glb", CESIUM_MAN, BARBARIAN])
def test_loops_and_numpy_bake_the_same_file(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def bake_file() -> list[tuple[BakedPrimitive, BakeFindings]]:
        return [
            outcome
            for primitives in meshes_of(path_of(name)).values()
            for outcome in bake_primitives(primitives, bake_settings())
        ]

    def joints(outcome: BakedPrimitive) -> list[list[int]]:
        listed: list[list[int]] = np.sort(outcome.adopted_joints, axis=1).tolist()
        return listed

    for (compiled, numbers), (plain, own) in zip(*both(monkeypatch, bake_file), strict=True):
        assert joints(compiled) == joints(plain)
        assert numbers.overflowing_vertices == own.overflowing_vertices
        assert numbers.adopting_vertices == own.adopting_vertices
        assert numbers.lost == pytest.approx(own.lost, abs=1e-9)


def test_many_joints_at_one_vertex_outgrow_the_kernels_first_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    # A fan whose hub has more corners than the kernel makes room for, and sees a new joint on every spoke.
    spokes = 400
    angles = np.linspace(0.0, 2.0 * np.pi, spokes, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(spokes)])
    numbers = np.arange(spokes)
    joints: npt.NDArray[np.int64] = np.zeros((spokes + 1, 4), dtype=np.int64)
    joints[1:, 0] = spokes - numbers
    part = SkinnedPrimitive(
        np.concatenate([[[0.0, 0.0, 0.0]], rim]),
        np.tile([0.0, 0.0, 1.0], (spokes + 1, 1)),
        None,
        joints,
        np.tile([1.0, 0.0, 0.0, 0.0], (spokes + 1, 1)),
        np.column_stack([np.zeros(spokes, dtype=np.int64), 1 + numbers, 1 + (numbers + 1) % spokes]),
    )
    compiled, plain = both(monkeypatch, lambda: bake(surface_of([part])))
    # By symmetry every spoke's joint has a gradient c (cos θ, sin θ) along its spoke. The mean is exact for
    # the linear field x, which is cos θ at the rim: Σ cos θ · c cos θ = c · spokes / 2 = 1.
    for slots in (compiled, plain):
        assert slots.adopting[0] == 0
        assert slots.adopted[0, 0] == -1
        assert len(set(slots.adopted[0, 1:].tolist())) == 3
        assert np.hypot(slots.alpha[0], slots.beta[0]) == pytest.approx(np.full(3, 2.0 / spokes), rel=1e-6)
        # Of the hub's spokes + 1 gradients three have a slot; slot 0 holds joint 0's, which is 0.
        assert slots.sums[0, 3] >= (spokes - 3) * 2.0 / spokes * (1 - 1e-9)


def test_the_definition_in_numpy_keeps_its_promise() -> None:
    surface = surface_of([degenerate()])
    found: VertexGradients = weight_gradients(
        surface.positions, surface.triangles, surface.field, surface.classes, weighting="max"
    )
    assert found.offsets[0] == 0
    assert found.offsets[-1] == len(found.joints) == len(found.gradients)
    for start, end in zip(found.offsets[:-1], found.offsets[1:], strict=True):
        assert (np.diff(found.joints[start:end]) > 0).all()
        # Weights sum to one, so their gradients sum to zero, up to float64's rounding.
        vectors = found.gradients[start:end]
        assert np.abs(vectors.sum(axis=0)).max() <= 1e-12 * max(np.abs(vectors).max(initial=0.0), 1.0)


def test_rows_made_to_collide_take_no_longer_than_sorting_does() -> None:
    """Invert the kernel's hash: rows that all begin their search at one place of its table."""
    count, bits = 20_000, (1 << 64) - 1
    factor, start = 0xBF58476D1CE4E5B9, 0x9E3779B97F4A7C15
    undone = pow(factor, -1, 1 << 64)
    rows = []
    for number in range(count):
        mixed = number << 40
        mixed ^= mixed >> 32
        mixed ^= (mixed >> 29) ^ (mixed >> 58)
        rows.append((mixed * undone & bits) ^ start)
    keys = np.array(rows, dtype=np.uint64)[:, None]
    with pytest.raises(_kernel.CollisionError):
        _kernel.label_equal_rows(keys, np.empty(count, dtype=np.int32))
    assert np.array_equal(kernel.label_equal_rows(keys), np.arange(count))
    keys[1::2] = keys[::2]
    assert np.array_equal(kernel.label_equal_rows(keys), np.arange(count) // 2)
    # Half as many that collide by chance alone are none of this.
    ordinary = np.random.default_rng(5).integers(0, 1 << 62, (count, 1)).astype(np.uint64)
    assert _kernel.label_equal_rows(ordinary, np.empty(count, dtype=np.int32)) == count
