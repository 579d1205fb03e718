"""The npm package as npm publishes it: packed, installed into an empty project, type-checked and used."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from skinbake.shaders.engines import engines_folder
from tests.support.node import package_folder, require_node, run_program
from tests.support.tools import required_program

FOLDER = engines_folder() / "three"
USE = """
import * as THREE from 'three';
import { applySkinbake, dispose } from 'skinbake-three';
const before = THREE.ShaderChunk.skinnormal_vertex;
const geometry = new THREE.BufferGeometry();
for (const name of ['position', 'normal', '_skinbake_alpha_0', '_skinbake_beta_0']) {
    geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(9), 3));
}
geometry.userData.skinbake = {
    version: 1, frame: 'normal', influences: 4, alpha: ['_SKINBAKE_ALPHA_0'], beta: ['_SKINBAKE_BETA_0'],
};
const mesh = new THREE.SkinnedMesh(geometry, new THREE.MeshNormalMaterial());
const [report] = applySkinbake(mesh);
const found = [report.lighting, THREE.ShaderChunk.skinnormal_vertex === before];
dispose(mesh);
console.log(JSON.stringify([...found, THREE.ShaderChunk.skinnormal_vertex === before]));
"""


pytestmark = pytest.mark.slow


def run(*command: str, folder: Path) -> str:
    done = subprocess.run(
        command, cwd=folder, capture_output=True, encoding="utf-8", timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty project into which the packed package is installed beside three.js."""
    require_node("three")
    npm = required_program("npm")
    folder = tmp_path_factory.mktemp("project")
    run(npm, "pack", str(FOLDER), "--pack-destination", str(folder), folder=folder)
    (packed,) = folder.glob("*.tgz")
    (folder / "package.json").write_text('{"name": "empty", "private": true, "type": "module"}')
    # One after the other: while npm still reads a linked package, a second one that asks for it may fail.
    for package in (package_folder("three"), packed):
        run(npm, "install", "--offline", "--no-audit", "--no-fund", f"file:{package}", folder=folder)
    return folder


def test_the_package_holds_what_it_says_and_nothing_else(project: Path) -> None:
    installed = project / "node_modules" / "skinbake-three"
    names = {path.name for path in installed.iterdir()}
    assert names == {"package.json", *json.loads((FOLDER / "package.json").read_text())["files"]}


def test_the_package_runs_without_a_build(project: Path) -> None:
    (project / "use.js").write_text(USE)
    assert json.loads(run(require_node(), "use.js", folder=project)) == ["not drawn", False, True]


def test_the_types_of_the_package_are_right_under_tsc_strict(project: Path) -> None:
    require_node("typescript", "@types/three")
    shutil.copy(Path(__file__).parent / "usage.ts", project / "usage.ts")
    options = {"strict": True, "noEmit": True, "module": "nodenext", "target": "es2022", "types": []}
    options |= {"lib": ["es2022", "dom"], "skipLibCheck": False, "preserveSymlinks": False}
    options |= {
        "paths": {"three": [types("build/three.module.d.ts")], "three/addons/*": [types("examples/jsm/*")]}
    }
    configuration = {"compilerOptions": options, "files": ["usage.ts"]}
    (project / "tsconfig.json").write_text(json.dumps(configuration))
    run_program("typescript", "tsc", "-p", ".", folder=project)


def types(path: str) -> str:
    return str(package_folder("@types/three") / path)
