"""Matrices that scenes for benches and tests are put together with: 4×4, acting on row vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def translation(x: float, y: float, z: float) -> np.ndarray:
    """A shift."""
    matrix = np.eye(4)
    matrix[3, :3] = x, y, z
    return matrix


def scaling(x: float, y: float, z: float) -> np.ndarray:
    """A scale along the axes; negative factors mirror."""
    return np.diag([x, y, z, 1.0])


def shear(xy: float) -> np.ndarray:
    """x grows with y."""
    matrix = np.eye(4)
    matrix[1, 0] = xy
    return matrix


def rotation(axis: Sequence[float], degrees: float) -> np.ndarray:
    """A turn counter-clockwise about an axis of any length (Rodrigues' formula)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = math.radians(degrees)
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross).T
    return matrix
