"""The G-buffer: what the camera sees of the meshes."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ...description import Surface
from ..frame import BACKGROUND_DISTANCE, Frame
from ..planned import PlannedPass
from ..projection import gl

FORMATS = ("f4", "f2", "f2", "f2")


def run_gbuffer(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Draw all meshes into distance, normal and surface constants."""
    plan = frame.plan
    frame.meshes.update(plan.meshes, plan.origin)
    framebuffer = frame.targets.get("gbuffer", (plan.width, plan.height), FORMATS, depth=True)
    framebuffer.use()
    # All attachments are cleared alike; only the distance, the last component of the first, is read where no mesh is.
    framebuffer.clear(alpha=BACKGROUND_DISTANCE, depth=1.0)
    program = frame.shaders.get("gbuffer.vert", "gbuffer.frag")
    frame.context.enable_only(moderngl.DEPTH_TEST)
    frame.bind_camera(program)
    program.set(view_projection=gl(plan.rays.view_projection), image_size=(plan.width, plan.height))
    for mesh in plan.meshes:
        surface = mesh.surface
        program.set(
            diffuse_color=diffuse(surface),
            specular_at_normal=specular_at_normal(surface),
            roughness=surface.roughness,
            emissive_color=surface.emissive_color,
        )
        frame.meshes.draw(mesh, program.program, "3f4 3f4 3f4", ("in_position", "in_normal", "in_color"))
    frame.context.enable_only(moderngl.NOTHING)
    yield 1.0


def diffuse(surface: Surface) -> tuple[float, float, float]:
    """Diffuse reflectance: none on a metal in the metallic workflow."""
    if not surface.specular or surface.use_specular_workflow:
        return surface.diffuse_color
    return tuple(c * (1.0 - surface.metallic) for c in surface.diffuse_color)


def specular_at_normal(surface: Surface) -> tuple[float, float, float]:
    """Fresnel reflectance at normal incidence, as the UsdPreviewSurface specification gives it."""
    if not surface.specular:
        return (0.0, 0.0, 0.0)
    if surface.use_specular_workflow:
        return surface.specular_color
    ratio = (1.0 - surface.ior) / (1.0 + surface.ior)
    return tuple(ratio * ratio * (1.0 - surface.metallic) + c * surface.metallic for c in surface.diffuse_color)
