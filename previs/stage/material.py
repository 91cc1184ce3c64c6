"""Bound materials: the medium of a volume, and the constants of a surface.

USD has no portable volume shader. Ours is `PrevisVolume`, whose inputs are the attributes of
`previs.description.Medium`; other shaders are recognised by their identifiers and reported.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from ..description import ANISOTROPY_LIMIT, PHASES, Color, Medium, Surface
from .context import Translation
from .values import as_color, as_float

PREVIS_VOLUME = "PrevisVolume"
_FOREIGN_VOLUMES = {
    "arnold:standard_volume": "Arnold's standard_volume",
    "standard_volume": "Arnold's standard_volume",
    "PxrVolume": "RenderMan's PxrVolume",
    "kma_volume": "Karma's kma_volume",
    "karma:kma_volume": "Karma's kma_volume",
}
_MEDIUM_COLORS = ("extinction", "albedo", "scattering", "absorption", "emission")
_MEDIUM_INPUTS = (*(f.name for f in fields(Medium)), "scattering", "absorption")
_MID_GREY: Color = (0.18, 0.18, 0.18)


def bound_material(prim: Usd.Prim, out: Translation) -> UsdShade.Material | None:
    """The material a previewer shows: bound for preview or for all purposes, else the one bound for full renders."""
    binding = UsdShade.MaterialBindingAPI(prim)
    for purpose in (UsdShade.Tokens.preview, UsdShade.Tokens.full):
        material, _ = binding.ComputeBoundMaterial(purpose)
        if material:
            out.depend(material.GetPrim())
            return material
    owner = prim
    while owner and not owner.IsPseudoRoot():
        rel = owner.GetRelationship("material:binding")
        targets = rel.GetForwardedTargets() if rel else []
        if targets:
            out.note("missing", prim, f"its material {targets[0]} does not exist")
            break
        owner = owner.GetParent()
    return None


def is_volume_only(material: UsdShade.Material) -> bool:
    """Whether a material has a connected volume output and no connected surface output.

    A volume output that is connected to nothing that exists counts where there is no surface output of that kind.
    """
    surfaces, volumes = material.GetSurfaceOutputs(), material.GetVolumeOutputs()
    if any(output.HasConnectedSource() for output in surfaces):
        return False
    if any(output.HasConnectedSource() for output in volumes):
        return True
    meant = [any(o.GetAttr().HasAuthoredConnections() for o in outputs) for outputs in (volumes, surfaces)]
    return meant == [True, False]


def read_medium(prim: Usd.Prim, material: UsdShade.Material | None, time: Usd.TimeCode, out: Translation) -> Medium:
    """The medium of a material's volume output; PrevisVolume's defaults when nothing is bound."""
    if material is None:
        return Medium()
    shaders = _volume_shaders(material, out)
    previs_shader = previs_volume_shader(material, out)
    dangling = _note_dangling_volumes(material, bool(shaders), out)
    if previs_shader is not None:
        return _read_previs_volume(previs_shader, time, out)
    if dangling and not shaders:
        return Medium()
    if not shaders:
        out.note("approximated", material.GetPrim(), "has no volume shader; PrevisVolume's defaults stand in for it")
        return Medium()
    shader = shaders[0]
    out.note("approximated", material.GetPrim(), f"{_shader_label(shader)} is read as PrevisVolume's defaults")
    return Medium()


def previs_volume_shader(material: UsdShade.Material, out: Translation) -> UsdShade.Shader | None:
    """The PrevisVolume shader behind one of a material's volume outputs."""
    return next((s for s in _volume_shaders(material, out) if s.GetShaderId() == PREVIS_VOLUME), None)


def _volume_shaders(material: UsdShade.Material, out: Translation) -> list[UsdShade.Shader]:
    """The shaders behind the volume outputs, the universal output first, then those of render contexts."""
    shaders = []
    for output in sorted(material.GetVolumeOutputs(), key=lambda o: o.GetFullName() != "outputs:volume"):
        for attribute in UsdShade.Utils.GetValueProducingAttributes(output, True):
            shader = UsdShade.Shader(attribute.GetPrim())
            if shader:
                out.depend(shader.GetPrim())
                shaders.append(shader)
    return shaders


