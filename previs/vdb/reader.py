"""A .vdb file → grids, or a list of what is in it.

Reads file versions 220 and up (OpenVDB 2 of 2013 onwards) as OpenVDB's own library writes them: float, double, half,
int32, int64 and three-component vector grids; none, zip and Blosc compression with and without active-mask
compression; affine transforms; instanced grids; files with grid offsets and streams without them. Frustum transforms
and bool, mask and point grids are recognised and refused by name.

Nothing in a file is believed before it is checked: a size is compared with the bytes that are left, the offsets of
grids must rise, and whatever goes wrong inside comes out as one sentence that names the file.
"""

from __future__ import annotations

import errno
import io
import mmap
import os
import stat
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import numpy as np

from . import layout
from .grid import Grid
from .layout import ValueSpec
from .tree import Tree, TreeFormat, read_tree, skip_tree

_DELAYED_LOAD = "__delayedload"  # a table of leaf sizes for OpenVDB's own lazy reading, as large as it is useless here
_LARGE_TREE = 1 << 26  # bytes from which a tree's are let go while it is decoded
_BYTE = ValueSpec("bool", np.dtype("u1"))
# Leaf buffers of the types that are skipped and not read: active mask, origin and, for bool, a mask of values.
_SKIPPED_LEAVES = {"Tree_bool_5_4_3": 64 + 12 + 64, "Tree_mask_5_4_3": 64 + 12}


@dataclass(frozen=True, eq=False)
class GridInfo:
    """What a file says about one of its grids, without its values.

    * ``name``, ``index``, ``grid_class``, ``metadata``: as in :class:`Grid`;
    * ``type``: the type as the file names it, for instance "Tree_float_5_4_3"; ``value_type`` as in :class:`Grid`, or
      None for a type that is not read;
    * ``index_to_world``: (4, 4) float64, None for a transform that is not affine;
    * ``bounds``: the inclusive index box (lo, hi) and ``active_count`` the number of active voxels that the writer
      noted: None where it did not, or where nothing is active. A claim, unlike those of a :class:`Grid`;
    * ``half``: whether values are stored as half floats;
    * ``unsupported``: None, or the reason why :func:`read` refuses the grid.
    """

    name: str
    index: int
    type: str
    value_type: str | None
    grid_class: str
    index_to_world: np.ndarray | None
    bounds: tuple[np.ndarray, np.ndarray] | None
    active_count: int | None
    half: bool
    unsupported: str | None
    metadata: Mapping[str, Any]


def read(path: str | os.PathLike[str], names: Collection[str] | None = None) -> list[Grid]:
    """Read the grids of a .vdb file, in the order of the file.

    ``names`` (default None: all) picks grids by name; the others are passed over without decoding their values, and a
    name that the file lacks is not in the result. Several grids may have one name: see ``Grid.index``.

    Grids that cannot be read (see :func:`read_metadata`) are left out if ``names`` is None and another grid can be
    read; they raise NotImplementedError, with the grid's name and type, if they were asked for or if they are all
    there is. A stream file may hold grids that cannot be found behind an unsupported one: they count as unsupported.
    Raises ValueError for a file that is damaged or is no .vdb, OSError if it cannot be opened.
    """
    wanted = {names} if isinstance(names, str) else None if names is None else set(names)
    with _explained(path), _open(path) as file:
        archive = _Archive(file)
        entries = archive.entries()
        chosen = [e for e in entries if wanted is None or e.name in wanted]
        readable = [e for e in chosen if e.unsupported is None]
        refused = [e for e in chosen if e.unsupported is not None]
        if refused and (wanted is not None or not readable):
            raise NotImplementedError(refused[0].unsupported)
        if archive.cut_short is not None and wanted is not None and not wanted <= {e.name for e in entries}:
            raise NotImplementedError(archive.cut_short)
        return [archive.grid(entry) for entry in readable]


