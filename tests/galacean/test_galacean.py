"""The npm package in Galacean Engine itself: normals and tangents against the replay.

It runs in Chromium on SwiftShader. Joints are turned at random.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER as FIXTURES
from skinbake.choices import Baseline, Encoding, Layout, Scheme
from skinbake.format.encodings import GradientFormat
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.support import corpus, gltf_reading
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
    with_scaled_joints,
)
from tests.support.mapped import TEXELS, columns, texel_normal
from tests.support.node import build_page, package_folder, require_node
from tests.support.stage import Stage, opened_page, page_of
from tests.support.told_of_files import Drawn, FilesToldOf
from tests.three.drawn import vectors, with_morphs

PAGE = page_of("/built/app.js", scripts=["/support/capture.js"])
DEGREES = 0.01
"""Between the browser and the replay: Galacean has joint matrices, and we all else, in float32."""
TUBE = FIXTURES / "bent_tube.glb"
MIRRORED = FIXTURES / "mirrored_tangent.glb"
BENT = Pose(clip=0, time=0.45)
RANDOM = Pose(clip=None)
PACKED = GradientFormat(Encoding.PACKED8)
SHORT = GradientFormat(Encoding.SNORM16, Layout.CUSTOM)
PAIRS = GradientFormat(layout=Layout.TEXCOORD)


class DrawingStage(Stage):
    """The page, and the models that it can load. A device that was lost leaves objects behind."""

    unasked = (*Stage.unasked, "WebGL: INVALID_OPERATION: delete: object does not belong to this context")

    def draw(self, character: Character, **options: object) -> dict[str, Any]:
        """Draw a character; whatever the console says of it fails the test."""
        return dict(self.call("draw", {**character.told(Placement()), **options}))

    def told(self, path: Path, **options: object) -> tuple[list[Any], list[str]]:
        """Draw a file and return the report, and what the module says on the console after a colon."""
        report = self.page.call("draw", {"url": f"/models/{path.name}", **options})["report"]
        said = [line for line in self.messages() if line.startswith("skinbake")]
        assert all("has Galacean's standard lighting: " in line for line in said)
        return report, [line.partition("lighting: ")[2] for line in said]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrawingStage]:
    require_node("vite", "@galacean/engine")
    folder = tmp_path_factory.mktemp("galacean")
    project = folder / "project"
    project.mkdir()
    packages = {"skinbake-galacean": str(engines_folder() / "galacean" / "index.js")}
    packages["@galacean/engine"] = str(package_folder("@galacean/engine"))
    build_page(project, Path(__file__).resolve().parent / "drawing.mjs", packages)
    with opened_page(PAGE, folder, {"built": project / "dist"}) as (page, models):
        yield DrawingStage(page, models)


def expected(
    character: Character, found: dict[str, Any], algorithm: Algorithm = Algorithm.LBS_ACCURATE
) -> Normals:
    return character.expected(algorithm, at(found))


def at(found: dict[str, Any]) -> Placement:
    """Return where Galacean turns the joints: in the space of the parent of their root."""
    root, world = (np.array(found[name]).reshape(4, 4).T for name in ("root", "world"))
    return dataclasses.replace(Placement(), world=world, root=root)


def largest(values: str, wanted: Array | None) -> float:
    assert wanted is not None
    found = vectors(values)
    assert found.shape == wanted.shape
    assert (np.linalg.norm(found, axis=1) > 0.5).all()
    return float(angles(found, wanted).max())


@pytest.mark.parametrize(
    ("source", "frame", "storage"),
    [
        pytest.param(TUBE, "auto", AS_USUAL, id="tube"),
        pytest.param(MIRRORED, "normal", PACKED, id="packed8"),
        pytest.param(MIRRORED, "tangent", SHORT, id="snorm16"),
        pytest.param(MIRRORED, "tangent", PAIRS, id="texcoord"),
    ],
)
def test_every_normal_is_that_of_the_replay(
    stage: DrawingStage, source: Path, frame: str, storage: GradientFormat
) -> None:
    character = stage.character(source, RANDOM, frame, storage)
    found = stage.draw(character)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


CHARACTERS = ["CesiumMan/CesiumMan.glb", "RiggedFigure/RiggedFigure.gltf", "Butterfly/animated_butterfly.glb"]


@pytest.mark.parametrize("model", CHARACTERS)
def test_real_characters_too(stage: DrawingStage, model: str) -> None:
    character = stage.character(corpus.character(model), RANDOM)
    found = stage.draw(character)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"][0] == ["accurate", ""]


def test_joints_may_come_from_a_texture(stage: DrawingStage) -> None:
    """Galacean puts them there if uniforms have no room."""
    character = stage.character(MIRRORED, RANDOM)
    found = stage.draw(character, change="many joints")
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


TURNED = {"position": [1, -2, 3], "angles": [20, 70, -35], "scale": [0.5, 1.5, 1]}
FLIPPED = {"position": [0, 1, 0], "angles": [10, -40, 5], "scale": [-2, 2, 2]}


@pytest.mark.parametrize("texel", TEXELS[:2])
@pytest.mark.parametrize(
    ("frame", "method", "root"),
    [("normal", "lbs", TURNED), ("tangent", "lbs", FLIPPED), ("normal", "dqs", FLIPPED)],
)
def test_a_relief_has_the_mapped_normals_of_the_replay(
    stage: DrawingStage, frame: str, method: str, root: dict[str, Any], texel: tuple[int, ...]
) -> None:
    """Galacean's fragment shaders multiply the texel by this matrix. Below a mirror, bumps stay bumps."""
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.draw(character, root=root, method=method, mapped=texel, varying="v_TBN")
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    relief = columns(character, algorithm, at(found))
    part = texel_normal(texel)
    wanted = part[0] * relief.t + part[1] * relief.b + part[2] * relief.n
    matrices = vectors(found["values"][0]).reshape(-1, 3, 3)
    assert angles(np.einsum("c,vci->vi", part, matrices), wanted).max() < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_anisotropic_materials_keep_the_frame_of_galacean(stage: DrawingStage) -> None:
    character = stage.character(MIRRORED, RANDOM, "normal")
    found = stage.draw(character, mapped=TEXELS[0], anisotropic=True, varying="v_TBN")
    wanted = expected(character, found)
    matrices = vectors(found["values"][0]).reshape(-1, 3, 3)
    assert wanted.tangents is not None
    assert character.tangents is not None
    bitangents = character.tangents[:, 3:] * np.cross(wanted.normals, wanted.tangents)
    for index, vector in enumerate((wanted.tangents, bitangents, wanted.normals)):
        assert angles(matrices[:, index], vector).max() < DEGREES


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_morph_targets_come_before_skinning(stage: DrawingStage, frame: str) -> None:
    path = baked(with_morphs(stage.models, MIRRORED), stage.models, frame)
    character = Character(path, RANDOM, (0.7, -0.4))
    found = stage.draw(character)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES


