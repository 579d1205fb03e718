"""`make bench` measures every row of its table, and its pages say what the figures say. No time is judged."""

from __future__ import annotations

import json
import re
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from benchmarks import speedup_chart
from benchmarks.measure import ROWS
from benchmarks.processes import MIB
from benchmarks.results import OUTPUT, updated
from benchmarks.results_page import lines, page
from fixtures.make_fixtures import FOLDER
from tests.support import corpus, corpus_folder

REPOSITORY = Path(__file__).resolve().parents[2]
TIMEOUT_SECONDS = 600
CHARACTER = "a small character"
WHAT = (
    "`skinbake --help`",
    "`skinbake --version`",
    CHARACTER,
    "bake a grid of 10,000 vertices, 1 MB",
    "bake a grid of 10,000 vertices, 1 MB, `--no-sync`",
    "bake a grid of 10,000 vertices, 1 MB: memory",
    "bake a grid of 10,000 vertices, 1 MB",
    "gradients alone, 10,000 vertices, one core",
    "gradients alone, 10,000 vertices, one core",
    "time from 1,000 to 10,000 vertices: slope of log time over log vertices",
    "memory from 1,000 to 10,000 vertices: (peak − 100 MiB) / file",
    "verify, 2,500 vertices, 10 poses, both methods",
    "verify, 2,500 vertices, 10 poses, LBS",
    "verify, 2,500 vertices, 10 poses, both methods, by both truths",
    "verify, 2,500 vertices, 10 poses, LBS, by both truths",
    "verify, 2,500 vertices, 10 poses, DQS, by both truths",
    "bake 8 files of 400 vertices in one call",
    "bake 400 vertices with 1 MB of textures",
)

STARTED = ("skinbake --help", "skinbake --version", "python -c pass")

Results = dict[str, Any]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a quick run, its figures beside it."""
    path = tmp_path_factory.mktemp("results") / "RESULTS.md"
    subprocess.run(
        [sys.executable, "-m", "benchmarks.results", "--quick", "--output", str(path)],
        cwd=REPOSITORY,
        check=True,
        capture_output=True,
        timeout=TIMEOUT_SECONDS,
    )
    return path


@pytest.fixture(scope="module")
def figures(quick: Path) -> Results:
    found: Results = json.loads(quick.with_suffix(".json").read_text(encoding="utf-8"))
    return found


def table(text: str) -> list[list[str]]:
    """Return the cells of a page's first table, below its head."""
    rows = [line for line in text.partition("\n\n## ")[0].splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in rows[1:]]


def character() -> str:
    """Return the row's name: it bakes a real character, or a fixture where the corpus is not here."""
    here = corpus_folder.find_corpus() is not None
    model = corpus.model("CesiumMan/CesiumMan.glb") if here else FOLDER / "bent_tube.glb"
    return f"bake {model.name}, {model.stat().st_size / 1e6:.2f} MB"


@pytest.mark.slow
class TestQuickRun:
    def test_every_row_is_there(self, quick: Path) -> None:
        rows = table(quick.read_text(encoding="utf-8"))
        assert tuple(re.sub(r", --jobs \d+", "", row[0]) for row in rows) == tuple(
            character() if what == CHARACTER else what for what in WHAT
        )
        assert {len(row) for row in rows} == {7}

    def test_every_row_has_a_figure_of_ours(self, quick: Path) -> None:
        for row in table(quick.read_text(encoding="utf-8")):
            assert re.search(r"\d|below 0", row[1]), row

    def test_a_quick_run_measures_every_row(self, figures: Results) -> None:
        assert figures["rows"].keys() == ROWS.keys()
        assert figures["machine"]["processor"]
        assert {"skinbake", "Python", "numpy"} <= figures["versions"].keys()

    def test_ratios_are_those_of_medians(self, quick: Path, figures: Results) -> None:
        runs = figures["rows"]["startup"]["runs"]
        ours, theirs = (
            statistics.median(runs[name]["seconds"]) for name in ("skinbake --help", "python -c pass")
        )
        assert table(quick.read_text(encoding="utf-8"))[0][4] == f"{ours / theirs:.2f}"

    def test_a_page_of_a_quick_run_warns_that_it_is_quick(self, quick: Path) -> None:
        assert "A quick run" in quick.read_text(encoding="utf-8")


