"""What blends in pictures: drawn as three.js draws it, and a body that is solid as a solid body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skinbake.commands import render
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.scenes import faces_backward
from skinbake.measure.draws import HALF_TURN
from skinbake.render.studio import placed
from skinbake.render.subject import YAW, Camera
from tests.support import corpus
from tests.support.characters import Array
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.transparent import (
    LIMBS,
    REAL,
    SCENES,
    Primitives,
    Three,
    body,
    flat,
    share_apart,
    three,
)
from tests.support.webgpu import NAGA

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("device")]

SIZE, LARGE = (480, 360), (960, 720)
APART = 0.01
"""The share of pixels, beside edges, that lighting or sampling changes."""
FILTERED = 0.02
"""The share of pixels that filtering changes: thin stripes of CesiumMan."""


@pytest.fixture
def device() -> None:
    """Skip where no device draws."""
    NAGA.require()


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Three]:
    """Open a page of three.js."""
    with three(tmp_path_factory.mktemp("three")) as page:
        yield page


def drawn(path: Path, time: float, *options: str, size: tuple[int, int] = SIZE) -> Array:
    target = path.with_suffix(".png")
    sizes = "{}x{}".format(*size)
    result = invoke(
        "render", path, "-o", target, "--size", sizes, "--time", str(time), "--lighting", "standard", *options
    )
    assert result.exit_code == 0, result.output
    return np.asarray(Image.open(target).convert("RGB"), np.float64)


@pytest.mark.parametrize("options", [(), ("--clay",)], ids=["in its colours", "in clay"])
@pytest.mark.parametrize("is_double", [True, False], ids=["seen from both sides", "from one side"])
def test_a_body_that_blends_and_is_solid_looks_like_a_solid_body(
    tmp_path: Path, is_double: bool, options: tuple[str, ...]
) -> None:
    found, wanted = (
        drawn(
            body(tmp_path / "body.glb", LIMBS, {"alphaMode": mode, "doubleSided": is_double}), 0.0, *options
        )
        for mode in ("BLEND", "OPAQUE")
    )
    assert np.abs(found - wanted).max() <= 1


@pytest.mark.parametrize(("primitives", "time", "is_double"), SCENES)
def test_what_blends_is_drawn_as_by_three(
    drawing: Three,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    primitives: Primitives,
    time: float,
    is_double: bool,
) -> None:
    path = body(tmp_path / "body.glb", primitives, {"alphaMode": "BLEND", "doubleSided": is_double})
    assert apart(drawing, path, time, monkeypatch) < APART


@corpus.needed
@pytest.mark.parametrize("source", REAL)
def test_a_character_without_light_is_drawn_as_by_three(
    drawing: Three, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    """Images, factors, colours of vertices, masks and sides, and which surface is before which."""
    path = flat(corpus.require_corpus() / source, tmp_path / "flat.glb")
    moves = bool(read(path).content.get("animations"))  # without a clip, it rests at 0 s
    clip = ["--clip", "0"] if moves else []
    time = 0.2 if moves else 0.0
    assert apart(drawing, path, time, monkeypatch, *clip, size=LARGE) < FILTERED


@corpus.needed
def test_a_moved_image_is_drawn_as_by_three(
    drawing: Three, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = {"offset": [0.3, -0.2], "rotation": 0.7, "scale": [0.9, 0.6]}
    image = {"index": 0, "extensions": {"KHR_texture_transform": moved}}
    material = {"pbrMetallicRoughness": {"baseColorTexture": image}}
    source = corpus.require_corpus() / "public/CesiumMan/CesiumMan.glb"
    path = flat(source, tmp_path / "moved.glb", material=material)
    assert apart(drawing, path, 0.2, monkeypatch, size=LARGE) < FILTERED


def apart(
    drawing: Three,
    path: Path,
    time: float,
    monkeypatch: pytest.MonkeyPatch,
    *options: str,
    size: tuple[int, int] = SIZE,
) -> float:
    """Return the share of a body's pixels in which a picture of it is unlike that of three.js."""
    cameras: list[Camera] = []

    def kept(positions: Sequence[Array], yaws: Sequence[float]) -> Camera:
        cameras.append(placed(positions, yaws))
        return cameras[-1]

    monkeypatch.setattr(render, "placed", kept)
    found = drawn(path, time, *options, size=size)
    projected = cameras[0].projected(YAW, size[0] / size[1])
    if faces_backward(read_document(str(path))):
        projected = projected @ HALF_TURN
    wanted = drawing.picture(path, time, projected, size)
    before = wanted[..., :3] + (1 - wanted[..., 3:] / 255) * found[0, 0]
    return share_apart(found, before, body=wanted[..., 3] > 0)
