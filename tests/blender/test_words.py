"""The parts of the add-on that need no Blender: its words, its tables, and its zip."""

from __future__ import annotations

import pickle
import re
import shutil
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from engines.blender import build
from fixtures.make_fixtures import FOLDER
from skinbake.errors import Chosen, Message
from skinbake.options import BAKE, on_command_line
from skinbake.wording import gain_in_words
from tests.blender.running import addon_module
from tests.support.baked_files import Editable

baking = addon_module("baking")
options = addon_module("options")

SAVED = {
    "correctives": {"none": 0, "auto": -1, "1": 1, "2": 2, "4": 4, "8": 8},
    "gradients": {"fitted": 0, "surface": 1},
    "frame": {"auto": 0, "tangent": 1, "normal": 2},
    "encoding": {"float32": 0, "snorm16": 1, "packed8": 2},
    "layout": {"attributes": 0, "texcoord": 1, "custom": 2},
    "neighbours": {"adopt": 0, "extend": 1, "drop": 2},
    "weld": {"mesh": 0, "skin": 1},
    "limit_influences": {"0": 0, "4": 1, "8": 2},
}
"""The numbers in saved scenes. A new value gets a new number, wherever it stands in the list."""


def baked(name: str, folder: Path, measure: bool = False, **chosen: Any) -> Any:
    """Bake a copy of a fixture as the add-on does an export."""
    copy = folder / name
    shutil.copy(FOLDER / name, copy)
    return baking.bake_export(str(copy), chosen, measure=measure)


def test_the_panel_offers_the_declared_values() -> None:
    offered = {name: [item[0] for item in items] for name, (_, items) in options.CHOICES.items()}
    assert [int(value) for value in offered.pop("limit_influences")] == [0, 4, 8]
    declared: dict[str, Any] = {one.name: one.values for one in BAKE}
    assert offered.pop("correctives") == ["none", "auto", "1", "2", "4", "8"]
    assert [declared["correctives"].read(value) for value in ("auto", 1, 8)] == ["auto", 1, 8]
    assert {name: set(values) for name, values in offered.items()} == {
        name: set(declared[name]) for name in offered
    }


def test_a_saved_option_keeps_its_meaning() -> None:
    numbers = {name: {item[0]: item[3] for item in items} for name, (_, items) in options.CHOICES.items()}
    assert numbers == SAVED


def test_a_limit_of_influences_says_how_many_vertices_lost_some(tmp_path: Path) -> None:
    outcome = baked("two_sets.glb", tmp_path, limit_influences=4)
    assert outcome.status == "baked"
    assert "256 vertices lost influences" in outcome.lines[0].text


@pytest.mark.slow
def test_a_stale_bake_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # No export is stale; so the file is spoiled between the bake and its verification.
    def spoiled(source: str, target: str, **chosen: Any) -> dict[str, Any]:
        result = usual(source, target, **chosen)
        file = Editable(Path(target))
        file.array("_SKINBAKE_ALPHA_0")[:] *= 2
        file.write(Path(target))
        return result

    usual = skinbake.bake
    monkeypatch.setattr(skinbake, "bake", spoiled)
    outcome = baked("bent_tube.glb", tmp_path, measure=True)
    assert outcome.status == "baked"
    errors = [line.text for line in outcome.lines if line.level == "ERROR"]
    assert errors and all(text.startswith("verify, ") for text in errors)


def test_a_measurement_that_fails_keeps_the_bake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*paths: str, **chosen: Any) -> dict[str, Any]:
        raise skinbake.InputError("no memory is left")

    monkeypatch.setattr(skinbake, "verify", broken)
    outcome = baked("bent_tube.glb", tmp_path, measure=True)
    assert (outcome.status, outcome.gain) == ("baked", None)
    assert outcome.lines[-1] == baking.Line("WARNING", "baked, but not measured: no memory is left")


def test_a_measurement_tells_the_gain_by_triangles_and_judges_by_the_lower_one(tmp_path: Path) -> None:
    outcome = baked("bent_tube.glb", tmp_path, measure=True)
    verdict = skinbake.verify(tmp_path / "bent_tube.glb", methods=["lbs"])
    assert outcome.gain == min(
        verdict[kind]["lbs"]["gain"] for kind in ("normals_by_triangles", "normals_by_tangents")
    )
    shown = verdict["normals_by_triangles"]["lbs"]["gain"]
    assert f", gain {shown:.2f}x, over 60 poses of 1 clip" in outcome.lines[-1].text