@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_morph_targets_are_said_to_be_unread(stage: DrawingStage, numbers: int) -> None:
    """Targets with four have NORMAL, which the frame follows. Those with six have none here."""
    source = with_morphs(stage.models, MIRRORED)
    _, by_rule, _ = by_numbers(source, stage.models, numbers, "normal")
    found = stage.page.call("draw", by_rule.told(Placement()))
    bare = ", and its targets lack NORMAL: bake it with --morph-normals too" if numbers == 6 else ""
    reason = f"Galacean does not read the numbers of --morph-frames{bare}"
    (said,) = stage.messages()
    assert said.endswith(f'" has a frame that follows NORMAL under morph targets: {reason}')
    if numbers == 4:
        assert largest(found["values"][0], expected(by_rule, found).normals) < DEGREES


def test_sparse_accessors_are_read(stage: DrawingStage) -> None:
    """Those of α and TANGENT: every second element lies in the sparse part."""
    character = stage.character(MIRRORED, RANDOM, "tangent")
    file = Editable(character.path)
    for name in ("_SKINBAKE_ALPHA_0", "TANGENT"):
        stored = file.array(name)
        places = np.arange(0, len(stored), 2, dtype=np.uint32)
        values = stored[places].copy()
        stored[places] = 0
        added = [file.add(part) for part in (places.view(np.float32)[:, None], values)]
        indices, substitutes = ({"bufferView": file.content["accessors"][one]["bufferView"]} for one in added)
        sparse = {"count": len(places), "values": substitutes, "indices": {**indices, "componentType": 5125}}
        file.content["accessors"][file.primitive()["attributes"][name]]["sparse"] = sparse
    path = file.write(stage.models / "sparse.glb")
    found = stage.call("draw", {**character.told(Placement()), "url": f"/models/{path.name}"})
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


STRETCHED = {"position": [1, 2, 3], "angles": [0, 0, 0], "scale": [1, 2, 1]}


