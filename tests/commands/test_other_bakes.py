"""Verify names the bake that lights a file better than its own, by the figures of that bake."""

from __future__ import annotations

from pathlib import Path

import pytest

from fixtures.make_fixtures import FOLDER
from tests.support import corpus
from tests.support.baked_files import Answer, Editable, verify
from tests.support.command_line import invoke
from tests.support.morphed_files import morphed

TUBE = FOLDER / "bent_tube.glb"


def baked(source: Path, target: Path, *options: str) -> Answer:
    result = invoke("bake", source, "-o", target, "-q", *options)
    assert result.exit_code == 0, result.output
    return verify(target, "--method", "lbs")


def left_by(answer: Answer) -> float:
    """The mean error of the bake by the truth with the smaller gain."""
    truths = [answer.file[name]["lbs"] for name in ("normals_by_triangles", "normals_by_tangents")]
    name = "corrected" if "corrected" in truths[0] else "accurate"
    worse = min(truths, key=lambda one: one["standard"]["mean"] / one[name]["mean"])
    return float(worse[name]["mean"])


def with_targets(target: Path, *, zeros: bool) -> Path:
    """A bent tube with morph targets whose NORMAL is absent, or zeros, and whose weights are not 0."""
    file = Editable(morphed(TUBE, target, weights=[0.9, 0.9]))
    for one in file.primitive()["targets"]:
        if zeros:
            file.stored(one["NORMAL"])[:] = 0.0
        else:
            del one["NORMAL"]
        file.stored(one["POSITION"])[:] *= 3.0
    return file.write(target)


@pytest.mark.slow
@pytest.mark.parametrize("zeros", [False, True])
def test_morph_normals_are_named_with_what_they_leave(tmp_path: Path, zeros: bool) -> None:
    source = with_targets(tmp_path / "in.glb", zeros=zeros)
    now = baked(source, tmp_path / "out.glb")
    then = baked(source, tmp_path / "other.glb", "--morph-normals")
    first = now.file["others"][0]
    assert first == {"options": "--morph-normals", "error": pytest.approx(left_by(then))}
    assert now.file["conclusion"].startswith("better with --morph-normals")
    assert left_by(then) * 1.1 < left_by(now)
    text = invoke("verify", tmp_path / "out.glb").stdout
    assert "Next: bake with --morph-normals" in text
    assert "leave the file unbaked" not in text


@pytest.mark.slow
def test_a_file_with_correctives_is_told_of_morph_normals_too(tmp_path: Path) -> None:
    """Correctives that one of two clips plays leave the normals of the other one as they are."""
    file = Editable(with_targets(tmp_path / "in.glb", zeros=True))
    file.content["animations"].append({**file.content["animations"][0], "name": "other"})
    source = file.write(tmp_path / "two.glb")
    now = baked(source, tmp_path / "out.glb", "--correctives", "1", "--clips", "other")
    assert "--morph-normals" in now.file["conclusion"]
    best = now.file["others"][-1]
    assert best["error"] * 1.1 < left_by(now)


@pytest.mark.slow
def test_the_best_of_both_kinds_are_named_by_what_they_leave(tmp_path: Path) -> None:
    """A real figure of few vertices: the kind of the file itself comes first."""
    source = corpus.model("RiggedFigure/RiggedFigure.gltf")
    now = baked(source, tmp_path / "out.glb", "--gradients", "surface")
    others = [
        {"options": words, "error": pytest.approx(left_by(baked(source, tmp_path / "o.glb", *words.split())))}
        for words in ("--neighbours extend", "--correctives auto")
    ]
    assert now.file["others"] == others
    assert now.file["conclusion"] == "better with --neighbours extend or --correctives auto"


def test_a_bake_with_a_clear_gain_and_one_without_a_better_one_name_none(tmp_path: Path) -> None:
    clear = baked(TUBE, tmp_path / "out.glb")
    assert (clear.file["conclusion"], clear.file["others"]) == ("clear gain", [])
    little = baked(corpus.model("quad_skin/quad_skin.glb"), tmp_path / "out.glb")
    assert (little.file["conclusion"], little.file["others"]) == ("little to win", [])


@pytest.mark.slow
def test_a_missed_limit_names_a_bake_that_is_nearer(tmp_path: Path) -> None:
    """A real coarse cylinder, which α and β hardly help."""
    source = corpus.model("RiggedSimple/RiggedSimple.gltf")
    baked(source, tmp_path / "out.glb")
    then = baked(source, tmp_path / "other.glb", "--correctives", "auto")
    result = invoke("verify", tmp_path / "out.glb", "--max-mean-error", "0.5")
    assert result.exit_code == 1
    assert f"{left_by(then):.2f}° with --correctives auto" in result.stdout
    assert "Next: bake with --correctives auto, or change the limit." in result.stdout
    assert invoke("verify", tmp_path / "other.glb", "--max-mean-error", "0.5").exit_code == 0
