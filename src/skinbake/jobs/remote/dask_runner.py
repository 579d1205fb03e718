"""The same work on a Dask cluster: a runner whose processes are workers of a running ``dask scheduler``."""

from __future__ import annotations

import asyncio
import logging
import math
import pickle
import queue
import time
import warnings
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic
from uuid import uuid4

from skinbake.errors import InputError, Notice, Place
from skinbake.gltf.output import Writing
from skinbake.jobs.remote.dask_task import build, call, perform, versions
from skinbake.jobs.remote.sent_files import DoneHere, JobWithFiles, ResultWithFiles, WorkWithFiles
from skinbake.jobs.work import Job, ResultT, Work
from skinbake.timing import Told, is_heard, tell
from skinbake.wording import installing

if TYPE_CHECKING:
    from distributed import Client, Future  # distributed is untyped: these are Any

CONNECT_SECONDS = 10.0
PATIENCE_SECONDS = 300.0
LOOK_SECONDS = 2.0
"""The seconds after which a waiting client counts the workers again."""

WINDOW_PER_THREAD = 4
LEAST_WINDOW = 16
WINDOW_BYTES = 512 * 2**20
"""The approximate bytes of inputs that the scheduler holds, sent along with their jobs."""

TASK_SECONDS = 0.5
TASK_JOBS = 64
TASK_BYTES = 16 * 2**20
"""Limits of one task of several small jobs: their time, their number and their size."""

BATCH = 64
"""The number of tasks whose results are fetched at a time."""

GONE = "the connection to the scheduler was lost"


_Outcome = str | tuple[list[ResultWithFiles[ResultT]], float]
"""The value that ``perform`` returns for a task."""


class DaskRunner:
    """Run jobs on the workers of a scheduler, given by its address, like ``tcp://host:8786``.

    Each thread of a worker has some jobs under way at a time, no matter how many jobs there are. If a worker
    dies, its jobs are tried on other workers, as often as the scheduler's ``allowed-failures`` says. Another
    job may have killed the worker. So a job that was given up is tried once more at the end, alone in the
    cluster.

    Files with plain paths are read and written here. They travel with their jobs (``WorkWithFiles``).
    ``writing`` says how they are written.
    """

    def __init__(
        self, address: str, writing: Writing | None = None, *, patience: float = PATIENCE_SECONDS
    ) -> None:
        self.address = address
        self._writing = writing or Writing()
        self._patience = patience
        self._client: Client | None = None

    def __enter__(self) -> DaskRunner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def one_by_one(self) -> OneByOne:
        """Return a runner that has one job under way at a time, and yields in order."""
        return OneByOne(self)

    def connect(self) -> list[Notice]:
        """Connect to the scheduler, and return notices about its workers.

        Raises InputError if nothing answers, Dask is not installed, or a worker has another version of
        skinbake, because its output bytes may differ.
        """
        if self._client is not None:
            return []
        self._client = _client(self.address)
        try:
            return self._checked(self._client)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Leave the cluster. Jobs that have not begun there are forgotten."""
        if self._client is not None:
            # A scheduler that has gone away causes warnings, and exceptions of many types.
            with suppress(Exception), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._client.close(timeout=CONNECT_SECONDS)
            self._client = None

    def _checked(self, client: Client) -> list[Notice]:
        found = client.run(pickle.loads, call(versions), on_error="return")
        here = versions()
        others = set()
        for worker, theirs in found.items():
            if isinstance(theirs, ImportError | AttributeError):
                raise self._refusal(f"{worker} has no skinbake, or one without --dask ({theirs})")
            if isinstance(theirs, BaseException):  # it died, or is about to: its jobs will be tried elsewhere
                continue
            if theirs[0] != here[0]:
                raise self._refusal(f"{worker} has skinbake {theirs[0]}")
            if theirs[1:] != here[1:]:
                others.add("Python {}, NumPy {}".format(*theirs[1:]))
        if not others:
            return []
        message = (
            f"workers have {' or '.join(sorted(others))}, this is Python {here[1]}, NumPy {here[2]}: outputs "
            "may differ in rounding"
        )
        return [Notice("worker-versions", message, Place(self.address))]

    def _refusal(self, what: str) -> InputError:
        return InputError(_refused(what), Place(self.address))

    def run(
        self, work: Work[Job, ResultT], jobs: Sequence[Job], *, one_by_one: bool = False
    ) -> Generator[tuple[int, ResultT], None, None]:
        """Yield (number of the job, result) as jobs are done, in any order, each exactly once.

        All remaining jobs are lost if the scheduler goes away, if no worker comes for a while, or if a worker
        comes with another version of skinbake. Raises InputError as ``connect`` does.
        """
        import dask

        self.connect()
        assert self._client is not None
        sent = WorkWithFiles(work, self._writing)
        flight = _Flight(self._client, sent, jobs, self._patience, one_by_one=one_by_one)
        # The bytes of inputs are in the tasks on purpose: there they outlive workers.
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            try:
                yield from flight.results()
            finally:
                flight.cancel()


@dataclass(frozen=True, slots=True)
class OneByOne:
    """A runner that has one job under way at a time."""

    runner: DaskRunner

    def run(
        self, work: Work[Job, ResultT], jobs: Sequence[Job]
    ) -> Generator[tuple[int, ResultT], None, None]:
        """Yield (number, result) in order."""
        return self.runner.run(work, jobs, one_by_one=True)


@dataclass(frozen=True, slots=True)
class _Task:
    """Jobs that went to the cluster as one task: their numbers, the bytes sent, and the task's future."""

    numbers: tuple[int, ...]
    size: int
    future: Future
    alone: bool


