"""What a command does, as one value: the command line, a configuration file and the defaults, read once."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

import click
from click.core import ParameterSource

from skinbake.cli.configuration import ConfigurationError, configured_in
from skinbake.cli.console import Console, console
from skinbake.cli.inputs import Input, expanded
from skinbake.cli.targets import check_named, check_target, meant_output, pair_up
from skinbake.errors import ChoiceError, Chosen
from skinbake.files.bounds import Bounds
from skinbake.files.urls import STDIO, File, named_file, on_disk
from skinbake.options import OPTIONS, STATE_NAME, By, on_command_line

if TYPE_CHECKING:
    from skinbake.gltf.writing.output import Writing

OptionsT = TypeVar("OptionsT")

Command: TypeAlias = Callable[..., None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan(Generic[OptionsT]):
    """The options that commands share, under their own names, and the files of a command for many files.

    The defaults are for commands without the option. ``options`` are the checked options of the command
    itself: first those without overrides of a configuration file, then each other set that an input has.
    ``variants`` has the number of the set of each input that has another. ``inputs`` are the files that the
    ``arguments`` stand for, ``targets`` those to work on, each with its output, if there is one.
    ``notes_at`` is the state file of --skip-unchanged, ``configuration`` the file that was read, if any.
    """

    command: str
    say: Console
    begun: float = field(default_factory=time.perf_counter)
    options: Sequence[OptionsT] = ()
    variants: Mapping[str, int] = field(default_factory=dict)
    configuration: Sequence[str] = ()

    arguments: Sequence[str] = ()
    inputs: Sequence[Input] = ()
    targets: Sequence[tuple[Input, File | None]] = ()
    allow_outside: tuple[str, ...] = ()

    output: str | None = None
    out_dir: str | None = None
    in_place: bool = False
    pack: bool = False
    dry_run: bool = False
    no_sync: bool = False
    warnings_as_errors: bool = False

    as_json: bool = False
    timings: bool = False
    summary: str | None = None
    depfile: str | None = None
    sources: str | None = None
    state: str | None = None
    skip_unchanged: bool = False
    notes_at: str | None = None

    jobs: int = 1
    threads: int | None = None
    dask: str | None = None
    max_memory: int | None = None
    timeout: float | None = None
    isolate: bool = False

    @property
    def names(self) -> list[str]:
        """Return the names of the files to work on."""
        return [entry.source for entry, _ in self.targets]

    @property
    def writing(self) -> Writing:
        """Return how outputs are written."""
        from skinbake.gltf.writing.output import Writing

        return Writing(
            dry_run=self.dry_run, sync=not self.no_sync, pack=self.pack, lists_read=bool(self.depfile)
        )

    def bounds(self, searched: str | None = None) -> Bounds:
        """Return the folders in which a document's files may lie, if a search of a folder found it."""
        return Bounds(searched, self.allow_outside)


def planned(
    options: Callable[[Mapping[str, Any]], OptionsT] | None = None, *, for_many: bool = False
) -> Callable[[Command], Command]:
    """Return a decorator that hands a command its ``Plan``, and options that it alone has by their names.

    With ``for_many``, the arguments are the files of the plan, and ``options`` makes the checked options of
    the command, from those that an override of a configuration file may set.
    """

    def decorate(command: Command) -> Command:
        @click.pass_context
        @wraps(command)
        def with_plan(ctx: click.Context, /, **given: Any) -> None:
            shared = {one.name for one in fields(Plan)} - {"inputs"}  # these are arguments yet
            messages = {name: given.pop(name) for name in ("verbose", "quiet", "color")}
            to_stdout = "output" in given and given["output"] == STDIO
            plan: Plan[Any] = Plan(
                command=str(ctx.command.name),
                say=console(**messages, results_on_stderr=to_stdout),
                configuration=[found.path for found in [configured_in(ctx)] if found],
                **{name: value for name, value in given.items() if name in shared},
            )
            own = {name: value for name, value in given.items() if name not in shared}
            if for_many:
                plan = _on_files(plan, own.pop("inputs"), writes="out_dir" in given)
                per_file = {one.name for one in OPTIONS[plan.command] if By.OVERRIDE in one.by}
                if options is not None:
                    plan = _with_options(plan, ctx, given, options)
                own = {name: value for name, value in own.items() if name not in per_file}
            command(plan, **own)

        return with_plan

    return decorate


