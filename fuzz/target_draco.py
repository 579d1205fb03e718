"""Coverage-guided target: the counts at the beginning of a Draco stream."""

from __future__ import annotations

from collections.abc import Callable

from fuzz.atheris_target import fuzz


def load() -> Callable[[bytes], object]:
    """Return the target."""
    from skinbake.errors import Place
    from skinbake.gltf.codecs.draco_stream import read_counts

    return lambda data: read_counts(memoryview(data), Place("fuzz"))


if __name__ == "__main__":
    fuzz(load)
