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
from skinbake.gltf.document import read_document
from skinbake.render.studio import placed
from skinbake.render.subject import YAW, Camera
from skinbake.render.thumbnail import SIZE, SUPERSAMPLING, Posed, png, thumbnail
from skinbake.skinning.rest import Algorithm
from tests.support.baked_files import Editable
from tests.support.characters import baked
from tests.support.models import bake, sheet, write_model
from tests.support.rasterised import fragments

MIDDLE = 23 / 48
"""The middle of the tube's clip, in seconds."""


def pixels(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode == "LA"
        return np.asarray(image)


def test_a_thumbnail_covers_what_the_model_covers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = baked(FOLDER / "bent_tube.glb", tmp_path)
    cameras: list[Camera] = []

    def kept(*arguments: Any) -> Camera:
        cameras.append(placed(*arguments))
        return cameras[0]

    monkeypatch.setattr(render, "placed", kept)
    data = render.small_picture(read_document(str(path)))
    assert data is not None
    found = pixels(data)
    assert found.shape == (SIZE[1], SIZE[0], 2)
    matrix = cameras[0].projected(YAW, SIZE[0] / SIZE[1])
    fine = (SUPERSAMPLING * SIZE[0], SUPERSAMPLING * SIZE[1])
    wanted = fragments(path, Algorithm.LBS_ACCURATE, MIDDLE, matrix, fine)
    share = wanted.covered.reshape(SIZE[1], SUPERSAMPLING, SIZE[0], SUPERSAMPLING).mean(axis=(1, 3))
    assert share.mean() > 0.1
    assert np.abs(found[..., 1] / 255 - share).mean() < 0.01
    assert found[..., 0][share == 1].std() > 15


def test_the_nearer_surface_hides_the_other() -> None:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    camera = placed([corners], [YAW])
    towards = camera.axes(YAW)[2]
    lit, dark = (np.tile(normal, (4, 1)) for normal in ([0.35, 0.75, 0.56], [0.2, -0.9, 0.4]))
    near, far = Posed(corners + 0.3 * towards, lit, triangles), Posed(corners, dark, triangles)
    both = [pixels(thumbnail(pair, camera)) for pair in ([near, far], [far, near])]
    assert np.array_equal(both[0], both[1])
    alone = pixels(thumbnail([near], camera))
    centre = (SIZE[1] // 2, SIZE[0] // 2, 0)
    assert both[0][centre] == alone[centre] > pixels(thumbnail([far], camera))[centre] + 60


def test_what_is_not_finite_or_far_away_is_left_out() -> None:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [np.nan, 1e200, np.inf]])
    surface = Posed(corners, np.zeros((4, 3)), np.array([[0, 1, 2], [0, 2, 3]]))
    assert (
        pixels(thumbnail([surface], placed([corners[:3]], [YAW])))[..., 1].max() == 0
    )  # no normal, no shade
    lit = Posed(corners, np.tile([0.0, 0, 1], (4, 1)), surface.triangles)
    assert pixels(thumbnail([lit], placed([corners[:3]], [YAW])))[..., 1].max() == 255


def test_a_png_holds_its_pixels() -> None:
    wanted = np.random.default_rng(1).integers(0, 256, (5, 7, 2), np.uint8)
    assert np.array_equal(pixels(png(wanted)), wanted)


def test_a_file_without_clips_has_a_picture_and_one_that_cannot_be_posed_has_none(tmp_path: Path) -> None:
    path = tmp_path / "baked.glb"
    bake(write_model(tmp_path / "sheet.glb", [sheet()]), path)
    document = read_document(str(path))
    assert render.small_picture(document) is not None
    broken = document.edited(json={**document.json, "skins": [{"joints": [99]}]})
    assert render.small_picture(broken) is None


def test_tangents_that_are_far_too_long_cause_no_warning(tmp_path: Path) -> None:
    """Found by the fuzzer, in a file that verify fails and whose report has a small picture all the same."""
    file = Editable(baked(FOLDER / "mirrored_tangent.glb", tmp_path, "tangent"))
    file.array("TANGENT")[:, :3] = 3e38
    document = read_document(str(file.write(tmp_path / "long.glb")))
    assert render.small_picture(document) is not None  # a warning fails every test
