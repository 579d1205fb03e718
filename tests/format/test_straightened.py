"""Single tangents that lean from the surface: bake straightens them, and strip brings them back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fixtures import builder, make_fixtures
from fixtures.builder import JsonObject
from skinbake.choices import FrameChoice, Truth
from skinbake.commands.inspect import inspect_file
from skinbake.commands.strip import strip_file
from skinbake.commands.verify import verify_file
from skinbake.errors import InputError
from skinbake.format.strip import stripped
from skinbake.geometry import frames
from skinbake.gltf import budget
from skinbake.gltf.document import read_document
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import FileResult
from skinbake.truth.poses import PoseRequest
from tests.support.baking import bake_settings
from tests.support.compressed import draco_twin, meshopt_twin
from tests.support.corpus import character
from tests.support.gltf_reading import GltfFile, read
from tests.support.khronos import new_findings, validate
from tests.support.models import FOLDER, Part, bake, note, rewritten, write_model

SOURCE = FOLDER / "mirrored_tangent.glb"
VERTEX = 70


def tangents_of(file: GltfFile) -> np.ndarray:
    return np.asarray(file.stored_attribute("TANGENT", 0, 0), np.float32)


def with_tangents(source: Path, target: Path, change: dict[int, np.ndarray]) -> Path:
    """Copy a GLB with other TANGENTs at some vertices of its first primitive."""
    file = read(source)
    accessor = file.content["accessors"][file.primitive(0)["attributes"]["TANGENT"]]
    view = file.content["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    data = bytearray(file.binary_chunk or b"")
    for vertex, tangent in change.items():
        place = start + vertex * view.get("byteStride", 16)
        data[place : place + 16] = np.asarray(tangent, "<f4").tobytes()
    return rewritten(GltfFile(target, file.content, bytes(data)), target)


def leaning(source: Path, target: Path, degrees: float, vertices: list[int]) -> Path:
    """Copy a GLB with the TANGENTs of some vertices turned out of the surface."""
    file = read(source)
    tangents, normals = tangents_of(file), np.asarray(file.attribute("NORMAL"))
    change = {}
    for vertex in vertices:
        turned = (
            np.cos(np.radians(degrees)) * tangents[vertex, :3] + np.sin(np.radians(degrees)) * normals[vertex]
        )
        change[vertex] = np.array([*turned, tangents[vertex, 3]])
    return with_tangents(source, target, change)


def straightening(result: FileResult) -> list[tuple[int | None, str]]:
    return [
        (notice.count, notice.message) for notice in result.notices if notice.code == "tangents-straightened"
    ]


@pytest.mark.parametrize("degrees", [0.2, 1.0, 10.0, 60.0, 85.0])
def test_a_single_tangent_is_straightened_and_the_frame_stays(degrees: float, tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", degrees, [VERTEX])
    result = bake(path, tmp_path / "baked.glb")
    ((count, message),) = straightening(result)
    assert (
        count,
        f"at vertex {VERTEX} TANGENT is not orthogonal to NORMAL ({degrees:g}° off)" in message,
    ) == (1, True)
    sound, after = read(SOURCE), read(tmp_path / "baked.glb")
    assert (note(after.content) or {})["frame"] == "tangent"
    # Turned within one plane and back, a tangent is what it was; no other vertex changes a bit.
    np.testing.assert_allclose(tangents_of(after), tangents_of(sound), atol=1e-6 if degrees < 80 else 1e-5)
    others = np.arange(len(tangents_of(sound))) != VERTEX
    assert (tangents_of(after)[others] == tangents_of(sound)[others]).all()
    bake(SOURCE, tmp_path / "sound.glb")
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        expected = read(tmp_path / "sound.glb").attribute(name)
        np.testing.assert_allclose(after.attribute(name), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("tangent", "fault"),
    [
        ([0, 0, 0, 1], "TANGENT has no direction"),
        ([1, 0, 0, 0], "w of TANGENT is neither 1 nor −1"),
        ([np.nan, 0, 0, 1], "TANGENT is not finite (x is NaN)"),
        ([1, 0, 0, np.inf], "TANGENT is not finite (w is infinite)"),
        ([3e38, 3e38, 3e38, -1], "TANGENT is not orthogonal to NORMAL"),
    ],
)
def test_a_tangent_without_a_meaning_becomes_a_sound_one(
    tangent: list[float], fault: str, tmp_path: Path
) -> None:
    path = with_tangents(SOURCE, tmp_path / "odd.glb", {VERTEX: np.array(tangent)})
    ((count, message),) = straightening(bake(path, tmp_path / "baked.glb"))
    assert count == 1
    assert message.startswith(f"at vertex {VERTEX} {fault}")
    after = read(tmp_path / "baked.glb")
    normals = frames.unit_normals(np.asarray(after.attribute("NORMAL")))
    assert frames.tangent_deviation(normals, tangents_of(after)).max() < 0.1
    assert verify_file(str(tmp_path / "baked.glb"), VerifyOptions(poses=PoseRequest(samples=1))).passed


@pytest.mark.parametrize("twin", [None, draco_twin, meshopt_twin])
def test_strip_brings_the_former_tangents_back(twin: object, tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    if callable(twin):
        path = twin(path, tmp_path / "twin.glb")
    assert straightening(bake(path, tmp_path / "baked.glb"))
    assert strip_file(str(tmp_path / "baked.glb"), str(tmp_path / "back.glb")).notices == ()
    assert (tmp_path / "back.glb").read_bytes() == path.read_bytes()
    again = bake(tmp_path / "baked.glb", tmp_path / "again.glb")
    assert straightening(again)
    assert (tmp_path / "again.glb").read_bytes() == (tmp_path / "baked.glb").read_bytes()


def test_former_tangents_are_found_under_another_number(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    bake(path, tmp_path / "baked.glb")
    for number in (0, 10_000, None):
        file = read(tmp_path / "baked.glb")
        file.primitive(0)["extras"]["skinbake"]["straightened"]["TANGENT"] = number
        strip_file(str(rewritten(file, tmp_path / "changed.glb")), str(tmp_path / "back.glb"))
        assert np.array_equal(tangents_of(read(tmp_path / "back.glb")), tangents_of(read(path)))


def test_an_accessor_number_with_a_point_means_the_same(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    file = read(path)
    attributes = file.primitive(0)["attributes"]
    attributes["TANGENT"] = float(attributes["TANGENT"])
    pointed = rewritten(file, tmp_path / "pointed.glb")
    assert f'"TANGENT":{attributes["TANGENT"]}'.encode() in pointed.read_bytes().replace(b" ", b"")
    results = [bake(source, tmp_path / f"baked_{source.name}") for source in (path, pointed)]
    assert straightening(results[0]) == straightening(results[1]) != []
    expected, found = (read(tmp_path / f"baked_{source.name}") for source in (path, pointed))
    assert (found.content, found.binary_chunk) == (expected.content, expected.binary_chunk)
    assert inspect_file(str(pointed)).primitives[0].frame == "tangent"
    strip_file(str(tmp_path / "baked_pointed.glb"), str(tmp_path / "back.glb"))
    assert read(tmp_path / "back.glb").content == read(path).content


def test_an_accessor_that_cannot_be_read_is_not_restored(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    bake(path, tmp_path / "baked.glb")
    file = read(tmp_path / "baked.glb")
    noted = file.primitive(0)["extras"]["skinbake"]["straightened"]
    del noted["digest"]
    file.content["accessors"][noted["TANGENT"]]["count"] = 10**6
    broken = rewritten(file, tmp_path / "broken.glb")
    result = strip_file(str(broken), str(tmp_path / "stripped.glb"))
    assert [notice.code for notice in result.notices] == ["tangents-kept", "bytes-left"]
    kept, now = (
        read(one).primitive(0)["attributes"]["TANGENT"] for one in (broken, tmp_path / "stripped.glb")
    )
    assert now == kept


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tangents", "influences"])
@pytest.mark.parametrize("twin", [None, draco_twin])
@pytest.mark.parametrize("renumbered", [False, True])
def test_memory_that_is_refused_is_no_reason_to_keep_the_bake(
    renumbered: bool, twin: object, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever the limit is reached: strip fails, or it does what it does without a limit."""
    path = FOLDER / "foreign_joints.glb"
    if kind == "tangents":
        path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    if callable(twin):
        path = twin(path, tmp_path / "twin.glb")
    bake(path, tmp_path / "baked.glb")
    file = read(tmp_path / "baked.glb")
    if renumbered:  # then all accessors are searched
        former = file.primitive(0)["extras"]["skinbake"]["straightened" if kind == "tangents" else "adopted"]
        former.update({name: 0 for name in former if name != "digest"})
    changed = rewritten(file, tmp_path / "changed.glb")
    document = read_document(str(changed))
    before = document.budget.taken.bytes
    whole, _ = stripped(document)
    told = list(document.notices)
    assert told == [] or (renumbered and callable(twin)), "accessors of streams are not searched"
    spent, refused = document.budget.taken.bytes, 0
    assert spent > before
    for limit in np.linspace(before, spent, 30).astype(int):
        monkeypatch.setattr(budget, "MEMORY", budget.Limit(0, int(limit)))
        document = read_document(str(changed))
        try:
            found, _ = stripped(document)
        except InputError as error:
            refused += 1
            assert "would take" in str(error)
        else:
            assert (found.json, list(document.notices)) == (whole.json, told)
    assert 20 < refused < 30


