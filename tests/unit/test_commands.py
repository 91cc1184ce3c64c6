"""The actions of the window: what their shortcuts mean, and that none of them is taken twice."""

from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest

imgui = pytest.importorskip("imgui_bundle", exc_type=ImportError).imgui

from previs.ui import keys  # noqa: E402
from previs.ui.actions import make_commands  # noqa: E402
from previs.ui.commands import Command  # noqa: E402
from previs.ui.keys import chords  # noqa: E402


class Anything:
    """Stands in for what the commands act on: nothing of it is used until one is run."""

    def __getattr__(self, name: str) -> Any:
        if name == "document":
            return None
        return lambda *_: None


@pytest.fixture
def commands() -> dict[str, Command]:
    return make_commands(Anything(), Anything(), lambda then: then(), lambda: None)


def test_a_shortcut_is_a_chord_of_keys() -> None:
    assert chords("F") == [int(imgui.Key.f)]
    assert chords("Ctrl+S") == [int(imgui.Key.mod_ctrl) | int(imgui.Key.s)]
    assert chords("Ctrl+Shift+Z Ctrl+Y") == [
        int(imgui.Key.mod_ctrl) | int(imgui.Key.mod_shift) | int(imgui.Key.z),
        int(imgui.Key.mod_ctrl) | int(imgui.Key.y),
    ]
    assert chords("") == []


def test_digits_are_on_the_keypad_too() -> None:
    assert set(chords("6")) == {int(imgui.Key._6), int(imgui.Key.keypad6)}


@pytest.mark.parametrize("shortcut", ["Hyper+S", "Ctrl+Nothing", "Ctrl+"])
def test_a_shortcut_that_is_none(shortcut: str) -> None:
    with pytest.raises((KeyError, AttributeError)):
        chords(shortcut)


def test_no_shortcut_is_taken_twice(commands: dict[str, Command]) -> None:
    taken = Counter(chord for command in commands.values() for chord in chords(command.shortcut))
    assert not [chord for chord, count in taken.items() if count > 1]


def test_every_command_says_what_it_does(commands: dict[str, Command]) -> None:
    for name, command in commands.items():
        assert command.label, name
        assert command.tooltip != command.label, name
        assert not command.tooltip.endswith("."), name
    labels = Counter(command.label for command in commands.values())
    assert max(labels.values()) == 1


def test_without_a_document_nothing_of_it_can_be_done(commands: dict[str, Command]) -> None:
    assert {name for name, command in commands.items() if command.enabled()} == {"open", "quit"}


def pressing(monkeypatch: pytest.MonkeyPatch, *pressed: str, typing: bool = False) -> None:
    """Let ImGui see these shortcuts pressed."""
    held = {chord for shortcut in pressed for chord in chords(shortcut)}
    stand_in = SimpleNamespace(
        get_io=lambda: SimpleNamespace(want_text_input=typing),
        shortcut=lambda chord, _flags: chord in held,
        is_any_item_active=lambda: False,
        InputFlags_=imgui.InputFlags_,
        Key=imgui.Key,
    )
    monkeypatch.setattr(keys, "imgui", stand_in)


def test_what_is_pressed_is_run(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []
    commands = {
        name: Command(name, lambda name=name: ran.append(name), shortcut, lambda name=name: name != "off")
        for name, shortcut in (("f", "F"), ("redo", "Ctrl+Shift+Z Ctrl+Y"), ("off", "A"), ("none", ""))
    }
    pressing(monkeypatch, "Ctrl+Y", "A")
    keys.run_shortcuts(commands)
    assert ran == ["redo"]
    pressing(monkeypatch, "F")
    keys.run_shortcuts(commands)
    assert ran == ["redo", "f"]


def test_while_text_is_typed_letters_are_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []
    pressing(monkeypatch, "F", typing=True)
    keys.run_shortcuts({"f": Command("f", lambda: ran.append("f"), "F")})
    assert ran == []
