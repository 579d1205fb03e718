"""--skip-unchanged: nothing is done twice, and nothing is passed over that would come out differently."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import skinbake
from skinbake.commands.bake import bake_file
from skinbake.files.versions import YOUNG
from skinbake.jobs import state
from skinbake.jobs.state import HEADER, State
from tests.support.command_line import LINUX, document, invoke, run
from tests.support.gltf_reading import read
from tests.support.models import FIXTURES, FOLDER, SHARED, copied, rewritten, sheet, write_model

STATE = ".skinbake-state.jsonl"
TEXTURED = "textured.gltf"


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """Make a folder of models: GLBs, one that cannot be baked, and a .gltf with a buffer and pictures."""
    folder = tmp_path / "in"
    copied("seam.glb", folder)
    (folder / "deep").mkdir()
    shutil.copyfile(FOLDER / "two_sets.glb", folder / "deep" / "two_sets.glb")
    write_model(folder / "bare.glb", [sheet(NORMAL=None)])
    path = copied(SHARED, folder)
    model = read(path)
    model.content["images"] = [{"uri": "skin.png"}, {"uri": "later.png"}]
    (folder / "skin.png").write_bytes(b"red")
    path.unlink()
    rewritten(model, folder / TEXTURED)
    return folder


NAMES = ["bare.glb", "deep/two_sets.glb", "seam.glb", TEXTURED]


class Baking:
    """Bakes a folder into another, or in place, and tells what became of each file."""

    def __init__(self, folder: Path, out: Path, *target: str | Path) -> None:
        self.folder, self.out, self.target = folder, out, target

    def __call__(self, *options: str | Path) -> dict[str, str]:
        target = self.target or ("--out-dir", self.out)
        result = invoke("bake", self.folder, *target, "--skip-unchanged", "--json", *options)
        found = document(result)["files"]
        return {Path(file["input"]).relative_to(self.folder).as_posix(): file["status"] for file in found}


@pytest.fixture
def baking(models: Path, tmp_path: Path) -> Baking:
    return Baking(models, tmp_path / "out")


@pytest.fixture
def baking_in_place(models: Path, tmp_path: Path) -> Baking:
    return Baking(models, models, "--in-place", "--state", tmp_path / "notes" / "state")


FIRST = {"bare.glb": "unchanged", "deep/two_sets.glb": "baked", "seam.glb": "baked", TEXTURED: "baked"}
AGAIN = dict.fromkeys(NAMES, "up-to-date")


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    found = {path: path.stat() for path in folder.rglob("*") if path.is_file() and path.name != STATE}
    return {str(path): (stat.st_ino, stat.st_mtime_ns) for path, stat in found.items()}


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_what_is_unchanged_is_not_touched(jobs: str, baking: Baking, workers: list[int]) -> None:
    assert baking("--jobs", jobs) == FIRST
    before = stamps(baking.out)
    assert baking("--jobs", jobs) == AGAIN
    assert stamps(baking.out) == before


def test_what_is_up_to_date_is_said_in_words(models: Path, tmp_path: Path) -> None:
    command = ["bake", str(models), "--out-dir", str(tmp_path / "out"), "--skip-unchanged", "-v"]
    invoke(*command)
    result = invoke(*command)
    assert f"{models / 'seam.glb'} -> {tmp_path / 'out' / 'seam.glb'}: up to date\n" in result.stdout
    assert "4 files: 4 up to date, in " in result.stderr


def same_size(path: Path, old: bytes, new: bytes) -> None:
    """Change a file and give it back its size and times."""
    before, data = path.stat(), path.read_bytes()
    assert data.count(old) > 0
    assert len(old) == len(new)
    path.write_bytes(data.replace(old, new, 1))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_mtime_ns == before.st_mtime_ns


def flip(path: Path) -> None:
    data = path.read_bytes()
    same_size(path, data[-8:], bytes([data[-8] ^ 1]) + data[-7:])


def linked_away(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.with_name("elsewhere").write_bytes(b"other")
    path.symlink_to("elsewhere")


CHANGES: dict[str, tuple[str, Callable[[Path, Path], object]]] = {
    "an input, size and time restored": (
        "seam.glb",
        lambda i, o: same_size(i / "seam.glb", b'"name"', b'"NAME"'),
    ),
    "a buffer": (TEXTURED, lambda i, o: flip(i / "shared accessors.bin")),
    "a picture": (TEXTURED, lambda i, o: (i / "skin.png").write_bytes(b"blu")),
    "a picture gone": (TEXTURED, lambda i, o: (i / "skin.png").unlink()),
    "a picture that was missing": (TEXTURED, lambda i, o: (i / "later.png").write_bytes(b"now")),
    "a picture linked elsewhere": (TEXTURED, lambda i, o: linked_away(i / "skin.png")),
    "an output, size and time restored": ("seam.glb", lambda i, o: flip(o / "seam.glb")),
    "an output gone": ("seam.glb", lambda i, o: (o / "seam.glb").unlink()),
    "an output that is another's": (
        "seam.glb",
        lambda i, o: shutil.copyfile(o / "deep/two_sets.glb", o / "seam.glb"),
    ),
    "a copied file": ("bare.glb", lambda i, o: flip(o / "bare.glb")),
    "a picture beside an output": (TEXTURED, lambda i, o: (o / "skin.png").unlink()),
    "the buffer of an output": (TEXTURED, lambda i, o: flip(next(o.glob("skinbake-*.bin")))),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", CHANGES)
def test_whatever_changes_is_baked_again_and_nothing_else(what: str, baking: Baking, tmp_path: Path) -> None:
    name, change = CHANGES[what]
    baking()
    assert baking() == AGAIN
    change(baking.folder, baking.out)
    found = baking()
    assert found == AGAIN | {name: FIRST[name]}
    # And the outputs are those of a bake into an empty folder, as far as names go that nobody took.
    fresh = Baking(baking.folder, tmp_path / "fresh")
    fresh()
    ours, theirs = read(baking.out / name), read(fresh.out / name)
    if name.endswith(".glb"):
        assert (baking.out / name).read_bytes() == (fresh.out / name).read_bytes()
    for array in ("buffers", "images"):
        for mine, other in zip(ours.content.get(array, []), theirs.content.get(array, []), strict=True):
            if "uri" in other and (fresh.out / other["uri"]).exists():
                assert (baking.out / mine["uri"]).read_bytes() == (fresh.out / other["uri"]).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        ["--crease-angle", "20"],
        ["--weighting", "area"],
        ["--alpha-name", "_A{set}"],
        ["--encoding", "snorm16"],
        ["--weld", "skin"],
        ["--limit-influences", "4"],
        ["--warnings-as-errors"],
        ["--compress", "meshopt"],
    ],
)
def test_a_bake_with_changed_options_is_another_bake(options: list[str], baking: Baking) -> None:
    baking()
    found = baking(*options)
    assert "up-to-date" not in found.values()
    assert baking()["seam.glb"] == "baked"  # the outputs are those of the other options now
    assert baking()["seam.glb"] == "up-to-date"


def test_a_folder_that_may_be_read_too_is_another_bake(tmp_path: Path) -> None:
    """A picture outside stays a file. The notice names the option that packs it."""
    folder = tmp_path / "models"
    path = copied("seam.glb", folder)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "red.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(5000))
    model = read(path)
    model.content["images"] = [{"uri": "../pictures/red.png"}]
    path.unlink()
    rewritten(model, path)
    baking = Baking(folder, tmp_path / "out")
    assert baking("--pack") == {"seam.glb": "baked"}
    assert baking("--pack") == {"seam.glb": "up-to-date"}
    before = (tmp_path / "out" / "seam.glb").stat().st_size
    allowed = ("--pack", "--allow-outside", tmp_path / "pictures")
    assert baking(*allowed) == {"seam.glb": "baked"}
    assert (tmp_path / "out" / "seam.glb").stat().st_size > before + 4000
    assert baking(*allowed) == {"seam.glb": "up-to-date"}


@pytest.mark.slow
def test_a_bake_by_another_version_is_another_bake(baking: Baking, monkeypatch: pytest.MonkeyPatch) -> None:
    baking()
    monkeypatch.setattr(state, "__version__", "0.1.1")
    assert baking() == FIRST


@pytest.mark.slow
def test_a_bake_by_changed_code_of_one_version_is_another_bake(
    baking: Baking, monkeypatch: pytest.MonkeyPatch
) -> None:
    baking()
    code = state.code_digest()
    monkeypatch.setattr(state, "code_digest", lambda: code[::-1])
    assert baking() == FIRST


@pytest.mark.slow
def test_the_code_is_all_that_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = tmp_path / "skinbake"
    shutil.copytree(Path(skinbake.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    before = state.code_digest()
    monkeypatch.setattr(state, "__file__", str(copy / "jobs" / "state.py"))
    assert state.code_digest() == before
    for changed in ("gradients/weight_gradients.py", "shaders/templates"):
        path = copy / changed
        file = path if path.is_file() else next(p for p in sorted(path.rglob("*")) if p.is_file())
        file.write_bytes(file.read_bytes() + b" ")
        assert state.code_digest() != before
        before = state.code_digest()


@pytest.mark.slow
def test_a_tree_that_moves_as_a_whole_stays_up_to_date(baking: Baking, tmp_path: Path) -> None:
    baking()
    (tmp_path / "moved").mkdir()
    for folder in (baking.folder, baking.out):
        shutil.move(folder, tmp_path / "moved" / folder.name)
    moved = Baking(tmp_path / "moved" / "in", tmp_path / "moved" / "out")
    assert moved() == AGAIN
    shutil.copytree(moved.folder, tmp_path / "moved" / "other")
    assert Baking(tmp_path / "moved" / "other", moved.out)() == FIRST  # from elsewhere, URIs may differ


@pytest.mark.slow
def test_an_output_of_another_name_is_another_output(models: Path, tmp_path: Path) -> None:
    options = ["--skip-unchanged", "--state", str(tmp_path / "state"), "--json"]
    for name, status in (
        ("a.glb", "baked"),
        ("a.glb", "up-to-date"),
        ("b.glb", "baked"),
        ("a.glb", "up-to-date"),
    ):
        result = invoke("bake", models / "seam.glb", "-o", tmp_path / name, *options)
        assert document(result)["files"][0]["status"] == status


def test_a_file_without_a_bake_is_verified_each_time(models: Path, tmp_path: Path) -> None:
    options = ["--skip-unchanged", "--state", str(tmp_path / "state")]
    said = [invoke("verify", models / "seam.glb", *options).output for _ in range(2)]
    assert "nothing in it is baked" in said[0]
    assert said[1] == said[0]


class TestInPlace:
    def test_what_was_baked_in_place_is_its_own_input(self, baking_in_place: Baking) -> None:
        assert baking_in_place() == FIRST
        before = stamps(baking_in_place.folder)
        assert baking_in_place() == AGAIN
        assert stamps(baking_in_place.folder) == before

    @pytest.mark.slow
    def test_what_is_replaced_is_baked_again(self, baking_in_place: Baking) -> None:
        baking_in_place()
        shutil.copyfile(FOLDER / "seam.glb", baking_in_place.folder / "seam.glb")
        assert baking_in_place() == AGAIN | {"seam.glb": "baked"}
        next(baking_in_place.folder.glob("skinbake-*.bin")).write_bytes(b"")
        assert baking_in_place()[TEXTURED] != "up-to-date"

    @pytest.mark.slow
    def test_changed_options_bake_in_place_again(self, baking_in_place: Baking) -> None:
        baking_in_place()
        assert baking_in_place("--weighting", "area") == FIRST
        assert baking_in_place("--weighting", "area") == AGAIN
        assert baking_in_place() == FIRST


class TestWhileItRuns:
    """A change by others, right after ``bake_file``."""

    @pytest.fixture
    def then(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[str, str], object]], None]:
        def follow(what: Callable[[str, str], object]) -> None:
            def both(source: str, target: str, *rest: Any) -> Any:
                result = bake_file(source, target, *rest)
                what(source, target)
                return result

            monkeypatch.setattr("skinbake.jobs.bake.bake_file", both)

        return follow

    @pytest.mark.slow
    @pytest.mark.parametrize("place", ["out", "in"])
    def test_an_output_that_somebody_else_has_overwritten_is_not_ours(
        self,
        place: str,
        baking: Baking,
        baking_in_place: Baking,
        then: Callable[[Callable[[str, str], object]], None],
    ) -> None:
        one = baking if place == "out" else baking_in_place
        then(lambda source, target: shutil.copyfile(FOLDER / "weights_u8.glb", target))
        one()
        then(lambda source, target: None)
        assert "up-to-date" not in one().values()

    @pytest.mark.slow
    def test_a_picture_that_somebody_else_has_overwritten_is_not_ours(
        self, baking: Baking, then: Callable[[Callable[[str, str], object]], None]
    ) -> None:
        picture = baking.out / "skin.png"
        then(lambda source, target: TEXTURED in source and picture.write_bytes(b"bad"))
        baking()
        then(lambda source, target: None)
        assert baking()[TEXTURED] == "baked"

    @pytest.mark.slow
    @pytest.mark.parametrize("young", [0, YOUNG])
    def test_an_input_that_changes_meanwhile_is_not_the_one_that_was_read(
        self,
        young: int,
        baking: Baking,
        then: Callable[[Callable[[str, str], object]], None],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(state, "YOUNG", young)
        sources = {name: (baking.folder / name).read_bytes() for name in NAMES}

        def change(source: str, target: str) -> None:
            if source.endswith(".glb"):
                shutil.copyfile(FOLDER / "weights_u8.glb", source)
            else:
                flip(baking.folder / "shared accessors.bin")

        then(change)
        baking()
        then(lambda source, target: None)
        for name, data in sources.items():
            (baking.folder / name).write_bytes(data)
        flip(baking.folder / "shared accessors.bin")
        assert "up-to-date" not in baking().values()

    def test_an_interrupt_keeps_what_was_done(self, baking: Baking, monkeypatch: pytest.MonkeyPatch) -> None:
        def interrupted(source: str, target: str, *rest: Any) -> Any:
            if "seam" in source:
                raise KeyboardInterrupt
            return bake_file(source, target, *rest)

        monkeypatch.setattr("skinbake.jobs.bake.bake_file", interrupted)
        result = run_interrupted(baking)
        assert "interrupted after 2 of 4 files: 1 baked, 1 unchanged" in result
        monkeypatch.undo()
        assert baking() == FIRST | {"bare.glb": "up-to-date", "deep/two_sets.glb": "up-to-date"}


def run_interrupted(baking: Baking) -> str:
    """Bake in this process, with an interrupt, and return what is said."""
    from click.testing import CliRunner

    from skinbake.cli.main import main

    arguments = ["bake", str(baking.folder), "--out-dir", str(baking.out), "--skip-unchanged"]
    return CliRunner().invoke(main, arguments, prog_name="skinbake").stderr


@pytest.mark.slow
@LINUX
def test_two_runs_at_once_with_other_options_tell_no_lies(tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for number in range(40):
        shutil.copyfile(FOLDER / "two_sets.glb", folder / f"{number:02}.glb")
    command = [sys.executable, "-m", "skinbake", "bake", str(folder), "--skip-unchanged", "-q", "--out-dir"]
    kinds: list[list[str]] = [[], ["--weighting", "area"]]
    for _ in range(2):
        both = [subprocess.Popen([*command, str(out), *options]) for options in kinds]
        assert [process.wait(120) for process in both] == [0, 0]
    for number, options in enumerate(kinds):
        subprocess.run([*command, str(out), *options], check=True)
        alone = tmp_path / f"alone{number}"
        subprocess.run([*command, str(alone), *options], check=True)
        assert {path.name: path.read_bytes() for path in out.glob("*.glb")} == {
            path.name: path.read_bytes() for path in alone.glob("*.glb")
        }


def test_failures_are_tried_again(models: Path, tmp_path: Path) -> None:
    (models / "broken.glb").touch()
    baking = Baking(models, tmp_path / "out")
    assert baking()["broken.glb"] == "failed"
    assert baking() == AGAIN | {"broken.glb": "failed"}
    assert "--require-baked" not in (tmp_path / "out" / STATE).read_text()


@pytest.mark.slow
def test_a_dry_run_tells_and_keeps_nothing(baking: Baking) -> None:
    assert baking("--dry-run") == FIRST
    assert not baking.out.exists()
    baking()
    before = (baking.out / STATE).read_bytes()
    assert baking("--dry-run") == AGAIN
    (baking.folder / "seam.glb").write_bytes((FOLDER / "weights_u8.glb").read_bytes())
    assert baking("--dry-run") == AGAIN | {"seam.glb": "baked"}
    assert (baking.out / STATE).read_bytes() == before


class TestTheStateFile:
    def test_skip_unchanged_needs_a_state_file(self, models: Path, tmp_path: Path) -> None:
        needed, folder = (
            "--skip-unchanged needs --state FILE, to keep its notes in",
            "--out-dir it needs none",
        )
        for arguments, has_folder in (
            (["bake", models / "seam.glb", "-o", tmp_path / "a.glb"], True),
            (["bake", models, "--in-place"], True),
            (["verify", models], False),
        ):
            result = invoke(*map(str, arguments), "--skip-unchanged")
            assert result.exit_code == 2
            assert needed in result.stderr
            assert (folder in result.stderr) == has_folder
        result = invoke("bake", models, "--out-dir", tmp_path / "o", "--state", tmp_path / "state")
        assert (result.exit_code, "--state is for --skip-unchanged" in result.stderr) == (2, True)

    def test_a_batch_goes_on_without_another_program_s_file(self, models: Path, tmp_path: Path) -> None:
        other, out = tmp_path / "precious.txt", tmp_path / "out"
        other.write_text("not a state file\n", encoding="utf-8")
        options = ["--out-dir", str(out), "--skip-unchanged", "--state", str(other), "--warnings-as-errors"]
        for _ in range(2):
            result = invoke("bake", models / "seam.glb", *options)
            assert result.exit_code == 0
            assert result.stderr.count("warning: ") == 1
            assert f"{other}: it is not a state file of skinbake" in result.stderr
            assert "seam.glb: baked" in result.stdout
            assert other.read_text(encoding="utf-8") == "not a state file\n"
            assert [path.name for path in out.iterdir()] == ["seam.glb"]

    def test_a_damaged_one_begins_anew(self, models: Path, tmp_path: Path) -> None:
        path = tmp_path / "out" / STATE
        options = ["--out-dir", str(tmp_path / "out"), "--skip-unchanged"]
        for damage, words in ((HEADER, ""), (b"\0" * 99, "a new one begins"), (None, "")):
            if damage is not None:
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(damage)
            result = invoke("bake", models / "seam.glb", *options)
            assert result.exit_code == 0
            assert ("warning: " in result.stderr, words in result.stderr) == (bool(words), True)
            assert ("up to date" in result.stdout) == (damage is None)
            assert path.read_bytes().startswith(HEADER)

    @pytest.mark.slow
    @LINUX
    def test_where_it_cannot_be_written_files_are_baked_all_the_same(
        self, models: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "state").symlink_to(tmp_path / "nowhere" / "state")
        options = ["--skip-unchanged", "--state", str(tmp_path / "state")]
        process = run("bake", models, "--out-dir", tmp_path / "out", *options)
        assert process.returncode == 4
        assert process.stderr.count(b"error: ") == 1
        assert (tmp_path / "out" / "seam.glb").exists()

    @pytest.mark.slow
    @pytest.mark.parametrize("damage", ["cut", "garbage", "empty", "foreign line"])
    def test_a_damaged_record_costs_a_bake(self, damage: str, baking: Baking) -> None:
        baking()
        path = baking.out / STATE
        lines = path.read_bytes().splitlines(keepends=True)
        assert lines[0] == HEADER
        changed = {
            "cut": b"".join(lines)[:-20],
            "garbage": b"".join([*lines[:-1], b"\xff\xfe\x00{}\n"]),
            "empty": b"",
            "foreign line": b"".join([*lines[:-1], b'{"key": 3}\n[]\n"x"\n{"key": "bake textured.gltf"}\n']),
        }[damage]
        path.write_bytes(changed)
        found = baking()
        assert found == (FIRST if damage == "empty" else AGAIN | {TEXTURED: "baked"})
        assert baking() == AGAIN

    @pytest.mark.slow
    def test_records_that_lie_about_digests_are_not_believed(self, baking: Baking) -> None:
        baking()
        path = baking.out / STATE
        for key in ("read", "made", "how", "from"):
            notes = [json.loads(line) for line in path.read_bytes().splitlines()[1:]]
            for note in notes:
                note[key] = dict.fromkeys(note[key], "0" * 32) if isinstance(note[key], dict) else "0" * 32
            path.write_bytes(HEADER + b"".join(json.dumps(note).encode() + b"\n" for note in notes))
            assert baking() == FIRST

    def test_superseded_records_go_when_they_are_many(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(state, "SPARE", 10)
        path = tmp_path / "state"
        for number in range(30):
            notes = State(str(path))
            notes.add(json.dumps({"key": f"bake {number % 3}", "n": number}).encode() + b"\n")
            notes.close()
        lines = path.read_bytes().splitlines(keepends=True)
        assert lines[0] == HEADER
        assert len(lines) < 20
        kept = State(str(path))
        assert [json.loads(kept.known(f"bake {n}") or b"")["n"] for n in range(3)] == [27, 28, 29]
        assert [entry.name for entry in tmp_path.iterdir()] == ["state"]

    @pytest.mark.parametrize("name", [".", os.devnull])
    def test_only_a_file_can_be_one(self, name: str, tmp_path: Path) -> None:
        found = State(str(tmp_path / name))
        assert [notice.code for notice in found.notices] == ["state-foreign"]
        found.add(b'{"key": "a"}\n')
        found.close()
        assert not list(tmp_path.iterdir())


class TestVerify:
    @pytest.fixture
    def verify(self, tmp_path: Path) -> Callable[..., dict[str, tuple[bool, bool]]]:
        bad, good = tmp_path / "built" / "bad.glb", tmp_path / "built" / "good.glb"
        invoke("bake", FOLDER / "seam.glb", "--out-dir", tmp_path / "built")
        (tmp_path / "built" / "seam.glb").rename(good)
        shutil.copyfile(good, bad)
        model = read(bad)
        model.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["version"] = 99
        rewritten(model, bad)
        options = ["--poses", "rest", "--skip-unchanged", "--state", str(tmp_path / "state"), "--json"]

        def verified(*more: str) -> dict[str, tuple[bool, bool]]:
            found = document(invoke("verify", tmp_path / "built", *options, *more))
            return {Path(f["input"]).name: (f["passed"], f["up_to_date"]) for f in found["files"]}

        return verified

    def test_what_passed_is_not_verified_again_what_failed_is(
        self, verify: Callable[..., dict[str, tuple[bool, bool]]]
    ) -> None:
        assert verify() == {"bad.glb": (False, False), "good.glb": (True, False)}
        assert verify() == {"bad.glb": (False, False), "good.glb": (True, True)}

    @pytest.mark.slow
    def test_changed_limits_and_changed_bytes_are_verified_again(
        self, verify: Callable[..., dict[str, tuple[bool, bool]]], tmp_path: Path
    ) -> None:
        verify()
        assert verify("--max-mean-error", "50")["good.glb"] == (True, False)
        assert verify("--max-mean-error", "50")["good.glb"] == (True, True)
        assert verify("--max-mean-error", "0")["good.glb"] == (False, False)
        flip(tmp_path / "built" / "good.glb")
        assert verify()["good.glb"][1] is False

    @pytest.mark.slow
    def test_bake_and_verify_may_share_a_state_file(
        self, verify: Callable[..., dict[str, tuple[bool, bool]]], tmp_path: Path
    ) -> None:
        verify()
        options = ["--skip-unchanged", "--state", str(tmp_path / "state"), "--json"]
        for status in ("baked", "up-to-date"):
            result = invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / "built" / "good.glb", *options)
            assert document(result)["files"][0]["status"] == status
        assert verify()["good.glb"] == (True, True)  # baked anew, it has the bytes that passed


@pytest.mark.slow
def test_every_fixture_is_up_to_date_after_its_bake(tmp_path: Path) -> None:
    inputs = [FOLDER / name for name in FIXTURES]
    for status in ("baked", "up-to-date"):
        result = invoke("bake", *inputs, "--out-dir", tmp_path, "--skip-unchanged", "--json")
        assert {file["status"] for file in document(result)["files"]} == {status}


@pytest.mark.parametrize("in_place", [False, True])
def test_a_buffer_above_a_subfolder_is_a_file_of_the_build(in_place: bool, tmp_path: Path) -> None:
    source = tmp_path / "art" / "sub" / "seam.gltf"
    source.parent.mkdir(parents=True)
    model = read(FOLDER / "seam.glb")
    (tmp_path / "art" / "shared.bin").write_bytes(model.buffer(0))
    model.content["buffers"][0]["uri"] = "../shared.bin"
    source.write_text(json.dumps(model.content))
    target: list[str | Path] = ["--in-place"] if in_place else ["--out-dir", tmp_path / "build"]
    state: list[str | Path] = ["--skip-unchanged", "--state", tmp_path / "state", "--json"]
    statuses = []
    for _ in range(3):
        result = invoke("bake", tmp_path / "art", *target, *state)
        assert result.exit_code == 0, result.output
        statuses.append(document(result)["files"][0]["status"])
    assert statuses[-1] == "up-to-date"
    assert in_place or statuses == ["baked", "up-to-date", "up-to-date"]


@pytest.mark.slow
def test_streams_are_read_and_written_each_time(tmp_path: Path) -> None:
    seam, notes = FOLDER / "seam.glb", ["--skip-unchanged", "--state", str(tmp_path / "state")]
    for _ in range(2):
        process = run("bake", "-", "-o", tmp_path / "out.glb", *notes, stdin=seam.read_bytes())
        assert (process.returncode, b"baked: 1 primitive" in process.stdout) == (0, True)
        process = run("bake", seam, "-o", "-", *notes)
        assert process.stdout == (tmp_path / "out.glb").read_bytes()
        process = run("verify", "-", "--poses", "rest", "-v", *notes, stdin=process.stdout)
        assert (process.returncode, b"structure  passed" in process.stdout) == (0, True)
