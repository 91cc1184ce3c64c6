"""The G-buffer of scattered pixels."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..frame import BACKGROUND_DISTANCE, Frame
from ..planned import PlannedPass
from .gbuffer import FORMATS


def run_gather(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Take the scattered pixels' texels of the G-buffer together."""
    plan = frame.plan
    framebuffer = frame.targets.get("gather", plan.target_size, FORMATS)
    program = frame.shaders.get("fullscreen.vert", "gather.frag")
    frame.bind_pixels(program)
    program.set(no_distance=BACKGROUND_DISTANCE)
    names = ("normal_distance", "diffuse_roughness", "specular", "emissive")
    textures = frame.targets["gbuffer"].color_attachments
    frame.bind(**{f"gbuffer_{n}": t for n, t in zip(names, textures, strict=True)})
    frame.context.enable_only(moderngl.NOTHING)
    framebuffer.use()
    frame.draw_fullscreen(program)
    yield 1.0
