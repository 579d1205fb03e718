"""``skinbake view``."""

from __future__ import annotations

from functools import partial
from typing import Any

import click

from skinbake.cli.console import ended_by_errors
from skinbake.cli.help import Helpful
from skinbake.cli.inputs import path_on_disk
from skinbake.cli.plan import Plan, planned
from skinbake.cli.runners import within_limits
from skinbake.cli.targets import check_earlier, check_named, is_model_name, is_page
from skinbake.errors import printable
from skinbake.files.urls import STDIO
from skinbake.wording import counted

PAGES = (".html", ".htm")
"""The suffixes of a page."""


@click.command(
    "view",
    cls=Helpful,
    second=("-o", PAGES),
    examples=(
        "skinbake view hero.glb",
        "skinbake view hero.glb -o build/hero.html",
    ),
)
@click.argument("source", metavar="FILE")
@planned()
def command(plan: Plan[Any], source: str, *, port: int, no_browser: bool) -> None:
    """Show a file in the browser: standard and accurate lighting side by side, over its own animations.

    The page is one HTML file that loads nothing from the network. A file that is not baked is baked in
    memory. Without -o the page is served to this machine only, until Ctrl-C.
    """
    source, output, say = path_on_disk(source), plan.output, plan.say
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
    from skinbake.commands.view import view_file, write_page

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
            write_page(result, output, sync=not plan.no_sync)
    if output != STDIO:
        how = "" if result.was_baked else ", baked in memory"
        say.written(
            f"{printable(source)} -> {printable(str(output))}: {counted(len(result.page), 'byte')}{how}"
        )
