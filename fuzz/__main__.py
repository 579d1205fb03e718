"""Run damaged models through every command for some minutes: ``python -m fuzz --minutes 2``."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from fuzz.aimed import aimed_cases
from fuzz.batches import FINDS, Plan, Totals, run_all
from fuzz.log import LOG, note
from fuzz.seeds import all_seeds


def main() -> int:
    """Fuzz as the command line says; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, help="The first seed; by default the time.")
    parser.add_argument("--runs", type=int, help="Stop after so many runs.")
    parser.add_argument("--finds", type=Path, default=FINDS, help="Where cases are kept.")
    parser.add_argument(
        "--corpus", type=Path, help="Keep the models to damage here, and take them from here."
    )
    parser.add_argument("--log", type=Path, default=LOG)
    given = parser.parse_args()
    models = all_seeds(given.corpus)
    first = given.seed if given.seed is not None else int(time.time()) * 10_000
    begun = time.monotonic()
    seconds, aimed = given.minutes * 60, aimed_cases(models)
    totals = run_all(Plan(models, first, seconds, given.workers, given.runs, given.finds, aimed=aimed))
    seconds = time.monotonic() - begun
    note("commands", executions=totals.runs, seconds=seconds, seed=first, finds=totals.finds, log=given.log,
         models=len(models), codes=dict(totals.codes))  # fmt: skip
    print("\n".join(summary(totals, seconds, first, len(models), given.finds)))
    return 1 if totals.finds else 0


def summary(totals: Totals, seconds: float, first: int, models: int, finds: Path) -> list[str]:
    """Return what was done and found, in lines."""
    rate = totals.runs / max(seconds, 1e-9)
    lines = [
        f"{totals.runs} runs from seed {first} on {models} models in {seconds:.0f} s, {rate:.0f} a second"
    ]
    lines += [f"  {count:8} {code}" for code, count in sorted(totals.codes.items())]
    if totals.finds:
        lines.append(f"{len(totals.finds)} causes found, kept in {finds}:")
        lines += [f"  {count:8} {name}" for name, count in totals.finds.most_common()]
    return lines


if __name__ == "__main__":
    sys.exit(main())