def sample() -> Results:
    """Figures chosen so that what follows from them can be seen."""
    runs = {"seconds": [2.0, 1.0, 9.0], "mib": [50.0, 60.0, 55.0]}
    slow = {"seconds": [4.0], "mib": [1.0]}
    half, whole = {"seconds": [3.0]}, {"seconds": [6.0]}
    sizes = [
        {
            "vertices": vertices,
            "bytes": 80 * vertices,
            "written": 100 * vertices,
            "seconds": [vertices * 1e-5],
            "mib": [100 + 2.5 * 80 * vertices / MIB],
        }
        for vertices in (1_000, 10_000, 100_000)
    ]
    return {
        "startup": {"runs": dict.fromkeys(STARTED, runs)},
        "character": {"model": "a.glb", "bytes": 1, "runs": {"bake": runs, "tangents": slow}},
        "grid": {"vertices": 100_000, "bytes": 1, "runs": {"bake": runs, "bake --no-sync": half}},
        "tangents": {"runs": {"bake": runs}},
        "gradients": {"vertices": 9, "runs": {"skinbake": half, "authors' loop": whole}},
        "scaling": {"sizes": sizes, "left_out": []},
        "verify": {"vertices": 9, "poses": 9, "runs": {"both methods": whole, "LBS": half, "libigl": whole}},
        "truths": {
            "vertices": 9,
            "poses": 9,
            "runs": {
                "both methods, both": {"seconds": [1.28]},
                "both methods, tangents": {"seconds": [1.0]},
                "LBS, both": {"seconds": [1.29]},
                "LBS, tangents": {"seconds": [1.0]},
                "DQS, both": {"seconds": [1.31]},
                "DQS, tangents": {"seconds": [1.0]},
            },
        },
        "files": {
            "files": 1_000,
            "vertices": 2_000,
            "bytes": 160_000,
            "jobs": 2,
            "single_calls": 50,
            "runs": {"one call": {"seconds": [15.01]}, "single calls": {"seconds": [10.0]}},
        },
        "payload": {
            "vertices": 9,
            "payload": 50_000_000,
            "runs": {"bare": {"seconds": [0.2]}, "bake": {"seconds": [0.3]}},
        },
        "stages": {
            "models": [
                {"model": "small", "seconds": 0.5, "stages": {"read": 0.25, "strip": 0.0001}},
                {"model": "large", "seconds": 2.0, "stages": {"read": 0.5, "write": 1.0}},
            ]
        },
    }  # fmt: skip


class TestPage:
    def test_bars_are_held_against_medians(self) -> None:
        told = [(line.ratio, line.met) for line in lines(sample())]
        assert told == [
            (1.0, False),
            (1.0, False),
            (0.5, True),
            (None, None),
            (None, None),
            (None, None),
            (None, None),
            (0.5, False),
            (None, None),
            (None, True),
            (None, True),
            (1.0, True),
            (0.5, True),
            (1.28, True),
            (1.29, True),
            (1.31, False),
            (pytest.approx(15.01 / 200), True),
            (None, None),
        ]

    def test_a_peer_that_is_not_installed_is_said(self) -> None:
        assert [line.peer for line in lines(sample()) if line.theirs == "not installed"] == [
            "`gltf-transform copy`",
            "`gltf-transform copy`",
            "`gltfpack -noq`",
            "`gltf-transform tangents`",
            "meshoptimizer's generateTangents, WebAssembly",
            "`gltf-transform copy`",
        ]

    def test_slope_and_memory(self) -> None:
        told = {line.what.split()[0]: line.ours for line in lines(sample())}
        assert told["time"] == "1.00 by least squares, 1.00 between the last two"
        assert told["memory"] == "2.50 at most"

    @pytest.mark.parametrize(("exponent", "met"), [(1.04, True), (1.06, False)])
    def test_what_grows_faster_misses_the_bar(self, exponent: float, met: bool) -> None:
        rows = sample()
        for size in rows["scaling"]["sizes"]:
            size["seconds"] = [1e-6 * size["vertices"] ** exponent]
        (line,) = [line for line in lines(rows) if line.what.startswith("time")]
        assert line.met is met

    def test_stages_that_take_time_and_the_rest(self) -> None:
        text = page({"quick": False, "date": "", "machine": MACHINE, "versions": {}, "rows": sample()})
        told = (
            text.partition("## Where the time goes")[2].partition("|---|---|---|---|---|\n")[2].splitlines()
        )
        assert told[4:5] == [""]
        assert told[:4] == [
            "| read | 0.250 | 50% | 0.500 | 25% |",
            "| write | 0.000 | 0% | 1.000 | 50% |",
            "| start-up | 0.250 | 50% | 0.500 | 25% |",
            "| together | 0.500 | 100% | 2.000 | 100% |",
        ]


