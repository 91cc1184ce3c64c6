"""UsdLux lights, exactly by the formulas of the schemas.

    Le = color · intensity · 2^exposure · diffuse · blackbody(temperature)       (radiance, before `normalize`)

`normalize` divides Le by the size: the world-space area of sphere (4πr²), disk (πr²), rect (w·h) and cylinder (2πrl),
and sin²(angle/2)·π for a distant light. A light is reduced to its centre (`Light.strength`) as

    ==========  =====================================  ==================
    kind        strength                               normalised
    ==========  =====================================  ==================
    distant     E = L·π·sin²(angle/2); L if angle = 0  E = Le
    sphere      I = L·π·r²                             I = Le/4
    disk, rect  I = L·area, times the cosine about −Z  I = Le
    cylinder    I = L·2πrl/4, its mean projected area  I = Le/4
    ==========  =====================================  ==================

The mean projected area of a cylinder's side is a quarter of its area: 2rl·sinθ averaged over the sphere is πrl/2.
A dome is a uniform environment of radiance Le: its texture and portals are reported, not read.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pxr import Usd, UsdLux

from ..description import Color, Light, LightKind, Shaping
from .context import Context, Placement, Translation
from .values import as_color, as_float, attribute_value, is_authored

_KINDS: dict[str, LightKind] = {
    "DistantLight": "distant",
    "SphereLight": "sphere",
    "DiskLight": "disk",
    "RectLight": "rect",
    "CylinderLight": "cylinder",
    "DomeLight": "dome",
    "DomeLight_1": "dome",
}
_WHITE: Color = (1.0, 1.0, 1.0)
_BLACK: Color = (0.0, 0.0, 0.0)
#: Inputs that had no "inputs:" prefix before USD 21.02; USD reads them no more.
_OLD_NAMES = ("intensity", "exposure", "color", "colorTemperature", "enableColorTemperature", "normalize")
_OLD_SIZES = ("radius", "width", "height", "length", "angle")


def is_light(prim: Usd.Prim) -> bool:
    """Whether a prim is a light, by its type or by an applied LightAPI."""
    return prim.HasAPI(UsdLux.LightAPI) or prim.GetTypeName() in ("PluginLight", "PortalLight")


def light_kind(prim: Usd.Prim) -> LightKind | None:
    """The kind of a light, None for one that is not modelled."""
    return _KINDS.get(prim.GetTypeName())


def read_light(prim: Usd.Prim, placement: Placement, context: Context, out: Translation) -> None:
    """Translate a light prim; kinds that are not modelled are reported."""
    kind = light_kind(prim)
    if kind is None:
        out.note("ignored", prim, f"{_unsupported_label(prim)} lights are not modelled")
        return
    _note_ignored_features(prim, kind, context.time, out)

    def number(name: str, default: float) -> float:
        value = attribute_value(prim, name, context.time, default)
        parsed = as_float(value)
        if parsed is None:
            out.note("repaired", prim, f"{name} = {value} is no finite number; {default:g} is used")
            return default
        return parsed

    base = _base_radiance(prim, kind, context.time, number, out)
    normalize = bool(attribute_value(prim, "inputs:normalize", context.time, False))
    sizes = {
        "angle": number("inputs:angle", 0.53) if kind == "distant" else 0.0,
        "radius": number("inputs:radius", 0.5) if kind in ("sphere", "disk", "cylinder") else 0.0,
        "width": number("inputs:width", 1.0) if kind == "rect" else 0.0,
        "height": number("inputs:height", 1.0) if kind == "rect" else 0.0,
        "length": number("inputs:length", 1.0) if kind == "cylinder" else 0.0,
    }
    for name, size in sizes.items():
        if size < 0.0:
            out.note("repaired", prim, f"inputs:{name} = {size:g} is negative; its absolute value is used")
            sizes[name] = -size
    shaping = _read_shaping(prim, kind, number, context.time, out)
    casts_shadows = bool(attribute_value(prim, "inputs:shadow:enable", context.time, True))
    as_point = kind == "sphere" and bool(attribute_value(prim, "treatAsPoint", context.time, False))
    for k, matrix in enumerate(placement.matrices):
        if not np.all(np.isfinite(matrix)):
            out.note("ignored", prim, "its transform is not finite; it is left out")
            continue
        radiance, strength = _reduce(kind, base, normalize, sizes, matrix)
        if kind != "dome" and not any(strength) and any(base):
            out.note("empty", prim, "has no size and is not normalised, so it emits nothing")
        out.lights.append(
            Light(
                path=f"{prim.GetPath()}{placement.label(k)}",
                kind=kind,
                light_to_world=matrix,
                radiance=radiance,
                strength=strength,
                treat_as_point=as_point,
                shaping=shaping,
                casts_shadows=casts_shadows,
                **sizes,
            )
        )
    if kind in ("disk", "rect", "cylinder"):
        out.note("approximated", prim, f"{kind} light: shines from its centre")
    if kind == "sphere" and not as_point and sizes["radius"] > 0.0 and _scale_spread(placement.matrices) > 1e-3:
        out.note("approximated", prim, "scaled unevenly: shines as a sphere of the same volume")


def _base_radiance(
    prim: Usd.Prim, kind: LightKind, time: Usd.TimeCode, number: Callable[[str, float], float], out: Translation
) -> Color:
    authored = attribute_value(prim, "inputs:color", time, _WHITE)
    color = as_color(authored)
    if color is None:
        out.note("repaired", prim, f"inputs:color = {authored} is no finite colour; white is used")
        color = _WHITE
    if attribute_value(prim, "inputs:enableColorTemperature", time, False):
        blackbody = UsdLux.BlackbodyTemperatureAsRgb(number("inputs:colorTemperature", 6500.0))
        color = tuple(c * float(b) for c, b in zip(color, blackbody, strict=True))
    diffuse = number("inputs:diffuse", 1.0)
    if diffuse != 1.0:
        out.note("approximated", prim, f"inputs:diffuse = {diffuse:g} scales the whole light")
    if number("inputs:specular", 1.0) != diffuse:
        out.note("ignored", prim, "inputs:specular")
    intensity = number("inputs:intensity", 50000.0 if kind == "distant" else 1.0)
    # 2^exposure overflows a float beyond 1023; no picture could show a difference long before.
    scale = intensity * diffuse * 2.0 ** min(number("inputs:exposure", 0.0), 120.0)
    base = tuple(c * scale for c in color)
    if min(base) < 0.0:
        out.note("repaired", prim, "emits negative light, which is clamped to none")
        base = tuple(max(c, 0.0) for c in base)
    return base


def _reduce(
    kind: LightKind, base: Color, normalize: bool, sizes: dict[str, float], matrix: np.ndarray
) -> tuple[Color, Color]:
    """(radiance, strength) of a light: see the table of this module."""
    x, y, z = np.asarray(matrix, float)[:3, :3]
    if kind == "distant":
        half = math.radians(min(sizes["angle"], 360.0) / 2.0)
        # Past a hemisphere the schema goes on counting the rest of the sphere.
        size = math.pi * (math.sin(half) ** 2 if half <= math.pi / 2 else 2.0 - math.sin(half) ** 2)
        projected, normalized_projected = size, 1.0
        if size == 0.0:
            return base, base
    elif kind == "sphere":
        radius = sizes["radius"] * abs(float(np.linalg.det(np.asarray(matrix, float)[:3, :3]))) ** (1.0 / 3.0)
        size = 4.0 * math.pi * radius**2
        projected, normalized_projected = size / 4.0, 0.25
    elif kind == "disk":
        size = math.pi * sizes["radius"] ** 2 * float(np.linalg.norm(np.cross(x, y)))
        projected, normalized_projected = size, 1.0
    elif kind == "rect":
        size = sizes["width"] * sizes["height"] * float(np.linalg.norm(np.cross(x, y)))
        projected, normalized_projected = size, 1.0
    elif kind == "cylinder":
        radius = sizes["radius"] * math.sqrt(float(np.linalg.norm(np.cross(y, z))))
        size = 2.0 * math.pi * radius * sizes["length"] * float(np.linalg.norm(x))
        projected, normalized_projected = size / 4.0, 0.25
    else:
        return base, _BLACK
    if not normalize:
        return base, tuple(c * projected for c in base)
    radiance = tuple(c / size for c in base) if size > 0.0 else base
    return radiance, tuple(c * normalized_projected for c in base)


def _read_shaping(
    prim: Usd.Prim,
    kind: LightKind,
    number: Callable[[str, float], float],
    time: Usd.TimeCode,
    out: Translation,
) -> Shaping | None:
    names = ("cone:angle", "cone:softness", "focus", "focusTint")
    if not prim.HasAPI(UsdLux.ShapingAPI) and not any(is_authored(prim, f"inputs:shaping:{n}") for n in names):
        return None
    if kind in ("distant", "dome"):
        out.note("ignored", prim, f"the shaping of a {kind} light")
        return None
    softness = number("inputs:shaping:cone:softness", 0.0)
    if not 0.0 <= softness <= 1.0:
        out.note("repaired", prim, f"inputs:shaping:cone:softness = {softness:g} is clamped to [0, 1]")
    return Shaping(
        cone_angle=min(max(number("inputs:shaping:cone:angle", 90.0), 0.0), 180.0),
        cone_softness=min(max(softness, 0.0), 1.0),
        focus=max(number("inputs:shaping:focus", 0.0), 0.0),
        focus_tint=as_color(attribute_value(prim, "inputs:shaping:focusTint", time, _BLACK)) or _BLACK,
    )


def _unsupported_label(prim: Usd.Prim) -> str:
    if prim.HasAPI(UsdLux.MeshLightAPI):
        return "mesh"
    if prim.HasAPI(UsdLux.VolumeLightAPI):
        return "volume"
    return prim.GetTypeName() or "untyped"


def _note_ignored_features(prim: Usd.Prim, kind: LightKind, time: Usd.TimeCode, out: Translation) -> None:
    """Report every feature of the light that is authored and has no effect here."""
    for name, label in (("inputs:texture:file", "texture"), ("inputs:shaping:ies:file", "IES profile")):
        asset = attribute_value(prim, name, time)
        if asset is not None and asset.path:
            out.note("ignored", prim, f"the {label} {asset.path}")
    for name, label in (("light:filters", "light filters"), ("portals", "portals")):
        relationship = prim.GetRelationship(name)
        if relationship and relationship.GetTargets():
            out.note("ignored", prim, label)
    for name in ("color", "distance", "falloff"):
        attribute = prim.GetAttribute(f"inputs:shadow:{name}")
        neutral = {"color": _BLACK, "distance": -1.0, "falloff": -1.0}[name]
        if attribute and attribute.HasAuthoredValue() and attribute.Get(time) != neutral:
            out.note("ignored", prim, f"inputs:shadow:{name}")
    for collection, consequence in (
        ("lightLink", "the light reaches everything"),
        ("shadowLink", "everything casts its shadows"),
    ):
        if _links_some(prim, collection):
            out.note("ignored", prim, f"{collection}: {consequence}")
    if any(a.HasAuthoredConnections() for a in prim.GetAuthoredAttributes() if a.GetName().startswith("inputs:")):
        out.note("ignored", prim, "connections of its inputs: their own values are used")
    sizes = () if kind == "dome" else _OLD_SIZES
    old = [n for n in (*_OLD_NAMES, *sizes) if is_authored(prim, n)]
    if old:
        out.note("ignored", prim, f"{', '.join(old)}: since USD 21.02 such names start with inputs:")
    if kind == "cylinder" and attribute_value(prim, "treatAsLine", time, False):
        out.note("ignored", prim, "treatAsLine")


def _links_some(prim: Usd.Prim, collection: str) -> bool:
    """Whether a link collection leaves something out, as far as can be told without evaluating it."""
    for part in ("includes", "excludes"):
        relationship = prim.GetRelationship(f"collection:{collection}:{part}")
        if relationship and relationship.GetTargets():
            return True
    include_root = prim.GetAttribute(f"collection:{collection}:includeRoot")
    if include_root and include_root.HasAuthoredValue() and not include_root.Get():
        return True
    return is_authored(prim, f"collection:{collection}:membershipExpression")


def _scale_spread(matrices: np.ndarray) -> float:
    """How much the largest scale of these transforms exceeds the smallest, relative to it; of those that are finite."""
    matrices = np.asarray(matrices, float)
    matrices = matrices[np.isfinite(matrices).all(axis=(1, 2)), :3, :3]
    if len(matrices) == 0:
        return 0.0
    singular = np.linalg.svd(matrices, compute_uv=False)
    largest, smallest = singular.max(axis=1), singular.min(axis=1)
    return float(np.max((largest - smallest) / np.maximum(largest, 1e-300), initial=0.0))
