"""The default bake is no worse than standard lighting, or keeps only a part of α and β; verify knows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from skinbake.gradients.baker import EIGHTHS, kept_slots
from skinbake.measure import guard
from tests.measure import random_rigs, stiff_models
from tests.measure.stiff_models import Mesh, Motion
from tests.support import corpus
from tests.support.baked_files import Answer, Editable, baked, verify
from tests.support.command_line import document, invoke
from tests.support.models import FOLDER
from tests.support.schemas import BAKE

Generator = np.random.Generator
Made = tuple[Mesh, list[Motion]]


def robot(generator: Generator) -> Made:
    mesh = stiff_models.robot(generator)
    return mesh, list(stiff_models.turns(generator, len(mesh.origins), 60.0))


def spring(generator: Generator) -> Made:
    mesh = stiff_models.spring(generator)
    turned = stiff_models.turns(generator, len(mesh.origins), 40.0)
    return mesh, [*turned, *stiff_models.stretches(generator, mesh.origins)]


HELD = (spring, 4)
"""A model that keeps a part of its α and β, and its seed."""


def scaled_chain(generator: Generator) -> Made:
    mesh = stiff_models.spring(generator)
    turned = stiff_models.turns(generator, len(mesh.origins), 40.0)
    return mesh, [*turned, *stiff_models.scales(generator, len(mesh.origins))]


def six_vertices(generator: Generator) -> Made:
    mesh = stiff_models.six_vertices(generator)
    return mesh, list(stiff_models.turns(generator, 2, 90.0))


def written(make: Callable[[Generator], Made], seed: int, folder: Path) -> Path:
    return stiff_models.write(folder / "model.glb", *make(np.random.default_rng(seed)))


def errors(answer: Answer, lighting: str) -> np.ndarray[Any, Any]:
    """Return the mean errors under linear blend skinning of all primitives, by both truths."""
    truths = ("normals_by_triangles", "normals_by_tangents")
    return np.array(
        [found[truth]["lbs"][lighting]["mean"] for found in answer.file["primitives"] for truth in truths]
    )


def noted(path: Path) -> Any:
    return Editable(path).metadata().get("kept")


@pytest.mark.slow
@pytest.mark.parametrize("make", [robot, spring, scaled_chain, six_vertices])
def test_small_models_are_lit_no_worse_than_standard_in_their_clips(
    make: Callable[[Generator], Made], tmp_path: Path
) -> None:
    """Some of them would be worse, and keep only a part. The second poses are not those of the guard."""
    held = 0
    for seed in range(5):
        source = written(make, seed, tmp_path)
        target = baked(source, tmp_path / "out")
        held += noted(target) is not None
        for options in ((), ("--samples", "47")):
            answer = verify(target, "--method", "lbs", *options)
            assert answer.exit_code == 0
            assert answer.file["warnings"] == []
            assert (errors(answer, "accurate") <= 1.01 * errors(answer, "standard") + 0.01).all(), seed
    assert held > 0 or make is not spring


@pytest.mark.slow
def test_a_sample_of_a_large_mesh_tells_enough(tmp_path: Path) -> None:
    """Of 12,000 vertices, 2,200 have α and β. 2,048 of them are looked at."""
    generator = np.random.default_rng(1)
    mesh = stiff_models.robot(generator, 1_500)
    assert len(mesh.positions) == 12_000
    source = stiff_models.write(tmp_path / "large.glb", mesh)
    target = baked(source, tmp_path / "out")
    answer = verify(target, "--method", "lbs")
    assert (errors(answer, "accurate") <= 1.01 * errors(answer, "standard")).all()


@corpus.needed
def test_eyes_that_clips_move_are_lit_no_worse_than_standard(tmp_path: Path) -> None:
    source = corpus.require_corpus() / "cases" / "enemy_no_textures.glb"
    answer = verify(baked(source, tmp_path / "out"), "--method", "lbs")
    assert (errors(answer, "accurate") <= 1.01 * errors(answer, "standard") + 0.001).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["CesiumMan/CesiumMan.glb", "cases/horse_two_meshes.glb"])
def test_characters_with_scaled_joints_are_lit_no_worse_than_standard(
    name: str, seed: int, tmp_path: Path
) -> None:
    """Every joint of the character is scaled unevenly by up to 15 % in its clip."""
    cases = name.startswith("cases/")
    source = corpus.require_corpus() / name if cases else corpus.character(name)
    scaled = stiff_models.with_scaled_joints(source, tmp_path / "scaled.glb", np.random.default_rng(seed))
    answer = verify(baked(scaled, tmp_path / "out"), "--method", "lbs")
    assert (errors(answer, "accurate") <= 1.01 * errors(answer, "standard")).all()


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bake that keeps a part of its α and β."""
    folder = tmp_path_factory.mktemp("held")
    path = baked(written(*HELD, folder), folder / "out")
    assert 0.0 < noted(path) < 1.0
    return path


