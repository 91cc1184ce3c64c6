"""Shadow maps: distance from a light to the first mesh, a tile per face."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..frame import Frame
from ..planned import PlannedLight, PlannedPass
from ..projection import gl, relative_to


def run_shadow_map(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Draw all meshes into every face of one light's shadow map."""
    plan, light = frame.plan, planned.payload
    assert isinstance(light, PlannedLight) and light.shadow is not None
    fit = light.shadow
    frame.meshes.update(plan.meshes, plan.origin)
    # Rasterised depth is linear where nothing is foreshortened: software GL draws it several times as fast.
    program = frame.shaders.get("shadow_map.vert", "shadow_map.frag", ORTHOGRAPHIC=fit.kind == "orthographic")
    program.set(light_position=tuple(fit.position - plan.origin), light_far=fit.far)
    framebuffer = frame.shadows.framebuffer
    framebuffer.use()
    frame.context.enable_only(moderngl.DEPTH_TEST)
    for face, matrix in enumerate(fit.matrices):
        tile = light.first_tile + face
        frame.shadows.owners[tile] = planned.name
        viewport = (*plan.shadow_atlas.corner(tile), plan.shadow_size, plan.shadow_size)
        framebuffer.viewport = framebuffer.scissor = viewport
        framebuffer.clear(depth=1.0, viewport=viewport)
        program.set(view_projection=gl(relative_to(matrix, plan.origin)))
        for mesh in plan.meshes:
            frame.meshes.draw(mesh, program.program, "3f4 24x", ("in_position",))
    framebuffer.scissor = None
    frame.context.enable_only(moderngl.NOTHING)
    yield 1.0
