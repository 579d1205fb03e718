"""The Python API: what it returns is what the commands print, and its documentation runs."""

from __future__ import annotations

import doctest
import inspect
import json
import math
import os
import pathlib
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from enum import StrEnum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pygltflib
import pytest

import skinbake
from fixtures.make_fixtures import FOLDER
from skinbake import api
from skinbake.choices import PoseKind
from skinbake.cli import bake, verify
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import Chosen, Place
from skinbake.options import (
    BAKE,
    OPTIONS,
    POSES,
    TARGETS,
    THREADS,
    VERIFY,
    By,
    Option,
    Range,
    defaults,
    in_toml,
    on_command_line,
)
from tests.support import corpus
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import read

ROOT = Path(__file__).parents[1]
TUBE = FOLDER / "bent_tube.glb"


@pytest.fixture
def examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names that the examples of the documentation may use."""
    monkeypatch.chdir(ROOT)
    baked = tmp_path / "baked.glb"
    skinbake.bake(TUBE, baked)
    return {"skinbake": skinbake, "folder": tmp_path, "baked": baked, "pathlib": pathlib}


def test_the_examples_of_the_docstrings_run(examples: dict[str, Any]) -> None:
    found = doctest.testmod(api, extraglobs=examples, raise_on_error=False)
    assert (found.failed, found.attempted > 8) == (0, True)


@pytest.mark.slow
def test_the_examples_of_the_page_run(examples: dict[str, Any]) -> None:
    page = str(ROOT / "docs" / "python.md")
    found = doctest.testfile(page, module_relative=False, globs=examples, encoding="utf-8")
    assert (found.failed, found.attempted > 30) == (0, True)


def test_every_public_name_is_documented() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    for name in set(skinbake.__all__) - {"__version__"}:
        thing = getattr(skinbake, name)
        assert thing.__doc__, name
        assert name in page or name in (api.bake.__doc__ or ""), name
    for name in ("bake", "verify", "normals", "inspect", "strip", "weight_gradients"):
        text = getattr(skinbake, name).__doc__
        assert all(part in text for part in ("Parameters", "Returns", "Raises", "Examples")), name
    assert dir(skinbake) == sorted(skinbake.__all__)
    with pytest.raises(AttributeError, match="no attribute 'bkae'"):
        _ = skinbake.bkae


def test_an_import_brings_nothing_heavy() -> None:
    heavy = ("numpy", "click", "igl", "scipy", "pygltflib", "json")
    code = f"import sys, skinbake; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_results_are_the_entries_of_json(tmp_path: Path) -> None:
    baked, again = tmp_path / "baked.glb", str(tmp_path / "again.glb")
    entry = document(invoke("bake", TUBE, "-o", baked, "--encoding", "packed8", "--json"))["files"][0]
    result = skinbake.bake(TUBE, again, encoding="packed8")
    assert json.loads(json.dumps(result)) == {**entry, "output": again}
    assert baked.read_bytes() == Path(again).read_bytes()
    arguments = ("--poses", "random:3", "--method", "lbs", "--max-mean-error", "0.001")
    entry = document(invoke("verify", baked, *arguments, "--json"))["files"][0]
    verdict = skinbake.verify(baked, poses="random", samples=3, methods=["lbs"], max_mean_error=0.001)
    assert not verdict["passed"]
    assert json.loads(json.dumps(verdict)) == entry
    plural = skinbake.verify(baked, poses="animations", samples=2, methods=["lbs"])
    assert plural["poses"] == "2 poses of 1 clip (0.958 s)"
    assert json.loads(json.dumps(skinbake.inspect(baked))) == document(invoke("inspect", baked, "--json"))


@pytest.mark.parametrize(("truth", "passes"), [("tangents", True), ("triangles", False), (None, False)])
def test_limits_hold_by_the_truth_that_is_named(
    truth: api.TruthName | None, passes: bool, tmp_path: Path
) -> None:
    """The tube gains 38 times by tangents and 24 times by triangles; without a name the worse counts."""
    skinbake.bake(TUBE, tmp_path / "tube.glb", gradients="surface")
    verdict = skinbake.verify(tmp_path / "tube.glb", samples=4, methods=["lbs"], min_gain=30.0, truth=truth)
    assert verdict["passed"] is passes


def test_options_reach_the_bake(tmp_path: Path) -> None:
    """Each option of the command line is a keyword, and gives the same bytes."""
    flags: dict[str, Any] = {
        "gradients": "surface",
        "weighting": "angle",
        "crease_angle": 60.0,
        "neighbours": "drop",
        "frame": "normal",
        "alpha_name": "_A{set}",
        "beta_name": "_B{set}",
        "limit_influences": 4,
    }
    words = [word for name, value in flags.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    source = FOLDER / "two_sets.glb"
    assert invoke("bake", source, "-o", tmp_path / "a.glb", *words).exit_code == 0
    skinbake.bake(source, tmp_path / "b.glb", **flags)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weighting": "maximal"}, "weighting='maximal': expected one of max, angle, area, angle-area"),
        ({"crease_angle": 181.0}, "crease_angle=181.0: expected a number from 0 to 180"),
        ({"crease_angle": float("nan")}, "crease_angle=nan: expected a number from 0 to 180"),
        ({"limit_influences": 6}, "limit_influences=6: expected a multiple of 4"),
        ({"limit_influences": 0}, "limit_influences=0: expected a whole number of at least 4"),
        ({"limit_influences": 4.0}, "limit_influences=4.0: expected a whole number of at least 4"),
        ({"alpha_name": "ALPHA_{set}"}, "alpha_name='ALPHA_{set}': expected a name that begins with"),
        ({"layout": "custom", "beta_name": "_B{set}"}, "beta_name needs layout='attributes'"),
        (
            {"layout": "texcoord", "encoding": "packed8"},
            "layout='texcoord' needs encoding='float32', not packed8: only",
        ),
        ({"position_bits": 12}, "position_bits needs compress='draco'"),
        ({"compress": "draco", "normal_bits": 1}, "normal_bits=1: expected a whole number from 2 to 24"),
        (
            {"compress": "meshopt", "compress_level": 4},
            "compress_level=4: expected at most 3 with compress='meshopt'",
        ),
    ],
)
def test_options_that_make_no_sense_are_refused(
    options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(skinbake.ChoiceError) as caught:
        skinbake.bake(TUBE, tmp_path / "out.glb", **options)
    assert message in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_gain": math.nan}, "min_gain=nan: expected a number of at least 0"),
        ({"min_gain": -1}, "min_gain=-1: expected a number of at least 0"),
        ({"max_mean_error": math.inf}, "max_mean_error=inf: expected a number of at least 0"),
        ({"max_p95_error": "1"}, "max_p95_error='1': expected a number of at least 0"),
        ({"cap": 0}, "cap=0: expected a number above 0"),
        ({"cap": math.nan}, "cap=nan: expected a number above 0"),
        ({"samples": 0}, "samples=0: expected a whole number of at least 1"),
        ({"samples": 2.5}, "samples=2.5: expected a whole number of at least 1"),
        ({"seed": -1}, "seed=-1: expected a whole number of at least 0"),
        ({"angle": math.nan}, "angle=nan: expected a number from 0 to 180"),
        ({"angle": 181}, "angle=181: expected a number from 0 to 180"),
        ({"poses": "dance"}, "poses='dance': expected animation, random, random:N with N of at least 1, or"),
        ({"poses": "random:0"}, "poses='random:0': expected animation"),
        ({"poses": "rest:3"}, "poses='rest:3': expected animation"),
        ({"truth": "mine"}, "truth='mine': expected one of triangles, tangents"),
    ],
)
def test_verify_refuses_values_that_do_not_exist(options: dict[str, Any], message: str) -> None:
    """NaN as a limit would pass, because no comparison with it is true."""
    with pytest.raises(skinbake.ChoiceError) as caught:
        skinbake.verify(TUBE, **options)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "options",
    [
        {"poses": "random:3"},
        {"samples": np.int64(4)},
        {"cap": np.float32(0.9)},
        {"seed": 10**400},
        {"angle": 180, "threads": 1},
    ],
    ids=str,
)
def test_verify_takes_numbers_of_any_type_up_to_their_limits(options: dict[str, Any], tmp_path: Path) -> None:
    skinbake.bake(TUBE, tmp_path / "out.glb")
    assert skinbake.verify(tmp_path / "out.glb", methods=["lbs"], **options)["passed"]


@pytest.mark.parametrize("angle", [math.nan, -5.0, 1e9])
def test_arrays_have_the_same_crease_angles_as_files(angle: float) -> None:
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    weights = [[1, 0], [0, 1], [0, 1], [1, 0]]
    with pytest.raises(skinbake.ChoiceError, match="expected a number from 0 to 180"):
        skinbake.weight_gradients(
            square, [[0, 0, 1]] * 4, [[0, 1, 2]], [[0, 1]] * 4, weights, crease_angle=angle
        )


def kinds(hint: Any) -> set[Any]:
    """Return the types that a type joins, words of a Literal as they are, and those of a list as a set."""
    if get_origin(hint) in {Union, UnionType}:
        return set().union(*map(kinds, get_args(hint)))
    if get_origin(hint) is Literal:
        return set(get_args(hint))
    return {frozenset(kinds(get_args(hint)[0]))} if get_origin(hint) is Sequence else {hint}


def declared_kinds(option: Option) -> set[Any]:
    """Return the types that the keyword of an option should have."""
    values, found = option.values, set[Any]()
    if isinstance(values, Range):
        found = {int if values.is_whole else float}
    elif isinstance(values, type) and issubclass(values, StrEnum):
        found = {values, *map(str, values)}
    elif values in (POSES, THREADS, TARGETS):
        found = {str, PoseKind} if values is POSES else {int, "auto"}
    elif option.is_path:
        found = {str, os.PathLike[str]}
    else:
        found = {values}
    return ({frozenset(found)} if option.is_many else found) | (
        {NoneType} if option.default is None else set()
    )


@pytest.mark.parametrize("name", ["bake", "verify", "inspect", "strip"])
def test_the_keywords_of_python_are_the_declared_options(name: str) -> None:
    """Signatures are the one other place that has names, types and defaults."""
    function = getattr(skinbake, name)
    hints = get_type_hints(function, localns={"GLTF2": object})
    hints |= get_type_hints(api.BakeOptions) if name == "bake" else {}
    declared = {one.keyword: one for one in OPTIONS[name] if By.PYTHON in one.by}
    assert hints.keys() - {"source", "target", "options", "return"} == declared.keys()
    for keyword, option in declared.items():
        assert kinds(hints[keyword]) == declared_kinds(option), keyword
        parameter = inspect.signature(function).parameters.get(keyword)
        if parameter is not None:
            is_opposite = keyword != option.name
            assert parameter.default == (not option.default if is_opposite else option.default), keyword


def test_the_options_of_files_have_one_default() -> None:
    """The class of a bake's options, and click, take theirs from the declarations."""
    of_class = {entry.name: entry.default for entry in fields(BakeOptions)}
    assert of_class.pop("character") is None  # made of all files of a command line
    assert of_class == defaults(BAKE, By.OVERRIDE)
    for command, options in ((bake.command, BAKE), (verify.command, VERIFY)):
        wanted = defaults(options, By.OVERRIDE)
        given = command.make_context("skinbake", ["a.glb"], resilient_parsing=True).params
        assert {name: given[name] for name in wanted} == wanted