@pytest.mark.slow
@pytest.mark.parametrize("change", ["removed", "renamed", "resampled", "another"])
def test_no_bake_is_stale_for_a_clip_that_changes(change: str, held: Path, tmp_path: Path) -> None:
    file = Editable(held)
    [clip] = file.content["animations"]
    if change == "removed":
        del file.content["animations"]
    elif change == "renamed":
        clip["name"] = "walk"
    else:
        for sampler in clip["samplers"]:
            stored = file.stored(sampler["output"])
            stored[1:] = stored[:1] if change == "another" else (stored[1:] + stored[:-1]) / 2
    answer = verify(file.write(tmp_path / "changed.glb"), "--method", "lbs")
    assert answer.failed == []
    same = change == "renamed"
    assert ("the poses of the fit are not in the file" in answer.file["checks"][1]["remark"]) is not same


@pytest.mark.parametrize("part", [None, 0.125])
def test_another_part_than_that_of_the_bake_is_stale(part: float | None, held: Path, tmp_path: Path) -> None:
    file = Editable(held)
    file.metadata()["kept"] = part
    if part is None:
        del file.metadata()["kept"]
    assert verify(file.write(tmp_path / "changed.glb")).failed == ["freshness"]


@pytest.mark.parametrize("slots", ["_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"])
@pytest.mark.parametrize("factor", [0.5, 0.99])
def test_a_note_of_other_numbers_than_the_kept_is_stale(
    slots: str, factor: float, held: Path, tmp_path: Path
) -> None:
    file = Editable(held)
    file.array(slots)[:] *= factor
    assert verify(file.write(tmp_path / "changed.glb")).failed == ["freshness"]


@pytest.mark.parametrize("share", [1.1, {}, -0.5, True, "all"])
def test_a_part_that_no_bake_writes_is_damage(share: Any, held: Path, tmp_path: Path) -> None:
    file = Editable(held)
    file.metadata()["kept"] = share
    [problem] = verify(file.write(tmp_path / "changed.glb")).problems("structure")
    assert problem["code"] == "metadata-broken"
    assert '"kept" is' in problem["message"]


def test_bake_says_what_it_kept(tmp_path: Path) -> None:
    source = written(*HELD, tmp_path)
    result = invoke("bake", source, "-o", tmp_path / "out.glb", "--json", "-v")
    [primitive] = document(result)["files"][0]["primitives"]
    assert 0.0 < primitive["kept"] < 1.0
    assert f"keeping {100 * primitive['kept']:.1f} % of α/β" in result.stderr
    plain = invoke("bake", source, "-o", tmp_path / "out.glb")
    assert "1 primitive held back (all of α/β would light it worse)" in plain.stdout


