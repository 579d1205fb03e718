"""The npm package in PlayCanvas itself, on WebGL 2 and WebGPU: normals and tangents against the replay.

Both run in Chromium on SwiftShader. Joints are turned at random.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER as FIXTURES
from skinbake.choices import Encoding, Layout, Scheme
from skinbake.format.encodings import GradientFormat
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.support import browser, corpus, gltf_reading
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import (
    AS_USUAL,
    Array,
    Character,
    Normals,
    Placement,
    Pose,
    angles,
    baked,
    by_numbers,
)
from tests.support.mapped import TEXELS, Columns, columns, texel_normal
from tests.support.node import package_folder, require_node
from tests.support.replay import replay
from tests.support.stage import Stage, opened_page, page_of, require_backend
from tests.support.told_of_files import Drawn, FilesToldOf
from tests.three.drawn import turn_rest, vectors, with_morphs

PAGE = page_of(
    "/tests/drawing.mjs",
    {"playcanvas": "/playcanvas/build/playcanvas.mjs", "skinbake-playcanvas": "/package/index.js"},
)
DEGREES = 0.01
"""Between the browser and the replay: PlayCanvas has bone matrices, and we all else, in float32."""
TUBE = FIXTURES / "bent_tube.glb"
MIRRORED = FIXTURES / "mirrored_tangent.glb"
RANDOM = Pose(clip=None)
BACKENDS = ["webgl2", "webgpu"]
PACKED = GradientFormat(Encoding.PACKED8)
SHORT = GradientFormat(Encoding.SNORM16, Layout.CUSTOM)
PAIRS = GradientFormat(layout=Layout.TEXCOORD)


class DrawingStage(Stage):
    """The page, and the models that it can load."""

    def draw(self, character: Character, **options: object) -> dict[str, Any]:
        """Draw a character; whatever the console says of it fails the test."""
        return dict(self.call("draw", {**character.told(Placement()), **options}))

    def told(self, path: Path, **options: object) -> tuple[list[Any], list[str]]:
        """Draw a file and return the report, and what the module says on the console."""
        report = self.page.call("told", {"url": f"/models/{path.name}", **options})
        return report, [line for line in self.page.messages() if line.startswith("skinbake")]


def expected(
    character: Character, found: dict[str, Any], algorithm: Algorithm = Algorithm.LBS_ACCURATE
) -> Normals:
    world = np.array(found["world"]).reshape(4, 4).T
    return character.expected(algorithm, at(character, found, world))


def at(character: Character, found: dict[str, Any], world: Array) -> Placement:
    """Return where PlayCanvas has the mesh: the joints' matrices are those below the root."""
    root = np.array(found["root"]).reshape(4, 4).T
    return dataclasses.replace(Placement(), world=world, root=root)


def largest(values: str, wanted: Array | None) -> float:
    assert wanted is not None
    found = vectors(values)
    assert found.shape == wanted.shape
    assert (np.linalg.norm(found, axis=1) > 0.5).all()
    return float(angles(found, wanted).max())


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrawingStage]:
    require_node("playcanvas", "draco3dgltf")
    folders = {"playcanvas": package_folder("playcanvas"), "draco": package_folder("draco3dgltf")}
    folders |= {"tests": Path(__file__).resolve().parent, "package": engines_folder() / "playcanvas"}
    folder = tmp_path_factory.mktemp("playcanvas")
    arguments = [*browser.PRESENTING, "--js-flags=--expose-gc"]
    with opened_page(PAGE, folder, folders, arguments) as (page, models):
        yield DrawingStage(page, models)


FIXTURE_CASES = [
    pytest.param(TUBE, "auto", AS_USUAL, "webgl2", id="tube"),
    pytest.param(TUBE, "auto", AS_USUAL, "webgpu", id="tube on webgpu"),
    pytest.param(MIRRORED, "normal", PACKED, "webgl2", id="packed8"),
    pytest.param(MIRRORED, "tangent", SHORT, "webgpu", id="snorm16"),
    pytest.param(MIRRORED, "tangent", PAIRS, "webgl2", id="texcoord"),
]