def _note_dangling_volumes(material: UsdShade.Material, has_shader: bool, out: Translation) -> bool:
    """Report the volume outputs that are connected to nothing that exists, and what stands in for them."""
    stand_in = "another volume output stands in" if has_shader else "PrevisVolume's defaults stand in"
    found = False
    for output in material.GetVolumeOutputs():
        for _, sentence in _dangling_connections(output.GetAttr(), out):
            out.note("missing", material.GetPrim(), f"{sentence}; {stand_in} for it")
            found = True
    return found


def _dangling_connections(attribute: Usd.Attribute, out: Translation) -> list[tuple[Usd.Attribute, str]]:
    """The connections from an input or output, directly or through others, to what is no input or output.

    Each is the attribute that is so connected, and the sentence that says it.
    """
    stage = attribute.GetStage()
    found, pending, seen = [], [attribute], {attribute.GetPath()}
    while pending:
        holder = pending.pop()
        subject = holder.GetName() if holder == attribute else f"<{holder.GetPath()}>"
        for path in holder.GetConnections():
            flaw = _flaw(stage, path)
            if flaw:
                found.append((holder, f"{subject} is connected to <{path}>, {flaw}"))
                # What is missing may be made by the next time; whether it varies is not asked of a prim that is not.
                out.dependencies.add(path.GetPrimPath())
                out.varying = True
            elif path not in seen:
                seen.add(path)
                pending.append(stage.GetAttributeAtPath(path))
    return found


def _flaw(stage: Usd.Stage, path: Sdf.Path) -> str:
    """Why nothing can be connected to that path; empty where it is an input or output."""
    if path.IsPrimPath() and stage.GetPrimAtPath(path):
        return "which is a prim and not one of its outputs"
    attribute = stage.GetAttributeAtPath(path) if path.IsPropertyPath() else None
    if not attribute:
        return "which does not exist"
    shading = UsdShade.Input.IsInput(attribute) or UsdShade.Output.IsOutput(attribute)
    return "" if shading else "which is neither an input nor an output"


def _shader_label(shader: UsdShade.Shader) -> str:
    identifier = shader.GetShaderId()
    if identifier:
        if identifier.startswith("ND_"):
            return f"the MaterialX volume {identifier}"
        if identifier in _FOREIGN_VOLUMES:
            return _FOREIGN_VOLUMES[identifier]
        return f"the unknown shader {identifier}"
    source_type = next(iter(_source_types(shader)), "")
    return f"a {source_type} shader from a source file" if source_type else "a shader without an identifier"


def _source_types(shader: UsdShade.Shader) -> list[str]:
    """The source types (glslfx, mdl, osl, …) of a shader that is given as a source file."""
    names = (a.GetName().split(":") for a in shader.GetPrim().GetAuthoredAttributes())
    return [n[1] if len(n) == 3 else "" for n in names if n[0] == "info" and n[-1] == "sourceAsset"]


def _input_source(
    shader: UsdShade.Shader, name: str, out: Translation
) -> tuple[Usd.Attribute | None, UsdShade.Shader | None]:
    """What drives an input: an attribute with a value (its own or an interface input's), or a shader.

    A connection to nothing is reported.
    """
    shader_input = shader.GetInput(name)
    if not shader_input:
        return None, None
    producers = UsdShade.Utils.GetValueProducingAttributes(shader_input)
    for holder, sentence in _dangling_connections(shader_input.GetAttr(), out):
        used = "the value authored beside the connection" if holder in producers else "the default"
        out.note("missing", shader.GetPrim(), f"{sentence}; {used} is used")
    for attribute in producers:
        out.depend(attribute.GetPrim())
        if UsdShade.Output.IsOutput(attribute):
            return None, UsdShade.Shader(attribute.GetPrim())
        return attribute, None
    return None, None


