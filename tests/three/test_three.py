"""The three.js module in three.js itself, in a browser: every vertex against the replay, then pictures.

What is expected comes from the replay on the processor, in float64, with joint matrices that skinbake
composed.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Encoding, Frame, Language, Layout, Lighting, Method
from skinbake.commands.shader import shader
from skinbake.errors import ChoiceError
from skinbake.format.encodings import GradientFormat
from skinbake.shaders.choices import ShaderChoices, ShaderRequest
from skinbake.skinning.rest import Algorithm
from tests.support import browser, corpus
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.blended_files import NAME, with_blend_weights
from tests.support.characters import (
    IDENTITY,
    Array,
    Character,
    Placement,
    Pose,
    angles,
    baked,
    by_numbers,
    column_by_column,
    unit,
)
from tests.support.mapped import TEXELS, look_at, relief_seen
from tests.support.node import package_folder, require_node
from tests.support.stage import Stage, opened_page, page_of
from tests.support.whole_fields import shader_text
from tests.three.drawn import INSTANCES, PLACED, transform, with_morphs

PAGE = page_of(
    "/tests/page.mjs",
    {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"},
)
CHOICES = ShaderChoices(Language.GLSL, target="three")
TOLERANCE = 1e-4
"""Of a component of a unit vector: three.js has bone matrices, and we all else, in float32."""
NORMAL, TANGENT = "normalize(transformedNormal)", "normalize(transformedTangent)"

TUBE = FOLDER / "bent_tube.glb"
MIRRORED = FOLDER / "mirrored_tangent.glb"
RANDOM = Pose(clip=None)
BENT = Pose(clip=0, time=0.45)


@dataclass(frozen=True)
class Result:
    """What the browser read back of one mesh, and where three.js had put it."""

    patched: int
    placement: Placement
    values: tuple[Array, ...]


class ModuleStage(Stage):
    """The page, with models and modules to show on it."""

    unasked = ()

    def __init__(self, page: browser.Page, models: Path, modules: Path) -> None:
        super().__init__(page, models)
        self.modules = modules

    def module(self, choices: ShaderChoices) -> str:
        """Write a module and return its address."""
        text = shader_text(choices)
        name = f"{hashlib.sha256(text.encode()).hexdigest()}.mjs"
        (self.modules / name).write_text(text, encoding="ascii")
        return f"/modules/{name}"

    def vertices(
        self,
        character: Character,
        choices: ShaderChoices | None,
        placement: Placement | None = None,
        *,
        expressions: Sequence[str] = (NORMAL,),
        **options: object,
    ) -> Result:
        """Draw every vertex, patched by a module or (None) as three.js does."""
        placement = placement or Placement()
        module = None if choices is None else self.module(choices)
        (mesh,) = self.call(
            "vertices",
            {**character.told(placement), "module": module, "expressions": list(expressions), **options},
        )
        world = np.array(mesh["world"]).reshape(4, 4).T
        values = tuple(floats(text).reshape(-1, 3).astype(np.float64) for text in mesh["values"])
        return Result(mesh["patched"], dataclasses.replace(placement, world=world), values)

    def misfits(self, character: Character, names: list[str]) -> list[str]:
        """Change a character's mesh in these ways, and return what its module says of each, patching none."""
        url, module = character.told(Placement())["url"], self.module(for_file(character))
        found = self.page.call("misfits", {"module": module, "url": url, "names": names})
        assert found == ["standard"] * len(names)
        return self.page.messages()


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleStage]:
    require_node("three")
    folder = tmp_path_factory.mktemp("three")
    modules = folder / "modules"
    modules.mkdir()
    folders = {"modules": modules, "three": package_folder("three")}
    folders |= {"tests": Path(__file__).resolve().parent}
    with opened_page(PAGE, folder, folders) as (page, models):
        yield ModuleStage(page, models, modules)


def floats(text: str) -> npt.NDArray[np.float32]:
    return np.frombuffer(base64.b64decode(text), "<f4")


