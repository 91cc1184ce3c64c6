"""Implicit shapes of UsdGeom as triangles: Sphere, Cube, Cylinder, Cone, Capsule, Plane."""

from __future__ import annotations

import math

import numpy as np
from pxr import Usd

from ..description import Geometry
from .geometry import make_geometry
from .values import as_float, attribute_value

#: Segments around a round shape; half as many from pole to pole. A silhouette is off by 1 − cos(π/64) = 0.12 %.
SEGMENTS = 64

_SIZES = {
    "Sphere": {"radius": 1.0},
    "Cube": {"size": 2.0},
    "Cylinder": {"radius": 1.0, "height": 2.0},
    "Cylinder_1": {"radiusBottom": 1.0, "radiusTop": 1.0, "height": 2.0},
    "Cone": {"radius": 1.0, "height": 2.0},
    "Capsule": {"radius": 0.5, "height": 1.0},
    "Capsule_1": {"radiusBottom": 0.5, "radiusTop": 0.5, "height": 1.0},
    "Plane": {"width": 2.0, "length": 2.0},
}


def is_primitive(prim: Usd.Prim) -> bool:
    """Whether a prim is an implicit shape that can be shown."""
    return prim.GetTypeName() in _SIZES


def build_primitive(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Geometry | None, bool, str]:
    """(triangles, whether they vary in time, what is wrong); without triangles the last says why."""
    kind = prim.GetTypeName()
    sizes, varying = {}, False
    for name, default in _SIZES[kind].items():
        size = as_float(attribute_value(prim, name, time, default))
        varying |= prim.GetAttribute(name).ValueMightBeTimeVarying()
        if size is None or size < 0.0:
            return None, varying, f"{name} is not a positive number; it is left out"
        sizes[name] = size
    axis = str(attribute_value(prim, "axis", time, "Z"))
    if kind == "Cube":
        points, normals, triangles = _cube(sizes["size"])
    elif kind == "Plane":
        points, normals, triangles = _plane(sizes["width"], sizes["length"], axis)
    elif kind == "Sphere":
        points, normals, triangles = _revolve(_arc(0.0, sizes["radius"], -90.0, 90.0))
    else:
        bottom = sizes.get("radiusBottom", sizes.get("radius", 0.0))
        top = 0.0 if kind == "Cone" else sizes.get("radiusTop", sizes.get("radius", 0.0))
        half = 0.5 * sizes["height"]
        if kind.startswith("Capsule"):
            profile = [_capsule(bottom, top, half)]
        else:
            profile = _frustum(bottom, top, half)
        points, normals, triangles = _revolve(*profile) if isinstance(profile, list) else _revolve(profile)
    if kind not in ("Cube", "Plane", "Sphere"):
        # Shapes are built along Z; a cyclic change of axes keeps their handedness.
        turn = {"Z": (0, 1, 2), "X": (2, 0, 1), "Y": (1, 2, 0)}.get(axis, (0, 1, 2))
        points, normals = points[:, turn], normals[:, turn]
    if str(attribute_value(prim, "orientation", time, "rightHanded")) == "leftHanded":
        triangles = triangles[:, ::-1]
    areas = np.linalg.norm(
        np.cross(
            points[triangles[:, 1]] - points[triangles[:, 0]],
            points[triangles[:, 2]] - points[triangles[:, 0]],
        ),
        axis=1,
    )
    triangles = triangles[areas > 0.0]
    if not len(triangles):
        return None, varying, "has no size; it is left out"
    return make_geometry(points, normals, triangles), varying, ""


Profile = tuple[np.ndarray, np.ndarray]


def _cube(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v, n = (np.eye(3)[(axis + i) % 3] for i in (1, 2, 0))
            square = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
            corners = [sign * n + a * u + b * v for a, b in (square if sign > 0 else square[::-1])]
            points += corners
            normals += [sign * n] * 4
    first = np.arange(6)[:, None, None] * 4
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return 0.5 * size * np.array(points), np.array(normals), triangles


def _plane(width: float, length: float, axis: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Width and length lie, as the schema says, along (X, Y) for axis Z, (Z, Y) for X, and (X, Z) for Y."""
    u, v, n = {"X": (2, 1, 0), "Y": (0, 2, 1)}.get(axis, (0, 1, 2))
    eye = np.eye(3)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = np.array([0.5 * width * a * eye[u] + 0.5 * length * b * eye[v] for a, b in corners])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    if np.dot(np.cross(eye[u], eye[v]), eye[n]) < 0.0:
        triangles = triangles[:, ::-1]
    return points, np.broadcast_to(eye[n], (4, 3)), triangles


def _arc(centre: float, radius: float, start: float, end: float) -> Profile:
    """A profile (radius, height) and its normals along a circle; angles in degrees above the equator."""
    steps = max(2, round(abs(end - start) / 180.0 * SEGMENTS / 2) + 1)
    angles = np.radians(np.linspace(start, end, steps))
    normal = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    normal[np.abs(normal) < 1e-15] = 0.0
    return normal * radius + (0.0, centre), normal


def _capsule(bottom: float, top: float, half: float) -> Profile:
    """Two spheres of these radii, `half` below and above the origin, and the cone that touches both."""
    # Where the cone touches, its normal is tilted by the difference of the radii.
    tilt = math.asin(max(-1.0, min(1.0, (bottom - top) / (2.0 * half)))) if half > 0.0 else 0.0
    lower = _arc(-half, bottom, -90.0, math.degrees(tilt))
    upper = _arc(half, top, math.degrees(tilt), 90.0)
    return np.concatenate([lower[0], upper[0]]), np.concatenate([lower[1], upper[1]])


def _frustum(bottom: float, top: float, half: float) -> list[Profile]:
    """The bottom cap, the side and the top cap."""
    side = np.array([2.0 * half, bottom - top])
    side = side / (np.linalg.norm(side) or 1.0)
    profiles = [(np.array([[bottom, -half], [top, half]]), np.array([side, side]))]
    if bottom > 0.0:
        profiles.insert(0, (np.array([[0.0, -half], [bottom, -half]]), np.array([[0.0, -1.0]] * 2)))
    if top > 0.0:
        profiles.append((np.array([[top, half], [0.0, half]]), np.array([[0.0, 1.0]] * 2)))
    return profiles


def _revolve(*profiles: Profile) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surfaces of revolution about Z from profiles that run upwards along the outside."""
    angles = np.linspace(0.0, 2.0 * math.pi, SEGMENTS + 1)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    around[-1] = around[0]
    points, normals, triangles, first = [], [], [], 0
    for outline, outline_normals in profiles:
        rows = len(outline)
        for source, target in ((outline, points), (outline_normals, normals)):
            ring = np.empty((rows, SEGMENTS + 1, 3))
            ring[..., :2] = source[:, None, :1] * around[None]
            ring[..., 2] = source[:, None, 1]
            target.append(ring.reshape(-1, 3))
        low = np.arange(rows - 1)[:, None] * (SEGMENTS + 1) + np.arange(SEGMENTS)[None] + first
        high = low + SEGMENTS + 1
        triangles.append(np.stack([low, low + 1, high + 1], axis=-1).reshape(-1, 3))
        triangles.append(np.stack([low, high + 1, high], axis=-1).reshape(-1, 3))
        first += rows * (SEGMENTS + 1)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)
