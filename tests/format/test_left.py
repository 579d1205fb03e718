"""What a bake leaves out on purpose stands in the file, and verify never takes it for forgotten."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Encoding, Gradients
from skinbake.commands.bake import LeftOut, bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_document
from skinbake.errors import UnsupportedFeatureError
from skinbake.format.strip import stripped
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document, read_document
from skinbake.measure.options import VerifyOptions
from tests.support.command_line import document as json_of
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, note, sheet, tangents_along, write_model
from tests.support.models import stripped as without_bake

FEW = VerifyOptions(min_gain=0.5)


def pretended(options: BakeOptions, source: PrimitiveSource) -> LeftOut | None:
    """A choice that no option of bake offers: the first primitive alone is baked."""
    return LeftOut("--pretended") if source.primitive else None


def two(**extras: Any) -> Document:
    """Read a mesh of two skinned primitives, the second with these extras."""
    document = read_document(str(FOLDER / "two_primitives.glb"))
    json = copy.deepcopy(document.json)
    json["meshes"][0]["primitives"][1] |= extras
    return document.edited(json=json)


@pytest.mark.parametrize(
    "options", [BakeOptions(), BakeOptions(encoding=Encoding.PACKED8, gradients=Gradients.SURFACE)]
)
def test_what_a_new_choice_leaves_out_is_left_for_verify_and_not_forgotten(options: BakeOptions) -> None:
    made = bake_document(two(), options, pretended)
    assert len(made.primitives) == 1
    verdict = verify_document(made.document, FEW)
    assert verdict.passed and not verdict.found_no_bake
    assert "left by bake --pretended: mesh 0" in verdict.checks[0].remark
    assert verdict.checks[0].remark.endswith("primitive 1")
    # The note is what tells: without it, the same primitive is forgotten.
    json = copy.deepcopy(made.document.json)
    del json["meshes"][0]["primitives"][1]["extras"]
    [problem] = verify_document(made.document.edited(json=json), FEW).checks[0].problems
    assert (problem.code, problem.place.primitive) == ("metadata-missing", 1)


@pytest.mark.parametrize("extras", [{}, {"extras": {}}, {"extras": {"by": "another tool"}}])
def test_strip_takes_the_note_of_what_was_left_away_again(extras: dict[str, Any]) -> None:
    given = two(**extras)
    made = bake_document(given, leaves=pretended)
    found = made.document.json["meshes"][0]["primitives"][1]["extras"]["skinbake"]
    assert found["version"] == 1 and found["left"] == {"by": "--pretended"}
    plain, count = stripped(made.document)
    assert count == 1
    assert plain.json == given.json


def test_what_is_left_needs_a_place_for_its_note() -> None:
    with pytest.raises(UnsupportedFeatureError, match="--pretended") as raised:
        bake_document(two(extras=[1]), leaves=pretended)
    assert raised.value.place is not None and raised.value.place.primitive == 1


def test_nothing_is_noted_where_nothing_is_baked() -> None:
    given = two()
    made = bake_document(given, leaves=lambda options, source: LeftOut("--pretended"))
    assert made.document is given
    assert (made.is_baked, made.skipped) == (False, 2)


def test_what_was_left_is_baked_by_the_next_bake_that_does_not_leave_it() -> None:
    plain, _ = stripped(bake_document(two(), leaves=pretended).document)
    assert len(bake_document(plain).primitives) == 2


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_primitives_without_tangents_are_left_by_the_frame_that_needs_them(
    suffix: str, tmp_path: Path
) -> None:
    plain = sheet()
    apart = plain.attributes["POSITION"] + np.float32(3.0)
    parts = [sheet(TANGENT=tangents_along(plain)), sheet(POSITION=apart)]
    given, target = write_model(tmp_path / f"given{suffix}", parts), tmp_path / f"baked{suffix}"
    result = invoke("bake", given, "-o", target, "--frame", "tangent", "--json")
    [file] = json_of(result)["files"]
    assert (file["status"], [one["code"] for one in file["warnings"]]) == ("baked", ["no-tangents"])
    assert note(read(target).content, 0, 0) is not None
    [verified] = json_of(invoke("verify", target, "--json"))["files"]
    assert verified["passed"] and verified["checks"][0]["outcome"] == "passed"
    assert "left by bake --frame tangent" in verified["checks"][0]["remark"]
    assert without_bake(target, tmp_path / f"back{suffix}").content == read(given).content
