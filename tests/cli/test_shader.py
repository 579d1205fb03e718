"""skinbake shader: what it takes from a baked file, what it refuses, where the text goes."""

from __future__ import annotations

import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Frame, Language, Lighting
from skinbake.shaders.choices import ALGORITHMS, ShaderChoices
from skinbake.version import __version__
from tests.support.baked_files import Editable
from tests.support.command_line import invoke, run
from tests.support.gltf_reading import read
from tests.support.models import (
    FOLDER,
    KEY,
    Part,
    edited,
    in_two_sets,
    rewritten,
    sheet,
    tangents_along,
    write_model,
)
from tests.support.whole_fields import shader_text

TUBE, SEAM, TWO_SETS, MIRRORED = (
    FOLDER / name for name in ("bent_tube.glb", "seam.glb", "two_sets.glb", "mirrored_tangent.glb")
)


def baked(path: Path, folder: Path, *options: str) -> Path:
    target = folder / f"baked-{path.name}"
    assert invoke("bake", path, "-o", target, "-q", *options).exit_code == 0
    return target


def header(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if line.startswith("//"))


def test_text_goes_to_stdout_and_everything_else_to_stderr() -> None:
    result = invoke("shader", "--lang", "glsl", "--frame", "tangent")
    assert result.exit_code == 0
    choices = ShaderChoices(Language.GLSL, frame=Frame.TANGENT)
    assert result.stdout == shader_text(choices)
    assert result.stderr == ""


def test_without_a_file_the_assumed_frame_is_a_warning() -> None:
    result = invoke("shader", "--lang", "wgsl")
    assert result.exit_code == 0
    assert "normal frame" in header(result.stdout)
    assert "warning: shader: the shader is made for --frame normal" in result.stderr


@pytest.mark.parametrize(("method", "lighting"), [("lbs", "accurate"), ("dqs", "exact")])
def test_each_method_has_its_best_lighting_by_default(method: str, lighting: str) -> None:
    text = invoke("shader", "--lang", "glsl", "--frame", "normal", "--method", method).stdout
    assert f"skinbake_{method}_{lighting}(" in text


def test_output_goes_to_a_file_and_says_what_it_is(tmp_path: Path) -> None:
    target = tmp_path / "skinbake.wgsl"
    result = invoke("shader", "--lang", "wgsl", "--frame", "normal", "-o", target)
    assert result.exit_code == 0
    assert result.stdout == ""
    assert result.stderr == f"{target}: plain WGSL, LBS accurate, 4 influences, normal frame\n"
    assert target.read_text(encoding="utf-8") == shader_text(ShaderChoices(Language.WGSL))


@pytest.mark.parametrize("target", ["three", "babylon", "godot", "playcanvas", "galacean"])
def test_a_module_for_all_files_is_not_called_one_for_a_frame(target: str, tmp_path: Path) -> None:
    file = tmp_path / "skinbake.txt"
    result = invoke("shader", "--target", target, "--frame", "tangent", "--cap", "0.5", "-o", file)
    assert result.stderr == (
        f"{file}: {target}, LBS accurate, cap 0.5; it reads frame, encoding and layout from each file\n"
    )


def test_a_target_that_cannot_be_written_is_exit_4(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"")
    target = file / "x.glsl"
    result = invoke("shader", "--lang", "glsl", "--frame", "normal", "-o", target)
    assert result.exit_code == 4
    assert str(target) in result.stderr
    assert list(tmp_path.iterdir()) == [file]


def test_an_existing_target_is_replaced_and_keeps_its_mode(tmp_path: Path) -> None:
    target = tmp_path / "x.glsl"
    target.write_text("old")
    target.chmod(0o640)
    assert invoke("shader", "--lang", "glsl", "--frame", "normal", "-o", target).exit_code == 0
    assert target.read_text().startswith("//")
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_the_baked_file_is_not_overwritten_with_its_shader(tmp_path: Path) -> None:
    file = baked(SEAM, tmp_path)
    before = file.read_bytes()
    result = invoke("shader", "--lang", "glsl", "--for", file, "-o", file)
    assert result.exit_code == 2
    assert "is the baked file itself" in result.stderr
    assert file.read_bytes() == before


