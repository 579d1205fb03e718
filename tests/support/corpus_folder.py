"""Find the folder of the corpus of real models.

Nothing here needs pytest: the seeds of the fuzzers are made without it.
"""

from __future__ import annotations

import os
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def find_corpus() -> Path | None:
    """Return SKINBAKE_CORPUS, else ../shared/corpus beside the repository; None if there is no corpus."""
    told = os.environ.get("SKINBAKE_CORPUS")
    folder = Path(told) if told else REPOSITORY.parent / "shared" / "corpus"
    return folder if (folder / "public" / "ATTRIBUTION.tsv").is_file() else None
