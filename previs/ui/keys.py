"""Keys: runs the commands whose shortcut is pressed."""

from __future__ import annotations

from collections.abc import Mapping

from imgui_bundle import imgui

from .commands import Command

_MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}
_KEYS = {
    "Space": (imgui.Key.space,),
    "LeftArrow": (imgui.Key.left_arrow,),
    "RightArrow": (imgui.Key.right_arrow,),
    "6": (imgui.Key._6, imgui.Key.keypad6),
    "4": (imgui.Key._4, imgui.Key.keypad4),
}


def chords(shortcut: str) -> list[int]:
    """ImGui key chords of a shortcut such as "Ctrl+Shift+Z Ctrl+Y" or "F".

    Raises:
        KeyError: for a key of another name.
    """
    found = []
    for alternative in shortcut.split():
        *modifiers, key = alternative.split("+")
        keys = _KEYS.get(key) or (imgui.Key.__members__[key.lower()],)
        for code in keys:
            chord = int(code)
            for modifier in modifiers:
                chord |= int(_MODIFIERS[modifier])
            found.append(chord)
    return found


def run_shortcuts(commands: Mapping[str, Command]) -> None:
    """Run what was pressed, unless text is being typed or something is held by the mouse.

    An undo in the middle of a drag would take away what the drag goes on to change.
    """
    if imgui.get_io().want_text_input or (imgui.is_any_item_active() and any(map(imgui.is_mouse_down, range(3)))):
        return
    for command in commands.values():
        for chord in chords(command.shortcut):
            if imgui.shortcut(chord, imgui.InputFlags_.route_global) and command.enabled():
                command.run()
