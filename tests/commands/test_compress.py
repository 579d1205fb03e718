"""The options of compression on the command line, and what becomes of hostile files."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path

import pytest

from tests.support.command_line import document, invoke, run
from tests.support.compressed import EXT, KHR, draco_twin, meshopt_twin
from tests.support.gltf_reading import DRACO, read
from tests.support.models import FOLDER

TUBE = FOLDER / "bent_tube.glb"
FOREIGN_JOINTS = FOLDER / "foreign_joints.glb"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--compress", "zip"],
        ["--compress-level", "11"],
        ["--position-bits", "12"],
        ["--compress", "meshopt", "--texcoord-bits", "12"],
        ["--compress", "draco", "--normal-bits", "1"],
        ["--compress", "draco", "--position-bits", "25"],
        ["--compress", "meshopt", "--compress-level", "4"],
        ["--compress", "none", "--compress-level", "2"],
    ],
)
def test_wrong_usage_is_exit_2(arguments: list[str], tmp_path: Path) -> None:
    result = invoke("bake", TUBE, "-o", tmp_path / "out.glb", *arguments)
    assert result.exit_code == 2
    assert not (tmp_path / "out.glb").exists()


def test_the_options_reach_the_file(tmp_path: Path) -> None:
    for name, arguments in {
        "draco": ["draco"],
        "coarse": ["draco", "--position-bits", "8", "--normal-bits", "8", "--compress-level", "10"],
        "meshopt": ["meshopt", "--compress-level", "0"],
    }.items():
        result = invoke("bake", TUBE, "-o", tmp_path / f"{name}.glb", "--compress", *arguments)
        assert result.exit_code == 0, result.stderr
    used = {name: read(tmp_path / f"{name}.glb").content["extensionsUsed"] for name in ("draco", "meshopt")}
    assert used == {"draco": [DRACO], "meshopt": [EXT]}
    sizes = [(tmp_path / f"{name}.glb").stat().st_size for name in ("coarse", "draco")]
    assert sizes[0] < sizes[1]
    assert invoke("verify", tmp_path / "coarse.glb", "--poses", "rest").exit_code == 0


def test_a_level_without_compression_is_told(tmp_path: Path) -> None:
    plain, packed = tmp_path / "plain.glb", tmp_path / "packed.glb"
    invoke("bake", TUBE, "-o", plain)
    for options, codes in (
        (["--compress-level", "3"], ["level-ignored"]),
        (["--compress-level", "3", "--compress", "meshopt"], []),
        ([], []),
    ):
        result = invoke("bake", TUBE, "-o", packed, "--json", *options)
        assert [notice["code"] for notice in document(result)["files"][0]["warnings"]] == codes
        if codes:
            assert packed.read_bytes() == plain.read_bytes()


@pytest.mark.parametrize("scheme", ["draco", "meshopt"])
def test_a_level_is_for_the_additions_to_a_compressed_file(scheme: str, tmp_path: Path) -> None:
    invoke("bake", TUBE, "-o", tmp_path / "baked.glb", "--compress", scheme)
    invoke("strip", tmp_path / "baked.glb", "-o", tmp_path / "packed.glb")
    packed = tmp_path / "packed.glb"
    result = invoke("bake", packed, "--dry-run", "--json", "--compress-level", "0")
    assert "level-ignored" not in [notice["code"] for notice in document(result)["files"][0]["warnings"]]
    assert document(result)["files"][0]["status"] == "baked"


def test_draco_that_grows_a_file_says_the_factor_and_the_remedy(tmp_path: Path) -> None:
    result = invoke("bake", TUBE, "-o", tmp_path / "a.glb", "--compress", "draco", "--json")
    (notice,) = document(result)["files"][0]["warnings"]
    assert notice["code"] == "draco-larger"
    sizes = [len(read(path).binary_chunk or b"") for path in (TUBE, tmp_path / "a.glb")]
    told = re.search(r"buffers ([\d.]+) times as large \(([\d,]+) to ([\d,]+) bytes\)", notice["message"])
    assert told is not None
    assert [int(number.replace(",", "")) for number in told.groups()[1:]] == pytest.approx(sizes, abs=3)
    assert float(told[1]) == pytest.approx(sizes[1] / sizes[0], rel=0.05)
    # The remedies help, the second one less.
    made = []
    for remedy in (["meshopt"], ["draco", "--position-bits", "14", "--normal-bits", "10"]):
        result = invoke("bake", TUBE, "-o", tmp_path / "b.glb", "--compress", *remedy)
        assert ("--compress draco makes its buffers" in result.stderr) == (remedy[0] == "draco")
        made.append((tmp_path / "b.glb").stat().st_size)
    assert made[0] < TUBE.stat().st_size < made[1] < (tmp_path / "a.glb").stat().st_size
    twin = draco_twin(TUBE, tmp_path / "twin.glb", sequential=True)
    grown = invoke("bake", twin, "--dry-run", "--compress", "draco").stderr
    assert "--compress draco makes its buffers" not in grown


def test_a_notice_makes_warnings_as_errors_fail(tmp_path: Path) -> None:
    """Its adopted influences need a new stream."""
    source = draco_twin(FOREIGN_JOINTS, tmp_path / "in.glb", sequential=False)
    result = invoke("bake", source, "-o", tmp_path / "out.glb", "--json")
    (notice,) = json.loads(result.stdout)["files"][0]["warnings"]
    assert (notice["code"], notice["count"]) == ("draco-sequential", 1)
    failing = invoke("bake", source, "-o", tmp_path / "not.glb", "--warnings-as-errors")
    assert (failing.exit_code, (tmp_path / "not.glb").exists()) == (3, False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["draco", "edgebreaker", EXT, KHR])
def test_damaged_data_ends_in_exit_3_or_0_and_never_in_a_traceback(kind: str, tmp_path: Path) -> None:
    """Bytes flipped and files cut inside the compressed data, all in one process."""
    twin = tmp_path / "twin.glb"
    if kind in {EXT, KHR}:
        meshopt_twin(TUBE, twin, name=kind)
    else:
        draco_twin(TUBE, twin, sequential=kind == "draco")
    data = twin.read_bytes()
    start = (
        data.index(b"DRACO") if kind not in {EXT, KHR} else len(data) - len(read(twin).binary_chunk or b"")
    )
    chance = random.Random(5)
    sources = []
    for number in range(24):
        damaged = bytearray(data)
        for _ in range(chance.randrange(1, 4)):
            where = start + chance.randrange(60 if number % 2 else len(data) - start)
            damaged[where] = chance.randrange(256)
        sources.append(tmp_path / f"{number}.glb")
        sources[-1].write_bytes(damaged)
    process = run("bake", *sources, "--out-dir", tmp_path / "out")
    assert process.returncode == 3
    text = process.stderr.decode()
    assert "Traceback" not in text
    assert "should not" not in text
    failed = [line for line in text.splitlines() if line.startswith("error: ")]
    assert len(process.stdout.splitlines()) + len(failed) == len(sources)
    errors = [line for line in text.splitlines() if "cannot be decoded" in line or "stream declares" in line]
    assert errors
    assert all("mesh 0" in line or "buffer view" in line for line in errors)


def test_bits_asked_for_what_is_in_draco_already_are_a_notice(tmp_path: Path) -> None:
    first, second = tmp_path / "first.glb", tmp_path / "second.glb"
    assert invoke("bake", TUBE, "-o", first, "--compress", "draco").exit_code == 0
    result = invoke("bake", first, "-o", second, "--compress", "draco", "--position-bits", "8")
    assert result.exit_code == 0
    assert "it is already in Draco and is not quantised again" in result.stderr
    assert second.read_bytes() == first.read_bytes()


def test_inspect_names_the_compression(tmp_path: Path) -> None:
    for scheme, name in (("draco", "KHR_draco_mesh_compression"), ("meshopt", EXT), ("none", None)):
        target = tmp_path / f"{scheme}.glb"
        assert invoke("bake", TUBE, "-o", target, "--compress", scheme).exit_code == 0
        found = document(invoke("inspect", target, "--json"))["primitives"][0]["compression"]
        assert found == name
        assert (f"compressed  {found};" in invoke("inspect", target).stdout) == (name is not None)
