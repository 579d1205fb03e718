"""The former data of a file is put back only if that loses nothing that came after the bake."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import JsonObject, pack_glb
from skinbake.choices import FrameChoice
from skinbake.commands.strip import strip_file
from skinbake.errors import InputError, Place
from skinbake.format.strip import stripped
from skinbake.gltf import json_access
from skinbake.gltf.codecs import draco
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.accessors import StoredArray, read_accessor
from tests.support import gltf_transform
from tests.support.baking import bake_file
from tests.support.compressed import draco_twin
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import FOLDER, Change, baked, copied, rewritten


def edited(name: str, tmp_path: Path, change: Change) -> Path:
    model = baked(copied(name, tmp_path), tmp_path / f"baked_{name}")
    change(model.content)
    return rewritten(model, tmp_path / f"edited_{name}")


def swapped_weights(path: Path, tmp_path: Path) -> tuple[Path, np.ndarray]:
    """Swap the first two weights of every vertex in the accessor that the baked primitive now has."""
    model = read(path)
    number = model.primitive(0)["attributes"]["WEIGHTS_0"]
    accessor = model.content["accessors"][number]
    view = model.content["bufferViews"][accessor["bufferView"]]
    data = bytearray(path.read_bytes())
    start = data.index(bytes(model.buffer_view(accessor["bufferView"])))
    values = model.stored(number).copy()
    values[:, [0, 1]] = values[:, [1, 0]]
    data[start : start + view["byteLength"]] = values.tobytes()
    target = tmp_path / f"swapped_{path.name}"
    target.write_bytes(data)
    return target, read(target).attribute("WEIGHTS_0")


@pytest.mark.parametrize("name", ["weights_u8.glb", "weights_u16.glb"])
def test_weights_edited_after_a_bake_survive_the_next_bake_and_strip(name: str, tmp_path: Path) -> None:
    first = tmp_path / f"first_{name}"
    bake_file(str(FOLDER / name), str(first))
    changed, weights = swapped_weights(first, tmp_path)
    assert not np.array_equal(weights, read(first).attribute("WEIGHTS_0"))
    result = bake_file(str(changed), str(tmp_path / "again.glb"))
    assert "adopted-kept" in [notice.code for notice in result.notices]
    now = read(tmp_path / "again.glb").attribute("WEIGHTS_0")
    assert np.abs(now - weights).max() <= 4 / 65535
    strip_file(str(changed), str(tmp_path / "stripped.glb"))
    assert np.array_equal(read(tmp_path / "stripped.glb").attribute("WEIGHTS_0"), weights)


def test_a_note_that_names_the_adopted_accessors_themselves_is_not_believed(tmp_path: Path) -> None:
    """A tool that renumbers accessors leaves the note as it is, and its numbers can hit anything."""

    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        note = primitive["extras"]["skinbake"]
        note["adopted"] = {name: primitive["attributes"][name] for name in note["adopted"]}

    path = edited("foreign_joints.glb", tmp_path, change)
    assert strip_file(str(path), str(tmp_path / "stripped.glb")).notices == ()
    assert_influences_of_source(tmp_path / "stripped.glb")


def test_a_note_on_former_influences_puts_back_nothing_else(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        noted = primitive["extras"]["skinbake"]["adopted"]
        noted |= {"POSITION": primitive["attributes"]["NORMAL"], "JOINTS_3": noted["JOINTS_0"]}

    path = edited("foreign_joints.glb", tmp_path, change)
    assert strip_file(str(path), str(tmp_path / "stripped.glb")).notices == ()
    assert_influences_of_source(tmp_path / "stripped.glb")
    source, after = read(FOLDER / "foreign_joints.glb"), read(tmp_path / "stripped.glb")
    assert set(after.primitive(0)["attributes"]) == set(source.primitive(0)["attributes"])
    assert np.array_equal(after.stored_attribute("POSITION"), source.stored_attribute("POSITION"))


def assert_influences_of_source(path: Path) -> None:
    for name in ("JOINTS_0", "WEIGHTS_0"):
        found, wanted = (read(file).stored_attribute(name) for file in (path, FOLDER / "foreign_joints.glb"))
        assert found.dtype == wanted.dtype
        assert np.array_equal(found, wanted)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["copy", "dedup", "resample", "unlit"])
def test_former_influences_are_found_after_another_tool_has_renumbered_them(
    command: str, tmp_path: Path
) -> None:
    gltf_transform.require_node()
    source, changed, again, back = (tmp_path / f"{name}.glb" for name in ("once", "tool", "again", "back"))
    bake_file(str(FOLDER / "foreign_joints.glb"), str(source))
    assert gltf_transform.run([command, source, changed]).returncode == 0
    note = read(changed).primitive(0)["extras"]["skinbake"]
    assert note["adopted"]["WEIGHTS_0"] == read(changed).primitive(0)["attributes"]["WEIGHTS_0"]
    strip_file(str(changed), str(back))
    assert_influences_of_source(back)
    result = bake_file(str(changed), str(again))
    assert "adopted-kept" not in [notice.code for notice in result.notices]
    for name in ("JOINTS_0", "WEIGHTS_0", "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        found, wanted = (read(file).stored_attribute(name) for file in (again, source))
        assert np.array_equal(found, wanted), name


@pytest.mark.parametrize("broken", [None, 7, ["a"], {"JOINTS": [1], "WEIGHTS": {}}])
def test_broken_digests_find_nothing(broken: object, tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["formerDigest"] = broken

    path = edited("foreign_joints.glb", tmp_path, change)
    result = strip_file(str(path), str(tmp_path / "stripped.glb"))
    (told,) = (notice.message for notice in result.notices if notice.code == "adopted-kept")
    assert told.endswith("A bake takes them for the file's own: bake from the source instead")


@pytest.mark.parametrize(
    "change",
    [
        lambda note: 7,
        lambda note: {"before": 7},
        lambda note: {**note, "accessors": 7},
        lambda note: {**note, "accessors": dict.fromkeys(note["accessors"], 999)},
        lambda note: {**note, "before": {**note["before"], "bufferView": 999}},
        lambda note: {**note, "before": {**note["before"], "attributes": 7}},
    ],
)
def test_a_broken_note_on_the_former_draco_stream_restores_nothing(
    change: Callable[[JsonObject], object], tmp_path: Path
) -> None:
    twin = draco_twin(FOLDER / "foreign_joints.glb", tmp_path / "twin.glb")
    model = baked(twin, tmp_path / "baked.glb")
    before = model.primitive(0)
    extension = before["extensions"][draco.EXTENSION]
    extension["extras"]["skinbake"] = change(extension["extras"]["skinbake"])
    result = strip_file(str(rewritten(model, tmp_path / "broken.glb")), str(tmp_path / "stripped.glb"))
    assert [notice.code for notice in result.notices] == ["adopted-kept", "bytes-left"]
    after = read(tmp_path / "stripped.glb").primitive(0)
    names = [name for name in before["attributes"] if not name.startswith("_SKINBAKE_")]
    assert after["attributes"] == {name: before["attributes"][name] for name in names}
    assert after["extensions"][draco.EXTENSION]["bufferView"] == extension["bufferView"]


@pytest.mark.slow
def test_many_accessors_that_share_their_bytes_are_not_all_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def change(content: JsonObject) -> None:
        note = content["meshes"][0]["primitives"][0]["extras"]["skinbake"]
        like = content["accessors"][note["adopted"]["WEIGHTS_0"]]
        content["accessors"] += [dict(like) for _ in range(20_000)]
        note["formerDigest"]["WEIGHTS"] = "0" * 32

    path, rows = edited("foreign_joints.glb", tmp_path, change), []

    def counted(document: Document, number: int, place: Place) -> StoredArray:
        stored = read_accessor(document, number, place)
        rows.append(len(stored.values))
        return stored

    monkeypatch.setattr("skinbake.format.former.read_accessor", counted)
    result = strip_file(str(path), str(tmp_path / "stripped.glb"))
    assert "adopted-kept" in [notice.code for notice in result.notices]
    size = path.stat().st_size
    assert size < sum(rows) < 20_000 * rows[0]
    assert sum(rows) < max(size, 1 << 19) + 10 * rows[0]


class Watched(dict[str, Any]):
    """An object of JSON that counts how often one of its kind is looked at."""

    looks = 0

    def get(self, key: str, default: object = None) -> Any:
        Watched.looks += 1
        return super().get(key, default)


def test_the_search_takes_time_in_proportion_to_the_primitives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of 300 primitives has another number of vertices, and accessors that are looked for in vain."""
    document, count = read_document(str(many_sizes(tmp_path, 300))), 600
    primitives: list[int] = []
    original = draco.extension_of

    def counted(primitive: JsonObject) -> JsonObject | None:
        primitives.append(1)
        return original(primitive)

    def watched(parent: JsonObject, key: str, place: Place) -> list[JsonObject]:
        return [Watched(entry) for entry in found(parent, key, place)]

    found = json_access.objects
    monkeypatch.setattr("skinbake.gltf.codecs.draco.extension_of", counted)
    monkeypatch.setattr("skinbake.gltf.asset.objects", watched)
    Watched.looks = 0
    _, restored = stripped(document.edited())
    assert restored == 300
    assert [notice.code for notice in document.notices].count("adopted-kept") == 300
    assert count < Watched.looks < 50 * count
    assert 300 < len(primitives) < 50 * 300


