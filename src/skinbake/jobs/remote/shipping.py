"""Work for machines that do not see this one's disk: what a plain path means travels with its job.

The file and those that it names are read here and sent along; the worker unpacks them into a private folder
and goes on as it does with URLs; what it made is sent back and written here. URLs are read and written by
the worker itself.
"""

from __future__ import annotations

import errno
import os
import posixpath
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from skinbake.containment import Bounds, RefusedError, Within, below, spot_of
from skinbake.errors import ChoiceError, InputError, OutputError, Place, SkinbakeError
from skinbake.gltf.document import STDIO, Document, read_named
from skinbake.gltf.output import plan_output
from skinbake.gltf.resources import FileContent, find, read_open_file
from skinbake.gltf.writing import TakenError
from skinbake.jobs.remote.dask_task import Ready
from skinbake.jobs.remote.staging import End, carrying, needed, resources_of
from skinbake.urls import is_url


@dataclass(frozen=True, slots=True, eq=False)
class Parcel:
    """Files of one machine's disk, for another: a storage.

    Names are relative to ``base``, a folder. ``paths`` has the names of what the user calls otherwise,
    ``made`` what was put on the other machine, in that order.
    """

    base: str
    paths: dict[str, str]
    files: dict[str, bytes]
    made: dict[str, bytes] = field(default_factory=dict)

    def name_of(self, path: str) -> str:
        """Return the name of what a path means on the machine that sent this."""
        return self.paths[path]

    def fetch(self, name: str, to: Path) -> None:
        """Copy a file here; FileNotFoundError where there is none."""
        if name not in self.files:
            raise FileNotFoundError(name)
        to.write_bytes(self.files[name])

    def has(self, name: str) -> bool:
        """Tell whether there is such a file in here."""
        return name in self.files

    def holds(self, name: str, content: Path) -> bool:
        """Tell whether an existing file has the content of the file at ``content``."""
        return self.files[name] == content.read_bytes()

    def put(self, name: str, content: Path) -> None:
        """Note what is to be written where this came from."""
        self.made[name] = content.read_bytes()

    def shown(self, name: str) -> str:
        """Return the path on the machine that sent this."""
        return str(Path(self.base, name)) if name else self.base.rstrip(os.sep) + os.sep


@dataclass(frozen=True, slots=True)
class Shipment:
    """A job with the files that it needs; None where all of them have URLs."""

    job: Any
    parcel: Parcel | None

    @property
    def size(self) -> int:
        """The bytes of the files."""
        return 0 if self.parcel is None else sum(map(len, self.parcel.files.values()))


@dataclass(frozen=True, slots=True)
class Returned:
    """A job's result, and the files that were made of it, by names relative to ``base``."""

    result: Any
    base: str
    made: dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Shipped:
    """A work for other machines; its jobs have a ``source``, and a ``target`` where they write.

    The work must find its files by ``bake_anywhere`` or ``verify_anywhere``; its results have an ``error``.
    """

    work: Any

    def pack(self, job: Any) -> Shipment | Ready:
        """Return the job with its files, or the failure to read them."""
        if getattr(job, "missing", None) is not None:
            return Ready(self.work(job))
        try:
            return Shipment(job, _parcel(job.source, getattr(job, "target", None), job.within))
        except SkinbakeError as error:
            return Ready(replace(self.work.lost(job, ""), error=error))
        except MemoryError:
            failure = InputError("it needs more memory than there is", Place(job.source))
            return Ready(replace(self.work.lost(job, ""), error=failure))

    def __call__(self, shipment: Shipment) -> Returned:
        """Do the work with the files that came along, and return what it made of them."""
        parcel = shipment.parcel
        if parcel is None:
            return Returned(self.work(shipment.job), "", {})
        with carrying(parcel):
            return Returned(self.work(shipment.job), parcel.base, parcel.made)

    def unpack(self, job: Any, returned: Returned) -> Any:
        """Write the files that were made, and return the job's result."""
        result = returned.result
        target = getattr(job, "target", None)
        if target is None or is_url(target) or result.error is not None:
            return result
        try:
            return self._written(job, returned)
        except SkinbakeError as error:
            return replace(self.work.lost(job, ""), notices=result.notices, error=error)

    def lost(self, job: Any, reason: str) -> Any:
        """Return the result of a job that nobody lived to report on."""
        return self.work.lost(job, reason)

    def _written(self, job: Any, returned: Returned) -> Any:
        options = self.work.options
        if not (returned.made or options.dry_run):
            return returned.result
        path = Path(os.path.realpath(job.target))
        nothing = Document(job.source, path.parent, {}, is_glb=True, raw=b"")
        planned = plan_output(nothing, job.target, make_folder=options.make_folder, root=job.within.output)
        if options.dry_run:
            return returned.result
        *beside, (_, content) = returned.made.items()
        files: dict[Path, Sequence[bytes]] = {}
        for name, data in beside:
            other = Path(os.path.normpath(Path(returned.base, name)))
            if below(os.fspath(other), os.fspath(planned.root)) is None:
                raise OutputError(f"a worker returned a file outside its folder: {name}", Place(job.target))
            if not os.path.lexists(other):
                files[other] = [data]
            elif not _holds(other, planned.root, data):
                # Somebody else's file has the name: bake here, where the names that are taken can be seen.
                return self.work(job)
        try:
            replace(planned, files={**files, path: [content]}, again=None).write(sync=options.sync)
        except TakenError:  # by now
            return self.work(job)
        return returned.result


