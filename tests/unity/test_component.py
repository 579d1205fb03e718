"""The component of engines/unity compiles, and has the pass correct what stand-ins for Unity have skinned.

A stand-in for UnityGLTF mirrors x, turns V upside down, and keeps the order of the slots. Mono runs
the component on stand-ins for Unity's types; DXC and lavapipe run the pass over what it has uploaded.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import skinbake
from fixtures.make_fixtures import FOLDER
from skinbake.choices import Language, Stage
from skinbake.commands.shader import shader
from skinbake.shaders.choices import ShaderRequest
from skinbake.version import __version__
from tests.shaders.running import done
from tests.support import analytic, dxc, glslang, webgpu
from tests.support.gltf_reading import read
from tests.support.tools import required_program

STUB = Path(__file__).parent / "stub" / "UnityEngine.cs"
PACKAGE = Path(__file__).parents[2] / "engines" / "unity"
COMPONENT = PACKAGE / "Runtime" / "Skinbake.cs"
TIMEOUT_SECONDS = 120
MIRROR = np.diag([-1.0, 1.0, 1.0])
STRIDE = 40
"""The bytes of a vertex that Unity has skinned: position, normal, tangent."""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The component and the stand-ins, compiled; warnings are errors."""
    made = tmp_path_factory.mktemp("unity") / "component.exe"
    compiler = required_program("mcs", "mono-mcs")
    run(compiler, "-warnaserror", "-warn:4", f"-out:{made}", str(STUB), str(COMPONENT))
    return made


def run(*command: str | Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def mirrored(matrices: analytic.Array) -> analytic.Array:
    """Return matrices (J, 4, 4) in mirrored space, column by column, as Unity stores them."""
    four = np.diag([-1.0, 1.0, 1.0, 1.0])
    found: analytic.Array = (four @ matrices @ four).transpose(0, 2, 1)
    return found


def test_the_package_has_the_version_of_skinbake_and_an_identity_for_each_of_its_files() -> None:
    """Unity leaves out a file of an installed package that has no .meta beside it."""
    package = json.loads((PACKAGE / "package.json").read_text("utf-8"))
    assert (package["name"], package["version"]) == ("com.skinbake.unity", __version__)
    assert json.loads((PACKAGE / "Runtime" / "Skinbake.asmdef").read_text("utf-8"))["name"] == "Skinbake"
    files = {path for path in PACKAGE.rglob("*") if path.suffix != ".meta"}
    metas = {path: path.with_name(path.name + ".meta").read_text("utf-8") for path in files}
    guids = {
        found[1] for text in metas.values() if (found := re.search(r"^guid: ([0-9a-f]{32})$", text, re.M))
    }
    assert len(guids) == len(files) == len([*PACKAGE.rglob("*.meta")])


@pytest.mark.slow
@pytest.mark.parametrize("pipeline", ["scriptable", "built-in"])
def test_the_component_has_the_pass_give_accurate_normals_and_tangents(
    program: Path, tmp_path: Path, pipeline: str
) -> None:
    path = tmp_path / "baked.glb"
    skinbake.bake(FOLDER / "mirrored_tangent.glb", path, layout="texcoord", frame="tangent")
    [posed] = skinbake.normals(path)
    file = read(path)
    position, normal, tangent = (file.attribute(name) for name in ("POSITION", "NORMAL", "TANGENT"))
    sets = [file.attribute(f"TEXCOORD_{number}") for number in range(4)]
    assert set(tangent[:, 3]) == {-1.0, 1.0}
    joints, weights = file.influences()
    [skin] = file.content["skins"]
    rest = file.matrices(skin["inverseBindMatrices"])
    # As UnityGLTF hands it to Unity. The root bone is no joint here, turned by 120 degrees.
    turn, place = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([3.0, -2.0, 1.0])
    columns = [
        position @ MIRROR,
        normal @ MIRROR,
        tangent * [-1.0, 1.0, 1.0, -1.0],
        *(one * [1.0, -1.0] + [0.0, 1.0] for one in sets),
    ]
    assert posed.joint_matrices.shape == rest.shape
    skins = np.concatenate([weights.astype("<f4").view("<i4"), joints.astype("<i4")], axis=1)
    parts = [np.array([len(position), len(rest)], "<i4"), *(one.astype("<f4") for one in columns), skins]
    parts += [
        mirrored(rest).astype("<f4"),
        mirrored(posed.joint_matrices @ np.linalg.inv(rest)).astype("<f4"),
    ]
    parts += [place.astype("<f4"), np.array([0.5, 0.5, 0.5, 0.5], "<f4")]
    (tmp_path / "mesh").write_bytes(b"".join(part.tobytes() for part in parts))
    run(required_program("mono", "mono-runtime"), program, tmp_path / "mesh", tmp_path, pipeline)
    # The pass over what the component has uploaded.
    lines = [line.split() for line in (tmp_path / "numbers").read_text().splitlines()]
    numbers = {name.removeprefix("skinbake_draw_"): values for name, *values in lines}
    made = shader(ShaderRequest(Language.HLSL, stage=Stage.COMPUTE), str(path))
    members = made.text.partition("cbuffer skinbake_Draw : register(b0) {")[2].partition("}")[0]
    draw = b""
    for member in members.split(";")[:-1]:
        kind, name = member.split()
        values = numbers.get(name.removeprefix("skinbake_draw_"), ["0"])
        assert len(values) == (2 if kind == "uint2" else 1)
        draw += (
            np.array([float(one) if kind == "float" else int(one) % 2**32 for one in values])
            .astype("<f4" if kind == "float" else "<u4")
            .tobytes()
        )
    module = dxc.spirv(made.text)
    assert glslang.invalid(module) == ""
    given = draw, *((tmp_path / f"skinbake_{name}").read_bytes() for name in ("geometry", "joints"))
    job = webgpu.Job(module, given, STRIDE * len(position), -(-len(position) // 64))
    found = np.frombuffer(done("pass", webgpu.answers(webgpu.NAGA, {"pass": job})["pass"]), np.float32)
    found = found.reshape(-1, STRIDE // 4)
    # What it should be: tangents by the lines of the paper.
    moved = np.einsum("vkij,vj->vki", posed.joint_matrices[joints][..., :3, :3], position)
    moved += posed.joint_matrices[joints][..., :3, 3]
    blended = np.einsum("vk,vkij->vij", weights, posed.joint_matrices[joints][..., :3, :3])
    alpha = np.stack([sets[1][:, 0], sets[1][:, 1], sets[2][:, 0]], axis=1)
    expected = np.einsum("vij,vj->vi", blended, tangent[:, :3])
    expected += np.einsum("vk,vki->vi", alpha, moved[:, 1:] - moved[:, :1])
    in_root = MIRROR @ turn
    assert not found[:, :3].any()
    assert analytic.degrees_between(found[:, 3:6], posed.normals["accurate"] @ in_root).max() < 0.02
    assert analytic.degrees_between(found[:, 6:9], expected @ in_root).max() < 0.02
    assert (found[:, 9] == -tangent[:, 3]).all()
    assert analytic.degrees_between(posed.normals["standard"], posed.normals["accurate"]).max() > 5.0
    assert numbers["groups"] == [str(-(-len(position) // 64)), "1", "1"]
    assert numbers["alive"] == ["0"], "buffers are left"
