"""Where a bake makes lighting worse, verify says so, and what helps on this file; bake warns of it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.choices import Gradients, Neighbours
from skinbake.commands import remedies
from skinbake.commands.bake import BakedDocument, Baker
from skinbake.errors import Place
from skinbake.gltf.document import Document, read_document
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import ErrorFigures, FileVerdict, Worst
from tests.support import corpus
from tests.support.baked_files import CESIUM_MAN, Answer, verify
from tests.support.command_line import invoke
from tests.support.models import FOLDER, edited

FEW = ("--poses", "animation", "--samples", "12", "--method", "lbs")
SURFACE = ("--gradients", "surface")
FIGURE, QUAD, CYLINDER = (
    "RiggedFigure/RiggedFigure.gltf",
    "quad_skin/quad_skin.glb",
    "RiggedSimple/RiggedSimple.gltf",
)


def verified(model: Path, folder: Path, *options: str) -> Answer:
    target = folder / "baked.glb"
    assert invoke("bake", model, "-o", target, "-q", *options).exit_code == 0
    return verify(target, *FEW)


@pytest.fixture
def _without_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave no fitted gradients among the options. With them, none of these models is lit worse."""
    others = [remedy for remedy in remedies.REMEDIES if remedy.gradients is not Gradients.RIG]
    monkeypatch.setattr(remedies, "REMEDIES", others)
    monkeypatch.setattr(remedies, "LAST", remedies.Remedy("--gradients surface", Gradients.SURFACE))


def worse(answer: Answer) -> list[str]:
    return [notice["message"] for notice in answer.file["warnings"] if notice["code"] == "lighting-worse"]


def gain(answer: Answer) -> float:
    (primitive,) = answer.file["primitives"]
    return float(primitive["normals"]["lbs"]["gain"])


def test_remedies_are_tried_where_normals_were_generated(tmp_path: Path) -> None:
    """Strip takes the normals away with the bake, and without them nothing is baked."""
    answer = verified(corpus.model("Fox/fox.glb"), tmp_path, *SURFACE, "--generate-normals")
    [message] = worse(answer)
    assert re.search(r"With --gradients (rig|poses) it is 1\.", message)


@pytest.mark.parametrize("name", [FIGURE, QUAD, CYLINDER])
def test_what_helps_is_named_and_helps(tmp_path: Path, name: str) -> None:
    model = corpus.model(name)
    answer = verified(model, tmp_path, *SURFACE)
    assert gain(answer) < 1
    [message] = worse(answer)
    assert re.search("α/β make its lighting worse: the (LBS|DQS) gain is 0.", message)
    options, best = re.findall(r" With (.*) it is (\d\.\d\d)", message)[0]
    better = verified(model, tmp_path, *SURFACE, *options.split())
    assert worse(better) == []
    assert gain(better) > 1
    assert message.endswith(": bake so" if float(best) >= 1.2 else "lighting(mesh, 'standard'))")


@corpus.needed
def test_a_fit_to_poses_is_named_where_nothing_else_helps(tmp_path: Path) -> None:
    target = tmp_path / "baked.glb"
    assert invoke("bake", corpus.model("BathDay/bath_day.glb"), "-o", target, "-q").exit_code == 0
    [message] = worse(verify(target, "--poses", "animation", "--samples", "12"))
    assert "DQS gain is 0." in message
    assert "With --gradients poses it is 1." in message


@corpus.needed
@pytest.mark.usefixtures("_without_rig")
def test_where_nothing_helps_that_is_said(tmp_path: Path) -> None:
    """It was baked with --gradients surface, so that is not tried again."""
    [message] = worse(verified(corpus.model(QUAD), tmp_path, *SURFACE))
    assert "No option that was tried helps (--neighbours drop, --crease-angle 180, " in message
    # The tests of the module switch a single mesh so.
    assert message.endswith("(in skinbake-three: lighting(mesh, 'standard'))")


@corpus.needed
@pytest.mark.usefixtures("_without_rig")
def test_what_was_baked_so_already_is_not_tried_again(tmp_path: Path) -> None:
    [message] = worse(verified(corpus.model(QUAD), tmp_path, *SURFACE, "--neighbours", "drop"))
    assert "(--crease-angle 180, --neighbours drop --crease-angle 180)" in message


@pytest.mark.parametrize(
    ("gradients", "expected", "last"),
    [
        ("rig", "--gradients surface", ", --gradients poses"),
        ("surface", "--gradients rig", ", --gradients poses"),
        ("poses", "--gradients rig, --gradients surface", ""),
    ],
)
def test_the_other_kinds_are_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gradients: str, expected: str, last: str
) -> None:
    """The others are baked with the noted kind, and gradients fitted to poses come last."""
    tried = []
    original = Baker.bake_document

    def watched(baker: Baker, document: Document) -> BakedDocument:
        tried.append(baker)
        return original(baker, document)

    target = tmp_path / "baked.glb"
    source = FOLDER / "foreign_joints.glb"
    assert invoke("bake", source, "-o", target, "-q", "--gradients", gradients).exit_code == 0
    monkeypatch.setattr(remedies, "WORSE", 1e9)
    monkeypatch.setattr(remedies, "LITTLE", 1e9)
    monkeypatch.setattr(Baker, "bake_document", watched)
    [message] = worse(verify(target, *FEW))
    options = f"{expected}, --neighbours drop, --crease-angle 180, --neighbours drop --crease-angle 180{last}"
    assert f"({options})" in message
    others = [False] * (1 + expected.count(","))
    assert [baker.gradients == gradients for baker in tried] == [
        *others,
        *(True, True, True),
        *([False] if last else []),
    ]


