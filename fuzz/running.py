"""Run one case in this process, as the command line would, and judge what came of it."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import re
import resource
import shutil
import struct
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import TracebackType
from typing import Any

from fuzz.cases import Case
from fuzz.uris import SECRET
from fuzz.watching import Watch, Watcher, package

DOCUMENTED = {0, 1, 2, 3, 4}
CPU_SECONDS = 10.0
MEMORY_KIB = 512 * 1024
REPORTS = {
    *("out/state.jsonl", "out/summary.jsonl", "out/normals.jsonl"),
    *("out/junit.xml", "out/report.html", "out/m.d"),
}
SCRIPTS = ((4, 4), (1, 1))
"""The script elements of a page, and of an index: begun and ended. A name in a model must add none."""

SUFFIXES = (".glb", ".gltf", ".vrm")

_STYLE = re.compile("\x1b\\[(?:0|1|2|31|32|33|34|35|36)m")
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@dataclass(frozen=True)
class Find:
    """Something that must not be: what kind, a key that is equal where the cause is, and words about it."""

    kind: str
    key: str
    text: str


@dataclass
class Outcome:
    """The outcome of a command: its exit code, its output, and tracebacks that it logged or ended in."""

    code: int
    stdout: bytes
    stderr: str
    tracebacks: list[tuple[str, str]] = field(default_factory=list)


class _Tracebacks(logging.Handler):
    """Keeps the exceptions that skinbake logs before it calls them its own defect."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.found: list[tuple[str, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the exception of a record that has one."""
        if record.exc_info and record.exc_info[1] is not None:
            self.found.append(described(record.exc_info[1]))


def described(error: BaseException) -> tuple[str, str]:
    """Return a key and the traceback of an exception: its type, and the last line of skinbake it passed."""
    where = _last_line(error.__traceback__)
    text = "".join(traceback.format_exception(error))
    return f"{type(error).__name__} {where}", text[-6000:]


def _last_line(trace: TracebackType | None) -> str:
    found = "?"
    for frame in traceback.extract_tb(trace):
        if frame.filename.startswith(package()):
            found = f"{Path(frame.filename).name}:{frame.name}:{frame.lineno}"
    return found


