"""Scenes of the hard cases, built of description records: without USD and without files."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...description import (
    Box,
    Camera,
    Field,
    Geometry,
    Light,
    Medium,
    Mesh,
    SceneDescription,
    Shape,
    Sphere,
    Surface,
    Volume,
)
from ...vdb import Grid
from ..transforms import rotation, translation

Vector = Sequence[float]


def look_at(eye: Vector, target: Vector) -> np.ndarray:
    """Placement of what looks, or shines, along its −Z from `eye` towards `target`."""
    back = np.subtract(eye, target, dtype=float)
    back /= np.linalg.norm(back)
    up = (0.0, 1.0, 0.0) if abs(back[1]) < 0.9 else (1.0, 0.0, 0.0)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3], matrix[3, :3] = right, np.cross(back, right), back, eye
    return matrix


def camera(eye: Vector, target: Vector = (0.0, 0.0, 0.0), degrees: float = 30.0, near: float = 1e-3) -> Camera:
    """A perspective camera; `degrees` is its horizontal angle of view."""
    aperture = 2.0 * 50.0 * math.tan(math.radians(0.5 * degrees))
    return Camera("/Camera", look_at(eye, target), "perspective", 50.0, aperture, aperture, clipping_range=(near, 1e6))


def placed_camera(view: Camera, matrix: np.ndarray) -> Camera:
    """A camera under one more transform, a similarity: its axes stay orthonormal, its clipping range follows."""
    scale = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1.0 / 3.0)
    moved = view.camera_to_world @ matrix
    moved[:3, :3] /= scale
    near, far = view.clipping_range
    return replace(view, camera_to_world=moved, clipping_range=(near * scale, far * scale))


def fog(extinction: float | Vector = 1.0, **values: Any) -> Medium:
    """A medium of that extinction, of albedo 0.9 unless it is given."""
    rgb = (float(extinction),) * 3 if np.isscalar(extinction) else tuple(map(float, extinction))
    return Medium(extinction=rgb, **{"albedo": (0.9, 0.9, 0.9), **values})


def cube_transform(shape: Sequence[int]) -> np.ndarray:
    """Index space to the cube from −1 to 1, on whose faces the field reaches its background."""
    cells = np.array(shape[:3], float) + 1.0
    matrix = np.diag([*(2.0 / cells), 1.0])
    matrix[3, :3] = 2.0 / cells - 1.0
    return matrix


def field_of(grid: Grid, index_to_local: np.ndarray | None = None) -> Field:
    """A field of a grid, placed by the grid's own transform unless another is given."""
    parts = (grid.leaf_origins, grid.leaf_values, grid.leaf_active, grid.tiles.origin, grid.tiles.value)
    key = hashlib.blake2b(b"|".join(np.ascontiguousarray(p).tobytes() for p in parts)).hexdigest()
    return Field((key, str(grid.background)), grid, grid.index_to_world if index_to_local is None else index_to_local)


def volume(
    values: np.ndarray,
    medium: Medium,
    local_to_world: np.ndarray | None = None,
    path: str = "/Volume",
    index_to_local: np.ndarray | None = None,
) -> Volume:
    """A volume of voxels (X, Y, Z); by default they and a voxel of margin fill the cube from −1 to 1."""
    values = np.asarray(values, np.float32)
    transform = cube_transform(values.shape) if index_to_local is None else index_to_local
    density = field_of(Grid.from_dense("density", values), transform)
    return Volume(path, np.eye(4) if local_to_world is None else local_to_world, medium, density=density)


def _shape(path: str, shape: Shape, medium: Medium, local_to_world: np.ndarray | None) -> Volume:
    return Volume(path, np.eye(4) if local_to_world is None else local_to_world, medium, shape=shape)


def box(medium: Medium, lo: Vector = (-1, -1, -1), hi: Vector = (1, 1, 1), matrix=None, path: str = "/Box") -> Volume:
    """A homogeneous box."""
    return _shape(path, Box(tuple(map(float, lo)), tuple(map(float, hi))), medium, matrix)


def sphere(medium: Medium, radius: float = 1.0, matrix: np.ndarray | None = None, path: str = "/Sphere") -> Volume:
    """A homogeneous sphere."""
    return _shape(path, Sphere(radius), medium, matrix)


def distant(direction: Vector, strength: Vector = (3.0, 3.0, 3.0), path: str = "/Sun", **values: Any) -> Light:
    """A sun that travels in that direction; `strength` is the irradiance on a plane across it."""
    return Light(path, "distant", look_at((0.0, 0.0, 0.0), direction), tuple(strength), tuple(strength), **values)


