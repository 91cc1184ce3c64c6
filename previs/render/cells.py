"""A coarse grid over a block of voxels: how dense each of its cells can be, and how far it is to the next that is not
empty, so that a ray marcher can leap over empty space and bound the density elsewhere.

A block of n texels along an axis has n − 1 intervals between the centres of its texels; cell c covers the intervals
[c·edge, (c + 1)·edge], the last cell what is left of them. Trilinear interpolation inside a cell reads the texels
c·edge to (c + 1)·edge, both included.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Smallest edge of a cell, in intervals between voxels.
LEAST_EDGE = 4
#: Cells along the longest axis at the most: of a block of up to `LARGE_BLOCK` intervals, and of a larger one.
MOST_CELLS = 32
MOST_CELLS_OF_LARGE_BLOCK = 64
LARGE_BLOCK = 256
#: Distances are not followed further, cells.
MOST_DISTANCE = 64

_MAGNITUDE = np.uint16(0x7FFF)


def cell_edge(size: Sequence[int]) -> int:
    """Edge of the cells of a block of `size` texels, in intervals: a power of two."""
    intervals = max(size) - 1
    most = MOST_CELLS if intervals <= LARGE_BLOCK else MOST_CELLS_OF_LARGE_BLOCK
    edge = LEAST_EDGE
    while -(-intervals // edge) > most:
        edge *= 2
    return edge


def cell_counts(size: Sequence[int], edge: int) -> tuple[int, ...]:
    """Cells along each axis of a block of `size` texels."""
    return tuple(max(-(-(n - 1) // edge), 1) for n in size)


def majorants(values: np.ndarray, edge: int) -> np.ndarray:
    """The largest magnitude of the texels that interpolation inside each cell reads.

    Args:
        values: float16 (z, y, x), finite.
        edge: of the cells.

    Returns:
        float16 (z, y, x) per cell; exact, as the texels are half floats.
    """
    layers, rows, columns = cell_counts(values.shape, edge)
    # Magnitudes of half floats are ordered as their bits are; integers are compared many at a time.
    bits = np.ascontiguousarray(values).view(np.uint16)
    found = np.empty((layers, rows, columns), np.uint16)
    for layer in range(layers):
        slab = bits[layer * edge : (layer + 1) * edge + 1] & _MAGNITUDE
        found[layer] = _spans(_spans(slab.max(axis=0), edge, 0), edge, 1)
    return found.view(np.float16)


def _spans(texels: np.ndarray, edge: int, axis: int) -> np.ndarray:
    """Maxima over the texels of each cell along an axis, both ends included."""
    starts = np.arange(0, max(texels.shape[axis] - 1, 1), edge)
    found = np.maximum.reduceat(texels, starts, axis=axis)
    # The last texel of a cell is the first of the next.
    inner = [slice(None)] * texels.ndim
    inner[axis] = slice(0, len(starts) - 1)
    np.maximum(found[tuple(inner)], np.take(texels, starts[1:], axis=axis), out=found[tuple(inner)])
    return found


def distances(empty: np.ndarray) -> np.ndarray:
    """Chebyshev distance in cells from each empty cell to the nearest other, at most `MOST_DISTANCE`; 0 where not
    empty.

    Args:
        empty: bool, of any number of axes.
    """
    found = np.where(empty, np.uint8(MOST_DISTANCE), np.uint8(0))
    reached = ~empty
    if not reached.any():
        return found
    for distance in range(1, MOST_DISTANCE):
        if reached.all():
            break
        grown = reached.copy()
        for axis in range(empty.ndim):
            before = np.moveaxis(grown.copy(), axis, 0)
            after = np.moveaxis(grown, axis, 0)
            after[1:] |= before[:-1]
            after[:-1] |= before[1:]
        found[grown & ~reached] = distance
        reached = grown
    return found


def with_distances(majorant: np.ndarray) -> np.ndarray:
    """One float16 per cell: its majorant where that is positive, else minus the distance to the next cell that is not
    empty, in cells and 1 at the least."""
    return np.where(majorant > 0, majorant, -distances(majorant == 0).astype(np.float16))


def cells_of(values: np.ndarray) -> tuple[np.ndarray, int]:
    """The cells of a block of float16 values (z, y, x) as `with_distances` gives them, and their edge."""
    edge = cell_edge(values.shape)
    return with_distances(majorants(values, edge)), edge
