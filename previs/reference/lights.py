"""Lights of the reference: distant, point and spot, each reduced to a direction or a position.

Every kind answers

- ``illuminate(points)``: unattenuated irradiance on a plane across the light (M, 3), the unit direction in which the
  light travels (M, 3), and the distance to the light (M,)
- ``breakpoints(origins, directions)``: distances (R, K) along rays where that irradiance has a kink or a jump
- ``peak(origins, directions)``: where along each ray the light is nearest, and how near; None for a light at infinity
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from previs.reference import checks
from previs.reference.checks import ColorLike


@dataclass(frozen=True, eq=False)
class DistantLight:
    """Parallel light. `direction` is the one in which it travels, `irradiance` RGB that on a plane across it.

    With `casts_shadows` False neither solids nor volumes attenuate it. Raises ValueError for a zero direction or a
    negative irradiance.
    """

    direction: Sequence[float]
    irradiance: ColorLike = 1.0
    casts_shadows: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", checks.direction(self.direction, "direction"))
        object.__setattr__(self, "irradiance", checks.color(self.irradiance, "irradiance"))

    def illuminate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Irradiance (M, 3), direction of travel (M, 3), distance (M,), which is infinite."""
        shape = (len(points), 3)
        return (
            np.broadcast_to(self.irradiance, shape),
            np.broadcast_to(self.direction, shape),
            np.full(len(points), np.inf),
        )

    def breakpoints(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """None, (R, 0): the irradiance is the same everywhere."""
        return np.empty((len(origins), 0))

    def peak(self, origins: np.ndarray, directions: np.ndarray) -> None:
        """None: the light is nowhere nearer."""
        return None


@dataclass(frozen=True, eq=False)
class PointLight:
    """Light from a `position`, of radiant `intensity` RGB (W/sr) in every direction: the irradiance is I/d².

    d is never taken less than `radius` (stage units, default 0), which keeps the irradiance bounded by that on the
    surface of a sphere light; light and shadow still come from the centre. With radius 0 the radiance along a
    ray through the light inside a medium diverges like 1/b with the ray's distance b. `casts_shadows` as for the
    distant light.
    """

    position: Sequence[float]
    intensity: ColorLike = 1.0
    radius: float = 0.0
    casts_shadows: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", checks.vector(self.position, "position"))
        object.__setattr__(self, "intensity", checks.color(self.intensity, "intensity"))
        checks.number(self.radius, "radius", 0.0)

    def illuminate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Irradiance (M, 3), direction of travel (M, 3), distance to the centre (M,)."""
        offset = points - self.position
        distance = np.linalg.norm(offset, axis=-1)
        travel = offset / np.maximum(distance, 1e-300)[:, None]
        nearest = np.maximum(np.maximum(distance, self.radius), 1e-100)
        return self._emitted(travel) / (nearest * nearest)[:, None], travel, distance

    def _emitted(self, travel: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.intensity, travel.shape)

    def breakpoints(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """The point nearest to the light, and where the ray crosses the sphere of the light's radius (R, 3)."""
        centre, nearest = self.peak(origins, directions)
        with np.errstate(invalid="ignore"):
            half = np.sqrt(self.radius**2 - nearest**2)
        return np.stack([centre, centre - half, centre + half], axis=-1)

    def peak(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance along each ray of the point nearest to the light, and its distance from the light (R,)."""
        offset = self.position - origins
        centre = np.einsum("ij,ij->i", offset, directions)
        return centre, np.linalg.norm(offset - centre[:, None] * directions, axis=-1)


@dataclass(frozen=True, eq=False)
class SpotLight(PointLight):
    """A point light shaped about its `axis` (the direction in which it shines) as UsdLux ShapingAPI says.

    `cone_angle` is the half angle in degrees, in [0, 180] (default 90); the intensity is multiplied by
    1 − smoothstep(θ, (1 − `softness`)·cone_angle, cone_angle), softness in [0, 1], and is 0 outside the cone.
    `focus` ≥ 0 multiplies it by lerp(`focus_tint`, 1, cosθ^focus), cosθ not below 0. With `cosine` True the light is a
    small one-sided Lambertian disk or rectangle: `intensity` is that on the axis and falls with cosθ.
    """

    axis: Sequence[float] = (0.0, 0.0, -1.0)
    cone_angle: float = 90.0
    softness: float = 0.0
    focus: float = 0.0
    focus_tint: ColorLike = 0.0
    cosine: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axis", checks.direction(self.axis, "axis"))
        object.__setattr__(self, "focus_tint", checks.color(self.focus_tint, "focus_tint"))
        checks.number(self.cone_angle, "cone_angle", 0.0, 180.0)
        checks.number(self.softness, "softness", 0.0, 1.0)
        checks.number(self.focus, "focus", 0.0)

    def _emitted(self, travel: np.ndarray) -> np.ndarray:
        cosine = np.clip(travel @ self.axis, -1.0, 1.0)
        # The angle by its sine and cosine: arccos alone has no digits near the axis.
        theta = np.degrees(np.arctan2(np.linalg.norm(np.cross(travel, self.axis), axis=-1), cosine))
        inner = (1.0 - self.softness) * self.cone_angle
        # A softness below rounding is none.
        if inner < self.cone_angle:
            x = np.clip((theta - inner) / (self.cone_angle - inner), 0.0, 1.0)
            shape = 1.0 - x * x * (3.0 - 2.0 * x)
        else:
            shape = (theta <= self.cone_angle).astype(float)
        forward = np.maximum(cosine, 0.0)
        if self.cosine:
            shape = shape * forward
        focused = (forward**self.focus)[:, None]
        return self.intensity * shape[:, None] * (self.focus_tint + (1.0 - self.focus_tint) * focused)

    def breakpoints(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Those of a point light, and where the ray crosses both cones and the plane across the axis (R, 8)."""
        from_light = origins - self.position
        a0, a1 = from_light @ self.axis, directions @ self.axis
        dot, square = np.einsum("ij,ij->i", from_light, directions), np.einsum("ij,ij->i", from_light, from_light)
        found = [super().breakpoints(origins, directions)]
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append((-a0 / a1)[:, None])
            for angle in (self.cone_angle, (1.0 - self.softness) * self.cone_angle):
                # (m·axis)² = cos²·|m|² with m = from_light + t·direction; both nappes, the wrong one does no harm.
                cos2 = np.cos(np.radians(angle)) ** 2
                a, b, c = a1 * a1 - cos2, a0 * a1 - cos2 * dot, a0 * a0 - cos2 * square
                q = -(b + np.where(b >= 0.0, 1.0, -1.0) * np.sqrt(b * b - a * c))
                found.append(np.stack([q / a, c / q], axis=-1))
        return np.concatenate(found, axis=1)


Light = DistantLight | PointLight
