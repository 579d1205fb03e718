"""--max-memory holds before bytes are read: in children whose addresses are limited to a little more."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skinbake.errors import InputError
from skinbake.gltf.budget import memory_limited
from skinbake.gltf.document import Document
from tests.support.gltf_reading import read
from tests.support.models import bake, sheet, write_model
from tests.support.webgpu import NAGA

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits the addresses of a child")

LIMIT, ADDRESSES, SPARSE = 256 << 20, 1200 << 20, 1500 << 20
"""--max-memory, all addresses of a child with Python and its libraries, and the size of a file of holes."""

LIMITED = (
    f"import os, resource, sys; resource.setrlimit(resource.RLIMIT_AS, ({ADDRESSES}, {ADDRESSES}));"
    "os.execv(sys.executable, [sys.executable, '-m', 'skinbake', *sys.argv[1:]])"
)

COMMANDS: dict[str, Callable[[str, Path], list[str]]] = {
    "bake": lambda source, folder: ["bake", source, "-o", str(folder / "out.glb")],
    "verify": lambda source, folder: ["verify", source],
    "strip": lambda source, folder: ["strip", source, "-o", str(folder / "out.glb")],
    "inspect": lambda source, folder: ["inspect", source],
    "shader": lambda source, folder: ["shader", "--lang", "glsl", "--for", source],
    "view": lambda source, folder: ["view", source, "-o", str(folder / "out.html")],
    "render": lambda source, folder: ["render", source, "-o", str(folder / "out.png")],
}


def refused(arguments: list[str], stdin: Path | None = None) -> str:
    """Run a command in a child, which must refuse its input, and return what it says."""
    with (Path(os.devnull) if stdin is None else stdin).open("rb") as file:
        done = subprocess.run(
            [sys.executable, "-c", LIMITED, *arguments, "--max-memory", str(LIMIT)],
            stdin=file,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", ["glb", "gltf", "buffer"])
def test_a_file_is_refused_before_it_is_read(kind: str, command: str, tmp_path: Path) -> None:
    if command == "render":
        NAGA.require()
    source, huge = with_files(tmp_path)
    if kind != "buffer":
        source = huge = write_model(tmp_path / f"in.{kind}", [sheet()])
    elif command in {"verify", "shader", "inspect", "strip"}:  # they read the buffers of a baked file
        (tmp_path / "baked").mkdir()
        bake(source, tmp_path / "baked" / "in.gltf")
        source, huge = tmp_path / "baked" / "in.gltf", tmp_path / "baked" / "a.bin"
    os.truncate(huge, SPARSE)
    said = refused(COMMANDS[command](str(source), tmp_path))
    assert "1.465 GiB" in said
    assert said.strip().endswith("The limit is 256 MiB: raise --max-memory")
    assert not list(tmp_path.glob("out.*"))


@pytest.mark.slow
def test_a_buffer_that_only_packing_reads_is_refused_before_it_is_read(tmp_path: Path) -> None:
    source, _ = with_files(tmp_path)
    os.truncate(tmp_path / "b.bin", SPARSE)
    said = refused(["bake", str(source), "-o", str(tmp_path / "out.glb"), "--pack"])
    assert "buffer 1 would take 1.465 GiB" in said
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.slow
def test_standard_input_is_refused_when_it_grows_too_large(tmp_path: Path) -> None:
    path = write_model(tmp_path / "in.glb", [sheet()])
    os.truncate(path, SPARSE)
    said = refused(["bake", "-", "-o", str(tmp_path / "out.glb")], stdin=path)
    assert "<stdin>: reading it would take 1 MiB" in said


def with_files(folder: Path) -> tuple[Path, Path]:
    """Write a model with two buffers in files, the second of which nothing uses.

    Return the path of the model, and that of the first buffer.
    """
    model = read(write_model(folder / "in.glb", [sheet()]))
    content = model.content
    (folder / "a.bin").write_bytes(model.binary_chunk or b"")
    (folder / "b.bin").write_bytes(bytes(4))
    content["buffers"][0]["uri"] = "a.bin"
    content["buffers"].append({"byteLength": 4, "uri": "b.bin"})
    (folder / "in.gltf").write_text(json.dumps(content), encoding="utf-8")
    return folder / "in.gltf", folder / "a.bin"


PEAK = """
import sys
from pathlib import Path
from skinbake.gltf.document import parse_gltf
from skinbake.render.materials import decoded

def memory(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(name)))

data = Path(sys.argv[1]).read_bytes()
document = parse_gltf(b'{"asset": {"version": "2.0"}}', "x.gltf", Path())
decoded(Path(sys.argv[2]).read_bytes(), document)
Path("/proc/self/clear_refs").write_text("5")
before, spent = memory("VmRSS"), document.budget.taken.bytes
decoded(data, document)
print(memory("VmHWM") - before, document.budget.taken.bytes - spent)
"""


@pytest.mark.slow
@pytest.mark.parametrize("side", [2048, 3000])
@pytest.mark.parametrize(
    ("kind", "mode"),
    [
        ("PNG", "RGBA"),
        ("PNG", "RGB"),
        ("PNG", "LA"),
        ("PNG", "P"),
        ("PNG", "I;16"),
        ("JPEG", "RGB"),
        ("JPEG", "CMYK"),
        ("WEBP", "RGB"),
        ("WEBP", "RGBA"),
    ],
)
def test_an_image_takes_no_more_than_it_claims(kind: str, mode: str, side: int, tmp_path: Path) -> None:
    for name, length in (("large", side), ("small", 16)):
        noise = np.random.default_rng(0).integers(0, 255, (length, length, 4), dtype=np.uint8)
        if mode == "I;16":
            picture = Image.fromarray(noise[..., 0].astype(np.uint16) * 257)
        else:
            picture = Image.fromarray(noise).convert(mode)
        picture.save(tmp_path / name, kind, progressive=True)
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(tmp_path / "large"), str(tmp_path / "small")],
        capture_output=True,
        text=True,
        check=False,
    )
    peak, claimed = map(int, done.stdout.split())
    assert peak < claimed, done.stderr
    assert claimed < 64 * side * side


@pytest.mark.slow
def test_a_webp_is_refused_by_its_header(tmp_path: Path) -> None:
    from skinbake.render.materials import decoded

    for options in ({}, {"lossless": True}, {"exif": b"Exif"}):
        data = io.BytesIO()
        Image.new("RGB", (3000, 1000)).save(data, "WEBP", **options)
        with memory_limited(20_000_000):
            document = Document("x.gltf", tmp_path, {"asset": {"version": "2.0"}}, is_glb=False)
            document.budget.backed = 1 << 20
        with pytest.raises(InputError, match="an image of 3,000 × 1,000 pixels would take 6"):
            decoded(data.getvalue()[:40], document)
