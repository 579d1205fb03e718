"""A real Dask cluster on this machine: a scheduler and workers, each a process."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tests.support.strictness import missing_tool

REPOSITORY = Path(__file__).resolve().parents[2]
PATIENCE = 60.0
"""Seconds after which a cluster that does not come up is given up."""


def require_dask() -> None:
    """Skip the module where Dask is missing; fail it in a strict run."""
    if find_spec("distributed") is None:
        missing_tool("Dask is not installed: pip install 'skinbake[dask]'")


@dataclass
class Cluster:
    """A scheduler's address, and its workers' processes in the order in which they were started."""

    address: str
    folder: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start_worker(self, *options: str, env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        """Start a worker with one thread, which finds this repository's modules."""
        number = len(self.workers)
        command = ["worker", self.address, "--nthreads", "1", "--name", str(number), "--no-dashboard"]
        command += ["--local-directory", str(self.folder / f"worker{number}"), *options]
        process = _dask(command, self.folder, {"PYTHONPATH": str(REPOSITORY), **(env or {})})
        self.workers.append(process)
        return process


@contextmanager
def cluster(
    folder: Path, *, workers: int = 2, allowed_failures: int = 3, options: Sequence[str] = ()
) -> Iterator[Cluster]:
    """Run a cluster; the scheduler finds no module of this repository's tests."""
    port = _free_port()
    address = f"tcp://127.0.0.1:{port}"
    folder.mkdir(parents=True, exist_ok=True)
    env = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(allowed_failures)}
    command = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    scheduler = _dask([*command, "--no-show"], folder, env)
    found = Cluster(address, folder, scheduler)
    try:
        for _ in range(workers):
            found.start_worker(*options)
        yield found
    finally:
        for process in (*found.workers, scheduler):
            # A nanny's worker too. Asked to end, they take their time.
            with suppress(ProcessLookupError):  # it has ended by itself
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextmanager
def observer(address: str) -> Iterator[Any]:
    """Yield a client of the test's own, by which to look into a cluster."""
    from distributed import Client

    client = Client(address, timeout=PATIENCE, set_as_default=False)
    try:
        yield client
    finally:
        client.close()


def wait_for_workers(client: Any, count: int) -> None:
    """Wait until so many workers are there."""
    client.wait_for_workers(count, timeout=PATIENCE)


def _dask(command: Sequence[str], folder: Path, env: dict[str, str]) -> subprocess.Popen[bytes]:
    log = (folder / f"{command[0]}-{time.monotonic_ns()}.log").open("wb")
    with log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *command],
            cwd=folder,
            env={**os.environ, **env},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
