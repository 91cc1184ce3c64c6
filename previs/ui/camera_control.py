"""A camera that turns about a point: what the mouse does to the view, as plain arithmetic.

`OrbitCamera` is immutable: every movement returns another one. It knows neither mouse buttons nor pixels; movements
are given in parts of the viewport's *height*, x to the right and **y up**, which makes them independent of its size.
The feel is that of usdview and Maya:

- *orbit*: what lies at the pivot follows the cursor; dragging over the height of the viewport is half a turn
  (usdview's quarter degree per pixel in a viewport of 720 lines). The way up stays up and the view stops at the poles.
- *pan*: the point under the cursor, at the depth of the pivot, stays under the cursor exactly.
- *dolly*: exponential, so that it never reaches the pivot: dragging over the height is four times nearer or farther.
  An orthographic camera narrows or widens its view instead of moving.

The pivot need not be at the centre of the view: `about` turns about any point without a jump of the picture, and the
pivot keeps its place in the picture when orbiting and dollying. A camera of the stage keeps its lens, its film and its
roll (as in usdview); `levelled` takes the roll away.

Not here: which button does what, and animation from one view to another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..description import Camera
from .gate import fitted

Bounds = tuple[np.ndarray, np.ndarray]

#: Radians of a turn for a drag over the height of the viewport.
TURN = math.pi
#: Natural logarithm of how much nearer a drag over the height of the viewport comes.
DOLLY_RATE = math.log(4.0)
#: One notch of a mouse wheel as a dolly amount: 12 % nearer, as in usdview.
WHEEL_STEP = -math.log(1.0 - 0.12) / DOLLY_RATE
#: Space around what is framed, as a factor of its radius.
FRAMING_MARGIN = 1.05
#: How near and how far a dolly goes, in radii of the scene. Beyond them floats run out of digits.
NEAREST, FARTHEST = 1e-4, 1e4


@dataclass(frozen=True, eq=False)
class OrbitCamera:
    """A view of a scene that can be moved about a pivot.

    `pivot` is a world point (3,); `offset` (3,) is where it lies in the camera's own space (x right, y up, −z ahead).
    `azimuth`, `elevation` and `roll` are radians: from the front, above the horizon within ±π/2, and about the axis.
    `lens` gives projection, focal length, apertures and offsets; its other values do not matter. `bounds` are those
    of the whole scene, which the clipping range follows. `unmoved` is the stage's camera while nothing has changed.
    """

    pivot: np.ndarray
    offset: np.ndarray
    azimuth: float
    elevation: float
    roll: float
    lens: Camera
    bounds: Bounds
    up_axis: Literal["Y", "Z"] = "Y"
    unmoved: Camera | None = None

    @classmethod
    def from_camera(cls, camera: Camera, bounds: Bounds | None, up_axis: Literal["Y", "Z"] = "Y") -> OrbitCamera:
        """The view of a camera.

        The pivot is on its axis, at the depth of the centre of `bounds` (the scene's world box, None without one).
        """
        bounds = _finite_bounds(bounds)
        matrix = np.asarray(camera.camera_to_world, float)
        centre, radius = _sphere(bounds)
        depth = float((matrix[3, :3] - centre) @ matrix[2, :3])
        if depth <= 1e-2 * radius:
            depth = radius
        return cls(
            pivot=matrix[3, :3] - depth * matrix[2, :3],
            offset=np.array([0.0, 0.0, -depth]),
            **_angles(matrix[:3, :3], up_axis),
            lens=camera,
            bounds=bounds,
            up_axis=up_axis,
            unmoved=camera,
        )

    def looking_through(self, camera: Camera) -> OrbitCamera:
        """The view of a camera of the same scene: its very picture until something moves, then its lens and roll."""
        return self.from_camera(camera, self.bounds, self.up_axis)

    def with_bounds(self, bounds: Bounds | None) -> OrbitCamera:
        """This view of a scene that has other bounds now; the picture keeps its framing."""
        return replace(self, bounds=_finite_bounds(bounds))

    # --- what it shows ----------------------------------------------------------------------------------------

    @property
    def rotation(self) -> np.ndarray:
        """Rows are the camera's right, up and back in the world, (3, 3), orthonormal."""
        side, front, up = _world_axes(self.up_axis)
        sin_a, cos_a = math.sin(self.azimuth), math.cos(self.azimuth)
        sin_e, cos_e = math.sin(self.elevation), math.cos(self.elevation)
        sin_r, cos_r = math.sin(self.roll), math.cos(self.roll)
        level_right = cos_a * side - sin_a * front
        outward = sin_a * side + cos_a * front
        back = cos_e * outward + sin_e * up
        level_up = cos_e * up - sin_e * outward
        return np.array([cos_r * level_right + sin_r * level_up, cos_r * level_up - sin_r * level_right, back])

    @property
    def eye(self) -> np.ndarray:
        """The camera's position in the world, (3,)."""
        return self.pivot - self.offset @ self.rotation

    @property
    def distance(self) -> float:
        """From the camera to its pivot, stage units."""
        return float(np.linalg.norm(self.offset))

    def camera(self, aspect: float | None = None) -> Camera:
        """The record to draw with, or to save in the stage.

        With `aspect` (width over height of the viewport) the film is widened to it as `gate.fitted` does. None keeps
        the film.
        While a camera of the stage is unmoved, so are its transform and clipping range; after that the clipping range
        holds the whole scene, and the path is empty.
        """
        camera = self.unmoved
        if camera is None:
            matrix = np.eye(4)
            matrix[:3, :3] = self.rotation
            matrix[3, :3] = self.pivot - self.offset @ matrix[:3, :3]
            clipping_range = self._clip(matrix)
            camera = replace(self.lens, path="", camera_to_world=matrix, clipping_range=clipping_range)
        if aspect is None:
            return camera
        return fitted(camera, aspect)[0]

    # --- movements --------------------------------------------------------------------------------------------

    def orbit(self, dx: float, dy: float) -> OrbitCamera:
        """Turn about the pivot by a drag of (dx, dy): to the right and up, in parts of the viewport's height."""
        sin_r, cos_r = math.sin(self.roll), math.cos(self.roll)
        # A rolled picture still follows the cursor: the drag is taken in the level frame.
        dx, dy = dx * cos_r - dy * sin_r, dx * sin_r + dy * cos_r
        azimuth = math.remainder(self.azimuth - TURN * dx, math.tau)
        elevation = min(max(self.elevation - TURN * dy, -0.5 * math.pi), 0.5 * math.pi)
        return replace(self, azimuth=azimuth, elevation=elevation, unmoved=None)

    def pan(self, dx: float, dy: float, aspect: float) -> OrbitCamera:
        """Move across the view by a drag of (dx, dy) in parts of the height of a viewport of that aspect.

        The pivot moves along, so that it stays where it is in the picture.
        """
        _, _, bottom, top = self._window(aspect)
        scale = top - bottom
        if self.lens.projection == "perspective":
            scale *= -self.offset[2]
        rotation = self.rotation
        return replace(self, pivot=self.pivot - scale * (dx * rotation[0] + dy * rotation[1]), unmoved=None)

    def dolly(self, amount: float) -> OrbitCamera:
        """Come nearer to the pivot (positive) or go away from it: by `exp(DOLLY_RATE · amount)`.

        An orthographic camera zooms about the pivot by that factor. Both end at NEAREST and FARTHEST.
        """
        _, radius = _sphere(self.bounds)
        orthographic = self.lens.projection == "orthographic"
        size = 0.1 * self.lens.horizontal_aperture if orthographic else self.distance
        wanted = size * math.exp(min(max(-DOLLY_RATE * amount, -100.0), 100.0))
        # A view that is out of these limits already may stay, or come back.
        factor = min(max(wanted, min(size, NEAREST * radius)), max(size, FARTHEST * radius)) / size
        if not orthographic:
            return replace(self, offset=self.offset * factor, unmoved=None)
        offset = self.offset * (factor, factor, 1.0)
        return replace(self, lens=_zoomed(self.lens, factor), offset=offset, unmoved=None)

    def wheel(self, steps: float) -> OrbitCamera:
        """Dolly by notches of a mouse wheel, positive is nearer."""
        return self.dolly(WHEEL_STEP * steps)

    def about(self, point: np.ndarray) -> OrbitCamera:
        """The same view with its pivot at a world point (3,). One that is not ahead of the camera is not taken."""
        point = np.asarray(point, float)
        rotation = self.rotation
        offset = rotation @ (point - self.pivot) + self.offset
        if not (np.all(np.isfinite(offset)) and -offset[2] > 1e-6 * _sphere(self.bounds)[1]):
            return self
        return replace(self, pivot=point, offset=offset)

    def framing(self, bounds: Bounds | None, aspect: float) -> OrbitCamera:
        """Look at a world box from the same direction: its sphere fits a viewport of that aspect, with a margin.

        The pivot becomes its centre. None frames the whole scene; a box without an extent is only put at the centre
        of the view.
        """
        centre, radius = _sphere(self.bounds if bounds is None else _finite_bounds(bounds))
        left, right, bottom, top = self._window(aspect)
        middle = np.array([0.5 * (left + right), 0.5 * (bottom + top)])
        half = np.array([0.5 * (right - left), 0.5 * (top - bottom)])
        lens = self.lens
        if lens.projection == "orthographic":
            if radius > 0.0:
                factor = FRAMING_MARGIN * radius / half.min()
                lens, middle = _zoomed(lens, factor), middle * factor
            offset = np.array([*middle, self.offset[2]])
        else:
            depth = -float(self.offset[2])
            if radius > 0.0:
                # The distance of the centre's ray from each of the four sides, at unit depth, is the largest radius.
                edges = np.abs([left, right, bottom, top])
                room = np.repeat(half, 2) / np.sqrt(1.0 + edges**2)
                depth = FRAMING_MARGIN * radius / float(room.min())
            offset = depth * np.array([*middle, -1.0])
        return replace(self, pivot=centre, offset=offset, lens=lens, unmoved=None)

    def turned_to(self, azimuth: float, elevation: float) -> OrbitCamera:
        """Look at the pivot from a given direction, radians, without roll: (0, 0) is the front, (π/2, 0) the right."""
        elevation = min(max(elevation, -0.5 * math.pi), 0.5 * math.pi)
        azimuth = math.remainder(azimuth, math.tau)
        return replace(self, azimuth=azimuth, elevation=elevation, roll=0.0, unmoved=None)

    def levelled(self) -> OrbitCamera:
        """Without roll: the horizon is level."""
        return self.turned_to(self.azimuth, self.elevation)

    # --- to and from JSON -------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """The view as plain numbers for JSON; the bounds are the scene's and not in it."""
        lens = self.lens
        return {
            "pivot": self.pivot.tolist(),
            "offset": self.offset.tolist(),
            "angles": [self.azimuth, self.elevation, self.roll],
            "projection": lens.projection,
            "film": [
                lens.focal_length,
                lens.horizontal_aperture,
                lens.vertical_aperture,
                lens.horizontal_aperture_offset,
                lens.vertical_aperture_offset,
            ],
        }

    def restored(self, state: Mapping[str, Any]) -> OrbitCamera:
        """This scene's view with what `state()` returned. Raises ValueError for anything else."""
        try:
            values = [np.array(state[name], float) for name in ("pivot", "offset", "angles", "film")]
            projection = state["projection"]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"not the state of a view: {error}") from None
        pivot, offset, angles, film = values
        if (
            [v.shape for v in values] != [(3,), (3,), (3,), (5,)]
            or not all(np.all(np.isfinite(v)) for v in values)
            or projection not in ("perspective", "orthographic")
            or film[:3].min() <= 0.0
            or offset[2] >= 0.0
        ):
            raise ValueError("not the state of a view: a value is out of its range")
        lens = Camera("", np.eye(4), projection, *film.tolist())
        azimuth, elevation, roll = angles.tolist()
        return replace(
            self.turned_to(azimuth, elevation),
            pivot=pivot,
            offset=offset,
            roll=math.remainder(roll, math.tau),
            lens=lens,
        )

    # --- inside -----------------------------------------------------------------------------------------------

    def _window(self, aspect: float) -> tuple[float, float, float, float]:
        return fitted(self.lens, aspect)[0].window()

    def _clip(self, matrix: np.ndarray) -> tuple[float, float]:
        """The clipping range that holds the scene. Moves an orthographic camera back until the scene is ahead."""
        centre, radius = _sphere(self.bounds)
        radius = 1.01 * max(radius, 1e-30)
        depth = float((matrix[3, :3] - centre) @ matrix[2, :3])
        if self.lens.projection == "orthographic":
            # The picture does not change when the camera moves along its axis, except for what is behind it.
            back = max(1.1 * radius - depth, 0.0)
            matrix[3, :3] += back * matrix[2, :3]
            return depth + back - radius, depth + back + radius
        # Inside the scene a near plane that comes with the pivot shows small things, without ruining the depth buffer.
        least = min(max(1e-3 * self.distance, 1e-5 * radius), 1e-3 * radius)
        near = max(depth - radius, least)
        return near, max(depth + radius, 2.0 * near)


