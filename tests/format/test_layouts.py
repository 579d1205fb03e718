"""α and β under other attributes: where each number stands, and that strip finds what bake put there."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Encoding, Layout
from skinbake.commands.strip import strip_file
from skinbake.errors import InputError
from skinbake.format.encodings import GradientFormat, free_texcoords
from tests.support import khronos
from tests.support.baking import bake_file
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import (
    FIXTURES,
    FOLDER,
    assert_only_added,
    bake,
    baked,
    edited,
    note,
    primitives,
    rewritten,
    sheet,
    write_model,
)

TEXCOORD, CUSTOM = GradientFormat(layout=Layout.TEXCOORD), GradientFormat(layout=Layout.CUSTOM)


def pairs(model: GltfFile, name: str) -> list[tuple[float, float]]:
    """Unpack a set of texture coordinates, which has a view of its own."""
    accessor = model.content["accessors"][model.primitive(0, 0)["attributes"][name]]
    assert (accessor["type"], accessor["componentType"]) == ("VEC2", 5126)
    assert "normalized" not in accessor
    return list(struct.iter_unpack("<2f", model.buffer_view(accessor["bufferView"])))


def numbers(model: GltfFile) -> tuple[Any, Any]:
    """Return α and β of the first primitive of a bake in the usual layout, (V, K − 1) each."""
    found = note(model.content)
    assert found is not None
    attributes = model.primitive(0, 0)["attributes"]
    alpha, beta = (
        np.concatenate([model.stored(attributes[name]) for name in found[key]], axis=1)
        for key in ("alpha", "beta")
    )
    return alpha, beta


class TestTexcoord:
    def test_four_influences_take_three_sets_after_those_that_are_there(self, tmp_path: Path) -> None:
        """α1 α2 | α3 β1 | β2 β3."""
        alpha, beta = numbers(baked(FOLDER / "seam.glb", tmp_path / "plain.glb"))
        model = baked(FOLDER / "seam.glb", tmp_path / "pairs.glb", storage=TEXCOORD)
        own = read(FOLDER / "seam.glb").primitive(0, 0)["attributes"]
        assert list(model.primitive(0, 0)["attributes"]) == [*own, "TEXCOORD_1", "TEXCOORD_2", "TEXCOORD_3"]
        first, second, third = (pairs(model, f"TEXCOORD_{number}") for number in (1, 2, 3))
        for vertex in range(len(alpha)):
            assert first[vertex] == (alpha[vertex, 0], alpha[vertex, 1])
            assert second[vertex] == (alpha[vertex, 2], beta[vertex, 0])
            assert third[vertex] == (beta[vertex, 1], beta[vertex, 2])
        found = note(model.content)
        assert found is not None
        assert found["layout"] == "texcoord"
        assert found["alpha"] == ["TEXCOORD_1", "TEXCOORD_2"]
        assert found["beta"] == ["TEXCOORD_2", "TEXCOORD_3"]

    def test_eight_influences_take_seven(self, tmp_path: Path) -> None:
        alpha, beta = numbers(baked(FOLDER / "two_sets.glb", tmp_path / "plain.glb"))
        model = baked(FOLDER / "two_sets.glb", tmp_path / "pairs.glb", storage=TEXCOORD)
        found = [pairs(model, f"TEXCOORD_{number}") for number in range(7)]
        assert "TEXCOORD_7" not in model.primitive(0, 0)["attributes"]
        for vertex in range(len(alpha)):
            row = [number for texcoords in found for number in texcoords[vertex]]
            assert row == [*alpha[vertex], *beta[vertex]]

    def test_primitives_begin_where_their_own_sets_end(self, tmp_path: Path) -> None:
        coordinates = np.zeros((20, 2), np.float32)
        parts = [sheet(), sheet(TEXCOORD_0=coordinates, TEXCOORD_1=coordinates)]
        path = write_model(tmp_path / "model.glb", parts)
        before, after = read(path), baked(path, tmp_path / "baked.glb", storage=TEXCOORD)
        for number, first in ((0, 0), (1, 2)):
            added = list(after.primitive(0, number)["attributes"])[-3:]
            assert added == [f"TEXCOORD_{first + step}" for step in range(3)]
        assert_only_added(before, after)

    @pytest.mark.parametrize(
        ("there", "added"),
        [
            ([], ["TEXCOORD_0", "TEXCOORD_1"]),
            (["TEXCOORD_1", "TEXCOORD_0"], ["TEXCOORD_2", "TEXCOORD_3"]),
            (["TEXCOORD_9"], ["TEXCOORD_10", "TEXCOORD_11"]),
            (["_TEXCOORD_3", "TEXCOORD_x", "TEXCOORD_3b"], ["TEXCOORD_0", "TEXCOORD_1"]),
        ],
    )
    def test_free_sets_follow_the_last(self, there: list[str], added: list[str]) -> None:
        assert free_texcoords(there, 2) == added

    @pytest.mark.parametrize("extras", [[], "text", {"skinbake": "mine"}])
    def test_extras_of_any_kind_are_kept(self, extras: Any, tmp_path: Path) -> None:
        path = edited(
            "seam.glb", tmp_path, lambda content: content["meshes"][0]["primitives"][0].update(extras=extras)
        )
        model = baked(path, tmp_path / "baked.glb", storage=TEXCOORD)
        assert (note(model.content) or {})["layout"] == "texcoord"
        assert_only_added(read(path), model)

    def test_strip_leaves_sets_that_may_no_longer_be_ours(self, tmp_path: Path) -> None:
        """A tool drops what no material uses, and another adds a set for its light map."""
        bake(FOLDER / "seam.glb", tmp_path / "baked.glb", storage=TEXCOORD)
        model = read(tmp_path / "baked.glb")
        attributes = model.primitive(0, 0)["attributes"]
        del attributes["TEXCOORD_2"], attributes["TEXCOORD_3"]
        rewritten(model, tmp_path / "edited.glb")
        result = strip_file(str(tmp_path / "edited.glb"), str(tmp_path / "out.glb"))
        (notice,) = [notice for notice in result.notices if notice.code != "bytes-left"]
        assert (notice.code, notice.count) == ("texcoords-kept", 1)
        assert "TEXCOORD_1 to TEXCOORD_3, but TEXCOORD_2, TEXCOORD_3 are missing" in notice.message
        stripped = read(tmp_path / "out.glb")
        assert "TEXCOORD_1" in stripped.primitive(0, 0)["attributes"]
        assert note(stripped.content) is None


class TestCustom:
    def test_alpha_and_beta_take_turns(self, tmp_path: Path) -> None:
        for name, count in (("seam.glb", 2), ("two_sets.glb", 4)):
            plain = baked(FOLDER / name, tmp_path / f"plain_{name}")
            model = baked(FOLDER / name, tmp_path / name, storage=CUSTOM)
            added = [name for name in model.primitive(0, 0)["attributes"] if name.startswith("_")]
            assert added == [f"_CUSTOM{number}" for number in range(count)]
            for ours, theirs in (("_CUSTOM0", "_SKINBAKE_ALPHA_0"), ("_CUSTOM1", "_SKINBAKE_BETA_0")):
                found = model.stored(model.primitive(0, 0)["attributes"][ours])
                assert (found == plain.stored(plain.primitive(0, 0)["attributes"][theirs])).all()
            assert (note(model.content) or {})["layout"] == "custom"

    def test_more_than_two_sets_are_refused(self, tmp_path: Path) -> None:
        joints, weights = np.zeros((20, 4), np.uint8), np.zeros((20, 4), np.float32)
        more = {
            f"{kind}_{n}": values
            for n in (1, 2)
            for kind, values in (("JOINTS", joints), ("WEIGHTS", weights))
        }
        path = write_model(tmp_path / "model.glb", [sheet(**more)])
        with pytest.raises(InputError) as raised:
            bake_file(str(path), str(tmp_path / "out.glb"), storage=CUSTOM)
        assert str(raised.value).endswith(
            'model.glb: mesh 0 "sheet", primitive 0: it has 3 influence sets, and --layout custom holds 2: '
            "use --layout attributes"
        )
        assert not (tmp_path / "out.glb").exists()

    def test_a_name_that_is_taken_is_an_error(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "model.glb", [sheet(_CUSTOM1=np.zeros((20, 4), np.float32))])
        with pytest.raises(InputError, match="it already has an attribute _CUSTOM1") as raised:
            bake_file(str(path), str(tmp_path / "out.glb"), storage=CUSTOM)
        assert "choose other names with --layout" in str(raised.value)


@pytest.mark.parametrize(
    "storage",
    [
        TEXCOORD,
        *(
            pytest.param(one, marks=pytest.mark.slow)
            for one in (CUSTOM, GradientFormat(Encoding.PACKED8, Layout.CUSTOM))
        ),
    ],
)
@pytest.mark.parametrize("name", FIXTURES)
def test_only_additions_and_the_same_again(name: str, storage: GradientFormat, tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    first, second = tmp_path / name, tmp_path / "again" / name
    assert_only_added(read(FOLDER / name), baked(FOLDER / name, first, storage=storage))
    bake(first, second, storage=storage)
    assert second.read_bytes() == first.read_bytes()


@pytest.mark.slow
def test_the_validator_finds_nothing(tmp_path: Path) -> None:
    written = []
    for layout in (Layout.TEXCOORD, Layout.CUSTOM):
        for name in FIXTURES:
            target = tmp_path / layout / name
            target.parent.mkdir(exist_ok=True)
            bake(FOLDER / name, target, storage=GradientFormat(layout=layout))
            written.append(target)
    reports = khronos.validate_many([*(FOLDER / name for name in FIXTURES), *written])
    for path in written:
        assert not khronos.new_findings(reports[FOLDER / path.name], reports[path])


@pytest.mark.slow
def test_two_bakes_of_one_file_differ_in_additions_only(tmp_path: Path) -> None:
    """From one layout to another without a trace, over the primitives of every fixture."""
    for name in FIXTURES:
        for folder in ("plain", "other"):
            (tmp_path / folder).mkdir(exist_ok=True)
        plain, other = tmp_path / "plain" / name, tmp_path / "other" / name
        bake(FOLDER / name, plain)
        model = baked(FOLDER / name, other, storage=TEXCOORD)
        assert all(note(model.content, mesh, number) for mesh, number, _ in primitives(model.content))
        bake(other, other)
        assert other.read_bytes() == plain.read_bytes()
