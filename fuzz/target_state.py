"""Coverage-guided target: the records of a state file."""

from __future__ import annotations

from collections.abc import Callable

from fuzz.atheris_target import fuzz


def load() -> Callable[[bytes], object]:
    """Return the target."""
    import tempfile
    from pathlib import Path

    from skinbake.jobs.state import State

    path = Path(tempfile.mkdtemp()) / "state.jsonl"

    def target(data: bytes) -> None:
        path.write_bytes(data)
        state = State(str(path))
        state.known("bake m.glb")
        state.close()

    return target


if __name__ == "__main__":
    fuzz(load)
