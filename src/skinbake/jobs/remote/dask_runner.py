"""The same work on a Dask cluster: a runner whose processes are workers of a running ``dask scheduler``.

Files do not travel. Workers open the paths and URLs that the user named: in a shared folder, or in a storage.
A worker that sees another file under a path says so, and leaves it alone.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import pickle
import platform
import queue
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skinbake.errors import InputError, Notice, OutputError, Place, SkinbakeError
from skinbake.files.bounds import Bounds, Within
from skinbake.files.folders import open_regular
from skinbake.files.urls import is_url
from skinbake.jobs.remote.staging import naming, with_names
from skinbake.jobs.work import Job, ResultT, Work
from skinbake.version import __version__
from skinbake.wording import installing

if TYPE_CHECKING:
    from distributed import Client, Future  # distributed is untyped: these are Any

CONNECT_SECONDS = 10.0
PATIENCE_SECONDS = 300.0
LOOK_SECONDS = 2.0
"""The seconds after which a waiting client counts the workers again."""

WINDOW_PER_THREAD, LEAST_WINDOW = 4, 16
"""The jobs that are under way at a time: for each thread of a worker, and at least."""

GONE = "the connection to the scheduler was lost; a worker may still write it"


class DaskRunner:
    """Run jobs on the workers of a scheduler, given by its address, like ``tcp://host:8786``.

    If a worker dies, its jobs are tried on other workers, as often as the scheduler's ``allowed-failures``
    says. Another job may have killed the worker. So a job that was given up is tried once more at the end,
    alone in the cluster.
    """

    def __init__(self, address: str, *, patience: float = PATIENCE_SECONDS) -> None:
        self.address = address
        self._patience = patience
        self._client: Client | None = None
        self._in_order = False

    def one_by_one(self) -> DaskRunner:
        """Return a runner of the same connection that does jobs one at a time, in order."""
        self.connect()
        other = copy(self)
        other._in_order = True
        return other

    def connect(self) -> list[Notice]:
        """Connect to the scheduler, and return notices about its workers.

        Raises InputError if nothing answers, Dask is not installed, or a worker has another version of
        skinbake, because its output bytes may differ.
        """
        if self._client is not None:
            return []
        self._client = _client(self.address)
        try:
            found = self._client.run(pickle.loads, call(versions), on_error="return")
            here, others = versions(), set()
            for worker, theirs in found.items():
                if isinstance(theirs, ImportError | AttributeError):
                    lacking = f"{worker} has no skinbake, or one without --dask ({theirs})"
                    raise InputError(_refused(lacking), Place(self.address))
                if isinstance(theirs, BaseException):  # it died: its jobs will be tried elsewhere
                    continue
                if theirs[0] != here[0]:
                    raise InputError(_refused(f"{worker} has skinbake {theirs[0]}"), Place(self.address))
                if theirs[1:] != here[1:]:
                    others.add("Python {}, NumPy {}".format(*theirs[1:]))
        except BaseException:
            self.close()
            raise
        if not others:
            return []
        message = (
            f"workers have {' or '.join(sorted(others))}, this is Python {here[1]}, NumPy {here[2]}: outputs "
            "may differ in rounding"
        )
        return [Notice("worker-versions", message, Place(self.address))]

    def close(self) -> None:
        """Leave the cluster. Jobs that have not begun there are forgotten."""
        if self._client is not None:
            # A scheduler that has gone away causes warnings, and exceptions of many types.
            with suppress(Exception), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._client.close(timeout=CONNECT_SECONDS)
            self._client = None

    def run(
        self, work: Work[Job, ResultT], jobs: Sequence[Job]
    ) -> Generator[tuple[int, ResultT], None, None]:
        """Yield (number of the job, result) as jobs are done, in any order, each exactly once.

        All remaining jobs are lost if the scheduler goes away, if no worker comes for a while, or if a worker
        comes with another version of skinbake. Raises InputError as ``connect`` does.
        """
        self.connect()
        client = self._client
        assert client is not None
        yield from ((number, work(job)) for number, job in enumerate(jobs) if job.missing is not None)
        waiting = deque(number for number, job in enumerate(jobs) if job.missing is None)
        suspects: deque[int] = deque()
        under_way: dict[Future, int] = {}
        ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        alone, over, threads, worker_seen = False, None, 0, time.monotonic()
        while over is None and (waiting or suspects or under_way):
            with suppress(OSError):  # the connection was lost: futures will say so
                threads = sum(client.nthreads().values())
            worker_seen = time.monotonic() if threads else worker_seen
            if client.status == "closed":
                over = GONE
            elif time.monotonic() - worker_seen > self._patience:
                over = f"the scheduler has had no worker for {self._patience:.0f} s"
            if not waiting and not under_way:
                alone, waiting = True, deque([suspects.popleft()])
            window = 1 if self._in_order else max(LEAST_WINDOW, WINDOW_PER_THREAD * threads)
            while waiting and len(under_way) < window:
                number = waiting.popleft()
                job = jobs[number]
                pickled = pickle.dumps((work, absolute(job), job, content(job.source)))
                future = client.submit(pickle.loads, call(perform, build(), pickled), pure=False)
                under_way[future] = number
                future.add_done_callback(ended.put)
            taken: list[Future] = []
            with suppress(queue.Empty):
                taken.append(ended.get(timeout=LOOK_SECONDS if under_way else 0.0))
                while True:
                    taken.append(ended.get_nowait())
            for future in taken:
                outcome = _outcome(future)
                if outcome is None:
                    future.add_done_callback(ended.put)
                    continue
                number = under_way.pop(future)
                if isinstance(outcome, tuple):
                    yield number, _checked(work, jobs[number], *outcome)
                elif isinstance(outcome, Exception) and alone:
                    yield number, work.lost(jobs[number], _blame(outcome))
                else:
                    over = outcome if isinstance(outcome, str) else over
                    suspects.append(number)
        for number in (*under_way.values(), *suspects, *waiting):
            yield number, work.lost(jobs[number], str(over))


_Performed = tuple[Any, str, tuple[int, str] | None]
"""A result, the address of the worker, and the content of the target there."""


def _outcome(future: Future) -> _Performed | str | Exception | None:
    """Return what a task returned or raised; a text if the work is over; None if it is done again."""
    from distributed import CancelledError

    if future.status not in {"finished", "error", "cancelled"}:
        return None  # its worker died with the result
    try:
        outcome: _Performed | str = future.result()
    except CancelledError:
        return GONE
    except (ImportError, AttributeError) as error:
        return _refused(f"a worker has no skinbake, or one without --dask ({error})")
    except Exception as error:  # a task may raise anything, as may its worker
        return error
    return _refused(outcome) if isinstance(outcome, str) else outcome


def absolute(job: Job) -> Job:
    """Return a job whose paths mean the same in every folder."""

    def path(name: str) -> str:
        return name if is_url(name) else str(Path(name).absolute())

    bounds, output = job.within
    root = None if bounds.root is None else path(bounds.root)
    within = Within(Bounds(root, tuple(map(path, bounds.allowed))), None if output is None else path(output))
    target = None if job.target is None else path(job.target)
    return job._replace(source=path(job.source), target=target, within=within)


def content(name: str | None) -> tuple[int, str] | None:
    """Return the size and the digest of the file of a path; None for a URL, and if it cannot be read."""
    if name is None or is_url(name):
        return None
    try:
        with os.fdopen(open_regular(name), "rb") as file:
            return os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def _checked(
    work: Work[Job, ResultT], job: Job, result: ResultT, worker: str, made: tuple[int, str] | None
) -> ResultT:
    """Return the result of a job, or its failure if the worker's target is not the file that is here."""
    if result.error is not None or job.target is None or made == content(job.target):
        return result
    message = f"the worker {worker} has written it on a disk that this machine does not see: share the folder"
    return work.failed(job, OutputError(message, Place(job.target)))