MACHINE = {"processor": "a processor", "cores": 2, "memory_gib": 8, "system": "a system"}


class TestCommittedPages:
    """The pages in the repository are those that the committed figures give."""

    @pytest.fixture
    def committed(self) -> Results:
        found: Results = json.loads(OUTPUT.with_suffix(".json").read_text(encoding="utf-8"))
        return found

    def test_results(self, committed: Results) -> None:
        assert OUTPUT.read_text(encoding="utf-8") == page(committed)

    def test_committed_pages_are_of_a_full_run(self, committed: Results) -> None:
        assert committed["quick"] is False


def speedup_row() -> Results:
    """A case that gains all of a second thread, and one that gains a third of it by four."""
    return {
        "cores": 4,
        "cases": {
            "verify 9 vertices, 9 poses": {
                "1": {"seconds": [8.0, 9.0, 7.0], "mib": [100.0]},
                "2": {"seconds": [4.0], "mib": [110.0]},
                "4": {"seconds": [2.5], "mib": [130.0]},
            },
            "bake 1,000 × a.glb, by --jobs": {
                "1": {"seconds": [6.0], "mib": [10.0]},
                "2": {"seconds": [4.5], "mib": [10.0]},
                "4": {"seconds": [3.0], "mib": [10.0]},
            },
        },
    }


class TestSpeedUp:
    def test_serial_shares_follow_from_amdahl(self) -> None:
        for share in (0.0, 0.1, 0.5, 1.0):
            for threads in (2, 8):
                gained = 1.0 / (share + (1.0 - share) / threads)
                assert speedup_chart.serial_share(gained, threads) == pytest.approx(share)

    def test_the_table_holds_two_threads_to_their_goals(self) -> None:
        rows = [line for line in speedup_chart.section(speedup_row()) if line.startswith("| ")]
        verify, many = ([cell.strip() for cell in row.strip("| ").split("|")] for row in rows[1:])
        assert verify == [
            *("verify 9 vertices, 9 poses", "8.00 s", "4.00 s, 2.00 ×", "2.50 s, 3.20 ×"),
            *("8%", "100, 130", "1.80 ×", "met"),
        ]
        assert many[2:] == ["4.50 s, 1.33 ×", "3.00 s, 2.00 ×", "33%", "10, 10", "1.67 ×", "**missed**"]

    def test_the_chart_has_a_line_for_each_case(self) -> None:
        picture = ElementTree.fromstring(speedup_chart.chart(speedup_row()))
        space = "{http://www.w3.org/2000/svg}"
        lines = [line.attrib["points"].split() for line in picture.iter(f"{space}polyline")]
        ideal, _, verify, many = ([tuple(map(float, at.split(","))) for at in line] for line in lines)
        origin, step = ideal[0], (ideal[1][0] - ideal[0][0]) / 4
        for found, expected in ((verify, (1, 2, 3.2)), (many, (1, 4 / 3, 2))):
            for (x, y), count, speedup in zip(found, (1, 2, 4), expected, strict=True):
                assert (x - origin[0]) / step == pytest.approx(count, abs=0.01)
                assert (origin[1] - y) / step == pytest.approx(speedup, abs=0.01)
        words = [text.text for text in picture.iter(f"{space}text")]
        assert "verify 9 vertices, 9 poses: 3.20 ×" in words

    @pytest.mark.slow
    def test_rows_that_are_measured_again_are_said(self) -> None:
        before = {"rows": {"a": 1, "b": 2}, "later": [{"rows": ["a", "b"], "date": "2000-01-01"}]}
        after = updated(before, {"b": 3}, 0.25)
        assert after["rows"] == {"a": 1, "b": 3}
        assert [one["rows"] for one in after["later"]] == [["a"], ["b"]]
        again = updated(after, {"a": 4, "b": 5}, 0.5)
        assert [one["rows"] for one in again["later"]] == [["a", "b"]]
        assert again["later"][0]["load"] == 0.5