def _read_previs_volume(shader: UsdShade.Shader, time: Usd.TimeCode, out: Translation) -> Medium:
    prim = shader.GetPrim()
    values: dict[str, Any] = {}
    for attribute in prim.GetAuthoredAttributes():
        if attribute.GetName() in _MEDIUM_INPUTS:
            name = attribute.GetName()
            out.note("ignored", prim, f"attribute {name} is not read; write inputs:{name}")
    for shader_input in shader.GetInputs():
        name = shader_input.GetBaseName()
        if name not in _MEDIUM_INPUTS:
            known = ", ".join(_MEDIUM_INPUTS)
            out.note("ignored", prim, f"inputs:{name} is not an input of PrevisVolume; known are {known}")
            continue
        attribute, source = _input_source(shader, name, out)
        if source is not None:
            identifier = source.GetShaderId() or "a shader"
            out.note("approximated", prim, f"inputs:{name} is driven by {identifier}; its default stands in for it")
        value = attribute.Get(time) if attribute else None
        if value is None:
            continue
        if name == "phase":
            values[name] = str(value)
            continue
        parsed = as_color(value) if name in _MEDIUM_COLORS else as_float(value)
        if parsed is None:
            out.note("repaired", prim, f"inputs:{name} = {value} is no finite value; the default is used")
        else:
            values[name] = parsed
    return _legal_medium(values, prim, out)


def _legal_medium(values: dict[str, Any], prim: Usd.Prim, out: Translation) -> Medium:
    """A medium from authored inputs, every value brought into its legal range, which is reported."""

    def clamp_color(name: str, upper: float | None = None) -> None:
        if name not in values:
            return
        legal = tuple(min(max(c, 0.0), upper) if upper is not None else max(c, 0.0) for c in values[name])
        if legal != values[name]:
            bounds = f"[0, {upper:g}]" if upper is not None else "zero or more"
            out.note("repaired", prim, f"inputs:{name} is clamped to {bounds}")
            values[name] = legal

    def clamp(name: str, lower: float, upper: float) -> None:
        if name in values and not lower <= values[name] <= upper:
            out.note("repaired", prim, f"inputs:{name} = {values[name]:g} is clamped to [{lower:g}, {upper:g}]")
            values[name] = min(max(values[name], lower), upper)

    for name in ("extinction", "scattering", "absorption", "emission"):
        clamp_color(name)
    clamp_color("albedo", 1.0)
    for name in ("density_scale", "emission_scale"):
        clamp(name, 0.0, float("inf"))
    for name in ("anisotropy", "anisotropy2"):
        clamp(name, -ANISOTROPY_LIMIT, ANISOTROPY_LIMIT)
    clamp("lobe_mix", 0.0, 1.0)
    if values.get("phase", "hg") not in PHASES:
        out.note(
            "repaired",
            prim,
            f"inputs:phase = {values['phase']} is not a phase function ({', '.join(PHASES)}); hg is used",
        )
        del values["phase"]
    scattering, absorption = values.pop("scattering", None), values.pop("absorption", None)
    if scattering is not None or absorption is not None:
        if "extinction" in values or "albedo" in values:
            out.note("ignored", prim, "inputs:scattering and inputs:absorption take the place of extinction and albedo")
        values["extinction"], values["albedo"] = extinction_and_albedo(
            scattering or (0.0, 0.0, 0.0), absorption or (0.0, 0.0, 0.0)
        )
    return replace(Medium(), **values)


def extinction_and_albedo(scattering: Color, absorption: Color) -> tuple[Color, Color]:
    """(σt, ρ) from (σs, σa), per channel; the albedo is 0 where there is no extinction.

    The extinction is a number that a color3f can hold, so that authoring it instead changes nothing.
    """
    extinction = tuple(float(np.float32(s + a)) for s, a in zip(scattering, absorption, strict=True))
    albedo = tuple(s / t if t > 0.0 else 0.0 for s, t in zip(scattering, extinction, strict=True))
    return extinction, albedo


