"""``skinbake bake``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.configuration import config_files, option_sets
from skinbake.cli.console import console, ended_by_errors
from skinbake.cli.depfile import OPTION, check_depfile, clip_files_read, depfile_writer
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded
from skinbake.cli.many import (
    Clock,
    Reporting,
    notes_of,
    run_of,
    state_path,
    work_through,
)
from skinbake.cli.targets import check_read, check_reports, in_turns, jobs_of, targets_of
from skinbake.cli.writing import writing_of
from skinbake.errors import ChoiceError, OutputError, Place, SkinbakeError
from skinbake.files.urls import STDIO, is_url, named_file
from skinbake.options import BAKE, By, defaults

if TYPE_CHECKING:
    from typing import Unpack

    from skinbake.cli.console import Console
    from skinbake.cli.given import Given
    from skinbake.commands.bake import Baker
    from skinbake.report.bake import FileResult


@click.command(
    "bake",
    cls=Helpful,
    examples=(
        "skinbake bake hero.glb -o build/hero.glb",
        "skinbake bake art/characters --out-dir build --jobs auto --skip-unchanged",
        "skinbake bake hero.glb --dry-run -v",
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@click.pass_context
def command(ctx: click.Context, inputs: tuple[str, ...], **given: Unpack[Given]) -> None:
    """Add α/β, the skin-weight gradients along tangent and bitangent, to every skinned primitive.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'art/**/*.glb'. Inputs and outputs may be URLs. Everything that bake does not add
    stays as it is. A file in which nothing can be baked passes through unchanged, with a warning. Bake last:
    tools that reorder influences or quantise positions falsify α and β.
    """
    clock = Clock()
    # Before the modules that log how they were installed.
    say = console(given, results_on_stderr=given.get("output") == STDIO)
    found = expanded(inputs, but=given.get("out_dir"))
    targets, notes_at = targets_of(found, given), state_path(given)
    # A .gltf has no binary chunk to pack files into.
    for _, target in targets:
        if given.get("pack") and target is not None and target.given.lower().endswith(".gltf"):
            reason = f" needs a .glb or .vrm as output, because a .gltf has no binary chunk: {target.given}"
            raise ChoiceError("pack", reason=(reason,))
    output = targets[0][1] if given.get("output") else None
    reports = {"--summary": given["summary"], "--state": notes_at, OPTION: given.get("depfile")}
    clip_files = [named_file(path) for path in given.get("fit_poses", ()) if Path(path).is_file()]
    check_reports(reports, [*(entry.file for entry in found), *clip_files], output)
    sets = option_sets(ctx, given, [entry.source for entry, _ in targets])
    bakers = sets.each(baker_of)
    check_read("--fit-poses", clip_files, targets)
    with ended_by_errors(say):
        also_read = clip_files_read(file.given for file in clip_files) if given.get("depfile") else []
    configuration = config_files(ctx)
    depfile_at = check_depfile(given, targets, say, also_read, configuration)
    from skinbake.jobs.bake import Bake, BakeOptions

    commands = [Bake(baker, writing_of(given)) for baker in bakers]
    options = [BakeOptions(baker, pack=given.get("pack", False)) for baker in bakers]
    notes = notes_of("bake", options, notes_at, found, say, sync=not given["no_sync"])
    jobs = sets.numbered(jobs_of(targets, given, notes))
    write_depfile = depfile_writer(depfile_at, given, say, also_read, configuration)

    def write(results: Sequence[FileResult]) -> int:
        from skinbake.gradients import kernel

        sizes = (counts.vertices for result in results for _, counts in result.primitives)
        if not kernel.IS_COMPILED and max(sizes, default=0) >= LARGE:
            say.note("skinbake lacks its compiled loops: large meshes take many times as long (-v tells why)")
        code = exit_codes.OK if write_depfile is None else write_depfile(results)
        untracked = _untracked_code(results, say) if given.get("require_tracked") else exit_codes.OK
        return max(code, untracked)

    reporting = _reporting(given, say, write, is_one=len(targets) == 1)
    turns = in_turns([entry for entry, _ in targets]) if given.get("out_dir") else []
    clock.imports_done()
    run = run_of(commands, jobs, given, say, notes, turns)
    sys.exit(work_through(run, reporting, given, say, clock, notes))


LARGE = 100_000
"""The vertices of a primitive from which on the compiled loops are missed."""


def _reporting(
    given: Given, say: Console, write: Callable[[Sequence[FileResult]], int], *, is_one: bool
) -> Reporting[FileResult]:
    """Return how results of bake are reported, counted and written. The line of a single file is in full."""
    from skinbake.report.bake import (
        OUTCOMES,
        SCHEMA,
        as_json,
        closing_line,
        count,
        detail_lines,
        file_json,
        short_line,
    )

    dry_run = given.get("dry_run", False)
    line_of = closing_line if is_one or given["verbose"] else short_line

    def tell(result: FileResult) -> None:
        say.notices(result.notices)
        if result.error is not None:
            say.error(result.error)
            return
        say.details(detail_lines(result))
        if not given["as_json"]:
            say.written(line_of(result, dry_run=dry_run))

    return Reporting(
        schema=SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        count=count,
        code=lambda result: exit_codes.of_error(result.error),
        file_json=file_json,
        document=partial(as_json, dry_run=dry_run),
        write=write,
    )


def _untracked_code(results: Sequence[FileResult], say: Console) -> int:
    """Print an error for each output that names a file which git does not track; return the exit code."""
    import subprocess

    from skinbake.gltf.beside import named_paths
    from skinbake.gltf.document import read_document

    code = exit_codes.OK
    for result in results:
        output = result.output
        if result.error is not None or output in {None, STDIO} or is_url(str(output)):
            continue
        try:
            folder = Path(os.path.realpath(str(output))).parent
            named = named_paths(read_document(str(output)), folder)
            names = [os.path.relpath(path, folder) for path in sorted(named) if path.exists()]
            # A folder that was checked out may look like a repository, whose settings name programs to run.
            safe = ["-c", "safe.bareRepository=explicit", "-c", "core.fsmonitor=false"]
            call = ["git", *safe, "--literal-pathspecs", "ls-files", "-z", "--", *names]
            tracked = subprocess.run(call, cwd=folder, capture_output=True, check=True).stdout
        except (OSError, subprocess.CalledProcessError) as error:
            say.error(OutputError(f"git cannot tell which files it tracks: {error}", Place(str(output))))
            return exit_codes.OUTPUT
        except SkinbakeError as error:  # a dry run has not written it
            say.error(error)
            code = exit_codes.of_error(error)
            continue
        known = {os.path.normpath(os.fsdecode(name)) for name in tracked.split(b"\0") if name}
        if missing := [name for name in names if name not in known] if names else []:
            message = f"git does not track {', '.join(missing)}, which it names: git add (--require-tracked)"
            say.error(OutputError(message, Place(str(output))))
            code = exit_codes.OUTPUT
    return code


def baker_of(given: Mapping[str, Any]) -> Baker:
    """Return a baker with the options of the command line. Raises ChoiceError if they contradict."""
    from skinbake.commands.bake import Baker

    return Baker(**{name: given[name] for name in defaults(BAKE, By.OVERRIDE)})
