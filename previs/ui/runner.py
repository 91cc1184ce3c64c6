"""The callbacks of the window: what hello_imgui calls at its beginning, in every frame, and at its end."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from typing import Any

import glfw
import imgui_bundle
import moderngl
from imgui_bundle import hello_imgui, imgui, immapp

from ..errors import PrevisError
from .actions import make_commands
from .app import App
from .dialogs import Dialogs
from .document import Document
from .inspector import draw_inspector
from .keys import run_shortcuts
from .menus import draw_menus
from .outliner import draw_outliner
from .panel import draw_look
from .preferences import Preferences
from .questions import Questions
from .recovery import Recovery
from .render_panel import draw_render
from .status import draw_status
from .theme import apply_theme
from .timeline import draw_timeline
from .viewport import draw_viewport
from .window import ACTIVE_RATE, IDLE_RATE, Start


class Runner:
    """Ties the application to hello_imgui. `app` is None until the window is there."""

    def __init__(self, start: Start) -> None:
        self._start = start
        self.app: App | None = None
        self.failure: BaseException | None = None
        self._preferences = Preferences.load()
        self._dialogs = Dialogs()
        self._questions: Questions | None = None
        self._last_frame: float | None = None
        self._parameters: hello_imgui.RunnerParams | None = None

    def parameters(self) -> tuple[hello_imgui.RunnerParams, immapp.AddOnsParams]:
        """The window's description for hello_imgui."""
        p = self._parameters = hello_imgui.RunnerParams()
        p.app_window_params.window_title = "previs"
        p.app_window_params.window_geometry.size = self._start.size
        p.app_window_params.restore_previous_geometry = os.environ.get("PREVIS_WINDOW") != "null"
        p.ini_folder_type = hello_imgui.IniFolderType.absolute_path
        p.ini_filename = str(self._preferences.layout_path)
        p.imgui_window_params.default_imgui_window_type = (
            hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        )
        p.imgui_window_params.show_menu_bar = True
        p.imgui_window_params.show_menu_app = False
        p.imgui_window_params.show_menu_view = False
        p.imgui_window_params.show_menu_view_themes = False
        p.imgui_window_params.remember_theme = False
        p.imgui_window_params.show_status_bar = True
        p.imgui_window_params.show_status_fps = False
        p.imgui_window_params.remember_status_bar_settings = False
        options = hello_imgui.OpenGlOptions()
        # The panels need no multisampling, and a rasteriser on the processor pays for it dearly.
        options.anti_aliasing_samples = 0
        options.major_version, options.minor_version, options.use_core_profile = 3, 3, True
        p.renderer_backend_options.open_gl_options = options
        p.fps_idling.fps_max = ACTIVE_RATE
        p.fps_idling.fps_idle = IDLE_RATE
        p.fps_idling.time_active_after_last_event = 0.1
        p.fps_idling.fps_idling_mode = hello_imgui.FpsIdlingMode.sleep
        callbacks = p.callbacks
        callbacks.post_init = self._guarded(self._begin)
        callbacks.pre_new_frame = self._guarded(self._between_frames)
        callbacks.show_menus = self._guarded(self._menus)
        callbacks.show_gui = self._guarded(self._above_panels)
        callbacks.show_status = self._guarded(self._status)
        callbacks.setup_imgui_style = apply_theme
        callbacks.before_exit = self._end
        callbacks.confirm_exit = self._confirm_exit
        p.docking_params = self._layout()
        return p, immapp.AddOnsParams(with_implot=True)

    def _layout(self) -> hello_imgui.DockingParams:
        layout = hello_imgui.DockingParams()
        split = hello_imgui.DockingSplit
        layout.docking_splits = [
            split("MainDockSpace", "Right", imgui.Dir.right, 0.27),
            split("MainDockSpace", "Left", imgui.Dir.left, 0.24),
            split("Left", "LeftBottom", imgui.Dir.down, 0.45),
            split("MainDockSpace", "Bottom", imgui.Dir.down, 0.09),
        ]
        panels = (
            ("View", "MainDockSpace", self._viewport),
            ("Look", "Right", lambda: draw_look(self.app)),
            ("Render", "Right", lambda: draw_render(self.app)),
            ("Outliner", "Left", lambda: draw_outliner(self.app)),
            ("Inspector", "LeftBottom", lambda: draw_inspector(self.app)),
            ("Timeline", "Bottom", lambda: draw_timeline(self.app)),
        )
        windows = [
            hello_imgui.DockableWindow(name, space, self._guarded(draw), True, name != "View")
            for name, space, draw in panels
        ]
        next(w for w in windows if w.label == "Look").focus_window_at_next_frame = True
        windows[0].imgui_window_flags = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
        # The list is a copy on both ways into C++.
        layout.dockable_windows = windows
        return layout

    def _guarded(self, call: Callable[[], None]) -> Callable[[], None]:
        """The callback; what it raises ends the window and is raised after it, since C++ lies in between."""

        def guarded() -> None:
            if self.failure is not None:
                return
            try:
                call()
            except Exception as error:
                self._fail(error)

        return guarded

    def _fail(self, error: Exception) -> None:
        """End the window, the edits kept for the next session."""
        self.failure = error
        hello_imgui.get_runner_params().app_shall_exit = True
        if self.app is not None:
            with contextlib.suppress(Exception):
                # Whatever is wrong with the application, its first error is the one to hear of.
                self.app.save_for_recovery()

    # --- callbacks ------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        context = moderngl.create_context(require=330)
        self.app = App(context, self._preferences, Recovery())
        self._questions = Questions(self.app, self._dialogs)
        self.app.commands = make_commands(self.app, self._dialogs, self._questions.leave, self._quit)
        glfw.set_drop_callback(imgui_bundle.glfw_utils.glfw_window_hello_imgui(), self._dropped)
        self._questions.offer_recovery()
        if self._start.path is not None:
            self.app.open(self._start.path, self._opened, time=self._start.time, **(self._start.scene_options or {}))

    def _opened(self, document: Document) -> None:
        """Apply what the command line asked for."""
        assert self.app is not None
        if self._start.camera is not None:
            try:
                found = document.scene.camera(self._start.camera, document.time_code)
            except PrevisError as error:
                self.app.notify(str(error), "error")
            else:
                self.app.look_through(found.path)

    def _dropped(self, _window: Any, paths: list[str]) -> None:
        if self.app is not None and self._questions is not None and paths:
            app = self.app
            self._questions.leave(lambda: app.open(paths[0]))

    def _between_frames(self) -> None:
        app, parameters = self.app, self._parameters
        if app is None or parameters is None:
            return
        now = time.perf_counter()
        if self._last_frame is not None:
            app.frames.add(now - self._last_frame)
        self._last_frame = now
        app.dragging = imgui.is_any_item_active() and any(imgui.is_mouse_down(b) for b in range(3))
        app.tick()
        # hello_imgui draws into whatever framebuffer is bound.
        app.context.screen.use()
        parameters.fps_idling.enable_idling = not app.busy
        name = f"{app.document.name}{' •' if app.document.modified else ''} - previs" if app.document else "previs"
        if name != parameters.app_window_params.window_title:
            parameters.app_window_params.window_title = name
            glfw.set_window_title(imgui_bundle.glfw_utils.glfw_window_hello_imgui(), name)

    def _viewport(self) -> None:
        assert self.app is not None
        draw_viewport(self.app)

    def _menus(self) -> None:
        if self.app is not None and self._questions is not None:
            draw_menus(self.app, self._questions.leave)

    def _above_panels(self) -> None:
        if self.app is None or self._questions is None:
            return
        io = imgui.get_io()
        if io.mouse_delta.x or io.mouse_delta.y or io.mouse_wheel or io.want_text_input or any(io.mouse_down):
            self.app.touched = time.monotonic()
        run_shortcuts(self.app.commands)
        self._dialogs.draw()
        self._questions.draw()

    def _status(self) -> None:
        if self.app is not None:
            draw_status(self.app)

    def _confirm_exit(self) -> bool:
        try:
            if self.failure is not None or self._questions is None or not self._questions.unsaved:
                return True
            self._questions.leave(self._quit)
        except Exception as error:
            self._fail(error)
            return True
        return False

    def _quit(self) -> None:
        hello_imgui.get_runner_params().app_shall_exit = True

    def _end(self) -> None:
        if self.app is None:
            return
        try:
            self.app.keep_preferences()
            self.app.release(clean=self.failure is None)
        except Exception as error:
            self.failure = self.failure or error
