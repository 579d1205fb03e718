"""The Rust lines of the Bevy target compile, and add attributes to a pipeline: with a stand-in for Bevy."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from skinbake.choices import Frame
from skinbake.shaders.choices import AttributeText, ShaderChoices
from tests.bevy.running import WESL, chosen
from tests.support.tools import required_program
from tests.support.whole_fields import shader_text

STUB = Path(__file__).parent / "stub"
TIMEOUT_SECONDS = 120
SIZES = {"Float32x3": 12, "Snorm8x4": 4, "Snorm16x4": 8}
"""Bytes of a vertex, by WebGPU's names."""


@pytest.fixture(scope="module")
def crates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the stand-in crates, compiled."""
    folder = tmp_path_factory.mktemp("crates")
    _rustc(folder, "--crate-type=proc-macro", "--crate-name=bevy_derive", STUB / "derive.rs")
    _rustc(folder, "--crate-type=lib", "--crate-name=bevy", "--extern=bevy_derive", STUB / "bevy.rs")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("choices", "names", "vertex_format"),
    [
        (chosen(Frame.NORMAL), "SKINBAKE_ALPHA_0 SKINBAKE_BETA_0", "Float32x3"),
        (chosen(Frame.NORMAL, target=WESL), "SKINBAKE_ALPHA_0 SKINBAKE_BETA_0", "Float32x3"),
        (chosen(Frame.TANGENT, target=WESL), "SKINBAKE_ALPHA_0 SKINBAKE_BETA_0", "Float32x3"),
        (chosen(Frame.TANGENT, layout="custom"), "CUSTOM0 CUSTOM1", "Float32x3"),
        (chosen(Frame.NORMAL, encoding="packed8", scale=1.5), "SKINBAKE_ALPHA_0 SKINBAKE_BETA_0", "Snorm8x4"),
        (
            chosen(Frame.TANGENT, encoding="snorm16", scale=2.0),
            "SKINBAKE_ALPHA_0 SKINBAKE_BETA_0",
            "Snorm16x4",
        ),
    ],
    ids=["float32", "next", "next tangent", "custom", "packed8", "snorm16"],
)
def test_the_rust_lines_compile_and_add_the_attributes(
    choices: ShaderChoices, names: str, vertex_format: str, crates: Path, tmp_path: Path
) -> None:
    text = shader_text(choices)
    (tmp_path / "skinbake.rs").write_text(_rust_lines(text, tmp_path))
    example = "\n".join(_example(text))
    (tmp_path / "main.rs").write_text(f"{(STUB / 'check.rs').read_text()}\nfn example() {{\n{example};\n}}\n")
    _rustc(crates, "--extern=bevy", "--deny=warnings", "--out-dir", tmp_path, tmp_path / "main.rs")
    process = subprocess.run(
        [tmp_path / "main"], capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False
    )
    assert process.returncode == 0, process.stderr
    alpha, beta = names.split()
    is_next = choices.target == WESL
    exact = is_next and choices.frame == Frame.NORMAL
    first = 14 if is_next else 8
    # The mesh with neither of the two is not baked: nothing is said of it.
    reasons = ["it has no SkinbakeBeta", "it has no SkinbakeAlpha", *["its own are compressed"] * exact]
    warning = "WARN skinbake: a baked mesh keeps Bevy's normals: "
    assert process.stderr.splitlines() == [warning + reason for reason in reasons]
    assert process.stdout.splitlines() == [
        "with compressed normals: " + ("Bevy's own" if exact else "baked"),
        f"shaders/skinbake.{'wesl' if is_next else 'wgsl'}",
        f"{alpha} SkinbakeAlpha {vertex_format} 64 {first}",
        f"{beta} SkinbakeBeta {vertex_format} {64 + SIZES[vertex_format]} {first + 1}",
    ]


@pytest.mark.slow
def test_a_name_of_any_characters_arrives_whole(crates: Path, tmp_path: Path) -> None:
    odd = AttributeText("arm.glb", alpha=('_A"\\\\n{}ü',), beta=("_☃ \t/",))
    (tmp_path / "skinbake.rs").write_text(
        _rust_lines(shader_text(chosen(Frame.NORMAL, attributes=odd)), tmp_path)
    )
    (tmp_path / "main.rs").write_text(
        "#[allow(dead_code)]\nmod skinbake;\nfn main() {\n"
        '    for (name, _) in &skinbake::gltf_plugin().custom_vertex_attributes { print!("{name}\\0"); }\n}\n'
    )
    _rustc(crates, "--extern=bevy", "--out-dir", tmp_path, tmp_path / "main.rs")
    process = subprocess.run([tmp_path / "main"], capture_output=True, timeout=TIMEOUT_SECONDS, check=True)
    assert process.stdout.decode().split("\0")[:-1] == ['A"\\\\n{}ü', "☃ \t/"]


def _rust_lines(text: str, folder: Path) -> str:
    """The Rust lines, by the very command that the text names for it."""
    found = re.search(r"^// +sed -n '(.*)' skinbake\.w[ge]sl > ", text, re.MULTILINE)
    assert found is not None
    (folder / "skinbake.wgsl").write_text(text)
    process = subprocess.run(
        ["sed", "-n", found[1], folder / "skinbake.wgsl"], capture_output=True, text=True, check=True
    )
    assert len(process.stdout.splitlines()) == text.count("\n//rs")
    return process.stdout


def _example(text: str) -> list[str]:
    """The lines of the example between its fences."""
    lines = [line.removeprefix("//rs //!") for line in text.splitlines() if line.startswith("//rs //!")]
    first, last = (number for number, line in enumerate(lines) if "```" in line)
    return lines[first + 1 : last]


def _rustc(folder: Path, *arguments: str | Path) -> None:
    """Compile with the crates of a folder, into it unless an argument says otherwise."""
    rustc = required_program("rustc", "rustc")
    out: list[str | Path] = [] if "--out-dir" in arguments else ["--out-dir", folder]
    command = [rustc, "--edition=2021", "-L", folder, *out, *arguments]
    process = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False)
    assert process.returncode == 0, process.stderr
