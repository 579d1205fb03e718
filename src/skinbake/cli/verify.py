"""``skinbake verify``."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.choices import Method
from skinbake.cli import exit_codes
from skinbake.cli.configuration import option_sets
from skinbake.cli.console import Console, console
from skinbake.cli.given import Given
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import Input, expanded
from skinbake.cli.limits import within_limits
from skinbake.cli.many import Clock, Reporting, notes_of, run_of, state_path, work_through
from skinbake.cli.targets import check_earlier, check_reports, is_page, jobs_of
from skinbake.cli.writing import tell_of_report, write_report
from skinbake.errors import ChoiceError, Chosen, Notices, SkinbakeError, printable
from skinbake.files.bounds import Bounds
from skinbake.files.urls import STDIO, is_url
from skinbake.options import STATE_NAME, VERIFY, By, defaults
from skinbake.threads import threads_limited

if TYPE_CHECKING:
    from typing import Unpack

    from skinbake.measure.options import VerifyOptions
    from skinbake.report.verify import Check, FileVerdict


class VerifyGiven(Given):
    """The options of verify that its report needs, as click gives them."""

    junit: str | None
    html: str | None
    dump_normals: str | None
    clip: str | None
    time: float | None


@click.command(
    "verify",
    cls=Helpful,
    examples=(
        "skinbake verify build/hero.glb",
        "skinbake verify build --jobs auto --require-baked --min-gain 1.5 --junit build/skinbake.xml",
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@click.pass_context
def command(ctx: click.Context, inputs: tuple[str, ...], **given: Unpack[VerifyGiven]) -> None:
    """Check that files still carry the right α/β, and measure how much they improve the lighting.

    Structure: α/β and metadata are there and whole. Freshness: a bake of the file as it is now would give the
    same α/β. Gradients of the surface are found by other code than bake's, fitted ones by bake's. Lighting:
    how far the normals of each algorithm are from the true ones, in degrees, in the file's own animations.
    Limits apply to the accurate lighting of each --method asked for (LBS otherwise). INPUT is a .glb, .gltf
    or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a quoted pattern like
    'build/**/*.glb'. Each may be a URL. One file has a
    verdict and the next step, several have a line each; -v shows every figure.
    """
    clock = Clock()
    say = console(given)
    found, notes_at = expanded(inputs), state_path(given)
    checks, without_output = _sources(inputs, found, given)
    found = [*found, *without_output]
    reports = {
        "--junit": given["junit"],
        "--html": given["html"],
        "--dump-normals": given["dump_normals"],
        "--summary": given["summary"],
        "--state": notes_at,
    }
    for option in ("--html", "--dump-normals"):
        if reports[option] and any(entry.source == STDIO or is_url(entry.source) for entry in found):
            raise click.UsageError(
                f"{option} needs files on this machine's disks, because it reads them again"
            )
    if given["dump_normals"] and len(found) > 1:
        raise click.UsageError("--dump-normals takes one input")
    for name in ("clip", "time"):
        if given[name] is not None and not given["dump_normals"]:
            raise ChoiceError(name, reason=(" is for ", Chosen("dump_normals")))
    check_reports(reports, (entry.file for entry in found))
    if given["html"] and len(found) > 1:
        from skinbake.view.index import pages

        for page in pages(given["html"], [entry.source for entry in found]):
            check_earlier(str(page), is_page, "--html: ")
    sources = [entry.source for entry in found]
    sets = option_sets(ctx, given, sources)
    options = sets.each(_options)
    from skinbake.jobs.verify import Verify

    bare = frozenset(entry.source for entry in without_output)
    commands = [Verify(one, checks, bare) for one in options]
    notes = notes_of("verify", options, notes_at, found, say, sync=not given["no_sync"])
    jobs = sets.numbered(jobs_of([(entry, None) for entry in found], given, notes))
    options_of = {source: options[number] for source, number in zip(sources, sets.numbers, strict=True)}
    searched = {entry.source: entry.searched for entry in found}
    reporting = _reporting(given, say, options_of, searched, is_one=len(found) == 1)
    clock.imports_done()
    run = run_of(commands, jobs, given, say, notes)
    sys.exit(work_through(run, reporting, given, say, clock, notes))


def _sources(
    inputs: Sequence[str], found: Sequence[Input], given: VerifyGiven
) -> tuple[Mapping[str, Check], list[Input]]:
    """Return the check of each output and bare source by --sources, and these sources.

    Raises click.UsageError without a state file that could tell.
    """
    folder = given.get("sources")
    if not folder:
        return {}, []
    from skinbake.jobs.sources import checks_of
    from skinbake.jobs.state import State

    if given["dask"] or any(entry.source == STDIO or is_url(entry.source) for entry in found):
        raise click.UsageError("--sources needs files on this machine's disks, without --dask")
    if not Path(folder).is_dir():
        raise click.UsageError(f"--sources: {folder} is not a folder")
    state_at = given["state"]
    own = Path(inputs[0], STATE_NAME) if len(inputs) == 1 and Path(inputs[0]).is_dir() else None
    # The notes of verify itself may lie in another file.
    if own is not None and (not state_at or (given["skip_unchanged"] and own.exists())):
        state_at = str(own)
    if not state_at:
        raise ChoiceError("sources", reason=(" needs ", Chosen("state"), " FILE, unless INPUT is one folder"))
    state = State(state_at) if Path(state_at).exists() else None
    if state is None or state.notices:
        why = "is not there" if state is None else "is not a sound state file"
        advice = f"{state_at} {why}: run skinbake bake --skip-unchanged, or name its notes with --state"
        raise click.UsageError(f"--sources needs the notes of bake --skip-unchanged: {advice}")
    named = [
        entry
        for entry in expanded([folder], but=inputs[0] if Path(inputs[0]).is_dir() else None)
        if entry.missing is None
    ]
    outputs = [entry.source for entry in found if entry.missing is None]
    checks = checks_of(state, outputs, [one.source for one in named], folder, given["allow_outside"])
    return checks, [one for one in named if one.source in checks and one.source not in outputs]


def _reporting(
    given: VerifyGiven,
    say: Console,
    options: Mapping[str, VerifyOptions],
    searched: Mapping[str, str | None],
    *,
    is_one: bool,
) -> Reporting[FileVerdict]:
    """Return how verdicts are reported, counted and written. The verdict on a single file is in full."""
    from skinbake.report.verify import (
        OUTCOMES,
        SCHEMA,
        as_brief,
        as_json,
        as_junit,
        as_line,
        as_text,
        count,
        file_json,
    )

    junit, page, dump = given["junit"], given["html"], given["dump_normals"]
    words_of = as_text if given["verbose"] else as_brief if is_one else as_line

    def tell(verdict: FileVerdict) -> None:
        if not any(check.name == "warnings" for check in verdict.checks):  # else they are told as problems
            say.notices(verdict.notices)
        say.problems(problem for check in verdict.checks for problem in check.problems)
        if verdict.error is not None:
            say.error(verdict.error)
        if not given["as_json"]:
            say.verdict(words_of(verdict))

    def write(verdicts: Sequence[FileVerdict]) -> int:
        code = exit_codes.OK
        if junit is not None:
            code = write_report(junit, as_junit(verdicts), say, sync=not given["no_sync"])
            if code == exit_codes.OK:
                tell_of_report(junit, given, say)
        if page is not None:
            code = max(code, write_page(page, verdicts))
        if dump is not None and verdicts[0].error is None:
            code = max(code, write_dump(dump, verdicts[0].input))
        return code

    def write_dump(target: str, source: str) -> int:
        from skinbake.commands.normals import NormalsRequest, write_normals

        own = options[source]
        methods = tuple(map(Method, own.methods)) or (Method.LBS,)
        request = NormalsRequest(given["clip"], given["time"], methods, own.cap, own.baseline)
        bounds = Bounds(searched.get(source), given["allow_outside"])
        call = partial(write_normals, source, target, request, sync=not given["no_sync"], bounds=bounds)
        try:
            with threads_limited(given["threads"]):
                pose = within_limits(call, given, source)
        except ChoiceError:
            raise
        except SkinbakeError as error:
            say.error(error)
            return exit_codes.of_error(error)
        if not given["as_json"]:
            say.written(f"{printable(target)}: written, {pose}")
        return exit_codes.OK

    def write_page(target: str, verdicts: Sequence[FileVerdict]) -> int:
        from skinbake.commands.view import write_report

        def bounds(source: str) -> Bounds:
            return Bounds(searched.get(source), given["allow_outside"])

        notices = Notices()
        try:
            folder, failed = write_report(
                verdicts, options, target, bounds, notices, sync=not given["no_sync"]
            )
        except SkinbakeError as error:
            say.error(error)
            return exit_codes.of_error(error)
        say.notices(notices)
        for one in failed:
            say.error(one)
        tell_of_report(target, given, say, pages=folder)
        return max((exit_codes.of_error(one) for one in failed), default=exit_codes.OK)

    return Reporting(
        schema=SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        count=count,
        code=_code,
        file_json=file_json,
        document=as_json,
        write=write if junit or page or dump else None,
    )


def _code(verdict: FileVerdict) -> int:
    """Return the exit code for a verdict."""
    failed = verdict.error is None and not verdict.passed
    return exit_codes.VERIFICATION if failed else exit_codes.of_error(verdict.error)


def _options(given: Mapping[str, Any]) -> VerifyOptions:
    """Return the VerifyOptions of the command line."""
    from skinbake.measure.options import VerifyOptions

    return VerifyOptions.of(**{name: given[name] for name in defaults(VERIFY, By.OVERRIDE)})
