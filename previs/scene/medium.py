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
from .attributes import remove_property, remove_schema, set_samples, set_value

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


#: Two ways to say the same: either pair determines the other.
PAIRS = (("extinction", "albedo"), ("scattering", "absorption"))
_PAIRED = (*PAIRS[0], *PAIRS[1])
_MADE = "PrevisMedium"


def author_medium(prim: Usd.Prim, values: Mapping[str, Any], time: float | None, keep: bool = True) -> None:
    """Author checked values on the PrevisVolume shader of a volume, which is made and bound where there is none.

    Extinction and albedo are kept while the other of them is set, and so are scattering and absorption, their
    animation too; without `keep` what is not given of a pair is as PrevisVolume has it.
    Raises `PrevisError` when the shader belongs to a native instance, or another material cannot be replaced.
    """
    shader = _shader_of(prim)
    if shader is None:
        shader = _bind_new_medium(prim)
    elif shader.GetPrim().IsInstanceProxy():
        raise PrevisError(f"{shader.GetPath()}: belongs to a native instance, which cannot be edited on its own")
    samples: dict[str, dict[float, Any]] = {}
    values = dict(values)
    for pair, other in (PAIRS, PAIRS[::-1]):
        if not any(name in values for name in pair):
            continue
        replaces = any(_drives(shader, name) for name in other)
        if not replaces and keep and pair == PAIRS[1]:
            replaces = not any(_drives(shader, name) for name in pair)
        if replaces:
            samples |= _converted(prim, pair, values, time)
            for name in other:
                _unset(shader, name)
    for name, by_time in samples.items():
        set_samples(_attribute(shader, name), {t: _usd_value(name, v) for t, v in by_time.items()})
    for name, value in values.items():
        if name not in samples:
            set_value(_attribute(shader, name), _usd_value(name, value), time)


def medium_at(prim: Usd.Prim, time: float | None) -> Medium:
    """The medium of a volume, as it is read from its material."""
    out = Translation(prim.GetPath())
    return read_medium(prim, bound_material(prim, out), time_code(time), out)


def medium_is_animated(prim: Usd.Prim, name: str) -> bool:
    """Whether a value of the medium changes over time. Raises ValueError for an unknown name."""
    if name not in MEDIUM_NAMES:
        raise ValueError(f"{name} is not a value of a medium; there are: {', '.join(MEDIUM_NAMES)}")
    shader = _shader_of(prim)
    if shader is None:
        return False
    # A value that is not authored follows from the others of the two pairs.
    names = (name,) if name not in _PAIRED or _drives(shader, name) else _PAIRED
    return any(attribute.ValueMightBeTimeVarying() for n in names for attribute in _value_attributes(shader, n))


def reset_medium(layer: Sdf.Layer, prim: Usd.Prim, authored: Usd.Prim | None, names: tuple[str, ...]) -> None:
    """Remove what a layer of edits says of these values of a medium, of all where none is named.

    `authored` is the same prim on a stage without the edits, None where they made it. Of the pairs extinction and
    albedo, scattering and absorption, what is not named keeps its value. Raises ValueError for an unknown name.
    """
    for name in names:
        if name not in MEDIUM_NAMES:
            raise ValueError(f"{name} is not a value of a medium; there are: {', '.join(MEDIUM_NAMES)}")
    shader = _shader_of(prim)
    if shader is not None:
        _reset_inputs(layer, prim, shader, authored, names or MEDIUM_NAMES)
    _unbind_made_medium(layer, prim)


def _reset_inputs(
    layer: Sdf.Layer, prim: Usd.Prim, shader: UsdShade.Shader, authored: Usd.Prim | None, names: tuple[str, ...]
) -> None:
    for name in names:
        if name not in _PAIRED:
            _remove_edits(layer, shader, name)
    paired = [name for name in names if name in _PAIRED]
    edited = [name for name in _PAIRED if _has_edits(layer, shader, name)]
    if not paired or not edited:
        return
    pair = next(p for p in PAIRS if paired[0] in p)
    if set(paired) <= set(pair) and set(edited) <= set(pair):
        for name in paired:
            _remove_edits(layer, shader, name)
        return
    # The edits say it in the other way than the stage, or than is asked for.
    kept = [name for name in pair if name not in paired]
    if not set(paired) <= set(pair) or not kept or _agree(prim, authored, kept[0]):
        for name in _PAIRED:
            _remove_edits(layer, shader, name)
        return
    [name] = paired
    times = _sample_times(authored)
    author_medium(prim, {name: getattr(_authored_medium(authored, None), name)}, None)
    if len(times) > 1:
        stage_has = {t: _usd_value(name, getattr(_authored_medium(authored, t), name)) for t in times}
        set_samples(_attribute(shader, name), stage_has)


def _agree(prim: Usd.Prim, authored: Usd.Prim | None, name: str) -> bool:
    """Whether a value of the medium is at all times what it is without the edits, but for rounding."""
    for time in {None, *_sample_times(prim), *_sample_times(authored)}:
        now, before = getattr(medium_at(prim, time), name), getattr(_authored_medium(authored, time), name)
        if not np.allclose(now, before, rtol=1e-5, atol=1e-7):
            return False
    return True


def _authored_medium(authored: Usd.Prim | None, time: float | None) -> Medium:
    return medium_at(authored, time) if authored else Medium()


def _sample_times(prim: Usd.Prim | None) -> list[float]:
    """The time samples of what determines extinction and albedo."""
    shader = _shader_of(prim) if prim else None
    if shader is None:
        return []
    attributes = [a for name in _PAIRED for a in _value_attributes(shader, name) if a.ValueMightBeTimeVarying()]
    return sorted({t for attribute in attributes for t in attribute.GetTimeSamples()})


