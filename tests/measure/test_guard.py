"""The default bake is no worse than standard lighting, or keeps only a part of its fit; verify knows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Gradients
from skinbake.gradients.kept import EIGHTHS, kept_eighths, mixed, scaled
from tests.measure import stiff_models
from tests.measure.stiff_models import Mesh, Motion
from tests.support import corpus
from tests.support.baked_files import Answer, Editable, baked, verify
from tests.support.command_line import document, invoke
from tests.support.models import FOLDER

Generator = np.random.Generator
Made = tuple[Mesh, list[Motion]]


def still_robot(generator: Generator) -> Made:
    return stiff_models.robot(generator), []


def robot(generator: Generator) -> Made:
    mesh = stiff_models.robot(generator)
    return mesh, list(stiff_models.turns(generator, len(mesh.origins), 60.0))


def still_chain(generator: Generator) -> Made:
    return stiff_models.spring(generator), []


def spring(generator: Generator) -> Made:
    mesh = stiff_models.spring(generator)
    turned = stiff_models.turns(generator, len(mesh.origins), 40.0)
    return mesh, [*turned, *stiff_models.stretches(generator, mesh.origins)]


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
    truths = ("normals", "normals_by_triangles")
    return np.array(
        [found[truth]["lbs"][lighting]["mean"] for found in answer.file["primitives"] for truth in truths]
    )


def noted(path: Path) -> Any:
    return Editable(path).metadata().get("kept")


@pytest.mark.parametrize("make", [still_robot, robot, still_chain, spring, scaled_chain, six_vertices])
def test_small_models_are_lit_no_worse_than_standard(
    make: Callable[[Generator], Made], tmp_path: Path
) -> None:
    """Some of them would be worse, and keep only a part. The second poses are not those of the guard."""
    held = 0
    for seed in range(5):
        source = written(make, seed, tmp_path)
        target = baked(source, tmp_path / "out")
        held += noted(target) is not None
        others: tuple[str, ...] = ("--samples", "47")
        if "animations" not in Editable(source).content:
            others = ("--poses", "random", "--seed", "5", "--samples", "96")
        for options in ((), others):
            answer = verify(target, "--method", "lbs", *options)
            assert answer.exit_code == 0
            assert answer.file["warnings"] == []
            assert (errors(answer, "accurate") <= 1.01 * errors(answer, "standard") + 0.01).all(), seed
    assert held > 0 or make is scaled_chain, "the gradients of the surface are half of the fit"


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
def test_eyes_that_clips_move_are_lit_as_by_the_gradients_of_the_surface(tmp_path: Path) -> None:
    source = corpus.require_corpus() / "cases" / "enemy_no_textures.glb"
    rig = verify(baked(source, tmp_path / "rig"), "--method", "lbs")
    surface = verify(baked(source, tmp_path / "surface", gradients=Gradients.SURFACE), "--method", "lbs")
    assert (errors(rig, "accurate") <= 1.02 * errors(surface, "accurate") + 0.01).all()
    assert (errors(rig, "accurate") <= 1.01 * errors(rig, "standard")).all()


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["CesiumMan/CesiumMan.glb", "cases/horse_two_meshes.glb"])
def test_characters_with_scaled_joints_are_lit_no_worse_than_by_the_gradients_of_the_surface(
    name: str, seed: int, tmp_path: Path
) -> None:
    """Every joint of the character is scaled unevenly by up to 15 % in its clip."""
    cases = name.startswith("cases/")
    source = corpus.require_corpus() / name if cases else corpus.character(name)
    scaled = stiff_models.with_scaled_joints(source, tmp_path / "scaled.glb", np.random.default_rng(seed))
    rig = verify(baked(scaled, tmp_path / "rig"), "--method", "lbs")
    surface = verify(baked(scaled, tmp_path / "surface", gradients=Gradients.SURFACE), "--method", "lbs")
    assert (errors(rig, "accurate") <= 1.02 * errors(surface, "accurate") + 0.01).all()


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bake that keeps a part of the surface's gradients, and none of its fit."""
    folder = tmp_path_factory.mktemp("held")
    path = baked(written(spring, 2, folder), folder / "out")
    assert noted(path) == {"fit": 0.0}
    return path


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
    assert answer.file["checks"][1]["remark"] == ""


