"""Surface lighting: kept in a texture, so that an edit of the medium alone does not light the meshes again."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..frame import BACKGROUND_DISTANCE, Frame
from ..planned import PlannedPass


def run_surface(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Light what is in the G-buffer, a batch of lights at a time."""
    plan = frame.plan
    size = plan.target_size
    framebuffer = frame.targets.get("surface", size, ("f4",))
    program = frame.fullscreen("surface.frag")
    normal, albedo, specular, emissive = frame.geometry
    parts = len(plan.batches)
    kind = plan.settings.read_by("surface")
    for number, batch in enumerate(plan.batches):
        for piece in frame.pieces((("surface", number), kind), size, number / parts, (number + 1) / parts):
            with piece:
                frame.bind_camera(program)
                frame.bind_pixels(program)
                program.set(background_distance=0.5 * BACKGROUND_DISTANCE)
                frame.bind(
                    gbuffer_normal_distance=normal,
                    gbuffer_diffuse_roughness=albedo,
                    gbuffer_specular=specular,
                    gbuffer_emissive=emissive,
                )
                frame.bind_lighting(program, batch)
                frame.context.enable_only(moderngl.NOTHING)
                if number > 0:
                    frame.context.enable_only(moderngl.BLEND)
                    frame.context.blend_equation = moderngl.FUNC_ADD
                    frame.context.blend_func = moderngl.ONE, moderngl.ONE
                framebuffer.scissor = piece.scissor
                framebuffer.use()
                frame.draw_fullscreen(program)
                framebuffer.scissor = None
            yield piece.done