def many_sizes(folder: Path, count: int) -> Path:
    """Write a file with primitives of 1, 2, 3 … vertices, whose notes name influences that are not there."""
    model = baked(copied("foreign_joints.glb", folder), folder / "baked.glb")
    content, data = model.content, model.binary_chunk or b""
    version = model.primitive(0)["extras"]["skinbake"]["version"]
    content["buffers"][0]["byteLength"] = len(data) + 16 * count
    view = len(content["bufferViews"])
    content["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": 16 * count})
    content["accessors"], primitives = [], []
    for size in range(1, count + 1):
        for code in (5123, 5126):
            content["accessors"].append(
                {"bufferView": view, "componentType": code, "count": size, "type": "VEC4"}
            )
    for number in range(count):
        digest = {
            "JOINTS": sha256(bytes(8 * (number + 1))).hexdigest()[:32],
            "WEIGHTS": sha256(bytes(16 * (number + 1))).hexdigest()[:32],
        }
        names = {"JOINTS_0": 2 * number, "WEIGHTS_0": 2 * number + 1}
        former = {"adopted": names, "digest": digest, "formerDigest": {"JOINTS": "0", "WEIGHTS": "0"}}
        note = {"version": version, "alpha": [], "beta": [], **former}
        primitives.append({"attributes": names, "extras": {"skinbake": note}})
    content["meshes"] = [{"primitives": primitives}]
    path = folder / "many.glb"
    path.write_bytes(pack_glb(content, data + bytes(16 * count)))
    return path


