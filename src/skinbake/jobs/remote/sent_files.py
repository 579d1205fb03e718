"""Work for machines that do not see this machine's disk: files with plain paths travel with their job.

The file and the files that it names are read here and sent along. The worker unpacks them into a private
folder and goes on as it does with URLs. Then it sends back the files that it made, and they are written here.
The worker itself reads and writes URLs.
"""

from __future__ import annotations

import errno
import os
import posixpath
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Generic

from skinbake.errors import ChoiceError, InputError, OutputError, Place, noticed
from skinbake.files import Bytes
from skinbake.files.bounds import Bounds, RefusedError, below, bounded_path
from skinbake.files.urls import STDIO, is_url
from skinbake.files.versions import Version, version_of
from skinbake.files.writing import TakenError
from skinbake.gltf.budget import Budget
from skinbake.gltf.document import Document, read_named
from skinbake.gltf.output import Writing, plan_output
from skinbake.gltf.resources import FileContent, find, read_open_file
from skinbake.jobs.remote.ends import End, needed, resources_of
from skinbake.jobs.remote.staging import Staging
from skinbake.jobs.work import Job, ResultT, Work, survived


@dataclass(frozen=True, slots=True, eq=False)
class SentFiles:
    """The files of one machine's disk, as a storage for another machine.

    Names are relative to the folder ``base``. ``paths`` maps the user's paths to names. ``made`` holds the
    files that the other machine stored, in that order.
    """

    base: str
    paths: dict[str, str]
    files: dict[str, bytes]
    made: dict[str, bytes] = field(default_factory=dict)

    def name_of(self, path: str) -> str:
        """Return the name of the file that a path means on the machine that sent this."""
        return self.paths[path]

    def fetch_file(self, name: str, to: Path) -> None:
        """Copy a file here. Raises FileNotFoundError if there is none."""
        if name not in self.files:
            raise FileNotFoundError(name)
        to.write_bytes(self.files[name])

    def has_file(self, name: str) -> bool:
        """Tell whether there is such a file in here."""
        return name in self.files

    def has_content(self, name: str, content: Path) -> bool:
        """Tell whether an existing file has the content of the file at ``content``."""
        return self.files[name] == content.read_bytes()

    def store_file(self, name: str, content: Path) -> None:
        """Note a file to be written on the machine that sent this."""
        self.made[name] = content.read_bytes()

    def public_name(self, name: str) -> str:
        """Return the path on the machine that sent this."""
        return str(Path(self.base, name)) if name else self.base.rstrip(os.sep) + os.sep


@dataclass(frozen=True, slots=True)
class JobWithFiles:
    """A job with the files that it needs, or None if all of them have URLs.

    ``replaces`` is the source as it was before it was read, if the target replaces it.
    """

    job: Job
    files: SentFiles | None
    replaces: Version | None = None

    @property
    def size(self) -> int:
        """The bytes of the files."""
        return 0 if self.files is None else sum(map(len, self.files.files.values()))


@dataclass(frozen=True, slots=True)
class ResultWithFiles(Generic[ResultT]):
    """A job's result, and the files that were made of it, by names relative to ``base``.

    ``replaces`` is that of the job.
    """

    result: ResultT
    base: str
    made: dict[str, bytes]
    replaces: Version | None = None


@dataclass(frozen=True, slots=True)
class DoneHere(Generic[ResultT]):
    """The result of a job that need not be sent."""

    result: ResultT
    size: int = 0


@dataclass(frozen=True, slots=True)
class WorkWithFiles(Generic[ResultT]):
    """A work for other machines. Its jobs may have plain paths.

    ``writing`` says how targets are written. The work must find its files by its job's ``elsewhere``.
    """

    work: Work[Job, ResultT]
    writing: Writing

    def with_files(self, job: Job) -> JobWithFiles | DoneHere[ResultT]:
        """Return the job with its files, or the failure to read them."""
        if job.missing is not None:
            return DoneHere(self.work(job))

        def gathered() -> JobWithFiles | DoneHere[ResultT]:
            in_place = job.source == job.target and not is_url(job.source)
            replaces = version_of(job.source) if in_place else None
            return JobWithFiles(job, _sent_files(job, pack=self.writing.pack), replaces)

        return survived(gathered, lambda error: DoneHere(self.work.failed(job, error)), job.source)

    def result_there(self, sent: JobWithFiles, workspace: str | None) -> ResultWithFiles[ResultT]:
        """Do the work on the machine that a job was sent to, and return the files that it made with it.

        Private folders are made in the workspace.
        """
        files = sent.files
        result = self.work(sent.job._replace(elsewhere=Staging(files, workspace)))
        if files is None:
            return ResultWithFiles(result, "", {})
        return ResultWithFiles(result, files.base, files.made, sent.replaces)

    def result_here(self, job: Job, returned: ResultWithFiles[ResultT]) -> ResultT:
        """Write the files that were made, and return the job's result."""
        result = returned.result
        if job.target is None or is_url(job.target) or result.error is not None:
            return result
        target = job.target
        return survived(
            lambda: self._written(job, target, returned),
            lambda error: self.work.failed(job, error),
            job.source,
        )

    def lost(self, job: Job, reason: str) -> ResultT:
        """Return the result of a job whose process died before it reported."""
        return self.work.lost(job, reason)

    def _written(self, job: Job, target: str, returned: ResultWithFiles[ResultT]) -> ResultT:
        """Write the files that were made. If other files have their names, do the work here instead."""
        result, writing = returned.result, self.writing
        if not (returned.made or writing.dry_run):
            return result
        path = Path(os.path.realpath(target))
        nothing = Document(job.source, path.parent, {}, is_glb=True, raw=b"")
        with noticed(result.notices):
            planned = plan_output(nothing, target, root=job.within.output)
            if writing.dry_run:
                return result
            files = _files_to_write(returned, target, planned.root)
            try:
                if files is not None:
                    files[path] = [next(reversed(returned.made.values()))]
                    whole = replace(planned, files=files, replaces=returned.replaces, again=None)
                    whole.write(sync=writing.sync)
                    return result
            except TakenError:  # another file got the name meanwhile
                pass
        # Another file has the name. On this machine, the work sees which names are taken.
        return self.work(job)


