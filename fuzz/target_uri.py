"""Coverage-guided target: data: URIs, and the names that others mean."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from fuzz.atheris_target import fuzz


def load() -> Callable[[bytes], object]:
    """Return the target."""
    from skinbake.errors import Place
    from skinbake.files.bounds import Bounds, RefusedError, bounded_paths
    from skinbake.gltf import resources

    def target(data: bytes) -> None:
        uri = data.decode("utf-8", "surrogateescape")
        if resources.is_data_uri(uri):
            resources.decode_data_uri(uri, Place("fuzz"))
        else:
            with suppress(RefusedError):  # a refusal is an answer
                bounded_paths(uri, "/models", Bounds("/models"))

    return target


if __name__ == "__main__":
    fuzz(load)
