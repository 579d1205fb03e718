"""The npm package in three.js, in a browser: normals of real draws against the replay, whatever a page does.

The normals are the varying that three.js's own programs hand to fragment shaders, by transform feedback.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import Encoding, Scheme
from skinbake.format.encodings import GradientFormat
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.support import corpus, gltf_reading, gltf_transform
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import (
    AS_USUAL,
    Array,
    Character,
    Placement,
    Pose,
    angles,
    baked,
    by_numbers,
)
from tests.support.node import package_folder, require_node
from tests.support.stage import opened_page, page_of
from tests.support.told_of_files import Drawn, FilesToldOf
from tests.three.drawn import (
    BENT,
    CHARACTERS,
    CLIP,
    DEGREES,
    MIRRORED,
    PARENTS,
    RANDOM,
    STORAGES,
    STRETCHED,
    TUBE,
    ThreeStage,
    check_cap,
    check_caps_apart,
    deviations_below,
    expected,
    largest,
    placed_by,
    rotation,
    scaled,
    shadow_is_of,
    turn_rest,
    vectors,
    with_morphs,
)
from tests.three.vrm import EXPRESSIONS, as_vrm

PAGE = page_of(
    "/tests/drawing.mjs",
    {
        "three": "/three/build/three.module.js",
        "three/addons/": "/three/examples/jsm/",
        "@pixiv/three-vrm": "/vrm/lib/three-vrm.module.js",
        "skinbake-three": "/package/index.js",
    },
    scripts=["/support/capture.js"],
)


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ThreeStage]:
    require_node("three", "@pixiv/three-vrm")
    folders = {"three": package_folder("three"), "vrm": package_folder("@pixiv/three-vrm")}
    folders |= {"tests": Path(__file__).resolve().parent, "package": engines_folder() / "three"}
    folder, arguments = tmp_path_factory.mktemp("package"), ["--js-flags=--expose-gc"]
    with opened_page(PAGE, folder, folders, arguments) as (page, models):
        yield ThreeStage(page, models)


@pytest.mark.parametrize(
    ("model", "fixture", "pose", "storage"),
    [
        pytest.param(*one.values, storage, id=f"{one.id} {storage.encoding} {storage.layout}")
        for number, one in enumerate(CHARACTERS)
        for storage in (STORAGES if number < 2 else STORAGES[:2])
    ],
)
def test_every_normal_is_that_of_the_replay(
    stage: ThreeStage, model: str | None, fixture: Path | None, pose: Pose, storage: GradientFormat
) -> None:
    character = stage.character(fixture or corpus.character(model or ""), pose, storage=storage)
    found = stage.normals(character)
    (drawn,) = found["draws"]
    wanted = expected(character, found["world"])
    assert largest(drawn, wanted) < DEGREES
    assert found["report"] == found["loaded"] == [["accurate", ""]]
    standard = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert np.percentile(angles(vectors(drawn), standard[: len(vectors(drawn))]), 99) > 100 * DEGREES


@pytest.mark.parametrize("storage", [AS_USUAL, GradientFormat(Encoding.PACKED8)], ids=["float32", "packed8"])
@pytest.mark.parametrize("scheme", [Scheme.DRACO, Scheme.MESHOPT])
def test_a_compressed_bake(stage: ThreeStage, storage: GradientFormat, scheme: Scheme) -> None:
    character = stage.character(TUBE, BENT, storage=storage)
    path = stage.models / f"{scheme}-{character.path.name}"
    bake_file(TUBE, path, compress=scheme, storage=storage)
    found = stage.normals(character, url=f"/models/{path.name}")
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_where_weights_jump_across_slivers_every_normal_is_that_of_the_replay(stage: ThreeStage) -> None:
    character = stage.character(corpus.model("RobotMantis/animated_robot_mantis.glb"), Pose(0, 0.4))
    found = stage.normals(character)
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


def test_three_vrm_loads_a_character_beside_the_plugin(stage: ThreeStage) -> None:
    character = stage.character(corpus.model("VRM/cryptovoxels.vrm"), RANDOM)
    found = stage.page.call("normals", {**character.told(Placement()), "vrm": True})
    # three-vrm warns of what this old file has.
    assert [line for line in stage.page.messages() if "skinbake" in line] == []
    wanted = expected(character, found["world"])
    assert found["draws"]
    assert max(largest(drawn, wanted) for drawn in found["draws"]) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("tools", [False, True], ids=["as loaded", "VRMUtils"])
@pytest.mark.parametrize("version", [0, 1])
def test_expressions_of_vrm_morph_before_skinning_under_mtoon(
    stage: ThreeStage, version: int, tools: bool
) -> None:
    """MToon draws the mesh twice: the second time its back sides, as the outline."""
    source = as_vrm(with_morphs(stage.models, TUBE), stage.models / f"tube{version}.vrm", version)
    weights = (0.7, 0.4)
    character = Character(baked(source, stage.models), BENT, weights)
    triangles = 500
    options = {"expressions": dict(zip(EXPRESSIONS, weights, strict=True)), "tools": tools}
    told = {name: value for name, value in character.told(Placement()).items() if name != "morphs"}
    found = stage.call("vrm", {**told, **options, "triangles": triangles})
    assert found["materials"] == [[True, False], [True, True]]
    assert found["report"] == [["accurate", ""]]
    wanted = expected(character, found["world"])
    if tools:
        wanted = wanted[np.unique(gltf_reading.read(source).triangles()[:triangles])]
    surface, outline = found["draws"]
    assert largest(surface, wanted) < DEGREES
    assert largest(outline, -wanted) < DEGREES


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_one_module_serves_both_frames(stage: ThreeStage, frame: str) -> None:
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.normals(character)
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


@pytest.mark.parametrize("when", ["before", "after"])
def test_tangents_of_a_frame_may_be_others_but_must_be_there(stage: ThreeStage, when: str) -> None:
    character = stage.character(MIRRORED, RANDOM, "tangent")
    anew = stage.normals(character, change="tangents anew", when=when)
    assert largest(anew["draws"][0], expected(character, anew["world"])) < DEGREES
    told = {**character.told(Placement()), "change": "no tangents", "when": when}
    without = stage.page.call("normals", told)
    wanted = expected(character, without["world"], Algorithm.LBS_STANDARD)
    assert largest(without["draws"][0], wanted) < DEGREES
    reason = "it has lost the attribute TANGENT, which its bake needs: bake last"
    assert without["report"] == [["standard", reason]]
    (message,) = stage.page.messages()
    assert message.endswith(f"has three.js's standard lighting: {reason}")


@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize(("numbers", "normals"), [(4, 2), (6, 0), (6, 1)])
def test_numbers_of_the_differential_move_the_frame(
    stage: ThreeStage, numbers: int, normals: int, frame: str, method: str
) -> None:
    """docs/reference/frame.md, *Morph targets*, by four and by six numbers; of six, one target has NORMAL."""
    source = with_morphs(stage.models, MIRRORED)
    character, by_rule, clear = by_numbers(source, stage.models, numbers, frame, normals=normals)
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    found = stage.normals(character, method=method)
    wanted = expected(character, found["world"], algorithm)
    assert angles(wanted, expected(by_rule, found["world"], algorithm)).max() > 100 * DEGREES
    drawn = vectors(found["draws"][0])
    clear = clear[: len(drawn)]
    assert angles(drawn[clear], wanted[: len(drawn)][clear]).max() < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("change", ["geometry.clone()", "another material", "material.clone()", "mtoon"])
def test_what_a_page_copies_keeps_the_numbers(stage: ThreeStage, change: str) -> None:
    character, *_ = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, 6, "normal")
    found = stage.normals(character, change=change, when="after")
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


@pytest.mark.parametrize(
    ("change", "plugin", "reason"),
    [
        (
            "targets in another order",
            True,
            "a page has changed its targets, and their numbers are for the old ones",
        ),
        (
            "toJSON()",
            True,
            "only SkinbakePlugin loads the numbers of its targets, and toJSON() leaves them out",
        ),
        (
            "applied twice",
            False,
            "only SkinbakePlugin loads the numbers of its targets, and toJSON() leaves them out",
        ),
    ],
)
def test_numbers_that_a_page_has_lost_leave_the_normal_and_a_message(
    stage: ThreeStage, change: str, plugin: bool, reason: str
) -> None:
    _, by_rule, _ = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, 4, "normal")
    told = {**by_rule.told(Placement()), "change": change, "plugin": plugin}
    found = stage.page.call("normals", told)
    assert largest(found["draws"][0], expected(by_rule, found["world"])) < DEGREES
    (message,) = stage.page.messages()
    assert message.endswith(f" has a frame that follows NORMAL under morph targets: {reason}")


def test_characters_that_share_a_material_have_their_own_numbers(stage: ThreeStage) -> None:
    source = with_morphs(stage.models, MIRRORED)
    four, six = (by_numbers(source, stage.models, numbers, "normal") for numbers in (4, 6))
    without = stage.character(source, RANDOM, "normal", morphs=(0.7, -0.4))
    characters = [four[0], six[0], without]
    told = [one.told(Placement()) for one in characters]
    draws = stage.call("together", {"characters": told})
    assert len(draws) == len(characters)
    for character, clear, drawn in zip(characters, (four[2], six[2], six[2]), draws, strict=True):
        wanted = expected(character, np.eye(4).ravel().tolist())
        found = vectors(drawn)
        assert angles(found, wanted[: len(found)])[clear[: len(found)]].max() < DEGREES


@pytest.mark.parametrize("change", ["nothing", "toJSON()"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_a_cap_limits_how_tangents_are_corrected(
    stage: ThreeStage, method: str, frame: str, change: str
) -> None:
    check_cap(stage, method, frame, change=change)


def test_characters_that_share_a_material_have_caps_of_their_own(stage: ThreeStage) -> None:
    check_caps_apart(stage)


@pytest.mark.parametrize("cap", [0, -1, 10000000, "much"])
def test_a_cap_that_limits_nothing_or_is_no_number_is_refused(stage: ThreeStage, cap: object) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    with pytest.raises(RuntimeError, match=f"skinbake: cap {cap} is not a number from 0.000001 to 1000000"):
        stage.call("normals", {**told, "cap": cap})


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_morph_targets_come_before_skinning(stage: ThreeStage, frame: str) -> None:
    path = baked(with_morphs(stage.models, MIRRORED), stage.models, frame)
    character = Character(path, RANDOM, (0.7, -0.4))
    found = stage.normals(character)
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


def test_a_file_that_gltf_transform_has_optimised_before_the_bake(stage: ThreeStage) -> None:
    small = stage.models / "small.glb"
    done = gltf_transform.run(["optimize", TUBE, small, "--compress", "false", "--simplify", "false"])
    assert done.returncode == 0, done.stderr
    character = stage.character(small, BENT)
    found = stage.normals(character)
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


@pytest.mark.parametrize(("model", "fixture", "pose"), [CHARACTERS[0], CHARACTERS[3], CHARACTERS[4]])
def test_dual_quaternions_have_algorithm_6(
    stage: ThreeStage, model: str | None, fixture: Path | None, pose: Pose
) -> None:
    character = stage.character(fixture or corpus.character(model or ""), pose)
    found = stage.normals(character, method="dqs")
    assert largest(found["draws"][0], expected(character, found["world"], Algorithm.DQS_EXACT)) < DEGREES


@pytest.mark.parametrize(("root", "other", "detached"), PARENTS)
def test_a_parent_moves_dual_quaternions_as_a_whole(
    stage: ThreeStage, root: Array, other: Array | None, detached: bool
) -> None:
    character = stage.character(TUBE, BENT)
    placed = placed_by(root, other, detached=detached)
    found = stage.call("parented", {**character.told(Placement()), **placed})
    before = np.array(found["world"]).reshape(4, 4).T if detached else np.eye(4)
    position, normal = deviations_below(character, found, before @ root)
    assert position < CLIP
    assert normal < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_joints_that_are_all_mirrored_have_dual_quaternions(stage: ThreeStage) -> None:
    character = stage.character(corpus.model("AFrameHands/leftHandLow.glb"), Pose(0, 0.05))
    placed = placed_by(np.eye(4), None, detached=False)
    found = stage.call("parented", {**character.told(Placement()), **placed})
    position, normal = deviations_below(character, found, np.eye(4), scaled(-1, 1, 1))
    assert position < CLIP
    assert normal < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_joints_that_are_not_rigid_are_drawn_as_three_js_does_and_told_of(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "method": "dqs"}
    found = stage.page.call("stretched", told)
    assert stage.messages() == [f'skinbake: "tube" has three.js\'s standard lighting: {STRETCHED}']
    plain, stretched, undone, again, hidden = found["found"]
    assert stretched["draws"] == plain["draws"]
    own = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert largest(undone["draws"][0], own) < DEGREES
    assert largest(again["draws"][0], expected(character, found["world"], Algorithm.DQS_EXACT)) < DEGREES
    reports = [one["report"] for one in (stretched, undone, again, hidden)]
    standard, accurate = [["standard", STRETCHED]], [["accurate", ""]]
    assert reports == [standard, standard, accurate, accurate]


@pytest.mark.parametrize("when", ["before", "after"])
def test_whatever_a_page_does_the_normals_stay_right(stage: ThreeStage, when: str) -> None:
    character = stage.character(TUBE, BENT)
    wrong = {}
    for change in stage.call("changes", {}):
        found = stage.normals(character, change=change, when=when)
        wanted = expected(character, found["world"])
        error = largest(found["draws"][-1], wanted) if found["draws"] else np.inf
        if error > DEGREES or found["report"] not in ([["accurate", ""]], [["not drawn", NOT_DRAWN]]):
            wrong[change] = (error, found["report"])
    assert wrong == {}


NOT_DRAWN = "it has not been drawn yet"


@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("copy", ["clone()", "copy()", "InstancedBufferGeometry"])
def test_a_copy_of_a_geometry_has_the_lighting_from_its_first_or_second_frame(
    stage: ThreeStage, copy: str, frame: str
) -> None:
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.call("copied", {**character.told(Placement()), "copy": copy})
    accurate = expected(character, found["world"])
    standard = expected(character, found["world"], Algorithm.LBS_STANDARD)
    first, second = found["frames"]
    assert largest(first, accurate if copy == "clone()" else standard) < DEGREES
    assert largest(second, accurate) < DEGREES
    assert found["reports"] == ["accurate" if copy == "copy()" else "not drawn", "accurate"]
    assert found["disposed"] == ["standard", "applySkinbake has not been called for it"]


ALTERED = {
    "computeVertexNormals": "normal",
    "normals in place": "normal",
    "normals replaced": "normal",
    "a clone with other normals": "normal",
    "interleaved normals": "normal",
    "scale": "position",
    "weights in place": "skinWeight",
    "alpha in place": "_skinbake_alpha_0",
}


@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_a_mesh_whose_arrays_a_page_alters_is_three_s_own_from_that_frame_on(
    stage: ThreeStage, method: str
) -> None:
    """Rounding does no harm, nor do the same values in another array."""
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "method": method}
    alone = stage.call("alteredAlone", told)
    found = stage.page.call("altered", told)
    reasons = {
        name: f"a page has changed its attribute {array}: its bake is for the old values"
        for name, array in ALTERED.items()
    }
    assert stage.messages() == [
        f'skinbake: "{name}" has three.js\'s standard lighting: {reason}' for name, reason in reasons.items()
    ]
    lit = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    for name, one in found.items():
        if one["isAltered"]:
            assert one["report"] == ["standard", reasons[name]]
            assert one["draws"] == [alone[name]] * 3, name
        else:
            assert one["report"] == ["accurate", ""]
            wanted = expected(character, one["world"], lit)
            assert max(largest(drawn, wanted) for drawn in one["draws"]) < DEGREES, name


@pytest.mark.parametrize("part", ["bending", "rigid"])
def test_a_tool_may_remove_vertices_of_a_mesh_that_was_drawn(stage: ThreeStage, part: str) -> None:
    """Alpha and beta of a rigid part are 0, and stay so, wherever its vertices are."""
    file = Editable(TUBE)
    if part == "rigid":
        file.array("WEIGHTS_0")[:] = (1, 0, 0, 0)
    source = file.write(stage.models / f"trimmed-{part}.glb")
    character = Character(baked(source, stage.models), BENT)
    triangles = 500
    found = stage.call("trimmed", {**character.told(Placement()), "triangles": triangles})
    assert found["report"] == [["accurate", ""]]
    kept = np.unique(gltf_reading.read(source).triangles()[:triangles])
    assert largest(found["normals"], expected(character, found["world"])[kept]) < DEGREES


def test_a_change_of_method_needs_the_arrays_that_a_page_has_given_away(stage: ThreeStage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    accurate, other = stage.page.call("freed", told)
    assert accurate == ["accurate", ""]
    kept = "bake last, or keep attributes as they are"
    reason = f"its attribute _SKINBAKE_ALPHA_0 is without an array, not VEC3: {kept}"
    assert other == ["standard", reason]
    assert stage.messages() == [f'skinbake: "freed" has three.js\'s standard lighting: {reason}']


def test_arrays_are_not_read_back_while_a_mesh_is_switched(stage: ThreeStage) -> None:
    """A page that writes them in each frame pays nothing for accurate lighting that is off."""
    told = stage.character(TUBE, BENT).told(Placement())
    assert stage.page.call("written", told) == {"read": 0, "lighting": "standard"}
    assert len(stage.messages()) == 1


def test_a_hook_may_turn_normals_before_three_js_skins_them(stage: ThreeStage) -> None:
    """As a morph target does."""
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "lines": "objectNormal += vec3(0.5, 0.25, -0.5);"}
    found = stage.call("hooked", told)
    plain = expected(character, found["world"])
    turn_rest(character, (0.5, 0.25, -0.5))
    wanted = expected(character, found["world"])
    assert angles(wanted, plain).max() > 1000 * DEGREES
    assert largest(found["normals"], wanted) < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_a_program_without_room_for_alpha_and_beta_is_three_s_own(stage: ThreeStage) -> None:
    """WebGL 2 promises 16 attributes. three.js needs five of them here."""
    character = stage.character(TUBE, BENT)
    found = stage.page.call("crowded", character.told(Placement()))
    reason = 'its MeshNormalMaterial "many" does not link with alpha and beta: see the error above'
    assert found["report"] == [["standard", reason]]
    wanted = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert largest(found["draws"][0], wanted) < DEGREES
    said = stage.messages()
    assert [line for line in said if line.startswith("skinbake")] == [
        f'skinbake: "crowded" has three.js\'s standard lighting: {reason}'
    ]
    assert any("THREE.WebGLProgram: Shader Error" in line for line in said)


def test_materials_that_draw_nothing_have_no_part_in_the_report(stage: ThreeStage) -> None:
    found = stage.call("idle", stage.character(TUBE, BENT).told(Placement()))
    assert found == {
        "unused": "accurate",
        "hidden": "accurate",
        "all hidden": "not drawn",
        "one": "not drawn",
    }


def test_geometries_that_a_page_gives_up_no_longer_count(stage: ThreeStage) -> None:
    """Those that are drawn again after ``dispose()`` do."""
    assert stage.call("counted", stage.character(TUBE, BENT).told(Placement())) == [2, 1, 2, 0, 2, 0]


def test_without_the_module_three_has_its_own_normals(stage: ThreeStage) -> None:
    """Else the tests above would not see it. The page has used the module before, and disposed of it."""
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, plugin=False)
    wanted = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert largest(found["draws"][0], wanted) < DEGREES


def test_standard_lighting_is_three_s_own(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, lighting="standard")
    wanted = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert largest(found["draws"][0], wanted) < DEGREES
    assert found["report"] == [["standard", "lighting() has switched it"]]


def test_a_mesh_that_was_drawn_before_is_taken_up_and_given_back(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("late", character.told(Placement()))
    normals = [
        expected(character, found["world"], algorithm)
        for algorithm in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT)
    ]
    reports = [one["report"] for one in found["found"]]
    right = [["accurate", ""]]
    assert reports == [[], right, right, [], right, right, []]
    for one, wanted in zip(found["found"], [*normals, *normals, normals[0]], strict=True):
        (drawn,) = one["draws"]
        assert largest(drawn, wanted) < DEGREES


@pytest.mark.parametrize("lighting", ["accurate", "standard"])
@pytest.mark.parametrize(
    ("kind", "views"),
    [
        ("ArrayCamera", [(0,), (1,)]),
        ("two renders", [(0,), (1,)]),
        ("instances", [(0, 2)]),
        ("InstancedBufferGeometry", [(0, 0, 0)]),
    ],
)
def test_several_views_and_instances(
    stage: ThreeStage, kind: str, views: list[tuple[int, ...]], lighting: str
) -> None:
    """Each camera is turned by its number, in radians, and so is each instance."""
    character = stage.character(TUBE, BENT)
    found = stage.call("views", {**character.told(Placement()), "kind": kind, "lighting": lighting})
    accurate = lighting == "accurate"
    algorithm = Algorithm.LBS_ACCURATE if accurate else Algorithm.LBS_STANDARD
    wanted = expected(character, found["world"], algorithm)
    for draw, turns in zip(found["draws"], views, strict=True):
        drawn = vectors(draw["values"]).reshape(len(turns), -1, 3)
        for normals, turn in zip(drawn, turns, strict=True):
            # A camera turned one way sees what an instance turned the other way shows.
            about_y = turn if kind == "instances" else -turn
            turned = wanted @ rotation(about_y).T
            assert angles(normals, turned[: len(normals)]).max() < DEGREES
    assert found["report"] == [["accurate", ""] if accurate else ["standard", "lighting() has switched it"]]


def test_meshes_that_are_not_lit_accurately_are_told_of_once(stage: ThreeStage) -> None:
    stage.page.call("strangers", stage.character(TUBE, BENT).told(Placement()))
    reasons = {
        "batched": "three.js does not skin a BatchedMesh",
        "instanced": "three.js does not skin an InstancedMesh",
        "still": "three.js does not skin a Mesh",
        "later": "applySkinbake has not been called for it. "
        "Register SkinbakePlugin wherever its file is loaded, in useGLTF.preload() too",
    }
    assert stage.page.messages() == [
        f'skinbake: "{name}" has three.js\'s standard lighting: {reason}' for name, reason in reasons.items()
    ]


def test_classes_with_hooks_are_served_and_those_of_another_three_told_of(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.page.call("classes", character.told(Placement()))
    wanted = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert largest(found["draws"][0], wanted) < DEGREES
    assert found["hooked"]
    reason = "it is of another copy of three.js: let every import of 'three' find the same files"
    assert found["report"] == [["standard", reason]]
    assert stage.page.messages() == [
        "THREE.WARNING: Multiple instances of Three.js being imported.",
        f'skinbake: "other" has three.js\'s standard lighting: {reason}',
    ]


def test_hooks_that_an_effect_puts_back_do_not_pile_up(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("outlined", character.told(Placement()))
    assert found["isSame"]
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_shadows_follow_the_method(stage: ThreeStage, method: str) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("shadows", {**character.told(Placement()), "method": method})
    blended = [shadow_is_of(character, found, one) for one in (Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT)]
    assert blended == [method == "lbs", method == "dqs"]


def test_the_shadow_of_a_switched_mesh_is_three_s_own(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "method": "dqs", "lighting": "standard"}
    found = stage.call("shadows", told)
    assert shadow_is_of(character, found, Algorithm.LBS_STANDARD)


@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_a_material_whose_meshes_stay_switched_has_three_s_own_program(
    stage: ThreeStage, method: str
) -> None:
    """Both meshes have the same material."""
    character = stage.character(TUBE, BENT)
    found = stage.call("switched", {**character.told(Placement()), "method": method})
    lit = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    accurate = expected(character, found["world"], lit)
    standard = expected(character, found["world"], Algorithm.LBS_STANDARD)
    first, *rounds = found["found"]
    steps = [(True, True, True), (True, False, True), (False, False, True), (False, False, False)]
    for draws, (one, other, ours) in zip(
        [first, *rounds], [steps[0], *[*steps[1:], steps[0]] * 3], strict=True
    ):
        for draw, is_accurate in zip(draws, (one, other), strict=True):
            assert largest(draw["values"], accurate if is_accurate else standard) < DEGREES
            assert any("Skinbake" in name for name in draw["names"]) == ours
    assert len(set(found["programs"])) == 1
    assert found["renewed"] == 0


@pytest.mark.parametrize("custom", [False, True])
@pytest.mark.parametrize("light", ["DirectionalLight", "PointLight"])
def test_shadows_follow_the_method_where_others_cast_them_before(
    stage: ThreeStage, light: str, custom: bool
) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    found = stage.call("lateShadows", {**told, "method": "dqs", "light": light, "custom": custom})
    assert found["known"]
    assert all(found["known"])
    assert found["more"] == 0


def test_an_unlit_material_that_was_drawn_before_follows_the_method(stage: ThreeStage) -> None:
    drawn, switched, new = stage.call("unlit", stage.character(TUBE, BENT).told(Placement()))
    assert drawn == switched == new
    assert new["report"] == [["unlit", "its materials read no normals"]]


def test_materials_that_a_mesh_no_longer_has_are_not_held(stage: ThreeStage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    assert stage.call("swapped", {**told, "count": 20}) <= 2


def test_metadata_of_an_accessor_is_found(stage: ThreeStage) -> None:
    """Where extras of the primitive are no object, bake writes into those of alpha's accessor."""
    file = Editable(TUBE)
    file.primitive()["extras"] = "ours"
    path = baked(file.write(stage.models / "spoken_for.glb"), stage.models)
    document = gltf_reading.read(path)
    assert document.primitive(0)["extras"] == "ours"
    character = stage.character(TUBE, BENT)
    found = stage.page.call("normals", {**character.told(Placement()), "url": f"/models/{path.name}"})
    assert stage.page.messages() == ["THREE.GLTFLoader: Ignoring primitive type .extras, ours"]
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES
    assert found["report"] == found["loaded"] == [["accurate", ""]]


