"""Light-space grids: every light ray is marched once, and its optical depth kept at even distances."""

from __future__ import annotations

import math
from collections.abc import Iterator

import moderngl
import numpy as np

from ..covered import covered_boxes
from ..draws import light_steps_across
from ..frame import Frame
from ..method import SLICES_PER_DRAW
from ..pieces import Box
from ..planned import PlannedMap, PlannedPass
from ..slices import SliceTargets
from ..uniforms import occupied_spheres, slice_distances, step_length
from .light_ray import set_light_ray

#: From clip space, -1 to 1, to a map's coordinates, 0 to 1.
_TO_CLIP = np.array([[2.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, -1.0, 0.0, 1.0]])


def _covered(frame: Frame, item: PlannedMap) -> list[Box] | None:
    """The texels whose rays can meet density; None where all may."""
    plan, fit = frame.plan, item.fit
    if fit.kind == "octahedral" or not plan.settings.skip_empty:
        return None
    (centres, radius), *_ = occupied_spheres(plan, frame.density.placements, item.volume)
    return covered_boxes([(centres + (plan.origin - fit.centre), radius)], fit.to_map @ _TO_CLIP, item.extent)


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
    boxes = _covered(frame, item)
    frame.slices.owners[item.tile] = planned.name
    with SliceTargets(frame.context, extent, frame.rest) as targets:
        for number in range(draws):
            framebuffer = targets.framebuffer(number)
            if boxes is not None:
                framebuffer.clear()
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
                    frame.draw_parts(program, framebuffer, piece.scissor, boxes)
                if piece.done < done[1]:
                    yield piece.done
            targets.copy(number, frame.slices.texture, plan.map_atlas.corner(item.tile))
            if number + 1 < draws:
                yield done[1]
    yield 1.0
