"""What a reference scene holds: volumes with their media, lights, solids, ambient light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from previs.reference import checks
from previs.reference.checks import ColorLike
from previs.reference.density import Density, GridMedium
from previs.reference.lights import Light
from previs.reference.phase import phase_function
from previs.reference.solids import Triangles


@dataclass(frozen=True, eq=False)
class EmissionField:
    """A second grid that modulates emission: radiance is multiplied by ``to_radiance(value of the grid)``.

    `to_radiance` maps field values (M,) to RGB (M, 3); by default the value itself in every channel. Give a blackbody
    curve for a temperature. Outside the grid's domain the field is its background.
    """

    grid: GridMedium
    to_radiance: Callable[[np.ndarray], np.ndarray] | None = None

    def factor(self, points: np.ndarray) -> np.ndarray:
        """The factor (M, 3) at world points (M, 3); ValueError when `to_radiance` gives another shape."""
        value = self.grid.sample(points, self.grid.background)
        if self.to_radiance is None:
            return np.repeat(value[:, None], 3, axis=1)
        rgb = np.asarray(self.to_radiance(value), float)
        if rgb.shape != (len(points), 3):
            raise ValueError(
                f"to_radiance gave an array of shape {rgb.shape} for {len(points)} values; (M, 3) is needed."
            )
        return rgb


@dataclass(frozen=True, eq=False)
class Medium:
    """Scattering properties. `extinction` σt RGB ≥ 0 per stage unit where the density is 1, the density scale included.

    `albedo` σs/σt RGB in [0, 1] (default 0.9). `phase`, `anisotropy`, `anisotropy2`, `lobe_mix` as in `phase_function`,
    anisotropies in (−1, 1). `emission` is the emitted radiance Le RGB (default 0), times every one of
    `emission_fields`; the emission term is σa·Le. Raises ValueError for values outside these ranges.
    """

    extinction: ColorLike = 1.0
    albedo: ColorLike = 0.9
    phase: str = "isotropic"
    anisotropy: float = 0.0
    anisotropy2: float = 0.0
    lobe_mix: float = 0.0
    emission: ColorLike = 0.0
    emission_fields: Sequence[EmissionField] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "extinction", checks.color(self.extinction, "extinction"))
        object.__setattr__(self, "albedo", checks.color(self.albedo, "albedo", 0.0, 1.0))
        object.__setattr__(self, "emission", checks.color(self.emission, "emission"))
        for name in ("anisotropy", "anisotropy2"):
            if not abs(getattr(self, name)) < 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be between −1 and 1, both excluded.")
        checks.number(self.lobe_mix, "lobe_mix", 0.0, 1.0)
        self.phase_value(np.zeros(1))

    @property
    def scattering(self) -> np.ndarray:
        """σs = albedo·σt, (3,)."""
        return self.albedo * self.extinction

    @property
    def absorption(self) -> np.ndarray:
        """σa = σt − σs, (3,)."""
        return (1.0 - self.albedo) * self.extinction

    def phase_value(self, cos_theta: np.ndarray) -> np.ndarray:
        """The phase function at the given cosines, 1/sr."""
        return phase_function(self.phase, cos_theta, self.anisotropy, self.anisotropy2, self.lobe_mix)


@dataclass(frozen=True, eq=False)
class Volume:
    """A medium and where it is. Volumes may overlap: their coefficients add."""

    density: Density
    medium: Medium = Medium()


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that is rendered. `ambient` is a uniform radiance La from all sides that nothing occludes:
    media scatter σs·La, surfaces reflect albedo·La. The background is black."""

    volumes: Sequence[Volume] = ()
    lights: Sequence[Light] = ()
    solids: Sequence[Triangles] = ()
    ambient: ColorLike = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "volumes", tuple(self.volumes))
        object.__setattr__(self, "lights", tuple(self.lights))
        object.__setattr__(self, "solids", tuple(self.solids))
        object.__setattr__(self, "ambient", checks.color(self.ambient, "ambient"))
