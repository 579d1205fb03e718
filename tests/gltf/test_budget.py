"""The claims of a document are counted before memory is allocated: by unit, and by the memory of children."""

from __future__ import annotations

import base64
import json
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from fixtures.builder import pack_glb
from skinbake.errors import BudgetError, InputError, Place, UnsupportedFeatureError
from skinbake.format.strip import stripped
from skinbake.gltf import budget as budgets
from skinbake.gltf.budget import Budget, Limit, Work, memory_limited, shown
from skinbake.gltf.codecs import draco
from skinbake.gltf.document import Document, parse_glb, parse_gltf, read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import MOST_SETS, read_indices, read_primitive, skinned_sources
from skinbake.gltf.writing.compaction import shift_of
from skinbake.report.totals import error_fields
from tests.support.corpus import require_corpus
from tests.support.models import FOLDER, baked, crowd, edited, sheet, write_model

HERE = Place("x.glb")
MIB = 1 << 20
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="reads what a child took")


def test_what_is_held_is_limited_and_can_be_let_go() -> None:
    budget = Budget(limit=100, backed=1)
    with budget.passing():
        budget.claim(Work(bytes=90), "a part", HERE)
    budget.claim(Work(bytes=100), "another", HERE)
    with pytest.raises(InputError, match=r"x.glb: one more would take 1 byte, .*101 bytes.*: raise --max"):
        budget.claim(Work(bytes=1), "one more", HERE)


def test_work_that_is_refused_does_not_count_and_an_error_releases_what_its_block_held() -> None:
    budget = Budget(limit=100, backed=1)
    with suppress(InputError), budget.passing():
        budget.claim(Work(bytes=60), "a part", HERE)
        budget.claim(Work(steps=10, bytes=60), "too much", HERE)
    assert (budget.held, budget.taken) == (0, Work(bytes=60))
    budget.claim(Work(bytes=70), "for a moment", HERE, passing=True)
    budget.claim(Work(bytes=100), "another", HERE)
    assert (budget.held, budget.taken) == (100, Work(bytes=230))


def test_costs_times_counts_add_up() -> None:
    cost = Work(steps=0.5, bytes=3) * 4 + Work(steps=1, zeros=1, packed=2, unpacked=7, welded=9) * 2
    assert cost == Work(steps=4.0, bytes=12, zeros=2, packed=4, unpacked=14, welded=18)


def test_json_names_a_refusal_an_input_error() -> None:
    with pytest.raises(BudgetError) as refused:
        Budget(limit=1, backed=1).claim(Work(bytes=2), "it", HERE)
    fields = error_fields(refused.value)
    assert fields is not None
    assert fields["kind"] == "InputError"


