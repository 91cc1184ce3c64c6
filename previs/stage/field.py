"""The voxels behind a field prim: from an OpenVDBAsset to a cleaned grid, read once.

Fields resolve their file through USD, so a path is relative to the layer that authors it and may lie inside a .usdz.
"""

from __future__ import annotations

import os
import threading
from collections import Counter, OrderedDict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from pxr import Ar, Sdf, Usd

from .. import vdb
from ..description import Note, SparseGrid
from ..errors import PrevisError
from .values import attribute_value

#: Voxels of files that are not in the picture any more are kept up to this many bytes, for scrubbing back and forth.
CACHE_BYTES = 1 << 30
_LEAVES = 4096  # looked through and cleaned at a time


@dataclass
class LoadedGrid:
    """A grid, its file and identity, and what is to be said of it (`notes` are (kind, message))."""

    key: Hashable
    file: str
    grid: SparseGrid
    notes: list[tuple[str, str]]

    @property
    def nbytes(self) -> int:
        """Memory of the leaf values, the bulk of a grid, and of a bit for each voxel whether it is active."""
        return int(self.grid.leaf_values.nbytes) + len(self.grid.leaf_origins) * 64


@dataclass(frozen=True)
class GridRequest:
    """A grid that a field prim names at some time: all that is needed to read it without USD.

    `field` is the relationship by which a volume uses the prim, such as "density"; "" where nobody asked.
    """

    prim: str
    file: str
    name: str
    index: int | None
    field: str = ""


class GridCache:
    """Grids by (file, its modification time and size, grid name, field index); the longest unused go first.

    `load` may be called from any thread; a grid that two threads ask for is read once.
    """

    def __init__(self, counters: Counter[str], limit: int = CACHE_BYTES) -> None:
        self._grids: OrderedDict[Hashable, LoadedGrid] = OrderedDict()
        self._used: set[Hashable] = set()
        self._counters = counters
        self._limit = limit
        self._lock = threading.Lock()
        self._loading: dict[Hashable, threading.Event] = {}
        self._reading = False

    def begin(self) -> None:
        """Start a reading: from here on every grid that is used is in the picture."""
        with self._lock:
            self._used.clear()
            self._reading = True

    def use(self, key: Hashable) -> None:
        """Say that a grid is in the picture."""
        with self._lock:
            self._used.add(key)

    def end(self) -> None:
        """Drop what is over the limit and not in the picture."""
        with self._lock:
            self._reading = False
            self._evict()

    def _evict(self) -> None:
        total = sum(g.nbytes for g in self._grids.values())
        # The newest stays even when it is too large alone: somebody has just asked for it.
        for key in list(self._grids)[:-1]:
            if total <= self._limit:
                break
            if key not in self._used:
                total -= self._grids.pop(key).nbytes

    def forget_changed(self) -> None:
        """Drop the grids whose files are other ones by now."""
        with self._lock:
            for key in [key for key, grid in self._grids.items() if not is_current(key, grid.file)]:
                del self._grids[key]

    def holds(self, resolved: str, name: str, index: int | None) -> bool:
        """Whether a grid is in memory, as its file is now."""
        try:
            key = (*_identity(resolved), name, index)
        except PrevisError:
            return False
        with self._lock:
            return key in self._grids

    def load(self, resolved: str, name: str, index: int | None) -> LoadedGrid:
        """The grid of a file. Raises `PrevisError` without a prim path: the caller knows whose field it is."""
        key = (*_identity(resolved), name, index)
        while True:
            with self._lock:
                found = self._grids.get(key)
                if found is not None:
                    self._grids.move_to_end(key)
                    return found if found.file == resolved else replace(found, file=resolved)
                other = self._loading.get(key)
                if other is None:
                    self._loading[key] = threading.Event()
                    break
            other.wait()
        try:
            grid, notes = _pick(_read_file(resolved, name), resolved, index)
            grid, repairs = cleaned(grid)
            loaded = LoadedGrid(key, resolved, grid, notes + repairs)
            with self._lock:
                self._counters["grids"] += 1
                self._grids[key] = loaded
                # A reading says only at its end what it uses.
                if not self._reading:
                    self._evict()
            return loaded
        finally:
            with self._lock:
                self._loading.pop(key).set()


def grid_request(prim: Usd.Prim, time: Usd.TimeCode, field: str = "") -> GridRequest:
    """What an OpenVDBAsset names at a time. Raises `PrevisError`, which names the prim, when there is no such file."""
    asset = attribute_value(prim, "filePath", time)
    if asset is None or not asset.path:
        raise PrevisError(f"{prim.GetPath()}: has no filePath at this time; author the path of a .vdb file")
    resolved = asset.resolvedPath
    if not resolved or not (Ar.IsPackageRelativePath(resolved) or os.path.isfile(resolved)):
        raise PrevisError(f"{prim.GetPath()}: {asset.path}: no such file (paths are relative to the authoring layer)")
    name = str(attribute_value(prim, "fieldName", time, "") or "")
    index_attribute = prim.GetAttribute("fieldIndex")
    index = index_attribute.Get(time) if index_attribute else None
    return GridRequest(str(prim.GetPath()), resolved, name, None if index is None else int(index), field)


