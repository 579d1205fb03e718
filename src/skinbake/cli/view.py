"""``skinbake view``."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.cli import exit_codes
from skinbake.cli.console import ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import expanded, path_on_disk
from skinbake.cli.many import code_of, work_through
from skinbake.cli.plan import Plan, planned
from skinbake.cli.runners import within_limits
from skinbake.cli.targets import PAGES, check_earlier, check_named, is_model_name, is_page
from skinbake.cli.verify import Extra, pages_of, reporting
from skinbake.errors import InputError, Place, printable
from skinbake.files.urls import STDIO
from skinbake.wording import counted

if TYPE_CHECKING:
    from skinbake.report.verify import FileVerdict


@click.command(
    "view",
    cls=Helpful,
    second=("-o", PAGES),
    examples=(
        "skinbake view hero.glb",
        "skinbake view hero.glb -o build/hero.html",
        "skinbake view art/characters -o build/characters.html",
    ),
)
@click.argument("source", metavar="INPUT")
@planned()
def command(plan: Plan[Any], source: str, *, port: int, no_browser: bool) -> None:
    """Show a file in the browser: standard and accurate lighting side by side, over its own animations.

    The page is one HTML file that loads nothing from the network. A file that is not baked is baked in
    memory. Without -o the page is served to this machine only, until Ctrl-C. A folder needs -o: the page is a
    sheet of all characters below it, by gain, with a page of each beside it.
    """
    output, say = plan.output, plan.say
    if output is not None:
        # A name of another kind of file, of a folder, or of a foreign file is refused.
        check_named(output)
        if output != STDIO and is_model_name(output):
            raise click.UsageError(f"{output} is the name of a model; name the page .html")
        if output != STDIO and not output.lower().endswith(PAGES):
            expected = f"expected a name that ends in {' or '.join(PAGES)}, or - for stdout"
            raise click.UsageError(f"{output}: {expected}")
        if output != STDIO:
            check_earlier(output, is_page)
        if port or no_browser:
            why = "are for a page that is served; -o writes it instead"
            raise click.UsageError(f"--port and --no-browser {why}")
    if Path(source).is_dir():
        sys.exit(_write_sheet(plan, source, output))
    source = path_on_disk(source)
    from skinbake.commands.view import view_file
    from skinbake.files.writing import write_result

    call = partial(view_file, source, output, plan.bounds())
    with ended_by_errors(say):
        result = within_limits(call, plan, source)
        say.notices(result.notices)
        if output is None:
            # Serve the page until Ctrl-C, and open the browser on it.
            import threading
            import webbrowser

            from skinbake.view.serving import serve

            def started(address: str) -> None:
                say.result(f"{address} (Ctrl-C ends)")
                if not no_browser:
                    # A browser in a terminal returns when it ends, and until then wants answers.
                    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

            serve(result.page, port, started)
        else:
            write_result([result.page], output, sync=not plan.no_sync)
    if output != STDIO:
        how = "" if result.was_baked else ", baked in memory"
        say.written(
            f"{printable(source)} -> {printable(str(output))}: {counted(len(result.page), 'byte')}{how}"
        )


def _write_sheet(plan: Plan[Any], folder: str, target: str | None) -> int:
    """Write the sheet of a folder, and the pages of its files, by one process a core; return the exit code.

    Raises click.UsageError without the name of a file for the sheet, or if it would replace foreign files.
    """
    if target is None or target == STDIO:
        raise click.UsageError(f"{folder} is a folder: name the page of its characters by -o PAGE")
    from skinbake.jobs.verify import Verify
    from skinbake.measure.options import VerifyOptions

    inputs = expanded([folder])
    if all(entry.missing for entry in inputs):  # one folder in it that cannot be opened is a row
        plan.say.error(InputError(inputs[0].missing or "", Place(folder)))
        return exit_codes.INPUT
    whole: Plan[VerifyOptions] = replace(
        plan,
        arguments=[folder],
        inputs=inputs,
        targets=[(entry, None) for entry in inputs],
        options=[VerifyOptions()],
        jobs=0,
    )
    made = pages_of(whole, target)
    for page in made.values():
        check_earlier(str(page), is_page)
    command = Verify(VerifyOptions(), pages=made, sync=not plan.no_sync)
    # Nothing is asked of the files: one that fails a check is shown like the others.
    usual = reporting(whole, Extra(html=target))

    def tell(verdict: FileVerdict) -> None:
        usual.tell(replace(verdict, notices=()))  # its page tells them

    return work_through(whole, [command], replace(usual, tell=tell, code=code_of))