def test_what_is_spent_in_all_is_limited_by_the_file_s_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budgets, "MEMORY", Limit(2048, 1000))
    budget = Budget(limit=1 << 60, backed=2)
    for _ in range(2 * 2048 // 64):
        with budget.passing():
            budget.claim(Work(bytes=64), "a part", HERE)
    with pytest.raises(InputError, match="The limit is 2,048 times its 2 bytes"):
        budget.claim(Work(bytes=1), "the last", HERE)


def test_zeros_count_once_an_accessor() -> None:
    budget = Budget(limit=1 << 60, backed=0)
    for _ in range(3):
        budget.claim_zeros(budgets.ZEROS.free // 2, 7, HERE)
    budget.claim_zeros(budgets.ZEROS.free // 2, 8, HERE)
    with pytest.raises(InputError, match="accessor 9 has no buffer view and claims 1 byte of zeros"):
        budget.claim_zeros(1, 9, HERE)


def test_a_file_that_is_named_again_backs_nothing_and_is_claimed() -> None:
    budget = Budget(limit=250, backed=10)
    budget.back(100, "a.bin", "buffer 0", HERE)
    budget.back(100, "a.bin", "buffer 1", HERE)
    assert (budget.backed, budget.held) == (110, 200)
    with pytest.raises(InputError, match="buffer 2 would take"):
        budget.back(100, "a.bin", "buffer 2", HERE)


def test_the_default_is_a_share_of_what_the_control_group_allows(tmp_path: Path) -> None:
    groups, root = tmp_path / "cgroup", tmp_path / "fs"
    (root / "a" / "b").mkdir(parents=True)
    groups.write_text("0::/a/b\n")
    (root / "a" / "memory.max").write_text("4096\n")
    (root / "a" / "b" / "memory.max").write_text("max\n")
    (root / "memory").mkdir()
    (root / "memory" / "memory.limit_in_bytes").write_text("12345")
    assert list(budgets.memory_limits(groups, root)) == [4096]
    groups.write_text("3:cpu,memory:/gone\n1:cpu:/a\n")
    assert list(budgets.memory_limits(groups, root)) == [12345]
    assert list(budgets.memory_limits(tmp_path / "none", root)) == []
    assert budgets.default_limit() == budgets.machine_memory() // 4
    assert budgets.default_limit(16) == budgets.machine_memory() // 16


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 bytes"),
        (1, "1 byte"),
        (7, "7 bytes"),
        (1536, "1.5 KiB"),
        (1000 << 10, "1000 KiB"),
        (3 << 30, "3 GiB"),
        (10**400, "over 1,024 TiB"),
    ],
)
def test_sizes_read_well(size: int, text: str) -> None:
    assert shown(size) == text


@pytest.mark.parametrize("entry", ["[]", "{}", "0", '{"a":0}'])
def test_json_is_counted_before_it_is_parsed(entry: str) -> None:
    text = f'{{"asset":{{"version":"2.0"}},"extras":[{",".join([entry] * 50_000)}]}}'.encode()
    tracemalloc.start()
    try:
        parsed = parse_gltf(text, "x.gltf", Path())
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert taken < parsed.budget.held + 100_000
    with memory_limited(taken // 2), pytest.raises(InputError, match="its JSON would take"):
        parse_gltf(text, "x.gltf", Path())


def test_data_uris_are_counted() -> None:
    uri = "data:;base64," + base64.b64encode(bytes(30_000)).decode()
    root = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 30_000, "uri": uri}] * 9}
    with memory_limited(1_500_000):
        document = parse_gltf(json.dumps(root).encode(), "x.gltf", Path())
        with pytest.raises(InputError, match=r"the data: URI of buffer \d would take"):
            for number in range(9):
                document.buffer(number)


def test_indices_that_are_not_in_the_file_are_counted(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        del content["meshes"][0]["primitives"][0]["indices"]

    document = read_document(str(edited("seam.glb", tmp_path, change)))
    (source,) = skinned_sources(document)
    before = document.budget.held
    found = read_indices(document, source)
    assert found.nbytes > 0
    assert document.budget.held - before >= found.nbytes


def bomb(path: Path, count: float, primitives: int) -> Path:
    """Write primitives that share accessors of ``count`` vertices without data, but for three positions."""
    data = struct.pack("<3I9f", 0, 1, 2, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    sparse = {"count": 3, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 1}}
    attributes = {"POSITION": 1, "NORMAL": 2, "JOINTS_0": 3, "WEIGHTS_0": 4}
    root = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 48, "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 12}, {"buffer": 0, "byteOffset": 12, "byteLength": 36}],
        "accessors": [
            {"bufferView": 0, "componentType": 5125, "count": 3, "type": "SCALAR"},
            {"componentType": 5126, "count": count, "type": "VEC3", "sparse": sparse},
            {"componentType": 5126, "count": count, "type": "VEC3"},
            {"componentType": 5121, "count": count, "type": "VEC4"},
            {"componentType": 5126, "count": count, "type": "VEC4"},
        ],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 0}] * primitives}],
        "nodes": [{"mesh": 0, "skin": 0}, {}],
        "skins": [{"joints": [1]}],
    }
    path.write_text(json.dumps(root))
    return path


