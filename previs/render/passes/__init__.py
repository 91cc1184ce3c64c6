"""The passes: one module each, with a function that draws what a planned pass asks for.

A pass gets the `Frame` it works in and the `PlannedPass` to run. It decides nothing: what runs, and when, is in the
plan.
"""

from __future__ import annotations

from collections.abc import Callable

from ..frame import Frame
from ..plan import PassKind, PlannedPass
from .composite import run_composite
from .fields import run_fields
from .gbuffer import run_gbuffer
from .march import run_march
from .shadow_map import run_shadow_map
from .surface import run_surface
from .transmittance_map import run_transmittance_map

RUNNERS: dict[PassKind, Callable[[Frame, PlannedPass], None]] = {
    "fields": run_fields,
    "shadow_map": run_shadow_map,
    "transmittance_map": run_transmittance_map,
    "gbuffer": run_gbuffer,
    "surface": run_surface,
    "march": run_march,
    "composite": run_composite,
}
