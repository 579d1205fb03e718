"""The page about GPUs: its neighbours, bytes and goals, and the page itself against the files of results."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks.gpu.adjacency import START, Adjacency
from benchmarks.gpu.chart import chart
from benchmarks.gpu.goals import (
    GOALS,
    MET,
    NOT_AT_SIZE,
    NOT_MET,
    NOT_ON_GPU,
    bytes_ratio,
    bytes_verdict,
    largest_mesh,
    verdict,
)
from benchmarks.gpu.meshes import Mesh, Palettes, sheet, sheet_poses
from benchmarks.gpu.page import digits, page
from benchmarks.gpu.records import (
    COMPUTE,
    RESULTS,
    ErrorRecord,
    RunRecord,
    TimeRecord,
    read_record,
    read_records,
    write_record,
)
from benchmarks.gpu.variants import BY_NAME, FLOATS, GATHER, PACKED8, SCATTER, STANDARD, VARIANTS, Counts

DOCS = Path(__file__).resolve().parents[2] / "docs"
OCTAHEDRON = np.array(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
)
CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32)


def adjacency(triangles: list[list[int]], count: int, classes: list[int] | None = None) -> Adjacency:
    rng = np.random.default_rng(3)
    normals = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    numbers = np.arange(count) if classes is None else np.array(classes)
    places = rng.normal(size=(count, 3)).astype(np.float32)[numbers]
    return Adjacency.of(places, normals, np.array(triangles), numbers)


def corners_of(found: Adjacency, vertex: int) -> list[tuple[int, int]]:
    """The neighbour pairs that going round a vertex meets."""
    pairs, before = [], -1
    for entry in found.ring[slice(*found.ranges[vertex])]:
        neighbour = int(entry & ~START)
        if entry < START:
            pairs.append((before, neighbour))
        before = neighbour
    return sorted(pairs)


def by_search(triangles: list[list[int]], vertex: int) -> list[tuple[int, int]]:
    return sorted((t[i - 2], t[i - 1]) for t in triangles for i in range(3) if t[i] == vertex)


class TestAdjacency:
    @pytest.mark.parametrize(
        ("triangles", "count"),
        [
            (OCTAHEDRON.tolist(), 6),
            ([[0, 1, 2]], 3),
            ([[0, 1, 2], [0, 2, 3], [0, 4, 5]], 6),
            ([[0, 1, 2], [1, 0, 3], [0, 1, 4]], 5),
            ([[0, 1, 2], [0, 1, 3], [1, 0, 4]], 5),
            (sheet(30).triangles.tolist(), 30),
        ],
        ids=["closed", "one", "two fans", "three at an edge", "two turned alike", "sheet"],
    )
    def test_going_round_a_vertex_meets_each_triangle_once(
        self, triangles: list[list[int]], count: int
    ) -> None:
        found = adjacency(triangles, count)
        for vertex in range(count):
            assert corners_of(found, vertex) == by_search(triangles, vertex), vertex

    def test_a_closed_fan_has_one_neighbour_more_than_triangles(self) -> None:
        found = adjacency(OCTAHEDRON.tolist(), 6)
        assert (np.diff(found.ranges, axis=1) == 5).all()

    def test_copies_at_a_seam_share_their_neighbours(self) -> None:
        """Two triangles with an edge of which the second one has copies."""
        found = adjacency([[0, 1, 2], [4, 5, 3]], 6, [0, 1, 2, 3, 2, 1])
        assert corners_of(found, 1) == corners_of(found, 5) == [(2, 0), (3, 2)]
        assert found.places[5].tolist() == found.places[1].tolist()
        assert found.triangles.tolist() == [[0, 1, 2], [2, 1, 3]]

    def test_a_vertex_without_triangles_has_no_neighbours(self) -> None:
        found = adjacency([[0, 1, 2]], 4)
        assert corners_of(found, 3) == []
        assert found.places[3].tolist() == [3, 3]
        assert np.isfinite(found.turns).all()

    def test_turns_lead_from_the_surface_to_the_authored_normal(self) -> None:
        """The surface normal of an octahedron's corner is its position, and here the authored one too."""
        found = Adjacency.of(CORNERS, CORNERS, OCTAHEDRON, np.arange(6))
        x, y, _, _ = found.turns.T
        # A turn round the normal alone.
        np.testing.assert_allclose(np.abs([x, y]), 0, atol=1e-6)


