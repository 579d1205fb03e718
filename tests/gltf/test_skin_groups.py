"""Which meshes count as one character, and what the notice says of those that do not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fixtures.builder import JsonObject
from skinbake.errors import InputError
from skinbake.gltf.document import read_document
from skinbake.gltf.skin_groups import meshes_of_one_skin
from tests.support.cutting import cut_into_meshes
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, edited, rewritten


def cut(folder: Path, change: Any = None, *, own_skins: bool = False) -> Path:
    path = cut_into_meshes(FOLDER / "two_primitives.glb", folder / "cut.glb", own_skins=own_skins)
    if change is not None:
        model = read(path)
        change(model.content)
        rewritten(model, path)
    return path


def groups(path: Path) -> tuple[list[list[int]], list[str]]:
    found, notices = meshes_of_one_skin(read_document(str(path)), [0, 1])
    return found, [notice.code for notice in notices]


def second_node(content: JsonObject) -> JsonObject:
    return next(node for node in content["nodes"] if node.get("mesh") == 1)


def also_drawn_alone(content: JsonObject) -> None:
    """Draw the second mesh once more, by a skin of other joints in the same order."""
    joints = content["skins"][0]["joints"]
    first = len(content["nodes"])
    content["nodes"] += [{"name": f"other {number}"} for number in range(len(joints))]
    content["skins"].append({"joints": list(range(first, first + len(joints)))})
    content["nodes"].append({"mesh": 1, "skin": len(content["skins"]) - 1})


def test_meshes_of_one_skin_are_one_group(tmp_path: Path) -> None:
    assert groups(cut(tmp_path)) == ([[0, 1]], [])


def test_equal_skins_are_one_skin(tmp_path: Path) -> None:
    assert groups(cut(tmp_path, own_skins=True)) == ([[0, 1]], [])


def test_other_inverse_bind_matrices_are_another_mesh_space(tmp_path: Path) -> None:
    def unbound(content: JsonObject) -> None:
        del content["skins"][1]["inverseBindMatrices"]

    assert groups(cut(tmp_path, unbound, own_skins=True)) == ([[0], [1]], ["weld-apart"])


def test_joints_in_another_order_are_another_skin(tmp_path: Path) -> None:
    def turned(content: JsonObject) -> None:
        content["skins"][1]["joints"].reverse()

    assert groups(cut(tmp_path, turned, own_skins=True)) == ([[0], [1]], ["weld-apart"])


def test_a_mesh_that_a_further_skin_draws_alone_stays_apart(tmp_path: Path) -> None:
    assert groups(cut(tmp_path, also_drawn_alone)) == ([[0], [1]], ["weld-apart"])


def test_meshes_that_several_skins_draw_together_are_one_group(tmp_path: Path) -> None:
    def both(content: JsonObject) -> None:
        also_drawn_alone(content)
        content["nodes"].append({"mesh": 0, "skin": len(content["skins"]) - 1})

    assert groups(cut(tmp_path, both)) == ([[0, 1]], [])


def test_two_characters_of_their_own_joints_are_no_notice(tmp_path: Path) -> None:
    def moved(content: JsonObject) -> None:
        also_drawn_alone(content)
        content["nodes"].pop()
        second_node(content)["skin"] = len(content["skins"]) - 1

    assert groups(cut(tmp_path, moved)) == ([[0], [1]], [])


def test_the_notice_counts_the_groups_and_names_them(tmp_path: Path) -> None:
    path = cut(tmp_path, also_drawn_alone)
    _, [notice] = meshes_of_one_skin(read_document(str(path)), [0, 1])
    assert notice.count == 2
    assert notice.message.endswith("The groups begin with meshes 0, 1")


def test_a_skin_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    path = edited("seam.glb", tmp_path, lambda content: content["skins"][0].update(inverseBindMatrices=10**6))
    with pytest.raises(InputError, match="inverseBindMatrices"):
        meshes_of_one_skin(read_document(str(path)), [0])