def _on_files(plan: Plan[Any], arguments: Sequence[str], *, writes: bool) -> Plan[Any]:
    """Return the plan with its files and outputs. Raises click.UsageError for what has no meaning."""
    inputs = expanded(arguments, but=plan.out_dir)
    plan = replace(plan, arguments=arguments, inputs=inputs, targets=[(entry, None) for entry in inputs])
    if writes:
        plan = replace(plan, targets=_targets(plan))
    for _, target in plan.targets if plan.pack else ():
        if target is not None and target.given.lower().endswith(".gltf"):
            why = f" needs a .glb or .vrm as output, because a .gltf has no binary chunk: {target.given}"
            raise ChoiceError("pack", reason=(why,))
    # Where the notes of --skip-unchanged are.
    if not plan.skip_unchanged:
        if plan.state and not plan.sources:
            raise ChoiceError("state", reason=(" is for ", Chosen("skip_unchanged")))
        return plan
    notes_at = plan.state or (str(Path(plan.out_dir, STATE_NAME)) if plan.out_dir else None)
    if notes_at is None:
        instead = "; with --out-dir it needs none" if writes else ""
        reason = " needs ", Chosen("state"), f" FILE, to keep its notes in{instead}"
        raise ChoiceError("skip_unchanged", reason=reason)
    return replace(plan, notes_at=notes_at)


def _targets(plan: Plan[Any]) -> list[tuple[Input, File | None]]:
    """Return (input, output) pairs. Raises click.UsageError for a combination without a meaning."""
    inputs, output, out_dir = list(plan.inputs), plan.output, plan.out_dir
    ways = sum(map(bool, (output, out_dir, plan.in_place)))
    if ways > 1:
        raise click.UsageError("give only one of -o/--output, --out-dir, --in-place")
    if not ways and not plan.dry_run:
        raise click.UsageError("give one of -o/--output, --out-dir, --in-place" + meant_output(inputs))
    targets: list[tuple[Input, File | None]] = [(entry, None) for entry in inputs]
    if output:
        if len(inputs) > 1:
            raise click.UsageError("-o takes one input; use --out-dir for several")
        if output == STDIO and plan.as_json:
            why = " prints to stdout, and so does -o -: name the file of the GLB"
            raise ChoiceError("as_json", reason=(why,))
        check_named(output, f"use --out-dir {output}, or name the file", may_be_url=True)
        target = named_file(output)
        check_target(inputs[0].file, target)
        targets = [(inputs[0], target)]
    elif plan.in_place:
        if any(entry.source == STDIO for entry in inputs):
            raise click.UsageError("--in-place needs files, not - for stdin")
        first: dict[tuple[object, ...], Input] = {}  # each file once, but hard links are replaced one by one
        for entry in inputs:
            first.setdefault(entry.file[1:], entry)
        targets = [(entry, entry.file) for entry in first.values()]
    elif out_dir:
        if out_dir == STDIO:
            raise click.UsageError("--out-dir needs the name of a folder, not -; -o - writes to stdout")
        if os.path.isfile(on_disk(out_dir) or ""):  # noqa: PTH113  # pathlib fails for long names
            raise click.UsageError(f"--out-dir {out_dir} is a file, not a folder")
        targets = list(pair_up(inputs, out_dir))
    return targets


def _with_options(
    plan: Plan[Any],
    ctx: click.Context,
    given: Mapping[str, Any],
    make: Callable[[Mapping[str, Any]], OptionsT],
) -> Plan[OptionsT]:
    """Return the plan with the checked options of each set that inputs have.

    An option of the command line is the same for all. Raises ChoiceError, and ConfigurationError for an
    override, which it names.
    """
    options, variants, configured = [make(given)], dict[str, int](), configured_in(ctx)
    if configured is None or not configured.overrides:
        return replace(plan, options=options)
    typed = {name for name in given if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    known: dict[tuple[int, ...], int] = {(): 0}
    for source in plan.names:
        chosen = tuple(configured.patterns_for(source))
        if chosen not in known:
            known[chosen] = len(options)
            changes = configured.converted_by(chosen)
            try:
                options.append(
                    make({**given, **{name: one for name, one in changes.items() if name not in typed}})
                )
            except ChoiceError as error:
                message = f"{configured.origin_of(chosen)}: {error.worded(on_command_line)}"
                raise ConfigurationError(message) from error
        variants[source] = known[chosen]
    return replace(plan, options=options, variants=variants)