class TestBytes:
    """By hand: 44 bytes of a vertex and 36 of results, 64 joints."""

    @pytest.mark.parametrize(
        ("name", "moved", "more"),
        [
            (STANDARD, 80, 0),
            (FLOATS, 104, 24),
            ("LBS accurate, snorm16", 96, 16),
            (PACKED8, 88, 8),
        ],
    )
    def test_shaders(self, name: str, moved: int, more: int) -> None:
        mesh = sheet(100)
        counts = Counts.of(mesh, Palettes.of(sheet_poses(1)))
        assert BY_NAME[name].bytes_moved(counts) == 100 * moved + 64 * 64
        assert BY_NAME[name].adjacency_bytes(counts) == 100 * more

    def test_recomputes(self) -> None:
        """162 triangles with three corners each, and 100 fans."""
        mesh = sheet(100)
        counts = Counts.of(mesh, Palettes.of(sheet_poses(1)))
        neighbours = 3 * 162 + 100
        assert counts.neighbours == neighbours
        skin = 100 * (12 + 4 + 16 + 12) + 64 * 64
        scatter = 162 * 12 + 100 * (12 + 2 * 12) + 100 * (8 + 16 + 12 + 12 + 24)
        assert BY_NAME[SCATTER].bytes_moved(counts) == skin + 100 * 12 + scatter
        gather = 4 * neighbours + 100 * (8 + 16 + 12 + 24)
        assert BY_NAME[GATHER].bytes_moved(counts) == skin + gather

    def test_instances_share_the_mesh(self) -> None:
        mesh = sheet(100)
        counts = Counts.of(mesh, Palettes.of(sheet_poses(3)))
        assert BY_NAME[STANDARD].bytes_moved(counts) == 100 * 44 + 3 * (100 * 36 + 64 * 64)


def test_a_scaled_mesh_keeps_its_slopes() -> None:
    mesh = sheet(50)
    scaled = mesh.scaled(100.0)
    np.testing.assert_allclose(
        scaled.positions * scaled.alpha[:, :1], mesh.positions * mesh.alpha[:, :1], 1e-5
    )
    assert isinstance(scaled, Mesh) and (scaled.weights == mesh.weights).all()


def record(times: dict[str, float], vertices: int = 10_000_000, *, software: bool = False) -> RunRecord:
    """A run of one mesh, in nanoseconds a vertex."""
    counts = Counts.of(sheet(400), Palettes.of(sheet_poses(1)))
    entries = tuple(
        TimeRecord(
            "one mesh",
            1,
            vertices,
            variant.name,
            COMPUTE,
            variant.bytes_moved(counts) / counts.vertices,
            variant.adjacency_bytes(counts) / counts.vertices,
            (1.0, 1e-9 * vertices * times.get(variant.name, 1.0), 0.0),
        )
        for variant in VARIANTS
    )
    errors = (ErrorRecord("Fox", 6, STANDARD, "tangents", 4.5, 20.0),)
    return RunRecord(
        "Card 5 (a)", "Vulkan", "a driver", software, "a processor", "Linux", "2026-01-01", {"wgpu": "1"},
        "timestamps of the adapter", 3, 1e11, entries, errors,
    )  # fmt: skip


GOOD = {STANDARD: 0.1, PACKED8: 0.109, FLOATS: 0.114, SCATTER: 0.5, GATHER: 0.46}