@pytest.mark.parametrize("change", [{"digest": None}, {"digest": 7}, {"straightened": 7}])
def test_a_broken_note_restores_no_tangents(change: JsonObject, tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    bake(path, tmp_path / "baked.glb")
    file = read(tmp_path / "baked.glb")
    file.primitive(0)["extras"]["skinbake"] |= change
    broken = rewritten(file, tmp_path / "broken.glb")
    result = strip_file(str(broken), str(tmp_path / "stripped.glb"))
    assert "tangents-kept" in [notice.code for notice in result.notices]
    assert np.array_equal(tangents_of(read(tmp_path / "stripped.glb")), tangents_of(file))


def test_quantised_tangents_are_left_as_they_are(tmp_path: Path) -> None:
    """Only FLOAT tangents are straightened. KHR_mesh_quantization has others."""
    file = read(leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX]))
    content, data = file.content, file.binary_chunk or b""
    shorts = np.rint(32767 * tangents_of(file)).astype("<i2")
    content["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": shorts.nbytes})
    view = len(content["bufferViews"]) - 1
    content["accessors"].append(
        {"bufferView": view, "componentType": 5122, "normalized": True, "type": "VEC4", "count": len(shorts)}
    )
    file.primitive(0)["attributes"]["TANGENT"] = len(content["accessors"]) - 1
    content["buffers"][0]["byteLength"] = len(data) + shorts.nbytes
    content["extensionsUsed"] = content["extensionsRequired"] = ["KHR_mesh_quantization"]
    path = rewritten(GltfFile(file.path, content, data + shorts.tobytes()), tmp_path / "shorts.glb")
    result = bake(path, tmp_path / "baked.glb")
    assert straightening(result) == []
    assert np.array_equal(read(tmp_path / "baked.glb").stored_attribute("TANGENT", 0, 0), shorts)


