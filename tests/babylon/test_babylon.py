"""The npm package in Babylon.js, in a browser: normals of real draws against the replay.

The normals are the varying that Babylon.js's own programs hand to fragment shaders, by transform feedback.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import Encoding
from skinbake.format.layouts import GradientFormat
from skinbake.skinning.algorithms import Algorithm
from tests.babylon.stage import DEGREES, Stage, expected, opened_stage
from tests.support import corpus
from tests.support.characters import Pose, angles
from tests.three.drawn import BENT, MIRRORED, RANDOM, TUBE, largest, vectors

pytestmark = pytest.mark.slow

PACKED = GradientFormat(Encoding.PACKED8)
CHARACTERS = [
    pytest.param("CesiumMan/CesiumMan.glb", Pose(0, 0.6), id="CesiumMan"),
    pytest.param("RiggedFigure/RiggedFigure.gltf", Pose(0, 0.7), id="RiggedFigure"),
    pytest.param("RiggedElf/RiggedElf.gltf", Pose(0, 0.5), id="RiggedElf"),
]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with opened_stage(tmp_path_factory.mktemp("babylon")) as stage:
        yield stage


@pytest.fixture
def stage(opened: Stage) -> Stage:
    """The page, of which no earlier test has left a message."""
    opened.page.messages()
    return opened


@pytest.mark.parametrize(("model", "pose"), CHARACTERS)
def test_every_normal_is_that_of_the_replay(stage: Stage, model: str, pose: Pose) -> None:
    character = stage.character(corpus.model(model), pose, storage=PACKED)
    found = stage.normals(character)
    (drawn,) = found["draws"]
    assert largest(drawn, expected(character)) < DEGREES
    assert found["report"] == [["accurate", ""]]
    standard = expected(character, Algorithm.LBS_APPROXIMATED)
    assert np.percentile(angles(vectors(drawn), standard[: len(vectors(drawn))]), 99) > 100 * DEGREES


@pytest.mark.parametrize("left", [False, True], ids=["right", "left"])
@pytest.mark.parametrize("frame", ["normal", "tangent"])
@pytest.mark.parametrize(("source", "pose"), [(TUBE, BENT), (MIRRORED, RANDOM)], ids=["tube", "mirrored"])
def test_both_frames_and_both_hands(stage: Stage, source: Path, pose: Pose, frame: str, left: bool) -> None:
    if frame == "tangent" and source == TUBE:
        pytest.skip("it has no TANGENT")
    character = stage.character(source, pose, frame)
    found = stage.normals(character, left=left)
    assert largest(found["draws"][0], expected(character, left=left)) < DEGREES
    assert found["report"] == [["accurate", ""]]


def test_without_the_module_babylon_has_its_own_normals(stage: Stage) -> None:
    """Else the tests above would not see it."""
    character = stage.character(TUBE, BENT)
    found = stage.normals(character, plugin=False)
    assert largest(found["draws"][0], expected(character, Algorithm.LBS_APPROXIMATED)) < DEGREES
    assert found["report"] == []
