"""Materials in pictures: images, colours of vertices, morph targets, and images that cannot be had."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fixtures.make_fixtures import FOLDER
from skinbake.gltf.document import read_document
from skinbake.render.materials import CLAY, Materials, decoded
from skinbake.render.studio import MODES, Studio
from skinbake.render.subject import Shot
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import Array
from tests.support.command_line import invoke
from tests.support.models import edited, sheet, write_model
from tests.support.morphed_files import morphed, warped
from tests.support.textured import image, with_holes
from tests.support.webgpu import NAGA

SIZE = "160x120"
TUBE = "bent_tube.glb"


@pytest.fixture
def device() -> None:
    """Skip where no device draws."""
    NAGA.require()


def drawn(path: Path, *options: str) -> Array:
    target = path.with_suffix(".png")
    result = invoke("render", path, "-o", target, "--size", SIZE, "--time", "0.4", *options)
    assert result.exit_code == 0, result.output
    return np.asarray(Image.open(target).convert("RGB"), np.float64)


def tube(folder: Path, material: dict[str, Any], *images: dict[str, str]) -> Path:
    """Return the bent tube with another material, whose textures are these images."""

    def change(content: dict[str, Any]) -> None:
        content["materials"][0] = {"doubleSided": True, **material}
        content["images"] = list(images)
        content["textures"] = [{"source": number} for number in range(len(images))]

    return edited(TUBE, folder, change)


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_an_image_of_one_colour_is_that_factor(tmp_path: Path) -> None:
    """The image holds the linear factors as sRGB has them."""
    red, half = image([(255, 0, 0)] * 2), round(255 * (1.055 * 0.25 ** (1 / 2.4) - 0.055))
    grey = image([(half, half, half)] * 2)
    flat = image([(128, 128, 255)] * 2)
    base = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    plain = drawn(tube(tmp_path, {}))
    for material, pictures, factors in (
        (base, [red], {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}),
        (
            {"emissiveTexture": {"index": 0}, "emissiveFactor": [0, 1, 0.5]},
            [grey],
            {"emissiveFactor": [0, 0.25, 0.125]},
        ),
        ({"normalTexture": {"index": 0}}, [flat], {}),
    ):
        found = drawn(tube(tmp_path, material, *pictures))
        wanted = drawn(tube(tmp_path, factors))
        assert np.abs(found - wanted).max() <= 3
        if factors:
            assert np.abs(found - plain).max() > 40


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_an_image_lies_where_its_coordinates_say_and_clay_hides_it(tmp_path: Path) -> None:
    smooth = {"pbrMetallicRoughness": {"roughnessFactor": 0.42}}
    stripes = image(([(255, 0, 0)] * 32 + [(0, 0, 255)] * 32) * 4)
    base = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    path = tube(tmp_path, base, stripes)
    found = drawn(path)
    ends = [
        drawn(tube(tmp_path, {"pbrMetallicRoughness": {"baseColorFactor": [r, 0, b, 1]}}))
        for r, b in ((1, 0), (0, 1))
    ]
    apart = np.stack([np.abs(found - end).max(axis=2) for end in ends])
    differ = np.abs(ends[0] - ends[1]).max(axis=2) > 60
    each = [(one[differ] < 12).mean() for one in apart]
    assert min(each) > 0.05  # both colours are seen, and between them a blur
    assert sum(each) > 0.2
    assert np.abs(drawn(path, "--clay") - drawn(tube(tmp_path, smooth))).max() <= 1


def tilted(folder: Path, *, by_image: bool, tangents: bool) -> Path:
    """Return a flat sheet that one joint moves, lit as if it leant to the side of growing u."""
    slope = np.array([0.5, 0.2, np.sqrt(1 - 0.29)])
    flat = sheet().attributes["POSITION"] * [1, 1, 0]
    count = len(flat)
    normal = np.array([0.0, 0.0, 1.0]) if by_image else slope
    attributes: dict[str, Any] = {
        "POSITION": flat.astype(np.float32),
        "NORMAL": np.tile(normal, (count, 1)).astype(np.float32),
        "TEXCOORD_0": (flat[:, :2] * [0.4, 0.4] + 0.5).astype(np.float32),
        "JOINTS_0": np.zeros((count, 4), np.uint8),
        "WEIGHTS_0": np.tile([1, 0, 0, 0], (count, 1)).astype(np.float32),
    }
    if tangents:
        attributes["TANGENT"] = np.tile([1, 0, 0, 1], (count, 1)).astype(np.float32)

    def change(content: dict[str, Any]) -> None:
        red, green, blue = (int(value) for value in (slope * 127.5 + 127.5).round())
        content["materials"] = [{"normalTexture": {"index": 0}} if by_image else {}]
        content["images"] = [image([(red, green, blue)] * 2)]
        content["textures"] = [{"source": 0}]

    return write_model(folder / "sheet.glb", [sheet(**attributes)], change=change)


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("tangents", [False, True])
def test_a_normal_map_leans_as_a_normal_would(tmp_path: Path, tangents: bool) -> None:
    pictures = []
    for by_image in (True, False):
        path = tilted(tmp_path, by_image=by_image, tangents=tangents and by_image)
        target = path.with_suffix(".png")
        result = invoke("render", path, "-o", target, "--size", SIZE, "--lighting", "standard")
        assert result.exit_code == 0, result.output
        pictures.append(np.asarray(Image.open(target).convert("RGB"), np.float64))
    assert np.abs(pictures[0] - pictures[1]).max() <= 4
    path = tilted(tmp_path, by_image=True, tangents=False)
    invoke("render", path, "-o", path.with_suffix(".png"), "--size", SIZE, "--clay")
    flat = np.asarray(Image.open(path.with_suffix(".png")).convert("RGB"), np.float64)
    assert np.abs(pictures[0] - flat).max() > 10


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_morph_targets_are_drawn_with_the_weights_of_each_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drawn through targets, the tube is what it is with the sums written into its arrays."""
    plain = tmp_path / "plain.glb"
    assert bake_file(FOLDER / TUBE, plain).status == "baked"
    weights = [0.9, 0.7]
    by_hand = Editable(FOLDER / TUBE)
    positions, normals = (by_hand.array(name).astype(np.float64) for name in ("POSITION", "NORMAL"))
    sums = [np.zeros_like(positions), np.zeros_like(positions)]
    for number, weight in enumerate(weights):
        moved, leant = warped(positions, normals, number)
        sums = [sums[0] + weight * moved, sums[1] + weight * leant]
    turned = normals + sums[1]
    by_hand.array("POSITION")[:] = positions + sums[0]
    by_hand.array("NORMAL")[:] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    options = ("--mode", "normals", "--lighting", "standard")
    wanted = drawn(by_hand.write(tmp_path / "by_hand.glb"), *options)
    path = morphed(plain, tmp_path / "morphed.glb", weights=weights)
    found = drawn(path, *options)
    assert np.abs(found - wanted).mean() < 0.1
    assert np.abs(found - drawn(plain, *options)).max() > 60

    shots: list[Shot] = []

    def kept(studio: Studio, shot: Shot, *rest: Any) -> Any:
        shots.append(shot)
        return picture(studio, shot, *rest)

    picture = Studio.picture
    monkeypatch.setattr(Studio, "picture", kept)
    two = Editable(path)
    two.content["nodes"].append({**two.content["nodes"][0], "weights": [0.0, 0.3]})
    two.content["scenes"][0]["nodes"].append(len(two.content["nodes"]) - 1)
    drawn(two.write(tmp_path / "two.glb"), *options)
    first, second = (shots[0].morphed["accurate"][number].positions for number in (0, 1))
    assert np.allclose(first - positions, sums[0], atol=1e-6)
    assert np.allclose(second - positions, 0.3 * warped(positions, normals, 1)[0], atol=1e-6)


