"""Files behind URLs: fsspec and its drivers reach them, object stores among them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote, urlsplit

from skinbake.errors import InputError, OutputError, Place, SkinbakeError
from skinbake.files.bounds import is_relative
from skinbake.files.urls import URL, join_url
from skinbake.wording import SUFFIXES, installing

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem  # fsspec is untyped: this is Any

OBJECT_STORES = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az"})
"""Protocols with buckets and without folders. A file appears there when its last byte has arrived."""

WILDCARDS = re.compile(r"[*?\[]")


@dataclass(frozen=True)
class Storage:
    """The files that one fsspec filesystem reaches, by names relative to its root. Paths begin with ``root``.

    Names have forward slashes and no dots to resolve. Those of a web server are decoded. ``spelled`` are the
    URLs of names that a user has given. Methods raise the exceptions of the driver. ``reading`` and
    ``writing`` turn these into messages.
    """

    _filesystem: AbstractFileSystem
    _root: str
    _spelled: Mapping[str, str] = field(compare=False)

    def _path(self, name: str) -> str:
        """Return the driver's path of a file."""
        if name in self._spelled or not _is_web(self._root):
            return self._spelled.get(name, self._root + name)
        host, slash, path = name.partition("/")
        return self._root + host + slash + quote(path)

    def fetch_file(self, name: str, to: Path) -> None:
        """Copy a file here. Raises FileNotFoundError if there is none."""
        self._filesystem.get_file(self._path(name), str(to))
        if not to.is_file():  # drivers copy a folder as a folder
            raise FileNotFoundError(name)

    def has_file(self, name: str) -> bool:
        """Tell whether there is such a file."""
        try:
            return bool(self._filesystem.info(self._path(name))["type"] == "file")
        except FileNotFoundError:
            return False

    def has_content(self, name: str, content: bytes) -> bool:
        """Tell whether an existing file has this content."""
        path = self._path(name)
        if self._filesystem.size(path) != len(content):
            return False
        return bool(self._filesystem.cat_file(path) == content)

    def store_file(self, name: str, content: Path) -> None:
        """Store a file whole or not at all, in place of one of that name; folders are made."""
        path = self._path(name)
        if _is_object_store(self._filesystem):
            self._filesystem.put_file(str(content), path)
            return
        folder = path[: path.rindex("/") + 1] if "/" in path else ""
        if folder.strip("/"):
            self._filesystem.makedirs(folder.rstrip("/"), exist_ok=True)
        import secrets

        from fsspec import AbstractFileSystem

        temporary = f"{folder}.skinbake-{secrets.token_hex(6)}.tmp"
        try:
            self._filesystem.put_file(str(content), temporary)
            if type(self._filesystem).mv is not AbstractFileSystem.mv:
                self._filesystem.mv(temporary, path)
            else:  # fsspec's own ``mv`` copies too, and reads brackets in names as patterns
                self._filesystem.cp_file(temporary, path)
                self._filesystem.rm_file(temporary)
        except BaseException:
            with suppress(Exception):  # the first exception is the one to tell
                self._filesystem.rm_file(temporary)
            raise

    def public_name(self, name: str) -> str:
        """Return the file's URL."""
        return str(self._filesystem.unstrip_protocol(self._path(name)))


def storage_of(url: str) -> tuple[Storage | None, str]:
    """Return the storage of a URL and the name in it, or None and a path of this machine.

    Files on this machine's disk are opened as such: a driver would follow links out of their folder. Raises
    InputError if fsspec or the driver of the URL's protocol is missing.
    """
    filesystem, path = _filesystem(url)
    from fsspec.implementations.local import LocalFileSystem

    if isinstance(filesystem, LocalFileSystem):
        return None, path
    scheme = URL.match(path)
    root = scheme.group() if scheme else path[: len(path) - len(path.lstrip("/"))]
    if _is_object_store(filesystem):  # no relative URI leads into another bucket
        root = path[: path.find("/") + 1]
    name = _decoded(url, path[len(root) :])
    return Storage(filesystem, root, {name: path}), name


