"""Solid surfaces of the reference: what a ray hits first, what stands in a light's way, where shadows begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from previs.reference import checks
from previs.reference.checks import ColorLike
from previs.reference.density import _corners, _slabs
from previs.reference.lights import DistantLight, Light

# Rays × triangles handled at once.
_CHUNK = 1_000_000
# Barycentric slack: a ray through a shared edge must hit at least one of its triangles.
_SLACK = 1e-12


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles in world space, `points` (T, 3, 3), seen from both sides.

    Lambertian with `albedo` RGB in [0, 1] (default 0, black), one for all or (T, 3, 3) at the corners and linear
    between, emitting `emission` RGB radiance (default 0). Lit as if they faced along `normals`, unit vectors (T, 3, 3)
    at the corners and linear between; None takes those of the triangles.
    Raises ValueError for another shape, values outside their range, or points that are not finite.
    """

    points: np.ndarray
    albedo: ColorLike = 0.0
    emission: ColorLike = 0.0
    normals: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, float)
        if points.ndim != 3 or points.shape[1:] != (3, 3):
            raise ValueError(f"Triangles need an array of shape (T, 3, 3), not {points.shape}.")
        if not np.all(np.isfinite(points)):
            raise ValueError(f"{np.count_nonzero(~np.isfinite(points))} coordinates of the triangles are not finite.")
        object.__setattr__(self, "points", points)
        albedo = np.asarray(self.albedo, float)
        if albedo.ndim < 2:
            albedo = np.broadcast_to(checks.color(self.albedo, "albedo", 0.0, 1.0), points.shape)
        if albedo.shape != points.shape or not np.all((albedo >= 0.0) & (albedo <= 1.0)):
            raise ValueError("albedo must be one colour, or one per corner (T, 3, 3), within [0, 1].")
        object.__setattr__(self, "albedo", albedo)
        if self.normals is not None:
            normals = np.asarray(self.normals, float)
            if normals.shape != points.shape or not np.all(np.isfinite(normals)):
                raise ValueError("normals must be finite and have one vector per corner (T, 3, 3).")
            object.__setattr__(self, "normals", normals)
        object.__setattr__(self, "emission", checks.color(self.emission, "emission"))


def box_triangles(
    lo: Sequence[float],
    hi: Sequence[float],
    to_world: np.ndarray | None = None,
    albedo: ColorLike = 0.0,
    emission: ColorLike = 0.0,
) -> Triangles:
    """Twelve triangles of a box with corners `lo`, `hi` in local space, placed by `to_world` (4×4, row vectors)."""
    corners = _corners(checks.vector(lo, "lo"), checks.vector(hi, "hi"), checks.affine(to_world, "to_world"))
    quads = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Triangles(corners[np.array(faces)], albedo, emission)


