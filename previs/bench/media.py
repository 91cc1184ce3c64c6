"""Media and scenes of the papers' tables: made here, or taken from what ships with previs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .. import vdb
from ..description import Volume
from ..errors import PrevisError
from ..scene import Scene
from .run import scene_folder

#: Voxels along a side of the cubes of [TFM11] Table 1.
SIDE = 128
#: Path of the volume, and of the light, in the scenes made here.
VOLUME, LIGHT = "/Medium", "/Light"
#: Where the light of the made scenes comes from: from above at the left, so that shadows cross the picture.
DIRECTION = (0.8, -0.7, -0.35)


def smoke() -> np.ndarray:
    """The smoke column of the shipped scene `plume`, (128, 128, 128), values from 0 to 1."""
    return cube_of(scene_folder() / "plume.vdb")


def cube_of(file: str | Path) -> np.ndarray:
    """The density of a .vdb file, fitted into a cube of 128³ voxels: (128, 128, 128), values from 0 to 1.

    The longest side of what is active fills the cube but for a margin of two voxels; values between voxels are linear.
    Where several grids are there, the one called "density" is taken, else the first of numbers.

    Raises:
        PrevisError: when the file cannot be read, or holds no density above 0.
    """
    try:
        grids = [g for g in vdb.read(file) if g.leaf_values.ndim == 4]
    except (OSError, ValueError, NotImplementedError) as error:
        raise PrevisError(f"{file}: {getattr(error, 'strerror', None) or error}") from None
    if not grids:
        raise PrevisError(f"{file}: no grid of numbers")
    grid = next((g for g in grids if g.name == "density"), grids[0])
    if not grid.active_count:
        raise PrevisError(f"{file}: grid {grid.name} is empty")
    try:
        values = np.asarray(grid.dense(*grid.bounds), np.float64)
    except ValueError as error:
        raise PrevisError(f"{file}: {error}") from None
    values = np.where(np.isfinite(values), values, 0.0).clip(0.0)
    if not values.any():
        raise PrevisError(f"{file}: grid {grid.name} has no density above 0")
    # A margin of two voxels, so that nothing ends at the box.
    spacing = max(values.shape) / (SIDE - 4)
    for axis, count in enumerate(values.shape):
        # Cell centres of the cube in cells of the grid, the shorter sides in the middle.
        place = (np.arange(SIDE) + 0.5 - 0.5 * SIDE) * spacing + 0.5 * count - 0.5
        first = np.floor(place).astype(int)
        part = place - first
        moved = np.moveaxis(values, axis, -1)
        padded = np.concatenate([np.zeros((*moved.shape[:-1], 1)), moved, np.zeros((*moved.shape[:-1], 1))], -1)
        low, high = (padded[..., np.clip(first + i, 0, count + 1)] for i in (1, 2))
        values = np.moveaxis(low * (1.0 - part) + high * part, -1, axis)
    return (values / values.max()).astype(np.float32)


#: Ellipsoids (centre, radii, degrees about the z axis) whose union is the solid: a sitting animal with long ears.
_SOLID: Sequence[tuple[tuple[float, float, float], tuple[float, float, float], float]] = (
    ((0.05, -0.38, 0.0), (0.52, 0.44, 0.40), 12.0),
    ((-0.18, -0.10, 0.0), (0.30, 0.42, 0.30), 20.0),
    ((-0.36, 0.22, 0.0), (0.30, 0.24, 0.23), -12.0),
    ((-0.24, 0.62, 0.12), (0.09, 0.34, 0.06), -14.0),
    ((-0.18, 0.60, -0.12), (0.09, 0.33, 0.06), -24.0),
    ((-0.30, -0.72, 0.20), (0.26, 0.12, 0.13), 0.0),
    ((-0.30, -0.72, -0.20), (0.26, 0.12, 0.13), 0.0),
    ((0.62, -0.46, 0.0), (0.15, 0.15, 0.15), 0.0),
)


def solid() -> np.ndarray:
    """A sharp-edged solid of density 1 with large zones that are constant: (128, 128, 128), values 0 and 1.

    It stands in for the volume made from the Stanford bunny.
    """
    axis = ((np.arange(SIDE) + 0.5) / SIDE * 2.0 - 1.0) * 0.98
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    inside = np.zeros((SIDE,) * 3, bool)
    for (cx, cy, cz), (rx, ry, rz), degrees in _SOLID:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        u, v = c * (x - cx) + s * (y - cy), -s * (x - cx) + c * (y - cy)
        inside |= (u / rx) ** 2 + (v / ry) ** 2 + ((z - cz) / rz) ** 2 < 1.0
    return inside.astype(np.float32)


def made_scene(density: np.ndarray, optical_depth: float, albedo: float) -> Scene:
    """A scene of one volume in a box from −1 to 1, one distant light and a camera; close it when done.

    `optical_depth` is that of the deepest way of the light through the medium, as `deepest_way` finds it.
    """
    scene = Scene()
    scene.add_volume(VOLUME, density, bounds=((-1, -1, -1), (1, 1, 1)), extinction=1.0, albedo=albedo)
    scene.add_distant_light(LIGHT, direction=DIRECTION, irradiance=10.0)
    scene.add_camera("/Camera", position=(0.0, 0.15, 5.2), target=(0, 0, 0), focal_length=80, vertical_aperture=36.0)
    volume = scene.describe().volumes[VOLUME]
    scene.set_medium(VOLUME, extinction=optical_depth / deepest_way(volume, DIRECTION))
    return scene


def deepest_way(volume: Volume, direction: Sequence[float], across: int = 96, along: int = 384) -> float:
    """The largest integral of density along the rays of a direction, in stage units, to a few per cent.

    It is the largest over a lattice of `across`² rays with `along` samples each, of the nearest voxels.
    """
    grid = volume.density.grid
    lo, hi = grid.bounds
    values = np.asarray(grid.dense(lo, hi), float)
    to_world = np.asarray(volume.density.index_to_local, float) @ np.asarray(volume.local_to_world, float)
    ends = (np.asarray(lo, float) - 0.5, np.asarray(hi, float) + 0.5)
    corners = np.array([[ends[corner >> axis & 1][axis] for axis in range(3)] for corner in range(8)])
    world = corners @ to_world[:3, :3] + to_world[3, :3]
    centre, radius = world.mean(axis=0), float(np.linalg.norm(world - world.mean(axis=0), axis=1).max())
    forward = np.asarray(direction, float) / np.linalg.norm(direction)
    side = np.cross(forward, (0.0, 1.0, 0.0) if abs(forward[1]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    up = np.cross(side, forward)
    places = ((np.arange(across) + 0.5) / across * 2.0 - 1.0) * radius
    start = centre + (places[:, None, None] * side + places[None, :, None] * up).reshape(-1, 3)
    inverse = np.linalg.inv(to_world)
    total = np.zeros(len(start))
    step = 2.0 * radius / along
    for distance in (np.arange(along) + 0.5) * step - radius:
        index = np.rint((start + distance * forward) @ inverse[:3, :3] + inverse[3, :3]).astype(int) - lo
        within = ((index >= 0) & (index < values.shape)).all(axis=1)
        total[within] += values[tuple(index[within].T)]
    return float(total.max()) * step