class Runner:
    """Runs commands in this process, inside a folder of its own that has secrets around it."""

    def __init__(self, root: Path) -> None:
        """Make the folder, watch the interpreter, and catch what skinbake logs."""
        from skinbake.cli.main import entry_point

        self._entry_point: Callable[[], None] = entry_point
        self.room = root / "a" / "b"
        self.room.mkdir(parents=True)
        self._secrets = [root / "secret.bin", root / "a" / "secret.bin", self.room / "secret.bin"]
        (self.room / "other").mkdir()
        self._secrets.append(self.room / "other" / "secret.bin")
        for path in self._secrets:
            path.write_bytes(SECRET)
        os.chdir(self.room)
        self._watcher = Watcher()
        self._tracebacks = _Tracebacks()
        logger = logging.getLogger("skinbake")
        logger.setLevel(logging.DEBUG)
        logger.addHandler(self._tracebacks)
        warnings.simplefilter("error")
        for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", category)  # of other packages; Python hides these too

    def command(self, arguments: Sequence[str], stdin: bytes = b"", watch: Watch | None = None) -> Outcome:
        """Run ``skinbake`` with arguments and return what it did."""
        before = sys.argv, sys.stdin, sys.stdout, sys.stderr
        out, err = io.BytesIO(), io.BytesIO()
        self._tracebacks.found = []
        code: object = 0
        sys.argv = ["skinbake", *arguments]
        sys.stdin = io.TextIOWrapper(io.BytesIO(stdin), encoding="utf-8")
        sys.stdout = io.TextIOWrapper(out, encoding="utf-8")
        sys.stderr = io.TextIOWrapper(err, encoding="utf-8", write_through=True)
        streams = sys.stdout, sys.stderr
        self._watcher.watch = watch
        try:
            self._entry_point()
        except SystemExit as error:
            code = error.code
        except BaseException as error:
            self._tracebacks.found.append(described(error))
            code = -1
        finally:
            self._watcher.watch = None
            for stream in streams:
                with contextlib.suppress(ValueError, OSError):  # the command may have closed it
                    stream.flush()
            sys.argv, sys.stdin, sys.stdout, sys.stderr = before
            logging.getLogger().handlers.clear()  # what -v has set up writes to a stream that is gone
        text = err.getvalue().decode("utf-8", "replace")
        number = code if isinstance(code, int) else 0 if code is None else -1
        return Outcome(number, out.getvalue(), text, self._tracebacks.found)

    def run(self, case: Case) -> tuple[Outcome, list[Find]]:
        """Run a case in an empty room, and return what it did and what must not be of that."""
        self._furnish(case)
        in_place = "--in-place" in case.arguments
        watch = Watch(str(self.room / "in"), str(self.room / "out"), in_place)
        memory, spent = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        outcome = self.command(case.arguments, case.stdin, watch)
        spent = time.process_time() - spent
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
        finds = [*self._reported(outcome), *self._left(case, outcome), *self._pages(case, outcome)]
        finds += [Find("outside", f"{what.split()[0]} {where}", what) for what, where in watch.broken[:3]]
        command = case.arguments[0]
        if spent > CPU_SECONDS:
            finds.append(Find("slow", command, f"{spent:.1f} s"))
        if memory > MEMORY_KIB:
            finds.append(Find("memory", command, f"{memory >> 10} MiB"))
        if outcome.code == 0 and command == "bake" and not finds:
            finds += self._baked(case, outcome)
        return outcome, finds

    # The room

    def _furnish(self, case: Case) -> None:
        for name in ("in", "out", "again"):
            shutil.rmtree(name, ignore_errors=True)
            Path(name).mkdir()
        for name, data in case.files.items():
            path = Path("in", name)
            if len(path.parts) > 2:
                path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        for name, target in case.links.items():
            with contextlib.suppress(FileExistsError):  # a file of the case has the name
                Path("in", name).symlink_to(target)

    # What must hold of every run

    def _reported(self, outcome: Outcome) -> list[Find]:
        finds = []
        if outcome.tracebacks:
            finds += [Find("defect", key, text) for key, text in outcome.tracebacks]
        elif "failed where it should not" in outcome.stderr or "Please report" in outcome.stderr:
            key = outcome.stderr.partition("should not: ")[2][:60]
            finds.append(Find("defect", key, outcome.stderr[-3000:]))
        elif "Traceback" in outcome.stderr or "Warning:" in outcome.stderr:
            finds.append(
                Find("defect", outcome.stderr.strip().rpartition("\n")[2][:80], outcome.stderr[-3000:])
            )
        if outcome.code not in DOCUMENTED:
            finds.append(Find("exit", f"code {outcome.code}", outcome.stderr[-2000:]))
        text = (
            outcome.stderr
            if outcome.stdout[:4] == b"glTF"
            else outcome.stderr + outcome.stdout.decode("utf-8", "replace")
        )
        control = _CONTROL.search(_STYLE.sub("", text))
        if control:
            about = text[max(control.start() - 60, 0) : control.start() + 20]
            finds.append(Find("escape", re.sub(r"[\W\d]+", " ", about)[:30], repr(about)))
        if SECRET in outcome.stdout:
            finds.append(Find("secret", "stdout", "a secret is on stdout"))
        return finds

    def _left(self, case: Case, outcome: Outcome) -> list[Find]:
        """Look at what is in the folders now."""
        finds = []
        written = _files("out")
        for path in [*written, *_files("in")]:
            is_given = f"../{path}" in case.files
            if Path(path).name.startswith(".skinbake-") and path.endswith(".tmp") and not is_given:
                finds.append(Find("leftover", case.arguments[0], path))
        finds += [
            Find("secret", case.arguments[0], path) for path in written if SECRET in Path(path).read_bytes()
        ]
        given = {f"in/{name}" for name in case.files}
        before = {f"out/{name[7:]}": data for name, data in case.files.items() if name.startswith("../out/")}
        made = [
            path
            for path in written
            if path not in REPORTS and not (path in before and _holds(Path(path), before[path]))
        ]
        gone = [path for path in before if path not in written]
        if gone:
            finds.append(Find("written", f"{case.arguments[0]} removes", str(gone)))
        no_depfile = (
            "cannot stand in a depfile" in outcome.stderr
        )  # found after the bake for a buffer or an image
        failed = outcome.code != 0 and case.arguments[1:2] != ("in",) and not no_depfile
        if (
            failed or case.arguments[0] in {"verify", "inspect", "config"} or "--dry-run" in case.arguments
        ) and made:
            finds.append(
                Find(
                    "written", f"{case.arguments[0]} code {outcome.code}", f"{made}\n{outcome.stderr[-1500:]}"
                )
            )
        if "--in-place" not in case.arguments or outcome.code != 0:
            now = set(_files("in"))
            changed = [
                name
                for name, data in case.files.items()
                if not name.startswith("..") and not _holds(Path("in", name), data)
            ]
            extra = now - given - {f"in/{name}" for name in case.links}
            if changed or extra:
                finds.append(Find("input", case.arguments[0], f"changed {changed}, new {sorted(extra)}"))
        around = {path.name for path in self.room.iterdir()} - {"in", "out", "again", "other", "secret.bin"}
        if around or any(path.read_bytes() != SECRET for path in self._secrets):
            finds.append(
                Find("outside", "around", f"{sorted(around)} beside the folders, or a secret overwritten")
            )
        return finds

    def _pages(self, case: Case, outcome: Outcome) -> list[Find]:
        """Look whether a text of the model has become markup of a page."""
        pages = [
            Path(path).read_bytes() for path in _files("out") if path in {"out/page.html", "out/report.html"}
        ]
        if case.arguments[0] == "view" and "-" in case.arguments and outcome.code == 0:
            pages.append(outcome.stdout)
        finds = []
        for page in pages:
            elements = page.lower().count(b"<script"), page.lower().count(b"</script")
            if page.startswith(b"<!doctype html>") and elements not in SCRIPTS:
                text = page[-3000:].decode("utf-8", "replace")
                finds.append(Find("markup", f"{case.arguments[0]} {elements}", text))
        return finds

    # What must hold of a bake

    def _baked(self, case: Case, outcome: Outcome) -> list[Find]:
        """Check what a successful bake wrote: all is there, it reads back, and sometimes that it repeats."""
        if {"--dry-run", "--config"} & {*case.arguments} or case.arguments[1] == "in":
            return []  # options in a file may be for the input's folder alone
        target = self._target(case, outcome)
        if target is None or not target.is_file():
            return [Find("missing", "bake", f"exit code 0 and no {target}")]
        was_baked = any(b"skinbake" in data for data in [*case.files.values(), case.stdin])
        finds = [] if was_baked else _values(str(target))  # an old bake may pass through, whatever it is
        random = Random(case.seed)
        if finds or random.random() > 0.25:
            return finds
        if random.random() >= 0.5:
            return self._stripped(case, target)
        # The second bake has no limit of memory, under which the first one may leave its lighting unjudged.
        was_judged = "was not compared with standard lighting" not in outcome.stderr
        return self._repeated(case, target) if was_judged else []

    def _target(self, case: Case, outcome: Outcome) -> Path | None:
        arguments = case.arguments
        if "--in-place" in arguments:
            return Path(arguments[1])
        if "--out-dir" in arguments:
            return Path(arguments[arguments.index("--out-dir") + 1], Path(arguments[1]).name)
        target = Path(arguments[arguments.index("-o") + 1])
        if str(target) == "-":
            target = Path("out", "stdout.glb")
            target.write_bytes(outcome.stdout)
        return target

    def _repeated(self, case: Case, target: Path) -> list[Find]:
        """Bake what was baked, with the same options: the same bytes must come."""
        options = [word for word in _without_targets(case.arguments) if word != "--warnings-as-errors"]
        before = target.read_bytes()
        if "--in-place" in case.arguments:
            again, where = target, ["--in-place"]
        else:  # as deep as the target: what lies outside is referred to from there
            again = Path("again", *target.parent.parts[1:], target.name)
            again.parent.mkdir(parents=True, exist_ok=True)
            where = ["-o", str(again)]
        outcome = self.command(["bake", str(target), *where, *options])
        if outcome.code != 0:
            words = outcome.stderr.rpartition(": ")[2].strip()
            return [
                Find(
                    "twice",
                    f"code {outcome.code}: {re.sub(r'[0-9]+', 'N', words)[:70]}",
                    outcome.stderr[-2000:],
                )
            ]
        if again.read_bytes() != before:
            return [
                Find("twice", f"other bytes {_difference(target, again)}", "a second bake has other bytes")
            ]
        return []

    def _stripped(self, case: Case, target: Path) -> list[Find]:
        """Strip what was baked: the JSON and the binary of before must come."""
        data = case.files.get(case.arguments[1].partition("/")[2], case.stdin)
        is_comparable = (
            case.plain and data[:4] == b"glTF" == target.read_bytes()[:4] and b"skinbake" not in data
        )
        if not is_comparable or "--compress" in case.arguments or b'"uri"' in data:
            return []
        back = Path("again", "back.glb")
        outcome = self.command(["strip", str(target), "-o", str(back)])
        if outcome.code != 0:
            return [Find("strip", f"code {outcome.code}", outcome.stderr[-2000:])]
        before, after = parts(data), parts(back.read_bytes())
        if before != after:
            keys = [key for key in {**before[0], **after[0]} if before[0].get(key) != after[0].get(key)]
            what = f"{keys or 'binary'} {sorted(set(re.findall(r'--[a-z-]+', ' '.join(case.arguments))))[:0]}"
            return [
                Find(
                    "strip",
                    f"differs in {what}",
                    f"strip of the bake differs in {what}\n{outcome.stderr[-500:]}",
                )
            ]
        return []