def _files_to_write(
    returned: ResultWithFiles[ResultT], target: str, root: Path
) -> dict[Path, Iterable[Bytes]] | None:
    """Return the files beside the target that are not there yet, or None if another file has a name."""
    files: dict[Path, Iterable[Bytes]] = {}
    *beside, _ = returned.made.items()
    for name, data in beside:
        path = Path(os.path.normpath(Path(returned.base, name)))
        if below(os.fspath(path), os.fspath(root)) is None:
            raise OutputError(f"a worker returned a file outside its folder: {name}", Place(target))
        if not os.path.lexists(path):
            files[path] = [data]
        elif not _has_content(path, root, data):
            return None
    return files


def _has_content(path: Path, root: Path, data: bytes) -> bool:
    try:
        return b"".join(FileContent(bounded_path(os.fspath(path), os.fspath(root)))) == data
    except OSError as error:
        raise OutputError(f"cannot be read: {error.strerror}", Place(str(path))) from error


def _sent_files(job: Job, *, pack: bool) -> SentFiles | None:
    """Return the files with plain paths that a bake from a job's source to its target needs.

    Raises InputError if they cannot be read, ChoiceError for standard input and output.
    """
    source, target, within = job.source, job.target, job.within
    if STDIO in {source, target}:
        reason = (" cannot send standard input and output to a cluster",)
        raise ChoiceError("dask", reason=reason, place=Place(source))
    disk = SentFiles("", {}, {})
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
    files = _read(start, goal, within.bounds, pack=pack) if start.storage is disk else {}
    folders = {str(Path(path).parent) for path in (*paths.values(), *files)} | set(tops.values())
    paths |= tops
    try:
        base = os.path.commonpath(folders)
    except ValueError as error:
        raise InputError("its files are on several drives: use URLs", Place(source)) from error

    def name(path: str) -> str:
        return Path(os.path.relpath(path, base)).as_posix()

    return SentFiles(
        base,
        {given: name(path) for given, path in paths.items()},
        {name(path): data for path, data in files.items()},
    )


def _end(given: str, path: str, disk: SentFiles, top: str | None) -> End:
    own = posixpath.dirname(path) if top is None else top
    return End(given, None if is_url(given) else disk, path, (own,))


def _absolute(path: str) -> str:
    """Return a path without links in its folder, so that ``..`` in a relative path is the parent folder."""
    folder, name = os.path.split(path)
    return Path(os.path.realpath(folder), name).as_posix()


def _read(source: End, target: End | None, bounds: Bounds, *, pack: bool) -> dict[str, bytes]:
    """Return a file and the files that it names, as far as a bake needs them, by absolute path."""
    budget, place = Budget(), Place(source.given)
    files = {source.name: bytes(read_named(source.given, bounds.root, budget))}
    folder = Path(source.given).parent
    for resource, with_content in needed(resources_of(source.given, bounds), source, target, pack=pack):
        try:
            file, descriptor = find(resource.uri, folder, bounds)
        except RefusedError:
            continue
        except OSError as error:
            if error.errno == errno.EACCES:
                message = f'cannot read "{resource.uri}" beside it: {error.strerror}'
                raise InputError(message, place) from error
            continue
        try:
            name = Path(file.path).as_posix()
            if name not in files:
                claim = partial(budget.back, path=name, what=f'"{resource.uri}"', place=place)
                files[name] = bytes(read_open_file(descriptor, claim)) if with_content else b""
        finally:
            os.close(descriptor)
    return files
