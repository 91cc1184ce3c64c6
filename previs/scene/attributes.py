"""Setting attributes and transforms so that the value is what is seen, whatever weaker layers hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom


def set_value(attribute: Usd.Attribute, value: Any, time: float | None) -> None:
    """Set a value for all times, or one sample of an animated attribute."""
    if time is None:
        if attribute.GetNumTimeSamples():
            # Samples in the same layer would hide the default.
            attribute.Clear()
        attribute.Set(value)
        return
    times = attribute.GetTimeSamples()
    if not times:
        attribute.Set(value)
        return
    target = attribute.GetStage().GetEditTarget()
    if not target.GetLayer().GetNumTimeSamplesForPath(target.MapToSpecPath(attribute.GetPath())):
        # Samples of one layer hide those of weaker ones altogether, so the others come along.
        set_samples(attribute, {t: attribute.Get(t) for t in times})
    attribute.Set(value, float(time))


def set_samples(attribute: Usd.Attribute, samples: Mapping[float, Any]) -> None:
    """Set the whole animation of an attribute."""
    attribute.Clear()
    for time, value in samples.items():
        attribute.Set(value, time)


def place(prim: UsdGeom.Xformable, matrix: np.ndarray) -> None:
    """Set the whole local transform."""
    identity = np.array_equal(matrix, np.eye(4))
    if identity and not UsdGeom.Xformable(prim).GetOrderedXformOps():
        return
    UsdGeom.Xformable(prim).MakeMatrixXform().Set(Gf.Matrix4d(np.asarray(matrix, float).tolist()))


def remove_property(layer: Sdf.Layer, path: Sdf.Path) -> None:
    """Remove what a layer says of a property."""
    spec = layer.GetPropertyAtPath(path)
    if spec is not None:
        spec.owner.RemoveProperty(spec)


def remove_schema(layer: Sdf.Layer, path: Sdf.Path, schema: str) -> None:
    """Remove what a layer says of one applied schema of a prim."""
    spec = layer.GetPrimAtPath(path)
    applied = spec.GetInfo("apiSchemas") if spec is not None and spec.HasInfo("apiSchemas") else None
    if applied is None:
        return
    for items in ("prependedItems", "appendedItems", "addedItems", "explicitItems", "deletedItems"):
        kept = [name for name in getattr(applied, items) if name != schema]
        if len(kept) < len(getattr(applied, items)):
            setattr(applied, items, kept)
    if applied.GetAppliedItems() or applied.deletedItems:
        spec.SetInfo("apiSchemas", applied)
    else:
        spec.ClearInfo("apiSchemas")
