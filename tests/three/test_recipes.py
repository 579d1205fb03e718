"""The recipes: import maps, bundlers, and react-three-fiber, built by vite and run in a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from skinbake.shaders.engines import engines_folder
from skinbake.skinning.rest import Algorithm
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


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the page of react-three-fiber, and return its folder."""
    require_node("vite", "react", "react-dom", "@react-three/fiber", "three")
    project = tmp_path_factory.mktemp("project")
    (project / "node_modules").symlink_to(package_folder("vite").parent)
    build_page(
        project,
        HERE / "recipes" / "fiber.jsx",
        {"skinbake-three": str(PACKAGE / "index.js")},
        define={"process.env.NODE_ENV": '"production"'},
    )
    return project / "dist"


@pytest.mark.slow
def test_react_three_fiber_built_by_vite_keeps_inline_materials_accurate(built: Path, tmp_path: Path) -> None:
    with opened_page(PAGE, tmp_path, {"built": built}) as (page, models):
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


@pytest.mark.slow
def test_a_file_that_is_preloaded_without_the_plugin_is_told_of(built: Path, tmp_path: Path) -> None:
    """As gltfjsx writes it. With the plugin in both places, as the readme has it, it is lit accurately."""
    with opened_page(PAGE, tmp_path, {"built": built}) as (page, models):
        stage = ThreeStage(page, models)
        url = stage.character(TUBE, BENT).told(Placement())["url"]
        assert page.call("preloaded", {"url": url, "isExtended": False}) == ["standard"]
        said: list[str] = []
        while not said:
            page.call("(() => new Promise(requestAnimationFrame))")
            said = [line for line in page.messages() if "skinbake" in line]
        assert said == [
            'skinbake: "tube" has three.js\'s standard lighting: applySkinbake has not been called for it. '
            "Register SkinbakePlugin wherever its file is loaded, in useGLTF.preload() too"
        ]
        assert page.call("preloaded", {"url": f"{url}?again", "isExtended": True}) == ["accurate"]
        assert [line for line in page.messages() if "skinbake" in line] == []