def test_a_type_checker_and_python_refuse_a_word_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(skinbake.ChoiceError) as caught:
        skinbake.bake(TUBE, tmp_path / "out.glb", encoding="snorm17")  # type: ignore[call-overload]  # on purpose
    error = caught.value
    assert (error.option, error.value) == ("encoding", "snorm17")
    assert error.expected == "one of float32, snorm16, packed8; did you mean 'snorm16'?"


def test_an_error_about_options_comes_whole_from_another_process() -> None:
    place = Place("a.glb")
    needed = Chosen("encoding", "float32")
    for error in (
        skinbake.ChoiceError("crease_angle", 181.0, "a number from 0 to 180"),
        skinbake.ChoiceError("layout", "texcoord", reason=(" needs ", needed), place=place),
    ):
        sent = pickle.loads(pickle.dumps(error))
        assert (str(sent), vars(sent)) == (str(error), vars(error))
        assert sent.worded(on_command_line) == error.worded(on_command_line)
    assert str(sent) == "a.glb: layout='texcoord' needs encoding='float32'"
    assert sent.worded(on_command_line) == "--layout texcoord needs --encoding float32"
    assert sent.worded(in_toml) == 'layout = "texcoord" needs encoding = "float32"'


def test_an_unknown_keyword_is_a_type_error(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"'neighbors'; did you mean 'neighbours'\?"):
        skinbake.bake(TUBE, tmp_path / "out.glb", **{"neighbors": "drop"})  # type: ignore[call-overload]  # on purpose
    with pytest.raises(TypeError, match="wieghting"):
        skinbake.bake(TUBE, tmp_path / "out.glb", **{"wieghting": "max"})  # type: ignore[call-overload]  # on purpose
    with pytest.raises(TypeError, match="needs a target"):
        skinbake.bake(TUBE)


