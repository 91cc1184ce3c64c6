"""Sparse grids as blocks for the GPU: padded, normalised, in half floats, dense or in bricks, and reduced
where too large.

A packed field covers the active box and one voxel around it, where the field falls to its background, so that the
trilinear filter of the texture unit gives the field as it is defined and nothing outside it is ever needed.
"""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..description import Field
from .bricks import Bricks, least_brick_bytes, occupancy, value_scale
from .cells import cell_counts, cell_edge, cells_of

#: Largest edge of a 3D texture assumed when a plan is made without a device; GL 3.3 drivers in use offer this.
DEFAULT_TEXTURE_LIMIT = 2048
#: Memory for fields that were packed ahead and may be wanted again, bytes.
STORE_MEMORY = 2**30
#: Blocks of more bytes are not kept in memory once they are uploaded.
LARGE_BLOCK = 2**26
#: Bytes that are converted at a time of those that come in slabs.
SLAB = 2**24
_LEAVES = 4096  # averaged at a time
#: What the fields are used for that may be held in bricks.
SPARSE_ROLES = frozenset({"density"})
#: A field is held in bricks where they take less than this part of the dense block's bytes, ...
WORTH_BRICKS = 0.7
#: ... and so many less at the least: a march through bricks takes longer, by a third where they are full.
LEAST_TO_SPARE = 2**25


@dataclass(frozen=True, eq=False)
class PackedField:
    """A dense block of voxels ready for upload.

    `values` is float16 of shape (z, y, x) or (z, y, x, 4), x fastest as a 3D texture wants it; the field is
    ``values · scale``. `box_to_index` is 4×4 and maps the unit box, whose corners are the centres of the corner
    voxels of the field, to the grid's index space. `reduction` is the edge of the cube of voxels averaged into
    one (1: none). Where there are `bricks` the block holds them, and else the voxels of the box as they lie in it.
    `given_cells` are the cells, where they were found without the box's voxels. Where there are `slabs`, `values` tells
    no more than the shape: they give the values a few layers along z at a time, each with the first of its layers.
    """

    values: np.ndarray
    scale: float
    box_to_index: np.ndarray
    reduction: int
    bricks: Bricks | None = None
    given_cells: tuple[np.ndarray, int] | None = None
    slabs: Callable[[], Iterator[tuple[int, np.ndarray]]] | None = None

    @property
    def size(self) -> tuple[int, int, int]:
        """Texels along x, y, z."""
        z, y, x = self.values.shape[:3]
        return x, y, z

    @property
    def intervals(self) -> np.ndarray:
        """Intervals between voxels that the box spans along x, y, z."""
        return np.array(self.size, float) - 1.0 if self.bricks is None else self.bricks.intervals

    @property
    def nbytes(self) -> int:
        """Bytes of the values, and of the table of bricks."""
        return self.values.nbytes + (self.bricks.table.nbytes if self.bricks is not None else 0)

    @property
    def scalars(self) -> np.ndarray:
        """The values as float16 of shape (z, y, x): of vectors the means of their components."""
        if self.values.ndim == 3:
            return self.values
        return self.values[..., :3].mean(axis=-1, dtype=np.float32).astype(np.float16)

    @cached_property
    def occupied(self) -> np.ndarray:
        """Centres of the cells that are not empty, (K, 3), x, y, z in cells from the corner of the box."""
        return np.argwhere(self.cells[0] > 0)[:, ::-1] + 0.5

    @cached_property
    def cells(self) -> tuple[np.ndarray, int]:
        """The cells of the scalar values, and their edge; see cells.py."""
        return self.given_cells or cells_of(self.scalars)


