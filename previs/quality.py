"""Quality presets: values of the knobs that trade error for time, under three names.

Errors are mean relative errors of 640×360 pixels against a converged march, times those of such a picture after every
light has moved, half the processor time of Mesa's software rasteriser on two cores. Of the shipped plume and cloud, and
of the smoke of Arnold's samples, all of it within a fifth of the picture: `draft` is 0.7, 1.5 and 4.8 % off in 59, 61
and 18 ms, `preview` 0.4, 0.8 and 3.8 % in 74, 79 and 27 ms, `final`, which is the defaults of the table of settings,
0.1, 0.4 and 0.9 % in 214, 228 and 97 ms. On the other shipped scenes draft is less than 2 % off and preview less than
1.3 %, but for edges of media that are opaque within a pixel or two, as of the pyroclastic: 10 and 5 %.

The method of transmittance is left as it is: `slices`, `map_size` and `light_steps` are tuned for slices,
`coefficients` and `map_filter` keep maps of curves quick for whoever has chosen those.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from .settings import BY_NAME, Settings

_VALUES: Mapping[str, Mapping[str, Any]] = {
    "draft": {
        "coefficients": 4,
        "steps": 56,
        "march_divisor": 2,
        "light_steps": 64,
        "map_size": 88,
        "slices": 84,
        "map_filter": "nearest",
        "shadow_map_size": 512,
        "opacity_cutoff": 0.03,
    },
    "preview": {
        "coefficients": 6,
        "steps": 64,
        "march_divisor": 2,
        "light_steps": 112,
        "map_size": 128,
        "slices": 112,
        "map_filter": "blend",
        "shadow_map_size": 1024,
        "opacity_cutoff": 0.005,
    },
}

#: The names, from the quickest to the most accurate.
QUALITIES = ("draft", "preview", "final")
#: Names of the knobs that a preset sets; it leaves the others alone.
PRESET_KNOBS = tuple(name for name in BY_NAME if any(name in values for values in _VALUES.values()))


def preset(quality: str) -> dict[str, Any]:
    """Values of all `PRESET_KNOBS` for one of the `QUALITIES`.

    Raises:
        ValueError: for another name.
    """
    if quality not in QUALITIES:
        raise ValueError(f"quality: {quality!r} is not one of {', '.join(QUALITIES)}")
    values = _VALUES.get(quality, {})
    return {name: values.get(name, BY_NAME[name].default) for name in PRESET_KNOBS}


def at_most(settings: Settings, quality: str, names: Collection[str] = PRESET_KNOBS) -> Settings:
    """The settings, with the knobs of the preset that are named wherever the settings ask for more than it does."""
    values = preset(quality)
    return settings.replace(**{name: _cheaper(name, settings[name], values[name]) for name in names})


def _cheaper(name: str, one: Any, other: Any) -> Any:
    """Of two values of a knob the one that takes less time; 0 leaves it to the plan, which takes the most."""
    if name in _BY_COST:
        return min(one, other, key=_BY_COST[name].index)
    if name in _LARGER_IS_CHEAPER:
        return max(one, other)
    return min(one or other, other or one)


_BY_COST = {"map_filter": ("nearest", "stochastic", "blend")}
_LARGER_IS_CHEAPER = ("march_divisor", "opacity_cutoff")
