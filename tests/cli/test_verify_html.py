"""``skinbake verify --html``: the page of one file, and the sheet of several."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.cli import exit_codes
from skinbake.commands import view
from skinbake.commands.verify import verify_file
from skinbake.commands.view import write_report
from skinbake.errors import InputError, Notice, Notices, Place
from skinbake.files.bounds import BESIDE
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import Check, Entry, FileVerdict
from skinbake.view.index import Listed
from skinbake.view.index import sheet as sheet_of
from tests.support.baked_files import Editable, baked
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import bake, sheet, write_model

FLAT = Notice("limit", "it is flat", Place("a.glb", 2, "Body"))

TUBE, SEAM = FOLDER / "bent_tube.glb", FOLDER / "seam.glb"


def given(page: Path) -> dict[str, Any]:
    """Return what a page holds beside its model."""
    found = re.search(r'id="given">(.*?)</script>', page.read_text(encoding="utf-8"))
    assert found is not None
    content: dict[str, Any] = json.loads(found[1])
    return content


def rows(page: Path) -> list[tuple[str, str, str | None]]:
    """Return name, outcome and link of each file of a sheet."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(
        r'<tr><td class="file">(?:<a href="([^"]*)">)?<span class="pictures">.*?'
        r'<span class="name">([^<]*)</span>(?:</a>)?</td><td class="told" data-value="([\w ]+)">',
        text,
    )
    return [(Path(name).name, outcome, link or None) for link, name, outcome in found]