def display_color(prim: Usd.Prim, time: Usd.TimeCode) -> Color | None:
    """The constant displayColor of a gprim, its own or inherited; None when there is none or it is not constant."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    if not primvar or not primvar.HasValue():
        return None
    values = primvar.ComputeFlattened(time)
    if values is None or len(values) == 0:
        return None
    constant = primvar.GetInterpolation() == UsdGeom.Tokens.constant or len(values) == 1
    return as_color(values[0]) if constant else None


def read_surface(
    prim: Usd.Prim, material: UsdShade.Material | None, time: Usd.TimeCode, out: Translation
) -> tuple[Surface | None, bool]:
    """(surface, whether the geometry's colours apply). The surface is None for one that is wholly transparent."""
    display = display_color(prim, time)
    varying = display is None and bool(UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor").HasValue())
    plain = Surface(diffuse_color=(1.0, 1.0, 1.0) if varying else display or _MID_GREY), varying
    if UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayOpacity").HasAuthoredValue():
        out.note("approximated", prim, "displayOpacity is ignored: shown opaque")
    if material is None:
        return plain
    shader = _surface_shader(material, out)
    if shader is None:
        out.note("approximated", material.GetPrim(), "has no surface shader; displayColor stands in for it")
        return plain
    if shader.GetShaderId() != "UsdPreviewSurface":
        out.note("approximated", material.GetPrim(), f"{_shader_label(shader)} is shown by displayColor, or grey 0.18")
        return plain
    return _read_preview_surface(prim, shader, time, out, plain)


def _surface_shader(material: UsdShade.Material, out: Translation) -> UsdShade.Shader | None:
    found = []
    for output in sorted(material.GetSurfaceOutputs(), key=lambda o: o.GetFullName() != "outputs:surface"):
        for attribute in UsdShade.Utils.GetValueProducingAttributes(output, True):
            shader = UsdShade.Shader(attribute.GetPrim())
            if shader:
                out.depend(shader.GetPrim())
                found.append(shader)
    preview = [s for s in found if s.GetShaderId() == "UsdPreviewSurface"]
    return (preview or found or [None])[0]


def _read_preview_surface(
    prim: Usd.Prim,
    shader: UsdShade.Shader,
    time: Usd.TimeCode,
    out: Translation,
    plain: tuple[Surface, bool],
) -> tuple[Surface | None, bool]:
    owner = shader.GetPrim()

    def value(name: str, default: Any, stand_in: Any = None) -> Any:
        attribute, source = _input_source(shader, name, out)
        if source is not None:
            fallback = _texture_fallback(source, time)
            found = fallback if fallback is not None else (default if stand_in is None else stand_in)
            out.note(
                "approximated",
                owner,
                f"inputs:{name} is driven by {source.GetShaderId() or 'a shader'}; a constant stands in for it",
            )
        else:
            found = attribute.Get(time) if attribute else None
        parse = as_color if isinstance(default, tuple) else as_float
        parsed = parse(found) if found is not None else default
        if parsed is None:
            out.note("repaired", owner, f"inputs:{name} = {found} is no finite value; the default is used")
            return default
        return parsed

    opacity = value("opacity", 1.0)
    threshold = value("opacityThreshold", 0.0)
    if opacity <= 0.0 or (threshold > 0.0 and opacity < threshold):
        out.note("ignored", prim, "is wholly transparent and left out")
        return None, False
    if opacity < 1.0 and threshold <= 0.0:
        out.note("approximated", owner, f"opacity {opacity:g} is shown opaque")
    uses_display_color = _reads_display_color(shader, time, out)
    if uses_display_color:
        diffuse = plain[0].diffuse_color
    else:
        diffuse = value("diffuseColor", _MID_GREY, _MID_GREY)
    for name, neutral in (("clearcoat", 0.0), ("displacement", 0.0)):
        if value(name, neutral) != neutral:
            out.note("ignored", owner, f"inputs:{name}")
    _, normal_map = _input_source(shader, "normal", out)
    if normal_map is not None:
        out.note("ignored", owner, "inputs:normal (a normal map)")
    surface = Surface(
        diffuse_color=diffuse,
        emissive_color=value("emissiveColor", (0.0, 0.0, 0.0)),
        specular=True,
        use_specular_workflow=bool(value("useSpecularWorkflow", 0.0)),
        specular_color=value("specularColor", (0.0, 0.0, 0.0)),
        metallic=min(max(value("metallic", 0.0), 0.0), 1.0),
        roughness=min(max(value("roughness", 0.5), 0.0), 1.0),
        ior=value("ior", 1.5),
    )
    return surface, uses_display_color and plain[1]


def _reads_display_color(shader: UsdShade.Shader, time: Usd.TimeCode, out: Translation) -> bool:
    """Whether the diffuse colour comes from a reader of the primvar displayColor."""
    _, source = _input_source(shader, "diffuseColor", out)
    if source is None or not (source.GetShaderId() or "").startswith("UsdPrimvarReader_float3"):
        return False
    attribute, _ = _input_source(source, "varname", out)
    return attribute is not None and str(attribute.Get(time)) == "displayColor"


def _texture_fallback(source: UsdShade.Shader, time: Usd.TimeCode) -> Any:
    fallback = source.GetInput("fallback")
    return fallback.Get(time) if fallback and fallback.GetAttr().HasAuthoredValue() else None
