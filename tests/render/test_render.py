"""``skinbake render``: its pictures against the replay, its files, and what it refuses."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from fixtures.make_fixtures import FOLDER
from skinbake.cli import exit_codes
from skinbake.commands import render
from skinbake.errors import ChoiceError, InputError
from skinbake.freshness.baked_views import sound_views
from skinbake.gltf import budget
from skinbake.gltf.document import read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.measure import scene
from skinbake.measure.scene import Scene, attachments
from skinbake.render import studio
from skinbake.render.studio import MODES, Look, Studio
from skinbake.render.subject import YAW, Camera, Shot, Subject
from skinbake.skinning.rest import Algorithm
from skinbake.truth.operator import GradientOperator
from tests.support.baked_files import Editable
from tests.support.characters import Array, Character, Pose, baked, by_numbers
from tests.support.command_line import invoke
from tests.support.corpus import model
from tests.support.cutting import cut_into_meshes, halved
from tests.support.gltf_reading import read
from tests.support.mapped import TEXELS, relief_angles, unfolded, with_relief
from tests.support.models import edited, sheet, write_model
from tests.support.morphed_files import morphed
from tests.support.rasterised import eroded, fragments
from tests.support.webgpu import NAGA

TUBE = FOLDER / "bent_tube.glb"
SIZE = (480, 320)
MEAN = 2.0
"""Of 255, as for the page."""


@pytest.fixture
def device() -> None:
    """Skip where no device draws."""
    NAGA.require()


def drawn(path: Path, target: Path, *options: str) -> Array:
    """Draw a file, and return the pixels (H, W, 3)."""
    result = invoke("render", path, "-o", target, "--size", f"{SIZE[0]}x{SIZE[1]}", *options)
    assert result.exit_code == 0, result.output
    return np.asarray(Image.open(target).convert("RGB"), np.float64)


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> list[Camera]:
    """Return the cameras of the pictures that the test draws."""
    found: list[Camera] = []

    def kept(subjects: Sequence[Subject], camera: Camera) -> Studio:
        found.append(camera)
        return Studio(subjects, camera)

    monkeypatch.setattr(render, "Studio", kept)
    return found


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("lighting", ["standard", "accurate"])
@pytest.mark.parametrize(
    ("name", "time"), [("bent_tube.glb", 0.45), ("mirrored_tangent.glb", 2.0), ("two_sets.glb", 3.5)]
)
def test_pixels_are_those_of_the_replay(
    tmp_path: Path, cameras: list[Camera], name: str, time: float, lighting: str
) -> None:
    path = baked(FOLDER / name, tmp_path)
    options = ["--mode", "normals", "--lighting", lighting, "--time", str(time)]
    found = drawn(path, tmp_path / "picture.png", *options)
    matrix = cameras[0].projected(YAW, SIZE[0] / SIZE[1])
    algorithm = Algorithm.LBS_ACCURATE if lighting == "accurate" else Algorithm.LBS_STANDARD
    wanted = fragments(path, algorithm, time, matrix, SIZE)
    inside = eroded(wanted.covered, 2)
    assert inside.sum() > 2000
    difference = np.abs(found - 255 * (0.5 + 0.5 * wanted.normals))[inside]
    assert difference.mean() < MEAN
    if name == "bent_tube.glb":  # the others are seen from behind too
        outside = eroded(~wanted.covered, 2)
        assert np.ptp(found[outside], axis=0).max() == 0


PACKED = """
    // The normal as two numbers of 12 bits, by the octahedron.
    let o = n / (abs(n.x) + abs(n.y) + abs(n.z));
    let folded = (1.0 - abs(o.yx)) * select(vec2<f32>(1.0), vec2<f32>(-1.0), o.xy < vec2<f32>(0.0));
    let q = vec2<u32>(round((0.5 * select(folded, o.xy, o.z >= 0.0) + 0.5) * 4095.0));
    let bytes = vec3<u32>(q.x >> 4u, ((q.x & 15u) << 4u) | (q.y >> 8u), q.y & 255u);
    return vec4<f32>(vec3<f32>(bytes), 255.0) / 255.0;
}
"""


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("texel", "frame", "numbers"),
    [
        (TEXELS[0], "tangent", 0),
        (TEXELS[1], "normal", 0),
        (TEXELS[1], "tangent", 4),
        (TEXELS[0], "tangent", 6),
        (TEXELS[1], "normal", 6),
    ],
)
def test_pixels_of_a_relief_are_those_of_the_replay(
    tmp_path: Path,
    cameras: list[Camera],
    monkeypatch: pytest.MonkeyPatch,
    texel: tuple[int, ...],
    frame: str,
    numbers: int,
) -> None:
    """With morph targets too, whose numbers move the frame."""
    scene, end = studio.SCENE.read_text(encoding="utf-8"), "    return vec4<f32>(color * alpha, alpha);\n}\n"
    assert scene.endswith(end)
    (tmp_path / "scene.wgsl").write_text(scene.removesuffix(end) + PACKED, encoding="utf-8")
    monkeypatch.setattr(studio, "SCENE", tmp_path / "scene.wgsl")
    monkeypatch.setattr(studio, "SUPERSAMPLING", 1)
    pose, plain = Pose(0, 0.45), with_relief(tmp_path, texel)
    if numbers:
        weights = (0.9, -0.7)
        source = morphed(plain, tmp_path / "morphed.glb", weights=[*weights])
        character, *_ = by_numbers(source, tmp_path, numbers, frame, weights, pose)
    else:
        character = Character(baked(plain, tmp_path, frame), pose)
    red, green, blue = np.moveaxis(
        drawn(character.path, tmp_path / "picture.png", "--time", "0.45"), 2, 0
    ).astype(int)
    high = np.stack([(red << 4) | (green >> 4), ((green & 15) << 8) | blue], axis=-1) / 4095 * 2 - 1
    matrix = cameras[0].projected(YAW, SIZE[0] / SIZE[1])
    apart = relief_angles(character, Algorithm.LBS_ACCURATE, texel, matrix, unfolded(high))
    assert len(apart) > 1_000
    assert np.percentile(apart, 99) < 0.2  # degrees


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_each_mode_and_side_is_another_picture(tmp_path: Path) -> None:
    found = [drawn(TUBE, tmp_path / f"{mode}.png", "--mode", mode, "--split") for mode in MODES]
    for number, one in enumerate(found):
        assert np.abs(one[:, : SIZE[0] // 2 - 1] - one[:, SIZE[0] // 2 + 1 :]).max() > 40
        for other in found[:number]:
            assert np.abs(one - other).max() > 40


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_close_up_shows_the_improvement_in_more_pixels(tmp_path: Path) -> None:
    shares = []
    for number, options in enumerate([[], ["--closeup"]]):
        standard, accurate = (
            drawn(TUBE, tmp_path / f"{number}{one}.png", "--mode", "normals", "--lighting", one, *options)
            for one in ("standard", "accurate")
        )
        differs = np.abs(standard - accurate).max(axis=2) > 16
        shares.append(differs.mean())
    assert shares[1] > 3 * shares[0]
    middle = tuple(slice(side // 4, 3 * side // 4) for side in differs.shape)
    assert differs[middle].mean() > 1.2 * differs.mean()
    result = invoke("render", TUBE, "-o", tmp_path / "a.png", "--size", "400x200", "--closeup", "--split")
    found = re.search(r'clip "bend" at 0\.\d\d s, close up on .*?: ([\d.]+)° → ([\d.]+)°', result.stdout)
    assert found is not None, result.output
    assert float(found[1]) > 8 * float(found[2])


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_close_up_that_moves_follows_its_place(tmp_path: Path) -> None:
    """The end of the tube swings far out of a picture that stands still."""
    target = tmp_path / "clip.webp"
    result = invoke("render", TUBE, "-o", target, "--size", "96x96", "--closeup", "--mode", "normals")
    assert result.exit_code == 0, result.output
    assert '19 pictures, clip "bend", close up on ' in result.stdout
    with Image.open(target) as image:
        empty = np.asarray(image.convert("RGB"), np.float64)[0, 0]
        for number in range(19):
            image.seek(number)
            middle = np.asarray(image.convert("RGB"), np.float64)[44:52, 44:52]
            assert np.abs(middle - empty).max(axis=2).min() > 8, number


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_close_up_shows_a_place_of_meshes_that_equal_skins_draw(tmp_path: Path) -> None:
    """Two skins of the same joints draw a prism each: both prisms are measured under both."""
    source = model("asset-generator/Animation_Skin/Animation_Skin_07.gltf")
    result = invoke("render", source, "-o", tmp_path / "a.png", "--size", "64x48", "--closeup")
    assert result.exit_code == 0, result.output
    assert "close up on joint0" in result.stdout


@pytest.mark.usefixtures("device")
def test_a_close_up_may_be_of_a_moment_that_is_asked_for(tmp_path: Path) -> None:
    options = ("--size", "64x48", "--closeup", "--time", "0.6")
    result = invoke("render", TUBE, "-o", tmp_path / "a.png", *options)
    assert result.exit_code == 0, result.output
    assert "at 0.60 s, close up on" in result.stdout


@pytest.mark.usefixtures("device")
def test_a_close_up_needs_a_moment_in_which_the_bake_shows(tmp_path: Path) -> None:
    result = invoke("render", TUBE, "-o", tmp_path / "a.png", "--closeup", "--time", "0")
    assert result.exit_code == exit_codes.INPUT
    assert "no clip has a place where the bake shows: leave out --closeup" in " ".join(result.stderr.split())
    assert not (tmp_path / "a.png").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_the_same_file_gives_the_same_bytes_and_nothing_else_is_written(tmp_path: Path) -> None:
    for name in ("one.png", "other.png"):
        drawn(TUBE, tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "other.png").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"one.png", "other.png"}


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_render_says_whether_it_baked_the_file_itself(tmp_path: Path) -> None:
    assert invoke("bake", TUBE, "-o", tmp_path / "baked.glb").exit_code == 0
    for name, end in ((TUBE, " s, baked in memory\n"), (tmp_path / "baked.glb", " s\n")):
        result = invoke("render", name, "-o", tmp_path / "tube.png", "--size", "64x48")
        assert result.exit_code == 0
        assert result.stdout.endswith(end)


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_clip_becomes_an_animation(tmp_path: Path, suffix: str) -> None:
    target = tmp_path / f"clip{suffix}"
    result = invoke("render", TUBE, "-o", target, "--size", "64x48")
    assert result.exit_code == 0
    assert '19 pictures, clip "bend"' in result.stdout
    with Image.open(target) as image:
        assert image.size == (64, 48)
        assert getattr(image, "n_frames", 1) == 19


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_turntable_turns_one_pose(tmp_path: Path) -> None:
    target = tmp_path / "turn.webp"
    result = invoke(
        "render", FOLDER / "seam.glb", "-o", target, "--size", "64x48", "--turntable", "--mode", "normals"
    )
    assert result.exit_code == 0
    assert "60 pictures, random poses (no clip moves it) at " in result.stdout
    with Image.open(target) as image:
        first = np.asarray(image.convert("RGB"), np.float64)
        image.seek(20)
        assert np.abs(np.asarray(image.convert("RGB"), np.float64) - first).max() > 60


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("mode", ["normals", "error"])
@pytest.mark.parametrize("has_clip", [True, False])
def test_what_hangs_on_a_joint_is_drawn_as_if_it_were_skinned_to_it(
    tmp_path: Path, has_clip: bool, mode: str
) -> None:
    """A copy of the tube hangs on its last joint, or has a skin and weights that do the same."""
    seen = []
    for is_skinned in (False, True, None):
        file = Editable(TUBE)
        content, (skin,) = file.content, file.content["skins"]
        if not has_clip:
            del content["animations"]
        (primitive,) = content["meshes"][0]["primitives"]
        inverse = read(TUBE).matrices(skin["inverseBindMatrices"])
        bare = {name: number for name, number in primitive["attributes"].items() if name[-2:] != "_0"}
        count = content["accessors"][bare["POSITION"]]["count"]
        joints: Any = np.tile(np.array([2, 0, 0, 0], np.uint8), (count, 1))
        weights = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
        moved = {"JOINTS_0": file.add(joints), "WEIGHTS_0": file.add(weights)}
        content["accessors"][moved["JOINTS_0"]]["componentType"] = 5121
        content["meshes"].append(
            {"primitives": [{**primitive, "attributes": {**bare, **(moved if is_skinned else {})}}]}
        )
        node: JsonObject = {"mesh": 1}
        content["nodes"].append(node)
        if is_skinned:
            node["skin"] = 0
            content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)
        elif is_skinned is False:
            node["matrix"] = inverse[2].T.ravel().tolist()
            content["nodes"][skin["joints"][2]].setdefault("children", []).append(len(content["nodes"]) - 1)
        path = file.write(tmp_path / f"{is_skinned}.glb")
        options = ["--time", "0.4"] if has_clip else []
        seen.append(drawn(path, path.with_suffix(".png"), "--mode", mode, *options))
    hanging, skinned, without = seen
    assert np.abs(hanging - without).max(axis=2).astype(bool).mean() > 0.02
    if mode == "normals":
        assert (np.abs(hanging - skinned).max(axis=2) > 6).mean() < 0.002
    else:
        unknown, colours = np.array([139.0, 147.0, 160.0]), np.linalg.norm(hanging, axis=2, keepdims=True)
        apart = np.linalg.norm(hanging / colours - unknown / np.linalg.norm(unknown), axis=2)
        assert (apart < 0.015).mean() > 0.02, "nothing is known of its error"


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_mesh_without_a_skin_that_is_broken_is_left_out(tmp_path: Path) -> None:
    def add_prop(content: JsonObject) -> None:
        (primitive,) = content["meshes"][0]["primitives"]
        content["meshes"].append(
            {"primitives": [{"attributes": {"POSITION": primitive["attributes"]["WEIGHTS_0"]}}]}
        )
        content["nodes"].append({"mesh": 1})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    path = edited("bent_tube.glb", tmp_path, add_prop)
    for source, words in (
        (path, "1 mesh without a skin cannot be read: left out of the picture"),
        (TUBE, ""),
    ):
        result = invoke("render", source, "-o", tmp_path / "a.png", "--size", "64x48", "--time", "0.5")
        assert (result.exit_code, "without a skin" in result.stderr) == (0, bool(words))
        assert words in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenes", "drawn"),
    [
        ({"scenes": [{"nodes": [0, 1]}, {"nodes": [1, 6]}], "scene": 1}, [1]),
        ({"scenes": [{}, {"nodes": [4]}, {"nodes": [1, 5]}, {"nodes": [0, 1]}], "scene": 1}, [1]),
        ({"scenes": [{"nodes": [4]}, {"nodes": [0, 1]}]}, [0]),
        ({"scenes": [{"nodes": [0, 1, 5]}], "scene": 9}, [0, 1]),
        ({"scenes": [{"nodes": [4]}]}, [0, 1]),
        ({"scenes": [{"nodes": "all"}, {"nodes": [None, 70, -1]}], "scene": -1}, [0, 1]),
        ({"scenes": "all"}, [0, 1]),
        ({}, [0, 1]),
    ],
)
def test_the_scene_with_a_character_is_drawn(
    tmp_path: Path, scenes: dict[str, Any], drawn: list[int]
) -> None:
    """Node 0 draws a character with skin 0, node 5, a child of 6, with skin 1; the page chooses alike."""
    file = Editable(baked(TUBE, tmp_path))
    file.content["nodes"] += [{"name": "nothing"}, {"mesh": 0, "skin": 1}, {"children": [5]}]
    file.content["skins"].append(file.content["skins"][0])
    for name in ("scene", "scenes"):
        del file.content[name]
    file.content.update(scenes)
    document = read_document(str(file.write(tmp_path / "scenes.glb")))
    assert render.small_pictures(document)
    assert [draw.skin for draw in Scene(document, sound_views(document)).shown()] == drawn


def test_the_help_tells_the_bounds_of_the_size() -> None:
    assert "from 16 to 2048" in " ".join(invoke("render", "--help").stdout.split())


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["-o", "picture.jpg"], exit_codes.USAGE, "expected a name that ends in .png, .webp, .gif"),
        (["-o", "picture.png", "--turntable"], exit_codes.USAGE, "--turntable needs a name that ends in"),
        (
            ["-o", "picture.png", "--split", "--lighting", "standard"],
            exit_codes.USAGE,
            "leave out --lighting",
        ),
        (["-o", "picture.png", "--size", "9x9"], exit_codes.USAGE, "expected a size like 960x600"),
        (["-o", "picture.png", "--size", "2049x16"], exit_codes.USAGE, "each side from 16 to 2048"),
        (["-o", "picture.png", "--size", "2048x15"], exit_codes.USAGE, "each side from 16 to 2048"),
        (["-o", "picture.png", "--size", "large"], exit_codes.USAGE, "expected a size like 960x600"),
        (["-o", "picture.png", "--time", "nan"], exit_codes.USAGE, "expected a number, found nan"),
        (["-o", "picture.png", "--clip", "jump"], exit_codes.USAGE, "the file has no such clip; it has bend"),
        (["-o", "picture.png", "--time", "99"], exit_codes.USAGE, 'clip "bend" goes from 0 to'),
        (["-o", "picture.png", "--time", "-1"], exit_codes.USAGE, 'clip "bend" goes from 0 to'),
    ],
)
def test_render_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], code: int, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke("render", TUBE, *options)
    assert result.exit_code == code
    assert words in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_clips_are_listed_without_their_control_characters(tmp_path: Path) -> None:
    def many(content: JsonObject) -> None:
        clip = content["animations"][0]
        content["animations"] = [{**clip, "name": f"\x1b[2J{number}"} for number in range(300)]

    path = edited("bent_tube.glb", tmp_path, many)
    with pytest.raises(ChoiceError) as caught:
        render.render_file(str(path), "a.png", render.RenderOptions(Look(64, 48), clip="walk"))
    message = str(caught.value)
    assert "it has \\x1b[2J0, \\x1b[2J1, " in message
    assert message.endswith(", \\x1b[2J19, 280 more")


def test_a_picture_replaces_pictures_only(tmp_path: Path) -> None:
    target = tmp_path / "picture.png"
    target.write_bytes(b"glTF, under a name that is not its own")
    result = invoke("render", TUBE, "-o", target)
    assert result.exit_code == exit_codes.USAGE
    assert "exists and is not a PNG, WebP or GIF; choose another name" in " ".join(result.stderr.split())
    assert target.read_bytes().startswith(b"glTF")


def test_a_picture_that_links_to_a_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "hero.gltf").write_text("")
    (tmp_path / "picture.png").symlink_to(tmp_path / "hero.gltf")
    result = invoke("render", TUBE, "-o", tmp_path / "picture.png")
    assert result.exit_code == exit_codes.USAGE
    assert "is the name of a model" in " ".join(result.stderr.split())


@pytest.mark.slow
@pytest.mark.parametrize("former", ["PNG", "WEBP", "GIF", ""])
def test_a_picture_of_any_kind_is_replaced(tmp_path: Path, device: None, former: str) -> None:
    target = tmp_path / "picture.png"
    target.touch()
    if former:
        Image.new("RGB", (4, 4)).save(target, former)
    drawn(TUBE, target, "--time", "0")
    with Image.open(target) as picture:
        assert picture.size == SIZE


@pytest.mark.parametrize("is_unlit", [False, True])
def test_a_shader_that_would_be_compiled_for_a_minute_is_refused(tmp_path: Path, is_unlit: bool) -> None:
    file = Editable(TUBE)
    if is_unlit:
        file.content["materials"] = [{"extensions": {"KHR_materials_unlit": {}}}]
        file.primitive()["material"] = 0
    attributes = file.primitive()["attributes"]
    for number in range(1, 17):
        for kind in ("JOINTS", "WEIGHTS"):
            attributes[f"{kind}_{number}"] = attributes[f"{kind}_0"]
    many = file.write(tmp_path / "many.glb")
    result = invoke("render", many, "-o", tmp_path / "out.png", "--size", "64x64")
    assert result.exit_code == exit_codes.INPUT
    remedy = "limit them in the source" if is_unlit else "bake it with --limit-influences 8"
    found = f"it has up to 68 influences for a vertex, and a picture draws 64: {remedy}"
    assert found in " ".join(result.stderr.split())
    assert not (tmp_path / "out.png").exists()


def test_a_model_that_is_too_large_is_refused(tmp_path: Path) -> None:
    """Found by the fuzzer: the camera's matrix was past all floats, and NumPy warned."""
    positions = sheet().attributes["POSITION"].astype(np.float64) * 1e20
    path = write_model(tmp_path / "sheet.glb", [sheet(POSITION=positions.astype(np.float32))])
    result = invoke("render", path, "-o", tmp_path / "picture.png")
    assert result.exit_code == exit_codes.INPUT
    assert "its positions are too large for a renderer" in result.stderr
    assert not (tmp_path / "picture.png").exists()


