"""Grids → a .vdb file that OpenVDB and everything built on it can read.

Writes file version 224 with grid offsets. Each transform is an AffineMap, which every reader knows and which holds
any invertible matrix. Leaves are the only thing compressed one by one, so a file's bytes depend on its grids alone:
the UUID is a hash of them.
"""

from __future__ import annotations

import hashlib
import os
import struct
import tempfile
import uuid
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from . import layout
from .grid import Grid, Tiles, affine_matrix

LIBRARY_VERSION = (10, 0)  # the OpenVDB release whose files look like ours
ZIP_LEVEL = 1  # noisy floats shrink by a few per cent at most beyond this, for several times the time


def write(
    path: str | os.PathLike[str],
    grids: Grid | Iterable[Grid],
    compression: Literal["zip", "none"] = "zip",
    *,
    active_mask: bool = True,
) -> None:
    """Write grids, or a single one, to one .vdb file.

    ``compression`` is "zip" (default) or "none"; ``active_mask`` (default True) leaves inactive values out of the
    file where one value stands for them all. Values keep their type. Names may be empty, unicode, or shared. A grid's
    metadata of plain Python values (str, bool, int, float, tuples of three numbers) is kept, other metadata is left
    out. The file is written beside its place and renamed: an existing one is never left half-written.

    Raises ValueError for a grid that cannot be stored (leaves that overlap or are off the lattice of 8, a
    transform that is not affine and invertible), OSError if the file cannot be written.
    """
    if compression not in ("zip", "none"):
        raise ValueError(f'compression must be "zip" or "none", not {compression!r}')
    grids = [grids] if isinstance(grids, Grid) else list(grids)
    flags = layout.COMPRESS_ZIP * (compression == "zip") | layout.COMPRESS_ACTIVE_MASK * active_mask
    for grid in grids:
        _check_leaves(grid)
    bodies = [_grid_body(grid, flags, metadata) for grid, metadata in zip(grids, _metadata(grids, flags), strict=True)]
    _replace_file(path, _assemble(grids, bodies))


# --- the file -------------------------------------------------------------------------------------------------


@dataclass
class _Body:
    """A grid from its compression flags to its last leaf; the leaf buffers begin at byte ``block``."""

    data: bytes
    block: int


def _assemble(grids: Sequence[Grid], bodies: Sequence[_Body]) -> list[bytes]:
    digest = hashlib.blake2b(digest_size=16)
    for body in bodies:
        digest.update(body.data)
    header = struct.pack("<qIIIB", layout.MAGIC, layout.WRITTEN_VERSION, *LIBRARY_VERSION, True)
    header += str(uuid.UUID(bytes=digest.digest(), version=4)).encode("ascii")
    header += _metadata_map({"creator": _metadatum("previs")}) + struct.pack("<i", len(grids))
    parts, position = [header], len(header)
    shared = Counter(grid.name for grid in grids)
    seen: Counter[str] = Counter()
    for grid, body in zip(grids, bodies, strict=True):
        unique = grid.name
        if shared[grid.name] > 1:
            unique += f"{layout.NAME_SEPARATOR}{seen[grid.name]}"
            seen[grid.name] += 1
        descriptor = _string(unique) + _string(grid.spec.tree_type) + _string("")
        start = position + len(descriptor) + 24
        position = start + len(body.data)
        descriptor += struct.pack("<qqq", start, start + body.block, position)
        parts += [descriptor, body.data]
    return parts


def _replace_file(path: str | os.PathLike[str], parts: Iterable[bytes]) -> None:
    target = os.fspath(path)
    folder, name = os.path.split(target)
    handle, beside = tempfile.mkstemp(prefix=f".{name}.", suffix=".part", dir=folder or ".")
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines(parts)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(beside, 0o666 & ~umask)  # mkstemp makes private files, an export is as readable as any other
        os.replace(beside, target)
    except BaseException:
        os.unlink(beside)
        raise


def _string(text: str) -> bytes:
    encoded = text.encode("utf-8")
    return struct.pack("<I", len(encoded)) + encoded


# --- metadata -------------------------------------------------------------------------------------------------


def _metadata(grids: Sequence[Grid], flags: int) -> list[dict[str, bytes]]:
    """The encoded metadata of each grid; ``index`` only where positions alone would not bring it back."""
    groups: dict[str, list[int]] = defaultdict(list)
    for position, grid in enumerate(grids):
        groups[grid.name].append(position)
    numbered = set()
    for positions in groups.values():
        indices = [grids[p].index for p in positions]
        if indices != list(range(len(positions))) and len(set(indices)) == len(indices):
            numbered.update(positions)
    return [_grid_metadata(grid, flags, p in numbered) for p, grid in enumerate(grids)]


