"""The two questions of the window: what to do with unsaved edits, and with those of a session that crashed."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from imgui_bundle import ImVec2, hello_imgui, imgui

from ..errors import PrevisError
from .app import App
from .dialogs import Dialogs
from .recovery import Entry

_UNSAVED = "Unsaved edits"
_RECOVERED = "Recover edits"


class Questions:
    """Modal questions; `draw` shows the one that is open."""

    def __init__(self, app: App, dialogs: Dialogs) -> None:
        self._app = app
        self._dialogs = dialogs
        self._then: Callable[[], None] | None = None
        self._pending: list[Entry] = []

    @property
    def unsaved(self) -> bool:
        """Whether leaving the document would lose edits."""
        return self._app.document is not None and self._app.document.modified

    def leave(self, then: Callable[[], None]) -> None:
        """Call `then` at once when nothing would be lost, else when the user has decided."""
        if self.unsaved:
            self._then = then
        else:
            then()

    def offer_recovery(self) -> None:
        """Ask about edits that sessions which crashed left behind."""
        self._pending = list(self._app.recovery.pending())

    def draw(self) -> None:
        """Draw the open question, if any."""
        if self._then is not None:
            self._ask_unsaved()
        elif self._pending:
            self._ask_recovery()

    def _ask_unsaved(self) -> None:
        if not _modal(_UNSAVED):
            return
        assert self._app.document is not None
        imgui.text(f"{self._app.document.name} has edits that are not saved.")
        imgui.dummy(ImVec2(0.0, 0.3 * hello_imgui.em_size()))
        then, choice = self._then, _buttons("Save overrides…", "Do not save", "Cancel")
        if choice is not None:
            self._then = None
            imgui.close_current_popup()
        imgui.end_popup()
        if choice == 0:
            folder = os.path.dirname(os.path.abspath(self._app.document.path))
            name = Path(self._app.document.name).stem + "_look.usda"
            self._dialogs.save_file(
                "Save overrides",
                os.path.join(folder, name),
                (".usda", ".usd", ".usdc"),
                lambda path: then() if self._app.save_overrides(path) and then is not None else None,
            )
        elif choice == 1 and then is not None:
            self._app.recovery.discard()
            then()

    def _ask_recovery(self) -> None:
        if not _modal(_RECOVERED):
            return
        entry = self._pending[0]
        imgui.text("previs did not end properly. There are edits that were not saved of")
        imgui.text_colored(imgui.ImVec4(1.0, 0.72, 0.25, 1.0), entry.stage)
        imgui.text_disabled(f"from {entry.saved_at:%Y-%m-%d %H:%M}")
        imgui.dummy(ImVec2(0.0, 0.3 * hello_imgui.em_size()))
        choice = _buttons("Recover", "Throw away", "Later")
        if choice is not None:
            self._pending.pop(0)
            imgui.close_current_popup()
        imgui.end_popup()
        if choice == 0:
            self._pending.clear()
            self._recover(entry)
        elif choice == 1:
            self._forget(entry)

    def _recover(self, entry: Entry) -> None:
        app = self._app
        try:
            state = app.recovery.take(entry)
        except PrevisError as error:
            app.notify(str(error), "error")
            return
        app.recover(state, lambda: self._forget(entry))

    def _forget(self, entry: Entry) -> None:
        try:
            self._app.recovery.forget(entry)
        except PrevisError as error:
            self._app.notify(str(error), "error")


def _modal(title: str) -> bool:
    if not imgui.is_popup_open(title):
        imgui.open_popup(title)
    centre = imgui.get_main_viewport().get_center()
    imgui.set_next_window_pos(centre, imgui.Cond_.appearing, ImVec2(0.5, 0.5))
    flags = imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_saved_settings
    return imgui.begin_popup_modal(title, None, flags)[0]


def _buttons(*labels: str) -> int | None:
    pressed = None
    for number, label in enumerate(labels):
        if number:
            imgui.same_line()
        if imgui.button(label):
            pressed = number
    if imgui.is_key_pressed(imgui.Key.escape):
        pressed = len(labels) - 1
    return pressed