def test_edited_tangents_stay_and_it_is_said(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    bake(path, tmp_path / "baked.glb")
    edit = tangents_of(read(tmp_path / "baked.glb"))[0] * [1, 1, 1, -1]
    with_tangents(tmp_path / "baked.glb", tmp_path / "edited.glb", {0: edit})
    result = strip_file(str(tmp_path / "edited.glb"), str(tmp_path / "back.glb"))
    assert "tangents-kept" in [notice.code for notice in result.notices]
    assert (tangents_of(read(tmp_path / "back.glb"))[0] == edit.astype(np.float32)).all()


def test_where_many_lean_the_frame_is_that_of_the_normals(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [70, 71])  # of 198: one is a slip, 1 % are more
    result = bake(path, tmp_path / "baked.glb")
    assert [notice.code for notice in result.notices] == ["tangents-skewed"]
    after = read(tmp_path / "baked.glb")
    assert (note(after.content) or {})["frame"] == "normal"
    assert (tangents_of(after) == tangents_of(read(path))).all()
    assert inspect_file(str(path)).primitives[0].frame == "normal"


def test_the_normal_frame_leaves_tangents_alone(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    result = bake(path, tmp_path / "baked.glb", settings=bake_settings(frame=FrameChoice.NORMAL))
    assert result.notices == ()
    assert (tangents_of(read(tmp_path / "baked.glb")) == tangents_of(read(path))).all()


def test_inspect_tells_the_frame_that_bake_takes(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    assert inspect_file(str(path)).primitives[0].frame == "tangent"


@pytest.mark.slow
def test_the_validator_finds_nothing_new(tmp_path: Path) -> None:
    path = leaning(SOURCE, tmp_path / "skewed.glb", 10.0, [VERTEX])
    bake(path, tmp_path / "baked.glb")
    assert not new_findings(validate(path), validate(tmp_path / "baked.glb"))


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [1.0, 10.0, 60.0])
def test_a_character_is_lit_as_if_its_tangent_were_sound(degrees: float, tmp_path: Path) -> None:
    source = character("Butterfly/animated_butterfly.glb")
    options = VerifyOptions(methods=(), poses=PoseRequest(samples=3))
    bake(source, tmp_path / "sound.glb")
    bake(leaning(source, tmp_path / "skewed.glb", degrees, [2396]), tmp_path / "baked.glb")
    means = []
    for path in ("sound.glb", "baked.glb"):
        verdict = verify_file(str(tmp_path / path), options)
        assert verdict.passed
        means.append(verdict.by_truth[Truth.TANGENTS]["lbs"]["accurate"].mean)
    assert means[1] == pytest.approx(means[0], abs=1e-6)


def handed(source: Path, target: Path, values: dict[int, float]) -> Path:
    """Copy a GLB with other w of TANGENT at some vertices of its first primitive."""
    tangents = tangents_of(read(source))
    change = {vertex: np.array([*tangents[vertex, :3], w]) for vertex, w in values.items()}
    return with_tangents(source, target, change)


@pytest.mark.parametrize("w", [0.0, 0.5, -2.0])
def test_a_handedness_that_is_none_is_told_as_that(w: float, tmp_path: Path) -> None:
    path = handed(SOURCE, tmp_path / "odd.glb", {VERTEX: w})
    ((count, message),) = straightening(bake(path, tmp_path / "baked.glb"))
    assert (count, message) == (
        1,
        f"at vertex {VERTEX} w of TANGENT is neither 1 nor −1: the output has w = 1 there, and strip "
        "restores the former; --frame normal leaves it",
    )


@pytest.mark.slow
@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (np.inf, "infinite"), (-np.inf, "infinite")])
@pytest.mark.parametrize("component", range(4))
def test_the_component_of_a_tangent_that_is_not_finite_is_named(
    component: int, value: float, word: str, tmp_path: Path
) -> None:
    path = large(tmp_path / "large.glb")
    broken = np.array([1.0, 0.0, 0.0, 1.0])
    broken[component] = value
    found = f"{'xyzw'[component]} is {word}"

    def messages(vertices: list[int], **others: float) -> list[str]:
        change = dict.fromkeys(vertices, broken) | {
            int(name[1:]): np.array([1.0, 0.0, 0.0, w]) for name, w in others.items()
        }
        source = with_tangents(path, tmp_path / "broken.glb", change)
        notices = bake(source, tmp_path / "baked.glb").notices
        return [one.message.split(": ")[0] for one in notices if one.code.startswith("tangents-")]

    assert messages([5]) == [f"at vertex 5 TANGENT is not finite ({found})"]
    assert messages([7, 8, 9]) == [f"at 3 vertices TANGENT is not finite (first at vertex 7, where {found})"]
    assert messages([7], v3=0.5) == [
        f"at vertex 7 TANGENT is not finite ({found}), and at vertex 3 w of TANGENT is neither 1 nor −1"
    ]
    many = list(range(40, 60))
    told = f"not finite at 20 vertices, first at vertex 40, where {found}"
    assert messages(many) == [f"at 20 vertices TANGENT is {told}"]
    assert messages(many, v3=0.5) == [
        "at 21 vertices TANGENT is not finite, w of TANGENT is neither 1 nor −1, or it leans more than 0.1° "
        f"from NORMAL ({told})"
    ]


