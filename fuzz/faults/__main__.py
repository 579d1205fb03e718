"""Inject faults at every call that writes: ``python -m fuzz.faults``.

The process starts itself again under a small library of C, imports all that commands need once, and forks
for each fault: a command runs, and at its n-th call that changes the watched folder something happens.
Afterwards each file is what it was or what it should become, whole; no temporary file is left, but after a
kill, and then the next run removes it; and the exit code is a documented one.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import mmap
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from fuzz.log import LOG, note
from fuzz.measuring import measured

REPOSITORY = Path(__file__).resolve().parents[2]
LIBRARY = REPOSITORY / "build" / "faults.so"
SECONDS = 60
OUTPUT, INTERRUPTED = 4, 130

KINDS = {
    "kill": (1, signal.SIGKILL, 0),
    "int": (1, signal.SIGINT, 0),
    "term": (1, signal.SIGTERM, 0),
    "enospc": (2, errno.ENOSPC, 0),
    "enospc+": (2, errno.ENOSPC, 1),
    "eio": (2, errno.EIO, 0),
    "eio+": (2, errno.EIO, 1),
    "eperm": (2, errno.EPERM, 0),
    "short": (3, 0, 0),
    "short+": (3, 0, 1),
}
"""By name: what the library does, with which signal or error, and whether all later calls fail too (+)."""


@dataclass
class Totals:
    """Faults by kind, exit codes by kind, and what was found with how often."""

    faults: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    finds: Counter[str] = field(default_factory=Counter)
    calls: dict[str, list[str]] = field(default_factory=dict)


def main() -> int:
    """Run as the command line says; 1 where something was found, 2 where there is no compiler."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.faults", description=__doc__)
    parser.add_argument("--scene", action="append", help="Of the scenes by name; all by default.")
    parser.add_argument("--kind", action="append", choices=list(KINDS), help="All by default.")
    parser.add_argument("--every", type=int, default=1, help="Only each so-many-th call.")
    parser.add_argument("--log", type=Path, default=LOG)
    parser.add_argument("--coverage", type=Path, help="Keep here which lines each child ran.")
    given = parser.parse_args()
    if os.environ.get("LD_PRELOAD") != str(LIBRARY):
        if not _compile():
            return 2
        environment = {**os.environ, "LD_PRELOAD": str(LIBRARY), "OPENBLAS_NUM_THREADS": "1"}
        return subprocess.call(
            [sys.executable, "-m", "fuzz.faults", *sys.argv[1:]], env=environment, cwd=REPOSITORY
        )
    begun = time.monotonic()
    totals = run(given.scene, given.kind or list(KINDS), given.every, given.coverage)
    seconds = time.monotonic() - begun
    count = sum(totals.faults.values())
    note("faults", executions=count, seconds=seconds, seed=None, finds=totals.finds, log=given.log,
         kinds=dict(totals.faults), codes=dict(totals.codes))  # fmt: skip
    print(
        f"{count} faults in {seconds:.0f} s: "
        + ", ".join(f"{number} {kind}" for kind, number in totals.faults.items())
    )
    print("".join(f"  {number:5} {code}\n" for code, number in sorted(totals.codes.items())), end="")
    for what, number in totals.finds.most_common():
        print(f"FOUND {number:5} {what} (at {', '.join(totals.calls[what][:6])})")
    return 1 if totals.finds else 0


def _compile() -> bool:
    LIBRARY.parent.mkdir(parents=True, exist_ok=True)
    compiler = os.environ.get("CC", "gcc")
    if shutil.which(compiler) is None:
        print(f"not run: {compiler} is not installed", file=sys.stderr)
        return False
    source = Path(__file__).with_name("preload.c")
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-o", str(LIBRARY), str(source), "-ldl"], check=True
    )
    return True


class Fault:
    """Arms the library in a child, and tells its parent what it hit."""

    def __init__(self) -> None:
        """Share memory with the children to be."""
        self._library = ctypes.CDLL(None)
        self._shared = mmap.mmap(-1, 4096)
        self._count = ctypes.c_int.from_buffer(self._shared, 0)
        self._told = (ctypes.c_char * 256).from_buffer(self._shared, 64)

    def arm(self, folder: Path, call: int, kind: str) -> None:
        """Have the n-th call below a folder fail; none for 0."""
        what, value, goes_on = KINDS[kind]
        self._library.fault_arm(
            str(folder).encode(), call, what, int(value), goes_on, ctypes.byref(self._count), self._told
        )

    def clear(self) -> None:
        """Forget the last fault."""
        self._shared[:512] = bytes(512)

    @property
    def calls(self) -> int:
        """Return how many calls were counted."""
        return int(self._count.value)

    @property
    def call(self) -> str:
        """Return which call was hit, empty where none was."""
        return self._told.value.decode(errors="replace")


def run(names: list[str] | None, kinds: list[str], every: int, coverage: Path | None = None) -> Totals:
    """Inject faults of some kinds into scenes, and return what came of them.

    With ``coverage`` each child that is not killed leaves a measurement in that folder.
    """
    from fuzz.batches import preload
    from fuzz.faults.scenes import SCENES

    preload()
    totals, fault = Totals(), Fault()
    where = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="skinbake-faults-", dir=where) as root:
        for scene in SCENES:
            if names is None or scene.name in names:
                _Trial(scene, fault, Path(root, "w"), totals, coverage).all(kinds, every)
    return totals


