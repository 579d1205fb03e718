"""The crate in Bevy itself, without a window, on a software driver: normals of real draws against the replay.

`draw` draws vertices as points into a picture of floats, each with its normal and its number.
`make setup-bevy` builds it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER as FIXTURES
from skinbake.choices import Encoding, Layout
from skinbake.format.encodings import GradientFormat
from skinbake.geometry.frames import frame_from_normal
from skinbake.skinning.rest import Algorithm
from tests.support.baked_files import Editable
from tests.support.characters import AS_USUAL, Array, Character, Placement, Pose, angles, baked
from tests.support.morphed_files import morphed

pytestmark = pytest.mark.slow

BUILT = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skinbake-bevy"
"""Where `make setup-bevy` has Bevy. Cargo builds here what has changed since."""
SOURCE = Path(__file__).parent / "draw" / "Cargo.toml"
DRIVER = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json"
TIMEOUT_SECONDS = 600

DEGREES = 0.02
"""Between Bevy and the replay: Bevy has joint matrices in float32."""
STORED_DEGREES = {"prepass": 0.15, "deferred": 0.1}
"""Rounding: 10 bits for each component in the prepass, 12 bits for each of two in the G-buffer."""
COLUMN = 384
WEIGHTS = (0.6, 0.3)
TUBE, TWO_SETS = FIXTURES / "bent_tube.glb", FIXTURES / "two_sets.glb"
BENT = 0.45
Said = dict[str, str | None]
PLAIN = (1.0, 1.0, 1.0)
MIRRORED = (-1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Instance:
    """A file in a scene, drawn in a column of the picture of its own."""

    path: Path
    scale: tuple[float, float, float] = PLAIN
    morphs: tuple[float, ...] = ()

    @property
    def character(self) -> Character:
        """The character in its pose, by the tests' own readers."""
        return Character(self.path, Pose(0, BENT), self.morphs)


@dataclass(frozen=True)
class Seen:
    """Normals of an instance's vertices (V, 3): zeros where another vertex is in front, and the replay's."""

    normals: Array
    accurate: Array
    standard: Array

    def errors(self) -> Array:
        """Return the angles in degrees to the replay, of the vertices that are seen."""
        seen = self.normals.any(axis=1)
        assert seen.mean() > 0.4
        return angles(self.normals[seen], self.accurate[seen])