def taken(*arguments: str | Path) -> tuple[int, int, str]:
    """Run a command in a child; return its exit code, its peak bytes, and what it said on stderr.

    A small process starts it, since a new one counts the memory of its parent as its own at first.
    """
    launcher = [sys.executable, "-I", "-S", str(LAUNCHER)]
    command = [sys.executable, "-m", "skinbake", *map(str, arguments)]
    done = subprocess.run([*launcher, *command], capture_output=True, text=True, check=False)
    return done.returncode, int(done.stdout.split()[-1]), done.stderr


LAUNCHER = Path(__file__).resolve().parents[2] / "benchmarks" / "launch.py"

COMMANDS: list[Callable[[Path], list[str | Path]]] = [
    lambda path: ["bake", path, "-o", path.with_name("out.glb")],
    lambda path: ["bake", path, "--dry-run", "--compress", "meshopt"],
    lambda path: ["inspect", path],
]


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("command", COMMANDS)
def test_zeros_that_no_byte_backs_are_refused(command: Callable[[Path], Any], tmp_path: Path) -> None:
    path = bomb(tmp_path / "p1.gltf", 500_000, 1)
    code, peak, said = taken(*command(path))
    assert (code, said.count("\n")) == (3, 1)
    assert "p1.gltf: mesh 0, primitive 0" in said
    assert "claims 7.629 MiB of zeros" in said
    assert "--max-memory" in said
    assert peak < 200 * MIB


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("count", [1 << 20, float(1 << 20)])
@pytest.mark.parametrize("command", COMMANDS)
def test_vertices_that_are_shared_too_often_are_refused_before_they_are_read(
    command: Callable[[Path], Any], count: float, tmp_path: Path
) -> None:
    """1.7 KB that took 2.4 GB."""
    path = bomb(tmp_path / "p10.gltf", count, 10)
    code, peak, said = taken(*command(path))
    assert (code, said.count("\n")) == (3, 1)
    assert "p10.gltf: its skinned primitives have 10,485,770 vertices and triangles" in said
    assert peak < 100 * MIB


def test_vertices_and_triangles_are_limited_by_the_file_s_bytes() -> None:
    budget = Budget(backed=100)
    most = budgets.ELEMENTS.free + 400
    budget.look_at(most, [], HERE)
    budget.look_at(most, [], HERE)
    with pytest.raises(InputError, match=f"x.glb: its skinned primitives have {most + 1:,} vertices"):
        budget.look_at(most + 1, [], HERE)


def test_welding_is_limited_by_the_file_s_bytes() -> None:
    budget = Budget(limit=1 << 60, backed=100)
    claim = budget.welding(HERE)
    claim(128 * MIB)
    claim(100 * 512)
    assert budget.held == 128 * MIB + 100 * 512
    with pytest.raises(InputError, match=r"x.glb: its vertices have so many copies .* 128 MiB"):
        claim(1)


def test_compressed_data_may_expand_to_128_mib_or_a_hundred_times_its_bytes() -> None:
    """Constant attributes cost nothing: 6 million vertices in a stream of 300 bytes."""
    budget = Budget(limit=1 << 60, backed=100 * MIB)
    budget.claim(Work(packed=300, unpacked=128 * MIB), "compressed data", HERE)
    with pytest.raises(InputError, match=r"300 bytes .* would expand to 134217729. The limit is 100 times"):
        budget.claim(Work(unpacked=1), "compressed data", HERE)
    budget.claim(Work(packed=2 * MIB, unpacked=72 * MIB), "compressed data", HERE)


