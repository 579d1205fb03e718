from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import jsonschema
import pytest

from skinbake.choices import Truth
from skinbake.cli.terminal import with_colours
from skinbake.errors import Chosen, InputError, Message, Notice, Place
from skinbake.report.totals import run_json
from skinbake.report.verify import (
    SCHEMA,
    Check,
    ErrorFigures,
    Figures,
    FileVerdict,
    MorphCount,
    Normals,
    OtherBake,
    Worst,
    as_brief,
    as_junit,
    as_line,
    as_text,
    by_worse_truth,
    conclusion,
    file_json,
    gain,
)
from tests.support.schemas import VERIFY

GREEN, RED = "\x1b[32m", "\x1b[31m"
PLACE = Place("hero.glb", 2, "Body", 1)

"""The JSON document, with no member that is not listed; docs/reference/json.md says it in words."""


def figure(mean: float) -> ErrorFigures:
    return ErrorFigures(mean, 2 * mean, 3 * mean, 4 * mean, Worst(PLACE, 7, "run", 0.25))


def lit(standard: float = 4.0, accurate: float = 1.0) -> Normals:
    return {
        "lbs": {"standard": figure(standard), "direct": figure(accurate), "accurate": figure(accurate)},
        "dqs": {
            "standard": figure(standard),
            "accurate": figure(accurate),
            "exact": figure(accurate / 2),
        },
    }


def without_direct(normals: Normals) -> Normals:
    return {
        method: {lighting: one for lighting, one in figures.items() if lighting != "direct"}
        for method, figures in normals.items()
    }


def by_truths(triangles: Normals, tangents: Normals | None = None) -> dict[Truth, Figures]:
    """Return figures of a file that is one primitive; by tangents none if they are not given."""
    return {
        truth: Figures(one, ((PLACE, one),))
        for truth, one in ((Truth.TRIANGLES, triangles), (Truth.TANGENTS, tangents or {}))
    }


PASSED = FileVerdict(
    "hero.glb",
    (Check("structure", "passed", (), "1 baked primitive, 9 vertices"), Check("freshness", "passed")),
    by_truths(lit(5.0, 2.0), without_direct(lit())),
    "60 poses of 3 clips (12 s)",
)
STALE = Notice("stale", "POSITION changed since its bake. Bake last", PLACE, 5)
FAILED = FileVerdict(
    "old.glb",
    (
        Check("structure", "passed"),
        Check("freshness", "failed", (STALE, replace(STALE, place=Place("old.glb", 0)))),
        Check("lighting", "skipped", (), "structure failed"),
    ),
    notices=(Notice("joints-mirror", "3 joints mirror", PLACE, 3),),
)
UNREADABLE = FileVerdict("no.glb", error=InputError("cannot be read", Place("no.glb")))


