"""``skinbake bake``."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import Console, ended_by_errors
from skinbake.cli.depfile import OPTION, check_depfile, clip_files_read, write_depfile
from skinbake.cli.help import Helpful
from skinbake.cli.many import Reporting, work_through
from skinbake.cli.plan import Plan, planned
from skinbake.cli.targets import check_read, check_reports
from skinbake.errors import ChoiceError, Chosen, OutputError, Place, SkinbakeError
from skinbake.files.urls import STDIO, is_url, named_file
from skinbake.options import BAKE, By, defaults

if TYPE_CHECKING:
    from skinbake.commands.bake_options import BakeOptions
    from skinbake.report.bake import FileResult

LARGE = 100_000
"""The vertices of a primitive from which on the compiled loops are missed."""


def options_of(given: Mapping[str, Any]) -> BakeOptions:
    """Return the options of the command line. Raises ChoiceError if they contradict each other."""
    from skinbake.commands.bake_options import BakeOptions

    return BakeOptions(**{name: given[name] for name in defaults(BAKE, By.OVERRIDE)})


@click.command(
    "bake",
    cls=Helpful,
    examples=(
        "skinbake bake hero.glb -o build/hero.glb",
        "skinbake bake art/characters --out-dir build --jobs auto --skip-unchanged",
        "skinbake bake hero.glb --dry-run -v",
    ),
    usual=(
        *("output", "out_dir", "in_place", "dry_run", "weld", "generate_normals", "correctives"),
        *("encoding", "compress", "leave_under", "jobs", "skip_unchanged", "verbose"),
    ),
)
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@planned(options_of, for_many=True)
def command(plan: Plan[BakeOptions], *, require_tracked: bool, one_character: bool) -> None:
    """Add α and β, the skin-weight gradients along tangent and bitangent, to every skinned primitive.

    INPUT is a .glb, .gltf or .vrm file, or - for a GLB on stdin; a folder, for all such files below it; or a
    quoted pattern like 'art/**/*.glb'. Inputs and outputs may be URLs. Everything that bake does not add
    stays as it is. A file in which nothing can be baked passes through unchanged, with a warning. Bake last:
    after tools that reorder influences or quantise positions, α and β are wrong.
    """
    if one_character:
        plan = _with_character(plan)
    clip_files = [named_file(one.path) for one in plan.options[0].fit_poses if not isinstance(one, str)]
    check_reports(
        {"--summary": plan.summary, "--state": plan.notes_at, OPTION: plan.depfile},
        [*(entry.file for entry in plan.inputs), *clip_files],
        plan.targets[0][1] if plan.output else None,
    )
    check_read("--fit-poses", clip_files, plan.targets)
    with ended_by_errors(plan.say):
        together = plan.names if one_character else []
        read = [*(file.given for file in clip_files), *together]
        also_read = clip_files_read(read) if plan.depfile else []
    check_depfile(plan, also_read)
    from skinbake.jobs.bake import Bake, BakeRecipe
    from skinbake.report.bake import (
        OUTCOMES,
        SCHEMA,
        closing_line,
        detail_lines,
        file_json,
        short_line,
    )

    say = plan.say
    line_of = closing_line if len(plan.targets) == 1 or say.verbosity > 0 else short_line

    def tell(result: FileResult) -> None:
        say.notices(result.notices)
        if result.error is not None:
            say.error(result.error)
            return
        say.details(detail_lines(result))
        if not plan.as_json:
            say.written(line_of(result, dry_run=plan.dry_run))

    def write(results: Sequence[FileResult]) -> int:
        from skinbake.gradients import kernel

        sizes = (counts.vertices for result in results for _, counts in result.primitives)
        if not kernel.IS_COMPILED and max(sizes, default=0) >= LARGE:
            say.note("skinbake lacks its compiled loops: large meshes take many times as long (-v tells why)")
        code = write_depfile(plan, results, also_read)
        return max(code, _untracked_code(results, say) if require_tracked else exit_codes.OK)

    reporting = Reporting(
        schema=SCHEMA,
        outcomes=OUTCOMES,
        tell=tell,
        file_json=file_json,
        chosen={"dry_run": plan.dry_run},
        write=write,
    )
    commands = [Bake(one, plan.writing) for one in plan.options]
    noted = [BakeRecipe(one, pack=plan.pack) for one in plan.options]
    sys.exit(work_through(plan, commands, reporting, noted))


def _with_character(plan: Plan[BakeOptions]) -> Plan[BakeOptions]:
    """Return the plan with the clips of all its files. Raises click.UsageError and ChoiceError."""
    if plan.options[0].correctives is None:
        raise ChoiceError("one_character", reason=(" needs ", Chosen("correctives", "auto")))
    if any(options != plan.options[0] for options in plan.options):
        raise click.UsageError("--one-character needs the same options for all files")
    if any(name == STDIO or is_url(name) for name in plan.names):
        raise click.UsageError("--one-character needs files, not - and no URLs")
    from skinbake.format.character import Character

    with ended_by_errors(plan.say):
        character = Character((entry.source, plan.bounds(entry.searched)) for entry, _ in plan.targets)
    return replace(plan, options=[replace(one, character=character) for one in plan.options])


def _untracked_code(results: Sequence[FileResult], say: Console) -> int:
    """Print an error for each output that names a file which git does not track; return the exit code."""
    import subprocess

    from skinbake.gltf.document import read_document
    from skinbake.gltf.writing.beside import named_paths

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
            told = error if isinstance(error, OSError) else os.fsdecode(error.stderr).strip()
            say.error(OutputError(f"git cannot tell which files it tracks: {told}", Place(str(output))))
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