def for_frame(frame: str, lighting: Lighting = Lighting.ACCURATE) -> ShaderChoices:
    return dataclasses.replace(CHOICES, frame=Frame(frame), lighting=lighting)


def deviation(found: Array, expected: Array | None) -> float:
    assert expected is not None
    return float(np.abs(found - expected).max())


SKEWED = transform((0.9, 0.2, -0.6), (1.4, 0.8, 1.1), (0.3, 0.1, -0.4))
FLIPPED = np.diag([-1.0, 1.0, 1.0, 1.0])


class TestInstruments:
    """The console and exceptions of the page reach the tests."""

    def test_warnings_and_errors_are_heard(self, stage: ModuleStage) -> None:
        stage.page.call("console.warn", "first")
        stage.page.call("console.error", "second")
        stage.page.call("console.log", "third")
        assert stage.page.messages() == ["first", "second"]
        assert stage.page.messages() == []

    def test_webgl_errors_are_heard(self, stage: ModuleStage) -> None:
        stage.page.call("(() => document.createElement('canvas').getContext('webgl2').enable(1))")
        (message,) = stage.page.messages()
        assert "INVALID_ENUM" in message

    def test_an_exception_is_raised_here(self, stage: ModuleStage) -> None:
        with pytest.raises(RuntimeError, match="not here"):
            stage.page.call("(async () => { throw new Error('not here'); })")

    def test_files_outside_the_served_folders_are_not_served(self, stage: ModuleStage) -> None:
        for path in ("/models/%2e%2e/profile/stderr.txt", "/profile/stderr.txt"):
            status = "(async (path) => (await fetch(path)).status)"
            assert stage.page.call(status, path) == 404
        assert len(stage.page.messages()) == 2


MODELS = [
    pytest.param(None, TUBE, BENT, id="bent_tube"),
    pytest.param(None, FOLDER / "weights_u8.glb", RANDOM, id="weights_u8"),
    pytest.param("CesiumMan/CesiumMan.glb", None, Pose(0, 0.6), id="CesiumMan"),
    pytest.param("RiggedFigure/RiggedFigure.gltf", None, Pose(0, 0.7), id="RiggedFigure"),
    pytest.param("VRM/cryptovoxels.vrm", None, RANDOM, id="cryptovoxels"),
]


