"""The target of each file, checked before any file is read."""

from __future__ import annotations

import codecs
import os
import re
import stat
import struct
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from skinbake.cli.inputs import MAGIC, Input
from skinbake.cli.names import STDIO
from skinbake.errors import ChoiceError
from skinbake.files.bounds import Bounds, Within
from skinbake.files.urls import canonical, is_url, join_url, on_disk
from skinbake.wording import SUFFIXES

if TYPE_CHECKING:
    from skinbake.cli.given import Given
    from skinbake.jobs.work import Job

IGNORES_CASE = sys.platform in {"darwin", "win32"}
"""Whether the usual disks of this system take ``A.glb`` and ``a.glb`` for one file."""

GLB_HEADERS = struct.Struct("<4sIIII")
"""The header of a GLB, and the header of its first chunk, which is its JSON."""


def check_target(source: str, target: str, *, instead: str = "use --in-place to replace it") -> None:
    """Raise click.UsageError if the target has no known suffix, or is the input itself.

    ``instead`` is the advice for the latter case.
    """
    if target == STDIO:
        return
    if Path(target).suffix.lower() not in SUFFIXES:
        raise click.UsageError(
            f"{target}: expected a name that ends in {', '.join(SUFFIXES)}, or - for stdout"
        )
    if source != STDIO and _same_file(source, target):
        raise click.UsageError(f"{target} is the input; {instead}")


def check_named(target: str, instead: str = "name the file") -> None:
    """Raise click.UsageError if the name of an output is that of a folder, there or not."""
    path = on_disk(target) or ""
    is_folder = os.path.isdir(path)  # noqa: PTH112  # pathlib fails for long names
    if target != STDIO and (is_folder or target.endswith(("/", os.sep))):
        raise click.UsageError(f"{target} is a folder: {instead}")


def check_text_target(target: str) -> None:
    """Raise click.UsageError if text would replace a model, through links too, or a file that is not text."""
    if target == STDIO:
        return
    if is_model_name(target):
        raise click.UsageError(f"{target} is the name of a model; name the file of the shader code")
    if _identity(target) is not None and not _is_text(_head(target)):
        raise click.UsageError(f"{target} exists and is not text; choose another name")


def is_model_name(path: str) -> bool:
    """Tell whether a name, or the name of the file that it links to, has the suffix of a model."""
    try:
        linked = canonical(path)
    except (OSError, ValueError):
        linked = path  # the write will report the reason
    return any(name.lower().endswith(SUFFIXES) for name in (path, linked))


def _is_text(head: bytes) -> bool:
    """Tell whether the beginning of a file is UTF-8 without a zero byte."""
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)  # the last character may be cut
    except UnicodeDecodeError:
        return False
    return b"\0" not in head


PICTURES = (b"\x89PNG", b"GIF8", b"RIFF")
"""How pictures of ``render`` begin: PNG, GIF and WebP."""


def check_picture_target(target: str) -> None:
    """Raise click.UsageError if a picture would replace a model, through links too, or another file."""
    if is_model_name(target):
        raise click.UsageError(f"{target} is the name of a model; name the file of the picture")
    if _identity(target) is not None and (head := _head(target)) and not head.startswith(PICTURES):
        raise click.UsageError(f"{target} exists and is no PNG, WebP or GIF; choose another name")


def check_read(option: str, paths: Iterable[str], targets: Iterable[str | None]) -> None:
    """Raise click.UsageError if a file that an option reads is also an output, through links too."""
    written = [target for target in targets if target not in {None, STDIO}]
    for path in paths:
        for target in written:
            if _same_file(path, str(target)):
                raise click.UsageError(f"{option}: {path} is also an output, {target}")


def _same_file(first: str, second: str) -> bool:
    """Tell whether two names are one file. A name that no disk accepts is not a file."""
    one, other = on_disk(first), on_disk(second)
    if one is None or other is None:
        return canonical(first) == canonical(second)
    try:
        return Path(one).samefile(other)
    except (OSError, ValueError):
        return False