def _shader_of(prim: Usd.Prim) -> UsdShade.Shader | None:
    out = Translation(prim.GetPath())
    material = bound_material(prim, out)
    return previs_volume_shader(material, out) if material else None


def _converted(
    prim: Usd.Prim, pair: tuple[str, str], values: dict[str, Any], time: float | None
) -> dict[str, dict[float, Any]]:
    """The animation of a pair that takes the place of the other; what does not change over time goes to `values`."""
    times = _sample_times(prim)
    if not times:
        present = medium_at(prim, time)
        for name in pair:
            values.setdefault(name, getattr(present, name))
        return {}
    if time is not None:
        times = sorted({*times, float(time)})
    media = {t: medium_at(prim, t) for t in times}
    samples = {}
    for name in pair:
        if name not in values:
            samples[name] = {t: getattr(medium, name) for t, medium in media.items()}
        elif time is not None:
            samples[name] = {t: getattr(medium, name) for t, medium in media.items()} | {float(time): values[name]}
    return samples


def _bind_new_medium(prim: Usd.Prim) -> UsdShade.Shader:
    """Make a material with a PrevisVolume shader below the prim and bind it for every purpose."""
    path = prim.GetPath().AppendChild(_MADE)
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
        _unbind_made_medium(prim.GetStage().GetEditTarget().GetLayer(), prim)
        raise PrevisError(f"{prim.GetPath()}: its material {bound.GetPath()} is bound by a prim above it, which wins")
    return shader


def _usd_value(name: str, value: Any) -> Any:
    return Gf.Vec3f(*value) if name in COLORS else value


def _attribute(shader: UsdShade.Shader, name: str) -> Usd.Attribute:
    """The attribute that an edit of a shader's input must set: its own, or that of the interface it is connected to."""
    shader_input = shader.GetInput(name)
    if not shader_input:
        paint = Sdf.ValueTypeNames.Color3f if name in COLORS else Sdf.ValueTypeNames.Float
        return shader.CreateInput(name, Sdf.ValueTypeNames.Token if name == "phase" else paint).GetAttr()
    produced = UsdShade.Utils.GetValueProducingAttributes(shader_input)
    if produced and not UsdShade.Output.IsOutput(produced[0]):
        return produced[0]
    if shader_input.HasConnectedSource():
        source = shader_input.GetConnectedSources()[0]
        interface = source[0].source.GetInput(source[0].sourceName) if source else None
        if interface:
            return interface.GetAttr()
        # Driven by another shader: the edit replaces the connection.
        shader_input.DisconnectSource()
    return shader_input.GetAttr()


def _unset(shader: UsdShade.Shader, name: str) -> None:
    """Make an input valueless: in this layer or, where a weaker one has a value, by blocking it.

    An interface input behind it is left alone, since it may drive other inputs too.
    """
    shader_input = shader.GetInput(name)
    if not shader_input:
        return
    attribute = shader_input.GetAttr()
    if attribute.HasAuthoredConnections():
        shader_input.DisconnectSource()
    attribute.Clear()
    if attribute.HasAuthoredValue():
        attribute.Block()


def _drives(shader: UsdShade.Shader, name: str) -> bool:
    shader_input = shader.GetInput(name)
    return bool(shader_input) and bool(UsdShade.Utils.GetValueProducingAttributes(shader_input))


def _value_attributes(shader: UsdShade.Shader, name: str) -> list[Usd.Attribute]:
    """The attributes that hold an input's value; none where another shader computes it."""
    shader_input = shader.GetInput(name)
    produced = UsdShade.Utils.GetValueProducingAttributes(shader_input) if shader_input else []
    return [attribute for attribute in produced if not UsdShade.Output.IsOutput(attribute)]


def _own_path(shader: UsdShade.Shader, name: str) -> Sdf.Path:
    return shader.GetPath().AppendProperty(f"inputs:{name}")


def _has_edits(layer: Sdf.Layer, shader: UsdShade.Shader, name: str) -> bool:
    paths = {_own_path(shader, name), *(attribute.GetPath() for attribute in _value_attributes(shader, name))}
    return any(layer.GetPropertyAtPath(path) is not None for path in paths)


def _remove_edits(layer: Sdf.Layer, shader: UsdShade.Shader, name: str) -> None:
    """Remove what was authored on an input and on the interface input that holds its value."""
    remove_property(layer, _own_path(shader, name))
    # Without the edit the input may be connected again.
    for attribute in _value_attributes(shader, name):
        remove_property(layer, attribute.GetPath())


def _unbind_made_medium(layer: Sdf.Layer, prim: Usd.Prim) -> None:
    """Remove the material that an edit made for a volume, once none of its values is left."""
    path = prim.GetPath().AppendChild(_MADE)
    shader = layer.GetPrimAtPath(path.AppendChild("Volume"))
    if shader is None or shader.specifier != Sdf.SpecifierDef:
        return
    if any(name.startswith("inputs:") for name in shader.properties.keys()):
        return
    owner = layer.GetPrimAtPath(prim.GetPath())
    for relationship in list(owner.relationships):
        if relationship.name.startswith("material:binding") and path in relationship.targetPathList.GetAppliedItems():
            owner.RemoveProperty(relationship)
    if not any(name.startswith("material:binding") for name in owner.properties.keys()):
        remove_schema(layer, prim.GetPath(), "MaterialBindingAPI")
    del owner.nameChildren[_MADE]