@pytest.mark.parametrize(("model", "fixture", "pose"), MODELS)
class TestEveryVertex:
    """By one material and no light: the normal that three.js hands to its fragment shaders."""

    def test_three_has_algorithm_1(
        self, stage: ModuleStage, model: str | None, fixture: Path | None, pose: Pose
    ) -> None:
        character = stage.character(fixture or corpus.character(model or ""), pose)
        found = stage.vertices(character, None)
        assert found.patched == 0
        expected = character.expected(Algorithm.LBS_STANDARD, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE

    @pytest.mark.parametrize("lighting", [Lighting.ACCURATE, Lighting.DIRECT])
    def test_patched_it_has_algorithm_3_and_keeps_its_positions(
        self, stage: ModuleStage, model: str | None, fixture: Path | None, pose: Pose, lighting: Lighting
    ) -> None:
        character = stage.character(fixture or corpus.character(model or ""), pose)
        found = stage.vertices(
            character,
            for_frame("normal", lighting),
            expressions=[NORMAL, "(modelMatrix * vec4(transformed, 1.0)).xyz"],
        )
        assert found.patched == 1
        algorithm = Algorithm.LBS_ACCURATE if lighting is Lighting.ACCURATE else Algorithm.LBS_DIRECT
        expected = character.expected(algorithm, found.placement)
        standard = character.expected(Algorithm.LBS_STANDARD, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE
        assert np.percentile(angles(found.values[0], standard.normals), 99) > 2
        size = np.ptp(character.rest.positions, axis=0).max()
        assert deviation(found.values[1], character.positions(found.placement)) < TOLERANCE * size


def without_a_normal(folder: Path, source: Path) -> Path:
    """Take a few normals' length from a copy of a fixture: bake has (0, 0, 1) for them."""
    target = folder / f"{source.stem}-normals.glb"
    file = Editable(source)
    file.array("NORMAL")[::50] = 0
    return file.write(target)


def test_a_normal_without_length_is_that_of_bake(stage: ModuleStage) -> None:
    character = stage.character(without_a_normal(stage.models, TUBE), BENT)
    found = stage.vertices(character, CHOICES)
    expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
    assert deviation(found.values[0], expected.normals) < TOLERANCE


class TestPlacement:
    """Bind matrices, the scene's own transform, and mirrored ones of both kinds."""

    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    @pytest.mark.parametrize("bind", [IDENTITY, PLACED, SKEWED], ids=["", "bound", "skewed"])
    @pytest.mark.parametrize("root", [IDENTITY, PLACED @ FLIPPED, SKEWED], ids=["", "flipped", "skewed root"])
    def test_every_vertex_has_algorithm_3(
        self, stage: ModuleStage, frame: str, bind: Array, root: Array
    ) -> None:
        character = stage.character(MIRRORED, RANDOM, frame)
        found = stage.vertices(
            character,
            for_frame(frame),
            Placement(root, bind),
            expressions=[NORMAL, TANGENT],
            material="mapped",
        )
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE
        assert deviation(found.values[1], expected.tangents) < TOLERANCE

    @pytest.mark.parametrize("bind", [IDENTITY, FLIPPED], ids=["", "flipped bind"])
    @pytest.mark.parametrize("root", [IDENTITY, PLACED @ FLIPPED], ids=["", "flipped root"])
    @pytest.mark.parametrize("mirrored", [False, True])
    def test_mirrored_joints_turn_the_normal_outside_only_where_asked_for(
        self, stage: ModuleStage, bind: Array, root: Array, mirrored: bool
    ) -> None:
        """A mirrored bind matrix mirrors every joint; a mirrored scene none, seen from the mesh."""
        character = stage.character(TUBE, BENT)
        choices = dataclasses.replace(CHOICES, mirrored_joints=mirrored)
        found = stage.vertices(character, choices, Placement(root, bind))
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement).normals
        outside = character.expected(Algorithm.LBS_DIRECT, found.placement).normals
        turned = (expected * outside).sum(axis=1)
        assert np.all(turned < 0) == (bind is not IDENTITY)
        if mirrored:
            expected = expected * np.sign(turned)[:, None]
        assert deviation(found.values[0], expected) < TOLERANCE
        direct = stage.vertices(character, for_frame("normal", Lighting.DIRECT), Placement(root, bind))
        assert deviation(direct.values[0], outside) < TOLERANCE

    @pytest.mark.parametrize("bind", [IDENTITY, FLIPPED], ids=["", "flipped bind"])
    @pytest.mark.parametrize("root", [IDENTITY, PLACED @ FLIPPED], ids=["", "flipped root"])
    def test_mirrored_joints_turn_the_normal_outside_for_dual_quaternions_too(
        self, stage: ModuleStage, bind: Array, root: Array
    ) -> None:
        character = stage.character(TUBE, BENT)
        inside, outside = (
            stage.vertices(
                character,
                dataclasses.replace(CHOICES, mirrored_joints=mirrored),
                Placement(root, bind),
                method="dqs",
            ).values[0]
            for mirrored in (False, True)
        )
        side = 1.0 if bind is IDENTITY else -1.0
        assert deviation(outside, side * inside) < TOLERANCE
        linear = character.expected(Algorithm.LBS_DIRECT, Placement(root, bind, root)).normals
        assert np.all((outside * linear).sum(axis=1) > 0)

    def test_an_instance_is_placed_after_skinning(self, stage: ModuleStage) -> None:
        character = stage.character(TUBE, BENT)
        found = stage.vertices(character, CHOICES, instance=column_by_column(SKEWED))
        skinned = character.expected(Algorithm.LBS_ACCURATE, found.placement).normals
        expected = unit(skinned @ np.linalg.inv(SKEWED[:3, :3]))
        assert deviation(found.values[0], expected) < TOLERANCE


class TestTangents:
    """With a normal map three.js skins TANGENT too."""

    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    @pytest.mark.parametrize("material", ["mapped", "physical", "standard"])
    @pytest.mark.parametrize("lighting", [Lighting.ACCURATE, Lighting.DIRECT])
    def test_normal_and_tangent_are_skinned_in_both_frames(
        self, stage: ModuleStage, frame: str, material: str, lighting: Lighting
    ) -> None:
        character = stage.character(MIRRORED, RANDOM, frame)
        assert character.frame == frame
        has_map = material != "standard"
        expressions = [NORMAL, TANGENT] if has_map else [NORMAL]
        found = stage.vertices(
            character, for_frame(frame, lighting), expressions=expressions, material=material
        )
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE
        if has_map:
            assert deviation(found.values[1], expected.tangents) < TOLERANCE


class TestMorphTargets:
    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    def test_the_frame_turns_with_the_morphed_normal(self, stage: ModuleStage, frame: str) -> None:
        source = with_morphs(stage.models, MIRRORED)
        character = stage.character(source, RANDOM, frame, morphs=(0.7, -0.4))
        found = stage.vertices(character, for_frame(frame), expressions=[NORMAL, TANGENT], material="mapped")
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE
        assert deviation(found.values[1], expected.tangents) < TOLERANCE

    def test_a_frame_derived_anew_would_be_far_off(self, stage: ModuleStage) -> None:
        """Else the test above would not see it."""
        source = with_morphs(stage.models, MIRRORED)
        morphed = stage.character(source, RANDOM, "normal", morphs=(0.7, -0.4))
        found = stage.vertices(morphed, CHOICES)
        assert deviation(found.values[0], morphed.expected_anew(found.placement)) > 100 * TOLERANCE


PACKED8, TEXCOORD = GradientFormat(Encoding.PACKED8), GradientFormat(layout=Layout.TEXCOORD)
STORAGES = [
    pytest.param(PACKED8, id="packed8"),
    pytest.param(GradientFormat(Encoding.SNORM16), id="snorm16"),
    pytest.param(GradientFormat(Encoding.PACKED8, Layout.CUSTOM), id="packed8 custom"),
    pytest.param(GradientFormat(layout=Layout.CUSTOM), id="custom"),
    pytest.param(TEXCOORD, id="texcoord"),
]


def for_file(character: Character, lighting: Lighting = Lighting.ACCURATE) -> ShaderChoices:
    """The choices that ``--target three --for`` makes of a character's file."""
    request = ShaderRequest(Language.GLSL, target="three", lighting=lighting)
    return shader(request, str(character.path)).choices


def with_coordinates(folder: Path, source: Path, count: int) -> Path:
    """Copy a fixture with so many texture coordinate sets of its own."""
    target = folder / f"{source.stem}-{count}-sets.glb"
    file = Editable(source)
    attributes = file.primitive()["attributes"]
    first = attributes.pop("TEXCOORD_0")
    attributes |= {f"TEXCOORD_{number}": first for number in range(count)}
    return file.write(target)


class TestStorage:
    """α and β as integers, under other names, in texture coordinates: what the file says is what is drawn."""

    @pytest.mark.parametrize("storage", STORAGES)
    @pytest.mark.parametrize("lighting", [Lighting.ACCURATE, Lighting.DIRECT])
    def test_every_vertex_has_what_the_file_means(
        self, stage: ModuleStage, storage: GradientFormat, lighting: Lighting
    ) -> None:
        character = stage.character(TUBE, BENT, storage=storage)
        choices = for_file(character, lighting)
        found = stage.vertices(character, choices, material="mapped")
        assert found.patched == 1
        expected = character.expected(Algorithm(choices.algorithm), found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE

    def test_packed8_is_seen(self, stage: ModuleStage) -> None:
        """Else the tests above would not tell it from floats."""
        of_floats = stage.character(TUBE, BENT)
        placement = stage.vertices(of_floats, None).placement
        packed = stage.character(TUBE, BENT, storage=PACKED8)
        both = [each.expected(Algorithm.LBS_ACCURATE, placement).normals for each in (of_floats, packed)]
        assert deviation(*both) > 10 * TOLERANCE

    def test_a_blend_with_dual_quaternions_changes_nothing(self, stage: ModuleStage) -> None:
        """It is posed by one method, and lit for that."""
        given = with_blend_weights(TUBE, stage.models / "given.glb")
        bake_file(given, stage.models / "blended.glb", blend=NAME)
        character = Character(stage.models / "blended.glb", BENT, ())
        found = stage.vertices(character, for_file(character))
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE

    @pytest.mark.parametrize("sets", [0, 1, 3])
    @pytest.mark.parametrize("material", ["standard", "second coordinates"])
    def test_texture_coordinates_of_any_number(self, stage: ModuleStage, sets: int, material: str) -> None:
        """Also where three.js declares uv1 itself, for a texture."""
        source = with_coordinates(stage.models, TUBE, sets)
        character = stage.character(source, BENT, storage=TEXCOORD)
        found = stage.vertices(character, for_file(character), material=material)
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE

    def test_integers_that_do_not_fit_are_told_of(self, stage: ModuleStage) -> None:
        character = stage.character(TUBE, BENT, storage=PACKED8)
        told = stage.misfits(character, ["size", "lacking", "integers", "floats", "scale", "encoding"])
        remedy = "bake last, or keep attributes as they are"
        assert told == [
            standard("size", f"its attribute _SKINBAKE_ALPHA_0 is VEC3, not VEC4: {remedy}"),
            standard("lacking", f"its attribute _SKINBAKE_BETA_0 is missing: {remedy}"),
            standard("integers", f"its attribute _SKINBAKE_ALPHA_0 is not encoded as packed8: {remedy}"),
            standard("floats", f"its attribute _SKINBAKE_ALPHA_0 is VEC3, not VEC4: {remedy}"),
            standard("scale", "the metadata of its bake lacks the scale: bake it again"),
            standard(
                "encoding", "its encoding is other, and this module knows packed8 and snorm16: update it"
            ),
        ]

    def test_texture_coordinates_that_do_not_fit_are_told_of(self, stage: ModuleStage) -> None:
        """A mesh that has as many of them and is not baked is nothing to tell of."""
        character = stage.character(TUBE, BENT, storage=TEXCOORD)
        assert stage.misfits(character, ["pair", "metadata"]) == [
            standard("pair", "its attribute TEXCOORD_2 is missing: bake last, or keep attributes as they are")
        ]


def standard(mesh: str, reason: str) -> str:
    return f'skinbake: "{mesh}" has three.js\'s standard lighting: {reason}'


class TestMaterials:
    def test_every_kind_compiles_in_silence(self, stage: ModuleStage) -> None:
        every = stage.page.call("materials")
        morphing = with_morphs(stage.models, MIRRORED)
        for source, frame, names in (
            (morphing, "tangent", every),
            (MIRRORED, "normal", ["basic", "mapped", "flat", "back"]),
        ):
            character = stage.character(source, RANDOM, frame)
            module = stage.module(for_frame(frame))
            result = stage.page.call(
                "compile", {**character.told(Placement()), "module": module, "materials": names}
            )
            assert stage.messages() == [OBJECT_SPACE] * ("object-space map" in names)
            assert result["error"] == 0
            assert dict(zip(names, result["found"], strict=True)) == {
                name: "unlit" if name in UNLIT else "accurate" for name in names
            }

    @pytest.mark.parametrize(
        "material",
        ["basic", "normal", "lambert", "phong", "toon", "matcap", "double-sided", "displaced", "hashed"],
    )
    def test_every_kind_has_the_same_normal(self, stage: ModuleStage, material: str) -> None:
        character = stage.character(TUBE, BENT)
        found = stage.vertices(character, CHOICES, material=material)
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement)
        assert deviation(found.values[0], expected.normals) < TOLERANCE

    @pytest.mark.parametrize(
        "choices",
        [
            dataclasses.replace(CHOICES, cap=0.9),
        ],
        ids=["cap"],
    )
    def test_choices_of_the_snippet_reach_it(self, stage: ModuleStage, choices: ShaderChoices) -> None:
        character = stage.character(TUBE, BENT)
        found = stage.vertices(character, choices)
        expected = character.expected(Algorithm.LBS_ACCURATE, found.placement, cap=choices.cap)
        assert deviation(found.values[0], expected.normals) < TOLERANCE


OBJECT_SPACE = (
    'skinbake: "mirror" has three.js\'s own tangents for the normal map of its MeshStandardMaterial "": '
    "it is in object space"
)
UNLIT = {"depth"}
"""Materials whose programs read no normals."""


class TestMisfits:
    def test_a_mesh_that_does_not_fit_is_left_alone_and_told_of(self, stage: ModuleStage) -> None:
        character = stage.character(TUBE, BENT)
        changes = ["size", "lacking", "frame", "normal", "influences", "version", "damaged", "metadata"]
        remedy = "bake last, or keep attributes as they are"
        assert stage.misfits(character, changes) == [
            standard("size", f"its attribute _SKINBAKE_ALPHA_0 is VEC4, not VEC3: {remedy}"),
            standard("lacking", f"its attribute _SKINBAKE_BETA_0 is missing: {remedy}"),
            standard("frame", "its frame is other, and this module knows normal and tangent: update it"),
            standard("normal", "it has lost the attribute NORMAL, which its bake needs: bake last"),
            standard("influences", EIGHT),
            standard("version", "its bake has version 2, and this module reads version 1: update it"),
            standard("damaged", "the metadata of its bake is damaged: bake it again"),
            standard(
                "metadata",
                "it has lost the metadata of its bake: keep the extras of primitives, or bake last",
            ),
        ]

    def test_a_file_of_two_influence_sets_is_left_alone(self, stage: ModuleStage) -> None:
        path = baked(FOLDER / "two_sets.glb", stage.models)
        options = {"url": f"/models/{path.name}", "module": stage.module(CHOICES), "expressions": []}
        (mesh,) = stage.page.call("vertices", options)
        assert mesh["patched"] == 0
        (message,) = stage.page.messages()
        assert message.endswith(EIGHT)

    def test_two_primitives_of_a_mesh_are_lit(self, stage: ModuleStage) -> None:
        path = baked(FOLDER / "two_primitives.glb", stage.models)
        options = {"url": f"/models/{path.name}", "module": stage.module(CHOICES), "expressions": []}
        meshes = stage.call("vertices", options)
        assert [mesh["patched"] for mesh in meshes] == [2, 2]

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"method": Method.DQS, "lighting": Lighting.STANDARD}, "three.js's own"),
            ({"method": Method.DQS}, "--lighting exact"),
            ({"lighting": Lighting.STANDARD}, "three.js's own"),
            ({"influences": 5}, "four influences"),
            ({"influences": 1}, "use --influences 4"),
            ({"language": Language.WGSL}, "language='glsl'"),
        ],
    )
    def test_choices_that_three_cannot_serve_are_refused(self, changes: dict[str, Any], words: str) -> None:
        with pytest.raises(ChoiceError, match=words):
            shader_text(dataclasses.replace(CHOICES, **changes))