def targets_of(inputs: list[Input], given: Mapping[str, Any]) -> list[tuple[Input, str | None]]:
    """Return (input, output) pairs. Raises click.UsageError for a combination without a meaning."""
    chosen = [name for name in ("output", "out_dir", "in_place") if given[name]]
    if len(chosen) > 1:
        raise click.UsageError("give only one of -o/--output, --out-dir and --in-place")
    if not chosen and not given.get("dry_run"):
        raise click.UsageError("give one of -o/--output, --out-dir and --in-place" + _meant_output(inputs))
    if given["output"]:
        if len(inputs) > 1:
            raise click.UsageError("-o takes one input; use --out-dir for several")
        if given["output"] == STDIO and given["as_json"]:
            why = " prints to stdout, and so does -o -: name the file of the GLB"
            raise ChoiceError("as_json", reason=(why,))
        check_named(given["output"], f"use --out-dir {given['output']}, or name the file")
        check_target(inputs[0].source, given["output"])
        return [(inputs[0], given["output"])]
    if given["in_place"]:
        if any(entry.source == STDIO for entry in inputs):
            raise click.UsageError("--in-place needs files, not - for stdin")
        return [(entry, entry.source) for entry in once(inputs)]
    if given["out_dir"] == STDIO:
        raise click.UsageError("--out-dir needs the name of a folder, not -; -o - writes to stdout")
    if given["out_dir"]:
        return list(pair_up(inputs, given["out_dir"]))
    return [(entry, None) for entry in inputs]


def _meant_output(inputs: Sequence[Input]) -> str:
    """Return the advice for a second name that stands for no file yet: it may be meant as the output."""
    if len(inputs) != 2 or STDIO in {entry.source for entry in inputs}:
        return ""
    last = inputs[1]
    path = on_disk(last.source)
    if path is None or last.searched is not None or not MAGIC.isdisjoint(path) or os.path.lexists(path):
        return ""
    suffix = Path(path).suffix.lower()
    if suffix and suffix not in SUFFIXES:
        return ""
    option = "-o" if suffix else "--out-dir"
    return f"; {last.source} was taken for a second input: write {option} {last.source}"


def jobs_of(
    targets: Iterable[tuple[Input, str | None]],
    given: Given,
    known: Callable[[str | None], bytes | None] = lambda target: None,
) -> list[Job]:
    """Return the jobs of pairs from ``targets_of``. ``known`` returns the record of a target."""
    from skinbake.jobs.work import Job

    return [
        Job(
            entry.source,
            target,
            known(target),
            within=Within(Bounds(entry.searched, given["allow_outside"]), given.get("out_dir")),
        )
        if entry.missing is None
        else Job(entry.source, missing=entry.missing)
        for entry, target in targets
    ]


def pair_up(inputs: Sequence[Input], folder: str) -> list[tuple[Input, str]]:
    """Return each input, once, with its place in ``folder``.

    Raises click.UsageError if two places would be the same, or if a place would be that of another input.
    """
    pairs: list[tuple[Input, str]] = []
    taken: dict[str, str] = {}
    found = _Found()
    sources = {found.real(entry.source) for entry in inputs}
    for entry in dict.fromkeys(inputs):
        source = entry.source
        if source == STDIO:
            raise click.UsageError("--out-dir needs inputs that have a name; use -o for stdin")
        target = join_url(folder, entry.kept) if is_url(folder) else str(Path(folder, entry.kept))
        if entry.missing is None:
            key = found.real(target)
            if key in taken:
                raise click.UsageError(
                    f"{taken[key]} and {source} would both become {target}: take another --out-dir for one, "
                    "or name a folder above both, so that their paths stay"
                )
            taken[key] = source
            check_target(source, target)
            if key in sources:
                raise click.UsageError(f"{source} would be written to {target}, which is also an input")
        pairs.append((entry, target))
    return pairs


RULES = re.compile(rb"(?:\\#|[^\t\n=#])+\.(?:glb|gltf|vrm): (?:\\#|[^\t=#])*\Z", re.IGNORECASE)
"""The beginning of an earlier depfile. A Makefile has recipes, variables or comments."""


def is_page(head: bytes) -> bool:
    """Tell whether a file begins like a page of skinbake."""
    return b'<meta name="generator" content="skinbake ' in head


REPORTS: Mapping[str, Callable[[bytes], bool]] = {
    "--summary": lambda head: head.startswith(b"{"),
    "--junit": lambda head: b"<testsuite" in head,
    "--html": is_page,
    "--depfile": lambda head: RULES.match(head) is not None,
}
"""The beginning of a file that an earlier run has written, by option."""