@pytest.mark.slow
def test_one_file_gives_its_page_with_limits_and_verdict(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    page = tmp_path / "report.html"
    result = invoke("verify", tmp_path / "tube.glb", "--html", page, "--max-mean-error", "0.01")
    assert result.exit_code == exit_codes.VERIFICATION
    told = given(page)
    assert told["outcome"] == "failed"
    assert told["limits"] == ["mean error at most 0.01°"]
    (failed,) = (check for check in told["checks"] if check["outcome"] == "failed")
    assert failed["name"] == "limits"
    assert "over 0.01°" in failed["problems"][0]
    wanted = json.loads(invoke("verify", tmp_path / "tube.glb", "--json").stdout)["files"][0]
    assert told["by_triangles"] == wanted["normals_by_triangles"]
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


def test_a_failed_check_names_the_place_of_each_problem(tmp_path: Path) -> None:
    file = Editable(baked(write_model(tmp_path / "pair.glb", [sheet(), sheet()]), tmp_path))
    for number in range(2):
        file.array("_SKINBAKE_ALPHA_0", number)[:] += 1.0
    path, page = file.write(tmp_path / "stale.glb"), tmp_path / "report.html"
    assert invoke("verify", path, "--poses", "rest", "--html", page).exit_code == exit_codes.VERIFICATION
    (failed,) = (check for check in given(page)["checks"] if check["outcome"] == "failed")
    assert [problem.split(": ")[0] for problem in failed["problems"]] == [
        'mesh 0 "sheet", primitive 0',
        'mesh 0 "sheet", primitive 1',
    ]


@pytest.mark.slow
def test_the_page_of_one_file_takes_no_small_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a sheet shows small pictures."""
    drawn: list[object] = []

    def pictures(*given: object) -> list[bytes]:
        drawn.append(given)
        return []

    monkeypatch.setattr(view, "small_pictures", pictures)
    bake(SEAM, tmp_path / "seam.glb")
    page = tmp_path / "report.html"
    result = invoke("verify", tmp_path / "seam.glb", "--poses", "rest", "--html", page)
    assert result.exit_code == exit_codes.OK
    assert given(page)["outcome"] == "passed"
    assert drawn == []
    invoke("verify", tmp_path / "seam.glb", SEAM, "--poses", "rest", "--html", page)
    assert len(drawn) == 2


@pytest.mark.slow
def test_the_page_of_a_plain_view_has_no_limits(tmp_path: Path) -> None:
    invoke("view", TUBE, "-o", tmp_path / "page.html")
    assert given(tmp_path / "page.html")["limits"] is None


@pytest.mark.slow
def test_a_page_is_small_beside_its_model(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    invoke("verify", tmp_path / "tube.glb", "--html", tmp_path / "report.html")
    rest = (tmp_path / "report.html").stat().st_size - (tmp_path / "tube.glb").stat().st_size * 4 / 3
    assert rest < 420_000


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_a_large_page_of_a_report_says_how_to_shrink_it(
    count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(count):
        bake(SEAM, tmp_path / "baked" / f"{number}.glb")
    command = ["verify", str(tmp_path / "baked"), "--poses", "rest", "--html"]
    assert "the page has" not in invoke(*command, tmp_path / "small.html").stderr
    monkeypatch.setattr(view, "LARGE_PAGE", 100_000)
    told = invoke(*command, tmp_path / "large.html").stderr
    assert told.count("show a copy with smaller images or fewer clips") == count


def test_several_files_give_a_sheet_with_the_largest_gain_first(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    for source in (TUBE, SEAM):
        bake(source, folder / source.name)
    (folder / "broken.glb").write_bytes(b"glTF")
    page = tmp_path / "all.html"
    result = invoke("verify", folder, "--method", "lbs", "--html", page, "--min-gain", "50")
    assert result.exit_code == exit_codes.INPUT
    assert rows(page) == [
        ("bent_tube.glb", "failed", "all/0001-bent_tube.html"),
        ("seam.glb", "failed", "all/0003-seam.html"),
        ("broken.glb", "failed", None),
    ]
    for _, _, link in rows(page)[:2]:
        assert link is not None
        assert given(tmp_path / link)["limits"] == ["gain at least 50×"]
    text = page.read_text(encoding="utf-8")
    assert "3 files, 3 failed" in text
    assert text.count('<img class="picture" src="data:image/png;base64,') == 8
    assert "Limits: gain at least 50×." in text
    assert "not a GLB" in text


@pytest.mark.slow
def test_a_page_that_fails_leaves_the_pages_of_the_others(tmp_path: Path) -> None:
    """The file that is verified first can no longer be read when its page is made."""
    for source in (TUBE, SEAM):
        bake(source, tmp_path / source.name)
    paths = [str(tmp_path / source.name) for source in (TUBE, SEAM)]
    options = VerifyOptions.of(poses="rest", methods=["lbs"])
    verdicts = [verify_file(path, options) for path in paths]
    Path(paths[0]).unlink()
    target = str(tmp_path / "all.html")
    every = dict.fromkeys(paths, options)
    folder, failed = write_report(verdicts, every, target, lambda _: BESIDE, Notices())
    assert folder == tmp_path / "all"
    assert [str(error.place) for error in failed] == paths[:1]
    assert {name: link is None for name, _, link in rows(tmp_path / "all.html")} == {
        "bent_tube.glb": True,
        "seam.glb": False,
    }


@pytest.mark.slow
def test_the_sheet_has_the_figures_by_triangles(tmp_path: Path) -> None:
    for source in (TUBE, SEAM):
        bake(source, tmp_path / source.name)
    result = invoke("verify", *(tmp_path / source.name for source in (TUBE, SEAM)), "--json")
    tube = json.loads(result.stdout)["files"][0]
    shown = tube["normals_by_triangles"]["lbs"]
    assert shown["gain"] < 0.9 * tube["normals_by_tangents"]["lbs"]["gain"], "its truths are told apart"
    invoke("verify", *(tmp_path / source.name for source in (TUBE, SEAM)), "--html", tmp_path / "all.html")
    text = (tmp_path / "all.html").read_text(encoding="utf-8")
    row = next(line for line in text.splitlines() if "bent_tube.glb" in line)
    cells = re.findall(r'data-label="(\w+)" data-value="([^"]+)"', row)
    values = [shown["standard"]["mean"], shown["accurate"]["mean"], shown["gain"]]
    values.append(2 * 3 * 4 * len(read(tmp_path / TUBE.name).attribute("POSITION")))  # α and β, as floats
    assert [float(value) for _, value in cells] == pytest.approx(values)
    assert "by triangles" in text
    assert "by tangents" not in text


@pytest.mark.slow
def test_files_that_are_not_baked_say_so(tmp_path: Path) -> None:
    page = tmp_path / "all.html"
    for options, outcome, summary in (
        ([], "not baked", "2 files, 2 not baked<"),
        (["--min-gain", "1"], "failed", "2 files, 2 failed<"),
    ):
        invoke("verify", TUBE, SEAM, "--html", page, *options)
        assert [told for _, told, _ in rows(page)] == [outcome, outcome]
        assert summary in page.read_text(encoding="utf-8")
        assert given(tmp_path / str(rows(page)[0][2]))["outcome"] == outcome
        assert "—" not in numbers(page)[0], "the figures of a bake are shown even so"
        assert page.read_text(encoding="utf-8").count("data:image/png") == 8


@pytest.mark.slow
def test_a_file_that_a_bake_has_left_has_figures_and_pictures(tmp_path: Path) -> None:
    left, baked_too = tmp_path / "left" / TUBE.name, tmp_path / "baked" / TUBE.name
    bake(TUBE, baked_too)
    result = invoke("bake", TUBE, "-o", left, "--leave-under", "10000")
    assert (result.exit_code, "left" in result.output) == (exit_codes.OK, True), result.output
    invoke("verify", left, baked_too, "--html", tmp_path / "all.html")
    assert sorted(told for _, told, _ in rows(tmp_path / "all.html")) == ["left unbaked", "passed"]
    first, second = numbers(tmp_path / "all.html")
    assert first == second
    assert (tmp_path / "all.html").read_text(encoding="utf-8").count("data:image/png") == 8


@pytest.mark.slow
def test_a_sheet_has_the_figures_that_a_bake_would_give(tmp_path: Path) -> None:
    """Of a file without a bake: as of its bake, with the same pictures, and the command that makes it."""
    bake(TUBE, tmp_path / "baked" / TUBE.name)
    invoke("verify", TUBE, tmp_path / "baked" / TUBE.name, "--html", tmp_path / "all.html")
    plain, baked_too = numbers(tmp_path / "all.html")
    assert plain == baked_too
    text = (tmp_path / "all.html").read_text(encoding="utf-8")
    pictures = re.findall(r'src="data:image/png;base64,([^"]*)"', text)
    assert pictures[:4] == pictures[4:]
    assert len(set(pictures)) == 4
    assert text.count("Clear gain") == 2
    steps = re.findall("Next: (.*?)</span>", text)
    assert sorted(step.split()[1] for step in steps) == ["bake", "view"]
    told = given(tmp_path / "all" / "0001-bent_tube.html")
    assert "This page baked it in memory, with the defaults." in told["notes"][0]
    assert told["by_triangles"] == given(tmp_path / "all" / "0002-bent_tube.html")["by_triangles"]


def test_names_are_text_in_the_sheet() -> None:
    name = "<img src=x onerror=alert(1)>\"'&.glb"
    page = sheet_of(
        [Listed(name=name, link='x".html', outcome="failed", remark="<script>1</script>")], "<b>", "verify"
    )
    text = page.decode()
    assert "<img" not in text.replace('<img class="picture"', "")
    assert text.count("<script") == 1
    assert "<b>" not in text
    assert 'href="x&quot;.html"' in text


@pytest.mark.slow
def test_a_page_says_what_the_text_says_of_the_figures(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    result = invoke("verify", tmp_path / "tube.glb", "--poses", "rest", "--html", tmp_path / "report.html")
    remark = "Nothing to correct: standard lighting errs by 0.00° in the mean."
    assert result.stdout.splitlines()[-2].startswith(f"  {remark} Next: ")
    assert given(tmp_path / "report.html")["notes"][0] == remark


def numbers(page: Path) -> list[list[str]]:
    """Return the numbers of each file of an index as they are shown."""
    lines = re.findall(r"<tr><td.*</tr>", page.read_text(encoding="utf-8"))
    return [re.findall(r'class="number"[^>]*>([^<]*)<', line) for line in lines]


@pytest.mark.slow
def test_the_sheet_shows_figures_with_two_decimals(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    page = tmp_path / "all.html"
    invoke("verify", tmp_path / "tube.glb", SEAM, "--html", page)
    entry = json.loads(invoke("verify", tmp_path / "tube.glb", "--json").stdout)["files"][0]
    assert entry["normals_by_tangents"]["lbs"]["gain"] > entry["normals_by_triangles"]["lbs"]["gain"]
    told = entry["normals_by_triangles"]["lbs"]
    wanted = "{standard[mean]:.2f}° {accurate[mean]:.2f}° {gain:.2f}×".format(**told).split()
    assert wanted in [row[:3] for row in numbers(page)]


@pytest.mark.parametrize(
    ("gain", "shown"),
    [(2.2, "2.20×"), (12.345, "12.35×"), (1234.4, "1,234×"), (0.996, "0.996×"), (0.99, "0.99×")],
)
def test_the_sheet_rounds_gains_as_the_text_of_verify_does(gain: float, shown: str, tmp_path: Path) -> None:
    (tmp_path / "all.html").write_bytes(
        sheet_of([Listed(name="a.glb", link=None, outcome="passed", gain=gain)], "", "verify")
    )
    assert numbers(tmp_path / "all.html")[0][2] == shown


def verdict(name: str, *checks: Check, error: InputError | None = None) -> FileVerdict:
    return FileVerdict(name, checks, error=error)


@pytest.mark.slow
def test_a_folder_is_shown_as_a_sheet_of_pages(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    for source in (TUBE, SEAM):
        (folder / source.name).write_bytes(source.read_bytes())
    before = {path: path.read_bytes() for path in folder.iterdir()}
    page = tmp_path / "all.html"
    result = invoke("view", folder, "-o", page)
    assert (result.exit_code, result.stderr) == (exit_codes.OK, "")
    assert [name for name, _, _ in rows(page)] == ["bent_tube.glb", "seam.glb"]
    assert all(given(tmp_path / str(link))["by_triangles"] for _, _, link in rows(page))
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    (folder / "broken.glb").write_bytes(b"glTF")
    assert invoke("view", folder, "-o", page).exit_code == exit_codes.INPUT
    assert rows(page)[0] == ("broken.glb", "failed", None)


def test_a_folder_needs_the_name_of_a_page_and_replaces_no_foreign_one(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    for source in (TUBE, SEAM):
        (folder / source.name).write_bytes(source.read_bytes())
    for options in ([], ["-o", "-"]):
        result = invoke("view", folder, *options)
        assert result.exit_code == exit_codes.USAGE
        assert "name the page of its characters by -o PAGE" in " ".join(result.stderr.split())
    own = tmp_path / "all" / "0002-seam.html"
    own.parent.mkdir()
    own.write_text("<!doctype html>my own page")
    assert invoke("view", folder, "-o", tmp_path / "all.html").exit_code == exit_codes.USAGE
    assert own.read_text() == "<!doctype html>my own page"


@pytest.mark.parametrize(
    ("told", "remark"),
    [
        (
            verdict("a.glb", Check("limits", "failed", (FLAT, replace(FLAT, message="and bent")))),
            'Failed mesh 2 "Body": it is flat (and 1 more)',
        ),
        (
            verdict("a.glb", error=InputError("it is flat", Place("a.glb", 2, "Body"))),
            'Failed mesh 2 "Body": it is flat',
        ),
        (verdict("a.glb", error=InputError("it is flat")), "Failed it is flat"),
        (
            verdict("a.glb", Check("structure", "passed"), Check("lighting", "skipped", (), "no normals")),
            "Passed no normals",
        ),
        (verdict("a.glb", Check("structure", "skipped", (), "nothing in it is baked")), "Not baked"),
        (FileVerdict("a.glb", up_to_date=True), "Passed before, up to date"),
    ],
)
def test_the_sheet_says_why_a_file_failed_or_has_no_figures(told: FileVerdict, remark: str) -> None:
    text = sheet_of([view._listed(told, None, Entry(told))], "", "verify").decode()
    (outcome,) = re.findall(r'data-value="(?:passed|failed|not baked)">(.*?)</td>', text)
    words = html.unescape(re.sub("<[^>]*>", "", outcome.replace("<br>", " ")))
    assert words.partition(" Next: ")[0] == remark


@pytest.mark.slow
def test_the_sheet_tells_of_limits_that_differ(tmp_path: Path) -> None:
    (tmp_path / "skinbake.toml").write_text(
        "[verify]\nmax-mean-error = 90\n"
        '[[overrides]]\nfiles = ["**/seam.glb"]\nverify = { min-gain = 0.5 }\n',
        encoding="utf-8",
    )
    bake(SEAM, tmp_path / "seam.glb")
    bake(TUBE, tmp_path / "tube.glb")
    page = tmp_path / "all.html"
    options: list[str | Path] = ["--config", tmp_path / "skinbake.toml", "--poses", "rest", "--html", page]
    invoke("verify", tmp_path / "seam.glb", tmp_path / "tube.glb", *options)
    others = "others that differ between files, on their pages."
    assert f"Limits: mean error at most 90°, {others}<" in page.read_text(encoding="utf-8")
    invoke("verify", tmp_path / "tube.glb", tmp_path / "tube.glb", *options)
    assert "Limits: mean error at most 90°.<" in page.read_text(encoding="utf-8")


def test_files_without_a_gain_come_last_unless_they_failed(tmp_path: Path) -> None:
    files = [
        Listed(name="rigid.glb", link=None, outcome="passed"),
        Listed(name="plain.glb", link=None, outcome="not baked"),
        Listed(name="good.glb", link=None, outcome="passed", gain=3.0),
        Listed(name="little.glb", link=None, outcome="passed", gain=1.1),
        Listed(name="poor.glb", link=None, outcome="failed", gain=0.9),
        Listed(name="broken.glb", link=None, outcome="failed"),
    ]
    (tmp_path / "all.html").write_bytes(sheet_of(files, "", "verify"))
    names = ["poor.glb", "broken.glb", "good.glb", "little.glb", "plain.glb", "rigid.glb"]
    assert [name for name, _, _ in rows(tmp_path / "all.html")] == names


def test_a_name_of_several_lines_is_one_line_in_the_sheet() -> None:
    text = sheet_of(
        [Listed(name="a\nb.glb", link=None, outcome="failed", remark="c\td")], "", "verify"
    ).decode()
    assert '<span class="name">a\\nb.glb</span>' in text
    assert "c\\td" in text


@pytest.mark.parametrize("source", ["-", "https://example.com/hero.glb"])
def test_html_needs_files_that_can_be_read_again(tmp_path: Path, source: str) -> None:
    result = invoke("verify", source, "--html", tmp_path / "report.html")
    assert result.exit_code == exit_codes.USAGE
    assert "--html needs files on this machine's disks" in " ".join(result.stderr.split())


@pytest.mark.slow
def test_html_replaces_earlier_pages_only(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    page = tmp_path / "report.html"
    for _ in range(2):
        assert invoke("verify", tmp_path / "tube.glb", "--html", page).exit_code == exit_codes.OK
    page.write_text("<!doctype html>my own page")
    result = invoke("verify", tmp_path / "tube.glb", "--html", page)
    assert result.exit_code == exit_codes.USAGE
    assert "was not written by an earlier run" in " ".join(result.stderr.split())
    assert page.read_text() == "<!doctype html>my own page"


@pytest.mark.slow
def test_html_replaces_earlier_pages_of_its_folder_only(tmp_path: Path) -> None:
    page, own = tmp_path / "all.html", tmp_path / "all" / "0002-seam.html"
    command = ("verify", TUBE, SEAM, "--html", page)
    for _ in range(2):
        assert invoke(*command).exit_code == exit_codes.OK
    kept = page.read_bytes()
    own.write_text("<!doctype html>my own page")
    result = invoke(*command)
    assert result.exit_code == exit_codes.USAGE
    told = "".join(result.stderr.split())
    assert f"--html:{own}existsandwasnotwrittenbyanearlierrun" in told
    assert own.read_text() == "<!doctype html>my own page"
    assert page.read_bytes() == kept


@pytest.mark.slow
def test_a_page_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    result = invoke("verify", tmp_path / "tube.glb", "--html", tmp_path / "tube.glb" / "report.html")
    assert result.exit_code == exit_codes.OUTPUT
    assert "is a file, not a folder" in result.stderr


def test_a_file_that_is_not_baked_has_a_page_all_the_same(tmp_path: Path) -> None:
    result = invoke("verify", TUBE, "--require-baked", "--html", tmp_path / "report.html")
    assert result.exit_code == exit_codes.VERIFICATION
    told = given(tmp_path / "report.html")
    assert told["outcome"] == "failed"
    assert told["by_triangles"] is None


def test_a_page_has_the_suffix_of_one(tmp_path: Path) -> None:
    result = invoke("verify", TUBE, "--html", tmp_path / "report.pdf")
    assert result.exit_code == exit_codes.USAGE
    assert "report.pdf: expected a name that ends in .html or .htm" in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []
