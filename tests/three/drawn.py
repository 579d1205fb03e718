"""Characters that a page draws, and the normals that it should have drawn."""

from __future__ import annotations

import base64
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Encoding, Layout
from skinbake.format.encodings import GradientFormat
from skinbake.skinning.rest import Algorithm
from tests.support.baked_files import Editable
from tests.support.characters import (
    AS_USUAL,
    Array,
    Character,
    Placement,
    Pose,
    angles,
    column_by_column,
    smallest_rotations,
    unit,
)
from tests.support.replay import replay
from tests.support.stage import Stage

DEGREES = 0.01
"""Between the browser and the replay: three.js has bone matrices, and we all else, in float32."""
CLIP = 2e-5
"""Of clip coordinates that are a few units."""
STRETCHED = (
    'its joint "tube_joint1" is not rigid up to one transform common to all joints, which dual quaternions '
    "need: use the method lbs"
)
TUBE = FOLDER / "bent_tube.glb"
MIRRORED = FOLDER / "mirrored_tangent.glb"
BENT = Pose(clip=0, time=0.45)
RANDOM = Pose(clip=None)


def transform(
    rotation: tuple[float, float, float], scale: tuple[float, float, float], at: tuple[float, float, float]
) -> Array:
    """Scale along the axes, then a rotation of |rotation| radians round it, then a shift."""
    axis = np.array(rotation)
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.linalg.norm(axis)
    result = np.eye(4)
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    result[:3, :3] = turn * np.array(scale)
    result[:3, 3] = at
    return result


PLACED = transform((0.4, -1.1, 0.3), (1.7, 1.7, 1.7), (0.5, -2.0, 1.0))
AWAY = transform((0.0, 1.0, 0.0), (1.0, 1.0, 1.0), (100.0, 0.0, 0.0))
MIRROR = transform((0.0, 0.5, 0.2), (-1.0, 1.0, 1.0), (-100.0, 0.0, 0.0))
INSTANCES = ((PLACED, AWAY, MIRROR), (AWAY, MIRROR, PLACED), (MIRROR, PLACED, AWAY))
"""Where the instance is that a camera looks at, and where those that are drawn before and after it."""

CHARACTERS = [
    pytest.param(None, TUBE, BENT, id="bent_tube"),
    pytest.param(None, FOLDER / "weights_u8.glb", RANDOM, id="weights_u8"),
    pytest.param("CesiumMan/CesiumMan.glb", None, Pose(0, 0.6), id="CesiumMan"),
    pytest.param("RiggedFigure/RiggedFigure.gltf", None, Pose(0, 0.7), id="RiggedFigure"),
    pytest.param("VRM/cryptovoxels.vrm", None, RANDOM, id="cryptovoxels"),
    pytest.param("RiggedSimple/RiggedSimple.gltf", None, Pose(0, 0.8), id="RiggedSimple"),
    pytest.param("Butterfly/animated_butterfly.glb", None, Pose(0, 0.4), id="Butterfly"),
    pytest.param("TRex/trex.gltf", None, Pose(0, 0.5), id="TRex"),
    pytest.param("XRHand/hand_l.gltf", None, RANDOM, id="XRHand"),
    pytest.param("RiggedElf/RiggedElf.gltf", None, Pose(0, 0.5), id="RiggedElf"),
    pytest.param("AFrameHands/leftHandLow.glb", None, Pose(0, 0.05), id="AFrameHands"),
]
STORAGES = [
    AS_USUAL,
    GradientFormat(Encoding.PACKED8),
    GradientFormat(Encoding.SNORM16),
    GradientFormat(layout=Layout.TEXCOORD),
    GradientFormat(Encoding.PACKED8, Layout.CUSTOM),
]


class ThreeStage(Stage):
    """The page, and the models that it can load. three-vrm extends a class that three.js gives up."""

    unasked = (
        *Stage.unasked,
        "THREE.GLTFLoader: Couldn't load",
        "THREE.GLTFLoader: Unknown ext",
        "THREE.TempNode: This module has been deprecated",
    )


def vectors(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, 3).astype(np.float64)


def expected(
    character: Character,
    world: list[float],
    algorithm: Algorithm = Algorithm.LBS_ACCURATE,
    cap: float | None = None,
) -> Array:
    placement = dataclasses.replace(Placement(), world=np.array(world).reshape(4, 4).T)
    return character.expected(algorithm, placement, cap=cap).normals


def in_clip_space(character: Character, found: dict[str, Any], algorithm: Algorithm) -> Array:
    """Return where a camera of the page has the vertices (V, 4)."""
    world, view, projection = (
        np.array(found[key]).reshape(4, 4).T for key in ("world", "view", "projection")
    )
    placement = dataclasses.replace(Placement(), world=world)
    points = replay(algorithm, character.rest, character.matrices(placement)[None]).positions[0]
    return np.asarray(np.insert(points, 3, 1, axis=1) @ (projection @ view @ world).T)


def shadow_is_of(character: Character, found: dict[str, Any], algorithm: Algorithm) -> bool:
    """Return whether the draws into a shadow map have every vertex where the algorithm puts it."""
    wanted = in_clip_space(character, found, algorithm)
    draws = [np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, 4) for text in found["draws"]]
    assert draws
    return all(np.abs(drawn - wanted[: len(drawn)]).max() < 1e-5 for drawn in draws)