def check_reports(reports: Mapping[str, str | None], output: str | None, sources: Iterable[str]) -> None:
    """Raise click.UsageError if an option's file is an input, an output, another option's, or a folder.

    Files are compared by identity, through links of both kinds. ``reports`` are
    the files by option. An existing file is replaced only if an earlier run may have written it, because it
    might otherwise be a file of a model.
    """
    taken = dict.fromkeys(_keys(output), f"the output, {output}")
    identities: dict[tuple[int, int], str] = {}
    for option, path in reports.items():
        if path is None:
            continue
        if path == STDIO:
            raise click.UsageError(f"{option} needs the name of a file, not -; stdout has other text already")
        check_named(path)
        keys = _keys(path)
        if is_model_name(path):
            raise click.UsageError(f"{option}: {path} is the name of a model")
        for key in keys:
            if key in taken:
                raise click.UsageError(f"{option}: {path} is {taken[key]}")
            taken[key] = f"the file of {option}"
            if isinstance(key, tuple):
                identities[key] = f"{option}: {path}"
    for source in sources if identities else ():
        identity = _identity(source)
        if identity in identities:
            raise click.UsageError(f"{identities[identity]} is an input")
    for option, path in reports.items():
        if path is not None and option in REPORTS:
            check_earlier(path, REPORTS[option], f"{option}: ")


def check_earlier(path: str, is_own: Callable[[bytes], bool], option: str = "") -> None:
    """Raise click.UsageError if a file is there that is not empty and was not written by an earlier run.

    ``is_own`` tells it from the first 4096 bytes. ``option`` begins the message.
    """
    if _identity(path) is not None and (head := _head(path)) and not is_own(head):
        raise click.UsageError(f"{option}{path} exists and was not written by an earlier run")


def _keys(path: str | None) -> list[str | tuple[int, int]]:
    """Return the keys that two names of a file share: the path without links, and the file's identity."""
    if path in {None, STDIO} or on_disk(str(path)) is None:
        return []
    identity = _identity(str(path))
    try:
        real = os.path.realpath(str(on_disk(str(path))))
        is_odd = identity is None and Path(real).exists()  # /dev/null may be named several times
    except (OSError, ValueError):
        return []  # the write will report the reason
    if is_odd:
        return []
    return [real] if identity is None else [real, identity]


def _identity(path: str) -> tuple[int, int] | None:
    """Return the identity that separates a regular file from all others, or None if there is none."""
    place = on_disk(path)
    if place is None or path == STDIO:
        return None
    try:
        found = os.stat(place)  # noqa: PTH116  # pathlib is slow for a million inputs
    except (OSError, ValueError):
        return None
    return (found.st_dev, found.st_ino) if stat.S_ISREG(found.st_mode) else None


def _head(path: str) -> bytes:
    """Return the first 4096 bytes of a file; none if it cannot be read: the write will report the reason."""
    try:
        with Path(str(on_disk(path))).open("rb") as file:
            return file.read(4096)
    except OSError:
        return b""


def once(inputs: Sequence[Input]) -> list[Input]:
    """Return the inputs, each file once, by the first of its names."""
    first: dict[str, Input] = {}
    for entry in inputs:
        first.setdefault(canonical(entry.source), entry)
    return list(first.values())


class _Found:
    """Real paths, equal for two names of one file. Each folder is looked up once."""

    def __init__(self) -> None:
        self._folders: dict[str, str] = {}

    def real(self, source: str) -> str:
        path = on_disk(source)
        if path is None:
            return canonical(source)
        folder, name = os.path.split(path)
        if folder not in self._folders:
            self._folders[folder] = os.path.realpath(folder)
        whole = os.path.join(self._folders[folder], name)  # noqa: PTH118  # likewise
        return whole.casefold() if IGNORES_CASE else whole


def in_turns(inputs: Sequence[Input]) -> list[int]:
    """Return the numbers of the inputs whose files may meet in a folder of outputs, so that order matters.

    Files that documents name are copied beside them. If a name is taken, the second file gets another name.
    Files of one tree keep their paths, and cannot meet others.
    """
    if len({os.path.realpath(entry.root) for entry in inputs}) < 2:
        return []
    return [number for number, entry in enumerate(inputs) if _names_files(entry.source)]


def _names_files(source: str) -> bool:
    """Tell whether a document may name other files. True if a glance cannot tell."""
    if Path(source).suffix.lower() == ".gltf" or is_url(source):
        return True
    try:
        with Path(source).open("rb") as file:
            head = file.read(GLB_HEADERS.size)
            text = file.read(GLB_HEADERS.unpack(head)[3])
    except (OSError, ValueError, struct.error):
        return False  # it cannot be baked either
    return b'"uri"' in text or b"\\u" in text