def read_metadata(path: str | os.PathLike[str]) -> list[GridInfo]:
    """List the grids of a .vdb file, unsupported ones too, without decoding their values.

    A stream file has no offsets, so what follows a point grid or a tree of another shape in it cannot be found:
    the list ends with that grid. Raises ValueError and OSError as :func:`read` does.
    """
    with _explained(path), _open(path) as file:
        return [_info(entry) for entry in _Archive(file).entries()]


def _open(path: str | os.PathLike[str]) -> BinaryIO:
    # Opening a pipe would wait for its writer, for ever perhaps.
    if stat.S_ISFIFO(os.stat(path).st_mode):
        raise OSError(errno.EINVAL, "it is a pipe and not a file", os.fspath(path))
    return open(path, "rb")


@contextmanager
def _explained(path: str | os.PathLike[str]) -> Iterator[None]:
    """Whatever goes wrong inside comes out as one of three exceptions with a sentence that names the file."""
    shown = os.fspath(path)
    if isinstance(shown, bytes):
        shown = os.fsdecode(shown)
    try:
        yield
    except NotImplementedError as error:
        raise NotImplementedError(f"{shown}: {error}") from None
    except OSError as error:
        if error.filename is None:
            raise OSError(error.errno, f"{error.strerror or error}", shown) from error
        raise
    except ValueError as error:
        raise ValueError(f"{shown}: cannot be read: {error}") from error
    except (struct.error, IndexError, zlib.error, OverflowError) as error:
        raise ValueError(f"{shown}: the file is damaged or cut short ({error})") from error
    except MemoryError as error:
        raise ValueError(f"{shown}: the file is damaged or too large for this machine's memory") from error


# --- the file -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Entry:
    """A grid up to its tree."""

    unique_name: str
    type: str
    parent: str
    half: bool
    compression: int
    metadata: dict[str, Any]
    index_to_world: np.ndarray | None
    tree_start: int
    tree_end: int  # where the tree may end at most
    transform: str
    index: int = 0

    @property
    def unsupported(self) -> str | None:
        if self.type not in layout.SPEC_OF_TREE:
            kind = self.type.removeprefix("Tree_").split("_")[0]
            if kind in layout.VALUE_SPECS:
                return f"grid {self.name!r} has a tree of an unusual shape ({self.type}), which is not supported"
            kind = "point" if kind.startswith("pt") else kind
            return f"grid {self.name!r} is a {kind} grid ({self.type}), which is not supported"
        if self.index_to_world is None:
            return f"grid {self.name!r} ({self.type}) has a {self.transform} transform; only affine ones are supported"
        return None

    @property
    def name(self) -> str:
        return self.unique_name.split(layout.NAME_SEPARATOR, 1)[0]

    @property
    def grid_class(self) -> str:
        noted = self.metadata.get("class")
        return noted if noted in layout.GRID_CLASSES else "unknown"


