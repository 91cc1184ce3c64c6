"""What lies under the cursor: lights, meshes and media of a scene description, by rays on the CPU.

The picture itself cannot tell: a cloud has no one surface. So a click casts one ray through the records: triangles are
tested against it, and the optical depth of every medium is integrated along it. Nothing is prepared but an index of
each grid's leaves, so a click right after an edit costs no more than any other.

Image coordinates are those of the window: parts of the image's width and height, u to the right, v **down**, (0, 0) is
the upper left corner.

Not here: lights without a position (distant lights and domes) cannot be picked, nor can cameras. Lights have no
surface that hides anything.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..description import Box, Camera, Light, Mesh, SceneDescription, Sphere, Volume
from ..reference.density import HomogeneousBox, HomogeneousCapsule, HomogeneousSphere
from .grid_rays import grid_columns

#: How near to a light's place in the picture a click takes it, in pixels.
LIGHT_RADIUS = 8.0
#: Media that gather less opacity than this along the ray are not picked: one sees through them.
LEAST_OPACITY = 0.01
#: The same where a mesh is behind them, which is what one sees then.
LEAST_OPACITY_BEFORE_MESH = 0.2


@dataclass(frozen=True, eq=False)
class Pick:
    """What was hit.

    `path` is the record's: that of an instanced volume ends in ``[i]``. `point` is a world position (3,): on the
    surface, the light's own, or where the view ray has gathered half of the opacity that the medium gives it.
    `distance` is that of the point from the camera, in stage units; from its plane for an orthographic camera.
    """

    path: str
    kind: Literal["light", "mesh", "volume"]
    point: np.ndarray
    distance: float


def project(camera: Camera, aspect: float, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where world points (N, 3) are in an image of that aspect: u, v and depth, (N,) each.

    The camera's aspect is conformed as the renderer does. Inside the image u and v are in [0, 1]; `depth` is along the
    camera's axis, in stage units. Points that are not ahead of a perspective camera have no place: u and v are NaN.
    """
    matrix = np.asarray(camera.camera_to_world, float)
    local = (np.asarray(points, float).reshape(-1, 3) - matrix[3, :3]) @ matrix[:3, :3].T
    x, y, depth = local[:, 0], local[:, 1], -local[:, 2]
    if camera.projection == "perspective":
        ahead = np.where(depth > 0.0, depth, np.nan)
        x, y = x / ahead, y / ahead
    left, right, bottom, top = camera.conformed(aspect).window()
    return (x - left) / (right - left), (top - y) / (top - bottom), depth


def pick(
    description: SceneDescription,
    camera: Camera,
    u: float,
    v: float,
    size: tuple[float, float],
    light_icons: Collection[str] | None = None,
    light_radius: float = LIGHT_RADIUS,
) -> Pick | None:
    """What a click at (u, v) means, None for empty space.

    A light within `light_radius` of the click wins over everything, for its icon is drawn over the picture; of
    several the one nearest to the click. Then the first mesh along the ray, unless the media before it gather
    LEAST_OPACITY_BEFORE_MESH; of several media the one that gives the view ray the most opacity.

    Args:
        description: the scene.
        camera: its aspect is conformed to the image.
        u, v: in [0, 1] over the image, from its upper left corner.
        size: (width, height) of the image in pixels.
        light_icons: paths of the lights whose icons are shown; None is all of them.
        light_radius: in pixels of `size`.
    """
    aspect = size[0] / size[1]
    light = _light_at(description.lights.values(), camera, u, v, size, light_icons, light_radius)
    if light is not None:
        return light
    origin, direction, near, far = _view_ray(camera.conformed(aspect), u, v)
    hit = None
    for mesh in description.meshes.values():
        t = mesh_distance(mesh, origin, direction, near, far)
        if t is not None:
            hit, far = mesh, t
    found = _medium_at(description.volumes.values(), origin, direction, near, far)
    if found is not None and found[2] >= (LEAST_OPACITY if hit is None else LEAST_OPACITY_BEFORE_MESH):
        volume, t, _ = found
        return Pick(volume.path, "volume", origin + t * direction, t)
    if hit is not None:
        return Pick(hit.path, "mesh", origin + far * direction, far)
    return None


