"""A default stage for a .vdb file that comes without one: its fields as a Volume, a sun, a ground and a camera.

What the grids mean is told from their names, and how dense they are made from their values: a ray through the thick
of the volume passes an optical depth of `OPTICAL_DEPTH`, and the brightest flame has a radiance of `FLAME_RADIANCE`
where it is opaque.
"""

from __future__ import annotations

import os

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdVol

from .. import vdb
from ..blackbody import REFERENCE_TEMPERATURE
from ..description import Field, Medium, Note, SceneDescription, SparseGrid, Volume, framing_camera
from ..errors import PrevisError
from ..stage import StageReader
from ..stage.field import LoadedGrid
from .building import SceneBuilder
from .medium import author_medium
from .voxels import VoxelFiles

OPTICAL_DEPTH = 6.0
FLAME_RADIANCE = 2.0
SUN_IRRADIANCE = 10.0
#: Dark enough for smoke to stand out against it.
GROUND_COLOR = 0.06
#: A field of temperatures that reaches this is taken as kelvin; cooler bodies do not glow.
GLOWING = 700.0
FLAME_COLOR = (1.0, 0.35, 0.08)

VOLUME_PATH = "/Volume"
_NUMBERS = ("float", "double", "int32", "int64")
#: The names of grids by what they hold, the likeliest first.
_NAMES = {
    "density": ("density", "smoke", "dens", "soot", "cloud", "fog"),
    "temperature": ("temperature",),
    "emission": ("flame", "flames", "fire", "burn", "emission"),
}