def fetch_grid(request: GridRequest, grids: GridCache) -> LoadedGrid:
    """The grid of a request. Raises `PrevisError`, which names the prim, the file and the cause."""
    try:
        return grids.load(request.file, request.name, request.index)
    except PrevisError as error:
        raise PrevisError(f"{request.prim}: {error}") from error


def named_file(prim: Usd.Prim, time: Usd.TimeCode) -> str | None:
    """The file on disk that an OpenVDBAsset names at a time, whether it exists or not; None for no file."""
    asset = attribute_value(prim, "filePath", time)
    if asset is None or not asset.path:
        return None
    path = asset.resolvedPath
    if not path:
        stack = prim.GetAttribute("filePath").GetPropertyStack(time)
        path = Sdf.ComputeAssetPathRelativeToLayer(stack[0].layer, asset.path) if stack else asset.path
    return outer_file(path)


def outer_file(path: str) -> str:
    """The file that a path leads into: for one inside a package the package."""
    return Ar.SplitPackageRelativePathOuter(path)[0] if Ar.IsPackageRelativePath(path) else path


def read_field(prim: Usd.Prim, time: Usd.TimeCode, grids: GridCache) -> tuple[LoadedGrid, list[Note]]:
    """The grid that an OpenVDBAsset names at a time, with the notes about it.

    Raises `PrevisError`, which names the prim, the file and, for a wrong name, the grids that the file has.
    """
    loaded = fetch_grid(grid_request(prim, time), grids)
    grids.use(loaded.key)
    notes = [Note(kind, str(prim.GetPath()), message) for kind, message in loaded.notes]
    if (
        attribute_value(prim, "fieldClass", time) == "levelSet"
        and getattr(loaded.grid, "grid_class", "") != "level set"
    ):
        notes.append(Note("approximated", str(prim.GetPath()), _LEVEL_SET))
    return loaded, notes


_LEVEL_SET = "is a level set: its distances are read as densities (negative ones as none)"


def _identity(resolved: str) -> tuple[Hashable, ...]:
    """(real path, modification time, size): equal for the same content under any path."""
    outer, inner = resolved, ""
    if Ar.IsPackageRelativePath(resolved):
        outer, inner = Ar.SplitPackageRelativePathOuter(resolved)
    try:
        status = os.stat(outer)
    except OSError as error:
        raise PrevisError(f"{outer}: {error.strerror or error}") from error
    return os.path.realpath(outer), inner, status.st_mtime_ns, status.st_size


def is_current(key: Hashable, file: str) -> bool:
    """Whether a file still holds the grid that was read from it under that key."""
    try:
        return _identity(file) == key[:-2]
    except PrevisError:
        return False


def _read_file(resolved: str, name: str) -> list[SparseGrid]:
    """The grids of that name; for an empty name those of the only name in the file."""
    if not Ar.IsPackageRelativePath(resolved):
        return _read_vdb(resolved, resolved, name)
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(resolved))
    if not asset:
        raise PrevisError(f"{resolved}: no such file in the package")
    import tempfile

    with tempfile.TemporaryDirectory(prefix="previs-") as folder:
        path = os.path.join(folder, "field.vdb")
        with open(path, "wb") as file:
            file.write(asset.GetBuffer())
        return _read_vdb(path, resolved, name)


def _read_vdb(path: str, label: str, name: str) -> list[SparseGrid]:
    try:
        found = vdb.read(path, names=[name]) if name else []
        if found:
            return found
        known = sorted({info.name for info in vdb.read_metadata(path)})
        if not known:
            raise PrevisError(f"{label}: holds no grids")
        if name:
            raise PrevisError(f"{label}: no grid named {name}; its grids: {', '.join(known)}")
        if len(known) > 1:
            raise PrevisError(f"{label}: fieldName is not authored and the file has several grids: {', '.join(known)}")
        return vdb.read(path, names=known)
    except NotImplementedError as error:
        raise PrevisError(f"{label}: not supported: {_sentence(error, path)}") from error
    except OSError as error:
        raise PrevisError(f"{label}: {error.strerror or error}") from error
    except ValueError as error:
        raise PrevisError(f"{label}: not a readable .vdb file: {_sentence(error, path)}") from error


