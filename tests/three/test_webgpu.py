"""The npm package under WebGPURenderer, by both its backends: normals of real draws against the replay.

The WebGPU of the browser runs on SwiftShader.
"""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.format.encodings import GradientFormat
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.support import corpus
from tests.support.characters import (
    Array,
    Character,
    Placement,
    Pose,
    angles,
    baked,
    by_numbers,
    column_by_column,
)
from tests.support.mapped import TEXELS, covered_by, look_at, relief_seen
from tests.support.node import package_folder, require_node
from tests.support.stage import opened_page, page_of, require_backend
from tests.three.drawn import (
    BENT,
    CHARACTERS,
    CLIP,
    DEGREES,
    INSTANCES,
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
    shadow_is_of,
    vectors,
    with_morphs,
)

PAGE = page_of(
    "/tests/drawing_webgpu.mjs",
    {
        "three": "/three/build/three.module.js",
        "three/webgpu": "/three/build/three.webgpu.js",
        "three/tsl": "/three/build/three.tsl.js",
        "three/addons/": "/three/examples/jsm/",
        "@pixiv/three-vrm/nodes": "/vrm/lib/nodes/index.module.js",
        "skinbake-three": "/package/index.js",
        "skinbake-three/webgpu": "/package/webgpu.js",
    },
    scopes={"/vrm/": {"three/tsl": "/tests/tsl_for_three_vrm.mjs"}},
    scripts=["/support/capture.js", "/tests/capture_webgpu.js"],
)
SIZE = 96
SOURCES = [(TUBE, BENT, "auto"), (MIRRORED, RANDOM, "normal"), (MIRRORED, RANDOM, "tangent")]


BACKENDS = ["webgl", "webgpu"]
KINDS = ["own", "normal", "lambert", "phong", "toon", "matcap", "standard", "node", "mtoon"]
KINDS += ["clone", "copy", "hook", "positioned"]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ThreeStage]:
    require_node("three", "@pixiv/three-vrm")
    folders = {"three": package_folder("three"), "vrm": package_folder("@pixiv/three-vrm")}
    folders |= {"tests": Path(__file__).resolve().parent, "package": engines_folder() / "three"}
    with opened_page(PAGE, tmp_path_factory.mktemp("webgpu"), folders) as (page, models):
        yield ThreeStage(page, models)


@pytest.mark.parametrize(
    ("method", "storage"), [*(("lbs", storage) for storage in STORAGES), ("dqs", STORAGES[0])], ids=str
)
@pytest.mark.parametrize(("source", "pose", "frame"), SOURCES)
@pytest.mark.parametrize("backend", BACKENDS)
def test_every_normal_is_that_of_the_replay(
    stage: ThreeStage,
    source: Path,
    pose: Pose,
    frame: str,
    method: str,
    storage: GradientFormat,
    backend: str,
) -> None:
    require_backend(stage, backend)
    character = stage.character(source, pose, frame, storage)
    found = stage.normals(character, method=method, backend=backend)
    (drawn,) = found["draws"]
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    assert largest(drawn, expected(character, found["world"], algorithm)) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_whose_normals_a_page_alters_is_three_s_own(stage: ThreeStage, backend: str) -> None:
    """The others of ``ALTERED`` in test_package.py go the same way."""
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    found = stage.page.call("altered", {**character.told(Placement()), "backend": backend})
    reason = "a page has changed its attribute normal: its bake is for the old values"
    assert stage.messages() == [f'skinbake: "anew" has three.js\'s standard lighting: {reason}']
    assert found["anew"]["report"] == [["standard", reason]]
    assert found["anew"]["draws"] == found["alone"]["draws"]
    rewritten = found["as they were"]
    assert rewritten["report"] == [["accurate", ""]]
    assert largest(rewritten["draws"][0], expected(character, rewritten["world"])) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_the_differential_move_the_frame(
    stage: ThreeStage, numbers: int, frame: str, method: str, backend: str
) -> None:
    """docs/reference/frame.md, *Morph targets*, by four and by six numbers."""
    require_backend(stage, backend)
    character, by_rule, clear = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, numbers, frame)
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    found = stage.normals(character, method=method, backend=backend)
    wanted = expected(character, found["world"], algorithm)
    assert angles(wanted, expected(by_rule, found["world"], algorithm)).max() > 100 * DEGREES
    drawn = vectors(found["draws"][0])
    clear = clear[: len(drawn)]
    assert angles(drawn[clear], wanted[: len(drawn)][clear]).max() < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("change", ["geometry.clone()", "another material"])
