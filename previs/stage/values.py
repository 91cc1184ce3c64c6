"""Values of USD attributes as plain Python and NumPy values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pxr import Usd

from ..description import Color
from ..errors import PrevisError


def time_code(time: float | Usd.TimeCode | None) -> Usd.TimeCode:
    """A time as USD has it: None is the earliest time, NaN the default time. Raises `PrevisError` for an infinity."""
    if time is None:
        return Usd.TimeCode.EarliestTime()
    if isinstance(time, Usd.TimeCode):
        return time
    if math.isinf(time):
        raise PrevisError(f"time {time} is not a finite time code")
    return Usd.TimeCode(float(time))


def attribute_value(prim: Usd.Prim, name: str, time: Usd.TimeCode, default: Any = None) -> Any:
    """The value of an attribute (its schema fallback when not authored), `default` where there is none."""
    attribute = prim.GetAttribute(name)
    value = attribute.Get(time) if attribute else None
    return default if value is None else value


def numpy_matrix(matrix: Any) -> np.ndarray:
    """A Gf.Matrix4d as a 4×4 float64 array (row vectors, as USD has it)."""
    return np.array(matrix, np.float64)


def as_float(value: Any) -> float | None:
    """A finite number, or None for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def as_color(value: Any) -> Color | None:
    """Three finite numbers; a single number counts for all channels; None for anything else."""
    try:
        array = np.asarray(value, float).reshape(-1)
    except (TypeError, ValueError):
        return None
    if array.size == 1:
        array = np.repeat(array, 3)
    if array.size < 3 or not np.all(np.isfinite(array[:3])):
        return None
    return tuple(float(c) for c in array[:3])


def is_authored(prim: Usd.Prim, name: str) -> bool:
    """Whether any layer authors a value for the attribute."""
    attribute = prim.GetAttribute(name)
    return bool(attribute) and attribute.HasAuthoredValue()
