"""Whether outputs are of their sources as they are now, by the records of ``bake --skip-unchanged``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from skinbake.errors import Notice, Place
from skinbake.jobs.state import Origin, State, absolute
from skinbake.report.verify import SOURCES, Check

BAKE = "skinbake bake --skip-unchanged"
"""What makes an output and notes it, with the options of the build."""


def checks_of(
    state: State, outputs: Iterable[str], sources: Sequence[str], folder: str, allowed: Sequence[str] = ()
) -> dict[str, Check]:
    """Return a check for each output, by its name, and one for each source that has no output.

    ``sources`` are the models below ``folder``. ``allowed`` are further folders in which files may be read.
    """
    origins = state.origins()
    named = {absolute(path): path for path in sources}
    found = {}
    for output in outputs:
        origin = origins.get(absolute(output))
        roots = [*map(os.path.realpath, (folder, *allowed)), str(Path(absolute(output)).parent)]
        problems = tuple(_problems(output, origin, named, roots, folder))
        remark = "" if origin is None else named.get(origin.source, "")
        found[output] = Check(SOURCES, "failed" if problems else "passed", problems, remark)
    with_output = {origin.source for path, origin in origins.items() if os.path.lexists(path)}
    for source, name in named.items():
        if source not in with_output:
            problem = Notice("output-missing", f"it has no output: run {BAKE}", Place(name))
            found[name] = Check(SOURCES, "failed", (problem,))
    return found


def _problems(
    output: str, origin: Origin | None, named: dict[str, str], roots: Sequence[str], folder: str
) -> Iterator[Notice]:
    """Yield what is wrong with an output: it has no record, its source is gone, or has changed."""
    place = Place(output)
    if origin is None:
        message = "no record tells its source: bake it with --skip-unchanged, or remove it"
        yield Notice("source-unknown", message, place)
    elif origin.source not in named:
        advice = f"is not below {folder}: name its folder with --sources"
        if not os.path.lexists(origin.source):
            advice = "is gone: remove the output"
        yield Notice("source-gone", f"its source {os.path.relpath(origin.source)} {advice}", place)
    elif changed := origin.changed(roots):
        names = ", ".join(Path(path).name for path in changed)
        message = f"{names} changed since its bake: run {BAKE} on {named[origin.source]}"
        yield Notice("source-changed", message, place, len(changed))
