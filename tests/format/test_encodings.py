"""α and β in fewer bytes: what is stored, read byte by byte, against the bake in float32."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Encoding
from skinbake.format.encodings import (
    CANDIDATES,
    LARGEST,
    GradientFormat,
    common_scale,
    decoded,
    encoded,
    shortened,
    vertex_bytes,
)
from tests.support import khronos
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import FIXTURES, FOLDER, bake, baked, note, primitives, sheet, write_model

FLOAT_ROUNDING = 2.0**-23
"""Relative: α is stored as float32 by the one bake, and read as float32 from the other."""

SCALED = [Encoding.PACKED8, Encoding.SNORM16]
FORMATS = {Encoding.PACKED8: (5120, "<4b", 127), Encoding.SNORM16: (5122, "<4h", 32767)}
TWO_MATERIALS = "two_primitives.glb"


def vectors(model: GltfFile, accessor: int, form: str) -> list[tuple[int, ...]]:
    """Unpack an accessor with a view of its own, as bake makes them."""
    described = model.content["accessors"][accessor]
    data = model.buffer_view(described["bufferView"])
    assert len(data) == described["count"] * struct.calcsize(form)
    return list(struct.iter_unpack(form, data))


def slots_by_hand(
    model: GltfFile, mesh: int, primitive: int, key: str
) -> tuple[list[list[float]], list[float]]:
    """Return α or β of every vertex by the table in docs/reference/file-format.md, and each scale."""
    found = note(model.content, mesh, primitive)
    assert found is not None
    code, form, limit = FORMATS[found["encoding"]]
    attributes = model.primitive(mesh, primitive)["attributes"]
    sets = []
    for name in found[key]:
        accessor = model.content["accessors"][attributes[name]]
        assert (accessor["type"], accessor["componentType"], accessor["normalized"]) == ("VEC4", code, True)
        sets.append(vectors(model, attributes[name], form))
    values, scales = [], []
    for vertex in zip(*sets, strict=True):
        first, *others = [[max(c / limit, -1.0) for c in integers] for integers in vertex]
        scale = first[3] * first[3] * found["scale"]
        values.append([scale * number for number in [*first[:3], *(n for more in others for n in more)]])
        scales.append(scale)
    return values, scales


def slots_as_float(model: GltfFile, mesh: int, primitive: int, key: str) -> Any:
    found = note(model.content, mesh, primitive)
    assert found is not None
    attributes = model.primitive(mesh, primitive)["attributes"]
    return np.concatenate([model.stored(attributes[name]) for name in found[key]], axis=1).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("encoding", SCALED)
@pytest.mark.parametrize("name", FIXTURES)
def test_every_value_is_within_half_a_step(name: str, encoding: Encoding, tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    plain = baked(FOLDER / name, tmp_path / "plain" / name)
    small = baked(FOLDER / name, tmp_path / name, storage=GradientFormat(encoding))
    limit = FORMATS[encoding][2]
    largest, scales = 0.0, set()
    for mesh, number, _ in primitives(plain.content):
        found = note(small.content, mesh, number)
        assert found is not None
        scales.add(found["scale"])
        for key in ("alpha", "beta"):
            expected = slots_as_float(plain, mesh, number, key)
            values, vertex_scales = slots_by_hand(small, mesh, number, key)
            step = np.array(vertex_scales)[:, None] / limit
            assert (np.abs(values - expected) <= 0.5 * step + FLOAT_ROUNDING * np.abs(expected)).all()
            assert (np.abs(expected).max(axis=1) <= np.array(vertex_scales) * (1 + FLOAT_ROUNDING)).all()
            largest = max(largest, float(np.abs(expected).max()))
    assert scales == {largest}


@pytest.mark.parametrize("encoding", SCALED)
def test_a_vertex_takes_the_bytes_that_are_promised(encoding: Encoding, tmp_path: Path) -> None:
    for name, influences in (("bent_tube.glb", 4), ("two_sets.glb", 8)):
        model = baked(FOLDER / name, tmp_path / name, storage=GradientFormat(encoding))
        size = {Encoding.PACKED8: 2, Encoding.SNORM16: 4}[encoding] * influences
        assert vertex_bytes(encoding, influences) == size
        found = note(model.content)
        assert found is not None
        accessors = [
            model.content["accessors"][model.primitive(0, 0)["attributes"][name]]
            for key in ("alpha", "beta")
            for name in found[key]
        ]
        views = [model.content["bufferViews"][accessor["bufferView"]] for accessor in accessors]
        assert sum(view["byteLength"] for view in views) == size * accessors[0]["count"]
        assert all(view["byteOffset"] % 4 == 0 for view in views)


def best_by_trial(slots: list[float], limit: int, scale: float) -> tuple[list[int], float]:
    """Return the best integers by trying all (docs/reference/file-format.md), and the squared error."""
    largest = max(abs(value) for value in slots)
    if largest == 0.0:
        return [0] * (len(slots) + 1), 0.0
    enough = [w for w in range(1, limit + 1) if (w / limit) ** 2 * scale >= largest]
    tried = []
    for w in enough[:8]:
        own = (w / limit) ** 2 * scale
        integers = [round(limit * value / own) for value in slots]  # halves to even, as the rule says
        error = sum(
            (integer * own / limit - value) ** 2 for integer, value in zip(integers, slots, strict=True)
        )
        tried.append((error, w, integers))
    error, w, integers = min(tried)
    return [*integers[:3], w, *integers[3:]], error


@pytest.mark.parametrize("count", [3, 7])
def test_the_scale_of_a_vertex_is_the_best_of_eight(count: int) -> None:
    generator = np.random.default_rng(7)
    slots = generator.normal(size=(300, count)) * 10.0 ** generator.uniform(-6, 3, size=(300, 1))
    slots[5], slots[6, 1:], slots[7] = 0.0, 0.0, 1e-30
    single = slots.astype(np.float32)
    scale = common_scale([single])
    assert scale == float(np.abs(single).max())
    found = np.concatenate(encoded(single, Encoding.PACKED8, scale), axis=1)
    assert found.dtype == np.int8
    assert CANDIDATES == 8
    for row, values in zip(found.tolist(), single.astype(float).tolist(), strict=True):
        integers, error = best_by_trial(values, 127, scale)
        own = (row[3] / 127) ** 2 * scale
        stored = [*row[:3], *row[4:]]
        squares = sum((c * own / 127 - value) ** 2 for c, value in zip(stored, values, strict=True))
        # Two scales may be equally good but for rounding; then either will do.
        assert row == integers or squares == pytest.approx(error, rel=1e-9)


@pytest.mark.parametrize("encoding", SCALED)
def test_zeros_and_next_to_nothing(encoding: Encoding) -> None:
    slots = np.array([[0, 0, 0], [1e-45, 0, 0], [-1e-38, 1e-38, 0], [3e38, -3e38, 1]], dtype=np.float32)
    scale = common_scale([slots])
    with np.errstate(all="raise", under="ignore"):
        (stored,) = encoded(slots, encoding, scale)
        back = decoded([stored], encoding, scale)
    assert stored[0].tolist() == [0, 0, 0, 0]
    assert stored[1, 3] > 0
    assert stored[3, [0, 3]].tolist() == [LARGEST[encoding], LARGEST[encoding]]
    assert np.isfinite(back.values).all()
    assert (
        np.abs(back.values.astype(float) - slots) <= back.rounding[:, None] + FLOAT_ROUNDING * abs(slots)
    ).all()


@pytest.mark.parametrize("encoding", SCALED)
def test_a_file_of_zeros_has_the_scale_zero(encoding: Encoding) -> None:
    slots = np.zeros((4, 7), dtype=np.float32)
    stored = encoded(slots, encoding, common_scale([slots]))
    assert [part.any() for part in stored] == [False, False]
    assert not decoded(stored, encoding, 0.0).values.any()
    assert common_scale([]) == 0.0


def test_the_least_integer_is_read_as_minus_one() -> None:
    """GlTF 2.0, §3.11: −128 and −127 are both −1; encoded writes no −128, an exporter's own might."""
    stored = np.array([[-128, -127, 127, -128]], dtype=np.int8)
    assert decoded([stored], Encoding.PACKED8, 2.0).values.tolist() == [[-2.0, -2.0, 2.0]]