@pytest.mark.slow
def test_correctives_are_measured_by_what_the_file_shows(tmp_path: Path) -> None:
    outcome = baked("bent_tube.glb", tmp_path, measure=True, correctives=1, encoding="snorm16")
    assert outcome.status == "baked"
    assert outcome.lines[0].text.startswith("bent_tube.glb: baked: correctives: 1 mesh, 1 morph target, ")
    lbs = skinbake.verify(tmp_path / "bent_tube.glb", methods=["lbs"])["normals_by_triangles"]["lbs"]
    shown = f"error of normals {lbs['standard']['mean']:.2f}° -> {lbs['corrected']['mean']:.2f}°, gain "
    assert outcome.lines[1].text.startswith(shown)
    assert f"{lbs['corrected']['mean']:.2f}" != f"{lbs['accurate']['mean']:.2f}"


def test_correctives_without_a_clip_say_what_is_missing(tmp_path: Path) -> None:
    outcome = baked("seam.glb", tmp_path, correctives="auto")
    assert (outcome.status, [line.level for line in outcome.lines]) == ("unchanged", ["INFO", "WARNING"])
    assert outcome.lines[0].text == "seam.glb: the plain export was kept"
    assert "only clips play correctives" in outcome.lines[1].text


def test_a_measurement_says_that_nothing_bends(tmp_path: Path) -> None:
    # All vertices follow one joint alone, so each pose moves the tube as a whole.
    file = Editable(FOLDER / "bent_tube.glb")
    file.array("WEIGHTS_0")[:] = [1.0, 0.0, 0.0, 0.0]
    outcome = baking.bake_export(str(file.write(tmp_path / "rigid.glb")), {}, measure=True)
    assert (outcome.status, outcome.gain) == ("baked", None)
    said = outcome.lines[-1].text
    assert said.startswith("nothing bends: standard normals are right already, over ")


def test_an_exact_correction_has_errors_and_no_gain() -> None:
    # The gain of a verdict is null if the mean error of accurate lighting is only rounding.
    lbs = {"standard": {"mean": 3.25}, "accurate": {"mean": 2e-6}, "gain": None}
    lines, gain = baking._figures(
        {"normals_by_triangles": {"lbs": lbs}, "normals_by_tangents": {}, "poses": "2 poses"}
    )
    assert gain is None
    assert [line.text for line in lines] == ["error of normals 3.25° -> 0.00°, over 2 poses"]


@pytest.mark.parametrize(
    ("gain", "shown"),
    [
        (28920.71, "28,921"),
        (100.0, "100"),
        (99.99, "99.99"),
        (2.204, "2.20"),
        (1.004, "1.00"),
        (1.0, "1.00"),
        (0.99999999, "0.9999"),
        (0.9999, "0.9999"),
        (0.997, "0.997"),
        (0.991, "0.99"),
        (0.5, "0.50"),
    ],
)
def test_a_loss_is_never_shown_as_no_change(gain: float, shown: str) -> None:
    lbs = {"standard": {"mean": 3.25 * gain}, "accurate": {"mean": 3.25}, "gain": gain}
    lines, _ = baking._figures(
        {"normals_by_triangles": {"lbs": lbs}, "normals_by_tangents": {}, "poses": "2 poses"}
    )
    (line,) = lines
    assert re.findall(r"gain (.*)x, over 2 poses", line.text) == [shown]
    assert gain_in_words(gain) == shown  # as skinbake verify shows it


def test_a_refused_option_keeps_the_export(tmp_path: Path) -> None:
    outcome = baked("bent_tube.glb", tmp_path, limit_influences=3)
    assert (outcome.status, [line.level for line in outcome.lines]) == ("failed", ["ERROR"])
    assert outcome.lines[0].text.startswith('bent_tube.glb: the plain export was kept: "Influences" 3: ')
    assert (tmp_path / "bent_tube.glb").read_bytes() == (FOLDER / "bent_tube.glb").read_bytes()


def words_of(message: str) -> str:
    """Return what the panel says of a mesh, by the message of a notice."""
    notice = {"code": "any", "message": message, "mesh_name": "Body"}
    (line,) = baking._warnings([notice])
    return str(line.text.removeprefix('mesh "Body": '))


