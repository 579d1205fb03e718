"""Real characters: the models of the corpus, which is not part of this repository, or those of fixtures/.

``corpus_folder`` finds the corpus. Without it, ``model`` and ``valid_models`` return the few characters of
``fixtures/characters``, and ``character`` one that stands in for another model. A test of any other model is
skipped, in a strict run too: it is data, not a tool. At module level ``needed`` and ``parameters`` keep the
other tests of the module running; every other function here may skip the whole module.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import pytest

from tests.support.corpus_folder import REPOSITORY, find_corpus

if TYPE_CHECKING:
    from pytest import ParameterSet

NOT_HERE = "the corpus of real models is not here: set SKINBAKE_CORPUS"
CHARACTERS = REPOSITORY / "fixtures" / "characters"
STAND_INS = {
    "CesiumMan/CesiumMan.glb": "barbarian_walking.glb",
    "pbrTest/pbrTest.gltf": "butterfly_wings.glb",
    "Butterfly/animated_butterfly.glb": "butterfly_wings.glb",
}
"""For models of the corpus, the character of fixtures/ with the same features: clips, and TANGENT or none."""

Item = TypeVar("Item", Path, tuple[Path, str])


needed = pytest.mark.skipif(find_corpus() is None, reason=NOT_HERE)
"""Marks a test, or a case of one, that takes a model of the corpus which fixtures/ does not have."""


def require_corpus() -> Path:
    """Return the corpus folder, or skip the test (or the module being collected)."""
    folder = find_corpus()
    if folder is None:
        pytest.skip(NOT_HERE, allow_module_level=True)
    return folder


def valid_models() -> list[Path]:
    """Return the 52 public and 13 derived models: .gltf, .glb and .vrm files, in the order of the index.

    Without the corpus, return the characters of fixtures/.
    """
    corpus = find_corpus()
    if corpus is None:
        return sorted(CHARACTERS.glob("*.gl*"))
    public = [corpus / "public" / row["file"] for row in _rows(corpus / "public" / "ATTRIBUTION.tsv")]
    derived = [corpus / "derived" / row["path"] for row in _rows(corpus / "derived" / "INDEX.tsv")]
    return public + derived


def invalid_models() -> list[tuple[Path, str]]:
    """Return the 339 broken or odd files, each with the verdict of the index.

    A verdict is ``ERROR``, ``WARN``, ``see note``, or starts with ``valid``.
    """
    folder = require_corpus() / "invalid"
    return [(folder / row["path"], row["verdict"]) for row in _rows(folder / "INDEX.tsv")]


def hostile_files(finding: str = "") -> list[Path]:
    """Return the .glb and .gltf files that once broke a promise, those of one finding like ``F06`` or all."""
    folder = require_corpus() / "hostile"
    if not folder.is_dir():
        pytest.skip("this corpus has no hostile files", allow_module_level=True)
    found = (path for path in folder.rglob("*") if path.suffix in {".glb", ".gltf"})
    return sorted(path for path in found if path.relative_to(folder).parts[0].startswith(finding))


def case(name: str) -> Path:
    """Return one of the models that once showed a defect, or skip."""
    path = require_corpus() / "cases" / name
    if not path.is_file():
        pytest.skip(f"this corpus has no cases/{name}")
    return path


def model(name: str) -> Path:
    """Return one model by its path below ``public`` or ``derived``, such as ``CesiumMan/CesiumMan.glb``.

    Without the corpus, return the character of this name, or skip.
    """
    corpus = find_corpus()
    if corpus is None:
        path = CHARACTERS / Path(name).name
        return path if path.is_file() else require_corpus()
    for folder in ("public", "derived"):
        if (corpus / folder / name).is_file():
            return corpus / folder / name
    raise FileNotFoundError(f"{name} is in neither public nor derived of {corpus}")


def character(name: str) -> Path:
    """Return one model for a test that holds of any like it; without the corpus, the model's stand-in."""
    return model(name if find_corpus() else STAND_INS.get(name, name))


def parameters(models: Callable[[], list[Item]]) -> list[ParameterSet]:
    """Return ``models()`` for pytest.mark.parametrize, with readable ids; one skipped case where it skips.

    ``@pytest.mark.parametrize("path", parameters(valid_models))`` or
    ``@pytest.mark.parametrize("case", parameters(invalid_models))``.
    """
    try:
        cases = models()
    except pytest.skip.Exception as absent:
        return [pytest.param(None, id="no-files", marks=pytest.mark.skip(reason=str(absent)))]
    folder = find_corpus() or CHARACTERS
    return [pytest.param(case, id=_path(case).relative_to(folder).as_posix()) for case in cases]


def _path(case: Path | tuple[Path, str]) -> Path:
    return case if isinstance(case, Path) else case[0]


def _rows(index: Path) -> list[dict[str, str]]:
    # The notes hold quotes and commas of their own: tabs alone separate.
    with index.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines, delimiter="\t", quoting=csv.QUOTE_NONE))
