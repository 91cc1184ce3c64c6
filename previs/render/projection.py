"""Where rays come from: cameras, transmittance maps and shadow maps as plain float64 geometry.

Everything here is computed in float64 world space and handed to the shaders relative to a *render origin* near the
scene, so that a scene far from the world's origin loses no digits in 32-bit floats. For the same reason camera rays
start on a plane through the scene, not at a camera that may be far away, and distances along light rays count from the
volume's centre.

Matrices act on row vectors (``[x y z 1] @ M``); their bytes are what GLSL reads as a column-major matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..description import Camera, Light, SceneDescription, box_corners, transform_points, volume_box

#: Beyond this half angle a perspective map wastes most of its texels on its rim; an octahedral map takes over.
MAX_PERSPECTIVE_TANGENT = math.tan(math.radians(60.0))


def render_origin(scene: SceneDescription) -> np.ndarray:
    """The point that shader coordinates are relative to: near the centre of what is drawn, (3,).

    It is snapped to a coarse grid so that small moves in the scene leave it, and all that was computed with it, alone.
    """
    bounds = scene.world_bounds()
    if bounds is None:
        return np.zeros(3)
    lo, hi = bounds
    radius = 0.5 * float(np.linalg.norm(hi - lo))
    if not np.isfinite(radius) or radius == 0.0:
        return 0.5 * (lo + hi)
    cell = 2.0 ** math.ceil(math.log2(radius))
    return np.round(0.5 * (lo + hi) / cell) * cell


@dataclass(frozen=True, eq=False)
class CameraRays:
    """A ray per pixel: ``anchor + s · normalize(direction)``; both are affine in the image coordinate (u, v).

    `anchor` and `direction` are (3, 3): the value at (0, 0), and its change along u and along v, where u runs to the
    right and v up over the image. `direction` is scaled to advance one unit along the camera's axis. The anchors lie
    on the plane `anchor_depth` in front of the camera; `near` and `far` are depths along the axis. `view` and
    `projection` are for rasterising. All relative to `origin`.
    """

    anchor: np.ndarray
    direction: np.ndarray
    anchor_depth: float
    near: float
    far: float
    view_projection: np.ndarray
    axis: np.ndarray

    def key(self) -> bytes:
        """A hashable stand-in."""
        numbers = np.array([self.anchor_depth, self.near, self.far])
        return b"".join(a.tobytes() for a in (self.anchor, self.direction, numbers, self.view_projection))


def camera_rays(camera: Camera, origin: np.ndarray, scene: SceneDescription, shift: tuple[float, float]) -> CameraRays:
    """Rays of a camera whose aspect already fits the image.

    Args:
        camera: as in the description.
        origin: the render origin.
        scene: bounds the depth range, so that a depth buffer keeps its precision.
        shift: offset of the samples from the pixel centres, in units of the image's (u, v).
    """
    matrix = np.asarray(camera.camera_to_world, float)
    right, up, back = matrix[0, :3], matrix[1, :3], matrix[2, :3]
    eye = matrix[3, :3] - origin
    left, right_edge, bottom, top = camera.window()
    width, height = right_edge - left, top - bottom
    left, bottom = left + shift[0] * width, bottom + shift[1] * height
    near, far = (float(c) for c in camera.clipping_range)
    bounds = scene.world_bounds()
    anchor_depth = 0.0
    if bounds is not None:
        corners = box_corners(*bounds) - origin
        depths = -(corners - eye) @ back
        centre, radius = 0.5 * (depths.min() + depths.max()), 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
        margin = 1e-3 * max(radius, 1e-30)
        near, far = max(near, float(depths.min()) - margin), min(far, float(depths.max()) + margin)
        if centre > 2.0 * radius:
            anchor_depth = float(centre)
    if camera.projection == "perspective":
        near = max(near, 1e-6 * max(far, 1e-30))
    far = max(far, near * (1.0 + 1e-6) if near > 0.0 else near + 1e-6)
    forward0 = left * right + bottom * up - back
    if camera.projection == "perspective":
        direction = np.array([forward0, width * right, height * up])
        anchor = direction * anchor_depth
        anchor[0] += eye
        x0, y0 = 2.0 / width, 2.0 / height
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = x0, y0
        projection[2, 0] = (2.0 * left + width) / width
        projection[2, 1] = (2.0 * bottom + height) / height
        projection[2, 2] = -(far + near) / (far - near)
        projection[2, 3] = -1.0
        projection[3, 2] = -2.0 * far * near / (far - near)
    else:
        direction = np.array([-back, np.zeros(3), np.zeros(3)])
        anchor = np.array([eye + left * right + bottom * up - anchor_depth * back, width * right, height * up])
        projection = np.eye(4)
        projection[0, 0], projection[1, 1] = 2.0 / width, 2.0 / height
        projection[3, 0], projection[3, 1] = -(2.0 * left + width) / width, -(2.0 * bottom + height) / height
        projection[2, 2] = -2.0 / (far - near)
        projection[3, 2] = -(far + near) / (far - near)
    view = np.eye(4)
    view[:3, :3] = np.stack([right, up, back], axis=1)
    view[3, :3] = -eye @ view[:3, :3]
    return CameraRays(anchor, direction, anchor_depth, near, far, view @ projection, -back)


MapKind = Literal["orthographic", "perspective", "octahedral"]
MAP_KINDS: tuple[MapKind, ...] = ("orthographic", "perspective", "octahedral")


@dataclass(frozen=True, eq=False)
class LightMap:
    """The rays of one light through one volume, one per texel of a square map; all relative to the volume's `centre`
    (world).

    ``ray_origin`` and ``ray_direction`` are (3, 3) affine in (u, v), as for a camera (unused for an octahedral map,
    whose directions cover the sphere). `to_map` takes a point relative to `centre` to (U, V, ·, W), with (u, v) = (U,
    V) / W. `from_light` is the vector from the light to `centre`, or the light's direction for an orthographic map.
    `reach` are the distances along the light's rays, counted from the centre's, between which the volume holds
    anything. `aspect` are the sides of the map's window in space, as parts of the longer one.
    """

    kind: MapKind
    centre: np.ndarray
    ray_origin: np.ndarray
    ray_direction: np.ndarray
    to_map: np.ndarray
    from_light: np.ndarray
    reach: tuple[float, float]
    aspect: tuple[float, float] = (1.0, 1.0)

    def key(self) -> bytes:
        """A hashable stand-in."""
        arrays = (self.ray_origin, self.ray_direction, self.to_map, self.from_light, self.reach)
        return self.kind.encode() + b"".join(np.asarray(a, float).tobytes() for a in arrays)


def _axes(forward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with `forward`."""
    helper = np.eye(3)[int(np.argmin(np.abs(forward)))]
    right = np.cross(forward, helper)
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward)


