"""The list of what a stage holds, for a tree of its prims, and their visibility."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pxr import Sdf, Usd, UsdGeom

from ..errors import PrevisError
from ..stage.light import is_light, light_kind
from ..stage.primitives import is_primitive
from ..stage.values import time_code
from .attributes import set_value
from .prims import is_volume

ItemKind = Literal["volume", "light", "mesh", "camera"]


@dataclass(frozen=True)
class OutlineItem:
    """One prim of a stage that can be seen, lit by or looked through.

    `visible` is the result with what hides it from above. `editable` is False for what instances share.
    """

    path: str
    name: str
    kind: ItemKind
    visible: bool
    editable: bool


def outline(stage: Usd.Stage, purposes: frozenset[str], time: float | None) -> tuple[OutlineItem, ...]:
    """The volumes, lights, meshes and cameras of a stage in its order, hidden ones too, those of other purposes not."""
    code = time_code(time)
    items = []
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        kind = _kind(prim)
        imageable = UsdGeom.Imageable(prim)
        if kind is None or (kind != "camera" and imageable and imageable.ComputePurpose() not in purposes):
            continue
        visible = not imageable or imageable.ComputeVisibility(code) != UsdGeom.Tokens.invisible
        items.append(OutlineItem(str(prim.GetPath()), prim.GetName(), kind, visible, not prim.IsInstanceProxy()))
    return tuple(items)


def set_visible(prim: Usd.Prim, authored: Usd.Prim | None, layer: Sdf.Layer, visible: bool) -> None:
    """Show or hide a prim for all times; what the stage says anyway leaves no edit behind.

    `authored` is the same prim on a stage without the edits on `layer`, None where they made it. Raises `PrevisError`
    when a prim above hides it, or it is nothing that can be hidden.
    """
    imageable = UsdGeom.Imageable(prim)
    if not imageable:
        raise PrevisError(f"{prim.GetPath()}: is nothing that can be shown or hidden")
    hiding = _hiding_ancestor(prim) if visible else None
    if hiding is not None:
        raise PrevisError(f"{prim.GetPath()}: stays hidden, since {hiding.GetPath()} above it is invisible")
    token = UsdGeom.Tokens.inherited if visible else UsdGeom.Tokens.invisible
    before = UsdGeom.Imageable(authored).GetVisibilityAttr() if authored else None
    if before and before.Get() == token and not before.GetNumTimeSamples():
        spec = layer.GetPrimAtPath(prim.GetPath())
        if spec is not None and "visibility" in spec.properties:
            spec.RemoveProperty(spec.properties["visibility"])
        return
    set_value(imageable.CreateVisibilityAttr(), token, None)


def _hiding_ancestor(prim: Usd.Prim) -> Usd.Prim | None:
    above = prim.GetParent()
    while above and not above.IsPseudoRoot():
        attribute = UsdGeom.Imageable(above).GetVisibilityAttr() if above.IsA(UsdGeom.Imageable) else None
        if attribute and not attribute.ValueMightBeTimeVarying() and attribute.Get() == UsdGeom.Tokens.invisible:
            return above
        above = above.GetParent()
    return None


def _kind(prim: Usd.Prim) -> ItemKind | None:
    if prim.IsA(UsdGeom.Camera):
        return "camera"
    if is_light(prim) and light_kind(prim) is not None:
        return "light"
    if is_volume(prim):
        return "volume"
    return "mesh" if prim.IsA(UsdGeom.Mesh) or is_primitive(prim) else None