def _grid_metadata(grid: Grid, flags: int, numbered: bool) -> dict[str, bytes]:
    entries = {}
    for key, value in grid.metadata.items():
        # What the file says of itself (its statistics, half storage) must be said anew.
        if not key.startswith("file_") and key not in ("index", layout.HALF_METADATA):
            encoded = _metadatum(value)
            if encoded is not None:
                entries[key] = encoded
    box = grid.bounds
    low, high = ((1 << 31) - 1,) * 3, (-(1 << 31),) * 3  # OpenVDB's empty box
    if box is not None:
        low, high = (tuple(int(v) for v in corner) for corner in box)
    words = ["zip"] * bool(flags & layout.COMPRESS_ZIP)
    words += ["active values"] * bool(flags & layout.COMPRESS_ACTIVE_MASK)
    entries |= {
        "name": _metadatum(grid.name),
        "class": _metadatum(grid.grid_class if grid.grid_class in layout.GRID_CLASSES else "unknown"),
        "file_bbox_min": _metadatum(low),
        "file_bbox_max": _metadatum(high),
        "file_compression": _metadatum(" + ".join(words) or "none"),
        "file_voxel_count": _string("int64") + struct.pack("<Iq", 8, grid.active_count),
    }
    if numbered:
        entries["index"] = _metadatum(int(grid.index))
    return entries


