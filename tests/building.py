"""Scene descriptions built by hand for tests: volumes, meshes, lights and cameras, without USD."""

import hashlib
import math
from dataclasses import replace

import numpy as np

from previs.bench.transforms import rotation as rotation
from previs.bench.transforms import scaling as scaling
from previs.bench.transforms import shear as shear
from previs.bench.transforms import translation as translation
from previs.description import (
    Box,
    Camera,
    Capsule,
    Color,
    Field,
    Geometry,
    Light,
    Medium,
    Mesh,
    SceneDescription,
    Shaping,
    Sphere,
    Surface,
    Volume,
)
from previs.index import RenderIndex
from previs.vdb import Grid


def look_at(
    eye: tuple[float, float, float], target: tuple[float, float, float], up: tuple[float, float, float] = (0, 1, 0)
) -> np.ndarray:
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(np.asarray(up, float), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3], matrix[3, :3] = right, np.cross(back, right), back, eye
    return matrix


def camera(
    eye: tuple[float, float, float],
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    degrees: float = 30.0,
    clip: tuple[float, float] = (1e-3, 1e6),
    offset: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """A perspective camera; `degrees` is its horizontal angle of view, `offset` that of its aperture in widths."""
    aperture = 2.0 * 50.0 * math.tan(math.radians(0.5 * degrees))
    return Camera(
        "/Camera",
        look_at(eye, target),
        focal_length=50.0,
        horizontal_aperture=aperture,
        vertical_aperture=aperture * 9.0 / 16.0,
        horizontal_aperture_offset=offset[0] * aperture,
        vertical_aperture_offset=offset[1] * aperture,
        clipping_range=clip,
    )


def orthographic_camera(
    eye: tuple[float, float, float],
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    width: float = 3.0,
    offset: tuple[float, float] = (0.0, 0.0),
    clip: tuple[float, float] = (1e-3, 1e6),
) -> Camera:
    """`width` and `offset` are stage units."""
    return Camera(
        "/Camera",
        look_at(eye, target),
        projection="orthographic",
        horizontal_aperture=10.0 * width,
        vertical_aperture=10.0 * width * 9.0 / 16.0,
        horizontal_aperture_offset=10.0 * offset[0],
        vertical_aperture_offset=10.0 * offset[1],
        clipping_range=clip,
    )


def smooth_noise(shape: tuple[int, int, int], seed: int = 0, modes: int = 2) -> np.ndarray:
    """A smooth random density in [0, 1] that is low at the faces of the block."""
    random = np.random.default_rng(seed)
    axes = [np.linspace(0.0, 1.0, n) for n in shape]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    total = np.zeros(shape)
    for _ in range(8):
        k = random.integers(0, modes + 1, 3)
        phase = random.uniform(0.0, 2.0 * np.pi, 3)
        waves = [np.cos(np.pi * f * a + p) for f, a, p in zip(k, (x, y, z), phase, strict=True)]
        total += random.uniform(0.5, 1.0) * waves[0] * waves[1] * waves[2]
    total = (total - total.min()) / np.ptp(total)
    window = np.prod([np.sin(np.pi * (0.1 + 0.8 * a)) for a in (x, y, z)], axis=0)
    return (0.15 + 0.85 * total) * window


def field(values: np.ndarray, index_to_local: np.ndarray | None = None, background: float = 0.0) -> Field:
    """A field of the given voxels; without a transform they and a voxel of margin fill the cube from −1 to 1."""
    values = np.asarray(values, np.float32)
    if index_to_local is None:
        index_to_local = unit_cube_transform(values.shape[:3])
    grid = Grid.from_dense("density", values, background=background)
    key = hashlib.blake2b(values.tobytes() + str((values.shape, background)).encode()).hexdigest()
    return Field(key, grid, np.asarray(index_to_local, float))


def unit_cube_transform(shape: tuple[int, ...]) -> np.ndarray:
    """Index space to the cube from −1 to 1, on whose faces the field reaches its background."""
    cells = np.array(shape[:3], float) + 1.0
    matrix = np.diag([*(2.0 / cells), 1.0])
    matrix[3, :3] = 2.0 / cells - 1.0
    return matrix


def volume(
    values: np.ndarray,
    medium: Medium,
    local_to_world: np.ndarray | None = None,
    path: str = "/Volume",
    temperature: np.ndarray | None = None,
    emission: np.ndarray | None = None,
    index_to_local: np.ndarray | None = None,
) -> Volume:
    """A volume of voxels."""
    return Volume(
        path,
        np.eye(4) if local_to_world is None else local_to_world,
        medium,
        density=field(values, index_to_local),
        temperature=None if temperature is None else field(temperature),
        emission=None if emission is None else field(emission),
    )


def box(medium: Medium, lo=(-1, -1, -1), hi=(1, 1, 1), local_to_world=None, path="/Box") -> Volume:
    shape = Box(tuple(map(float, lo)), tuple(map(float, hi)))
    return Volume(path, np.eye(4) if local_to_world is None else local_to_world, medium, shape=shape)


def sphere(medium: Medium, radius=1.0, local_to_world=None, path="/Sphere") -> Volume:
    return Volume(path, np.eye(4) if local_to_world is None else local_to_world, medium, shape=Sphere(radius))


def capsule(medium: Medium, axis="Z", height=1.0, radius=0.5, local_to_world=None, path="/Capsule") -> Volume:
    matrix = np.eye(4) if local_to_world is None else local_to_world
    return Volume(path, matrix, medium, shape=Capsule(axis, height, radius))


def distant(direction, strength: Color = (1.0, 1.0, 1.0), path="/Sun", **values) -> Light:
    """`strength` is the irradiance on a plane across the light."""
    up = (0.0, 1.0, 0.0) if abs(direction[1]) < 0.9 * np.linalg.norm(direction) else (1.0, 0.0, 0.0)
    # A light shines along its local −Z as a camera looks along it.
    matrix = look_at((0.0, 0.0, 0.0), tuple(direction), up)
    return Light(path, "distant", matrix, strength, strength, **values)


def point(position, strength: Color = (1.0, 1.0, 1.0), radius=0.0, path="/Point", **values) -> Light:
    """`strength` is the radiant intensity."""
    return Light(path, "sphere", translation(*position), strength, strength, radius=radius, **values)


def spot(
    position, target, strength: Color = (1.0, 1.0, 1.0), shaping: Shaping | None = None, path="/Spot", **values
) -> Light:
    """`shaping` defaults to a cone of 30°; other kinds than a small sphere are asked for with `kind`."""
    axis = np.subtract(target, position)
    up = (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 * np.linalg.norm(axis) else (1.0, 0.0, 0.0)
    kind = values.pop("kind", "sphere")
    shaped = values.pop("shaped", True)
    shaping = (shaping or Shaping(cone_angle=30.0)) if shaped else None
    return Light(path, kind, look_at(position, target, up), strength, strength, shaping=shaping, **values)


# Bit a of a corner's number is its side along axis a; counter-clockwise from outside.
_BOX_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))


