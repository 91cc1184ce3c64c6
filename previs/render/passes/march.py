"""The view march: single scattering and emission along every camera ray."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..draws import projective_minimum
from ..frame import Frame
from ..planned import PlannedPass


def run_march(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """March all pixels: a batch of lights at a time, each in as many slices of the rays as the plan asks for."""
    plan = frame.plan
    size = plan.target_size
    formats = ("f4", "f4", "f4") if plan.defines["HAS_EMISSION"] else ("f4", "f4")
    draws = [(batch, part) for batch in plan.batches for part in plan.slices]
    program = frame.fullscreen("march.frag", RESUMES=len(draws) > 1)
    previous = None
    for number, (batch, part) in enumerate(draws):
        # Two targets take turns so that the last draw ends in the one that the composite reads.
        name = "march" if (len(draws) - 1 - number) % 2 == 0 else "march_other"
        target = frame.targets.get(name, size, formats)
        # All of the picture before the next slice: the cost of neighbours in a slice tells how large a piece may be.
        done = number / len(draws), (number + 1) / len(draws)
        for piece in frame.pieces((("march", number), plan.settings.read_by("march")), size, *done):
            with piece:
                frame.bind_camera(program)
                frame.bind_pixels(program)
                program.set(
                    opacity_cutoff=plan.settings.opacity_cutoff,
                    projective_minimum=projective_minimum(plan.settings),
                    most_cuts=plan.cuts,
                    slice_begin=part.start,
                    slice_end=part.stop,
                    first_slice=part is plan.slices[0],
                )
                if plan.meshes:
                    frame.bind(gbuffer_normal_distance=frame.geometry[0])
                if plan.defines["HAS_EMISSION"]:
                    frame.bind_emission(program)
                frame.bind_lighting(program, batch)
                if previous is not None:
                    names = ("previous_scattered", "previous_transmittance", "previous_emission")
                    frame.bind(**dict(zip(names, previous.color_attachments, strict=False)))
                frame.context.enable_only(moderngl.NOTHING)
                target.scissor = piece.scissor
                target.use()
                frame.draw_fullscreen(program)
                target.scissor = None
                if len(draws) > 1:
                    frame.context.finish()
            yield piece.done
        previous = target