@pytest.mark.parametrize("json", [{"indices": "x"}, {"indices": -1}, {"indices": 9}, {"indices": None}])
def test_json_that_is_not_sound_is_refused_where_it_is_read(json: JsonObject, tmp_path: Path) -> None:
    def spoil(root: JsonObject) -> None:
        root["meshes"][0]["primitives"][0].update(json)
        root["accessors"][0]["count"] = -5

    document = read_document(str(edited("seam.glb", tmp_path, spoil)))
    assert len(skinned_sources(document)) == 1


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("name", ["p10.gltf", "p40.gltf"])
def test_the_bombs_of_the_audit_are_refused(name: str, tmp_path: Path) -> None:
    path = require_corpus() / "hostile" / "F04-unbacked-bomb" / name
    code, peak, _ = taken("bake", path, "-o", tmp_path / "out.glb")
    assert code == 3
    assert peak < 200 * MIB
    assert list(tmp_path.iterdir()) == []


@LINUX
@pytest.mark.parametrize("command", COMMANDS[:1])
@pytest.mark.parametrize(
    "limit", [100, *(pytest.param(limit, marks=pytest.mark.slow) for limit in (200, 400))]
)
def test_max_memory_bounds_what_a_child_takes(
    command: Callable[[Path], Any], limit: int, tmp_path: Path
) -> None:
    path = crowd(tmp_path / "crowd.glb", 150, 110)
    code, peak, said = taken(*command(path), "--max-memory", f"{limit}M")
    assert code == 3
    assert f"The limit is {limit} MiB: raise --max-memory" in said
    assert peak < (limit + 80) * MIB


@pytest.mark.slow
@LINUX
def test_one_node_that_is_listed_as_many_joints_is_counted(tmp_path: Path) -> None:
    def spoil(root: JsonObject) -> None:
        joints = root["skins"][0]["joints"]
        root["nodes"][joints[1]]["rotation"] = [0.6, 0.0, 0.0, 0.8]
        del root["skins"][0]["inverseBindMatrices"]
        joints += joints[-1:] * 500_000

    path = edited("bent_tube.glb", tmp_path, spoil)
    code, peak, said = taken("bake", path, "-o", tmp_path / "out.glb", "--max-memory", "200M")
    assert code == 3
    assert "the stored pose of 3 nodes and 500,003 joints would take" in said
    assert peak < 200 * MIB


@LINUX
@pytest.mark.slow
def test_what_fits_is_baked_within_what_it_claims(tmp_path: Path) -> None:
    path = crowd(tmp_path / "crowd.glb", 150, 20)
    code, peak, said = taken("bake", path, "-o", tmp_path / "out.glb", "--max-memory", "200M")
    assert (code, said) == (0, "")
    assert peak < 280 * MIB


@pytest.mark.slow
@LINUX
def test_verify_keeps_to_max_memory(tmp_path: Path) -> None:
    baked(crowd(tmp_path / "crowd.glb", 100, 8), tmp_path / "baked.glb")
    assert taken("verify", tmp_path / "baked.glb", "--poses", "rest")[0] == 0
    code, peak, said = taken("verify", tmp_path / "baked.glb", "--max-memory", "100M")
    assert code == 3
    assert "--max-memory" in said
    assert peak < 200 * MIB


def test_a_mesh_that_is_drawn_more_often_than_its_file_is_long_is_not_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from skinbake.commands.verify import verify_file
    from skinbake.measure import scene
    from skinbake.measure.options import VerifyOptions

    baked(write_model(tmp_path / "in.glb", [sheet()]), tmp_path / "out.glb")
    assert verify_file(str(tmp_path / "out.glb"), VerifyOptions()).checks
    for most, poses in ((20 * 24, 24), (20 * 24 - 1, 23), (20 * 3, 3)):
        monkeypatch.setattr(scene, "SAMPLES", Limit(0, most))
        verdict = verify_file(str(tmp_path / "out.glb"), VerifyOptions())
        assert verdict.poses.startswith(f"{poses} random poses")
        assert [one.code for one in verdict.notices] == ["poses-left-out"] * (poses < 24)
    monkeypatch.setattr(scene, "SAMPLES", Limit(0, 20 * 3 - 1))
    with pytest.raises(InputError, match="60 vertices times poses"):
        verify_file(str(tmp_path / "out.glb"), VerifyOptions())


