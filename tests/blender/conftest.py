"""Blender runs once for all tests, and starts slowly."""

from __future__ import annotations

import pytest

from tests.blender.running import Session, run_once
from tests.support import corpus, corpus_folder

MODELS = ("CesiumMan/CesiumMan.glb", "Alien/Alien_Scolitex.gltf")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that runs Blender as slow, before the marked ones are left out."""
    for item in items:
        if isinstance(item, pytest.Function) and "session" in item.fixturenames:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Session:
    """Return the results of Blender, with the characters of the corpus where it is."""
    base = tmp_path_factory.getbasetemp()
    shared = (base if worker_id == "master" else base.parent) / "blender"
    models = [corpus.model(name) for name in MODELS] if corpus_folder.find_corpus() else []
    return run_once(shared, models)