@pytest.mark.parametrize(("source", "frame", "storage", "backend"), FIXTURE_CASES)
def test_every_normal_is_that_of_the_replay(
    stage: DrawingStage, source: Path, frame: str, storage: GradientFormat, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(source, RANDOM, frame, storage)
    found = stage.draw(character, backend=backend)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


CHARACTERS = ["CesiumMan/CesiumMan.glb", "RiggedFigure/RiggedFigure.gltf", "Butterfly/animated_butterfly.glb"]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("model", CHARACTERS)
def test_real_characters_too(stage: DrawingStage, model: str, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(corpus.character(model), RANDOM)
    found = stage.draw(character, backend=backend)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"][0] == ["accurate", ""]


TURNED = {"position": [1, -2, 3], "angles": [20, 70, -35], "scale": [0.5, 1.5, 1]}
FLIPPED = {"position": [0, 1, 0], "angles": [10, -40, 5], "scale": [-2, 2, 2]}


@pytest.mark.parametrize(
    ("frame", "backend", "root"),
    [("normal", "webgl2", TURNED), ("tangent", "webgpu", FLIPPED), ("tangent", "webgl2", FLIPPED)],
)
def test_a_placed_character_has_normals_and_tangents(
    stage: DrawingStage, frame: str, backend: str, root: dict[str, Any]
) -> None:
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, frame)
    varyings = ["vNormalW", "vTangentW", "vBinormalW"]
    found = stage.draw(character, backend=backend, root=root, mapped=TEXELS[0], varyings=varyings)
    relief = relief_of(character, found)
    for values, wanted in zip(found["values"], (relief.n, relief.t, relief.b), strict=True):
        assert largest(values, wanted) < DEGREES


def relief_of(
    character: Character, found: dict[str, Any], algorithm: Algorithm = Algorithm.LBS_ACCURATE
) -> Columns:
    world = np.array(found["world"]).reshape(4, 4).T
    return columns(character, algorithm, at(character, found, world))


@pytest.mark.parametrize("texel", TEXELS[:2])
@pytest.mark.parametrize(("frame", "method"), [("normal", "lbs"), ("tangent", "lbs"), ("normal", "dqs")])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_relief_has_the_mapped_normals_of_the_replay(
    stage: DrawingStage, frame: str, method: str, backend: str, texel: tuple[int, ...]
) -> None:
    """At the pixel of each vertex, as its fragment shader has them. Below a mirror, bumps stay bumps."""
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, frame)
    root = FLIPPED if method == "lbs" else TURNED
    options = {"backend": backend, "root": root, "method": method, "mapped": texel}
    found = stage.draw(character, varyings=["dNormalW"], **options)
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    relief, (x, y, z) = relief_of(character, found, algorithm), texel_normal(texel)
    assert largest(found["values"][0], x * relief.t + y * relief.b + z * relief.n) < 0.2
    assert found["report"] == [["accurate", ""]]


def test_anisotropic_materials_keep_the_frame_of_playcanvas(stage: DrawingStage) -> None:
    character = stage.character(MIRRORED, RANDOM, "normal")
    found = stage.draw(character, varyings=["dNormalW"], mapped=TEXELS[0], anisotropic=True)
    wanted, (x, y, z) = expected(character, found), texel_normal(TEXELS[0])
    assert wanted.tangents is not None
    assert character.tangents is not None
    bitangents = character.tangents[:, 3:] * np.cross(wanted.normals, wanted.tangents)
    assert largest(found["values"][0], x * wanted.tangents + y * bitangents + z * wanted.normals) < 0.2


