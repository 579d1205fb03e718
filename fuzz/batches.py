"""Run many cases in forked batches: a crash or a hang is caught, and told by the case that caused it."""

from __future__ import annotations

import faulthandler
import gc
import hashlib
import json
import os
import re
import resource
import selectors
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from fuzz.cases import Case, make_case
from fuzz.models import Model
from fuzz.running import CPU_SECONDS, Find, Runner
from fuzz.shortcuts import remember_what_never_changes

BATCH = 1000
HANG_SECONDS, PATIENCE = 40.0, 15
ADDRESS_SPACE = 8 << 30
REPOSITORY = Path(__file__).resolve().parents[1]
FINDS = REPOSITORY / "fuzz" / "finds"


@dataclass
class Totals:
    """The results of many runs: how many, by command and exit code, and how often each thing was found."""

    runs: int = 0
    codes: Counter[str] = field(default_factory=Counter)
    finds: Counter[str] = field(default_factory=Counter)


@dataclass
class _Batch:
    """A child at work: its process, the seed it is at, the first that it leaves, and where its faults go.

    ``heard`` is when it last said something, ``spent`` the processor's time that it had taken by then.
    """

    process: int
    reader: int
    at: int
    end: int
    heard: float
    faults: Path
    spent: float = 0.0
    rest: bytes = b""


@dataclass(frozen=True)
class Plan:
    """The runs to do: seeds from ``first`` until ``seconds`` are over, or ``most`` done, ``workers`` at once.

    around wraps the work of each child: coverage is measured so. ``aimed`` cases run before all others.
    """

    models: Sequence[Model]
    first: int
    seconds: float
    workers: int
    most: int | None = None
    finds: Path = FINDS
    around: Callable[[Callable[[], None]], None] | None = None
    aimed: Sequence[Case] = ()

    def case(self, seed: int) -> Case:
        """Return the case of a seed; those below 0 are the aimed ones."""
        return self.aimed[-1 - seed] if seed < 0 else make_case(seed, self.models)


def preload() -> None:
    """Import all that commands import, once for all children."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    import importlib
    import pkgutil

    import skinbake

    for module in pkgutil.walk_packages(skinbake.__path__, "skinbake."):
        if "dask" not in module.name and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in ("DracoPy", "meshopt", "igl", "scipy.sparse", "scipy.sparse.linalg", "jinja2", "fsspec"):
        importlib.import_module(name)
    remember_what_never_changes()


def run_all(plan: Plan) -> Totals:
    """Run cases one seed after another, and return what came of them."""
    preload()
    gc.collect()
    gc.freeze()
    totals = Totals()
    where = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="skinbake-fuzz-", dir=where))
    end = time.monotonic() + plan.seconds
    last = plan.first + plan.most if plan.most is not None else None
    following = plan.first
    waiting = [(-len(plan.aimed), 0)] if plan.aimed else []
    at_work: dict[int, _Batch] = {}
    selector = selectors.DefaultSelector()
    try:
        while True:
            while len(at_work) < plan.workers and (waiting or time.monotonic() < end):
                if not waiting:
                    stop = following + BATCH if last is None else min(following + BATCH, last)
                    if stop <= following:
                        break
                    waiting.append((following, stop))
                    following = stop
                batch = _started(plan, waiting.pop(), folder, end)
                at_work[batch.reader] = batch
                selector.register(batch.reader, selectors.EVENT_READ)
            if not at_work:
                return totals
            _listen(plan, totals, selector, at_work, waiting)
    finally:
        for batch in at_work.values():
            os.kill(batch.process, signal.SIGKILL)
            os.waitpid(batch.process, 0)
        shutil.rmtree(folder, ignore_errors=True)


def _listen(
    plan: Plan,
    totals: Totals,
    selector: selectors.BaseSelector,
    at_work: dict[int, _Batch],
    waiting: list[tuple[int, int]],
) -> None:
    """Hear what the children say, and end those that are done, dead or silent."""
    for key, _ in selector.select(timeout=1.0):
        batch = at_work[key.fd]
        data = os.read(key.fd, 1 << 16)
        batch.heard, batch.spent = time.monotonic(), _spent(batch.process)
        *lines, batch.rest = (batch.rest + data).split(b"\n")
        for line in lines:
            _take(totals, batch, line.decode())
        if not data:
            _ended(plan, totals, batch, selector, at_work, waiting, hung=False)
    for batch in list(at_work.values()):
        if _hangs(batch):
            os.kill(batch.process, signal.SIGUSR1)  # faulthandler says where it is
            time.sleep(0.3)
            os.kill(batch.process, signal.SIGKILL)
            _ended(plan, totals, batch, selector, at_work, waiting, hung=True)


def _hangs(batch: _Batch) -> bool:
    """Tell whether a child is silent though it had the processor, or for very long: machines may be busy."""
    silent = time.monotonic() - batch.heard
    if silent < HANG_SECONDS:
        return False
    return silent > PATIENCE * HANG_SECONDS or _spent(batch.process) - batch.spent > CPU_SECONDS


def _spent(process: int) -> float:
    """Return the processor's time that a child has taken, 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _take(totals: Totals, batch: _Batch, line: str) -> None:
    word, _, rest = line.partition(" ")
    if word == "s":
        batch.at = int(rest)
    elif word == "d":
        totals.runs += 1
        totals.codes[rest] += 1
    elif word == "f":
        totals.finds[rest] += 1
    elif word == "e":
        batch.at = batch.end = int(rest)