@pytest.mark.slow
def test_json_is_as_the_schema_has_it() -> None:
    document = run_json(SCHEMA, map(file_json, [PASSED, FAILED, UNREADABLE]), exit_code=3, process=None)
    jsonschema.validate(document, VERIFY)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert [entry["passed"] for entry in document["files"]] == [True, False, False]
    assert document["files"][0]["normals_by_tangents"]["lbs"]["standard"]["p99"] == 12.0
    assert document["files"][0]["primitives"][0]["normals_by_tangents"]["dqs"]["exact"]["mean"] == 0.5
    for entry in (document["files"][0], document["files"][0]["primitives"][0]):
        assert entry["normals_by_triangles"]["lbs"]["accurate"]["p95"] == 4.0
        assert (
            entry["normals_by_tangents"]["lbs"]["gain"],
            entry["normals_by_triangles"]["lbs"]["gain"],
        ) == (4.0, 2.5)
    assert [len(check["problems"]) for check in document["files"][1]["checks"]] == [0, 2, 0]
    problem = document["files"][1]["checks"][1]["problems"][0]
    assert (problem["code"], problem["mesh"], problem["primitive"], problem["count"]) == ("stale", 2, 1, 5)
    assert document["files"][2]["error"] == {"kind": "InputError", "message": "cannot be read"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "shown", "colour"),
    [
        (2.2, "2.20x", GREEN),
        (1.0, "1.00x", GREEN),
        (1.004, "1.00x", GREEN),
        (0.996, "0.996x", RED),
        (0.99996, "0.9999x", RED),
        (0.994, "0.99x", RED),
    ],
)
def test_a_loss_never_reads_as_a_gain_of_one(factor: float, shown: str, colour: str) -> None:
    figures = {"lbs": lit(factor)["lbs"]}
    text = with_colours(as_text(replace(PASSED, figures=by_truths(figures))))
    assert f"{colour}{shown}\x1b[0m by triangles" in text
    assert f"Little to win: {shown[:-1]} times nearer" in text or factor > 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "member",
    [
        "normals_by_triangles",
        "normals_by_tangents",
        "checks",
        "primitives",
        "scaled_joints",
        "input",
        "error",
    ],
)
def test_the_schema_notices_a_missing_member(member: str) -> None:
    document = run_json(SCHEMA, map(file_json, [PASSED]), exit_code=0, process=None)
    del document["files"][0][member]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, VERIFY)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "words"),
    [
        (MorphCount(8, 3), "3 of 8 morph targets move"),
        (MorphCount(1, 1), "its morph target moves"),
        (MorphCount(1, 0), "its morph target does not move"),
    ],
)
def test_the_text_says_how_many_morph_targets_move(count: MorphCount, words: str) -> None:
    moved = replace(PASSED, morphs=count)
    assert f"true ones, over 60 poses of 3 clips (12 s); {words}." in as_text(moved)
    assert "morph" not in as_text(PASSED)
    document = run_json(SCHEMA, map(file_json, [moved]), exit_code=0, process=None)
    jsonschema.validate(document, VERIFY)
    assert document["files"][0]["morphs"] == {"targets": count.targets, "moving": count.moving}


def test_gain_is_a_ratio_of_means_unless_the_error_is_rounding() -> None:
    assert gain(lit()["lbs"]) == 4.0
    assert gain(lit(accurate=1e-6)["lbs"]) is None
    assert gain({}) is None
    exact = replace(PASSED, figures=by_truths(lit(accurate=1e-6), lit(accurate=1e-6)))
    assert "LBS gain" not in as_text(exact)


VIEW, NEARER = (
    "skinbake view hero.glb shows",
    "times nearer to the true normals, by the lower of two measurements",
)


@pytest.mark.parametrize(
    ("tangents", "triangles", "line"),
    [
        ((4.0, 1.0), (5.0, 2.0), f"Clear gain: 2.5 {NEARER}. Next: {VIEW} where."),
        ((4.0, 2.0), (5.0, 1.0), f"Clear gain: 2.0 {NEARER}. Next: {VIEW} where."),
        ((4.0, 2.004), (9.0, 1.0), f"Clear gain: 2.0 {NEARER}. Next: {VIEW} where."),
        ((4.0, 2.01), (9.0, 1.0), f"Small gain: 1.99 {NEARER}. Next: {VIEW} whether it is worth its bytes."),
        ((4.0, 3.0), (6.0, 5.0), f"Small gain: 1.20 {NEARER}. Next: {VIEW} whether it is worth its bytes."),
        ((4.0, 1.0), (5.5, 5.0), f"Little to win: 1.10 {NEARER}. Next: leave the file unbaked."),
        ((1.0, 2.0), (5.0, 5.0), f"Little to win: 0.50 {NEARER}. Next: leave the file unbaked."),
        ((900.0, 4.5), (900.0, 1.0), f"Clear gain: 200 {NEARER}. Next: {VIEW} where."),
        ((0.3, 0.1), (0.4, 0.1), f"Clear gain: 3.0 {NEARER}. Next: {VIEW} where."),
        (
            (0.29, 0.1),
            (0.4, 0.1),
            "Nothing to correct: standard lighting errs by 0.29° in the mean. Next: leave the file unbaked.",
        ),
        (
            (1e-6, 1e-6),
            (1e-5, 1e-6),
            "Nothing to correct: standard lighting errs by 0.00° in the mean. Next: leave the file unbaked.",
        ),
        ((1.0, 1e-6), (1.0, 1e-6), f"Clear gain: exact but for rounding. Next: {VIEW} where."),
    ],
)
def test_a_verdict_ends_in_a_conclusion_and_the_next_step(
    tangents: tuple[float, float], triangles: tuple[float, float], line: str
) -> None:
    """The thresholds leave no gap: 0.3° of standard lighting, gains of 1.2 and 2 by the worse truth."""
    found = replace(PASSED, figures=by_truths(lit(*triangles), without_direct(lit(*tangents))))
    for text in (as_brief(found), as_text(found)):
        assert text.splitlines()[-1] == f"  {line}"