class TestGoals:
    def test_good_times_meet_every_goal(self) -> None:
        assert [verdict(goal, record(GOOD)) for goal in GOALS] == [MET] * 4
        assert bytes_verdict(record(GOOD)) == MET

    @pytest.mark.parametrize(
        ("name", "time", "missed"),
        [(PACKED8, 0.111, [0]), (FLOATS, 0.116, [1, 3]), (GATHER, 0.43, [2, 3]), (SCATTER, 0.44, [3])],
    )
    def test_a_slow_variant_misses_its_own(self, name: str, time: float, missed: list[int]) -> None:
        found = [verdict(goal, record(GOOD | {name: time})) for goal in GOALS]
        assert found == [NOT_MET if number in missed else MET for number in range(4)]

    def test_software_and_small_meshes_do_not_count(self) -> None:
        assert {verdict(goal, record(GOOD, software=True)) for goal in GOALS} == {NOT_ON_GPU}
        assert {verdict(goal, record(GOOD, 1_000_000)) for goal in GOALS} == {NOT_AT_SIZE}

    def test_more_bytes_miss_the_goal_of_bytes(self) -> None:
        given = record(GOOD)
        times = tuple(replace(entry, more=9.0) for entry in given.times)
        assert bytes_verdict(replace(given, times=times)) == NOT_MET

    def test_a_time_that_is_missing_is_no_verdict(self) -> None:
        given = record(GOOD)
        times = tuple(
            replace(entry, seconds=()) if entry.variant == GATHER else entry for entry in given.times
        )
        assert verdict(GOALS[2], replace(given, times=times)) == NOT_AT_SIZE

    def test_by_bytes(self) -> None:
        with_joints = 64 * 64 / 400
        assert bytes_ratio(GOALS[0], record({})) == pytest.approx((88 + with_joints) / (80 + with_joints))

    def test_a_crowd_is_not_the_largest_mesh(self) -> None:
        given = record(GOOD)
        crowd = tuple(
            replace(entry, scene="crowd", instances=1000, posed_vertices=20_000_000) for entry in given.times
        )
        assert largest_mesh(replace(given, times=given.times + crowd)) == "one mesh"


class TestFiles:
    def test_a_record_is_read_as_it_was_written(self, tmp_path: Path) -> None:
        given = record(GOOD)
        path = write_record(given, tmp_path)
        assert path.name == "card-5-a-vulkan.json"
        assert read_record(path) == given

    def test_hardware_comes_first(self, tmp_path: Path) -> None:
        write_record(replace(record(GOOD, software=True), adapter="a"), tmp_path)
        write_record(replace(record(GOOD), adapter="b"), tmp_path)
        assert [found.adapter for found in read_records(tmp_path)] == ["b", "a"]

    def test_the_committed_page_and_chart_are_those_of_the_results(self) -> None:
        records = read_records(RESULTS)
        assert (DOCS / "gpu.md").read_text(encoding="utf-8") == page(records, "gpu.svg")
        assert (DOCS / "gpu.svg").read_text(encoding="utf-8") == chart(records)


class TestPage:
    def test_the_tables_of_times_are_those_of_hardware(self) -> None:
        given = [record(GOOD), replace(record(GOOD, software=True), adapter="llvmpipe")]
        text = page(given, "gpu.svg")
        assert re.findall(r"\n\*\*One mesh\*\*, (.+)\n", text) == ["Card 5 (a)"]
        assert "Measured on Card 5 (a)." in text
        assert "met: 1.09" in text and NOT_ON_GPU not in text
        assert "| LBS standard | 0.100 |" in text

    def test_software_alone_is_said_first(self) -> None:
        text = page([record(GOOD, software=True)], "gpu.svg")
        assert text.index("No GPU has been measured yet") < text.index("##")
        assert "met: " not in text

    def test_the_chart_has_bars_of_times_only_for_hardware(self) -> None:
        bars = [
            len(ElementTree.fromstring(chart([given])).findall("{http://www.w3.org/2000/svg}rect"))
            for given in (record(GOOD), record(GOOD, software=True))
        ]
        assert bars == [1 + 9 + 9 + 1, 1 + 9 + 1]

    def test_errors_come_from_a_run_that_had_characters(self) -> None:
        without = replace(record(GOOD), errors=())
        assert "Fox, 6 poses" in page([without, record(GOOD, software=True)], "gpu.svg")
        assert "4.50°" in chart([without, record(GOOD)])
        assert "the corpus of characters was not there" in page([without], "gpu.svg")

    def test_digits(self) -> None:
        assert [digits(value) for value in (0.01234, 1.234, 12.34, 1234.5)] == [
            "0.012",
            "1.23",
            "12.3",
            "1,234",
        ]
