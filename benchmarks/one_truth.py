"""Run skinbake with one truth taken out of verify, which always measures by both.

Usage: python -m benchmarks.one_truth TRUTH ARGUMENT ...

The arguments are those of ``skinbake``. It imports nothing that skinbake does not import, so that whole
processes can be compared.
"""

from __future__ import annotations

import os
import sys
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does before it imports numpy

from skinbake.__main__ import run
from skinbake.choices import Truth
from skinbake.measure import measured
from skinbake.truth.truths import truths_at_rest


def main() -> None:
    """Let verify measure by one truth alone."""
    truth = Truth(sys.argv.pop(1))
    measured.truths_at_rest = partial(truths_at_rest, names=(truth,))  # type: ignore[attr-defined]
    run()


if __name__ == "__main__":
    main()
