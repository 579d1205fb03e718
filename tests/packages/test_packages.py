"""The npm packages as projects use them: installed as their readmes say, before another, and built by vite.

No alias and no import map helps: what a page imports, the bundler has to find. Each page draws a character by
the oldest and the newest engine, and its normals are held against the replay.
"""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Baseline
from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
from tests.support.characters import Character, Placement, Pose, angles, baked
from tests.support.node import package_folder, require_node, run_program
from tests.support.stage import Stage, opened_page, page_of
from tests.support.tools import required_program

pytestmark = pytest.mark.slow

HERE = Path(__file__).resolve().parent
TUBE = FOLDER / "bent_tube.glb"
BENT = Pose(clip=0, time=0.45)
RANDOM = Pose(clip=None)
DEGREES = 0.01


@dataclass(frozen=True)
class Case:
    """A page of ``pages/``, the package that it imports, and the engine that the project has."""

    page: str
    package: str
    engine: dict[str, str]
    """By the name that the page imports, the folder of ``tests/support/node_modules`` or beside it."""

    backend: str = "webgl"

    @property
    def version(self) -> str:
        """Return the version of the engine."""
        return version_of(next(iter(self.engine.values())))


Apps: TypeAlias = Callable[[Case], Path]

OTHER = "../other_versions/node_modules"
GALACEAN = "@galacean/engine"
BABYLON = ("@babylonjs/core", "@babylonjs/loaders")
OLDEST = {
    "three": Case("three.mjs", "three", {"three": f"{OTHER}/three-0.160"}),
    "three/webgpu": Case("three_webgpu.mjs", "three", {"three": f"{OTHER}/three-0.185"}),
    "babylon": Case("babylon.mjs", "babylon", {name: f"{OTHER}/{name}" for name in BABYLON}),
    "playcanvas": Case("playcanvas.mjs", "playcanvas", {"playcanvas": f"{OTHER}/playcanvas"}),
    "galacean": Case("galacean.mjs", "galacean", {GALACEAN: f"{OTHER}/{GALACEAN}"}),
}
NEWEST = {
    "three": Case("three.mjs", "three", {"three": "three"}),
    "three/webgpu": Case("three_webgpu.mjs", "three", {"three": "three"}),
    "babylon": Case("babylon.mjs", "babylon", {name: name for name in BABYLON}),
    "playcanvas": Case("playcanvas.mjs", "playcanvas", {"playcanvas": "playcanvas"}),
    "galacean": Case("galacean.mjs", "galacean", {GALACEAN: GALACEAN}),
}


def version_of(package: str) -> str:
    text = (package_folder(package) / "package.json").read_text(encoding="utf-8")
    return str(json.loads(text)["version"])


def install_command(package: str) -> str:
    """Return the command of the readme of a package, with the folder of this checkout."""
    readme = (engines_folder() / package / "README.md").read_text(encoding="utf-8")
    found = re.search(rf"^npm install .*CHECKOUT/engines/{package}\S*", readme, re.MULTILINE)
    assert found
    return found[0].replace("CHECKOUT", str(engines_folder().parent))


def run(project: Path, command: str) -> None:
    required_program("npm")
    done = subprocess.run(
        ["sh", "-c", command], cwd=project, capture_output=True, encoding="utf-8", timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def apps(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Case], Path]:
    """Return what makes a project with an engine, installs a package, and returns the built page's folder."""
    made: dict[str, Path] = {}

    def built(case: Case) -> Path:
        key = f"{case.page} {case.version}"
        if key not in made:
            require_node("vite", *case.engine.values())
            project = tmp_path_factory.mktemp("above") / "project"
            project.mkdir()
            # Beside the project, where npm copies none of it. Node and bundlers look there too.
            for name, folder in case.engine.items():
                link = project.parent / "node_modules" / name
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(package_folder(folder).resolve())
            (project / "package.json").write_text('{"name": "project", "private": true, "type": "module"}')
            (project / ".npmrc").write_text("legacy-peer-deps=true\noffline=true\naudit=false\nfund=false\n")
            later = project.parent / "later"
            later.mkdir()
            (later / "package.json").write_text('{"name": "later", "version": "1.0.0"}')
            for command in (install_command(case.package), "npm install ../later", "npm ci"):
                run(project, command)
            assert not (project / "node_modules" / f"skinbake-{case.package}").is_symlink()
            build(project, HERE / "pages" / case.page)
            made[key] = project / "dist"
        return made[key]

    return built


def build(project: Path, page: Path) -> None:
    for path in (page, page.parent / "viewed.mjs"):
        (project / path.name).write_bytes(path.read_bytes())
    (project / "index.html").write_text(f'<script type="module" src="/{page.name}"></script>')
    output = {"entryFileNames": "app.js"}
    options = {"build": {"rollupOptions": {"output": output}, "target": "esnext"}, "logLevel": "error"}
    (project / "vite.config.mjs").write_text(f"export default {json.dumps(options)};")
    run_program("vite", "vite.js", "build", folder=project)


def shown(dist: Path, folder: Path, pose: Pose, **options: object) -> tuple[Character, dict[str, Any]]:
    """Open what was built, and let it draw a character. Also return what skinbake says on the console."""
    page = page_of("/built/app.js", scripts=["/support/capture.js", "/three/capture_webgpu.js"])
    return drawn(page, {"built": dist, "three": HERE.parent / "three"}, folder, pose, **options)


