"""The note of a bake: written and read it is the same, and what a tool has damaged ends where it is read."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from skinbake.choices import Encoding, Gradients, Layout, Weld
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.format import note as notes
from skinbake.format.note import CorrectiveNote, GradientNote, MorphNote, gradient_note
from skinbake.gltf.document import read_document
from tests.support.gltf_reading import read
from tests.support.models import FIXTURES, FOLDER, SHARED, baked, rewritten

OPTIONS = [
    BakeOptions(),
    BakeOptions(
        encoding=Encoding.PACKED8, gradients=Gradients.SURFACE, weld=Weld.SKIN, generate_normals=True
    ),
    BakeOptions(layout=Layout.TEXCOORD, limit_influences=4, generate_normals=True),
]


def written_notes(content: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the notes of all primitives with α and β, as the file has them."""
    holders = [one for mesh in content["meshes"] for one in mesh["primitives"]] + content["accessors"]
    found = [one["extras"].get("skinbake") for one in holders if isinstance(one.get("extras"), dict)]
    return [one for one in found if isinstance(one, dict) and "digest" in one]


@pytest.mark.parametrize("options", OPTIONS)
def test_a_note_of_gradients_is_written_as_it_is_read(options: BakeOptions) -> None:
    count = 0
    for name in FIXTURES:
        made = bake_document(read_document(str(FOLDER / name)), options)
        written = written_notes(made.document.json)
        count += len(written)
        sources = made.document.asset.primitives
        found = [one for one in (gradient_note(made.document, source) for source in sources) if one]
        assert sorted(map(str, written)) == sorted(str(one.as_json()) for one in found)
        assert all(list(one.as_json()) == list(one.json) for one in found)  # in the same order
    assert count > len(FIXTURES) // 2


@pytest.mark.parametrize("kind", [GradientNote, MorphNote, CorrectiveNote, notes.LeftNote])
def test_a_note_without_members_says_next_to_nothing(kind: Any) -> None:
    assert len(kind().as_json()) <= 6


@pytest.mark.parametrize(
    ("key", "value", "member", "read_as"),
    [
        ("alpha", "_SKINBAKE_ALPHA_0", "alpha", ()),
        ("alpha", ["_A", 3], "alpha", ("_A",)),
        ("influences", 4.0, "influences", 4),
        ("influences", True, "influences", 0),
        ("poses", {"fingerprint": [1, "x"], "slots": "0"}, "poses", None),
        ("kept", {"fit": 1.5}, "kept", None),
        ("neighbours", 7, "neighbours", "7"),
        ("digest", {"POSITION": 3, "NORMAL": "00"}, "digest", {"NORMAL": "00"}),
        ("adopted", {"JOINTS_0": 5, "WEIGHTS_0": "x"}, "adopted", {"JOINTS_0": 5}),
    ],
)
def test_a_damaged_member_is_read_as_absent(
    key: str, value: object, member: str, read_as: object, tmp_path: Path
) -> None:
    model = baked(FOLDER / "seam.glb", tmp_path / "baked.glb")
    model.primitive(0)["extras"]["skinbake"][key] = value
    document = read_document(str(rewritten(model, tmp_path / "damaged.glb")))
    found = gradient_note(document, document.asset.primitives[0])
    assert found is not None and getattr(found, member) == read_as


def test_a_note_of_another_program_stays_beside_ours(tmp_path: Path) -> None:
    baked(FOLDER / SHARED, tmp_path / SHARED)
    content = copy.deepcopy(read(tmp_path / SHARED).content)
    assert isinstance(content["meshes"][0]["primitives"][0]["extras"], list)
    assert len(written_notes(content)) == 2
