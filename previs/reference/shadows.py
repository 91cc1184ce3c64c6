"""Where along a ray the shadow of a volume begins and ends.

Behind a dense homogeneous shape the light drops over a distance that no fixed set of nodes is sure to see. The surface
that separates rays of light that meet the shape from those that pass it is swept by its outline, so it is
known in advance: a quadratic for round shapes, the edges for boxes. A grid without background fades
over a voxel and needs none of this.
"""

from __future__ import annotations

import numpy as np

from previs.reference.density import Density, GridMedium, HomogeneousBox, HomogeneousCapsule, HomogeneousSphere
from previs.reference.lights import DistantLight, Light
from previs.reference.solids import SolidSet, box_triangles


def volume_shadow_breakpoints(
    density: Density, light: Light, origins: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """Distances (R, K) at which rays may cross the boundary of the shadow of a volume, NaN for none."""
    none = np.empty((len(origins), 0))
    if not light.casts_shadows:
        return none
    if isinstance(density, HomogeneousBox):
        return _box(density.lo, density.hi, density.to_world, light, origins, directions)
    if isinstance(density, GridMedium):
        if density.background == 0.0:
            return none
        size = np.array(density.values.shape, float)
        return _box(np.full(3, -1.0), size, density.index_to_world, light, origins, directions)
    inverse = np.linalg.inv(density.to_world)
    # The light as a homogeneous point: a direction has weight 0.
    if isinstance(light, DistantLight):
        lamp, weight = -light.direction @ inverse[:3, :3], 0.0
    else:
        lamp, weight = light.position @ inverse[:3, :3] + inverse[3, :3], 1.0
    o, d = origins @ inverse[:3, :3] + inverse[3, :3], directions @ inverse[:3, :3]
    if isinstance(density, HomogeneousSphere):
        return _tangents(o, d, lamp, weight, density.radius)
    assert isinstance(density, HomogeneousCapsule)
    end, across = np.zeros(3), np.ones(3)
    end["XYZ".index(density.axis)] = 0.5 * density.height
    across["XYZ".index(density.axis)] = 0.0
    caps = [_tangents(o - c, d, lamp - weight * c, weight, density.radius) for c in (-end, end)]
    return np.concatenate([*caps, _tangents(o * across, d * across, lamp * across, weight, density.radius)], axis=1)


def _box(
    lo: np.ndarray, hi: np.ndarray, to_world: np.ndarray, light: Light, origins: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    if np.any(lo == hi):
        return np.empty((len(origins), 0))
    return SolidSet([box_triangles(lo, hi, to_world)]).shadow_breakpoints(light, origins, directions, all_edges=True)


def _tangents(
    origins: np.ndarray, directions: np.ndarray, lamp: np.ndarray, weight: float, radius: float
) -> np.ndarray:
    """Where the line from x = o + t·d to the light touches a ball around 0: |x × l|² = r²·|l − w·x|², (R, 2)."""
    moment, turn = np.cross(origins, lamp), np.cross(directions, lamp)
    towards = lamp - weight * origins
    a = np.einsum("ij,ij->i", turn, turn) - (radius * weight) ** 2 * np.einsum("ij,ij->i", directions, directions)
    b = np.einsum("ij,ij->i", moment, turn) + radius**2 * weight * np.einsum("ij,ij->i", towards, directions)
    c = np.einsum("ij,ij->i", moment, moment) - radius**2 * np.einsum("ij,ij->i", towards, towards)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -(b + np.where(b >= 0.0, 1.0, -1.0) * np.sqrt(b * b - a * c))
        return np.stack([q / a, c / q], axis=-1)
