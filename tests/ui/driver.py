"""Runs one scenario in a window of GLFW's null platform, in a process of its own.

    python tests/ui/driver.py SCENARIO FOLDER [STAGE]

PREVIS_TEST_SIZE=1440x860 makes the window larger. A process each, because the window's library cannot begin a second
time. A scenario is a function of `scenarios.py` that is given a `Hand`. When it fails, a screenshot is left in
tests/ui/failed.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
FAILED = HERE / "failed"

os.environ["PREVIS_WINDOW"] = "null"

from imgui_bundle import ImVec2, hello_imgui, imgui  # noqa: E402
from imgui_bundle.immapp import testing  # noqa: E402

from previs.ui.app import App  # noqa: E402
from previs.ui.document import Document  # noqa: E402

#: Seconds that anything may take on a busy machine.
PATIENCE = float(os.environ.get("PREVIS_TEST_PATIENCE", "120"))


class Hand:
    """A user of the window: moves the mouse, types, and waits as long as it takes."""

    def __init__(self, context, app: App, folder: Path) -> None:
        # The size of drafts follows how busy the machine is, and with it the passes that run.
        app.picture.pace.measured = lambda *_: None
        self.context = context
        self.app = app
        self.folder = folder
        self._wanted: Callable[[], object] | None = None
        tick = app.tick

        def tick_and_call() -> None:
            tick()
            if self._wanted is not None:
                wanted, self._wanted = self._wanted, None
                self._result = wanted()

        app.tick = tick_and_call

    def call(self, function: Callable[[], Any]) -> Any:
        """What a function returns that needs OpenGL: scenarios run in a thread that the context is not current in."""

        def guarded() -> tuple[Any, BaseException | None]:
            try:
                return function(), None
            except BaseException as error:
                return None, error

        self._wanted = guarded
        self.until(lambda: self._wanted is None, "the call between two frames")
        result, error = self._result
        if error is not None:
            raise error
        return result

    def picture(self) -> np.ndarray:
        """Linear radiance of the picture, (H, W, 3), rows from the top."""
        return self.call(self.app.picture.read)

    @property
    def document(self) -> Document:
        assert self.app.document is not None, "nothing is open"
        return self.app.document

    def frames(self, count: int = 1) -> None:
        """Let the window draw some frames."""
        for _ in range(count):
            self.context.yield_()

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition."""
        end = time.monotonic() + PATIENCE
        while not condition():
            self.check()
            assert time.monotonic() < end, f"waited {PATIENCE:g} s for {what}"
            self.context.yield_()

    def check(self) -> None:
        """Fail if the test engine could not do what it was told, which it only notes."""
        assert not self.context.is_error(), "the test engine could not do it; see its log above"

    def open(self) -> None:
        """Wait until the stage given at the start is open."""
        self.until(lambda: self.app.loading is None and self.app.document is not None, "the stage")

    def seen(self) -> None:
        """Wait until the present state has been drawn, at any level."""
        self.frames(2)
        self.until(lambda: self.app.picture.current, "a picture of the present state")

    def finish(self) -> None:
        """Wait until the picture is in full quality."""
        self.frames(2)
        self.until(lambda: self.app.picture.finished, "the finished picture")

    def finish_both(self) -> None:
        """Wait until both compared pictures are in full quality."""
        self.finish()
        self.until(lambda: self.app.other is not None and self.app.other.finished, "the other picture")

    def _focus(self, item: str) -> None:
        """Bring the panel of an item to the front: tabs hide one another."""
        if not item.startswith("//$"):
            self.context.window_focus("//" + item[2:].split("/")[0])
            self.frames(2)

    def click(self, item: str) -> None:
        """Click an item, such as "//Look/phase"."""
        self._focus(item)
        self.context.item_click(item)
        self.check()

    def type(self, item: str, text: str) -> None:
        """Type a value into a knob."""
        self._focus(item)
        self.context.item_double_click(item)
        self.frames(3)
        self.context.key_chars_replace_enter(text)
        self.check()
        self.frames(2)

    def drag(self, item: str, dx: float, steps: int = 8) -> None:
        """Press on an item's middle, move by dx pixels in some steps, release."""
        self._focus(item)
        self.context.mouse_move(item)
        self._drag(dx, 0.0, steps, imgui.MouseButton_.left)

    def _drag(self, dx: float, dy: float, steps: int, button) -> None:
        position = imgui.get_mouse_pos()
        self.context.mouse_down(button)
        for i in range(1, steps + 1):
            at = ImVec2(position.x + dx * i / steps, position.y + dy * i / steps)
            self.context.mouse_move_to_pos(at)
            self.frames(1)
        self.context.mouse_up(button)
        self.check()
        self.frames(1)

    def press(self, chord: int) -> None:
        """Press a key, with modifiers or-ed in."""
        self.context.key_press(chord)
        self.check()
        self.frames(2)

    def picture_position(self, u: float, v: float) -> ImVec2:
        """Screen position of a point of the picture, parts of its width and height from the upper left corner."""
        info = self.context.item_info("//View/picture")
        self.check()
        rectangle = info.rect_full
        return ImVec2(
            rectangle.min.x + u * (rectangle.max.x - rectangle.min.x),
            rectangle.min.y + v * (rectangle.max.y - rectangle.min.y),
        )

    def click_picture(self, u: float, v: float) -> None:
        """Click into the picture."""
        self.context.mouse_move_to_pos(self.picture_position(u, v))
        self.context.mouse_click(imgui.MouseButton_.left)
        self.check()
        self.frames(2)

    def drag_picture(self, dx: float, dy: float, button=imgui.MouseButton_.left, steps: int = 6) -> None:
        """Drag in the picture from its middle, in pixels."""
        self.context.mouse_move_to_pos(self.picture_position(0.5, 0.5))
        self._drag(dx, dy, steps, button)

    def capture(self, name: str) -> Path:
        """A screenshot in the test's folder."""
        path = self.folder / f"{name}.png"
        testing.capture(self.context, str(path))
        return path


def main() -> int:
    name, folder, *stage = sys.argv[1:]
    sys.path.insert(0, str(HERE))
    import scenarios

    from previs.ui.window import Start, run

    os.environ["PREVIS_CONFIG"] = os.environ.get("PREVIS_CONFIG") or str(Path(folder) / "config")
    scenario = getattr(scenarios, name)

    def test(context, app: App) -> None:
        engine = imgui.test_engine.get_io(hello_imgui.get_imgui_test_engine())
        engine.config_watchdog_warning = engine.config_watchdog_kill_test = engine.config_watchdog_kill_app = 1e9
        try:
            scenario(Hand(context, app, Path(folder)))
            assert not app.internal_errors, app.internal_errors[0]
        except BaseException:
            if not context.is_error():
                FAILED.mkdir(exist_ok=True)
                testing.capture(context, str(FAILED / f"{name}.png"))
            raise

    width, height = os.environ.get("PREVIS_TEST_SIZE", "1060x620").split("x")
    run(Start(path=stage[0] if stage else None, size=(int(width), int(height))), test)
    return 0


if __name__ == "__main__":
    sys.exit(main())