def huge() -> bytes:
    """Return the head of a PNG of 200,000 × 200,000 pixels."""
    head = b"IHDR" + struct.pack(">IIBBBBB", 200_000, 200_000, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def png_of_16_bits(colour: int, rows: Sequence[Sequence[int]], key: Sequence[int]) -> bytes:
    """Return a PNG of a colour type, of rows of samples, and with a transparent colour if there is one."""
    width = len(rows[0]) // {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    lines = b"".join(b"\0" + struct.pack(f">{len(row)}H", *row) for row in rows)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, len(rows), 16, colour, 0, 0, 0))]
    chunks += [(b"tRNS", struct.pack(f">{len(key)}H", *key))] if key else []
    chunks += [(b"IDAT", zlib.compress(lines)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


GREYS = [[0, 0x1234, 0x1334], [0x80FF, 0xFF00, 0xFFFF]]
COLOURS = [[0x1234, 0x80FF, 0xFF00, 0, 0, 0], [0xFFFF, 0x7F00, 0x0100, 0x1234, 0x80FF, 0xFE00]]


@pytest.mark.parametrize(
    ("colour", "rows", "key"),
    [
        (0, GREYS, []),
        (0, GREYS, [0x1234]),
        (0, GREYS, [0]),
        (2, COLOURS, []),
        (2, COLOURS, [0x1234, 0x80FF, 0xFF00]),
        (4, [[0, 0xFFFF, 0x1234, 0x80FF], [0x8080, 0x7F00, 0xFFFF, 0]], []),
        (6, [[0x1234, 0x80FF, 0xFF00, 0x4001], [0, 0xFFFF, 0x7F00, 0xFFFF]], []),
    ],
)
def test_a_png_of_16_bits_is_scaled_to_8(
    tmp_path: Path, colour: int, rows: list[list[int]], key: list[int]
) -> None:
    """A sample v stands for v / 65535: in 8 bits for 255 times that, up to one step."""
    document = read_document(str(write_model(tmp_path / "sheet.glb", [sheet()])))
    found = decoded(png_of_16_bits(colour, rows, key), document)[0].astype(int)
    each = {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    for line, row in zip(found, rows, strict=True):
        pixels = [row[start : start + each] for start in range(0, len(row), each)]
        for pixel, raw in zip(line, pixels, strict=True):
            shades = raw[:3] if each >= 3 else raw[:1] * 3
            alpha = raw[-1] if each in {2, 4} else 0 if raw == key else 0xFFFF
            assert np.abs(pixel - np.array([*shades, alpha]) * 255 / 65535).max() < 1.0, raw


def test_a_wide_grey_png_of_16_bits_is_made_smaller_after_it_is_scaled(tmp_path: Path) -> None:
    document = read_document(str(write_model(tmp_path / "sheet.glb", [sheet()])))
    data = png_of_16_bits(0, [[0x4000] * 4096] * 2, [])
    levels = decoded(data, document)
    assert levels[0].shape == (1, 2048, 4)
    assert (levels[0] == [64, 64, 64, 255]).all()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"images": [{"uri": "gone.png"}], "textures": [{"source": 0}]}, "gone.png"),
        (
            {"images": [{"uri": "data:,no%20picture"}], "textures": [{"source": 0}]},
            "cannot be decoded: it is damaged, or no PNG, JPEG or WEBP",
        ),
        (
            {
                "images": [{"uri": "data:;base64," + base64.b64encode(huge()).decode()}],
                "textures": [{"source": 0}],
            },
            "cannot be decoded",
        ),
        (
            {
                "images": [{"uri": "gone.ktx2"}],
                "textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}],
            },
            "texture 0 is in KTX2, which is not decoded",
        ),
        ({"images": [], "textures": [{"source": 3}]}, '"source" refers to entry 3'),
        ({"images": [{}], "textures": [{"source": 0}]}, "names neither a buffer view nor a file"),
        ({}, "a material names texture 0, and the file has 0"),
    ],
)
def test_an_image_that_cannot_be_had_is_left_out_with_a_notice(
    tmp_path: Path, content: dict[str, Any], words: str
) -> None:
    def change(model: dict[str, Any]) -> None:
        model["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        model.update(content)

    document = read_document(str(write_model(tmp_path / "sheet.glb", [sheet()], change=change)))
    materials = Materials(document)
    made = materials.of(0, False)
    assert (made.base, dict(made.images)) == (CLAY, {})
    materials.tell_missing()
    (notice,) = document.notices
    assert notice.code == "images-missing"
    assert words in notice.message


def test_a_material_of_other_types_is_clay(tmp_path: Path) -> None:
    def change(model: dict[str, Any]) -> None:
        model["materials"] = [
            {"pbrMetallicRoughness": {"baseColorFactor": "red", "baseColorTexture": 7}, "emissiveFactor": [1]}
        ]

    document = read_document(str(write_model(tmp_path / "sheet.glb", [sheet()], change=change)))
    for number in (0, 5, None):
        made = Materials(document).of(number, False)
        assert (made.base, made.emissive) == (CLAY, (0.0, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("alpha", ["MASK", "BLEND"])
def test_holes_stay_holes_in_clay_and_in_every_mode(tmp_path: Path, alpha: str) -> None:
    base = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "doubleSided": False}
    path = tube(tmp_path, {**base, "alphaMode": alpha}, with_holes())
    options: list[list[str]] = [[], ["--clay"], *(["--mode", mode] for mode in MODES if mode != "shaded")]
    pictures = [drawn(path, *one)[:90] for one in options]  # the scale of errors lies below
    covered = [np.abs(one - one[0, 0]).max(axis=2) > 4 for one in pictures]
    whole = drawn(tube(tmp_path, base, with_holes()))[:90]
    assert covered[0].mean() < 0.8 * (np.abs(whole - whole[0, 0]).max(axis=2) > 4).mean()
    for one in covered[1:]:
        assert (one != covered[0]).mean() < 0.03  # the edges of holes, where alpha is between
    red, _, blue = pictures[1][covered[0]].T
    assert np.abs(red - blue).max() < 40, "clay has no colour"
