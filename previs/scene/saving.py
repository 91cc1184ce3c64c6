"""Writing a layer to a file, with the voxels of the scene beside it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from pxr import Sdf, Tf, UsdUtils

from .. import vdb
from ..errors import PrevisError
from .voxels import VoxelFiles

FILE_ENDINGS = (".usda", ".usd", ".usdc")


def export(layer: Sdf.Layer, path: Path, voxel_files: VoxelFiles) -> None:
    """Write a layer with relative asset paths, and the scene's own voxel files beside it."""
    if path.suffix not in FILE_ENDINGS:
        raise ValueError(f"{path}: a scene is saved as {', '.join(FILE_ENDINGS)}")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise PrevisError(f"{folder}: no such folder to save in")
    copy = Sdf.Layer.CreateAnonymous(path.suffix)
    copy.TransferContent(layer)
    voxels: dict[str, str] = {}

    def relocate(asset_path: str) -> str:
        absolute = os.path.realpath(asset_path)
        if voxel_files.owns(asset_path):
            stem = Path(asset_path).name.rsplit("_", 1)[0]
            voxels.setdefault(absolute, _unique(f"{path.stem}_{stem}", set(voxels.values())))
            return f"./{voxels[absolute]}"
        # In a layer without a folder a relative path is relative to the working folder.
        if os.path.isabs(asset_path) or os.path.exists(asset_path):
            return os.path.relpath(os.path.abspath(asset_path), folder)
        return asset_path

    UsdUtils.ModifyAssetPaths(copy, relocate)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=folder) as beside:
            for source, name in voxels.items():
                vdb.write(os.path.join(beside, name), vdb.read(source))
            written = os.path.join(beside, path.name)
            if not copy.Export(written):
                raise PrevisError(f"{path}: cannot be written")
            for name in voxels.values():
                os.replace(os.path.join(beside, name), folder / name)
            os.replace(written, path)
        loaded = Sdf.Layer.Find(str(path.absolute()))
        if loaded is not None:
            # USD hands out the layer in memory for as long as anybody holds it.
            loaded.Reload(True)
    except OSError as error:
        raise PrevisError(f"{path}: cannot be written: {error.strerror or error}") from error
    except Tf.ErrorException as error:
        raise PrevisError(f"{path}: cannot be written") from error


def _unique(stem: str, taken: set[str]) -> str:
    name, number = f"{stem}.vdb", 2
    while name in taken:
        name, number = f"{stem}_{number}.vdb", number + 1
    return name
