"""The judges of the fuzzer: each sees the defects that it is for, and a case depends on its seed alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fuzz import batches
from fuzz.aimed import aimed_cases
from fuzz.batches import keep
from fuzz.cases import Case, load, make_case
from fuzz.models import GLB, read_model
from fuzz.replay import smaller
from fuzz.running import Find
from fuzz.seeds import plain_seeds
from fuzz.watching import Watch
from skinbake.cli.main import COMMANDS

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
MODELS = [read_model(path) for path in sorted(FIXTURES.glob("*.gl[bt]*"))]

PROGRAM = """
import json, logging, os, sys, warnings
from pathlib import Path
from fuzz.cases import Case
from fuzz.running import Runner
import skinbake.cli.main

for number, body in enumerate(json.loads(sys.argv[2])):
    skinbake.cli.main.entry_point = lambda: exec(body)
    runner = Runner(Path(sys.argv[1], str(number)))
    outcome, finds = runner.run(Case(1, ("inspect", "in/m.glb"), {"m.glb": b"glTF"}))
    print(json.dumps(sorted({find.kind for find in finds})))
"""

BROKEN = {
    "raise KeyError(1)": ["defect", "exit"],
    "sys.exit(5)": ["exit"],
    "warnings.warn('odd', RuntimeWarning)": ["defect", "exit"],
    "logging.getLogger('skinbake').debug('x', exc_info=ValueError('x'))": ["defect"],
    "print('error: skinbake failed where it should not: x', file=sys.stderr)": ["defect"],
    "print('\\x1b]0;title', file=sys.stderr)": ["escape"],
    "Path('out/x.glb').write_bytes(b'')": ["written"],
    "Path('out/.skinbake-00.tmp').write_bytes(b'')": ["leftover", "written"],
    "Path('in/m.glb').read_bytes()": [],
    "Path('in/m.glb').write_bytes(b'')": ["input", "outside"],
    "Path('secret.bin').read_bytes()": ["outside"],
    "Path('in/../secret.bin').read_bytes()": ["outside"],
    "Path('new').write_bytes(b'')": ["outside"],
    "os.rename('in/m.glb', 'moved')": ["input", "outside"],
    "sys.stdout.write('SKINBAKE-SECRET: this was outside of the folder of the model')": ["secret"],
    "Path('out/report.html').write_text('<!doctype html><script>1</script>')": [],
    "Path('out/report.html').write_text('<!doctype html><script>1</script><script>2</script>')": ["markup"],
    "bytearray(700 << 20)": ["memory"],
}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The finds of each; in a process of its own, for an audit hook can never be taken away."""
    repository = Path(__file__).resolve().parents[2]
    # A small process starts it, since a new one counts the memory of its parent as its own at first.
    command = [sys.executable, "-I", "-S", str(repository / "benchmarks" / "launch.py"), sys.executable, "-c"]
    process = subprocess.run(
        [*command, PROGRAM, str(tmp_path_factory.mktemp("judges")), json.dumps(list(BROKEN))],
        capture_output=True,
        text=True,
        cwd=repository,
        env={**os.environ, "PYTHONPATH": str(repository)},
        check=True,
    )
    lines = process.stdout.splitlines()[: len(BROKEN)]
    return dict(zip(BROKEN, map(json.loads, lines), strict=True))


@pytest.mark.parametrize("body", BROKEN)
def test_a_judge_sees_what_is_broken(body: str, found: dict[str, list[str]]) -> None:
    if sys.platform != "linux" and "bytearray" in body:
        pytest.skip("ru_maxrss counts in other units")
    assert found[body] == BROKEN[body]


def test_a_case_is_its_seeds() -> None:
    assert [make_case(seed, MODELS) for seed in range(50)] == [make_case(seed, MODELS) for seed in range(50)]


