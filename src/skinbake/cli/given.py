"""The options that the commands for many files share, as click gives them."""

from __future__ import annotations

from typing import NotRequired, TypedDict, cast


class Given(TypedDict):
    """The options of all commands for many files. Each command has options of its own in addition.

    ``output``, ``out_dir``, ``depfile`` and ``dry_run`` belong to commands that write, ``fit_poses`` and
    ``pack`` to ``bake``, ``sources`` to ``verify``.
    """

    as_json: bool
    timings: bool
    summary: str | None
    state: str | None
    skip_unchanged: bool
    jobs: int
    threads: int | None
    no_sync: bool
    isolate: bool
    timeout: float | None
    max_memory: int | None
    dask: str | None
    allow_outside: tuple[str, ...]
    warnings_as_errors: bool
    color: str
    quiet: bool
    verbose: int
    output: NotRequired[str | None]
    sources: NotRequired[str | None]
    out_dir: NotRequired[str | None]
    dry_run: NotRequired[bool]
    fit_poses: NotRequired[tuple[str, ...]]
    pack: NotRequired[bool]
    depfile: NotRequired[str | None]


def alone(some: Given) -> Given:
    """Return the options of a command that has none for clusters, threads and state files."""
    absent = {"dask": None, "threads": None, "skip_unchanged": False, "state": None}
    return cast("Given", {**absent, **some})