class _Call:
    """Unpickling it calls the function with the arguments, and returns the result."""

    def __init__(self, function: Callable[..., object], *arguments: object) -> None:
        self._call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return self._call


def call(function: Callable[..., object], *arguments: object) -> bytes:
    """Return a call as bytes. ``pickle.loads`` of them makes the call.

    Dask's schedulers unpickle the tasks that they pass on. A task made of ``pickle.loads`` and some bytes
    needs nothing there, so only workers need skinbake.
    """
    return pickle.dumps(_Call(function, *arguments))


def build() -> str:
    """Return skinbake's version, and whether it lacks its compiled loops: the last bits depend on both."""
    from skinbake.gradients import kernel

    return __version__ if kernel.IS_COMPILED else f"{__version__} without compiled loops"


def versions() -> tuple[str, str, str]:
    """Return the versions of skinbake, Python and NumPy: the bytes of an output depend on them."""
    import numpy as np

    return build(), platform.python_version(), np.__version__


def perform(version: str, pickled: bytes) -> str | _Performed:
    """Do a pickled (work, job, job as given, content of its source) on a worker.

    Return the result, this worker's address, and the content of the target. If the client has another
    version, return a text that names the version here. Then nothing is unpickled, because the client's
    classes may have other members.
    """
    from distributed import get_worker

    worker = str(get_worker().address)
    if version != build():
        return f"{worker} has skinbake {build()}"
    work, job, given, expected = pickle.loads(pickled)
    found = content(job.source)
    if found != expected:
        what = "cannot open it" if found is None else "sees another file under this path"
        sizes = "" if found is None or expected is None else f" ({found[0]} bytes, {expected[0]} expected)"
        error: SkinbakeError = InputError(
            f"the worker {worker} {what}{sizes}: share the folder with the workers", Place(given.source)
        )
        return work.failed(given, error), worker, None
    pairs = [(job.source, given.source), (job.target, given.target), (job.within.output, given.within.output)]
    pairs += [(job.within.bounds.root, given.within.bounds.root)]
    names = {path: name for path, name in pairs if path is not None and name is not None}
    result = with_names(lambda: work(job), naming(names))
    return result, worker, content(job.target)


