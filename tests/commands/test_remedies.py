"""Where a bake makes lighting worse, verify says so, and what helps; bake warns of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.choices import USUAL_TRUTHS, Gradients, Truth
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.remedies import tell_worse_lighting
from skinbake.errors import Notices, Place
from skinbake.freshness.baked_views import sound_views
from skinbake.gltf.document import read_document
from skinbake.report.verify import ErrorFigures, Figures, FileVerdict, Worst
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


STANDARD = "it the standard way (in skinbake-three: lighting(mesh, 'standard'))"
DEFAULT = (
    "The default, --gradients fitted, compares itself with standard lighting in the file's own clips: bake so"
)


def verified(model: Path, folder: Path, *options: str) -> Answer:
    target = folder / "baked.glb"
    assert invoke("bake", model, "-o", target, "-q", *options).exit_code == 0
    return verify(target, *FEW)


def worse(answer: Answer) -> list[str]:
    return [notice["message"] for notice in answer.file["warnings"] if notice["code"] == "lighting-worse"]


def gain(answer: Answer) -> float:
    (primitive,) = answer.file["primitives"]
    return float(primitive["normals_by_tangents"]["lbs"]["gain"])


@pytest.mark.slow
@pytest.mark.parametrize("name", [FIGURE, QUAD, CYLINDER])
def test_a_measured_bake_is_the_remedy_and_the_default_helps(tmp_path: Path, name: str) -> None:
    model = corpus.model(name)
    answer = verified(model, tmp_path, *SURFACE)
    assert gain(answer) < 1
    [message] = worse(answer)
    assert re.match("α/β make its lighting worse: the (LBS|DQS) gain is 0.", message)
    assert re.search(r"\. A bake with .* lights the file better$", message) or message.endswith(DEFAULT)
    better = verified(model, tmp_path)
    assert worse(better) == []
    assert gain(better) > 1


def wrung(content: JsonObject) -> None:
    """Turn the two upper joints of the tube against each other, by 150° about an axis near its own."""
    del content["animations"]
    axis, half = np.array([0.38, 0.9, 0.2]), np.radians(75)
    turn = np.sin(half) * axis / np.linalg.norm(axis)
    content["nodes"][2]["rotation"] = [*turn, np.cos(half)]
    content["nodes"][3]["rotation"] = [*-turn, np.cos(half)]


@pytest.mark.slow
def test_exact_lighting_is_named_where_only_accurate_dual_quaternions_are_worse(
    tmp_path: Path,
) -> None:
    """Linear blend skinning gains much there, so it must not lose it."""
    target = tmp_path / "baked.glb"
    source = edited("bent_tube.glb", tmp_path / "source", wrung)
    assert invoke("bake", source, "-o", target, "-q").exit_code == 0
    answer = verify(target, "--poses", "rest")
    truths = [answer.file[key] for key in ("normals_by_triangles", "normals_by_tangents")]

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
    assert worse(answer) == []  # dual quaternions are measured, but nobody has asked for them
    asked = verify(target, "--poses", "rest", "--method", "dqs", "--method", "lbs")
    assert worse(asked) == [f"{message}. The LBS gain is {lbs:.2f}"]
    assert worse(verify(target, "--poses", "rest", "--method", "dqs")) == [message]
    assert worse(verify(target, "--poses", "rest", "--method", "lbs")) == []


HERE = Place("hero.glb", 0, "body", 0)


def measured(lbs: float, accurate: float, exact: float, *, p99: float = 9.0) -> FileVerdict:
    """Return a verdict with standard errors of 1°, and these errors of the others, by both truths."""

    def figures(**errors: float) -> dict[str, ErrorFigures]:
        worst = Worst(HERE, 0, "walk", 0.0)
        return {name: ErrorFigures(error, error, p99, 10.0, worst) for name, error in errors.items()}

    there = {
        "lbs": figures(standard=1.0, accurate=lbs),
        "dqs": figures(standard=1.0, accurate=accurate, exact=exact),
    }
    return FileVerdict("hero.glb", figures=dict.fromkeys(USUAL_TRUTHS, Figures(there, ((HERE, there),))))


def told(verdict: FileVerdict, kind: Gradients = Gradients.FITTED) -> list[str]:
    """Return the messages for a verdict on a bake of some kind."""
    document = read_document(str(FOLDER / "bent_tube.glb"))
    baked = bake_document(document, BakeOptions(gradients=kind)).document
    [view] = sound_views(baked)
    view = replace(view, source=view.source._replace(place=HERE))
    document = document.edited(notices=Notices())
    tell_worse_lighting(document, [view], verdict)
    return [notice.message for notice in document.notices]


@pytest.mark.parametrize(
    ("verdict", "message"),
    [
        (measured(0.5, 1.0, 1.0), None),
        # An error that is rounding cannot be divided by.
        (
            measured(0.5, 1.25, 0.0),
            "accurate lighting of dual quaternions makes it worse: the DQS gain is 0.80. "
            "Exact lighting is right: take that with dual quaternions, as skinbake shader --method dqs does. "
            "The LBS gain is 2.00",
        ),
        # If linear blend skinning gains, advice is for dual quaternions alone.
        (
            measured(0.5, 2.0, 1.25),
            "α/β make its lighting worse: the exact DQS gain is 0.80, and the LBS gain is 2.00. "
            f"With dual quaternions, light {STANDARD}",
        ),
        # Nobody sees such errors.
        (measured(2.0, 2.0, 2.0, p99=0.09), None),
        (
            measured(2.0, 2.0, 2.0, p99=0.11),
            f"α/β make its lighting worse: the LBS gain is 0.50. Light {STANDARD}",
        ),
    ],
)
def test_advice_is_for_the_method_that_is_worse(verdict: FileVerdict, message: str | None) -> None:
    assert told(verdict) == ([] if message is None else [message])


def test_a_bake_that_nothing_guarded_is_advised_to_be_the_default() -> None:
    kind = Gradients.SURFACE
    worse_by_lbs, worse_by_dqs = measured(2.0, 2.0, 2.0), measured(0.5, 2.0, 2.0)
    assert told(worse_by_lbs, kind) == [f"α/β make its lighting worse: the LBS gain is 0.50. {DEFAULT}"]
    [message] = told(worse_by_dqs, kind)
    assert message.endswith(f"With dual quaternions, light {STANDARD}")


def test_lighting_that_errs_where_standard_lighting_is_right_is_worse() -> None:
    """Its gain is 0, which is none."""
    right = ErrorFigures(0.0, 0.0, 0.0, 0.0, Worst(HERE, 0, "walk", 0.0))
    wrong = replace(right, mean=1.0, p99=2.0, max=3.0)
    normals = {"lbs": {"standard": right, "accurate": wrong}}
    verdict = FileVerdict("hero.glb", figures={Truth.TANGENTS: Figures(normals, ((HERE, normals),))})
    assert told(verdict) == [f"α/β make its lighting worse: the LBS gain is 0.00. Light {STANDARD}"]


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
        (CYLINDER, ("--gradients", "fitted"), False),
        (CYLINDER, ("--gradients", "surface", "--neighbours", "drop"), False),
        (CESIUM_MAN, ("--gradients", "surface"), False),
    ],
)
def test_bake_says_where_worse_lighting_is_likely(
    tmp_path: Path, name: str, options: tuple[str, ...], said: bool
) -> None:
    result = invoke("bake", corpus.character(name), "-o", tmp_path / "baked.glb", *options)
    assert ("take joints of their neighbours: so coarse a mesh" in result.stderr) is said