def turned(file: Editable, degrees: float, seed: int) -> Editable:
    """Store the joints but the first turned about random axes."""
    generator, half = np.random.default_rng(seed), np.radians(degrees / 2)
    for joint in file.content["skins"][0]["joints"][1:]:
        axis = generator.normal(size=3)
        axis /= np.linalg.norm(axis)
        file.content["nodes"][joint]["rotation"] = [*(np.sin(half) * axis), np.cos(half)]
    return file


@pytest.mark.parametrize(("make", "seed"), [(still_chain, 10), (still_robot, 21)])
def test_another_stored_pose_leaves_a_held_bake_fresh(
    make: Callable[[Generator], Made], seed: int, tmp_path: Path
) -> None:
    """The fit cannot be made again. What is kept leaves more error than all of the gradients would."""
    source = turned(Editable(written(make, seed, tmp_path)), 20.0, seed).write(tmp_path / "turned.glb")
    path = baked(source, tmp_path / "out")
    assert noted(path) is not None
    moved = turned(Editable(path), 25.0, seed + 100).write(tmp_path / "moved.glb")
    answer = verify(moved, "--method", "lbs")
    assert answer.failed == []
    assert "stored in another pose" in answer.file["checks"][1]["remark"]


@pytest.mark.parametrize("fit", [None, 0.25])
def test_another_part_of_the_fit_than_that_of_the_bake_is_stale(
    fit: float | None, held: Path, tmp_path: Path
) -> None:
    file = Editable(held)
    file.metadata()["kept"] = {"fit": fit}
    if fit is None:
        del file.metadata()["kept"]
    assert verify(file.write(tmp_path / "changed.glb")).failed == ["freshness"]


@pytest.mark.parametrize("slots", ["_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"])
@pytest.mark.parametrize("factor", [0.5, 0.99])
def test_numbers_that_are_no_eighths_of_the_fit_are_stale(
    slots: str, factor: float, held: Path, tmp_path: Path
) -> None:
    """Both α and β of a vertex are the same eighths. One alone, or a hundredth less, is neither."""
    file = Editable(held)
    file.array(slots)[:] *= factor
    assert verify(file.write(tmp_path / "changed.glb")).failed == ["freshness"]


@pytest.mark.parametrize("share", [0.5, {}, {"fit": 1.1}, {"fit": True}, {"fit": "all"}])
def test_a_part_of_a_fit_that_no_bake_writes_is_damage(share: Any, held: Path, tmp_path: Path) -> None:
    file = Editable(held)
    file.metadata()["kept"] = share
    [problem] = verify(file.write(tmp_path / "changed.glb")).problems("structure")
    assert problem["code"] == "metadata-broken"
    assert '"kept" is' in problem["message"]


def test_bake_says_what_it_kept(tmp_path: Path) -> None:
    source = written(spring, 2, tmp_path)
    result = invoke("bake", source, "-o", tmp_path / "out.glb", "--json", "-v")
    [primitive] = document(result)["files"][0]["primitives"]
    assert primitive["kept"]["fit"] == 0.0
    mean = primitive["kept"]["gradients"]
    assert 0 < mean < 1
    assert f"keeping 0.0 % of the fit and {100 * mean:.1f} % of α/β" in result.stderr
    plain = invoke("bake", source, "-o", tmp_path / "out.glb")
    assert "1 primitive held back (all of the fit would light it worse)" in plain.stdout


def test_a_model_that_gains_keeps_all(tmp_path: Path) -> None:
    result = invoke("bake", FOLDER / "bent_tube.glb", "-o", tmp_path / "out.glb", "--json")
    assert document(result)["files"][0]["primitives"][0]["kept"] is None
    assert noted(tmp_path / "out.glb") is None


