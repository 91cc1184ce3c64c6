"""Media: the values of `set_medium`, authored on the PrevisVolume shader of the material that a volume is bound to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdShade

from ..description import PHASES, Medium
from ..errors import PrevisError
from ..stage.context import Translation
from ..stage.material import PREVIS_VOLUME, bound_material, previs_volume_shader, read_medium
from ..stage.values import time_code
from .arguments import checked_color, checked_number
from .attributes import set_value, unset

COLORS = ("extinction", "albedo", "scattering", "absorption", "emission")
RANGES = {
    "density_scale": (0.0, np.inf),
    "extinction": (0.0, np.inf),
    "albedo": (0.0, 1.0),
    "scattering": (0.0, np.inf),
    "absorption": (0.0, np.inf),
    "anisotropy": (-1.0, 1.0),
    "anisotropy2": (-1.0, 1.0),
    "lobe_mix": (0.0, 1.0),
    "emission": (0.0, np.inf),
    "emission_scale": (0.0, np.inf),
    "temperature_scale": (-np.inf, np.inf),
    "temperature_offset": (-np.inf, np.inf),
}
MEDIUM_NAMES = (*(f.name for f in fields(Medium)), "scattering", "absorption")


def medium_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a medium by name, checked. Raises ValueError for an unknown name or a value out of range."""
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if name not in MEDIUM_NAMES:
            raise ValueError(f"{name} is not a value of a medium; there are: {', '.join(MEDIUM_NAMES)}")
        if name == "phase":
            if value not in PHASES:
                raise ValueError(f"phase must be one of {', '.join(PHASES)}, not {value!r}")
            checked[name] = str(value)
            continue
        checked[name] = checked_color(name, value) if name in COLORS else checked_number(name, value)
        lower, upper = RANGES[name]
        numbers = np.atleast_1d(checked[name])
        if numbers.min() < lower or numbers.max() > upper:
            bounds = f"in [{lower:g}, {upper:g}]" if np.isfinite(upper) else f"at least {lower:g}"
            raise ValueError(f"{name} must be {bounds}, not {value}")
    alternatives = {"scattering", "absorption"} & checked.keys()
    if alternatives and {"extinction", "albedo"} & checked.keys():
        raise ValueError("give either extinction and albedo, or scattering and absorption")
    return checked


def author_medium(prim: Usd.Prim, values: dict[str, Any], time: float | None) -> None:
    """Author checked values on the PrevisVolume shader of a volume, which is made and bound where there is none.

    Raises `PrevisError` when the shader belongs to a native instance, or another material cannot be replaced.
    """
    out = Translation(prim.GetPath())
    material = bound_material(prim, out)
    shader = previs_volume_shader(material, out) if material else None
    if shader is None:
        shader = _bind_new_medium(prim)
    elif shader.GetPrim().IsInstanceProxy():
        raise PrevisError(f"{shader.GetPath()}: belongs to a native instance, which cannot be edited on its own")
    values = dict(values)
    pairs = (("extinction", "albedo"), ("scattering", "absorption"))
    for pair, other in (pairs, pairs[::-1]):
        if any(n in values for n in pair) and any(_drives(shader, n) for n in other):
            # One parametrisation takes the place of the other; what is not set keeps its present value.
            current = read_medium(prim, bound_material(prim, out), time_code(time), out)
            for name in pair:
                values.setdefault(name, getattr(current, name))
            for name in other:
                unset(_producer(shader, name))
    for name, value in values.items():
        attribute = _producer(shader, name)
        if attribute is None:
            kind = (
                Sdf.ValueTypeNames.Token
                if name == "phase"
                else Sdf.ValueTypeNames.Color3f
                if name in COLORS
                else Sdf.ValueTypeNames.Float
            )
            attribute = shader.CreateInput(name, kind).GetAttr()
        set_value(attribute, Gf.Vec3f(*value) if name in COLORS else value, time)


def _bind_new_medium(prim: Usd.Prim) -> UsdShade.Shader:
    """Make a material with a PrevisVolume shader below the prim and bind it for every purpose."""
    path = prim.GetPath().AppendChild("PrevisMedium")
    material = UsdShade.Material.Define(prim.GetStage(), path)
    shader = UsdShade.Shader.Define(prim.GetStage(), path.AppendChild("Volume"))
    shader.CreateIdAttr(PREVIS_VOLUME)
    shader.CreateOutput("out", Sdf.ValueTypeNames.Token)
    material.CreateVolumeOutput().ConnectToSource(shader.ConnectableAPI(), "out")
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(material)
    bound, _ = binding.ComputeBoundMaterial(UsdShade.Tokens.preview)
    if bound.GetPath() != path:
        # A binding for previews only, or one that overrides its descendants, is stronger.
        binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, UsdShade.Tokens.preview)
        bound, _ = binding.ComputeBoundMaterial(UsdShade.Tokens.preview)
    if bound.GetPath() != path:
        raise PrevisError(f"{prim.GetPath()}: its material {bound.GetPath()} is bound by a prim above it, which wins")
    return shader


def _producer(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    """The attribute that an edit of a shader's input must set: its own, or that of the interface it is connected to."""
    shader_input = shader.GetInput(name)
    if not shader_input:
        return None
    produced = UsdShade.Utils.GetValueProducingAttributes(shader_input)
    if produced and not UsdShade.Output.IsOutput(produced[0]):
        return produced[0]
    if shader_input.HasConnectedSource():
        source = shader_input.GetConnectedSources()[0]
        interface = source[0].source.GetInput(source[0].sourceName) if source else None
        if interface:
            return interface.GetAttr()
        # Driven by another shader: the edit replaces the connection.
        shader_input.ClearSources()
    return shader_input.GetAttr()


def _drives(shader: UsdShade.Shader, name: str) -> bool:
    shader_input = shader.GetInput(name)
    return bool(shader_input) and bool(UsdShade.Utils.GetValueProducingAttributes(shader_input))
