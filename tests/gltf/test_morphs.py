"""Morph targets and their weights as files have them, against values that the tests wrote."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from skinbake.errors import InputError
from skinbake.geometry.morphs import Differences, MorphTargets
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf import asset
from skinbake.gltf.reading.clips import clip_weights, read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.morphs import read_targets
from tests.support.calls import count_calls
from tests.support.gltf_reading import JsonObject
from tests.support.small_documents import Builder, animate

V = 4
POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=np.float32)
MOVED = np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, 0], [0.25, 0, 1]], dtype=np.float32)


def face(targets: list[dict[str, object]] | None = None) -> Builder:
    """Make one skinned square on node 1 with these targets; an attribute is an array or an accessor."""
    builder = Builder()
    attributes = {
        "POSITION": builder.accessor(POSITIONS),
        "NORMAL": builder.accessor(np.tile([0.0, 0, 1], (V, 1))),
        "TANGENT": builder.accessor(np.tile([1.0, 0, 0, 1], (V, 1))),
        "JOINTS_0": builder.accessor(np.zeros((V, 4), np.uint16)),
        "WEIGHTS_0": builder.accessor(np.tile([1.0, 0, 0, 0], (V, 1))),
    }
    primitive: JsonObject = {"attributes": attributes}
    if targets is not None:
        primitive["targets"] = [
            {
                name: value if isinstance(value, int) else builder.accessor(value)
                for name, value in target.items()
            }
            for target in targets
        ]
    builder.json["meshes"] = [{"primitives": [primitive]}]
    builder.json["nodes"] = [{"name": "joint"}, {"mesh": 0, "skin": 0}]
    builder.json["skins"] = [{"joints": [0]}]
    return builder


def read(builder: Builder, wanted: list[int], *, tangents: bool = False) -> MorphTargets | None:
    document = builder.document()
    (source,) = skinned_sources(document)
    return read_targets(document, source, wanted, count=V, tangents=tangents)


def dense(differences: Differences) -> Float64Array:
    result = np.zeros((V, 3))
    result[differences.rows] = differences.values
    return result


def test_targets_are_read_by_number_and_attributes_may_be_missing() -> None:
    turned = np.tile([0.5, 0, -0.25], (V, 1))
    found = read(face([{"POSITION": MOVED}, {"NORMAL": turned}, {"POSITION": -MOVED}]), [0, 1])
    assert found is not None
    assert not found.with_tangents
    first, second = found.targets
    assert dense(first.positions) == pytest.approx(MOVED)
    assert first.positions.rows.tolist() == [1, 3]
    assert not dense(first.normals).any()
    assert dense(second.normals) == pytest.approx(turned)
    assert not dense(second.positions).any()


def test_tangents_are_read_only_for_the_tangent_frame_and_where_a_target_has_them() -> None:
    turned = np.tile([0.0, 0.5, 0.0], (V, 1))
    builder = face([{"TANGENT": turned}, {"POSITION": MOVED}])
    with_tangents = read(builder, [0, 1], tangents=True)
    assert with_tangents is not None
    assert with_tangents.with_tangents
    assert dense(with_tangents.targets[0].tangents) == pytest.approx(turned)
    without = read(builder, [0, 1])
    assert without is not None
    assert not without.with_tangents
    assert not dense(without.targets[0].tangents).any()
    no_tangents = read(face([{"POSITION": MOVED}]), [0], tangents=True)
    assert no_tangents is not None
    assert not no_tangents.with_tangents


def test_differences_count_as_held_once_an_accessor_and_without_the_zeros() -> None:
    """Reading them takes more, which is let go."""
    builder = face([{"POSITION": MOVED}, {"POSITION": -MOVED}])
    targets = builder.json["meshes"][0]["primitives"][0]["targets"]
    targets.append(targets[0])
    document = builder.document()
    (source,) = skinned_sources(document)
    before = document.budget.held
    found = read_targets(document, source, [0, 1, 2], count=V, tangents=False)
    assert found is not None
    kept = [target.positions for target in found.targets[:2]]
    assert document.budget.held - before == sum(one.rows.nbytes + one.values.nbytes for one in kept)


def test_a_primitive_without_targets_has_none() -> None:
    assert read(face(), []) is None
    assert face().document().asset.meshes[0].target_count == 0


@pytest.mark.parametrize(
    ("stored", "normalized", "unit"),
    [(np.int8, True, 127), (np.int16, True, 32767), (np.int8, False, 1), (np.int16, False, 1)],
)
def test_quantised_differences_are_decoded(stored: type, normalized: bool, unit: int) -> None:
    values = np.array([[0, 0, 0], [1, -2, 3], [0, 100, 0], [-127, 0, 0]])
    builder = face([{"POSITION": MOVED}])
    builder.json["meshes"][0]["primitives"][0]["targets"] = [
        {"POSITION": builder.accessor(np.pad(values, ((0, 0), (0, 1))).astype(stored), normalized=normalized)}
    ]
    # Elements of three, padded to four: as KHR_mesh_quantization wants them aligned.
    accessor, view = builder.json["accessors"][-1], builder.json["bufferViews"][-1]
    accessor["type"], view["byteStride"] = "VEC3", 4 * np.dtype(stored).itemsize
    found = read(builder, [0])
    assert found is not None
    assert dense(found.targets[0].positions) == pytest.approx(values / unit)


def test_sparse_differences_stand_on_zeros() -> None:
    builder = face([{"POSITION": MOVED}])
    where = builder.accessor(np.array([3], np.uint16))
    what = builder.accessor(np.array([[7.0, 8.0, 9.0]]))
    views = [builder.json["accessors"][number]["bufferView"] for number in (where, what)]
    target = builder.json["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]
    builder.json["accessors"][target] = {
        "componentType": 5126,
        "count": V,
        "type": "VEC3",
        "sparse": {
            "count": 1,
            "indices": {"bufferView": views[0], "componentType": 5123},
            "values": {"bufferView": views[1]},
        },
    }
    found = read(builder, [0])
    assert found is not None
    assert found.targets[0].positions.rows.tolist() == [3]
    assert found.targets[0].positions.values.tolist() == [[7.0, 8.0, 9.0]]


def test_an_accessor_that_targets_share_is_read_once() -> None:
    builder = face([{"POSITION": MOVED}])
    targets = builder.json["meshes"][0]["primitives"][0]["targets"]
    targets += [targets[0]] * 1000
    found = read(builder, list(range(1001)))
    assert found is not None
    assert len({id(target.positions) for target in found.targets}) == 1


# Weights at rest


def weights_of(**places: object) -> list[float]:
    builder = face([{"POSITION": MOVED}, {"POSITION": -MOVED}])
    for name, weights in places.items():
        owner = builder.json["meshes"][0] if name == "mesh" else builder.json["nodes"][1]
        owner["weights"] = weights
    found: list[float] = builder.document().asset.nodes[1].resting_weights().tolist()
    return found


def test_weights_at_rest_are_the_node_s_else_the_mesh_s_else_zero() -> None:
    assert weights_of() == [0.0, 0.0]
    assert weights_of(mesh=[0.5, -1]) == [0.5, -1.0]
    assert weights_of(mesh=[0.5, -1], node=[2, 0.25]) == [2.0, 0.25]
    assert weights_of(node=[2, 0.25]) == [2.0, 0.25]


@pytest.mark.parametrize(
    "weights", [[1.0], [1.0, 2.0, 3.0], "two", [True, 0.0], [None, 0.0], [1e39, 0.0], [10**400, 0]]
)
@pytest.mark.parametrize("owner", ["mesh", "node"])
def test_weights_at_rest_that_are_not_numbers_are_refused(owner: str, weights: object) -> None:
    named = "its mesh" if owner == "mesh" else "node 1"
    with pytest.raises(InputError, match=f'"weights" of {named} must be 2 numbers'):
        weights_of(**{owner: weights})


# Animated weights

TIMES = (0.0, 1.0, 3.0)


def animated(
    method: str, values: object, *, normalized: bool = False, at: tuple[float, float] = (0.5, 2.0)
) -> Float64Array:
    builder = face([{"POSITION": MOVED}, {"POSITION": -MOVED}])
    animate(
        builder,
        path="weights",
        node=1,
        method=method,
        times=TIMES,
        values=values,
        normalized=normalized,
    )
    (clip,) = read_clips(builder.document())
    found = clip_weights(1, clip, np.array(at), np.array([9.0, 9.0]))
    assert clip_weights(0, clip, np.array([0.0]), np.array([9.0, 9.0])).tolist() == [[9.0, 9.0]]
    return found


def test_weights_step() -> None:
    found = animated("STEP", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert found == pytest.approx(np.array([[0.1, 0.2], [0.3, 0.4]]), abs=1e-7)


def test_weights_are_interpolated_linearly_target_by_target() -> None:
    expected = [[0.2, 0.3], [0.4, 0.5]]
    assert animated("LINEAR", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]) == pytest.approx(np.array(expected), abs=1e-7)


def test_weights_go_beyond_no_key() -> None:
    found = animated("LINEAR", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], at=(-1.0, 9.0))
    assert found == pytest.approx(np.array([[0.1, 0.2], [0.5, 0.6]]), abs=1e-7)


def test_weights_follow_cubic_splines_with_in_tangents_values_and_out_tangents_of_all_targets() -> None:
    """Specification, §3.7.3.2 and C.5: per key a1 a2, v1 v2, b1 b2; by hand at the middle of a span."""
    keys = np.array(
        [
            [[9.0, 9.0], [0.0, 1.0], [0.4, -0.8]],
            [[0.8, 0.0], [1.0, 3.0], [0.0, 0.0]],
            [[0.0, 0.0], [1.0, 3.0], [9.0, 9.0]],
        ]
    )
    # s = ½: (v0 + v1) / 2 + span (b0 − a1) / 8. The second span, 2 s long, begins and ends flat.
    expected = [[0.5 + (0.4 - 0.8) / 8, 2.0 + (-0.8 - 0.0) / 8], [1.0, 3.0]]
    assert animated("CUBICSPLINE", keys.ravel()) == pytest.approx(np.array(expected), abs=1e-7)


def test_normalised_weights_are_decoded() -> None:
    values = np.array([0, 65535, 13107, 0, 65535, 0], dtype=np.uint16)
    expected = [[0.1, 0.5], [0.6, 0.0]]
    assert animated("LINEAR", values, normalized=True) == pytest.approx(np.array(expected), abs=1e-12)


@pytest.mark.parametrize("change", [{"skin": None}, {"mesh": None}])
def test_weights_of_nodes_that_draw_no_skinned_mesh_are_left_out(change: JsonObject) -> None:
    builder = face([{"POSITION": MOVED}])
    animate(builder, path="weights", node=1, times=TIMES, values=[0.0])  # broken, and never looked at
    for key in change:
        del builder.json["nodes"][1][key]
    assert read_clips(builder.document()) == []


# Broken files


def edited(change: Callable[[JsonObject], object]) -> Builder:
    builder = face([{"POSITION": MOVED, "NORMAL": MOVED}, {"POSITION": MOVED}])
    animate(builder, path="weights", node=1, times=TIMES, values=np.zeros(6))
    change(builder.json)
    return builder


def _targets(content: JsonObject) -> list[JsonObject]:
    found: list[JsonObject] = content["meshes"][0]["primitives"][0]["targets"]
    return found


def _accessor(content: JsonObject, name: str = "POSITION") -> JsonObject:
    found: JsonObject = content["accessors"][_targets(content)[0][name]]
    return found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda json: _targets(json)[0].update(POSITION=99),
            "POSITION of morph target 0.*refers to entry 99",
        ),
        (
            lambda json: _targets(json)[1].update(POSITION="x"),
            "POSITION of morph target 1.*must be an integer",
        ),
        (lambda json: _accessor(json).update(count=3), "it has 3 elements, POSITION has 4"),
        (lambda json: _accessor(json).update(count=10**9), "it has 1,000,000,000 elements, POSITION has 4"),
        (lambda json: _accessor(json).update(type="VEC2"), "it has 2 components, 3 are needed"),
        (lambda json: _accessor(json).update(type="SCALAR"), "it has 1 component, 3 are needed"),
        (lambda json: _accessor(json).update(count=1), "it has 1 element, POSITION has 4"),
        (lambda json: _accessor(json).update(componentType=5125), "must be floats, or signed.*found uint32"),
        (lambda json: _accessor(json, "NORMAL").update(componentType=5120), "NORMAL.*normalised.*found int8"),
        (lambda json: _accessor(json).update(bufferView=0, byteOffset=40), "need 88 bytes of buffer view 0"),
        (
            lambda json: json["meshes"][0]["primitives"][0]["targets"].append(7),
            '"targets" must be an array of objects',
        ),
    ],
)
def test_broken_targets_are_refused(change: Callable[[JsonObject], object], message: str) -> None:
    with pytest.raises(InputError) as raised:
        read(edited(change), [0, 1])
    assert re.search(message, str(raised.value)), str(raised.value)
    assert "mesh 0, primitive 0" in str(raised.value)


def test_positions_must_be_finite_and_normals_that_are_not_count_as_nothing() -> None:
    broken = MOVED.copy()
    broken[2, 1] = np.nan
    with pytest.raises(InputError, match=r"POSITION of morph target 0.*finite"):
        read(face([{"POSITION": broken}]), [0])
    found = read(face([{"NORMAL": broken}]), [0])
    assert found is not None
    assert found.targets[0].normals.rows.tolist() == [1, 3]


def test_targets_that_do_not_move_are_not_read() -> None:
    found = read(face([{"POSITION": 99}, {"POSITION": MOVED}]), [1])
    assert found is not None
    assert dense(found.targets[0].positions) == pytest.approx(MOVED)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda json: _targets(json).pop(), "of 1 morph target needs 3 scalars, found 6 of 1"),
        (lambda json: _targets(json).append({}), "of 3 morph targets needs 9 scalars, found 6 of 1"),
        (
            lambda json: json["animations"][0]["samplers"][0].update(interpolation="CUBICSPLINE"),
            "needs 18 scalars, found 6 of 1 component",
        ),
        (
            lambda json: json["animations"][0]["samplers"][0].update(output=1),
            "needs 6 scalars, found 4 of 3 components",
        ),
        (
            lambda json: json["meshes"][0]["primitives"].append({"attributes": {}, "targets": [{}]}),
            "mesh 0: its primitives have 1 and 2 morph targets",
        ),
        (lambda json: json["meshes"][0]["primitives"][0].update(targets={}), '"targets" must be an array'),
        (lambda json: json["nodes"][1].update(mesh=4), 'node 1: "mesh" is 4, but the file has 1 mesh'),
    ],
)
def test_broken_animations_of_weights_are_refused(
    change: Callable[[JsonObject], object], message: str
) -> None:
    with pytest.raises(InputError) as raised:
        read_clips(edited(change).document())
    assert message in str(raised.value)


def test_weights_that_are_not_finite_are_refused() -> None:
    builder = face([{"POSITION": MOVED}])
    animate(builder, path="weights", node=1, times=TIMES, values=[0.0, np.inf, 0.0])
    with pytest.raises(InputError, match="a morph weight of its keys is not a finite number"):
        read_clips(builder.document())


def test_a_primitive_without_targets_beside_one_with_them_takes_no_part() -> None:
    builder = face([{"POSITION": MOVED}, {"POSITION": MOVED}])
    builder.json["meshes"][0]["primitives"].append({"attributes": {}})
    document = builder.document()
    assert json.loads(builder.text())["meshes"][0]["primitives"][1] == {"attributes": {}}
    assert document.asset.meshes[0].target_count == 2


def test_the_targets_of_a_mesh_are_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """An animation of weights asks for them with each channel. 9,000 took 33 s for as many primitives."""
    builder = face([{"POSITION": MOVED}])
    builder.json["meshes"][0]["primitives"] *= 20
    animate(builder, path="weights", node=1, values=[[0.0], [1.0], [0.5]])
    builder.json["animations"][0]["channels"] *= 20
    document = builder.document()
    lists = count_calls(monkeypatch, asset, "objects")
    (clip,) = read_clips(document)
    assert len(clip.channels) == 20
    keys = Counter(key for _, key, _ in lists)
    assert (keys["primitives"], keys["targets"]) == (1, 20)