def test_a_text_instead_of_a_list_is_refused(tmp_path: Path) -> None:
    """Its letters would be names: the first of /textures allows every folder."""
    with pytest.raises(skinbake.ChoiceError, match="allow_outside='/textures': expected a list of names"):
        skinbake.bake(TUBE, tmp_path / "out.glb", allow_outside="/textures")
    with pytest.raises(skinbake.ChoiceError, match="allow_outside='/textures'"):
        skinbake.inspect(TUBE, allow_outside="/textures")
    with pytest.raises(skinbake.ChoiceError, match="fit_poses='animations': expected a list of names"):
        skinbake.bake(TUBE, tmp_path / "out.glb", gradients="fitted", fit_poses="animations")
    with pytest.raises(skinbake.ChoiceError, match="methods='lbs': expected a list of names"):
        skinbake.verify(TUBE, methods="lbs")  # type: ignore[arg-type]  # on purpose
    assert not list(tmp_path.iterdir())


ODD: list[Any] = [object(), [], {}, [3], 3, 1.5, b"x", math.nan, np.zeros((2, 2))]
SQUARE_ARRAYS: list[Any] = [
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    [[0, 0, 1]] * 4,
    [[0, 1, 2]],
    [[0, 1]] * 4,
    [[1, 0], [0, 1], [0, 1], [1, 0]],
]
CALLS: dict[str, tuple[Callable[..., Any], list[Any]]] = {
    "bake": (skinbake.bake, [TUBE, "out.glb"]),
    "verify": (skinbake.verify, [TUBE]),
    "inspect": (skinbake.inspect, [TUBE]),
    "strip": (skinbake.strip, [TUBE, "out.glb"]),
    "weight_gradients": (skinbake.weight_gradients, SQUARE_ARRAYS),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_a_value_of_another_type_is_refused_by_the_name_of_its_option(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each option of each function, with values of many types: it takes one, or says what it takes."""
    monkeypatch.chdir(tmp_path)
    function, given = CALLS[name]
    options = {
        one.name for one in inspect.signature(function).parameters.values() if one.kind is one.KEYWORD_ONLY
    }
    options |= set(api.BakeOptions.__annotations__) if name == "bake" else set()
    for option in options - {"tangents"}:
        for value in (*ODD, None):
            try:
                function(*given, **{option: value})
            except skinbake.ChoiceError as error:
                assert option in error.options and option in str(error)
                assert "expected" in str(error) or " needs" in str(error) or "contradicts" in str(error)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("bake", {"alpha_name": 3}, "alpha_name=3: expected a text"),
        ("bake", {"crease_angle": None}, "crease_angle=None: expected a number from 0 to 180"),
        ("bake", {"dry_run": "no"}, "dry_run='no': expected True or False"),
        ("bake", {"allow_outside": None}, "allow_outside=None: expected a list of names"),
        ("verify", {"angle": None}, "angle=None: expected a number from 0 to 180"),
        (
            "verify",
            {"poses": 3},
            "poses=3: expected animation, random, random:N with N of at least 1, or rest",
        ),
        ("verify", {"methods": None}, "methods=None: expected a list of names"),
        ("strip", {"sync": 1}, "sync=1: expected True or False"),
        ("weight_gradients", {"crease_angle": None}, "crease_angle=None: expected a number from 0 to 180"),
    ],
)
def test_a_value_of_another_type_is_told_what_fits(name: str, options: dict[str, Any], message: str) -> None:
    function, given = CALLS[name]
    with pytest.raises(skinbake.ChoiceError) as caught:
        function(*given, **options)
    assert str(caught.value) == message


@pytest.mark.parametrize("name", ["notes.txt", "hero", "s3://bucket/hero.glb", "-"])
def test_targets_are_named_like_models_of_this_machine(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(skinbake.OutputError, match=r"expected a name that ends in|only the command line"):
        skinbake.bake(TUBE, name)
    with pytest.raises(skinbake.OutputError, match=r"expected a name that ends in|only the command line"):
        skinbake.strip(TUBE, name)
    assert not list(tmp_path.iterdir())


def test_a_source_is_a_file_of_this_machine() -> None:
    with pytest.raises(skinbake.InputError, match="only the command line reads URLs"):
        skinbake.inspect("s3://bucket/hero.glb")


def test_a_failure_writes_nothing_and_has_its_notices(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(skinbake.OutputError) as caught:
        skinbake.bake(FOLDER / "morphed_sheet.glb", tmp_path / "file" / "out.glb")
    assert caught.value.place is not None
    with pytest.raises(skinbake.InputError):
        skinbake.verify(tmp_path / "missing.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


class TestModels:
    """Models of pygltflib's."""

    @pytest.mark.parametrize(
        "name",
        [
            "bent_tube.glb",
            "seam.glb",
            pytest.param("two_sets.glb", marks=pytest.mark.slow),
            "mirrored_tangent.glb",
        ],
    )
    def test_a_model_is_baked_as_its_file_is(self, name: str, tmp_path: Path) -> None:
        model = pygltflib.GLTF2().load(FOLDER / name)
        before, blob = model.to_json(), model.binary_blob()
        skinbake.bake(model).save(tmp_path / "model.glb")
        assert (model.to_json(), model.binary_blob()) == (before, blob)
        skinbake.bake(FOLDER / name, tmp_path / "file.glb")
        ours, theirs = read(tmp_path / "model.glb"), read(tmp_path / "file.glb")
        attributes = theirs.primitive(0, 0)["attributes"]
        assert set(ours.primitive(0, 0)["attributes"]) == set(attributes)
        for attribute in attributes:
            found, wanted = (one.stored_attribute(attribute) for one in (ours, theirs))
            assert found.tobytes() == wanted.tobytes(), attribute
        assert skinbake.verify(tmp_path / "model.glb", samples=2)["passed"]

    def test_a_second_bake_changes_nothing(self) -> None:
        once = skinbake.bake(pygltflib.GLTF2().load(TUBE))
        twice = skinbake.bake(once)
        assert json.loads(twice.to_json()) == json.loads(once.to_json())
        assert twice.binary_blob() == once.binary_blob()

    @pytest.mark.slow
    @corpus.needed
    def test_files_beside_a_model_are_found_in_its_folder(self, tmp_path: Path) -> None:
        model = pygltflib.GLTF2().load(corpus.model("pbrTest/pbrTest.gltf"))
        baked = skinbake.bake(model)
        assert baked.buffers[0].uri is None
        assert [image.uri for image in baked.images] == [image.uri for image in model.images]
        baked.images, baked.textures, baked.materials = [], [], []
        for primitive in (primitive for mesh in baked.meshes for primitive in mesh.primitives):
            primitive.material = None
        baked.save(tmp_path / "model.glb")
        assert skinbake.verify(tmp_path / "model.glb", samples=1)["passed"]

    def test_a_model_without_a_skin_comes_back_as_it_was(self) -> None:
        model = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0"))
        assert skinbake.bake(model).to_json() == model.to_json()
        with pytest.raises(skinbake.InputError, match="nothing in it is skinned"):
            skinbake.bake(model, require_baked=True)
        with pytest.raises(skinbake.InputError, match="passed through unchanged: nothing in it is skinned"):
            skinbake.bake(model, warnings_as_errors=True)

    def test_a_model_is_written_nowhere(self, tmp_path: Path) -> None:
        model = pygltflib.GLTF2().load(TUBE)
        with pytest.raises(TypeError, match="returns the new GLTF2"):
            skinbake.bake(model, tmp_path / "out.glb")
        for option in ({"dry_run": True}, {"pack": True}, {"allow_outside": [tmp_path]}):
            with pytest.raises(TypeError, match="takes no target, dry_run, pack or allow_outside"):
                skinbake.bake(model, **option)
        assert not list(tmp_path.iterdir())

    def test_what_is_no_model_is_refused(self) -> None:
        with pytest.raises(TypeError, match="takes a path or a GLTF2 of pygltflib, not dict"):
            skinbake.bake({})


SQUARE: dict[str, Any] = {
    "positions": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    "normals": [[0, 0, 1]] * 4,
    "triangles": [[0, 1, 2], [0, 2, 3]],
    "joints": [[0, 1]] * 4,
    "weights": [[1, 0], [0, 1], [0, 1], [1, 0]],
}


class Failing:
    """An array of another library whose device is gone."""

    def __array__(self, *arguments: Any, **options: Any) -> Any:
        raise RuntimeError("the device is gone")


class TestArrays:
    """``weight_gradients``."""

    def test_a_linear_weight_has_its_own_slope(self) -> None:
        """On a plane the gradient of w = a x + b y is (a, b) at every vertex, whatever the triangles."""
        random = np.random.default_rng(5)
        points = np.column_stack([random.uniform(0, 1, (40, 2)), np.zeros(40)])
        triangles = np.array([[a, a + 1, a + 2] for a in range(38)])
        corners = points[triangles]
        turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0
        triangles[turned] = triangles[turned][:, ::-1]
        share = 0.2 + 0.3 * points[:, 0] + 0.4 * points[:, 1]
        found = skinbake.weight_gradients(
            points,
            np.tile([0.0, 0.0, 2.0], (40, 1)),
            triangles,
            np.tile([3, 9], (40, 1)),
            np.column_stack([1 - share, share]),
        )
        alpha, beta = found
        gradient = alpha * found.tangents + beta * found.bitangents
        assert np.abs(gradient - [0.3, 0.4, 0.0]).max() < 1e-5

    @pytest.mark.parametrize("length", [1e-300, 1e-200, 1e200, 1e300])
    def test_normals_have_any_length(self, length: float) -> None:
        """The weight of joint 1 is x along a plane through the y axis, on which x grows by 0.8 a unit."""
        points = np.array([[0, 0, 0], [0.8, 0, -0.6], [0.8, 1, -0.6], [0, 1, 0]])
        found = skinbake.weight_gradients(
            points,
            np.tile([0.6 * length, 0.0, 0.8 * length], (4, 1)),
            [[0, 1, 2], [0, 2, 3]],
            [[0, 1]] * 4,
            np.column_stack([1 - points[:, 0], points[:, 0]]),
        )
        gradient = found.alpha * found.tangents + found.beta * found.bitangents
        assert np.abs(gradient - [0.64, 0.0, -0.48]).max() < 1e-6

    @pytest.mark.parametrize("neighbours", ["drop", "adopt"])
    @pytest.mark.parametrize("name", ["seam.glb", "foreign_joints.glb", "mirrored_tangent.glb"])
    def test_arrays_give_what_a_file_gives(
        self, name: str, neighbours: api.NeighboursName, tmp_path: Path
    ) -> None:
        skinbake.bake(FOLDER / name, tmp_path / "out.glb", neighbours=neighbours, gradients="surface")
        before, after = read(FOLDER / name), read(tmp_path / "out.glb")
        attributes = before.primitive(0, 0)["attributes"]
        found = skinbake.weight_gradients(
            before.attribute("POSITION").astype(np.float32),
            before.attribute("NORMAL").astype(np.float32),
            before.triangles(),
            before.stored_attribute("JOINTS_0"),
            before.attribute("WEIGHTS_0").astype(np.float32),
            tangents=before.attribute("TANGENT").astype(np.float32) if "TANGENT" in attributes else None,
            neighbours=neighbours,
        )
        assert found.alpha.tobytes() == after.stored_attribute("_SKINBAKE_ALPHA_0").tobytes()
        assert found.beta.tobytes() == after.stored_attribute("_SKINBAKE_BETA_0").tobytes()
        assert np.array_equal(found.joints, after.attribute("JOINTS_0"))

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"positions": [[0, 0]] * 4}, r"positions have shape \(4, 2\): expected \(any, 3\)"),
            ({"positions": np.zeros((0, 3))}, "positions have shape"),
            ({"normals": [[0, 0, 1]] * 3}, r"normals have shape \(3, 3\): expected \(4, 3\)"),
            ({"triangles": [[0, 1, 4]]}, "triangles hold 0 to 4: expected 0 to 3"),
            ({"triangles": [[0.0, 1.0, 2.0]]}, "triangles are float64: expected integers"),
            ({"joints": [[0, -1]] * 4}, "joints hold -1 to 0"),
            ({"weights": [[1]] * 4}, "expected 2 to 256 slots for a vertex"),
            ({"weights": np.ones((4, 257))}, "expected 2 to 256 slots for a vertex"),
            ({"weights": np.ones((4, 100_000))}, "expected 2 to 256 slots for a vertex"),
            ({"positions": np.ones((4, 3), complex)}, "positions are complex128: expected numbers"),
            ({"positions": np.zeros((4, 3), "M8[s]")}, "positions are datetime64.s.: expected numbers"),
            ({"positions": [["0", "0", "0"]] * 4}, "positions are <U1: expected numbers"),
            ({"positions": [[None] * 3] * 4}, "positions are object: expected numbers"),
            ({"positions": [[0, 0, 0], [1]]}, "positions are not an array"),
            ({"positions": range(2**40)}, "positions are a range"),
            ({"weights": Failing()}, "weights are not an array: the device is gone"),
            ({"positions": np.broadcast_to(np.zeros(3), (2**40, 3))}, "repeat few numbers in memory"),
            ({"triangles": np.broadcast_to([0, 1, 2], (2**34, 3))}, "repeat few numbers in memory"),
            ({"weights": [[np.nan, 1]] * 4}, "weights hold numbers that are not finite"),
            ({"tangents": [[1, 0, 0]] * 4}, r"tangents have shape \(4, 3\): expected \(4, 4\)"),
            ({"frame": "tangent"}, "there are no tangents"),
        ],
    )
    def test_arrays_that_do_not_fit_are_refused(self, change: dict[str, Any], message: str) -> None:
        assert skinbake.weight_gradients(**SQUARE).alpha.shape == (4, 1)
        with pytest.raises(ValueError, match=message):
            skinbake.weight_gradients(**{**SQUARE, **change})

    def test_gradients_beyond_float32_are_refused(self) -> None:
        tiny = 1e-39 * np.array(SQUARE["positions"], dtype=np.float64)
        with pytest.raises(skinbake.InputError, match="α or β of 4 vertices are not finite numbers"):
            skinbake.weight_gradients(**{**SQUARE, "positions": tiny})


