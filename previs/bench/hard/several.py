"""Hard cases of several volumes, and of densities that are awkward to sample: sheets, gaps, sparse grids."""

from __future__ import annotations

import numpy as np

from ... import metrics
from ...description import Volume
from ...vdb import Grid
from ...vdb.grid import Tiles
from ..transforms import translation
from .media import COARSE
from .records import (
    CLOUD,
    FRONT,
    SIDE,
    TURNED,
    box,
    camera,
    cloud,
    cube_transform,
    distant,
    field_of,
    fog,
    scene,
    sphere,
    volume,
)
from .trial import ANY, MAPS_AND_MARCH, MARCH, Trial, case


@case("two overlapping volumes", methods=MAPS_AND_MARCH, coefficients=(6,))
def overlapping_volumes(trial: Trial) -> None:
    """Coefficients add: two clouds of different colour across each other, and one cloud as two of half its density."""
    red = cloud((0.5, 2.0, 4.0), albedo=(0.9, 0.5, 0.3), anisotropy=0.6)
    blue = cloud((4.0, 2.0, 0.5), translation(0.5, 0.2, 0.1), "/Blue", albedo=(0.3, 0.5, 0.9))
    trial.right(scene(red, blue, SIDE))
    once = trial.render(scene(cloud(4.0), SIDE), **COARSE)
    # A map of half the depth is not the same curve: the methods may differ by their error.
    limit = 1e-3 if trial.method == MARCH else trial.limits[0]
    trial.same(trial.render(scene(cloud(2.0), cloud(2.0, path="/Again"), SIDE), **COARSE), once, limit)


@case("volume inside a volume", methods=MAPS_AND_MARCH, coefficients=(6,))
def volume_inside_a_volume(trial: Trial) -> None:
    """A dense core of voxels in a cloud, and a homogeneous ball in it."""
    core = volume(CLOUD, fog((4.0, 16.0, 32.0)), np.diag([0.3, 0.3, 0.3, 1.0]) @ translation(0.2, 0.1, 0.0), "/Core")
    trial.right(scene(cloud(1.0), core, SIDE))
    trial.right(scene(cloud(1.0), sphere(fog((1.0, 4.0, 8.0)), 0.3, translation(0.2, 0.1, 0.0)), SIDE))


@case("one volume or eight that abut, same picture", methods=(ANY,))
def one_box_or_eight(trial: Trial) -> None:
    """A homogeneous cube cut into eight."""
    medium = fog((0.5, 1.5, 3.0))
    whole = trial.right(scene(box(medium, matrix=TURNED), SIDE))
    parts = [
        box(medium, lo, np.add(lo, 1.0), TURNED, f"/Part{i}")
        for i, lo in enumerate(np.stack(np.meshgrid(*[[-1.0, 0.0]] * 3), axis=-1).reshape(-1, 3))
    ]
    trial.same(trial.render(scene(*parts, SIDE)), whole)


