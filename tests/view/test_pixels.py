"""What the page draws, pixel by pixel, against the replay's normals shaded by the same formulas in numpy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.skinning.rest import Algorithm
from tests.support import browser
from tests.support.characters import Array, Character, Pose, baked, by_numbers
from tests.support.mapped import TEXELS, relief_angles, unfolded, with_relief
from tests.support.morphed_files import morphed
from tests.support.rasterised import Fragments, eroded, fragments
from tests.view.pages import picture, shown

TIME = 0.45
MEAN = 2.0
"""Of 255: a pixel has 256 steps, and the GPU interpolates in float32."""
SILHOUETTE = 3
"""Pixels beside an edge of the surface, which antialiasing mixes with others."""
CLAY = np.array([0.60, 0.585, 0.56])


@pytest.fixture(scope="module")
def browsing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[browser.Page, Path]]:
    """Open the page of the fixture, at rest in one pose."""
    path = baked(FOLDER / "bent_tube.glb", tmp_path_factory.mktemp("pixels"))
    with shown(path) as page:
        page.show_as(900, 640, "light")
        page.call(
            """(async (time) => {
                while (innerWidth !== 900 || canvas.width !== canvas.clientWidth) {
                    await new Promise(requestAnimationFrame); // it takes its new size with a frame
                }
                application.stopMeasuring();
                application.seek(time, true);
                for (const id of ['textures', 'moving']) document.getElementById(id).checked = false;
                for (const side of [left, right]) side.value = 'fitted';
                application.chooseSides();
                divided.checked = true;
                application.goHome();
            })""",
            TIME,
        )
        yield page, path


@pytest.mark.parametrize("lighting", ["standard", "fitted"])
@pytest.mark.parametrize("mode", ["shaded", "normals"])
def test_pixels_are_those_of_the_replay(
    browsing: tuple[browser.Page, Path], mode: str, lighting: str
) -> None:
    page, path = browsing
    page.call(
        """((mode, lighting) => {
            for (const side of [left, right]) side.value = lighting;
            application.chooseSides();
            document.querySelector(`input[value=${mode}]`).click();
        })""",
        mode,
        lighting,
    )
    found = picture(page)[::-1].astype(np.float64)
    height, width = found.shape[:2]
    algorithm = Algorithm.LBS_ACCURATE if lighting == "fitted" else Algorithm.LBS_STANDARD
    matrix, eye, axes = page.call(
        """((aspect) => {
            const { camera } = application;
            return [camera.projected(aspect), camera.eye, camera.axes];
        })""",
        width / height,
    )
    drawn = fragments(path, algorithm, TIME, np.array(matrix).reshape(4, 4).T, (width, height))
    wanted = 255 * (
        shaded(drawn, np.array(eye), np.array(axes)) if mode == "shaded" else 0.5 + 0.5 * drawn.normals
    )
    inside = eroded(drawn.covered, SILHOUETTE)
    assert inside.sum() > 10_000
    difference = np.abs(found[..., :3] - wanted)[inside]
    assert difference.mean() < MEAN
    assert np.percentile(difference, 99) < 4 * MEAN


def shaded(drawn: Fragments, eye: Array, studio: Array) -> Array:
    """Return the colours (H, W, 3) of clay under the page's light: GGX, Schlick, a sky, a rim and a softbox.

    studio has right, up and back of the camera as rows.
    """

    def dot(a: Array, b: Array) -> Array:
        return np.asarray((a * b).sum(axis=-1, keepdims=True))

    n = drawn.normals
    v = unit_fields(eye - drawn.positions)
    light, behind = np.array([-0.80, 0.48, 0.36]) @ studio, np.array([0.72, 0.38, -0.58]) @ studio
    h = unit_fields(light + v)
    nl, nh, nv = np.maximum(dot(n, light), 0), np.maximum(dot(n, h), 0), np.maximum(dot(n, v), 1e-3)
    roughness = 0.42
    a2 = roughness**4
    spread = a2 / (nh**2 * (a2 - 1) + 1) ** 2
    k = (roughness + 1) ** 2 / 8
    shine = 0.04 + 0.96 * (1 - np.maximum(dot(v, h), 0)) ** 5
    specular = shine * spread / (4 * (nl * (1 - k) + k) * (nv * (1 - k) + k))
    up = 0.5 + 0.5 * (n @ studio[1])[..., None]
    sky = (1 - up) * np.array([0.10, 0.10, 0.105]) + up * np.array([0.27, 0.29, 0.32])
    rim = np.maximum(dot(n, behind), 0) * (0.35 + 0.65 * (1 - nv) ** 2)
    mirrored = (2 * dot(n, v) * n - v) @ studio.T
    far = np.abs(mirrored[..., :2] / np.maximum(mirrored[..., 2:], 0.05) - np.array([0.62, 0.3]))
    share = np.clip((np.array([0.34, 0.5]) + 0.3 * roughness - far) / (0.6 * roughness), 0, 1)
    box = (share**2 * (3 - 2 * share)).prod(axis=-1, keepdims=True) * (mirrored[..., 2:] >= 0)
    shine = 1.2 * nl * specular + 1.6 * box * (0.05 + 0.95 * (1 - nv) ** 5)
    colour = (
        CLAY * (sky + 1.25 * nl * np.array([1.0, 0.98, 0.94]) + 0.55 * rim * np.array([0.9, 0.95, 1.0]))
        + shine
    )
    toned = colour / (1 + 0.18 * colour)
    return np.asarray(
        np.clip(np.where(toned <= 0.0031308, 12.92 * toned, 1.055 * toned ** (1 / 2.4) - 0.055), 0, 1)
    )


def unit_fields(vectors: Array) -> Array:
    """Return vectors (…, 3) divided by their lengths."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