def rotation(angle: float) -> Array:
    """Return the rotation (3, 3) about y."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


def scaled(x: float, y: float, z: float) -> Array:
    return np.diag([x, y, z, 1.0])


def turned(angle: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(angle)
    return matrix


SKEWED = turned(0.7) @ scaled(1, 2, 0.6) @ turned(-1.9) @ scaled(-1, 1.2, 1)
PLACED = turned(1.1) @ scaled(1.3, 0.8, 1)
PLACED[:3, 3] = (0.4, -0.3, -0.6)
PARENTS = [
    pytest.param(root, other, False, id=f"{name}, {'apart' if other is not None else 'below'}")
    for name, root in {
        "as it is": scaled(1, 1, 1),
        "mirrored": scaled(-1, 1, 1),
        "stretched": scaled(1, 2, 1),
        "larger": scaled(2, 2, 2),
        "skewed": SKEWED,
    }.items()
    for other in (None, PLACED)
]
PARENTS += [pytest.param(SKEWED, PLACED, True, id="skewed, detached")]


def deviations_below(
    character: Character, found: dict[str, Any], root: Array, common: Array | None = None
) -> tuple[float, float]:
    """Return a character's largest errors below a parent: of clip coordinates, and of normals in degrees.

    It is skinned in its own space by rigid joints, then moved as a whole. ``common`` (4, 4) is what its
    joints have in common besides.
    """
    whole = root if common is None else root @ common
    joints = character.joints if common is None else np.linalg.inv(common) @ character.joints
    own = replay(Algorithm.DQS_EXACT, character.rest, joints[None])
    world, view, projection = (
        np.array(found[key]).reshape(4, 4).T for key in ("world", "view", "projection")
    )
    points = np.insert(own.positions[0], 3, 1, axis=1) @ (projection @ view @ whole).T
    drawn = np.frombuffer(base64.b64decode(found["position"]), "<f4").reshape(-1, 4)
    # The cross product of the two tangents points inside where the mesh itself does not know of a mirror.
    side = np.sign(np.linalg.det(whole) * np.linalg.det(world))
    normals = side * own.normals[0] @ np.linalg.inv(whole[:3, :3])
    return float(np.abs(drawn - points[: len(drawn)]).max()), largest(found["normal"], normals)


def placed_by(root: Array, other: Array | None, *, detached: bool) -> dict[str, Any]:
    """Return what the pages' ``parented`` needs."""
    told = {"method": "dqs", "root": column_by_column(root), "detached": detached}
    return told if other is None else told | {"other": column_by_column(other)}


CAP = 0.3


def check_cap(stage: Stage, method: str, frame: str, **options: object) -> None:
    """Draw a character whose tangents are corrected by at most ``CAP`` times their length."""
    character = stage.character(MIRRORED, RANDOM, frame)
    found = stage.normals(character, method=method, cap=CAP, **options)
    algorithm = Algorithm.LBS_ACCURATE if method == "lbs" else Algorithm.DQS_EXACT
    free, wanted = (expected(character, found["world"], algorithm, cap) for cap in (None, CAP))
    assert angles(free, wanted).max() > 100 * DEGREES
    assert largest(found["draws"][-1], wanted) < DEGREES


def check_caps_apart(stage: Stage, **options: object) -> None:
    """Draw characters that share a material, each with a cap of its own, or with none."""
    character = stage.character(MIRRORED, RANDOM, "normal")
    caps = (CAP, None, 2 * CAP)
    told = [{**character.told(Placement()), **({"cap": cap} if cap else {})} for cap in caps]
    draws = stage.call("together", {"characters": told, **options})
    wanted = [expected(character, np.eye(4).ravel().tolist(), cap=cap) for cap in caps]
    assert [largest(drawn, normals) < DEGREES for drawn, normals in zip(draws, wanted, strict=True)] == [
        True
    ] * 3


def largest(found: str, wanted: Array) -> float:
    normals = vectors(found)
    assert (np.linalg.norm(normals, axis=1) > 0).all()
    return float(angles(normals, wanted[: len(normals)]).max())


def turn_rest(character: Character, offset: tuple[float, float, float]) -> None:
    """Add a vector to all normals at rest, and turn the frames with them, as a morph target does."""
    rest = character.rest
    normals = unit(rest.normals + np.array(offset))
    turn = smallest_rotations(rest.normals.astype(np.float64), normals)
    tangents, bitangents = (np.einsum("vij,vj->vi", turn, part) for part in (rest.tangents, rest.bitangents))
    character.rest = dataclasses.replace(rest, normals=normals, tangents=tangents, bitangents=bitangents)


def with_morphs(folder: Path, source: Path) -> Path:
    """Add two morph targets to a copy of a fixture: waves that move positions and turn normals."""
    target = folder / f"{source.stem}-morphs.glb"
    if target.exists():
        return target
    file = Editable(source)
    positions, normals = file.array("POSITION").copy(), file.array("NORMAL").copy()
    targets = []
    for axis, frequency in ((0, 9.0), (2, 5.0)):
        wave = np.sin(frequency * positions[:, [axis - 1]])
        moved = 0.3 * wave * normals
        turned = 1.5 * np.roll(normals, 1, axis=1) * wave
        accessors = [file.add(part.astype(np.float32)) for part in (moved, turned)]
        file.content["accessors"][accessors[0]] |= {
            "min": moved.min(axis=0).tolist(),
            "max": moved.max(axis=0).tolist(),
        }
        targets.append({"POSITION": accessors[0], "NORMAL": accessors[1]})
    file.primitive()["targets"] = targets
    return file.write(target)
