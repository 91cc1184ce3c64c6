"""Where lights come from and where they stand, as numbers to turn. Without ImGui."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Vector = tuple[float, float, float]


def angles(direction: Sequence[float], up_axis: str) -> tuple[float, float]:
    """Elevation and azimuth in degrees of where light comes from that travels along `direction`.

    Elevation is the angle over the horizon, in [-90, 90]. Azimuth is 0 in front, which is +Z where Y is up and -Y
    where Z is up, and 90 at +X; in (-180, 180].
    """
    x, y, z = (-float(c) for c in direction)
    front, up = (-y, z) if up_axis == "Z" else (z, y)
    return math.degrees(math.atan2(up, math.hypot(x, front))), math.degrees(math.atan2(x, front))


def direction(elevation: float, azimuth: float, up_axis: str) -> Vector:
    """The unit direction in which light travels that comes from there: the inverse of `angles`."""
    high, turned = math.radians(elevation), math.radians(azimuth)
    x, front, up = math.cos(high) * math.sin(turned), math.cos(high) * math.cos(turned), math.sin(high)
    return (-x, front, -up) if up_axis == "Z" else (-x, -up, -front)


def reach(bounds: np.ndarray | None, position: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest coordinates, (3,) each, between which a light is comfortably moved about a scene.

    Args:
        bounds: lower and upper corner of what is lit, (2, 3); None for nothing.
        position: where the light is; it always lies inside.
    """
    here = np.asarray(position, float)
    if bounds is None or not np.isfinite(bounds).all():
        return here - 10.0, here + 10.0
    low, high = np.asarray(bounds, float)
    margin = float(np.linalg.norm(high - low)) or 1.0
    return np.minimum(low - margin, here), np.maximum(high + margin, here)