EIGHT = (
    "it has 8 influences for each vertex, and three.js reads four: bake it again with --limit-influences 4"
)


SIZE = 256


RELIEF_DEGREES = 0.2
"""Between the pixels of a relief and the replay."""
AT_REST = Pose(clip=None, angle=0.0)
RELIEF = 160
"""The width and height of pictures of a relief, in pixels."""


class TestNormalMaps:
    """Every pixel of a relief of constant tilt, in four directions, against the replay."""

    def pixels(
        self,
        stage: ModuleStage,
        character: Character,
        choices: ShaderChoices | None,
        texel: tuple[int, ...],
        placement: Placement | None = None,
        **options: object,
    ) -> tuple[Array, Array, Callable[[Array], Array], Any]:
        """Return the normals (P, 3) of the pixels that are drawn, in the world, and what they should be.

        With them are what interpolates vectors of vertices there, and what the module reports.
        """
        placed = placement or Placement()
        world = stage.vertices(character, None, placed).placement
        x, y, z = placed.root[:3, :3] @ [0.4, 0.5, 1.0]
        projection, view = look_at(character, world, (x, y, z))
        found = stage.call(
            "mapped",
            {
                **character.told(placed),
                "module": None if choices is None else stage.module(choices),
                "texel": texel,
                "camera": {"projection": column_by_column(projection), "view": column_by_column(view)},
                "size": RELIEF,
                "expression": "normal",
                **options,
            },
        )
        drawn = floats(found["image"]).reshape(RELIEF, RELIEF, 4)[::-1].astype(np.float64)
        algorithm = Algorithm.DQS_EXACT if options.get("method") == "dqs" else Algorithm.LBS_ACCURATE
        seen = relief_seen(character, algorithm, world, (projection, view), drawn, texel)
        return *seen, found.get("told")

    def deviation(
        self,
        stage: ModuleStage,
        character: Character,
        choices: ShaderChoices,
        placement: Placement | None = None,
        **options: object,
    ) -> float:
        """Return the largest angle in degrees over the directions of the relief.

        Of a thousand pixels one is left out: in folds, normals turn by degrees from one pixel to the next.
        """
        largest = 0.0
        for texel in TEXELS:
            found, wanted, _, told = self.pixels(stage, character, choices, texel, placement, **options)
            assert set(told) == {"accurate accurate"}
            largest = max(largest, float(np.percentile(angles(found, wanted), 99.9)))
        return largest

    @pytest.mark.parametrize(
        ("frame", "expression"),
        [("normal", "normal"), ("tangent", "normal"), ("tangent", "clearcoatNormal")],
    )
    def test_pixels_in_a_pose_are_those_of_the_replay(
        self, stage: ModuleStage, frame: str, expression: str
    ) -> None:
        character = stage.character(MIRRORED, RANDOM, frame)
        choices = for_frame(frame)
        assert self.deviation(stage, character, choices, expression=expression) < RELIEF_DEGREES
        found, wanted, *_ = self.pixels(stage, character, None, TEXELS[0])
        assert np.median(angles(found, wanted)) > 2

    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    def test_dual_quaternions_have_pixels_of_their_own(self, stage: ModuleStage, frame: str) -> None:
        character = stage.character(MIRRORED, RANDOM, frame)
        assert self.deviation(stage, character, for_frame(frame), method="dqs") < RELIEF_DEGREES

    def test_direct_lighting_has_the_same_pixels(self, stage: ModuleStage) -> None:
        character = stage.character(MIRRORED, RANDOM, "tangent")
        choices = for_frame("tangent", Lighting.DIRECT)
        assert self.deviation(stage, character, choices) < RELIEF_DEGREES

    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    def test_morph_targets_carry_the_relief_along(self, stage: ModuleStage, frame: str) -> None:
        source = with_morphs(stage.models, MIRRORED)
        character = stage.character(source, RANDOM, frame, morphs=(0.1, -0.1))
        assert self.deviation(stage, character, for_frame(frame)) < RELIEF_DEGREES

    @pytest.mark.parametrize("method", ["lbs", "dqs"])
    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    @pytest.mark.parametrize("numbers", [4, 6])
    def test_numbers_of_the_differential_carry_the_relief_along(
        self, stage: ModuleStage, numbers: int, frame: str, method: str
    ) -> None:
        source = with_morphs(stage.models, MIRRORED)
        character, *_ = by_numbers(source, stage.models, numbers, frame, (0.1, -0.1))
        assert self.deviation(stage, character, for_frame(frame), method=method) < RELIEF_DEGREES

    @pytest.mark.parametrize("root", [PLACED, PLACED @ FLIPPED, SKEWED], ids=["", "mirrored", "skewed"])
    def test_a_relief_is_placed_as_its_surface_is(self, stage: ModuleStage, root: Array) -> None:
        """three.js mirrors a bitangent twice, and so takes bumps of a mirrored mesh for dents along it."""
        character = stage.character(MIRRORED, RANDOM, "tangent")
        assert self.deviation(stage, character, CHOICES, Placement(root)) < RELIEF_DEGREES

    def test_three_instances_of_which_one_is_mirrored_have_reliefs_of_their_own(
        self, stage: ModuleStage
    ) -> None:
        """They share geometry and material. The camera looks at each in turn; all three are drawn."""
        character = stage.character(MIRRORED, RANDOM, "tangent")
        for roots in INSTANCES:
            beside = [column_by_column(root) for root in roots[1:]]
            found = self.deviation(stage, character, CHOICES, Placement(roots[0]), beside=beside)
            assert found < RELIEF_DEGREES

    @pytest.mark.parametrize("frame", ["normal", "tangent"])
    def test_pixels_at_rest_are_three_s_own(self, stage: ModuleStage, frame: str) -> None:
        character = stage.character(MIRRORED, AT_REST, frame)
        for texel in TEXELS[:2]:
            own, wanted, *_ = self.pixels(stage, character, None, texel)
            found, *_ = self.pixels(stage, character, for_frame(frame), texel)
            assert angles(found, own).max() < 0.01
            assert angles(own, wanted).max() < RELIEF_DEGREES

    def test_anisotropy_follows_the_image_of_tangent(self, stage: ModuleStage) -> None:
        character = stage.character(MIRRORED, RANDOM, "normal")
        """Its sign has no effect. Grooves are directions in the surface, not slopes: no cofactors here."""
        images = character.expected(Algorithm.LBS_ACCURATE, Placement()).tangents
        assert images is not None
        given = (stage, character, for_frame("normal"), TEXELS[0])
        found, _, between, _ = self.pixels(*given, expression="material.anisotropyT", anisotropy=0.5)
        wanted = between(images)
        wanted *= np.sign(np.einsum("pi,pi->p", found, wanted))[:, None]
        assert np.percentile(angles(found, wanted), 99) < 1


