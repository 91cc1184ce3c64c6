"""The actions of the window by name: menus, keys and buttons all take them from here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


def _always() -> bool:
    return True


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Command:
    """One action.

    Attributes:
        label: what menus and buttons say.
        run: does it.
        shortcut: keys such as "Ctrl+Shift+Z" or "F"; "" for none. Several are separated by spaces.
        enabled: whether it can be done now.
        checked: whether it is a state that is on.
        tooltip: one sentence more than the label.
    """

    label: str
    run: Callable[[], None]
    shortcut: str = ""
    enabled: Callable[[], bool] = _always
    checked: Callable[[], bool] = _never
    tooltip: str = ""