def _refused(what: str) -> str:
    return f"{what}, this is {build()}: install the same on all workers"


def _blame(error: BaseException) -> str:
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "each worker that took it died, also when it was alone there: killed, or out of memory"
    return f"its worker failed: {type(error).__name__}: {error}"


def _client(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        message = f"--dask needs Dask, which is not installed: {installing('dask')}"
        raise InputError(message, Place(address)) from error
    if not logging.getLogger().isEnabledFor(logging.DEBUG):  # our own messages tell what matters
        for name in [*logging.root.manager.loggerDict]:
            if name.partition(".")[0] in {"distributed", "tornado"}:
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        asyncio.run(_greeted(address))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about versions; ``connect`` reports what matters
            return Client(address, timeout=CONNECT_SECONDS, set_as_default=False, name="skinbake")
    except Exception as error:  # an address, TLS and the network fail by exceptions of any type
        text = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"no Dask scheduler answers: {text}", Place(address)) from error


async def _greeted(address: str) -> None:
    """Wait until a scheduler answers the greeting of a connection. Raises TimeoutError, and what Dask raises.

    Dask's client waits without a limit for that answer. A frozen scheduler, or another program at its port,
    takes the connection and says nothing.
    """
    from distributed import Security
    from distributed.comm import connect

    greeting = connect(address, timeout=CONNECT_SECONDS, **Security().get_connection_args("client"))
    try:
        connection = await asyncio.wait_for(greeting, CONNECT_SECONDS + 1.0)
    except TimeoutError as error:
        raise TimeoutError("it takes the connection, and then says nothing") from error
    await connection.close()
