"""Arrays of voxels: checked, written to temporary .vdb files, and referred to by the fields of a Volume."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Sdf, UsdVol, Vt

from .. import vdb
from .arguments import Vector, checked_box, checked_transform
from .attributes import set_value

if TYPE_CHECKING:
    import tempfile


class VoxelFiles:
    """The temporary voxel files of one scene, in a folder that `close` removes."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._count = 0
        self._kept: set[str] = set()

    def author(self, volume: UsdVol.Volume, arrays: Mapping[str, np.ndarray], matrix: np.ndarray) -> None:
        """Write the arrays to a file and point the volume's fields to it."""
        file = self._new_path(volume.GetPrim().GetName())
        grids = [vdb.Grid.from_dense(name, array, matrix) for name, array in arrays.items()]
        vdb.write(file, grids, compression="none")
        for name in arrays:
            if not volume.HasFieldRelationship(name):
                volume.CreateFieldRelationship(name, volume.GetPath().AppendChild(name))
            asset = UsdVol.OpenVDBAsset.Define(volume.GetPrim().GetStage(), volume.GetFieldPath(name))
            before = asset.CreateFilePathAttr().Get()
            set_value(asset.GetFilePathAttr(), Sdf.AssetPath(file), None)
            set_value(asset.CreateFieldNameAttr(), name, None)
            if asset.GetFieldIndexAttr().HasAuthoredValue():
                set_value(asset.GetFieldIndexAttr(), 0, None)
            asset.CreateFieldDataTypeAttr("float")
            asset.CreateFieldClassAttr("fogVolume")
            if before is not None and self._may_go(before.path) and not _refers_to(volume, before.path):
                os.remove(before.path)
        corners = grid_extent(arrays["density"].shape, matrix)
        volume.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, c)) for c in corners]))

    def owns(self, file: str) -> bool:
        """Whether a file is one of these."""
        if self._folder is None or not os.path.isfile(file):
            return False
        return os.path.dirname(os.path.realpath(file)) == os.path.realpath(self._folder.name)

    def keep(self) -> None:
        """Keep the files there are until `close`, even when no field refers to them any more: undo may want them."""
        if self._folder is not None:
            self._kept.update(os.listdir(self._folder.name))

    def _may_go(self, file: str) -> bool:
        return self.owns(file) and os.path.basename(file) not in self._kept

    def close(self) -> None:
        """Remove the files."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _new_path(self, name: str) -> str:
        if self._folder is None:
            import tempfile

            self._folder = tempfile.TemporaryDirectory(prefix="previs-scene-")
        self._count += 1
        return os.path.join(self._folder.name, f"{name}_{self._count}.vdb")


def _refers_to(volume: UsdVol.Volume, file: str) -> bool:
    """Whether another field of the volume still uses a file."""
    fields = (
        UsdVol.OpenVDBAsset(volume.GetPrim().GetStage().GetPrimAtPath(p)) for p in volume.GetFieldPaths().values()
    )
    paths = (asset.GetFilePathAttr().Get() for asset in fields if asset)
    return any(p is not None and p.path == file for p in paths)


def _voxels(name: str, array: ArrayLike) -> np.ndarray:
    voxels = np.asarray(array)
    if voxels.ndim != 3 or voxels.size == 0:
        raise ValueError(f"{name} must be an array of shape (X, Y, Z), not {voxels.shape}")
    if voxels.dtype.kind not in "fiub":
        raise ValueError(f"{name} must hold real numbers, not {voxels.dtype}")
    return voxels


def field_arrays(
    density: ArrayLike, temperature: ArrayLike | None, emission: ArrayLike | None
) -> dict[str, np.ndarray]:
    """The voxels by field name, checked."""
    arrays = {"density": _voxels("density", density)}
    for name, array in (("temperature", temperature), ("emission", emission)):
        if array is not None:
            arrays[name] = _voxels(name, array)
            if arrays[name].shape != arrays["density"].shape:
                shapes = f"{arrays[name].shape}, density {arrays['density'].shape}"
                raise ValueError(f"{name} has the shape {shapes}: they must be equal")
    return arrays


def index_transform(
    shape: tuple[int, ...], bounds: tuple[Vector, Vector] | None, transform: ArrayLike | None
) -> np.ndarray:
    """Index space to local space."""
    if transform is not None:
        if bounds is not None:
            raise ValueError("give either bounds or transform")
        matrix = checked_transform(transform)
        if np.linalg.det(matrix[:3, :3]) == 0.0:
            raise ValueError("transform is singular: the volume would have no thickness")
        return matrix
    size = np.array(shape, float)
    lo, hi = checked_box(bounds) if bounds is not None else (-0.5 * size, 0.5 * size)
    step = (hi - lo) / size
    matrix = np.diag([*step, 1.0])
    matrix[3, :3] = lo + 0.5 * step
    return matrix


def grid_extent(shape: tuple[int, ...], matrix: np.ndarray) -> np.ndarray:
    """Local box (2, 3) of everything the field can reach: one voxel beyond the outermost centres."""
    corners = np.array([[(-1.0, n)[(i >> a) & 1] for a, n in enumerate(shape)] for i in range(8)])
    placed = corners @ matrix[:3, :3] + matrix[3, :3]
    return np.array([placed.min(axis=0), placed.max(axis=0)])
