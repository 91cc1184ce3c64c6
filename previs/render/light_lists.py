"""Which lights can reach what: cones against boxes, and lists of lights for the cells of a grid over the media.

Everything here is conservative: a light that is left out of a list lights nothing there, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..description import Light, box_corners

#: Cells along an edge of the grid of lists: the most that fit, of these.
LIST_GRIDS = (16, 12, 9, 6)
#: Cells along an edge of a box that a cone is tested against.
BOX_CELLS = 6
#: Cells along an edge of the bounds of surfaces, for the part of the picture that a light can reach.
SCREEN_CELLS = 8
#: Lists are made for more lights than this, where they leave out at least half of them.
FEW_LIGHTS = 4
#: What the packed lists can hold, all in a uniform block of 64 KiB: cells, and beside them lights, a byte each.
LISTS_BYTES = 2**16
MOST_CELLS = LIST_GRIDS[0] ** 3
MOST_INDICES = LISTS_BYTES - 32 - 4 * MOST_CELLS
MOST_LISTED = 256


def reach_angle(light: Light) -> float:
    """Half angle in radians, about its axis, of the directions into which a light shines; π for all."""
    if light.kind == "distant":
        return math.pi
    angle = math.pi
    if light.shaping is not None:
        angle = math.radians(min(max(light.shaping.cone_angle, 0.0), 180.0))
    # These emit with the cosine to their axis, to one side.
    return min(angle, 0.5 * math.pi) if light.kind in ("disk", "rect") else angle


def reached_balls(light: Light, centres: np.ndarray, radius: float | np.ndarray) -> np.ndarray:
    """Whether a light can reach each of the balls with these centres (N, 3): (N,) bool."""
    angle = reach_angle(light)
    if angle >= math.pi:
        return np.ones(len(centres), bool)
    offset = centres - light.position
    along = offset @ light.direction
    across = np.linalg.norm(offset - along[:, None] * light.direction, axis=1)
    # Distance to the cone's surface, positive outside; less than the true one behind the apex, for angles past 90° too.
    slack = 1e-4 * (np.abs(along) + across)
    return across * math.cos(angle) - along * math.sin(angle) <= radius + slack


def grid_cells(lo: np.ndarray, hi: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Centres (count³, 3), x fastest, and the radius around them, of the cells of a grid over a box."""
    steps = (np.arange(count) + 0.5) / count
    z, y, x = np.meshgrid(steps, steps, steps, indexing="ij")
    size = np.asarray(hi, float) - lo
    return lo + np.stack([x, y, z], axis=-1).reshape(-1, 3) * size, 0.5 * float(np.linalg.norm(size)) / count


def reaches_box(light: Light, lo: np.ndarray, hi: np.ndarray) -> bool:
    """Whether a light can reach anything of a world box."""
    if reach_angle(light) >= math.pi:
        return True
    return bool(reached_balls(light, *grid_cells(np.asarray(lo, float), np.asarray(hi, float), BOX_CELLS)).any())


def reached_rectangle(
    light: Light, lo: np.ndarray, hi: np.ndarray, view_projection: np.ndarray, size: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """The part of a picture in which a light can reach anything of a world box: (x, y, width, height) in pixels from
    the lower left, None where it reaches nothing that is in the picture.

    Args:
        light: any.
        lo, hi: the world box.
        view_projection: world → clip, row vectors.
        size: (width, height) of the picture.
    """
    whole = (0, 0, *size)
    if reach_angle(light) >= math.pi:
        return whole
    centres, radius = grid_cells(lo, hi, SCREEN_CELLS)
    centres = centres[reached_balls(light, centres, radius)]
    if not len(centres):
        return None
    half = 0.5 * (hi - lo) / SCREEN_CELLS * (1.0 + 1e-3)
    corners = (centres[:, None, :] + box_corners(-half, half)).reshape(-1, 3)
    clip = corners @ view_projection[:3] + view_projection[3]
    if clip[:, 3].min() <= 1e-6 * np.abs(clip[:, 3]).max():
        return whole
    places = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * size
    # A pixel more on every side: rounding.
    first = np.clip(np.floor(places.min(axis=0)) - 1, 0, size).astype(int)
    last = np.clip(np.ceil(places.max(axis=0)) + 1, 0, size).astype(int)
    if np.any(last <= first):
        return None
    return (int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1]))


@dataclass(frozen=True, eq=False)
class LightLists:
    """Lists of lights for the cells of a grid over the world box from `lo` to `hi`.

    `first` and `count` are (cells³,), x fastest; `lights` are numbers of lights, counted from the first of their
    batch, in ascending order within a list.
    """

    lo: np.ndarray
    hi: np.ndarray
    cells: int
    first: np.ndarray
    count: np.ndarray
    lights: np.ndarray

    @property
    def longest(self) -> int:
        """Length of the longest list."""
        return int(self.count.max())


def light_lists(
    lights: Sequence[Light], lo: np.ndarray, hi: np.ndarray, margin: float, always: bool = False
) -> LightLists | None:
    """Lists of the lights that can reach each cell, or None where they would leave out too little.

    Args:
        lights: of one batch.
        lo, hi: the world box around everything that looks lights up.
        margin: how far from the place that a list is asked for its lights are evaluated at the most.
        always: also where they leave out little, if they can be packed.
    """
    if len(lights) > MOST_LISTED or (len(lights) <= FEW_LIGHTS and not always):
        return None
    for cells in LIST_GRIDS:
        centres, radius = grid_cells(lo, hi, cells)
        # Rounding may take a place to the next cell.
        radius = radius * (1.0 + 1e-3) + margin
        reached = np.stack([reached_balls(light, centres, radius) for light in lights], axis=1)
        count = reached.sum(axis=1)
        if 2 * count.mean() > len(lights) and not always:
            return None
        if count.sum() <= MOST_INDICES:
            return LightLists(lo, hi, cells, np.cumsum(count) - count, count, np.nonzero(reached)[1])
    return None
