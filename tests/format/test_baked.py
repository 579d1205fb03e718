"""The contract of what bake writes, on the written file, read by the tests' own reader."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import AnyArray, JsonObject
from skinbake.choices import Encoding, FrameChoice, Layout, Neighbours, Scheme, Weighting
from skinbake.errors import InputError, Place
from skinbake.format.baked import AttributeNames
from skinbake.format.encodings import GradientFormat
from skinbake.gltf.codecs.meshopt import view_bytes
from skinbake.gltf.document import read_document
from skinbake.gltf.resources import encode_data_uri
from skinbake.gltf.writing.additions import Additions, Packed
from skinbake.gltf.writing.copies import NAME as NOTES
from skinbake.gltf.writing.recode import Compression
from skinbake.version import FIT
from tests.support.baked_files import verify
from tests.support.baking import bake_file, bake_settings
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import (
    FIXTURES,
    FOLDER,
    SHARED,
    Part,
    assert_only_added,
    bake,
    baked,
    copied,
    edited,
    note,
    primitives,
    sheet,
    stripped,
    write_model,
)

FLOAT = 5126
ALPHA, BETA = "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"
OTHER_NAMES = AttributeNames("_GRADIENT{set}_ALONG_T", "_GRADIENT{set}_ALONG_B")


def target_of(source: Path, folder: Path) -> Path:
    """Return a place in a folder of its own, so that nothing is found there."""
    folder.mkdir(exist_ok=True)
    return folder / source.name


def attributes_of(model: GltfFile, mesh: int = 0, primitive: int = 0) -> Mapping[str, int]:
    found: Mapping[str, int] = model.primitive(mesh, primitive)["attributes"]
    return found


@pytest.mark.parametrize("name", FIXTURES)
class TestEveryFixture:
    def test_alpha_and_beta_are_floats_for_every_slot_but_the_first(self, name: str, tmp_path: Path) -> None:
        before, after = read(FOLDER / name), baked(FOLDER / name, tmp_path / name)
        for mesh, number, _ in primitives(before.content):
            own, now = attributes_of(before, mesh, number), attributes_of(after, mesh, number)
            sets = sum(attribute.startswith("JOINTS_") for attribute in own)
            names = [f"_SKINBAKE_{letter}_{n}" for n in range(sets) for letter in ("ALPHA", "BETA")]
            assert list(now) == [*own, *names]
            vertices = before.content["accessors"][own["POSITION"]]["count"]
            for attribute in names:
                accessor = after.content["accessors"][now[attribute]]
                assert accessor["type"] == ("VEC3" if attribute.endswith("_0") else "VEC4")
                assert (accessor["componentType"], accessor["count"]) == (FLOAT, vertices)
                assert "normalized" not in accessor
                view = after.content["bufferViews"][accessor["bufferView"]]
                assert view["target"] == 34962
                assert (view.get("byteOffset", 0) % 4, accessor.get("byteOffset", 0)) == (0, 0)
                assert np.isfinite(after.stored(now[attribute])).all()
            assert any(after.stored(now[attribute]).any() for attribute in names)

    def test_bake_changes_nothing_but_its_additions(self, name: str, tmp_path: Path) -> None:
        assert_only_added(read(FOLDER / name), baked(FOLDER / name, tmp_path / name))

    def test_the_file_that_was_read_is_not_touched(self, name: str, tmp_path: Path) -> None:
        source = copied(name, tmp_path / "in")
        before = {path.name: path.read_bytes() for path in (tmp_path / "in").iterdir()}
        times = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "in").iterdir()}
        bake(source, target_of(source, tmp_path / "out"))
        assert {path.name: path.read_bytes() for path in (tmp_path / "in").iterdir()} == before
        assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "in").iterdir()} == times

    def test_the_metadata_say_how(self, name: str, tmp_path: Path) -> None:
        after = baked(FOLDER / name, tmp_path / name)
        for mesh, number, _ in primitives(after.content):
            found = note(after.content, mesh, number)
            assert found is not None
            joints, _ = after.influences(mesh, number)
            sets = joints.shape[1] // 4
            expected = {
                "version": 1,
                "frame": "tangent" if name in {"mirrored_tangent.glb", "morphed_sheet.glb"} else "normal",
                "influences": 4 * sets,
                "weighting": "max",
                "creaseAngle": 15.0,
                "neighbours": "adopt",
                "gradients": "fitted",
                "fit": FIT,
                "alpha": [f"_SKINBAKE_ALPHA_{n}" for n in range(sets)],
                "beta": [f"_SKINBAKE_BETA_{n}" for n in range(sets)],
            }
            assert {key: found[key] for key in expected} == expected
            assert found["generator"].startswith("skinbake ")
            assert re.fullmatch("[0-9a-f]{16}", found["rig"])
            known = {*expected, "rig", "generator", "digest", "adopted", "formerDigest", "generated"}
            known |= {"keepExtras", "positions", "poses"}
            assert set(found) <= known
            positions = after.attribute("POSITION", mesh, number)
            corners = after.triangles(mesh, number)
            assert found["positions"]["componentType"] == 5126
            assert found["positions"]["corners"] == corners.size
            hashes = [fnv_1a([int(joint) for joint in row]) for row in joints]
            assert found["positions"]["joints"] == sum(hashes[vertex] for vertex in corners.ravel()) % 2**32
            used = positions[np.unique(corners)]
            bounds = {"min": used.min(axis=0).tolist(), "max": used.max(axis=0).tolist()}
            is_shared = len(used) < len(positions)
            told = {key: value for key, value in found["positions"].items() if key in bounds}
            assert told == ({} if is_shared else bounds)

    def test_baking_twice_is_baking_once(self, name: str, tmp_path: Path) -> None:
        once, twice = tmp_path / "once", tmp_path / "twice"
        first = target_of(FOLDER / name, once)
        bake(FOLDER / name, first)
        bake(first, target_of(first, twice))
        assert contents(twice) == contents(once)
        bake(first, first)
        assert contents(once) == contents(twice)

    @pytest.mark.slow
    def test_an_earlier_bake_leaves_no_trace(self, name: str, tmp_path: Path) -> None:
        other = bake_settings(
            weighting=Weighting.AREA, crease_angle=0.0, neighbours=Neighbours.DROP, frame=FrameChoice.NORMAL
        )
        odd = target_of(FOLDER / name, tmp_path / "odd")
        bake(FOLDER / name, odd, settings=other, names=OTHER_NAMES)
        again, plain = (target_of(FOLDER / name, tmp_path / folder) for folder in ("again", "plain"))
        bake(odd, again)
        bake(FOLDER / name, plain)
        assert contents(again.parent) == contents(plain.parent)

    def test_chosen_attribute_names_change_the_names_only(self, name: str, tmp_path: Path) -> None:
        plain = baked(FOLDER / name, target_of(FOLDER / name, tmp_path / "plain"))
        other = baked(FOLDER / name, target_of(FOLDER / name, tmp_path / "other"), names=OTHER_NAMES)
        for file in (plain, other):  # their digest has the names
            for mesh, number, _ in primitives(file.content):
                found = note(file.content, mesh, number)
                assert found is not None
                del found["poses"]["slots"]
        text = json.dumps(plain.content)
        for n in range(2):
            text = text.replace(f'"_SKINBAKE_ALPHA_{n}"', f'"_GRADIENT{n}_ALONG_T"')
            text = text.replace(f'"_SKINBAKE_BETA_{n}"', f'"_GRADIENT{n}_ALONG_B"')
        assert json.dumps(other.content) == text
        assert other.binary_chunk == plain.binary_chunk


def fnv_1a(words: list[int]) -> int:
    """Return the hash of 32 bits (Fowler, Noll, Vo) of numbers, each taken as one octet is."""
    result = 0x811C9DC5
    for word in words:
        result = (result ^ word) * 0x01000193 % 2**32
    return result


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder, without the notes of copies, which name where the sources are."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != NOTES}


@pytest.mark.slow
def test_two_processes_write_the_same_bytes(tmp_path: Path) -> None:
    names = ["two_sets.glb", "foreign_joints.glb", SHARED]
    written = []
    for seed in ("1", "4242"):
        folder = tmp_path / seed
        folder.mkdir()
        command = [sys.executable, "-m", "skinbake", "bake", "-q", "--out-dir", str(folder)]
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        subprocess.run([*command, *(str(FOLDER / name) for name in names)], env=environment, check=True)
        written.append(contents(folder))
    assert len(written[0]) == len(names) + 2
    assert written[0] == written[1]


class TestSharedAccessors:
    def test_primitives_that_share_accessors_still_do(self, tmp_path: Path) -> None:
        before, after = read(FOLDER / SHARED), baked(FOLDER / SHARED, tmp_path / SHARED)
        for attribute in attributes_of(before):
            numbers = {attributes_of(after, 0, part)[attribute] for part in range(2)}
            assert numbers == {attributes_of(before)[attribute]}

    def test_adoption_does_not_change_them_under_a_primitive_that_adopts_nothing(
        self, tmp_path: Path
    ) -> None:
        """The second primitive draws one triangle that a single joint owns, from the same arrays."""
        source = FOLDER / "foreign_joints.glb"
        joints = read(source).influences()[0][:, 0]
        triangles = read(source).triangles()
        (inner,) = triangles[(joints[triangles] == 0).all(axis=1)][:1]

        def split(content: JsonObject) -> None:
            first = content["meshes"][0]["primitives"][0]
            corners = inner.astype(np.uint16).tobytes()
            content["buffers"].append({"byteLength": 6, "uri": encode_data_uri(corners)})
            content["bufferViews"].append({"buffer": 1, "byteLength": 6})
            view = len(content["bufferViews"]) - 1
            accessor = {"bufferView": view, "componentType": 5123, "count": 3, "type": "SCALAR"}
            content["accessors"].append(accessor)
            other = {**first, "indices": len(content["accessors"]) - 1}
            content["meshes"] += [{"primitives": [other]}]
            content["nodes"].append({"mesh": 1, "skin": 0})

        path = edited("foreign_joints.glb", tmp_path, split)
        before, after = read(path), baked(path, tmp_path / "baked.glb")
        adopted = note(after.content, 0)
        assert adopted is not None
        assert set(adopted["adopted"]) == {"JOINTS_0", "WEIGHTS_0"}
        assert "adopted" not in (note(after.content, 1) or {})
        for attribute, accessor in attributes_of(before, 1).items():
            assert attributes_of(after, 1)[attribute] == accessor
        assert attributes_of(after, 0)["JOINTS_0"] != attributes_of(before, 0)["JOINTS_0"]
        assert_only_added(before, after)

    def test_equal_arrays_are_stored_once(self, tmp_path: Path) -> None:
        once = write_model(tmp_path / "once.glb", [sheet()])
        twice = write_model(tmp_path / "twice.glb", [sheet(), sheet()])
        sizes = []
        for path in (once, twice):
            before, after = read(path), baked(path, tmp_path / f"baked_{path.name}")
            sizes.append(len(after.binary_chunk or b"") - len(before.binary_chunk or b""))
        assert sizes[0] == sizes[1] > 0
        after = read(tmp_path / "baked_twice.glb")
        first, second = (attributes_of(after, 0, part) for part in range(2))
        assert (first[ALPHA], first[BETA]) == (second[ALPHA], second[BETA])
        assert first[ALPHA] != first[BETA]


@pytest.mark.parametrize(
    "storage", [GradientFormat(), GradientFormat(Encoding.PACKED8), GradientFormat(layout=Layout.TEXCOORD)]
)
@pytest.mark.parametrize("scheme", [Scheme.NONE, Scheme.MESHOPT])
def test_equal_attributes_of_a_primitive_share_bytes_but_no_accessor_or_view(
    tmp_path: Path, storage: GradientFormat, scheme: Scheme
) -> None:
    """One joint moves all of the sheet, so that α and β are 0. panda3d-gltf reads it only like this."""
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (20, 1))
    rigid = sheet(WEIGHTS_0=weights, JOINTS_0=np.zeros((20, 4), np.uint8))
    source = write_model(tmp_path / "rigid.glb", [rigid, rigid])
    once, twice = tmp_path / "once.glb", tmp_path / "twice.glb"
    result = bake_file(source, once, storage=storage, compression=Compression(scheme))
    assert result.status == "baked"
    after = read(once)
    for part in range(2):
        numbers = list(attributes_of(after, 0, part).values())
        views = [after.content["accessors"][number]["bufferView"] for number in numbers]
        assert len(set(numbers)) == len(set(views)) == len(numbers)
    data = note(after.content, 0) or {}
    names = [*data["alpha"], *data["beta"]]
    first, second = (attributes_of(after, 0, part) for part in range(2))
    assert [first[name] for name in names] == [second[name] for name in names]
    added = [after.content["accessors"][first[name]]["bufferView"] for name in dict.fromkeys(names)]
    places = [after.content["bufferViews"][view] for view in added]
    assert len({(view["buffer"], view["byteOffset"]) for view in places}) == 1
    assert bake_file(once, twice, storage=storage, compression=Compression(scheme)).status == "baked"
    assert twice.read_bytes() == once.read_bytes()
    assert verify(once, "--poses", "random:2").exit_code == 0
    if scheme is Scheme.NONE:
        stripped(once, tmp_path / "stripped.glb")
        assert (tmp_path / "stripped.glb").read_bytes() == source.read_bytes()


@pytest.mark.parametrize("encoding", Encoding)
def test_equal_attributes_beside_a_draco_stream_have_their_own_accessors(
    encoding: Encoding, tmp_path: Path
) -> None:
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (20, 1))
    rigid = sheet(WEIGHTS_0=weights, JOINTS_0=np.zeros((20, 4), np.uint8))
    source, target = write_model(tmp_path / "rigid.glb", [rigid]), tmp_path / "baked.glb"
    storage, compression = GradientFormat(encoding), Compression(Scheme.DRACO)
    assert bake_file(source, target, storage=storage, compression=compression).status == "baked"
    numbers = list(attributes_of(read(target), 0, 0).values())
    assert len(set(numbers)) == len(numbers)


def test_equal_bytes_of_different_formats_are_not_shared() -> None:
    additions = Additions(read_document(str(FOLDER / "seam.glb")), note_key="skinbake")
    shorts = np.arange(8, dtype=np.uint16).reshape(2, 4)
    formats: list[tuple[AnyArray, bool]] = [
        (shorts, False),
        (shorts, True),
        (shorts.view(np.uint8).reshape(4, 4), False),
    ]
    formats += [(shorts.view(np.uint8).reshape(2, 8)[:, :4].copy().view(np.float32), False)]
    numbers = [additions.add(values, normalized=normalized) for values, normalized in formats]
    assert len(set(numbers)) == len(formats)
    assert [additions.add(values, normalized=normalized) for values, normalized in formats] == numbers


def test_arrays_that_differ_in_one_bit_have_accessors_of_their_own() -> None:
    added = Additions(read_document(str(FOLDER / "seam.glb")))
    others = np.zeros((50, 1000, 4), np.float32)
    others[:, 998, 2] = np.arange(1, 51)
    others[7, 998, 2] = -0.0
    arrays = [others[0] * 0, others[0, :500] * 0, *others]
    numbers = [added.add(one) for one in arrays]
    assert len(set(numbers)) == len(arrays)
    assert [added.add(one.copy()) for one in arrays] == numbers


def test_a_second_accessor_of_equal_bytes_is_made_once() -> None:
    added = Additions(read_document(str(FOLDER / "seam.glb")))
    values = np.arange(8, dtype=np.float32).reshape(2, 4)
    first = added.add(values)
    length = added.byte_length
    second = added.add(values, apart_from={first})
    assert first != second
    assert added.add(values.copy(), apart_from={second}) == first
    assert added.add(values.copy(), apart_from=[first]) == second
    assert added.byte_length == length


@pytest.mark.parametrize("packed", [None, Packed("EXT_meshopt_compression", 0, beside=False)])
@pytest.mark.parametrize(
    ("kind", "columns", "stride"), [("u1", 1, 4), ("i1", 3, 4), ("u2", 3, 8), ("f4", 3, 12)]
)
def test_elements_of_whole_arrays_begin_at_multiples_of_four(
    kind: str, columns: int, stride: int, packed: Packed | None
) -> None:
    """glTF 2.0, section 3.6.2.4. Some exporters put colours of three bytes into Draco."""
    values = np.arange(1, 7 * columns + 1).astype(kind).reshape(7, columns)
    added = Additions(read_document(str(FOLDER / "seam.glb")))
    number = added.add_values(values, packed)
    document = added.applied({})
    view = document.objects("bufferViews")[number]
    assert view.get("byteStride", values[0].nbytes) == stride
    data = bytes(view_bytes(document, number, Place("x")))
    rows = np.frombuffer(data.ljust(7 * stride, b"\0"), np.uint8).reshape(7, stride)
    assert np.array_equal(rows[:, : values[0].nbytes].copy().view(kind), values)


class TestUnbaked:
    def test_unskinned_primitives_are_untouched(self, tmp_path: Path) -> None:
        def change(content: JsonObject) -> None:
            first = content["meshes"][0]["primitives"][0]
            names = ("POSITION", "NORMAL")
            rigid = {**first, "attributes": {name: first["attributes"][name] for name in names}, "extras": 3}
            content["meshes"] += [{"primitives": [rigid]}, {"primitives": [dict(first)]}]
            content["meshes"][0]["primitives"].append(rigid)
            content["nodes"] += [{"mesh": 1}, {"mesh": 2}]

        path = edited("seam.glb", tmp_path, change)
        before, after = read(path), baked(path, tmp_path / "baked.glb")
        for place in ((0, 1), (1, 0), (2, 0)):
            assert after.primitive(*place) == before.primitive(*place)
            assert note(after.content, *place) is None
        assert note(after.content, 0, 0) is not None
        assert_only_added(before, after)

    def test_skipped_primitives_are_untouched_and_named(self, tmp_path: Path) -> None:
        lines = Part(sheet().attributes, sheet().indices, mode=1)
        points = Part(sheet().attributes, None, mode=0)
        path = write_model(tmp_path / "sheet.glb", [sheet(), lines, points, sheet(NORMAL=None)])
        result = bake(path, tmp_path / "baked.glb")
        before, after = read(path), read(tmp_path / "baked.glb")
        assert (len(result.primitives), result.skipped) == (1, 3)
        skipped = {notice.place.primitive: notice.code for notice in result.notices}
        assert skipped == {1: "no-surface", 2: "no-surface", 3: "no-normals"}
        assert [after.primitive(0, n) for n in (1, 2, 3)] == [before.primitive(0, n) for n in (1, 2, 3)]
        assert_only_added(before, after)

    @pytest.mark.parametrize("name", ["plain.glb", "plain.gltf"])
    def test_a_file_in_which_nothing_can_be_baked_passes_through(self, name: str, tmp_path: Path) -> None:
        path = write_model(tmp_path / name, [sheet(NORMAL=None)])
        result = bake(path, tmp_path / f"baked_{name}")
        assert (result.status, result.skipped) == ("unchanged", 1)
        assert [notice.code for notice in result.notices] == ["no-normals", "nothing-baked"]
        assert (tmp_path / f"baked_{name}").read_bytes() == path.read_bytes()


class TestNames:
    def test_an_attribute_of_that_name_is_not_overwritten(self, tmp_path: Path) -> None:
        def take(name: str, content: JsonObject) -> None:
            content["meshes"][0]["primitives"][0]["attributes"][name] = 0

        for taken in (ALPHA, BETA):
            path = write_model(
                tmp_path / "sheet.glb",
                [sheet()],
                change=partial(take, taken),
            )
            with pytest.raises(InputError, match="--alpha-name") as raised:
                bake_file(str(path), str(tmp_path / "baked.glb"))
            assert taken in str(raised.value)
            assert not (tmp_path / "baked.glb").exists()
            assert baked(path, tmp_path / "other.glb", names=OTHER_NAMES).has_attribute(taken)

    def test_a_pattern_holds_braces_and_letters_beyond_ascii(self, tmp_path: Path) -> None:
        names = AttributeNames("_α{{set}}{x}", "_β {set}")
        after = baked(FOLDER / "seam.glb", tmp_path / "seam.glb", names=names)
        assert list(attributes_of(after))[-2:] == ["_α{0}{x}", "_β 0"]


EXTRAS: list[Any] = [{}, {"mine": 1}, [], [1, {"two": None}], "text", "", 5, 0, 1.5, True, False, None]


class TestExtras:
    @pytest.mark.parametrize("extras", EXTRAS)
    def test_what_stands_in_extras_stays(self, extras: Any, tmp_path: Path) -> None:
        path = edited("seam.glb", tmp_path, set_extras(extras))
        before, after = read(path), baked(path, tmp_path / "baked.glb")
        assert_only_added(before, after)
        holder = after.primitive(0)
        if isinstance(extras, dict):
            assert {key: holder["extras"][key] for key in extras} == extras
        else:
            assert holder["extras"] == extras
            accessor = after.content["accessors"][holder["attributes"][ALPHA]]
            assert accessor["extras"]["skinbake"]["version"] == 1

    def test_a_stranger_of_our_name_in_extras_stays(self, tmp_path: Path) -> None:
        extras = {"skinbake": {"enabled": True}, "other": 1}
        path = edited("seam.glb", tmp_path, set_extras(extras))
        after = baked(path, tmp_path / "baked.glb")
        assert after.primitive(0)["extras"] == extras
        assert_only_added(read(path), after)


def set_extras(extras: Any) -> Any:
    return lambda content: content["meshes"][0]["primitives"][0].update(extras=extras)


class TestFrames:
    def test_tangents_are_used_where_they_are_orthonormal(self, tmp_path: Path) -> None:
        source = FOLDER / "mirrored_tangent.glb"
        auto, forced, normal = (
            baked(source, tmp_path / f"{frame}.glb", settings=bake_settings(frame=frame))
            for frame in FrameChoice
        )
        assert (note(auto.content) or {})["frame"] == "tangent"
        assert (note(normal.content) or {})["frame"] == "normal"
        assert auto.content == forced.content
        assert auto.binary_chunk == forced.binary_chunk
        # The same vector ∇w in two orthonormal frames: its length is one, its components are two.
        lengths = [np.hypot(model.attribute(ALPHA), model.attribute(BETA)) for model in (auto, normal)]
        np.testing.assert_allclose(lengths[0], lengths[1], rtol=1e-5, atol=1e-6)
        assert not np.allclose(auto.attribute(ALPHA), normal.attribute(ALPHA), atol=0.1)

    def test_alpha_and_beta_follow_tangent_and_bitangent(self, tmp_path: Path) -> None:
        """Turning every TANGENT by 90° about its normal turns (α, β) into (β, −α); w = −1 flips β."""
        tangents, bitangents = tangent_frame(sheet())
        first = tangent_model(tmp_path / "a.glb", tangents, 1)
        turned = tangent_model(tmp_path / "b.glb", bitangents, 1)
        mirrored = tangent_model(tmp_path / "c.glb", tangents, -1)
        scale = np.abs(first.attribute(ALPHA)).max()
        close = {"rtol": 1e-5, "atol": 1e-6 * scale}
        np.testing.assert_allclose(turned.attribute(ALPHA), first.attribute(BETA), **close)
        np.testing.assert_allclose(turned.attribute(BETA), -first.attribute(ALPHA), **close)
        np.testing.assert_allclose(mirrored.attribute(ALPHA), first.attribute(ALPHA), **close)
        np.testing.assert_allclose(mirrored.attribute(BETA), -first.attribute(BETA), **close)

    @pytest.mark.parametrize(
        ("degrees", "frame"), [(0.0, "tangent"), (0.05, "tangent"), (0.2, "normal"), (1.0, "normal")]
    )
    def test_a_leaning_tangent_is_handled_and_said(self, degrees: float, frame: str, tmp_path: Path) -> None:
        part = leaning(degrees)
        path = write_model(tmp_path / "sheet.glb", [part])
        result = bake(path, tmp_path / "auto.glb")
        found = note(read(tmp_path / "auto.glb").content)
        assert found is not None
        assert found["frame"] == frame
        assert ("TANGENT" in found["digest"]) == (frame == "tangent")
        notices = [notice for notice in result.notices if notice.code == "tangents-skewed"]
        assert len(notices) == (frame == "normal")
        for notice in notices:
            assert notice.count == 20
            assert f"up to {degrees:g}°" in notice.message
            assert "from NORMAL instead" in notice.message
        normal = baked(write_model(tmp_path / "bare.glb", [sheet()]), tmp_path / "bare_baked.glb")
        same = (read(tmp_path / "auto.glb").attribute(ALPHA) == normal.attribute(ALPHA)).all()
        assert same == (frame == "normal")

    def test_a_leaning_tangent_is_used_where_it_is_asked_for(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "sheet.glb", [leaning(1.0)])
        result = bake(path, tmp_path / "baked.glb", settings=bake_settings(frame=FrameChoice.TANGENT))
        (notice,) = result.notices
        assert notice.code == "tangents-skewed"
        assert "as asked" in notice.message
        assert (note(read(tmp_path / "baked.glb").content) or {})["frame"] == "tangent"

    def test_a_primitive_without_tangents_is_skipped_where_they_are_asked_for(self, tmp_path: Path) -> None:
        result = bake(
            FOLDER / "seam.glb", tmp_path / "a.glb", settings=bake_settings(frame=FrameChoice.TANGENT)
        )
        assert [notice.code for notice in result.notices] == ["no-tangents", "nothing-baked"]
        assert result.status == "unchanged"


def tangent_frame(part: Part) -> tuple[AnyArray, AnyArray]:
    normals = part.attributes["NORMAL"].astype(float)
    tangents = np.cross(normals, [0.3, 1.0, 0.2])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    return tangents, np.cross(normals, tangents)


def tangent_model(path: Path, tangents: AnyArray, handedness: int) -> GltfFile:
    attribute = np.column_stack([tangents, np.full(len(tangents), handedness)]).astype(np.float32)
    write_model(path, [sheet(TANGENT=attribute)])
    return baked(path, path.with_name(f"baked_{path.name}"))


def leaning(degrees: float) -> Part:
    """Make a sheet whose TANGENT leans out of the tangent plane: t0 × b0 leans as far from NORMAL."""
    tangents, _ = tangent_frame(sheet())
    angle = np.deg2rad(degrees)
    normals = sheet().attributes["NORMAL"].astype(float)
    leaned = np.cos(angle) * tangents + np.sin(angle) * normals
    return sheet(TANGENT=np.column_stack([leaned, np.ones(20)]).astype(np.float32))


class TestValuesThatAreNoNumbers:
    @pytest.mark.parametrize("attribute", ["NORMAL", "TANGENT"])
    def test_alpha_and_beta_are_numbers_all_the_same(self, attribute: str, tmp_path: Path) -> None:
        tangents, _ = tangent_frame(sheet())
        arrays = {
            "NORMAL": sheet().attributes["NORMAL"].copy(),
            "TANGENT": np.column_stack([tangents, np.ones(20)]).astype(np.float32),
        }
        arrays[attribute][3] = np.nan
        arrays[attribute][7, 0] = np.inf
        path = write_model(tmp_path / "sheet.glb", [sheet(**arrays)])
        result = bake(path, tmp_path / "baked.glb")
        assert result.status == "baked"
        # A normal that is taken as (0, 0, 1) has its tangent leaning, which is said too.
        assert {notice.count for notice in result.notices} == {2}
        assert any(attribute in notice.message for notice in result.notices)
        after = read(tmp_path / "baked.glb")
        assert np.isfinite(after.attribute(ALPHA)).all()
        assert np.isfinite(after.attribute(BETA)).all()


class TestGeneratedNormals:
    def test_generated_normals_are_smooth_and_noted(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "sheet.glb", [sheet(NORMAL=None)])
        result = bake(path, tmp_path / "baked.glb", generate_normals=True)
        before, after = read(path), read(tmp_path / "baked.glb")
        assert result.primitives[0][1].generated_normals
        assert (note(after.content) or {})["generated"] == ["NORMAL"]
        assert_only_added(before, after)
        normals = after.attribute("NORMAL")
        assert after.stored_attribute("NORMAL").dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
        # A sheet of 5 × 4 vertices is coarse; its true normals are some degrees away.
        cosines = (normals * sheet().attributes["NORMAL"]).sum(axis=1)
        assert np.rad2deg(np.arccos(cosines.min())) < 12

    def test_given_normals_are_kept(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "sheet.glb", [sheet(), sheet(NORMAL=None)])
        after = baked(path, tmp_path / "baked.glb", generate_normals=True)
        assert attributes_of(after)["NORMAL"] == attributes_of(read(path))["NORMAL"]
        assert "generated" not in (note(after.content, 0, 0) or {})
        assert (note(after.content, 0, 1) or {})["generated"] == ["NORMAL"]

    def test_baking_again_keeps_them_apart_from_given_ones(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "sheet.glb", [sheet(NORMAL=None)])
        bake(path, tmp_path / "once.glb", generate_normals=True)
        bake(tmp_path / "once.glb", tmp_path / "twice.glb", generate_normals=True)
        assert (tmp_path / "twice.glb").read_bytes() == (tmp_path / "once.glb").read_bytes()


class TestInfluences:
    def test_eight_bit_weights_that_adopt_become_sixteen_bits(self, tmp_path: Path) -> None:
        """v / 255 is exactly 257 v / 65535; an adopted slot has 1, which the vertex's largest weight pays."""
        before = read(FOLDER / "weights_u8.glb")
        after = baked(FOLDER / "weights_u8.glb", tmp_path / "baked.glb")
        assert set((note(after.content) or {})["adopted"]) == {"JOINTS_0", "WEIGHTS_0"}
        old, new = (model.stored_attribute("WEIGHTS_0").astype(int) for model in (before, after))
        assert after.stored_attribute("WEIGHTS_0").dtype == np.uint16
        assert after.content["accessors"][attributes_of(after)["WEIGHTS_0"]]["normalized"] is True
        assert (new.sum(axis=1) == 65535).all()
        change = new - 257 * old
        adopting = (change == 1).any(axis=1)
        assert adopting.any()
        assert not change[~adopting].any()
        assert (change[change > 0] == 1).all()
        assert (old[change > 0] == 0).all()
        assert (change.min(axis=1) == -(change > 0).sum(axis=1)).all()
        assert (old.argmax(axis=1)[adopting] == change.argmin(axis=1)[adopting]).all()

    def test_eight_bit_weights_without_a_change_stay(self, tmp_path: Path) -> None:
        settings = bake_settings(neighbours=Neighbours.DROP)
        before = read(FOLDER / "weights_u8.glb")
        after = baked(FOLDER / "weights_u8.glb", tmp_path / "baked.glb", settings=settings)
        assert attributes_of(after)["WEIGHTS_0"] == attributes_of(before)["WEIGHTS_0"]
        assert (note(after.content) or {})["neighbours"] == "drop"

    def test_adopted_joints_change_no_other_slot(self, tmp_path: Path) -> None:
        before = read(FOLDER / "foreign_joints.glb")
        after = baked(FOLDER / "foreign_joints.glb", tmp_path / "baked.glb")
        (old_joints, old_weights), (joints, weights) = before.influences(), after.influences()
        adopted = weights != old_weights
        assert adopted.any()
        assert (old_weights[adopted] == 0).all()
        assert (weights[adopted] == 2.0**-30).all()
        assert (joints == old_joints)[~adopted].all()
        assert joints.max() < 4
        for row in joints[adopted.any(axis=1)]:
            assert len(set(row.tolist()) - {0}) >= 1

    def test_two_sets_have_two_pairs_of_attributes(self, tmp_path: Path) -> None:
        after = baked(FOLDER / "two_sets.glb", tmp_path / "baked.glb")
        for letter in ("ALPHA", "BETA"):
            assert after.attribute(f"_SKINBAKE_{letter}_0").shape == (256, 3)
            assert after.attribute(f"_SKINBAKE_{letter}_1").shape == (256, 4)
            assert after.attribute(f"_SKINBAKE_{letter}_1").any()

    def test_three_sets_are_baked_too(self, tmp_path: Path) -> None:
        nothing = np.zeros((20, 4), np.uint8)
        part = sheet(
            JOINTS_1=nothing,
            WEIGHTS_1=nothing.astype(np.float32),
            JOINTS_2=nothing.astype(np.uint16),
            WEIGHTS_2=nothing,
        )
        after = baked(write_model(tmp_path / "sheet.glb", [part]), tmp_path / "baked.glb")
        assert after.attribute("_SKINBAKE_ALPHA_2").shape == (20, 4)
        assert (note(after.content) or {})["influences"] == 12


