"""How a camera's aperture sits in a view of another shape."""

from __future__ import annotations

from dataclasses import replace

from ..description import Camera

#: Left, top, right and bottom of the aperture in parts of the view, from the upper left corner.
Gate = tuple[float, float, float, float]


def fitted(camera: Camera, aspect_ratio: float) -> tuple[Camera, Gate]:
    """The camera with its aperture widened to a view of that aspect, and where the authored aperture lies in it.

    All that the camera sees is seen; a shape other than the view's leaves bars at the sides or above and below.
    """
    if aspect_ratio <= 0.0:
        raise ValueError(f"aspect_ratio must be above 0, not {aspect_ratio}")
    if aspect_ratio >= camera.aspect_ratio:
        share = camera.aspect_ratio / aspect_ratio
        wide = replace(camera, horizontal_aperture=camera.vertical_aperture * aspect_ratio)
        return wide, (0.5 - 0.5 * share, 0.0, 0.5 + 0.5 * share, 1.0)
    share = aspect_ratio / camera.aspect_ratio
    tall = replace(camera, vertical_aperture=camera.horizontal_aperture / aspect_ratio)
    return tall, (0.0, 0.5 - 0.5 * share, 1.0, 0.5 + 0.5 * share)
