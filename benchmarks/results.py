"""Measure everything that the table of benchmarks/RESULTS.md has, and write it.

Usage: python -m benchmarks.results [--quick] [--only ROW ... [--update]] [--real-time]
                                     [--output FILE.md]

Writes the figures of every single run beside the page, as JSON.
--quick takes one run each of small inputs, to see that all of it works, and writes into build/. --only prints
the figures of some rows and writes nothing. With --update it writes them into the stored results, and the
page says when and where they were measured. --real-time runs the commands before all other work of the
machine (Linux, privileged): for rows of short commands on a machine that others use.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import sys
import time
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks import peers, speedup_chart
from benchmarks.measure import FULL, QUICK, ROWS, Plan
from benchmarks.processes import Json, run_at_real_time
from benchmarks.results_page import page
from skinbake import __version__

OUTPUT = Path(__file__).with_name("RESULTS.md")
QUICK_OUTPUT = peers.REPOSITORY / "build" / "RESULTS.md"
PACKAGES = ("numpy", "scipy", "libigl")


def main() -> int:
    """Measure and write; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", choices=sorted(ROWS), metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("--update", action="store_true")
    parser.add_argument("--real-time", action="store_true")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    plan = QUICK if options.quick else FULL
    output = options.output or (QUICK_OUTPUT if options.quick else OUTPUT)
    load = os.getloadavg()[0]
    if options.real_time:
        run_at_real_time()
    rows = measured(plan, options.only or ROWS)
    if options.only and not options.update:
        print(as_json(rows), end="")
        return 0
    if options.only:
        results = updated(
            json.loads(output.with_suffix(".json").read_text(encoding="utf-8")),
            rows,
            load,
            real_time=options.real_time,
        )
    else:
        results = {"quick": options.quick, "date": time.strftime("%Y-%m-%d"), **environment(), "rows": rows}
    print(write(results, output))
    return 0


def updated(results: Json, rows: Json, load: float, *, real_time: bool = False) -> Json:
    """Return stored results with some rows measured again, and word of when and where."""
    machine = environment()["machine"]
    told = {
        "rows": sorted(rows),
        "date": time.strftime("%Y-%m-%d"),
        "load": round(load, 1),
        "real_time": real_time,
    }
    told |= {name: machine[name] for name in ("processor", "cores")}
    later = []
    for one in results.get("later", []):
        left = [name for name in one["rows"] if name not in rows]
        later += [{**one, "rows": left}] if left else []
    return {**results, "later": [*later, told], "rows": {**results["rows"], **rows}}


def write(results: Json, output: Path) -> str:
    """Write the figures, the page and its chart; return the page."""
    output.parent.mkdir(parents=True, exist_ok=True)
    output.with_suffix(".json").write_text(as_json(results), encoding="utf-8")
    text = page(results)
    output.write_text(text, encoding="utf-8")
    if "speedup" in results["rows"]:
        output.with_name(speedup_chart.CHART).write_text(
            speedup_chart.chart(results["rows"]["speedup"]), encoding="utf-8"
        )
    return text


def measured(plan: Plan, names: Iterable[str]) -> Json:
    """Measure rows one after the other, each in an empty folder of its own."""
    rows = {}
    for name in names:
        start = time.perf_counter()
        with TemporaryDirectory(prefix="skinbake-bench-") as folder:
            rows[name] = ROWS[name](plan, Path(folder))
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr)
    return rows


def as_json(results: Json) -> str:
    """Return JSON with the figures of each command in one line."""
    text = json.dumps(results, indent=1, ensure_ascii=False)
    return re.sub(r"\[[-\d.,\s]+\]", lambda found: " ".join(found[0].split()), text) + "\n"


def environment() -> Json:
    """Return what the figures depend on: the machine, and the versions of everything that ran."""
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    packages = {}
    for package in PACKAGES:
        try:
            packages[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "machine": {
            "processor": processor(),
            "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
            "memory_gib": round(memory / (1 << 30)),
            "system": f"{platform.system()} {platform.machine()}",
        },
        "versions": {
            "skinbake": __version__,
            "Python": platform.python_version(),
            **packages,
            **peers.versions(),
        },
    }


def processor() -> str:
    """Return what the processor calls itself."""
    described = Path("/proc/cpuinfo")
    if described.is_file():
        for line in described.read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    sys.exit(main())
