"""Several files at once: below a folder, durable, and in no other's way; nothing is left of a failure."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from skinbake.choices import Encoding
from skinbake.errors import OutputError
from skinbake.files import folders, replacing, temporary, versions, writing
from skinbake.files.temporary import temporary_name
from skinbake.files.versions import signature_of, version_of
from skinbake.files.writing import TakenError, write_file, write_files
from skinbake.gltf.document import read_document
from skinbake.gltf.writing import output
from skinbake.gltf.writing.output import plan_output
from skinbake.signals import interrupts_put_off
from tests.support.baking import bake_file
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, copied

if sys.platform == "win32":
    pytest.skip("needs the links, locks and signals of POSIX", allow_module_level=True)

SEAM, TUBE = FOLDER / "seam.glb", FOLDER / "bent_tube.glb"
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink()
    }


@pytest.fixture(autouse=True)
def _folders_are_new() -> Iterator[None]:
    """Folders of one test have identities that those of another had."""
    temporary._looked_through.clear()
    yield


@pytest.mark.parametrize("most", [1, 3, 4, 7])
def test_a_system_that_takes_a_part_of_the_bytes_gets_the_rest_too(
    most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linux writes at most 2 GiB in one call, and less to a disk that is nearly full."""
    pieces: list[bytes | memoryview] = [b"", b"abcd", memoryview(b"ef"), b"ghijklm"]
    monkeypatch.setattr(
        os, "writev", lambda descriptor, left: os.write(descriptor, b"".join(left)[:most]), raising=False
    )
    write_file(pieces, str(tmp_path / "a.txt"))
    assert (tmp_path / "a.txt").read_bytes() == b"abcdefghijklm"


def test_of_young_files_only_small_ones_are_digested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A digest reads the whole file."""
    path = tmp_path / "a.glb"
    path.write_bytes(b"12345678")
    monkeypatch.setattr(versions, "YOUNG", 10**18)
    for cheap, is_digested in ((7, False), (8, True)):
        monkeypatch.setattr(versions, "CHEAP", cheap)
        assert (version_of(str(path)).digest is not None) is is_digested


@pytest.fixture(params=["descriptors", "paths"])
def by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways: relative to open folders, and by paths, as on Windows."""
    if request.param == "paths":
        monkeypatch.setattr(folders, "BY_DESCRIPTOR", False)
        monkeypatch.setattr(writing, "BY_DESCRIPTOR", False)
        rename = os.rename

        def as_on_windows(source: str, goal: str) -> None:
            if os.path.lexists(goal):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
            rename(source, goal)

        monkeypatch.setattr(os, "rename", as_on_windows)
    return str(request.param)


