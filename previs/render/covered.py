"""Which part of a picture the media can be seen in: rectangles around what is occupied of every volume.

Software marches all pixels of a block together and skips none of them by a branch. What is never drawn costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .pieces import Box

#: Side of the square tiles in which it is told what is covered, in pixels.
TILE = 16


def covered_boxes(
    spheres: Iterable[tuple[np.ndarray, float]], view_projection: np.ndarray, size: tuple[int, int]
) -> list[Box] | None:
    """Rectangles that cover the projections of spheres, none of which overlap; None where that is the whole picture.

    Args:
        spheres: centres (N, 3) and their common radius, of each volume.
        view_projection: 4×4, row vectors, from the space of the centres to clip space; orthographic or perspective.
        size: (width, height) of the picture in pixels.

    Returns:
        (x, y, width, height) in pixels from the lower left.
    """
    width, height = size
    columns, rows = -(-width // TILE), -(-height // TILE)
    # Number of spheres at a tile, from where it changes: one more at a corner and its opposite, one less at the others.
    changes = np.zeros((rows + 1, columns + 1), np.int64)
    for centres, radius in spheres:
        clip = centres @ view_projection[:3] + view_projection[3]
        reach = radius * np.linalg.norm(view_projection[:3], axis=0)
        near, far = clip[:, 3] - reach[3], clip[:, 3] + reach[3]
        if near.min(initial=np.inf) <= 1e-6 * max(float(np.abs(far).max(initial=0.0)), 1e-30):
            return None
        ranges = []
        for axis, pixels, tiles in ((0, width, columns), (1, height, rows)):
            low, high = clip[:, axis] - reach[axis], clip[:, axis] + reach[axis]
            # The quotient's bounds: the far denominator where it brings the end closer to the middle.
            low = low / np.where(low < 0.0, near, far)
            high = high / np.where(high > 0.0, near, far)
            # A pixel more on both sides, for rounding.
            first = np.floor(((0.5 * low + 0.5) * pixels - 1.0) / TILE)
            last = np.floor(((0.5 * high + 0.5) * pixels + 1.0) / TILE)
            ranges.append((first, last, tiles))
        (x0, x1, _), (y0, y1, _) = ranges
        seen = (x1 >= 0) & (x0 < columns) & (y1 >= 0) & (y0 < rows)
        x0, x1 = (np.clip(x[seen], 0, columns - 1).astype(np.int64) for x in (x0, x1))
        y0, y1 = (np.clip(y[seen], 0, rows - 1).astype(np.int64) for y in (y0, y1))
        for y, x, sign in ((y0, x0, 1), (y1 + 1, x1 + 1, 1), (y0, x1 + 1, -1), (y1 + 1, x0, -1)):
            np.add.at(changes, (y, x), sign)
    covered = changes.cumsum(axis=0).cumsum(axis=1)[:rows, :columns] > 0
    if covered.all():
        return None
    boxes: list[Box] = []
    open_runs: dict[tuple[int, int], int] = {}
    for row in range(rows + 1):
        edges = np.diff(np.concatenate([[0], covered[row].astype(np.int8), [0]])) if row < rows else np.zeros(1)
        runs = set(zip(np.flatnonzero(edges > 0).tolist(), np.flatnonzero(edges < 0).tolist(), strict=True))
        for run in [r for r in open_runs if r not in runs]:
            boxes.append(_box(run, open_runs.pop(run), row, width, height))
        for run in runs:
            open_runs.setdefault(run, row)
    return boxes


def _box(run: tuple[int, int], first: int, last: int, width: int, height: int) -> Box:
    """The pixels of tiles in columns `run` and rows from `first` to before `last`."""
    x, y = run[0] * TILE, first * TILE
    return x, y, min(run[1] * TILE, width) - x, min(last * TILE, height) - y


def common(a: Box | None, b: Box) -> Box | None:
    """What two rectangles have in common, None where that is nothing; the first may be None for everything."""
    if a is None:
        return b
    x, y = max(a[0], b[0]), max(a[1], b[1])
    width, height = min(a[0] + a[2], b[0] + b[2]) - x, min(a[1] + a[3], b[1] + b[3]) - y
    return (x, y, width, height) if width > 0 and height > 0 else None