class _Archive:
    """An open file: its header is read at once, its grids on demand."""

    def __init__(self, file: BinaryIO) -> None:
        size = os.fstat(file.fileno()).st_size
        self._cursor = _Cursor(file, 0, size)
        self._trees: dict[int, Tree] = {}  # by where they start in the file
        self._listed: dict[str, _Entry] = {}
        self.cut_short: str | None = None
        if self._cursor.size < 12 or self._cursor.unpack("<q") != layout.MAGIC:
            raise ValueError("it is not an OpenVDB file")
        self.version = self._cursor.unpack("<I")
        if self.version < layout.OLDEST_VERSION:
            raise NotImplementedError(
                f"its file version is {self.version}, and versions before {layout.OLDEST_VERSION} are not supported; "
                "load it in any current application and save it again"
            )
        self._cursor.take(8)  # the version of the library that wrote it
        self._has_offsets = self._cursor.unpack("<B") != 0
        self._flags = 0
        if self.version < layout.VERSION_NODE_MASK:
            self._flags = layout.COMPRESS_ZIP if self._cursor.unpack("<B") else 0
        self._cursor.take(36)  # a UUID
        if not self._has_offsets:
            # The trees themselves say where the next grid begins, so they have to be walked: in memory.
            position = self._cursor.position
            file.seek(0)
            content = file.read(size)
            self._cursor = _Cursor(io.BytesIO(content), position, len(content))
        _read_metadata_map(self._cursor)
        self._grid_count = self._cursor.unpack("<i")
        if self._grid_count < 0:
            raise ValueError(f"it announces {self._grid_count} grids")

    def entries(self) -> list[_Entry]:
        """All grids of the file; those of a stream that cannot be found are missing and ``cut_short`` says why."""
        found: list[_Entry] = []
        for _ in range(self._grid_count):
            entry = self._read_entry()
            self._listed.setdefault(entry.unique_name, entry)
            found.append(entry)
            if self._has_offsets:
                self._cursor.position = entry.tree_end
            elif not self._pass_tree(entry):
                self.cut_short = f"what follows grid {entry.name!r} of type {entry.type} in this stream cannot be found"
                break
        return _numbered(found)

    def grid(self, entry: _Entry) -> Grid:
        """Decode one grid; an instance gets the very arrays of its parent."""
        owner = entry
        if entry.parent:
            if entry.parent not in self._listed or self._listed[entry.parent].parent:
                raise ValueError(f"grid {entry.name!r} is an instance of {entry.parent!r}, which has no tree")
            owner = self._listed[entry.parent]
            if owner.type != entry.type:
                raise ValueError(f"grid {entry.name!r} is an instance of a grid of another type")
        tree = self._tree(owner)
        spec = layout.SPEC_OF_TREE[owner.type]
        return Grid(
            name=entry.name,
            index_to_world=entry.index_to_world,
            leaf_origins=tree.leaf_origins,
            leaf_values=tree.leaf_values,
            leaf_active=tree.leaf_masks,
            background=tree.background.item() if spec.components == 1 else tuple(tree.background.tolist()),
            tiles=tree.tiles,
            inactive_tiles=tree.inactive_tiles,
            grid_class=entry.grid_class,
            value_type=spec.name,
            index=entry.index,
            metadata=entry.metadata,
        )

    def _tree(self, entry: _Entry) -> Tree:
        if entry.tree_start not in self._trees:
            data, release = self._cursor.releasable(entry.tree_start, entry.tree_end)
            self._trees[entry.tree_start], _ = read_tree(data, self._format(entry), release)
        return self._trees[entry.tree_start]

    def _format(self, entry: _Entry) -> TreeFormat:
        return TreeFormat(self.version, entry.compression, layout.SPEC_OF_TREE.get(entry.type, _BYTE), entry.half)

    def _pass_tree(self, entry: _Entry) -> bool:
        """Move behind the tree of a stream's grid; False if the end of its type of tree cannot be found."""
        if entry.index_to_world is None and entry.transform != _FRUSTUM:
            return False
        if entry.parent:
            return True
        data = self._cursor.view(entry.tree_start, entry.tree_end)
        if entry.type in layout.SPEC_OF_TREE:
            size = skip_tree(data, self._format(entry))
        elif entry.type in _SKIPPED_LEAVES:
            size = skip_tree(data, self._format(entry), _SKIPPED_LEAVES[entry.type])
        else:
            return False
        self._cursor.position = entry.tree_start + size
        return True

    def _read_entry(self) -> _Entry:
        cursor = self._cursor
        unique_name, grid_type, parent = (cursor.string() for _ in range(3))
        grid_start, _, grid_end = (cursor.unpack("<q") for _ in range(3))
        half = grid_type.endswith(layout.HALF_SUFFIX)
        grid_type = grid_type.removesuffix(layout.HALF_SUFFIX)
        end = cursor.size
        if self._has_offsets:
            # Rising offsets keep grids from sharing bytes, so the work is bounded by the file's size.
            if not cursor.position <= grid_start <= grid_end <= cursor.size:
                raise ValueError(f"the offsets of grid {unique_name!r} are not inside the file")
            cursor = _Cursor(cursor.file, grid_start, grid_end)
            end = grid_end
        compression = self._flags
        if self.version >= layout.VERSION_NODE_MASK:
            compression = cursor.unpack("<I")
            if compression & ~layout.COMPRESS_ALL:
                raise ValueError(f"grid {unique_name!r} has unknown compression flags {compression:#x}")
        metadata = _read_metadata_map(cursor)
        # A reader that follows the metadata and one that follows the type would differ only for a damaged file.
        half = bool(metadata.get(layout.HALF_METADATA, half))
        matrix, map_name = _read_transform(cursor, self.version)
        self._cursor.position = max(self._cursor.position, cursor.position)
        return _Entry(
            unique_name=unique_name,
            type=grid_type,
            parent=parent,
            half=half,
            compression=compression,
            metadata=metadata,
            index_to_world=matrix,
            tree_start=cursor.position,
            tree_end=end,
            transform=map_name,
        )


