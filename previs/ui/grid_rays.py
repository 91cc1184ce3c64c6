"""The optical depth of a sparse grid along one ray, exactly, without making the grid dense.

A ray is cut at the faces of ever smaller nodes of the grid's tree (4096, 128 and 8 voxels, then single voxels); after
each cut only the pieces near something stored are kept. Inside one cell of voxels a trilinear field is a cubic along a
ray, which two Gauss points integrate exactly. The index of a grid's leaves is made when the grid is first asked for
and is kept as long as the grid.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from ..description import SparseGrid

#: Sides of the tree's nodes, in voxels, coarse to fine; tiles have one of these sides too.
NODE_SIZES = (4096, 128, 8)
#: Pieces of a ray that are made at most of what is occupied; beyond that larger nodes are taken for one cell.
MAX_PIECES = 500_000

_GAUSS2 = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
_CORNERS = np.array([[(i >> a) & 1 for a in range(3)] for i in range(8)], np.int64)


def grid_columns(
    grid: SparseGrid, origin: np.ndarray, direction: np.ndarray, t0: float, t1: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where a ray meets the field, and how much of it.

    Args:
        grid: scalar voxels; values below 0 count as 0.
        origin: (3,) in the grid's index space.
        direction: (3,), index coordinates per unit of the ray's parameter; not zero.
        t0, t1: the interval of the parameter that counts.

    Returns:
        Start (P,), end (P,) and ∫ density dt (P,) of the pieces of the ray that may hold something, in order and
        without overlap.
    """
    nothing = np.zeros(0), np.zeros(0), np.zeros(0)
    if grid.active_count == 0:
        return nothing
    # As `Field` defines it: the field ends one voxel outside the active box.
    lo, hi = (np.asarray(b, float) + side for b, side in zip(grid.bounds, (-1.0, 1.0), strict=True))
    entry, exit_ = _clip_to_box(origin, direction, lo, hi, t0, t1)
    if not entry < exit_:
        return nothing
    # From where the ray enters: a camera may be far away, in voxels.
    origin = origin + entry * direction
    start, end = np.array([0.0]), np.array([exit_ - entry])
    tree = _tree(grid)
    for size in (*NODE_SIZES, 1):
        # The coarsest cut is always made: 32-bit indices bound it, and it finds what little a vast grid holds.
        if size < NODE_SIZES[0] and float((end - start).sum() * np.abs(direction).sum()) / size > MAX_PIECES:
            break
        start, end = _cut(start, end, origin, direction, size)
        if size > 1 and tree.background == 0.0:
            middle = origin + 0.5 * (start + end)[:, None] * direction
            keep = tree.occupied(np.floor(middle / size).astype(np.int64), size)
            start, end = start[keep], end[keep]
    length = end - start
    cell = np.floor(origin + 0.5 * (start + end)[:, None] * direction).astype(np.int64)
    corners = tree.values((cell[:, None, :] + _CORNERS).reshape(-1, 3)).reshape(-1, 8)
    total = np.zeros(len(start))
    for node in _GAUSS2:
        inside = np.clip(origin + (start + node * length)[:, None] * direction - cell, 0.0, 1.0)[:, None, :]
        weights = np.where(_CORNERS == 1, inside, 1.0 - inside).prod(axis=2)
        total += np.maximum((weights * corners).sum(axis=1), 0.0)
    return start + entry, end + entry, 0.5 * length * total


def _clip_to_box(
    origin: np.ndarray, direction: np.ndarray, lo: np.ndarray, hi: np.ndarray, t0: float, t1: float
) -> tuple[float, float]:
    """The part of [t0, t1] in which a ray is inside a box; entry > exit where it misses."""
    for o, d, a, b in zip(origin.tolist(), direction.tolist(), lo.tolist(), hi.tolist(), strict=True):
        if d == 0.0:
            if not a <= o <= b:
                return np.inf, -np.inf
        else:
            near, far = sorted(((a - o) / d, (b - o) / d))
            t0, t1 = max(t0, near), min(t1, far)
    return (t0, t1) if t0 <= t1 else (np.inf, -np.inf)


