"""The view march: single scattering and emission along every camera ray."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import moderngl

from ..covered import covered_boxes
from ..draws import other_iterations, projective_minimum
from ..frame import Frame
from ..pieces import Box
from ..planned import Plan, PlannedPass
from ..uniforms import occupied_spheres


def run_march(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """March all pixels, or those that the others are interpolated from."""
    plan = frame.plan
    names = march_targets(plan, "march")
    for name in names:
        frame.targets.get(name, plan.march_size, media_formats(plan))
    boxes = None
    if plan.pixels is None and plan.march_divisor == 1:
        spheres = occupied_spheres(plan, frame.density.placements)
        boxes = covered_boxes(spheres, plan.rays.view_projection, (plan.width, plan.height))
    if boxes is not None:
        for name in names:
            _clear(frame, frame.targets[name])
    yield from march(frame, names, plan.march_divisor, moderngl.NOTHING, boxes)


def _clear(frame: Frame, target: moderngl.Framebuffer) -> None:
    """What is seen where there is no medium: nothing scattered, all transmitted."""
    for number, texture in enumerate(target.color_attachments):
        framebuffer = frame.context.framebuffer([texture])
        framebuffer.clear(*([1.0] * 4 if number == 1 else [0.0] * 4))
        framebuffer.release()


def media_formats(plan: Plan) -> tuple[str, ...]:
    """Formats of the textures for scattered light, transmittance and, where there is any, emission."""
    return ("f4", "f4", "f4") if plan.defines["HAS_EMISSION"] else ("f4", "f4")


def march_targets(plan: Plan, name: str) -> tuple[str, ...]:
    """The targets in which the draws of a march take turns; the last draw ends in the first of them."""
    return (name, f"{name}_other") if len(plan.batches) * len(plan.slices) > 1 else (name,)


def march(
    frame: Frame, names: tuple[str, ...], stride: int, flags: int, boxes: Sequence[Box] | None = None
) -> Iterator[float]:
    """March the pixels of a target: a batch of lights at a time, each in as many slices of the rays as the plan asks
    for.

    Args:
        frame: to draw in.
        names: of the targets, from `march_targets`.
        stride: pixels of the picture from one texel of the target to the next.
        flags: what of OpenGL to enable.
        boxes: the parts of the target to draw; None draws all of it.
    """
    plan = frame.plan
    draws = [(batch, part) for batch in plan.batches for part in plan.slices]
    program = frame.fullscreen("march.frag", RESUMES=len(draws) > 1)
    kept = other_iterations(plan.volumes, plan.settings) if plan.cuts else math.inf
    previous = None
    for number, (batch, part) in enumerate(draws):
        target = frame.targets[names[(len(draws) - 1 - number) % 2]]
        # All of the picture before the next slice: the cost of neighbours in a slice tells how large a piece may be.
        done = number / len(draws), (number + 1) / len(draws)
        for piece in frame.pieces(((names[0], number), plan.settings.read_by("march")), target.size, *done):
            with piece:
                frame.bind_camera(program)
                frame.bind_pixels(program, stride)
                program.set(
                    opacity_cutoff=plan.settings.opacity_cutoff,
                    projective_minimum=projective_minimum(plan.settings),
                    # One more, to find what there is where it begins.
                    slice_length=len(part) + 1,
                    iterations_left=plan.slices[-1].stop - part.start,
                    iterations_kept=kept,
                    first_slice=part is plan.slices[0],
                )
                if plan.meshes:
                    # Of the two that of the program's sampler counts.
                    frame.bind(gbuffer_normal_distance=frame.geometry[0], previous_scattered=frame.geometry[0])
                if plan.defines["HAS_EMISSION"]:
                    frame.bind_emission(program)
                frame.bind_lighting(program, batch)
                frame.bind_light_lists(program, plan.batches.index(batch))
                if previous is not None:
                    held = ("previous_scattered", "previous_transmittance", "previous_emission")
                    frame.bind(**dict(zip(held, previous.color_attachments, strict=False)))
                frame.context.enable_only(flags)
                frame.draw_parts(program, target, piece.scissor, boxes)
                if len(draws) > 1:
                    frame.context.finish()
            yield piece.done
        previous = target