def polygons(points: np.ndarray, faces: tuple[tuple[int, ...], ...]) -> Geometry:
    """Flat-shaded geometry: every face has vertices of its own."""
    vertices, normals, triangles = [], [], []
    for face in faces:
        corners = np.asarray(points, float)[list(face)]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        first = len(vertices)
        vertices += list(corners)
        normals += [normal / np.linalg.norm(normal)] * len(face)
        triangles += [(first, first + i, first + i + 1) for i in range(1, len(face) - 1)]
    vertices = np.array(vertices, np.float32)
    key = hashlib.blake2b(vertices.tobytes() + str(faces).encode()).hexdigest()
    return Geometry(key, vertices, np.array(normals, np.float32), np.array(triangles, np.uint32))


def box_mesh(lo, hi, color: Color = (0.5, 0.5, 0.5), matrix: np.ndarray | None = None, path="/Mesh", **surface) -> Mesh:
    corners = np.array([[(lo, hi)[(i >> a) & 1][a] for a in range(3)] for i in range(8)], float)
    placed = (np.eye(4) if matrix is None else np.asarray(matrix, float))[None]
    return Mesh(path, polygons(corners, _BOX_FACES), placed, Surface(diffuse_color=color, **surface))


def quad_mesh(corners, color: Color = (0.5, 0.5, 0.5), path="/Quad", **surface) -> Mesh:
    geometry = polygons(np.asarray(corners, float), (tuple(range(len(corners))),))
    return Mesh(path, geometry, np.eye(4)[None], Surface(diffuse_color=color, **surface))


def scene(*records: Volume | Light | Mesh) -> SceneDescription:
    """A scene of the given records; a path is used once."""
    kinds = {Volume: {}, Light: {}, Mesh: {}}
    for record in records:
        held = kinds[type(record)]
        assert record.path not in held, f"{record.path} is there twice"
        held[record.path] = record
    return SceneDescription(volumes=kinds[Volume], lights=kinds[Light], meshes=kinds[Mesh])


def moved(description: SceneDescription, matrix: np.ndarray) -> SceneDescription:
    """The whole scene under one more transform."""
    return SceneDescription(
        volumes={p: replace(v, local_to_world=v.local_to_world @ matrix) for p, v in description.volumes.items()},
        lights={p: replace(x, light_to_world=x.light_to_world @ matrix) for p, x in description.lights.items()},
        meshes={p: replace(m, local_to_world=m.local_to_world @ matrix) for p, m in description.meshes.items()},
    )


def index_of(description: SceneDescription) -> RenderIndex:
    index = RenderIndex()
    index.update(description)
    return index