@pytest.mark.parametrize(
    ("figures", "headline"),
    [
        ((4.0, 1.0), "Clear gain"),
        ((4.0, 3.0), "Small gain"),
        ((5.5, 5.0), "Leave it unbaked"),
        ((0.29, 0.1), "Nothing to correct"),
    ],
)
def test_a_page_begins_with_the_verdict_in_words(figures: tuple[float, float], headline: str) -> None:
    found = conclusion(replace(PASSED, figures=by_truths(lit(*figures), without_direct(lit(*figures)))))
    assert found is not None
    assert found.headline == headline


def test_normals_that_do_not_belong_to_the_surface_have_no_clear_gain() -> None:
    """Both lightings are then those of another shape, and a gain says little."""
    gains = replace(PASSED, figures=by_truths(lit(4.0, 1.0), without_direct(lit(4.0, 1.0))))
    leaning = Notice("normals-off-surface", "normals lean", Place("hero.glb", mesh=0, primitive=0))
    found = conclusion(replace(gains, notices=(leaning,)))
    assert found is not None
    assert (found.short, found.headline) == ("", "Normals do not belong to the surface")
    assert found.step == "do what the warning says"


def test_a_brief_verdict_has_the_figures_by_triangles() -> None:
    found = replace(PASSED, figures=by_truths(lit(5.0, 2.0), without_direct(lit(4.0, 2.0))))
    brief = as_brief(found).splitlines()
    figures = "standard 5.00°, accurate 2.00°, in the mean over 60 poses of 3 clips (12 s)"
    assert brief[:2] == ["hero.glb: passed", f"  LBS error by triangles: {figures}. -v shows more"]
    assert "2.0 times nearer to the true normals, by the lower of two measurements" in brief[2]
    assert len(brief) == 3


@pytest.mark.parametrize(
    ("verdict", "lines"),
    [
        (
            FAILED,
            ["  freshness  failed", "  Failed: freshness. Next: do what the error says, then verify again."],
        ),
        (UNREADABLE, []),
        (
            FileVerdict("a b.glb", (Check("structure", "skipped"),)),
            ["  There is no bake to judge. Next: skinbake inspect 'a b.glb' shows why."],
        ),
        (
            FileVerdict("a b.glb", (Check("structure", "skipped"),), command="skinbake bake"),
            ["  There is no bake to judge. Next: skinbake bake 'a b.glb' --out-dir baked."],
        ),
        (FileVerdict("a.glb", up_to_date=True), []),
        (
            FileVerdict("a.glb", (Check("structure", "passed"),)),
            ["  No light was measured in these poses. Next: skinbake verify a.glb --poses random."],
        ),
        (
            FileVerdict("a.glb", (Check("structure", "passed"),), poses="24 random poses"),
            ["  No light was measured in these poses. Next: skinbake view a.glb shows them."],
        ),
        (
            FileVerdict("a.glb", (Check("lighting", "skipped"),), poses="60 poses of 1 clip (2 s)"),
            ["  No light was measured in these poses. Next: skinbake verify a.glb --poses random."],
        ),
        (
            FileVerdict("a.glb", (Check("lighting", "skipped"),)),
            ["  Clips of other files play its correctives. Next: verify these files."],
        ),
        (
            FileVerdict(
                "a.glb", (Check("structure", "passed"),), notices=(Notice("a", "b", Place("a.glb")),)
            ),
            ["  No light was measured in these poses. Next: do what the warning says."],
        ),
    ],
)
def test_a_verdict_without_figures_has_a_next_step_too(verdict: FileVerdict, lines: list[str]) -> None:
    assert as_brief(verdict).splitlines()[1:] == lines