class TestModes:
    @pytest.mark.parametrize("mode", [5, 6])
    def test_strips_and_fans_bake_like_the_list_of_their_triangles(self, mode: int, tmp_path: Path) -> None:
        strip = (
            np.array([0, 1, 4, 5, 8, 9, 12, 13]) if mode == 5 else np.array([5, 0, 4, 8, 9, 10, 6, 2, 1, 0])
        )
        drawn = write_model(tmp_path / "drawn.glb", [Part(sheet().attributes, strip, mode)])
        listed = write_model(tmp_path / "listed.glb", [Part(sheet().attributes, read(drawn).triangles())])
        first, second = (baked(path, path.with_suffix(".baked.glb")) for path in (drawn, listed))
        assert first.primitive(0)["mode"] == mode
        assert (first.attribute(ALPHA) == second.attribute(ALPHA)).all()
        assert (first.attribute(BETA) == second.attribute(BETA)).all()
        assert first.attribute(ALPHA).any()

    def test_a_primitive_without_indices_bakes_like_its_indexed_twin(self, tmp_path: Path) -> None:
        part = sheet()
        corners = np.asarray(part.indices).reshape(-1)
        spread = {name: array[corners] for name, array in part.attributes.items()}
        indexed = baked(write_model(tmp_path / "a.glb", [part]), tmp_path / "a_baked.glb")
        path = write_model(tmp_path / "b.glb", [Part(spread, None)])
        flat = baked(path, tmp_path / "b_baked.glb")
        assert "indices" not in flat.primitive(0)
        for name in (ALPHA, BETA):
            np.testing.assert_allclose(
                flat.attribute(name), indexed.attribute(name)[corners], rtol=1e-5, atol=1e-6
            )


