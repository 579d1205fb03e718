"""The types of the npm package, under ``tsc --strict``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from skinbake.shaders.engines import engines_folder
from tests.support.node import package_folder, require_node, run_program

pytestmark = pytest.mark.slow


def test_a_use_of_the_package_compiles_under_tsc_strict(tmp_path: Path) -> None:
    require_node("typescript", "@babylonjs/core", "@babylonjs/loaders")
    shutil.copy(Path(__file__).parent / "usage.ts", tmp_path / "usage.ts")
    names = {"@babylonjs/*": str(package_folder("@babylonjs") / "*")}
    names |= {"skinbake-babylon": str(engines_folder() / "babylon" / "index.d.ts")}
    options = {"strict": True, "noEmit": True, "module": "nodenext", "target": "es2022", "types": []}
    # Babylon.js's own declarations are large: they are believed.
    options |= {"lib": ["es2022", "dom"], "skipLibCheck": True}
    options |= {"paths": {name: [path] for name, path in names.items()}}
    configuration = {"compilerOptions": options, "files": ["usage.ts"]}
    (tmp_path / "tsconfig.json").write_text(json.dumps(configuration))
    (tmp_path / "package.json").write_text('{"name": "empty", "private": true, "type": "module"}')
    run_program("typescript", "tsc", "-p", ".", folder=tmp_path)