def _cut(
    start: np.ndarray, end: np.ndarray, origin: np.ndarray, direction: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cut intervals, in order and disjoint, where the ray crosses the planes at multiples of `size`."""
    cuts = [start, end]
    for o, d in zip(origin.tolist(), direction.tolist(), strict=True):
        if d == 0.0:
            continue
        a, b = (o + start * d) / size, (o + end * d) / size
        first = np.ceil(np.minimum(a, b))
        count = np.maximum(np.floor(np.maximum(a, b)) - first + 1.0, 0.0).astype(np.int64)
        piece = np.repeat(np.arange(len(start)), count)
        step = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)
        t = ((first[piece] + step) * size - o) / d
        cuts.append(np.minimum(np.maximum(t, start[piece]), end[piece]))
    t = np.sort(np.concatenate(cuts))
    t0, t1 = t[:-1], t[1:]
    middle = 0.5 * (t0 + t1)
    within = np.searchsorted(start, middle, "right") - 1
    # What lies between two of the intervals is not theirs.
    keep = (t1 > t0) & (within >= 0) & (middle < end[within])
    return t0[keep], t1[keep]


class _Places:
    """Finds rows of integer coordinates (N, 3) by their values."""

    def __init__(self, coordinates: np.ndarray) -> None:
        coordinates = np.asarray(coordinates, np.int64).reshape(-1, 3)
        keys = _keys(coordinates)
        self._order = np.argsort(keys, kind="stable")
        self._sorted = keys[self._order]
        self._coordinates = coordinates

    def find(self, coordinates: np.ndarray) -> np.ndarray:
        """The row of each of (M, 3) coordinates, −1 for those that are not there."""
        if len(self._sorted) == 0:
            return np.full(len(coordinates), -1)
        at = np.searchsorted(self._sorted, _keys(coordinates))
        row = self._order[np.minimum(at, len(self._order) - 1)]
        # Keys wrap around in grids of more than two million nodes along an axis.
        return np.where((self._coordinates[row] == coordinates).all(axis=1), row, -1)


def _keys(coordinates: np.ndarray) -> np.ndarray:
    x, y, z = coordinates.T
    return x + (y << 21) + (z << 42)


class _Tree:
    """Which nodes of a grid hold something, and the value of any voxel."""

    def __init__(self, grid: SparseGrid) -> None:
        # Active tiles lie over inactive ones.
        stored = (grid.tiles, grid.inactive_tiles)
        origins = np.concatenate([np.asarray(t.origin, np.int64).reshape(-1, 3) for t in stored])
        sizes = np.concatenate([t.size for t in stored])
        self._tile_values = np.concatenate([t.value for t in stored])
        self._tiles = []
        for size in NODE_SIZES:
            rows = np.flatnonzero(sizes == size)
            if len(rows):
                self._tiles.append((size, rows, _Places(origins[rows] // size)))
        self._leaf_values = grid.leaf_values
        self.background = float(grid.background)
        nodes, self._nodes = np.asarray(grid.leaf_origins, np.int64).reshape(-1, 3) // 8, {}
        self._leaves = self._nodes[8] = _Places(nodes)
        previous = 8
        for size in reversed(NODE_SIZES[:-1]):
            small = origins[sizes == previous] // size
            # Leaves come in the order of their tree: most repetitions are neighbours, and a sort sees few rows.
            nodes = np.concatenate([nodes // (size // previous), small])
            nodes = nodes[np.append(True, (nodes[1:] != nodes[:-1]).any(axis=1))] if len(nodes) else nodes
            nodes = np.unique(nodes, axis=0)
            self._nodes[size] = _Places(nodes)
            previous = size

    def occupied(self, nodes: np.ndarray, size: int) -> np.ndarray:
        """Whether anything is stored for the cells in nodes (N, 3) of a size: they reach one voxel into the next."""
        found = np.zeros(len(nodes), bool)
        for corner in _CORNERS:
            near = nodes + corner
            found |= self._nodes[size].find(near) >= 0
            for side, _, places in self._tiles:
                if side >= size:
                    found |= places.find(near * size // side) >= 0
        return found

    def values(self, voxels: np.ndarray) -> np.ndarray:
        """The values of voxels (N, 3), (N,) float64."""
        leaf = self._leaves.find(voxels >> 3)
        result = np.full(len(voxels), self.background)
        held = leaf >= 0
        x, y, z = (voxels[held] & 7).T
        result[held] = self._leaf_values[leaf[held], x, y, z]
        for size, rows, places in self._tiles:
            missing = np.flatnonzero(~held)
            row = places.find(voxels[missing] // size)
            found = row >= 0
            result[missing[found]] = self._tile_values[rows[row[found]]]
            held[missing[found]] = True
        return result


_TREES: WeakKeyDictionary[SparseGrid, _Tree] = WeakKeyDictionary()


def _tree(grid: SparseGrid) -> _Tree:
    tree = _TREES.get(grid)
    if tree is None:
        tree = _TREES[grid] = _Tree(grid)
    return tree
