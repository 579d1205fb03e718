"""A broken reference of the input does not come to mean what bake adds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fixtures.builder import JsonObject
from skinbake.errors import InputError
from tests.support.baking import bake_file
from tests.support.models import SHARED, edited


@pytest.mark.parametrize(
    ("array", "broken"),
    [
        ("accessors", lambda root, past: root["skins"][0].update(inverseBindMatrices=past)),
        (
            "accessors",
            lambda root, past: root["meshes"][0]["primitives"][0].update(targets=[{"NORMAL": past}]),
        ),
        (
            "bufferViews",
            lambda root, past: root.update(images=[{"bufferView": past, "mimeType": "image/png"}]),
        ),
        ("buffers", lambda root, past: root["bufferViews"].append({"buffer": past, "byteLength": 4})),
    ],
)
def test_a_reference_past_the_end_is_refused(
    array: str, broken: Callable[[JsonObject, int], None], tmp_path: Path
) -> None:
    def damage(root: JsonObject) -> None:
        broken(root, len(root[array]))

    source = edited(SHARED, tmp_path / "in", damage)
    target = tmp_path / "out.gltf"
    with pytest.raises(InputError, match=f'of "{array}"'):
        bake_file(str(source), str(target))
    assert not target.exists()
