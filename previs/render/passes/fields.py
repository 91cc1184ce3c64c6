"""Voxels to the GPU."""

from __future__ import annotations

from ..frame import Frame
from ..plan import PlannedPass


def run_fields(frame: Frame, planned: PlannedPass) -> None:
    """Upload the fields of the plan's volumes; equal fields are uploaded once."""
    volumes = planned.payload
    memory = frame.plan.settings.field_memory * 2**20
    limit = frame.plan.limits.texture_3d_size
    frame.density.update({v.path: v.density for v in volumes if v.density is not None}, memory, limit)
    frame.temperature.update({v.path: v.temperature for v in volumes if v.temperature is not None}, memory, limit)
    frame.emission.update({v.path: v.emission for v in volumes if v.emission is not None}, memory, limit)