@pytest.mark.parametrize(
    ("tangents", "triangles", "worse"),
    [((4.0, 1.0), (5.0, 2.0), 5.0), ((4.0, 3.0), (6.0, 1.0), 4.0), ((4.0, 2.0), (1.0, 1e-6), 4.0)],
)
def test_the_truth_with_the_smaller_gain_counts(
    tangents: tuple[float, float], triangles: tuple[float, float], worse: float
) -> None:
    found = replace(PASSED, figures=by_truths(lit(*triangles), without_direct(lit(*tangents))))
    assert by_worse_truth(found)["standard"].mean == worse
    assert by_worse_truth(replace(PASSED, figures={})) == {}


def test_little_to_win_is_not_said_of_an_unsound_bake_or_beside_other_advice() -> None:
    little = replace(PASSED, figures=by_truths(lit(4.0, 3.9), without_direct(lit(4.0, 3.9))))
    stale = replace(little, checks=(Check("freshness", "failed"),))
    so = Message("With ", Chosen("gradients", "fitted"), " it is 1.50: bake so")
    advised = replace(little, notices=(Notice("lighting-worse", so, PLACE),))
    worse = replace(little, notices=(Notice("lighting-worse", "No option that was tried helps", PLACE),))
    missed = replace(little, checks=(Check("limits", "failed"),))
    other = replace(little, notices=(Notice("weight-sum", so, PLACE),))
    for text_of in (as_text, as_brief):
        texts = map(text_of, (little, stale, advised, worse, missed, other))
        assert [text.count("Little to win") for text in texts] == [1, 0, 0, 1, 1, 1]
    assert as_brief(advised).endswith("Next: bake as the warning says.")
    assert as_brief(missed).endswith("Next: leave it unbaked by bake --leave-under, or change the limit.")


