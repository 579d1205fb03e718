"""Files with correctives on the page of ``skinbake view`` and in pictures, against a reader of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skinbake.cli import exit_codes
from skinbake.commands import render
from skinbake.render.studio import Studio
from skinbake.render.subject import YAW, Camera, Subject
from tests.correctives.models import SHEET, parted
from tests.support import browser
from tests.support.baked_files import verify
from tests.support.characters import angles
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.played import drawn
from tests.support.rasterised import covering, eroded
from tests.support.webgpu import NAGA
from tests.view.pages import numbers, shown, take

pytestmark = pytest.mark.slow

DEGREES = 0.01
"""Between the page and the replay: both have float32 targets."""

TIME = 0.37

NORMALS = """((time, lighting) => {
    const { scene, renderer } = application;
    application.choose(scene.clips[0]);
    application.stopMeasuring();
    application.seek(time, true);
    application.applyPose();
    return scene.parts.map((part) => base64Of(renderer.captured(part, lighting).normals));
})"""

CHOICES = """(() => [left, right].map((side) => [
    side.value, [...side.options].filter((option) => !option.disabled).map((option) => option.value),
]))"""


@pytest.fixture(scope="module", params=["face targets", "parts"])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shown")
    source = SHEET if request.param == "face targets" else parted(folder / "parts.glb")
    target = folder / "corrected.glb"
    result = invoke("bake", source, "-o", target, "--correctives", "auto")
    assert result.exit_code == 0, result.output
    return target


@pytest.fixture
def page(path: Path) -> Iterator[browser.Page]:
    """Open the page of a file, for each test anew: a test may drop another file on it."""
    with shown(path) as found:
        yield found


def test_the_page_draws_correctives_as_a_stock_viewer_does(page: browser.Page, path: Path) -> None:
    found = [numbers(text) for text in page.call(NORMALS, TIME, "corrected")]
    expected = list(drawn(path, 0, TIME))
    assert len(found) == len(expected)
    for normals, one in zip(found, expected, strict=True):
        assert angles(normals, one.normals).max() < DEGREES
    standard = [numbers(text) for text in page.call(NORMALS, TIME, "standard")]
    assert max(angles(*pair).max() for pair in zip(found, standard, strict=True)) > 100 * DEGREES


def test_the_page_opens_on_standard_and_corrected_lighting(page: browser.Page) -> None:
    (left, usual), (right, _) = page.call(CHOICES)
    assert (left, right) == ("standard", "corrected")
    assert {"standard", "corrected", "surface", "truth"} <= set(usual)


def test_a_dropped_file_with_correctives_plays_them(page: browser.Page, path: Path) -> None:
    with_gradients = [numbers(text) for text in page.call(NORMALS, TIME, "corrected")]
    take(page, path)
    (_, left), (right, _) = page.call(CHOICES)
    assert right == "corrected"
    assert not {"surface", "fitted"} & set(left)
    dropped = [numbers(text) for text in page.call(NORMALS, TIME, "corrected")]
    for pair in zip(dropped, with_gradients, strict=True):
        assert angles(*pair).max() < DEGREES


def test_the_errors_of_the_page_are_those_of_verify(page: browser.Page, path: Path) -> None:
    take(page, path)
    means = page.call(
        """(() => Array.from({ length: 12 }, (_, i) => {
            application.stopMeasuring();
            const { scene } = application;
            const [clip] = scene.clips;
            scene.pose(clip, clip.start + (clip.end - clip.start) * (i + 0.5) / 12);
            return ['standard', 'corrected'].map((lighting) => scene.errors(lighting).mean);
        }))"""
    )
    figures = verify(path).file["normals_by_triangles"]["lbs"]
    wanted = [figures[lighting]["mean"] for lighting in ("standard", "corrected")]
    assert np.mean(means, axis=0) == pytest.approx(wanted, rel=0.1)


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> list[Camera]:
    """Return the cameras of the pictures that the test draws, where a device draws any."""
    NAGA.require()
    found: list[Camera] = []

    def kept(subjects: Sequence[Subject], camera: Camera) -> Studio:
        found.append(camera)
        return Studio(subjects, camera)

    monkeypatch.setattr(render, "Studio", kept)
    return found


def test_a_picture_has_the_normals_of_correctives(path: Path, cameras: list[Camera], tmp_path: Path) -> None:
    size = 480, 320
    options = ["--mode", "normals", "--time", str(TIME), "--size", "480x320"]
    result = invoke("render", path, "-o", tmp_path / "picture.png", *options)
    assert result.exit_code == 0, result.output
    assert "baked in memory" not in result.stdout
    file = read(path)
    draws = list(drawn(path, 0, TIME))
    draws = [one for one in draws if one.node == draws[0].node]  # the other node draws the same
    positions, normals = (
        np.concatenate([getattr(one, name) for one in draws]) for name in ("positions", "normals")
    )
    starts = np.cumsum([0, *(len(one.positions) for one in draws)])
    triangles = np.concatenate(
        [file.triangles(one.mesh, one.primitive) + start for one, start in zip(draws, starts, strict=False)]
    )
    clip = np.insert(positions, 3, 1, axis=1) @ cameras[0].projected(YAW, size[0] / size[1]).T
    places = (clip[:, :3] / clip[:, 3:] * [1, -1, 1] * 0.5 + 0.5) * [*size, 1]
    covered, corners, shares = covering(places, clip[:, 3], triangles, size)
    inside = eroded(covered, 3)
    assert inside.sum() > 2_000
    wanted = np.einsum("hwk,hwki->hwi", shares, normals[corners])[inside]
    wanted = 127.5 + 127.5 * wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
    result = invoke("render", path, "-o", tmp_path / "standard.png", *options, "--lighting", "standard")
    assert result.exit_code == 0, result.output
    corrected, standard = (
        np.abs(np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB"), np.float64)[inside] - wanted)
        for name in ("picture", "standard")
    )
    assert corrected.mean() < 1.0  # of 255
    assert standard.mean() > 2.0


def test_a_picture_of_a_file_without_correctives_shows_none(tmp_path: Path) -> None:
    result = invoke("render", SHEET, "-o", tmp_path / "picture.png", "--lighting", "corrected")
    assert result.exit_code == exit_codes.USAGE
    assert "--lighting corrected: the file has no correctives" in " ".join(result.stderr.split())