def point(position: Vector, strength: float = 4.0, path: str = "/Point", **values: Any) -> Light:
    """A small bulb; `strength` is its radiant intensity."""
    rgb = (float(strength),) * 3
    return Light(path, "sphere", translation(*position), rgb, rgb, treat_as_point=True, **values)


# Bit a of a corner's number is its side along axis a; counter-clockwise from outside.
_BOX_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))


def box_mesh(lo: Vector, hi: Vector, color: float = 0.5, path: str = "/Mesh") -> Mesh:
    """A solid box, flat-shaded and Lambertian."""
    corners = np.array([[(lo, hi)[(i >> a) & 1][a] for a in range(3)] for i in range(8)], float)
    points, normals, triangles = [], [], []
    for face in _BOX_FACES:
        quad = corners[list(face)]
        normal = np.cross(quad[1] - quad[0], quad[2] - quad[0])
        first = len(points)
        points += list(quad)
        normals += [normal / np.linalg.norm(normal)] * 4
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    vertices = np.array(points, np.float32)
    geometry = Geometry(vertices.tobytes(), vertices, np.array(normals, np.float32), np.array(triangles, np.uint32))
    return Mesh(path, geometry, np.eye(4)[None], Surface(diffuse_color=(color,) * 3))


def scene(*records: Volume | Light | Mesh) -> SceneDescription:
    """A scene of the given records, each of its own path."""
    return SceneDescription(
        volumes={r.path: r for r in records if isinstance(r, Volume)},
        lights={r.path: r for r in records if isinstance(r, Light)},
        meshes={r.path: r for r in records if isinstance(r, Mesh)},
    )


def moved(description: SceneDescription, matrix: np.ndarray, keep_depth: bool = False) -> SceneDescription:
    """The whole scene under one more transform.

    With `keep_depth` a scale s goes with extinctions over s and radiant intensities times s²: the picture stays.
    """
    scale = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1.0 / 3.0) if keep_depth else 1.0

    def medium(held: Medium) -> Medium:
        return held if scale == 1.0 else replace(held, density_scale=held.density_scale / scale)

    def light(held: Light) -> Light:
        factor = 1.0 if held.kind == "distant" else scale * scale
        strength = tuple(c * factor for c in held.strength)
        return replace(held, light_to_world=held.light_to_world @ matrix, strength=strength)

    return SceneDescription(
        volumes={
            p: replace(v, local_to_world=v.local_to_world @ matrix, medium=medium(v.medium))
            for p, v in description.volumes.items()
        },
        lights={p: light(x) for p, x in description.lights.items()},
        meshes={p: replace(m, local_to_world=m.local_to_world @ matrix) for p, m in description.meshes.items()},
    )


def smooth_noise(shape: tuple[int, int, int], seed: int = 0) -> np.ndarray:
    """A smooth random density in [0, 1] that is low at the faces of the block."""
    random = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in shape), indexing="ij")
    total = np.zeros(shape)
    for _ in range(8):
        k, phase = random.integers(0, 3, 3), random.uniform(0.0, 2.0 * np.pi, 3)
        waves = [np.cos(np.pi * f * a + p) for f, a, p in zip(k, (x, y, z), phase, strict=True)]
        total += random.uniform(0.5, 1.0) * waves[0] * waves[1] * waves[2]
    total = (total - total.min()) / np.ptp(total)
    return (0.15 + 0.85 * total) * np.prod([np.sin(np.pi * (0.1 + 0.8 * a)) for a in (x, y, z)], axis=0)


FRONT = camera((1.2, 0.9, 5.5))
SIDE = distant((-1.0, -0.7, -0.4))
TURNED = rotation((0.3, 1.0, 0.2), 35.0)
#: The cloud of most cases.
CLOUD = smooth_noise((13, 16, 12), seed=3)
#: Its largest column along an axis of the cube from −1 to 1: an extinction of depth/COLUMN makes it that deep.
COLUMN = float(max(CLOUD.sum(axis=a).max() * 2.0 / (CLOUD.shape[a] + 1.0) for a in range(3)))


def cloud(depth: float | Vector = 3.0, matrix: np.ndarray | None = TURNED, path: str = "/Volume", **medium) -> Volume:
    """The cloud of most cases, turned in space; `depth` is its largest optical depth, one or one per channel."""
    return volume(CLOUD, fog(np.asarray(depth, float) / COLUMN, **medium), matrix, path)