@pytest.mark.slow
def test_more_vertices_than_a_device_draws_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: None
) -> None:
    class Small(Studio):
        def __init__(self, subjects: Sequence[Subject], camera: Camera) -> None:
            super().__init__(subjects, camera)
            self._device = Mock(limits={"max-storage-buffer-binding-size": 192_000}, wraps=self._device)

    monkeypatch.setattr(render, "Studio", Small)
    result = invoke("render", TUBE, "-o", tmp_path / "picture.png")
    assert result.exit_code == exit_codes.INPUT
    assert "a primitive has 1,518 vertices, and this device draws 1,000: look at it with skinbake view" in (
        " ".join(result.stderr.split())
    )
    assert not (tmp_path / "picture.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 5, 300])
@pytest.mark.parametrize("skinned", [True, False])
def test_triangles_that_cover_the_picture_hundreds_of_times_are_refused(
    times: int, skinned: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40,000 long triangles over each other, 2 MB, took a software driver 16 s."""
    triangles = sheet().indices
    assert triangles is not None
    many = replace(sheet(), indices=np.tile(triangles, (times, 1)))
    parts = [many, sheet()] if skinned else [sheet(), many]

    def stage(content: JsonObject) -> None:
        primitive = content["meshes"][0]["primitives"].pop()
        content["meshes"].append({"primitives": [primitive]})
        for name in ("JOINTS_0", "WEIGHTS_0"):
            del primitive["attributes"][name]
        content["nodes"].append({"mesh": 1})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    path = write_model(tmp_path / "in.glb", parts, change=stage)
    monkeypatch.setattr(render, "Studio", Undrawn)
    result = invoke("render", path, "-o", tmp_path / "out.png", "--clay")
    said = " ".join(result.stderr.split())
    assert result.exit_code == exit_codes.INPUT
    found = re.search(
        "would cover the picture ([0-9]+) times, one over the other, .* at most (24|25) times", said
    )
    if times < 300:
        assert "enough" in said
    else:
        assert found is not None, said
        assert 0.1 * times < int(found[1]) <= times + 1


@pytest.mark.parametrize("times", [1, 100])
def test_vertices_that_nodes_draw_without_a_skin_are_work_each_time(
    times: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """5,000 vertices that 300 nodes draw, 67 KB, took view 9 s."""

    def hang(content: JsonObject) -> None:
        attributes = content["meshes"][0]["primitives"][0]["attributes"]
        content["meshes"].append({"primitives": [{"attributes": {"POSITION": attributes["POSITION"]}}]})
        content["scenes"][0]["nodes"] += range(len(content["nodes"]), len(content["nodes"]) + times)
        content["nodes"] += [{"mesh": 1}] * times

    path = str(write_model(tmp_path / "in.glb", [sheet()], change=hang))
    vertices = len(sheet().attributes["POSITION"])
    monkeypatch.setattr(budget.Cost, "DRAWN_PRIMITIVE", budget.Work())
    monkeypatch.setattr(budget.Cost, "SHOWN_CLIP", budget.Work())
    document = read_document(path)
    assert len(attachments(document)) == times
    assert document.budget.taken.steps == times * vertices
    monkeypatch.setattr(budget, "STEPS", budget.Limit(1, times * vertices - 1 - document.budget.backed))
    with pytest.raises(InputError, match="once more would take"):
        attachments(read_document(path))


@pytest.mark.slow
@pytest.mark.parametrize("call", ["create_texture", "create_buffer_with_data"])
def test_a_device_without_enough_memory_is_told(
    call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: None
) -> None:
    """It was a defect of skinbake."""
    import wgpu

    def fail(**options: Any) -> None:
        error = "Validation Error\n\nCaused by:\n  In wgpuDeviceCreateTexture\n    Not enough memory left.\n"
        raise wgpu.GPUValidationError(error)

    class Full(Studio):
        def __init__(self, subjects: Sequence[Subject], camera: Camera) -> None:
            super().__init__([], camera)
            self._subjects = subjects
            self._indices = [None] * len(subjects)
            self._device = Mock(**{call: fail}, wraps=self._device)

    monkeypatch.setattr(render, "Studio", Full)
    result = invoke("render", TUBE, "-o", tmp_path / "picture.png")
    assert result.exit_code == exit_codes.INPUT
    said = " ".join(result.stderr.split())
    assert (
        "the device cannot hold what is drawn (Not enough memory left.): draw it smaller, by --size" in said
    )
    assert "report it" not in said


class Undrawn:
    """A studio without a device: errors are measured, and nothing is drawn."""

    def __init__(self, subjects: Sequence[Subject], camera: Camera) -> None:
        pass

    def picture(self, *arguments: object) -> None:
        raise InputError("enough")


def measure_errors(path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure the errors that a picture of a file would show. It ends with InputError."""
    monkeypatch.setattr(render, "Studio", Undrawn)
    render.render_file(str(path), str(folder / "a.png"), render.RenderOptions(Look(64, 48, "error")))


@pytest.mark.slow
def test_the_errors_are_those_of_a_pose_that_bends_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clip of the tube bends it by 90° at most."""
    shots: list[Shot] = []

    def kept(self: Undrawn, shot: Shot, *arguments: object) -> None:
        shots.append(shot)
        raise InputError("enough")

    monkeypatch.setattr(Undrawn, "picture", kept)
    with pytest.raises(InputError, match="enough"):
        measure_errors(TUBE, tmp_path, monkeypatch)
    ((matrices,),) = (shot.matrices for shot in shots)
    angles = np.degrees(np.arccos((np.trace(matrices[:, :3, :3], axis1=1, axis2=2) - 1.0) / 2.0))
    assert 85.0 < angles[1] <= 90.01
    means = {}
    for lighting, ((degrees, known),) in shots[0].errors.items():
        assert known.all()
        means[lighting] = float(np.mean(degrees))
    assert 2.0 < means["standard"] < 30.0
    assert 0.0 < means["accurate"] < means["standard"] / 5.0


def test_welding_counts_to_the_memory_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "WELDING", budget.Limit(0, 0))
    with pytest.raises(InputError, match="its vertices have so many copies at one place"):
        measure_errors(FOLDER / "seam.glb", tmp_path, monkeypatch)


@pytest.mark.slow
def test_a_surface_is_welded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search for the worst pose needs the welded surface, and so does the picture of this pose."""
    claimed: list[int] = []
    monkeypatch.setattr(budget.Budget, "welding", lambda self, place: claimed.append)
    with pytest.raises(InputError, match="enough"):
        measure_errors(TUBE, tmp_path, monkeypatch)
    assert len(claimed) == 1


@pytest.mark.parametrize("name", ["weights_u8.glb", "weights_u16.glb"])
def test_slots_that_integer_weights_adopt_tear_no_surface_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Two meshes hold the vertices of one. Their copies adopt other joints, and so their weights differ."""
    operators: list[GradientOperator] = []

    def kept(operator: GradientOperator, *arguments: object, **others: object) -> None:
        operators.append(operator)

    monkeypatch.setattr(scene, "lighting_errors", kept)
    cut = cut_into_meshes(halved(FOLDER / name, tmp_path / "half.glb"), tmp_path / "cut.glb")
    with pytest.raises(InputError, match="enough"):
        measure_errors(cut, tmp_path, monkeypatch)
    vertices = len(read(FOLDER / name).attribute("POSITION"))
    (operator,) = {id(one): one for one in operators}.values()
    assert operator.counts == (vertices, vertices)
    assert len(np.unique(operator.classes)) == vertices


@pytest.mark.parametrize(("module", "package"), [("wgpu", "wgpu"), ("PIL.Image", "Pillow")])
def test_without_its_extra_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, package: str
) -> None:
    monkeypatch.setitem(sys.modules, "wgpu", ModuleType("wgpu"))
    monkeypatch.setitem(sys.modules, module, None)
    result = invoke("render", TUBE, "-o", tmp_path / "picture.png")
    assert result.exit_code == exit_codes.INPUT
    assert f"pictures need {package}, which is missing" in result.stderr
    assert "pip install 'pillow>=10.1' 'wgpu>=0.32'" in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_without_a_device_one_line_says_why_and_what_to_install(tmp_path: Path) -> None:
    """wgpu's reason has several lines."""
    nowhere = {"VK_DRIVER_FILES": "/nowhere", "VK_ICD_FILENAMES": "/nowhere", "WGPU_BACKEND_TYPE": "Vulkan"}
    command = [sys.executable, "-m", "skinbake", "render", str(TUBE), "-o", str(tmp_path / "picture.png")]
    result = subprocess.run(
        command, env={**os.environ, **nowhere}, capture_output=True, text=True, check=False
    )
    assert result.returncode == exit_codes.INPUT
    assert "\\n" not in result.stderr
    assert "): install a driver of Vulkan, like mesa-vulkan-drivers\n" in result.stderr


@pytest.mark.slow
def test_two_halves_have_the_whole_width(tmp_path: Path) -> None:
    """Of an odd width, a pixel was lost."""
    NAGA.require()
    target = tmp_path / "odd.png"
    result = invoke("render", TUBE, "-o", target, "--size", "301x200", "--split", "--time", "0.4")
    assert result.exit_code == 0, result.output
    with Image.open(target) as picture:
        assert picture.size == (301, 200)
