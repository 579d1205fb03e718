"""Coverage-guided target: what a buffer view says of its meshopt data."""

from __future__ import annotations

from collections.abc import Callable

from fuzz.atheris_target import fuzz


def load() -> Callable[[bytes], object]:
    """Return the target."""
    import json

    from skinbake.errors import InputError, Place
    from skinbake.gltf.codecs import meshopt

    def target(data: bytes) -> None:
        try:
            view = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise InputError("no JSON") from error
        if isinstance(view, dict):
            place = Place("fuzz")
            name = meshopt.extension_of(view, place)
            meshopt.is_fallback(view, place)
            if name is not None:
                meshopt.check_length(memoryview(data), meshopt.packing(view, name, "it", place), "it", place)

    return target


if __name__ == "__main__":
    fuzz(load)