@pytest.mark.parametrize(("frame", "backend"), [("normal", "webgl2"), ("tangent", "webgpu")])
def test_morph_targets_come_before_skinning(stage: DrawingStage, frame: str, backend: str) -> None:
    require_backend(stage, backend)
    path = baked(with_morphs(stage.models, MIRRORED), stage.models, frame)
    character = Character(path, RANDOM, (0.7, -0.4))
    found = stage.draw(character, backend=backend)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES


@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_morph_targets_are_said_to_be_unread(stage: DrawingStage, numbers: int) -> None:
    """Targets with four have NORMAL, which the frame follows. Those with six have none here."""
    source = with_morphs(stage.models, MIRRORED)
    _, by_rule, _ = by_numbers(source, stage.models, numbers, "normal")
    found = stage.page.call("draw", by_rule.told(Placement()))
    bare = ", and its targets lack NORMAL: bake it with --morph-normals too" if numbers == 6 else ""
    reason = f"PlayCanvas does not read the numbers of --morph-frames{bare}"
    (said,) = stage.messages()
    assert said.endswith(f'" has a frame that follows NORMAL under morph targets: {reason}')
    if numbers == 4:
        assert largest(found["values"][0], expected(by_rule, found).normals) < DEGREES


def test_sparse_accessors_are_read(stage: DrawingStage) -> None:
    """Those of α and TANGENT: every second element lies in the sparse part. β has nothing else."""
    character = stage.character(MIRRORED, RANDOM, "tangent")
    file = Editable(character.path)
    names = ["_SKINBAKE_ALPHA_0", "TANGENT", "_SKINBAKE_BETA_0"]
    for name, step in zip(names, (2, 2, 1), strict=True):
        accessor = file.content["accessors"][file.primitive()["attributes"][name]]
        stored = file.array(name)
        places = np.arange(0, len(stored), step, dtype=np.uint32)
        values = stored[places].copy()
        stored[places] = 0
        added = [file.add(part) for part in (places.view(np.float32)[:, None], values)]
        views = [{"bufferView": file.content["accessors"][one]["bufferView"]} for one in added]
        indices, substitutes = {**views[0], "componentType": 5125}, views[1]
        accessor["sparse"] = {"count": len(places), "indices": indices, "values": substitutes}
        if step == 1:
            del accessor["bufferView"]
    path = file.write(stage.models / "sparse.glb")
    found = stage.call("draw", {**character.told(Placement()), "url": f"/models/{path.name}"})
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_arrays_of_zeros_need_no_buffer_view(stage: DrawingStage) -> None:
    """As glTF-Transform leaves α and β of a rigid part: the accessor alone."""
    file = Editable(stage.character(MIRRORED, RANDOM, "tangent").path)
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        file.array(name)[:] = 0
    character = Character(file.write(stage.models / "zeros-in-bytes.glb"), RANDOM)
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        del file.content["accessors"][file.primitive()["attributes"][name]]["bufferView"]
    path = file.write(stage.models / "zeros.glb")
    found = stage.call("draw", {**character.told(Placement()), "url": f"/models/{path.name}"})
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_a_container_may_be_loaded_without_its_meshes(stage: DrawingStage) -> None:
    """PlayCanvas itself fails if one of them has a skin."""
    file = Editable(TUBE)
    for node in file.content["nodes"]:
        node.pop("skin", None)
    path = file.write(stage.models / "animation.glb")
    assert stage.call("animations", {"url": f"/models/{path.name}"}) == 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_dual_quaternions_move_normals_positions_and_shadows(stage: DrawingStage, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, "tangent", PACKED)
    found = stage.draw(
        character, backend=backend, method="dqs", shadows=True, varyings=["vPositionW", "vNormalW"]
    )
    assert largest(found["values"][1], expected(character, found, Algorithm.DQS_EXACT).normals) < DEGREES
    matrices = character.matrices(at(character, found, np.array(found["world"]).reshape(4, 4).T))
    wanted = replay(Algorithm.DQS_EXACT, character.rest, matrices[None]).positions[0]
    assert np.abs(vectors(found["values"][0]) - wanted).max() < 1e-5 * np.ptp(wanted)
    # Of the forward pass and of the shadow map.
    assert len(found["programs"]) >= 2
    assert all(found["programs"])