def occupied_points(volume) -> np.ndarray:
    """World points whose hull holds everything in a volume: corners of its leaves, or of its box, (P, 3)."""
    lo, hi, to_world = volume_box(volume)
    corners = box_corners(lo, hi)
    grid = volume.density.grid if volume.density is not None else None
    if grid is not None and 0 < len(grid.leaf_origins) <= 200_000 and len(grid.tiles.size) == 0:
        origins = _outermost(grid.leaf_origins).astype(float)
        first, last = np.maximum(origins - 1.0, lo), np.minimum(origins + 8.0, hi)
        corners = np.concatenate([np.where(mask, last, first) for mask in box_corners(np.zeros(3), np.ones(3)) > 0.5])
    return transform_points(corners, to_world)


def _outermost(leaves: np.ndarray) -> np.ndarray:
    """Leaves (n, 3) whose hull is that of all: of every row along an axis the first and the last."""
    for axis in range(3):
        across = [a for a in range(3) if a != axis]
        leaves = leaves[np.lexsort((leaves[:, axis], leaves[:, across[0]], leaves[:, across[1]]))]
        begins = np.ones(len(leaves) + 1, bool)
        begins[1:-1] = (leaves[1:, across] != leaves[:-1, across]).any(axis=1)
        leaves = leaves[begins[:-1] | begins[1:]]
    return leaves


