"""The floor: a march through the density alone."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl

from ..frame import Frame
from ..planned import PlannedPass


def run_floor(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """March all pixels through the density, in one draw of as many uniform steps as the pass says."""
    plan = frame.plan
    target = frame.targets.get("floor", (plan.width, plan.height), ("f4",))
    program = frame.fullscreen("floor.frag")
    frame.bind_camera(program)
    frame.bind_lighting(program, range(0))
    program.set(floor_steps=planned.payload)
    frame.context.enable_only(moderngl.NOTHING)
    target.use()
    frame.draw_fullscreen(program)
    yield 1.0
