"""What a click hits: compared with closed forms, with the reference integrator's columns and with brute force."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from building import (
    box,
    box_mesh,
    camera,
    capsule,
    distant,
    field,
    look_at,
    orthographic_camera,
    point,
    quad_mesh,
    rotation,
    scaling,
    scene,
    shear,
    sphere,
    translation,
    volume,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from previs.description import Camera, Field, Geometry, Light, Medium, Mesh, SceneDescription, Volume
from previs.reference.density import GridMedium
from previs.render.projection import camera_rays
from previs.ui.grid_rays import grid_columns
from previs.ui.picking import LIGHT_RADIUS, mesh_distance, pick, project
from previs.vdb import Grid
from previs.vdb.grid import Tiles

SIZE = (320, 200)
ASPECT = SIZE[0] / SIZE[1]
CAMERA = camera((0.0, 0.0, 10.0))
ORTHOGRAPHIC = orthographic_camera((0.0, 0.0, 10.0), width=8.0)
SHEARED = rotation((1.0, 2.0, 3.0), 40.0) @ shear(0.5) @ scaling(1.0, 2.0, 0.5) @ translation(0.3, -0.2, 0.1)


def thick(strength: float) -> Medium:
    return Medium(extinction=(strength, strength, strength))


def at(description: SceneDescription, world_point=(0.0, 0.0, 0.0), with_camera: Camera = CAMERA, **values):
    """A click where a world point is seen."""
    u, v, _ = project(with_camera, ASPECT, np.array([world_point]))
    return pick(description, with_camera, float(u[0]), float(v[0]), SIZE, **values)


# --- projection -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "c", [CAMERA, ORTHOGRAPHIC, camera((3.0, -2.0, 7.0), (1.0, 1.0, 0.0), offset=(0.2, -0.1))], ids=["p", "o", "offset"]
)
def test_projection_is_the_renderers(c):
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3))
    u, v, depth = project(c, ASPECT, points)
    rays = camera_rays(c.conformed(ASPECT), np.zeros(3), SceneDescription(), (0.0, 0.0))
    clip = np.c_[points, np.ones(50)] @ rays.view_projection
    # The renderer's v runs up, the window's down.
    v = 1.0 - v
    assert np.stack([u, v], axis=1) == pytest.approx(0.5 * clip[:, :2] / clip[:, 3:] + 0.5)
    # And the ray through (u, v) passes the point at that depth.
    uv = np.stack([np.ones(50), u, v], axis=1)
    assert uv @ rays.anchor + depth[:, None] * (uv @ rays.direction) == pytest.approx(points, abs=1e-9)


def test_what_is_behind_the_camera_has_no_place():
    u, v, depth = project(CAMERA, ASPECT, np.array([[0.0, 0.0, 11.0], [0.0, 0.0, 10.0]]))
    assert np.isnan(u).all() and np.isnan(v).all()
    assert depth.tolist() == [-1.0, 0.0]


# --- meshes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("c", [CAMERA, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_the_nearest_mesh(c):
    description = scene(
        box_mesh((-1, -1, -1), (1, 1, 1), path="/Far"),
        box_mesh((-0.5, -0.5, 2), (0.5, 0.5, 3), path="/Near"),
    )
    hit = at(description, with_camera=c)
    assert (hit.path, hit.kind) == ("/Near", "mesh")
    assert hit.point == pytest.approx([0.0, 0.0, 3.0])
    assert hit.distance == pytest.approx(7.0)
    hit = at(description, (0.9, 0.9, 1.0), c)
    assert hit.path == "/Far"
    assert hit.point == pytest.approx([0.9, 0.9, 1.0])
    assert at(description, (2.0, 0.0, 0.0), c) is None


def test_clipping():
    description = scene(box_mesh((-1, -1, -1), (1, 1, 1)))
    assert at(description, with_camera=replace(CAMERA, clipping_range=(10.0, 100.0))).distance == pytest.approx(11.0)
    assert at(description, with_camera=replace(CAMERA, clipping_range=(1.0, 8.0))) is None
    assert at(description, with_camera=replace(CAMERA, clipping_range=(12.0, 20.0))) is None


def test_instances_under_any_transform():
    cube = box_mesh((-1, -1, -1), (1, 1, 1))
    matrices = np.array(
        [
            scaling(0.3, 0.3, 0.3) @ translation(-2.0, 0.0, 0.0),
            np.diag([0.0, 1.0, 1.0, 1.0]),
            scaling(-0.2, 0.3, 0.4) @ rotation((0, 0, 1), 45.0) @ translation(2.0, 0.0, 1.0),
        ]
    )
    description = scene(replace(cube, local_to_world=matrices))
    assert at(description, (-2.0, 0.0, 0.3)).point == pytest.approx([-2.0, 0.0, 0.3])
    assert at(description, (2.0, 0.0, 1.4)).point == pytest.approx([2.0, 0.0, 1.4])
    # The second instance is scaled to nothing.
    assert at(description) is None


def brute_force(mesh: Mesh, origin: np.ndarray, direction: np.ndarray) -> float:
    """Möller–Trumbore over every triangle of every instance, in the world."""
    best = np.inf
    for matrix in mesh.local_to_world:
        p = mesh.geometry.points.astype(float) @ matrix[:3, :3] + matrix[3, :3]
        a, b, c = (p[mesh.geometry.triangles[:, i]] for i in range(3))
        e1, e2 = b - a, c - a
        h = np.cross(direction, e2)
        det = (e1 * h).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = origin - a
            u = (s * h).sum(axis=1) / det
            q = np.cross(s, e1)
            v = (q @ direction) / det
            t = (e2 * q).sum(axis=1) / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        best = min(best, t[hit].min(initial=np.inf))
    return best


def test_triangles_as_brute_force_finds_them():
    random = np.random.default_rng(3)
    points = random.normal(size=(300, 3)).astype(np.float32)
    triangles = random.integers(0, 300, (400, 3)).astype(np.uint32)
    matrices = np.array([SHEARED, translation(1.0, 2.0, 3.0), scaling(-0.1, 0.1, 5.0)])
    mesh = Mesh("/M", Geometry("k", points, np.zeros_like(points), triangles), matrices)
    for _ in range(60):
        origin = random.normal(size=3) * 20.0
        direction = random.normal(size=3) - origin
        direction /= np.linalg.norm(direction)
        found = mesh_distance(mesh, origin, direction, 0.0, np.inf)
        assert (np.inf if found is None else found) == pytest.approx(brute_force(mesh, origin, direction), rel=1e-6)


def test_there_are_no_cracks():
    mesh = terrain(64)
    # Along an edge of the triangles, and through their corners.
    for x, z in np.random.default_rng(4).integers(-20, 20, (50, 2)) / 32.0:
        for nudge in (0.0, 0.5 / 32.0):
            origin = np.array([x + nudge, 5.0, z])
            assert mesh_distance(mesh, origin, np.array([0.0, -1.0, 0.0]), 0.0, np.inf) is not None


def terrain(n: int) -> Mesh:
    """2·n² triangles over the square from −1 to 1 in x and z."""
    x, z = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    points = np.stack([x, 0.1 * np.sin(7.0 * x) * np.cos(9.0 * z), z], axis=-1).reshape(-1, 3).astype(np.float32)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate([np.c_[i, i + 1, i + n + 1], np.c_[i + 1, i + n + 2, i + n + 1]]).astype(np.uint32)
    return Mesh("/Terrain", Geometry("terrain", points, np.zeros_like(points), triangles), np.eye(4)[None])


def fastest(call, repeats=7) -> float:
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def test_a_million_triangles_take_less_than_a_tenth_of_a_second():
    mesh = terrain(708)
    assert len(mesh.geometry.triangles) > 1_000_000
    description = scene(mesh)
    view = camera((0.0, 3.0, 2.0))
    assert at(description, (0.0, 0.0, 0.0), view).point == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)
    assert fastest(lambda: at(description, (0.0, 0.0, 0.0), view)) < 0.1


# --- media ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("record", "entry", "length"),
    [
        (box(thick(0.3), (-1, -1, -2), (1, 1, 3)), 3.0, 5.0),
        (sphere(thick(0.3), 1.5), 1.5, 3.0),
        (capsule(thick(0.3), "Z", 2.0, 0.5), 1.5, 3.0),
        (sphere(thick(0.3), 1.0, SHEARED @ translation(-0.3, 0.2, -0.1)), None, None),
    ],
    ids=["box", "sphere", "capsule", "ellipsoid"],
)
def test_shapes_are_picked_where_half_is_gathered(record, entry, length):
    hit = at(scene(record))
    if entry is None:
        # An ellipsoid: |x·M⁻¹| = 1 along z through its centre.
        entry = 1.0 / np.linalg.norm(np.array([0.0, 0.0, 1.0]) @ np.linalg.inv(record.local_to_world[:3, :3]))
        length = 2.0 * entry
    total = -math.expm1(-0.3 * length)
    depth = -math.log1p(-0.5 * total) / 0.3
    assert (hit.path, hit.kind) == (record.path, "volume")
    assert hit.point == pytest.approx([0.0, 0.0, entry - depth], abs=1e-9)
    assert hit.distance == pytest.approx(10.0 - entry + depth)


def test_the_densest_channel_does_not_decide_alone():
    one = Medium(extinction=(50.0, 0.0, 0.0))
    grey = thick(50.0)
    hit = at(scene(box(one, (-1, -1, 1), (1, 1, 2), path="/Red"), box(grey, (-1, -1, -1), (1, 1, 0), path="/Grey")))
    # Red takes a third of the light, grey the other two.
    assert hit.path == "/Grey"
    assert hit.point[2] == pytest.approx(-math.log(2.0) / 50.0, abs=1e-6)


def test_the_density_scale_counts_and_a_medium_without_strength_does_not():
    empty = Medium(extinction=(0.0, 0.0, 0.0))
    assert at(scene(box(empty))) is None
    assert at(scene(box(replace(thick(1.0), density_scale=0.0)))) is None
    scaled = at(scene(box(replace(thick(1.0), density_scale=30.0))))
    assert scaled.point[2] == pytest.approx(1.0 - math.log(2.0) / 30.0)


def test_overlapping_media_share_the_opacity():
    # Half of the light in the overlap goes to each; the thinner one is longer but gets less.
    description = scene(
        box(thick(1.0), (-1, -1, -1), (1, 1, 1), path="/A"), box(thick(3.0), (-1, -1, -1), (1, 1, 1), path="/B")
    )
    hit = at(description)
    assert hit.path == "/B"
    total = -math.expm1(-8.0)
    assert hit.point[2] == pytest.approx(1.0 + math.log1p(-0.5 * total) / 4.0)


def test_thin_smoke_does_not_hide_a_mesh():
    wall = box_mesh((-5, -5, -3), (5, 5, -2), path="/Wall")
    for strength, path in ((0.004, "/Wall"), (0.05, "/Wall"), (0.5, "/Box")):
        assert at(scene(box(thick(strength)), wall)).path == path
    # Before nothing, a thin medium is what there is; a hundredth of that is nothing.
    assert at(scene(box(thick(0.05)))).path == "/Box"
    assert at(scene(box(thick(0.004)))) is None


def test_a_mesh_in_front_hides_a_medium():
    description = scene(box(thick(50.0)), box_mesh((-1, -1, 2), (1, 1, 3), path="/Front"))
    assert at(description).path == "/Front"
    # From within the medium outwards.
    inside = at(scene(box(thick(1.0))), (0.0, 0.0, -0.5), camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
    total = -math.expm1(-1.0)
    assert inside.point[2] == pytest.approx(math.log1p(-0.5 * total), abs=1e-2)


def test_volumes_scaled_to_nothing_are_not_there():
    flat = scaling(1.0, 0.0, 1.0)
    assert at(scene(box(thick(9.0), local_to_world=flat))) is None
    assert at(scene(volume(np.ones((4, 4, 4)), thick(9.0), flat))) is None
    assert at(scene(replace(volume(np.ones((2, 2, 2)), thick(9.0)), density=field(np.zeros((4, 4, 4)))))) is None


def reference_column(values, matrix, origin, direction, background=0.0) -> float:
    medium = GridMedium(values, matrix, background)
    return float(medium.column(origin[None], direction[None], np.array([0.0]), np.array([np.inf]))[0])


def column(grid: Grid, matrix: np.ndarray, origin: np.ndarray, direction: np.ndarray, far=np.inf):
    inverse = np.linalg.inv(matrix)
    return grid_columns(grid, origin @ inverse[:3, :3] + inverse[3, :3], direction @ inverse[:3, :3], 0.0, far)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.0, 0.25]), st.booleans())
def test_grid_columns_are_the_references(seed, background, along_axis):
    random = np.random.default_rng(seed)
    values = random.uniform(0.0, 1.0, random.integers(1, 30, 3)) * (random.uniform(size=3)[0] > 0.1)
    # The reference's array is the active box: its faces are active, and there are holes inside.
    values[1:-1, 1:-1, 1:-1] *= random.uniform(size=np.maximum(np.array(values.shape) - 2, 0)) > 0.6
    values = values.astype(np.float32)
    shift = random.integers(-20, 20, 3)
    grid = Grid.from_dense("density", values, background=background, origin=shift)
    if grid.active_count == 0:
        return
    lo, hi = grid.bounds
    held = values[tuple(slice(a, b + 1) for a, b in zip(lo - shift, hi - shift, strict=True))]
    matrix = SHEARED.copy()
    medium_matrix = translation(*lo) @ matrix
    target = (lo + random.uniform(size=3) * (hi - lo + 1e-3)) @ matrix[:3, :3] + matrix[3, :3]
    direction = matrix[int(random.integers(3)), :3] if along_axis else random.normal(size=3)
    direction = direction / np.linalg.norm(direction)
    origin = target - direction * 200.0
    start, end, amount = column(grid, matrix, origin, direction)
    expected = reference_column(held, medium_matrix, origin, direction, background)
    assert amount.sum() == pytest.approx(expected, rel=1e-7, abs=1e-9)
    assert (start <= end).all() and (end[:-1] <= start[1:] + 1e-9).all()
    # And a part of it.
    part = column(grid, matrix, origin, direction, 200.0)[2].sum()
    medium = GridMedium(held, medium_matrix, background)
    expected = medium.column(origin[None], direction[None], np.array([0.0]), np.array([200.0]))[0]
    assert part == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_tiles_of_every_size():
    grid = Grid.from_dense("density", np.full((4, 4, 4), 5.0), origin=(-20, 0, 0))
    tiles = Tiles(
        np.array([[0, 0, 0], [128, 0, 0], [4096, 0, 0]], np.int32),
        np.array([8, 128, 4096], np.int32),
        np.array([1.0, 2.0, 3.0], np.float32),
    )
    hidden = Tiles(np.array([[16, 0, 0]], np.int32), np.array([8], np.int32), np.array([7.0], np.float32))
    grid = replace(grid, tiles=tiles, inactive_tiles=hidden)
    start, _, amount = grid_columns(grid, np.array([-100.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0]), 0.0, np.inf)
    # A tile of n voxels holds n times its value: the trapezoids at its ends add up to that.
    assert amount.sum() == pytest.approx(4 * 5.0 + 8 * 1.0 + 8 * 7.0 + 128 * 2.0 + 4096 * 3.0)
    for lo, hi, expected in ((100.5, 106.5, 1.0), (230.5, 350.5, 2.0), (5000.5, 8000.5, 3.0), (126.0, 226.0, 0.0)):
        part = grid_columns(grid, np.array([-100.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0]), lo, hi)[2].sum()
        assert part == pytest.approx(expected * (hi - lo))
    # Only what holds something is cut into voxels.
    assert len(start) < 4096 + 128 + 100


def test_grids_that_span_the_world_take_no_time():
    far = 2**31 - 8
    leaf = np.ones((1, 8, 8, 8), np.float32)
    grid = Grid(
        "density",
        np.eye(4),
        np.array([[-(2**31), 0, 0], [0, 0, 0], [far, 0, 0]], np.int32),
        np.repeat(leaf, 3, axis=0),
        np.repeat(leaf, 3, axis=0) > 0,
    )
    ray = np.array([-3e9, 2.0, 2.0]), np.array([1.0, 0.0, 0.0])
    assert grid_columns(grid, *ray, 0.0, np.inf)[2].sum() == pytest.approx(24.0, rel=1e-4)
    # Not voxel by voxel, of which there are four thousand million.
    assert fastest(lambda: grid_columns(grid, *ray, 0.0, np.inf), 3) < 60.0


def test_a_grid_is_picked_through_its_transforms():
    values = np.zeros((40, 40, 40))
    values[5:9, 20:24, 30:34] = 1.0
    to_local, to_world = shear(0.3) @ scaling(0.05, 0.05, 0.05), rotation((1, 1, 0), 70.0) @ translation(-1.0, 0.5, 0.0)
    description = scene(volume(values, thick(400.0), to_world, index_to_local=to_local))
    centre = np.array([6.5, 21.5, 31.5, 1.0]) @ to_local @ to_world
    hit = at(description, centre[:3])
    assert hit.path == "/Volume"
    index = np.append(hit.point, 1.0) @ np.linalg.inv(to_local @ to_world)
    # Opaque: what is picked is its front, between the last empty voxel and the first full one.
    assert (index[:3] > (3.9, 18.9, 28.9)).all() and (index[:3] < (9.1, 24.1, 34.1)).all()
    assert np.linalg.norm(hit.point - centre[:3]) > 0.03
    assert hit.distance < np.linalg.norm(centre[:3] - (0.0, 0.0, 10.0))
    empty = np.array([30.0, 10.0, 10.0, 1.0]) @ to_local @ to_world
    assert at(description, empty[:3]) is None


def test_a_dense_grid_of_256_takes_less_than_30_milliseconds():
    values = np.random.default_rng(2).uniform(0.0, 1.0, (256, 256, 256)).astype(np.float32) + 1e-3
    grid = Grid.from_dense("density", values)
    record = Volume("/V", translation(-127.5, -127.5, -127.5), thick(0.001), density=Field("k", grid, np.eye(4)))
    view = camera((300.0, 200.0, 400.0))
    description = scene(record)
    assert at(description, with_camera=view).path == "/V"
    assert fastest(lambda: at(description, with_camera=view)) < 0.03


# --- lights -----------------------------------------------------------------------------------------------------


def pixels_from(light_position, dx, dy, c=CAMERA):
    u, v, _ = project(c, ASPECT, np.array([light_position]))
    return float(u[0]) + dx / SIZE[0], float(v[0]) + dy / SIZE[1]


@pytest.mark.parametrize("c", [CAMERA, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_a_light_is_taken_within_its_radius(c):
    place = (1.0, -0.5, 2.0)
    description = scene(point(place), box(thick(50.0)), box_mesh((-3, -3, -3), (3, 3, -2)))
    for dx, dy in ((0.0, 0.0), (7.9, 0.0), (0.0, -7.9), (5.6, 5.6)):
        hit = pick(description, c, *pixels_from(place, dx, dy, c), SIZE)
        assert (hit.path, hit.kind) == ("/Point", "light")
        assert hit.point == pytest.approx(place)
    for dx, dy in ((8.1, 0.0), (0.0, -8.1), (5.7, 5.7)):
        assert pick(description, c, *pixels_from(place, dx, dy, c), SIZE).kind != "light"
    assert hit.distance == pytest.approx(8.0 if c is ORTHOGRAPHIC else np.linalg.norm(np.subtract(place, (0, 0, 10))))
    wide = pick(description, c, *pixels_from(place, 15.0, 0.0, c), SIZE, light_radius=2.0 * LIGHT_RADIUS)
    assert wide.kind == "light"


def test_the_light_nearest_to_the_click():
    a, b = (0.0, 0.0, 0.0), (0.15, 0.0, -5.0)
    description = scene(point(a, path="/A"), point(b, path="/B"))
    assert pick(description, CAMERA, *pixels_from(a, 0.5, 0.0), SIZE).path == "/A"
    assert pick(description, CAMERA, *pixels_from(b, 0.5, 0.0), SIZE).path == "/B"
    # At one place in the picture it is the front one.
    description = scene(point((0.0, 0.0, -5.0), path="/Behind"), point(a, path="/A"))
    assert at(description).path == "/A"


def test_icons_that_are_not_shown_are_not_picked():
    description = scene(point((0.0, 0.0, 3.0)), box(thick(50.0)))
    assert at(description).path == "/Point"
    assert at(description, light_icons=()).path == "/Box"
    assert at(description, light_icons={"/Point"}).path == "/Point"


def test_lights_without_a_place():
    dome = Light("/Dome", "dome", np.eye(4), (1.0, 1.0, 1.0))
    description = scene(distant((0.0, 0.0, -1.0)), dome, point((0.0, 0.0, 20.0), path="/Behind"))
    assert at(description) is None
    assert at(description, with_camera=ORTHOGRAPHIC) is None


def test_empty_space():
    assert at(SceneDescription()) is None
    assert at(scene(quad_mesh([(1, 1, 0), (2, 1, 0), (2, 2, 0)]), box(thick(9.0), (3, 3, 3), (4, 4, 4)))) is None


def test_a_camera_far_away_and_from_any_side():
    for eye in ((1e6, 0.0, 0.0), (0.0, 2e5, 1.0), (3.0, 4.0, -5.0)):
        c = Camera("/C", look_at(eye, (0, 0, 0)), focal_length=1e5, clipping_range=(1e-3, 1e9))
        hit = at(scene(sphere(thick(1e4))), with_camera=c)
        assert hit.point == pytest.approx(np.array(eye) / np.linalg.norm(eye), abs=1e-3)