def _zoomed(lens: Camera, factor: float) -> Camera:
    """A lens with `factor` times the film, offsets included."""
    return replace(
        lens,
        horizontal_aperture=lens.horizontal_aperture * factor,
        vertical_aperture=lens.vertical_aperture * factor,
        horizontal_aperture_offset=lens.horizontal_aperture_offset * factor,
        vertical_aperture_offset=lens.vertical_aperture_offset * factor,
    )


def _world_axes(up_axis: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(side, front, up): a right-handed frame in which azimuth 0 looks from the front, as `framing_camera` does."""
    x, y, z = np.eye(3)
    return (x, -y, z) if up_axis == "Z" else (x, z, y)


def _angles(rotation: np.ndarray, up_axis: str) -> dict[str, float]:
    """Azimuth, elevation and roll of the rows right, up, back of an orthonormal frame."""
    side, front, up = _world_axes(up_axis)
    right, camera_up, back = rotation
    across = math.hypot(back @ side, back @ front)
    elevation = math.atan2(back @ up, across)
    if across > 1e-9:
        azimuth = math.atan2(back @ side, back @ front)
        roll = math.atan2(right @ up, camera_up @ up)
    else:
        # Straight up or down azimuth and roll are one turn: all of it is azimuth, then orbiting stays level.
        azimuth, roll = math.atan2(-(right @ front), right @ side), 0.0
    return {"azimuth": azimuth, "elevation": elevation, "roll": roll}


def _finite_bounds(bounds: Bounds | None) -> Bounds:
    """The bounds as float64; a box from −1 to 1 where there are none."""
    if bounds is not None:
        lo, hi = (np.asarray(b, float) for b in bounds)
        if np.all(np.isfinite(lo)) and np.all(np.isfinite(hi)):
            return lo, hi
    return -np.ones(3), np.ones(3)


def _sphere(bounds: Bounds) -> tuple[np.ndarray, float]:
    """Centre and radius of the sphere around a box."""
    lo, hi = bounds
    return 0.5 * (lo + hi), 0.5 * float(np.linalg.norm(hi - lo))