def test_options_have_the_names_of_the_panel(tmp_path: Path) -> None:
    outcome = baked("bent_tube.glb", tmp_path, layout="texcoord", encoding="packed8")
    assert '"Layout: UV sets" needs "Encoding: 32-bit floats", not packed8' in outcome.lines[0].text
    for name, (label, items) in options.CHOICES.items():
        for value, shown, *_ in items:
            message = Message("try ", Chosen(name, value), ".")
            assert message == f"try {on_command_line(Chosen(name, value))}."
            assert words_of(message) == f'try "{label}: {shown}".'
    angle = Message("with ", Chosen("crease_angle", 180), ": so")
    assert words_of(pickle.loads(pickle.dumps(angle))) == 'with "Crease angle: 180°": so'
    assert words_of(Message("an ", Chosen("encoding"), " of 8 bits")) == 'an "Encoding" of 8 bits'
    # Words that only look like an option are words.
    assert words_of("bone --encoding packed8 is at rest") == "bone --encoding packed8 is at rest"
    outcome = baked("bent_tube.glb", tmp_path, neighbours="extend", limit_influences=4)
    assert outcome.lines[0].text.endswith(
        'kept: "Influences" contradicts "Bones of neighbours: Extend", which adds influences'
    )


def test_a_skipped_mesh_says_what_to_do_in_blender(tmp_path: Path) -> None:
    outcome = baked("bent_tube.glb", tmp_path, frame="tangent")
    assert [line.text for line in outcome.lines][1:] == [
        'mesh "tube", primitive 0: skipped: it has no TANGENT; turn on Data > Mesh > Tangents in the exporter'
    ]


def test_meshes_of_one_name_are_named_once() -> None:
    notice = {
        "code": "no-normals",
        "message": "skipped: it has no NORMAL",
        "mesh_name": "Body",
        "primitive": 0,
    }
    lines = baking._warnings([{**notice, "mesh": 0}, {**notice, "mesh": 1}])
    assert [line.text.partition(":")[0] for line in lines] == ['mesh "Body", primitive 0']


def test_bake_and_verify_say_the_same_once(tmp_path: Path) -> None:
    file = Editable(FOLDER / "bent_tube.glb")
    file.array("NORMAL")[:] *= -1
    outcome = baking.bake_export(str(file.write(tmp_path / "inside.glb")), {}, measure=True)
    warnings = [line.text for line in outcome.lines if line.level == "WARNING"]
    assert len(warnings) == 1
    assert warnings[0].endswith(
        "Normals and triangles face opposite ways: turn the one or the other. In Blender: if the scale of "
        "the mesh or of its armature is negative or uneven, select both and choose Object > Apply > Scale"
    )


@pytest.mark.parametrize(
    ("losses", "said"),
    [
        ([{}], None),
        (
            [{"lost_gradient": 0.2}, {"gradient": 3.0}],
            'joints of neighbours left out: 5.0 % of the gradient; try "Bones of neighbours: Extend"',
        ),
        (
            [{"lost_gradient": 0.06, "extended": {"influences": 8}}],
            "joints of neighbours left out: 6.0 % of the gradient",
        ),
        (
            [{"lost_gradient": 0.125, "limited": {"influences": 4}}],
            "joints of neighbours left out: 12.5 % of the gradient; try a larger limit of influences",
        ),
    ],
)
def test_a_large_loss_is_said_with_what_helps(losses: list[dict[str, Any]], said: str | None) -> None:
    plain = {"gradient": 1.0, "lost_gradient": 0.0, "limited": None, "extended": None}
    assert list(baking._loss([plain | loss for loss in losses])) == ([said] if said else [])


def test_a_loss_of_a_real_bake_is_said(tmp_path: Path) -> None:
    outcome = baked("foreign_joints.glb", tmp_path, neighbours="drop")
    assert outcome.lines[0].text.endswith(
        '; joints of neighbours left out: 42.3 % of the gradient; try "Bones of neighbours: Extend"'
    )


