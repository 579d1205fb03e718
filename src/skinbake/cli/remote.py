"""URLs among the arguments, and ``--dask``: work that is not all on this machine's disk."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

import click

from skinbake.cli.console import Console
from skinbake.cli.limits import OR_CLUSTER
from skinbake.errors import ChoiceError, Chosen, InputError, Place
from skinbake.files.urls import STDIO, is_url, join_url

if TYPE_CHECKING:
    from skinbake.cli.given import Given
    from skinbake.jobs.work import Job, Result, Runner

ResultT = TypeVar("ResultT", bound="Result")

ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?[^/\s]+:\d+/?|inproc://.+")


def behind(url: str, but: str | None) -> list[tuple[str, str]]:
    """Return (URL, relative path) of the files that a URL stands for. Raises InputError if there are none.

    ``but`` is the folder of the outputs. It is left out unless the search begins in it.
    """
    from skinbake.jobs.elsewhere import files_behind

    found = files_behind(url)
    outputs = join_url(but, "") if but and is_url(but) else None
    if outputs is None or join_url(url, "").startswith(outputs):
        return found
    return [(file, kept) for file, kept in found if not file.startswith(outputs)]


def cluster_runner(
    given: Given, sources: Sequence[str], turns: Sequence[int], say: Console
) -> Runner[Job, ResultT] | None:
    """Return the runner of the cluster, connected until the command ends, or None if none is asked for.

    ``turns`` are the numbers of the sources that must be done in order. Raises ChoiceError for options that
    do not fit a cluster, or URLs, and InputError if the cluster cannot be used.
    """
    address = given["dask"]
    if address is not None and not ADDRESS.fullmatch(address):
        raise ChoiceError(
            "dask", reason=(" needs the address that a scheduler prints, like tcp://host:8786",)
        )
    if address and given["jobs"] != 1:
        raise ChoiceError("jobs", reason=OR_CLUSTER)
    if address and STDIO in {*sources, given.get("output")}:
        raise ChoiceError("dask", reason=(" needs files or URLs, not - for stdin or stdout",))
    named = [*sources, given.get("out_dir") or "", given.get("output") or ""]
    if given["skip_unchanged"] and (address or any(map(is_url, named))):
        raise ChoiceError(
            "skip_unchanged", reason=(" needs files on this disk, without ", Chosen("dask"), " and URLs")
        )
    if not address:
        return None
    from skinbake.jobs.elsewhere import dask_runner
    from skinbake.jobs.runners import FirstThese

    runner = dask_runner(address)
    click.get_current_context().call_on_close(runner.close)
    notices = runner.connect()
    say.notices(notices)
    if notices and given["warnings_as_errors"]:
        raise InputError("nothing was sent: there are warnings (--warnings-as-errors)", Place(address))
    return FirstThese(turns, runner.one_by_one(), runner) if turns else runner