def test_float32_is_stored_as_it_is() -> None:
    slots = np.arange(14, dtype=np.float32).reshape(2, 7)
    stored = encoded(slots, Encoding.FLOAT32, 3.0)
    assert [part.shape for part in stored] == [(2, 3), (2, 4)]
    back = decoded(stored, Encoding.FLOAT32, 3.0)
    assert (back.values == slots).all()
    assert not back.rounding.any()


@pytest.mark.slow
@pytest.mark.parametrize("encoding", SCALED)
def test_baking_twice_is_baking_once(encoding: Encoding, tmp_path: Path) -> None:
    for name in ("two_sets.glb", TWO_MATERIALS, "foreign_joints.glb"):
        first, second = tmp_path / f"1{name}", tmp_path / f"2{name}"
        bake(FOLDER / name, first, storage=GradientFormat(encoding))
        bake(first, second, storage=GradientFormat(encoding))
        assert second.read_bytes() == first.read_bytes()
        bake(FOLDER / name, second)
        bake(first, first)
        assert second.read_bytes() == first.read_bytes()


def test_primitives_share_one_scale_although_their_own_differ(tmp_path: Path) -> None:
    """The second is the first at half the size, where weights change twice as fast."""
    positions = sheet().attributes["POSITION"]
    path = write_model(tmp_path / "model.glb", [sheet(), sheet(POSITION=positions / np.float32(2))])
    plain = baked(path, tmp_path / "plain.glb")
    small = baked(path, tmp_path / "small.glb", storage=GradientFormat(Encoding.PACKED8))
    own = [
        max(float(np.abs(slots_as_float(plain, 0, number, key)).max()) for key in ("alpha", "beta"))
        for number in range(2)
    ]
    noted = [(note(small.content, 0, number) or {})["scale"] for number in range(2)]
    assert own[1] > 1.5 * own[0] > 0.0
    assert noted == [max(own), max(own)]
    assert math.isclose(np.float32(noted[0]), noted[0], rel_tol=0.0)  # a shader's constant loses nothing


@pytest.mark.slow
def test_the_validator_finds_nothing(tmp_path: Path) -> None:
    written = []
    for encoding in SCALED:
        for name in FIXTURES:
            target = tmp_path / encoding / name
            target.parent.mkdir(exist_ok=True)
            bake(FOLDER / name, target, storage=GradientFormat(encoding))
            written.append(target)
    reports = khronos.validate_many([*(FOLDER / name for name in FIXTURES), *written])
    for path in written:
        assert not khronos.new_findings(reports[FOLDER / path.name], reports[path])


def test_metadata_of_float32_say_nothing_of_it(tmp_path: Path) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "seam.glb")
    assert not {"encoding", "scale", "layout"} & (note(model.content) or {}).keys()
    assert read(tmp_path / "seam.glb").content == model.content


def test_rounding_beside_a_scale_of_0_stays_as_it_is() -> None:
    alpha, beta = np.array([[1e-17], [0.0]]), np.zeros((2, 1))
    found = shortened(alpha, beta, 0.0)
    assert np.array_equal(found[0], alpha) and np.array_equal(found[1], beta)
