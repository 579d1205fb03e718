"""No command leaves a file open: a process that works on many files has few descriptors to spare."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, copied

DESCRIPTORS = Path("/dev/fd")

pytestmark = pytest.mark.skipif(not DESCRIPTORS.is_dir(), reason="needs /dev/fd")

COMMANDS = {
    "into new folders": "bake art/beside.gltf -o {made}/new/folder/tube.glb --pack",
    "beside each other": "bake art --out-dir {made} --depfile {made}.d --summary {made}.jsonl",
    "nothing has changed": "bake art --out-dir kept --skip-unchanged",
    "in place": "bake art/beside.gltf --in-place",
    "on stdout": "bake art/linked.gltf -o -",
    "below a file": "bake art/beside.gltf -o art/data/tube.bin/out.gltf",
    "refused for its warnings": "bake art/beside.gltf -o {made}/out.glb --warnings-as-errors",
    "verify": "verify art --poses rest --junit {made}.xml --html {made}.html",
    "inspect": "inspect art",
    "strip": "strip kept --out-dir {made}",
    "view": "view art/seam.glb -o {made}.html",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make the folder art, whose files have their data in them, beside them, behind a link, or nowhere."""
    art = tmp_path / "art"
    (art / "data").mkdir(parents=True)
    copied("seam.glb", art)
    tube = read(FOLDER / "bent_tube.glb")
    for path in (art / "data" / "tube.bin", art / "data" / "picture.png", tmp_path / "outside.bin"):
        path.write_bytes(tube.binary_chunk or b"")
    (art / "linked.bin").symlink_to("data/../data/tube.bin")
    (art / "out.bin").symlink_to("../outside.bin")
    images = [{"uri": uri} for uri in ("data/picture.png", "missing.png", "out.bin")]
    for name, uri in {
        "beside": "data/tube.bin",
        "linked": "linked.bin",
        "out": "out.bin",
        "missing": "missing.bin",
        "folder": "data",
    }.items():
        buffers = [{**tube.content["buffers"][0], "uri": uri}]
        document = {**tube.content, "buffers": buffers, "images": images}
        (art / f"{name}.gltf").write_text(json.dumps(document))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_a_command_leaves_no_descriptor_open(command: str, folder: Path) -> None:
    """The first run opens what stays open on purpose, like the libraries that it imports."""
    invoke("bake", "art", "--out-dir", "kept", "--skip-unchanged")
    counts = []
    for made in ("first", "second"):
        result = invoke(*command.format(made=made).split())
        assert result.exit_code != 2, result.output
        counts.append(len(list(DESCRIPTORS.iterdir())))
    assert counts[0] == counts[1]
