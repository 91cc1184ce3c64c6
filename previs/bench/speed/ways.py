"""The ways to draw a scene that are compared: by default, without each accelerator, and as a plain renderer would."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...quality import QUALITIES, preset
from ...settings import BY_NAME, Settings
from ..run import Variant

#: Knobs of what makes pictures faster without being asked for, with the value that does without; see `accelerators`.
OFF: Mapping[str, Any] = {
    "skip_empty": False,
    "march_divisor": 1,
    "sparse": "off",
    "cull_lights": False,
}
#: Values of those of them that cost accuracy, and are therefore off where nobody asks for them.
ON: Mapping[str, tuple[Any, ...]] = {"march_divisor": (2, 4)}
#: What other methods attenuate light by, with their numbers of values.
CURVES = (("quantile", 6), ("quantile", 14), ("tfm", 6))
#: Steps of the plain renderer that are tried, of view rays and light rays alike.
LADDER = (16, 24, 32, 48, 64, 96, 128, 192, 256)
#: Names of the ways that tables refer to.
DEFAULT, ALL_OFF, BRUTE_FORCE = "default", "all off", "brute force"


def accelerators() -> dict[str, Any]:
    """The accelerators that there are, with the values that turn them off."""
    return {name: BY_NAME[name].parse(value) for name, value in OFF.items() if name in BY_NAME}


def plain(steps: int) -> dict[str, Any]:
    """The settings of a plain renderer: at each of `steps` steps of a view ray a march of as many to every light.

    Steps are counted across the longest diagonal of a volume; a ray ends where it is opaque.
    """
    return {
        "transmittance": "march",
        "steps": steps,
        "light_steps": steps,
        "projective_steps": False,
        **accelerators(),
    }


def quality_presets() -> dict[str, Mapping[str, Any]]:
    """Values of knobs by the name of a quality."""
    return {name: preset(name) for name in QUALITIES}


def ways(base: Settings) -> list[Variant]:
    """What is compared besides the plain renderer: the default first, maps of curves instead of slices, all
    accelerators off last but one, and light marched exactly instead of taken from maps.

    Args:
        base: the stage's own settings.
    """
    off = accelerators()
    found = [Variant(DEFAULT, {}, "default")]
    for name, values in quality_presets().items():
        # Where the stage asks for nothing else, the highest quality is the default.
        if dict(base.replace(**values)) != dict(base):
            found.append(Variant(name, values, "quality"))
    for name, value in off.items():
        # What the stage has turned off needs no way without it.
        if base[name] != value:
            found.append(Variant(f"without {name}", {name: value}, "without"))
        else:
            for on in ON.get(name, ()):
                found.append(Variant(f"{name} {on}", {name: BY_NAME[name].parse(on)}, "with"))
    if base.transmittance == "slices":
        for method, count in CURVES:
            values = {"transmittance": method, "coefficients": count}
            found.append(Variant(f"{method} {count}", values, "curve"))
    if any(base[name] != value for name, value in off.items()):
        found.append(Variant(ALL_OFF, off, "off"))
    if base.transmittance != "march":
        found.append(Variant("all off, light marched", {**off, "transmittance": "march", "light_steps": 0}, "march"))
    return found
