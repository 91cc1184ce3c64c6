"""Voxels to the GPU."""

from __future__ import annotations

from collections.abc import Iterator

from ..fields import SPARSE_ROLES
from ..frame import Frame
from ..planned import PlannedPass


def run_fields(frame: Frame, planned: PlannedPass) -> Iterator[float]:
    """Upload the fields of the plan's volumes; equal fields are uploaded once."""
    volumes = planned.payload
    memory = frame.plan.settings.field_memory * 2**20
    limit = frame.plan.limits.texture_3d_size
    atlases = {"density": frame.density, "temperature": frame.temperature, "emission": frame.emission}
    for role, atlas in atlases.items():
        sparse = frame.plan.settings.sparse if role in SPARSE_ROLES else "off"
        fields = {v.path: getattr(v, role) for v in volumes}
        atlas.update({p: f for p, f in fields.items() if f is not None and f.grid.active_count}, memory, limit, sparse)
    frame.forget_placements()
    yield 1.0
