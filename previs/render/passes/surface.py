"""Surface lighting: kept in a texture, so that an edit of the medium alone does not light the meshes again."""

from __future__ import annotations

import moderngl

from ..frame import BACKGROUND_DISTANCE, Frame
from ..plan import PlannedPass


def run_surface(frame: Frame, planned: PlannedPass) -> None:
    """Light what is in the G-buffer, a batch of lights at a time."""
    plan = frame.plan
    framebuffer = frame.targets.get("surface", (plan.width, plan.height), ("f4",))
    framebuffer.use()
    framebuffer.clear()
    program = frame.fullscreen("surface.frag")
    normal, albedo, specular, emissive = frame.targets["gbuffer"].color_attachments
    frame.bind_camera(program)
    program.set(background_distance=0.5 * BACKGROUND_DISTANCE)
    frame.bind(
        gbuffer_normal_distance=normal,
        gbuffer_diffuse_roughness=albedo,
        gbuffer_specular=specular,
        gbuffer_emissive=emissive,
    )
    frame.context.enable_only(moderngl.NOTHING)
    for batch in plan.batches:
        frame.bind_lighting(program, batch)
        if batch.start > 0:
            frame.context.enable_only(moderngl.BLEND)
            frame.context.blend_func = moderngl.ONE, moderngl.ONE
        frame.draw_fullscreen(program)
    frame.context.enable_only(moderngl.NOTHING)