def drawn(
    page: str, served: dict[str, Path], folder: Path, pose: Pose, **options: object
) -> tuple[Character, dict[str, Any]]:
    with opened_page(page, folder, served) as (opened, models):
        stage = Stage(opened, models)
        character = Character(baked(TUBE, models), pose)
        found = dict(opened.call("show", {**character.told(Placement()), **options}))
        found["said"] = [line for line in stage.messages() if "skinbake" in line]
    return character, found


def largest(
    character: Character, found: dict[str, Any], algorithm: Algorithm, baseline: Baseline = Baseline.BLENDED
) -> float:
    """Return the largest angle between the normals that were drawn and those of the replay, in degrees."""
    world = np.array(found["world"]).reshape(4, 4).T if "world" in found else np.eye(4)
    placement = dataclasses.replace(Placement(), world=world)
    wanted = character.expected(algorithm, placement, baseline=baseline).normals
    drawn = np.array(found["values"], dtype=np.float64).reshape(-1, 3)
    assert len(drawn) > 0.9 * len(wanted)
    return float(angles(drawn[: len(wanted)], wanted[: len(drawn)]).max())


def pose_for(case: Case) -> Pose:
    return RANDOM if case.package in {"playcanvas", "galacean"} else BENT


def cases(found: dict[str, Case], which: str) -> Sequence[Any]:
    return [pytest.param(case, id=f"{which} {name}") for name, case in found.items()]


@pytest.mark.parametrize("case", [*cases(OLDEST, "oldest"), *cases(NEWEST, "newest")])
def test_a_production_build_is_lit_accurately(apps: Apps, case: Case, tmp_path: Path) -> None:
    backends = ["webgl", "webgpu"] if case.page == "three_webgpu.mjs" else ["webgl"]
    for backend in backends:
        folder = tmp_path / backend
        folder.mkdir()
        character, found = shown(apps(case), folder, pose_for(case), backend=backend)
        assert found.get("backend", backend) == backend
        assert (found["report"], found["said"]) == (["accurate", ""], [])
        assert largest(character, found, Algorithm.LBS_ACCURATE) < DEGREES
        assert largest(character, found, Algorithm.LBS_STANDARD) > 5


@pytest.mark.parametrize("case", cases(OLDEST, "before"))
def test_an_engine_that_is_too_old_is_named_and_lit_standard(apps: Apps, case: Case, tmp_path: Path) -> None:
    """It is the oldest one with the number before it: of what came before, much does not even build."""
    dist = tmp_path / "dist"
    shutil.copytree(apps(case), dist)
    name = NAMES[case.package]
    major, minor, patch = map(int, case.version.split("."))
    number, earlier = case.version, f"{major}.{minor - 1}.{patch}"
    if name == "three.js":
        number, earlier = str(minor), str(minor - 1)
    for path in dist.rglob("*.js"):
        text = path.read_text(encoding="utf-8")
        path.write_text(
            re.sub(rf"([\"'`]){re.escape(number)}\1", rf"\g<1>{earlier}\1", text), encoding="utf-8"
        )
    (tmp_path / "page").mkdir()
    character, found = shown(dist, tmp_path / "page", pose_for(case))
    shown_version = f"0.{earlier}" if name == "three.js" else earlier
    oldest = f"{major}.{minor}"
    assert found["report"] == ["standard", f"{name} {shown_version} is too old: this needs {oldest} or newer"]
    assert [line.partition("lighting: ")[2] for line in found["said"]] == [found["report"][1]]
    baseline = Baseline.INVERSE_TRANSPOSE if name == "Galacean" else Baseline.BLENDED
    assert largest(character, found, Algorithm.LBS_STANDARD, baseline) < DEGREES


NAMES = {"three": "three.js", "babylon": "Babylon.js", "playcanvas": "PlayCanvas", "galacean": "Galacean"}


@pytest.mark.parametrize("case", cases(OLDEST, ""))
def test_packages_ask_for_the_engines_that_are_tested(case: Case) -> None:
    """From the oldest on, up to the end of the newest one's major version."""
    package = json.loads((engines_folder() / case.package / "package.json").read_text(encoding="utf-8"))
    if case.page == "three_webgpu.mjs":
        return
    major, minor, _ = case.version.split(".")
    for name in case.engine:
        newest = int(version_of(name).split(".")[0])
        assert package["peerDependencies"][name] == f">={major}.{minor}.0 <{newest + 1}.0.0"


def test_model_viewer_is_lit_by_its_own_three(apps: Apps, tmp_path: Path) -> None:
    engine = {"three": f"{OTHER}/three", "@google/model-viewer": f"{OTHER}/@google/model-viewer"}
    character, found = shown(apps(Case("model_viewer.mjs", "three", engine)), tmp_path, BENT)
    assert (found["report"], found["said"]) == (["accurate", ""], [])
    assert largest(character, found, Algorithm.LBS_ACCURATE) < DEGREES
    assert largest(character, found, Algorithm.LBS_STANDARD) > 5


def test_a_frame_is_lit_by_the_three_inside_it(tmp_path: Path) -> None:
    require_node(f"{OTHER}/aframe")
    imports = {"three": "/pages/three_of_aframe.mjs", "skinbake-three": "/package/index.js"}
    scripts = ["/support/capture.js", "/aframe/dist/aframe-v1.8.0.min.js"]
    page = page_of("/pages/aframe.mjs", imports, scripts=scripts)
    served = {"pages": HERE / "pages", "package": engines_folder() / "three"}
    served["aframe"] = package_folder(f"{OTHER}/aframe")
    character, found = drawn(page, served, tmp_path, BENT)
    assert (found["report"], found["said"]) == (["accurate", ""], [])
    assert largest(character, found, Algorithm.LBS_ACCURATE) < DEGREES
    assert largest(character, found, Algorithm.LBS_STANDARD) > 5
