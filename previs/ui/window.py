"""The window: hello_imgui's runner, the layout of the panels, keys, dropped files and the question before leaving."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import PrevisError
from ..render.context import ContextError

#: "null" opens a window of GLFW's null platform: no display is needed and nothing is seen, as tests want it.
PLATFORM_VARIABLE = "PREVIS_WINDOW"
#: Frames a second at most, while something moves, and while nothing does.
ACTIVE_RATE, IDLE_RATE = 60.0, 0.5


@dataclass
class Start:
    """What the window begins with: a file, keyword arguments of `Scene.open` for it, a camera and a time code."""

    path: str | None = None
    scene_options: dict[str, Any] | None = None
    camera: str | None = None
    time: float | None = None
    size: tuple[int, int] = (1440, 860)


def check_display() -> None:
    """See whether a window can be opened at all, before a library ends the process over it.

    Raises:
        PrevisError: with what to do.
    """
    if os.environ.get(PLATFORM_VARIABLE) == "null":
        return
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise PrevisError("no display: neither DISPLAY nor WAYLAND_DISPLAY is set; `previs record` renders without one")


def load_library() -> None:
    """Import the window's library, which needs system libraries that a machine without a desktop may not have.

    Raises:
        PrevisError: with what to do.
    """
    try:
        import imgui_bundle  # noqa: F401
    except ImportError as error:
        raise PrevisError(
            f"the window needs imgui-bundle and its system libraries: {error}. "
            "On Debian or Ubuntu: apt-get install --no-install-recommends libgl1 libx11-6 libxext6"
        ) from error


def run(start: Start, test: Callable[[Any, Any], None] | None = None) -> None:
    """Open the window and return when it is closed.

    Args:
        start: what to begin with.
        test: drives the window in a test: called with the test engine's context and the `App`; the window is closed
            when it returns, and what it raises is raised here.

    Raises:
        PrevisError: when no window or no OpenGL can be had.
    """
    check_display()
    load_library()
    from imgui_bundle import immapp

    from .runner import Runner

    choose_platform()
    runner = Runner(start)
    parameters, add_ons = runner.parameters()
    try:
        if test is None:
            immapp.run(parameters, add_ons)
        else:
            from imgui_bundle.immapp import testing

            testing.run(
                test_function=lambda context: test(context, runner.app),
                runner_params=parameters,
                add_ons_params=add_ons,
            )
    except RuntimeError as error:
        if runner.app is None:
            cause = " ".join(str(error).split())
            raise ContextError(
                f"the display offers no window with OpenGL 3.3 ({cause}); install the graphics driver, or Mesa: "
                "apt-get install --no-install-recommends libgl1-mesa-dri libglx-mesa0"
            ) from error
        raise
    if runner.failure is not None:
        raise runner.failure


def choose_platform() -> None:
    """Start GLFW on the display, or on the null platform where `PLATFORM_VARIABLE` asks for it.

    Raises:
        PrevisError: when the display cannot be reached.
    """
    # After imgui_bundle, whose own GLFW library the glfw package then takes: two of them would not know of each other.
    import glfw

    null = os.environ.get(PLATFORM_VARIABLE) == "null"
    if null:
        glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_NULL)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", glfw.GLFWError)
        begun = glfw.init()
    if not begun:
        # The warning shows GLFW's text as bytes.
        cause = "; ".join(str(w.message).partition("b'")[2].rstrip("'") for w in said) or "there is no display"
        raise PrevisError(f"{cause}; `previs record` renders without a display")
    if null:
        glfw.window_hint(glfw.CONTEXT_CREATION_API, glfw.EGL_CONTEXT_API)