def _view_ray(camera: Camera, u: float, v: float) -> tuple[np.ndarray, np.ndarray, float, float]:
    """(origin, unit direction, first distance, last distance) of the ray through a point of the image."""
    matrix = np.asarray(camera.camera_to_world, float)
    left, right, bottom, top = camera.window()
    across = (left + u * (right - left)) * matrix[0, :3] + (top - v * (top - bottom)) * matrix[1, :3]
    near, far = camera.clipping_range
    if camera.projection == "orthographic":
        return matrix[3, :3] + across, -matrix[2, :3], near, far
    direction = across - matrix[2, :3]
    length = float(np.linalg.norm(direction))
    return matrix[3, :3], direction / length, near * length, far * length


def _light_at(
    lights: Collection[Light],
    camera: Camera,
    u: float,
    v: float,
    size: tuple[float, float],
    shown: Collection[str] | None,
    radius: float,
) -> Pick | None:
    """The light whose place in the picture is nearest to (u, v), within a radius in pixels."""
    placed = [x for x in lights if x.kind not in ("distant", "dome") and (shown is None or x.path in shown)]
    if not placed:
        return None
    positions = np.array([light.position for light in placed])
    light_u, light_v, depth = project(camera, size[0] / size[1], positions)
    gap = np.hypot((light_u - u) * size[0], (light_v - v) * size[1])
    # Also behind an orthographic camera there is nothing to be seen.
    gap = np.where((depth > 0.0) & np.isfinite(gap), gap, np.inf)
    # Of lights at one place in the picture the nearest to the camera.
    best = int(np.lexsort((depth, gap))[0])
    if gap[best] > radius:
        return None
    distance = depth[best]
    if camera.projection == "perspective":
        distance = np.linalg.norm(positions[best] - np.asarray(camera.camera_to_world, float)[3, :3])
    return Pick(placed[best].path, "light", positions[best], float(distance))


def mesh_distance(mesh: Mesh, origin: np.ndarray, direction: np.ndarray, near: float, far: float) -> float | None:
    """The first distance within [near, far] at which a ray meets a triangle of any instance, None for a miss.

    `origin` (3,) and `direction` (3,), of unit length, are in the world. Both sides of a triangle are met.
    """
    bounds = mesh.geometry.bounds
    if bounds is None or len(mesh.geometry.triangles) == 0:
        return None
    lo, hi = (np.asarray(b, float) for b in bounds)
    # A flat mesh has a box without thickness, which rounding would miss.
    pad = 1e-6 * max(float(np.abs(lo).max()), float(np.abs(hi).max()), 1e-30)
    matrices = np.asarray(mesh.local_to_world, float).reshape(-1, 4, 4)
    inverse = np.linalg.inv(matrices[np.linalg.det(matrices[:, :3, :3]) != 0.0])
    # A local direction keeps its length: the ray's parameter is the world distance in every space.
    origins, directions = origin @ inverse[:, :3, :3] + inverse[:, 3, :3], direction @ inverse[:, :3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.stack([lo - pad, hi + pad])[:, None] - origins) / directions
    # Along an axis that the ray does not move on, it is within the box everywhere or (NaN: on its face) nowhere.
    entry = np.maximum(np.fmin(*sides).max(axis=1), near)
    exit_ = np.minimum(np.fmax(*sides).min(axis=1), far)
    met = np.flatnonzero(entry <= exit_)
    best = None
    for i in met[np.argsort(entry[met])]:
        if best is not None and entry[i] > best:
            break
        t = _first_triangle(mesh, origins[i], directions[i], near, far)
        if t is not None and (best is None or t < best):
            best = t
    return best


def _first_triangle(mesh: Mesh, origin: np.ndarray, direction: np.ndarray, near: float, far: float) -> float | None:
    """The ray's first parameter within [near, far] on a triangle, all in the mesh's own space."""
    points, triangles = mesh.geometry.points, mesh.geometry.triangles
    length = float(np.linalg.norm(direction))
    ahead = direction / length
    side = np.cross(ahead, np.eye(3)[int(np.argmin(np.abs(ahead)))])
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(ahead, side)], axis=1)
    # Seen along the ray, a triangle can only be hit if its vertices are not all on one side of it, in either
    # direction. That takes a byte per vertex and leaves few triangles for arithmetic.
    place = origin @ axes
    slack = 1e-5 * max(float(np.abs(mesh.geometry.bounds).max()), float(np.abs(place).max()))
    sides = np.zeros(len(points), np.uint8)
    for i, (x, y, z) in enumerate(axes.T.astype(np.float32)):
        # Not a matrix product: those are spread over threads, which stall for long when the processor is busy.
        across = points[:, 0] * x + points[:, 1] * y + points[:, 2] * z
        sides |= (across > place[i] + slack).view(np.uint8) << np.uint8(2 * i)
        sides |= (across < place[i] - slack).view(np.uint8) << np.uint8(2 * i + 1)
    of_corners = np.take(sides, triangles)
    rows = np.flatnonzero((of_corners[:, 0] & of_corners[:, 1] & of_corners[:, 2]) == 0)
    if len(rows) == 0:
        return None
    corners = points[triangles[rows]].astype(float) - origin
    x, y = np.moveaxis(corners @ axes, -1, 0)
    following, last = (1, 2, 0), (2, 0, 1)
    weights = x[:, following] * y[:, last] - x[:, last] * y[:, following]
    total = weights.sum(axis=1)
    inside = ((weights >= 0.0).all(axis=1) | (weights <= 0.0).all(axis=1)) & (total != 0.0)
    depth = (weights[inside] * (corners[inside] @ ahead)).sum(axis=1) / total[inside] / length
    depth = depth[(depth >= near) & (depth <= far)]
    return float(depth.min()) if len(depth) else None