class Stage:
    """Draw scenes, and read back what Bevy has drawn."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.numbers: Array | None = None
        self.log = ""

    def file(self, name: str, source: Path) -> Path:
        """Copy a file with the numbers of its vertices, from 1 on, in TEXCOORD_0."""
        file = Editable(source)
        numbers = np.arange(1, len(file.array("POSITION")) + 1, dtype=np.float32)
        file.primitive()["attributes"]["TEXCOORD_0"] = file.add(np.stack([numbers, 0 * numbers], axis=1))
        return file.write(self.folder / name)

    def drawn(self, mode: str, instances: list[Instance]) -> tuple[list[Seen], list[Said]]:
        """Return what is seen of each instance, and what the crate says of each mesh."""
        bodies = [one.character for one in instances]
        roots = [np.diag([*one.scale, 1.0]) for one in instances]
        points = [body.positions(Placement(root)) for body, root in zip(bodies, roots, strict=True)]
        size = 1.1 * max(float(np.ptp(one[:, :2], axis=0).max()) for one in points)
        for column, (root, one) in enumerate(zip(roots, points, strict=True)):
            middle = (one.min(axis=0) + one.max(axis=0)) / 2
            root[:3, 3] = [size * (column - (len(roots) - 1) / 2), 0.0, 0.0] - middle
        placed = [
            {"file": one.path.name, "scale": one.scale, "at": root[:3, 3].tolist(), "time": BENT}
            for one, root in zip(instances, roots, strict=True)
        ]
        picture, said = self.run(mode, placed, size)
        assert "ERROR" not in self.log
        if mode == "forward":
            self.numbers = picture[..., 3]
        assert self.numbers is not None
        seen = []
        for column, (body, root) in enumerate(zip(bodies, roots, strict=True)):
            part = np.s_[:, COLUMN * column : COLUMN * (column + 1)]
            numbers = self.numbers[part].round().astype(int)
            normals = np.zeros((len(body.rest.positions), 3))
            normals[numbers[numbers > 0] - 1] = picture[part][numbers > 0][:, :3]
            # As Bevy's own, normals are on the outside where the entity mirrors.
            side = np.sign(np.linalg.det(root[:3, :3]))
            expected = body.expected(Algorithm.LBS_ACCURATE, Placement(root)).normals * side
            own = body.expected(Algorithm.LBS_STANDARD, Placement(root)).normals * side
            seen.append(Seen(normals, expected, own))
        return seen, said

    def run(self, mode: str, placed: list[dict[str, Any]], size: float = 5.0) -> tuple[Array, list[Said]]:
        """Return the picture (height, width, 4), and what the crate says of each mesh; ``log`` is its log."""
        scene = {
            "folder": str(self.folder),
            "mode": mode,
            "width": COLUMN * len(placed),
            "height": COLUMN,
            "tall": size,
            "weights": WEIGHTS,
            "out": str(self.folder / "picture"),
            "instances": placed,
        }
        (self.folder / "scene.json").write_text(json.dumps(scene))
        process = subprocess.run(
            [BUILT / "debug" / "draw", self.folder / "scene.json"],
            capture_output=True,
            text=True,
            timeout=TIMEOUT_SECONDS,
            check=False,
            env={**os.environ, "VK_ICD_FILENAMES": DRIVER, "WGPU_BACKEND": "vulkan"},
        )
        self.log = process.stdout + process.stderr
        assert process.returncode == 0, self.log
        picture = np.fromfile(self.folder / "picture", np.float32).reshape(COLUMN, -1, 4).astype(np.float64)
        return picture, [json.loads(line) for line in process.stdout.splitlines() if line.startswith("{")]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    cargo = shutil.which("cargo", path=f"{os.environ['PATH']}:{Path.home() / '.cargo' / 'bin'}")
    if cargo is None or not BUILT.is_dir():
        # Not even a strict run promises it: it takes long.
        pytest.skip("Bevy is not built: run `make setup-bevy`")
    command = [cargo, "build", "--quiet", "--offline", "--manifest-path", str(SOURCE)]
    subprocess.run(command, check=True, env={**os.environ, "CARGO_TARGET_DIR": str(BUILT)})
    return Stage(tmp_path_factory.mktemp("bevy"))


@pytest.fixture(scope="module")
def instances(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Instance]:
    """What every scene draws."""
    folder = tmp_path_factory.mktemp("baked")

    def made(name: str, source: Path, storage: GradientFormat = AS_USUAL) -> Path:
        return stage.file(f"{name}.glb", baked(source, folder, storage=storage))

    tube = made("tube", TUBE)
    moved = stage.file("moved.glb", morphed(baked(TUBE, folder), folder / "moved.glb"))
    return {
        "first": Instance(tube),
        "second": Instance(tube),
        "mirrored": Instance(tube, MIRRORED),
        "packed8": Instance(made("packed8", TUBE, GradientFormat(Encoding.PACKED8))),
        "snorm16": Instance(made("snorm16", TUBE, GradientFormat(Encoding.SNORM16, Layout.CUSTOM))),
        "tangents": Instance(made("tangents", _with_tangents(folder / "source.glb"))),
        "morphed": Instance(moved, morphs=WEIGHTS),
    }


@dataclass(frozen=True)
class Drawn:
    """What is seen, by mode and instance, and what the crate says of the meshes, in order."""

    seen: dict[str, dict[str, Seen]]
    said: list[Said]


@pytest.fixture(scope="module")
def drawn(stage: Stage, instances: dict[str, Instance]) -> Drawn:
    found: dict[str, dict[str, Seen]] = {}
    said: list[Said] = []
    for mode in ("forward", *STORED_DEGREES):
        seen, said = stage.drawn(mode, list(instances.values()))
        found[mode] = dict(zip(instances, seen, strict=True))
    return Drawn(found, said)


NAMES = ["first", "second", "mirrored", "packed8", "snorm16", "tangents", "morphed"]


@pytest.mark.parametrize("name", NAMES)
def test_normals_are_those_of_the_replay(name: str, drawn: Drawn) -> None:
    seen = drawn.seen["forward"][name]
    assert seen.errors().max() < DEGREES
    assert np.percentile(angles(seen.accurate, seen.standard), 95) > 5


@pytest.mark.parametrize("mode", STORED_DEGREES)
@pytest.mark.parametrize("name", NAMES)
def test_screen_space_effects_and_deferred_lighting_see_the_same_normals(
    name: str, mode: str, drawn: Drawn
) -> None:
    assert drawn.seen[mode][name].errors().max() < STORED_DEGREES[mode]


def test_all_that_share_a_bake_and_a_material_share_its_extension(drawn: Drawn) -> None:
    assert [one["standard"] for one in drawn.said] == [None] * len(NAMES)
    # Each of the five other files has a material of its own; the first file is drawn three times.
    assert None not in {one["material"] for one in drawn.said}
    assert len({one["material"] for one in drawn.said}) == len(NAMES) - 2


def test_each_mesh_that_stays_standard_is_named_with_the_reason(stage: Stage, tmp_path: Path) -> None:
    changed = Editable(baked(TUBE, tmp_path))
    changed.metadata()["positions"]["joints"] += 1
    files = {
        "it is not baked": TUBE,
        "it has 8 influences for each vertex, and Bevy reads four": baked(TWO_SETS, tmp_path),
        "bake it again with --layout attributes": baked(
            TUBE, tmp_path, storage=GradientFormat(layout=Layout.TEXCOORD)
        ),
        "a tool has changed the order of its joints since its bake: bake last": changed.write(
            tmp_path / "changed.glb"
        ),
    }
    placed = []
    for number, path in enumerate([*files.values(), TUBE]):
        name = stage.file(f"standard{number % 4}.glb", path).name if number < 4 else "standard0.glb"
        placed.append({"file": name, "scale": PLAIN, "at": [4.0 * number - 8, 0.0, 0.0], "time": 0.0})
    _, said = stage.run("forward", placed, 4.0)
    # The log has one line for all instances of a mesh.
    told = [line for line in stage.log.splitlines() if "stays standard" in line]
    for reason in files:
        count = 2 if reason == "it is not baked" else 1
        assert sum(reason in (one["standard"] or "") for one in said) == count
        assert sum(reason in line for line in told) == 1


def _with_tangents(path: Path) -> Path:
    """Write the tube with a left-handed TANGENT, turned from the frame of NORMAL."""
    file = Editable(TUBE)
    tangents, bitangents = frame_from_normal(file.array("NORMAL"))
    left = np.full((len(tangents), 1), -1.0)
    turned = np.hstack([0.6 * tangents + 0.8 * bitangents, left]).astype(np.float32)
    file.primitive()["attributes"]["TANGENT"] = file.add(turned)
    return file.write(path)
