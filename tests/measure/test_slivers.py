"""Triangles that are nearly lines have a million times the usual gradient, and an encoding bears them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from skinbake.choices import Encoding
from skinbake.format.encodings import Spread, bearing_scale, common_scale, decoded, encoded, shortened
from tests.support import corpus
from tests.support.baked_files import Answer, verify
from tests.support.models import Part, write_model

SCALED = [Encoding.PACKED8, Encoding.SNORM16]
ROUNDING = 1e-6


def fine_sheet(slivers: int, gap: float = 1e-6, unit: float = 1.0, far: float = 0.0) -> Part:
    """Return a sheet of 20 × 16 vertices, with corners of slivers that lie ``gap`` beside a vertex of it."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-0.6, 0.6, 16)))
    corners = (np.arange(320).reshape(16, 20)[:-1, :-1]).reshape(-1, 1)
    triangles = np.concatenate([corners + np.array(three) for three in ([0, 1, 21], [0, 21, 20])])
    weight = 1.0 / (1.0 + np.exp(-6.0 * x))
    at = 47 + 61 * np.arange(slivers) % 230
    x, y = np.append(x, x[at] + gap), np.append(y, y[at])
    weight = np.append(weight, 1.0 - weight[at])
    more = np.stack([at, 320 + np.arange(slivers), at + 20], axis=1)
    z = 0.2 * np.cos(2.0 * x) * np.cos(y)
    normals = np.stack([0.4 * np.sin(2.0 * x) * np.cos(y), 0.2 * np.cos(2.0 * x) * np.sin(y), 1.0 + 0.0 * x])
    count = len(x)
    return Part(
        {
            "POSITION": (unit * (np.stack([x, y, z], axis=1) + far)).astype(np.float32),
            "NORMAL": (normals / np.linalg.norm(normals, axis=0)).T.astype(np.float32),
            "JOINTS_0": np.tile(np.array([0, 1, 0, 0], np.uint8), (count, 1)),
            "WEIGHTS_0": np.pad(np.stack([1.0 - weight, weight], axis=1), ((0, 0), (0, 2))).astype(
                np.float32
            ),
        },
        np.concatenate([triangles, more]),
    )


def accurate(answer: Answer) -> float:
    return float(answer.file["normals_by_tangents"]["lbs"]["accurate"]["mean"])


CASES = {
    "one": [fine_sheet(1)],
    "several": [fine_sheet(4)],
    "finer": [fine_sheet(2, gap=3e-7)],
    "far from the origin": [fine_sheet(1, gap=1e-5, far=10.0)],
    "in another unit": [fine_sheet(1, unit=1e4)],
    "beside another primitive": [fine_sheet(2), fine_sheet(0)],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {},
        *(
            pytest.param(one, marks=pytest.mark.slow)
            for one in ({"gradients": "surface"}, {"neighbours": "drop"})
        ),
    ],
    ids=str,
)
@pytest.mark.parametrize("parts", CASES.values(), ids=CASES)
def test_slivers_do_not_spoil_the_other_vertices(
    parts: list[Part], options: dict[str, Any], tmp_path: Path
) -> None:
    source = write_model(tmp_path / "sheet.glb", parts)
    errors = []
    for encoding in (Encoding.FLOAT32, Encoding.PACKED8):
        target = tmp_path / f"{encoding}.glb"
        skinbake.bake(source, target, encoding=encoding, **options)
        answer = verify(target)
        assert not answer.failed, answer.messages
        errors.append(accurate(answer))
    assert errors[1] <= 1.05 * errors[0] + 0.01


def test_a_bake_with_slivers_is_undone_and_made_again_to_the_byte(tmp_path: Path) -> None:
    source, baked = write_model(tmp_path / "sheet.glb", [fine_sheet(3)]), tmp_path / "baked.glb"
    skinbake.bake(source, baked, encoding="packed8")
    skinbake.strip(baked, tmp_path / "stripped.glb")
    assert (tmp_path / "stripped.glb").read_bytes() == source.read_bytes()
    skinbake.bake(baked, tmp_path / "again.glb", encoding="packed8")
    assert (tmp_path / "again.glb").read_bytes() == baked.read_bytes()