def _metadatum(value: Any) -> bytes | None:
    """Type name, size and bytes of a plain Python value; None for what has no OpenVDB type."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return _string("bool") + struct.pack("<I?", 1, value)
    if isinstance(value, int) and -(1 << 63) <= value < 1 << 63:
        small = -(1 << 31) <= value < 1 << 31
        return (
            _string("int32") + struct.pack("<Ii", 4, value)
            if small
            else _string("int64") + struct.pack("<Iq", 8, value)
        )
    if isinstance(value, float):
        with np.errstate(over="ignore"):
            single = float(np.float32(value)) == value or value != value
        return (
            _string("float") + struct.pack("<If", 4, value)
            if single
            else _string("double") + struct.pack("<Id", 8, value)
        )
    if isinstance(value, str):
        return _string("string") + _string(value)
    if isinstance(value, tuple) and len(value) == 3:
        if all(isinstance(v, int) and -(1 << 31) <= v < 1 << 31 for v in value):
            return _string("vec3i") + struct.pack("<I3i", 12, *value)
        if all(isinstance(v, (int, float)) for v in value):
            return _string("vec3d") + struct.pack("<I3d", 24, *value)
    return None


def _metadata_map(entries: dict[str, bytes]) -> bytes:
    return struct.pack("<I", len(entries)) + b"".join(_string(key) + entries[key] for key in sorted(entries))


# --- one grid -------------------------------------------------------------------------------------------------


def _grid_body(grid: Grid, flags: int, metadata: dict[str, bytes]) -> _Body:
    matrix = affine_matrix(grid.index_to_world, f"grid {grid.name!r}")
    head = struct.pack("<I", flags) + _metadata_map(metadata)
    head += _string("AffineMap") + matrix.astype("<f8").tobytes()
    head += struct.pack("<i", 1)  # buffers per leaf: more than one is history
    # In the order in which a walk of the tree meets the leaves.
    order = _tree_order(np.asarray(grid.leaf_origins))
    masks = grid.leaf_masks[order]
    topology = _topology(grid, order, masks, flags)
    buffers = _leaf_buffers(grid, order, masks, flags)
    return _Body(b"".join([head, topology, *buffers]), len(head) + len(topology))


def _check_leaves(grid: Grid) -> None:
    origins = np.asarray(grid.leaf_origins)
    shape = (len(origins), 8, 8, 8)
    if origins.shape != (len(origins), 3) or grid.leaf_values.shape != (*shape, *grid.spec.shape):
        raise ValueError(f"grid {grid.name!r}: leaf values must be {(*shape, *grid.spec.shape)}")
    if grid.leaf_masks.shape != (len(origins), layout.LEAF_MASK_BYTES) or grid.leaf_masks.dtype != np.uint8:
        raise ValueError(f"grid {grid.name!r}: leaf_active must be {shape} booleans")
    if (origins % layout.LEAF_SIZE).any():
        raise ValueError(f"grid {grid.name!r}: leaf origins must be multiples of 8")


def _tree_order(origins: np.ndarray) -> np.ndarray:
    root = (origins >> 12).T
    inside2 = layout.linear_offsets((origins >> 7) & 31, layout.NODE2_LOG2)
    inside1 = layout.linear_offsets((origins >> 3) & 15, layout.NODE1_LOG2)
    return np.lexsort((inside1, inside2, root[2], root[1], root[0]))


def _encode(raw: bytes | memoryview, flags: int) -> list[bytes | memoryview]:
    """Values as they stand in the file: behind a size if the file is compressed, raw where that is shorter."""
    if not flags & layout.COMPRESS_ZIP:
        return [raw]
    packed = zlib.compress(raw, ZIP_LEVEL)
    if len(packed) < len(raw):
        return [struct.pack("<q", len(packed)), packed]
    return [struct.pack("<q", -len(raw)), raw]


def _leaf_buffers(grid: Grid, order: np.ndarray, masks: np.ndarray, flags: int) -> list[bytes | memoryview]:
    """The mask, the inactive-value byte and the values of each leaf."""
    spec, count = grid.spec, len(order)
    shape = (count, layout.LEAF_VOXELS, *spec.shape)
    values = np.ascontiguousarray(grid.leaf_values[order], spec.scalar).reshape(shape)
    kept = np.ones((count, layout.LEAF_VOXELS), bool)
    heads = [bytes([layout.INACTIVE_STORED])] * count
    if flags & layout.COMPRESS_ACTIVE_MASK:
        active = np.unpackbits(masks, axis=1, bitorder="little").view(bool)
        single, heads = _inactive_values(values, active, np.asarray(grid.background, spec.scalar))
        kept = active | ~single[:, None]
    stream = memoryview(values[kept].tobytes())
    ends = np.cumsum(kept.sum(axis=1) * spec.itemsize).tolist()
    mask_bytes = masks.tobytes()
    parts: list[bytes | memoryview] = []
    start = 0
    for i, end in enumerate(ends):
        parts.append(mask_bytes[i * layout.LEAF_MASK_BYTES : (i + 1) * layout.LEAF_MASK_BYTES])
        parts.append(heads[i])
        parts += _encode(stream[start:end], flags)
        start = end
    return parts


def _inactive_values(values: np.ndarray, active: np.ndarray, background: np.ndarray) -> tuple[np.ndarray, list[bytes]]:
    """Which leaves have one inactive value at most, and the bytes that say so in front of each leaf's values."""
    # Compared as bits, so that a NaN counts as a value like any other and −0 is not taken for 0.
    components = 1 if values.ndim == 2 else values.shape[2]
    words = values.reshape(*active.shape, components).view(f"<u{values.dtype.itemsize}")
    ground = np.full(components, background).view(words.dtype)
    heads = [bytes([layout.INACTIVE_BACKGROUND])] * len(values)
    single = np.ones(len(values), bool)
    differs = (words != ground).any(axis=2)
    for i in np.flatnonzero((differs & ~active).any(axis=1)):
        inactive = words[i][~active[i]]
        if (inactive == inactive[0]).all():
            heads[i] = bytes([layout.INACTIVE_ONE_VALUE]) + inactive[0].tobytes()
        else:
            heads[i] = bytes([layout.INACTIVE_STORED])
            single[i] = False
    return single, heads


# --- topology -------------------------------------------------------------------------------------------------


@dataclass
class _Entries:
    """The children of the nodes of one level, by their nodes: who is a child node, who a tile of which value."""

    offset: np.ndarray  # position in the node
    is_child: np.ndarray
    active: np.ndarray
    value: np.ndarray


def _topology(grid: Grid, order: np.ndarray, masks: np.ndarray, flags: int) -> bytes:
    spec = grid.spec
    background = np.broadcast_to(np.asarray(grid.background, spec.scalar), spec.shape)
    tiles = _all_tiles(grid)
    leaves = np.asarray(grid.leaf_origins, np.int64)[order]

    nodes1 = _level(leaves, tiles, layout.LEAF_SIZE, layout.NODE1_SPAN, layout.NODE1_LOG2, background, grid.name)
    # A leaf's place in the tree's order is its place in `masks`, so a node's leaves are a run of its rows.
    node1_bytes, row = [], 0
    for _, entries in nodes1:
        leaf_count = int(entries.is_child.sum())
        node = _node(entries, layout.NODE1_LOG2, background, flags)
        node1_bytes.append(node + masks[row : row + leaf_count].tobytes())
        row += leaf_count

    origins1 = np.array([origin for origin, _ in nodes1], np.int64).reshape(-1, 3)
    nodes2 = _level(origins1, tiles, layout.NODE1_SPAN, layout.NODE2_SPAN, layout.NODE2_LOG2, background, grid.name)
    root_tiles = tiles[0].size == layout.NODE2_SPAN
    origins2 = np.array([origin for origin, _ in nodes2], np.int64).reshape(-1, 3)
    _refuse_duplicates(np.concatenate([origins2, tiles[0].origin[root_tiles]]), grid.name)
    parts = [background.tobytes(), struct.pack("<II", int(root_tiles.sum()), len(nodes2))]
    for i in np.flatnonzero(root_tiles):
        origin = tiles[0].origin[i].astype("<i4").tobytes()
        parts += [origin, tiles[0].value[i].tobytes(), struct.pack("<?", bool(tiles[1][i]))]
    row = 0
    for origin, entries in nodes2:
        child_count = int(entries.is_child.sum())
        parts.append(np.asarray(origin, "<i4").tobytes())
        parts.append(_node(entries, layout.NODE2_LOG2, background, flags))
        parts += node1_bytes[row : row + child_count]
        row += child_count
    return b"".join(parts)


