"""The media at the picture's size, from a march of fewer pixels."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..frame import Frame
from ..planned import PlannedPass
from .march import march, march_targets, media_formats

#: Part of the pass that is done when everything is interpolated and pixels on edges are to be marched.
INTERPOLATED = 0.3


def run_upsample(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Interpolate between the marched pixels along surfaces, then march the pixels that have none on theirs.

    Those are marked in the depth buffer: what is interpolated lies in front of the march's triangle, they lie behind.
    """
    plan = frame.plan
    names = march_targets(plan, "upsample")
    program = frame.fullscreen("upsample.frag")
    for name in names:
        framebuffer = frame.targets.get(name, plan.target_size, media_formats(plan), depth=bool(plan.meshes))
        framebuffer.use()
        if plan.meshes:
            framebuffer.clear(depth=1.0)
            frame.bind_camera(program)
            frame.bind_lighting(program, plan.batches[0])
            frame.bind(gbuffer_normal_distance=frame.geometry[0])
        frame.bind_pixels(program, plan.march_divisor)
        sampled = ("march_scattered", "march_transmittance", "march_emission")
        frame.bind(**dict(zip(sampled, frame.targets["march"].color_attachments, strict=False)))
        frame.context.enable_only(moderngl.DEPTH_TEST if plan.meshes else moderngl.NOTHING)
        frame.draw_fullscreen(program)
    if plan.meshes:
        yield INTERPOLATED
        for part in march(frame, names, 1, moderngl.DEPTH_TEST):
            yield INTERPOLATED + (1.0 - INTERPOLATED) * part
    else:
        yield 1.0
