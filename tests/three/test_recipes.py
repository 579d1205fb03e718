"""The recipes: import maps, bundlers, and react-three-fiber, built by vite and run in a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from skinbake.shaders.engines import engines_folder
from skinbake.skinning.algorithms import Algorithm
from tests.support.characters import Placement
from tests.support.node import build_page, package_folder, require_node
from tests.support.stage import opened_page, page_of
from tests.three.drawn import BENT, DEGREES, TUBE, ThreeStage, expected, largest

HERE = Path(__file__).resolve().parent
PACKAGE = engines_folder() / "three"
PAGE = page_of("/built/app.js", scripts=["/support/capture.js"])


def test_the_import_maps_have_what_the_modules_import() -> None:
    """Every address is a file of a version that is tested here."""
    require_node("three")
    readme = (PACKAGE / "README.md").read_text(encoding="utf-8")
    webgl = re.search(r'{"imports": ({.*?})}', readme, re.DOTALL)
    webgpu = re.search(r"```json\n(.*?)```", readme, re.DOTALL)
    assert webgl
    assert webgpu
    maps = [json.loads(webgl[1]), json.loads(webgl[1]) | json.loads(webgpu[1])]
    for name, found in zip(("index.js", "webgpu.js"), maps, strict=True):
        text = (PACKAGE / name).read_text(encoding="utf-8")
        bare = set(re.findall(r"^(?:import|export|}) .*from '([^.].*)';$", text, re.MULTILINE))
        assert bare
        assert bare <= set(found)
    for address in maps[1].values():
        matched = re.fullmatch(r"https://cdn\.jsdelivr\.net/npm/(.*)@(.*?)/(.*)", address)
        assert matched
        package, version, path = matched.groups()
        folder = PACKAGE if package == "skinbake-three" else package_folder(package)
        assert json.loads((folder / "package.json").read_text(encoding="utf-8"))["version"] == version
        assert (folder / path).exists()


@pytest.mark.slow
def test_react_three_fiber_built_by_vite_keeps_inline_materials_accurate(tmp_path: Path) -> None:
    require_node("vite", "react", "react-dom", "@react-three/fiber", "three")
    project = tmp_path / "project"
    project.mkdir()
    (project / "node_modules").symlink_to(package_folder("vite").parent)
    build_page(
        project,
        HERE / "recipes" / "fiber.jsx",
        {"skinbake-three": str(PACKAGE / "index.js")},
        define={"process.env.NODE_ENV": '"production"'},
    )
    with opened_page(PAGE, tmp_path, {"built": project / "dist"}) as (page, models):
        character = ThreeStage(page, models).character(TUBE, BENT)
        found = page.call("show", character.told(Placement()))["found"]
        assert [line for line in page.messages() if "skinbake" in line] == []
    assert [[report[:2] for report in one["reports"]] for one in found] == [
        [["accurate", "ffa500"]],
        [["accurate", "008080"]],
    ]
    for one in found:
        world = one["reports"][0][2]
        assert largest(one["values"], expected(character, world)) < DEGREES
        assert largest(one["values"], expected(character, world, Algorithm.LBS_STANDARD)) > 10