def light_map(light: Light, volume, size: int) -> LightMap:
    """Fit a transmittance map of `size`² texels of a light to what a volume holds.

    Orthographic for a distant light; perspective around the volume, or around the light's cone where that is narrower;
    octahedral where the light is inside the volume or too near for either.
    """
    points = occupied_points(volume)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    points = points - centre
    margin = 1.0 / size
    if light.kind == "distant":
        direction = light.direction
        right, up = _axes(direction)
        u, v, k = points @ right, points @ up, points @ direction
        (u0, du), (v0, dv) = _span(u, margin), _span(v, margin)
        origin = np.array([u0 * right + v0 * up + k.min() * direction, du * right, dv * up])
        to_map = np.zeros((4, 4))
        to_map[:3, 0], to_map[:3, 1] = right / du, up / dv
        to_map[3, :] = (-u0 / du, -v0 / dv, 0.0, 1.0)
        return LightMap(
            "orthographic",
            centre,
            origin,
            np.array([direction, np.zeros(3), np.zeros(3)]),
            to_map,
            direction,
            (float(k.min()), float(k.max())),
            _aspect(du, dv),
        )
    position = light.position - centre
    candidates = []
    distance = float(np.linalg.norm(position))
    farthest = float(np.linalg.norm(points - position, axis=1).max())
    if distance > 0.0:
        candidates.append(_perspective_window(points - position, -position / distance, margin))
    shaping = light.shaping
    if shaping is not None and shaping.cone_angle < 60.0:
        tangent = math.tan(math.radians(max(shaping.cone_angle, 1e-3))) * (1.0 + 2.0 * margin)
        candidates.append((light.direction, -tangent, 2.0 * tangent, -tangent, 2.0 * tangent))
    candidates = [c for c in candidates if c is not None]
    if not candidates:
        to_map = np.eye(4)
        to_map[3, :3] = -position
        reach = (-distance, farthest - distance)
        return LightMap("octahedral", centre, np.zeros((3, 3)), np.zeros((3, 3)), to_map, -position, reach)
    forward, u0, du, v0, dv = min(candidates, key=lambda c: c[2] * c[4])
    right, up = _axes(forward)
    direction = np.array([forward + u0 * right + v0 * up, du * right, dv * up])
    to_map = np.zeros((4, 4))
    to_map[:3, 0] = (right - u0 * forward) / du
    to_map[:3, 1] = (up - v0 * forward) / dv
    to_map[:3, 3] = forward
    to_map[3] = -position @ to_map[:3]
    origin = np.array([position, np.zeros(3), np.zeros(3)])
    # No part of the hull is nearer than its depth, nor farther than its farthest corner.
    nearest = max(float(((points - position) @ forward).min()), 0.0)
    reach = (nearest - distance, farthest - distance)
    return LightMap("perspective", centre, origin, direction, to_map, -position, reach, _aspect(du, dv))


def _aspect(width: float, height: float) -> tuple[float, float]:
    longer = max(width, height)
    return width / longer, height / longer


def _span(values: np.ndarray, margin: float) -> tuple[float, float]:
    """(first, width) of an interval around values, widened so that border texels lie outside."""
    lo, hi = float(values.min()), float(values.max())
    width = max(hi - lo, 1e-30)
    return lo - 1.5 * margin * width, width * (1.0 + 3.0 * margin)


def _perspective_window(points: np.ndarray, forward: np.ndarray, margin: float):
    """(forward, u0, du, v0, dv) of the tangent window around points relative to the light, None where too wide."""
    right, up = _axes(forward)
    depth = points @ forward
    if depth.min() <= 1e-3 * max(float(np.linalg.norm(points, axis=1).max()), 1e-30):
        return None
    u, v = (points @ right) / depth, (points @ up) / depth
    if max(np.abs(u).max(), np.abs(v).max()) > MAX_PERSPECTIVE_TANGENT:
        return None
    return (forward, *_span(u, margin), *_span(v, margin))


ShadowKind = Literal["none", "orthographic", "perspective", "cube"]
SHADOW_KINDS: tuple[ShadowKind, ...] = ("none", "orthographic", "perspective", "cube")

#: Axes of the six faces of a shadow cube: forward, right, up. The shader picks the same ones.
CUBE_FACES = tuple(
    (sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3])
    for axis in range(3)
    for sign in (1.0, -1.0)
)


@dataclass(frozen=True, eq=False)
class ShadowFit:
    """Projections of the shadow map of one light.

    `matrices` holds one world → clip matrix per face: one or two (near the volumes, and everything) for a distant
    light, one for a spot, six for a point light. Depth is linear in [0, 1]: along the light for an orthographic face,
    distance / `far` else.
    """

    kind: ShadowKind
    matrices: tuple[np.ndarray, ...]
    far: float
    position: np.ndarray

    def key(self) -> bytes:
        """A hashable stand-in."""
        return (
            self.kind.encode()
            + np.array([self.far, *self.position]).tobytes()
            + b"".join(m.tobytes() for m in self.matrices)
        )


