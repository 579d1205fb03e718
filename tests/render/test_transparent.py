"""What blends in pictures: drawn as three.js draws it, and a body that is solid as a solid body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skinbake.commands import render
from skinbake.render.studio import placed
from skinbake.render.subject import YAW, Camera
from tests.support.characters import Array
from tests.support.command_line import invoke
from tests.support.transparent import LIMBS, SCENES, Primitives, Three, body, share_apart, three
from tests.support.webgpu import NAGA

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("device")]

SIZE = (480, 360)
APART = 0.01
"""The share of pixels, beside edges, that lighting or sampling changes."""


@pytest.fixture
def device() -> None:
    """Skip where no device draws."""
    NAGA.require()


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Three]:
    """Open a page of three.js."""
    with three(tmp_path_factory.mktemp("three")) as page:
        yield page


def drawn(path: Path, time: float, *options: str) -> Array:
    target = path.with_suffix(".png")
    size = "{}x{}".format(*SIZE)
    result = invoke(
        "render", path, "-o", target, "--size", size, "--time", str(time), "--lighting", "standard", *options
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
    cameras: list[Camera] = []

    def kept(positions: Sequence[Array], yaws: Sequence[float]) -> Camera:
        cameras.append(placed(positions, yaws))
        return cameras[-1]

    monkeypatch.setattr(render, "placed", kept)
    path = body(tmp_path / "body.glb", primitives, {"alphaMode": "BLEND", "doubleSided": is_double})
    found = drawn(path, time)
    wanted = drawing.picture(path, time, cameras[0].projected(YAW, SIZE[0] / SIZE[1]), SIZE)
    before = wanted[..., :3] + (1 - wanted[..., 3:] / 255) * found[0, 0]
    assert share_apart(found, before) < APART