STRETCHED = {"position": [1, 2, 3], "angles": [0, 0, 0], "scale": [1, 2, 1]}
REFLECTED = {"position": [0, 0, 0], "angles": [30, 0, 10], "scale": [-1, 1, 1]}
LARGER = {"position": [0, 1, 0], "angles": [0, 50, 0], "scale": [3, 3, 3]}
LEFT_HAND = "AFrameHands/leftHandLow.glb"


@pytest.mark.parametrize("method", ["lbs", "dqs"])
@pytest.mark.parametrize(
    ("node", "root", "backend"),
    [
        (STRETCHED, None, "webgl2"),
        (STRETCHED, FLIPPED, "webgpu"),
        (REFLECTED, None, "webgl2"),
        (REFLECTED, TURNED, "webgpu"),
        (None, REFLECTED, "webgl2"),
        (None, TURNED, "webgl2"),
        (None, LARGER, "webgpu"),
        (LARGER, STRETCHED, "webgl2"),
    ],
)
def test_only_the_root_moves_a_skinned_mesh(
    stage: DrawingStage,
    method: str,
    node: dict[str, Any] | None,
    root: dict[str, Any] | None,
    backend: str,
) -> None:
    """glTF ignores the transform of the mesh's own node. The root moves what the joints have posed."""
    require_backend(stage, backend)
    character = stage.character(MIRRORED, RANDOM, "tangent")
    algorithm = Algorithm.DQS_EXACT if method == "dqs" else Algorithm.LBS_ACCURATE
    varyings = ["vPositionW", "vNormalW", "vTangentW"]
    found = stage.draw(
        character, backend=backend, method=method, node=node, root=root, mapped=TEXELS[0], varyings=varyings
    )
    matrix = np.array(found["root"]).reshape(4, 4).T
    posed = replay(algorithm, character.rest, character.joints[None])
    positions = posed.positions[0] @ matrix[:3, :3].T + matrix[:3, 3]
    wanted = character.expected(algorithm, dataclasses.replace(Placement(), root=matrix, world=matrix))
    assert np.abs(vectors(found["values"][0]) - positions).max() < 1e-5 * np.ptp(positions)
    assert largest(found["values"][1], wanted.normals) < DEGREES
    relief = columns(character, algorithm, dataclasses.replace(Placement(), root=matrix, world=matrix))
    assert largest(found["values"][2], relief.t) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_joints_may_all_mirror(stage: DrawingStage, method: str) -> None:
    """The hand is a rigid motion of its mirror image. Its normals are on PlayCanvas's own side."""
    character = stage.character(corpus.model(LEFT_HAND), RANDOM)
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    sides = {name: getattr(character.rest, name) * (-1, 1, 1) for name in MOVED}
    rest = dataclasses.replace(character.rest, **sides)
    algorithm = Algorithm.DQS_EXACT if method == "dqs" else Algorithm.LBS_ACCURATE
    posed = replay(algorithm, rest, (character.joints @ mirror)[None])
    found = stage.draw(character, method=method, varyings=["vPositionW", "vNormalW"])
    # PlayCanvas's own positions of vertices without weights are lost.
    weighted = gltf_reading.read(character.path).influences()[1].sum(axis=1) > 0
    distances = np.abs(vectors(found["values"][0]) - posed.positions[0]).max(axis=1)
    assert distances[weighted].max() < 1e-5 * np.ptp(posed.positions)
    assert largest(found["values"][1], posed.normals[0]) < DEGREES
    assert found["report"] == [["accurate", ""]]