@pytest.mark.parametrize(("model", "fixture", "pose"), [MODELS[0], MODELS[2]])
class TestPictures:
    def test_lighting_changes_at_the_bends_and_nowhere_else(
        self, stage: ModuleStage, model: str | None, fixture: Path | None, pose: Pose
    ) -> None:
        """MeshNormalMaterial before and after, against the replay's difference drawn as a colour."""
        character = stage.character(fixture or corpus.character(model or ""), pose)
        placement = stage.vertices(character, None).placement
        standard = character.expected(Algorithm.LBS_STANDARD, placement).normals
        accurate = character.expected(Algorithm.LBS_ACCURATE, placement).normals
        expected = angles(standard, accurate).astype("<f4")
        projection, view = look_at(character, placement, (0.5, 0.3, 1.0))
        images = stage.call(
            "pictures",
            {
                **character.told(placement),
                "module": stage.module(CHOICES),
                "camera": {"projection": column_by_column(projection), "view": column_by_column(view)},
                "size": SIZE,
                "colours": base64.b64encode(np.repeat(expected, 3).tobytes()).decode(),
            },
        )
        before, after, wanted = (floats(image).reshape(SIZE, SIZE, 4) for image in images)
        seen = after[..., 3] == 1
        assert 0.05 < seen.mean() < 0.9
        assert np.array_equal(seen, before[..., 3] == 1)
        change = angles(2 * before[..., :3][seen] - 1, 2 * after[..., :3][seen] - 1)
        awaited = wanted[..., 0][seen]
        assert np.corrcoef(change, awaited)[0, 1] > 0.95
        assert np.percentile(np.abs(change - awaited), 99) < 6
        still, bent = awaited < 0.5, awaited > 8
        assert still.mean() > 0.05
        assert change[still].max() < 1
        assert bent.mean() > 0.1
        assert np.percentile(change[bent], 1) > 4
