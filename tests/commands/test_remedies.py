"""Where a bake makes lighting worse, verify says so, and what helps on this file; bake warns of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from skinbake.choices import Gradients
from skinbake.commands import remedies
from skinbake.commands.bake import BakedDocument, Baker
from skinbake.gltf.document import Document
from tests.support import corpus
from tests.support.baked_files import CESIUM_MAN, Answer, verify
from tests.support.command_line import invoke
from tests.support.models import FOLDER

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
    """With fitted gradients, no model of the corpus is lit worse."""
    others = [remedy for remedy in remedies.REMEDIES if remedy.gradients is not Gradients.RIG]
    monkeypatch.setattr(remedies, "REMEDIES", others)


def worse(answer: Answer) -> list[str]:
    return [notice["message"] for notice in answer.file["warnings"] if notice["code"] == "lighting-worse"]


def gain(answer: Answer) -> float:
    (primitive,) = answer.file["primitives"]
    return float(primitive["normals"]["lbs"]["gain"])


@corpus.needed
def test_remedies_are_tried_where_normals_were_generated(tmp_path: Path) -> None:
    """Strip takes the normals away with the bake, and without them nothing is baked."""
    answer = verified(corpus.model("Fox/fox.glb"), tmp_path, *SURFACE, "--generate-normals")
    [message] = worse(answer)
    assert "With --gradients rig it is 1." in message


@corpus.needed
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
    ("gradients", "expected"),
    [
        ("rig", "--gradients surface"),
        ("surface", "--gradients rig"),
        ("poses", "--gradients rig, --gradients surface"),
    ],
)
def test_the_other_kinds_are_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gradients: str, expected: str
) -> None:
    """The others are baked with the noted kind."""
    tried = []
    original = Baker.bake_document

    def watched(baker: Baker, document: Document) -> BakedDocument:
        tried.append(baker)
        return original(baker, document)

    target = tmp_path / "baked.glb"
    source = FOLDER / "foreign_joints.glb"
    assert invoke("bake", source, "-o", target, "-q", "--gradients", gradients).exit_code == 0
    monkeypatch.setattr(remedies, "WORSE", 1e9)
    monkeypatch.setattr(Baker, "bake_document", watched)
    [message] = worse(verify(target, *FEW))
    assert f"({expected}, --neighbours drop, --crease-angle 180, " in message
    others = [False] * (1 + expected.count(","))
    assert [baker.gradients == gradients for baker in tried] == [*others, True, True, True]


@pytest.mark.parametrize("name", ["bent_tube.glb", pytest.param(CESIUM_MAN, marks=corpus.needed)])
def test_better_lighting_is_no_notice(tmp_path: Path, name: str) -> None:
    model = corpus.model(name) if "/" in name else FOLDER / name
    answer = verified(model, tmp_path)
    assert gain(answer) > 1
    assert worse(answer) == []


@corpus.needed
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
    result = invoke("bake", corpus.model(name), "-o", tmp_path / "baked.glb", *options)
    assert ("take joints of their neighbours: so coarse a mesh" in result.stderr) is said
