"""Setting attributes and transforms so that the value is what is seen, whatever weaker layers hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Gf, Usd, UsdGeom


def unset(attribute: Usd.Attribute | None) -> None:
    """Make an attribute valueless, in this layer or, where a weaker one has a value, by blocking it."""
    if attribute is not None:
        attribute.Clear()
        if attribute.HasAuthoredValue():
            attribute.Block()


def set_value(attribute: Usd.Attribute, value: Any, time: float | None) -> None:
    """Set a value for all times, or one sample of an animated attribute."""
    if time is None:
        if attribute.GetNumTimeSamples():
            # Samples in the same layer would hide the default.
            attribute.Clear()
        attribute.Set(value)
        return
    # Samples of one layer hide those of weaker ones altogether, so the others come along.
    samples = {t: attribute.Get(t) for t in attribute.GetTimeSamples()}
    if not samples:
        attribute.Set(value)
        return
    samples[float(time)] = value
    for sample_time, sample in samples.items():
        attribute.Set(sample, sample_time)


def place(prim: UsdGeom.Xformable, matrix: np.ndarray) -> None:
    """Set the whole local transform."""
    identity = np.array_equal(matrix, np.eye(4))
    if identity and not UsdGeom.Xformable(prim).GetOrderedXformOps():
        return
    UsdGeom.Xformable(prim).MakeMatrixXform().Set(Gf.Matrix4d(np.asarray(matrix, float).tolist()))
