"""Strip gives back the document as it was; what another tool did to the file since is met with care."""

from __future__ import annotations

import base64
import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.choices import Encoding, FrameChoice, Layout, Neighbours, Weighting
from skinbake.commands.inspect import inspect_file
from skinbake.commands.strip import strip_file
from skinbake.errors import InputError
from skinbake.format.baked import AttributeNames
from skinbake.format.encodings import GradientFormat
from tests.support.baking import bake_file, bake_settings
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import (
    FIXTURES,
    FOLDER,
    KEY,
    SHARED,
    Change,
    assert_buffers_kept,
    bake,
    baked,
    copied,
    edited,
    note,
    primitives,
    rewritten,
    sheet,
    stripped,
    with_pointers,
    write_model,
)

OPTIONS: list[dict[str, Any]] = [
    {},
    {"names": AttributeNames("_A{set}", "_B{set}")},
    {
        "settings": bake_settings(
            weighting=Weighting.ANGLE, neighbours=Neighbours.DROP, frame=FrameChoice.NORMAL
        )
    },
    {"storage": GradientFormat(Encoding.PACKED8, Layout.CUSTOM)},
    {"storage": GradientFormat(Encoding.SNORM16)},
    {"storage": GradientFormat(layout=Layout.TEXCOORD)},
]


def assert_restored(before: GltfFile, after: GltfFile) -> None:
    assert json.dumps(after.content) == json.dumps(before.content)
    assert after.binary_chunk == before.binary_chunk
    assert_buffers_kept(before, after)


@pytest.mark.parametrize(
    "options", OPTIONS, ids=["default", "names", "drop", "packed8", "snorm16", "texcoord"]
)
@pytest.mark.parametrize("name", FIXTURES)
def test_strip_undoes_a_bake(name: str, options: dict[str, Any], tmp_path: Path) -> None:
    source = copied(name, tmp_path)
    bake(source, tmp_path / f"baked_{name}", **options)
    assert_restored(read(source), stripped(tmp_path / f"baked_{name}", tmp_path / f"stripped_{name}"))


def test_strip_of_a_glb_gives_back_its_very_bytes(tmp_path: Path) -> None:
    """The fixtures' writer and ours put JSON alike, so that here the whole file is comparable."""
    bake(FOLDER / "foreign_joints.glb", tmp_path / "baked.glb")
    strip_file(str(tmp_path / "baked.glb"), str(tmp_path / "stripped.glb"))
    assert (tmp_path / "stripped.glb").read_bytes() == (FOLDER / "foreign_joints.glb").read_bytes()


@pytest.mark.parametrize("extras", [{}, {"a": 1}, [], "text", 0, None, False, {"skinbake": "mine"}])
def test_strip_gives_back_any_extras(extras: Any, tmp_path: Path) -> None:
    path = edited(
        "seam.glb", tmp_path, lambda content: content["meshes"][0]["primitives"][0].update(extras=extras)
    )
    bake(path, tmp_path / "baked.glb")
    assert_restored(read(path), stripped(tmp_path / "baked.glb", tmp_path / "stripped.glb"))


def test_strip_takes_generated_normals_out(tmp_path: Path) -> None:
    path = write_model(tmp_path / "sheet.glb", [sheet(NORMAL=None)])
    bake(path, tmp_path / "baked.glb", generate_normals=True)
    assert read(tmp_path / "baked.glb").has_attribute("NORMAL")
    assert_restored(read(path), stripped(tmp_path / "baked.glb", tmp_path / "stripped.glb"))


def test_strip_gives_back_the_influences_from_before_adoption(tmp_path: Path) -> None:
    for name in ("foreign_joints.glb", "weights_u8.glb"):
        before, after = read(FOLDER / name), baked(FOLDER / name, tmp_path / name)
        assert (after.influences()[1] != before.influences()[1]).any()
        back = stripped(tmp_path / name, tmp_path / f"stripped_{name}")
        for number in range(2):
            assert (back.influences()[number] == before.influences()[number]).all()
        assert back.stored_attribute("WEIGHTS_0").dtype == before.stored_attribute("WEIGHTS_0").dtype


