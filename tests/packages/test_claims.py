"""What all adapters ask of a bake takes no longer than the arrays and the JSON that a file really has."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from skinbake.shaders.engines import engines_folder
from tests.support.node import require_node

HERE = Path(__file__).resolve().parent


@pytest.fixture(scope="module")
def answers() -> dict[str, dict[str, Any]]:
    """What ``bake.js`` says of each case of ``claims.mjs``, and how many elements it has read for it."""
    done = subprocess.run(
        [require_node(), "--max-old-space-size=512", HERE / "claims.mjs", engines_folder() / "bake.js"],
        capture_output=True,
        encoding="utf-8",
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    answers: dict[str, dict[str, Any]] = json.loads(done.stdout)
    return answers


@pytest.mark.slow
def test_the_joints_of_a_sound_file_are_read_and_compared(answers: dict[str, dict[str, Any]]) -> None:
    assert answers["sound"]["first"].startswith("a tool has changed the order of its joints")
    assert answers["sound"]["reads"] == 3 * 4 + 3


@pytest.mark.parametrize("case", ["vertices", "vertices without indices", "corners", "sets", "bounds"])
def test_a_count_that_no_array_has_is_not_counted_up_to(
    case: str, answers: dict[str, dict[str, Any]]
) -> None:
    assert answers[case]["reads"] <= 3 * 4 + 3
    assert (answers[case]["stale"] == 0) == (case != "bounds")


@pytest.mark.parametrize(
    ("case", "primitives"), [("many nodes", 2_000), ("many skins", 2_000), ("a chain of skins", 3 * 1024)]
)
def test_nodes_and_skins_that_share_meshes_read_each_primitive_a_few_times(
    case: str, primitives: int, answers: dict[str, dict[str, Any]]
) -> None:
    """One primitive of the first mesh is stale, so all meshes of its skins are, and so on along the chain."""
    assert answers[case]["stale"] == primitives
    assert answers[case]["reads"] <= 4 * primitives


def test_more_names_than_influences_are_damage_and_not_read(answers: dict[str, dict[str, Any]]) -> None:
    assert answers["names"]["first"] == "the metadata of its bake is damaged: bake it again"
    assert answers["names"]["reads"] == 0
