"""The way of writing outputs, from the options of a command."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skinbake.cli.given import Given
    from skinbake.gltf.output import Writing


def writing_of(given: Given) -> Writing:
    """Return how outputs are written, from the options of the command line."""
    from skinbake.gltf.output import Writing

    return Writing(
        dry_run=given.get("dry_run", False), sync=not given["no_sync"], pack=given.get("pack", False)
    )
