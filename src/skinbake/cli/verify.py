"""``skinbake verify``."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import Console, console, finite, message_options
from skinbake.cli.targets import STDIO, check_readable_suffix
from skinbake.errors import OutputError, Place

PROGRESS_AFTER = 2.0
"""Seconds of work before a progress bar is shown."""


def _poses(ctx: click.Context, param: click.Parameter, value: str) -> tuple[str, int | None]:
    kind, _, number = value.partition(":")
    if kind not in {"animation", "random", "rest"} or (number and kind != "random"):
        raise click.BadParameter("must be animation, rest, random or random:N")
    if number and not (number.isdecimal() and int(number) > 0):
        raise click.BadParameter("N of random:N must be a positive number")
    return kind, int(number) if number else None


@click.command("verify")
@click.argument("inputs", nargs=-1, required=True, metavar="FILE...")
@click.option(
    "--method",
    "methods",
    type=click.Choice(["lbs", "dqs"]),
    multiple=True,
    help="Skinning to measure; both by default, DQS where all joints are rigid.",
)
@click.option(
    "--poses",
    default="animation",
    show_default=True,
    callback=_poses,
    metavar="WHICH",
    help="animation (the file's own clips), random:N, or rest.",
)
@click.option(
    "--samples",
    type=click.IntRange(1),
    help="Poses of each clip; by default about 60 in all, at least 3 a clip.",
)
@click.option(
    "--angle",
    type=click.FloatRange(0, 180),
    callback=finite,
    default=30.0,
    show_default=True,
    metavar="DEG",
    help="Largest rotation of a joint in random poses.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of random poses.")
@click.option(
    "--baseline",
    type=click.Choice(["blended", "inverse-transpose", "cofactor"]),
    default="blended",
    show_default=True,
    help="What standard LBS lighting is: as in three.js, Bevy or Filament.",
)
@click.option(
    "--cap",
    type=click.FloatRange(0, min_open=True),
    callback=finite,
    help="Limit the correction of a tangent to this share of it (the authors' demo: 0.9); off by default.",
)
@click.option(
    "--max-mean-error", type=click.FloatRange(0), callback=finite, metavar="DEG", help="Fail above this mean."
)
@click.option(
    "--max-p95-error",
    type=click.FloatRange(0),
    callback=finite,
    metavar="DEG",
    help="Fail above this percentile.",
)
@click.option(
    "--min-gain",
    type=click.FloatRange(0),
    callback=finite,
    metavar="X",
    help="Fail below this gain over standard.",
)
@click.option("--require-baked", is_flag=True, help="Fail where a file holds no bake.")
@click.option("--warnings-as-errors", is_flag=True, help="Fail where there are warnings.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option("--junit", metavar="FILE", help="Also write the results as JUnit XML.")
@message_options
def command(inputs: tuple[str, ...], **given: Any) -> None:
    """Check that files still carry the right α/β, and measure what they are worth.

    Structure: α/β and metadata are there and whole. Freshness: nothing that α/β depend on was changed since
    the bake, and an independent computation gives the same α/β. Lighting: how far the normals of each
    algorithm are from the true ones, in degrees, in the file's own animations. Limits apply to the accurate
    lighting of each --method asked for (LBS otherwise). FILE may be - for a GLB on stdin.
    """
    for source in inputs:
        check_readable_suffix(source)
    if inputs.count(STDIO) > 1:
        raise click.UsageError("stdin can be read once only")
    say = console(verbose=given["verbose"], quiet=given["quiet"], color=given["color"])
    from skinbake.commands.verify import verify_file
    from skinbake.report.verify import as_json, as_junit, as_text

    options = _options(given)
    verdicts, code = [], exit_codes.OK
    with _progress(say) as progress:
        for source in inputs:
            verdict = verify_file(source, options, progress)
            verdicts.append(verdict)
    for verdict in verdicts:
        say.notices(verdict.notices)
        say.problems(problem for check in verdict.checks for problem in check.problems)
        if verdict.error is not None:
            say.error(verdict.error)
            code = max(code, exit_codes.of_error(verdict.error))
        elif not verdict.passed:
            code = max(code, exit_codes.VERIFICATION)
        if not given["as_json"]:
            say.result(as_text(verdict))
    if given["junit"]:
        code = max(code, _write(given["junit"], as_junit(verdicts), say))
    if given["as_json"]:
        say.document(as_json(verdicts, exit_code=code))
    sys.exit(code)


def _options(given: dict[str, Any]) -> Any:
    """Return the VerifyOptions that the command line asks for."""
    import math

    from skinbake.commands.lighting import VerifyOptions
    from skinbake.commands.poses import PoseRequest
    from skinbake.replay.surface import Baseline

    kind, count = given["poses"]
    return VerifyOptions(
        methods=tuple(dict.fromkeys(given["methods"])),
        poses=PoseRequest(kind, count or given["samples"], math.radians(given["angle"]), given["seed"]),
        max_mean_error=given["max_mean_error"],
        max_p95_error=given["max_p95_error"],
        min_gain=given["min_gain"],
        require_baked=given["require_baked"],
        warnings_as_errors=given["warnings_as_errors"],
        cap=given["cap"],
        baseline=Baseline(given["baseline"]),
    )


def _write(path: str, text: str, say: Console) -> int:
    """Write the JUnit file; return the exit code."""
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        say.error(OutputError(f"cannot be written: {error.strerror}", Place(path)))
        return exit_codes.OUTPUT
    return exit_codes.OK


@contextmanager
def _progress(say: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a callback that shows a bar once the work has taken some time, where stderr is a terminal."""
    started = time.monotonic()
    bar: Any = None
    tasks: dict[str, Any] = {}

    def advance(what: str, done: int, total: int) -> None:
        nonlocal bar
        if bar is None and (say.verbosity < 0 or time.monotonic() - started < PROGRESS_AFTER):
            return
        if bar is None:
            from rich.console import Console as RichConsole
            from rich.progress import Progress

            stderr = RichConsole(stderr=True, no_color=say.color is False)
            bar = Progress(console=stderr, transient=True, disable=not stderr.is_terminal)
            bar.start()
        if what not in tasks:
            from pathlib import PurePath

            from rich.markup import escape

            # A whole path would leave no room for the bar.
            tasks[what] = bar.add_task(escape(PurePath(what).name))
        bar.update(tasks[what], completed=done, total=total)

    try:
        yield advance
    finally:
        if bar is not None:
            bar.stop()