def test_clones_share_all_and_are_switched_and_disposed_of_apart(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("clones", character.told(Placement()))
    accurate = expected(character, found["world"])
    standard = expected(character, found["world"], Algorithm.LBS_STANDARD)
    pairs = [(found["draws"], (accurate, standard)), (found["again"], (accurate, accurate))]
    pairs += [(found["one"], (accurate, standard)), (found["back"], (accurate, accurate))]
    for draws, wanted in [*pairs, (found["disposed"], (standard, standard))]:
        assert len(draws) == 2
        both = [
            max(largest(draw, one) for draw, one in zip(draws, order, strict=True))
            for order in (wanted, wanted[::-1])
        ]
        assert min(both) < DEGREES
    assert not any("kinbake" in name and not name.startswith("_") for name in found["attributes"])


def test_a_hundred_characters_of_all_kinds_share_one_program(stage: ThreeStage) -> None:
    sources = [
        (TUBE, "auto", AS_USUAL),
        (TUBE, "auto", GradientFormat(Encoding.PACKED8)),
        (MIRRORED, "tangent", AS_USUAL),
    ]
    paths = [baked(source, stage.models, frame, storage) for source, frame, storage in sources]
    found = stage.call("programs", {"urls": [f"/models/{path.name}" for path in paths], "count": 34})
    assert found == {"draws": 102, "programs": 1, "lightings": ["accurate"]}


def test_a_material_with_a_shader_of_its_own_is_told_of_once(stage: ThreeStage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    reason = 'its ShaderMaterial "own" does not skin by three.js\'s chunks'
    assert stage.page.call("foreign", told) == [["standard", reason]]
    assert stage.page.messages() == [f'skinbake: "hero" has three.js\'s standard lighting: {reason}']


def test_a_library_that_replaces_a_chunk_later_hides_no_character(stage: ThreeStage) -> None:
    """A program of unbaked characters would not link if the other chunks still called our functions."""
    character = stage.character(TUBE, BENT)
    plain = stage.models / "plain.glb"
    plain.write_bytes(TUBE.read_bytes())
    found = stage.call("replaced", {**character.told(Placement()), "unbaked": f"/models/{plain.name}"})
    (unbaked,), (own,) = found["draws"]
    assert largest(unbaked, expected(character, found["world"], Algorithm.LBS_STANDARD)) < DEGREES
    assert largest(own, expected(character, found["world"])) < DEGREES
    assert (found["report"], found["restored"]) == ([["accurate", ""]], True)


def test_a_material_that_skins_without_morphing_compiles(stage: ThreeStage) -> None:
    path = baked(with_morphs(stage.models, TUBE), stage.models)
    found = stage.call("unmorphed", Character(path, BENT, (0.7, -0.4)).told(Placement()))
    assert largest(found["draws"][0], expected(Character(path, BENT), found["world"])) < DEGREES


def test_a_root_that_is_not_an_object_is_refused(stage: ThreeStage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    message = "skinbake: the root is not an Object3D: pass gltf.scene, not gltf"
    assert stage.call("roots", told) == [message] * 6


def test_an_exporter_writes_the_file_s_own_attributes(stage: ThreeStage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    names = stage.call("exported", told)
    assert [name for name in names if "SKINBAKE" in name] == ["_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"]


class TestFiles(FilesToldOf):
    engine = "three.js"
    part = '"cut_2"'
    names_files = False

    def check(self, drawn: Drawn) -> None:
        assert (
            largest(drawn.found["draws"][0], expected(drawn.character, drawn.found["world"], drawn.lit))
            < DEGREES
        )