def _numbered(entries: list[_Entry]) -> list[_Entry]:
    """Give each grid its index among those of its name: the file's own ``index`` metadata if it tells them apart."""
    groups: dict[str, list[int]] = defaultdict(list)
    for position, entry in enumerate(entries):
        groups[entry.name].append(position)
    numbered = list(entries)
    for positions in groups.values():
        noted = [entries[p].metadata.get("index") for p in positions]
        usable = all(type(n) is int for n in noted) and len(set(noted)) == len(noted)
        for rank, (position, note) in enumerate(zip(positions, noted, strict=True)):
            numbered[position] = replace(entries[position], index=note if usable else rank)
    return numbered


def _info(entry: _Entry) -> GridInfo:
    metadata = entry.metadata
    bounds = None
    corners = [metadata.get("file_bbox_min"), metadata.get("file_bbox_max")]
    if all(isinstance(c, tuple) and len(c) == 3 and all(isinstance(v, int) for v in c) for c in corners):
        low, high = (np.array(c, np.int64) for c in corners)
        bounds = (low, high) if (low <= high).all() else None
    count = metadata.get("file_voxel_count")
    spec = layout.SPEC_OF_TREE.get(entry.type)
    return GridInfo(
        name=entry.name,
        index=entry.index,
        type=entry.type,
        value_type=spec.name if spec else None,
        grid_class=entry.grid_class,
        index_to_world=entry.index_to_world,
        bounds=bounds,
        active_count=count if isinstance(count, int) else None,
        half=entry.half,
        unsupported=entry.unsupported,
        metadata=metadata,
    )


# --- small parts ----------------------------------------------------------------------------------------------


