"""Off-screen Mesa as a shared library: OpenGL on the processor for machines that have no GL installed at all.

The library comes from the system (libOSMesa) or from the `lavavu-osmesa` wheel, which bundles Mesa with its LLVM.
The object made here is what moderngl asks of a context: `load` finds GL functions, entering makes it current.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
from pathlib import Path

_PROFILE, _CORE_PROFILE = 0x33, 0x34
_MAJOR, _MINOR = 0x36, 0x37
_FORMAT, _RGBA = 0x22, 0x1908
_DEPTH_BITS = 0x30
_UNSIGNED_BYTE = 0x1401


def _bundled() -> ctypes.CDLL | None:
    """The library of the wheel, its dependencies loaded first, found by name without importing the package."""
    spec = importlib.util.find_spec("lavavu_osmesa") or importlib.util.find_spec("lavavu")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).parents[1] / "lavavu_osmesa.libs"
    pending = sorted(folder.glob("*.so*")) if folder.is_dir() else []
    found = None
    # Each needs others of the same folder: load what can be loaded until nothing more can.
    while pending:
        left = []
        for path in pending:
            try:
                library = ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            except OSError:
                left.append(path)
                continue
            if path.name.startswith("libOSMesa"):
                found = library
        if len(left) == len(pending):
            break
        pending = left
    return found


def _library() -> ctypes.CDLL:
    name = ctypes.util.find_library("OSMesa")
    if name is not None:
        try:
            return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        except OSError:
            pass
    library = _bundled()
    if library is None:
        raise OSError("no libOSMesa on the system and no lavavu-osmesa package")
    return library


class OSMesaContext:
    """An OpenGL 3.3 core context that draws in memory.

    Raises:
        OSError: when there is no OSMesa library, or it makes no such context.
    """

    def __init__(self) -> None:
        self._library = _library()
        create = self._library.OSMesaCreateContextAttribs
        create.restype = ctypes.c_void_p
        create.argtypes = [ctypes.POINTER(ctypes.c_int), ctypes.c_void_p]
        attributes = [_FORMAT, _RGBA, _DEPTH_BITS, 24, _PROFILE, _CORE_PROFILE, _MAJOR, 3, _MINOR, 3, 0]
        self._handle = create((ctypes.c_int * len(attributes))(*attributes), None)
        if not self._handle:
            raise OSError("OSMesa makes no OpenGL 3.3 core context")
        self._buffer = (ctypes.c_ubyte * 4)()
        self._make_current = self._library.OSMesaMakeCurrent
        self._make_current.restype = ctypes.c_ubyte
        self._make_current.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_int]
        self._address = self._library.OSMesaGetProcAddress
        self._address.restype = ctypes.c_void_p
        self._address.argtypes = [ctypes.c_char_p]
        if not self._make_current(self._handle, self._buffer, _UNSIGNED_BYTE, 1, 1):
            raise OSError("OSMesa cannot make its context current")

    def load(self, name: str) -> int:
        """Address of a GL function, 0 when there is none."""
        return self._address(name.encode()) or 0

    def __enter__(self) -> OSMesaContext:
        self._make_current(self._handle, self._buffer, _UNSIGNED_BYTE, 1, 1)
        return self

    def __exit__(self, *_: object) -> None:
        self._make_current(None, None, _UNSIGNED_BYTE, 0, 0)

    def release(self) -> None:
        """Free the context."""
        if self._handle:
            destroy = self._library.OSMesaDestroyContext
            destroy.argtypes, destroy.restype = [ctypes.c_void_p], None
            destroy(self._handle)
            self._handle = None
