"""Text for people: results on stdout, messages on stderr, as much and as colourful as they want."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from fixtures.builder import JsonObject
from skinbake.cli import bake as bake_command
from skinbake.cli import exit_codes
from skinbake.cli.console import without_repeats
from skinbake.cli.terminal import with_colours
from skinbake.errors import Notice, Place
from skinbake.gradients import kernel
from skinbake.report.bake import (
    BakedCounts,
    FileResult,
    LimitCost,
    closing_line,
    detail_lines,
    short_line,
)
from tests.support.command_line import document, invoke, run
from tests.support.models import FIXTURES, FOLDER, bake, edited, sheet, write_model
from tests.support.tools import required_program

SEAM = FOLDER / "seam.glb"
SOURCES = Path(skinbake.__file__).parent
ESCAPE = "\x1b["


@pytest.fixture
def warned(tmp_path: Path) -> Path:
    """A file of two primitives: one to be skipped, one with 20 vertices whose weights sum to ½."""
    weights = np.tile(np.array([0.25, 0.25, 0, 0], np.float32), (20, 1))
    return write_model(tmp_path / "warned.glb", [sheet(NORMAL=None), sheet(WEIGHTS_0=weights)])


def test_warnings_name_file_mesh_and_primitive_and_are_aggregated(warned: Path) -> None:
    result = invoke("bake", warned, "--dry-run")
    assert result.stderr.splitlines() == [
        f'warning: {warned}: mesh 0 "sheet", primitive 0: skipped: it has no NORMAL; '
        "bake --generate-normals adds smooth ones",
        f'warning: {warned}: mesh 0 "sheet", primitive 1: the weights of 20 vertices do not sum to 1 (0.5): '
        "in a shader the correction of the normals is 100 % too strong there; normalise the weights "
        "before the bake",
    ]


def crowd(folder: Path, count: int) -> Path:
    """Write a file of so many primitives. Their weights do not sum to 1, at other numbers of vertices."""
    parts = []
    for number in range(count):
        weights = np.tile(np.array([0.5, 0.5, 0, 0], np.float32), (20, 1))
        weights[: number + 2] = [0.25, 0.25, 0, 0]
        parts.append(sheet(WEIGHTS_0=weights))
    return write_model(folder / "crowd.glb", [*parts, sheet(NORMAL=None)])


def test_many_warnings_that_are_alike_are_one_line(tmp_path: Path) -> None:
    path = crowd(tmp_path, 12)
    result = invoke("bake", path, "--dry-run")
    normals, sums = result.stderr.splitlines()
    assert sums.startswith(f'warning: {path}: mesh 0 "sheet", primitive 0: the weights of 2 vertices do not')
    assert sums.endswith(
        '(11 more are alike: mesh 0 "sheet", primitive 1; mesh 0 "sheet", primitive 2; -v shows all)'
    )
    assert normals.startswith(f'warning: {path}: mesh 0 "sheet", primitive 12: skipped: it has no NORMAL')
    verbose = invoke("bake", path, "--dry-run", "-v").stderr.splitlines()
    shown = [line for line in verbose if line.startswith("warning: ")]
    told = [re.findall(r"primitive (\d+): the weights of (\d+) vertices", line) for line in shown]
    assert told == [[]] + [[(str(number), str(number + 2))] for number in range(12)]
    (file,) = document(invoke("bake", path, "--dry-run", "--json"))["files"]
    assert [warning["count"] for warning in file["warnings"]] == [1, *range(2, 14)]


def test_three_warnings_that_are_alike_are_three_lines_in_their_order(tmp_path: Path) -> None:
    lines = invoke("bake", crowd(tmp_path, 3), "--dry-run").stderr.splitlines()
    assert [re.findall(r"primitive \d: .{11}", line) for line in lines] == [
        ["primitive 3: skipped: it"],
        *([f"primitive {number}: the weights"] for number in range(3)),
    ]


def test_warnings_of_one_code_on_other_things_are_not_alike() -> None:
    place = Place("a.glb", 0, None, 0)
    named = [Notice("image", f'image 1 "{name}" is missing', place) for name in "abcde"]
    other_files = [Notice("sum", "20 vertices", Place(f"{name}.glb", 0, None, 0)) for name in "abcde"]
    of_files = [Notice("accessor", f"accessor {number} is unused", Place("a.glb")) for number in range(5)]
    mixed = [notice for three in zip(named, other_files, of_files, strict=True) for notice in three]
    assert list(without_repeats(mixed)) == [(notice, str(notice)) for notice in mixed]


def test_errors_name_file_mesh_primitive_and_attribute(tmp_path: Path) -> None:
    def cut(content: JsonObject) -> None:
        content["accessors"][3]["count"] = 3

    path = edited("seam.glb", tmp_path, cut)
    result = invoke("bake", path, "--dry-run")
    assert result.stderr.startswith(f'error: {path}: mesh 0 "seam", primitive 0, ')
    assert "it has 3 elements, POSITION has 198" in result.stderr


def test_the_closing_line_counts(warned: Path, tmp_path: Path) -> None:
    result = invoke("bake", warned, "-o", tmp_path / "out.glb")
    (line,) = result.stdout.splitlines()
    # The weights are the same everywhere: α and β are both zero, and 20 zeros of VEC3 are stored once.
    assert line == (
        f"{warned} -> {tmp_path / 'out.glb'}: baked: 1 primitive, 20 vertices, frame from normal, "
        "240 bytes added, 1 skinned primitive skipped, no weight changes along the surface, "
        "so all α/β are 0: only uneven scale gains, 2 warnings"
    )


def test_lines_over_many_files_are_short_and_v_shows_them_in_full(warned: Path, tmp_path: Path) -> None:
    inputs = [warned, FOLDER / "seam.glb"]
    whole = [invoke("bake", path, "--out-dir", tmp_path / "out").stdout for path in inputs]
    short = invoke("bake", *inputs, "--out-dir", tmp_path / "out").stdout.splitlines()
    out = tmp_path / "out"
    assert short == [
        f"{warned} -> {out / warned.name}: baked: 1 primitive, 240 bytes added, 1 skipped, 2 warnings",
        f"{inputs[1]} -> {out / 'seam.glb'}: baked: 1 primitive, 4,752 bytes added",
    ]
    assert invoke("bake", *inputs, "--out-dir", tmp_path / "out", "-v").stdout == "".join(whole)
    assert all("frame from normal" in line for line in whole)


def test_a_short_line_keeps_what_was_lost_and_what_was_asked_for(tmp_path: Path) -> None:
    result = invoke(
        "bake", FOLDER / "foreign_joints.glb", FOLDER / "two_sets.glb", "--dry-run", "--neighbours", "drop"
    )
    assert re.search(
        r"foreign_joints.glb \(dry run\): baked: .* \d+\.\d % of the gradient left out", result.stdout
    )
    result = invoke(
        "bake", FOLDER / "two_sets.glb", FOLDER / "seam.glb", "--dry-run", "--limit-influences", "4"
    )
    assert "limited to 4 influences" in result.stdout.splitlines()[0]


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("a.glb: failed, nothing written", "a.glb: \x1b[31mfailed\x1b[0m, nothing written"),
        ("a.glb: passed before, up to date", "a.glb: \x1b[32mpassed\x1b[0m before, up to date"),
        ("failed.glb -> passed.glb: baked", "failed.glb -> passed.glb: baked"),
    ],
)
def test_outcomes_have_colours(line: str, shown: str) -> None:
    assert with_colours(line) == shown


def test_a_count_of_one_is_singular() -> None:
    counts = BakedCounts(1, 1, 0, 1, "fitted", "normal", False, 1, 0, 1.0, 0.0, 1, 8)
    result = FileResult("a.glb", None, "baked", ((Place("a.glb"), counts),))
    assert closing_line(result, dry_run=True) == (
        "a.glb (dry run): baked: 1 primitive, 1 vertex, frame from normal, 1 byte added, "
        "1 vertex adopted joints"
    )
    assert short_line(result, dry_run=True) == "a.glb (dry run): baked: 1 primitive, 1 byte added"
    (detail,) = detail_lines(result)
    assert "1 vertex, 1 triangle, 1 slot, frame" in detail
    assert detail.endswith("1 byte")


def test_the_closing_line_tells_what_an_encoding_takes_and_costs() -> None:
    result = invoke("bake", FOLDER / "bent_tube.glb", "--dry-run", "--encoding", "packed8")
    pattern = (
        r"12,144 bytes added, packed8 at 8 bytes a vertex, "
        r"which turns normals by 0\.\d+° on average and 0\.\d+° at the 99th percentile"
    )
    assert re.search(pattern, result.stdout), result.stdout
    result = invoke("bake", FOLDER / "two_sets.glb", "--dry-run", "--encoding", "snorm16")
    assert "snorm16 at 32 bytes a vertex, which turns normals by under 0.0001° on average" in result.stdout


def test_animations_that_cannot_be_posed_do_not_stop_a_bake(tmp_path: Path) -> None:
    def breaking(content: Any) -> None:
        sampler = content["animations"][0]["samplers"][0]
        content["accessors"][sampler["input"]]["type"] = "VEC2"

    path = edited("bent_tube.glb", tmp_path, breaking)
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--encoding", "packed8")
    assert result.exit_code == 0, result.stderr
    assert "the error that --encoding packed8 adds could not be measured" in result.stderr
    assert "packed8 at 8 bytes a vertex, 3 warnings" in result.stdout
    others = ("not compared with standard lighting", "could not be measured")
    assert [words in invoke("bake", path, "--dry-run").stderr for words in others] == [True, False]


def test_inspect_tells_how_they_are_stored(tmp_path: Path) -> None:
    for options, words in (
        (["--encoding", "packed8", "--layout", "custom"], "encoding packed8, layout custom, 12,144 bytes"),
        (["--layout", "texcoord"], "layout texcoord, 36,432 bytes"),
    ):
        invoke("bake", FOLDER / "bent_tube.glb", "-o", tmp_path / "out.glb", *options)
        assert words in invoke("inspect", tmp_path / "out.glb").stdout


def test_the_closing_line_tells_adoption_and_degenerate_triangles(tmp_path: Path) -> None:
    result = invoke("bake", FOLDER / "foreign_joints.glb", "--dry-run")
    assert "vertices adopted joints" in result.stdout
    part = sheet()
    flat = part.attributes["POSITION"].copy()
    flat[0] = flat[1]
    path = write_model(tmp_path / "flat.glb", [sheet(POSITION=flat)])
    assert "1 triangle without area ignored" in invoke("bake", path, "--dry-run").stdout


def test_the_closing_line_tells_what_was_lost(tmp_path: Path) -> None:
    """Every slot is taken and every neighbour has other joints: nothing can be adopted."""
    joints = (np.arange(80).reshape(20, 4) % 40).astype(np.uint8)
    weights = np.full((20, 4), 0.25, np.float32)
    path = write_model(tmp_path / "full.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=40)
    result = invoke("bake", path, "--dry-run")
    told = r"20 vertices left out some joints of their neighbours \((\d+\.\d\d) % of the gradient([^)]*)\)"
    found = re.search(told, result.stdout)
    assert found is not None
    assert float(found[1]) > 5
    assert found[2].startswith("; try --neighbours extend, but three.js, PlayCanvas")
    short = invoke("bake", path, SEAM, "--dry-run").stdout.splitlines()[0]
    assert " % of the gradient left out; try --neighbours extend, but three.js" in short
    # The remedy leaves out less, and is not named again.
    result = invoke("bake", path, "--dry-run", "--neighbours", "extend")
    assert "try --neighbours" not in result.stdout
    remedied = re.search(told, result.stdout)
    assert remedied is not None
    assert float(remedied[1]) < float(found[1])


def test_a_limit_says_how_much_weight_it_has_taken() -> None:
    cost = LimitCost(4, 7, 0.5)
    counts = BakedCounts(9, 9, 0, 4, "fitted", "normal", False, 0, 2, 1.0, 0.4, 99, 24, cost)
    line = closing_line(FileResult("a.glb", None, "baked", ((Place("a.glb"), counts),)), dry_run=True)
    assert "limited to 4 influences: 7 vertices lost 50.00 % of their weight" in line
    # bake refuses --neighbours extend beside the limit.
    assert line.endswith("(40.00 % of the gradient; try a larger --limit-influences)")


def test_of_a_rigid_mesh_it_is_said_that_no_weight_changes(tmp_path: Path) -> None:
    """All vertices follow one joint, so standard lighting is right in every pose."""
    joints, weights = np.zeros((20, 4), np.uint8), np.tile(np.array([1, 0, 0, 0], np.float32), (20, 1))
    path = write_model(tmp_path / "rigid.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)])
    result = invoke("bake", path, "-o", tmp_path / "out.glb")
    assert result.stdout.endswith(
        ", no weight changes along the surface, so all α/β are 0: only uneven scale gains\n"
    )
    text = invoke("verify", tmp_path / "out.glb", "--poses", "random:2").stdout
    nothing = "Nothing to correct: standard lighting errs by 0.00° in the mean."
    assert text.endswith(f"\n  {nothing} Next: leave the file unbaked.\n")
    assert "all α/β are 0" not in invoke("bake", SEAM, "--dry-run").stdout


def test_a_small_share_that_is_left_out_asks_for_nothing() -> None:
    result = invoke("bake", FOLDER / "two_sets.glb", "--dry-run", "--neighbours", "drop")
    found = re.search(
        r"left out some joints of their neighbours \((.*) % of the gradient(.*?)\)", result.stdout
    )
    assert found is not None
    assert (0 < float(found[1]) < 5, found[2]) == (True, "")


@pytest.mark.slow
def test_one_line_closes_each_file(tmp_path: Path) -> None:
    result = invoke("bake", *(FOLDER / name for name in FIXTURES), "--out-dir", tmp_path)
    lines = result.stdout.splitlines()
    assert [line.split(" -> ")[0] for line in lines] == [str(FOLDER / name) for name in FIXTURES]
    (totals,) = result.stderr.splitlines()
    assert totals.startswith(f"{len(FIXTURES)} files: {len(FIXTURES)} baked, in ")


def test_quiet_leaves_errors_only(warned: Path, tmp_path: Path) -> None:
    result = invoke("bake", warned, "-o", tmp_path / "out.glb", "-q")
    assert (result.stdout, result.stderr) == ("", "")
    (tmp_path / "broken.glb").touch()
    result = invoke("bake", tmp_path / "broken.glb", "-o", tmp_path / "out.glb", "-q")
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")


@pytest.mark.slow
def test_verbose_says_more(warned: Path) -> None:
    plain = run("bake", warned, "--dry-run")
    more = run("bake", warned, "--dry-run", "-v")
    assert len(more.stderr) > len(plain.stderr)
    assert more.stdout.startswith(plain.stdout.rstrip()[:20])


def test_results_make_way_for_a_glb_on_stdout() -> None:
    result = invoke("bake", SEAM, "-o", "-")
    assert result.stdout_bytes.startswith(b"glTF")
    assert "baked: 1 primitive" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "environment", "is_coloured"),
    [
        ([], {}, False),
        (["--color", "always"], {}, True),
        (["--color", "always"], {"NO_COLOR": "1"}, True),
        (["--color", "never"], {}, False),
        (["--color", "auto"], {"NO_COLOR": "1"}, False),
    ],
)
def test_colour_follows_the_option(
    arguments: list[str], environment: dict[str, str], is_coloured: bool, warned: Path
) -> None:
    result = invoke("bake", warned, "--dry-run", *arguments, env=environment)
    assert (ESCAPE in result.stderr) == is_coloured
    assert ESCAPE not in result.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
@pytest.mark.slow
@pytest.mark.parametrize("no_color", ["", "1"])
def test_colour_goes_to_terminals_only_and_not_against_no_color(no_color: str, warned: Path) -> None:
    import pty

    leader, follower = pty.openpty()
    environment = {**os.environ, "NO_COLOR": no_color, "TERM": "xterm"}
    if not no_color:
        del environment["NO_COLOR"]
    command = [sys.executable, "-m", "skinbake", "bake", str(warned), "--dry-run"]
    subprocess.run(command, stderr=follower, stdout=subprocess.DEVNULL, env=environment, check=True)
    os.close(follower)
    shown = os.read(leader, 10_000).decode()
    os.close(leader)
    assert "skipped: it has no NORMAL" in shown
    assert (ESCAPE in shown) == (not no_color)


def test_a_name_cannot_forge_lines_or_colours(tmp_path: Path) -> None:
    name = "x\nerror: forged\x1b[31m"
    path = write_model(
        tmp_path / "sheet.glb",
        [sheet(NORMAL=None)],
        change=lambda content: content["meshes"][0].update(name=name),
    )
    result = invoke("bake", path, "--dry-run")
    assert "\nerror: forged" not in result.stderr
    assert "\x1b" not in result.stderr


@pytest.mark.slow
def test_verbose_says_that_no_loops_are_compiled() -> None:
    for asked, code, words in (
        ("numpy", 0, "without its compiled loops (SKINBAKE_KERNEL asks for numpy)"),
        ("nump", 2, 'error: SKINBAKE_KERNEL is "nump" in the environment: expected numpy, or nothing'),
    ):
        result = subprocess.run(
            [sys.executable, "-m", "skinbake", "bake", "-v", str(FOLDER / "seam.glb"), "--dry-run"],
            env={**os.environ, "SKINBAKE_KERNEL": asked},
            capture_output=True,
            text=True,
            check=False,
        )
        assert result.returncode == code, result.stderr
        assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(("vertices", "lines"), [(1_518, 1), (1_519, 0)])
def test_one_line_says_that_a_large_mesh_lacks_the_compiled_loops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, vertices: int, lines: int
) -> None:
    """The larger of two files has 1,518 vertices."""
    monkeypatch.setattr(kernel, "IS_COMPILED", False)
    monkeypatch.setattr(bake_command, "LARGE", vertices)
    models = [FOLDER / "bent_tube.glb", FOLDER / "seam.glb"]
    result = invoke("bake", *models, "--out-dir", tmp_path)
    assert result.exit_code == 0
    assert result.stderr.count("lacks its compiled loops") == lines


@pytest.mark.slow
def test_numpy_does_the_work_of_loops_that_do_not_load(tmp_path: Path) -> None:
    left = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
    shutil.copytree(SOURCES, tmp_path / "skinbake", ignore=left)
    for name in ("gradients/_kernel", "truth/_loops"):
        (tmp_path / "skinbake" / f"{name}{EXTENSION_SUFFIXES[-1]}").write_bytes(b"of another system")
    made = []
    asked = {"broken": {"PYTHONPATH": str(tmp_path)}, "numpy": {"SKINBAKE_KERNEL": "numpy"}}
    for name, variables in asked.items():
        result = subprocess.run(
            [sys.executable, "-m", "skinbake", "bake", "-v", FOLDER / "seam.glb", "-o", f"{name}.glb"],
            env={**os.environ, **variables, "PYTHONDONTWRITEBYTECODE": "1"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        told = [line for line in result.stderr.splitlines() if "without its compiled loops" in line]
        assert len(told) == 2
        assert [("_kernel." in line, "_loops." in line) for line in told] == (
            [(True, False), (False, True)] if name == "broken" else [(False, False)] * 2
        )
        made.append((tmp_path / f"{name}.glb").read_bytes())
    assert made[0] == made[1]


class TestInspect:
    def test_inspect_says_what_is_skinned_and_what_is_baked(self, tmp_path: Path) -> None:
        before = invoke("inspect", FOLDER / "two_primitives.glb").stdout
        assert before.count("baked       no") == 2
        assert 'mesh 0 "cut", primitive 1' in before
        assert "VEC4 UNSIGNED_BYTE" in before
        bake(FOLDER / "two_primitives.glb", tmp_path / "baked.glb")
        after = invoke("inspect", tmp_path / "baked.glb").stdout
        assert after.count("frame from normal, weighting max, neighbours adopt") == 2
        assert after.count("up to date") == 2

    def test_inspect_counts_defects_of_the_weights(self, warned: Path) -> None:
        result = invoke("inspect", warned)
        assert "20 vertices with weights that do not sum to 1\n" in result.stdout
        assert "none: no NORMAL" in result.stdout
        assert "skipped: it has no NORMAL" in result.stderr

    def test_equal_sums_of_weights_are_told_once(self, warned: Path) -> None:
        assert ", weights sum to 0.5\n" in invoke("inspect", warned).stdout

    def test_each_defect_of_the_weights_has_words(self, tmp_path: Path) -> None:
        joints, weights = np.tile(np.array([0, 1, 0, 0], np.uint8), (20, 1)), np.zeros((20, 4), np.float32)
        weights[1:] = [0.5, 0.5, 0, 0]
        weights[1] = [0.5, 0.25, 0.25, 0]
        weights[2:4] = [1.5, -0.5, 0, 0]
        path = write_model(tmp_path / "odd.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)])
        found = re.findall(r"    weights     (.*)\n", invoke("inspect", path).stdout)
        assert set(found) == {
            "1 vertex with no weight above 0",
            "1 vertex with one joint in several slots",
            "2 vertices with a negative weight",
            "2 vertices with weights that do not sum to 1",
        }

    def test_inspect_shows_attributes_of_any_type_that_gltf_knows(self, tmp_path: Path) -> None:
        def add(content: JsonObject) -> None:
            for kind in ("MAT2", "MAT3", "MAT4"):
                content["accessors"].append({"componentType": 5126, "count": 198, "type": kind})
                number = len(content["accessors"]) - 1
                content["meshes"][0]["primitives"][0]["attributes"][f"_{kind}"] = number

        path = edited("seam.glb", tmp_path, add)
        assert "_MAT3 MAT3 FLOAT" in invoke("inspect", path).stdout


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (slice(None), "20 vertices have a NORMAL without a direction: taken as (0, 0, 1); remove NORMAL and "
         "bake with --generate-normals"),
        (slice(1), "1 vertex has a NORMAL without a direction: taken as (0, 0, 1)"),
        (slice(1, None), "19 vertices have a NORMAL without a direction: taken as (0, 0, 1)"),
    ],
)  # fmt: skip
def test_normals_without_any_direction_are_better_made_anew(rows: slice, told: str, tmp_path: Path) -> None:
    normals = np.tile(np.array([0, 0, 1], np.float32), (20, 1))
    normals[rows] = 0
    path = write_model(tmp_path / "sheet.glb", [sheet(NORMAL=normals)])
    lines = invoke("bake", path, "--dry-run").stderr.splitlines()
    assert [line for line in lines if "without a direction" in line] == [
        f'warning: {path}: mesh 0 "sheet", primitive 0: {told}'
    ]


@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (np.inf, "infinite"), (-np.inf, "infinite")])
@pytest.mark.parametrize("component", range(3))
def test_the_component_of_a_normal_that_is_not_finite_is_named(
    component: int, value: float, word: str, tmp_path: Path
) -> None:
    for broken in ([0], [4, 9, 19]):
        normals = np.tile(np.array([0, 0, 1], np.float32), (20, 1))
        normals[broken, component] = value
        path = write_model(tmp_path / "sheet.glb", [sheet(NORMAL=normals)])
        where = f"at {len(broken)} vertices, first at " if len(broken) > 1 else "at "
        found = (
            f"(not finite {where}vertex {broken[0]}, where {'xyz'[component]} is {word}): taken as (0, 0, 1)"
        )
        assert f"a NORMAL without a direction {found}" in invoke("bake", path, "--dry-run").stderr


@pytest.mark.parametrize(
    ("sets", "told"),
    [
        (["JOINTS_2", "WEIGHTS_2"], "it has JOINTS_2 and no JOINTS_1: sets after the gap are not read"),
        (
            ["JOINTS_10", "WEIGHTS_10", "WEIGHTS_3", "JOINTS_3"],
            "it has JOINTS_3 and no JOINTS_1: sets after the gap are not read",
        ),
        (["WEIGHTS_1"], "it has WEIGHTS_1 and no JOINTS_1: sets after the gap are not read"),
        (["JOINTS_1", "WEIGHTS_1"], None),
        (["_JOINTS_2", "JOINTS_02", "JOINTS_x"], None),
    ],
)
@pytest.mark.parametrize("command", [("bake", "--dry-run"), ("inspect",), ("verify",)])
def test_influence_sets_after_a_gap_are_told(
    command: tuple[str, ...], sets: list[str], told: str | None, tmp_path: Path
) -> None:
    def add(content: JsonObject) -> None:
        attributes = content["meshes"][0]["primitives"][0]["attributes"]
        attributes.update({name: attributes[f"{name.strip('_').partition('_')[0]}_0"] for name in sets})

    path = edited("seam.glb", tmp_path, add)
    found = document(invoke(*command, path, "--json"))
    warnings = (found["files"][0] if "files" in found else found)["warnings"]
    messages = [one["message"] for one in warnings if one["code"] == "sets-after-gap"]
    assert messages == ([] if told is None else [told])


@pytest.mark.parametrize("target", ["page.html", "picture.png"])
def test_what_cannot_be_shown_is_told_in_one_sentence(target: str, tmp_path: Path) -> None:
    def lose(content: JsonObject) -> None:
        del content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]

    path = edited("seam.glb", tmp_path, lose)
    command = "view" if target.endswith(".html") else "render"
    result = invoke(command, path, "-o", tmp_path / target)
    assert result.exit_code == 3
    assert result.stderr.strip() == f"error: {path}: nothing in it can be shown: it has no POSITION"


@pytest.mark.slow
def test_json_on_stdin_is_told_from_a_file_of_json() -> None:
    data = b'{"asset": {"version": "2.0"}}'
    process = run("bake", "-", "-o", "-", stdin=data)
    assert process.returncode == 3
    assert process.stderr.decode().splitlines()[0] == (
        "error: <stdin>: this is JSON text, not a GLB: - takes a GLB only; give a .gltf file by its name"
    )


def test_git_itself_says_why_it_tracks_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    required_program("git")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    result = invoke("bake", SEAM, "--out-dir", tmp_path / "out", "--require-tracked")
    assert result.exit_code == exit_codes.OUTPUT
    assert "git cannot tell which files it tracks: fatal: not a git repository" in result.stderr
