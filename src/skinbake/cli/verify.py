"""``skinbake verify``."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from skinbake.choices import Method
from skinbake.cli import exit_codes
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import Input, expanded
from skinbake.cli.many import Reporting, code_of, tell_of_report, work_through, write_report
from skinbake.cli.plan import Plan, planned
from skinbake.cli.runners import within_limits
from skinbake.cli.targets import PAGES, check_earlier, check_reports, is_page
from skinbake.errors import ChoiceError, Chosen, Notices, SkinbakeError, printable
from skinbake.files.urls import STDIO, is_url
from skinbake.options import STATE_NAME, VERIFY, By, defaults
from skinbake.threads import threads_limited

if TYPE_CHECKING:
    from skinbake.files.bounds import Bounds
    from skinbake.measure.options import VerifyOptions
    from skinbake.report.verify import Check, FileVerdict


class Extra(NamedTuple):
    """The reports that only verify writes, and the pose of --dump-normals."""

    junit: str | None = None
    html: str | None = None
    dump_normals: str | None = None
    clip: str | None = None
    time: float | None = None


def options_of(given: Mapping[str, Any]) -> VerifyOptions:
    """Return the options of the command line, checked. Raises ChoiceError if they contradict."""
    from skinbake.measure.options import VerifyOptions

    return VerifyOptions.of(**{name: given[name] for name in defaults(VERIFY, By.OVERRIDE)})


@click.command(
    "verify",
    cls=Helpful,
    examples=(
        "skinbake verify build/hero.glb",
        "skinbake verify build --jobs auto --require-baked --min-gain 1.5 --junit build/skinbake.xml",
        "skinbake verify build --html report.html",
    ),
    usual=(
        *("poses", "methods", "max_mean_error", "min_gain", "require_baked", "sources", "warnings_as_errors"),
        *("as_json", "junit", "html", "jobs", "verbose"),
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@planned(options_of, for_many=True)
def command(plan: Plan[VerifyOptions], **extras: Any) -> None:
    """Check that files still carry the right α and β, and measure how much they improve the lighting.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'build/**/*.glb'. Each may be a URL. One file has a verdict and the next step, several
    have a line each; -v shows every figure.

    Three checks. Structure: α and β are there and whole. Freshness: a bake of the file as it is now would
    give the same values. Lighting: how far the normals of each algorithm are from the true ones, in degrees,
    in the file's own animations. Limits apply to the accurate lighting of each --method (by default LBS).
    """
    checks, without_output = _sources(plan)
    # A source without an output is told of like an input.
    plan = replace(
        plan,
        inputs=[*plan.inputs, *without_output],
        targets=[*plan.targets, *((entry, None) for entry in without_output)],
    )
    extra = Extra(**extras)
    _check_extra(plan, extra)
    from skinbake.jobs.verify import Verify

    bare = frozenset(entry.source for entry in without_output)
    made = pages_of(plan, extra.html)
    commands = [
        Verify(one, checks, bare, plan.say.verbosity > 0, made, sync=not plan.no_sync) for one in plan.options
    ]
    sys.exit(work_through(plan, commands, reporting(plan, extra), plan.options))


def _check_extra(plan: Plan[VerifyOptions], extra: Extra) -> None:
    """Raise click.UsageError if the plan's files do not allow a report, or its file is another's."""
    is_elsewhere = any(name == STDIO or is_url(name) for name in plan.names)
    for option, wanted in (("--html", extra.html), ("--dump-normals", extra.dump_normals)):
        if wanted and is_elsewhere:
            raise click.UsageError(
                f"{option} needs files on this machine's disks, because it reads them again"
            )
    is_one = len(plan.targets) == 1
    if extra.dump_normals and not is_one:
        raise click.UsageError("--dump-normals takes one input")
    for name, value in (("clip", extra.clip), ("time", extra.time)):
        if value is not None and not extra.dump_normals:
            raise ChoiceError(name, reason=(" is for ", Chosen("dump_normals")))
    reports = {
        "--junit": extra.junit,
        "--html": extra.html,
        "--dump-normals": extra.dump_normals,
        "--summary": plan.summary,
        "--state": plan.notes_at,
    }
    check_reports(reports, (entry.file for entry in plan.inputs))
    if extra.html and not extra.html.lower().endswith(PAGES):
        raise ChoiceError("html", extra.html, f"a name that ends in {' or '.join(PAGES)}")
    for page in pages_of(plan, extra.html).values():
        check_earlier(str(page), is_page, "--html: ")


def pages_of(plan: Plan[VerifyOptions], target: str | None) -> Mapping[str, Path]:
    """Return the paths of the pages beside a sheet by source, none if there is no sheet of several files."""
    if target is None or len(plan.targets) == 1:
        return {}
    from skinbake.view.index import pages

    return dict(zip(plan.names, pages(target, plan.names), strict=True))


def reporting(plan: Plan[VerifyOptions], extra: Extra) -> Reporting[FileVerdict]:
    """Return how verdicts are reported, counted and written. The verdict on a single file is in full."""
    from skinbake.report.verify import (
        OUTCOMES,
        SCHEMA,
        as_brief,
        as_junit,
        as_line,
        as_text,
        count,
        file_json,
    )

    say, is_one = plan.say, len(plan.targets) == 1
    junit, html, dump_normals, *_ = extra
    words_of = as_text if say.verbosity > 0 else as_brief if is_one else as_line
    options = {name: plan.options[plan.variants.get(name, 0)] for name in plan.names}
    bounds = {entry.source: plan.bounds(entry.searched) for entry, _ in plan.targets}

    def tell(verdict: FileVerdict) -> None:
        if not any(check.name == "warnings" for check in verdict.checks):  # else they are told as problems
            say.notices(verdict.notices)
        say.problems(problem for check in verdict.checks for problem in check.problems)
        if verdict.error is not None:
            say.error(verdict.error)
        if not plan.as_json:
            say.verdict(words_of(verdict.entry.verdict if verdict.entry else verdict))

    def write(verdicts: Sequence[FileVerdict]) -> int:
        code = exit_codes.OK
        if junit is not None:
            code = write_report(plan, junit, as_junit(verdicts))
            if code == exit_codes.OK:
                tell_of_report(plan, junit)
        if html is not None:
            code = max(code, write_page(html, verdicts))
        if dump_normals is not None and verdicts[0].error is None:
            source = verdicts[0].input
            code = max(code, _write_dump(plan, extra, options[source], source, bounds[source]))
        return code

    def write_page(target: str, verdicts: Sequence[FileVerdict]) -> int:
        from skinbake.commands.view import write_report

        notices = Notices()
        try:
            folder, failed = write_report(
                verdicts,
                options,
                target,
                bounds.__getitem__,
                notices,
                command=plan.command,
                sync=not plan.no_sync,
            )
        except SkinbakeError as error:
            say.error(error)
            return exit_codes.of_error(error)
        say.notices(notices)
        for one in failed:
            say.error(one)
        tell_of_report(plan, target, pages=folder)
        return max((exit_codes.of_error(one) for one in failed), default=exit_codes.OK)

    def code(verdict: FileVerdict) -> int:
        failed = verdict.error is None and not verdict.passed
        return exit_codes.VERIFICATION if failed else code_of(verdict)

    return Reporting(
        schema=SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        count=count,
        file_json=file_json,
        write=write if junit or html or dump_normals else None,
        code=code,
    )


def _write_dump(
    plan: Plan[VerifyOptions], extra: Extra, options: VerifyOptions, source: str, bounds: Bounds
) -> int:
    """Write the file of --dump-normals, and return the exit code."""
    from skinbake.commands.normals import NormalsRequest, write_normals

    target, sync = str(extra.dump_normals), not plan.no_sync
    methods = tuple(map(Method, options.methods)) or (Method.LBS,)
    request = NormalsRequest(extra.clip, extra.time, methods, options.cap, options.baseline)
    try:
        with threads_limited(plan.threads):
            call = partial(write_normals, source, target, request, sync=sync, bounds=bounds)
            pose = within_limits(call, plan, source)
    except ChoiceError:
        raise
    except SkinbakeError as error:
        plan.say.error(error)
        return exit_codes.of_error(error)
    if not plan.as_json:
        plan.say.written(f"{printable(target)}: written, {pose}")
    return exit_codes.OK


def _sources(plan: Plan[VerifyOptions]) -> tuple[Mapping[str, Check], list[Input]]:
    """Return the check of each output and bare source by --sources, and these sources.

    Raises click.UsageError without a state file that could tell.
    """
    folder, state_at, first = plan.sources, plan.state, Path(plan.arguments[0])
    if not folder:
        return {}, []
    from skinbake.jobs.sources import checks_of
    from skinbake.jobs.state import State

    if plan.dask or any(name == STDIO or is_url(name) for name in plan.names):
        raise click.UsageError("--sources needs files on this machine's disks, without --dask")
    if not Path(folder).is_dir():
        raise click.UsageError(f"--sources: {folder} is not a folder")
    own = first / STATE_NAME if len(plan.arguments) == 1 and first.is_dir() else None
    # The notes of verify itself may lie in another file.
    if own is not None and (not state_at or (plan.skip_unchanged and own.exists())):
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
        for entry in expanded([folder], but=plan.arguments[0] if first.is_dir() else None)
        if entry.missing is None
    ]
    outputs = [entry.source for entry in plan.inputs if entry.missing is None]
    checks = checks_of(state, outputs, [one.source for one in named], folder, plan.allow_outside)
    return checks, [one for one in named if one.source in checks and one.source not in outputs]