def _holds(path: Path, root: Path, data: bytes) -> bool:
    try:
        return b"".join(FileContent(spot_of(os.fspath(path), os.fspath(root)))) == data
    except OSError as error:
        raise OutputError(f"cannot be read: {error.strerror}", Place(str(path))) from error


def _parcel(source: str, target: str | None, within: Within) -> Parcel | None:
    """Return the files that a bake of the source to the target needs, as far as they have plain paths.

    Raises InputError where they cannot be read, ChoiceError for standard input and output.
    """
    if STDIO in {source, target}:
        raise ChoiceError("standard input and output cannot be sent to a cluster", Place(source))
    disk = Parcel("", {}, {})
    roots = [root for root in (within.bounds.root, *within.bounds.allowed, within.output) if root is not None]
    tops = {root: Path(os.path.realpath(root)).as_posix() for root in roots if not is_url(root)}
    start = _end(source, _absolute(source), disk, tops.get(within.bounds.root or ""))
    allowed = tuple(tops[root] for root in within.bounds.allowed if root in tops)
    start = replace(start, tops=(*start.tops, *allowed))
    goal = None
    if target is not None:
        path = _absolute(target) if target == source else Path(os.path.realpath(target)).as_posix()
        goal = _end(target, path, disk, tops.get(within.output or ""))
    paths = {end.given: end.name for end in (start, goal) if end is not None and end.storage is disk}
    if not paths:
        return None
    files = _read(start, goal, within.bounds) if start.storage is disk else {}
    folders = {str(Path(path).parent) for path in (*paths.values(), *files)} | set(tops.values())
    paths |= tops
    try:
        base = os.path.commonpath(folders)
    except ValueError as error:
        raise InputError("its files are on several drives: use URLs", Place(source)) from error

    def name(path: str) -> str:
        return Path(os.path.relpath(path, base)).as_posix()

    return Parcel(
        base,
        {given: name(path) for given, path in paths.items()},
        {name(path): data for path, data in files.items()},
    )


def _end(given: str, path: str, disk: Parcel, top: str | None) -> End:
    own = posixpath.dirname(path) if top is None else top
    return End(given, None if is_url(given) else disk, path, (own,))


def _absolute(path: str) -> str:
    """Return a path without links in its folder, so that ``..`` in a relative one means what it says."""
    folder, name = os.path.split(path)
    return Path(os.path.realpath(folder), name).as_posix()


def _read(source: End, target: End | None, bounds: Bounds) -> dict[str, bytes]:
    """Return a file and those that it names, as far as a bake needs them, by absolute path."""
    files = {source.name: bytes(read_named(source.given, bounds.root))}
    folder = Path(source.given).parent
    for resource, with_content in needed(resources_of(source.given, bounds), source, target):
        try:
            spot, descriptor = find(resource.uri, folder, bounds)
        except RefusedError:
            continue
        except OSError as error:
            if error.errno == errno.EACCES:
                message = f'cannot read "{resource.uri}" beside it: {error.strerror}'
                raise InputError(message, Place(source.given)) from error
            continue
        try:
            name = Path(spot.path).as_posix()
            if name not in files:
                files[name] = bytes(read_open_file(descriptor)) if with_content else b""
        finally:
            os.close(descriptor)
    return files