def shadow_fit(light: Light, casters: np.ndarray, receivers: np.ndarray, media: np.ndarray) -> ShadowFit:
    """Fit a light's shadow map.

    Args:
        light: a light that casts shadows.
        casters: world points (P, 3) around the meshes that may cast a shadow.
        receivers: world points (P, 3) around everything that may receive one.
        media: world points around the volumes alone, may be empty.
    """
    if light.kind == "distant":
        direction = light.direction
        right, up = _axes(direction)
        faces = [_orthographic_face(right, up, direction, casters, receivers)]
        if len(media):
            near = _orthographic_face(right, up, direction, casters, media)
            # A second, closer map pays only where it is clearly finer than the one over everything.
            if abs(np.linalg.det(near[:3, :3])) > 1.5 * abs(np.linalg.det(faces[0][:3, :3])):
                faces.insert(0, near)
        return ShadowFit("orthographic", tuple(faces), 1.0, np.zeros(3))
    position = light.position
    # What lies beyond the last caster is compared at its depth, which is as good.
    far = max(float(np.linalg.norm(casters - position, axis=1).max()), 1e-30) * 1.001
    shaping = light.shaping
    if shaping is not None and shaping.cone_angle < 65.0:
        tangent = math.tan(math.radians(max(shaping.cone_angle, 0.1))) * 1.01
        right, up = _axes(light.direction)
        return ShadowFit(
            "perspective", (_perspective_face(light.direction, right, up, position, tangent, far),), far, position
        )
    faces = [_perspective_face(f, r, u, position, 1.0, far) for f, r, u in CUBE_FACES]
    return ShadowFit("cube", tuple(faces), far, position)


def _orthographic_face(right, up, direction, casters: np.ndarray, receivers: np.ndarray) -> np.ndarray:
    """World → clip for the part across the light where casters and receivers overlap; depth spans the casters."""
    matrix = np.eye(4)
    for column, axis in enumerate((right, up)):
        c, r = casters @ axis, receivers @ axis
        lo, hi = max(c.min(), r.min()), min(c.max(), r.max())
        if hi <= lo:
            lo, hi = float(c.min()), float(c.max())
        # Something flat has a width too, one that rounding does not lose.
        pad = max(1e-3 * (hi - lo), 1e-6 * max(abs(lo), abs(hi)), 1e-30)
        lo, hi = lo - pad, hi + pad
        matrix[:3, column], matrix[3, column] = 2.0 * axis / (hi - lo), -(hi + lo) / (hi - lo)
    k = casters @ direction
    lo, hi = float(k.min()), float(k.max())
    across = float(np.linalg.norm(receivers.max(axis=0) - receivers.min(axis=0)))
    pad = max(1e-3 * (hi - lo), 1e-3 * across, 1e-6 * max(abs(lo), abs(hi)), 1e-30)
    lo, hi = lo - pad, hi + pad
    matrix[:3, 2], matrix[3, 2] = 2.0 * direction / (hi - lo), -(hi + lo) / (hi - lo)
    return matrix


def _perspective_face(forward, right, up, position, tangent: float, far: float) -> np.ndarray:
    """World → clip of a square perspective; the raster depth only has to clip, the stored one is written by the
    shader."""
    # The depth that is stored is linear, so a near plane close to the light costs no precision: lamps sit in housings.
    near = 1e-6 * far
    basis = np.eye(4)
    basis[:3, 0], basis[:3, 1], basis[:3, 2] = right, up, -forward
    basis[3, :3] = -position @ basis[:3, :3]
    projection = np.zeros((4, 4))
    projection[0, 0] = projection[1, 1] = 1.0 / tangent
    projection[2, 2], projection[2, 3] = -(far + near) / (far - near), -1.0
    projection[3, 2] = -2.0 * far * near / (far - near)
    return basis @ projection


def relative_to(matrix: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """A world → anything matrix turned into one that takes points relative to `origin`."""
    shift = np.eye(4)
    shift[3, :3] = origin
    return shift @ matrix


def gl(matrix: np.ndarray) -> bytes:
    """A matrix as GLSL reads it, 32-bit."""
    return np.ascontiguousarray(matrix, np.float32).tobytes()