MOVED = ("positions", "normals", "tangents", "bitangents")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_scaled_joint_keeps_a_mesh_from_dual_quaternions(stage: DrawingStage, backend: str) -> None:
    require_backend(stage, backend)
    options = {**stage.character(TUBE, RANDOM).told(Placement()), "backend": backend}
    options["change"] = "a scaled joint"
    found = stage.page.call("draw", {**options, "method": "dqs", "varyings": ["vPositionW", "vNormalW"]})
    ((lighting, reason),) = found["report"]
    assert lighting == "standard"
    assert reason.endswith("is scaled otherwise than other joints: load it with the method lbs")
    (message,) = stage.messages()
    assert reason in message
    options |= {"plugin": False, "url": options["url"] + "?without"}
    usual = stage.page.call("draw", {**options, "varyings": ["vPositionW", "vNormalW"]})
    assert "was loaded without skinbakeOptions()" in stage.messages()[0]
    assert found["values"] == usual["values"]


@pytest.mark.parametrize(
    "change",
    [
        "clone",
        "another material",
        "a copied material",
        "and back",
        "and back after long",
        "a clone is standard for long",
        "disposed and again",
        "the same normals",
        "an own comment",
    ],
)
def test_whatever_a_page_does_the_normals_stay_right(stage: DrawingStage, change: str) -> None:
    character = stage.character(TUBE, RANDOM)
    found = stage.draw(character, change=change)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_chunk_may_turn_normals_before_playcanvas_skins_them(stage: DrawingStage, backend: str) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, RANDOM)
    found = stage.draw(character, backend=backend, change="turned by a chunk")
    plain = expected(character, found).normals
    turn_rest(character, (0.5, 0.25, -0.5))
    wanted = expected(character, found).normals
    assert angles(wanted, plain).max() > 1000 * DEGREES
    assert largest(found["values"][0], wanted) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("change", "array"),
    [("normals set", "NORMAL"), ("other weights", "WEIGHTS_0")],
    ids=["NORMAL", "WEIGHTS_0"],
)
def test_a_mesh_whose_arrays_a_page_changes_has_playcanvas_s_own_normals(
    stage: DrawingStage, change: str, array: str, backend: str
) -> None:
    """α and β are for the arrays of the file."""
    require_backend(stage, backend)
    options = {**stage.character(TUBE, RANDOM).told(Placement()), "backend": backend, "change": change}
    found = stage.page.call("draw", options)
    reason = f"a page has changed its {array}: its bake is for the old values"
    assert found["report"] == [["standard", reason]]
    assert stage.messages() == [f'skinbake: "tube" has PlayCanvas\'s standard lighting: {reason}']
    usual = stage.page.call("draw", {**options, "plugin": False, "url": options["url"] + "?without"})
    assert "was loaded without skinbakeOptions()" in stage.messages()[0]
    assert found["values"] == usual["values"]


def test_the_old_arrays_bring_the_accurate_lighting_back(stage: DrawingStage) -> None:
    character = stage.character(TUBE, RANDOM)
    told = {**character.told(Placement()), "change": "normals set, then as they were"}
    found = stage.page.call("draw", told)
    assert [line for line in stage.messages() if "a page has changed its NORMAL" not in line] == []
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("storage", [PACKED, None], ids=["baked otherwise", "not baked"])
def test_an_instance_may_get_another_mesh(stage: DrawingStage, storage: GradientFormat | None) -> None:
    character = stage.character(TUBE, RANDOM, storage=storage or AS_USUAL)
    path = character.path
    if storage is None:
        path = stage.models / "unbaked.glb"
        path.write_bytes(TUBE.read_bytes())
    first = stage.character(TUBE, RANDOM)
    found = stage.draw(first, change="another mesh", other=f"/models/{path.name}")
    algorithm = Algorithm.LBS_STANDARD if storage is None else Algorithm.LBS_ACCURATE
    assert largest(found["values"][0], expected(character, found, algorithm).normals) < DEGREES