def test_what_a_page_copies_keeps_the_numbers(stage: ThreeStage, change: str, backend: str) -> None:
    character, *_ = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, 6, "normal")
    found = stage.normals(character, change=change, backend=backend)
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
def test_targets_that_a_page_has_sorted_move_the_frame_by_the_normal(stage: ThreeStage, backend: str) -> None:
    _, by_rule, _ = by_numbers(with_morphs(stage.models, MIRRORED), stage.models, 4, "normal")
    told = {**by_rule.told(Placement()), "change": "targets in another order", "backend": backend}
    found = stage.page.call("normals", told)
    assert largest(found["draws"][0], expected(by_rule, found["world"])) < DEGREES
    (message,) = stage.page.messages()
    assert "a frame that follows NORMAL under morph targets: a page has changed its targets" in message


@pytest.mark.parametrize("backend", BACKENDS)
def test_characters_that_share_a_material_have_their_own_numbers(stage: ThreeStage, backend: str) -> None:
    source = with_morphs(stage.models, MIRRORED)
    four, six = (by_numbers(source, stage.models, numbers, "normal") for numbers in (4, 6))
    without = stage.character(source, RANDOM, "normal", morphs=(0.7, -0.4))
    characters = [four[0], six[0], without]
    told = [one.told(Placement()) for one in characters]
    draws = stage.call("together", {"backend": backend, "characters": told})
    assert len(draws) == len(characters)
    for character, clear, drawn in zip(characters, (four[2], six[2], six[2]), draws, strict=True):
        wanted = expected(character, np.eye(4).ravel().tolist())
        found = vectors(drawn)
        assert angles(found, wanted[: len(found)])[clear[: len(found)]].max() < DEGREES