class TestBuffers:
    def test_a_glb_grows_its_bin_chunk(self, tmp_path: Path) -> None:
        before, after = read(FOLDER / "seam.glb"), baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
        assert len(after.content["buffers"]) == 1
        assert after.binary_chunk is not None
        assert after.content["buffers"][0]["byteLength"] == len(after.binary_chunk)
        assert after.binary_chunk.startswith(before.binary_chunk or b"-")

    def test_a_gltf_gets_a_buffer_of_its_own(self, tmp_path: Path) -> None:
        source = copied(SHARED, tmp_path)
        before = sorted(path.name for path in tmp_path.iterdir())
        after = baked(source, tmp_path / "baked.gltf")
        *old, new = after.content["buffers"]
        assert old == read(source).content["buffers"]
        assert new["byteLength"] == (tmp_path / new["uri"]).stat().st_size
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*before, "baked.gltf", new["uri"]])

    def test_a_glb_whose_buffer_is_a_file_gets_a_data_uri(self, tmp_path: Path) -> None:
        source = read(FOLDER / "seam.glb")
        (tmp_path / "body.bin").write_bytes(source.binary_chunk or b"")
        path = edited("seam.glb", tmp_path, lambda content: content["buffers"][0].update(uri="body.bin"))
        before, after = read(path), baked(path, tmp_path / "baked.glb")
        assert [buffer["uri"][:9] for buffer in after.content["buffers"]] == ["body.bin", "data:appl"]
        assert_only_added(before, after)
        assert after.attribute(ALPHA).any()

    def test_unknown_chunks_and_trailing_bytes_stay(self, tmp_path: Path) -> None:
        data = (FOLDER / "seam.glb").read_bytes()
        extra = b"\x04\0\0\0XTRAabcd"
        path = tmp_path / "odd.glb"
        path.write_bytes(data[:8] + (len(data) + 12).to_bytes(4, "little") + data[12:] + extra + b"tail")
        bake(path, tmp_path / "baked.glb")
        written = (tmp_path / "baked.glb").read_bytes()
        assert written.endswith(extra + b"tail")
        assert int.from_bytes(written[8:12], "little") == len(written) - 4
        assert (note(read(tmp_path / "baked.glb").content) or {})["version"] == 1

    def test_padding_of_the_bin_chunk_stays_where_it_was(self, tmp_path: Path) -> None:
        def shorten(content: JsonObject) -> None:
            content["buffers"][0]["byteLength"] -= 2
            content["accessors"][-1]["count"] -= 1
            content["bufferViews"][-1]["byteLength"] -= 64

        path = edited("weights_u16.glb", tmp_path, shorten)
        before, after = read(path), baked(path, tmp_path / "baked.glb")
        assert (after.binary_chunk or b"").startswith(before.binary_chunk or b"-")
        assert_only_added(before, after)


def test_the_copied_fixture_folder_is_enough(tmp_path: Path) -> None:
    """Nothing is looked for beside the file but what its URIs name."""
    shutil.copyfile(FOLDER / "seam.glb", tmp_path / "seam.glb")
    bake(tmp_path / "seam.glb", tmp_path / "out.glb")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.glb", "seam.glb"]