def wrung(content: JsonObject) -> None:
    """Turn the two upper joints of the tube against each other, by 150° about an axis near its own."""
    del content["animations"]
    axis, half = np.array([0.38, 0.9, 0.2]), np.radians(75)
    turn = np.sin(half) * axis / np.linalg.norm(axis)
    content["nodes"][2]["rotation"] = [*turn, np.cos(half)]
    content["nodes"][3]["rotation"] = [*-turn, np.cos(half)]


def test_exact_lighting_is_named_where_only_accurate_dual_quaternions_are_worse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linear blend skinning gains much there, so it must not lose it. Nothing is baked anew."""
    target = tmp_path / "baked.glb"
    source = edited("bent_tube.glb", tmp_path / "source", wrung)
    assert invoke("bake", source, "-o", target, "-q").exit_code == 0
    monkeypatch.setattr(Baker, "bake_document", None)
    answer = verify(target, "--poses", "rest")
    truths = [answer.file[key] for key in ("normals", "normals_by_triangles")]

    def least(method: str, lighting: str) -> float:
        errors = [truth[method] for truth in truths]
        return float(min(error["standard"]["mean"] / error[lighting]["mean"] for error in errors))

    lbs, accurate, exact = least("lbs", "accurate"), least("dqs", "accurate"), least("dqs", "exact")
    assert lbs > 10
    assert accurate < 0.9
    assert exact > 5
    message = (
        f"accurate lighting of dual quaternions makes it worse: the DQS gain is {accurate:.2f}. "
        f"Exact lighting gains {exact:.2f}: take that with dual quaternions, "
        "as skinbake shader --method dqs does"
    )
    assert worse(answer) == [f"{message}. The LBS gain is {lbs:.2f}"]
    assert worse(verify(target, "--poses", "rest", "--method", "dqs")) == [message]
    assert worse(verify(target, "--poses", "rest", "--method", "lbs")) == []


HERE = Place("hero.glb", 0, "body", 0)


def measured(
    lbs: float, accurate: float, exact: float, *, whole: float | None = None, p99: float = 9.0
) -> FileVerdict:
    """Return a verdict with standard errors of 1°, and these errors of the others, by both truths.

    whole is the error of all lightings all in all, like lbs if None.
    """

    def figures(**errors: float) -> dict[str, ErrorFigures]:
        worst = Worst(HERE, 0, "walk", 0.0)
        return {name: ErrorFigures(error, error, p99, 10.0, worst) for name, error in errors.items()}

    all_in_all = lbs if whole is None else whole
    there = {
        "lbs": figures(standard=1.0, accurate=lbs),
        "dqs": figures(standard=1.0, accurate=accurate, exact=exact),
    }
    everywhere = {"lbs": figures(standard=1.0, accurate=all_in_all)}
    return FileVerdict(
        "hero.glb",
        normals=everywhere,
        by_triangles=everywhere,
        primitives=((HERE, there),),
        primitives_by_triangles=((HERE, there),),
    )


def told(
    monkeypatch: pytest.MonkeyPatch, verdict: FileVerdict, others: Mapping[remedies.Remedy, FileVerdict]
) -> list[str]:
    """Return the messages for a verdict, if remedies lead to others."""

    def tried(*arguments: Any) -> Iterator[object]:
        return (
            remedies._Trial(remedy, remedies._gains(then), remedies._all_in_all(then))
            for remedy, then in others.items()
            if (remedy == remedies.LAST) == (arguments[-1] == [remedies.LAST])
        )

    monkeypatch.setattr(remedies, "_tried", tried)
    document = read_document(str(FOLDER / "bent_tube.glb"))
    return [notice.message for notice in remedies.worse_lighting(document, [], verdict, VerifyOptions())]


BY_DROP = remedies.Remedy("--neighbours drop", neighbours=Neighbours.DROP)


@pytest.mark.parametrize(
    ("verdict", "then", "message"),
    [
        (measured(0.5, 1.0, 1.0), None, None),
        # An error that is rounding cannot be divided by.
        (
            measured(0.5, 1.25, 0.0),
            None,
            "accurate lighting of dual quaternions makes it worse: the DQS gain is 0.80. "
            "Exact lighting is right: take that with dual quaternions, as skinbake shader --method dqs does. "
            "The LBS gain is 2.00",
        ),
        # If linear blend skinning gains, advice is for dual quaternions alone.
        (
            measured(0.5, 1.25, 2.0),
            measured(0.8, 1.0, 0.625, whole=0.5),
            "α/β make its lighting worse: the DQS gain is 0.80, and the LBS gain is 2.00. "
            "With --neighbours drop it is 1.25, and the LBS gain 1.25: bake so for dual quaternions",
        ),
        (
            measured(0.5, 2.0, 1.25),
            measured(0.5, 2.0, 2.0),
            "α/β make its lighting worse: the exact DQS gain is 0.80, and the LBS gain is 2.00. "
            "No option that was tried helps (--neighbours drop): "
            "with dual quaternions, light it the standard way "
            "(in skinbake-three: lighting(mesh, 'standard'))",
        ),
        (
            measured(2.0, 0.5, 0.5),
            measured(0.5, 0.5, 0.5),
            "α/β make its lighting worse: the LBS gain is 0.50. With --neighbours drop it is 2.00: bake so",
        ),
        # What helps there must not harm elsewhere.
        (
            measured(2.0, 0.5, 0.5, whole=0.5),
            measured(0.5, 0.5, 0.5, whole=0.8),
            "α/β make its lighting worse: the LBS gain is 0.50. With --neighbours drop it is 2.00, "
            "but all in all the gain falls from 2.00 to 1.25: "
            "light it the standard way (in skinbake-three: lighting(mesh, 'standard'))",
        ),
        # Nobody sees such errors.
        (measured(2.0, 2.0, 2.0, p99=0.09), None, None),
        (
            measured(2.0, 2.0, 2.0, p99=0.11),
            None,
            "α/β make its lighting worse: the LBS gain is 0.50. "
            "Light it the standard way (in skinbake-three: lighting(mesh, 'standard'))",
        ),
    ],
)
def test_advice_is_for_the_method_that_is_worse(
    monkeypatch: pytest.MonkeyPatch, verdict: FileVerdict, then: FileVerdict | None, message: str | None
) -> None:
    others = {} if then is None else {BY_DROP: then}
    assert told(monkeypatch, verdict, others) == ([] if message is None else [message])


def test_a_remedy_that_keeps_the_whole_comes_before_a_stronger_one(monkeypatch: pytest.MonkeyPatch) -> None:
    others = {
        remedies.Remedy("--gradients surface"): measured(0.25, 0.5, 0.5, whole=0.8),
        BY_DROP: measured(0.5, 0.5, 0.5, whole=0.5),
    }
    [message] = told(monkeypatch, measured(2.0, 0.5, 0.5, whole=0.5), others)
    assert message.endswith("With --neighbours drop it is 2.00: bake so")


def test_only_meshes_with_such_primitives_are_compared_all_in_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another mesh gains 2, and the whole file too. The remedy keeps the 1.25 of the meshes that need it."""
    here = measured(2.0, 0.5, 0.5, whole=0.5)
    there = replace(HERE, mesh=1)
    good = tuple((there, normals) for _, normals in measured(0.5, 0.5, 0.5).primitives)
    verdict = replace(here, primitives=here.primitives + good)
    monkeypatch.setattr(remedies, "_measured", lambda *_: measured(2.0, 0.5, 0.5, whole=0.8))
    [message] = told(monkeypatch, verdict, {BY_DROP: measured(0.5, 0.5, 0.5, whole=0.8)})
    assert message.endswith("With --neighbours drop it is 2.00: bake so")


