"""The page of skinbake view in a browser: what it draws, what it measures, and what it never does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import clip_poses, read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.measure.angles import MeasuredBlock, lighting_errors
from skinbake.skinning.rest import Algorithm
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import truths_at_rest
from tests.support import browser, corpus
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import Array, Character, Placement, Pose, angles
from tests.support.models import edited
from tests.view.pages import DEGREES, normals, picture, shown

TUBE = FOLDER / "bent_tube.glb"
MODES = ("shaded", "reflections", "error", "normals")

CHARACTERS = {
    "bent_tube": ("", 0.45),
    "CesiumMan": ("CesiumMan/CesiumMan.glb", 0.6),
    "Fox": ("Fox/fox.glb", 0.9),
    "RiggedFigure": ("RiggedFigure/RiggedFigure.gltf", 0.7),
    "TRex": ("TRex/trex.gltf", 0.5),
}


@dataclass(frozen=True)
class Browsing:
    """A page in the browser, and the file that it shows: baked with the gradients of the rig."""

    page: browser.Page
    path: Path
    surface: Path
    time: float

    def expected(self, lighting: str) -> Array:
        """Return the normals (V, 3) of the replay under a lighting of the page."""
        path = self.surface if lighting == "surface" else self.path
        algorithms = {"standard": Algorithm.LBS_STANDARD, "dqs": Algorithm.DQS_EXACT}
        algorithm = algorithms.get(lighting, Algorithm.LBS_ACCURATE)
        return Character(path, Pose(0, self.time)).expected(algorithm, Placement()).normals


@pytest.fixture(scope="module", params=CHARACTERS)
def browsing(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browsing]:
    """Open the page of a character."""
    browser.require_browser()
    name, time = CHARACTERS[request.param]
    source = corpus.model(name) if name else TUBE
    folder = tmp_path_factory.mktemp(request.param)
    paths = {}
    for kind in ("fitted", "surface"):
        paths[kind] = folder / f"{source.stem}-{kind}.glb"
        assert bake_file(source, paths[kind], gradients=kind, generate_normals=True).status == "baked"
    with shown(paths["fitted"]) as page:
        yield Browsing(page, paths["fitted"], paths["surface"], time)
        # Whatever the tests have done to it, the page has said nothing and asked for nothing.
        assert page.messages() == []
        assert page.requests() == [page.address]


@pytest.mark.parametrize("lighting", ["standard", "fitted", "surface", "dqs"])
def test_every_normal_is_that_of_the_replay(browsing: Browsing, lighting: str) -> None:
    found = normals(browsing.page, lighting, clip=0, time=browsing.time)
    assert angles(found, browsing.expected(lighting)).max() < DEGREES
    if lighting != "standard":
        standard = browsing.expected("standard")
        assert np.percentile(angles(found, standard), 99) > 100 * DEGREES


def test_errors_on_the_page_are_those_of_verify(browsing: Browsing) -> None:
    """The page measures true normals by itself, in JavaScript: by triangles, as verify does."""
    found = browsing.page.call(
        """((time) => {
            const { scene } = application;
            application.choose(scene.clips[0]);
            application.stopMeasuring();
            application.seek(time, true);
            application.applyPose();
            right.value = 'truth';
            application.chooseSides();
            application.draw();
            const names = ['standard', 'fitted', 'truth'];
            return Object.fromEntries(names.map((name) => [name, scene.errors(name).mean]));
        })""",
        browsing.time,
    )
    assert found["truth"] < DEGREES
    browsing.page.call("(() => { right.value = 'fitted'; application.chooseSides(); })")
    wanted = errors_by_verify(browsing.path, browsing.time)
    for lighting, name in (("standard", "standard"), ("fitted", "accurate")):
        assert found[lighting] == pytest.approx(wanted[name], rel=0.002), lighting


def test_parts_that_joints_of_scale_0_hide_do_not_count_on_the_page(tmp_path: Path) -> None:
    browser.require_browser()
    model = Editable(TUBE)
    joints, weights = model.array("JOINTS_0"), model.array("WEIGHTS_0")
    inner = (joints == 0) & (weights < 0.5)
    weights[inner] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    model.content["nodes"][model.content["skins"][0]["joints"][1]]["scale"] = [0.0, 0.0, 0.0]
    path = tmp_path / "hidden.glb"
    assert bake_file(model.write(tmp_path / "model.glb"), path).status == "baked"
    wanted = errors_by_verify(path, 0.3)
    with shown(path) as page:
        found = page.call(
            """(() => {
                application.stopMeasuring();
                application.seek(0.3, true);
                application.applyPose();
                application.draw();
                return application.scene.errors('standard').mean;
            })"""
        )
    assert found == pytest.approx(wanted["standard"], rel=0.002)


def errors_by_verify(path: Path, time: float) -> dict[str, float]:
    """Return the mean errors by triangles of one pose, weighted by area at rest."""
    document = read_document(str(path))
    (view,) = baked_views(document, skinned_sources(document))
    operator = gradient_operator([view.now])
    matrices = clip_poses(read_skeleton(document, 0), read_clips(document)[0], np.array([time]))
    corners = view.now.positions[view.now.triangles].astype(np.float64)
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    areas = np.bincount(view.now.triangles.ravel(), np.repeat(sizes, 3), len(view.now.positions))
    sums: dict[str, Any] = {}

    def record(block: MeasuredBlock) -> None:
        here = areas[block.vertex : block.vertex + block.errors.shape[1]] * block.valid[0]
        total = sums.setdefault(block.lighting, [0.0, 0.0])
        total[0] += float((np.where(block.valid[0], block.errors[0], 0.0) * here).sum())
        total[1] += float(here.sum())

    truths = truths_at_rest(operator, [rest_primitive(view)], len(matrices), None, ("triangles",))
    lighting_errors(operator, [rest_primitive(view)], matrices, "lbs", record, at_rest=truths)
    return {lighting: error / area for lighting, (error, area) in sums.items()}


def test_every_mode_draws_something_else(browsing: Browsing) -> None:
    browsing.page.call("((time) => application.seek(time, true))", browsing.time)
    pictures = []
    for mode in MODES:
        browsing.page.call("((mode) => document.querySelector(`input[value=${mode}]`).click())", mode)
        found = picture(browsing.page).astype(int)
        drawn = found[..., 3] > 200
        assert drawn.mean() > 0.02, mode
        assert found[drawn][:, :3].std() > 10, mode
        pictures.append(found)
    for i, one in enumerate(pictures):
        for other in pictures[:i]:
            assert np.abs(one - other).max() > 60
    browsing.page.call("(() => document.querySelector('input[value=shaded]').click())")


def test_the_divider_follows_the_mouse_and_the_keys(browsing: Browsing) -> None:
    page = browsing.page
    page.call(
        "((time) => { application.seek(time, true); document.querySelector('input[value=error]').click(); })",
        browsing.time,
    )
    # While errors are measured, the legend may change, and so all colours.
    page.call("(() => application.stopMeasuring())")
    page.call("(() => divided.click())")
    before = picture(page)
    box = page.call(
        "(() => { canvas.scrollIntoView(); "
        "const { left, top, width, height } = line.getBoundingClientRect(); "
        "return { x: left + width / 2, y: top + height / 3, width: canvas.clientWidth }; })"
    )
    page.drag((box["x"], box["y"]), (0.25 * box["width"], box["y"]))
    assert float(page.call("(() => divider.value)")) == pytest.approx(25, abs=1)
    after = picture(page)
    changed = (before != after).any(axis=2).any(axis=0).nonzero()[0] / before.shape[1]
    assert changed.size
    assert changed.min() > 0.24
    assert changed.max() < 0.51
    page.call("(() => divider.focus())")
    page.press("ArrowRight")
    assert 25 < float(page.call("(() => divider.value)")) < 35
    page.press("End")
    assert page.call("(() => divider.value)") == "100"
    page.call("(() => { application.setSplit(0.5); divided.click(); })")


def test_a_clip_plays_and_its_time_goes_on(browsing: Browsing) -> None:
    times = browsing.page.call(
        """(async () => {
            application.seek(application.clip.start, true);
            play.click();
            const times = [application.time];
            for (let i = 0; i < 6; i++) {
                await new Promise(requestAnimationFrame);
                times.push(application.time);
            }
            play.click();
            return times;
        })"""
    )
    assert len(set(times)) > 3


def test_pointing_at_the_chart_shows_the_pose_and_leaving_it_goes_back(browsing: Browsing) -> None:
    page = browsing.page
    page.call("(() => { chart.scrollIntoView(); application.seek(application.clip.start, true); })")
    box = page.call(
        """(() => {
            const { left, top, width, height } = chart.getBoundingClientRect();
            return [left, top, width, height];
        })"""
    )
    page.move_mouse(box[0] + 0.7 * box[2], box[1] + box[3] / 2)
    start, end, pointed = page.call(
        "(() => [application.clip.start, application.clip.end, application.time])"
    )
    assert 0.5 < (pointed - start) / (end - start) < 0.8
    page.move_mouse(5, 5)
    assert page.call("(() => application.time)") == pytest.approx(start)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extensions", "side"), [({"VRM": {}}, -1), ({"VRM": {}, "VRMC_vrm": {}}, 1), ({}, 1)]
)
def test_the_camera_stands_before_the_character(
    tmp_path: Path, extensions: dict[str, Any], side: int
) -> None:
    """Characters of VRM 0 look along -Z."""
    path = edited("bent_tube.glb", tmp_path, lambda content: content.update(extensions=extensions))
    with shown(path) as page:
        page.call("(() => home.click())")
        eye, target = page.call("(() => [application.camera.eye, application.camera.target])")
    assert np.sign(eye[2] - target[2]) == side
