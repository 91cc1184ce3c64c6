"""The view march: single scattering and emission along every camera ray."""

from __future__ import annotations

import moderngl

from ..frame import Frame
from ..plan import PlannedPass

#: Pixels along the side of a tile: brute-force marching is done in tiles, so that no single draw occupies a GPU for long.
TILE = 128


def run_march(frame: Frame, planned: PlannedPass) -> None:
    """March all pixels: a batch of lights at a time, in tiles where light is marched by brute force."""
    plan = frame.plan
    size = (plan.width, plan.height)
    formats = ("f4", "f4", "f4") if plan.defines["HAS_EMISSION"] else ("f4", "f4")
    framebuffer = frame.targets.get("march", size, formats)
    framebuffer.use()
    framebuffer.clear()
    program = frame.fullscreen("march.frag")
    frame.bind_camera(program)
    program.set(opacity_cutoff=plan.settings.opacity_cutoff)
    if plan.meshes:
        frame.bind(program, gbuffer_normal_distance=frame.targets["gbuffer"].color_attachments[0])
    if plan.defines["HAS_EMISSION"]:
        frame.bind_emission(program)
    tiles = [(0, 0, *size)]
    if plan.settings.transmittance == "march":
        tiles = [
            (x, y, min(TILE, size[0] - x), min(TILE, size[1] - y))
            for y in range(0, size[1], TILE)
            for x in range(0, size[0], TILE)
        ]
    frame.context.enable_only(moderngl.NOTHING)
    for batch in plan.batches:
        frame.bind_lighting(program, batch)
        if batch.start > 0:
            # Light adds up; transmittance and emission are the same for every batch and are drawn once.
            frame.context.enable_only(moderngl.BLEND)
            frame.context.blend_func = moderngl.ONE, moderngl.ONE
            framebuffer.color_mask = tuple((i == 0,) * 4 for i in range(len(formats)))
            framebuffer.use()
        for number, tile in enumerate(tiles):
            framebuffer.scissor = tile
            frame.draw_fullscreen(program)
            if len(tiles) > 1:
                frame.context.finish()
                frame.report((batch.start + len(batch) * (number + 1) / len(tiles)) / max(len(plan.lights), 1))
        framebuffer.scissor = None
    framebuffer.color_mask = tuple((True,) * 4 for _ in formats)
    frame.context.enable_only(moderngl.NOTHING)