def _holds(path: Path, data: bytes) -> bool:
    try:
        return path.read_bytes() == data
    except OSError:
        return False


def _files(folder: str) -> list[str]:
    return [f"{base}/{name}" for base, _, names in os.walk(folder) for name in names]


def _without_targets(arguments: Sequence[str]) -> list[str]:
    """Return the options of a bake but for those that say where to, print, or bound its memory."""
    options, skip = [], False
    for word in arguments[2:]:
        if skip:
            skip = False
        elif word in {"-o", "--out-dir", "--summary", "--state", "--depfile", "--color", "--max-memory"}:
            skip = True
        elif word not in {"--in-place", "--json", "--timings", "--skip-unchanged", "-v", "-vv", "-q"}:
            options.append(word)
    return options


def parts(data: bytes) -> tuple[Any, bytes]:
    """Return the JSON and the BIN chunk of a GLB."""
    length = struct.unpack_from("<I", data, 12)[0]
    rest = data[20 + length :]
    binary = rest[8 : 8 + struct.unpack_from("<I", rest)[0]] if len(rest) >= 8 else b""
    return json.loads(data[20 : 20 + length]), binary


def _difference(one: Path, other: Path) -> str:
    """Return where two outputs differ, in words that are equal for equal causes."""
    try:
        if one.read_bytes()[:4] != b"glTF":
            first, second = json.loads(one.read_text()), json.loads(other.read_text())
            binary = False
        else:
            (first, before), (second, after) = parts(one.read_bytes()), parts(other.read_bytes())
            binary = before != after
        keys = [key for key in {**first, **second} if first.get(key) != second.get(key)]
    except (ValueError, RecursionError):  # too deep for Python's own reader
        return "?"
    return f"in {keys}{' and binary' if binary else ''}"


def _values(path: str) -> list[Find]:
    """Read an output back: its α and β must be finite."""
    import numpy as np

    from skinbake.errors import SkinbakeError
    from skinbake.format.note import gradient_note_in
    from skinbake.gltf.document import read_document
    from skinbake.gltf.reading.accessors import read_accessor

    try:
        document = read_document(path)
        for mesh in document.objects("meshes"):
            primitives = mesh.get("primitives")
            for primitive in primitives if isinstance(primitives, list) else ():
                note = gradient_note_in(document, primitive)
                for name in [] if note is None else note.slot_names:
                    number = primitive["attributes"].get(name)
                    if (
                        number is not None
                        and not np.isfinite(read_accessor(document, number, document.place).decoded()).all()
                    ):
                        return [Find("finite", name.strip("0123456789"), f"{name} of {path} is not finite")]
    except SkinbakeError as error:
        return [Find("unreadable", re.sub(r"[0-9]+", "N", str(error).rpartition(": ")[2])[:60], str(error))]
    except Exception as error:
        key, text = described(error)
        return [Find("unreadable", key, text)]
    return []