def test_a_primitive_is_left_to_standard_lighting_where_all_parts_of_the_fit_are_worse(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The first of two primitives is judged so. The other one is baked without it, and judged again."""
    judged = iter([[[guard.UNBAKED, EIGHTHS]], [[EIGHTHS]]])
    monkeypatch.setattr(guard, "kept_eighths", lambda *_: next(judged))
    source, target = FOLDER / "two_primitives.glb", tmp_path / "out.glb"
    result = invoke("bake", source, "-o", target, "--json")
    [file] = document(result)["files"]
    assert [one["code"] for one in file["warnings"]] == ["standard-is-better"]
    assert (len(file["primitives"]), file["skipped"]) == (1, 1)
    answer = verify(target)
    assert answer.exit_code == 0
    assert "left by bake --gradients fitted" in answer.file["checks"][0]["remark"]
    assert invoke("strip", target, "-o", tmp_path / "back.glb", "-q").exit_code == 0
    assert (tmp_path / "back.glb").read_bytes() == source.read_bytes()


@pytest.mark.parametrize("order", [1, -1])
def test_a_clip_is_seen_among_many_that_alternate_with_it(order: int, tmp_path: Path) -> None:
    """A rig whose clip leaves it unbaked. Every other one of its 48 clips stands still."""
    model = Editable(random_rigs.write(285, tmp_path))
    [moving] = model.content["animations"]
    keys = np.zeros((1, 1), dtype=np.float32), np.array([[0, 0, 0, 1]], dtype=np.float32)
    times, turn = map(model.add, keys)
    target = {"node": moving["channels"][0]["target"]["node"], "path": "rotation"}
    still = {"samplers": [{"input": times, "output": turn}], "channels": [{"sampler": 0, "target": target}]}
    model.content["animations"] = [still, moving][::order] * 24
    result = invoke("bake", model.write(tmp_path / "many.glb"), "-o", tmp_path / "out.glb", "--json")
    assert document(result)["files"][0]["status"] == "left"


def test_a_file_of_which_nothing_is_lit_better_is_left_with_a_note(tmp_path: Path) -> None:
    source, target = random_rigs.write(195, tmp_path), tmp_path / "out.glb"
    result = document(invoke("bake", source, "-o", target, "--json", "--require-baked"))
    jsonschema.validate(result, BAKE)
    [file] = result["files"]
    assert (file["status"], file["left"]["reason"]) == ("left", "standard lighting is better")
    assert [one["code"] for one in file["warnings"]] == ["standard-is-better"]
    answer = verify(target, "--require-baked", "--min-gain", "1.2")
    assert (answer.exit_code, answer.file["left"]) == (0, True)
    assert answer.file["checks"][0]["remark"] == (
        "left unbaked by bake --gradients fitted: standard lighting is better"
    )
    assert verify(source, "--require-baked").exit_code == 1
    assert invoke("strip", target, "-o", tmp_path / "back.glb", "-q").exit_code == 0
    assert (tmp_path / "back.glb").read_bytes() == source.read_bytes()
    assert invoke("bake", target, "--in-place", "--gradients", "surface").exit_code == 0
    assert verify(target).failed == []


def test_a_model_that_gains_keeps_all(tmp_path: Path) -> None:
    result = invoke("bake", FOLDER / "bent_tube.glb", "-o", tmp_path / "out.glb", "--json")
    assert document(result)["files"][0]["primitives"][0]["kept"] is None
    assert noted(tmp_path / "out.glb") is None


def test_a_broken_clip_leaves_the_bake_unjudged(tmp_path: Path) -> None:
    file = Editable(written(*HELD, tmp_path))
    file.stored(file.content["animations"][0]["samplers"][0]["input"])[0] = 99.0
    result = invoke("bake", file.write(tmp_path / "broken.glb"), "-o", tmp_path / "out.glb", "--json")
    assert result.exit_code == 0
    [found] = document(result)["files"]
    assert [notice["code"] for notice in found["warnings"]] == ["fit-poses-unread", "not-judged"]
    assert found["primitives"][0]["kept"] is None


def two_primitives() -> tuple[Any, Any]:
    """Return α and β of two primitives, and classes: they meet in class 1."""
    generator = np.random.default_rng(0)
    slots = [tuple(generator.normal(size=(2, 3, 3)).astype(np.float32)) for _ in range(2)]
    return slots, [np.array([0, 1, 0]), np.array([1, 2, 3])]


def test_copies_keep_as_many_eighths_as_the_least_of_them() -> None:
    slots, classes = two_primitives()
    found = kept_slots(slots, classes, [3, 5])
    for slot in range(2):
        expected = slots[0][slot] * 3 / 8, slots[1][slot] * np.array([[3], [5], [5]]) / 8
        for mine, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(mine[slot], theirs, rtol=1e-6)


def test_primitives_that_keep_all_keep_every_bit() -> None:
    slots, classes = two_primitives()
    found = kept_slots(slots, classes, [EIGHTHS, EIGHTHS])
    assert all(
        np.array_equal(mine, theirs)
        for pair in zip(found, slots, strict=True)
        for mine, theirs in zip(*pair, strict=True)
    )


def test_the_bytes_do_not_depend_on_threads(tmp_path: Path) -> None:
    source = written(*HELD, tmp_path)
    found = []
    for count in ("1", "3"):
        target = tmp_path / f"{count}.glb"
        assert invoke("bake", source, "-o", target, "-q", "--threads", count).exit_code == 0
        found.append(target.read_bytes())
    assert found[0] == found[1]
