"""What a page of ``skinbake view`` holds besides the file itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Gradients
from skinbake.commands import view
from skinbake.freshness.baked_views import sound_views
from skinbake.gltf.document import read_document
from tests.support.baking import bake_file
from tests.support.gltf_reading import read
from tests.support.models import rewritten, sheet, write_model

TUBE = FOLDER / "bent_tube.glb"


@pytest.mark.parametrize(
    ("kind", "other"),
    [
        (Gradients.SURFACE, Gradients.FITTED),
        (Gradients.FITTED, Gradients.SURFACE),
    ],
)
def test_a_page_has_the_gradients_of_another_kind(tmp_path: Path, kind: Gradients, other: Gradients) -> None:
    assert bake_file(TUBE, tmp_path / "baked.glb", gradients=kind).status == "baked"
    document = read_document(str(tmp_path / "baked.glb"))
    (found,) = view._other_gradients(document, sound_views(document))
    assert found.kind == other
    assert found.alpha.any()


def test_only_sound_primitives_with_a_bake_have_views(tmp_path: Path) -> None:
    """Of three primitives one loses its normals after the bake, and one its bake."""
    path = tmp_path / "three.glb"
    bake_file(str(write_model(tmp_path / "plain.glb", [sheet(), sheet(), sheet()])), str(path))
    model = read(path)
    del model.primitive(0, 0)["attributes"]["NORMAL"], model.primitive(0, 1)["extras"]
    document = read_document(str(rewritten(model, path)))
    assert [one.source.place.primitive for one in sound_views(document)] == [2]


def test_a_broken_primitive_without_a_bake_does_not_hide_a_baked_one(tmp_path: Path) -> None:
    """glTF knows the modes 0 to 6."""
    path = tmp_path / "two.glb"
    bake_file(str(write_model(tmp_path / "plain.glb", [sheet(), sheet()])), str(path))
    model = read(path)
    broken = model.primitive(0, 0)
    del broken["extras"]
    broken["mode"] = 7
    for name in [name for name in broken["attributes"] if name.startswith("_SKINBAKE_")]:
        del broken["attributes"][name]
    document = read_document(str(rewritten(model, path)))
    assert [one.source.place.primitive for one in sound_views(document)] == [1]
