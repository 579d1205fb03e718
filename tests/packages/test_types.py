"""The types of the npm packages, under ``tsc --strict``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from skinbake.shaders.engines import engines_folder
from tests.support.node import package_folder, require_node, run_program

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("package", "engines", "declarations"),
    [
        ("babylon", ["@babylonjs/core", "@babylonjs/loaders"], "*"),
        ("galacean", ["@galacean/engine"], "*/types/index.d.ts"),
    ],
)
def test_a_use_of_the_package_compiles_under_tsc_strict(
    package: str, engines: list[str], declarations: str, tmp_path: Path
) -> None:
    require_node("typescript", *engines)
    shutil.copy(Path(__file__).parent / "usage" / f"{package}.ts", tmp_path / "usage.ts")
    scope = engines[0].partition("/")[0]
    names = {f"{scope}/*": str(package_folder(scope) / declarations)}
    names |= {f"skinbake-{package}": str(engines_folder() / package / "index.d.ts")}
    options = {"strict": True, "noEmit": True, "module": "nodenext", "target": "es2022", "types": []}
    # The engines' own declarations are large: they are believed.
    options |= {"lib": ["es2022", "dom"], "skipLibCheck": True}
    options |= {"paths": {name: [path] for name, path in names.items()}}
    configuration = {"compilerOptions": options, "files": ["usage.ts"]}
    (tmp_path / "tsconfig.json").write_text(json.dumps(configuration))
    (tmp_path / "package.json").write_text('{"name": "empty", "private": true, "type": "module"}')
    run_program("typescript", "tsc", "-p", ".", folder=tmp_path)