@pytest.mark.parametrize("name", ["other.glb", "OTHER.GLTF", "new.vrm"])
@pytest.mark.parametrize("source", [[], ["--for"]])
def test_no_model_is_overwritten_with_a_shader(tmp_path: Path, name: str, source: list[str]) -> None:
    other = tmp_path / name
    if name != "new.vrm":
        other.write_text("{}")
    before = [(path, path.read_bytes()) for path in tmp_path.iterdir()]
    result = invoke("shader", "--lang", "glsl", *(x for s in source for x in (s, SEAM)), "-o", other)
    assert result.exit_code == 2
    assert f"{other} is the name of a model" in result.stderr
    assert [(path, path.read_bytes()) for path in tmp_path.iterdir()] == before


def test_no_model_is_overwritten_with_a_shader_by_a_link(tmp_path: Path) -> None:
    model, link = tmp_path / "hero.gltf", tmp_path / "skinbake.glsl"
    model.write_text("{}")
    link.symlink_to(model)
    result = invoke("shader", "--lang", "glsl", "-o", link)
    assert result.exit_code == 2
    assert f"{link} is the name of a model" in result.stderr
    assert model.read_text() == "{}"


@pytest.mark.parametrize(
    "content",
    [b"\x89PNG\r\n\x1a\n", bytes(64), "α".encode("utf-16")],
    ids=["picture", "zeros", "other encoding"],
)
def test_a_target_that_is_not_text_is_kept(tmp_path: Path, content: bytes) -> None:
    target = tmp_path / "hero"
    target.write_bytes(content)
    result = invoke("shader", "--lang", "glsl", "-o", target)
    assert result.exit_code == 2
    assert f"{target} exists and is not text" in result.stderr
    assert target.read_bytes() == content


