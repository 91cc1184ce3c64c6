"""The bytes of one tree → leaves and tiles: topology first, then the leaf buffers in the order of the topology.

What costs time here: a leaf's mask is repeated in front of its buffer; a block of no values still has a size (and a
Blosc header) except in half grids, where nothing is written; node values are halved in half grids but the background,
root tiles and inactive values never are.

Memory and time are bounded by the file's size. Every node and leaf takes its masks' bytes in the file, so a short file
cannot ask for many; a constant 32³ node packs well, so tiles are bounded by a number besides.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import layout
from .blocks import find_block, read_block
from .grid import Tiles
from .layout import ValueSpec

TILE_LIMIT = 1 << 24
"""Tiles that a tree may hold; a production tree has some thousands."""

_BATCH = 4096  # leaves decoded at a time: bounds what is held packed and unpacked at once
_ORIGIN_AND_BUFFER_COUNT = 13  # in front of a leaf's values in old files


@dataclass(frozen=True)
class TreeFormat:
    """What the file says about how a tree is stored: file version, compression flags, type, half floats."""

    version: int
    flags: int
    spec: ValueSpec
    half: bool

    @property
    def stored(self) -> np.dtype:
        """The scalar type of values in the file, except background, root tiles and inactive values."""
        return np.dtype("<f2") if self.half and self.spec.is_real else self.spec.scalar

    @property
    def stored_itemsize(self) -> int:
        """Bytes of one stored value."""
        return self.stored.itemsize * self.spec.components

    @property
    def drops_inactive(self) -> bool:
        """Whether inactive values may be left out of the file."""
        return bool(self.flags & layout.COMPRESS_ACTIVE_MASK) and self.has_inactive_byte

    @property
    def has_inactive_byte(self) -> bool:
        """Whether each node says how its inactive values are stored."""
        return self.version >= layout.VERSION_NODE_MASK


@dataclass(frozen=True)
class Tree:
    """A decoded tree; arrays as in :class:`previs.vdb.Grid`."""

    background: np.ndarray
    leaf_origins: np.ndarray
    leaf_values: np.ndarray
    leaf_masks: np.ndarray
    tiles: Tiles
    inactive_tiles: Tiles


def read_tree(
    data: memoryview, tree_format: TreeFormat, decoded: Callable[[int], None] = lambda _: None
) -> tuple[Tree, int]:
    """Decode the tree at the start of ``data``; also the number of bytes that it takes.

    ``decoded`` is told now and then how many of the first bytes are not needed any more.
    """
    topology = _Topology(data, tree_format)
    topology.read(with_tiles=True)
    origins, masks = topology.leaves()
    _check_room(len(origins), len(data) - topology.position)
    # Tiles and all else that came before the leaves must not be views of bytes that are let go.
    background, tiles = topology.background.copy(), topology.tiles()
    values, position = _read_leaves(data, topology.position, masks, background, tree_format, decoded)
    shape = (len(origins), 8, 8, 8)
    tree = Tree(
        background,
        origins,
        values.reshape(*shape, *tree_format.spec.shape),
        masks,
        *tiles,
    )
    return tree, position


def skip_tree(data: memoryview, tree_format: TreeFormat, leaf_bytes: int | None = None) -> int:
    """The number of bytes of the tree at the start of ``data``, without decoding its leaf buffers.

    ``leaf_bytes`` is given for the types whose leaf buffers have one size.
    """
    topology = _Topology(data, tree_format)
    topology.read(with_tiles=False)
    _, masks = topology.leaves()
    _check_room(len(masks), len(data) - topology.position)
    if leaf_bytes is not None:
        position = topology.position + leaf_bytes * len(masks)
        if position > len(data):
            raise ValueError("the leaves reach beyond the data")
        return position
    position = topology.position
    counts = _active_counts(masks)
    for first in range(0, len(counts), _BATCH):
        _, _, position = _scan_leaves(data, position, counts[first : first + _BATCH], tree_format, decode=False)
    return position


def _check_room(leaf_count: int, room: int) -> None:
    """Refuse, before memory is asked for, leaves whose buffers cannot be in the file."""
    if leaf_count * layout.LEAF_MASK_BYTES > room:
        raise ValueError(f"{leaf_count} leaves are announced and the file is too short to hold them")


def _active_counts(masks: np.ndarray) -> list[int]:
    return np.bitwise_count(masks.view("<u8")).sum(axis=1, dtype=np.int64).tolist()


# --- topology -------------------------------------------------------------------------------------------------


class _Topology:
    """A walk down the nodes of a tree, that collects leaves and tiles."""

    def __init__(self, data: memoryview, tree_format: TreeFormat) -> None:
        self.data = data
        self.format = tree_format
        self.position = 0
        self.background = np.zeros(tree_format.spec.shape, tree_format.spec.scalar)
        self._with_tiles = True
        self._leaf_origins: list[np.ndarray] = []
        self._leaf_masks: list[np.ndarray] = []
        self._tiles: dict[bool, list[tuple[np.ndarray, int, np.ndarray]]] = {True: [], False: []}
        self._tile_count = 0

    def read(self, *, with_tiles: bool) -> None:
        self._with_tiles = with_tiles
        spec = self.format.spec
        buffer_count, background = struct.unpack("<i", self._take(4))[0], self._take(spec.itemsize)
        if buffer_count > 1:
            raise ValueError(f"its tree has {buffer_count} buffers a leaf, which no OpenVDB of this decade writes")
        self.background = np.frombuffer(background, spec.scalar).reshape(spec.shape)
        tile_count, child_count = struct.unpack("<II", self._take(8))
        entry = np.dtype([("origin", "<i4", 3), ("value", spec.scalar, spec.shape), ("active", "u1")])
        tiles = np.frombuffer(self._take(tile_count * entry.itemsize), entry)
        for active in (True, False):
            self._add_tiles(
                active, tiles["origin"], layout.NODE2_SPAN, tiles["value"], (tiles["active"] != 0) == active
            )
        origins = [tiles["origin"]]
        for _ in range(child_count):
            origin = np.frombuffer(self._take(12), "<i4")
            origins.append(origin[None])
            self._read_node2(origin)
        origins = np.concatenate(origins)
        if (origins % layout.NODE2_SPAN).any() or len(np.unique(origins, axis=0)) != len(origins):
            raise ValueError("the nodes of its root are not where nodes can be")

    def leaves(self) -> tuple[np.ndarray, np.ndarray]:
        """Origins (L, 3) int32 and active masks (L, 64) uint8."""
        if not self._leaf_origins:
            return np.zeros((0, 3), np.int32), np.zeros((0, layout.LEAF_MASK_BYTES), np.uint8)
        return np.concatenate(self._leaf_origins), np.concatenate(self._leaf_masks)

    def tiles(self) -> tuple[Tiles, Tiles]:
        """Active tiles, and inactive tiles that differ from the background."""
        return self._joined_tiles(True), self._joined_tiles(False)

    def _joined_tiles(self, active: bool) -> Tiles:
        runs = self._tiles[active]
        if not runs:
            return Tiles.none(self.format.spec)
        return Tiles(
            np.concatenate([origins for origins, _, _ in runs]),
            np.repeat(np.array([size for _, size, _ in runs], np.int32), [len(origins) for origins, _, _ in runs]),
            np.concatenate([values for _, _, values in runs]),
        )

    def _take(self, size: int) -> memoryview:
        after = self.position + size
        if after > len(self.data):
            raise ValueError("the file ends inside a tree")
        taken = self.data[self.position : after]
        self.position = after
        return taken

    def _read_node2(self, origin: np.ndarray) -> None:
        for child in self._read_node(origin, layout.NODE2_LOG2, layout.NODE1_SPAN):
            self._read_node1(child)

    def _read_node1(self, origin: np.ndarray) -> None:
        leaves = self._read_node(origin, layout.NODE1_LOG2, layout.LEAF_SIZE)
        masks = np.frombuffer(self._take(len(leaves) * layout.LEAF_MASK_BYTES), np.uint8)
        self._leaf_origins.append(leaves)
        self._leaf_masks.append(masks.reshape(-1, layout.LEAF_MASK_BYTES))

    def _read_node(self, origin: np.ndarray, log2_side: int, child_span: int) -> np.ndarray:
        """Read one internal node up to its children, keep its tiles, and return the origins of its children."""
        count = 1 << (3 * log2_side)
        is_child, active = (
            np.unpackbits(np.frombuffer(self._take(count // 8), np.uint8), bitorder="little").view(bool) for _ in "cv"
        )
        values = self._read_node_values(count, is_child, active)
        if values is not None and self._with_tiles:
            is_tile = ~is_child
            differs = values != self.background
            if self.format.spec.is_real and np.isnan(self.background).any():
                differs &= ~(np.isnan(values) & np.isnan(self.background))
            if differs.ndim > 1:
                differs = differs.any(axis=1)
            for state, chosen in ((True, is_tile & active), (False, is_tile & ~active & differs)):
                offsets = np.flatnonzero(chosen)
                if len(offsets):
                    origins = origin + layout.offset_coordinates(offsets, log2_side) * child_span
                    self._add_tiles(state, origins, child_span, values, chosen)
        return origin + layout.offset_coordinates(np.flatnonzero(is_child), log2_side) * np.int32(child_span)

    def _read_node_values(self, count: int, is_child: np.ndarray, active: np.ndarray) -> np.ndarray | None:
        """The values of a node's ``count`` places; None if there is none but the background."""
        fmt = self.format
        if not fmt.has_inactive_byte:
            # Old files hold the values of tiles alone, active and inactive ones in a row.
            values = np.empty((count, *fmt.spec.shape), fmt.spec.scalar)
            values[...] = self.background
            values[~is_child] = self._read_values(int(np.count_nonzero(~is_child)))
            return values
        how = self._take(1)[0]
        fill = _read_inactive(self.data, self.position, how, count // 8, self.background, fmt.spec)
        self.position = fill.position
        if not fmt.drops_inactive or how == layout.INACTIVE_STORED:
            return self._read_values(count)
        stored = self._read_values(int(np.count_nonzero(active)))
        if how == layout.INACTIVE_BACKGROUND and not len(stored):
            return None
        values = np.empty((count, *fmt.spec.shape), fmt.spec.scalar)
        fill.paint(values)
        values[active] = stored
        return values

    def _read_values(self, count: int) -> np.ndarray:
        fmt = self.format
        raw: bytes | memoryview = b""
        if count or fmt.stored == fmt.spec.scalar:
            raw, self.position = read_block(self.data, self.position, count * fmt.stored_itemsize, fmt.flags)
        return np.frombuffer(raw, fmt.stored).reshape(count, *fmt.spec.shape).astype(fmt.spec.scalar, copy=False)

    def _add_tiles(self, active: bool, origins: np.ndarray, size: int, values: np.ndarray, chosen: np.ndarray) -> None:
        """Keep the chosen values as tiles; ``origins`` are of all values or of the chosen alone."""
        kept = values[chosen]
        if not len(kept) or not self._with_tiles:
            return
        self._tile_count += len(kept)
        if self._tile_count > TILE_LIMIT:
            raise ValueError(f"its tree has more than {TILE_LIMIT} tiles")
        self._tiles[active].append((origins if len(origins) == len(kept) else origins[chosen], size, kept))


# --- inactive values ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _InactiveFill:
    """What stands where a node's inactive values were dropped: one value, or a mask that tells two apart."""

    value: np.ndarray
    other: np.ndarray
    other_mask: memoryview | None
    position: int  # of the values that follow

    def paint(self, values: np.ndarray) -> None:
        values[...] = self.value
        if self.other_mask is not None:
            is_other = np.unpackbits(np.frombuffer(self.other_mask, np.uint8), bitorder="little").view(bool)
            values[is_other] = self.other


def _read_inactive(
    data: memoryview, position: int, how: int, mask_bytes: int, background: np.ndarray, spec: ValueSpec
) -> _InactiveFill:
    """Read what follows the inactive-value byte ``how``."""
    if how in (layout.INACTIVE_BACKGROUND, layout.INACTIVE_STORED):
        return _InactiveFill(background, background, None, position)
    if how > layout.INACTIVE_STORED:
        raise ValueError(f"a node stores its inactive values in the unknown way {how}")
    size = spec.itemsize
    after = position
    with np.errstate(over="ignore"):
        value, other = np.negative(background), background
    if how in (layout.INACTIVE_ONE_VALUE, layout.INACTIVE_MASK_AND_ONE_VALUE, layout.INACTIVE_MASK_AND_TWO_VALUES):
        value = np.frombuffer(data[after : after + size], spec.scalar).reshape(spec.shape)
        after += size
    if how == layout.INACTIVE_MASK_AND_TWO_VALUES:
        other = np.frombuffer(data[after : after + size], spec.scalar).reshape(spec.shape)
        after += size
    mask = None
    if how >= layout.INACTIVE_MASK_OF_BACKGROUNDS:
        mask = data[after : after + mask_bytes]
        after += mask_bytes
    if after > len(data):
        raise ValueError("the file ends inside a tree")
    return _InactiveFill(value, other, mask, after)


# --- leaves ---------------------------------------------------------------------------------------------------


def _read_leaves(
    data: memoryview,
    position: int,
    masks: np.ndarray,
    background: np.ndarray,
    tree_format: TreeFormat,
    decoded: Callable[[int], None],
) -> tuple[np.ndarray, int]:
    """The values (L, 512) of leaves whose active masks (L, 64) are given, and the position after their buffers."""
    spec = tree_format.spec
    values = np.empty((len(masks), layout.LEAF_VOXELS, *spec.shape), spec.scalar)
    for first in range(0, len(masks), _BATCH):
        part, bits = values[first : first + _BATCH], masks[first : first + _BATCH]
        mask, counts = np.unpackbits(bits, axis=1, bitorder="little").view(bool), _active_counts(bits)
        chunks, oddities, position = _scan_leaves(data, position, counts, tree_format, background=background)
        present = mask
        if tree_format.drops_inactive:
            part[...] = background
        if oddities or not tree_format.drops_inactive:
            present = mask.copy() if tree_format.drops_inactive else np.ones_like(mask)
            for i, fill in oddities:
                if fill is None:
                    present[i] = True
                else:
                    fill.paint(part[i])
        stored = np.frombuffer(b"".join(chunks), tree_format.stored).reshape(-1, *spec.shape)
        if present.all():
            part[...] = stored.reshape(part.shape)
        else:
            part[present] = stored
        decoded(position)
    return values, position


def _scan_leaves(
    data: memoryview,
    position: int,
    counts: list[int],
    tree_format: TreeFormat,
    *,
    background: np.ndarray | None = None,
    decode: bool = True,
) -> tuple[list[bytes | memoryview], list[tuple[int, _InactiveFill | None]], int]:
    """Step through the buffers of leaves with so many active values each.

    Returns the unpacked blocks, the leaves that are not plainly "inactive values are the background" (with their
    fill, or None where every value is stored) and the position after the last. One step a leaf, since only a leaf's
    own size says where the next begins.
    """
    spec, flags, itemsize = tree_format.spec, tree_format.flags, tree_format.stored_itemsize
    drops, has_byte = tree_format.drops_inactive, tree_format.has_inactive_byte
    empty_is_absent = tree_format.stored != spec.scalar
    ground = np.zeros(spec.shape, spec.scalar) if background is None else background
    ahead = layout.LEAF_MASK_BYTES + (0 if has_byte else _ORIGIN_AND_BUFFER_COUNT)
    chunks: list[bytes | memoryview] = []
    oddities: list[tuple[int, _InactiveFill | None]] = []
    for i, count in enumerate(counts):
        position += ahead
        if has_byte:
            how = data[position]
            position += 1
            if how:
                fill = None
                if how != layout.INACTIVE_STORED:
                    fill = _read_inactive(data, position, how, layout.LEAF_MASK_BYTES, ground, spec)
                    position = fill.position
                if drops:
                    oddities.append((i, fill))
                if fill is None:
                    count = layout.LEAF_VOXELS
        elif data[position - 1] != 1:
            raise ValueError(f"a leaf has {data[position - 1]} buffers")
        if not drops:
            count = layout.LEAF_VOXELS
        if not count and empty_is_absent:
            continue
        if decode:
            chunk, position = read_block(data, position, count * itemsize, flags)
            chunks.append(chunk)
        else:
            start, length = find_block(data, position, count * itemsize, flags)
            position = start + abs(length)
    if position > len(data):
        raise ValueError("the file ends inside a leaf")
    return chunks, oddities, position