def _filesystem(url: str) -> tuple[AbstractFileSystem, str]:
    scheme = url.partition("://")[0]
    if "::" in url:
        raise InputError("it is a chained URL: copy the file out, and name the copy", Place(url))
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise InputError(
            f"URLs need fsspec, which is not installed: {installing('dask')}", Place(url)
        ) from error
    try:
        filesystem, path = url_to_fs(url)
    except ImportError as error:
        raise InputError(f"the driver for {scheme}:// is not installed: {error}", Place(url)) from error
    except ValueError as error:
        if "Protocol not known" in str(error):
            raise InputError(f"fsspec knows no protocol {scheme}://", Place(url)) from error
        raise InputError(f"not a URL that can be read: {error}", Place(url)) from error
    except Exception as error:  # drivers refuse a host or a key by exceptions of any type
        raise InputError(f"cannot be reached: {reason(error)}", Place(url)) from error
    return filesystem, str(path)


def _is_object_store(filesystem: AbstractFileSystem) -> bool:
    protocol = filesystem.protocol
    return not OBJECT_STORES.isdisjoint({protocol} if isinstance(protocol, str) else protocol)


@contextmanager
def _one_sentence(error: type[InputError | OutputError], done: str, file: str) -> Iterator[None]:
    """Raise an error of a kind, with one sentence, for any exception of a storage in the block."""
    try:
        yield
    except (SkinbakeError, MemoryError):
        raise
    except Exception as failure:
        raise error(f"cannot be {done}: {reason(failure)}", Place(file)) from failure


reading = partial(_one_sentence, InputError, "read")
"""Raise InputError, about a file, for any exception of a storage in the block."""

writing = partial(_one_sentence, OutputError, "written")
"""Raise OutputError likewise."""


def reason(error: Exception) -> str:
    """Return the reason why a driver failed, on one line. Object stores seldom set errno."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, FileNotFoundError):
        return "No such file or directory"
    text = str(error).strip().partition("\n")[0]
    if isinstance(error, PermissionError):
        return f"Permission denied ({text})" if text else "Permission denied"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def expand_url(url: str) -> list[tuple[str, str]]:
    """Return (URL, relative path) of each file that a URL means, in order of their paths.

    The URL of a file means the file, under its name. A URL that ends in no suffix of glTF is a folder. It
    means the ``.glb``, ``.gltf`` and ``.vrm`` files in it at any depth, without hidden ones, relative to the
    folder. A pattern with ``*``, ``**``, ``?`` or ``[…]`` means the files that match, relative to the folder
    before its first wildcard. Raises InputError if the storage cannot be read, or if there are no files.
    """
    wildcard, file = WILDCARDS.search(url), PurePosixPath(url)
    if wildcard is None and file.suffix.lower() in SUFFIXES:
        return [(url, _decoded(url, file.name))]
    filesystem, path = _filesystem(url)
    with reading(url):
        if wildcard and filesystem.isfile(path):  # a name may hold brackets
            return [(url, _decoded(url, PurePosixPath(url).name))]
        base = url[: url.rindex("/", 0, wildcard.start()) + 1] if wildcard else url
        start = str(filesystem._strip_protocol(base)).rstrip("/")
        found = filesystem.glob(path) if wildcard else filesystem.find(path)
    names = [str(name)[len(start) :].lstrip("/").split("/") for name in found]
    # Hidden files, and files in hidden folders, count only for a pattern with dots.
    dots = "/." in path[len(start) :]
    relative = [
        "/".join(parts)
        for parts in sorted(names)
        if PurePosixPath(parts[-1]).suffix.lower() in SUFFIXES
        and (dots or not any(part.startswith(".") for part in parts))
    ]
    if not relative:
        what = "no file that matches this pattern" if wildcard else "nothing in this folder"
        raise InputError(f"{what} ends in {', '.join(SUFFIXES)}", Place(url))
    return [(join_url(base, name), _decoded(url, name)) for name in relative]


def _decoded(url: str, name: str) -> str:
    """Return the relative path of an HTTP URL, each part decoded where that leaves a name."""
    if not _is_web(url):
        return name
    parts = [(part, unquote(part)) for part in name.split("/")]
    return "/".join(clear if is_relative(part) and "/" not in clear else part for part, clear in parts)


def _is_web(url: str) -> bool:
    return urlsplit(url).scheme.lower() in {"http", "https"}
