"""Compile HLSL with Microsoft's compiler, DXC, to SPIR-V and to DXIL, which Direct3D 12 takes.

Its library comes with a package of PyPI, compushady-lrtu, of which nothing else is used.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import uuid
from pathlib import Path

from tests.support.strictness import missing_tool

COMPILER_CLASS = uuid.UUID("73e22d93-e6ce-47f3-b5bf-f0664f39c1b0")
COMPILER = uuid.UUID("228b4687-5a6a-4730-900c-9702b2203f54")
RESULT = uuid.UUID("58346cda-dde7-4497-9461-6f87af5e0659")
UTF8 = 65001

CONTAINER = b"DXBC"
"""What a file of DXIL begins with."""

# Places in the tables of functions of its objects, which begin with QueryInterface, AddRef and Release.
RELEASE, COMPILE = 2, 3
STATUS, OBJECT, ERRORS = 3, 4, 5
POINTER, SIZE = 3, 4


class Source(ctypes.Structure):
    """``DxcBuffer``."""

    _fields_ = (("data", ctypes.c_char_p), ("size", ctypes.c_size_t), ("encoding", ctypes.c_uint32))


@functools.cache
def require_library() -> ctypes.CDLL:
    """Return DXC; else skip, or fail under SKINBAKE_STRICT=1."""
    found = importlib.util.find_spec("compushady")
    folders = found.submodule_search_locations if found else None
    paths = [path for folder in folders or () for path in Path(folder).glob("backends/libdxcompiler*.so")]
    return ctypes.CDLL(str(paths[0])) if paths else missing_tool("DXC is not installed: pip compushady-lrtu")


def spirv(shader: str) -> bytes:
    """Compile an HLSL compute shader, entry point ``main``, to SPIR-V; ValueError with the compiler's words.

    The bindings are the numbers of the registers.
    """
    return _compiled(shader, "-spirv")


def dxil(shader: str) -> bytes:
    """Compile an HLSL compute shader, entry point ``main``, to DXIL; ValueError with the compiler's words."""
    return _compiled(shader)


def _compiled(shader: str, *options: str) -> bytes:
    """Warnings are errors."""
    compiler, result, output = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
    make = require_library().DxcCreateInstance
    assert make(COMPILER_CLASS.bytes_le, COMPILER.bytes_le, ctypes.byref(compiler)) == 0
    arguments = ["-T", "cs_6_0", "-E", "main", "-WX", *options]
    given = (ctypes.c_wchar_p * len(arguments))(*arguments)
    text = shader.encode("ascii")
    source = Source(text, len(text), UTF8)
    before = ctypes.byref(source), given, len(arguments), None, RESULT.bytes_le
    assert _call(compiler, COMPILE, *before, ctypes.byref(result)) == 0
    status = ctypes.c_int32()
    assert _call(result, STATUS, ctypes.byref(status)) == 0
    assert _call(result, ERRORS if status.value else OBJECT, ctypes.byref(output)) == 0
    data = ctypes.string_at(
        _call(output, POINTER, returns=ctypes.c_void_p), _call(output, SIZE, returns=ctypes.c_size_t)
    )
    for one in (output, result, compiler):
        _call(one, RELEASE)
    if status.value:
        raise ValueError(data.decode())
    return data


def _call(it: ctypes.c_void_p, place: int, *arguments: object, returns: type = ctypes.c_int32) -> int:
    """Call a function of an object by its place in the object's table."""
    table = ctypes.cast(it, ctypes.POINTER(ctypes.POINTER(ctypes.c_void_p)))[0]
    kinds = [ctypes.c_void_p if not isinstance(one, int) else ctypes.c_uint32 for one in arguments]
    function = ctypes.CFUNCTYPE(returns, ctypes.c_void_p, *kinds)(table[place])
    found: int = function(it, *arguments)
    return found
