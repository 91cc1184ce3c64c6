"""What a medium holds that the renderer's numbers cannot: said to the user before it is drawn.

Densities are half floats relative to their peak, positions are 32-bit floats, and a map has so many texels. Each suits
what media usually hold; beyond that the picture is off, and these notes say of what volume and by what.
"""

from __future__ import annotations

import math

import numpy as np

from ..description import SparseGrid, Volume, box_corners, volume_box
from .method import Method

#: A half float below this part of the peak has lost digits; the least there is, is this part.
SUBNORMAL, LEAST_HALF = 2.0**-14, 2.0**-24
#: Optical depth that may be lost along the whole way through a volume without a word.
NEGLIGIBLE_DEPTH = 1e-3
#: Optical depth of a voxel from which light fades on its surface within a small part of a map's texel.
DEEP_VOXEL = 100.0
#: Optical depth through a volume from which rounding of a 32-bit position shows: 2^-24 of the size is a hundredth then.
SOLID_DEPTH = 2e5
#: Optical depth through a volume from which 16 cosines over the full range fall below 40 dB, in the bench's smoke and
#: solid by optical depth.
FULL_RANGE_DEPTH = 30.0
#: Leaves that are looked through at a time.
LEAVES = 4096


def density_range(grid: SparseGrid) -> tuple[float, float]:
    """(least above zero, largest) of the values a grid holds; (inf, 0) where there is none above zero."""
    least, largest = math.inf, 0.0
    leaves = np.asarray(grid.leaf_values)
    # Some leaves at a time: which values are above zero takes a byte for each of them.
    slabs = [leaves[first : first + LEAVES] for first in range(0, len(leaves), LEAVES)]
    for values in (*slabs, np.asarray(getattr(getattr(grid, "tiles", None), "value", np.zeros(0)))):
        if values.size:
            least = min(least, float(np.min(values, initial=math.inf, where=values > 0.0)))
            largest = max(largest, float(np.max(values, initial=0.0)))
    return least, largest


def precision_notes(volume: Volume, densities: tuple[float, float], method: Method) -> list[str]:
    """What of a volume is beyond the renderer, a sentence each.

    Args:
        volume: a shape, or a grid that holds voxels.
        densities: of a grid, from `density_range`; (1, 1) for a shape.
        method: how light is attenuated.
    """
    lo, hi, to_world = volume_box(volume)
    least, peak = densities
    strength = max(volume.medium.strength)
    corners = box_corners(np.asarray(lo, float), np.asarray(hi, float)) @ to_world[:3, :3]
    across = float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0)))
    deepest = peak * strength * across
    notes = []
    if deepest > SOLID_DEPTH:
        notes.append(
            f"an optical depth of up to {deepest:.1g} across; positions of 32 bits place its surface to within "
            f"{across * 2**-22:.1g}"
        )
    if volume.density is None:
        return notes
    # The least half float is what is lost of a density at the most, wherever it is that small.
    lost = LEAST_HALF * deepest
    if least < SUBNORMAL * peak and lost > NEGLIGIBLE_DEPTH:
        notes.append(
            f"its densities span {peak / least:.1g} to 1; half floats round those below {SUBNORMAL * peak:.1g} "
            f"by up to {LEAST_HALF * peak:.1g}"
        )
    voxel = float(np.linalg.norm(to_world[:3, :3], axis=1).min()) * peak * strength
    if voxel > DEEP_VOXEL and method.has_maps:
        notes.append(
            f"an optical depth of up to {voxel:.1g} in a voxel; light on such a surface is as fine as a texel of its "
            "maps"
        )
    if deepest > FULL_RANGE_DEPTH and method.curve == "cosine" and not method.adaptive:
        notes.append(
            f"an optical depth of up to {deepest:.1g} across; {method.name} blurs light in it, tfm and quantile do not"
        )
    return notes