def test_tangents_that_lean_and_those_without_a_handedness_are_counted_apart(tmp_path: Path) -> None:
    path = large(tmp_path / "large.glb")
    path = leaning(path, tmp_path / "skewed.glb", 10.0, [3, 8])
    path = handed(path, tmp_path / "both.glb", {5: 0.0, 11: 0.0, 8: 0.0})
    ((count, message),) = straightening(bake(path, tmp_path / "baked.glb"))
    assert (count, message) == (
        4,
        "at vertex 3 TANGENT is not orthogonal to NORMAL (10° off), and at 3 vertices, first at vertex 5, w "
        "of TANGENT is neither 1 nor −1: the output has an orthogonal one with w = 1 or −1 there, and strip "
        "restores the former; --frame normal leaves it",
    )


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (2, "at 2 vertices, first at vertex 0, TANGENT has no direction, or is not orthogonal to NORMAL"),
        (
            20,
            "at 20 vertices TANGENT has no direction, or TANGENT × bitangent leans more than 0.1° from "
            "NORMAL",
        ),
    ],
)
def test_tangents_without_a_direction_are_told_as_that(count: int, words: str, tmp_path: Path) -> None:
    path = large(tmp_path / "large.glb")
    path = with_tangents(path, tmp_path / "odd.glb", dict.fromkeys(range(count), np.array([0, 0, 0, 1])))
    [notice] = bake(path, tmp_path / "baked.glb").notices
    assert notice.message.split(":")[0] == words


