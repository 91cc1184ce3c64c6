"""Light-space grids: every light ray is marched once, and its optical depth kept at even distances."""

from __future__ import annotations

import math
from collections.abc import Iterator

import moderngl

from ..draws import light_steps_across
from ..frame import Frame
from ..method import SLICES_PER_DRAW
from ..planned import PlannedMap, PlannedPass
from ..slices import SliceTargets
from ..uniforms import slice_distances, step_length
from .light_ray import set_light_ray


def fill_slices(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Fill the tile of one pair of light and volume."""
    plan, item = frame.plan, planned.payload
    assert isinstance(item, PlannedMap)
    settings, extent = plan.settings, item.extent
    program = frame.shaders.get(
        "fullscreen.vert",
        "transmittance_slices.frag",
        SLICES_PER_DRAW=SLICES_PER_DRAW,
        HAS_SPARSE=plan.defines["HAS_SPARSE"],
    )
    first, spacing = slice_distances(item, plan.map_slices)
    volume = plan.volumes[item.volume]
    step = step_length(volume, frame.density.placements, light_steps_across(volume, settings))
    draws = plan.map_slices // SLICES_PER_DRAW
    frame.slices.owners[item.tile] = planned.name
    with SliceTargets(frame.context, extent, frame.rest) as targets:
        for number in range(draws):
            framebuffer = targets.framebuffer(number)
            done = number / draws, (number + 1) / draws
            for piece in frame.pieces((planned.name, settings.read_by("transmittance_map")), extent, *done):
                with piece:
                    set_light_ray(frame, program, item)
                    program.set(
                        first_slice=number * SLICES_PER_DRAW,
                        slices=(first, spacing),
                        parts=max(math.ceil(spacing / step - 1e-3), 1),
                        stored=item.reference / item.weighting,
                    )
                    frame.bind(previous_depth=targets.previous(number))
                    frame.context.enable_only(moderngl.NOTHING)
                    framebuffer.scissor = piece.scissor
                    framebuffer.use()
                    frame.draw_fullscreen(program)
                    framebuffer.scissor = None
                if piece.done < done[1]:
                    yield piece.done
            targets.copy(number, frame.slices.texture, plan.map_atlas.corner(item.tile))
            if number + 1 < draws:
                yield done[1]
    yield 1.0