def test_lighting_that_errs_where_standard_lighting_is_right_is_worse(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its gain is 0, which is none."""
    right = ErrorFigures(0.0, 0.0, 0.0, 0.0, Worst(HERE, 0, "walk", 0.0))
    wrong = replace(right, mean=1.0, p99=2.0, max=3.0)
    normals = {"lbs": {"standard": right, "accurate": wrong}}
    verdict = FileVerdict("hero.glb", normals=normals, primitives=((HERE, normals),))
    assert told(monkeypatch, verdict, {}) == [
        "α/β make its lighting worse: the LBS gain is 0.00. "
        "Light it the standard way (in skinbake-three: lighting(mesh, 'standard'))"
    ]


@pytest.mark.parametrize("name", ["bent_tube.glb", CESIUM_MAN])
def test_better_lighting_is_no_notice(tmp_path: Path, name: str) -> None:
    model = corpus.character(name) if "/" in name else FOLDER / name
    answer = verified(model, tmp_path)
    assert gain(answer) > 1
    assert worse(answer) == []


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        (CYLINDER, ("--gradients", "surface"), True),
        (FIGURE, ("--gradients", "surface"), True),
        (CYLINDER, ("--gradients", "rig"), False),
        (CYLINDER, ("--gradients", "surface", "--neighbours", "drop"), False),
        (CESIUM_MAN, ("--gradients", "surface"), False),
    ],
)
def test_bake_says_where_worse_lighting_is_likely(
    tmp_path: Path, name: str, options: tuple[str, ...], said: bool
) -> None:
    result = invoke("bake", corpus.character(name), "-o", tmp_path / "baked.glb", *options)
    assert ("take joints of their neighbours: so coarse a mesh" in result.stderr) is said