@pytest.mark.slow
def test_seeds_give_many_kinds_of_cases() -> None:
    cases = [make_case(seed, MODELS) for seed in range(400)]
    assert {case.arguments[0] for case in cases} == set(COMMANDS) - {"example", "cost"}  # these read no file
    options = {word for case in cases for word in case.arguments if word.startswith("--")}
    assert {
        "--compress",
        "--layout",
        "--weld",
        "--limit-influences",
        "--in-place",
        "--state",
        "--html",
    } <= options
    assert len({case.about.split(": ")[1] for case in cases}) > 50
    assert any(case.links for case in cases)


def test_a_case_is_kept_whole_and_once(tmp_path: Path) -> None:
    case = Case(
        7, ("bake", "in/m.glb"), {"m.glb": b"12345678", "../out/s": b"\0"}, {"l": ".."}, b"in", True, "x"
    )
    names = {keep(tmp_path, case, Find("defect", "KeyError a.py:f:1", "text")) for _ in range(2)}
    assert len(names) == 1
    assert load(tmp_path / names.pop()) == case


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the processor's time is read from /proc")
@pytest.mark.parametrize(
    ("program", "hangs"), [("while True: pass", True), ("import time; time.sleep(60)", False)]
)
def test_only_what_has_the_processor_hangs(
    program: str, hangs: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A silent child that waits is given more time: the machine may have no processor for it."""
    monkeypatch.setattr(batches, "HANG_SECONDS", 1.0)
    monkeypatch.setattr(batches, "CPU_SECONDS", 0.3)
    with subprocess.Popen([sys.executable, "-c", program]) as child:
        try:
            at_work = batches._Batch(child.pid, 0, 0, 1, time.monotonic(), tmp_path / "faults")
            assert not batches._hangs(at_work)
            found, end = False, time.monotonic() + (60 if hangs else 4)
            while not found and time.monotonic() < end:
                time.sleep(0.2)
                found = batches._hangs(at_work)
            assert found == hangs
            at_work.heard -= batches.PATIENCE
            assert batches._hangs(at_work)
        finally:
            child.kill()


@pytest.mark.slow
def test_aimed_cases_end_in_documented_ways(tmp_path: Path) -> None:
    """Each aimed case is a seed below 0, and runs before all others."""
    models = [model for model in plain_seeds() if "directed" in model.name][:2]
    aimed = aimed_cases(models)
    plan = batches.Plan(models, 5, 60.0, 1, most=1, finds=tmp_path, aimed=aimed)
    assert [plan.case(seed) for seed in range(-1, -4, -1)] == aimed[:3]
    assert plan.case(5) == make_case(5, models)
    assert len({(case.about, case.arguments) for case in aimed}) == len(aimed)


def test_a_case_is_cut_down_to_what_its_find_needs() -> None:
    _, files = MODELS[0].packed(GLB)
    case = Case(1, ("inspect", "in/m.glb"), {**files, "other.bin": b"x"})
    find = Find("defect", "here", "")

    def judge(candidate: Case) -> list[Find]:
        return [find] if b'"skins"' in candidate.files.get("m.glb", b"") else []

    small = smaller(case, find, judge)
    assert list(small.files) == ["m.glb"]
    assert judge(small) == [find]
    assert b'"meshes"' not in small.files["m.glb"]


@pytest.mark.skipif(sys.platform == "win32", reason="paths of POSIX")
@pytest.mark.parametrize(
    ("path", "mode", "allowed"),
    [
        ("/r/in/m.glb", "rb", True),
        ("/r/in/../secret", "rb", False),
        ("/r/in/m.glb", "wb", False),
        ("/r/out/m.glb", "wb", True),
        ("/r/outer/m.glb", "wb", False),
        ("/etc/passwd", "rb", False),
        (os.__file__, "rb", True),
        (os.__file__, "ab", False),
    ],
)
def test_what_a_run_may_open(path: str, mode: str, allowed: bool) -> None:
    watch = Watch("/r/in", "/r/out", replaces_inputs=False)
    watch.see("open", (path, mode, 0))
    assert (not watch.broken) == allowed