def test_a_document_without_arrays_of_its_own_is_given_back(tmp_path: Path) -> None:
    """Every accessor of it is zeros that no buffer holds: bake adds the first buffer."""
    content = {
        "asset": {"version": "2.0"},
        "accessors": [
            {"componentType": 5126, "count": 3, "type": "VEC3"},
            {"componentType": 5126, "count": 3, "type": "VEC4"},
            {"componentType": 5121, "count": 3, "type": "VEC4"},
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0, "JOINTS_0": 2, "WEIGHTS_0": 1}}]}
        ],
        "skins": [{"joints": [0]}],
        "nodes": [{"mesh": 0, "skin": 0}],
    }
    path = tmp_path / "zeros.gltf"
    path.write_text(json.dumps(content), encoding="utf-8")
    baked(path, tmp_path / "baked.gltf")
    assert_restored(read(path), stripped(tmp_path / "baked.gltf", tmp_path / "stripped.gltf"))


@pytest.mark.parametrize("name", ["seam.glb", SHARED])
def test_a_document_without_a_bake_passes_through(name: str, tmp_path: Path) -> None:
    source = copied(name, tmp_path)
    result = strip_file(str(source), str(tmp_path / f"stripped_{name}"))
    assert (result.primitives, [notice.code for notice in result.notices]) == (0, ["nothing-baked"])
    assert (tmp_path / f"stripped_{name}").read_bytes() == source.read_bytes()


def test_strip_with_warnings_as_errors_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"it holds no bake \(--warnings-as-errors\)"):
        strip_file(str(FOLDER / "seam.glb"), str(tmp_path / "out.glb"), warnings_as_errors=True)
    assert list(tmp_path.iterdir()) == []


