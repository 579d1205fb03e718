"""Small pictures without a device, against the tests' own rasteriser and Pillow's reader of PNG."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fixtures.make_fixtures import FOLDER
from skinbake.commands import render
from skinbake.commands.shown import telling_pose
from skinbake.gltf.document import read_document
from skinbake.render.studio import placed
from skinbake.render.subject import YAW, Camera
from skinbake.render.thumbnail import LIGHT, SIZE, SUPERSAMPLING, Posed, png, thumbnails
from skinbake.skinning.rest import Algorithm
from tests.support.baked_files import Editable
from tests.support.characters import baked
from tests.support.models import bake, sheet, write_model
from tests.support.rasterised import fragments


def pixels(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode == "LA"
        return np.asarray(image)


@pytest.mark.slow
def test_pictures_cover_and_light_what_the_replay_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are alike where both lightings have the same normals, and differ where these do."""
    path = baked(FOLDER / "bent_tube.glb", tmp_path)
    cameras, moments = list[Camera](), list[float]()

    def drawn(surfaces: list[Posed], camera: Camera) -> list[bytes]:
        cameras.append(camera)
        return thumbnails(surfaces, camera)

    def told(*arguments: Any, **options: Any) -> Any:
        found = telling_pose(*arguments, **options)
        moments.append(found[1])
        return found

    monkeypatch.setattr(render, "thumbnails", drawn)
    monkeypatch.setattr(render, "telling_pose", told)
    found = [pixels(data).astype(float) for data in render.small_pictures(read_document(str(path)))]
    assert len(found) == 4
    camera, whole = cameras[0], found[:2]
    matrix = camera.projected(camera.yaws[0], SIZE[0] / SIZE[1])
    size = (SUPERSAMPLING * SIZE[0], SUPERSAMPLING * SIZE[1])
    wanted = [
        fragments(path, algorithm, moments[0], matrix, size)
        for algorithm in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE)
    ]
    share = means(wanted[0].covered.astype(float))
    assert share.mean() > 0.1
    # The tube is open, and the pictures show its inside, which the oracle leaves out.
    assert all((share - one[..., 1] / 255).max() < 0.01 for one in whole)
    assert all((one[..., 1] > 0).mean() < share.mean() + 0.2 for one in whole)
    apart = means(np.abs(wanted[0].normals - wanted[1].normals).max(axis=2))
    changed, inside = np.abs(whole[0][..., 0] - whole[1][..., 0]), share == 1
    assert changed[inside & (apart < 0.002)].max(initial=0) <= 2
    assert changed[inside & (apart > 0.1)].mean() > 5
    assert all(one[..., 0][one[..., 1] == 255].std() > 15 for one in found)
    # Close up, the place fills the picture, and lighting changes more of it.
    assert (found[2][..., 1] > 0).mean() > 1.5 * (whole[0][..., 1] > 0).mean()
    assert np.abs(found[2] - found[3]).mean() > 1.5 * np.abs(whole[0] - whole[1]).mean()


def means(fine: np.ndarray) -> np.ndarray:
    """Return the means of an array over the samples of each pixel."""
    parts = fine.reshape(SIZE[1], SUPERSAMPLING, SIZE[0], SUPERSAMPLING)
    return np.asarray(parts.mean(axis=(1, 3)))


def thumbnail(surfaces: list[Posed], camera: Camera) -> bytes:
    (found,) = thumbnails(surfaces, camera)
    return found


def test_normals_that_lean_away_are_not_turned_to_the_light() -> None:
    """A triangle seen from its front is dark where its normals point away: that is the error to see."""
    corners, triangles = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
    camera = placed([corners], [YAW])
    right = np.tile(camera.axes(YAW)[2], (3, 1))
    data = thumbnails([Posed(corners, np.stack([right, -right]), triangles)], camera)
    lit, wrong = (pixels(one)[SIZE[1] // 2, SIZE[0] // 2, 0] for one in data)
    assert lit > wrong + 60
    turned = pixels(thumbnail([Posed(corners, -right[None], triangles[:, ::-1])], camera))
    assert turned[SIZE[1] // 2, SIZE[0] // 2, 0] == lit


@pytest.mark.slow
def test_the_nearer_surface_hides_the_other() -> None:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    camera = placed([corners], [YAW])
    towards = camera.axes(YAW)[2]
    light = LIGHT @ camera.axes(YAW)
    lit, dark = (np.tile(normal, (1, 4, 1)) for normal in (light, -light))
    near, far = Posed(corners + 0.3 * towards, lit, triangles), Posed(corners, dark, triangles)
    both = [pixels(thumbnail(pair, camera)) for pair in ([near, far], [far, near])]
    assert np.array_equal(both[0], both[1])
    alone = pixels(thumbnail([near], camera))
    centre = (SIZE[1] // 2, SIZE[0] // 2, 0)
    assert both[0][centre] == alone[centre] > pixels(thumbnail([far], camera))[centre] + 60


def test_what_is_not_finite_or_far_away_is_left_out() -> None:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [np.nan, 1e200, np.inf]])
    surface = Posed(corners, np.zeros((1, 4, 3)), np.array([[0, 1, 2], [0, 2, 3]]))
    assert (
        pixels(thumbnail([surface], placed([corners[:3]], [YAW])))[..., 1].max() == 0
    )  # no normal, no shade
    lit = Posed(corners, np.tile([0.0, 0, 1], (1, 4, 1)), surface.triangles)
    assert pixels(thumbnail([lit], placed([corners[:3]], [YAW])))[..., 1].max() == 255


def test_a_png_holds_its_pixels() -> None:
    wanted = np.random.default_rng(1).integers(0, 256, (5, 7, 2), np.uint8)
    assert np.array_equal(pixels(png(wanted)), wanted)


def test_a_file_without_clips_has_a_picture_and_one_that_cannot_be_posed_has_none(tmp_path: Path) -> None:
    path = tmp_path / "baked.glb"
    bake(write_model(tmp_path / "sheet.glb", [sheet()]), path)
    document = read_document(str(path))
    assert render.small_pictures(document)
    broken = document.edited(json={**document.json, "skins": [{"joints": [99]}]})
    assert render.small_pictures(broken) == []


def test_tangents_that_are_far_too_long_cause_no_warning(tmp_path: Path) -> None:
    """Found by the fuzzer, in a file that verify fails and whose report has a small picture all the same."""
    file = Editable(baked(FOLDER / "mirrored_tangent.glb", tmp_path, "tangent"))
    file.array("TANGENT")[:, :3] = 3e38
    document = read_document(str(file.write(tmp_path / "long.glb")))
    assert render.small_pictures(document)  # a warning fails every test
