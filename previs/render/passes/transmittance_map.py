"""Transmittance maps: how one volume attenuates one light, a curve per texel."""

from __future__ import annotations

import math
from collections.abc import Iterator

import moderngl

from ..draws import light_steps_across
from ..frame import Frame
from ..method import method_of
from ..planned import PlannedMap, PlannedPass
from ..uniforms import step_length
from .light_ray import set_light_ray
from .light_slices import fill_slices

#: Stored optical depth that the start of an adaptive range may leave out.
BEGIN_DEPTH = 0.001
#: Steps of the second march at the least; a range is often only a few voxels deep.
SECOND_MARCH_STEPS = 96.0


def run_transmittance_map(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Fill the tile of one pair of light and volume."""
    plan, item = frame.plan, planned.payload
    assert isinstance(item, PlannedMap)
    settings, volume = plan.settings, plan.volumes[item.volume]
    if method_of(settings).curve == "slices":
        yield from fill_slices(frame, planned)
        return
    program = frame.shaders.get(
        "fullscreen.vert",
        "transmittance_map.frag",
        **method_of(settings).defines(settings),
        SECOND_MARCH_STEPS=SECOND_MARCH_STEPS,
        HAS_SPARSE=plan.defines["HAS_SPARSE"],
    )
    stored = item.reference / item.weighting
    left, bottom = plan.map_atlas.corner(item.tile)
    frame.maps.owners[item.tile] = planned.name
    framebuffer = frame.maps.framebuffer
    for piece in frame.pieces((planned.name, settings.read_by("transmittance_map")), (plan.map_size, plan.map_size)):
        with piece:
            set_light_ray(frame, program, item)
            program.set(
                stored=stored,
                stretched=item.stretched,
                end_depth=-math.log(item.threshold) * stored / item.weakest,
                begin_depth=BEGIN_DEPTH / item.weighting,
                step_length=step_length(volume, frame.density.placements, light_steps_across(volume, settings)),
            )
            frame.context.enable_only(moderngl.NOTHING)
            framebuffer.viewport = (left, bottom, plan.map_size, plan.map_size)
            x, y, width, height = piece.scissor or (0, 0, plan.map_size, plan.map_size)
            framebuffer.scissor = (left + x, bottom + y, width, height)
            framebuffer.use()
            frame.draw_fullscreen(program)
            framebuffer.scissor = None
        yield piece.done
