"""Options of bake that change what is stored, all with each other: verified, baked twice, stripped again."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import corpus
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER

STORAGES = (
    pytest.param((), marks=pytest.mark.slow),
    pytest.param(("--encoding", "packed8"), marks=pytest.mark.slow),
    ("--encoding", "snorm16", "--layout", "custom"),
    pytest.param(("--layout", "texcoord"), marks=pytest.mark.slow),
)
GATHERINGS = ((), pytest.param(("--weld", "skin", "--limit-influences", "4"), marks=pytest.mark.slow))
COMPRESSED = (
    "hand_l-draco-sequential.glb",
    "barbarian-EXT_meshopt-high.glb",
    "barbarian-draco-edgebreaker.glb",
)
FILES = ("two_sets.glb", "morphed_sheet.glb", "weights_u8.glb")


def sources() -> list[Path]:
    """Return fixtures as they are, and characters that come compressed."""
    return [*(FOLDER / name for name in FILES), *map(corpus.model, COMPRESSED)]


@pytest.mark.slow
@pytest.mark.parametrize("gathering", GATHERINGS)
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(
    "compression",
    [
        (),
        pytest.param(("--compress", "meshopt"), marks=pytest.mark.slow),
        pytest.param(("--compress", "draco"), marks=pytest.mark.slow),
    ],
)
def test_every_combination_verifies_repeats_and_is_undone(
    compression: tuple[str, ...], storage: tuple[str, ...], gathering: tuple[str, ...], tmp_path: Path
) -> None:
    """A compression that was asked for is the one thing that strip cannot undo."""
    options = [*compression, *storage, *gathering, "-q"]
    for source in sources():
        once, twice, back = (tmp_path / f"{name}-{source.name}" for name in ("once", "twice", "back"))
        result = invoke("bake", source, "-o", once, *options)
        assert result.exit_code == 0, (source.name, result.stderr)
        result = invoke("verify", once, "--poses", "random:1", "--method", "lbs", "-q")
        assert result.exit_code == 0, (source.name, result.stderr)
        assert invoke("bake", once, "-o", twice, *options).exit_code == 0
        assert twice.read_bytes() == once.read_bytes(), source.name
        assert invoke("strip", once, "-o", back, "-q").exit_code == 0
        if not compression:
            assert read(back).content == read(source).content, source.name
            assert read(back).binary_chunk == read(source).binary_chunk, source.name
        assert "skinbake" not in str(read(back).content["meshes"]), source.name
        shader = invoke("shader", "--lang", "wgsl", "--for", once, "-q")
        assert shader.exit_code == 0, (source.name, shader.stderr)
