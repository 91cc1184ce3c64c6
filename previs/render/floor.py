"""The floor of the cost of a picture: a march through the density alone, which no renderer of volumes does without.

Its steps are uniform between the bounds of the volumes, each with one density fetch; there is no light and nothing is
skipped. It is drawn like any other pass, with the fields of the plan, so that it can be timed in turns with pictures.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import PrevisError
from .atlas import AtlasLayout
from .planned import Plan, PlannedPass, counted
from .renderer import Renderer

#: Steps of a floor, where none are given.
FLOOR_STEPS = 100


def floor_plan(plan: Plan, steps: int = FLOOR_STEPS) -> Plan:
    """The floor of a plan: its fields, and then the march through their density alone.

    Fields should be dense: that is what the fetch of the floor reads. Every floor planned is drawn anew.

    Args:
        plan: of a whole picture.
        steps: from where a ray enters the bounds of the volumes to where it leaves them.

    Raises:
        PrevisError: when the plan has no volume.
    """
    if not plan.volumes:
        raise PrevisError("the floor is a march through volumes, and there are none")
    fields = tuple(p for p in plan.passes if p.kind == "fields")
    floor = PlannedPass(
        "floor",
        "floor",
        f"density alone of {counted(len(plan.volumes), 'volume')}, {steps} steps",
        (plan.width, plan.height),
        plan.width * plan.height * 16,
        object(),
        tuple(p.name for p in fields),
        payload=steps,
    )
    return replace(
        plan,
        maps=(),
        shadow_tiles=0,
        map_atlas=AtlasLayout(),
        shadow_atlas=AtlasLayout(),
        passes=(*fields, floor),
        notes=(),
        pixels=None,
    )


def floor_transmittance(renderer: Renderer, plan: Plan) -> np.ndarray:
    """What the floor of a plan found: the transmittance along every view ray, (H, W, 3), rows from the top.

    Raises:
        PrevisError: when the floor was not drawn.
    """
    texture = renderer.texture("floor")
    with renderer.context:
        data = texture.read()
    return np.frombuffer(data, np.float32).reshape(plan.height, plan.width, 4)[::-1, :, :3].copy()
