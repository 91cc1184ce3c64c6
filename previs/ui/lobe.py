"""The outline of a phase function as a polar plot: how far it reaches in every direction. No ImGui."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ..description import ANISOTROPY_LIMIT
from ..reference.phase import phase_function

Radius = Literal["linear", "log"]

#: 1/(4π): a phase function that scatters evenly.
ISOTROPIC = 0.25 / np.pi
#: A logarithmic plot shows values down to this part of the isotropic one, or of its own peak where that is smaller.
LOG_FLOOR = 1e-2


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


def radii(values: np.ndarray, peak: float, radius: Radius) -> np.ndarray:
    """Radii in [0, 1] of values up to `peak`; logarithmic ones end at 0 where the value is `LOG_FLOOR` isotropic."""
    if radius == "linear":
        return values / peak
    floor = LOG_FLOOR * min(ISOTROPIC, peak)
    return np.clip(np.log(np.maximum(values, floor) / floor) / np.log(peak / floor), 0.0, 1.0)


def outline(sampled: Lobe, peak: float, radius: Radius) -> np.ndarray:
    """A closed line round the origin, (2N − 1, 2), light going to the right along x, y up; inside the unit circle."""
    r = radii(sampled.values, peak, radius)
    upper = np.stack([r * np.cos(sampled.angles), r * np.sin(sampled.angles)], axis=1)
    return np.concatenate([upper, (upper * (1.0, -1.0))[-2::-1]])
