"""Sparse fields in bricks: what is not background is stored in cubes of voxels, found through a table.

A brick of edge B covers B intervals between voxels along each axis and is read from (B + 1)³ texels: the last layer of
each axis is the first of the next brick, so that the trilinear filter of the texture unit is exact inside a brick.
Bricks lie on multiples of B in index space, as the leaves of a grid lie on multiples of 8. A brick that is all
background is not stored; those inside large tiles of one value share one. The table has two levels: pages of 8³
entries, and a directory of pages; pages without bricks are not stored either.

The dense array is never made: leaves are taken a batch at a time.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..description import SparseGrid
from .brick_layout import MOST_TEXELS, Layout, lay_out
from .cells import cell_counts, cell_edge, with_distances

#: Edges that bricks may have, in voxels.
EDGES = (8, 16, 32)
#: Bytes of a brick's entry in the table.
ENTRY_BYTES = 4
#: Bricks that a box may span at the most.
MOST_ENTRIES = 2**26
#: Bricks along a page of the table.
PAGE = 8
#: The entry where nothing is stored; else where it begins: 11 bits along x, 11 along y, 10 along z.
NO_BRICK = 0xFFFFFFFF

#: The table of a dense block: one page, behind a directory of one, of one brick that begins with the block.
ONE_BRICK = np.array([[[1 << 22]], [[0]]], np.uint32)

_LEAF = 8
_PART = 4  # edge of the parts of a leaf whose majorants are told apart
_BATCH = 1024  # leaves taken at a time: what they need for it stays small beside them
_MAGNITUDE = np.uint16(0x7FFF)
_SIDES = tuple(itertools.product((0, 1), repeat=3))


@dataclass(frozen=True, eq=False)
class Bricks:
    """How the texels of a block of bricks are found.

    `table` is uint32 of shape (z, y, x) and begins with the directory: for every page the texel of the table at which
    it begins, or `NO_BRICK`. An entry of a page is the texel of the block at which the brick begins, or `NO_BRICK`. The
    box of the field spans `intervals` (3,) intervals between voxels along x, y, z; box coordinate b is
    ``b · intervals / edge + shift`` bricks from the first of the first page. `background` is the value, relative to the
    field's scale, where no brick is stored.
    """

    edge: int
    table: np.ndarray
    intervals: np.ndarray
    shift: np.ndarray
    background: float


class _Shared(NamedTuple):
    """Bricks of the box [x, y, z] from `first` up to and without `end`, all of one value."""

    first: np.ndarray
    end: np.ndarray
    value: np.float16

    def bricks(self, divisor: int = 1) -> np.ndarray:
        """All of them (n, 3), or the cubes of so many along an edge that they lie in."""
        spans = [np.arange(a // divisor, (b - 1) // divisor + 1) for a, b in zip(self.first, self.end, strict=True)]
        return np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 3)


class _Pages(NamedTuple):
    """The pages of a table: their places, sorted, in the flattened directory (z, y, x), which has `along` of them."""

    places: np.ndarray
    along: np.ndarray

    @property
    def _side(self) -> int:
        return max(int(np.ceil(len(self.places) ** (1.0 / 3.0) - 1e-9)), 1)

    @property
    def size(self) -> tuple[int, int, int]:
        """Texels of the table along x, y, z: the directory, and the pages behind it."""
        side, (x, y, z) = self._side, (int(n) for n in self.along)
        return max(x, side * PAGE), max(y, side * PAGE), z + -(-len(self.places) // side**2) * PAGE

    def begins(self, number: np.ndarray) -> np.ndarray:
        """The texels (n, 3) at which pages begin."""
        side = self._side
        x, y, z = number % side, number // side % side, number // side**2
        return np.stack([x * PAGE, y * PAGE, z * PAGE + self.along[2]], axis=-1)


class _Wanted(NamedTuple):
    """The bricks of one edge: where those with voxels of their own are in the flattened box (z, y, x), and those that
    share one."""

    places: np.ndarray
    shared: list[_Shared]


class Occupancy:
    """What a scalar grid needs to be held in bricks: its peak, and which bricks there are of each edge.

    `lo` and `hi` are the box that is held, both ends included: the active one and a voxel around it. Values are
    relative to `scale`, and `background` is one of them.

    Args:
        grid: of finite values and at least one active voxel.
    """

    def __init__(self, grid: SparseGrid) -> None:
        lo, hi = (np.asarray(b, np.int64) for b in grid.bounds)
        self.lo, self.hi = lo - 1, hi + 1
        self.scale = value_scale(grid)
        self.background = self._half(np.asarray(grid.background, grid.leaf_values.dtype))
        self._wanted = self._find(grid)
        self._layouts: dict[tuple[int, int], Layout | None] = {}
        self._lock = threading.Lock()
        self._tables: dict[int, _Pages] = {}

    def first(self, edge: int) -> np.ndarray:
        """The first brick of the box along x, y, z, in bricks from index 0."""
        return self.lo // edge

    def counts(self, edge: int) -> np.ndarray:
        """Bricks that the box spans along x, y, z."""
        return (self.hi - 1) // edge - self.first(edge) + 1

    def layout(self, edge: int, texture_limit: int) -> Layout | None:
        """Where the bricks are in the block: those with voxels of their own, then one for each value that is shared.
        None where the largest texture does not hold it or the table."""
        key = edge, texture_limit
        with self._lock:
            if key not in self._layouts:
                self._layouts[key] = self._lay_out(edge, texture_limit)
            return self._layouts[key]

    def _lay_out(self, edge: int, texture_limit: int) -> Layout | None:
        counts, table = self.counts(edge), self._pages(edge).size
        if any(n > min(most, texture_limit) for n, most in zip(table, MOST_TEXELS, strict=True)):
            return None
        places, shared = self._wanted[edge]
        bricks = _apart(places, counts)
        # Apart from all others, so that they are joined to none.
        apart = [(0, counts[1] + 8 * (i + 1), 0) for i in range(len({s.value for s in shared}))]
        return lay_out(np.concatenate([bricks, np.reshape(apart, (-1, 3)).astype(int)]), edge, texture_limit)

    def nbytes(self, edge: int, texture_limit: int) -> float:
        """Bytes of the block of bricks and of their table; infinite where the largest texture does not hold them."""
        layout = self.layout(edge, texture_limit)
        if layout is None:
            return np.inf
        return layout.texels * 2 + int(np.prod(self._pages(edge).size)) * ENTRY_BYTES

    def best(self, texture_limit: int) -> tuple[float, int]:
        """(bytes, edge) of the bricks that take the fewest bytes; infinite where no texture holds any."""
        return min(((self.nbytes(e, texture_limit), e) for e in self._wanted), default=(np.inf, 0))

    def find(self, grid: SparseGrid, edge: int, texture_limit: int) -> tuple[Bricks, tuple[np.ndarray, int]]:
        """How bricks of that edge are found; and the cells of the field with their edge."""
        places, shared = self._wanted[edge]
        origins = self._held_layout(edge, texture_limit).origins
        pages, values = self._pages(edge), sorted({s.value for s in shared})
        table = np.full(tuple(reversed(pages.size)), NO_BRICK, np.uint32)
        page = _apart(pages.places, pages.along)
        begins = pages.begins(np.arange(len(page)))
        table[page[:, 2], page[:, 1], page[:, 0]] = _entries(begins)
        chosen = [(_apart(places, self.counts(edge)), origins[: len(places)])]
        chosen += [(s.bricks(), origins[len(places) + values.index(s.value)]) for s in shared]
        for bricks, begin in chosen:
            page = bricks // PAGE
            number = np.searchsorted(pages.places, _joined(page, pages.along))
            x, y, z = (pages.begins(number) + bricks % PAGE).T
            table[z, y, x] = _entries(begin)
        cells = _CellsOfLeaves(self)
        for leaves, held in self._leaves(grid):
            cells.add(leaves, held)
        for origin, size, value in self._large_tiles(grid):
            cells.add_tile(origin, size, self._half(value))
        intervals = (self.hi - self.lo).astype(float)
        shift = (self.lo - self.first(edge) * edge) / edge
        return Bricks(edge, table, intervals, shift, float(self.background)), cells.result()

    def block(self, grid: SparseGrid, edge: int, texture_limit: int) -> np.ndarray:
        """The block of bricks, float16 (z, y, x)."""
        layout = self._held_layout(edge, texture_limit)
        return self._slab(grid, edge, layout, (0, layout.size[2]), None)

    def slabs(self, grid: SparseGrid, edge: int, texture_limit: int, memory: int) -> Iterator[tuple[int, np.ndarray]]:
        """The block in parts of about so many bytes, each with the layer along z at which it begins."""
        layout = self._held_layout(edge, texture_limit)
        layer, begins = layout.size[0] * layout.size[1] * 2, [0]
        for cut, after in itertools.pairwise(layout.cuts[1:]):
            if (after - begins[-1]) * layer > memory:
                begins.append(cut)
        # Which leaves are in which part is found once: most are in one or two.
        leaves, parts = [], []
        for first in range(0, len(grid.leaf_origins), _BATCH):
            at = grid.leaf_origins[first : first + _BATCH].astype(np.int64)
            inside = np.zeros((len(at), len(begins)), bool)
            for _, held, number in self._bricks_of(at, edge):
                inside[held, np.searchsorted(begins, layout.origins[number, 2], "right") - 1] = True
            leaf, part = np.nonzero(inside)
            leaves.append((first + leaf).astype(np.int32))
            parts.append(part.astype(np.int32))
        leaf, part = (np.concatenate([np.zeros(0, np.int32), *found]) for found in (leaves, parts))
        for number, span in enumerate(itertools.pairwise([*begins, layout.size[2]])):
            yield span[0], self._slab(grid, edge, layout, span, leaf[part == number])

    def _pages(self, edge: int) -> _Pages:
        if edge not in self._tables:
            places, shared = self._wanted[edge]
            counts = self.counts(edge)
            along = -(-counts // PAGE)
            held = [_apart(places, counts) // PAGE, *(s.bricks(PAGE) for s in shared)]
            self._tables[edge] = _Pages(np.unique(np.concatenate([_joined(p, along) for p in held])), along)
        return self._tables[edge]

    def _held_layout(self, edge: int, texture_limit: int) -> Layout:
        layout = self.layout(edge, texture_limit)
        assert layout is not None
        return layout

    def _slab(
        self, grid: SparseGrid, edge: int, layout: Layout, span: tuple[int, int], leaves: np.ndarray | None
    ) -> np.ndarray:
        """The layers of the block from the first of `span` up to and without its second; `leaves` are the numbers of
        those that reach into it, None all."""
        (places, shared), (begin, end) = self._wanted[edge], span
        block = np.zeros((end - begin, layout.size[1], layout.size[0]), np.float16)
        if self.background != 0.0:
            block[...] = self.background
        origins = layout.origins - np.array((0, 0, begin), np.int16)
        values = sorted({s.value for s in shared})
        for value, (x, y, z) in zip(values, origins[len(places) :], strict=True):
            if 0 <= z < end - begin:
                block[z : z + edge + 1, y : y + edge + 1, x : x + edge + 1] = value
        for at, held in self._leaves(grid, leaves):
            self._copy(at, held, edge, origins, block)
        for origin, size, value in self._large_tiles(grid):
            for at in _shell(origin, size, edge, self.lo, self.hi):
                held = np.broadcast_to(value, (len(at), _LEAF, _LEAF, _LEAF))
                self._copy(at, held, edge, origins, block)
        return block

    def _half(self, values: np.ndarray) -> np.ndarray:
        values = np.asarray(values)
        if values.dtype.kind != "f":
            values = values.astype(np.float32)
        if self.scale != 1.0:
            values = values / values.dtype.type(self.scale)
        return values.astype(np.float16)

    def _leaves(self, grid: SparseGrid, chosen: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Origins (n, 3) and values (n, 8, 8, 8) [x, y, z] of all leaves, or those of the chosen numbers, and of tiles
        of that size, with background outside the box."""
        for tiles in (grid.inactive_tiles, grid.tiles):
            small = tiles.size == _LEAF
            values = tiles.value[small][:, None, None, None]
            yield from self._clipped(grid, tiles.origin[small], np.broadcast_to(values, (len(values), 8, 8, 8)))
        yield from self._clipped(grid, grid.leaf_origins, grid.leaf_values, chosen)

    def _clipped(
        self, grid: SparseGrid, origins: np.ndarray, values: np.ndarray, chosen: np.ndarray | None = None
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        steps = np.arange(_LEAF)
        for first in range(0, len(origins if chosen is None else chosen), _BATCH):
            batch = slice(first, first + _BATCH)
            if chosen is not None:
                batch = chosen[batch]
            part, held = origins[batch].astype(np.int64), values[batch]
            touching = ((part <= self.hi) & (part + _LEAF > self.lo)).all(axis=1)
            if not touching.all():
                part, held = part[touching], held[touching]
            cut = np.flatnonzero(((part < self.lo) | (part + _LEAF - 1 > self.hi)).any(axis=1))
            if len(cut):
                held = np.array(held)
                at = part[cut][:, :, None] + steps
                inside = (at >= self.lo[:, None]) & (at <= self.hi[:, None])
                inside = inside[:, 0, :, None, None] & inside[:, 1, None, :, None] & inside[:, 2, None, None, :]
                held[cut] = np.where(inside, held[cut], np.asarray(grid.background, held.dtype))
            if len(part):
                yield part, held

    def _large_tiles(self, grid: SparseGrid) -> Iterator[tuple[np.ndarray, int, np.generic]]:
        """Origin, size and value of the tiles larger than a leaf that reach into the box."""
        for tiles in (grid.inactive_tiles, grid.tiles):
            origins, sizes = tiles.origin.astype(np.int64), tiles.size.astype(np.int64)
            inside = ((origins <= self.hi) & (origins + sizes[:, None] > self.lo)).all(axis=1)
            for i in np.flatnonzero(inside & (sizes > _LEAF)):
                yield origins[i], int(sizes[i]), tiles.value[i]

    def _find(self, grid: SparseGrid) -> dict[int, _Wanted]:
        edges = [e for e in EDGES if int(np.prod(self.counts(e))) <= MOST_ENTRIES]
        filled = {e: np.zeros(tuple(self.counts(e)), bool, order="F") for e in edges}
        ground = self.background.view(np.uint16)
        for origins, values in self._leaves(grid):
            bits = self._half(values).view(np.uint16)
            differs = (bits & _MAGNITUDE) != 0 if self.background == 0.0 else bits != ground
            # Eight truth values at once: the voxels along z, of which the first are the lowest byte.
            rows = np.ascontiguousarray(differs).view("<u8")[..., 0]
            for side in _SIDES:
                # A brick repeats the first layer of the next: what is in a leaf's first layer is in both.
                found = rows[:, 0] if side[0] else np.bitwise_or.reduce(rows, axis=1)
                found = found[:, 0] if side[1] else np.bitwise_or.reduce(found, axis=1)
                found = (found & np.uint64(0xFF) if side[2] else found) != 0
                for edge in edges:
                    _mark(filled[edge], origins[found], edge, side, self.first(edge))
        shared: dict[int, list[_Shared]] = {e: [] for e in edges}
        for origin, size, value in self._large_tiles(grid):
            half = self._half(value)
            if half == self.background:
                continue
            for edge in edges:
                most = self.counts(edge)
                first = np.clip(origin // edge - self.first(edge), 0, most)
                before = np.clip(origin // edge - self.first(edge) - 1, 0, most)
                end = np.clip((origin + size) // edge - self.first(edge), 0, most)
                last = np.clip((origin + size) // edge - self.first(edge) - 1, 0, most)
                filled[edge][tuple(slice(a, b) for a, b in zip(before, end, strict=True))] = True
                if (first < last).all():
                    shared[edge].append(_Shared(first, last, half))
        for edge in edges:
            for first, end, _ in shared[edge]:
                filled[edge][tuple(slice(a, b) for a, b in zip(first, end, strict=True))] = False
        return {e: _Wanted(np.flatnonzero(filled[e].transpose(2, 1, 0)), shared[e]) for e in edges}

    def _bricks_of(self, leaves: np.ndarray, edge: int) -> Iterator[tuple[tuple[int, ...], np.ndarray, np.ndarray]]:
        """The bricks with voxels of their own that leaves at (n, 3) are in, and those before them, which have their
        first layers: (on which sides those are before it, numbers of the leaves, numbers of the bricks)."""
        places, counts, first = self._wanted[edge].places, self.counts(edge), self.first(edge)
        if not len(places):
            return
        inset = leaves % edge
        for side in _SIDES:
            held = np.flatnonzero((inset[:, np.array(side, bool)] == 0).all(axis=1))
            brick = leaves[held] // edge - first - side
            inside = ((brick >= 0) & (brick < counts)).all(axis=1)
            held, place = held[inside], _joined(brick[inside], counts)
            number = np.minimum(np.searchsorted(places, place), len(places) - 1)
            found = places[number] == place
            yield side, held[found], number[found]

    def _copy(self, leaves: np.ndarray, values: np.ndarray, edge: int, origins: np.ndarray, block: np.ndarray) -> None:
        """Put leaves into the bricks that hold them, and their first layers into the bricks before, as far as these are
        in the block."""
        inset, targets = leaves % edge, []
        for side, held, number in self._bricks_of(leaves, edge):
            begin = origins[number, 2]
            chosen = (begin >= 0) & (begin < len(block))
            held, number = held[chosen], number[chosen]
            targets.append((side, held, origins[number] + np.where(side, edge, inset[held])))
        needed = np.zeros(len(leaves), bool)
        for _, held, _ in targets:
            needed[held] = True
        if not needed.any():
            return
        # Voxels [x, y, z] to texels [z, y, x].
        halves = self._half(values if needed.all() else values[needed]).transpose(0, 3, 2, 1)
        numbers = np.cumsum(needed) - 1
        for side, held, at in targets:
            layers = sliding_window_view(block, [1 if s else _LEAF for s in reversed(side)], writeable=True)
            part = [slice(0, 1) if s else slice(None) for s in reversed(side)]
            layers[at[:, 2], at[:, 1], at[:, 0]] = halves[(numbers[held], *part)]


def _apart(places: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Places in a flattened box (z, y, x) as (n, 3) along x, y, z."""
    x, y = places % counts[0], places // counts[0] % counts[1]
    return np.stack([x, y, places // (counts[0] * counts[1])], axis=1)


def _joined(at: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The inverse of `_apart`."""
    return (at[:, 2] * counts[1] + at[:, 1]) * counts[0] + at[:, 0]


def _entries(begins: np.ndarray) -> np.ndarray:
    """Entries of a table for texels (..., 3)."""
    return (begins @ (1, 1 << 11, 1 << 22)).astype(np.uint32)


def value_scale(grid: SparseGrid) -> float:
    """What the values of a grid are stored relative to, so that densities far outside the range of a half float keep
    their precision: the largest magnitude; 1 where that is nothing to divide by."""
    held = (grid.background, grid.leaf_values, grid.tiles.value, grid.inactive_tiles.value)
    filled = [a for a in map(np.asarray, held) if a.size]
    peak = max((max(float(a.max()), -float(a.min())) for a in filled), default=0.0)
    return peak if peak > 0.0 and np.isfinite(peak) else 1.0


def _mark(filled: np.ndarray, origins: np.ndarray, edge: int, side: tuple[int, ...], first: np.ndarray) -> None:
    """Mark the bricks that leaves lie in, or those before them on the given sides where a brick begins with a leaf."""
    for axis in range(3):
        if side[axis]:
            origins = origins[origins[:, axis] % edge == 0]
    brick = origins // edge - first - side
    held = ((brick >= 0) & (brick < filled.shape)).all(axis=1)
    filled[tuple(brick[held].T)] = True


def _shell(origin: np.ndarray, size: int, edge: int, lo: np.ndarray, hi: np.ndarray) -> Iterator[np.ndarray]:
    """Origins of the leaves of a tile, inside the box, that are not in shared bricks alone; a layer at a time."""
    begin, end = np.maximum(origin, lo // _LEAF * _LEAF), np.minimum(origin + size, hi + 1)
    x, y, z = (np.arange(a, b, _LEAF) for a, b in zip(begin, end, strict=True))

    def inner(at: np.ndarray, axis: int) -> np.ndarray:
        brick = at // edge
        return (brick > origin[axis] // edge) & (brick < (origin[axis] + size) // edge - 1)

    plane = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    shared = inner(plane[:, 0], 0) & inner(plane[:, 1], 1)
    for layer in z:
        chosen = plane[~shared] if inner(np.asarray(layer), 2) else plane
        for first in range(0, len(chosen), _BATCH):
            part = chosen[first : first + _BATCH]
            yield np.column_stack([part, np.full(len(part), layer)])


class _CellsOfLeaves:
    """The cells of a field, from its leaves: bounds, as a quarter of a leaf's edge is the finest that is looked at."""

    def __init__(self, occupancy: Occupancy) -> None:
        self._lo, self._half = occupancy.lo, occupancy._half
        size = tuple(int(n) for n in occupancy.hi - occupancy.lo + 1)
        self._edge = cell_edge(size)
        self._counts = np.array(cell_counts(size, self._edge))
        ground = occupancy.background.view(np.uint16) & _MAGNITUDE
        self._bits = np.full(tuple(reversed(self._counts)), ground, np.uint16)

    def _span(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cells, both ends included, that read any of the texels from first to last."""
        low = (first - self._lo - 1) // self._edge
        return np.clip(low, 0, self._counts - 1), np.clip((last - self._lo) // self._edge, 0, self._counts - 1)

    def add(self, origins: np.ndarray, values: np.ndarray) -> None:
        """Take leaves into account."""
        parts = _LEAF // _PART
        split = values.reshape(-1, parts, _PART, parts, _PART, parts * _PART)
        # Along the two outer axes first, where many are compared at a time.
        high, low = (f(f(split, axis=2), axis=3).reshape(-1, parts, parts, parts, _PART) for f in (np.max, np.min))
        magnitude = np.maximum(np.abs(high.max(axis=4)), np.abs(low.min(axis=4)))
        at = np.stack(np.meshgrid(*[np.arange(parts) * _PART] * 3, indexing="ij"), axis=-1)
        first = (origins[:, None, None, None] + at).reshape(-1, 3)
        # Rounding keeps the order, so this is the largest of the rounded magnitudes.
        largest = self._half(magnitude).view(np.uint16)
        largest = largest.reshape(-1)
        chosen = largest > 0
        first, largest = first[chosen], largest[chosen]
        low, high = self._span(first, first + _PART - 1)
        flat = self._bits.reshape(-1)
        for side in _SIDES:
            cell = np.where(side, high, low)
            # Where both ends are one cell it is counted once.
            once = ~((low == high) & np.array(side, bool)).any(axis=1)
            place = (cell[once, 2] * self._counts[1] + cell[once, 1]) * self._counts[0] + cell[once, 0]
            np.maximum.at(flat, place, largest[once])

    def add_tile(self, origin: np.ndarray, size: int, value: np.float16) -> None:
        """Take a tile into account."""
        low, high = self._span(origin, origin + size - 1)
        box = tuple(slice(a, b + 1) for a, b in zip(reversed(low), reversed(high), strict=True))
        np.maximum(self._bits[box], value.view(np.uint16) & _MAGNITUDE, out=self._bits[box])

    def result(self) -> tuple[np.ndarray, int]:
        """The cells and their edge, as of a `PackedField`."""
        return with_distances(self._bits.view(np.float16)), self._edge


def least_bytes(grid: SparseGrid) -> int:
    """Bytes that bricks of a scalar grid take at the least, found without looking for where they would lie: those of
    the leaves that are not all background, as every one of them has voxels of its own in any brick."""
    leaves = grid.leaf_values.reshape(-1, _LEAF**3)
    background, count = np.asarray(grid.background, leaves.dtype), 0
    for first in range(0, len(leaves), _BATCH):
        part = leaves[first : first + _BATCH]
        count += int(np.count_nonzero((part.max(axis=1) != background) | (part.min(axis=1) != background)))
    return count * _LEAF**3 * 2


T = TypeVar("T")


class _Held(Generic[T]):
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.found: T | None = None


class _OncePerGrid(Generic[T]):
    """A function of a grid that is called once as long as the grid lives; who asks meanwhile waits."""

    def __init__(self, find: Callable[[SparseGrid], T]) -> None:
        self._find = find
        self._lock = threading.Lock()
        self._known: weakref.WeakKeyDictionary[SparseGrid, _Held[T]] = weakref.WeakKeyDictionary()

    def __call__(self, grid: SparseGrid) -> T:
        with self._lock:
            held = self._known.setdefault(grid, _Held())
        with held.lock:
            if held.found is None:
                held.found = self._find(grid)
            return held.found


#: Of a grid its `Occupancy` and its `least_bytes`.
occupancy = _OncePerGrid(Occupancy)
least_brick_bytes = _OncePerGrid(least_bytes)
