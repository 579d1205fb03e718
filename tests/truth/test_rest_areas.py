"""The areas that weigh errors, in one space: files whose meshes have units of their own, and their twins."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from skinbake.choices import PoseKind, Truth
from skinbake.commands.verify import verify_file
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import FileVerdict
from skinbake.truth.areas import RestAreas
from skinbake.truth.poses import PoseRequest
from tests.support import corpus
from tests.support.baked_files import Editable, baked, source

REQUEST = PoseRequest(PoseKind.RANDOM, 8)


def measured(path: Path) -> FileVerdict:
    verdict = verify_file(str(path), VerifyOptions(("lbs",), REQUEST))
    assert verdict.passed
    return verdict


def assert_alike(one: FileVerdict, other: FileVerdict, rel: float) -> None:
    for truth, normals in one.by_truth.items():
        for lighting, figures in normals["lbs"].items():
            found = other.by_truth[truth]["lbs"][lighting]
            assert found.mean == pytest.approx(figures.mean, rel=rel)
            assert found.p95 == pytest.approx(figures.p95, rel=rel)


def derived(name: str) -> Path:
    return next(path for path in corpus.valid_models() if path.name == name)


@corpus.needed
@pytest.mark.parametrize(
    "name",
    ["KHR_mesh_quantization", "EXT_meshopt-high", pytest.param("EXT_meshopt-medium", marks=pytest.mark.slow)],
)
def test_twins_of_the_corpus_agree_within_a_percent(tmp_path: Path, name: str) -> None:
    """Each mesh of the character is quantised by its own scale: by areas in mesh space they were 37 % off."""
    plain, quantised = (baked(derived(f"barbarian-{which}.glb"), tmp_path) for which in ("plain", name))
    assert_alike(measured(plain), measured(quantised), 0.01)


def two_meshes(folder: Path, scale: float) -> Path:
    """A tube that bends, and one that follows a single joint, in units of its own."""
    model = Editable(source("bent_tube.glb"))
    content = model.content
    rigid = copy.deepcopy(content["meshes"][0])
    attributes = rigid["primitives"][0]["attributes"]
    positions, weights = model.array("POSITION").copy(), model.array("WEIGHTS_0").copy()
    inverse_bind = model.stored(content["skins"][0]["inverseBindMatrices"]).copy()
    weights[:] = [1.0, 0.0, 0.0, 0.0]
    attributes["POSITION"] = model.add((positions * np.float32(scale)).astype(np.float32))
    lows = content["accessors"][attributes["POSITION"]]
    lows["min"], lows["max"] = (
        (reduce(positions, axis=0) * np.float32(scale)).astype(np.float32).tolist()
        for reduce in (np.min, np.max)
    )
    attributes["WEIGHTS_0"] = model.add(weights.astype(np.float32))
    # Column by column: all but the translation is of mesh space.
    matrices = inverse_bind.reshape(-1, 4, 4) / np.array([scale, scale, scale, 1.0])[:, None]
    skin = copy.deepcopy(content["skins"][0])
    skin["inverseBindMatrices"] = model.add(matrices.reshape(-1, 16).astype(np.float32))
    content["meshes"].append(rigid)
    content["skins"].append(skin)
    nodes = content["nodes"]
    drawn = next(node for node in nodes if "mesh" in node)
    nodes.append({**drawn, "mesh": 1, "skin": 1})
    content["scenes"][0]["nodes"].append(len(nodes) - 1)
    return model.write(folder / f"times_{scale}.glb")


@pytest.mark.slow
def test_a_mesh_in_other_units_counts_as_much(tmp_path: Path) -> None:
    one, other = (
        measured(baked(two_meshes(tmp_path, scale), folder(tmp_path, scale))) for scale in (1.0, 100.0)
    )
    assert_alike(one, other, 1e-4)
    (_, bends), (_, follows) = one.figures[Truth.TANGENTS].primitives
    half = 0.5 * (bends["lbs"]["standard"].mean + follows["lbs"]["standard"].mean)
    assert one.by_truth["tangents"]["lbs"]["standard"].mean == pytest.approx(half, rel=1e-6)
    assert bends["lbs"]["standard"].mean > 100 * follows["lbs"]["standard"].mean


def folder(parent: Path, scale: float) -> Path:
    made = parent / f"baked_{scale}"
    made.mkdir()
    return made


def test_a_mesh_that_the_rest_pose_hides_has_the_area_of_its_bind(tmp_path: Path) -> None:
    path = two_meshes(tmp_path, 100.0)
    shown = areas(path)
    model = Editable(path)
    for joint in model.content["skins"][0]["joints"]:
        model.content["nodes"][joint]["scale"] = [0, 0, 0]
    hidden = areas(model.write(tmp_path / "hidden.glb"))
    assert sum(shown) > 0.1
    for one, other in zip(shown, hidden, strict=True):
        assert other == pytest.approx(one, rel=1e-4)


def areas(path: Path) -> list[float]:
    document = read_document(str(path))
    sources = skinned_sources(document)
    return [
        float(RestAreas(document, number).of(read_primitive(document, one)).sum())
        for number, one in enumerate(sources)
    ]
