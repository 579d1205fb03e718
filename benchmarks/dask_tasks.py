"""Print how many tasks that do nothing Dask's scheduler hands to worker processes in a second.

Usage: python -m benchmarks.dask_tasks TASKS WORKERS
"""

from __future__ import annotations

import sys
import time

from distributed import Client, LocalCluster


def nothing(number: int) -> int:
    return number


def main() -> None:
    count, workers = int(sys.argv[1]), int(sys.argv[2])
    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.gather(client.map(nothing, range(-workers, 0)))
        start = time.perf_counter()
        client.gather(client.map(nothing, range(count)))
        print(count / (time.perf_counter() - start))


if __name__ == "__main__":
    main()