@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_cap_limits_how_tangents_are_corrected(
    stage: ThreeStage, method: str, frame: str, backend: str
) -> None:
    require_backend(stage, backend)
    check_cap(stage, method, frame, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
def test_characters_that_share_a_material_have_caps_of_their_own(stage: ThreeStage, backend: str) -> None:
    require_backend(stage, backend)
    check_caps_apart(stage, backend=backend)


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_morph_targets_come_before_skinning(stage: ThreeStage, frame: str) -> None:
    path = baked(with_morphs(stage.models, MIRRORED), stage.models, frame)
    character = Character(path, RANDOM, (0.7, -0.4))
    found = stage.normals(character)
    assert largest(found["draws"][0], expected(character, found["world"])) < DEGREES


@pytest.mark.parametrize(
    ("backend", "storage"), [("webgl", STORAGES[0]), ("webgpu", STORAGES[1])], ids=["webgl", "webgpu"]
)
@pytest.mark.parametrize(("model", "fixture", "pose"), CHARACTERS[2:])
def test_real_characters_too(
    stage: ThreeStage, model: str, fixture: None, pose: Pose, storage: GradientFormat, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(corpus.character(model), pose, storage=storage)
    found = stage.normals(character, backend=backend)
    (drawn,) = found["draws"]
    assert largest(drawn, expected(character, found["world"])) < DEGREES


@pytest.mark.parametrize("material", KINDS)
def test_materials_of_all_kinds_have_the_same_normals(stage: ThreeStage, material: str) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, material=material)
    assert largest(found["draws"][-1], expected(character, found["world"])) < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_whatever_a_page_does_the_normals_stay_right(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    wrong = {}
    for change in stage.call("changes", {}):
        found = stage.normals(character, change=change)
        error = largest(found["draws"][-1], expected(character, found["world"]))
        if error > DEGREES or found["report"] != [["accurate", ""]]:
            wrong[change] = (error, found["report"])
    assert wrong == {}


@pytest.mark.parametrize("backend", BACKENDS)
def test_joints_that_no_uniform_buffer_holds_come_from_a_texture(stage: ThreeStage, backend: str) -> None:
    """As three.js has it. Here the buffer is said to be small."""
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, backend=backend, material="fuzzy", uniformBytes=64)
    assert largest(found["draws"][-1], expected(character, found["world"])) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_tangents_are_those_of_the_replay(stage: ThreeStage, frame: str, method: str) -> None:
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.call("tangents", {**character.told(Placement()), "method": method})
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    placement = dataclasses.replace(Placement(), world=np.array(found["world"]).reshape(4, 4).T)
    tangents = character.expected(algorithm, placement).tangents
    assert tangents is not None
    (drawn,) = found["draws"]
    assert largest(drawn, tangents) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
def test_standard_lighting_is_three_s_own(stage: ThreeStage, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    for options in ({"lighting": "standard"}, {"plugin": False}):
        found = stage.normals(character, backend=backend, **options)
        wanted = expected(character, found["world"], Algorithm.LBS_STANDARD)
        assert largest(found["draws"][0], wanted) < DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_that_was_drawn_before_is_taken_up_switched_and_given_back(
    stage: ThreeStage, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    found = stage.call("late", {**character.told(Placement()), "backend": backend})
    standard, accurate, dual = (
        expected(character, found["world"], algorithm)
        for algorithm in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT)
    )
    switched, right = ["standard", "lighting() has switched it"], ["accurate", ""]
    reports = [one["report"] for one in found["found"]]
    assert reports == [[], [right], [switched], [right], [right], [right], [right], []]
    order = [standard, accurate, standard, accurate, dual, dual, accurate, standard]
    for one, wanted in zip(found["found"], order, strict=True):
        (drawn,) = one["draws"]
        assert largest(drawn, wanted) < DEGREES


@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_shadows_follow_the_method(stage: ThreeStage, method: str) -> None:
    require_backend(stage, "webgpu")
    character = stage.character(TUBE, BENT)
    found = stage.call("shadows", {**character.told(Placement()), "method": method})
    blended = [shadow_is_of(character, found, one) for one in (Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT)]
    assert blended == [method == "lbs", method == "dqs"]


def test_the_shadow_of_a_switched_mesh_is_three_s_own(stage: ThreeStage) -> None:
    require_backend(stage, "webgpu")
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "method": "dqs", "lighting": "standard"}
    found = stage.call("shadows", told)
    assert shadow_is_of(character, found, Algorithm.LBS_STANDARD)


@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_that_stays_switched_has_three_s_own_program(
    stage: ThreeStage, backend: str, method: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "backend": backend, "method": method}
    plain = stage.call("switched", {**told, "plain": True})
    ((own,),) = plain["found"]
    found = stage.call("switched", told)
    lit = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    accurate = expected(character, found["world"], lit)
    standard = expected(character, found["world"], Algorithm.LBS_STANDARD)
    first, *rounds = found["found"]
    text = first[0]["text"]
    assert "morphSkinbakeAlpha" in text
    assert "morphSkinbakeAlpha" not in own["text"]
    after = [(accurate, text), (standard, text), (standard, own["text"]), (accurate, text)]
    for draws, (normals, shader) in zip([first, *rounds], [after[0], *after[1:] * 3], strict=True):
        one, other = draws
        assert largest(one["values"], accurate) < DEGREES
        assert largest(other["values"], normals) < DEGREES
        assert (one["text"], other["text"]) == (text, shader)
    assert len(set(found["programs"])) == 1
    assert found["made"] == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_bundle_is_recorded_again_when_its_mesh_is_switched(stage: ThreeStage, backend: str) -> None:
    require_backend(stage, backend)
    found = stage.call("bundled", {**stage.character(TUBE, BENT).told(Placement()), "backend": backend})
    assert found == {"version": 2, "report": [["accurate", ""]]}


@pytest.mark.parametrize(("root", "other", "detached"), PARENTS)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_parent_moves_dual_quaternions_as_a_whole(
    stage: ThreeStage, root: Array, other: Array | None, detached: bool, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    placed = placed_by(root, other, detached=detached)
    found = stage.call("parented", {**character.told(Placement()), **placed, "backend": backend})
    before = np.array(found["world"]).reshape(4, 4).T if detached else np.eye(4)
    position, normal = deviations_below(character, found, before @ root)
    assert position < CLIP
    assert normal < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("backend", BACKENDS)
def test_joints_that_are_not_rigid_are_drawn_as_three_js_does_and_told_of(
    stage: ThreeStage, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    told = {**character.told(Placement()), "method": "dqs", "backend": backend}
    found = stage.page.call("stretched", told)
    assert stage.messages() == [f'skinbake: "tube" has three.js\'s standard lighting: {STRETCHED}']
    plain, stretched, undone, again = found["found"]
    assert stretched["draws"] == plain["draws"]
    own = expected(character, found["world"], Algorithm.LBS_STANDARD)
    assert largest(undone["draws"][0], own) < DEGREES
    assert largest(again["draws"][0], expected(character, found["world"], Algorithm.DQS_EXACT)) < DEGREES
    reports = [one["report"] for one in (stretched, undone, again)]
    assert reports == [[["standard", STRETCHED]], [["standard", STRETCHED]], [["accurate", ""]]]


@pytest.mark.parametrize("storage", [STORAGES[0], STORAGES[1], STORAGES[3]], ids=["float", "packed8", "uv"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_alpha_and_beta_need_no_vertex_buffers_where_there_are_too_few(
    stage: ThreeStage, backend: str, storage: GradientFormat
) -> None:
    """Both characters have the same program, and alpha and beta of their own."""
    require_backend(stage, backend)
    pair = [stage.character(MIRRORED, RANDOM, frame, storage) for frame in ("normal", "tangent")]
    told = [character.told(Placement()) for character in pair]
    found = stage.call("crowded", {"backend": backend, "characters": told})
    assert {"tangent", "uv", "uv1", "color"} <= set(found["names"])
    wanted = [expected(character, found["world"]) for character in pair]
    assert len(found["draws"]) == 2
    orders = (wanted, wanted[::-1])
    errors = [max(map(largest, found["draws"], order)) for order in orders]
    assert min(errors) < DEGREES
    assert found["report"] == [["accurate", ""]] * 2
    assert found["freed"] == (2 if backend == "webgpu" else 0)


@pytest.mark.parametrize("classed", [False, True], ids=["assigned", "of a class"])
def test_a_hook_that_calls_the_one_before_leaves_the_material_alone(stage: ThreeStage, classed: bool) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    found = stage.call("chained", {**told, "classed": classed})
    assert found["calls"] == 5
    assert len(set(found["versions"])) == 1
    assert found["report"] == [["accurate", ""]]


def test_node_materials_of_webgl_renderer_need_both_modules(stage: ThreeStage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.page.call("handled", character.told(Placement()))
    reason = (
        'its MeshStandardNodeMaterial "nodes" does not skin by three.js\'s chunks: '
        "call applySkinbake of 'skinbake-three/webgpu' too"
    )
    assert stage.page.messages() == [f'skinbake: "hero" has three.js\'s standard lighting: {reason}']
    alone, both = found
    assert [alone["report"], both["report"]] == [[["standard", reason]], [["accurate", ""]]]
    standard = expected(character, alone["world"], Algorithm.LBS_STANDARD)
    assert largest(alone["draws"][0], standard) < DEGREES
    assert largest(both["draws"][0], expected(character, both["world"])) < DEGREES


@pytest.mark.parametrize("kind", ["ArrayCamera", "two renders"])
def test_several_cameras(stage: ThreeStage, kind: str) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.call("views", {**character.told(Placement()), "kind": kind})
    wanted = expected(character, found["world"])
    for turn, drawn in enumerate(found["draws"]):
        assert largest(drawn, wanted @ rotation(-turn).T) < DEGREES
    assert len(found["draws"]) == 2


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_hundred_characters_of_one_file_share_their_programs(stage: ThreeStage, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, BENT)
    found = stage.call("programs", {**character.told(Placement()), "backend": backend})
    one, hundred = found["found"]
    assert one["draws"] == 1
    assert one["more"] >= 2
    assert hundred == {"draws": 100, "more": 0}
    assert found["lightings"] == ["accurate"]


def test_a_material_that_skins_by_itself_is_told_of_once(stage: ThreeStage) -> None:
    told = stage.character(TUBE, BENT).told(Placement())
    reason = 'its MeshBasicNodeMaterial "own" does not skin by three.js\'s nodes'
    assert stage.page.call("foreign", told) == [["standard", reason]]
    assert stage.page.messages() == [f'skinbake: "hero" has three.js\'s standard lighting: {reason}']


@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_webgpu_draws_the_same_picture(stage: ThreeStage, method: str) -> None:
    """Its pixels hold the normals as floats."""
    require_backend(stage, "webgpu")
    character = stage.character(TUBE, BENT, storage=STORAGES[1])
    told = {**character.told(Placement()), "method": method}
    accurate, other = (picture(stage.call("picture", {**told, "backend": b})) for b in ("webgl", "webgpu"))
    standard = picture(stage.call("picture", {**told, "backend": "webgpu", "plugin": False}))
    other, standard = other[::-1], standard[::-1]
    seen = (accurate[..., 3] == 1) & (other[..., 3] == 1)
    assert seen.mean() > 0.05
    assert np.abs(accurate - other)[seen].max() < 1e-3
    both = seen & (standard[..., 3] == 1)
    assert np.percentile(angles(2 * other[both][:, :3] - 1, 2 * standard[both][:, :3] - 1), 99) > 2


def picture(text: str) -> npt.NDArray[np.float32]:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(SIZE, SIZE, 4)


@pytest.mark.parametrize(("frame", "method"), [("normal", "lbs"), ("tangent", "lbs"), ("tangent", "dqs")])
@pytest.mark.parametrize("backend", BACKENDS)
def test_every_pixel_of_a_relief_is_that_of_the_replay(
    stage: ThreeStage, frame: str, method: str, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, frame)
    for texel in TEXELS[:2]:
        found, wanted, told = relief(stage, character, texel, backend=backend, method=method)
        assert told == ["accurate accurate"]
        assert np.percentile(angles(found, wanted), 99.9) < RELIEF_DEGREES


@pytest.mark.parametrize("backend", BACKENDS)
def test_three_instances_of_which_one_is_mirrored_have_reliefs_of_their_own(
    stage: ThreeStage, backend: str
) -> None:
    """They share geometry and material. The camera looks at each in turn; all three are drawn."""
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, "tangent")
    for roots in INSTANCES:
        found, wanted, told = relief(stage, character, TEXELS[0], roots, backend=backend)
        assert told == ["accurate accurate"] * 3
        assert np.percentile(angles(found, wanted), 99.9) < RELIEF_DEGREES


@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_the_differential_carry_the_relief_along(
    stage: ThreeStage, numbers: int, frame: str, method: str
) -> None:
    source = with_morphs(stage.models, MIRRORED)
    character, by_rule, _ = by_numbers(source, stage.models, numbers, frame, (0.1, -0.1))
    found, wanted, told = relief(stage, character, TEXELS[0], backend="webgl", method=method)
    assert told == ["accurate accurate"]
    assert np.percentile(angles(found, wanted), 99.9) < RELIEF_DEGREES
    found, otherwise, _ = relief(stage, by_rule, TEXELS[0], backend="webgl", method=method)
    assert np.percentile(angles(found, otherwise), 99.9) > 3 * RELIEF_DEGREES


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_a_relief_at_rest_is_three_s_own(stage: ThreeStage, frame: str) -> None:
    character = stage.character(MIRRORED, Pose(clip=None, angle=0.0), frame)
    own, wanted, _ = relief(stage, character, TEXELS[0], backend="webgl", plugin=False)
    found, *_ = relief(stage, character, TEXELS[0], backend="webgl")
    assert angles(found, own).max() < RELIEF_DEGREES
    assert angles(own, wanted).max() < RELIEF_DEGREES


MOVES = [Pose(0, 0.2), Pose(0, 0.45)]


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("lbs", {}),
        ("dqs", {}),
        ("dqs", {"uniformBytes": 64}),
        ("dqs", {"lighting": "standard"}),
    ],
    ids=["lbs", "dqs", "joints from a texture", "switched"],
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_velocities_are_from_where_the_same_skinning_had_the_vertices(
    stage: ThreeStage, backend: str, method: str, options: dict[str, object]
) -> None:
    """In clip space from y up, as three.js has them for TRAA and motion blur."""
    require_backend(stage, backend)
    before, now = (stage.character(TUBE, pose) for pose in MOVES)
    projection, view = look_at(now, Placement(), (0.4, 0.5, 1.0))
    told = [character.told(Placement()) for character in (before, now)]
    camera = {"half": 1 / projection[0, 0], "view": view.T.ravel().tolist()}
    given = {"url": told[1]["url"], "poses": [one["pose"] for one in told], "camera": camera}
    found = stage.call(
        "velocities", {**given, "size": RELIEF, "backend": backend, "method": method, **options}
    )
    drawn, colours = (
        np.frombuffer(base64.b64decode(found[name]), "<f4").reshape(RELIEF, RELIEF, 4)
        for name in ("image", "colour")
    )
    if not found["isFromTop"]:
        drawn, colours = drawn[::-1], colours[::-1]
    dual = method == "dqs" and "lighting" not in options
    own, other = Algorithm.LBS_ACCURATE, Algorithm.DQS_EXACT
    own, other = (other, own) if dual else (own, other)
    seen, corners, shares = covered_by(now, own, Placement(), (projection, view), colours[..., 3] == 1)

    def moved(to: Algorithm, origin: Algorithm) -> Array:
        moves = now.positions(Placement(), to) - before.positions(Placement(), origin)
        planar = moves @ (projection @ view)[:2, :3].T
        return np.asarray(np.einsum("pk,pki->pi", shares[seen], planar[corners[seen]]))

    velocities = drawn[seen][:, :2]
    assert np.abs(velocities - moved(own, own)).max() < VELOCITY
    assert np.abs(moved(own, other) - moved(own, own)).max() > 5 * VELOCITY


VELOCITY = 1e-3
"""Of clip coordinates. They change from pixel to pixel, and SwiftShader rounds the vertices."""
RELIEF_DEGREES = 0.2
RELIEF = 160


def relief(
    stage: ThreeStage,
    character: Character,
    texel: tuple[int, ...],
    roots: Sequence[Array] = (),
    method: str = "lbs",
    **options: object,
) -> tuple[Array, Array, list[str]]:
    """Draw a relief of one tilt. Return its pixels, what they should be, and what the module reports.

    roots (4, 4) are where the character is, and where others are that are drawn too.
    """
    placed = Placement(roots[0], world=roots[0]) if roots else Placement()
    x, y, z = placed.root[:3, :3] @ [0.4, 0.5, 1.0]
    projection, view = look_at(character, placed, (x, y, z))
    camera = {"half": 1 / projection[0, 0], "view": view.T.ravel().tolist()}
    found = stage.call(
        "mapped",
        {
            **character.told(Placement()),
            "texel": texel,
            "camera": camera,
            "size": RELIEF,
            "method": method,
            "roots": [column_by_column(root) for root in roots],
            **options,
        },
    )
    rows = np.frombuffer(base64.b64decode(found["image"]), "<f4").reshape(RELIEF, RELIEF, 4)
    drawn = (rows if found["isFromTop"] else rows[::-1]).astype(np.float64)
    algorithm = Algorithm.DQS_EXACT if method == "dqs" else Algorithm.LBS_ACCURATE
    pixels, wanted, _ = relief_seen(character, algorithm, placed, (projection, view), drawn, texel)
    return pixels, wanted, found["told"]
