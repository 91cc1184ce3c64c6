"""Checks of what is put into a reference scene: every bad value is a `ValueError` with a sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ColorLike = float | Sequence[float] | np.ndarray


def color(value: ColorLike, name: str, low: float = 0.0, high: float = np.inf) -> np.ndarray:
    """A colour as a (3,) float64 array; one number stands for three equal channels.

    Raises ValueError when it is not one or three finite numbers within [low, high].
    """
    rgb = np.asarray(value, float)
    if rgb.shape not in ((), (1,), (3,)):
        raise ValueError(f"{name} has shape {rgb.shape}; one number or three are needed.")
    rgb = np.broadcast_to(rgb, (3,)).copy()
    if not (np.all(np.isfinite(rgb)) and np.all(rgb >= low) and np.all(rgb <= high)):
        raise ValueError(f"{name} is {rgb.tolist()}; every channel must be finite and within [{low:g}, {high:g}].")
    return rgb


def vector(value: Sequence[float] | np.ndarray, name: str) -> np.ndarray:
    """A finite (3,) float64 vector; ValueError otherwise."""
    xyz = np.asarray(value, float)
    if xyz.shape != (3,) or not np.all(np.isfinite(xyz)):
        raise ValueError(f"{name} must be three finite numbers, not {value!r}.")
    return xyz


def direction(value: Sequence[float] | np.ndarray, name: str) -> np.ndarray:
    """A unit (3,) vector; ValueError for anything that has no direction."""
    xyz = vector(value, name)
    length = np.linalg.norm(xyz)
    if length == 0.0:
        raise ValueError(f"{name} is the zero vector, which has no direction.")
    return xyz / length


def affine(value: np.ndarray | None, name: str) -> np.ndarray:
    """An invertible affine 4×4 float64 matrix for row vectors; None is the identity. ValueError otherwise."""
    if value is None:
        return np.eye(4)
    matrix = np.asarray(value, float)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise ValueError(f"{name} must be a finite 4×4 matrix.")
    if not np.allclose(matrix[:, 3], (0.0, 0.0, 0.0, 1.0), rtol=0.0, atol=1e-12):
        raise ValueError(f"{name} is not affine for row vectors: its last column must be 0, 0, 0, 1.")
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise ValueError(f"{name} is singular: it flattens the volume to nothing.")
    return matrix


def number(value: float, name: str, low: float, high: float = np.inf) -> float:
    """A float within [low, high]; ValueError otherwise."""
    value = float(value)
    if not low <= value <= high:
        raise ValueError(f"{name} is {value:g}; it must be within [{low:g}, {high:g}].")
    return value
