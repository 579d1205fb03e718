"""Files baked with other encodings and layouts: they verify, and what is done to them is found out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Encoding, Layout
from skinbake.format.encodings import GradientFormat
from tests.support.baked_files import CESIUM_MAN, Editable, JsonObject, source, verify
from tests.support.models import FIXTURES, FOLDER, bake

ALPHA, BETA = "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"
FEW = ("--poses", "random:2", "--method", "lbs")
PACKED8, SNORM16 = GradientFormat(Encoding.PACKED8), GradientFormat(Encoding.SNORM16)
TEXCOORD = GradientFormat(layout=Layout.TEXCOORD)
STORAGES = [
    PACKED8,
    SNORM16,
    TEXCOORD,
    GradientFormat(Encoding.PACKED8, Layout.CUSTOM),
    GradientFormat(layout=Layout.CUSTOM),
]
NAMES = ["packed8", "snorm16", "texcoord", "custom-packed8", "custom"]
QUICK = "packed8"
MODELS = [
    *(name for name in FIXTURES if name.endswith(".glb")),
    CESIUM_MAN,
]

Edit = Callable[[Editable], object]


def written(name: str, folder: Path, storage: GradientFormat) -> Path:
    target = folder / source(name).name
    assert bake(source(name), target, storage=storage).status == "baked"
    return target


def after(edit: Edit, path: Path, *options: str) -> Any:
    model = Editable(path)
    edit(model)
    return verify(model.write(path.with_name("edited.glb")), *FEW, *options)


@pytest.mark.parametrize(
    ("name", "storage"),
    [
        pytest.param(
            name,
            storage,
            id=f"{name}-{label}",
            marks=[] if name == "bent_tube.glb" or label == QUICK else [pytest.mark.slow],
        )
        for name in MODELS
        for storage, label in zip(STORAGES, NAMES, strict=True)
    ],
)
def test_a_fresh_bake_verifies(name: str, storage: GradientFormat, tmp_path: Path) -> None:
    answer = verify(written(name, tmp_path, storage), *FEW)
    assert answer.exit_code == 0, answer.messages


def busy_vertices(model: Editable, count: int = 5) -> list[int]:
    """Return vertices with much to lose: those of the largest scale, apart from one another."""
    order = np.argsort(-model.array(ALPHA)[:, 3].astype(int), kind="stable")
    return [int(vertex) for vertex in order[: 3 * count : 3]]


@pytest.mark.slow
@pytest.mark.parametrize(
    "component", [0, *(pytest.param(other, marks=pytest.mark.slow) for other in (1, 2, 3))]
)
def test_two_steps_of_one_byte_are_found(component: int, tmp_path: Path) -> None:
    """One step may be what rounding is forgiven: half a step. Two are three half steps at least."""
    path = written("bent_tube.glb", tmp_path, PACKED8)
    for vertex in busy_vertices(Editable(path)):

        def edit(model: Editable, vertex: int = vertex) -> None:
            byte = model.array(ALPHA)[vertex]
            byte[component] += -2 if byte[component] > 0 else 2

        (problem,) = after(edit, path).problems("freshness")
        assert (problem["code"], problem["count"]) == ("stale", 1)
        assert f"at 1 of 1,518 vertices, most at vertex {vertex}" in problem["message"]


def test_a_step_of_every_byte_is_found(tmp_path: Path) -> None:
    path = written("bent_tube.glb", tmp_path, PACKED8)

    def edit(model: Editable) -> None:
        bytes_ = model.array(BETA)[:, :3]
        bytes_ += np.where(bytes_ > 0, -1, 1).astype(np.int8)

    (problem,) = after(edit, path).problems("freshness")
    assert problem["count"] > 1518 / 2


def test_snorm16_is_held_to_what_float32_is_held_to(tmp_path: Path) -> None:
    """Its steps are a thirtieth of the 0.1 % that verify forgives float32: a hundred of them show."""
    path = written("bent_tube.glb", tmp_path, SNORM16)
    (vertex, *_) = busy_vertices(Editable(path))
    for change, found in ((-1, False), (-100, True)):

        def edit(model: Editable, change: int = change) -> None:
            values = model.array(ALPHA)[vertex]
            largest = int(np.abs(values[:3].astype(int)).argmax())
            values[largest] += change * np.sign(values[largest])

        assert ("freshness" in after(edit, path).failed) == found


def metadata(**changes: Any) -> Edit:
    def edit(model: Editable) -> None:
        model.metadata().update(changes)
        for name in [name for name, value in changes.items() if value is None]:
            del model.metadata()[name]

    return edit


def test_a_changed_scale_is_found_and_told(tmp_path: Path) -> None:
    path = written("bent_tube.glb", tmp_path, PACKED8)
    scale = Editable(path).metadata()["scale"]
    (problem,) = after(metadata(scale=scale * 1.25), path).problems("freshness")
    assert "No array of it changed since its bake" in problem["message"]


def test_slots_in_another_order_are_stale(tmp_path: Path) -> None:
    def edit(model: Editable) -> None:
        for name in (ALPHA, BETA):
            model.array(name)[:, :3] = model.array(name)[:, [1, 0, 2]]

    (problem,) = after(edit, written("bent_tube.glb", tmp_path, PACKED8)).problems("freshness")
    assert "No array of it changed since its bake" in problem["message"]


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (metadata(scale=None), '"scale" is missing'),
        (metadata(scale=-1.0), '"scale" is -1.0'),
        (metadata(scale=True), '"scale" is true'),
        (metadata(scale="1"), "\"scale\" is '1'"),
        (metadata(encoding="packed9"), "\"encoding\" is 'packed9'"),
        (metadata(encoding=8), '"encoding" is 8'),
        (metadata(encoding=[]), '"encoding" is []'),
        (metadata(layout="attributes "), "\"layout\" is 'attributes '"),
        (metadata(layout="texcoord"), "not an attribute for each influence set"),
    ],
)
def test_damaged_metadata_are_told(edit: Edit, words: str, tmp_path: Path) -> None:
    (problem,) = after(edit, written("seam.glb", tmp_path, PACKED8)).problems("structure")
    assert problem["code"] == "metadata-broken"
    assert words in problem["message"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"encoding": None, "scale": None}, "stored as normalised int8, expected FLOAT"),
        ({"encoding": "snorm16"}, "stored as normalised int8, expected normalised SHORT"),
    ],
)
def test_an_encoding_other_than_noted_is_told(changes: JsonObject, words: str, tmp_path: Path) -> None:
    (problem,) = after(metadata(**changes), written("seam.glb", tmp_path, PACKED8)).problems("structure")
    assert (problem["code"], problem["attribute"]) == ("attribute-format", ALPHA)
    assert words in problem["message"]


def test_integers_that_are_not_normalised_are_told(tmp_path: Path) -> None:
    def edit(model: Editable) -> None:
        del model.content["accessors"][model.primitive()["attributes"][BETA]]["normalized"]

    (problem,) = after(edit, written("seam.glb", tmp_path, PACKED8)).problems("structure")
    assert (problem["code"], problem["attribute"]) == ("attribute-format", BETA)
    assert "stored as int8, expected normalised BYTE" in problem["message"]


def test_metadata_without_the_shared_texture_coordinates_are_told(tmp_path: Path) -> None:
    edit = metadata(beta=["TEXCOORD_8", "TEXCOORD_9"])
    (problem,) = after(edit, written("seam.glb", tmp_path, TEXCOORD)).problems("structure")
    assert problem["code"] == "metadata-broken"
    assert "the set that both share" in problem["message"]


def test_a_texture_coordinate_set_that_is_gone_is_told(tmp_path: Path) -> None:
    def edit(model: Editable) -> None:
        del model.primitive()["attributes"]["TEXCOORD_2"]

    (problem,) = after(edit, written("seam.glb", tmp_path, TEXCOORD)).problems("structure")
    assert (problem["code"], problem["attribute"]) == ("attribute-missing", "TEXCOORD_2")


def test_numbers_in_texture_coordinates_are_held_as_closely_as_others(tmp_path: Path) -> None:
    def edit(model: Editable) -> None:
        model.array("TEXCOORD_2")[:] *= np.float32(1.01)

    path = written("bent_tube.glb", tmp_path, TEXCOORD)
    assert {"TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_2"} <= Editable(path).primitive()["attributes"].keys()
    assert "freshness" in after(edit, path).failed


@pytest.mark.slow
def test_what_all_of_it_is_for(tmp_path: Path) -> None:
    """The error against the true normals grows by no more than the angle that the encoding adds."""
    figures = {}
    for storage in (GradientFormat(), PACKED8):
        path = tmp_path / f"{storage.encoding}.glb"
        result = bake(FOLDER / "bent_tube.glb", path, storage=storage)
        answer = verify(path, "--method", "lbs")
        figures[storage.encoding] = (
            answer.file["normals_by_tangents"]["lbs"]["accurate"]["mean"],
            result.encoding,
        )
    (plain, _), (small, cost) = figures[Encoding.FLOAT32], figures[Encoding.PACKED8]
    assert cost is not None
    assert cost.mean is not None
    assert abs(small - plain) <= cost.mean