def is_bare_vdb(path: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a .vdb file."""
    return os.fspath(path).lower().endswith(".vdb")


class _Builder(SceneBuilder):
    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self._voxel_files = VoxelFiles()


def layer_of(path: str | os.PathLike[str]) -> Sdf.Layer:
    """A layer in memory with a Volume of the fields of a file.

    Raises `PrevisError`, which names the file, when it is missing, damaged or holds nothing to show.
    """
    name = os.fspath(path)
    layer = Sdf.Layer.CreateAnonymous("bare_vdb.usda")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    volume = UsdVol.Volume.Define(stage, VOLUME_PATH)
    for field, info in _choose(name).items():
        target = volume.GetPath().AppendChild(field)
        volume.CreateFieldRelationship(field, target)
        asset = UsdVol.OpenVDBAsset.Define(stage, target)
        asset.CreateFilePathAttr(Sdf.AssetPath(os.path.abspath(name)))
        asset.CreateFieldNameAttr(info.name)
        asset.CreateFieldIndexAttr(info.index)
    stage.SetDefaultPrim(volume.GetPrim())
    return layer


def furnish(stage: Usd.Stage, reader: StageReader, path: str | os.PathLike[str]) -> Note:
    """Give the Volume of `layer_of` a medium that is visible at once, and the stage a sun, a ground and a camera.

    The voxels are read for it, into the cache of the reader. Returns what is to be said of it. Raises `PrevisError`
    when they cannot be read.
    """
    loaded: dict[str, LoadedGrid] = {}
    for request in reader.grid_requests():
        try:
            loaded[Sdf.Path(request.prim).name] = reader.fetch(request)
        except PrevisError as error:
            raise PrevisError(str(error).removeprefix(f"{request.prim}: ")) from error
    said = "a bare .vdb: shown with a sun and a ground"
    with Usd.EditContext(stage, stage.GetRootLayer()):
        _add_surroundings(stage, loaded.get("density"))
        # A session layer may have taken the volume away.
        if "density" in loaded:
            said += _author_fields(stage.GetPrimAtPath(VOLUME_PATH), loaded)
    return Note("approximated", os.fspath(path), said)


def _author_fields(prim: Usd.Prim, loaded: dict[str, LoadedGrid]) -> str:
    """Author the medium, and leave out the fields that it does not use; returns what is to be said of it."""
    density = loaded["density"].grid
    values = _medium(density, {name: found.grid for name, found in loaded.items()})
    author_medium(prim, values, None, keep=False)
    said = f"; grid {density.name or '(unnamed)'} is the density, its extinction {values['extinction'][0]:g} per unit"
    for name in ("temperature", "emission"):
        if name not in loaded:
            continue
        grid = loaded[name].grid
        if "emission" in values and (name == "emission" or _largest(grid) >= GLOWING):
            said += f"; grid {grid.name} makes it glow"
        else:
            said += f"; grid {grid.name} is left out, it is too cold to glow"
            prim.RemoveProperty(f"field:{name}")
    return said


def _choose(path: str) -> dict[str, vdb.GridInfo]:
    """The grids of a file by the fields that they are to be."""
    try:
        infos = vdb.read_metadata(path)
    except FileNotFoundError:
        raise PrevisError(f"{path}: no such file") from None
    except OSError as error:
        raise PrevisError(f"{path}: {error.strerror or error}") from error
    except (ValueError, NotImplementedError) as error:
        reason = " ".join(str(error).removeprefix(f"{path}: ").split()).rstrip(".")
        raise PrevisError(f"{path}: not a readable .vdb file: {reason}") from error
    readable = [info for info in infos if info.unsupported is None and info.value_type in _NUMBERS]
    if not readable:
        known = ", ".join(sorted({info.name for info in infos})) or "none"
        raise PrevisError(f"{path}: holds no grid of numbers to show; its grids: {known}")
    chosen = {}
    for field, names in _NAMES.items():
        found = [info for name in names for info in readable if info.name.lower() == name]
        if found:
            chosen[field] = found[0]
    if "density" not in chosen:
        others = [info for info in readable if info not in chosen.values()] or readable
        chosen["density"] = min(others, key=lambda info: info.grid_class == "level set")
    return {field: info for field, info in chosen.items() if field == "density" or info is not chosen["density"]}


def _medium(density: SparseGrid, others: dict[str, SparseGrid]) -> dict[str, object]:
    """Values of the medium: extinction and, where something glows, emission."""
    column = typical_column(density)
    extinction = float(f"{OPTICAL_DEPTH / column:.3g}") if column > 0.0 else 1.0
    values: dict[str, object] = {"extinction": (extinction,) * 3, "albedo": Medium().albedo}
    hottest = _largest(others["temperature"]) if "temperature" in others else 0.0
    brightest = _largest(others["emission"]) if "emission" in others else 0.0
    # Where a medium is opaque its radiance is the emitted one times the part that is absorbed.
    scale = FLAME_RADIANCE / (1.0 - Medium().albedo[0])
    if hottest >= GLOWING:
        # The hottest point is what sets the level: a blackbody is 1 at the reference temperature.
        values["emission"], scale = (1.0, 1.0, 1.0), scale * (REFERENCE_TEMPERATURE / hottest) ** 4
    elif brightest > 0.0:
        values["emission"] = FLAME_COLOR
    if "emission" in values:
        values["emission_scale"] = float(f"{scale / (brightest or 1.0):.3g}")
    return values


def typical_column(grid: SparseGrid) -> float:
    """The density summed along lines through the thick of a grid, in world units: the upper quartile of its columns.

    0 for a grid without density.
    """
    columns = []
    sums = np.asarray(grid.leaf_values).sum(axis=(1, 2, 3), dtype=np.float64)
    for axis in range(3):
        size = float(np.linalg.norm(np.asarray(grid.index_to_world, float)[axis, :3]))
        if len(sums):
            across = np.delete(np.asarray(grid.leaf_origins), axis, axis=1)
            _, column = np.unique(across, axis=0, return_inverse=True)
            # A leaf stands for 8 × 8 lines.
            columns.append(np.bincount(column.reshape(-1), sums) / 64.0 * size)
        tiles = grid.tiles
        columns.append(np.asarray(tiles.value, float) * np.asarray(tiles.size, float) * size)
    filled = np.concatenate(columns)
    filled = filled[np.isfinite(filled) & (filled > 0.0)]
    return float(np.percentile(filled, 75.0)) if len(filled) else 0.0


def _largest(grid: SparseGrid) -> float:
    arrays = (np.asarray(grid.leaf_values), np.asarray(grid.tiles.value))
    return max((float(a.max()) for a in arrays if a.size), default=0.0)


def _add_surroundings(stage: Usd.Stage, density: LoadedGrid | None) -> None:
    build = _Builder(stage)
    volumes = {}
    if density is not None and density.grid.active_count:
        field = Field(density.key, density.grid, np.asarray(density.grid.index_to_world, float))
        volumes[VOLUME_PATH] = Volume(VOLUME_PATH, np.eye(4), density=field)
    scene = SceneDescription(volumes=volumes)
    bounds = scene.world_bounds()
    lo, hi = bounds if bounds is not None else (-np.ones(3), np.ones(3))
    diagonal = float(np.linalg.norm(hi - lo))
    build.add_distant_light("/Sun", direction=(1.0, -1.2, -0.6), irradiance=SUN_IRRADIANCE)
    half, height = 4.0 * diagonal, float(lo[1]) - 0.02 * diagonal
    x, z = 0.5 * (lo + hi)[[0, 2]]
    corners = [(x - half, height, z + half), (x + half, height, z + half)]
    corners += [(x + half, height, z - half), (x - half, height, z - half)]
    build.add_mesh("/Ground", corners, [[0, 1, 2, 3]], color=GROUND_COLOR)
    # The ground would make the volume small in a view that frames everything.
    view = framing_camera(scene).camera_to_world
    near = (1e-3 * diagonal, 1e3 * diagonal)
    build.add_camera("/Camera", view[3, :3], view[3, :3] - diagonal * view[2, :3], clipping_range=near)
