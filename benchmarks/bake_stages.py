"""Bake a file and print the seconds of each stage as JSON.

Usage: python -m benchmarks.bake_stages MODEL OUTPUT.glb
"""

from __future__ import annotations

import json
import sys

from skinbake.commands.bake import bake_file
from skinbake.timing import recorded


def main() -> None:
    with recorded() as timings:
        bake_file(sys.argv[1], sys.argv[2])
    print(json.dumps(timings.seconds))


if __name__ == "__main__":
    main()