@pytest.mark.parametrize(("gain", "is_said"), [(1.19, True), (1.2, False)])
def test_a_small_gain_says_to_turn_the_bake_off(
    gain: float, is_said: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measured(*paths: Any, **chosen: Any) -> dict[str, Any]:
        verdict = usual(*paths, **chosen)
        verdict["normals_by_tangents"]["lbs"]["gain"] = gain
        return verdict

    usual = skinbake.verify
    monkeypatch.setattr(skinbake, "verify", measured)
    outcome = baked("bent_tube.glb", tmp_path, measure=True)
    assert outcome.gain == gain
    text = "little to win: the gain is under 1.2. Turn off the bake for this file"
    assert (baking.Line("INFO", text) in outcome.lines) == is_said


def test_a_failure_names_the_mesh(tmp_path: Path) -> None:
    file = Editable(FOLDER / "bent_tube.glb")
    file.array("POSITION")[5, 1] = np.nan
    path = file.write(tmp_path / "nan.glb")
    plain = path.read_bytes()
    outcome = baking.bake_export(str(path), {}, measure=True)
    start = 'nan.glb: the plain export was kept: mesh 0 "tube", primitive 0, POSITION: '
    assert outcome.lines[0].text.startswith(start)
    assert path.read_bytes() == plain


@pytest.fixture
def wheels(tmp_path: Path) -> Path:
    """Return a folder with two files for each library: a build looks at names alone."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    for library in build.LIBRARIES:
        for tag in ("cp311", "cp313"):
            (folder / f"{library.lower()}-1.0-{tag}-{tag}-any.whl").write_bytes(library.encode())
    return folder


@pytest.mark.slow
def test_a_build_has_the_same_bytes_again(tmp_path: Path, wheels: Path) -> None:
    first, second = (build.build(tmp_path / name, "3.11", wheels).read_bytes() for name in "ab")
    assert first == second


@pytest.mark.parametrize(("python", "blenders"), [("3.11", ("4.5.0", "5.1.0")), ("3.13", ("5.1.0", None))])
def test_the_zip_says_what_it_fits(
    tmp_path: Path, wheels: Path, python: str, blenders: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "skinbake_wheel", lambda: ("skinbake-1.0-py3-none-any.whl", b""))
    with zipfile.ZipFile(build.build(tmp_path, python, wheels)) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        names = set(archive.namelist())
    assert (manifest["blender_version_min"], manifest.get("blender_version_max")) == blenders
    assert manifest["platforms"] == [build.this_system()]
    assert {name.removeprefix("./") for name in manifest["wheels"]} <= names
    assert len(manifest["wheels"]) == len(build.LIBRARIES) + 1
    tags = {name.split("-")[2] for name in manifest["wheels"] if "skinbake" not in name}
    assert tags == {f"cp{python.replace('.', '')}"}
    assert manifest["permissions"]["files"]
    assert {"__init__.py", "baking.py", "options.py", "panel.py", "settings.py", "LICENSE"} <= names


def test_each_system_and_each_blender_has_a_zip_with_its_own_wheels(tmp_path: Path) -> None:
    wheels = tmp_path / "wheels"
    for system, platforms in build.PLATFORMS.items():
        own = f"skinbake-{skinbake.__version__}-cp311-abi3-{platforms[0]}.whl"
        (tmp_path / own).write_bytes(system.encode())
        for python in build.BLENDERS:
            (wheels / f"{system}-{python}").mkdir(parents=True)
            tag = f"cp{python.replace('.', '')}"
            for library in build.LIBRARIES:
                (wheels / f"{system}-{python}" / f"{library}-1-{tag}-{tag}-{platforms[-1]}.whl").touch()
    zips = build.build_all(tmp_path / "zips", tmp_path, wheels)
    assert len({path.name for path in zips}) == len(build.PLATFORMS) * len(build.BLENDERS)
    for path in zips:
        with zipfile.ZipFile(path) as archive:
            manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
            [system] = manifest["platforms"]
            [own] = [name for name in manifest["wheels"] if "skinbake-" in name]
            assert archive.read(own.removeprefix("./")) == system.encode()
        assert f"-{system}-py" in path.name
        assert all(name.endswith(build.PLATFORMS[system], 0, -len(".whl")) for name in manifest["wheels"])


@pytest.mark.slow
def test_the_wheel_of_skinbake_holds_all_of_it(tmp_path: Path) -> None:
    name, data = build.skinbake_wheel()
    (tmp_path / name).write_bytes(data)
    with zipfile.ZipFile(tmp_path / name) as archive:
        held = set(archive.namelist())
        record = archive.read(next(entry for entry in held if entry.endswith("/RECORD"))).decode()
    sources = {path.relative_to(build.PACKAGE.parent).as_posix() for path in build.PACKAGE.rglob("*.py")}
    assert sources <= held
    assert {"skinbake/py.typed", "skinbake/shaders/templates/targets/bevy.wgsl"} <= held
    assert not {entry for entry in held if entry.endswith((".c", ".pyc"))}
    assert {line.split(",")[0] for line in record.splitlines()} == held


@pytest.mark.parametrize("count", [0, 2])
def test_a_missing_or_doubtful_library_is_refused(tmp_path: Path, wheels: Path, count: int) -> None:
    for path in wheels.glob("scipy*"):
        path.unlink()
    for number in range(count):
        (wheels / f"scipy-1.{number}-cp311-cp311-any.whl").touch()
    (wheels / "scipy-1.9-cp313-cp313-any.whl").touch()
    with pytest.raises(ValueError, match=f"expected one wheel of scipy for Python 3.11, found {count}"):
        build.build(tmp_path, "3.11", wheels)
    assert not list(tmp_path.glob("*.zip"))
