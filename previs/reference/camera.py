"""The camera of the reference: which ray belongs to which pixel centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from previs.reference import checks


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole or an orthographic camera that looks along its local −Z, +Y up.

    `camera_to_world` is a 4×4 orthonormal matrix for row vectors (`look_at` makes one). `window` is
    (left, right, bottom, top): at unit distance for a perspective camera, in stage units for an orthographic one.
    Only what lies between the two `clip` distances along the camera's axis is seen (stage units, default all that is
    in front); light is not clipped.

    Raises ValueError for a matrix that is not orthonormal, an empty window or an empty clipping range.
    """

    camera_to_world: np.ndarray
    projection: Literal["perspective", "orthographic"] = "perspective"
    window: tuple[float, float, float, float] = (-0.5, 0.5, -0.5, 0.5)
    clip: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        matrix = checks.affine(self.camera_to_world, "camera_to_world")
        if not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-6):
            raise ValueError("camera_to_world must be orthonormal; a camera has no scale or shear.")
        if self.projection not in ("perspective", "orthographic"):
            raise ValueError(f"There is no projection {self.projection!r}; known are perspective, orthographic.")
        left, right, bottom, top = self.window
        if not (left < right and bottom < top):
            raise ValueError(f"The window {self.window} is empty; left < right and bottom < top are needed.")
        near, far = self.clip
        if not near < far or (self.projection == "perspective" and near < 0.0):
            raise ValueError(f"The clip distances {self.clip} leave nothing in front of the camera.")
        object.__setattr__(self, "camera_to_world", matrix)

    def rays(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays through the pixel centres, row 0 on top: origins (H·W, 3), unit directions (H·W, 3), and the cosine
        between each direction and the camera's axis (H·W,)."""
        left, right, bottom, top = self.window
        x = left + (np.arange(width) + 0.5) / width * (right - left)
        y = top - (np.arange(height) + 0.5) / height * (top - bottom)
        x, y = (a.ravel() for a in np.meshgrid(x, y))
        zero, one = np.zeros_like(x), np.ones_like(x)
        rotation, position = self.camera_to_world[:3, :3], self.camera_to_world[3, :3]
        if self.projection == "orthographic":
            return np.stack([x, y, zero], -1) @ rotation + position, np.stack([zero, zero, -one], -1) @ rotation, one
        cosine = 1.0 / np.sqrt(x * x + y * y + 1.0)
        directions = np.stack([x, y, -one], -1) * cosine[:, None]
        return np.broadcast_to(position, (len(x), 3)).copy(), directions @ rotation, cosine


def look_at(eye: Sequence[float], target: Sequence[float], up: Sequence[float] = (0.0, 1.0, 0.0)) -> np.ndarray:
    """The camera_to_world matrix (4×4, row vectors) of a camera at `eye` that sees `target` in the centre.

    Raises ValueError when `eye` and `target` coincide, or the view is along `up`.
    """
    position = checks.vector(eye, "eye")
    back = checks.direction(position - checks.vector(target, "target"), "eye − target")
    right = checks.direction(np.cross(checks.vector(up, "up"), back), "up × view")
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3], matrix[3, :3] = right, np.cross(back, right), back, position
    return matrix