OTHERS = (OtherBake("--gradients fitted", 0.8), OtherBake("--correctives auto", 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("accurate", [3.9, 2.5, 1.0])
def test_bakes_that_are_better_are_named_in_words_and_in_json(accurate: float) -> None:
    found = replace(PASSED, figures=by_truths(lit(4.0, accurate)), others=OTHERS)
    told = f"0.80° with --gradients fitted, 0.50° with --correctives auto, {accurate:.2f}° with this one."
    step = "Next: bake with --gradients fitted or --correctives auto"
    for text_of in (as_text, as_brief):
        assert text_of(found).endswith(f"  Another bake is better: {told} {step}.")
    better = "better with --gradients fitted or --correctives auto"
    assert as_line(found).endswith(f", {better}")
    document = run_json(SCHEMA, map(file_json, [found]), exit_code=0, process=None)
    jsonschema.validate(document, VERIFY)
    (file,) = document["files"]
    assert file["conclusion"] == better
    assert file["others"][1] == {"options": "--correctives auto", "error": 0.5}
    missed = replace(found, checks=(Check("limits", "failed"),))
    assert as_brief(missed).endswith(f"{step}, or change the limit.")


def test_a_missed_limit_that_no_other_bake_meets_is_to_be_changed() -> None:
    small = replace(PASSED, figures=by_truths(lit(4.0, 2.5)), checks=(Check("limits", "failed"),))
    assert as_brief(small).endswith("Next: change the limit.")


def test_remarks_on_checks_cannot_control_a_terminal() -> None:
    text = as_text(replace(PASSED, checks=(Check("structure", "passed", (), "clip \x1b[2J"),)))
    assert "\x1b" not in text
    assert "  structure  passed  clip " in text


def test_the_table_is_aligned_and_says_what_it_means() -> None:
    lines = as_text(PASSED).splitlines()
    assert lines[0] == "hero.glb: passed"
    assert lines[1] == "  structure  passed  1 baked primitive, 9 vertices"
    table = [line for line in lines if line.startswith(("  LBS", "  DQS")) and "gain" not in line]
    assert len(table) == 5
    assert {line[18:68].count(".") for line in table} == {6}
    assert len({line.index("mesh 2") for line in table}) == 1
    numbers = ["5.00", "10.00", "15.00", "20.00", "4.00", "8.00"]
    assert table[0].split()[:8] == ["LBS", "standard", *numbers]
    heads = [line for line in lines if "by triangles" in line or " p95 " in line][:2]
    assert heads[1].split()[:6] == ["mean", "p95", "p99", "max", "mean", "p95"]
    assert heads[0].index("by triangles") < table[0].index("10.00")
    assert heads[0].endswith("by tangents")
    assert len(heads[0]) == table[0].index("8.00") + 4
    assert table[0].endswith('mesh 2 "Body", primitive 1, vertex 7, clip "run" at 0.25 s')
    gains = "2.50x by triangles, 4.00x by tangents"
    assert any(line.startswith("  LBS gain") and gains in line for line in lines)
    assert "degrees" in lines[-2]
    assert "over 60 poses of 3 clips (12 s)." in lines[-2]
    assert max(len(line) for line in lines) < 130


def test_a_failed_file_says_so_first() -> None:
    assert as_text(FAILED).splitlines()[0] == "old.glb: FAILED"
    assert "lighting   skipped  structure failed" in as_text(FAILED)
    assert as_text(UNREADABLE) == "no.glb: FAILED"
    scaled = as_text(replace(PASSED, scaled_joints=('"Arm"', '"Leg"')))
    assert scaled.splitlines()[-2] == '  Dual quaternions with scale: "Arm", "Leg" scale or shear.'


@pytest.mark.parametrize(
    ("verdict", "line"),
    [
        (PASSED, "hero.glb: passed, LBS gain 2.50x by triangles, mean error 5.00° -> 2.00°"),
        (FAILED, "old.glb: FAILED (freshness), 1 warning"),
        (UNREADABLE, "no.glb: FAILED"),
        (
            FileVerdict(
                "a.glb", (Check("structure", "skipped"),), notices=(Notice("not-baked", "not so", PLACE),)
            ),
            "a.glb: not baked",
        ),
        (
            FileVerdict("a.glb", (Check("structure", "skipped"),), command="skinbake bake"),
            "a.glb: not baked, run skinbake bake",
        ),
        (FileVerdict("a.glb", up_to_date=True), "a.glb: passed before, up to date"),
        (
            replace(PASSED, figures=by_truths(lit(4.0, 3.9))),
            "hero.glb: passed, LBS gain 1.03x by triangles, mean error 4.00° -> 3.90°, "
            "little to win: leave it unbaked",
        ),
        (
            replace(PASSED, figures=by_truths(lit(4.0, 1.0), without_direct(lit(4.0, 3.9)))),
            "hero.glb: passed, LBS gain 4.00x by triangles, mean error 4.00° -> 1.00°, "
            "little to win by tangents: leave it unbaked",
        ),
        (
            replace(PASSED, figures=by_truths(lit(1e-6, 1e-6))),
            "hero.glb: passed, mean error 0.00° -> 0.00°, nothing to correct: leave it unbaked",
        ),
    ],
)
def test_a_file_among_many_has_one_line(verdict: FileVerdict, line: str) -> None:
    assert as_line(verdict) == line


def test_the_gain_in_a_line_has_a_colour() -> None:
    worse = as_line(replace(PASSED, figures=by_truths(lit(1.0, 2.0), without_direct(lit(5.0, 2.0)))))
    assert f"LBS gain {RED}0.50x" in with_colours(worse)
    assert f": {GREEN}passed" in with_colours(worse)


def test_junit_counts_a_suite_a_file_and_a_case_a_check() -> None:
    root = ElementTree.fromstring(as_junit([PASSED, FAILED, UNREADABLE]))
    assert root.tag == "testsuites"
    counts = [
        {key: suite.get(key) for key in ("name", "tests", "failures", "errors", "skipped")} for suite in root
    ]
    assert counts == [
        {"name": "hero.glb", "tests": "2", "failures": "0", "errors": "0", "skipped": "0"},
        {"name": "old.glb", "tests": "3", "failures": "1", "errors": "0", "skipped": "1"},
        {"name": "no.glb", "tests": "1", "failures": "0", "errors": "1", "skipped": "0"},
    ]
    assert [case.get("name") for case in root[1].iter("testcase")] == ["structure", "freshness", "lighting"]
    failure = root[1][1].find("failure")
    assert failure is not None
    assert (
        failure.get("message")
        == 'hero.glb: mesh 2 "Body", primitive 1: POSITION changed since its bake. Bake last (and 1 more)'
    )
    assert failure.text is not None
    assert failure.text.splitlines() == [str(problem) for problem in FAILED.checks[1].problems]
    error = root[2][0].find("error")
    assert error is not None
    assert error.get("message") == "no.glb: cannot be read"


def test_junit_has_the_gain_of_a_file_and_the_seconds_of_its_checks() -> None:
    timed = replace(
        PASSED, checks=(replace(PASSED.checks[0], seconds=0.25), replace(PASSED.checks[1], seconds=1.5))
    )
    [suite] = ElementTree.fromstring(as_junit([timed]))
    assert suite.get("time") == "1.750"
    assert [case.get("time") for case in suite.iter("testcase")] == ["0.250", "1.500"]
    told = {one.get("name"): one.get("value") for one in suite.iter("property")}
    figures = by_worse_truth(PASSED)
    assert told == {
        "standard": f"{figures['standard'].mean:.3f}",
        "gain": f"{figures['standard'].mean / figures['accurate'].mean:.3f}",
        "accurate": f"{figures['accurate'].mean:.3f}",
    }
    assert suite[0].tag == "properties"


def test_junit_cases_of_all_files_differ_in_class_and_name() -> None:
    """Jenkins and others show and compare cases by these two alone."""
    root = ElementTree.fromstring(as_junit([PASSED, FAILED, UNREADABLE]))
    cases = [(case.get("classname"), case.get("name")) for case in root.iter("testcase")]
    assert cases[0] == ("hero.glb", "structure")
    assert cases[-1] == ("no.glb", "read")
    assert len(set(cases)) == len(cases) == 6


def test_junit_has_a_case_for_a_file_that_was_not_verified_again() -> None:
    """Jenkins fails a build whose report holds no case."""
    (suite,) = ElementTree.fromstring(as_junit([FileVerdict("hero.glb", up_to_date=True)]))
    (case,) = suite
    assert (case.get("name"), len(case)) == ("up-to-date", 0)
    assert (suite.get("tests"), suite.get("skipped")) == ("1", "0")


def test_junit_is_well_formed_whatever_names_hold() -> None:
    name = 'a\x00\x1b<&>"\ud800\uffff ß 𝕊'
    problem = Notice("stale", name, Place(name, 0, name))
    verdict = FileVerdict(
        name, (Check("freshness", "failed", (problem,), name), Check("x", "skipped", (), name))
    )
    text = as_junit([verdict, FileVerdict(name, error=InputError(name, Place(name)))])
    suites = list(ElementTree.fromstring(text.encode()))
    assert suites[0].get("name") == 'a\ufffd\ufffd<&>"\ufffd\ufffd ß 𝕊'
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>\n')
