"""Resolve the ``#import`` and ``#ifdef`` of a Bevy shader, so that plain WGSL is left.

A small part of what Bevy's own composer (naga_oil) does: names of a module get its path as a prefix, and
importing what a module does not declare is an error. Modules are the stand-ins of ``stub/wgsl``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

MODULES = Path(__file__).parent / "stub" / "wgsl"
_DECLARED = re.compile(r"^(?:@\S+\s+)*(?:fn|struct|const|alias|var(?:<[^>]*>)?)\s+(\w+)", re.MULTILINE)
_IMPORT = re.compile(r"^#import\s+([\w:]+(?:::\{[^#]*?^\}|::\{[^}\n]*\})?)[^\S\n]*$", re.MULTILINE)


def compose(text: str, defines: Iterable[str]) -> str:
    """Return the WGSL of a shader and of the modules that it imports, under these shader definitions.

    Raises ValueError where a module or a name in it does not exist, or a directive is not understood.
    """
    defined = frozenset(defines)
    finished: dict[str, str] = {}
    own = _linked(text, defined, finished)
    return "\n".join([*finished.values(), own])


def without_comments(text: str) -> str:
    """Return the text without line comments."""
    return re.sub(r"//[^\n]*", "", text)


def _linked(text: str, defined: frozenset[str], finished: dict[str, str]) -> str:
    """Return one module's text with imported names spelled out; compose what it imports first."""
    text = _chosen(without_comments(text), defined)
    imports = [path for found in _IMPORT.finditer(text) for path in _paths(found[1])]
    text = _IMPORT.sub("", text)
    for path in imports:
        text = _with_import(text, path, defined, finished)
    if left := re.search(r"^\s*#.*|\b\w+::\w+", text, re.MULTILINE):
        raise ValueError(f"not resolved: {left[0].strip()}")
    return text


def _with_import(text: str, path: str, defined: frozenset[str], finished: dict[str, str]) -> str:
    name = path.rpartition("::")[2]
    if _file(path).is_file():
        declared = _module(path, defined, finished)

        def member(found: re.Match[str]) -> str:
            return _mangled(path, found[1], declared)

        return re.sub(rf"(?<![\w:.]){name}::(\w+)", member, text)
    module = path.rpartition("::")[0]
    declared = _module(module, defined, finished)
    pattern = rf"(?<![\w:.]){name}\b(?!\s*::)"
    # As in naga_oil, an import that the definitions leave unused may lead nowhere.
    if not re.search(pattern, text):
        return text
    return re.sub(pattern, _mangled(module, name, declared), text)


def _module(path: str, defined: frozenset[str], finished: dict[str, str]) -> set[str]:
    """Compose a stand-in once, under its mangled names, and return the names that it declares."""
    file = _file(path)
    if not file.is_file():
        raise ValueError(f"no module {path}")
    head, _, body = file.read_text().partition("\n")
    if head != f"#define_import_path {path}":
        raise ValueError(f"{file.name} defines {head}")
    declared = set(_DECLARED.findall(_chosen(without_comments(body), defined)))
    if path not in finished:
        text = _linked(body, defined, finished)
        for name in declared:
            text = re.sub(rf"(?<![\w.]){name}\b", _mangled(path, name, declared), text)
        finished[path] = text
    return declared


def _file(path: str) -> Path:
    return MODULES / f"{path.removeprefix('bevy_pbr::')}.wgsl"


def _mangled(path: str, name: str, declared: set[str]) -> str:
    if name not in declared:
        raise ValueError(f"{path} has no {name}")
    return f"{path.replace('::', '_')}_{name}"


def _paths(imported: str) -> Iterator[str]:
    """Spell out ``a::{b, c::d}`` as ``a::b`` and ``a::c::d``."""
    prefix, braces, items = imported.partition("{")
    if not braces:
        yield imported
        return
    for item in items.rstrip("} \n").split(","):
        if item.strip():
            yield prefix + item.strip()


def _chosen(text: str, defined: frozenset[str]) -> str:
    """Return the lines that ``#ifdef``, ``#ifndef``, ``#else`` and ``#endif`` leave."""
    kept: list[str] = []
    taken = [True]
    for line in text.splitlines():
        words = line.split()
        if words and words[0] in ("#ifdef", "#ifndef"):
            taken.append((words[1] in defined) == (words[0] == "#ifdef"))
        elif words and words[0] == "#else":
            taken[-1] = not taken[-1]
        elif words and words[0] == "#endif":
            taken.pop()
        elif all(taken):
            kept.append(line)
    if len(taken) != 1:
        raise ValueError("#ifdef and #endif do not match")
    return "\n".join(kept)
