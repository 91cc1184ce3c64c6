"""Surface lighting: kept in a texture, so that an edit of the medium alone does not light the meshes again.

Every light is drawn apart and added. A first draw sorts the pixels by what the light needs there and keeps it as depth;
the depth test then runs each program only where it has something to do.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import moderngl
import numpy as np

from ...description import mesh_world_bounds
from ..frame import BACKGROUND_DISTANCE, Frame
from ..light_lists import reached_rectangle
from ..pieces import Box
from ..planned import SHADOW_KIND_NUMBERS, Plan, PlannedLight, PlannedPass
from ..projection import relative_to


def run_surface(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Light what is in the G-buffer, a light at a time."""
    plan = frame.plan
    size = plan.target_size
    target = frame.targets.get("surface", size, ("f4",), depth=True)
    kind = plan.settings.read_by("surface")
    rectangles = _rectangles(plan)
    parts = len(plan.lights) + 1
    for number in range(parts):
        light = plan.lights[number - 1] if number else None
        name = light.record.path if light is not None else ""
        for piece in frame.pieces((("surface", name), kind), size, number / parts, (number + 1) / parts):
            with piece:
                if light is None:
                    target.scissor = piece.scissor
                    _draw(frame, target, frame.fullscreen("surface.frag"))
                elif (scissor := _common(piece.scissor, rectangles[number - 1])) is not None:
                    target.scissor = scissor
                    _draw_light(frame, target, number - 1, light)
                target.scissor = None
            yield piece.done


def _rectangles(plan: Plan) -> list[Box | None]:
    """For every light the part of the target in which it can reach a surface; None where it reaches none."""
    whole = (0, 0, *plan.target_size)
    bounds = [b for m in plan.meshes if (b := mesh_world_bounds(m)) is not None]
    if not plan.settings.cull_lights or plan.pixels is not None or not bounds:
        return [whole] * len(plan.lights)
    lo, hi = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
    matrix = relative_to(plan.rays.view_projection, -plan.origin)
    return [reached_rectangle(p.record, lo, hi, matrix, plan.target_size) for p in plan.lights]


def _common(a: Box | None, b: Box | None) -> Box | None:
    """What two rectangles share, None where that is nothing; the first may be None for everything."""
    if a is None or b is None:
        return b
    x, y = max(a[0], b[0]), max(a[1], b[1])
    width, height = min(a[0] + a[2], b[0] + b[2]) - x, min(a[1] + a[3], b[1] + b[3]) - y
    return (x, y, width, height) if width > 0 and height > 0 else None


def light_defines(plan: Plan, light: PlannedLight) -> dict[str, Any]:
    """What the programs that draw one light are compiled for."""
    record, shadow = light.record, light.shadow
    placed = record.kind != "distant"
    return {
        "LIGHT_CAPACITY": 1,
        "HAS_POINT": placed,
        "HAS_SHAPING": placed and record.shaping is not None,
        "HAS_COSINE": record.kind in ("disk", "rect"),
        "HAS_SHADOW_MAPS": shadow is not None,
        "SHADOW_KIND": SHADOW_KIND_NUMBERS[shadow.kind] if shadow is not None else 0,
        "SHADOW_FACES": len(shadow.matrices) if shadow is not None else 0,
        "IN_MEDIA": bool(plan.volumes) and record.casts_shadows,
    }


def _draw_light(frame: Frame, target: moderngl.Framebuffer, number: int, light: PlannedLight) -> None:
    """Add one light to the bound part of the target."""
    defines = light_defines(frame.plan, light)
    sort = frame.fullscreen("surface_sort.frag", **defines)
    frame.bind_lighting(sort, range(number, number + 1), 1)
    context = frame.context
    try:
        target.color_mask = (False,) * 4
        context.depth_func = "1"
        _draw(frame, target, sort, moderngl.DEPTH_TEST)
        target.color_mask = (True,) * 4
        target.depth_mask = False
        context.blend_equation = moderngl.FUNC_ADD
        context.blend_func = moderngl.ONE, moderngl.ONE
        # The triangle is half way between the depths of what meets a medium and what does not.
        for in_media in (False, True) if defines["IN_MEDIA"] else (False,):
            program = frame.fullscreen("surface_light.frag", **{**defines, "IN_MEDIA": in_media})
            frame.bind_lighting(program, range(number, number + 1), 1)
            context.depth_func = ">" if in_media else "<"
            with frame.shadows.plain():
                _draw(frame, target, program, moderngl.DEPTH_TEST | moderngl.BLEND)
    finally:
        context.depth_func = "<"
        target.color_mask = (True,) * 4
        target.depth_mask = True


def _draw(frame: Frame, target: moderngl.Framebuffer, program, flags: int = moderngl.NOTHING) -> None:
    frame.bind_camera(program)
    frame.bind_pixels(program)
    normal, diffuse, specular, emissive = frame.geometry
    frame.bind(
        gbuffer_normal_distance=normal,
        gbuffer_diffuse_roughness=diffuse,
        gbuffer_specular=specular,
        gbuffer_emissive=emissive,
    )
    program.set(background_distance=0.5 * BACKGROUND_DISTANCE, ambient=frame.plan.ambient)
    frame.context.enable_only(flags)
    target.use()
    frame.draw_fullscreen(program)