@pytest.mark.parametrize("content", ["", "x" * 4095 + "α"], ids=["empty", "a letter at the border"])
def test_a_target_that_is_text_is_replaced(tmp_path: Path, content: str) -> None:
    target = tmp_path / "skinbake.glsl"
    target.write_text(content, encoding="utf-8")
    assert invoke("shader", "--lang", "glsl", "--frame", "normal", "-o", target).exit_code == 0
    assert target.read_text(encoding="utf-8").startswith("//")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--lang"),
        (["--lang", "msl"], "msl"),
        (["--lang", "glsl", "--lighting", "exact"], "--method lbs has no exact lighting"),
        (
            ["--lang", "glsl", "--method", "dqs", "--lighting", "direct"],
            "--method dqs has no direct lighting",
        ),
        (["--lang", "glsl", "--lighting", "direct", "--cap"], "--cap is for accurate and exact"),
        (["--lang", "glsl", "--method", "dqs", "--mirrored-joints"], "--mirrored-joints"),
        (["--lang", "glsl", "--scaled-joints"], "--scaled-joints needs --method dqs --lighting exact"),
        (["--lang", "glsl", "--cap", "0"], "'--cap': expected a number above 0, found 0"),
        (["--lang", "glsl", "--cap", "nan"], "expected a number above 0, found nan"),
        # WGSL compilers refuse a literal beyond float32. The square of 1e-30 is 0 in float32: no limit.
        (["--lang", "wgsl", "--cap", "1e39"], "--cap 1e+39 is not in the range 1e-06 to 1e+06 of a shader"),
        (["--lang", "glsl", "--cap", "1e-30"], "--cap 1e-30 is not in the range 1e-06 to 1e+06 of a shader"),
        (["--lang", "glsl", "--influences", "0"], "expected a whole number from 1 to 64, found 0"),
        (["--lang", "glsl", "-o", ""], "--output: the name is empty"),
        (
            ["--lang", "glsl", "--layout", "custom", "--influences", "9"],
            "--layout custom: it holds 8 influences",
        ),
        (["--lang", "glsl", "--for", "hero.fbx"], "hero.fbx"),
    ],
)
def test_wrong_usage_is_exit_2(arguments: list[str], message: str) -> None:
    result = invoke("shader", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stdout == ""


def test_the_command_in_the_header_writes_the_same_text_again() -> None:
    cases: list[ShaderChoices] = []
    for language in Language:
        for method, lighting in ALGORITHMS:
            cases.append(ShaderChoices(language, method, lighting, 5, Frame.TANGENT))
            if lighting in (Lighting.ACCURATE, Lighting.EXACT):
                cases.append(ShaderChoices(language, method, lighting, 3, Frame.NORMAL, cap=0.75))
        cases.append(ShaderChoices(language, mirrored_joints=True))
    for choices in cases:
        text = shader_text(choices)
        match = re.search(r"^//     (skinbake shader .*)$", text, re.MULTILINE)
        assert match is not None
        result = invoke(*match.group(1).split()[1:])
        assert result.exit_code == 0, result.stderr
        assert result.stdout == text


@pytest.mark.parametrize("cap", [1e-6, 1e6])
def test_the_limits_of_cap_are_in_its_range(cap: float) -> None:
    assert invoke("shader", "--lang", "glsl", "--frame", "normal", "--cap", str(cap)).exit_code == 0
    for further in (cap * 0.9, cap * 1.1):
        result = invoke("shader", "--lang", "glsl", "--frame", "normal", "--cap", str(further))
        assert (result.exit_code == 0) == (1e-6 < further < 1e6)


def test_cap_without_a_number_is_the_published_one() -> None:
    with_number = invoke("shader", "--lang", "glsl", "--frame", "normal", "--cap", "0.9").stdout
    assert invoke("shader", "--lang", "glsl", "--frame", "normal", "--cap").stdout == with_number


class TestForFile:
    @pytest.mark.parametrize(
        ("fixture", "frame", "influences"),
        [(TUBE, "normal", 4), (TWO_SETS, "normal", 8), (MIRRORED, "tangent", 4)],
    )
    def test_choices_are_those_of_the_metadata(
        self, fixture: Path, frame: str, influences: int, tmp_path: Path
    ) -> None:
        file = baked(fixture, tmp_path)
        note = read(file).content["meshes"][0]["primitives"][0]["extras"][KEY]
        assert (note["frame"], note["influences"]) == (frame, influences)
        text = invoke("shader", "--lang", "glsl", "--for", file).stdout
        assert f"{influences} influences a vertex, {frame} frame" in header(text)
        assert f"skinbake {__version__} for {file.name}:" in header(text)

    def test_the_command_in_the_header_names_the_file(self, tmp_path: Path, monkeypatch: Any) -> None:
        file = baked(TUBE, tmp_path, "--encoding", "packed8", "--alpha-name", "_A{set}")
        text = invoke("shader", "--lang", "glsl", "--for", file).stdout
        match = re.search(r"^//     (skinbake shader .*)$", text, re.MULTILINE)
        assert match is not None
        monkeypatch.chdir(tmp_path)
        assert invoke(*match.group(1).split()[1:]).stdout == text

    @pytest.mark.slow
    def test_stdin_is_a_file_too(self, tmp_path: Path) -> None:
        file = baked(TWO_SETS, tmp_path)
        process = run("shader", "--lang", "wgsl", "--for", "-", stdin=file.read_bytes())
        assert process.returncode == 0, process.stderr
        assert b"8 influences a vertex" in process.stdout

    def test_attributes_have_the_names_of_the_file(self, tmp_path: Path) -> None:
        file = baked(TWO_SETS, tmp_path, "--alpha-name", "_SLOPE_A{set}", "--beta-name", "_SLOPE_B{set}")
        text = header(invoke("shader", "--lang", "glsl", "--for", file).stdout)
        for name in ("_SLOPE_A0", "_SLOPE_A1", "_SLOPE_B0", "_SLOPE_B1"):
            assert re.search(rf"^//     {name} +vec", text, re.MULTILINE)
        assert "_SKINBAKE_" not in text

    def test_a_name_cannot_leave_its_comment(self, tmp_path: Path) -> None:
        file = baked(SEAM, tmp_path, "--alpha-name", "_A\n}{set}é", "--beta-name", "_B{set}")
        text = invoke("shader", "--lang", "glsl", "--for", file).stdout
        assert r"_A\n}0\xe9" in header(text)
        assert text.isascii()

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (
                ["--frame", "tangent"],
                "this file does not fit --frame tangent: it is baked in the normal frame",
            ),
            (["--influences", "5"], "this file does not fit --influences 5"),
        ],
    )
    def test_what_the_file_does_not_hold_is_refused(
        self, options: list[str], message: str, tmp_path: Path
    ) -> None:
        result = invoke("shader", "--lang", "glsl", "--for", baked(TUBE, tmp_path), *options)
        assert result.exit_code == 3
        assert message in result.stderr
        assert result.stdout == ""

    @pytest.mark.parametrize(
        ("parts", "message"),
        [
            ([sheet(), sheet(NORMAL=None)], "is baked: run skinbake bake first"),
            (
                [sheet(POSITION=None), sheet(NORMAL=None)],
                "is baked: run skinbake bake --generate-normals first",
            ),
            ([sheet(POSITION=None)] * 2, "can be baked: it has no POSITION"),
            ([sheet(JOINTS_0=None)], "can be baked: the meshes that are drawn with a skin have no JOINTS_0"),
        ],
    )
    def test_a_file_that_is_not_baked_is_refused_with_what_to_do(
        self, parts: list[Part], message: str, tmp_path: Path
    ) -> None:
        file = write_model(tmp_path / "plain.glb", parts)
        result = invoke("shader", "--lang", "glsl", "--for", file)
        assert result.exit_code == 3
        assert result.stderr == f"error: {file}: nothing in it {message}\n"

    @pytest.mark.parametrize("target", ["three", "bevy", "godot"])
    def test_an_engine_s_limit_is_the_file_s_fault_with_the_way_out(
        self, target: str, tmp_path: Path
    ) -> None:
        file = baked(TWO_SETS, tmp_path)
        result = invoke("shader", "--target", target, "--for", file)
        assert result.exit_code == 3
        assert f"{file}: this file does not fit --target {target}" in result.stderr
        assert "four influences per vertex, not 8; bake with --limit-influences 4" in result.stderr
        asked = invoke("shader", "--target", target, "--for", file, "--lighting", "standard")
        assert asked.exit_code == 2

    @pytest.mark.parametrize("target", ["three", "babylon", "godot", "playcanvas", "galacean"])
    def test_influences_that_vertices_use_are_not_left_out_by_a_module(
        self, target: str, tmp_path: Path
    ) -> None:
        file = baked(TWO_SETS, tmp_path)
        result = invoke("shader", "--target", target, "--for", file, "--influences", "4")
        assert result.exit_code == 3
        assert "more than 4 of its 8 influences" in result.stderr

    def test_a_module_names_the_primitives_that_need_more_influences(self, tmp_path: Path) -> None:
        file = baked(write_model(tmp_path / "mixed.glb", [sheet(), in_two_sets(sheet())]), tmp_path)
        result = invoke("shader", "--target", "three", "--for", file, "--influences", "4")
        assert result.exit_code == 0
        assert (
            "primitive 1: this module does not fit it: its vertices use more than 4 of its 8" in result.stderr
        )
        assert result.stderr.endswith("Bake it with --limit-influences 4\n")
        assert invoke("shader", "--target", "babylon", "--for", file).stderr == ""

    def test_a_module_serves_texture_coordinates_of_several_counts(self, tmp_path: Path) -> None:
        model = write_model(tmp_path / "mixed.glb", [sheet(), in_two_sets(sheet())])
        file = baked(model, tmp_path, "--layout", "texcoord")
        result = invoke("shader", "--target", "babylon", "--for", file, "--influences", "8")
        assert (result.exit_code, result.stderr) == (0, "")

    def test_a_module_leaves_an_empty_set_of_influences_out_on_request(self, tmp_path: Path) -> None:
        part = sheet()
        empty = {f"{name}_1": np.zeros_like(part.attributes[f"{name}_0"]) for name in ("JOINTS", "WEIGHTS")}
        file = baked(write_model(tmp_path / "empty.glb", [sheet(**empty)]), tmp_path)
        result = invoke("shader", "--target", "three", "--for", file, "--influences", "4")
        assert (result.exit_code, result.stderr) == (0, "")

    def test_damaged_metadata_is_refused(self, tmp_path: Path) -> None:
        file = baked(SEAM, tmp_path)
        model = read(file)
        del model.content["meshes"][0]["primitives"][0]["extras"][KEY]["frame"]
        result = invoke("shader", "--lang", "glsl", "--for", rewritten(model, file))
        assert result.exit_code == 3
        assert "metadata is damaged" in result.stderr

    def test_fewer_influences_serve_where_the_others_hold_nothing(self, tmp_path: Path) -> None:
        """The sheet has two joints: slots 2 and 3 hold neither weight nor gradient."""
        file = baked(write_model(tmp_path / "sheet.glb", [sheet()]), tmp_path)
        assert invoke("shader", "--lang", "glsl", "--for", file, "--influences", "2").exit_code == 0
        result = invoke("shader", "--lang", "glsl", "--for", file, "--influences", "1")
        assert result.exit_code == 3
        assert re.search(r"20 vertices use more than 1 of its 4", result.stderr)

    def test_primitives_that_differ_need_a_word(self, tmp_path: Path) -> None:
        parts = [sheet(), sheet(TANGENT=tangents_along(sheet()))]
        file = baked(write_model(tmp_path / "both.glb", parts), tmp_path)
        result = invoke("shader", "--lang", "glsl", "--for", file)
        assert result.exit_code == 3
        assert "differ in frame" in result.stderr
        assert result.stderr.endswith("Or write one for each kind with --frame\n")
        # The module for three.js reads the frame of each mesh when it runs.
        assert invoke("shader", "--target", "three", "--for", file).exit_code == 0
        assert invoke("shader", "--target", "babylon", "--for", file).exit_code == 0
        result = invoke("shader", "--lang", "glsl", "--for", file, "--frame", "tangent")
        assert result.exit_code == 0
        assert "primitive 0: this shader does not fit it: it is baked in the normal frame" in result.stderr

    def test_primitives_of_several_counts_get_a_text_each(self, tmp_path: Path) -> None:
        """The joints of one sheet are in two sets. The options in each notice write the other text."""
        file = baked(write_model(tmp_path / "mixed.glb", [sheet(), in_two_sets(sheet())]), tmp_path)
        result = invoke("shader", "--lang", "glsl", "--for", file)
        assert result.exit_code == 3
        assert result.stderr.endswith("Or write one for each kind with --influences\n")
        for count, other, primitive in (("4", "8", 1), ("8", "4", 0)):
            result = invoke("shader", "--lang", "glsl", "--for", file, "--influences", count)
            assert result.exit_code == 0
            assert f"{count} influences a vertex" in header(result.stdout)
            assert f"primitive {primitive}: this shader does not fit it" in result.stderr
            assert f"Write another shader with --frame normal --influences {other}\n" in result.stderr
        assert "use --influences 8" not in result.stderr

    def test_fewer_influences_serve_primitives_of_several_counts(self, tmp_path: Path) -> None:
        """The second set of a sheet is empty, so it has two names for alpha and needs one."""
        part = sheet()
        empty = {f"{name}_1": np.zeros_like(part.attributes[f"{name}_0"]) for name in ("JOINTS", "WEIGHTS")}
        model = write_model(tmp_path / "empty.glb", [sheet(), sheet(**empty)])
        shader = ("shader", "--lang", "glsl", "--influences", "4", "--for")
        result = invoke(*shader, baked(model, tmp_path))
        assert (result.exit_code, result.stderr) == (0, "")
        assert "_SKINBAKE_ALPHA_0" in header(result.stdout)
        # Texture coordinates of eight influences have alpha and beta in other places than those of four.
        result = invoke(*shader, baked(model, tmp_path, "--layout", "texcoord"))
        assert "skinbake_alpha_0(texcoord_0, texcoord_1)" in header(result.stdout)
        assert "primitive 1: this shader does not fit it" in result.stderr
        assert result.stderr.endswith("--influences 8\n")

    def test_the_notice_about_another_storage_names_its_option(self, tmp_path: Path) -> None:
        model = read(baked(write_model(tmp_path / "two.glb", [sheet(), sheet()]), tmp_path))
        other = model.content["meshes"][0]["primitives"][1]
        for kind, name in (("alpha", "_CUSTOM0"), ("beta", "_CUSTOM1")):
            other["attributes"][name] = other["attributes"].pop(f"_SKINBAKE_{kind.upper()}_0")
            other["extras"][KEY][kind] = [name]
        other["extras"][KEY]["layout"] = "custom"
        file = rewritten(model, tmp_path / "differing.glb")
        result = invoke("shader", "--lang", "glsl", "--for", file, "--layout", "attributes")
        assert result.exit_code == 0
        found = re.search(
            r"primitive 1: this shader .*layout custom\. Write another shader with (.*)", result.stderr
        )
        assert found is not None
        asked = invoke("shader", "--lang", "glsl", "--for", file, *found[1].split())
        assert asked.exit_code == 0
        assert "_CUSTOM0" in header(asked.stdout)

    def test_mirroring_joints_are_seen_to(self, tmp_path: Path) -> None:
        def mirror(content: Any) -> None:
            node = content["nodes"][content["skins"][0]["joints"][0]]
            node.pop("matrix", None)
            node["scale"] = [-1, 1, 1]

        file = baked(edited(SEAM.name, tmp_path, mirror), tmp_path)
        text = invoke("shader", "--lang", "glsl", "--for", file).stdout
        assert "mirrored joints" in header(text)
        assert "--mirrored-joints" in header(text)
        assert "determinant(T)" in text
        direct = invoke("shader", "--lang", "glsl", "--for", file, "--lighting", "direct")
        assert direct.exit_code == 0
        assert "mirrored" not in direct.stdout

    def test_dual_quaternions_take_joints_that_scale(self, tmp_path: Path) -> None:
        def stretch(content: Any) -> None:
            node = content["nodes"][content["skins"][0]["joints"][0]]
            node.pop("matrix", None)
            node["scale"] = [1, 1, 1.5]

        file = baked(edited(SEAM.name, tmp_path, stretch), tmp_path)
        text = invoke("shader", "--lang", "glsl", "--for", file, "--method", "dqs").stdout
        assert "--scaled-joints" in header(text)
        assert "skinbake_dqs_scaled(" in text
        assert "skinbake_dqs_exact" not in text
        for options in (["--lighting", "accurate"], ["--target", "three"]):
            result = invoke("shader", "--lang", "glsl", "--for", file, "--method", "dqs", *options)
            assert result.exit_code == 3
            assert "this file does not fit --method dqs" in result.stderr
        assert invoke("shader", "--lang", "glsl", "--for", file).exit_code == 0