@pytest.mark.parametrize("root", [TURNED, FLIPPED])
def test_the_root_alone_moves_a_skinned_mesh(stage: DrawingStage, root: dict[str, Any]) -> None:
    """glTF ignores the transform of the mesh's own node."""
    character = stage.character(MIRRORED, RANDOM, "tangent")
    found = stage.draw(character, node=STRETCHED, root=root)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES


LEFT_HAND = "AFrameHands/leftHandLow.glb"


@pytest.mark.parametrize("kind", ["rigid", "scaled", "mirrored"])
def test_dual_quaternions_move_normals_and_positions(stage: DrawingStage, kind: str) -> None:
    if kind == "mirrored":
        character = stage.character(corpus.model(LEFT_HAND), RANDOM)
    elif kind == "scaled":
        character = stage.character(with_scaled_joints(stage.models, TUBE), BENT)
    else:
        character = stage.character(MIRRORED, RANDOM, "tangent", PACKED)
    found = stage.draw(character, method="dqs")
    wanted = expected(character, found, Algorithm.DQS_EXACT).normals
    assert largest(found["values"][0], wanted) < DEGREES
    assert angles(wanted, expected(character, found).normals).max() > 1
    assert found["report"] == [["accurate", ""]]
    (positions, *_) = stage.draw(character, method="dqs", varying="v_pos")["values"]
    posed = character.positions(at(found), Algorithm.DQS_EXACT)
    weighted = gltf_reading.read(character.path).influences()[1].sum(axis=1) > 0
    assert np.abs(vectors(positions) - posed)[weighted].max() < 1e-5 * np.ptp(posed)


def test_dual_quaternions_move_depths_and_shadows_too(stage: DrawingStage) -> None:
    """Galacean draws depths by a shader that reads no normals. Shadows are seen from the sun."""
    options = {"shadows": True, "varying": "gl_Position"}
    found, usual = (
        [vectors(one).reshape(-1, 4) for one in stage.draw(character, **options, method=method)["values"]]
        for character in [stage.character(MIRRORED, RANDOM)]
        for method in ("dqs", "lbs")
    )
    size = np.ptp(found[-1])
    assert len(found) == 3
    assert sorted(np.abs(one - found[-1]).max() < 1e-5 * size for one in found[:-1]) == [False, True]
    moved = [np.abs(one - other).max() / np.ptp(one) for one, other in zip(found, usual, strict=True)]
    assert min(moved) > 1e-4


@pytest.mark.parametrize("storage", [AS_USUAL, PACKED, PAIRS], ids=["float32", "packed8", "pairs"])
def test_a_bake_that_meshopt_has_compressed(stage: DrawingStage, storage: GradientFormat) -> None:
    character = stage.character(TUBE, RANDOM, storage=storage)
    path = stage.models / f"meshopt-{character.path.name}"
    bake_file(TUBE, path, compress=Scheme.MESHOPT, storage=storage)
    found = stage.call("draw", {**character.told(Placement()), "url": f"/models/{path.name}"})
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize(
    "change", ["clone", "another material", "a lost device", "a new renderer", "standard, and back"]
)
def test_whatever_a_page_does_the_normals_stay_right(stage: DrawingStage, change: str) -> None:
    character = stage.character(TUBE, RANDOM)
    if change == "a lost device":
        # Galacean restores all that the page has loaded, and fails at some morphed meshes.
        stage.page.go(f"{stage.page.address}/")
    found = stage.draw(character, change=change)
    assert largest(found["values"][0], expected(character, found).normals) < DEGREES
    assert found["report"] == [["accurate", ""]]


@pytest.mark.parametrize("other", ["baked otherwise", "not baked"])
def test_a_renderer_may_get_another_mesh(stage: DrawingStage, other: str) -> None:
    first = stage.character(TUBE, RANDOM)
    path = stage.models / "unbaked.glb"
    if other == "not baked":
        path.write_bytes(TUBE.read_bytes())
    else:
        path = stage.character(TUBE, RANDOM, storage=PACKED).path
    found = stage.draw(first, change="another mesh", other=f"/models/{path.name}")
    if other == "not baked":
        usual = stage.draw(first, plugin=False)
        assert found["values"] == usual["values"]
        assert found["report"][0][0] == "standard"
    else:
        character = Character(path, RANDOM)
        assert largest(found["values"][0], expected(character, found).normals) < DEGREES


