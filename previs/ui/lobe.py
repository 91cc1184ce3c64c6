"""The outline of a phase function as a polar plot: how far it reaches in every direction. No ImGui."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ..description import ANISOTROPY_LIMIT
from ..reference.phase import phase_function

Radius = Literal["linear", "log"]

#: 1/(4π): a phase function that scatters evenly.
ISOTROPIC = 0.25 / np.pi
#: The middle of a logarithmic plot is half of this part of the isotropic value, or of the least value if that is less.
LOG_FLOOR = 0.1


@dataclass(frozen=True, eq=False)
class Lobe:
    """A phase function at angles from 0 (straight on) to π (straight back), both (N,), `values` in 1/sr."""

    angles: np.ndarray
    values: np.ndarray

    def integral(self) -> float:
        """Over the sphere, 1 for any phase function that is sampled well."""
        return float(np.trapezoid(2.0 * np.pi * self.values * np.sin(self.angles), self.angles))


@lru_cache(maxsize=32)
def lobe(
    phase: str, anisotropy: float = 0.0, anisotropy2: float = 0.0, lobe_mix: float = 0.0, count: int = 181
) -> Lobe:
    """Sample a phase function, closer to each other where peaks are: straight on and straight back."""
    u = np.linspace(0.0, 1.0, count)
    angles = np.pi * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    g, g2 = np.clip([anisotropy, anisotropy2], -ANISOTROPY_LIMIT, ANISOTROPY_LIMIT)
    values = phase_function(phase, np.cos(angles), float(g), float(g2), float(lobe_mix))
    return Lobe(angles, values)


@dataclass(frozen=True)
class Polar:
    """How values become radii in [0, 1]: values of `peak` lie on the unit circle, those of `floor` in the middle.

    A linear radius has its middle at 0, whatever the floor.
    """

    peak: float
    floor: float
    radius: Radius

    @classmethod
    def fitting(cls, lobes: Sequence[Lobe], radius: Radius) -> Polar:
        """A plot that holds some lobes and the isotropic one."""
        peak = max(ISOTROPIC, *(float(part.values.max()) for part in lobes))
        least = min(float(part.values.min()) for part in lobes)
        return cls(peak, 0.5 * max(min(least, LOG_FLOOR * ISOTROPIC), 1e-9), radius)

    def radii(self, values: np.ndarray | float) -> np.ndarray:
        """Radii of values, of their shape."""
        values = np.asarray(values, float)
        if self.radius == "linear":
            return values / self.peak
        above = np.log(np.maximum(values, self.floor) / self.floor)
        return np.clip(above / np.log(self.peak / self.floor), 0.0, 1.0)


def outline(sampled: Lobe, polar: Polar) -> np.ndarray:
    """A closed line round the origin, (2N − 1, 2), light going to the right along x, y up; inside the unit circle."""
    r = polar.radii(sampled.values)
    upper = np.stack([r * np.cos(sampled.angles), r * np.sin(sampled.angles)], axis=1)
    return np.concatenate([upper, (upper * (1.0, -1.0))[-2::-1]])
