"""``skinbake bake``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.choices import (
    BAKE_RANGES,
    Encoding,
    FrameChoice,
    Gradients,
    Layout,
    Neighbours,
    Scheme,
    Weighting,
    Weld,
)
from skinbake.cli import exit_codes
from skinbake.cli.chosen_config import config_files, option_sets
from skinbake.cli.console import console, ended_by_errors, in_range, message_options, one_of, outside_option
from skinbake.cli.depfile import OPTION, check_depfile, clip_files_read, depfile_option, depfile_writer
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded
from skinbake.cli.limits import limit_options
from skinbake.cli.many import (
    STATE_NAME,
    Clock,
    Reporting,
    many_options,
    notes_of,
    run_of,
    state_path,
    work_through,
)
from skinbake.cli.names import STDIO
from skinbake.cli.remote import cluster_option
from skinbake.cli.targets import check_read, check_reports, in_turns, jobs_of, target_options, targets_of
from skinbake.cli.writing import writing_of
from skinbake.errors import ChoiceError

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
@target_options
@click.option("--in-place", is_flag=True, help="Replace each input by its baked version.")
@click.option(
    "--pack",
    is_flag=True,
    help="Bring the files of images and buffers into the output, which must be a .glb or .vrm.",
)
@click.option("--dry-run", is_flag=True, help="Do everything except writing.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option(
    "--gradients",
    type=one_of(Gradients),
    default="rig",
    show_default=True,
    help="α and β: the paper's gradients of the weights on the surface; fitted to the turns of the rig, "
    "which lights coarse meshes better; or fitted to poses too, which lights these best and takes longer.",
)
@click.option(
    "--fit-poses",
    multiple=True,
    metavar="FILE|animations|random:N",
    help="Poses for --gradients poses: the file's own animations (default), those of another file whose "
    "nodes have the same names, or random poses. May be given several times.",
)
@click.option(
    "--weighting",
    type=one_of(Weighting),
    default="max",
    show_default=True,
    help="Weight of the triangles at a vertex (Max 1999 is the most accurate).",
)
@click.option(
    "--crease-angle",
    type=in_range(BAKE_RANGES["crease_angle"]),
    default=15.0,
    show_default=True,
    metavar="DEG",
    help="Copies of a vertex form a hard edge if their normals differ by more than this angle.",
)
@click.option(
    "--weld",
    type=one_of(Weld),
    default="mesh",
    show_default=True,
    help="Compute gradients over one mesh, or over all meshes that the same skins draw. The latter is "
    "for characters cut into several meshes.",
)
@click.option(
    "--neighbours",
    type=one_of(Neighbours),
    default="adopt",
    show_default=True,
    help="Joints that only the neighbours of a vertex have: put them into free slots, add an influence set "
    "where these are too few, or drop them.",
)
@click.option(
    "--frame",
    type=one_of(FrameChoice),
    default="auto",
    show_default=True,
    help="Compute the tangent frame from TANGENT, or from NORMAL alone; auto prefers TANGENT.",
)
@click.option(
    "--limit-influences",
    type=in_range(BAKE_RANGES["limit_influences"]),
    metavar="N",
    help="Keep the N largest influences of each vertex, N a multiple of 4, and print the cost.",
)
@click.option("--generate-normals", is_flag=True, help="Add smooth NORMALs to primitives without NORMAL.")
@click.option(
    "--alpha-name",
    show_default="_SKINBAKE_ALPHA_{set}",
    metavar="PATTERN",
    help="Name of the α attributes; {set} is the number of the influence set.",
)
@click.option(
    "--beta-name",
    show_default="_SKINBAKE_BETA_{set}",
    metavar="PATTERN",
    help="Name of the β attributes.",
)
@click.option(
    "--compress",
    type=one_of(Scheme),
    default="keep",
    show_default=True,
    help="Keep geometry compressed as it is, decompress it, or compress skinned primitives without loss.",
)
@click.option(
    "--compress-level",
    type=in_range(BAKE_RANGES["compress_level"]),
    metavar="N",
    help="Effort: 0 (fast) to 10 (small), for meshopt 0 to 3. It changes little in Draco. Each codec "
    "has its own default. Without --compress it is for α and β of compressed files.",
)
@click.option(
    "--position-bits",
    type=in_range(BAKE_RANGES["position_bits"]),
    metavar="N",
    help="Quantise POSITION before baking, with --compress draco.",
)
@click.option(
    "--normal-bits",
    type=in_range(BAKE_RANGES["normal_bits"]),
    metavar="N",
    help="Quantise NORMAL in the same way.",
)
@click.option(
    "--texcoord-bits",
    type=in_range(BAKE_RANGES["texcoord_bits"]),
    metavar="N",
    help="Quantise TEXCOORD_0 in the same way.",
)
@click.option(
    "--encoding",
    type=one_of(Encoding),
    default="float32",
    show_default=True,
    help="Number type of α and β: 24, 16 or 8 bytes for a vertex with four influences.",
)
@click.option(
    "--layout",
    type=one_of(Layout),
    default="attributes",
    show_default=True,
    help="Attributes of α and β: their own, free TEXCOORD_n, or _CUSTOM0 and _CUSTOM1.",
)
@click.option("--require-baked", is_flag=True, help="Fail (exit 3) if nothing in a file can be baked.")
@click.option(
    "--warnings-as-errors", is_flag=True, help="Fail (exit 3) and write nothing if there are warnings."
)
@depfile_option
@many_options(f"The file for the notes of --skip-unchanged; by default {STATE_NAME} in --out-dir.")
@limit_options
@cluster_option
@outside_option
@message_options
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
    _check_pack(given, [target for _, target in targets])
    output = given.get("output")
    reports = {"--summary": given["summary"], "--state": notes_at, OPTION: given.get("depfile")}
    clip_files = [source for source in given.get("fit_poses", ()) if Path(source).is_file()]
    check_reports(reports, output, [*(entry.source for entry in found), *clip_files])
    sets = option_sets(ctx, given, [entry.source for entry, _ in targets])
    bakers = sets.each(baker_of)
    check_read("--fit-poses", clip_files, (target for _, target in targets))
    with ended_by_errors(say):
        also_read = clip_files_read(clip_files) if given.get("depfile") else []
    pairs, configuration = [(entry.source, target) for entry, target in targets], config_files(ctx)
    depfile_at = check_depfile(given, pairs, say, also_read, configuration)
    from skinbake.jobs.bake import MODULES, SECONDS_A_BYTE, SECONDS_A_FILE, Bake, BakeOptions

    options = [BakeOptions(baker, pack=given.get("pack", False)) for baker in bakers]
    notes = notes_of("bake", options[0], notes_at, found, say, sync=not given["no_sync"])
    jobs = jobs_of(targets, given, notes.known)
    reporting = _reporting(
        given,
        say,
        depfile_writer(depfile_at, given, say, also_read, configuration),
        is_one=len(targets) == 1,
    )
    clock.imports_done()
    run = run_of(
        [Bake(baker, writing_of(given)) for baker in bakers],
        sets.numbered(jobs),
        given,
        say,
        modules=MODULES,
        guess=(SECONDS_A_FILE, SECONDS_A_BYTE),
        turns=in_turns([entry for entry, _ in targets]) if given.get("out_dir") else [],
        recipes=notes.recipes(options),
    )
    sys.exit(work_through(run, reporting, given, say, clock, notes))


def _reporting(
    given: Given, say: Console, write: Callable[[Sequence[FileResult]], int] | None, *, is_one: bool
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


def _check_pack(given: Given, targets: Sequence[str | None]) -> None:
    """Raise click.UsageError if --pack meets an output that has no binary chunk."""
    if not given.get("pack"):
        return
    for target in targets:
        if target is not None and target != STDIO and target.lower().endswith(".gltf"):
            raise click.UsageError(
                f"{target}: --pack needs a .glb or .vrm as output, because a .gltf has no binary chunk"
            )


def baker_of(given: Mapping[str, Any]) -> Baker:
    """Return a baker with the options of the command line. Raises click.UsageError if they contradict."""
    from skinbake.commands.bake import Baker

    try:
        return Baker(**{entry.name: given[entry.name] for entry in fields(Baker)})
    except ChoiceError as error:
        raise click.UsageError(error.message) from error