def _block_dims(dims: np.ndarray, factor: int) -> np.ndarray:
    """Cells of a packed block: one of margin on both sides, and one more where cubes do not begin with the block."""
    return -(-np.asarray(dims, np.int64) // factor) + (2 if factor == 1 else 3)


def reduction_factor(dims: np.ndarray, bytes_per_voxel: int, memory: int, texture_limit: int) -> int:
    """The smallest power of two by which a block of `dims` voxels has to shrink to fit memory and texture limits."""
    factor = 1
    while True:
        reduced = _block_dims(dims, factor)
        if reduced.max() <= texture_limit and int(np.prod(reduced)) * bytes_per_voxel <= memory:
            return factor
        factor *= 2


def field_dims(field: Field) -> np.ndarray:
    """Voxels of the active box along x, y, z (zeros for an empty grid)."""
    if field.grid.active_count == 0:
        return np.zeros(3, np.int64)
    lo, hi = field.grid.bounds
    return np.asarray(hi, np.int64) - np.asarray(lo, np.int64) + 1


@dataclass(frozen=True)
class Storage:
    """How a field is held on the GPU: in bricks of `edge` voxels (0: as a dense block), averaged over cubes of
    `reduction`³ voxels, in that many bytes."""

    edge: int
    reduction: int
    nbytes: int


def storage(
    field: Field,
    memory: int,
    texture_limit: int = DEFAULT_TEXTURE_LIMIT,
    components: int = 1,
    sparse: str = "off",
) -> Storage:
    """How `pack` will hold a field; arguments as there."""
    dims = field_dims(field)
    factor = reduction_factor(dims, 2 * components, memory, texture_limit)
    dense = _dense_bytes(dims, factor, components)
    if sparse == "off" or components > 1 or field.grid.leaf_values.ndim > 4:
        return Storage(0, factor, dense)
    # No wider than a dense block could be: the steps of a march are counted in voxels.
    if dims.max() + 2 > texture_limit:
        return Storage(0, factor, dense)
    is_needed = sparse == "on" or factor > 1
    # Where bricks would lie takes long to find.
    if not is_needed and not (_is_worth(0, dense) and _is_worth(least_brick_bytes(field.grid), dense)):
        return Storage(0, factor, dense)
    nbytes, edge = occupancy(field.grid).best(texture_limit)
    nbytes += _cell_bytes(dims + 2)
    if nbytes <= memory and (is_needed or _is_worth(nbytes, dense)):
        return Storage(edge, 1, int(nbytes))
    return Storage(0, factor, dense)


def _is_worth(nbytes: float, dense: int) -> bool:
    """Whether bricks of so many bytes are better than a dense block of so many."""
    return nbytes < WORTH_BRICKS * dense and dense - nbytes >= LEAST_TO_SPARE


def _dense_bytes(dims: np.ndarray, factor: int, components: int) -> int:
    block = _block_dims(dims, factor)
    return int(np.prod(block)) * 2 * components + (_cell_bytes(block) if components == 1 else 0)


def _cell_bytes(size: np.ndarray) -> int:
    """Bytes of the cells of so many voxels along each axis."""
    size = [int(n) for n in size]
    return int(np.prod(cell_counts(size, cell_edge(size)))) * 2


def pack(
    field: Field,
    memory: int,
    texture_limit: int = DEFAULT_TEXTURE_LIMIT,
    components: int = 1,
    sparse: str = "off",
) -> PackedField:
    """Pack a field of at least one active voxel, averaging cubes of voxels where it would exceed the limits.

    Args:
        field: its grid holds finite, cleaned values.
        memory: bytes that the block may take.
        texture_limit: largest edge of a 3D texture.
        components: of the texture that the block goes into, 1 or 4.
        sparse: whether to hold it in bricks: "on", "off", or "auto" for where that takes less memory.
    """
    grid = field.grid
    lo, hi = (np.asarray(b, np.int64) for b in grid.bounds)
    held = storage(field, memory, texture_limit, components, sparse)
    factor = held.reduction
    if held.edge:
        found = occupancy(grid)
        bricks, cells = found.find(grid, held.edge, texture_limit)
        to_index = _box_to_index(lo - 1, bricks.intervals, 1)
        values, slabs = None, None
        if held.nbytes > LARGE_BLOCK:
            # Converted when it is uploaded, a part at a time.
            shape = tuple(reversed(found.layout(held.edge, texture_limit).size))
            values = np.broadcast_to(np.float16(0.0), shape)
            slabs = functools.partial(found.slabs, grid, held.edge, texture_limit, SLAB)
        else:
            values = found.block(grid, held.edge, texture_limit)
        return PackedField(values, found.scale, to_index, 1, bricks, cells, slabs)
    if factor == 1:
        first, scale = lo - 1, value_scale(grid)
        # The size was checked against the memory above; the grid's own limit is for those who did not.
        limit = int(np.prod(hi - lo + 3))
        dense = grid.dense(lo - 1, hi + 1, limit, dtype=np.float16, divisor=scale, order="F")
    else:
        first, dense = lo // factor - 1, _reduced(grid, lo, hi, factor)
        scale = max(float(dense.max()), -float(dense.min())) or 1.0
        dense /= dense.dtype.type(scale)
    if dense.ndim == 4:
        values = np.zeros((*dense.shape[2::-1], 4), np.float16)
        values[..., :3] = dense.transpose(2, 1, 0, 3)
    else:
        values = dense.transpose(2, 1, 0).astype(np.float16, order="C", copy=False)
    to_index = _box_to_index(first, np.array(dense.shape[:3], float) - 1.0, factor)
    return PackedField(values, scale, to_index, factor)


def _box_to_index(first: np.ndarray, intervals: np.ndarray, factor: int) -> np.ndarray:
    """Box coordinate 0 is the centre of the first of the cubes of voxels that were averaged, 1 that of the last."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(intervals * factor)
    matrix[3, :3] = (first + 0.5) * factor - 0.5
    return matrix


@dataclass(eq=False)
class _Stored:
    field: Hashable
    ready: threading.Event = dataclasses.field(default_factory=threading.Event)
    packed: PackedField | None = None


class PackedStore:
    """Fields packed ahead, by any thread, for draws to take. The oldest are dropped where `memory` bytes are exceeded.

    A field is packed once: who wants one that another thread is packing waits for it.
    """

    def __init__(self, memory: int = STORE_MEMORY) -> None:
        self._memory = memory
        self._lock = threading.Lock()
        self._stored: OrderedDict[Hashable, _Stored] = OrderedDict()

    @staticmethod
    def _key(f: Field, memory: int, texture_limit: int, components: int, sparse: str) -> Hashable:
        return f.key, memory, texture_limit, components, sparse

    def prepare(self, f: Field, memory: int, texture_limit: int, components: int, sparse: str = "off") -> None:
        """Pack a field and keep it, where it is not kept already; arguments as for `pack`."""
        key = self._key(f, memory, texture_limit, components, sparse)
        with self._lock:
            held = self._stored.get(key)
            if held is not None:
                self._stored.move_to_end(key)
                return
            held = self._stored[key] = _Stored(f.key)
        try:
            held.packed = pack(f, memory, texture_limit, components, sparse)
            if components == 1:
                held.packed.occupied  # noqa: B018  # and the cells: here rather than by the thread that draws
        except BaseException:
            with self._lock:
                self._stored.pop(key, None)
            raise
        finally:
            held.ready.set()
        with self._lock:
            self._shrink()

    def take(self, f: Field, memory: int, texture_limit: int, components: int, sparse: str = "off") -> PackedField:
        """A field packed ahead, or else packed now and not kept; arguments as for `pack`."""
        key = self._key(f, memory, texture_limit, components, sparse)
        with self._lock:
            held = self._stored.get(key)
            if held is not None:
                self._stored.move_to_end(key)
        if held is not None:
            held.ready.wait()
            if held.packed is not None:
                if held.packed.nbytes > LARGE_BLOCK:
                    with self._lock:
                        self._stored.pop(key, None)
                return held.packed
        return pack(f, memory, texture_limit, components, sparse)

    def _shrink(self) -> None:
        sizes = {key: s.packed.nbytes for key, s in self._stored.items() if s.packed is not None}
        total = sum(sizes.values())
        # The last one packed stays, however large: somebody is about to draw it.
        for key in list(sizes)[:-1]:
            if total <= self._memory:
                break
            total -= sizes[key]
            del self._stored[key]

    def keep(self, fields: Iterable[Field]) -> None:
        """Drop what was packed of other fields."""
        kept = {f.key for f in fields}
        with self._lock:
            for key in [key for key, s in self._stored.items() if s.packed is not None and s.field not in kept]:
                del self._stored[key]

    def clear(self) -> None:
        """Drop all fields."""
        with self._lock:
            self._stored.clear()


def _reduced(grid, lo: np.ndarray, hi: np.ndarray, factor: int) -> np.ndarray:
    """Means over cubes of `factor`³ voxels aligned to multiples of the factor, with one cell of margin."""
    first, last = lo // factor - 1, hi // factor + 1
    shape = last - first + 1
    channels = grid.leaf_values.shape[4:]
    total = np.zeros((*shape, *channels), np.float32)
    background = np.asarray(grid.background, np.float32)
    # Inactive voxels count with the value they hold, as they do where nothing is reduced.
    edge = min(factor, 8)
    cells = 8 // edge
    offsets = np.stack(np.meshgrid(*[np.arange(cells) * edge] * 3, indexing="ij"), axis=-1)
    for begin in range(0, len(grid.leaf_values), _LEAVES):
        part = slice(begin, begin + _LEAVES)
        values = grid.leaf_values[part].astype(np.float32) - background
        blocks = values.reshape(-1, cells, edge, cells, edge, cells, edge, *channels).sum(axis=(2, 4, 6))
        where = ((grid.leaf_origins[part, None, None, None, :] + offsets) // factor - first).reshape(-1, 3)
        # Leaves reach beyond the active box; there they hold nothing.
        held = np.all((where >= 0) & (where < shape), axis=1)
        np.add.at(total, tuple(where[held].T), blocks.reshape(-1, *channels)[held])
    tiles = grid.tiles
    for origin, size, value in zip(tiles.origin, tiles.size, tiles.value, strict=True):
        _add_box(
            total, np.asarray(origin, np.int64), int(size), np.asarray(value, np.float32) - background, factor, first
        )
    # In place: at the limits this is the largest array there is.
    total /= float(factor) ** 3
    total += background
    return total


def _add_box(total: np.ndarray, origin: np.ndarray, size: int, value, factor: int, first: np.ndarray) -> None:
    """Add `value` times the number of voxels that each cell shares with the cube at `origin`."""
    overlaps, slices = [], []
    for axis in range(3):
        begin, end = origin[axis], origin[axis] + size
        cell0, cell1 = begin // factor, (end - 1) // factor
        edges = np.arange(cell0, cell1 + 1) * factor
        overlaps.append(np.minimum(edges + factor, end) - np.maximum(edges, begin))
        slices.append(slice(cell0 - first[axis], cell1 + 1 - first[axis]))
    share = overlaps[0][:, None, None] * overlaps[1][None, :, None] * overlaps[2][None, None, :]
    share = share.astype(np.float32)
    total[tuple(slices)] += share[..., None] * value if total.ndim == 4 else share * value
