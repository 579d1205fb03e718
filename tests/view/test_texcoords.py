"""Where images lie on the page: sets of texture coordinates, and KHR_texture_transform."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Layout
from skinbake.format.encodings import GradientFormat
from tests.support import browser, corpus, textured
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import Array
from tests.support.gltf_reading import read
from tests.support.morphed_files import morphed, with_tangents
from tests.support.textured import USES, placed_by_extension, placed_by_hand
from tests.view.pages import picture, shown, take

pytestmark = pytest.mark.slow

TUBE, SPINE = FOLDER / "bent_tube.glb", FOLDER / "two_sets.glb"
LEVELS = 3
"""Of 255: a GPU interpolates coordinates in float32."""


@pytest.fixture(scope="module")
def browsing() -> Iterator[browser.Page]:
    """Open the page of a fixture, on which the tests drop others. Its light stands still."""
    with shown(FOLDER / "weights_u8.glb") as page:
        page.show_as(900, 640, "light")
        page.call(
            """(async () => {
                while (innerWidth !== 900 || canvas.width !== canvas.clientWidth) {
                    await new Promise(requestAnimationFrame); // it takes its new size with a frame
                }
                moving.checked = false;
            })"""
        )
        yield page
        assert page.messages() == []
        assert page.requests() == [page.address]


def drawn(
    page: browser.Page, path: Path, lighting: str = "standard", *, images: bool = True, framed: Any = None
) -> Array:
    """Drop a file on the page, and return its picture (H, W, 3) in the first clip.

    framed are the middle and the radius of what the camera shows; by default those of the file.
    """
    take(page, path)
    page.call(
        """((lighting, images, framed) => {
            application.choose(application.scene.clips[0]);
            application.stopMeasuring();
            application.seek(0.4, true);
            if (framed) application.camera.frame(...framed);
            textures.checked = images;
            for (const side of [left, right]) side.value = lighting;
            application.chooseSides();
            divided.checked = true;
            application.goHome();
        })""",
        lighting,
        images,
        framed,
    )
    return picture(page)[::-1, :, :3].astype(np.float64)


@pytest.mark.parametrize("uses", [("base",), ("normal",), ("emissive",), USES], ids="-".join)
def test_a_moved_image_lies_where_the_formula_says(
    browsing: browser.Page, tmp_path: Path, uses: Collection[str]
) -> None:
    """Each image has its own set and its own transform; moved by hand, it has neither."""
    found = drawn(browsing, placed_by_extension(TUBE, tmp_path / "found.glb", uses))
    wanted = drawn(browsing, placed_by_hand(TUBE, tmp_path / "wanted.glb", uses))
    assert np.abs(found - wanted).max() <= LEVELS
    unmoved = drawn(browsing, placed_by_hand(TUBE, tmp_path / "unmoved.glb", uses, is_moved=False))
    assert np.abs(found - unmoved).max() > 40


def with_everything(folder: Path) -> Path:
    """Bake a model that has every attribute of the page: 8 influences, tangents, colours, morph targets."""
    file = Editable(SPINE)
    normals = file.array("NORMAL").astype(np.float64)
    positions = file.array("POSITION").astype(np.float64)
    tangents = np.cross(normals, np.cross([0.3, 1.0, 0.2], normals))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    colours = 0.6 + 0.4 * np.sin(3 * positions)
    attributes = file.primitive()["attributes"]
    attributes["TANGENT"] = file.add(np.pad(tangents, ((0, 0), (0, 1)), constant_values=1).astype(np.float32))
    attributes["COLOR_0"] = file.add(colours.astype(np.float32))
    plain = file.write(folder / "plain.glb")
    moved = with_tangents(morphed(plain, folder / "morphed.glb", weights=[0.4, 0.3]), 0.2)
    target = folder / "everything.glb"
    assert bake_file(moved, target, frame="tangent").status == "baked"
    return target


@pytest.mark.parametrize("lighting", ["standard", "fitted", "truth"])
def test_three_sets_fit_beside_all_other_attributes(
    browsing: browser.Page, tmp_path: Path, lighting: str
) -> None:
    source = with_everything(tmp_path)
    primitive = read(source).primitive(0)
    assert {"JOINTS_1", "TANGENT", "COLOR_0"} <= primitive["attributes"].keys()
    assert primitive["extras"]["skinbake"]["frame"] == "tangent"
    found = drawn(browsing, placed_by_extension(source, tmp_path / "found.glb"), lighting)
    active, sets = browsing.call(
        """(() => {
            const { gl } = application.renderer;
            const { slots, texcoords } = application.renderer.parts[0].primitive;
            const count = gl.getProgramParameter(gl.getParameter(gl.CURRENT_PROGRAM), gl.ACTIVE_ATTRIBUTES);
            return [count, [slots, texcoords.length]];
        })"""
    )
    assert sets == [8, 3]
    assert active == (16 if lighting == "fitted" else 12)
    wanted = drawn(browsing, placed_by_hand(source, tmp_path / "wanted.glb"), lighting)
    assert np.abs(found - wanted).max() <= LEVELS
    unmoved = drawn(browsing, placed_by_hand(source, tmp_path / "unmoved.glb", is_moved=False), lighting)
    assert np.abs(found - unmoved).max() > 40


def test_a_normal_map_leans_along_its_own_coordinates(browsing: browser.Page, tmp_path: Path) -> None:
    found, wanted = (drawn(browsing, path) for path in textured.white_in_two_ways(TUBE, tmp_path))
    assert np.abs(found - wanted).max() <= LEVELS


@pytest.mark.parametrize("offset", [1, -1])
@pytest.mark.parametrize("name", textured.SAMPLERS)
def test_an_image_goes_on_beyond_its_edges_as_its_sampler_says(
    browsing: browser.Page, tmp_path: Path, name: str, offset: int
) -> None:
    path, wanted = textured.beyond(tmp_path, name, offset)
    assert textured.quarters_seen(drawn(browsing, path)) == wanted


def test_pixels_keep_their_edges_where_the_sampler_says_nearest(
    browsing: browser.Page, tmp_path: Path
) -> None:
    path, sampler = tmp_path / "a.glb", {"magFilter": 9728}
    assert textured.share_of_pure(drawn(browsing, textured.quartered(path, {}, sampler, size=1))) > 0.9
    assert textured.share_of_pure(drawn(browsing, textured.quartered(path, {}, size=1))) < 0.6


def test_the_example_of_the_specification_shows_a_quarter_turned_clockwise(
    browsing: browser.Page, tmp_path: Path
) -> None:
    turned = drawn(browsing, textured.quartered(tmp_path / "a.glb", textured.EXAMPLE))
    assert textured.quarters_seen(turned) == textured.TURNED
    quarter = {"offset": [0, 0.5], "scale": [0.5, 0.5]}
    straight = drawn(browsing, textured.quartered(tmp_path / "b.glb", quarter))
    assert textured.quarters_seen(straight) == textured.QUARTER


def test_an_image_on_a_set_that_is_not_there_is_left_out_with_its_factor(
    browsing: browser.Page, tmp_path: Path
) -> None:
    """α and β that are stored as texture coordinates are no such set either."""
    plain = tmp_path / "plain.glb"
    assert bake_file(TUBE, plain, storage=GradientFormat(layout=Layout.TEXCOORD)).status == "baked"
    assert "TEXCOORD_1" in Editable(plain).primitive()["attributes"]
    for number in (1, 9):
        file = Editable(plain)
        textured.set_material(file.content, {use: {"texCoord": number} for use in USES})
        file.content["materials"][0]["pbrMetallicRoughness"] |= {"roughnessFactor": 0.42}  # as of clay
        path = file.write(tmp_path / "lost.glb")
        found, wanted = drawn(browsing, path), drawn(browsing, path, images=False)
        assert np.abs(found - wanted).max() <= LEVELS


@corpus.needed
def test_a_character_of_gltfpack_looks_as_before(browsing: browser.Page, tmp_path: Path) -> None:
    source = corpus.model("CesiumMan/CesiumMan.glb")
    packed = textured.packed(source, tmp_path / "packed.glb")
    info = packed.content["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    assert info["extensions"][textured.NAME]["scale"] != [1, 1]
    wanted, clay = (drawn(browsing, source, images=images) for images in (True, False))
    # gltfpack samples clips anew: its last pose is another one, and so is the box around all poses.
    framed = browsing.call("(() => [application.camera.middle, application.camera.radius])")
    found = drawn(browsing, tmp_path / "packed.glb", framed=framed)
    del info["extensions"]
    garbled = drawn(browsing, packed.write(tmp_path / "garbled.glb"), framed=framed)
    covered = np.abs(wanted - clay).max(axis=2) > 0
    apart, before = (np.abs(one - wanted)[covered].mean() for one in (found, garbled))
    assert apart < 2
    assert before > 10 * apart


@pytest.mark.parametrize("content", textured.BROKEN, ids=str)
def test_broken_values_say_nothing(browsing: browser.Page, tmp_path: Path, content: object) -> None:
    file = Editable(placed_by_hand(TUBE, tmp_path / "hand.glb"))
    info = file.content["materials"][0]["emissiveTexture"]
    assert info["texCoord"] == 2
    info["extensions"] = {textured.NAME: content}
    take(browsing, file.write(tmp_path / "broken.glb"))
    found, places = browsing.call(
        """(() => {
            const { texcoords, texcoordOf } = application.renderer.parts[0].primitive;
            return [Array.from(texcoords[texcoordOf.emissive].subarray(0, 60)), texcoordOf];
        })"""
    )
    assert places == {"base": 0, "normal": 1, "emissive": 2}
    assert np.array_equal(np.float32(found), file.array("TEXCOORD_2").ravel()[:60])


@pytest.mark.parametrize("alpha", ["MASK", "BLEND"])
def test_holes_stay_holes_in_clay_and_in_every_mode(
    browsing: browser.Page, tmp_path: Path, alpha: str
) -> None:
    covered = []
    for mode in (None, alpha):
        file = Editable(TUBE)
        own = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "doubleSided": False}
        file.content["materials"][0] = own if mode is None else {**own, "alphaMode": mode}
        file.content |= {"images": [textured.with_holes()], "textures": [{"source": 0}]}
        path = file.write(tmp_path / f"{mode}.glb")
        for images in (True, False):
            drawn(browsing, path, images=images)
            browsing.call("(() => { application.ground = [0, 0, 0, 0]; })")
            for name in ("shaded", "reflections", "error", "normals"):
                browsing.call("((name) => document.querySelector(`input[value=${name}]`).click())", name)
                covered.append(picture(browsing)[..., 3] > 20)
            browsing.call("(() => document.querySelector('input[value=shaded]').click())")
    whole, holed = covered[0], covered[8]
    assert holed.sum() < 0.8 * whole.sum()
    for one in covered[8:]:
        assert (one != holed).sum() < 0.08 * whole.sum()  # the edges of holes, where alpha is between
