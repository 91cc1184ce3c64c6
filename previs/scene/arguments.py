"""Checks of the arguments of a `Scene`: what passes is ready to be authored, what does not is a ValueError."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..description import Color

Vector = Sequence[float] | np.ndarray


def checked_number(name: str, value: Any) -> float:
    """A finite number. Raises ValueError, which names it."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number, not {value!r}") from None
    if not np.isfinite(number):
        raise ValueError(f"{name} must be finite, not {number}")
    return number


def positive_number(name: str, value: Any) -> float:
    """A finite number above 0. Raises ValueError, which names it."""
    number = checked_number(name, value)
    if number <= 0.0:
        raise ValueError(f"{name} must be above 0, not {number:g}")
    return number


def checked_vector(name: str, value: Any) -> np.ndarray:
    """Three finite numbers, (3,) float64. Raises ValueError, which names it."""
    try:
        vector = np.asarray(value, float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{name} must be three finite numbers, not {value!r}")
    return vector


def checked_color(name: str, value: Any) -> Color:
    """Three finite numbers; one counts for all channels. Raises ValueError, which names it."""
    if np.ndim(value) == 0:
        return (checked_number(name, value),) * 3
    return tuple(float(c) for c in checked_vector(name, value))


def is_color(value: Any) -> bool:
    """Whether a value has the form of a colour, three numbers or one, which no array of voxels has."""
    try:
        return np.shape(value) in ((), (3,))
    except ValueError:  # a ragged list
        return False


def checked_box(bounds: tuple[Vector, Vector]) -> tuple[np.ndarray, np.ndarray]:
    """The corners (lo, hi) of a box with thickness, (3,) each."""
    if len(bounds) != 2:
        raise ValueError("bounds must be two corners, (lo, hi)")
    lo, hi = checked_vector("bounds[0]", bounds[0]), checked_vector("bounds[1]", bounds[1])
    if not np.all(hi > lo):
        raise ValueError(f"bounds have no thickness: {lo.tolist()} to {hi.tolist()}")
    return lo, hi


def checked_transform(transform: ArrayLike | None) -> np.ndarray:
    """A finite affine 4×4 matrix on row vectors; None is the identity."""
    if transform is None:
        return np.eye(4)
    matrix = np.asarray(transform, float)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise ValueError("transform must be a finite 4×4 matrix")
    if not np.array_equal(matrix[:, 3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError("transform must act on row vectors: translation in its last row, last column 0 0 0 1")
    return matrix


def checked_rows(name: str, values: ArrayLike) -> np.ndarray:
    """Finite numbers of shape (V, 3)."""
    array = np.asarray(values, float)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0 or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be finite numbers of shape (V, 3), not {array.shape}")
    return array


def checked_polygons(faces: Any, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """(counts, indices), checked."""
    rows = [np.asarray(face) for face in faces]
    if not rows or any(r.ndim != 1 or len(r) < 3 or r.dtype.kind not in "iu" for r in rows):
        raise ValueError("faces must be lists of at least three point indices")
    indices = np.concatenate(rows).astype(np.int64)
    if indices.min() < 0 or indices.max() >= n_points:
        raise ValueError(f"faces point outside the {n_points} points")
    return np.array([len(r) for r in rows]), indices


def mesh_colors(color: Any, n_points: int) -> np.ndarray:
    """One colour, (1, 3), or one per point, (V, 3)."""
    if np.ndim(color) == 2:
        colors = checked_rows("color", color)
        if len(colors) != n_points:
            raise ValueError(f"color: {len(colors)} colours for {n_points} points")
        return colors
    return np.array([checked_color("color", color)])


def looking(position: Any, direction: Any, up: Any = None, default_up: Vector = (0.0, 1.0, 0.0)) -> np.ndarray:
    """A rigid transform whose −Z axis points along a direction."""
    forward = checked_vector("direction", direction)
    length = np.linalg.norm(forward)
    if length == 0.0:
        raise ValueError("there is no direction from the position to the target")
    back = -forward / length
    upward = checked_vector("up", default_up if up is None else up)
    right = np.cross(upward, back)
    if np.linalg.norm(right) < 1e-6 * max(np.linalg.norm(upward), 1e-300):
        # Looking along up: any other axis will do.
        right = np.cross(np.eye(3)[int(np.argmin(np.abs(back)))], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3] = right, np.cross(back, right), back
    matrix[3, :3] = checked_vector("position", position)
    return matrix