def test_standard_lighting_is_galacean_s_own(stage: DrawingStage) -> None:
    character = stage.character(MIRRORED, RANDOM)
    usual = stage.draw(character, plugin=False, mapped=TEXELS[0], varying="v_TBN")
    found = stage.draw(character, change="standard", mapped=TEXELS[0], varying="v_TBN")
    assert found["values"] == usual["values"]
    assert found["report"] == [["standard", "lighting() has switched it"]]
    normals = vectors(usual["values"][0])[2::3]
    placement = at(found)
    wanted = character.expected(
        Algorithm.LBS_STANDARD, placement, baseline=Baseline.INVERSE_TRANSPOSE
    ).normals
    assert angles(normals, wanted).max() < DEGREES
    reason = "it is not baked, or its file was loaded before registerSkinbake()"
    assert usual["report"] == [["standard", reason]]


def test_a_mesh_whose_normals_a_page_sets_has_standard_normals(stage: DrawingStage) -> None:
    path = baked(TUBE, stage.models)
    reason = "a page has written or removed its NORMAL: its bake is for the old values"
    assert stage.told(path, change="normals set", keepMeshData=True) == ([["standard", reason]], [reason])


@pytest.mark.parametrize(
    ("change", "report"),
    [
        ("an unlit material", ["unlit", "its materials read no normals"]),
        ("not drawn", ["not drawn", "it has not been drawn yet"]),
    ],
)
def test_a_report_names_what_is_not_lit(stage: DrawingStage, change: str, report: list[str]) -> None:
    assert stage.told(baked(TUBE, stage.models), change=change) == ([report], [])


def test_a_root_is_a_scene_an_entity_or_a_list(stage: DrawingStage) -> None:
    path = baked(TUBE, stage.models)
    assert stage.call("counted", {"url": f"/models/{path.name}"}) == [1, 1, 1, 2]
    wrong = "TypeError: skinbake: the root is not an entity, a scene or an array of entities"
    others = ["Error: skinbake: lighting other is neither", "Error: skinbake: method other is neither"]
    *found, light, method = stage.call("roots", {})
    assert found == [wrong] * 3
    assert [light[: len(others[0])], method[: len(others[1])]] == others


class TestMessages:
    """Nothing is silently standard."""

    def test_eight_influences(self, stage: DrawingStage) -> None:
        reason = "it has 8 influences for each vertex, and Galacean reads four: "
        reason += "bake it again with --limit-influences 4"
        path = baked(FIXTURES / "two_sets.glb", stage.models)
        assert stage.told(path) == ([["standard", reason]], [reason])

    def test_draco(self, stage: DrawingStage) -> None:
        path = stage.models / "draco.glb"
        bake_file(TUBE, path, compress=Scheme.DRACO)
        reason = "Galacean reads nothing of a mesh in Draco: bake it again with --compress none"
        assert stage.told(path) == ([["standard", reason]], [reason])

    def test_too_many_attributes(self, stage: DrawingStage) -> None:
        """Galacean has eight for up to eight morph targets. SwiftShader has 16."""
        file = Editable(baked(with_morphs(stage.models, MIRRORED), stage.models))
        attributes = file.primitive()["attributes"]
        attributes["COLOR_0"] = file.add(np.ones((len(file.array("NORMAL")), 4), np.float32))
        reason = "it needs 17 vertex attributes, and this device has 16"
        assert stage.told(file.write(stage.models / "many.glb")) == ([["standard", reason]], [reason])

    def test_a_shader_of_a_page(self, stage: DrawingStage) -> None:
        reason = 'the shader "own" does not include Galacean\'s common_vert and skinning_vert'
        path = baked(TUBE, stage.models)
        assert stage.told(path, change="a shader of its own") == ([["standard", reason]], [reason])

    def test_a_damaged_attribute(self, stage: DrawingStage) -> None:
        file = Editable(baked(TUBE, stage.models))
        file.primitive()["attributes"]["_SKINBAKE_BETA_0"] = file.primitive()["attributes"]["WEIGHTS_0"]
        _, (reason,) = stage.told(file.write(stage.models / "damaged.glb"))
        assert reason.startswith("its attribute _SKINBAKE_BETA_0 is VEC4, not VEC3")


class TestFiles(FilesToldOf):
    engine = "Galacean"
    function = "draw"
    drawing = "draw"
    pose = RANDOM

    def check(self, drawn: Drawn) -> None:
        if drawn.lit is Algorithm.LBS_STANDARD:
            assert (
                drawn.found["values"] == drawn.stage.call("draw", {**drawn.told, "plugin": False})["values"]
            )
        else:
            assert largest(drawn.found["values"][0], expected(drawn.character, drawn.found).normals) < DEGREES
