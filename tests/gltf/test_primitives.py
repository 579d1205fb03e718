"""From the document to arrays: which primitives are skinned, which are skipped and why, what is refused."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import AnyArray, JsonObject
from skinbake.errors import InputError
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.meshes import read_primitive, reason_to_skip, skinned_sources, tell_half_skinned
from skinbake.gltf.resources import encode_data_uri
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import SHARED, Change, Part, copied, edited, rewritten, sheet, write_model


def sources(path: Path) -> tuple[Document, list[PrimitiveSource]]:
    document = read_document(str(path))
    return document, skinned_sources(document)


def primitive_of(path: Path, number: int = 0) -> SkinnedPrimitive:
    document, found = sources(path)
    return read_primitive(document, found[number])


def skip_code(path: Path, *, generate_normals: bool = False) -> str | None:
    document, (source,) = sources(path)
    reason = reason_to_skip(document, source, generate_normals=generate_normals)
    return reason.code if reason else None


@pytest.mark.parametrize(
    "name", ["two_sets.glb", "weights_u8.glb", "weights_u16.glb", "mirrored_tangent.glb"]
)
def test_arrays_are_those_of_the_independent_reader(name: str, tmp_path: Path) -> None:
    path = copied(name, tmp_path)
    primitive, model = primitive_of(path), read(path)
    joints, weights = model.influences()
    assert (primitive.positions == model.attribute("POSITION")).all()
    assert (primitive.normals == model.attribute("NORMAL")).all()
    assert (primitive.joints == joints).all()
    assert (primitive.weights == weights).all()
    assert (primitive.triangles == model.triangles()).all()
    assert (primitive.tangents is None) is not model.has_attribute("TANGENT")
    if primitive.tangents is not None:
        assert (primitive.tangents == model.attribute("TANGENT")).all()


def test_interleaved_arrays_and_data_uris_are_read(tmp_path: Path) -> None:
    path = copied(SHARED, tmp_path)
    model = read(path)
    for number in range(2):
        primitive = primitive_of(path, number)
        assert (primitive.positions == model.attribute("POSITION", 0, number)).all()
        assert (primitive.triangles == model.triangles(0, number)).all()


@pytest.mark.parametrize("mode", [4, 5, 6])
@pytest.mark.parametrize("is_indexed", [True, False])
def test_strips_fans_and_lists_unroll_as_the_independent_reader_does(
    tmp_path: Path, mode: int, is_indexed: bool
) -> None:
    # 20 indices are not a multiple of three: the list's last two draw nothing.
    indices = np.arange(20)[::-1] if is_indexed else None
    path = write_model(tmp_path / "sheet.glb", [Part(sheet().attributes, indices, mode)])
    triangles = primitive_of(path).triangles
    assert len(triangles) == (6 if mode == 4 else 18)
    assert (triangles == read(path).triangles()).all()


@pytest.mark.parametrize(("component", "dtype"), [(5121, "<u1"), (5123, "<u2"), (5125, "<u4")])
def test_indices_have_any_unsigned_type(tmp_path: Path, component: int, dtype: str) -> None:
    corners = np.asarray(sheet().indices).reshape(-1)
    raw = corners.astype(dtype).tobytes()

    def retype(content: JsonObject) -> None:
        content["buffers"].append({"byteLength": len(raw), "uri": encode_data_uri(raw)})
        content["bufferViews"].append({"buffer": 1, "byteLength": len(raw)})
        view = len(content["bufferViews"]) - 1
        number = content["meshes"][0]["primitives"][0]["indices"]
        content["accessors"][number] |= {"bufferView": view, "componentType": component}

    path = write_model(tmp_path / "sheet.glb", [sheet()], change=retype)
    assert (primitive_of(path).triangles.reshape(-1) == corners).all()


def test_a_mesh_is_skinned_where_a_node_gives_it_a_skin(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        rigid = {**primitive, "attributes": {"POSITION": primitive["attributes"]["POSITION"]}}
        content["meshes"] += [{"name": "loose", "primitives": [primitive]}, {"primitives": [rigid]}]
        content["meshes"].append({"name": "never drawn", "primitives": [primitive]})
        content["nodes"] += [{"mesh": 1}, {"mesh": 2, "skin": 0}, {"mesh": 0}, {"skin": 0}]

    document = read_document(str(edited("seam.glb", tmp_path, change)))
    found = skinned_sources(document)
    tell_half_skinned(document)
    notices = list(document.notices)
    assert [(source.mesh, source.primitive) for source in found] == [(0, 0)]
    assert [(notice.code, notice.place.mesh) for notice in notices] == [
        ("no-skin", 1),
        ("no-joints", 2),
        ("no-skin", 3),
    ]
    assert notices[0].place.mesh_name == "loose"


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_smallest_skin_bounds_the_joints(tmp_path: Path, order: tuple[int, int]) -> None:
    def change(content: JsonObject) -> None:
        content["skins"].append({"joints": content["skins"][0]["joints"][:2]})
        content["nodes"][0]["skin"] = order[0]
        content["nodes"].append({"mesh": 0, "skin": order[1]})

    document, (source,) = sources(edited("seam.glb", tmp_path, change))
    assert source.joint_count == 2
    with pytest.raises(InputError, match="has a weight for joint 2, but the skin has only 2 joints"):
        read_primitive(document, source)


def test_a_joint_past_the_skin_may_stand_at_weight_zero(tmp_path: Path) -> None:
    joints = np.tile(np.array([0, 1, 7, 0], np.uint8), (20, 1))
    weights = np.tile(np.array([0.5, 0.5, 0, 0], np.float32), (20, 1))
    path = write_model(tmp_path / "a.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)])
    assert primitive_of(path).joints.max() == 7
    weights[3] = [0.5, 0.25, 0.25, 0]
    weights[9] = [0.5, 0.25, 0, 0.25]
    path = write_model(tmp_path / "b.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)])
    with pytest.raises(
        InputError,
        match=r"vertex 3 has a weight for joint 7, .* only 2 joints. The number of such vertices is 1",
    ):
        primitive_of(path)


def test_a_skin_of_one_joint_is_told_in_the_singular(tmp_path: Path) -> None:
    path = write_model(tmp_path / "sheet.glb", [sheet()], joints=1)
    with pytest.raises(InputError, match=r"but the skin has only 1 joint\. The number"):
        primitive_of(path)


def test_a_skin_needs_no_inverse_bind_matrices(tmp_path: Path) -> None:
    path = edited("seam.glb", tmp_path, lambda content: content["skins"][0].pop("inverseBindMatrices"))
    assert len(primitive_of(path).positions) == 198


@pytest.mark.parametrize(
    ("mode", "code"), [(0, "no-surface"), (1, "no-surface"), (2, "no-surface"), (3, "no-surface"), (4, None)]
)
def test_points_and_lines_are_skipped(tmp_path: Path, mode: int, code: str | None) -> None:
    path = write_model(tmp_path / "sheet.glb", [Part(sheet().attributes, sheet().indices, mode)])
    assert skip_code(path) == code


@pytest.mark.parametrize(
    ("part", "code"),
    [
        (sheet(NORMAL=None), "no-normals"),
        (sheet(POSITION=None), "no-positions"),
        (Part(sheet().attributes, np.array([0, 1])), "no-triangles"),
        (Part(sheet().attributes, np.array([0, 1]), mode=5), "no-triangles"),
    ],
)
def test_a_primitive_that_cannot_be_baked_is_skipped_with_a_reason(
    tmp_path: Path, part: Part, code: str
) -> None:
    path = write_model(tmp_path / "sheet.glb", [part])
    assert skip_code(path) == code


def test_generated_normals_lift_one_reason_only(tmp_path: Path) -> None:
    path = write_model(tmp_path / "sheet.glb", [sheet(NORMAL=None)])
    assert skip_code(path, generate_normals=True) is None
    path = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None, POSITION=None)])
    assert skip_code(path, generate_normals=True) == "no-positions"


def constant(value: float, dtype: type[np.generic], *, columns: int = 4, rows: int = 20) -> AnyArray:
    return np.full((rows, columns), value, dtype)


U8, U16, F4 = np.uint8, np.uint16, np.float32
WRONG_ARRAYS: list[tuple[dict[str, AnyArray | None], str]] = [
    (
        {"WEIGHTS_0": constant(-np.inf, F4)},
        r"WEIGHTS_0: .* \(at 20 vertices, first at vertex 0, where x is infinite\): mend the mesh",
    ),
    (
        {
            "JOINTS_1": constant(0, U8),
            "WEIGHTS_1": np.where(np.arange(20)[:, None] < 7, F4(0), F4("nan")) + constant(0, F4),
        },
        r"WEIGHTS_1: .*finite numbers \(at 13 vertices, first at vertex 7, where x is NaN\)",
    ),
    ({"NORMAL": constant(1, F4, columns=3, rows=19)}, "NORMAL: it has 19 elements, POSITION has 20"),
    ({"JOINTS_0": constant(0, U8, rows=21)}, "JOINTS_0: it has 21 elements, POSITION has 20"),
    ({"TANGENT": constant(1, F4, rows=1)}, "TANGENT: it has 1 element, POSITION has 20"),
    ({"POSITION": constant(0, F4, columns=2)}, "POSITION: it has 2 components, 3 are needed"),
    ({"POSITION": constant(0, F4, columns=1)}, "POSITION: it has 1 component, 3 are needed"),
    ({"NORMAL": constant(0, F4)}, "NORMAL: it has 4 components, 3 are needed"),
    ({"TANGENT": constant(1, F4, columns=3)}, "TANGENT: it has 3 components, 4 are needed"),
    ({"JOINTS_0": constant(0, U16, columns=2)}, "JOINTS_0: it has 2 components, 4 are needed"),
    ({"JOINTS_0": constant(0, F4)}, "JOINTS_0: joints must be unsigned bytes or shorts"),
    ({"WEIGHTS_0": None}, "it has JOINTS_0 and no WEIGHTS_0: write the weights, or remove the joints"),
    ({"JOINTS_1": constant(0, U8)}, "it has JOINTS_1 and no WEIGHTS_1: write the weights"),
]


@pytest.mark.parametrize(("arrays", "message"), WRONG_ARRAYS)
def test_wrong_arrays_are_refused(tmp_path: Path, arrays: dict[str, AnyArray | None], message: str) -> None:
    path = write_model(tmp_path / "sheet.glb", [sheet(**arrays)])
    with pytest.raises(InputError, match=message) as caught:
        primitive_of(path)
    assert str(caught.value).startswith(f'{path}: mesh 0 "sheet", primitive 0')


@pytest.mark.parametrize(("attribute", "name"), [("POSITION", "values"), ("WEIGHTS_0", "weights")])
@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (np.inf, "infinite"), (-np.inf, "infinite")])
def test_the_component_that_is_no_finite_number_is_named(
    tmp_path: Path, attribute: str, name: str, value: float, word: str
) -> None:
    path = write_model(tmp_path / "sheet.glb", [sheet()])
    file = read(path)
    accessor = file.content["accessors"][file.primitive(0)["attributes"][attribute]]
    start = file.content["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    start += accessor.get("byteOffset", 0)
    columns = {"VEC3": "xyz", "VEC4": "xyzw"}[accessor["type"]]
    for vertex, (number, component) in itertools.product([0, 7, 19], enumerate(columns)):
        data = bytearray(file.binary_chunk or b"")
        place = start + 4 * (vertex * len(columns) + number)
        data[place : place + 4] = np.float32(value).tobytes()
        broken = rewritten(GltfFile(path, file.content, bytes(data)), tmp_path / "broken.glb")
        found = (
            f"{attribute}: its {name} are not all finite numbers (at vertex {vertex}, where {component} is"
        )
        with pytest.raises(InputError, match=re.escape(f"{found} {word})")):
            primitive_of(broken)


def test_every_type_that_gltf_forbids_has_a_remedy(tmp_path: Path) -> None:
    """Of joints and weights in both sets: all component types, with and without "normalized"."""
    sizes = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
    names = dict(zip(sizes, ["int8", "uint8", "int16", "uint16", "uint32", "float32"], strict=True))
    allowed = {
        "JOINTS": {(5121, False), (5121, True), (5123, False), (5123, True)},
        "WEIGHTS": {(5121, True), (5123, True), (5126, False), (5126, True)},
    }
    more = {"JOINTS_1": constant(0, F4), "WEIGHTS_1": constant(0, F4)}  # wide enough for every type
    path = write_model(tmp_path / "sheet.glb", [sheet(JOINTS_0=constant(0, F4), **more)])
    for family, number, code, normalized in itertools.product(allowed, (0, 1), sizes, (False, True)):
        if (code, normalized) in allowed[family]:
            continue
        file = read(path)
        for name in ("JOINTS_0", "JOINTS_1"):
            set_accessor(name, componentType=5121)(file.content)
        set_accessor(f"{family}_{number}", componentType=code, normalized=normalized)(file.content)
        broken = rewritten(file, tmp_path / "broken.glb")
        with pytest.raises(InputError) as caught:
            primitive_of(broken)
        found = f"{'normalised ' if normalized and code != 5126 else ''}{names[code]}"
        message = str(caught.value)
        assert f"{family}_{number}: " in message and f", found {found}: " in message, message
        if family == "JOINTS":
            assert message.endswith(": export the mesh again with unsigned shorts"), message
        elif (code, normalized) in {(5121, False), (5123, False)}:
            largest = {5121: 255, 5123: 65535}[code]
            assert message.endswith(
                f': set "normalized": true in its accessor if {largest} stands for 1, '
                "or export the mesh again with floats"
            ), message
        else:
            assert message.endswith(": export the mesh again with floats"), message


def set_accessor(attribute: str, **members: Any) -> Change:
    def change(content: JsonObject) -> None:
        number = content["meshes"][0]["primitives"][0]["attributes"][attribute]
        content["accessors"][number] |= members

    return change


def set_primitive(**members: Any) -> Change:
    return lambda content: content["meshes"][0]["primitives"][0].update(members)


def set_attribute(name: str, value: Any) -> Change:
    return lambda content: content["meshes"][0]["primitives"][0]["attributes"].update({name: value})


WRONG_JSON: list[tuple[Change, str]] = [
    (set_accessor("WEIGHTS_0", componentType=5121), "weights must be floats, or normalised unsigned"),
    (set_accessor("WEIGHTS_0", componentType=5120, normalized=True), "weights must be floats, or normalised"),
    (set_accessor("JOINTS_0", componentType=5120), "joints must be unsigned bytes or shorts"),
    (set_primitive(mode=7), '"mode" is 7; glTF knows 0 to 6'),
    (set_primitive(mode="4"), '"mode" must be an integer'),
    (set_primitive(indices=99), '"indices" refers to entry 99'),
    (set_primitive(indices=0), "indices must be scalars of an unsigned integer type"),
    (set_primitive(attributes=[]), '"attributes" must be an object'),
    (set_primitive(extensions=3), '"extensions" must be an object'),
    (set_attribute("POSITION", 99), '"POSITION" refers to entry 99'),
    (set_attribute("POSITION", "0"), '"POSITION" must be an integer'),
    (set_attribute("NORMAL", True), '"NORMAL" must be an integer'),
    (set_attribute("COLOR_0", -1), '"COLOR_0" must be an integer'),
    (lambda content: content["nodes"][0].update(mesh=9), 'node 0: "mesh" is 9, but the file has 1 mesh$'),
    (lambda content: content["nodes"][0].update(skin=9), 'node 0: "skin" is 9, but the file has 1 skin$'),
    (lambda content: content["nodes"][0].update(skin=1.5), 'node 0: "skin" must be an integer'),
    (lambda content: content["skins"][0].update(joints=[]), "skin 0 has no joints"),
    (lambda content: content["skins"][0].pop("joints"), "skin 0 has no joints"),
    (lambda content: content["meshes"][0].update(primitives={}), '"primitives" must be an array'),
    (lambda content: content["meshes"][0].update(name=5), '"name" must be a string'),
]


@pytest.mark.parametrize(("change", "message"), WRONG_JSON)
def test_wrong_json_is_refused(tmp_path: Path, change: Change, message: str) -> None:
    path = edited("seam.glb", tmp_path, change)
    with pytest.raises(InputError, match=message) as caught:
        document, found = sources(path)
        for source in found:
            reason_to_skip(document, source, generate_normals=False)
            read_primitive(document, source)
    assert str(caught.value).startswith(str(path))


def test_an_index_past_the_vertices_is_refused(tmp_path: Path) -> None:
    path = write_model(tmp_path / "sheet.glb", [Part(sheet().attributes, np.array([0, 1, 20]))])
    with pytest.raises(InputError, match="indices: index 20 is too large for 20 vertices"):
        primitive_of(path)


def test_a_primitive_without_positions_is_skipped_or_refused(tmp_path: Path) -> None:
    """Commands skip it before they read its arrays."""

    def without(content: JsonObject) -> None:
        del content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]

    document, (source,) = sources(edited("seam.glb", tmp_path, without))
    assert reason_to_skip(document, source, generate_normals=False) is not None
    with pytest.raises(InputError, match="it has no POSITION"):
        read_primitive(document, source)
