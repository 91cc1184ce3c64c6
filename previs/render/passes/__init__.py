"""The passes: one module each, with a function that draws what a planned pass asks for.

A pass gets the `Frame` it works in and the `PlannedPass` to run. It decides nothing: what runs, and when, is in the
plan. It is a generator that yields the part of itself that is done after every piece of work. Whoever runs it may draw
other things in the same context then, with the same programs too: a pass binds and sets all it needs after each yield,
and needs no OpenGL to be dropped at one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..frame import Frame
from ..planned import PassKind, PlannedPass
from .composite import run_composite
from .fields import run_fields
from .floor import run_floor
from .gather import run_gather
from .gbuffer import run_gbuffer
from .march import run_march
from .shadow_map import run_shadow_map
from .surface import run_surface
from .transmittance_map import run_transmittance_map
from .upsample import run_upsample

RUNNERS: dict[PassKind, Callable[[Frame, PlannedPass], Iterator[float]]] = {
    "fields": run_fields,
    "floor": run_floor,
    "shadow_map": run_shadow_map,
    "transmittance_map": run_transmittance_map,
    "gbuffer": run_gbuffer,
    "gather": run_gather,
    "surface": run_surface,
    "march": run_march,
    "upsample": run_upsample,
    "composite": run_composite,
}