@pytest.mark.slow
def test_targets_that_are_sparse_alone_are_read(tmp_path: Path) -> None:
    """Two hundred targets of 20,000 vertices claim 48 MB of zeros, of a file of 1 MB."""
    from skinbake.gltf.reading.morphs import read_targets

    source = crowd(tmp_path / "in.gltf", 141, 1)
    root = json.loads(source.read_text())
    count = root["accessors"][root["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"]
    sparse = {
        "count": 1,
        "indices": {"bufferView": len(root["bufferViews"]), "componentType": 5121},
        "values": {"bufferView": len(root["bufferViews"]) + 1},
    }
    root["bufferViews"] += [{"buffer": 0, "byteLength": 1}, {"buffer": 0, "byteLength": 12}]
    first = len(root["accessors"])
    entry = {"componentType": 5126, "count": count, "type": "VEC3", "sparse": sparse}
    root["accessors"] += [entry] * 200
    root["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": first + n} for n in range(200)]
    source.write_text(json.dumps(root))
    document = read_document(str(source))
    (one,) = skinned_sources(document)
    held = document.budget.held
    found = read_targets(document, one, list(range(200)), count=count, tangents=False)
    assert found is not None
    assert len(found.targets) == 200
    assert document.budget.taken.zeros == 200 * count * 12
    assert document.budget.held < held + 1_000_000  # only what moves is kept


def test_influence_sets_past_all_measure_are_refused(tmp_path: Path) -> None:
    def repeat(content: JsonObject) -> None:
        attributes = content["meshes"][0]["primitives"][0]["attributes"]
        for number in range(1, MOST_SETS + 1):
            for kind in ("JOINTS", "WEIGHTS"):
                attributes[f"{kind}_{number}"] = attributes[f"{kind}_0"]

    document = read_document(str(write_model(tmp_path / "in.glb", [sheet()], change=repeat)))
    (source,) = skinned_sources(document)
    with pytest.raises(UnsupportedFeatureError, match="has 65 influence sets; the limit is 64"):
        read_primitive(document, source)


def sharing(attributes: JsonObject, note: JsonObject, primitives: int) -> Document:
    """Return a document of primitives that share accessors of 1,000 vertices, the first with metadata."""
    accessors: list[JsonObject] = [
        {"bufferView": 0, "componentType": code, "count": 1000, "type": "VEC4"} for code in (5121, 5121, 5126)
    ]
    accessors[0]["extras"] = {"skinbake": {"version": 1, **note}}
    accessors[1]["normalized"] = True
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 16_000}],
        "bufferViews": [{"buffer": 0, "byteLength": 16_000}],
        "accessors": accessors,
        "meshes": [{"primitives": [{"attributes": attributes}] * primitives}],
    }
    return parse_glb(pack_glb(content, bytes(16_000)), "x.glb", Path())


INFLUENCES = {"JOINTS_0": 0, "WEIGHTS_0": 1}
MANY_SETS = {name: value for n in range(40) for name, value in ((f"JOINTS_{n}", 0), (f"WEIGHTS_{n}", 1))}
STRAIGHTENED = {"straightened": {"TANGENT": 2, "digest": "x"}, "digest": {"TANGENT": "y"}}


