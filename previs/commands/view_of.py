"""Which camera and which image size a command renders with."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from ..api import choose_camera, choose_size
from ..description import Camera, Light, SceneDescription
from ..errors import PrevisError


def camera_and_size(
    arguments: argparse.Namespace, scene, description: SceneDescription, time: float | None
) -> tuple[Camera, tuple[int, int]]:
    """The camera and (width, height): what the arguments say, else the RenderSettings, else the stage.

    Raises:
        PrevisError: for an unknown camera or RenderSettings prim.
    """
    settings = scene.reader.render_settings()
    name = arguments.camera or (settings.camera if settings and arguments.renderSettingsPrimPath else None)
    camera = choose_camera(scene, description, name, time)
    if arguments.imageWidth is None and settings is not None and settings.resolution is not None:
        if min(settings.resolution) < 1:
            raise PrevisError(f"{settings.path}: a resolution of {settings.resolution} cannot be rendered")
        return camera, settings.resolution
    return camera, choose_size(camera, arguments.imageWidth)


def with_camera_light(description: SceneDescription, camera: Camera) -> SceneDescription:
    """The scene with one more light that shines along the view, of irradiance π: a white surface facing it is at 1."""
    light = Light("(camera light)", "distant", camera.camera_to_world, (1.0,) * 3, strength=(math.pi,) * 3)
    return replace(description, lights={**description.lights, light.path: light})