class TestAfterOtherTools:
    """A baked file that was changed; strip must leave a valid file, and say what it could not undo."""

    def changed(self, name: str, tmp_path: Path, change: Change) -> tuple[GltfFile, GltfFile, list[str]]:
        """Return the changed file, what strip makes of it, and the codes of its notices."""
        model = baked(copied(name, tmp_path), tmp_path / f"baked_{name}")
        change(model.content)
        path = rewritten(model, tmp_path / f"changed_{name}")
        target = tmp_path / f"stripped_{name}"
        result = strip_file(str(path), str(target))
        return read(path), read(target), [notice.code for notice in result.notices]

    def test_an_accessor_that_came_later_stays(self, tmp_path: Path) -> None:
        def change(content: JsonObject) -> None:
            content["accessors"].append({"componentType": 5126, "count": 198, "type": "VEC2"})
            number = len(content["accessors"]) - 1
            content["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = number

        before, after, codes = self.changed("seam.glb", tmp_path, change)
        assert codes == ["bytes-left"]
        assert (after.attribute("TEXCOORD_1") == 0).all()
        assert list(after.primitive(0)["attributes"]) == [
            name for name in before.primitive(0)["attributes"] if not name.startswith("_SKINBAKE")
        ]

    def test_a_second_primitive_that_still_uses_our_accessors_keeps_them(self, tmp_path: Path) -> None:
        """Another tool dropped one primitive's extras: it is no longer known as baked, but still refers."""
        path = write_model(tmp_path / "twice.glb", [sheet(), sheet()])
        before = baked(path, tmp_path / "baked.glb")
        first, second = (before.primitive(0, number) for number in range(2))
        assert first["attributes"]["_SKINBAKE_ALPHA_0"] == second["attributes"]["_SKINBAKE_ALPHA_0"]
        del second["extras"]
        rewritten(before, tmp_path / "changed.glb")
        strip_file(str(tmp_path / "changed.glb"), str(tmp_path / "stripped.glb"))
        after = read(tmp_path / "stripped.glb")
        for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
            assert not after.has_attribute(name, 0, 0)
            assert (after.attribute(name, 0, 1) == before.attribute(name, 0, 1)).all()

    def test_influences_that_are_gone_leave_the_adopted_ones(self, tmp_path: Path) -> None:
        def change(content: JsonObject) -> None:
            found = note(content)
            assert found is not None
            primitive, accessors = content["meshes"][0]["primitives"][0], content["accessors"]
            for name, number in found["adopted"].items():  # their bytes have no accessor any more
                accessors[number]["bufferView"] = accessors[primitive["attributes"][name]]["bufferView"]

        before, after, codes = self.changed("foreign_joints.glb", tmp_path, change)
        assert "adopted-kept" in codes
        assert (after.influences()[0] == before.influences()[0]).all()
        assert (after.influences()[1] == before.influences()[1]).all()
        assert not after.has_attribute("_SKINBAKE_ALPHA_0")

    def test_reordered_accessors_are_left_where_they_are(self, tmp_path: Path) -> None:
        def change(content: JsonObject) -> None:
            last = len(content["accessors"]) - 1
            content["accessors"].append(content["accessors"][0])
            content["accessors"][0] = copy.deepcopy(content["accessors"][last])
            attributes = content["meshes"][0]["primitives"][0]["attributes"]
            swap = {0: last + 1, last: 0}
            for name, number in attributes.items():
                attributes[name] = swap.get(number, number)

        before, after, codes = self.changed("seam.glb", tmp_path, change)
        assert codes == ["bytes-left"]
        assert (after.attribute("POSITION") == before.attribute("POSITION")).all()

    def test_bytes_that_moved_behind_the_former_end_stay(self, tmp_path: Path) -> None:
        """Another tool put bytes before all others: what stays ends where our own began."""
        source = baked(copied("seam.glb", tmp_path), tmp_path / "baked.glb")
        for view in source.content["bufferViews"]:
            view["byteOffset"] = view.get("byteOffset", 0) + 40
        assert source.binary_chunk is not None
        moved = replace(source, binary_chunk=bytes(40) + source.binary_chunk)
        moved.content["buffers"][0]["byteLength"] += 40
        rewritten(moved, tmp_path / "moved.glb")
        result = strip_file(str(tmp_path / "moved.glb"), str(tmp_path / "stripped.glb"))
        assert [notice.code for notice in result.notices] == ["bytes-left"]
        after = read(tmp_path / "stripped.glb")
        assert (after.attribute("POSITION") == moved.attribute("POSITION")).all()
        assert after.content["buffers"][0]["byteLength"] >= max(
            view["byteOffset"] + view["byteLength"] for view in after.content["bufferViews"]
        )

    def test_a_file_that_was_changed_bakes_again(self, tmp_path: Path) -> None:
        def change(content: JsonObject) -> None:
            content["accessors"].append({"componentType": 5126, "count": 112, "type": "VEC2"})
            number = len(content["accessors"]) - 1
            content["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = number

        path = edited("foreign_joints.glb", tmp_path, lambda content: None)
        model = baked(path, tmp_path / "baked.glb")
        change(model.content)
        rewritten(model, tmp_path / "changed.glb")
        bake(tmp_path / "changed.glb", tmp_path / "again.glb")
        again = read(tmp_path / "again.glb")
        for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
            assert (again.attribute(name) == model.attribute(name)).all()


MANGLED: list[tuple[str, Any]] = [
    ("alpha", 5),
    ("alpha", [[1]]),
    ("alpha", {"a": 1}),
    ("beta", None),
    ("generated", 7),
    ("generated", [None]),
    ("adopted", []),
    ("adopted", {"JOINTS_0": "x", "WEIGHTS_0": 10**30}),
    ("adopted", {"JOINTS_0": -1}),
    ("adopted", {"JOINTS_0": 0}),
    ("straightened", 5),
    ("straightened", ["digest"]),
    ("frame", []),
    ("digest", [1, 2]),
    ("digest", {"POSITION": None}),
    ("version", 99),
    ("influences", "four"),
]


@pytest.mark.parametrize(("member", "value"), MANGLED)
def test_a_mangled_note_crashes_nothing(member: str, value: Any, tmp_path: Path) -> None:
    model = baked(FOLDER / "foreign_joints.glb", tmp_path / "baked.glb")
    model.primitive(0)["extras"][KEY][member] = value
    path = str(rewritten(model, tmp_path / "mangled.glb"))
    for attempt in (
        lambda: strip_file(path, str(tmp_path / "stripped.glb")),
        lambda: inspect_file(path),
        lambda: bake_file(path, str(tmp_path / "again.glb")),
    ):
        try:
            attempt()
        except InputError as error:
            assert str(error).startswith(path)


@pytest.mark.parametrize(
    ("member", "value"),
    [
        ("alpha", ["POSITION", "_SKINBAKE_ALPHA_0"]),
        ("beta", ["WEIGHTS_0", "_SKINBAKE_BETA_0"]),
        ("generated", ["POSITION", "JOINTS_0"]),
        ("formerAttributes", []),
        ("formerAttributes", None),
    ],
)
def test_a_damaged_note_costs_no_attribute_that_no_bake_adds(member: str, value: Any, tmp_path: Path) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
    note = model.primitive(0)["extras"][KEY]
    assert "adopted" not in note
    note[member] = value
    strip_file(str(rewritten(model, tmp_path / "damaged.glb")), str(tmp_path / "stripped.glb"))
    source, stripped = read(FOLDER / "seam.glb"), read(tmp_path / "stripped.glb")
    assert set(stripped.primitive(0)["attributes"]) == set(source.primitive(0)["attributes"])
    for name in source.primitive(0)["attributes"]:
        assert np.array_equal(stripped.stored_attribute(name), source.stored_attribute(name)), name


def test_texture_coordinates_stay_if_the_note_does_not_name_their_layout(tmp_path: Path) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb", storage=GradientFormat(layout=Layout.TEXCOORD))
    del model.primitive(0)["extras"][KEY]["layout"]
    strip_file(str(rewritten(model, tmp_path / "damaged.glb")), str(tmp_path / "stripped.glb"))
    assert set(read(tmp_path / "stripped.glb").primitive(0)["attributes"]) == set(
        model.primitive(0)["attributes"]
    )


def test_a_noted_primitive_without_attributes_crashes_nothing(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        primitive["extras"] = {KEY: {"version": 1, "alpha": ["_A"], "beta": ["_B"]}}
        del primitive["attributes"]

    path = edited("seam.glb", tmp_path, change)
    try:
        strip_file(str(path), str(tmp_path / "stripped.glb"))
    except InputError as error:
        assert str(error).startswith(str(path))


@pytest.mark.parametrize(
    "values", [{"bufferByteLength": -1}, {"bufferByteLength": 10**9}, {"bufferByteLength": "4"}]
)
def test_a_mangled_undo_note_leaves_the_bytes(values: JsonObject, tmp_path: Path) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
    (first,) = [view for view in model.content["bufferViews"] if KEY in view.get("extras", {})]
    first["extras"][KEY] = values
    path = rewritten(model, tmp_path / "mangled.glb")
    strip_file(str(path), str(tmp_path / "stripped.glb"))
    after = read(tmp_path / "stripped.glb")
    for name in ("POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0"):
        assert np.array_equal(after.attribute(name), model.attribute(name))
    assert not after.has_attribute("_SKINBAKE_ALPHA_0")


def test_every_primitive_of_every_mesh_is_stripped(tmp_path: Path) -> None:
    path = write_model(tmp_path / "sheet.glb", [sheet(), sheet(), sheet(NORMAL=None)])
    bake(path, tmp_path / "baked.glb")
    result = strip_file(str(tmp_path / "baked.glb"), str(tmp_path / "stripped.glb"))
    assert result.primitives == 2
    content = read(tmp_path / "stripped.glb").content
    assert KEY not in json.dumps([primitive for _, _, primitive in primitives(content)])


def test_data_uris_without_padding_come_back_as_they_were(tmp_path: Path) -> None:
    source = copied(SHARED, tmp_path / "in")

    def embed(content: JsonObject) -> None:
        for buffer in content["buffers"]:
            if buffer["uri"].startswith("data:"):
                continue
            data = (source.parent / unquote(buffer["uri"])).read_bytes() + b"\0"
            buffer["uri"] = f"data:;base64,{base64.b64encode(data).decode().rstrip('=')}"

    path = edited(SHARED, tmp_path / "embedded", embed)
    assert any((len(buffer["uri"].partition(",")[2]) % 4) for buffer in read(path).content["buffers"])
    for name in ("out.gltf", "out.glb"):
        bake(path, tmp_path / name)
        assert inspect_file(str(tmp_path / name)).primitives[0].bake is not None
    strip_file(str(tmp_path / "out.gltf"), str(tmp_path / "again.gltf"))
    assert (tmp_path / "again.gltf").read_bytes() == path.read_bytes()


def test_clips_of_pointers_are_kept_to_the_byte(tmp_path: Path) -> None:
    path = edited("bent_tube.glb", tmp_path / "in", with_pointers)
    after = baked(path, tmp_path / "out.glb")
    before = read(path)
    assert after.content["animations"] == before.content["animations"]
    assert_buffers_kept(before, after)
    strip_file(str(tmp_path / "out.glb"), str(tmp_path / "again.glb"))
    assert (tmp_path / "again.glb").read_bytes() == path.read_bytes()