class SolidSet:
    """All triangles of a scene together, ready for queries."""

    def __init__(self, solids: Sequence[Triangles]) -> None:
        none = np.zeros((0, 3))
        counts = [len(s.points) for s in solids]
        points = np.concatenate([np.zeros((0, 3, 3)), *(s.points for s in solids)])
        self._albedo = np.concatenate([np.zeros((0, 3, 3)), *(s.albedo for s in solids)])
        self.emission = np.concatenate(
            [none, *(np.tile(s.emission, (n, 1)) for s, n in zip(solids, counts, strict=True))]
        )
        self.points = points
        self.count = len(points)
        if self.count == 0:
            return
        self.lo, self.hi = points.min(axis=(0, 1)), points.max(axis=(0, 1))
        # Around its own centre the set keeps its digits, wherever in the world it stands.
        self.centre = 0.5 * (self.lo + self.hi)
        v0 = points[:, 0] - self.centre
        self._e1, self._e2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
        cross = np.cross(self._e1, self._e2)
        length = np.linalg.norm(cross, axis=-1)
        self._cross, self._offset = cross, np.einsum("ij,ij->i", cross, v0)
        self._v1, self._v2 = np.cross(self._e1, v0), np.cross(self._e2, v0)
        self.normal = cross / np.maximum(length, 1e-300)[:, None]
        facing = np.repeat(self.normal[:, None], 3, axis=1)
        for first, solid in zip(np.cumsum([0, *counts[:-1]]), solids, strict=True):
            if solid.normals is not None:
                facing[first : first + len(solid.points)] = solid.normals
        self._facing = facing
        self.size = max(float(np.linalg.norm(self.hi - self.lo)), 1e-300)
        self._edges = self._shared_edges()

    def _hits(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Distances (R, T) at which rays meet triangles, NaN where they do not (Möller–Trumbore)."""
        o = origins - self.centre
        moment = np.cross(o, directions)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = -1.0 / (directions @ self._cross.T)
            u = (moment @ self._e2.T - directions @ self._v2.T) * inverse
            v = -(moment @ self._e1.T - directions @ self._v1.T) * inverse
            t = (o @ self._cross.T - self._offset) * inverse
            inside = (u >= -_SLACK) & (v >= -_SLACK) & (u + v <= 1.0 + _SLACK) & np.isfinite(t)
        return np.where(inside, t, np.nan)

    def nearest(
        self, origins: np.ndarray, directions: np.ndarray, t_min: np.ndarray, t_max: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distance (R,) and triangle (R,) of the first hit within [t_min, t_max]; (inf, −1) without one."""
        distance, index = np.full(len(origins), np.inf), np.full(len(origins), -1)
        if self.count == 0:
            return distance, index
        step = max(_CHUNK // self.count, 1)
        for i in range(0, len(origins), step):
            part = slice(i, i + step)
            t = self._hits(origins[part], directions[part])
            t = np.where((t >= t_min[part, None]) & (t <= t_max[part, None]), t, np.inf)
            best = t.argmin(axis=1)
            found = t[np.arange(len(t)), best]
            distance[part], index[part] = found, np.where(np.isfinite(found), best, -1)
        return distance, index

    def surface_at(self, points: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Albedo (M, 3) and unit normal (M, 3) at points (M, 3) of the triangles of these numbers (M,)."""
        if self.count == 0:
            return np.zeros((len(points), 3)), np.zeros((len(points), 3))
        offset = points - self.points[index, 0]
        cross = self._cross[index]
        square = np.maximum(np.einsum("ij,ij->i", cross, cross), 1e-300)
        u = np.einsum("ij,ij->i", np.cross(offset, self._e2[index]), cross) / square
        v = np.einsum("ij,ij->i", np.cross(self._e1[index], offset), cross) / square
        weights = np.stack([1.0 - u - v, u, v], axis=1)[:, :, None]
        normal = np.sum(weights * self._facing[index], axis=1)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(length > 1e-12, normal / np.maximum(length, 1e-300), self.normal[index])
        return np.sum(weights * self._albedo[index], axis=1), normal

    def visible(self, origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Whether nothing stands between each origin and `distance` along its direction, ends excluded (M,) bool."""
        clear = np.ones(len(origins), bool)
        if self.count == 0:
            return clear
        # The starting point may lie on a surface, up to rounding.
        margin = 1e-10 * self.size
        entry, exit_ = _slabs(origins, directions, self.lo - margin, self.hi + margin)
        rows = np.flatnonzero((entry < exit_) & (exit_ > 0.0) & (entry < distance))
        step = max(_CHUNK // self.count, 1)
        for i in range(0, len(rows), step):
            part = rows[i : i + step]
            t = self._hits(origins[part], directions[part])
            clear[part] = ~np.any((t > margin) & (t < distance[part, None] - margin), axis=1)
        return clear

    def _shared_edges(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
        """Edges as (a, b, third corners of the triangles that share the edge, or None when they are not two)."""
        corners = self.points.reshape(-1, 3)
        _, vertex = np.unique(np.round((corners - self.centre) / (1e-9 * self.size)), axis=0, return_inverse=True)
        vertex = vertex.reshape(-1, 3)
        by_key: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for triangle, ids in enumerate(vertex):
            for k in range(3):
                i, j = sorted((int(ids[k]), int(ids[(k + 1) % 3])))
                by_key.setdefault((i, j), []).append((triangle, k))
        edges = []
        for sharers in by_key.values():
            triangle, k = sharers[0]
            a, b = self.points[triangle, k], self.points[triangle, (k + 1) % 3]
            thirds = np.array([self.points[t, (k + 2) % 3] for t, k in sharers]) if len(sharers) == 2 else None
            edges.append((a, b, thirds))
        return edges

    def shadow_breakpoints(
        self, light: Light, origins: np.ndarray, directions: np.ndarray, all_edges: bool = False
    ) -> np.ndarray:
        """Distances (R, E) where rays cross the boundary of a shadow, NaN elsewhere.

        The boundary of a shadow is swept by the silhouette edges as seen from the light: edges of one triangle only,
        and edges whose two triangles lie on the same side of the plane through edge and light. With `all_edges` the
        others count too: behind them the light's way through a filled solid has a kink.
        """
        found = []
        if self.count == 0 or not light.casts_shadows:
            return np.empty((len(origins), 0))
        distant = isinstance(light, DistantLight)
        for a, b, thirds in self._edges:
            # In the plane of edge and light: `along` the edge, and `outward` across it, away from the light.
            length = np.linalg.norm(b - a)
            ray = light.direction if distant else a - light.position
            along = (b - a) / max(length, 1e-300)
            outward = ray - (ray @ along) * along
            if np.linalg.norm(outward) <= 1e-13 * np.linalg.norm(ray) or length == 0.0:
                continue
            outward /= np.linalg.norm(outward)
            normal = np.cross(along, outward)
            if thirds is not None and not all_edges:
                side = (thirds - a) @ normal
                if side[0] * side[1] < -1e-18 * self.size**2:
                    continue
            slack = 1e-9 * self.size
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (a - origins) @ normal / (directions @ normal)
                offset = origins + t[:, None] * directions - a
                across = offset @ outward
                # Follow the light back from there to the line of the edge.
                slope = (
                    (offset + ray) @ along / (across + ray @ outward) if not distant else ray @ along / (ray @ outward)
                )
                foot = offset @ along - slope * across
                crosses = (across >= -slack) & (foot >= -slack) & (foot <= length + slack)
                if np.any(crosses):
                    found.append(np.where(crosses, t, np.nan))
        return np.stack(found, axis=-1) if found else np.empty((len(origins), 0))
