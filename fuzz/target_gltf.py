"""Coverage-guided target: the accessors, views and buffers of a .gltf whose data are in its URIs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from fuzz.atheris_target import fuzz


def load() -> Callable[[bytes], object]:
    """Return the target."""
    from pathlib import Path

    from skinbake.errors import SkinbakeError
    from skinbake.gltf.document import parse_gltf
    from skinbake.gltf.reading.accessors import read_accessor

    def target(data: bytes) -> None:
        document = parse_gltf(data, "fuzz.gltf", Path("nowhere"))
        for number in range(min(len(document.objects("accessors")), 8)):
            with suppress(SkinbakeError):  # the other reader has its turn after a refusal
                read_accessor(document, number, document.place)
            with suppress(SkinbakeError):
                document.asset.accessors[number].described(document.place)

    return target


if __name__ == "__main__":
    fuzz(load)