def test_a_broken_clip_leaves_the_bake_unjudged(tmp_path: Path) -> None:
    file = Editable(written(spring, 10, tmp_path))
    file.stored(file.content["animations"][0]["samplers"][0]["input"])[0] = 99.0
    result = invoke("bake", file.write(tmp_path / "broken.glb"), "-o", tmp_path / "out.glb", "--json")
    assert result.exit_code == 0
    [found] = document(result)["files"]
    assert [notice["code"] for notice in found["warnings"]] == ["not-judged"]
    assert found["primitives"][0]["kept"] is None


def two_primitives() -> tuple[Any, Any, Any]:
    """Return fitted α and β of two primitives, those of the surface, and classes: they meet in class 1."""
    generator = np.random.default_rng(0)
    fitted, plain = ([tuple(generator.normal(size=(2, 3, 3))) for _ in range(2)] for _ in range(2))
    return fitted, plain, [np.array([0, 1, 0]), np.array([1, 2, 3])]


def test_a_part_of_the_fit_lies_between_it_and_the_gradients() -> None:
    fitted, plain, classes = two_primitives()
    found = mixed(fitted, plain, classes, [0.5, 0.75])
    for slot in range(2):
        (one, other), (mine, theirs) = ([pair[slot] for pair in pairs] for pairs in (fitted, plain))
        np.testing.assert_allclose(found[0][slot], (one + mine) / 2)
        np.testing.assert_allclose(found[1][slot][0], (other + theirs)[0] / 2)
        np.testing.assert_allclose(found[1][slot][1:], (0.75 * other + 0.25 * theirs)[1:])


def test_copies_keep_as_many_eighths_as_the_least_of_them() -> None:
    slots, _, classes = two_primitives()
    found = scaled(slots, classes, [np.array([8, 5, 3]), None])
    for slot in range(2):
        expected = (
            slots[0][slot] * np.array([[3], [5], [3]]) / 8,
            slots[1][slot] * np.array([[5], [8], [8]]) / 8,
        )
        for mine, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(mine[slot], theirs)


def test_the_kept_eighths_follow_from_what_is_stored() -> None:
    """Of the second primitive, only the point that it shares may keep a part."""
    slots, _, classes = two_primitives()
    stored = scaled(slots, classes, [np.array([0, 5, 0]), None])
    stored[1] = stored[1][0] / 2, stored[1][1] / 2
    one, other = kept_eighths(slots, stored, classes, [True, False])
    assert one.tolist()[::2] == [0, 0]
    assert other.tolist()[1:] == [EIGHTHS, EIGHTHS]
    assert one[1] == other[0] < 5


def test_numbers_that_an_encoding_has_shortened_tell_nothing_of_the_kept_eighths() -> None:
    slots = np.random.default_rng(1).uniform(1.0, 2.0, size=(2, 4, 3))
    slots[:, 2] *= 1000.0
    classes = [np.arange(4)]
    stored = [(0.5 * slots[0], 0.5 * slots[1])]
    largest = np.abs(stored[0]).max(axis=(0, 2), keepdims=True)
    cut = stored[0] * np.minimum(1.0, 10.0 / largest)
    (found,) = kept_eighths([(slots[0], slots[1])], [(cut[0], cut[1])], classes, [True], 10.0)
    assert found.tolist() == [4, 4, EIGHTHS, 4]


def test_primitives_that_keep_all_keep_every_bit() -> None:
    slots = np.random.default_rng(0).normal(size=(2, 4, 3)).astype(np.float32)
    [(alpha, beta)] = scaled([(slots[0], slots[1])], [np.arange(4)], [None])
    assert (alpha.astype(np.float32) == slots[0]).all()
    assert (beta.astype(np.float32) == slots[1]).all()


def test_the_bytes_do_not_depend_on_threads(tmp_path: Path) -> None:
    source = written(spring, 10, tmp_path)
    found = []
    for count in ("1", "3"):
        target = tmp_path / f"{count}.glb"
        assert invoke("bake", source, "-o", target, "-q", "--threads", count).exit_code == 0
        found.append(target.read_bytes())
    assert found[0] == found[1]
