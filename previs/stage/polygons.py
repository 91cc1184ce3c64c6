"""Polygons in NumPy: triangulation and normals."""

from __future__ import annotations

import numpy as np


def triangulate(
    points: np.ndarray, counts: np.ndarray, indices: np.ndarray, keep: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cut the kept faces into triangles.

    `points` (P, 3), `counts` (F,), `indices` (sum of counts,), `keep` (F,) bool: faces with at least three corners.
    Returns (corners, faces): (T, 3) positions in `indices`, in the order of the faces' corners, and the face of each
    triangle, (T,).
    """
    starts = np.cumsum(counts) - counts
    corner_blocks, face_blocks = [], []
    for size in np.unique(counts[keep]):
        faces = np.flatnonzero(keep & (counts == size))
        corners = starts[faces][:, None] + np.arange(size)
        if size == 3:
            cut = corners[:, None, :]
        elif size == 4:
            cut = _cut_quads(points[indices[corners]], corners)
        else:
            cut = _cut_polygons(points[indices[corners]], corners)
        corner_blocks.append(cut.reshape(-1, 3))
        face_blocks.append(np.repeat(faces, size - 2))
    corners, faces = np.concatenate(corner_blocks), np.concatenate(face_blocks)
    if len(corner_blocks) > 1:
        order = np.argsort(faces, kind="stable")
        corners, faces = corners[order], faces[order]
    return corners, faces


def _cut_quads(polygons: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(F, 2, 3) corners: along the diagonal 0-2, or 1-3 where only that one lies inside."""
    a, b, c, d = (polygons[:, i] for i in range(4))
    fan = corners[:, [[0, 1, 2], [0, 2, 3]]]
    folded = np.einsum("ij,ij->i", np.cross(b - a, c - a), np.cross(c - a, d - a)) < 0.0
    if folded.any():
        other = np.einsum("ij,ij->i", np.cross(c - b, d - b), np.cross(d - b, a - b)) >= 0.0
        turn = folded & other
        fan[turn] = corners[turn][:, [[1, 2, 3], [1, 3, 0]]]
    return fan


def _cut_polygons(polygons: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(F, size − 2, 3) corners of polygons of equal size."""
    size = corners.shape[1]
    fan = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], axis=1)
    cut = corners[:, fan]
    edges = np.roll(polygons, -1, axis=1) - polygons
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    normals = area_vectors(polygons)
    concave = (np.einsum("fij,fj->fi", turns, normals) < 0.0).any(axis=1)
    for face in np.flatnonzero(concave):
        cut[face] = corners[face][_clip_ears(polygons[face], normals[face])]
    return cut


def area_vectors(polygons: np.ndarray) -> np.ndarray:
    """Normals of (F, size, 3) polygons, as long as twice their areas (Newell)."""
    relative = polygons - polygons[:, :1]
    return np.cross(relative, np.roll(relative, -1, axis=1)).sum(axis=1)


def _clip_ears(polygon: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Triangles (size − 2, 3) of one simple polygon."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, axis, axis=1)
    # Dropping the middle coordinate keeps (x, z), which turns the other way than (z, x).
    sign = np.sign(normal[axis]) * (-1.0 if axis == 1 else 1.0)

    def area(i: int, j: int, k: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[i], flat[j], flat[k]
        return float(sign * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)))

    left = list(range(len(polygon)))
    triangles = []
    while len(left) > 3:
        for at in range(len(left)):
            before, here, after = left[at - 1], left[at], left[(at + 1) % len(left)]
            if area(before, here, after) <= 0.0:
                continue
            others = (o for o in left if o not in (before, here, after))
            if any(
                area(before, here, o) >= 0.0 and area(here, after, o) >= 0.0 and area(after, before, o) >= 0.0
                for o in others
            ):
                continue
            break
        else:
            # Self-intersecting or degenerate: any cut is as good as another.
            at = 1
            before, here, after = left[0], left[1], left[2]
        triangles.append((before, here, after))
        del left[at]
    triangles.append(tuple(left))
    return np.array(triangles)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of unit length; +Y where there is no direction."""
    lengths = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    nowhere = lengths <= 0.0
    if not nowhere.any():
        return vectors / lengths[:, None]
    result = vectors / np.where(nowhere, 1.0, lengths)[:, None]
    result[nowhere] = 0.0, 1.0, 0.0
    return result


def flat_normals(points: np.ndarray, triangles: np.ndarray, faces: np.ndarray, n_faces: int) -> np.ndarray:
    """The unit normal of every face (F, 3), from its triangles."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas = np.cross(b - a, c - a)
    return unit(np.stack([np.bincount(faces, areas[:, i], n_faces) for i in range(3)], axis=1))


def smooth_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals of the points (P, 3): the normals of the triangles around each, weighted by their angles there."""
    corners = points[triangles]
    face = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    total = np.zeros_like(points)
    for i in range(3):
        u = unit(corners[:, (i + 1) % 3] - corners[:, i])
        v = unit(corners[:, (i + 2) % 3] - corners[:, i])
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", u, v), -1.0, 1.0))
        for axis in range(3):
            total[:, axis] += np.bincount(triangles[:, i], angle * face[:, axis], len(points))
    return unit(total)
