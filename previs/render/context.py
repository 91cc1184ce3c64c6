"""The one place that makes OpenGL contexts, and says how to get one where there is none."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable

import moderngl

from ..errors import PrevisError

REQUIRED_VERSION = 330
#: Environment variable that picks one of `BACKENDS` instead of trying them in order.
BACKEND_VARIABLE = "PREVIS_GL"

_REMEDY = {
    "linux": "On Debian or Ubuntu: apt-get install --no-install-recommends libegl1 libgl1; "
    "without root, on x86-64: pip install --no-deps lavavu-osmesa",
    "darwin": "macOS brings OpenGL itself: run in a session with a window server",
    "win32": "Install the graphics driver, or Mesa's opengl32.dll for software rendering",
}


class ContextError(PrevisError):
    """No usable OpenGL context can be made on this machine."""


def remedy() -> str:
    """What to install on this platform so that a context can be made."""
    return _REMEDY.get(sys.platform, _REMEDY["linux"])


def _egl() -> moderngl.Context:
    return moderngl.create_standalone_context(require=REQUIRED_VERSION, backend="egl")


def _platform() -> moderngl.Context:
    return moderngl.create_standalone_context(require=REQUIRED_VERSION)


def _osmesa() -> moderngl.Context:
    # It searches the system for a library, with modules that nobody else needs.
    from .osmesa import OSMesaContext

    return moderngl.create_context(require=REQUIRED_VERSION, context=OSMesaContext())


#: Ways to a context, in the order in which they are tried.
BACKENDS: dict[str, Callable[[], moderngl.Context]] = {"egl": _egl, "platform": _platform, "osmesa": _osmesa}


def create_context() -> moderngl.Context:
    """A new context without a window: EGL, then the platform's default, then Mesa as a library.

    Raises:
        ContextError: with what each way answered and what to install.
    """
    wanted = os.environ.get(BACKEND_VARIABLE)
    if wanted is not None and wanted not in BACKENDS:
        raise ContextError(f"{BACKEND_VARIABLE}={wanted}: choose one of {', '.join(BACKENDS)}")
    names = [wanted] if wanted else [n for n in BACKENDS if n == "platform" or sys.platform.startswith("linux")]
    attempts = []
    for name in names:
        try:
            return BACKENDS[name]()
        except Exception as error:  # glcontext raises the builtin Exception and nothing more specific
            attempts.append(f"{name}: {error}")
    raise ContextError(f"OpenGL 3.3 is not available ({'; '.join(attempts)}). {remedy()}")


def is_software(context: moderngl.Context) -> bool:
    """Whether the context renders on the processor (Mesa's llvmpipe or softpipe)."""
    renderer = context.info["GL_RENDERER"].lower()
    return any(name in renderer for name in ("llvmpipe", "softpipe", "swiftshader"))


def finisher(context: moderngl.Context) -> Callable[[], None]:
    """A function that waits until everything drawn in a context is finished; call it where the context is current.

    Other Python threads run meanwhile: moderngl's own `finish` holds the interpreter, and with it a thread that reads
    the next frame.
    """
    window_system = getattr(getattr(context, "mglo", None), "_context", None)
    load = getattr(window_system, "load", None)
    address = load("glFinish") if load is not None else 0
    if not address:
        return context.finish
    # A function called through ctypes lets go of the interpreter.
    return ctypes.CFUNCTYPE(None)(address)


def check_errors(context: moderngl.Context, where: str) -> None:
    """Raise if OpenGL has an error pending.

    Raises:
        RuntimeError: naming the error and what was being done.
    """
    error = context.error
    if error != "GL_NO_ERROR":
        raise RuntimeError(f"OpenGL error {error} after {where}")
