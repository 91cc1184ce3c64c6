"""The composite: media over surfaces."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..frame import Frame
from ..planned import PlannedPass


def run_composite(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Put scattered and emitted light over the attenuated surfaces, and compute alpha."""
    plan = frame.plan
    framebuffer = frame.targets.get("composite", plan.target_size, ("f4",))
    framebuffer.use()
    program = frame.shaders.get(
        "fullscreen.vert",
        "composite.frag",
        HAS_MEDIA=bool(plan.volumes),
        HAS_MESHES=bool(plan.meshes),
        HAS_EMISSION=plan.defines["HAS_EMISSION"],
    )
    if plan.volumes:
        names = ("march_scattered", "march_transmittance", "march_emission")
        textures = frame.targets[plan.media_target].color_attachments
        frame.bind(**dict(zip(names, textures, strict=False)))
    if plan.meshes:
        frame.bind(surface_radiance=frame.targets["surface"].color_attachments[0])
    frame.context.enable_only(moderngl.NOTHING)
    frame.draw_fullscreen(program)
    yield 1.0
