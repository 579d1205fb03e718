"""The hostile families of the benchmark of growth."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.growth import COMMANDS, FAMILIES, MORE_COMMANDS, NAMED_BYTES
from tests.support.command_line import invoke
from tests.support.gltf_reading import read

SIZE = 1 << 14


def test_many_images_name_one_file_that_packing_brings_in_once(tmp_path: Path) -> None:
    paths = {name: str(tmp_path / f"{name}.glb") for name in ("source", "baked", "other")}
    source = FAMILIES["named_images"](SIZE).written(Path(paths["source"]))
    content = read(source).content
    assert source.stat().st_size < 2 * SIZE
    assert len(content["textures"]) == len(content["images"]) == SIZE // 32
    assert [texture["source"] for texture in content["textures"]] == list(range(SIZE // 32))
    assert {image["uri"] for image in content["images"]} == {"a.png"}

    for command in (COMMANDS | MORE_COMMANDS["named_images"]).values():
        assert invoke(*(part.format(**paths) for part in command)).exit_code == 0
    assert NAMED_BYTES < Path(paths["other"]).stat().st_size < NAMED_BYTES + 4 * SIZE
    assert not any("uri" in image for image in read(Path(paths["other"])).content["images"])


@pytest.mark.parametrize("family", ["shared_note", "former_influences", "former_streams"])
def test_primitives_share_what_a_bake_noted(family: str, tmp_path: Path) -> None:
    """Strip takes each primitive for a baked one, as it reads the metadata of each."""
    source = FAMILIES[family](SIZE).written(tmp_path / "source.glb")
    count = len(read(source).content["meshes"][0]["primitives"])
    assert count > 10
    result = invoke("strip", source, "-o", tmp_path / "other.glb", "--json")
    assert json.loads(result.stdout)["primitives"] == count
    assert result.exit_code == 0
