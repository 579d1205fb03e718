"""Print the man page of all commands, from their declarations: ``python -m skinbake.cli.manual``."""

from __future__ import annotations

import click

from skinbake.cli.help import manual
from skinbake.cli.main import main

if __name__ == "__main__":
    click.echo(manual(main), nl=False)
