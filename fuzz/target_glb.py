"""Coverage-guided target: the chunks of a GLB, and its JSON."""

from __future__ import annotations

from collections.abc import Callable

from fuzz.atheris_target import fuzz


def load() -> Callable[[bytes], object]:
    """Return the target."""
    from pathlib import Path

    from skinbake.gltf.document import parse_glb

    return lambda data: parse_glb(data, "fuzz.glb", Path("nowhere"))


if __name__ == "__main__":
    fuzz(load)
