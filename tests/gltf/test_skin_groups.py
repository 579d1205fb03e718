"""Which meshes count as one character, and what the notice says of those that do not."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import pytest

from fixtures.builder import JsonObject
from skinbake.errors import InputError
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.scenes import meshes_of_one_skin, tell_meshes_apart
from tests.support.cutting import cut_into_meshes
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, edited, rewritten
from tests.support.small_documents import Builder


def cut(folder: Path, change: Any = None, *, own_skins: bool = False) -> Path:
    path = cut_into_meshes(FOLDER / "two_primitives.glb", folder / "cut.glb", own_skins=own_skins)
    if change is not None:
        model = read(path)
        change(model.content)
        rewritten(model, path)
    return path


def groups(path: Path) -> tuple[list[list[int]], list[str]]:
    document = read_document(str(path))
    found = meshes_of_one_skin(document, [0, 1])
    tell_meshes_apart(document, [0, 1])
    return found, [notice.code for notice in document.notices]


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


def test_different_inverse_bind_matrices_are_another_mesh_space(tmp_path: Path) -> None:
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
    document = read_document(str(path))
    tell_meshes_apart(document, [0, 1])
    [notice] = document.notices
    assert notice.count == 2
    assert notice.message.endswith("The groups begin with meshes 0, 1")


def test_a_skin_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    path = edited("seam.glb", tmp_path, lambda content: content["skins"][0].update(inverseBindMatrices=10**6))
    with pytest.raises(InputError, match="inverseBindMatrices"):
        meshes_of_one_skin(read_document(str(path)), [0])


def drawn(skins: list[list[int]], draws: list[list[int]]) -> Document:
    """Return a document of skins, each a list of joints, and of meshes, each with the skins that draw it."""
    builder = Builder()
    nodes: list[JsonObject] = [{} for _ in range(1 + max(max(joints) for joints in skins))]
    nodes += [{"mesh": mesh, "skin": skin} for mesh, by in enumerate(draws) for skin in by]
    builder.json |= {"nodes": nodes, "skins": [{"joints": joints} for joints in skins]}
    builder.json["meshes"] = [{"primitives": []} for _ in draws]
    return builder.document()


@pytest.mark.parametrize("seed", range(40))
def test_groups_apart_are_those_of_which_a_pair_shares_a_joint(seed: int) -> None:
    random = Random(seed)
    nodes = random.choice((4, 12, 30))
    skins = [random.sample(range(nodes), random.randint(1, 3)) for _ in range(8)]
    draws = [random.sample(range(8), random.randint(1, 2)) for _ in range(6)]
    by_joints = [frozenset(tuple(skins[skin]) for skin in by) for by in draws]
    first = [mesh for mesh, joints in enumerate(by_joints) if joints not in by_joints[:mesh]]
    moved = {mesh: {node for joints in by_joints[mesh] for node in joints} for mesh in first}
    expected = [mesh for mesh in first if any(moved[mesh] & moved[other] for other in first if other != mesh)]
    document = drawn(skins, draws)
    found = meshes_of_one_skin(document, range(6))
    tell_meshes_apart(document, range(6))
    notices = list(document.notices)
    assert [group[0] for group in found] == first
    assert [notice.count for notice in notices] == ([len(expected)] if expected else [])
    for notice in notices:
        assert notice.message.endswith(f"begin with meshes {', '.join(map(str, expected))}")


def test_the_joints_of_many_groups_are_not_compared_by_pairs() -> None:
    compared = 0

    class Joint(int):
        """A node that counts how often it is found equal to another or not."""

        def __eq__(self, other: object) -> bool:
            nonlocal compared
            compared += 1
            return int(self) == other

        def __hash__(self) -> int:
            return int(self)

    count = 20
    skins = [[(node + skin) % count for node in range(count)] for skin in range(count)]
    document = drawn(skins, [[skin] for skin in range(count)])
    for skin in document.objects("skins"):
        skin["joints"] = [Joint(node) for node in skin["joints"]]
    assert meshes_of_one_skin(document, range(count)) == [[mesh] for mesh in range(count)]
    tell_meshes_apart(document, range(count))
    (notice,) = document.notices
    assert notice.count == count
    assert compared <= 8 * count * count  # joints in all skins: count²; by pairs of groups it is count³