class _Flight(Generic[ResultT]):
    """One run: the jobs that are still to be sent, under way, or suspected of killing workers."""

    def __init__(
        self,
        client: Client,
        work: WorkWithFiles[ResultT],
        jobs: Sequence[Job],
        patience: float,
        *,
        one_by_one: bool,
    ) -> None:
        self._client = client
        self._work = work
        self._jobs = jobs
        self._patience = patience
        self._one_by_one = one_by_one
        self._name = uuid4().hex
        self._next = 0
        self._suspects: deque[int] = deque()
        self._under_way: dict[str, _Task] = {}
        self._ended: queue.SimpleQueue[str | Told] = queue.SimpleQueue()
        # The rows of many files would fill the screen. Of many, the bar counts those that are done.
        self._topic = f"skinbake-{self._name}" if len(jobs) == 1 and is_heard() else None
        self._sent = 0
        self._seconds: float | None = None
        self._threads = 0
        self._looked = -math.inf
        self._worker_seen = time.monotonic()
        self._over: str | None = None

    def results(self) -> Iterator[tuple[int, ResultT]]:
        """Yield each job's number and result."""
        if self._topic:
            self._client.subscribe_topic(self._topic, self._hear)
        while self._over is None and (self._next < len(self._jobs) or self._suspects or self._under_way):
            self._look()
            yield from self._launch()
            # Yield the results of tasks that succeeded, and handle those that ended otherwise.
            keys = self._some_ended()
            finished = []
            for key in keys:
                future = self._under_way[key].future
                if future.status == "finished":
                    finished.append(key)
                elif future.status == "error":
                    yield from self._broken(self._taken(key), future.exception())
                elif future.status == "cancelled":
                    self._over = GONE
                else:  # its worker died with the result, so the task is done again
                    future.add_done_callback(self._note)
            for key, outcome in zip(finished, self._gathered(finished), strict=True):
                task = self._taken(key)
                if isinstance(outcome, BaseException):
                    yield from self._broken(task, outcome)
                elif isinstance(outcome, str):
                    self._over = _refused(outcome)
                    self._suspects.extend(task.numbers)
                else:
                    yield from self._done(task, *outcome)
        left = [n for task in self._under_way.values() for n in task.numbers]
        for number in (*left, *self._suspects, *range(self._next, len(self._jobs))):
            yield number, self._work.lost(self._jobs[number], str(self._over))

    def cancel(self) -> None:
        """Forget the jobs that have not begun. A job that runs on a worker comes to its end there."""
        self._under_way.clear()  # Dask drops tasks without a held future
        if self._topic:
            with suppress(Exception):  # the scheduler may have gone away
                self._client.unsubscribe_topic(self._topic)

    def _look(self) -> None:
        """Count the workers' threads from time to time. Give up if there have been none for long."""
        now = time.monotonic()
        if now - self._looked < LOOK_SECONDS:
            return
        self._looked = now
        if self._client.status == "closed":
            self._over = GONE
            return
        with suppress(OSError):  # the connection was lost: futures will say so
            self._threads = sum(self._client.nthreads().values())
        if self._threads:
            self._worker_seen = now
        elif now - self._worker_seen > self._patience:
            self._over = f"the scheduler has had no worker for {self._patience:.0f} s"

    def _launch(self) -> Iterator[tuple[int, ResultT]]:
        """Send jobs while there is room. Yield the results of the jobs that need not be sent."""
        window = 1 if self._one_by_one else max(LEAST_WINDOW, WINDOW_PER_THREAD * self._threads)
        while self._next < len(self._jobs) and len(self._under_way) < window and self._sent < WINDOW_BYTES:
            first, last = self._next, min(self._next + self._jobs_of_a_task(), len(self._jobs))
            packed: dict[int, JobWithFiles | DoneHere[ResultT]] = {}
            size = 0
            for number in range(first, last):
                self._next = number + 1
                packed[number] = self._work.with_files(self._jobs[number])
                size += packed[number].size
                if size > TASK_BYTES:
                    break
            yield from self._submitted(packed, alone=False)
        if self._suspects and not self._under_way:
            number = self._suspects.popleft()
            yield from self._submitted({number: self._work.with_files(self._jobs[number])}, alone=True)

    def _jobs_of_a_task(self) -> int:
        """Return the number of jobs for one task. Each task costs the scheduler about a millisecond."""
        if self._one_by_one or not self._seconds:
            return 1
        share = (len(self._jobs) - self._next) // (2 * WINDOW_PER_THREAD * max(self._threads, 1))
        return max(1, min(TASK_JOBS, share, int(TASK_SECONDS / self._seconds)))

    def _submitted(
        self, packed: dict[int, JobWithFiles | DoneHere[ResultT]], *, alone: bool
    ) -> Iterator[tuple[int, ResultT]]:
        """Send jobs as one task. Yield the results of the jobs that need not be sent."""
        sent = {}
        for number, job in packed.items():
            if isinstance(job, DoneHere):
                yield number, job.result
            else:
                sent[number] = job
        if not sent:
            return
        pickled = call(perform, build(), pickle.dumps((self._work, list(sent.values()))), self._topic)
        if self._topic:
            tell(Told(self._jobs[0].source, "waiting for a worker"))
        numbers = tuple(sent)
        key = f"skinbake-{self._name}-{numbers[0]}{'-alone' if alone else ''}"
        future = self._client.submit(pickle.loads, pickled, key=key, pure=False)
        self._under_way[key] = _Task(numbers, len(pickled), future, alone)
        self._sent += len(pickled)
        future.add_done_callback(self._note)

    def _note(self, future: Future) -> None:
        self._ended.put(future.key)

    def _hear(self, event: tuple[float, Sequence[Any]]) -> None:
        """Note an event of the worker, on the thread of the client's network."""
        self._ended.put(Told(self._jobs[0].source, *event[1]))

    def _some_ended(self) -> list[str]:
        """Wait a little for tasks to end, and return the keys of the ended ones. Tell what workers told."""
        found: list[str | Told] = []
        if not self._under_way:
            return []
        with suppress(queue.Empty):  # no more have ended
            found.append(self._ended.get(timeout=LOOK_SECONDS))
            while len(found) < BATCH:
                found.append(self._ended.get_nowait())
        for told in found:
            if isinstance(told, Told):
                tell(told)
        return [key for key in found if isinstance(key, str)]

    def _taken(self, key: str) -> _Task:
        task = self._under_way.pop(key)
        self._sent -= task.size
        return task

    def _gathered(self, keys: Sequence[str]) -> list[_Outcome[ResultT] | BaseException]:
        """Return the outcomes of finished tasks. A task that is broken after all has an exception."""
        futures = [self._under_way[key].future for key in keys]
        try:
            return list(self._client.gather(futures))
        except Exception:  # one task failed, and gather does not say which
            return [self._one(future) for future in futures]

    def _one(self, future: Future) -> _Outcome[ResultT] | BaseException:
        try:
            outcome: _Outcome[ResultT] = future.result()
            return outcome
        except Exception as error:  # a task may raise anything, as may its worker
            return error

    def _done(
        self, task: _Task, results: Sequence[ResultWithFiles[ResultT]], seconds: float
    ) -> Iterator[tuple[int, ResultT]]:
        each = seconds / len(results)
        self._seconds = each if self._seconds is None else 0.8 * self._seconds + 0.2 * each
        for number, result in zip(task.numbers, results, strict=True):
            yield number, self._work.result_here(self._jobs[number], result)

    def _broken(self, task: _Task, error: BaseException) -> Iterator[tuple[int, ResultT]]:
        """Yield the lost jobs of a task that raised an exception or killed its workers."""
        from distributed import CancelledError

        if isinstance(error, CancelledError):
            self._over = GONE
        elif isinstance(error, ImportError | AttributeError):
            self._over = _refused(f"a worker has no skinbake, or one without --dask ({error})")
        elif task.alone:
            number = task.numbers[0]
            yield number, self._work.lost(self._jobs[number], _blame(error))
            return
        self._suspects.extend(task.numbers)


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
    _silence()
    try:
        asyncio.run(_greeted(address))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about versions; ``connect`` reports the ones that matter
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


def _silence() -> None:
    """Keep Dask's log off the terminal. skinbake's own messages tell the user what matters."""
    if logging.getLogger().isEnabledFor(logging.DEBUG):
        return
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] in {"distributed", "tornado"}:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
