"""Knobs of the renderer, authored on a stage: attributes `previs:<name>` of its RenderSettings prim."""

from __future__ import annotations

from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdRender

from ..settings import BY_NAME, Setting
from ..stage.render_settings import KNOB_PREFIX, KNOBS_PATH, needs_metadata
from .attributes import remove_property, set_value

# Numbers are doubles, so that what is read is what was set.
_KINDS = {
    bool: Sdf.ValueTypeNames.Bool,
    int: Sdf.ValueTypeNames.Int,
    float: Sdf.ValueTypeNames.Double,
    str: Sdf.ValueTypeNames.Token,
}


def known_setting(name: str) -> Setting:
    """The row of the table. Raises ValueError for an unknown name."""
    if name not in BY_NAME:
        raise ValueError(f"unknown setting {name!r}; known are {', '.join(BY_NAME)}")
    return BY_NAME[name]


def author_setting(stage: Usd.Stage, prim: Usd.Prim | None, name: str, value: Any) -> None:
    """Author a checked value on a RenderSettings prim; without one `/Render/previs` is made.

    It is made too where the prim would not be found below another root layer.
    """
    if prim is None or needs_metadata(prim):
        if not stage.GetPrimAtPath(KNOBS_PATH.GetParentPath()):
            UsdGeom.Scope.Define(stage, KNOBS_PATH.GetParentPath())
        _author(UsdRender.Settings.Define(stage, KNOBS_PATH).GetPrim(), name, value)
    if prim is not None:
        _author(prim, name, value)


def _author(prim: Usd.Prim, name: str, value: Any) -> None:
    attribute = prim.GetAttribute(KNOB_PREFIX + name)
    if not attribute:
        attribute = prim.CreateAttribute(KNOB_PREFIX + name, _KINDS[known_setting(name).type], True)
    set_value(attribute, value, None)


def reset_settings(layer: Sdf.Layer, prim: Usd.Prim | None, names: tuple[str, ...]) -> None:
    """Remove what a layer of edits says of these knobs, of all where none is named, and the prims made for them."""
    for path in {KNOBS_PATH} if prim is None else {KNOBS_PATH, prim.GetPath()}:
        for name in names or BY_NAME:
            known_setting(name)
            remove_property(layer, path.AppendProperty(KNOB_PREFIX + name))
    for path in (KNOBS_PATH, KNOBS_PATH.GetParentPath()):
        spec = layer.GetPrimAtPath(path)
        if spec is None or spec.specifier != Sdf.SpecifierDef or spec.properties or spec.nameChildren:
            break
        parent = layer.GetPrimAtPath(path.GetParentPath()) or layer.pseudoRoot
        del parent.nameChildren[path.name]
