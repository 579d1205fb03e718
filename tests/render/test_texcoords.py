"""Where images lie in a picture: sets of texture coordinates, and KHR_texture_transform."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Layout
from skinbake.commands.shown import tell_unplaced
from skinbake.format.encodings import GradientFormat
from skinbake.freshness.baked_views import sound_views
from skinbake.gltf.document import read_document
from skinbake.render.materials import Materials, sampling
from tests.support import corpus, textured
from tests.support.baked_files import Editable, JsonObject
from tests.support.baking import bake_file
from tests.support.characters import Array
from tests.support.command_line import invoke
from tests.support.models import sheet, write_model
from tests.support.textured import USES, placed_by_extension, placed_by_hand
from tests.support.webgpu import NAGA

TUBE = FOLDER / "bent_tube.glb"
LEVELS = 3
"""Of 255: a GPU interpolates coordinates in float32."""


@pytest.fixture
def device() -> None:
    """Skip where no device draws."""
    NAGA.require()


def baked_by_hand(folder: Path) -> Path:
    target = folder / "baked.glb"
    assert bake_file(placed_by_hand(TUBE, folder / "hand.glb"), target).status == "baked"
    return target


def drawn(path: Path, *options: str) -> Array:
    target = path.with_suffix(".png")
    result = invoke("render", path, "-o", target, "--size", "320x240", "--time", "0.4", *options)
    assert result.exit_code == 0, result.output
    return np.asarray(Image.open(target).convert("RGB"), np.float64)


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("uses", [("base",), ("normal",), ("emissive",), USES], ids="-".join)
def test_a_moved_image_lies_where_the_formula_says(tmp_path: Path, uses: Collection[str]) -> None:
    """Each image has its own set and its own transform; moved by hand, it has neither."""
    found = drawn(placed_by_extension(TUBE, tmp_path / "found.glb", uses))
    wanted = drawn(placed_by_hand(TUBE, tmp_path / "wanted.glb", uses))
    assert np.abs(found - wanted).max() <= LEVELS
    unmoved = drawn(placed_by_hand(TUBE, tmp_path / "unmoved.glb", uses, is_moved=False))
    assert np.abs(found - unmoved).max() > 40


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_normal_map_leans_along_its_own_coordinates(tmp_path: Path) -> None:
    found, wanted = map(drawn, textured.white_in_two_ways(TUBE, tmp_path))
    assert np.abs(found - wanted).max() <= LEVELS


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_the_example_of_the_specification_shows_a_quarter_turned_clockwise(tmp_path: Path) -> None:
    assert textured.quarters_seen(drawn(textured.quartered(tmp_path / "a.glb", textured.EXAMPLE))) == (
        textured.TURNED
    )
    quarter = {"offset": [0, 0.5], "scale": [0.5, 0.5]}
    assert textured.quarters_seen(drawn(textured.quartered(tmp_path / "b.glb", quarter))) == textured.QUARTER


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_an_image_on_a_set_that_is_not_there_is_left_out_with_its_factor(tmp_path: Path) -> None:
    """α and β that are stored as texture coordinates are no such set either."""
    plain = tmp_path / "plain.glb"
    pairs = GradientFormat(layout=Layout.TEXCOORD)
    assert bake_file(TUBE, plain, storage=pairs).status == "baked"
    bare = Editable(plain)
    assert "TEXCOORD_1" in bare.primitive()["attributes"]
    bare.content["materials"] = [{"doubleSided": True}]
    wanted = drawn(bare.write(tmp_path / "bare.glb"), "--lighting", "standard")
    for number in (1, 9):
        file = Editable(plain)
        textured.set_material(file.content, {use: {"texCoord": number} for use in USES})
        found = drawn(file.write(tmp_path / "lost.glb"), "--lighting", "standard")
        assert np.abs(found - wanted).max() <= LEVELS


@pytest.mark.parametrize("number", [1, 9])
def test_an_image_that_is_left_out_is_told_of(tmp_path: Path, number: int) -> None:
    plain = tmp_path / "plain.glb"
    assert bake_file(TUBE, plain, storage=GradientFormat(layout=Layout.TEXCOORD)).status == "baked"
    file = Editable(plain)
    textured.set_material(file.content, {use: {"texCoord": number} for use in USES})
    document = read_document(str(file.write(tmp_path / "lost.glb")))
    (view,) = sound_views(document)
    tell_unplaced(document, view, "picture")
    (notice,) = document.notices
    assert notice.code == "images-unplaced"
    assert notice.message == (
        f"its material puts an image on TEXCOORD_{number}, which the primitive does not have. "
        "The picture shows the primitive without it"
    )
    assert notice.place == view.source.place


def test_an_image_that_is_drawn_is_not_told_of(tmp_path: Path) -> None:
    document = read_document(str(baked_by_hand(tmp_path)))
    for view in sound_views(document):
        tell_unplaced(document, view, "page")
        assert not list(document.notices)


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@corpus.needed
def test_a_character_of_gltfpack_looks_as_before(tmp_path: Path) -> None:
    source = corpus.model("CesiumMan/CesiumMan.glb")
    packed = textured.packed(source, tmp_path / "packed.glb")
    info = packed.content["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    assert info["extensions"][textured.NAME]["scale"] != [1, 1]
    (tmp_path / "plain.glb").write_bytes(source.read_bytes())
    wanted, found = drawn(tmp_path / "plain.glb"), drawn(tmp_path / "packed.glb")
    del info["extensions"]
    garbled = drawn(packed.write(tmp_path / "garbled.glb"))
    covered = np.abs(wanted - drawn(tmp_path / "plain.glb", "--clay")).max(axis=2) > 0
    apart, before = (np.abs(one - wanted)[covered].mean() for one in (found, garbled))
    assert apart < 2
    assert before > 10 * apart


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("offset", [1, -1])
@pytest.mark.parametrize("name", textured.SAMPLERS)
def test_an_image_goes_on_beyond_its_edges_as_its_sampler_says(
    tmp_path: Path, name: str, offset: int
) -> None:
    path, wanted = textured.beyond(tmp_path, name, offset)
    assert textured.quarters_seen(drawn(path)) == wanted


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_pixels_keep_their_edges_where_the_sampler_says_nearest(tmp_path: Path) -> None:
    path, sampler = tmp_path / "a.glb", {"magFilter": 9728}
    assert textured.share_of_pure(drawn(textured.quartered(path, {}, sampler, size=1))) > 0.9
    assert textured.share_of_pure(drawn(textured.quartered(path, {}, size=1))) < 0.6


@pytest.mark.parametrize(
    "change",
    [
        {"samplers": 5},
        {"samplers": [5]},
        {"samplers": []},
        {"textures": [{"source": 0, "sampler": -1}]},
        {"textures": [{"source": 0, "sampler": "0"}]},
    ],
    ids=str,
)
def test_a_sampler_that_is_none_is_as_usual(tmp_path: Path, change: JsonObject) -> None:
    def broken(content: JsonObject) -> None:
        info = {"index": 0}
        content["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": info}}]
        content["images"] = [textured.image([(1, 2, 3)])]
        content["textures"], content["samplers"] = [{"source": 0, "sampler": 0}], [{"wrapS": 33071}]
        content.update(change)

    document = read_document(str(write_model(tmp_path / "sheet.glb", [sheet()], change=broken)))
    assert sampling(Materials(document).of(0, False).textures["base"]) == ("repeat", "repeat", "linear")


def placement(folder: Path, info: object) -> tuple[object, ...]:
    def change(content: JsonObject) -> None:
        content["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": info}}]
        content["images"], content["textures"] = [textured.image([(1, 2, 3)])], [{"source": 0}]

    document = read_document(str(write_model(folder / "sheet.glb", [sheet()], change=change)))
    found = Materials(document).of(0, False).textures["base"]
    return found.texcoord, found.offset, found.rotation, found.scale


@pytest.mark.parametrize("content", textured.BROKEN, ids=str)
def test_broken_values_say_nothing(tmp_path: Path, content: object) -> None:
    info = {"index": 0, "texCoord": 3, "extensions": {textured.NAME: content}}
    assert placement(tmp_path, info) == (3, (0.0, 0.0), 0.0, (1.0, 1.0))


def test_each_value_of_a_texture_transform_is_read_by_itself(tmp_path: Path) -> None:
    told = {"offset": [1, 2], "rotation": "none", "scale": [3, 4], "texCoord": 2.0}
    info = {"index": 0, "texCoord": "first", "extensions": {textured.NAME: told}}
    assert placement(tmp_path, info) == (2, (1.0, 2.0), 0.0, (3.0, 4.0))
    assert placement(tmp_path, {"index": 0, "texCoord": -1, "extensions": []}) == (
        0,
        (0.0, 0.0),
        0.0,
        (1.0, 1.0),
    )