class _Trial:
    """One scene: what it begins with, what it should become, and all faults in between."""

    def __init__(
        self, scene: Any, fault: Fault, folder: Path, totals: Totals, coverage: Path | None = None
    ) -> None:
        self.scene, self.fault, self.folder, self.totals = scene, fault, folder, totals
        self.coverage = coverage
        self._furnish()
        if scene.name == "strip":
            self._child(("bake", "in/a.glb", "--in-place"), 0, "kill")
        self.old = _tree(folder)
        code, _ = self._child(scene.arguments, 0, "kill")
        if code not in {0, 1}:
            raise RuntimeError(f"{scene.name} fails without a fault: {code}")
        self.calls, self.new = fault.calls, _tree(folder)

    def all(self, kinds: list[str], every: int) -> None:
        """Inject each kind at each call."""
        for kind in kinds:
            for call in range(1, self.calls + 1, every):
                self._furnish(self.old)
                before = _folders(self.folder)
                code, stderr = self._child(self.scene.arguments, call, kind)
                if not self.fault.call:
                    continue
                self.totals.faults[kind] += 1
                self.totals.codes[f"{kind} {self.scene.name} exit {code}"] += 1
                hit = self.fault.call
                for what in self._judged(kind, code, stderr, before):
                    name = f"{self.scene.name}, {kind}: {what}"
                    self.totals.finds[name] += 1
                    self.totals.calls.setdefault(name, []).append(f"{call} {hit.split()[0]}")

    def _furnish(self, files: dict[str, bytes] | None = None) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        if files is None:
            self.scene.furnish(self.folder)
            return
        for name in ("in", "out"):
            (self.folder / name).mkdir(parents=True)
        for name, data in files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)

    def _child(self, arguments: tuple[str, ...], call: int, kind: str) -> tuple[int, str]:
        """Run a command in a child with a fault; return its exit code, or minus a signal, and its stderr."""
        self.fault.clear()
        log = self.folder.parent / "stderr"
        process = os.fork()
        if process == 0:
            work = partial(
                _command, arguments, self.folder, log, lambda: self.fault.arm(self.folder, call, kind)
            )
            code = 70
            try:
                code = work() if self.coverage is None else measured(work, self.coverage)
            finally:
                os._exit(code)
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            done, status = os.waitpid(process, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status), log.read_text(errors="replace")
            time.sleep(0.001)
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        return -1000, "it hung"

    def _judged(self, kind: str, code: int, stderr: str, before: set[str]) -> list[str]:
        """Return what must not be of the folder after a fault."""
        now = _tree(self.folder)
        temporary = {
            name for name in now if Path(name).name.startswith(".skinbake-") and name.endswith(".tmp")
        }
        whole = {name: data for name, data in now.items() if name not in {*temporary, *self.scene.appended}}
        expected = {name: data for name, data in self.new.items() if name not in self.scene.appended}
        found = []
        if temporary and kind != "kill":
            found.append("a temporary file is left")
        if "Traceback" in stderr or "should not" in stderr or "Please report" in stderr:
            found.append(f"a defect is reported: {stderr.strip()[-200:]}")
        for name, data in whole.items():
            if data not in {self.old.get(name), self.new.get(name)}:
                found.append(f"{name} is neither what it was nor what it should become")
            elif (
                name.endswith(".gltf")
                and data != self.old.get(name)
                and not expected.items() <= whole.items()
            ):
                found.append(f"{name} is there before the files that it names")
        found += [f"{name} is gone" for name in self.old.keys() - now.keys()]
        if code not in self._allowed(kind):
            found.append(f"exit code {code}")
        if code == 0 and whole != expected:
            found.append("exit code 0, and not all is written")
        # Renaming is not interrupted; and once the old file is replaced, a disk that then fails to take the
        # folder cannot bring it back. In both cases all is there.
        replaced = any(name in self.old and self.old[name] != data for name, data in whole.items())
        is_late = whole == expected and (kind in {"int", "term"} or replaced)
        if code not in {0, 1} and kind != "kill" and not self.scene.appended and not is_late:
            found += [f"{name} is new though it failed" for name in whole.keys() - self.old.keys()]
            found += [f"folder {name} is new though it failed" for name in _folders(self.folder) - before]
        if kind == "kill" and (temporary or whole != expected):
            found += self._healed(expected, temporary)
        return found

    def _allowed(self, kind: str) -> set[int]:
        """Return the exit codes that a fault may end in."""
        if kind == "kill":
            return {-signal.SIGKILL}
        if kind in {"int", "term"}:
            return {0, 1, INTERRUPTED, 143, -signal.SIGTERM}
        # A line of notes that is cut is one that could not be written; a model is written on.
        return {0, 1, OUTPUT} if not kind.startswith("short") or self.scene.appended else {0, 1}

    def _healed(self, expected: dict[str, bytes], temporary: set[str]) -> list[str]:
        """Run the command once more, without a fault: all must become as it should, temporary files gone."""
        code, _ = self._child(self.scene.arguments, 0, "kill")
        now = _tree(self.folder)
        left = {name for name in now if name in temporary}
        whole = {name: data for name, data in now.items() if name not in {*left, *self.scene.appended}}
        found = (
            []
            if code in {0, 1} and whole == expected
            else [f"a later run does not put it right: exit code {code}"]
        )
        return [*found, "a later run leaves the temporary file of a killed one"] if left else found


def _command(arguments: tuple[str, ...], folder: Path, log: Path, arm: Any) -> int:
    """Run a command in this child, and return its exit code."""
    from skinbake.cli.main import entry_point

    code: object = 70
    try:
        os.chdir(folder)
        null, errors = os.open(os.devnull, os.O_RDWR), os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for descriptor, number in ((null, 0), (null, 1), (errors, 2)):
            os.dup2(descriptor, number)
        sys.argv = ["skinbake", *arguments]
        arm()
        entry_point()
    except SystemExit as error:
        code = error.code or 0
    except KeyboardInterrupt:
        code = INTERRUPTED
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
    return code if isinstance(code, int) else 70


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _folders(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_dir()}


if __name__ == "__main__":
    sys.exit(main())
