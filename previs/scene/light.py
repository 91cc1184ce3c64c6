"""Lights: the values of `set_light`, authored on the inputs of UsdLux."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from .arguments import checked_color, checked_number
from .attributes import place, set_value

LIGHT_ATTRIBUTES: dict[str, tuple[str, Sdf.ValueTypeName]] = {
    "intensity": ("inputs:intensity", Sdf.ValueTypeNames.Float),
    "exposure": ("inputs:exposure", Sdf.ValueTypeNames.Float),
    "color": ("inputs:color", Sdf.ValueTypeNames.Color3f),
    "color_temperature": ("inputs:colorTemperature", Sdf.ValueTypeNames.Float),
    "enable_color_temperature": ("inputs:enableColorTemperature", Sdf.ValueTypeNames.Bool),
    "normalize": ("inputs:normalize", Sdf.ValueTypeNames.Bool),
    "angle": ("inputs:angle", Sdf.ValueTypeNames.Float),
    "radius": ("inputs:radius", Sdf.ValueTypeNames.Float),
    "width": ("inputs:width", Sdf.ValueTypeNames.Float),
    "height": ("inputs:height", Sdf.ValueTypeNames.Float),
    "length": ("inputs:length", Sdf.ValueTypeNames.Float),
    "treat_as_point": ("treatAsPoint", Sdf.ValueTypeNames.Bool),
    "cone_angle": ("inputs:shaping:cone:angle", Sdf.ValueTypeNames.Float),
    "cone_softness": ("inputs:shaping:cone:softness", Sdf.ValueTypeNames.Float),
    "focus": ("inputs:shaping:focus", Sdf.ValueTypeNames.Float),
    "focus_tint": ("inputs:shaping:focusTint", Sdf.ValueTypeNames.Color3f),
    "casts_shadows": ("inputs:shadow:enable", Sdf.ValueTypeNames.Bool),
}
SHAPING = ("cone_angle", "cone_softness", "focus", "focus_tint")


def light_value(name: str, value: Any) -> Any:
    """A value as USD takes it. Raises ValueError when it is out of range."""
    kind = LIGHT_ATTRIBUTES[name][1]
    if kind == Sdf.ValueTypeNames.Bool:
        return bool(value)
    if kind == Sdf.ValueTypeNames.Color3f:
        return Gf.Vec3f(*checked_color(name, value))
    number = checked_number(name, value)
    if number < 0.0 and name != "exposure":
        raise ValueError(f"{name} must be at least 0, not {value}")
    if name == "cone_softness" and number > 1.0:
        raise ValueError(f"{name} must be in [0, 1], not {value}")
    return number


def brightness(name: str, strength: float | None, default: float, intensity: float | None) -> dict[str, Any]:
    """The USD inputs for a light given by its strength (normalised) or by its surface's radiance."""
    if strength is not None and intensity is not None:
        raise ValueError(f"give either {name} or intensity")
    if intensity is not None:
        return {"intensity": intensity}
    return {"intensity": default if strength is None else strength, "normalize": True}


def author_light(prim: Usd.Prim, values: Mapping[str, Any], time: float | None) -> None:
    """Author values on a light, with the schemas they belong to. Raises ValueError for an unknown or bad one."""
    checked = {}
    for name, value in values.items():
        if name not in LIGHT_ATTRIBUTES:
            known = ", ".join((*LIGHT_ATTRIBUTES, "visible", "position", "direction"))
            raise ValueError(f"{name} is not a value of a light; there are: {known}")
        checked[name] = light_value(name, value)
    if "color_temperature" in checked:
        checked.setdefault("enable_color_temperature", True)
    if any(name in checked for name in SHAPING) and not prim.HasAPI(UsdLux.ShapingAPI):
        UsdLux.ShapingAPI.Apply(prim)
    if "casts_shadows" in checked and not prim.HasAPI(UsdLux.ShadowAPI):
        UsdLux.ShadowAPI.Apply(prim)
    for name, value in checked.items():
        attribute_name, kind = LIGHT_ATTRIBUTES[name]
        attribute = prim.GetAttribute(attribute_name) or prim.CreateAttribute(attribute_name, kind, False)
        set_value(attribute, value, time)


def finish_light(light: UsdGeom.Xformable, casts_shadows: bool, matrix: np.ndarray) -> str:
    """Author what all new lights have; returns the path."""
    if not casts_shadows:
        author_light(light.GetPrim(), {"casts_shadows": False}, None)
    place(light, matrix)
    return str(light.GetPath())