class Gone:
    """An object of which nothing can be read."""

    def __getattr__(self, name: str) -> Any:
        raise RuntimeError("the object is gone")


def deep(levels: int) -> dict[str, Any]:
    """Return objects in objects."""
    found: dict[str, Any] = {}
    for _ in range(levels):
        found = {"a": found}
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda model: setattr(model, "extras", deep(100_000)), "cannot be written as JSON"),
        (lambda model: model.extras.update(a=model.extras), "cannot be written as JSON"),
        (lambda model: model.extras.update(a=object()), "cannot be written as JSON"),
        (lambda model: model.extras.update(a=float("nan")), "cannot be written as JSON"),
        (lambda model: setattr(model.accessors[0], "count", 10**5000), "cannot be written as JSON"),
        (lambda model: setattr(model.accessors[0], "count", 2**60), '"count" must be'),
        (lambda model: setattr(model, "nodes", [1]), '"nodes" must be an array of objects'),
        (lambda model: model.set_binary_blob("text"), "its binary blob is of type str"),
        (lambda model: model.set_binary_blob(10**12), "its binary blob is of type int"),
        (lambda model: model.set_binary_blob([1, 300]), "its binary blob is of type list"),
        (lambda model: model.__dict__.update(_path=object()), "expected the folder of its files"),
        (lambda model: model.__dict__.update(_path="\0"), "expected the folder of its files"),
        (lambda model: model.__dict__.update(_path="\ud800"), "expected the folder of its files"),
        (lambda model: model.__dict__.update(_path=np.zeros(3)), "expected the folder of its files"),
        (lambda model: model.__dict__.update(_name=np.zeros(3), nodes=[1]), "GLTF2: .*array of objects"),
        (lambda model: setattr(model, "nodes", Gone()), "cannot be written as JSON .the object is gone"),
        (lambda model: setattr(model, "extensions", 5), "holds what pygltflib does not read"),
        (lambda model: setattr(model.meshes[0].primitives[0], "material", "x"), "pygltflib does not read"),
        (lambda model: setattr(model.buffers[0], "extras", [1]), "holds what pygltflib does not read"),
    ],
)
def test_a_hostile_model_of_pygltflib_ends_in_an_error_of_ours(change: Any, message: str) -> None:
    model = pygltflib.GLTF2().load(str(FOLDER / "bent_tube.glb"))
    assert model is not None
    model.extras = {}
    change(model)
    with pytest.raises(skinbake.InputError, match=message):
        skinbake.bake(model)


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
@pytest.mark.parametrize("spelling", ["{0}/./model.glb", "{0}/up/../model.glb", "{0}/link.glb"])
def test_a_source_named_by_another_path_is_replaced_as_itself(tmp_path: Path, spelling: str) -> None:
    """A replaced file has notices of its own, and one without a bake is not written at all."""
    model, target = tmp_path / "model.glb", spelling.format(tmp_path)
    model.write_bytes(TUBE.read_bytes())
    (tmp_path / "up").mkdir()
    (tmp_path / "link.glb").symlink_to(model)
    os.link(model, tmp_path / "other.glb")
    plain = model.stat()
    skinbake.strip(model, target)
    assert model.stat().st_ino == plain.st_ino
    result = skinbake.bake(model, target)
    assert [notice["code"] for notice in result["warnings"]] == ["hard-links"]
    assert (tmp_path / "other.glb").read_bytes() == TUBE.read_bytes() != model.read_bytes()
    assert (tmp_path / "link.glb").is_symlink()


def test_another_name_of_the_source_by_a_hard_link_is_another_file(tmp_path: Path) -> None:
    model, other = tmp_path / "model.glb", tmp_path / "other.glb"
    model.write_bytes(TUBE.read_bytes())
    os.link(model, other)
    skinbake.bake(model, other)
    assert model.read_bytes() == TUBE.read_bytes() != other.read_bytes()
