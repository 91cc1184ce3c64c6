"""The one place that makes OpenGL contexts, and says how to get one where there is none."""

from __future__ import annotations

import sys

import moderngl

from ..errors import PrevisError

REQUIRED_VERSION = 330

_REMEDY = {
    "linux": "On Debian or Ubuntu: apt-get install --no-install-recommends libegl1 libgl1 (with software rendering).",
    "darwin": "macOS brings OpenGL itself; run in a session with a window server.",
    "win32": "Install the graphics driver, or Mesa's opengl32.dll for software rendering.",
}


class ContextError(PrevisError):
    """No usable OpenGL context can be made on this machine."""


def remedy() -> str:
    """What to install on this platform so that a context can be made."""
    return _REMEDY.get(sys.platform, _REMEDY["linux"])


def create_context() -> moderngl.Context:
    """A new context without a window: EGL where there is one, else the platform's default.

    Raises:
        ContextError: with what each way answered and what to install.
    """
    attempts = []
    backends: list[dict[str, str]] = [{"backend": "egl"}, {}] if sys.platform.startswith("linux") else [{}]
    for backend in backends:
        name = backend.get("backend", "default")
        try:
            context = moderngl.create_standalone_context(require=REQUIRED_VERSION, **backend)
        except Exception as error:  # glcontext raises the builtin Exception and nothing more specific
            attempts.append(f"{name}: {error}")
            continue
        context.gc_mode = "auto"
        return context
    raise ContextError(f"OpenGL 3.3 is not available ({'; '.join(attempts)}). {remedy()}")


def is_software(context: moderngl.Context) -> bool:
    """Whether the context renders on the processor (Mesa's llvmpipe or softpipe)."""
    renderer = context.info["GL_RENDERER"].lower()
    return any(name in renderer for name in ("llvmpipe", "softpipe", "swiftshader"))


def check_errors(context: moderngl.Context, where: str) -> None:
    """Raise if OpenGL has an error pending.

    Raises:
        RuntimeError: naming the error and what was being done.
    """
    error = context.error
    if error != "GL_NO_ERROR":
        raise RuntimeError(f"OpenGL error {error} after {where}")
