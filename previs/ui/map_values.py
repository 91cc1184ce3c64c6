"""The switch between maps of 6 and of 14 values, and slices, which have no such number.

Pressing 6 or 14 is a wish for maps: where the method stores no values, it becomes the one whose maps are the best.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..render.method import BEST_MAP, method_of
from ..settings import Settings

if TYPE_CHECKING:
    from ..scene import Scene
    from .app import App

#: Values per texel to switch between: interactive and high quality.
SWITCHED = (6, 14)


def map_values(settings: Settings) -> int:
    """How many values a texel of the settings' maps holds; 0 for a method that stores none."""
    return settings.coefficients if method_of(settings).has_coefficients else 0


def with_map_values(settings: Settings, number: int) -> dict[str, Any]:
    """The knobs to set for maps of so many values."""
    method = {} if method_of(settings).has_coefficients else {"transmittance": BEST_MAP}
    return {**method, "coefficients": number}


def set_map_values(app: App, number: int) -> None:
    """Light media by maps of so many values; one entry of the history."""
    assert app.document is not None
    values = with_map_values(app.document.settings, number)

    def change(scene: Scene) -> None:
        for name, value in values.items():
            scene.set_setting(name, value)

    app.edit("Set map values", change)


def other_map_values(settings: Settings) -> int:
    """The other number to switch to: 6 where there are 14, else 14; coming from another method the one that is set."""
    now = map_values(settings)
    return settings.coefficients if not now else SWITCHED[0] if now == SWITCHED[1] else SWITCHED[1]
