"""The note that bake leaves: digests recomputed with hashlib from what the tests' own reader finds."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.commands.inspect import inspect_file
from skinbake.format.note import gradient_note_in
from skinbake.gltf.document import read_document
from skinbake.threads import threads_limited
from tests.support.gltf_reading import GltfFile
from tests.support.models import FIXTURES, FOLDER, SHARED, bake, baked, note, primitives, rewritten


def digest(values: Any, dtype: str) -> str:
    return hashlib.sha256(np.asarray(values).astype(dtype).tobytes()).hexdigest()[:32]


def digests(model: GltfFile, mesh: int, primitive: int, frame: str) -> dict[str, str]:
    joints, weights = model.influences(mesh, primitive)
    expected = {
        "POSITION": digest(model.attribute("POSITION", mesh, primitive), "<f4"),
        "NORMAL": digest(model.attribute("NORMAL", mesh, primitive), "<f4"),
        "JOINTS": digest(joints, "<u2"),
        "WEIGHTS": digest(weights, "<f4"),
        "indices": digest(model.triangles(mesh, primitive), "<u4"),
    }
    if frame == "tangent":
        expected["TANGENT"] = digest(model.attribute("TANGENT", mesh, primitive), "<f4")
    return expected


@pytest.mark.parametrize("name", FIXTURES)
def test_digests_are_those_of_the_arrays_in_the_written_file(name: str, tmp_path: Path) -> None:
    after = baked(FOLDER / name, tmp_path / name)
    for mesh, number, _ in primitives(after.content):
        found = note(after.content, mesh, number)
        assert found is not None
        assert found["digest"] == digests(after, mesh, number, found["frame"])


@pytest.mark.parametrize("name", ["mirrored_tangent.glb", "two_sets.glb"])
def test_digests_are_the_same_by_several_threads(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skinbake.format.digests.LARGE", 1)
    notes = []
    for count in (1, 2, 3, 8):
        with threads_limited(count):
            after = baked(FOLDER / name, tmp_path / name)
        for mesh, number, _ in primitives(after.content):
            found = note(after.content, mesh, number)
            assert found is not None
            assert found["digest"] == digests(after, mesh, number, found["frame"])
        notes.append((tmp_path / name).read_bytes())
    assert len(set(notes)) == 1


def changed(path: Path) -> set[str]:
    (primitive,) = inspect_file(str(path)).primitives
    assert primitive.bake is not None
    return set(primitive.bake.changed)


@pytest.mark.slow
def test_a_fresh_bake_is_up_to_date(tmp_path: Path) -> None:
    for name in FIXTURES:
        bake(FOLDER / name, tmp_path / name)
        bakes = [primitive.bake for primitive in inspect_file(str(tmp_path / name)).primitives]
        assert [found.changed for found in bakes if found] == [()] * len(bakes)


@pytest.mark.parametrize(
    ("attribute", "changes"),
    [
        ("POSITION", {"POSITION"}),
        ("NORMAL", {"NORMAL"}),
        ("TANGENT", {"TANGENT"}),
        ("WEIGHTS_0", {"WEIGHTS"}),
        ("JOINTS_0", {"JOINTS"}),
        ("TEXCOORD_0", set()),
    ],
)
def test_a_changed_value_is_recognised_by_its_array(
    attribute: str, changes: set[str], tmp_path: Path
) -> None:
    model = baked(FOLDER / "mirrored_tangent.glb", tmp_path / "baked.glb")
    accessor = model.content["accessors"][model.primitive(0)["attributes"][attribute]]
    start = model.content["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor.get("byteOffset", 0)
    data = bytearray(model.binary_chunk or b"")
    # The lowest bit of the first number: the smallest change that a file can hold.
    data[start] ^= 1
    path = rewritten(GltfFile(model.path, model.content, bytes(data)), tmp_path / "touched.glb")
    assert changed(path) == changes


def test_changed_indices_are_recognised(tmp_path: Path) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
    number = model.primitive(0)["indices"]
    model.content["accessors"][number]["count"] -= 3
    del model.content["accessors"][number]["min"], model.content["accessors"][number]["max"]
    assert changed(rewritten(model, tmp_path / "touched.glb")) == {"indices"}


def test_storing_the_same_values_in_another_way_changes_nothing(tmp_path: Path) -> None:
    """The integer joints of one fixture, stored as bytes, become shorts."""
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
    joints = model.stored_attribute("JOINTS_0")
    assert joints.dtype == np.uint8
    raw = joints.astype("<u2").tobytes()
    content = model.content
    length = len(model.binary_chunk or b"")
    content["bufferViews"].append({"buffer": 0, "byteOffset": length, "byteLength": len(raw)})
    content["accessors"].append(
        {
            "bufferView": len(content["bufferViews"]) - 1,
            "componentType": 5123,
            "count": len(joints),
            "type": "VEC4",
        }
    )
    content["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = len(content["accessors"]) - 1
    content["buffers"][0]["byteLength"] = length + len(raw)
    widened = GltfFile(model.path, content, (model.binary_chunk or b"") + raw)
    assert changed(rewritten(widened, tmp_path / "touched.glb")) == set()


def test_a_note_beside_odd_extras_is_found(tmp_path: Path) -> None:
    baked(FOLDER / SHARED, tmp_path / SHARED)
    document = read_document(str(tmp_path / SHARED))
    first, second = document.objects("meshes")[0]["primitives"]
    assert isinstance(first["extras"], list)
    beside, inside = gradient_note_in(document, first), gradient_note_in(document, second)
    assert beside is not None and inside is not None
    assert beside.alpha == ("_SKINBAKE_ALPHA_0",)
    assert inside.json == second["extras"]["skinbake"]


HOSTILE: list[tuple[str, Callable[[JsonObject], Any]]] = [
    ("no object", lambda extras: extras.update(skinbake=3)),
    ("no version", lambda extras: extras.update(skinbake={"frame": "normal"})),
    ("a version that is a string", lambda extras: extras.update(skinbake={"version": "1"})),
]


@pytest.mark.parametrize(("what", "change"), HOSTILE)
def test_what_is_no_note_of_ours_is_not_taken_for_one(
    what: str, change: Callable[[JsonObject], Any], tmp_path: Path
) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
    change(model.primitive(0)["extras"])
    document = read_document(str(rewritten(model, tmp_path / "odd.glb")))
    assert gradient_note_in(document, model.primitive(0)) is None, what