def scaled(name: str, by: float) -> Callable[[Editable], None]:
    def edit(model: Editable) -> None:
        model.array(name)[::2] *= np.float32(by)

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (scaled("POSITION", 1.5), "POSITION changed since its bake"),
        (scaled("NORMAL", -1.0), "NORMAL changed since its bake"),
        (scaled("_SKINBAKE_ALPHA_0", 1.5), "α/β are wrong at"),
    ],
)
def test_a_stale_or_damaged_bake_is_refused(
    tmp_path: Path, edit: Callable[[Editable], None], words: str
) -> None:
    path = baked(TUBE, tmp_path)
    assert invoke("shader", "--lang", "glsl", "--for", path).exit_code == 0
    model = Editable(path)
    edit(model)
    result = invoke("shader", "--lang", "glsl", "--for", model.write(path))
    assert result.exit_code == 3
    assert result.stdout == ""
    assert "its bake is stale: " in result.stderr
    assert words in result.stderr
    assert "run skinbake bake" in result.stderr


def test_a_bake_in_another_order_is_served(tmp_path: Path) -> None:
    model = Editable(baked(TUBE, tmp_path))
    indices = model.array("indices")
    indices[:] = np.roll(indices, 3, axis=0)
    assert invoke("shader", "--lang", "glsl", "--for", model.write(tmp_path / "rolled.glb")).exit_code == 0


