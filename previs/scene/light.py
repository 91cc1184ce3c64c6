"""Lights: the values of `set_light`, authored on the inputs of UsdLux."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from ..description import Color, LightKind
from ..errors import PrevisError
from ..stage.light import is_light, light_kind
from ..stage.values import as_color, as_float, attribute_value, time_code
from .arguments import checked_color, checked_number, checked_vector, looking
from .attributes import place, remove_property, remove_schema, set_value

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
_PLACE = ("position", "direction")
SHAPING = ("cone_angle", "cone_softness", "focus", "focus_tint")


@dataclass(frozen=True)
class LightValues:
    """The numbers authored on a light, by the names of `Scene.set_light`, schema defaults where there are none.

    Sizes that the kind of light does not have are 0. `visible` is the result with what hides it from above.
    `position` and `direction` (unit length, where the light travels) are the world's.
    """

    kind: LightKind
    intensity: float
    exposure: float
    color: Color
    enable_color_temperature: bool
    color_temperature: float
    normalize: bool
    angle: float
    radius: float
    width: float
    height: float
    length: float
    cone_angle: float
    cone_softness: float
    focus: float
    casts_shadows: bool
    visible: bool
    focus_tint: Color
    treat_as_point: bool
    position: tuple[float, float, float]
    direction: tuple[float, float, float]


#: What an input is where the prim has no schema for it.
_WITHOUT_SCHEMA: dict[str, Any] = {
    "color": (1.0, 1.0, 1.0),
    "color_temperature": 6500.0,
    "cone_angle": 90.0,
    "focus_tint": (0.0, 0.0, 0.0),
    "intensity": 1.0,
    "casts_shadows": True,
}


def require_light(prim: Usd.Prim) -> Usd.Prim:
    """The prim. Raises `PrevisError` when it is not a light of a kind that is modelled."""
    if not is_light(prim):
        raise PrevisError(f"{prim.GetPath()}: is not a light")
    if light_kind(prim) is None:
        raise PrevisError(f"{prim.GetPath()}: {prim.GetTypeName() or 'untyped'} lights are not modelled")
    return prim


def light_values(prim: Usd.Prim, time: float | None) -> LightValues:
    """The authored numbers of a light."""
    code = time_code(time)
    values: dict[str, Any] = {}
    for name, (attribute_name, kind) in LIGHT_ATTRIBUTES.items():
        value = attribute_value(prim, attribute_name, code)
        default = _WITHOUT_SCHEMA.get(name, 0.0)
        if kind == Sdf.ValueTypeNames.Bool:
            values[name] = bool(default if value is None else value)
            continue
        # What is no finite number is shown as the default, see the notes of the description.
        parsed = as_color(value) if kind == Sdf.ValueTypeNames.Color3f else as_float(value)
        values[name] = default if parsed is None else parsed
    visible = UsdGeom.Imageable(prim).ComputeVisibility(code) != UsdGeom.Tokens.invisible
    world = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code), float)
    length = float(np.linalg.norm(world[2, :3]))
    axis = -world[2, :3] / length if math.isfinite(length) and length > 0.0 else np.array([0.0, 0.0, -1.0])
    place_values = {"position": tuple(world[3, :3].tolist()), "direction": tuple(axis.tolist())}
    return LightValues(kind=light_kind(prim), visible=visible, **values, **place_values)


def default_light_values(kind: str) -> LightValues:
    """What a new light of a schema type, such as SphereLight, has."""
    stage = Usd.Stage.CreateInMemory()
    return light_values(stage.DefinePrim("/Light", kind), None)


def light_is_animated(prim: Usd.Prim, name: str) -> bool:
    """Whether a value of a light changes over time. Raises ValueError for an unknown name."""
    if name in _PLACE:
        xform = UsdGeom.Xformable(prim)
        while xform:
            if xform.TransformMightBeTimeVarying():
                return True
            xform = UsdGeom.Xformable(xform.GetPrim().GetParent())
        return False
    if name == "visible":
        attribute = UsdGeom.Imageable(prim).GetVisibilityAttr()
    elif name in LIGHT_ATTRIBUTES:
        attribute = prim.GetAttribute(LIGHT_ATTRIBUTES[name][0])
    else:
        raise _unknown(name)
    return bool(attribute) and attribute.ValueMightBeTimeVarying()


def place_light(prim: Usd.Prim, position: Any, direction: Any) -> None:
    """Move a light to a world position, turn it to shine along a world direction; None keeps what it has."""
    xform = UsdGeom.Xformable(prim)
    world = np.array(xform.ComputeLocalToWorldTransform(time_code(None)), float)
    if direction is not None:
        world = looking(world[3, :3], direction)
    if position is not None:
        world[3, :3] = checked_vector("position", position)
    parent = np.array(xform.ComputeParentToWorldTransform(time_code(None)), float)
    place(xform, world @ np.linalg.inv(parent))


def reset_light(layer: Sdf.Layer, prim: Usd.Prim, authored: Usd.Prim | None, names: tuple[str, ...]) -> None:
    """Remove what a layer of edits says of these values of a light, of all where none is named.

    `authored` is the same prim on a stage without the edits, None where they made it; then the light stays where it
    is. Raises ValueError for an unknown name.
    """
    for name in names:
        if name not in (*LIGHT_ATTRIBUTES, *_PLACE, "visible"):
            raise _unknown(name)
    names = names or (*LIGHT_ATTRIBUTES, *_PLACE, "visible")
    path = prim.GetPath()
    for name in names:
        if name in LIGHT_ATTRIBUTES:
            remove_property(layer, path.AppendProperty(LIGHT_ATTRIBUTES[name][0]))
        elif name == "visible":
            remove_property(layer, path.AppendProperty("visibility"))
    if authored is not None and any(name in names for name in _PLACE):
        _reset_place(layer, prim, authored, [name for name in _PLACE if name not in names])
    spec = layer.GetPrimAtPath(path)
    left = [] if spec is None else list(spec.properties.keys())
    for prefix, schema in (("inputs:shaping:", "ShapingAPI"), ("inputs:shadow:", "ShadowAPI")):
        if authored is not None and not any(name.startswith(prefix) for name in left):
            remove_schema(layer, path, schema)


def _reset_place(layer: Sdf.Layer, prim: Usd.Prim, authored: Usd.Prim, kept: list[str]) -> None:
    own = [UsdGeom.Xformable(p).ComputeLocalToWorldTransform(time_code(None)) for p in (prim, authored)]
    now, before = (np.array(matrix, float) for matrix in own)
    path = prim.GetPath()
    spec = layer.GetPrimAtPath(path)
    for name in [] if spec is None else list(spec.properties.keys()):
        if name.startswith("xformOp"):
            remove_property(layer, path.AppendProperty(name))
    if "position" in kept and not np.allclose(now[3, :3], before[3, :3], rtol=1e-9, atol=0.0):
        place_light(prim, now[3, :3], None)
    elif "direction" in kept and not np.allclose(now[2, :3], before[2, :3], rtol=1e-9, atol=1e-12):
        place_light(prim, None, -now[2, :3])


def _unknown(name: str) -> ValueError:
    known = ", ".join((*LIGHT_ATTRIBUTES, "visible", *_PLACE))
    return ValueError(f"{name} is not a value of a light; there are: {known}")


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
            raise _unknown(name)
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
