"""The rays of a light through a volume, as light_ray.glsl reads them."""

from __future__ import annotations

import numpy as np

from ..frame import Frame
from ..planned import MAP_KINDS_NUMBERS, PlannedMap
from ..shader import Program


def set_light_ray(frame: Frame, program: Program, item: PlannedMap) -> None:
    """Set the uniforms of light_ray.glsl for one pair of light and volume, and bind the voxels."""
    volume, fit = frame.plan.volumes[item.volume], item.fit
    placement = frame.density.placements[volume.path]
    box_to_world = np.array(placement.box_to_local @ np.asarray(volume.local_to_world, float))
    box_to_world[3, :3] -= fit.centre
    program.set(
        centre_to_box=np.ascontiguousarray(np.linalg.inv(box_to_world), np.float32).tobytes(),
        atlas_scale=placement.scale_row(),
        atlas_offset=tuple(placement.offset),
        **dict(zip(("bricks_scale", "bricks_shift", "bricks_offset"), map(tuple, placement.brick_rows()), strict=True)),
        map_kind=MAP_KINDS_NUMBERS[fit.kind],
        ray_origin=np.asarray(fit.ray_origin, np.float32).tobytes(),
        ray_direction=np.asarray(fit.ray_direction, np.float32).tobytes(),
        from_light=(*fit.from_light, float(np.linalg.norm(fit.from_light))),
    )
    frame.bind_density(program)
