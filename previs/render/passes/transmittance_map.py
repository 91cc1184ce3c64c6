"""Transmittance maps: how one volume attenuates one light, a curve per texel."""

from __future__ import annotations

import math
from collections.abc import Iterator

import moderngl
import numpy as np

from ..frame import Frame
from ..method import method_of
from ..planned import MAP_KINDS_NUMBERS, PlannedMap, PlannedPass
from ..uniforms import step_length

#: Stored optical depth that the start of an adaptive range may leave out.
BEGIN_DEPTH = 0.001
#: Steps of the second march at the least; a range is often only a few voxels deep.
SECOND_MARCH_STEPS = 96.0


def run_transmittance_map(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Fill the tile of one pair of light and volume."""
    plan, item = frame.plan, planned.payload
    assert isinstance(item, PlannedMap)
    settings, volume, fit = plan.settings, plan.volumes[item.volume], item.fit
    placement = frame.density.placements[volume.path]
    program = frame.shaders.get(
        "fullscreen.vert",
        "transmittance_map.frag",
        **method_of(settings).defines(settings),
        SECOND_MARCH_STEPS=SECOND_MARCH_STEPS,
        HAS_SPARSE=plan.defines["HAS_SPARSE"],
    )
    bricks = placement.brick_rows()
    box_to_world = placement.box_to_local @ np.asarray(volume.local_to_world, float)
    box_to_world = np.array(box_to_world)
    box_to_world[3, :3] -= fit.centre
    stored = item.reference / item.weighting
    left, bottom = plan.map_atlas.corner(item.tile)
    frame.maps.owners[item.tile] = planned.name
    framebuffer = frame.maps.framebuffer
    for piece in frame.pieces((planned.name, settings.read_by("transmittance_map")), (plan.map_size, plan.map_size)):
        with piece:
            program.set(
                centre_to_box=np.ascontiguousarray(np.linalg.inv(box_to_world), np.float32).tobytes(),
                atlas_scale=placement.scale_row(),
                atlas_offset=tuple(placement.offset),
                **dict(zip(("bricks_scale", "bricks_shift", "bricks_offset"), map(tuple, bricks), strict=True)),
                map_kind=MAP_KINDS_NUMBERS[fit.kind],
                ray_origin=np.asarray(fit.ray_origin, np.float32).tobytes(),
                ray_direction=np.asarray(fit.ray_direction, np.float32).tobytes(),
                from_light=(*fit.from_light, float(np.linalg.norm(fit.from_light))),
                stored=stored,
                stretched=item.stretched,
                end_depth=-math.log(item.threshold) * stored / item.weakest,
                begin_depth=BEGIN_DEPTH / item.weighting,
                step_length=step_length(volume, frame.density.placements, settings.light_steps),
            )
            frame.bind_density(program)
            frame.context.enable_only(moderngl.NOTHING)
            framebuffer.viewport = (left, bottom, plan.map_size, plan.map_size)
            x, y, width, height = piece.scissor or (0, 0, plan.map_size, plan.map_size)
            framebuffer.scissor = (left + x, bottom + y, width, height)
            framebuffer.use()
            frame.draw_fullscreen(program)
            framebuffer.scissor = None
        yield piece.done
