"""Works that a worker process can import: plain ones, and ones that kill who does them."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinbake.errors import SkinbakeError
from skinbake.timing import Told, tell, tell_written


@dataclass(frozen=True)
class Work:
    """Returns twice the job, and who did it."""

    def __call__(self, job: Any) -> Any:
        return 2 * job, os.getpid()

    def failed(self, job: Any, error: SkinbakeError) -> Any:
        return "failed", job, error.message

    def lost(self, job: Any, reason: str, *, is_written: bool = False) -> Any:
        return "written" if is_written else "lost", job, reason


@dataclass(frozen=True)
class Echoing(Work):
    """Returns the job itself; a large one after a while."""

    def __call__(self, job: Any) -> Any:
        if len(job) > 1000:
            time.sleep(0.3)
        return job


@dataclass(frozen=True)
class Deadly(Work):
    """Dies of the signal on the jobs that are in ``on``, after a while.

    Notes in ``log`` when jobs began, and when it died.
    """

    on: tuple[int, ...]
    by: int
    log: Path

    def __call__(self, job: Any) -> Any:
        started = self.log / f"{job}-{os.getpid()}-{time.monotonic_ns()}"
        started.touch()
        if job in self.on:
            time.sleep(0.5)
            started.rename(f"{started}-{time.monotonic_ns()}")
            if signal.getsignal(self.by) == signal.SIG_IGN:  # as SIGHUP is after nohup
                signal.signal(self.by, signal.SIG_DFL)
            os.kill(os.getpid(), self.by)
        time.sleep(0.002)
        return super().__call__(job)


@dataclass(frozen=True)
class DeadlyOnce(Deadly):
    """Dies the first time only: somebody else took the memory."""

    def __call__(self, job: Any) -> Any:
        if job in self.on and any(self.log.glob(f"{job}-*")):
            return 2 * job, os.getpid()
        return super().__call__(job)


@dataclass(frozen=True)
class Crashing(Work):
    """Reads from address 0 on job 3."""

    def __call__(self, job: Any) -> Any:
        if job == 3:
            ctypes.string_at(0)
        return super().__call__(job)


@dataclass(frozen=True)
class Raising(Work):
    """Has a defect on job 3, and a result that cannot be sent on job 4."""

    def __call__(self, job: Any) -> Any:
        if job == 3:
            raise RuntimeError("a defect of skinbake")
        return (lambda: None) if job == 4 else super().__call__(job)


@dataclass(frozen=True)
class Surroundings(Work):
    """Returns what a worker finds around it."""

    def __call__(self, job: Any) -> Any:
        threads = os.environ.get("OPENBLAS_NUM_THREADS")
        return (
            threads,
            len(list(Path("/proc/self/task").iterdir())),
            signal.getsignal(signal.SIGINT) is not None,
        )


@dataclass(frozen=True)
class Slow(Work):
    """Makes a file, sleeps for as long as the job says, and takes the file away however it ends."""

    folder: Path

    def __call__(self, job: Any) -> Any:
        path = self.folder / f"{os.getpid()}.busy"
        path.touch()
        try:
            time.sleep(job)
        finally:
            path.unlink()
        return super().__call__(job)


@dataclass(frozen=True)
class Unborn(Work):
    """Cannot be unpickled by anybody."""

    def __reduce__(self) -> Any:
        return os._exit, (7,)


@dataclass(frozen=True)
class Stillborn(Work):
    """Ends the first processes that unpickle it, and then works."""

    count: int
    log: Path

    def __reduce__(self) -> Any:
        return _born_after, (self.count, self.log)


def _born_after(count: int, log: Path) -> Stillborn:
    for number in range(count):
        try:
            (log / str(number)).touch(exist_ok=False)
        except FileExistsError:
            continue
        os._exit(7)
    return Stillborn(count, log)


@dataclass(frozen=True)
class DyingBesideOthers(Work):
    """Kills its process on the first try of job 0, while job 2 takes long. Notes in ``log`` the times."""

    log: Path

    def __call__(self, job: Any) -> Any:
        number = len(list(self.log.glob(f"{job}-began-*")))
        (self.log / f"{job}-began-{time.monotonic_ns()}").touch()
        if job == 0 and not number:
            time.sleep(0.4)
            os.kill(os.getpid(), signal.SIGKILL)
        if job == 2:
            time.sleep(1.5)
        (self.log / f"{job}-ended-{time.monotonic_ns()}").touch()
        return super().__call__(job)


@dataclass(frozen=True)
class Lingering(Work):
    """Leaves a thread that keeps the process alive for some seconds after the job."""

    def __call__(self, job: Any) -> Any:
        threading.Thread(target=time.sleep, args=(2.0,)).start()
        return super().__call__(job)


@dataclass(frozen=True)
class Hungry(Work):
    """Takes as many bytes as the job says, and touches none of them."""

    def __call__(self, job: Any) -> Any:
        try:
            return len(bytearray(job)), os.getpid()
        except MemoryError:
            return "too much", os.getpid()


@dataclass(frozen=True)
class ToldTooLate(Work):
    """Is done with job 3 at the very moment at which it is told to stop."""

    def __call__(self, job: Any) -> Any:
        if job == 3:
            told: list[int] = []
            signal.signal(signal.SIGTERM, lambda number, frame: told.append(number))
            while not told:
                time.sleep(0.01)
        return super().__call__(job)


@dataclass(frozen=True)
class Deaf(Work):
    """Does not hear that it is to stop."""

    def __call__(self, job: Any) -> Any:
        if job == 1:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            time.sleep(60)
        return super().__call__(job)


@dataclass(frozen=True)
class WritingFirst(Work):
    """Tells that it has written the output of job 1, and takes a minute more. Then it is done at once."""

    def __call__(self, job: Any) -> Any:
        tell(Told(str(job)))
        if job == 1:
            tell_written()
        if job in {1, 2}:
            time.sleep(60)
        return super().__call__(job)


@dataclass(frozen=True)
class SlowToStart(Work):
    """Takes three seconds to be read in a worker, and then is done with a job at once, nearly."""

    def __reduce__(self) -> Any:
        return slowly, ()

    def __call__(self, job: Any) -> Any:
        time.sleep(0.3)
        return super().__call__(job)


def slowly() -> SlowToStart:
    """Return the work after a while."""
    time.sleep(3.0)
    return SlowToStart()


@dataclass(frozen=True)
class SlowToStop(Slow):
    """Takes half a second to take its file away if it is told to stop."""

    def __call__(self, job: Any) -> Any:
        path = self.folder / f"{os.getpid()}.undone"
        path.touch()
        try:
            time.sleep(job)
        except BaseException:
            time.sleep(0.5)
            raise
        finally:
            path.unlink()
        return Work.__call__(self, job)
