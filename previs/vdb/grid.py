"""A sparse voxel grid in memory: 8³ leaves, larger constant tiles, a background and a transform.

Nothing here knows about files. Values sit at integer index coordinates and arrays are indexed [x, y, z]; world is
``[i j k 1] @ index_to_world`` (row vectors). A grid is immutable and its arrays may be shared with other grids (an
instance shares the tree of its parent): copy before writing into them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from .layout import LEAF_MASK_BYTES, LEAF_SIZE, LEAF_VOXELS, VALUE_SPECS, ValueSpec

DENSE_LIMIT = 1 << 28
"""Voxels that :meth:`Grid.dense` makes at most unless told otherwise: 1 GB of float32."""


@dataclass(frozen=True, eq=False)
class Tiles:
    """Cubes of one value each, that take no leaves.

    ``origin`` (T, 3) int32 is the lowest index of each, ``size`` (T,) int32 its side (8, 128 or 4096 voxels, origins
    are multiples of it), ``value`` (T,) or (T, 3).
    """

    origin: np.ndarray
    size: np.ndarray
    value: np.ndarray

    def __len__(self) -> int:
        return len(self.size)

    @classmethod
    def none(cls, spec: ValueSpec) -> Tiles:
        """No tiles, for values of the given kind."""
        return cls(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros((0, *spec.shape), spec.scalar))


class _LeafActive:
    """The field ``leaf_active`` of a grid: booleans, held as the bits that a file has of them."""

    def __get__(self, grid: Grid | None, owner: type | None = None) -> np.ndarray:
        if grid is None:
            raise AttributeError("leaf_active")  # says that the field has no default
        masks = grid.leaf_masks
        if masks.dtype != np.uint8 or masks.shape[1:] != (LEAF_MASK_BYTES,):
            return masks  # nothing that a grid can be made of, and refused where it is written
        active = np.unpackbits(masks, axis=1, bitorder="little").view(bool)
        # A copy that looks like the grid's own: what is written into it would be lost without a word.
        active.flags.writeable = False
        return active.reshape(-1, LEAF_SIZE, LEAF_SIZE, LEAF_SIZE)

    def __set__(self, grid: Grid, active: np.ndarray) -> None:
        active = np.asarray(active)
        if active.dtype == bool and active.shape[1:] == (LEAF_SIZE,) * 3:
            active = np.packbits(active.reshape(-1, LEAF_VOXELS), axis=1, bitorder="little")
        grid.__dict__["_leaf_masks"] = active


@dataclass(frozen=True, eq=False)
class Grid:
    """One grid: everything that OpenVDB would answer about its voxels.

    * ``name``: str, may be empty, unicode, or shared by several grids of a file;
    * ``index_to_world``: (4, 4) float64, row vectors, translation in the last row, stage units;
    * ``leaf_origins``: (L, 3) int32, multiples of 8;
    * ``leaf_values``: (L, 8, 8, 8) [x, y, z], float32, float64, int32 or int64, with a last axis of 3 for vectors;
      inactive voxels keep their values here;
    * ``leaf_active``: (L, 8, 8, 8) bool, read-only. Held as bits and made anew whenever it is asked for, so ask once;
      a grid may be made of the bits too, (L, 64) uint8 as in ``leaf_masks``;
    * ``background``: the value everywhere else (a Python number, or a tuple of three);
    * ``tiles``, ``inactive_tiles``: :class:`Tiles`; of the inactive ones only those that differ from the background;
    * ``grid_class``: "fog volume", "level set", "staggered" or "unknown";
    * ``value_type``: "float", "double", "int32", "int64", "vec3s", "vec3d" or "vec3i";
    * ``index``: int, tells same-named grids of a file apart (USD's ``fieldIndex``): the ``index`` metadata that
      Houdini writes, else the position among the grids of that name;
    * ``metadata``: the file's metadata of this grid, as Python values.
    """

    name: str
    index_to_world: np.ndarray
    leaf_origins: np.ndarray
    leaf_values: np.ndarray
    leaf_active: np.ndarray = _LeafActive()  # type: ignore[assignment]
    background: Any = 0.0
    tiles: Tiles = field(default=None)  # type: ignore[assignment]  # none, of the grid's value type
    inactive_tiles: Tiles = field(default=None)  # type: ignore[assignment]
    grid_class: str = "unknown"
    value_type: str = "float"
    index: int = 0
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for attribute in ("tiles", "inactive_tiles"):
            if getattr(self, attribute) is None:
                object.__setattr__(self, attribute, Tiles.none(self.spec))

    def __repr__(self) -> str:
        return (
            f"Grid({self.name!r}, index={self.index}, {self.value_type}, {self.grid_class}, "
            f"{len(self.leaf_origins)} leaves, {len(self.tiles)} tiles, {self.active_count} active voxels)"
        )

    @property
    def leaf_masks(self) -> np.ndarray:
        """(L, 64) uint8, the bits of ``leaf_active``: byte 8x + y of a leaf holds the voxels along z, the first of
        which is the lowest bit."""
        return self.__dict__["_leaf_masks"]

    @property
    def spec(self) -> ValueSpec:
        """The kind of value that the grid holds."""
        return VALUE_SPECS[self.value_type]

    @cached_property
    def active_count(self) -> int:
        """The number of active voxels, those inside tiles included."""
        sizes = self.tiles.size.astype(np.int64)
        return int(np.bitwise_count(self.leaf_masks).sum(dtype=np.int64)) + int((sizes**3).sum())

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The inclusive index box (lo, hi) of the active voxels, tiles included: two (3,) int64, None if none is."""
        lows, highs = [], []
        occupied = np.flatnonzero(self.leaf_masks.any(axis=1))
        if len(occupied):
            origins = self.leaf_origins[occupied].astype(np.int64)
            low, high = np.empty(3, np.int64), np.empty(3, np.int64)
            for axis in range(3):
                # Only the outermost leaves decide: no need to look into all the others.
                first, last = origins[:, axis].min(), origins[:, axis].max()
                low[axis] = first + self._layers(occupied[origins[:, axis] == first], axis)[0]
                high[axis] = last + self._layers(occupied[origins[:, axis] == last], axis)[-1]
            lows.append(low)
            highs.append(high)
        if len(self.tiles):
            origins = self.tiles.origin.astype(np.int64)
            lows.append(origins.min(axis=0))
            highs.append((origins + self.tiles.size[:, None] - 1).max(axis=0))
        if not lows:
            return None
        return np.min(lows, axis=0), np.max(highs, axis=0)

    def _layers(self, leaves: np.ndarray, axis: int) -> np.ndarray:
        """The layers along an axis, 0 to 7, in which any of the leaves has an active voxel."""
        bits = np.bitwise_or.reduce(self.leaf_masks[leaves], axis=0)
        active = np.unpackbits(bits, bitorder="little").reshape(LEAF_SIZE, LEAF_SIZE, LEAF_SIZE)
        return np.flatnonzero(active.any(axis=tuple({0, 1, 2} - {axis})))

    def dense(
        self,
        lo: ArrayLike,
        hi: ArrayLike,
        limit: int = DENSE_LIMIT,
        *,
        dtype: DTypeLike = None,
        divisor: float = 1.0,
        order: Literal["C", "F"] = "C",
    ) -> np.ndarray:
        """The values of an index box as one array.

        ``lo`` and ``hi`` are three integers each, both inclusive; the box may reach beyond the grid. The result is
        (hi − lo + 1) voxels [x, y, z], with a last axis of 3 for vectors: for each voxel what OpenVDB's accessor
        returns, so inactive voxels have their stored value and everything outside has the background.

        Values are divided by ``divisor``, integers as float32, and converted to ``dtype`` (default: the grid's own)
        before they are spread out: a box that is mostly background costs little more than its leaves. ``order`` is
        that of the memory: "C" has z fastest, "F" has x.

        Raises ValueError if ``hi`` is below ``lo`` or the box has more than ``limit`` voxels (default 2²⁸): a grid
        of a kilobyte may span thousands of voxels along each axis.
        """
        low, high = (_index_triple(v) for v in (lo, hi))
        shape = tuple(b - a + 1 for a, b in zip(low, high, strict=True))
        if min(shape) < 1:
            raise ValueError(f"grid {self.name!r}: the box {low} to {high} is empty")
        count = shape[0] * shape[1] * shape[2]
        if count > limit:
            raise ValueError(
                f"grid {self.name!r}: a dense array of {shape[0]}×{shape[1]}×{shape[2]} voxels is over the limit "
                f"of {limit} voxels; ask for a smaller box or raise the limit"
            )
        scalar = np.dtype(self.spec.scalar if dtype is None else dtype)

        def converted(values: np.ndarray) -> np.ndarray:
            if divisor != 1.0:
                real = values if values.dtype.kind == "f" else values.astype(np.float32)
                values = real / real.dtype.type(divisor)
            return values.astype(scalar, copy=False)

        try:
            # Zeroed memory costs nothing where it stays untouched.
            out = np.zeros((*shape, *self.spec.shape), scalar, order)
        except MemoryError:
            raise ValueError(f"grid {self.name!r}: there is no memory for {count} voxels") from None
        if np.any(self.background):
            out[...] = converted(np.asarray(self.background, self.spec.scalar))
        lower, upper = np.array(low, np.int64), np.array(high, np.int64)
        for tiles in (self.inactive_tiles, self.tiles):
            _paint_tiles(out, lower, upper, replace(tiles, value=converted(tiles.value)))
        leaves = converted(self.leaf_values)
        if order == "F":
            # Leaves in the order of the box: what is copied then lies together on both sides.
            leaves = np.ascontiguousarray(leaves.swapaxes(1, 3)).swapaxes(1, 3)
        _paint_leaves(out, lower, upper, self.leaf_origins, leaves)
        return out

    @classmethod
    def from_dense(
        cls,
        name: str,
        array: ArrayLike,
        index_to_world: ArrayLike | None = None,
        background: float = 0.0,
        origin: ArrayLike = (0, 0, 0),
        grid_class: str = "fog volume",
        metadata: Mapping[str, Any] | None = None,
    ) -> Grid:
        """A sparse grid of a NumPy array.

        ``array`` is (X, Y, Z), or (X, Y, Z, 3) for vectors, of any real type: stored as float32. ``index_to_world``
        is (4, 4) with row vectors, default identity; ``origin`` the index of ``array[0, 0, 0]``. A voxel is active
        where its value differs from ``background``; leaves without an active voxel are dropped.

        Raises ValueError for an array of another shape or a matrix that is not affine and invertible.
        """
        array = np.asarray(array)
        if array.ndim not in (3, 4) or (array.ndim == 4 and array.shape[3] != 3):
            raise ValueError(f"grid {name!r}: the array must be (X, Y, Z) or (X, Y, Z, 3), not {array.shape}")
        if array.dtype.kind not in "fiub":
            raise ValueError(f"grid {name!r}: the array must hold real numbers, not {array.dtype}")
        spec = VALUE_SPECS["float" if array.ndim == 3 else "vec3s"]
        matrix = affine_matrix(np.eye(4) if index_to_world is None else index_to_world, f"grid {name!r}")
        low = np.array(_index_triple(origin), np.int64)
        high = low + array.shape[:3]
        if low.min() < -(1 << 31) or high.max() >= 1 << 31:
            raise ValueError(f"grid {name!r}: index coordinates must fit 32 bits")

        # Pad to whole leaves, which start at multiples of 8 whatever the origin is.
        first = low // LEAF_SIZE
        blocks = -(-high // LEAF_SIZE) - first if array.size else np.zeros(3, np.int64)
        fill = np.asarray(background, spec.scalar)
        inset = low - first * LEAF_SIZE
        padded = np.empty((*(blocks * LEAF_SIZE), *spec.shape), spec.scalar)
        if not np.array_equal(padded.shape[:3], array.shape[:3]):
            padded[...] = fill
        if array.size:
            padded[tuple(slice(int(i), int(i) + n) for i, n in zip(inset, array.shape[:3], strict=True))] = array
        bx, by, bz = (int(b) for b in blocks)
        split = padded.reshape(bx, LEAF_SIZE, by, LEAF_SIZE, bz, LEAF_SIZE, *spec.shape)
        differs = split != fill
        if spec.components > 1:
            differs = differs.any(axis=-1)
        kept = np.argwhere(differs.any(axis=(1, 3, 5)))
        axes = (0, 2, 4, 1, 3, 5)
        at = tuple(kept.T)
        return cls(
            name=name,
            index_to_world=matrix,
            leaf_origins=((kept + first) * LEAF_SIZE).astype(np.int32),
            leaf_values=np.ascontiguousarray(split.transpose(*axes, *range(6, split.ndim))[at]),
            leaf_active=np.ascontiguousarray(differs.transpose(axes)[at]),
            background=fill.item() if spec.components == 1 else tuple(np.broadcast_to(fill, 3).tolist()),
            grid_class=grid_class,
            value_type=spec.name,
            metadata=dict(metadata or {}),
        )


def affine_matrix(matrix: ArrayLike, owner: str) -> np.ndarray:
    """A checked (4, 4) float64 copy; ValueError, opening with ``owner``, if not finite, affine and invertible."""
    checked = np.array(matrix, dtype=np.float64)
    if checked.shape != (4, 4) or not np.isfinite(checked).all():
        raise ValueError(f"{owner}: the transform must be a finite 4×4 matrix")
    if not np.array_equal(checked[:, 3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError(f"{owner}: the transform is not affine with row vectors (last column 0 0 0 1)")
    if abs(np.linalg.det(checked[:3, :3])) == 0.0:
        raise ValueError(f"{owner}: the transform is singular")
    return checked


def _index_triple(values: ArrayLike) -> tuple[int, int, int]:
    array = np.asarray(values)
    if array.shape != (3,) or array.dtype.kind not in "iu":
        raise ValueError(f"an index is three integers, not {values!r}")
    x, y, z = (int(v) for v in array)
    return x, y, z


def _paint_tiles(out: np.ndarray, low: np.ndarray, high: np.ndarray, tiles: Tiles) -> None:
    origins, sizes = tiles.origin.astype(np.int64), tiles.size.astype(np.int64)
    small = sizes == LEAF_SIZE
    if small.any():
        # An 8³ tile is a leaf of one value: there may be very many, so they take the leaves' vectorised way.
        values = tiles.value[small]
        blocks = np.broadcast_to(
            values.reshape(len(values), 1, 1, 1, *values.shape[1:]), (len(values), 8, 8, 8, *values.shape[1:])
        )
        _paint_leaves(out, low, high, tiles.origin[small], blocks)
    large = ~small & (origins <= high).all(axis=1) & (origins + sizes[:, None] > low).all(axis=1)
    for i in np.flatnonzero(large):
        start = np.maximum(origins[i] - low, 0)
        stop = origins[i] + sizes[i] - low
        out[tuple(slice(int(a), int(b)) for a, b in zip(start, stop, strict=True))] = tiles.value[i]


def _paint_leaves(
    out: np.ndarray, low: np.ndarray, high: np.ndarray, leaf_origins: np.ndarray, leaf_values: np.ndarray
) -> None:
    origins = leaf_origins.astype(np.int64)
    touching = ((origins <= high) & (origins + LEAF_SIZE > low)).all(axis=1)
    # The part of the box made of whole leaves is painted at once; only leaves that its faces cut are painted singly.
    first = -(-low // LEAF_SIZE) * LEAF_SIZE
    last = (high + 1) // LEAF_SIZE * LEAF_SIZE
    whole = touching & ((origins >= first) & (origins < last)).all(axis=1)
    if whole.any():
        corner = out[tuple(slice(int(a), int(b)) for a, b in zip(first - low, last - low, strict=True))]
        bx, by, bz = (int(n) for n in (last - first) // LEAF_SIZE)
        trailing = out.shape[3:]
        blocks = corner.reshape(bx, LEAF_SIZE, by, LEAF_SIZE, bz, LEAF_SIZE, *trailing, copy=False)
        blocks = blocks.transpose(0, 2, 4, 1, 3, 5, *range(6, blocks.ndim))
        at = (origins[whole] - first) // LEAF_SIZE
        if whole.all():
            blocks[tuple(at.T)] = leaf_values
        else:
            blocks[tuple(at.T)] = leaf_values[whole]
    cut = np.flatnonzero(touching & ~whole)
    starts = np.maximum(origins[cut] - low, 0).tolist()
    stops = np.minimum(origins[cut] + LEAF_SIZE - low, high - low + 1).tolist()
    skips = np.maximum(low - origins[cut], 0).tolist()
    for i, (x, y, z), (x1, y1, z1), (sx, sy, sz) in zip(cut.tolist(), starts, stops, skips, strict=True):
        out[x:x1, y:y1, z:z1] = leaf_values[i, sx : sx + x1 - x, sy : sy + y1 - y, sz : sz + z1 - z]