def large(path: Path) -> Path:
    """Write a flat sheet of 900 vertices with tangents along x."""
    x, y, triangles = builder.grid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 30))
    joints, weights = make_fixtures.influences(make_fixtures.sheet_weights(x, y, 2))
    attributes: dict[str, np.ndarray] = {
        "POSITION": np.stack([x, y, 0 * x], axis=1).astype(np.float32),
        "NORMAL": np.tile(np.array([0, 0, 1], np.float32), (len(x), 1)),
        "TANGENT": np.tile(np.array([1, 0, 0, 1], np.float32), (len(x), 1)),
        "JOINTS_0": joints.astype(np.uint8),
        "WEIGHTS_0": weights.astype(np.float32),
    }
    return write_model(path, [Part(attributes, triangles)])


@pytest.mark.parametrize(
    ("unhanded", "leans", "words"),
    [
        (20, 0, "at 20 vertices w of TANGENT is neither 1 nor −1: the frame is taken from NORMAL instead"),
        (
            20,
            3,
            "at 23 vertices TANGENT × bitangent leans more than 0.1° from NORMAL (up to 180°; at 20 of them "
            "because w of TANGENT is neither 1 nor −1): the frame is taken from NORMAL instead",
        ),
        (
            0,
            20,
            "at 20 vertices TANGENT × bitangent leans more than 0.1° from NORMAL (up to 10°): the frame is "
            "taken from NORMAL instead",
        ),
    ],
)
def test_many_tangents_without_a_handedness_are_told_apart_too(
    unhanded: int, leans: int, words: str, tmp_path: Path
) -> None:
    path = leaning(large(tmp_path / "large.glb"), tmp_path / "skewed.glb", 10.0, list(range(leans)))
    path = handed(path, tmp_path / "both.glb", dict.fromkeys(range(leans, leans + unhanded), 0.0))
    result = bake(path, tmp_path / "baked.glb")
    assert [(one.message, one.count) for one in result.notices if one.code == "tangents-skewed"] == [
        (words, unhanded + leans)
    ]
