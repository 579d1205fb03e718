"""What a page of ``skinbake view`` holds besides the file itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Gradients
from skinbake.commands import view
from skinbake.gltf.document import read_document
from tests.support.baking import bake_file

TUBE = FOLDER / "bent_tube.glb"


@pytest.mark.parametrize(
    ("kind", "other"),
    [
        (Gradients.SURFACE, Gradients.RIG),
        (Gradients.RIG, Gradients.SURFACE),
        (Gradients.POSES, Gradients.SURFACE),
    ],
)
def test_a_page_has_the_gradients_of_another_kind(tmp_path: Path, kind: Gradients, other: Gradients) -> None:
    assert bake_file(TUBE, tmp_path / "baked.glb", gradients=kind).status == "baked"
    document = read_document(str(tmp_path / "baked.glb"))
    (found,) = view._other_gradients(document, view.sound_views(document))
    assert found.kind == other
    assert found.alpha.any()