@dataclass
class _Cursor:
    """A place in a file before ``size``; every step is checked against what is left."""

    file: BinaryIO
    position: int
    size: int

    def take(self, count: int) -> bytes:
        if count > self.size - self.position:
            raise ValueError(f"it ends too early: {count} bytes are announced and {self.size - self.position} are left")
        self.file.seek(self.position)
        taken = self.file.read(count)
        if len(taken) != count:
            raise ValueError("it became shorter while it was read")
        self.position += count
        return taken

    def unpack(self, one: str) -> Any:
        return struct.unpack(one, self.take(struct.calcsize(one)))[0]

    def string(self) -> str:
        # Names are UTF-8 by convention only, and a name in another encoding is no reason to refuse a grid.
        return self.take(self.unpack("<I")).decode("utf-8", errors="replace")

    def view(self, start: int, stop: int) -> memoryview:
        """The bytes of a range, without a copy if the file is in memory."""
        if isinstance(self.file, io.BytesIO):
            return self.file.getbuffer()[start:stop]
        return memoryview(_Cursor(self.file, start, stop).take(stop - start))

    def releasable(self, start: int, stop: int) -> tuple[memoryview, Callable[[int], None]]:
        """The bytes of a range, and what gives the memory of so many of the first of them back to the system."""
        count = stop - start
        if isinstance(self.file, io.BytesIO) or count < _LARGE_TREE or not hasattr(mmap, "MADV_DONTNEED"):
            return self.view(start, stop), lambda _: None
        # A copy: if the file itself were mapped, one that is cut off meanwhile would end the process.
        held = mmap.mmap(-1, count, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        self.file.seek(start)
        if self.file.readinto(held) != count:
            raise ValueError("it became shorter while it was read")
        released = 0

        def release(position: int) -> None:
            nonlocal released
            whole = min(position, count) // mmap.PAGESIZE * mmap.PAGESIZE
            if whole > released:
                held.madvise(mmap.MADV_DONTNEED, released, whole - released)
                released = whole

        return memoryview(held), release


_VECTOR_METADATA = {
    f"{shape}{suffix}": (code, count)
    for shape, count in (("vec2", 2), ("vec3", 3), ("vec4", 4), ("mat3", 9), ("mat4", 16), ("quat", 4))
    for suffix, code in (("i", "i"), ("s", "f"), ("d", "d"))
}
_SCALAR_METADATA = {"bool": "?", "int32": "i", "int64": "q", "float": "f", "double": "d"}


def _read_metadata_map(cursor: _Cursor) -> dict[str, Any]:
    """Metadata as Python values: str, bool, int, float, tuples; bytes of a type that is not known."""
    metadata = {}
    for _ in range(cursor.unpack("<I")):
        key, kind = cursor.string(), cursor.string()
        content = cursor.take(cursor.unpack("<I"))
        if kind == "string":
            metadata[key] = content.decode("utf-8", errors="replace")
        elif kind in _SCALAR_METADATA and len(content) == struct.calcsize(f"<{_SCALAR_METADATA[kind]}"):
            (metadata[key],) = struct.unpack(f"<{_SCALAR_METADATA[kind]}", content)
        elif kind in _VECTOR_METADATA:
            code, count = _VECTOR_METADATA[kind]
            known = len(content) == struct.calcsize(f"<{count}{code}")
            metadata[key] = struct.unpack(f"<{count}{code}", content) if known else content
        elif kind != _DELAYED_LOAD:
            metadata[key] = content
    return metadata


_FRUSTUM = "NonlinearFrustumMap"
_SCALE_ONLY = ("ScaleMap", "UniformScaleMap")
_SCALE_TRANSLATE = ("ScaleTranslateMap", "UniformScaleTranslateMap")
_WHOLE_MATRIX = ("AffineMap", "UnitaryMap")


def _read_transform(cursor: _Cursor, version: int) -> tuple[np.ndarray | None, str]:
    """The matrix of a grid's transform, None if it is not affine, and the name of its kind."""
    name = cursor.string()
    if name == _FRUSTUM:
        # Stepped over, since in a stream the next grid stands behind it: a box, two numbers and an affine map.
        cursor.take((24 if version < layout.VERSION_FRUSTUM_BOX else 48) + 16)
        _affine(cursor, cursor.string())
        return None, name
    return _affine(cursor, name), name


def _affine(cursor: _Cursor, name: str) -> np.ndarray | None:
    matrix = np.eye(4)
    if name in _WHOLE_MATRIX:
        matrix = np.frombuffer(cursor.take(128), "<f8").reshape(4, 4).astype(np.float64)
    elif name == "TranslationMap":
        matrix[3, :3] = np.frombuffer(cursor.take(24), "<f8")
    elif name in _SCALE_ONLY or name in _SCALE_TRANSLATE:
        if name in _SCALE_TRANSLATE:
            matrix[3, :3] = np.frombuffer(cursor.take(24), "<f8")
        # Behind the scale stand its absolute value, inverse and so on, which follow from it.
        matrix[range(3), range(3)] = np.frombuffer(cursor.take(120), "<f8")[:3]
    else:
        return None
    if not np.isfinite(matrix).all() or not np.allclose(matrix[:, 3], (0, 0, 0, 1), rtol=0, atol=1e-6):
        raise ValueError("a transform is not a finite affine matrix")
    matrix[:, 3] = (0, 0, 0, 1)
    with np.errstate(all="ignore"):
        if not np.linalg.det(matrix[:3, :3]):
            raise ValueError("a transform is singular")
    return matrix
