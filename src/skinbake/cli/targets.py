"""The target of each file, checked before any file is read."""

from __future__ import annotations

import codecs
import os
import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import click

from skinbake.cli.inputs import MAGIC, Input
from skinbake.files.folders import open_regular
from skinbake.files.urls import STDIO, File, is_url, join_url, named_file, on_disk
from skinbake.wording import SUFFIXES

PAGES = (".html", ".htm")
"""The suffixes of a page."""

GLB_HEADERS = struct.Struct("<4sIIII")
"""The header of a GLB, and the header of its first chunk, which is its JSON."""

GLANCE = 1 << 24
"""The longest JSON in bytes that is looked through before the work begins."""


def check_target(source: File, target: File) -> None:
    """Raise click.UsageError if the target has no known suffix, or is the input itself."""
    name = target.given
    if name == STDIO:
        return
    if Path(name).suffix.lower() not in SUFFIXES:
        raise click.UsageError(f"{name}: expected a name that ends in {', '.join(SUFFIXES)}, or - for stdout")
    if source.is_same(target):
        raise click.UsageError(f"{name} is the input; use --in-place to replace it")


def check_named(target: str, instead: str = "name the file", *, may_be_url: bool = False) -> None:
    """Raise click.UsageError if the name of an output is that of a folder, there or not, or a URL."""
    if is_url(target) and not may_be_url:
        raise click.UsageError(f"{target} is a URL: only models go to URLs; name a file on this disk")
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
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(_head(target))  # the last character may be cut
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise click.UsageError(f"{target} exists and is not text; choose another name")


def is_model_name(path: str) -> bool:
    """Tell whether a name, or the name of the file that it links to, has the suffix of a model."""
    return any(name.lower().endswith(SUFFIXES) for name in (path, named_file(path).place))


PICTURES = (b"\x89PNG", b"GIF8", b"RIFF")
"""How pictures of ``render`` begin: PNG, GIF and WebP."""


def check_picture_target(target: str) -> None:
    """Raise click.UsageError if a picture would replace a model, through links too, or another file."""
    if is_model_name(target):
        raise click.UsageError(f"{target} is the name of a model; name the file of the picture")
    if (head := _head(target)) and not head.startswith(PICTURES):
        raise click.UsageError(f"{target} exists and is not a PNG, WebP or GIF; choose another name")


def check_read(option: str, files: Iterable[File], targets: Iterable[tuple[Input, File | None]]) -> None:
    """Raise click.UsageError if a file that an option reads is also an output, through links too."""
    written = [target for _, target in targets if target is not None]
    for file in files:
        for target in written:
            if file.is_same(target):
                raise click.UsageError(f"{option}: {file.given} is also an output, {target.given}")


def meant_output(inputs: Sequence[Input]) -> str:
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


def pair_up(inputs: Sequence[Input], folder: str) -> list[tuple[Input, File]]:
    """Return each input, once, with its place in ``folder``.

    Raises click.UsageError if two places would be the same, or if a place would be that of another input.
    """
    pairs: list[tuple[Input, File]] = []
    taken: dict[tuple[object, ...], str] = {}
    folders: dict[str, str] = {}
    sources = {entry.file.key for entry in inputs}
    for entry in dict.fromkeys(inputs):
        source = entry.source
        if source == STDIO:
            raise click.UsageError("--out-dir needs inputs that have a name; use -o for stdin")
        name = join_url(folder, entry.kept) if is_url(folder) else str(Path(folder, entry.kept))
        target = named_file(name, folders)
        if entry.missing is None:
            if target[1:] in taken:  # not the key: hard links are replaced one by one
                raise click.UsageError(
                    f"{taken[target[1:]]} and {source} would both become {name}: take another --out-dir for "
                    "one, or name a folder above both, so that their paths stay"
                )
            taken[target[1:]] = source
            check_target(entry.file, target)
            if target.key in sources:
                raise click.UsageError(f"{source} would be written to {name}, which is also an input")
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
    "--dump-normals": lambda head: head.startswith(b'{"schema": "skinbake.normals/'),
    "--depfile": lambda head: RULES.match(head) is not None,
}
"""The beginning of a file that an earlier run has written, by option."""


def check_reports(
    reports: Mapping[str, str | None], sources: Iterable[File], output: File | None = None
) -> None:
    """Raise click.UsageError if an option's file is an input, an output, another option's, or a folder.

    ``reports`` are the files by option. An existing file is replaced only if an earlier run may have written
    it, because it might otherwise be a file of a model.
    """
    taken = {} if output is None else {output.key: f"the output, {output.given}"}
    own: dict[str | tuple[int, int], str] = {}
    for option, path in reports.items():
        if path is None:
            continue
        if path == STDIO:
            raise click.UsageError(f"{option} needs the name of a file, not -; stdout has other text already")
        check_named(path)
        if is_model_name(path):
            raise click.UsageError(f"{option}: {path} is the name of a model")
        file = named_file(path)
        if file.identity and not Path(on_disk(path) or "").is_file():  # /dev/null may be named several times
            continue
        if file.key in taken:
            raise click.UsageError(f"{option}: {path} is {taken[file.key]}")
        taken[file.key] = f"the file of {option}"
        own[file.key] = f"{option}: {path}"
    for source in sources:
        if source.key in own:
            raise click.UsageError(f"{own[source.key]} is an input")
    for option, path in reports.items():
        if path is not None and option in REPORTS:
            check_earlier(path, REPORTS[option], f"{option}: ")


def check_earlier(path: str, is_own: Callable[[bytes], bool], option: str = "") -> None:
    """Raise click.UsageError if a file is there that is not empty and was not written by an earlier run.

    ``is_own`` tells it from the first 4096 bytes. ``option`` begins the message.
    """
    if (head := _head(path)) and not is_own(head):
        raise click.UsageError(f"{option}{path} exists and was not written by an earlier run")


def _head(path: str) -> bytes:
    """Return the first 4096 bytes of a regular file, none if it cannot be read: the write reports why."""
    with suppress(OSError, ValueError), os.fdopen(open_regular(on_disk(path) or ""), "rb") as file:
        return file.read(4096)
    return b""


def in_turns(inputs: Sequence[Input]) -> list[int]:
    """Return the numbers of the inputs whose files may meet in a folder of outputs, so that order matters.

    Files that documents name are copied beside them. If a name is taken, the second file gets another name.
    Files of one tree keep their paths, and cannot meet others.
    """
    if len({os.path.realpath(root) for root in {entry.root for entry in inputs}}) < 2:
        return []
    return [number for number, entry in enumerate(inputs) if _names_files(entry.source)]


def _names_files(source: str) -> bool:
    """Tell whether a document may name other files. True if a glance cannot tell."""
    if Path(source).suffix.lower() == ".gltf" or is_url(source):
        return True
    try:
        with os.fdopen(open_regular(source), "rb") as file:
            head = file.read(GLB_HEADERS.size)
            length = GLB_HEADERS.unpack(head)[3]
            text = file.read(min(length, GLANCE))
    except (OSError, ValueError, struct.error):
        return False  # it cannot be baked either
    return length > GLANCE or b'"uri"' in text or b"\\u" in text
