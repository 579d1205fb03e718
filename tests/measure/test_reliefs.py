"""The errors of mapped normals that verify tells, against a relief that the tests skin themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.freshness.baked_views import sound_views
from skinbake.freshness.expected import true_operator_of
from skinbake.gltf.document import read_document
from skinbake.measure.reliefs import GOLDEN_TURN, RELIEF_TILT
from skinbake.skinning.rest import Algorithm
from skinbake.truth.areas import vertex_areas
from tests.support.baked_files import Editable, source, verify
from tests.support.baking import bake_file
from tests.support.characters import Array, Character, Placement, Pose, angles, unit
from tests.support.derivatives import derivative_along
from tests.support.replay import replay

ANGLE = 0.6
POSE = Pose(clip=None, angle=ANGLE, seed=3)
SAME = ["--poses", "random:1", "--seed", "3", "--angle", str(np.degrees(ANGLE))]


def with_map(folder: Path, name: str = "mirrored_tangent.glb", *, coat: bool = False) -> Path:
    """Give a fixture's material a normal map, or one for its clear coat."""
    file = Editable(source(name))
    file.content["images"] = [{"uri": "data:image/png;base64,"}]
    file.content["textures"] = [{"source": 0}]
    for material in file.content["materials"]:
        if coat:
            clearcoat = {"clearcoatNormalTexture": {"index": 0}}
            material["extensions"] = {"KHR_materials_clearcoat": clearcoat}
            file.content["extensionsUsed"] = ["KHR_materials_clearcoat"]
        else:
            material["normalTexture"] = {"index": 0}
    return file.write(folder / f"mapped-{name}")


def baked(original: Path, frame: str = "auto") -> Path:
    target = original.with_name(f"{frame}-{original.name}")
    assert bake_file(original, target, frame=frame).status == "baked"
    return target


def expected_means(path: Path, method: str) -> dict[str, dict[str, float]]:
    """Return mean errors by third column and lighting, of one pose, by vectors (V, 3) and plain algebra."""
    character = Character(path, POSE)
    rest, tangents = character.rest, character.tangents
    assert tangents is not None
    count = len(rest.positions)
    turn, tilt = GOLDEN_TURN * np.arange(count), np.radians(RELIEF_TILT)
    m = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.full(count, np.cos(tilt))])
    algorithms = {
        "lbs": [Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE],
        "dqs": [Algorithm.DQS_STANDARD, Algorithm.DQS_EXACT],
    }[method]
    standard, best = (replay(one, rest, character.matrices(Placement())[None]) for one in algorithms)

    t, n, w = unit(tangents[:, :3]), unit(rest.normals), tangents[:, 3:]
    b = w * np.cross(n, t)
    # The images of t, by the lighting and by derivatives of the positions along t and b themselves.
    along = [np.sum(t * unit(v), axis=1, keepdims=True) for v in (rest.tangents, rest.bitangents)]
    across = [np.sum(b * unit(v), axis=1, keepdims=True) for v in (rest.tangents, rest.bitangents)]
    size = np.linalg.norm(rest.tangents, axis=1, keepdims=True)
    images = best.tangents[0] / size, best.bitangents[0] / size
    lit = along[0] * images[0] + along[1] * images[1], across[0] * images[0] + across[1] * images[1]
    document = read_document(str(path))
    operator = true_operator_of(document, sound_views(document))
    rows = [derivative_along(operator, v) for v in (t, b)]
    positions = rest.positions.astype(np.float64)
    before, after = ([row @ p for row in rows] for p in (positions, best.positions[0]))
    true = _mapped(before, after, (t, b, n))

    carried = standard.normals[0]
    errors: dict[str, dict[str, float]] = {}
    own = w * _cofactor(*lit, carried, m)
    engine = {
        "standard": _engine(
            carried, along[0] * standard.tangents[0] + along[1] * standard.bitangents[0], w, m
        ),
        "engine_frame": _engine(w * np.cross(*lit), lit[0], w, m),
        "exact" if method == "dqs" else "accurate": own,
    }
    areas = vertex_areas(positions, character.triangles)
    for kind, third in (("normals", carried), ("normals_by_area", true[2])):
        wanted = w * _cofactor(true[0], true[1], third, m)
        errors[kind] = {
            name: float((angles(found, wanted) * areas).sum() / areas.sum()) for name, found in engine.items()
        }
    return errors


def _cofactor(t: Array, b: Array, n: Array, m: Array) -> Array:
    found: Array = np.linalg.det(np.stack([t, b, n], axis=2))[:, None] * np.einsum(
        "vij,jv->vi", np.linalg.inv(np.stack([t, b, n], axis=2)).transpose(0, 2, 1), m
    )
    return found


def _engine(normal: Array, tangent: Array, w: Array, m: Array) -> Array:
    n, t = unit(normal), unit(tangent)
    found: Array = m[0][:, None] * t + m[1][:, None] * w * unit(np.cross(n, t)) + m[2][:, None] * n
    return found


