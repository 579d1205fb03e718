"""Run GLSL vertex shaders in software contexts without a window: OpenGL ES 3 and desktop OpenGL 4.5.

moderngl itself asks EGL for desktop contexts only; these are made here and handed to it. Debian packages
libegl1 and libgl1-mesa-dri (llvmpipe).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from tests.support.strictness import missing_tool

# Khronos' EGL registry.
_SURFACELESS_MESA, _NONE, _RENDERABLE_TYPE = 0x31DD, 0x3038, 0x3040
_MAJOR, _MINOR, _PROFILE, _CORE = 0x3098, 0x30FB, 0x30FD, 1
_APIS = {"es": (0x30A0, 0x0040), "desktop": (0x30A2, 0x0008)}
"""By kind of context: the API to bind, and the bit of configurations that serve it."""
_POINTS = 0x0000
_VERSIONS = {"es": (_MAJOR, 3, _MINOR, 0), "desktop": (_MAJOR, 4, _MINOR, 5, _PROFILE, _CORE)}


class _Egl:
    """The display that needs no screen."""

    def __init__(self, path: str) -> None:
        self.library = ctypes.CDLL(path)
        handle = ctypes.c_void_p
        for name, count in (("GetPlatformDisplay", 3), ("CreateContext", 4), ("GetProcAddress", 1)):
            function = getattr(self.library, f"egl{name}")
            function.restype = handle
            function.argtypes = [ctypes.c_uint if name == "GetPlatformDisplay" else handle, *[handle] * 3][
                :count
            ]
        self.library.eglGetProcAddress.argtypes = [ctypes.c_char_p]
        self.display = handle(self.library.eglGetPlatformDisplay(_SURFACELESS_MESA, None, None))
        self.works = bool(self.display) and bool(self.library.eglInitialize(self.display, None, None))

    def context(self, kind: str) -> ctypes.c_void_p:
        api, bit = _APIS[kind]
        self.library.eglBindAPI(api)
        config, count = ctypes.c_void_p(), ctypes.c_int()
        wanted = (ctypes.c_int * 3)(_RENDERABLE_TYPE, bit, _NONE)
        # A surfaceless context may go without a configuration.
        self.library.eglChooseConfig(self.display, wanted, ctypes.byref(config), 1, ctypes.byref(count))
        version = (ctypes.c_int * 7)(*_VERSIONS[kind], _NONE)
        return ctypes.c_void_p(self.library.eglCreateContext(self.display, config, None, version))

    def use(self, context: ctypes.c_void_p | None) -> None:
        if not self.library.eglMakeCurrent(self.display, None, None, context):
            raise RuntimeError(f"EGL error {self.library.eglGetError():#x}")


class _Loader:
    """A context of ours as moderngl takes it."""

    def __init__(self, egl: _Egl, kind: str) -> None:
        self._egl, self._context = egl, egl.context(kind)
        if not self._context:
            missing_tool(f"EGL makes no {kind} context (Debian package libgl1-mesa-dri)")
        egl.use(self._context)

    def load_opengl_function(self, name: str) -> int:
        return self._egl.library.eglGetProcAddress(name.encode()) or 0

    load = load_opengl_function

    def __enter__(self) -> None:
        self._egl.use(self._context)

    def __exit__(self, *details: object) -> None:
        """Leave it current."""

    def release(self) -> None:
        self._egl.use(None)
        self._egl.library.eglDestroyContext(self._egl.display, self._context)


class Context:
    """A context in which vertex shaders are run by transform feedback."""

    def __init__(self, context: Any) -> None:
        self._context = context
        # Without a framebuffer the feedback is zeros, and no error.
        self._target = context.framebuffer([context.renderbuffer((1, 1))])
        self._target.use()

    @property
    def version(self) -> str:
        """Return what the driver calls itself, such as ``OpenGL ES 3.2 Mesa 22.3.6``."""
        return str(self._context.info["GL_VERSION"])

    def run(
        self,
        shader: str,
        attributes: Sequence[tuple[str, str]],
        columns: npt.NDArray[np.float32],
        outputs: Sequence[str],
        width: int,
        blocks: Mapping[str, npt.NDArray[np.float32]] = MappingProxyType({}),
    ) -> npt.NDArray[np.float32]:
        """Run a vertex shader over columns (R, C, 4) and return its outputs, side by side: (R, width).

        attributes name each column with its type in moderngl's words, sixteen bytes. outputs are of
        floating types, ``width`` components in all. blocks fill uniform blocks.
        """
        version = shader.partition("\n")[0]
        fragment = f"{version}\nvoid main() {{}}"
        program = self._context.program(
            vertex_shader=shader, fragment_shader=fragment, varyings=list(outputs)
        )
        held = [self._context.buffer(columns.tobytes())]
        for number, (name, values) in enumerate(blocks.items()):
            program[name].binding = number
            held.append(self._context.buffer(values.tobytes()))
            held[-1].bind_to_uniform_block(number)
        layout = " ".join(form for _, form in attributes)
        names = [name for name, _ in attributes]
        # An attribute that the compiler dropped, such as one that only a dropped result reads, is skipped.
        array = self._context.vertex_array(program, [(held[0], layout, *names)], skip_errors=True)
        held.append(self._context.buffer(reserve=4 * len(columns) * width))
        array.transform(held[-1], mode=_POINTS, vertices=len(columns))
        found = np.frombuffer(held[-1].read(), np.float32).reshape(-1, width)
        for thing in (array, program, *held):
            thing.release()
        return found

    def compute(self, shader: str, uniform: bytes, storage: Sequence[bytes | int], groups: int) -> bytes:
        """Run a compute shader over so many groups; binding 0 is uniform, the others are storage.

        One of ``storage`` is the number of bytes of the results, which are zeros at first.
        """
        program = self._context.compute_shader(shader)
        filled = [bytes(one) if isinstance(one, int) else one for one in storage]
        held = [self._context.buffer(one) for one in (uniform, *filled)]
        held[0].bind_to_uniform_block(0)
        for number, one in enumerate(held[1:], 1):
            one.bind_to_storage_buffer(number)
        program.run(groups)
        (results,) = (one for one, given in zip(held[1:], storage, strict=True) if isinstance(given, int))
        found = bytes(results.read())
        for thing in (program, *held):
            thing.release()
        return found


@contextmanager
def context(kind: str) -> Iterator[Context]:
    """Make a context, ``es`` (OpenGL ES 3) or ``desktop`` (4.5 core); else skip, or fail in a strict run."""
    if importlib.util.find_spec("moderngl") is None:
        missing_tool("moderngl is not installed (pip install 'skinbake[dev]')")
    import moderngl

    # Most of the time llvmpipe compiles: without optimising it takes half as long. It asks once a process.
    os.environ.setdefault("GALLIVM_PERF", "nopt")
    path = ctypes.util.find_library("EGL")
    egl = _Egl(path) if path else None
    if egl is None or not egl.works:
        missing_tool("EGL does not work here (Debian packages libegl1 and libgl1-mesa-dri)")
    loader = _Loader(egl, kind)
    # Its stub knows settings as a dict; it takes a context of the caller's too.
    settings: dict[str, Any] = {"context": loader}
    made = moderngl.create_context(require=300, **settings)
    try:
        yield Context(made)
    finally:
        made.release()
        loader.release()