def _medium_at(
    volumes: Collection[Volume], origin: np.ndarray, direction: np.ndarray, near: float, far: float
) -> tuple[Volume, float, float] | None:
    """(volume, distance, opacity) of the medium that gives the ray most of its opacity, None without any.

    The opacity is that of all media up to `far`, averaged over the channels; the distance is where half of the
    volume's own share is gathered.
    """
    met = []
    for volume in volumes:
        strength = np.array(volume.medium.strength)
        start, end, column = _columns(volume, origin, direction, near, far) if strength.any() else ((), (), ())
        if len(start) and np.any(column):
            met.append((volume, strength, start, end, column))
    if not met:
        return None
    cuts = np.unique(np.concatenate([np.concatenate([start, end]) for _, _, start, end, _ in met]))
    # Each volume's optical depth within every piece between two cuts of any of them, (volumes, pieces, 3).
    depths = []
    for _, strength, start, end, column in met:
        knots = np.stack([start, end], axis=1).ravel()
        total = np.cumsum(column)
        gathered = np.stack([total - column, total], axis=1).ravel()
        depths.append(np.diff(np.interp(cuts, knots, gathered))[:, None] * strength)
    depths = np.array(depths)
    piece = depths.sum(axis=0)
    transmittance = np.exp(-(np.cumsum(piece, axis=0) - piece))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(piece > 0.0, depths / piece, 0.0)
    # What a volume takes of the light from behind, per piece, mean of the channels.
    taken = (share * transmittance * -np.expm1(-piece)).mean(axis=2)
    best = int(np.argmax(taken.sum(axis=1)))
    gathered = np.cumsum(taken[best])
    half = 0.5 * gathered[-1]
    i = int(np.searchsorted(gathered, half))
    # A piece may be the whole of a homogeneous shape: inside it light falls exponentially, in each channel.
    missing = half - (gathered[i] - taken[best, i])
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        part = (share[best, i] * transmittance[i] * -np.expm1(-piece[i] * middle)).mean()
        low, high = (middle, high) if part < missing else (low, middle)
    return met[best][0], float(cuts[i] + low * (cuts[i + 1] - cuts[i])), float(taken.sum())


def _columns(
    volume: Volume, origin: np.ndarray, direction: np.ndarray, near: float, far: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start, end and ∫ density dt of the pieces of a world ray inside a volume, (P,) each."""
    nothing = np.zeros(0), np.zeros(0), np.zeros(0)
    to_world = np.asarray(volume.local_to_world, float)
    if volume.density is not None:
        to_world = np.asarray(volume.density.index_to_local, float) @ to_world
    # What is scaled to nothing has no inside.
    if not np.all(np.isfinite(to_world)) or np.linalg.det(to_world[:3, :3]) == 0.0:
        return nothing
    if volume.density is not None:
        inverse = np.linalg.inv(to_world)
        local_origin = origin @ inverse[:3, :3] + inverse[3, :3]
        return grid_columns(volume.density.grid, local_origin, direction @ inverse[:3, :3], near, far)
    shape = volume.shape
    if isinstance(shape, Box):
        solid = HomogeneousBox(shape.minimum, shape.maximum, to_world)
    elif isinstance(shape, Sphere):
        solid = HomogeneousSphere(shape.radius, to_world)
    else:
        solid = HomogeneousCapsule(shape.radius, shape.height, shape.axis, to_world)
    entry, exit_ = solid.span(origin[None], direction[None])
    start, end = np.maximum(entry, near), np.minimum(exit_, far)
    return (start, end, end - start) if start[0] < end[0] else nothing