def test_a_bake_that_has_lost_its_normals_is_refused(tmp_path: Path) -> None:
    model = Editable(baked(TUBE, tmp_path))
    del model.primitive()["attributes"]["NORMAL"]
    result = invoke("shader", "--lang", "glsl", "--for", model.write(tmp_path / "without.glb"))
    assert result.exit_code == 3
    assert "it has lost what α/β are for (skipped: it has no NORMAL" in result.stderr


def test_very_small_sums_of_weights_are_told_in_a_few_digits(tmp_path: Path) -> None:
    model = Editable(TUBE)
    model.array("WEIGHTS_0")[:3] *= np.float32(2.0**-40)
    result = invoke("inspect", model.write(tmp_path / "small.glb"))
    assert "3 vertices do not sum to 1 (9.09e-13)" in result.stderr
    assert "the correction of the normals is 1.1e+12 times too strong there;" in result.stderr


def test_weights_of_another_sum_are_told_by_every_command(tmp_path: Path) -> None:
    model = Editable(TUBE)
    weights = model.array("WEIGHTS_0")
    weights[:3] *= np.float32(0.5)
    weights[3:5] *= np.float32(1.25)
    source, target = model.write(tmp_path / "odd.glb"), tmp_path / "baked.glb"
    said = [
        invoke("inspect", source),
        invoke("bake", source, "-o", target),
        invoke("verify", target, "--poses", "random:1"),
        invoke("shader", "--lang", "glsl", "--for", target),
    ]
    for result in said:
        assert result.exit_code == 0
        assert "the weights of 5 vertices do not sum to 1 (0.5 … 1.25)" in result.stderr
        assert (
            "the correction of the normals is up to 100 % too strong or up to 20 % too weak there;"
            in result.stderr
        )
    # GLTFLoader divides weights by their sum, and so does the module for Babylon.js.
    for engine in ("three", "babylon"):
        assert "sum to 1" not in invoke("shader", "--target", engine, "--for", target).stderr