def _all_tiles(grid: Grid) -> tuple[Tiles, np.ndarray]:
    """Active and inactive tiles in one, and which are active."""
    both = (grid.tiles, grid.inactive_tiles)
    origin = np.concatenate([np.asarray(t.origin, np.int64).reshape(-1, 3) for t in both])
    size = np.concatenate([np.asarray(t.size, np.int64) for t in both])
    value = np.concatenate([np.asarray(t.value, grid.spec.scalar).reshape(-1, *grid.spec.shape) for t in both])
    if not np.isin(size, (layout.LEAF_SIZE, layout.NODE1_SPAN, layout.NODE2_SPAN)).all():
        raise ValueError(f"grid {grid.name!r}: tiles are 8, 128 or 4096 voxels a side")
    if (origin % size[:, None]).any():
        raise ValueError(f"grid {grid.name!r}: tile origins must be multiples of their sizes")
    return Tiles(origin, size, value), np.repeat([True, False], [len(t) for t in both])


def _refuse_duplicates(origins: np.ndarray, name: str) -> None:
    if len(np.unique(origins, axis=0)) != len(origins):
        raise ValueError(f"grid {name!r}: leaves or tiles overlap")


def _level(
    children: np.ndarray,
    tiles: tuple[Tiles, np.ndarray],
    child_span: int,
    span: int,
    log2_side: int,
    background: np.ndarray,
    name: str,
) -> list[tuple[np.ndarray, _Entries]]:
    """Group child nodes and tiles of one size by the node that holds them: (its origin, its entries) in tree order."""
    here = tiles[0].size == child_span
    origins = np.concatenate([children, tiles[0].origin[here]])
    if not len(origins):
        return []
    _refuse_duplicates(origins, name)
    order = _tree_order(origins)
    origins = origins[order]
    is_child = np.repeat([True, False], [len(children), int(here.sum())])[order]
    active = np.concatenate([np.zeros(len(children), bool), tiles[1][here]])[order]
    ground = np.broadcast_to(background, (len(children), *background.shape))
    value = np.concatenate([ground, tiles[0].value[here]])[order]
    parents = origins // span * span
    starts = np.flatnonzero(np.concatenate([[True], (parents[1:] != parents[:-1]).any(axis=1)]))
    stops = [*starts[1:].tolist(), len(origins)]
    offset = layout.linear_offsets((origins - parents) // child_span, log2_side)
    return [
        (parents[a], _Entries(offset[a:b], is_child[a:b], active[a:b], value[a:b]))
        for a, b in zip(starts.tolist(), stops, strict=True)
    ]


def _node(entries: _Entries, log2_side: int, background: np.ndarray, flags: int) -> bytes:
    """An internal node without its children: child mask, value mask, values."""
    count = 1 << (3 * log2_side)
    is_child, is_active = np.zeros(count, bool), np.zeros(count, bool)
    is_child[entries.offset[entries.is_child]] = True
    is_active[entries.offset[entries.active]] = True
    values = np.empty((count, *background.shape), background.dtype)
    values[...] = background
    values[entries.offset] = entries.value
    head = layout.INACTIVE_STORED
    if flags & layout.COMPRESS_ACTIVE_MASK and not (~entries.is_child & ~entries.active).any():
        head = layout.INACTIVE_BACKGROUND
        values = values[is_active]
    masks = [np.packbits(mask, bitorder="little").tobytes() for mask in (is_child, is_active)]
    return b"".join([*masks, bytes([head]), *_encode(values.tobytes(), flags)])