def _sentence(error: Exception, path: str) -> str:
    """An error's message as one line without the path, which stands before it already."""
    return " ".join(str(error).removeprefix(f"{path}: ").split()).rstrip(".")


def _pick(found: list[SparseGrid], label: str, index: int | None) -> tuple[SparseGrid, list[tuple[str, str]]]:
    """The grid that the index selects among those of one name."""
    notes = []
    if len(found) == 1:
        # A single grid is meant whatever the index says: exporters number grids by their place in the file.
        grid = found[0]
    elif index is None:
        grid = min(found, key=lambda g: g.index)
        notes.append(
            (
                "approximated",
                f"{len(found)} grids are named {grid.name} and fieldIndex is not authored; the first is read",
            )
        )
    else:
        chosen = [g for g in found if g.index == index]
        if not chosen:
            known = ", ".join(str(g.index) for g in sorted(found, key=lambda g: g.index))
            raise PrevisError(f"{label}: no grid {found[0].name} with fieldIndex {index}; there are: {known}")
        grid = chosen[0]
    if grid.grid_class == "level set":
        notes.append(("approximated", _LEVEL_SET))
    return grid, notes


def cleaned(grid: SparseGrid) -> tuple[SparseGrid, list[tuple[str, str]]]:
    """The grid without NaN and negative values (now 0) and infinities (now the largest finite value), and notes.

    The background, tiles and inactive voxels are cleaned too, since interpolation reaches them; only active values are
    counted.
    """
    values = np.asarray(grid.leaf_values)
    if all(_is_clean(np.asarray(a)) for a in (values, grid.tiles.value, grid.inactive_tiles.value, grid.background)):
        return grid, []
    largest = _largest_finite(grid)
    notes = []
    bad = {"NaN": 0, "infinite": 0, "negative": 0}
    values, counts = _clean_array(values, largest, np.asarray(grid.leaf_active))
    for name, count in counts.items():
        bad[name] += count
    changes: dict[str, object] = {"leaf_values": values}
    for attribute in ("tiles", "inactive_tiles"):
        tiles = getattr(grid, attribute)
        tile_values, counts = _clean_array(np.asarray(tiles.value), largest, None)
        if tile_values is not tiles.value:
            changes[attribute] = replace(tiles, value=tile_values)
        if attribute == "tiles":
            for name, count in counts.items():
                bad[name] += count
    background, _ = _clean_array(np.atleast_1d(np.asarray(grid.background, float)), largest, None)
    if not np.array_equal(background, np.atleast_1d(np.asarray(grid.background, float))):
        changes["background"] = background.item() if background.size == 1 else tuple(background.tolist())
    if any(bad.values()):
        what = ", ".join(f"{count} {name}" for name, count in bad.items() if count)
        plural = "value was" if sum(bad.values()) == 1 else "values were"
        notes.append(("repaired", f"{what} {plural} cleaned in grid {grid.name or '(unnamed)'}"))
    if values is grid.leaf_values and len(changes) == 1:
        return grid, notes
    return replace(grid, **changes), notes


def _largest_finite(grid: SparseGrid) -> float:
    slabs = (*_slabs(np.asarray(grid.leaf_values)), np.asarray(grid.tiles.value))
    finite = [float(np.max(a, where=np.isfinite(a), initial=0.0)) for a in slabs if a.size]
    return max(finite, default=0.0)


def _slabs(values: np.ndarray) -> Iterator[np.ndarray]:
    """Views of some leaves at a time: what is made of all voxels at once takes as much memory as they do."""
    for first in range(0, len(values), _LEAVES):
        yield values[first : first + _LEAVES]


def _is_clean(values: np.ndarray) -> bool:
    # min and max are NaN if any value is: two passes tell whether there is anything to do.
    return values.size == 0 or bool(values.min() >= 0 and values.max() < np.inf)


def _clean_array(values: np.ndarray, largest: float, active: np.ndarray | None) -> tuple[np.ndarray, dict[str, int]]:
    """(cleaned values, counts of what was wrong among active ones); the same array when nothing was."""
    if _is_clean(values):
        return values, {}
    result = values.copy()
    counts = {"NaN": 0, "infinite": 0, "negative": 0}
    for first, slab in zip(range(0, len(values), _LEAVES), _slabs(result), strict=True):
        if _is_clean(slab):
            continue
        wrong = {"NaN": np.isnan(slab), "infinite": np.isposinf(slab), "negative": slab < 0}
        slab[wrong["NaN"] | wrong["negative"]] = 0
        slab[wrong["infinite"]] = largest
        counted = True if active is None else active[first : first + _LEAVES]
        for name, mask in wrong.items():
            voxels = mask.any(axis=-1) if active is not None and mask.ndim > active.ndim else mask
            counts[name] += int(np.count_nonzero(voxels & counted))
    return result, counts