def _ended(
    plan: Plan,
    totals: Totals,
    batch: _Batch,
    selector: selectors.BaseSelector,
    at_work: dict[int, _Batch],
    waiting: list[tuple[int, int]],
    *,
    hung: bool,
) -> None:
    """Take leave of a child; where it died at work, keep the case, and have the rest of its seeds done."""
    selector.unregister(batch.reader)
    os.close(batch.reader)
    del at_work[batch.reader]
    _, status = os.waitpid(batch.process, 0)
    told = batch.faults.read_text(errors="replace") if batch.faults.exists() else ""
    batch.faults.unlink(missing_ok=True)
    if not hung and os.WIFEXITED(status) and os.WEXITSTATUS(status) == 0:
        return
    where = re.search(r"skinbake/(\S+?\.py)\", line (\d+) in (\w+)", told)
    line = f"{where[1]}:{where[3]}" if where else "?"
    kind = "hang" if hung else "crash"
    code = (
        "" if hung else f" signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f" exit {status >> 8}"
    )
    case = plan.case(batch.at)
    totals.runs += 1
    totals.codes[f"{case.arguments[0]} {kind}"] += 1
    totals.finds[keep(plan.finds, case, Find(kind, f"{case.arguments[0]}{code} {line}", told))] += 1
    if batch.at + 1 < batch.end:
        waiting.append((batch.at + 1, batch.end))


def _started(plan: Plan, seeds: tuple[int, int], folder: Path, end: float) -> _Batch:
    reader, writer = os.pipe()
    process = os.fork()
    if process == 0:
        code = 70
        try:
            os.close(reader)
            room = folder / f"room-{os.getpid()}"
            work = partial(_work, plan, seeds, room, writer, end)
            (plan.around or (lambda inner: inner()))(work)
            code = 0
        except BaseException:
            import traceback

            (folder / f"faults-{os.getpid()}").write_text(traceback.format_exc())
        finally:
            os._exit(code)
    os.close(writer)
    return _Batch(process, reader, seeds[0], seeds[1], time.monotonic(), folder / f"faults-{process}")


def _work(plan: Plan, seeds: tuple[int, int], room: Path, writer: int, end: float) -> None:
    """Run the cases of some seeds, and say of each when it begins and how it ended."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    faults = os.open(room.with_name(f"faults-{os.getpid()}"), os.O_WRONLY | os.O_CREAT, 0o600)
    faulthandler.enable(faults)
    faulthandler.register(signal.SIGUSR1, faults)
    gc.set_threshold(20_000)  # what stays is frozen, and a run leaves little: looking often costs a tenth
    runner = Runner(room)
    lines: list[str] = []
    for seed in range(*seeds):
        os.write(writer, "".join([*lines, f"s {seed}\n"]).encode())
        case = plan.case(seed)
        outcome, finds = runner.run(case)
        lines = [f"d {case.arguments[0]} {outcome.code}\n"]
        lines += [f"f {keep(plan.finds, case, find)}\n" for find in finds]
        heavy = any(find.kind == "memory" for find in finds)
        if heavy or (seed >= 0 and time.monotonic() > end):
            lines.append(f"e {seed + 1}\n")
            break
    os.write(writer, "".join(lines).encode())
    os.chdir("/")
    shutil.rmtree(room, ignore_errors=True)


def keep(folder: Path, case: Case, find: Find) -> str:
    """Keep a case, unless there is one of the same cause that is no larger; return the name of the cause."""
    digest = hashlib.sha256(f"{find.kind} {find.key}".encode()).hexdigest()[:8]
    words = re.sub(r"[^A-Za-z0-9.]+", "-", find.key)[:60].strip("-")
    name = f"{find.kind}-{words}-{digest}"
    path = folder / name
    size = sum(map(len, case.files.values()))
    known = json.loads((path / "case.json").read_text())["size"] if (path / "case.json").is_file() else None
    if known is None or size < known // 2:
        notes = {"kind": find.kind, "key": find.key, "text": find.text, "size": size}
        case.save(path, notes)
    return name
