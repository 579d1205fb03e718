"""The npm package in Babylon.js, in a browser: normals of real draws against the replay.

The normals are the varying that Babylon.js's own programs hand to fragment shaders: under WebGL 2 by
transform feedback, under WebGPU, which runs on SwiftShader, by drawing each vertex into a pixel of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Encoding, Layout, Scheme
from skinbake.format.encodings import GradientFormat
from skinbake.skinning.rest import Algorithm
from tests.babylon.stage import DEGREES, expected, opened_stage
from tests.support import corpus, gltf_reading
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import (
    Array,
    Character,
    Placement,
    Pose,
    angles,
    baked,
    by_numbers,
    unit,
    with_scaled_joints,
)
from tests.support.mapped import TEXELS, columns, texel_normal
from tests.support.replay import replay
from tests.support.stage import Stage, require_backend
from tests.support.told_of_files import Drawn, FilesToldOf
from tests.three.drawn import BENT, MIRRORED, RANDOM, TUBE, largest, turn_rest, vectors, with_morphs

pytestmark = pytest.mark.slow

TWO_SETS = FOLDER / "two_sets.glb"
PACKED = GradientFormat(Encoding.PACKED8)
TEXCOORD = GradientFormat(layout=Layout.TEXCOORD)
CHARACTERS = [
    pytest.param("CesiumMan/CesiumMan.glb", Pose(0, 0.6), id="CesiumMan"),
    pytest.param("RiggedFigure/RiggedFigure.gltf", Pose(0, 0.7), id="RiggedFigure"),
    pytest.param("RiggedElf/RiggedElf.gltf", Pose(0, 0.5), id="RiggedElf"),
]
VIEWS = [
    (TUBE, BENT, "normal", False, "webgl"),
    (TUBE, BENT, "normal", True, "webgl"),
    (MIRRORED, RANDOM, "normal", True, "webgl"),
    (MIRRORED, RANDOM, "tangent", False, "webgl"),
    (MIRRORED, RANDOM, "tangent", True, "webgl"),
    (TUBE, BENT, "normal", True, "webgpu"),
    (MIRRORED, RANDOM, "tangent", False, "webgpu"),
]
BACKENDS = ["webgl", "webgpu"]
RIGHT = [["accurate", ""]]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with opened_stage(tmp_path_factory.mktemp("babylon")) as stage:
        yield stage


def worst(drawn: str, wanted: Array) -> float:
    """Return the largest angle; under WebGPU a buffer may hold more vertices than the mesh has."""
    normals = vectors(drawn)[: len(wanted)]
    assert len(normals) > 0.9 * len(wanted)
    return float(angles(normals, wanted[: len(normals)]).max())


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("model", "pose"), CHARACTERS)
def test_every_normal_is_that_of_the_replay(stage: Stage, model: str, pose: Pose, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(corpus.character(model), pose, storage=PACKED)
    found = stage.normals(character, backend=backend)
    (drawn,) = found["draws"]
    assert worst(drawn, expected(character)) < DEGREES
    assert found["report"] == RIGHT
    standard = expected(character, Algorithm.LBS_STANDARD)
    drawn_normals = vectors(drawn)[: len(standard)]
    assert np.percentile(angles(drawn_normals, standard[: len(drawn_normals)]), 99) > 100 * DEGREES


@pytest.mark.parametrize(("source", "pose", "frame", "left", "backend"), VIEWS)
def test_normals_are_right_in_both_frames_and_both_handednesses(
    stage: Stage, source: Path, pose: Pose, frame: str, left: bool, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(source, pose, frame)
    found = stage.normals(character, left=left, backend=backend, material="standard")
    assert worst(found["draws"][0], expected(character, left=left)) < DEGREES
    assert found["report"] == RIGHT


@pytest.mark.parametrize(
    ("source", "storage"),
    [
        (TUBE, GradientFormat(Encoding.SNORM16)),
        (TUBE, TEXCOORD),
        (TUBE, GradientFormat(Encoding.PACKED8, Layout.CUSTOM)),
        (TWO_SETS, GradientFormat()),
        (TWO_SETS, TEXCOORD),
        (TWO_SETS, GradientFormat(Encoding.SNORM16, Layout.CUSTOM)),
    ],
)
def test_encodings_and_layouts(stage: Stage, source: Path, storage: GradientFormat) -> None:
    """The others are those of the tests above and below; ``TWO_SETS`` has eight influences."""
    character = stage.character(source, BENT if source == TUBE else RANDOM, storage=storage)
    found = stage.normals(character, material="standard")
    assert largest(found["draws"][0], expected(character)) < DEGREES
    assert found["report"] == RIGHT


@pytest.mark.parametrize("storage", [GradientFormat(), PACKED, TEXCOORD], ids=["float32", "packed8", "pairs"])
@pytest.mark.parametrize("scheme", [Scheme.DRACO, Scheme.MESHOPT])
def test_a_compressed_bake(stage: Stage, storage: GradientFormat, scheme: Scheme) -> None:
    """Draco compresses floats. ``bake`` leaves the integers of an encoding beside them."""
    character = stage.character(TUBE, BENT, storage=storage)
    path = stage.models / f"{scheme}-{character.path.name}"
    bake_file(TUBE, path, compress=scheme, storage=storage)
    url = {"url": f"/models/{path.name}"}
    found = stage.call("normals", {**character.told(Placement()), **url, "material": "standard"})
    assert worst(found["draws"][0], expected(character)) < DEGREES
    assert found["report"] == RIGHT


def test_a_geometry_buffer_has_standard_normals_and_that_is_said(stage: Stage) -> None:
    report = stage.page.call("buffered", stage.character(TUBE, BENT).told(Placement()))
    assert report == RIGHT
    (said,) = stage.messages()
    assert said.startswith(
        'skinbake: "buffered" has Babylon.js\'s standard lighting in its geometry buffer: '
    )


@pytest.mark.parametrize("how", [False, True], ids=["MergeMeshes", "MergeMeshesAsync"])
def test_a_merged_mesh_has_lost_its_bake_and_that_is_said_and_reported(stage: Stage, how: bool) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    report = stage.page.call("merged", {**told, "isAsync": how})
    reason = "MergeMeshes() keeps no alpha and beta: merge its parts in a tool before the bake"
    assert report == [["standard", reason]]
    (said,) = stage.messages()
    assert said.endswith(f"_merged\" has Babylon.js's standard lighting: {reason}")


def test_merging_meshes_without_a_bake_is_not_told_of(stage: Stage) -> None:
    (stage.models / TUBE.name).write_bytes(TUBE.read_bytes())
    told = stage.character(TUBE, BENT).told(Placement())
    assert stage.call("merged", {**told, "url": f"/models/{TUBE.name}"}) == []


def test_what_is_exported_without_its_bake_is_told_of_once(tmp_path: Path) -> None:
    with opened_stage(tmp_path, "exporting.mjs", "@babylonjs/serializers") as stage:
        told = stage.character(TUBE, BENT).told(Placement())
        drawn = stage.call("exported", {**told, "times": 0})
        assert drawn == {"names": [], "report": RIGHT}
        found = stage.page.call("exported", {**told, "times": 2})
    assert "WEIGHTS_0" in found["names"]
    assert [name for name in found["names"] if "SKINBAKE" in name.upper()] == []
    reason = "GLTF2Export leaves them out. Keep the baked file, or bake the exported one"
    assert stage.messages() == [f'skinbake: "exported" has no alpha and beta where it is exported: {reason}']


def test_eight_influences_under_webgpu(stage: Stage) -> None:
    require_backend(stage, "webgpu")
    character = stage.character(TWO_SETS, RANDOM, storage=PACKED)
    found = stage.normals(character, material="standard", backend="webgpu")
    assert worst(found["draws"][0], expected(character)) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
def test_joints_may_come_from_uniforms(stage: Stage, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT, storage=PACKED)
    found = stage.normals(character, bones="uniforms", material="standard", backend=backend)
    assert worst(found["draws"][0], expected(character)) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", ["rigid", "scaled", "eight influences", "mirrored"])
def test_dual_quaternions_move_normals_and_positions(stage: Stage, kind: str, backend: str) -> None:
    require_backend(stage, backend)
    if kind == "mirrored":
        character = stage.character(corpus.model("AFrameHands/leftHandLow.glb"), Pose(0, 0.05))
    elif kind == "eight influences":
        character = stage.character(TWO_SETS, RANDOM, storage=PACKED)
    elif kind == "scaled":
        character = stage.character(with_scaled_joints(stage.models, TUBE), BENT)
    else:
        character = stage.character(MIRRORED, RANDOM, "tangent")
    options = {"method": "dqs", "backend": backend}
    found = stage.normals(character, material="standard", **options)
    wanted = expected(character, Algorithm.DQS_EXACT)
    assert worst(found["draws"][0], -wanted if kind == "mirrored" else wanted) < DEGREES
    # Another material, because a program hands on one varying.
    (positions,) = stage.normals(character, varying="vPositionW", **options)["draws"]
    posed = replay(Algorithm.DQS_EXACT, character.rest, character.matrices(Placement())[None]).positions[0]
    used = character.rest.weights.sum(axis=1) > 0
    drawn = vectors(positions)[: len(posed)]
    assert np.abs(drawn - posed)[used[: len(drawn)]].max() < 1e-5 * np.ptp(posed)
    # The hand hardly bends.
    assert angles(wanted, expected(character)).max() > (1 if kind == "mirrored" else 100) * DEGREES
    assert found["report"] == RIGHT


def test_joints_that_mirror_keep_normals_on_babylon_s_side(stage: Stage) -> None:
    character = stage.character(corpus.model("AFrameHands/leftHandLow.glb"), Pose(0, 0.05))
    found = stage.normals(character)
    assert (np.linalg.det(character.matrices(Placement())[:, :3, :3]) < 0).all()
    assert largest(found["draws"][0], -expected(character)) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_morph_targets_come_before_skinning(stage: Stage, frame: str, backend: str) -> None:
    require_backend(stage, backend)
    path = baked(with_morphs(stage.models, MIRRORED), stage.models, frame)
    character = Character(path, RANDOM, (0.7, -0.4))
    found = stage.normals(character, backend=backend, material="standard")
    assert worst(found["draws"][0], expected(character)) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_the_differential_move_the_frame(
    stage: Stage, numbers: int, frame: str, backend: str
) -> None:
    """docs/reference/frame.md, *Morph targets*, by four and by six numbers."""
    require_backend(stage, backend)
    character, by_rule, clear = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, numbers, frame)
    wanted = expected(character)
    assert angles(wanted, expected(by_rule)).max() > 100 * DEGREES
    found = stage.normals(character, backend=backend, material="standard")
    drawn = vectors(found["draws"][0])
    clear = clear[: len(drawn)]
    assert angles(drawn[clear], wanted[: len(drawn)][clear]).max() < DEGREES


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("targets in attributes", "Babylon.js keeps its targets in attributes, not in a texture"),
        (
            "targets in another order",
            "a page has added or removed targets, and the numbers are for those of the file",
        ),
    ],
)
def test_numbers_that_do_not_belong_to_the_targets_leave_the_normal_and_a_message(
    stage: Stage, change: str, reason: str
) -> None:
    _, by_rule, _ = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, 4, "normal")
    told = {**by_rule.told(Placement()), "material": "standard", "change": change}
    found = stage.page.call("normals", told)
    assert worst(found["draws"][0], expected(by_rule)) < DEGREES
    (message,) = stage.page.messages()
    assert message.endswith(f" has a frame that follows NORMAL or TANGENT under morph targets: {reason}")


def test_a_copy_of_the_targets_keeps_their_numbers(stage: Stage) -> None:
    character, *_ = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, 6, "normal")
    found = stage.normals(character, material="standard", change="clone")
    assert worst(found["draws"][0], expected(character)) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
def test_morph_targets_with_tangents_turn_the_tangent_frame(stage: Stage, backend: str) -> None:
    """docs/reference/frame.md, *Morph targets*, by TANGENT."""
    require_backend(stage, backend)
    weights = (0.7, -0.4)
    path = baked(with_morphed_tangents(stage.models, MIRRORED), stage.models, "tangent")
    character = Character(path, RANDOM, weights)
    file = gltf_reading.read(path)
    stored = file.attribute("TANGENT")
    targets = file.primitive(0)["targets"]
    moved = stored[:, :3] + sum(
        weight * file.values(target["TANGENT"]) for weight, target in zip(weights, targets, strict=True)
    )
    n, n0 = character.rest.normals, Character(path, RANDOM).rest.normals
    along = np.einsum("vi,vi->v", n, moved) - np.einsum("vi,vi->v", n0, stored[:, :3])
    tangents = moved - n * along[:, None]
    bitangents = np.cross(n, tangents) * stored[:, 3:]
    by_normal = expected(character)
    character.rest = dataclasses.replace(character.rest, tangents=tangents, bitangents=bitangents)
    wanted = expected(character)
    assert angles(wanted, by_normal).max() > 100 * DEGREES
    found = stage.normals(character, backend=backend, material="standard")
    assert worst(found["draws"][0], wanted) < DEGREES


@pytest.mark.parametrize("material", ["pbr", "standard", "openpbr"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_page_may_turn_normals_before_babylon_skins_them(stage: Stage, material: str, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, backend=backend, material=material, turned=True)
    plain = expected(character)
    turn_rest(character, (0.5, 0.25, -0.5))
    assert angles(expected(character), plain).max() > 1000 * DEGREES
    assert worst(found["draws"][0], expected(character)) < DEGREES
    assert found["report"] == RIGHT


def with_morphed_tangents(folder: Path, source: Path) -> Path:
    """Add TANGENT to the targets of ``with_morphs``: they turn and stretch it."""
    target = folder / f"{source.stem}-morphed-tangents.glb"
    if target.exists():
        return target
    file = Editable(with_morphs(folder, source))
    tangents, positions = file.array("TANGENT").copy(), file.array("POSITION").copy()
    for one, frequency in zip(file.primitive()["targets"], (7.0, 3.0), strict=True):
        wave = np.sin(frequency * positions[:, [1]])
        one["TANGENT"] = file.add((np.roll(tangents[:, :3], 1, axis=1) * wave).astype(np.float32))
    return file.write(target)


@pytest.mark.parametrize(
    ("frame", "left", "backend", "material"),
    [
        ("normal", False, "webgl", "standard"),
        ("tangent", True, "webgl", "standard"),
        ("normal", True, "webgpu", "standard"),
        ("tangent", False, "webgpu", "standard"),
        ("normal", False, "webgl", "openpbr"),
        ("tangent", False, "webgpu", "openpbr"),
    ],
)
def test_normal_maps_have_the_matrix_of_a_relief(
    stage: Stage, frame: str, left: bool, backend: str, material: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.normals(character, left=left, bump=True, material=material, backend=backend)
    assert_matrix_of_a_relief(found, character, left, backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_the_differential_carry_the_relief_along(
    stage: Stage, numbers: int, frame: str, backend: str
) -> None:
    require_backend(stage, backend)
    source = with_morphs(stage.models, MIRRORED)
    character, *_ = by_numbers(source, stage.models, numbers, frame, (0.1, -0.1))
    found = stage.normals(character, bump=True, material="standard", backend=backend)
    assert_matrix_of_a_relief(found, character, False, backend)


def assert_matrix_of_a_relief(found: Any, character: Character, left: bool, backend: str) -> None:
    right = columns(character, Algorithm.LBS_ACCURATE, Placement())
    size = np.linalg.norm(right.n, axis=1, keepdims=True)
    wanted = [part / size * ((-1, 1, 1) if left else 1) for part in (right.t, right.b, right.n)]
    assert character.tangents is not None
    assert (character.tangents[:, 3] < 0).any()
    if backend == "webgl":
        (drawn,) = found["draws"]
        matrices = vectors(drawn).reshape(-1, 3, 3).transpose(1, 0, 2)
    else:
        matrices = np.array([vectors(drawn)[: len(right.n)] for drawn in found["draws"]])
    for found_column, one in zip(matrices, wanted, strict=True):
        assert angles(found_column, one[: len(found_column)]).max() < DEGREES
        np.testing.assert_allclose(
            np.linalg.norm(found_column, axis=1), np.linalg.norm(one[: len(found_column)], axis=1), rtol=1e-4
        )


@pytest.mark.parametrize("texel", TEXELS[:2])
@pytest.mark.parametrize(
    ("frame", "left", "material"),
    [
        ("normal", False, "standard"),
        ("tangent", True, "standard"),
        ("tangent", False, "pbr"),
        ("normal", False, "openpbr"),
    ],
)
def test_a_relief_has_the_mapped_normals_of_the_replay(
    stage: Stage, frame: str, left: bool, material: str, texel: tuple[int, ...]
) -> None:
    """At the pixel of each vertex, as its fragment shader has them. The left-handed world is a mirror."""
    character = stage.character(MIRRORED, RANDOM, frame)
    options = {"left": left, "material": material, "texel": texel}
    found = stage.call("relief", {**character.told(Placement()), **options})
    relief, (x, y, z) = columns(character, Algorithm.LBS_ACCURATE, Placement()), texel_normal(texel)
    wanted = (x * relief.t + y * relief.b + z * relief.n) * ((-1, 1, 1) if left else 1)
    drawn = vectors(found["normals"])
    assert angles(drawn, wanted[: len(drawn)]).max() < 0.2
    assert found["report"] == RIGHT


@pytest.mark.parametrize("kind", ["instances", "thin instances"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_instances_of_any_shape(stage: Stage, kind: str, backend: str) -> None:
    """One turns, one stretches and mirrors."""
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT, storage=PACKED)
    options = {**character.told(Placement()), "kind": kind, "backend": backend, "material": "standard"}
    found = stage.call("many", options)
    assert found["report"] == RIGHT
    rest = expected(character)
    places = [np.array(place).reshape(4, 4).T[:3, :3] for place in found["places"]]
    wanted = [unit(rest @ np.linalg.inv(place)) for place in places]
    if backend == "webgl":
        draws = np.concatenate([vectors(drawn).reshape(-1, len(rest), 3) for drawn in found["draws"]])
    else:
        draws = np.array([vectors(drawn)[: len(rest)] for drawn in found["draws"]])
    assert len(draws) == len(places)
    errors = [[angles(one, normals[: len(one)]).max() for one in draws] for normals in wanted]
    assert (np.min(errors, axis=1) < DEGREES).all()


def test_whatever_a_page_does_the_normals_stay_right(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("changed", character.told(Placement()))
    wanted = expected(character)
    errors = {name: [largest(drawn, wanted) for drawn in one["draws"]] for name, one in found.items()}
    assert {name: len(each) == 1 and each[0] < DEGREES for name, each in errors.items()} == dict.fromkeys(
        found, True
    )
    assert {name: one["report"] for name, one in found.items()} == dict.fromkeys(found, RIGHT)


CHANGED = "a page has changed or removed its {}: its bake is for the old values"


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_whose_attributes_a_page_alters_has_standard_normals(stage: Stage, backend: str) -> None:
    """α and β are for the arrays of the file. The same values in another buffer do no harm."""
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, "tangent")
    found = stage.page.call("altered", {**character.told(Placement()), "backend": backend})
    altered = {
        "normals flattened": "NORMAL",
        "normals in place": "NORMAL",
        "a buffer of normals in place": "NORMAL",
        "positions stretched": "POSITION",
        "other weights": "WEIGHTS_0",
        "tangents replaced": "TANGENT",
        "tangents removed": "TANGENT",
        "beta removed": "skinbakeBeta0",
    }
    reasons = {name: CHANGED.format(kind) for name, kind in altered.items()}
    wanted = {name: [["standard", reason]] for name, reason in reasons.items()}
    unaltered = ["weights cleaned", "normals as they were", "arrays freed", "processor and back"]
    wanted |= dict.fromkeys(unaltered, RIGHT)
    assert {name: one["report"] for name, one in found.items()} == wanted
    said = "\n".join(stage.messages())
    assert [reason for reason in reasons.values() if reason not in said] == []
    standard = dict.fromkeys(found, expected(character, Algorithm.LBS_STANDARD))
    right = standard | dict.fromkeys(unaltered, expected(character))
    right |= dict.fromkeys(
        ["normals in place", "a buffer of normals in place"], -standard["normals in place"]
    )
    del right["other weights"]
    for name, normals in right.items():
        for drawn in found[name]["draws"]:
            assert angles(vectors(drawn), normals[: len(vectors(drawn))]).max() < DEGREES, name


def test_arrays_are_not_read_back_while_a_mesh_is_switched(stage: Stage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    found = stage.page.call("written", told)
    assert found == {"read": 0, "report": [["standard", CHANGED.format("NORMAL")]]}
    assert len(stage.messages()) == 1


def test_roots_that_hold_no_meshes_are_refused_by_name(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("roots", character.told(Placement()))
    refused = ["nothing", "text", "a skeleton", "a list of nothing"]
    words = "TypeError: skinbake: the root is not a scene, a node"
    assert {name: found[name].startswith(words) for name in refused} == dict.fromkeys(refused, True)
    assert found["what a container returns"] == RIGHT
    assert found["a container"] == [["not drawn", "it has not been drawn yet"]]
    assert found["disposed"] == []


def test_a_render_target_may_have_its_own_material_for_a_mesh(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    draws = stage.call("rendered", character.told(Placement()))
    assert [largest(drawn, expected(character)) < DEGREES for drawn in draws] == [True, True]


def test_a_container_that_is_instantiated_twice(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("instantiated", character.told(Placement()))
    assert [largest(drawn, expected(character)) < DEGREES for drawn in found["draws"]] == [True, True]
    assert found["report"] == RIGHT * 2


@pytest.mark.parametrize(
    ("options", "report"),
    [({"plugin": False}, []), ({"lighting": "standard"}, [["standard", "lighting() has switched it"]])],
    ids=["unregistered", "switched"],
)
def test_standard_lighting_is_babylon_s_own(
    stage: Stage, options: dict[str, object], report: list[list[str]]
) -> None:
    """Else the tests above would not see it."""
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, **options)
    assert largest(found["draws"][0], expected(character, Algorithm.LBS_STANDARD)) < DEGREES
    assert found["report"] == report


@pytest.mark.parametrize("kind", ["frozen", "blocked in the scene", "blocked in the material"])
def test_lighting_switches_materials_that_babylon_does_not_look_at_again(stage: Stage, kind: str) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("switched", {**character.told(Placement()), "kind": kind})
    switched = [["standard", "lighting() has switched it"]]
    not_drawn = [["not drawn", "it has not been drawn yet"]]
    standard, accurate = found["standard"], found["accurate"]
    assert largest(standard["draws"][0], expected(character, Algorithm.LBS_STANDARD)) < DEGREES
    assert standard["report"] == switched
    assert largest(accurate["draws"][0], expected(character)) < DEGREES
    assert accurate["report"] == RIGHT
    assert [standard["before"], accurate["before"]] == [not_drawn, not_drawn]


def test_a_report_is_of_the_program_that_drew(stage: Stage) -> None:
    """Until the next frame, that is the one before ``lighting``."""
    character = stage.character(TUBE, BENT)
    found = stage.call("early", character.told(Placement()))
    assert found == {"before": RIGHT, "after": [["standard", "lighting() has switched it"]]}


def test_the_light_of_an_environment_sees_the_accurate_normals(stage: Stage) -> None:
    """Babylon.js computes it in the vertex shader, before a plugin can correct the normal."""
    character = stage.character(TUBE, BENT)
    told = character.told(Placement())
    with_module, without = (stage.call("irradiance", {**told, "plugin": one}) for one in (True, False))
    assert without["inVertex"]
    assert not with_module["inVertex"]
    assert largest(with_module["draws"][0], expected(character)) < DEGREES


def test_shadows_are_where_they_were(stage: Stage) -> None:
    """Linear blending moves the vertices in any case."""
    told = stage.character(TUBE, BENT).told(Placement())
    with_module, without = (stage.call("shadows", {**told, "plugin": one}) for one in (True, False))
    assert len(with_module) == 1
    assert with_module == without


STRANGERS = {
    "webgl": {
        "fewer influences": "its numBoneInfluencers is 2, and its bake is for 4",
        "processor": "the processor skins it (computeBonesUsingShaders)",
        "copied": "its geometry is a copy, and Babylon.js copies no attributes that it does not know",
        "no skeleton": "it has no skeleton",
        "crowded": "it needs 6 vertex attributes, and this device has 5",
        "old engine": "this module needs WebGL 2 or WebGPU",
        "baked animation": "a baked vertex animation moves it",
        "own shader": 'its ShaderMaterial "own" takes no material plugins',
    },
    "webgpu": {
        "crowded": "it needs 5 vertex buffers, and this device has 4",
        "pulled vertices": "its material pulls vertices",
    },
}


@pytest.mark.parametrize("backend", BACKENDS)
def test_meshes_that_stay_standard_are_told_of_once(stage: Stage, backend: str) -> None:
    require_backend(stage, backend)
    told = stage.character(TUBE, BENT).told(Placement())
    found = stage.page.call("strangers", {**told, "backend": backend})
    assert found == {name: [["standard", reason]] for name, reason in STRANGERS[backend].items()}
    assert stage.messages() == [
        f'skinbake: "{name}" has Babylon.js\'s standard lighting: {reason}'
        for name, reason in STRANGERS[backend].items()
    ]


def alpha(file: Editable) -> dict[str, Any]:
    """Return the accessor of α."""
    found: dict[str, Any] = file.content["accessors"][file.primitive()["attributes"]["_SKINBAKE_ALPHA_0"]]
    return found


DAMAGES: dict[str, Callable[[Editable, dict[str, Any]], object]] = {
    "its bake has version 2, and this module reads version 1: update it": lambda _, noted: noted.update(
        version=2
    ),
    "it has 12 influences for each vertex, and Babylon.js reads eight: "
    "bake it again with --limit-influences 8": lambda _, noted: noted.update(influences=12),
    "the metadata of its bake is damaged: bake it again": lambda _, noted: noted.pop("alpha"),
    "its frame is other, and this module knows normal and tangent: update it": lambda _, noted: noted.update(
        frame="other"
    ),
    "its encoding is other, and this module knows packed8 and snorm16: update it": (
        lambda _, noted: noted.update(encoding="other")
    ),
    "the metadata of its bake lacks the scale: bake it again": lambda _, noted: noted.pop("scale"),
    "it has lost the attribute TANGENT, which its bake needs: bake last": (
        lambda _, noted: noted.update(frame="tangent")
    ),
    "its attribute _SKINBAKE_BETA_0 is missing: bake last, or keep attributes as they are": (
        lambda file, _: file.primitive()["attributes"].pop("_SKINBAKE_BETA_0")
    ),
    "its attribute _SKINBAKE_ALPHA_0 is VEC3, not VEC4: bake last, or keep attributes as they are": (
        lambda file, _: file.primitive()["attributes"].update(
            _SKINBAKE_ALPHA_0=file.primitive()["attributes"]["POSITION"]
        )
    ),
    "its attribute _SKINBAKE_ALPHA_0 is not encoded as packed8: bake last, or keep attributes as they are": (
        lambda file, _: file.primitive()["attributes"].update(
            _SKINBAKE_ALPHA_0=file.primitive()["attributes"]["WEIGHTS_0"]
        )
    ),
    "its attribute _SKINBAKE_ALPHA_0 is VEC4, not VEC3: bake last, or keep attributes as they are": (
        lambda _, noted: noted.pop("encoding")
    ),
    "its attribute _SKINBAKE_ALPHA_0 is not of floats: bake last, or keep attributes as they are": (
        lambda file, noted: (noted.pop("encoding"), alpha(file).update(type="VEC3"))
    ),
    "it has lost the metadata of its bake: keep the extras of primitives, or bake last": (
        lambda file, _: file.primitive().pop("extras")
    ),
}


def test_what_has_happened_to_a_bake_is_told_when_it_is_loaded(stage: Stage) -> None:
    source = stage.character(TUBE, BENT, storage=PACKED).path
    urls = []
    for number, damage in enumerate(DAMAGES.values()):
        file = Editable(source)
        damage(file, file.primitive()["extras"]["skinbake"])
        urls.append(f"/models/{file.write(stage.models / f'damaged{number}.glb').name}")
    stage.page.call("loaded", {"urls": urls})
    (node,) = (node for node in file.content["nodes"] if "mesh" in node)
    assert stage.messages() == [
        f'skinbake: "{node["name"]}" has Babylon.js\'s standard lighting: {reason}' for reason in DAMAGES
    ]


def test_sparse_accessors_and_metadata_of_an_accessor_are_read(stage: Stage) -> None:
    """Where extras of the primitive are no object, bake writes into those of alpha's accessor."""
    file = Editable(TUBE)
    file.primitive()["extras"] = "ours"
    path = baked(file.write(stage.models / "spoken_for.glb"), stage.models, storage=PACKED)
    sparse = Editable(path)
    assert sparse.primitive()["extras"] == "ours"
    accessor = alpha(sparse)
    numbers = np.arange(accessor["count"], dtype=np.uint32).view(np.float32).reshape(-1, 2)
    indices = sparse.content["accessors"][sparse.add(numbers)]["bufferView"]
    values = {"bufferView": accessor.pop("bufferView"), "byteOffset": accessor.pop("byteOffset", 0)}
    accessor["sparse"] = {"count": accessor["count"], "values": values}
    accessor["sparse"]["indices"] = {"bufferView": indices, "componentType": 5125}
    sparse.write(stage.models / "sparse.glb")
    character = stage.character(TUBE, BENT, storage=PACKED)
    found = stage.call("normals", {**character.told(Placement()), "url": "/models/sparse.glb"})
    assert found["report"] == RIGHT
    assert largest(found["draws"][0], expected(character)) < DEGREES


class TestFiles(FilesToldOf):
    engine = "Babylon.js"

    def check(self, drawn: Drawn) -> None:
        assert worst(drawn.found["draws"][0], expected(drawn.character, drawn.lit)) < DEGREES