class TestBelowTheRoot:
    def test_files_and_folders_are_made(self, tmp_path: Path, by: str) -> None:
        root = tmp_path / "out" / "deep"
        files = {root / "a" / "b" / "x.bin": [b"be", b"side"], root / "c.gltf": [b"target"]}
        write_files(root, files, "c.gltf")
        assert contents(root) == {"a/b/x.bin": b"beside", "c.gltf": b"target"}

    @pytest.mark.parametrize("name", ["../x", "a/../../x", ".", "/etc/x"])
    def test_a_path_outside_is_refused(self, name: str, tmp_path: Path, by: str) -> None:
        root = tmp_path / "out"
        root.mkdir()
        with pytest.raises(OutputError, match="is not below"):
            write_files(root, {root / name: [b"x"], root / "t": [b"y"]}, "t")
        assert contents(tmp_path) == {}

    @pytest.mark.parametrize("absolute", [True, False])
    def test_a_linked_folder_does_not_lead_out(self, absolute: bool, tmp_path: Path, by: str) -> None:
        root, home = tmp_path / "out", tmp_path / "home"
        root.mkdir()
        home.mkdir()
        (home / "key").write_bytes(b"victim")
        (root / "tex").symlink_to(home if absolute else "../home")
        with pytest.raises(OutputError, match="link leads out"):
            write_files(root, {root / "tex" / "key": [b"attacker"], root / "t": [b"y"]}, "t")
        assert contents(home) == {"key": b"victim"}
        assert contents(root) == {}

    @pytest.mark.parametrize("place", ["beside", "target"])
    def test_a_linked_file_is_not_written_through(self, place: str, tmp_path: Path, by: str) -> None:
        root, home = tmp_path / "out", tmp_path / "home"
        root.mkdir()
        home.write_bytes(b"victim")
        (root / place).symlink_to(home)
        files = {root / "beside": [b"attacker"], root / "target": [b"y"]}
        if place == "beside":
            with pytest.raises(TakenError):
                write_files(root, files, "target")
        else:
            write_files(root, files, "target")
        assert home.read_bytes() == b"victim"

    def test_a_link_inside_the_root_is_followed(self, tmp_path: Path) -> None:
        (tmp_path / "real").mkdir()
        (tmp_path / "tex").symlink_to("real")
        write_files(tmp_path, {tmp_path / "tex" / "a": [b"1"], tmp_path / "t": [b"2"]}, "t")
        assert (tmp_path / "real" / "a").read_bytes() == b"1"

    def test_a_folder_swapped_for_a_link_meanwhile_stays_the_one_that_was_opened(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        root, home = tmp_path / "out", tmp_path / "home"
        (root / "tex").mkdir(parents=True)
        home.mkdir()
        original = os.link

        def swapped(*arguments: Any, **options: Any) -> None:
            if not (root / "tex").is_symlink():
                (root / "tex").rename(root / "moved")
                (root / "tex").symlink_to(home)
            original(*arguments, **options)

        monkeypatch.setattr(os, "link", swapped)
        write_files(root, {root / "tex" / "a": [b"1"], root / "t": [b"2"]}, "t")
        assert contents(home) == {}
        assert (root / "moved" / "a").read_bytes() == b"1"

    def test_a_hostile_image_writes_nothing_outside(self, tmp_path: Path) -> None:
        """The model ships a folder "x#": to the check it was a fragment, to the open a folder."""
        model = tmp_path / "job" / "model"
        (model / "x#").mkdir(parents=True)
        for folder, data in (("job", b"attacker"), ("home", b"victim")):
            (tmp_path / folder / ".ssh").mkdir(parents=True, exist_ok=True)
            (tmp_path / folder / ".ssh" / "keys").write_bytes(data)
        (tmp_path / "home" / "build").mkdir()
        uri = "x#/../../.ssh/keys"
        text = json.dumps({"asset": {"version": "2.0"}, "images": [{"uri": uri}]})
        (model / "a.gltf").write_text(text, encoding="utf-8")
        bake_file(str(model / "a.gltf"), str(tmp_path / "home" / "build" / "a.gltf"))
        assert (tmp_path / "home" / ".ssh" / "keys").read_bytes() == b"victim"


class TestDurable:
    @LINUX
    def test_every_file_and_folder_is_synced_before_it_counts(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Files before they have their names, folders after; each folder that got a name."""
        told: list[str] = []

        def synced(descriptor: int) -> None:
            told.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))

        def named(kind: str) -> Callable[..., None]:
            original = getattr(os, kind)

            def wrapped(*arguments: Any, **options: Any) -> None:
                told.append(f"{kind} {arguments[1]}")
                original(*arguments, **options)

            return wrapped

        monkeypatch.setattr(os, "fsync", synced)
        monkeypatch.setattr(os, "link", named("link"))
        monkeypatch.setattr(os, "replace", named("replace"))
        root = tmp_path / "new"
        write_files(root, {root / "a" / "b" / "x": [b"1"], root / "t": [b"2"]}, "t")
        files, names, folders = told[:2], told[2:4], told[4:]
        assert [Path(path).parent for path in files] == [root / "a" / "b", root]
        assert names == ["link x", "replace t"]
        assert sorted(folders) == sorted(map(str, [tmp_path, root, root / "a", root / "a" / "b"]))

    def test_syncing_can_be_left_out(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refused(descriptor: int) -> None:
            raise AssertionError

        monkeypatch.setattr(os, "fsync", refused)
        write_file([b"x"], str(tmp_path / "a"), sync=False)
        with pytest.raises(AssertionError):
            write_file([b"x"], str(tmp_path / "b"))

    def test_a_temporary_name_that_cannot_be_removed_is_undone(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        original, calls = os.unlink, []

        def failing(*arguments: Any, **options: Any) -> None:
            calls.append(arguments)
            if len(calls) == 1:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            original(*arguments, **options)

        monkeypatch.setattr(os, "unlink", failing)
        with pytest.raises(OutputError, match="Input/output error"):
            write_files(tmp_path, {tmp_path / "x": [b"1"], tmp_path / "t": [b"2"]}, "t")
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("call", [1, 2, 3, 4])
    def test_a_disk_that_fails_is_an_output_error(
        self, call: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        calls = []

        def failing(descriptor: int) -> None:
            calls.append(descriptor)
            if len(calls) == call:
                raise OSError(errno.EIO, os.strerror(errno.EIO))

        monkeypatch.setattr(os, "fsync", failing)
        files = {tmp_path / "a" / "x": [b"1"], tmp_path / "t": [b"2"]}
        with pytest.raises(OutputError, match="Input/output error"):
            write_files(tmp_path, files, "t")
        assert list(tmp_path.iterdir()) == []

    def test_systems_that_cannot_wait_are_let_be(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def unable(descriptor: int) -> None:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

        monkeypatch.setattr(os, "fsync", unable)
        write_file([b"x"], str(tmp_path / "a"))
        assert (tmp_path / "a").read_bytes() == b"x"


class TestSignals:
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    @pytest.mark.parametrize("function", ["open", "mkdir"])
    def test_a_signal_while_a_file_is_made_leaves_nothing_of_it(
        self, number: signal.Signals, function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The call has been done, and its result is not yet noted: then it was lost."""
        original = getattr(os, function)

        def interrupted(*arguments: Any, **options: Any) -> Any:
            result = original(*arguments, **options)
            if function == "mkdir" or str(arguments[0]).endswith(".tmp"):
                signal.raise_signal(number)
            return result

        def handler(signum: int, frame: object) -> None:
            raise KeyboardInterrupt

        before = signal.signal(number, handler)
        try:
            monkeypatch.setattr(os, function, interrupted)
            root = tmp_path / "out"
            with pytest.raises(KeyboardInterrupt):
                write_files(root, {root / "a" / "x": [b"1"], root / "t": [b"2"]}, "t")
        finally:
            signal.signal(number, before)
        assert list(tmp_path.iterdir()) == []

    def test_signals_come_once_each_when_the_block_is_done(self) -> None:
        received = []
        before = signal.signal(signal.SIGTERM, lambda number, frame: received.append(number))
        try:
            with interrupts_put_off():
                with interrupts_put_off():
                    signal.raise_signal(signal.SIGTERM)
                    signal.raise_signal(signal.SIGTERM)
                assert received == []
            assert received == [signal.SIGTERM]
        finally:
            signal.signal(signal.SIGTERM, before)

    def test_a_thread_besides_the_main_one_puts_off_no_signals(self) -> None:
        handlers = []

        def work() -> None:
            with interrupts_put_off():
                handlers.append(signal.getsignal(signal.SIGINT))

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert handlers == [signal.getsignal(signal.SIGINT)]


def left_behind(folder: Path) -> str:
    """Have a process die that has begun to write into a folder; return its temporary file's name."""
    script = (
        "import os, sys; from skinbake.files.temporary import temporary_name; "
        "name = temporary_name(); open(os.path.join(sys.argv[1], name), 'w').close(); print(name)"
    )
    process = subprocess.run(
        [sys.executable, "-c", script, str(folder)], capture_output=True, text=True, check=True
    )
    name = process.stdout.strip()
    assert (folder / name).exists()
    return name


class TestTemporaries:
    @LINUX
    def test_a_dead_process_s_are_removed_by_the_next_run(self, tmp_path: Path) -> None:
        name = left_behind(tmp_path)
        write_file([b"x"], str(tmp_path / "a"))
        assert [path.name for path in tmp_path.iterdir()] == ["a"], name

    def test_a_living_process_s_stay(self, tmp_path: Path) -> None:
        (tmp_path / temporary_name()).touch()
        before = contents(tmp_path)
        os.utime(next(tmp_path.iterdir()), (0, 0))
        if sys.platform == "linux":  # elsewhere nothing but the time tells
            write_file([b"x"], str(tmp_path / "a"))
            assert before.keys() < contents(tmp_path).keys()

    @LINUX
    def test_a_temporary_of_an_earlier_process_of_this_number_is_removed(self, tmp_path: Path) -> None:
        kernel, process, started, rest = temporary_name().removeprefix(".skinbake-").split("_")
        (tmp_path / f".skinbake-{kernel}_{process}_{int(started, 16) - 1:x}_{rest}").touch()
        write_file([b"x"], str(tmp_path / "a"))
        assert list(contents(tmp_path)) == ["a"]

    @pytest.mark.parametrize(
        "name", [".skinbake-01234567_1_1_0123456789ab.tmp", ".skinbake-0123456789ab.tmp"]
    )
    def test_of_another_machine_s_process_only_time_tells(self, name: str, tmp_path: Path) -> None:
        (tmp_path / name).touch()
        hours_ago = time.time() - 20 * 3600
        os.utime(tmp_path / name, (hours_ago, hours_ago))
        write_file([b"x"], str(tmp_path / "a"))
        assert sorted(contents(tmp_path)) == [name, "a"]
        temporary._looked_through.clear()
        days_ago = time.time() - 2 * 86_400
        os.utime(tmp_path / name, (days_ago, days_ago))
        write_file([b"x"], str(tmp_path / "a"))
        assert list(contents(tmp_path)) == ["a"]

    def test_files_with_other_names_than_temporaries_stay(self, tmp_path: Path) -> None:
        others = [
            ".skinbake-state.jsonl",
            ".skinbake-0123.tmp",
            "x.skinbake-0123456789ab.tmp",
            ".skinbake-0123456789ab.tmp.glb",
        ]
        for name in others:
            (tmp_path / name).touch()
            os.utime(tmp_path / name, (0, 0))
        (tmp_path / ".skinbake-0123456789ab.tmp").mkdir()
        (tmp_path / ".skinbake-ba9876543210.tmp").symlink_to("nowhere")
        write_file([b"x"], str(tmp_path / "a"))
        assert sorted(contents(tmp_path)) == sorted([*others, "a"])
        assert (tmp_path / ".skinbake-0123456789ab.tmp").is_dir()
        assert (tmp_path / ".skinbake-ba9876543210.tmp").is_symlink()

    def test_a_folder_is_looked_through_once(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        scans = []
        original = os.scandir

        def scanned(place: Any) -> Any:
            scans.append(place)
            return original(place)

        monkeypatch.setattr(os, "scandir", scanned)
        for number in range(5):
            write_file([b"x"], str(tmp_path / str(number)))
        assert len(scans) == 1


class TestTaken:
    """Files beside the target replace nothing, in any order."""

    @pytest.fixture(params=["links", "no links"])
    def links(self, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
        if request.param == "no links":

            def unable(*arguments: object, **options: object) -> None:
                raise OSError(errno.EPERM, os.strerror(errno.EPERM))

            monkeypatch.setattr(os, "link", unable)

    @pytest.mark.usefixtures("links")
    def test_the_same_content_serves(self, tmp_path: Path) -> None:
        (tmp_path / "x").write_bytes(b"same")
        inode = (tmp_path / "x").stat().st_ino
        write_files(tmp_path, {tmp_path / "x": [b"sa", b"me"], tmp_path / "t": [b"2"]}, "t")
        assert contents(tmp_path) == {"x": b"same", "t": b"2"}
        assert (tmp_path / "x").stat().st_ino == inode

    @pytest.mark.usefixtures("links")
    @pytest.mark.parametrize("other", [b"othr", b"sam", b"same!", b""])
    def test_a_file_of_other_content_beside_the_target_is_left_alone(
        self, other: bytes, tmp_path: Path
    ) -> None:
        (tmp_path / "x").write_bytes(other)
        (tmp_path / "t").write_bytes(b"old")
        with pytest.raises(TakenError):
            write_files(tmp_path, {tmp_path / "x": [b"sa", b"me"], tmp_path / "t": [b"2"]}, "t")
        assert contents(tmp_path) == {"x": other, "t": b"old"}

    def test_what_serves_must_be_what_it_was(self, tmp_path: Path) -> None:
        (tmp_path / "x").write_bytes(b"same")
        before = signature_of(tmp_path / "x")
        write_files(tmp_path, {tmp_path / "t": [b"2"]}, "t", serving={tmp_path / "x": before})
        (tmp_path / "x").unlink()
        with pytest.raises(TakenError):
            write_files(tmp_path, {tmp_path / "t": [b"3"]}, "t", serving={tmp_path / "x": before})
        assert contents(tmp_path) == {"t": b"2"}

    def test_an_output_is_planned_anew_where_a_name_was_taken(self, tmp_path: Path) -> None:
        """hero.bin is free when both plan, and the other run is faster. Its file goes with its target."""
        target = tmp_path / "hero.gltf"
        mine = self.planned(SEAM, target)
        self.planned(TUBE, target).write()
        assert (tmp_path / "hero.bin").exists()
        written = mine.write()
        assert not (tmp_path / "hero.bin").exists()
        (uri,) = {buffer["uri"] for buffer in json.loads(target.read_bytes())["buffers"]}
        assert uri.startswith("hero-")
        assert {path.name for path in written.files} == {uri, "hero.gltf"}
        assert read(target).attribute("POSITION", 0, 0).shape == read(SEAM).attribute("POSITION", 0, 0).shape

    @staticmethod
    def planned(source: Path, target: Path) -> Any:
        from skinbake.gltf.writing.container import for_target

        return plan_output(for_target(read_document(str(source)), str(target)), str(target))

    def test_a_name_that_is_always_taken_is_an_output_error(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        target = tmp_path / "hero.gltf"
        planned = self.planned(SEAM, target)

        def taken(*arguments: object, **options: object) -> None:
            raise TakenError("cannot be written: it is taken")

        monkeypatch.setattr("skinbake.gltf.writing.output.write_files", taken)
        with pytest.raises(OutputError, match="keep changing"):
            planned.write()


RACER = """
import sys, time
from pathlib import Path
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.gltf.writing.output import Writing
source, folder, rounds, encoding = sys.argv[1:]
options, how = BakeOptions(encoding=encoding), Writing(sync=False)
for number in range(int(rounds)):
    print(number, flush=True)
    sys.stdin.readline()  # the other one is ready too
    bake_file(source, str(Path(folder, str(number), "hero.gltf")), options, how)
"""


@pytest.mark.slow
def test_two_runs_into_one_folder_cannot_exchange_their_bins(tmp_path: Path) -> None:
    """The same target at the same time by other options, many times: each .gltf has the .bin it names."""
    rounds = 30
    for number in range(rounds):
        (tmp_path / str(number)).mkdir()
    wanted = {}
    for name, (source, encoding) in {"a": (SEAM, "float32"), "b": (TUBE, "packed8")}.items():
        from skinbake.format.encodings import GradientFormat

        alone = tmp_path / name / "hero.gltf"
        alone.parent.mkdir()
        bake_file(str(source), str(alone), storage=GradientFormat(Encoding(encoding)))
        document = json.loads(alone.read_bytes())
        wanted[len(document["accessors"]), document["buffers"][0]["byteLength"]] = [
            (alone.parent / buffer["uri"]).read_bytes() for buffer in document["buffers"]
        ]
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", RACER, str(source), str(tmp_path), str(rounds), encoding],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for source, encoding in ((SEAM, "float32"), (TUBE, "packed8"))
    ]
    try:
        for _ in range(rounds):
            for racer in racers:
                assert racer.stdout is not None
                assert racer.stdout.readline()
            for racer in racers:
                assert racer.stdin is not None
                racer.stdin.write("\n")
                racer.stdin.flush()
        assert [racer.wait(60) for racer in racers] == [0, 0]
    finally:
        for racer in racers:
            racer.kill()
            racer.communicate()
    for number in range(rounds):
        folder = tmp_path / str(number)
        document = json.loads((folder / "hero.gltf").read_bytes())
        key = len(document["accessors"]), document["buffers"][0]["byteLength"]
        assert [(folder / buffer["uri"]).read_bytes() for buffer in document["buffers"]] == wanted[key], (
            number
        )
        assert not [path for path in folder.iterdir() if path.name.endswith(".tmp")]


def test_a_run_that_was_stopped_does_not_stop_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "PATIENCE", 0.2)
    holder = os.open(tmp_path, os.O_RDONLY)
    try:
        writing._lock(holder)
        start = time.monotonic()
        write_files(tmp_path, {tmp_path / "x": [b"1"], tmp_path / "t": [b"2"]}, "t")
        assert time.monotonic() - start >= 0.2
    finally:
        os.close(holder)
    assert contents(tmp_path) == {"x": b"1", "t": b"2"}


class TestInPlace:
    def test_a_file_that_was_saved_anew_is_left_as_it_is(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        from skinbake.commands import bake

        path = copied("seam.glb", tmp_path)
        original = plan_output

        def saved(*arguments: Any, **options: Any) -> Any:
            (tmp_path / "new").write_bytes(TUBE.read_bytes())
            (tmp_path / "new").replace(path)
            return original(*arguments, **options)

        monkeypatch.setattr(bake, "plan_output", saved)
        with pytest.raises(OutputError) as raised:
            bake_file(str(path), str(path))
        assert str(raised.value) == (
            f"{path}: another program has saved it since it was read, so it is not replaced: run this again"
        )
        assert contents(tmp_path) == {"seam.glb": TUBE.read_bytes()}

    @LINUX
    @pytest.mark.parametrize("way", ["renamed", "written"])
    @pytest.mark.parametrize("saves", [1, 2])
    def test_a_save_between_the_check_and_the_rename_is_kept(
        self, way: str, saves: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Before each exchange of names another program saves; its last save stays, and the code is 4."""
        path = copied("seam.glb", tmp_path)
        data = [TUBE.read_bytes() + bytes(number) for number in range(saves)]
        call = replacing.exchange_call()
        assert call is not None
        left = list(data)

        def exchange(folder: int, one: str, other: str) -> None:
            if left:
                if way == "renamed":
                    (tmp_path / "new").write_bytes(left.pop(0))
                    (tmp_path / "new").replace(path)
                else:
                    path.write_bytes(left.pop(0))
            call(folder, one, other)

        monkeypatch.setattr(replacing, "exchange_call", lambda: exchange)
        result = invoke("bake", path, "--in-place")
        assert not left
        assert result.exit_code == 4, result.output
        assert (
            "another program has saved it since it was read, so it is not replaced: run this again"
            in result.stderr
        )
        assert contents(tmp_path) == {"seam.glb": data[-1]}

    @LINUX
    def test_an_exchange_that_fails_says_why(self, tmp_path: Path) -> None:
        call = replacing.exchange_call()
        assert call is not None
        (tmp_path / "file").touch()
        with folders.beneath(str(tmp_path), []) as folder:
            assert folder.descriptor is not None
            ctypes.set_errno(0)  # that of another call
            with pytest.raises(FileNotFoundError):
                call(folder.descriptor, "gone", "file")
            with pytest.raises(NotADirectoryError):
                call(folder.descriptor, "file/below", "file")

    @LINUX
    def test_a_file_that_is_removed_meanwhile_is_not_made_again(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = copied("seam.glb", tmp_path)
        call = replacing.exchange_call()
        assert call is not None

        def exchange(folder: int, one: str, other: str) -> None:
            path.unlink()
            call(folder, one, other)

        monkeypatch.setattr(replacing, "exchange_call", lambda: exchange)
        result = invoke("bake", path, "--in-place")
        assert result.exit_code == 4
        assert "it is not replaced: run this again" in result.stderr
        assert contents(tmp_path) == {}

    @LINUX
    @pytest.mark.parametrize("code", [None, errno.EINVAL, errno.ENOSYS, errno.EPERM])
    def test_systems_that_cannot_exchange_names_rename(
        self, code: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = copied("seam.glb", tmp_path)

        def exchange(folder: int, one: str, other: str) -> None:
            assert code is not None
            raise OSError(code, os.strerror(code))

        monkeypatch.setattr(replacing, "exchange_call", lambda: None if code is None else exchange)
        assert invoke("bake", path, "--in-place").exit_code == 0
        assert read(path).has_attribute("_SKINBAKE_ALPHA_0")
        assert list(contents(tmp_path)) == ["seam.glb"]

    @LINUX
    @pytest.mark.parametrize("large", [1, 1 << 24])
    def test_a_former_file_that_cannot_be_put_back_is_named(
        self, large: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Also if its new bytes were written ahead: the former file has that temporary name then."""
        monkeypatch.setattr(output, "LARGE", large)
        path = copied("seam.glb", tmp_path)
        call = replacing.exchange_call()
        assert call is not None
        exchanged: list[str] = []

        def exchange(folder: int, one: str, other: str) -> None:
            if exchanged:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            path.write_bytes(TUBE.read_bytes())
            call(folder, one, other)
            exchanged.append(one)

        monkeypatch.setattr(replacing, "exchange_call", lambda: exchange)
        result = invoke("bake", path, "--in-place", "--threads", "2")
        assert result.exit_code == 4
        assert f"the former file is now {exchanged[0]}" in result.stderr
        assert (tmp_path / exchanged[0]).read_bytes() == TUBE.read_bytes()
        assert read(path).has_attribute("_SKINBAKE_ALPHA_0")

    @LINUX
    @pytest.mark.parametrize("function", ["open", "unlink"])
    def test_a_disk_that_fails_after_the_exchange_brings_the_former_file_back(
        self, function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = copied("seam.glb", tmp_path)
        call, genuine = replacing.exchange_call(), getattr(os, function)
        assert call is not None

        failures = [1, 2] if function == "unlink" else [1]

        def failing(*arguments: Any, **options: Any) -> Any:
            failures.pop()
            if not failures:
                monkeypatch.setattr(os, function, genuine)
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        def exchange(folder: int, one: str, other: str) -> None:
            call(folder, one, other)
            monkeypatch.setattr(replacing, "exchange_call", lambda: call)
            if getattr(os, function) is genuine and path.read_bytes() != SEAM.read_bytes():
                monkeypatch.setattr(os, function, failing)

        monkeypatch.setattr(replacing, "exchange_call", lambda: exchange)
        assert invoke("bake", path, "--in-place").exit_code == 4
        assert contents(tmp_path) == {"seam.glb": SEAM.read_bytes()}

    def test_a_young_file_is_compared_by_content(self, tmp_path: Path) -> None:
        """Its times may not show a change: clocks of file systems tick every few milliseconds."""
        path = tmp_path / "a"
        path.write_bytes(b"one")
        before = version_of(str(path))
        assert before.digest is not None
        assert before.is_current
        with path.open("r+b") as file:
            file.write(b"two")
        now = versions.Version(before.path, signature_of(path), before.digest)
        assert not now.is_current

    def test_an_old_file_is_not_read_twice(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        path = tmp_path / "a"
        path.write_bytes(b"one")
        monkeypatch.setattr(time, "time_ns", lambda: path.stat().st_ctime_ns + 2_000_000_000)
        assert version_of(str(path)).digest is None

    def test_what_nobody_touched_is_replaced(self, tmp_path: Path) -> None:
        path = copied("seam.glb", tmp_path)
        assert bake_file(str(path), str(path)).status == "baked"
        assert read(path).has_attribute("_SKINBAKE_ALPHA_0")


def test_what_is_in_place_is_told_before_anything_can_interrupt(tmp_path: Path) -> None:
    told: list[bool] = []
    path = tmp_path / "out.bin"
    write_files(tmp_path, {path: [b"new"]}, str(path), named=lambda: told.append(path.read_bytes() == b"new"))
    assert told == [True]