@corpus.needed
def test_the_sliver_of_the_corpus_costs_packed8_nothing_to_see(tmp_path: Path) -> None:
    source = corpus.require_corpus() / "cases" / "turn4" / "sliver_packed8.glb"
    result = skinbake.bake(source, tmp_path / "baked.glb", encoding="packed8")
    assert result["encoding"]["added_error"]["mean"] < 0.05


@pytest.mark.parametrize("encoding", SCALED)
def test_what_is_beyond_the_scale_keeps_its_direction(encoding: Encoding) -> None:
    random = np.random.default_rng(4)
    given = random.normal(size=(2, 500, 3)).astype(np.float32)
    given[:, :5] *= 1e7
    alpha, beta = given
    scale = bearing_scale([Spread(alpha, beta, np.ones(500))], Encoding.PACKED8)
    assert scale < common_scale([*given])
    sizes = np.abs(given).max(axis=(0, 2))[:, None].astype(float)
    for slots, kept in zip(given, shortened(alpha, beta, scale), strict=True):
        back = decoded(encoded(kept, encoding, scale), encoding, scale)
        wanted = slots * np.minimum(1.0, scale / sizes)
        assert (np.abs(back.values - wanted) <= back.rounding[:, None] + ROUNDING * np.abs(wanted)).all()


def test_usual_values_have_the_largest_as_their_scale() -> None:
    random = np.random.default_rng(5)
    for spread in (0.0, 1.0, 2.0):
        given = random.normal(size=(2, 400, 7)) * 10.0 ** random.uniform(-spread, 0.0, (400, 1))
        given = given.astype(np.float32)
        for encoding in SCALED:
            scale = bearing_scale([Spread(given[0], given[1], np.ones(400))], encoding)
            assert scale == common_scale([*given])


def test_the_least_and_the_largest_numbers_have_a_scale() -> None:
    slots = np.array([[1e-45, 0, 0], [1e-38, 0, 0], [1.0, 0, 0], [3e38, -3e38, 1]], dtype=np.float32)
    for areas in (np.zeros(4), np.ones(4), np.array([1e300, 1.0, 1.0, 1e-300])):
        scale = bearing_scale([Spread(slots, slots, areas)], Encoding.PACKED8)
        assert 0.0 < scale <= common_scale([slots])
        kept, _ = shortened(slots, slots, scale)
        back = decoded(encoded(kept, Encoding.PACKED8, scale), Encoding.PACKED8, scale)
        assert np.isfinite(back.values).all()


class TestLosses:
    """Two primitives whose units are far apart have no scale that serves both."""

    def codes(self, units: tuple[float, ...], encoding: Encoding, folder: Path) -> list[str]:
        source = write_model(folder / "sheets.glb", [fine_sheet(0, unit=unit) for unit in units])
        result = skinbake.bake(source, folder / "baked.glb", encoding=encoding)
        return [notice["code"] for notice in result["warnings"]]

    def test_an_encoding_that_loses_a_tenth_of_the_gain_is_warned_of(self, tmp_path: Path) -> None:
        assert "encoding-costs" in self.codes((1.0, 1e-7), Encoding.PACKED8, tmp_path)

    @pytest.mark.parametrize(
        ("units", "encoding"), [((1.0, 1e-7), Encoding.SNORM16), ((1.0, 1e-2), Encoding.PACKED8)]
    )
    def test_one_that_loses_less_is_not(
        self, units: tuple[float, ...], encoding: Encoding, tmp_path: Path
    ) -> None:
        assert "encoding-costs" not in self.codes(units, encoding, tmp_path)