PACKED = """(() => {
    // The shaded normal as two numbers of 16 bits, by the octahedron.
    const packed = `
    vec3 o = n / (abs(n.x) + abs(n.y) + abs(n.z));
    vec2 e = o.z >= 0.0 ? o.xy : (1.0 - abs(o.yx)) * vec2(o.x < 0.0 ? -1.0 : 1.0, o.y < 0.0 ? -1.0 : 1.0);
    ivec2 q = ivec2(round((0.5 * e + 0.5) * 65535.0));
    result = vec4(q.x >> 8, q.x & 255, q.y >> 8, q.y & 255) / 255.0;`;
    const { renderer } = application;
    const { started } = renderer;
    renderer.started = function (name, texts, captured) {
        if (!name.includes('shaded')) return started.call(this, name, texts, captured);
        const changed = () => {
            const [vertex, fragment] = texts();
            return [vertex, fragment.replace('result = vec4(color * alpha, alpha);', packed)];
        };
        return started.call(this, `packed ${name}`, changed, captured);
    };
})"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lighting", "algorithm", "frame"),
    [("fitted", 3, "tangent"), ("dqs", 6, "tangent"), ("fitted", 3, "normal"), ("dqs", 6, "normal")],
)
def test_pixels_of_a_relief_are_those_of_the_replay(
    tmp_path: Path, lighting: str, algorithm: int, frame: str
) -> None:
    path = baked(with_relief(tmp_path, TEXELS[1]), tmp_path, frame)
    apart = pixels_apart(Character(path, Pose(0, TIME)), lighting, Algorithm(algorithm))
    assert np.percentile(apart, 99) < RELIEF_DEGREES


@pytest.mark.slow
@pytest.mark.parametrize(("numbers", "frame"), [(4, "tangent"), (6, "tangent"), (6, "normal")])
def test_pixels_of_a_relief_follow_the_numbers_of_morph_targets(
    tmp_path: Path, numbers: int, frame: str
) -> None:
    weights = (0.9, -0.7)
    source = morphed(with_relief(tmp_path, TEXELS[1]), tmp_path / "morphed.glb", weights=[*weights])
    character, *_ = by_numbers(source, tmp_path, numbers, frame, weights, Pose(0, TIME))
    apart = pixels_apart(character, "fitted", Algorithm.LBS_ACCURATE)
    assert np.percentile(apart, 99) < RELIEF_DEGREES


def pixels_apart(character: Character, lighting: str, algorithm: Algorithm) -> Array:
    """Return the angles between the mapped normals of the page's pixels and the replay's, in degrees."""
    with shown(character.path) as page:
        page.show_as(900, 640, "light")
        page.call(
            """(async (time, lighting) => {
                while (innerWidth !== 900 || canvas.width !== canvas.clientWidth) {
                    await new Promise(requestAnimationFrame);
                }
                await Promise.all(application.renderer.materials.map((one) => one.loading));
                application.stopMeasuring();
                application.seek(time, true);
                document.getElementById('moving').checked = false;
                for (const side of [left, right]) side.value = lighting;
                application.chooseSides();
                document.querySelector('input[value=shaded]').click();
                divided.checked = true;
                application.goHome();
            })""",
            TIME,
            lighting,
        )
        page.call(PACKED)
        found = picture(page)[::-1].astype(np.int64)
        matrix = page.call(
            "((aspect) => application.camera.projected(aspect))", found.shape[1] / found.shape[0]
        )
    high = (256 * found[..., ::2] + found[..., 1::2]) / 65535 * 2 - 1
    screen = np.array(matrix).reshape(4, 4).T
    apart = relief_angles(character, algorithm, TEXELS[1], screen, unfolded(high))
    assert len(apart) > 4_000
    return apart


RELIEF_DEGREES = 0.2
"""Between the page and the replay. Samples of antialiasing beside edges are another one percent."""