@case("one volume or eight that abut, same picture", methods=MAPS_AND_MARCH, coefficients=(6,))
def one_grid_or_eight(trial: Trial) -> None:
    """A grid cut into eight: each falls to 0 over the voxel in which its neighbour rises, so that they add up."""
    medium, transform, parts = fog(3.0), cube_transform(CLOUD.shape), []
    halves = [((0, n // 2), (n // 2, n)) for n in CLOUD.shape]
    for i in range(8):
        spans = [halves[a][(i >> a) & 1] for a in range(3)]
        piece = CLOUD[tuple(slice(*s) for s in spans)]
        shift = translation(*(s[0] for s in spans))
        parts.append(volume(piece, medium, TURNED, f"/Part{i}", shift @ transform))
    settings = {"steps": 96, "light_steps": 96, "map_size": 64}
    whole = trial.render(scene(volume(CLOUD, medium, TURNED), SIDE), **settings)
    limit = 5e-3 if trial.method == MARCH else trial.limits[0]
    trial.same(trial.render(scene(*parts, SIDE), **settings), whole, limit)


@case("two blobs with a gap")
def two_blobs_with_a_gap(trial: Trial) -> None:
    """One grid, two dense blobs in line with the light and nothing between: the curve falls, rests, and falls again."""
    values = np.zeros((33, 9, 9))
    values[:6], values[-6:] = 1.0, 1.0
    trial.right(scene(_long(values, 1.2), distant((-1.0, -0.05, -0.1))))


@case("thin dense sheet")
def thin_dense_sheet(trial: Trial) -> None:
    """A layer of one voxel of depth 20 in a thin haze, lit and seen across and aslant."""
    values = np.full((16, 25, 16), 0.01)
    values[:, 12] = 1.0
    sheet = volume(values, fog(20.0 * 26.0 / 2.0))
    for direction in ((-0.3, -1.0, -0.2), (-1.0, -0.2, -0.4)):
        trial.right(scene(sheet, distant(direction)), camera((1.2, 2.5, 5.0)))


@case("dense voxel layer at the far end")
def dense_layer_at_the_far_end(trial: Trial) -> None:
    """A thin medium that ends, away from the light, in a layer of one voxel of depth 100."""
    values = np.full((33, 9, 9), 0.3)
    values[0] = 300.0
    trial.right(scene(_long(values, 1.0), distant((-1.0, -0.05, -0.1))))
    trial.right(scene(_long(values, 1.0), distant((-1.0, -0.05, -0.1))), camera((-4.0, 1.5, 4.0)))


def _long(values: np.ndarray, extinction: float) -> Volume:
    """A grid 33 × 9 × 9 with cubic voxels, 4 units long."""
    transform = np.diag([4.0 / 34.0] * 3 + [1.0])
    transform[3, :3] = [-0.5 * (n - 1) * 4.0 / 34.0 for n in values.shape]
    return volume(values, fog(extinction * 34.0 / 12.0), index_to_local=transform)


def _spread(count: int) -> Grid:
    """Two cubes of 512³ voxels in a grid of 4096³, as tiles of 128³."""
    corners = np.stack(np.meshgrid(*[np.arange(4) * 128] * 3), axis=-1).reshape(-1, 3)
    origin = np.concatenate([corners, corners + count - 512]).astype(np.int32)
    tiles = Tiles(origin, np.full(len(origin), 128, np.int32), np.ones(len(origin), np.float32))
    empty = np.zeros((0, 8, 8, 8), np.float32)
    return Grid("density", np.eye(4), np.zeros((0, 3), np.int32), empty, empty.astype(bool), tiles=tiles)


@case("sparse grid whose bounds are thousands of voxels wide", methods=(ANY,))
def sparse_grid_4096_voxels_wide(trial: Trial) -> None:
    """Two blocks in opposite corners of 4096³ voxels: they do not fit as they are, are averaged, and that is said.

    What they are is known: two boxes that end half a voxel outside their outermost ones.
    """
    scale = 2.0 / 4096.0
    to_world = np.diag([scale, scale, scale, 1.0])
    to_world[3, :3] = 0.5 * scale - 1.0
    sparse = Volume("/Sparse", np.eye(4), fog(4.0), density=field_of(_spread(4096), to_world))
    light = distant((-0.3, -1.0, -0.2))
    # Averages over cubes smear the faces over a cube; 16 MiB leave cubes of 32 voxels, a sixteenth of a block.
    image = trial.render(scene(sparse, light), steps=512, light_steps=256, field_memory=16)
    boxes = [box(fog(4.0), (lo,) * 3, (lo + 0.25,) * 3, path=f"/Block{i}") for i, lo in enumerate((-1.0, 0.75))]
    truth = trial.render(scene(*boxes, light), steps=512)
    trial.measure(abs(image.color.sum() / truth.color.sum() - 1.0), 0.1, "light lost or gained", "%")
    trial.told(image.stats["notes"], "/Sparse", "averaged")


@case("sparse grid whose bounds are thousands of voxels wide", coefficients=(6,))
def sparse_column_1600_voxels_long(trial: Trial) -> None:
    """Two leaves at the ends of a column that fits: one of them, seen closely, is as sharp as it would be alone."""
    values = np.linspace(0.2, 1.0, 512, dtype=np.float32).reshape(8, 8, 8)
    origins = np.array([[0, 0, 0], [1600, 0, 0]], np.int32)
    grid = Grid("density", np.eye(4), origins, np.stack([values] * 2), np.ones((2, 8, 8, 8), bool))
    alone = volume(values, fog(0.5), index_to_local=np.eye(4))
    view, light = camera((8.0, 9.0, 40.0), (3.5, 3.5, 3.5), 20.0), distant((-0.2, -1.0, -0.5))
    long = Volume("/Long", np.eye(4), fog(0.5), density=field_of(grid))
    image = trial.render(scene(long, light), view)
    # A map has fewer texels than the column has voxels: its shadows are blurred, which is for the program to say.
    difference = metrics.mean_relative_error(image.color, trial.render(scene(alone, light), view).color)
    if trial.method != MARCH and difference > trial.limits[0]:
        trial.told(image.stats["notes"], "/Long", "texels")
        trial.measure(difference, 0.25, "difference", "%")
    else:
        trial.measure(difference, trial.limits[0], "difference", "%")


@case("empty grid", methods=(ANY,))
def empty_grid(trial: Trial) -> None:
    """A grid without an active voxel is not there, and is said to be empty; the rest of the scene stays."""
    nothing = volume(np.zeros((4, 4, 4)), fog(), path="/Nothing")
    rest = (cloud(3.0), SIDE)
    image = trial.render(scene(nothing, *rest), FRONT, **COARSE)
    trial.same(image, trial.render(scene(*rest), FRONT, **COARSE), 0.0)
    trial.told(image.stats["notes"], "/Nothing", "no active voxels")
    alone = trial.render(scene(nothing, SIDE), FRONT, **COARSE)
    trial.measure(max(alone.color.max(), alone.alpha.max()), 0.0, "light from nothing")