def test_a_bake_takes_adopted_joints_that_stay_for_the_file_s_own(tmp_path: Path) -> None:
    """That is what its notice says: a strip of the next bake brings them back."""
    first = tmp_path / "first.glb"
    bake_file(str(FOLDER / "foreign_joints.glb"), str(first))
    model = read(first)
    del model.primitive(0)["extras"]["skinbake"]["formerDigest"]
    result = bake_file(str(rewritten(model, tmp_path / "cut.glb")), str(tmp_path / "again.glb"))
    assert "adopted-kept" in [notice.code for notice in result.notices]
    assert strip_file(str(tmp_path / "again.glb"), str(tmp_path / "back.glb")).notices == ()
    source, back = (
        np.count_nonzero(read(path).stored_attribute("WEIGHTS_0"))
        for path in (FOLDER / "foreign_joints.glb", tmp_path / "back.glb")
    )
    assert back > source


def test_indices_written_as_floats_change_nothing(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        attributes = content["meshes"][0]["primitives"][0]["attributes"]
        attributes.update({name: float(number) for name, number in attributes.items()})

    source = read(copied("foreign_joints.glb", tmp_path))
    change(source.content)
    path = rewritten(source, tmp_path / "floats.glb")
    once, twice, back = (tmp_path / f"{name}.glb" for name in ("once", "twice", "back"))
    bake_file(str(path), str(once))
    bake_file(str(once), str(twice))
    assert once.read_bytes() == twice.read_bytes()
    strip_file(str(once), str(back))
    assert read(back).content == read(path).content


def test_an_accessor_of_the_bake_that_a_morph_target_shares_stays(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        primitive["targets"] = [{"POSITION": primitive["attributes"]["_SKINBAKE_ALPHA_0"]}]

    path = edited("seam.glb", tmp_path, change)
    strip_file(str(path), str(tmp_path / "stripped.glb"))
    after: GltfFile = read(tmp_path / "stripped.glb")
    assert after.primitive(0)["targets"][0]["POSITION"] < len(after.content["accessors"])


def test_a_baked_glb_becomes_the_same_gltf_as_the_one_it_was_baked_from(tmp_path: Path) -> None:
    baked_glb = tmp_path / "foreign_joints.glb"
    bake_file(str(FOLDER / "foreign_joints.glb"), str(baked_glb))
    for folder, source in (("one", FOLDER / "foreign_joints.glb"), ("two", baked_glb)):
        (tmp_path / folder).mkdir()
        bake_file(str(source), str(tmp_path / folder / "x.gltf"))
    # What is noted of the files beside the target names its source.
    first, second = (sorted((tmp_path / folder).glob("[!.]*")) for folder in ("one", "two"))
    assert len(first) == 3
    assert [(path.name, path.read_bytes()) for path in first] == [
        (path.name, path.read_bytes()) for path in second
    ]


def test_a_file_that_can_no_longer_be_baked_passes_through_with_its_bake(tmp_path: Path) -> None:
    baked_glb = tmp_path / "seam.glb"
    bake_file(str(FOLDER / "seam.glb"), str(baked_glb))

    result = bake_file(str(baked_glb), str(tmp_path / "out.glb"), frame=FrameChoice.TANGENT)
    assert result.status == "unchanged"
    assert (tmp_path / "out.glb").read_bytes() == baked_glb.read_bytes()


def test_an_image_that_has_the_name_of_the_new_bin_keeps_its_bytes(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    source = read(copied("seam.glb", tmp_path / "in"))
    source.content["images"] = [{"uri": "./clash.bin"}]
    path = rewritten(source, tmp_path / "in" / "seam.glb")
    (tmp_path / "in" / "clash.bin").write_bytes(b"picture")
    (tmp_path / "out").mkdir()
    bake_file(str(path), str(tmp_path / "out" / "clash.gltf"))
    assert (tmp_path / "out" / "clash.bin").read_bytes() == b"picture"
    assert read(tmp_path / "out" / "clash.gltf").attribute("_SKINBAKE_ALPHA_0").any()


def test_a_folder_for_results_is_made_and_goes_again_where_nothing_comes_of_it(tmp_path: Path) -> None:
    target = tmp_path / "new" / "deeper" / "seam.glb"
    assert bake_file(str(FOLDER / "seam.glb"), str(target)).status == "baked"
    assert target.is_file()
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"glTF")
    other = tmp_path / "other" / "broken.glb"
    with pytest.raises(InputError):
        bake_file(str(broken), str(other))
    assert not other.parent.exists()