@pytest.mark.parametrize(
    ("attributes", "note", "primitives", "claim"),
    [
        (INFLUENCES, {"adopted": {}, "digest": {}}, 40, "its digest"),
        (MANY_SETS, {"adopted": {}, "digest": {}}, 1, "its digest"),
        ({"TANGENT": 2, "_OURS": 0}, STRAIGHTENED, 40, "its digest"),
        ({"_OURS": 0}, {"alpha": ["x"] * 1000}, 40, "reading the metadata of accessor 0"),
        ({"_OURS": 0}, {"alpha": [[[]] * 1000]}, 40, "reading the metadata of accessor 0"),
    ],
)
def test_metadata_that_primitives_share_is_counted_at_each_use(
    attributes: JsonObject, note: JsonObject, primitives: int, claim: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of 1 MiB could let strip work for hours, or take any amount of memory."""
    few = sharing(dict(list(attributes.items())[-2:]), note, 1)
    document = sharing(attributes, note, primitives)
    monkeypatch.setattr(budgets, "MEMORY", Limit(1, 4_000_000))
    held = few.budget.held
    assert stripped(few)[1] == 1
    assert few.budget.held == held
    with pytest.raises(InputError, match=f"{claim} would take .* whatever --max-memory says"):
        stripped(document)


def test_channels_of_one_sampler_share_its_values(tmp_path: Path) -> None:
    def repeat(content: JsonObject) -> None:
        for animation in content["animations"]:
            animation["channels"] *= 50

    document = read_document(str(edited("bent_tube.glb", tmp_path, repeat)))
    (clip, *_) = read_clips(document)
    distinct = {(channel.path, id(channel.values)) for channel in clip.channels}
    assert len(clip.channels) == 50 * len(distinct)


def test_holes_shift_what_lies_behind_them() -> None:
    holes = [(4, 8), (20, 32), (40, 44)]
    shift = shift_of(holes)
    for position in range(60):
        assert shift(position) == sum(end - begin for begin, end in holes if begin < position)


def test_streams_that_share_accessors_are_compared_once_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.support.compressed import draco_twin

    count = 40

    def share(content: JsonObject) -> None:
        """Give each of many primitives a buffer view of its own of one stream."""
        mesh = content["meshes"][0]
        one = mesh["primitives"][0]
        extension = one["extensions"][draco.EXTENSION]
        view = content["bufferViews"][extension["bufferView"]]
        first = len(content["bufferViews"])
        content["bufferViews"] += [dict(view) for _ in range(count)]
        mesh["primitives"] = [
            {**one, "extensions": {draco.EXTENSION: {**extension, "bufferView": first + number}}}
            for number in range(count)
        ]

    document = read_document(str(draco_twin(FOLDER / "bent_tube.glb", tmp_path / "in.glb", change=share)))
    calls: list[object] = []
    read = draco.read_stream

    def counted(*given: Any) -> Any:
        calls.append(given)
        return read(*given)

    monkeypatch.setattr(draco, "read_stream", counted)
    sources = skinned_sources(document)
    attributes = len(sources[0].attributes)
    for source in sources:
        read_primitive(document, source)
    assert len(sources) == count
    assert count <= len(calls) <= count * (attributes + 1)


def test_streams_that_primitives_share_are_compared_within_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accessors of many primitives may stand for two streams, which are compared for each accessor."""
    from tests.support.compressed import draco_twin

    def share(content: JsonObject) -> None:
        mesh = content["meshes"][0]
        one = mesh["primitives"][0]
        former = one["extensions"][draco.EXTENSION]
        content["bufferViews"].append(content["bufferViews"][former["bufferView"]])
        now = {**former, "bufferView": len(content["bufferViews"]) - 1}
        now["extras"] = {"skinbake": {"before": former}}
        mesh["primitives"] = []
        for _ in range(40):
            first = len(content["accessors"])
            content["accessors"] += [content["accessors"][number] for number in one["attributes"].values()]
            primitive = {**one, "extensions": {draco.EXTENSION: now}, "extras": {"skinbake": {"version": 1}}}
            primitive["attributes"] = {name: first + at for at, name in enumerate(one["attributes"])}
            mesh["primitives"].append(primitive)

    document = read_document(str(draco_twin(FOLDER / "bent_tube.glb", tmp_path / "in.glb", change=share)))
    monkeypatch.setattr(budgets, "MEMORY", Limit(1, 1_000_000))
    with pytest.raises(InputError, match=r"Draco streams? would take .* whatever --max-memory says"):
        stripped(document)
