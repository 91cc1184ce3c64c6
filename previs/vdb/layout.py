"""What a .vdb file is made of: the numbers and names that its reader and its writer must agree on.

A file is little-endian. It opens with a magic number, a file version, a flag that says whether each grid carries
its own offsets, a UUID, a metadata map and the number of grids. A grid is a descriptor (unique name, type, parent's
name, three offsets), compression flags, a metadata map, a transform, the topology of its tree and the leaf buffers.

The tree is always root → 32³ → 16³ → 8³ voxels: a child of the root spans 4096 voxels along an axis, its children
128, theirs, the leaves, 8. Inside a node x is the slowest axis and z the fastest; bit i of a mask is bit i % 8 of
byte i // 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAGIC = 0x56444220
OLDEST_VERSION = 220  # older files store transforms and compression in other places
VERSION_FRUSTUM_BOX = 221  # from here on the box of a frustum transform is of doubles
VERSION_NODE_MASK = 222  # from here on a node says how its inactive values were dropped
WRITTEN_VERSION = 224

COMPRESS_ZIP = 1
COMPRESS_ACTIVE_MASK = 2
COMPRESS_BLOSC = 4
COMPRESS_ALL = COMPRESS_ZIP | COMPRESS_ACTIVE_MASK | COMPRESS_BLOSC

# How a node's inactive values are stored, the byte in front of its values. Writers drop inactive values and
# say here what to put in their place.
INACTIVE_BACKGROUND = 0
INACTIVE_MINUS_BACKGROUND = 1
INACTIVE_ONE_VALUE = 2
INACTIVE_MASK_OF_BACKGROUNDS = 3
INACTIVE_MASK_AND_ONE_VALUE = 4
INACTIVE_MASK_AND_TWO_VALUES = 5
INACTIVE_STORED = 6

LEAF_SIZE = 8
LEAF_VOXELS = 512
LEAF_MASK_BYTES = 64
NODE1_SPAN = 128  # a 16³ node of leaves
NODE2_SPAN = 4096  # a 32³ node of 16³ nodes
NODE1_LOG2 = 4
NODE2_LOG2 = 5

NAME_SEPARATOR = "\x1e"  # same-named grids are kept apart as name, separator, number
HALF_SUFFIX = "_HalfFloat"
HALF_METADATA = "is_saved_as_half_float"

GRID_CLASSES = ("fog volume", "level set", "staggered")  # any other is "unknown"


@dataclass(frozen=True)
class ValueSpec:
    """One value of a grid: its OpenVDB name, scalar type and number of components."""

    name: str
    scalar: np.dtype
    components: int = 1

    @property
    def itemsize(self) -> int:
        """Bytes of one value in memory."""
        return self.scalar.itemsize * self.components

    @property
    def shape(self) -> tuple[int, ...]:
        """The trailing array axes of one value: () or (3,)."""
        return () if self.components == 1 else (self.components,)

    @property
    def is_real(self) -> bool:
        """Whether a file may hold these values as half floats."""
        return self.scalar.kind == "f"

    @property
    def tree_type(self) -> str:
        """The grid type of the descriptor."""
        return f"Tree_{self.name}_5_4_3"


VALUE_SPECS = {
    spec.name: spec
    for spec in (
        ValueSpec("float", np.dtype("<f4")),
        ValueSpec("double", np.dtype("<f8")),
        ValueSpec("int32", np.dtype("<i4")),
        ValueSpec("int64", np.dtype("<i8")),
        ValueSpec("vec3s", np.dtype("<f4"), 3),
        ValueSpec("vec3d", np.dtype("<f8"), 3),
        ValueSpec("vec3i", np.dtype("<i4"), 3),
    )
}
SPEC_OF_TREE = {spec.tree_type: spec for spec in VALUE_SPECS.values()}


def offset_coordinates(offsets: np.ndarray, log2_side: int) -> np.ndarray:
    """Child coordinates (n, 3) int32 of linear offsets in a node of 2**log2_side children a side, x slowest."""
    side_mask = (1 << log2_side) - 1
    coordinates = np.empty((len(offsets), 3), dtype=np.int32)
    coordinates[:, 0] = offsets >> (2 * log2_side)
    coordinates[:, 1] = (offsets >> log2_side) & side_mask
    coordinates[:, 2] = offsets & side_mask
    return coordinates


def linear_offsets(coordinates: np.ndarray, log2_side: int) -> np.ndarray:
    """The inverse of :func:`offset_coordinates`: (n, 3) child coordinates → (n,) linear offsets."""
    x, y, z = coordinates.T.astype(np.int64)
    return (x << (2 * log2_side)) | (y << log2_side) | z