def _mapped(before: Any, after: Any, frame: tuple[Array, Array, Array]) -> list[Array]:
    """Return the images of a frame under the map that two tangents measure, before and after."""
    c0, c = np.cross(*before), np.cross(*after)
    area0, area = (np.linalg.norm(v, axis=1, keepdims=True) for v in (c0, c))
    first = np.stack([*before, c0 / area0], axis=2)
    last = np.stack([*after, c / np.sqrt(area * area0)], axis=2)
    linear = last @ np.linalg.inv(first)
    return [np.einsum("vij,vj->vi", linear, vectors) for vectors in frame]


@pytest.mark.parametrize("frame", ["tangent", "normal"])
@pytest.mark.parametrize("method", ["lbs", "dqs"])
def test_errors_of_mapped_normals_are_those_of_a_skinned_relief(
    tmp_path: Path, frame: str, method: str
) -> None:
    path = baked(with_map(tmp_path), frame)
    found = verify(path, "--method", method, *SAME).file["reliefs"]
    for kind, lightings in expected_means(path, method).items():
        for lighting, mean in lightings.items():
            assert found[kind][method][lighting]["mean"] == pytest.approx(mean, rel=2e-3, abs=1e-4), lighting
    means = {
        lighting: figures["mean"]
        for lighting, figures in found["normals"][method].items()
        if lighting != "gain"
    }
    best = "exact" if method == "dqs" else "accurate"
    assert means[best] < 0.6 * means["engine_frame"] < means["standard"]


@pytest.mark.slow
def test_a_limit_can_ask_for_mapped_normals(tmp_path: Path) -> None:
    path = baked(with_map(tmp_path))
    answer = verify(path, *SAME)
    mean = answer.file["reliefs"]["normals"]["lbs"]["accurate"]["mean"]
    for factor, failed in ((1.1, []), (0.9, ["limits"])):
        limit = ["--truth", "relief", "--max-mean-error", str(factor * mean)]
        assert verify(path, *SAME, *limit).failed == failed
    plain = baked(_copied(tmp_path))
    (problem,) = verify(plain, *SAME, "--truth", "relief", "--max-mean-error", "5").problems("limits")
    assert "no baked primitive has a normal map and TANGENT" in problem["message"]


def _copied(folder: Path) -> Path:
    target = folder / "plain.glb"
    target.write_bytes(source("mirrored_tangent.glb").read_bytes())
    return target


@pytest.mark.slow
def test_a_map_of_the_clear_coat_counts_and_a_mesh_without_tangents_does_not(tmp_path: Path) -> None:
    coated = verify(baked(with_map(tmp_path, coat=True)), *SAME).file
    assert coated["reliefs"]["normals"]["lbs"]["accurate"]["mean"] > 0
    assert coated["primitives"][0]["reliefs"] == coated["reliefs"]
    assert verify(baked(with_map(tmp_path, "bent_tube.glb")), *SAME).file["reliefs"] is None
    assert verify(baked(_copied(tmp_path)), *SAME).file["reliefs"] is None


def test_mapped_normals_at_rest_have_no_error(tmp_path: Path) -> None:
    found = verify(baked(with_map(tmp_path)), "--poses", "rest").file["reliefs"]["normals"]["lbs"]
    assert max(found[lighting]["max"] for lighting in ("standard", "engine_frame", "accurate")) < 0.01


@pytest.mark.slow
def test_morph_targets_take_the_relief_along(tmp_path: Path) -> None:
    found = verify(baked(with_map(tmp_path, "morphed_sheet.glb")), "--method", "lbs").file["reliefs"]
    means = {name: found["normals"]["lbs"][name]["mean"] for name in ("standard", "engine_frame", "accurate")}
    assert means["accurate"] < 0.6 * means["engine_frame"] < 0.6 * means["standard"]


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["tangent", "normal"])
@pytest.mark.parametrize("numbers", [4, 6])
def test_numbers_of_morph_targets_stretch_the_relief_as_they_stretch_the_surface(
    tmp_path: Path, numbers: int, frame: str
) -> None:
    """By a rule, the frame only turns. Without NORMAL the file's own normals stay behind."""
    file = Editable(with_map(tmp_path, "morphed_sheet.glb"))
    for target in file.primitive()["targets"] if numbers == 6 else ():
        del target["NORMAL"]
    plain = file.write(tmp_path / "plain.glb")
    path = tmp_path / "numbers.glb"
    made = bake_file(plain, path, frame=frame, morph_frames=True)
    assert made.morphs[0][1].frames == numbers
    by_numbers, by_rule = (
        verify(one, "--method", "lbs").file["reliefs"] for one in (path, baked(plain, frame))
    )
    assert by_numbers["normals"]["lbs"]["accurate"]["mean"] < 0.1
    # Engines know nothing of the numbers.
    means = [found["normals"]["lbs"]["standard"]["mean"] for found in (by_numbers, by_rule)]
    assert means[0] == pytest.approx(means[1], abs=1e-4)
    least = 7 if numbers == 6 else 0.5
    assert by_rule["normals"]["lbs"]["accurate"]["mean"] > least