@pytest.mark.parametrize(
    ("change", "backend"), [("standard", "webgl2"), ("standard", "webgpu"), ("disposed", "webgl2")]
)
def test_without_it_a_mesh_has_the_engine_s_own_normals(
    stage: DrawingStage, change: str, backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, RANDOM)
    found = stage.draw(character, change=change, backend=backend)
    wanted = expected(character, found, Algorithm.LBS_STANDARD).normals
    assert largest(found["values"][0], wanted) < DEGREES
    assert found["report"][0][0] != "accurate"


@pytest.mark.parametrize(
    ("change", "programs"),
    [
        ("standard", [False]),
        ("standard while disabled", [False]),
        ("standard just now", [True]),
        ("standard for long", [False]),
    ],
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_that_stays_switched_has_the_engine_s_own_program(
    stage: DrawingStage, change: str, programs: list[bool], backend: str
) -> None:
    require_backend(stage, backend)
    character = stage.character(TUBE, RANDOM)
    found = stage.draw(character, change=change, backend=backend)
    assert found["programs"] == programs
    assert found["report"] == [["standard", "lighting() has switched it"]]
    wanted = expected(character, found, Algorithm.LBS_STANDARD).normals
    assert largest(found["values"][0], wanted) < DEGREES


def test_dispose_leaves_the_chunks_of_the_application(stage: DrawingStage) -> None:
    path = stage.models / "chunk.glb"
    path.write_bytes(baked(TUBE, stage.models).read_bytes())
    found = stage.call("disposed", {"url": f"/models/{path.name}"})
    assert found == {"lit": [True, True], "kept": [True, True], "others": [False, False]}


def test_dispose_again_and_again_wraps_no_function_again(stage: DrawingStage) -> None:
    path = stage.models / "wrapped.glb"
    path.write_bytes(baked(TUBE, stage.models).read_bytes())
    assert stage.call("wrapped", {"url": f"/models/{path.name}"}) == 1


def test_a_report_names_meshes_that_are_not_drawn(stage: DrawingStage) -> None:
    path = stage.models / "watched.glb"
    path.write_bytes(baked(TUBE, stage.models).read_bytes())
    found = stage.page.call("watchedOver", {"url": f"/models/{path.name}"})
    assert any("Failed to compile" in message for message in stage.messages())
    not_drawn = [["not drawn", "it has not been drawn yet"]]
    assert found == {
        "outside": not_drawn,
        "drawn": [["accurate", ""]],
        "disabled": not_drawn,
        "failed": not_drawn,
        "destroyed": [["not drawn", "it has been destroyed"]],
    }


def test_wrong_roots_and_applications_are_named(stage: DrawingStage) -> None:
    root = "TypeError: skinbake: the root is not an entity"
    application = "TypeError: skinbake: skinbakeOptions() takes the application first"
    assert stage.call("refused", {}) == [root] * 3 + [application] * 2


def test_files_may_share_one_object_of_options(stage: DrawingStage) -> None:
    slow = textured(stage.models)
    (stage.models / "quick.glb").write_bytes(baked(TUBE, stage.models).read_bytes())
    reports = stage.call("together", {"urls": [f"/models/{slow.name}", "/models/quick.glb"]})
    assert reports == [[["accurate", ""]]] * 2


PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
"""An image, as base64."""


def textured(folder: Path) -> Path:
    """Write the tube, baked, with a texture."""
    file = Editable(baked(TUBE, folder))
    file.content["images"] = [{"uri": f"data:image/png;base64,{PIXEL}"}]
    file.content["textures"] = [{"source": 0}]
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    file.content["materials"] = [material]
    file.primitive()["material"] = 0
    return file.write(folder / "textured.glb")


def test_materials_of_unloaded_files_do_not_stay_in_memory(stage: DrawingStage) -> None:
    path = stage.models / "unloaded.glb"
    path.write_bytes(baked(TUBE, stage.models).read_bytes())
    assert stage.call("remaining", {"url": f"/models/{path.name}"}) == 0


class TestMessages:
    """Nothing is silently standard."""

    def test_eight_influences(self, stage: DrawingStage) -> None:
        reason = "it has 8 influences for each vertex, and PlayCanvas reads four"
        report, (message,) = stage.told(baked(FIXTURES / "two_sets.glb", stage.models))
        assert report[0][1].startswith(reason)
        assert reason in message

    @pytest.mark.parametrize(
        ("change", "reason"),
        [
            ("an own chunk", "has other chunks than PlayCanvas's"),
            ("an own normal", "has other chunks than PlayCanvas's"),
            ("an own skin", "has other chunks than PlayCanvas's"),
            ("a main function without the chunk", "does not call getNormal() of the chunk normalVS"),
            ("a main function that does not call it", "does not call getNormal() of the chunk normalVS"),
            ("a shader of its own", "is not a StandardMaterial or LitMaterial"),
        ],
    )
    def test_a_material_that_cannot(self, stage: DrawingStage, change: str, reason: str) -> None:
        path = stage.models / f"{change.replace(' ', '-')}.glb"  # PlayCanvas keeps materials by URL
        path.write_bytes(baked(TUBE, stage.models).read_bytes())
        report, (message,) = stage.told(path, change=change)
        assert report[0][0] == "standard"
        assert reason in report[0][1]
        assert message.startswith("skinbake: ")
        assert "PlayCanvas's standard lighting" in message
        assert reason in message

    def test_an_asset_that_was_loaded_without_the_options(self, stage: DrawingStage) -> None:
        path = stage.models / "without.glb"
        path.write_bytes(baked(TUBE, stage.models).read_bytes())
        stage.told(baked(TUBE, stage.models))
        report, (message,) = stage.told(path, plugin=False)
        assert report == [["standard", "it is not baked, or its asset was loaded without skinbakeOptions()"]]
        assert "was loaded without skinbakeOptions()" in message

    def test_draco(self, stage: DrawingStage) -> None:
        path = stage.models / "draco.glb"
        bake_file(TUBE, path, compress=Scheme.DRACO)
        reason = "PlayCanvas reads no alpha and beta of a mesh in Draco: bake it again with --compress none"
        report, (message,) = stage.told(path)
        assert report == [["standard", reason]]
        assert reason in message

    def test_a_damaged_attribute(self, stage: DrawingStage) -> None:
        file = Editable(baked(TUBE, stage.models))
        file.primitive()["attributes"]["_SKINBAKE_BETA_0"] = file.primitive()["attributes"]["WEIGHTS_0"]
        _, (message,) = stage.told(file.write(stage.models / "damaged.glb"))
        assert "its attribute _SKINBAKE_BETA_0 is VEC4, not VEC3" in message

    def test_a_second_method_for_one_url_is_told(self, stage: DrawingStage) -> None:
        """PlayCanvas keeps what a URL has given, and calls no hooks."""
        for name, methods in (("same", ["lbs", "lbs"]), ("other", ["lbs", "dqs"])):
            path = stage.models / f"{name}.glb"
            path.write_bytes(baked(TUBE, stage.models).read_bytes())
            stage.page.call("twice", {"url": f"/models/{path.name}", "methods": methods})
        (message,) = stage.messages()
        assert message.startswith("skinbake: ")
        assert "is drawn by lbs, not by dqs" in message
        assert '"/models/other.glb" comes from PlayCanvas\'s cache' in message

    def test_a_mesh_that_is_not_baked_is_not_told_of(self, stage: DrawingStage) -> None:
        path = stage.models / "plain.glb"
        path.write_bytes(TUBE.read_bytes())
        report, messages = stage.told(path)
        assert report[0][0] == "standard"
        assert messages == []


class TestFiles(FilesToldOf):
    engine = "PlayCanvas"
    function = "told"
    drawing = "draw"
    pose = RANDOM

    def check(self, drawn: Drawn) -> None:
        assert (
            largest(drawn.found["values"][0], expected(drawn.character, drawn.found, drawn.lit).normals)
            < DEGREES
        )
