"""Asks for files: with the system's own dialog where there is one, else with a browser drawn here.

Nothing waits: the answer comes through the callback, in a later frame; a dialog that is called off calls nothing.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui, portable_file_dialogs

from .files import Listing, listing, nearest_folder, typed_path, with_ending
from .theme import ACCENT, ERROR, WARNING, em, tooltip
from .window import PLATFORM_VARIABLE

#: Programs that draw dialogs for others on Linux; portable_file_dialogs calls one of them.
HELPERS = ("zenity", "kdialog", "matedialog", "qarma")
#: Seconds after which a folder is read again.
_REFRESH = 2.0

Then = Callable[[str], object]


def system_dialogs() -> bool:
    """Whether the system has file dialogs to call.

    Without a helper program portable_file_dialogs answers at once, as if the user had called the dialog off.
    """
    if os.environ.get(PLATFORM_VARIABLE) == "null":
        return False
    if sys.platform in ("darwin", "win32"):
        return True
    return any(shutil.which(name) for name in HELPERS)


@dataclass(frozen=True)
class _Question:
    kind: Literal["open", "save"]
    title: str
    path: str
    endings: tuple[str, ...]
    then: Then


class Dialogs:
    """Opens file dialogs, one at a time. `draw` must be called once in every frame, outside of all windows."""

    def __init__(self) -> None:
        self._question: _Question | None = None
        self._system: portable_file_dialogs.open_file | portable_file_dialogs.save_file | None = None
        self._browser: FileBrowser | None = None

    def open_file(self, title: str, folder: str, endings: tuple[str, ...], then: Then) -> None:
        """Ask for a file that exists. `folder` is where to begin, `endings` such as (".usd", ".vdb")."""
        self._ask(_Question("open", title, folder, endings, then))

    def save_file(self, title: str, path: str, endings: tuple[str, ...], then: Then) -> None:
        """Ask where to save. `path` is proposed; a name without one of the endings is given the first."""
        self._ask(_Question("save", title, path, endings, then))

    def _ask(self, question: _Question) -> None:
        if self._system is not None:
            # The system's dialog cannot be taken back to the front from here; it is still there.
            return
        self._question = question
        self._browser = None
        if not system_dialogs():
            self._browser = FileBrowser(question.kind, question.title, question.path, question.endings)
            return
        patterns = [" ".join(f"*{ending}" for ending in question.endings), "*"]
        filters = ["Files", patterns[0], "All files", patterns[1]]
        if question.kind == "open":
            self._system = portable_file_dialogs.open_file(question.title, question.path, filters)
        else:
            self._system = portable_file_dialogs.save_file(question.title, question.path, filters)

    def draw(self) -> None:
        """Draw the browser if it is open, and hand over an answer that has come."""
        question = self._question
        if question is None:
            return
        if self._system is not None:
            if not self._system.ready(0):
                return
            result = self._system.result()
            self._system = None
            self._answer(question, result[0] if isinstance(result, list) and result else result or "")
        elif self._browser is not None:
            answer = self._browser.draw()
            if answer is not None:
                self._browser = None
                self._answer(question, answer)

    def _answer(self, question: _Question, path: str | list[str]) -> None:
        self._question = None
        if not isinstance(path, str) or not path:
            return
        if question.kind == "save":
            complete = with_ending(path, question.endings)
            if complete != path and os.path.exists(complete):
                # The system has asked about replacing the name without its ending.
                self._question = question
                self._browser = FileBrowser("save", question.title, complete, question.endings, ask=True)
                return
            path = complete
        question.then(path)


class FileBrowser:
    """A modal window with a folder's content. Arrow keys choose, Enter opens, Backspace goes up, Escape calls it off.

    Its ImGui window is named by the title; inside are `##path`, `##name`, `###accept` and `###cancel`, and each
    folder and file by ## and its name. With `ask` it begins with the question whether to replace the file.
    """

    def __init__(
        self, kind: Literal["open", "save"], title: str, path: str, endings: tuple[str, ...], ask: bool = False
    ) -> None:
        self._kind = kind
        self._title = title
        self._endings = endings
        self._all_files = False
        self._name = os.path.basename(path) if kind == "save" else ""
        self._listing = Listing("")
        self._read = 0.0
        self._chosen = -1
        self._replace = ""
        self._problem = ""
        self._scroll = False
        self._opened = False
        self._typed_now = False
        self._go(nearest_folder(os.path.dirname(path) if kind == "save" else path))
        self._replace = path if ask else ""

    def _go(self, folder: str) -> None:
        self._folder = self._typed = os.path.normpath(folder)
        self._chosen, self._replace, self._problem, self._scroll = -1, "", "", True
        self._refresh()

    def _refresh(self) -> None:
        self._listing = listing(self._folder, () if self._all_files else self._endings)
        self._read = time.monotonic()

    def draw(self) -> str | None:
        """The path that was chosen, "" when it was called off, None while it is open."""
        if not self._opened:
            imgui.open_popup(self._title)
            self._opened = True
        centre = imgui.get_main_viewport().get_center()
        imgui.set_next_window_pos(centre, imgui.Cond_.appearing, ImVec2(0.5, 0.5))
        imgui.set_next_window_size(ImVec2(em(42), em(30)), imgui.Cond_.appearing)
        if not imgui.begin_popup_modal(self._title, None, imgui.WindowFlags_.no_saved_settings)[0]:
            # Something closed it from outside.
            return ""
        if time.monotonic() - self._read > _REFRESH:
            self._refresh()
        answer = self._content()
        if answer is not None:
            imgui.close_current_popup()
        imgui.end_popup()
        return answer

    def _content(self) -> str | None:
        self._typed_now = False
        answer = self._places()
        answer = self._entries() if answer is None else answer
        answer = self._answers() if answer is None else answer
        if answer is None and imgui.is_key_pressed(imgui.Key.escape) and not imgui.is_any_item_active():
            if not self._replace:
                return ""
            self._replace = ""
        return answer

    def _places(self) -> str | None:
        """Buttons and the path, which can be typed."""
        if imgui.button(f"{icons_fontawesome.ICON_FA_ARROW_UP}##up"):
            self._go(os.path.dirname(self._folder))
        tooltip("The folder above")
        imgui.same_line()
        if imgui.button(f"{icons_fontawesome.ICON_FA_HOME}##home"):
            self._go(os.path.expanduser("~"))
        tooltip("Your home folder")
        imgui.same_line()
        imgui.set_next_item_width(-1.0)
        entered, self._typed = imgui.input_text("##path", self._typed, imgui.InputTextFlags_.enter_returns_true)
        if not entered:
            return None
        self._typed_now = True
        path = typed_path(self._typed, self._folder)
        if os.path.isdir(path):
            self._go(path)
            return None
        if self._kind == "open" and os.path.exists(path):
            return path
        if self._kind == "save" and os.path.isdir(os.path.dirname(path)):
            self._go(os.path.dirname(path))
            self._name = os.path.basename(path)
            return self._accept()
        self._problem = f"There is no {path}"
        return None

    def _entries(self) -> str | None:
        answer = None
        reserve = imgui.get_frame_height_with_spacing() * 2.0 + (em(1.6) if self._replace or self._problem else 0.0)
        window = imgui.internal.get_current_window().id_
        if imgui.begin_child("entries", ImVec2(0.0, -reserve), imgui.ChildFlags_.frame_style):
            # Identifiers as if there were no child window, whose own name is made up by ImGui.
            imgui.internal.push_override_id(window)
            names = [*self._listing.folders, *self._listing.files]
            self._keys(names)
            if self._listing.error:
                imgui.text_colored(ImVec4(*ERROR), self._listing.error)
            elif not names:
                imgui.text_disabled("Nothing here that fits" if not self._all_files else "Empty")
            if self._scroll:
                imgui.set_scroll_y(0.0)
                self._scroll = False
            clipper = imgui.ListClipper()
            clipper.begin(len(names))
            while clipper.step():
                for i in range(clipper.display_start, clipper.display_end):
                    opened = self._entry(i, names[i])
                    answer = opened if opened is not None else answer
            imgui.pop_id()
        imgui.end_child()
        return answer

    def _entry(self, i: int, name: str) -> str | None:
        folder = i < len(self._listing.folders)
        icon = icons_fontawesome.ICON_FA_FOLDER if folder else icons_fontawesome.ICON_FA_FILE
        color = ACCENT if folder else (0.7, 0.7, 0.7, 1.0)
        flags = imgui.SelectableFlags_.allow_double_click | imgui.SelectableFlags_.no_auto_close_popups
        start = imgui.get_cursor_pos_x()
        clicked, _ = imgui.selectable(f"##{name}", i == self._chosen, int(flags))
        imgui.same_line(start)
        imgui.text_colored(ImVec4(*color), icon)
        imgui.same_line(start + em(1.7))
        imgui.text_unformatted(name)
        if not clicked:
            return None
        self._choose(i)
        return self._enter() if imgui.is_mouse_double_clicked(0) else None

    def _choose(self, i: int) -> None:
        self._chosen, self._replace, self._problem = i, "", ""
        if i >= len(self._listing.folders):
            self._name = self._listing.files[i - len(self._listing.folders)]

    def _keys(self, names: list[str]) -> None:
        """Arrow keys move the choice, unless text is typed."""
        if imgui.is_any_item_active() or not names:
            return
        for key, step in ((imgui.Key.down_arrow, 1), (imgui.Key.up_arrow, -1)):
            if imgui.is_key_pressed(key):
                self._choose(min(max(self._chosen + step, 0), len(names) - 1))
        if imgui.is_key_pressed(imgui.Key.backspace):
            self._go(os.path.dirname(self._folder))

    def _enter(self) -> str | None:
        """Open the chosen folder or take the chosen file."""
        if 0 <= self._chosen < len(self._listing.folders):
            self._go(os.path.join(self._folder, self._listing.folders[self._chosen]))
            return None
        return self._accept()

    def _accept(self) -> str | None:
        """The path of the name, when it will do."""
        if not self._name.strip():
            self._problem = "Choose a file" if self._kind == "open" else "Give the file a name"
            return None
        path = typed_path(self._name, self._folder)
        if os.path.isdir(path):
            self._go(path)
            return None
        if self._kind == "open":
            if os.path.exists(path):
                return path
            self._problem = f"There is no {os.path.basename(path)} here"
            return None
        path = with_ending(path, self._endings)
        if not os.path.isdir(os.path.dirname(path)):
            self._problem = f"There is no folder {os.path.dirname(path)}"
            return None
        if os.path.exists(path) and self._replace != path:
            self._replace = path
            return None
        return path

    def _answers(self) -> str | None:
        if self._problem:
            imgui.text_colored(ImVec4(*ERROR), self._problem)
        elif self._replace:
            text = f"{os.path.basename(self._replace)} is there already. Replace it?"
            imgui.text_colored(ImVec4(*WARNING), text)
        answer = None
        choice = em(15)
        imgui.align_text_to_frame_padding()
        imgui.text_unformatted("Name")
        imgui.same_line()
        imgui.set_next_item_width(-choice - em(0.5))
        if self._kind == "save" and imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        entered, name = imgui.input_text("##name", self._name, imgui.InputTextFlags_.enter_returns_true)
        if name != self._name:
            self._name, self._replace, self._problem = name, "", ""
        if entered:
            answer = self._accept()
        imgui.same_line()
        endings = " ".join(self._endings)
        imgui.set_next_item_width(-1.0)
        if imgui.begin_combo("##endings", "All files" if self._all_files else endings):
            for label, everything in ((endings, False), ("All files", True)):
                if imgui.selectable(label, everything == self._all_files)[0]:
                    self._all_files = everything
                    self._chosen = -1
                    self._refresh()
            imgui.end_combo()
        width = em(7)
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x - 2 * width - em(0.5))
        if imgui.button("Cancel###cancel", ImVec2(width, 0.0)):
            return ""
        imgui.same_line(0.0, em(0.5))
        label = "Open" if self._kind == "open" else "Replace" if self._replace else "Save"
        imgui.push_style_color(imgui.Col_.button, ImVec4(*(0.6 * c for c in ACCENT[:3]), 1.0))
        pressed = imgui.button(f"{label}###accept", ImVec2(width, 0.0))
        imgui.pop_style_color()
        key = imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter)
        typed = entered or self._typed_now or imgui.is_any_item_active()
        if pressed or (key and answer is None and not typed):
            answer = self._enter() if key and not pressed else self._accept_or_enter()
        return answer

    def _accept_or_enter(self) -> str | None:
        chosen_folder = 0 <= self._chosen < len(self._listing.folders)
        return self._enter() if chosen_folder and self._kind == "open" else self._accept()
