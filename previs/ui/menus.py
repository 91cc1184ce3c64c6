"""The menu bar, drawn from the commands."""

from __future__ import annotations

import os
from collections.abc import Callable

from imgui_bundle import hello_imgui, imgui

from .app import App
from .theme import tooltip

#: Menus and their commands in order; "" is a line between, "recent" the list of files opened before.
MENUS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "File",
        (
            *("open", "recent", "reload", ""),
            *("save_overrides", "load_overrides", "discard", ""),
            *("export_image", "", "quit"),
        ),
    ),
    ("Edit", ("undo", "redo", "", "add_sun")),
    (
        "Camera",
        (
            *("frame_selection", "frame_all", ""),
            *("free_camera", "cameras", "copy_camera", ""),
            *("gate_mask", "", "auto_exposure"),
        ),
    ),
    (
        "Render",
        (
            "slices",
            "six",
            "fourteen",
            "",
            "toggle_wipe",
            "toggle_error",
            "",
            "inspect",
            "solo",
            "",
            "measure_error",
            "converge",
        ),
    ),
    ("Time", ("play", "next_frame", "previous_frame")),
)


def draw_menus(app: App, leave: Callable[[Callable[[], None]], None]) -> None:
    """Draw the menus into the open menu bar.

    Args:
        app: whose commands are listed.
        leave: calls the function it is given once unsaved edits were saved or given up.
    """
    for title, names in MENUS:
        if not imgui.begin_menu(title):
            continue
        _close_on_escape()
        for name in names:
            if name == "":
                imgui.separator()
            elif name == "recent":
                _recent(app, leave)
            elif name == "cameras":
                _cameras(app)
            else:
                _command(app, name)
        imgui.end_menu()
    if imgui.begin_menu("Window"):
        _close_on_escape()
        _windows()
        imgui.end_menu()


def _close_on_escape() -> None:
    if imgui.is_key_pressed(imgui.Key.escape):
        imgui.close_current_popup()


def _windows() -> None:
    """The panels, to close and to open again."""
    docking = hello_imgui.get_runner_params().docking_params
    for name in (window.label for window in docking.dockable_windows if window.can_be_closed):
        window = docking.dockable_window_of_name(name)
        if imgui.menu_item(f"{name}###window_{name}", "", window.is_visible, True)[0]:
            window.is_visible = not window.is_visible
    imgui.separator()
    if imgui.menu_item("Restore the layout###restore_layout", "", False, True)[0]:
        docking.layout_reset = True
        for name in (window.label for window in docking.dockable_windows):
            docking.dockable_window_of_name(name).is_visible = True
    tooltip("Puts all panels back where they were at first")


def _command(app: App, name: str) -> None:
    command = app.commands.get(name)
    if command is None:
        return
    keys = command.shortcut.split(" ")[0].replace("Arrow", "")
    label = command.label
    if name == "undo" and app.document is not None and app.document.undo_label:
        label = f"Undo {_lower(app.document.undo_label)}"
    elif name == "redo" and app.document is not None and app.document.redo_label:
        label = f"Redo {_lower(app.document.redo_label)}"
    if imgui.menu_item(f"{label}###{name}", keys, command.checked(), command.enabled())[0]:
        command.run()
    if command.tooltip:
        tooltip(command.tooltip)


def _lower(label: str) -> str:
    return label[:1].lower() + label[1:]


def _recent(app: App, leave: Callable[[Callable[[], None]], None]) -> None:
    """Files opened before."""
    recent = list(app.preferences.recent)
    if not imgui.begin_menu("Open recent###open_recent", bool(recent)):
        return
    for path in recent:
        if imgui.menu_item(f"{os.path.basename(path)}###{path}", "", False, True)[0]:
            leave(lambda path=path: app.open(path))
        tooltip(path)
    imgui.end_menu()


def _cameras(app: App) -> None:
    if app.document is None:
        return
    for path in app.document.description.cameras:
        if imgui.menu_item(f"{path}###{path}", "", app.view.camera_path == path, True)[0]:
            app.look_through(path)
