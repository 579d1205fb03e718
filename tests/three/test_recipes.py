"""The recipes for bundlers and react-three-fiber: built by vite, and run in a browser."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from skinbake.skinning.algorithms import Algorithm
from tests.support import browser
from tests.support.characters import Placement
from tests.support.node import SUPPORT, package_folder, require_node
from tests.three.drawn import BENT, DEGREES, TUBE, Stage, expected, largest
from tests.three.write_package import FOLDER as PACKAGE

HERE = Path(__file__).resolve().parent
PAGE = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<script src="/support/capture.js"></script>
<body><script type="module">window.ready = import('/built/app.js');</script>
"""


@pytest.mark.slow
def test_react_three_fiber_built_by_vite_keeps_inline_materials_accurate(tmp_path: Path) -> None:
    node = require_node("vite", "react", "react-dom", "@react-three/fiber", "three")
    for name in ("models", "profile", "project"):
        (tmp_path / name).mkdir()
    project = tmp_path / "project"
    (project / "node_modules").symlink_to(package_folder("vite").parent)
    (project / "app.jsx").write_bytes((HERE / "recipes" / "fiber.jsx").read_bytes())
    (project / "package.json").write_text('{"name": "project", "private": true, "type": "module"}')
    configuration = {
        "resolve": {"alias": {"skinbake-three": str(PACKAGE / "index.js")}, "dedupe": ["three"]},
        "define": {"process.env.NODE_ENV": '"production"'},
        "build": {"minify": False, "lib": {"entry": "app.jsx", "formats": ["es"], "fileName": "app"}},
        "logLevel": "warn",
    }
    (project / "vite.config.mjs").write_text(f"export default {json.dumps(configuration)};")
    vite = package_folder("vite") / "bin" / "vite.js"
    done = subprocess.run(
        [node, str(vite), "build"],
        cwd=project,
        capture_output=True,
        encoding="utf-8",
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    folders = {"models": tmp_path / "models", "built": project / "dist", "support": SUPPORT}
    with browser.opened(PAGE, folders, tmp_path / "profile") as page:
        character = Stage(page, tmp_path / "models").character(TUBE, BENT)
        found = page.call("show", character.told(Placement()))["found"]
        assert [line for line in page.messages() if "skinbake" in line] == []
    assert [[report[:2] for report in one["reports"]] for one in found] == [
        [["accurate", "ffa500"]],
        [["accurate", "008080"]],
    ]
    for one in found:
        world = one["reports"][0][2]
        assert largest(one["values"], expected(character, world)) < DEGREES
        assert largest(one["values"], expected(character, world, Algorithm.LBS_APPROXIMATED)) > 10
