"""How a march is cut into draws: the steps of a ray, and how many of them an invocation of a shader may take."""

from __future__ import annotations

import math

import numpy as np

from ..description import Volume
from ..errors import PrevisError
from ..settings import Settings
from .cells import cell_counts, cell_edge
from .fields import field_dims
from .method import method_of
from .planned import DeviceLimits, counted

MAX_LIGHTS_PER_BATCH = 64
#: With lists of lights, whose steps pass the longest of them at the most.
MAX_LISTED_PER_BATCH = 256
#: Bytes of a light, a volume and a pair of both in the uniform blocks; see uniforms.py.
LIGHT_BYTES, VOLUME_BYTES, PAIR_BYTES = 14 * 16, 15 * 16, 8 * 16
#: Loop iterations in one invocation of a shader. Mesa's llvmpipe silently ends all loops after 65535; a GPU's watchdog
#: ends a draw that takes too long. Longer marches are drawn in batches of lights and slices of the ray.
LOOP_BUDGET = 50_000
#: Iterations in which a ray cuts optically deep steps, at the least: about two for every unit of optical depth until it
#: is opaque in the last of three channels. For the edges of shadows an eighth of as many are added for every light.
MOST_CUTS = 160
#: Lights whose edges a ray may meet.
MOST_EDGES = 32
#: Lights are drawn in smaller batches rather than rays in shorter slices; where a slice has less than a third of these
#: iterations no step is cut, as none would get anywhere.
FEW_CUTS = 24
#: Steps of a view ray across the longest diagonal of a volume at the least, when the number is left to the plan: of
#: voxels, and of a homogeneous shape, in which nothing but shadows tells how fine they have to be.
LEAST_STEPS, LEAST_STEPS_IN_SHAPE = 96, 128
#: A step reads the density three times, so it may span two voxels.
VOXELS_PER_STEP = 2
#: Steps across it at the least where each is to be no longer than a voxel.
LEAST_FINE_STEPS = 256
#: No 3D texture has more voxels along its diagonal than this; a larger field is reduced.
MOST_STEPS = 4096


def steps_across(volume: Volume, wanted: int) -> int:
    """Steps of a view ray across the longest diagonal of a volume: as many as wanted, or for 0 at least one for two
    voxels."""
    if wanted:
        return wanted
    if volume.density is None:
        return LEAST_STEPS_IN_SHAPE
    return min(max(LEAST_STEPS, math.ceil(_voxels_across(volume) / VOXELS_PER_STEP)), MOST_STEPS)


def fine_steps_across(volume: Volume) -> int:
    """Steps across the longest diagonal of a volume of which none is longer than a voxel."""
    if volume.density is None:
        return LEAST_FINE_STEPS
    return min(max(LEAST_FINE_STEPS, math.ceil(_voxels_across(volume))), MOST_STEPS)


def light_steps_across(volume: Volume, settings: Settings) -> int:
    """Steps of a light ray across the longest diagonal of a volume: as many as asked for, or else one per voxel, and
    for slices, which are interpolated over as much, one for two voxels."""
    if settings.light_steps:
        return settings.light_steps
    return steps_across(volume, 0) if method_of(settings).curve == "slices" else fine_steps_across(volume)


def _voxels_across(volume: Volume) -> float:
    return float(np.linalg.norm(field_dims(volume.density) + 1))


def march_draws(
    records, lights: int, settings: Settings, limits: DeviceLimits, longest: int | None = None
) -> tuple[tuple[range, ...], tuple[range, ...], int]:
    """How a march is cut into draws: ranges of lights, ranges of the iterations of a ray, and in how many of these it
    may cut steps. `longest` is the length of the longest list of lights, None without lists.

    Raises:
        PrevisError: when the way to one light alone takes more steps than a draw may.
    """
    volumes = max(len(records), 1)
    grids = [v for v in records if v.density is not None]
    to_light = 0 if method_of(settings).has_maps else sum(_steps_to_light(v, settings) for v in grids)
    # Phase functions and transmittances of all volumes, the texels around a place in a map, or the way to the light.
    per_light = 1 + 2 * volumes + (4 * len(grids) if method_of(settings).has_maps else to_light)
    if per_light > LOOP_BUDGET:
        raise PrevisError(
            f"{grids[0].path}: a march to a light takes {to_light} steps through {counted(len(grids), 'volume')}, "
            f"a draw at most {LOOP_BUDGET}; set light_steps to {max(LOOP_BUDGET // (2 * len(grids)), 1)} or less"
        )
    pairs = limits.uniform_block_size // (PAIR_BYTES * volumes)
    most = MAX_LIGHTS_PER_BATCH if longest is None else MAX_LISTED_PER_BATCH
    most = min(most, pairs, limits.uniform_block_size // LIGHT_BYTES)
    if longest is None:
        most = min(most, LOOP_BUDGET // (FEW_CUTS * per_light))
    # A power of two, as the blocks are sized in powers of two: few shader variants for many numbers of lights.
    size = 2 ** int(math.log2(max(most, 1)))
    batches = tuple(range(i, min(i + size, lights)) for i in range(0, lights, size)) or (range(0),)
    # A ray takes no more steps than it would in every volume apart.
    steps = sum(steps_across(v, settings.steps) for v in records) + other_iterations(records, settings)
    met = max(len(b) for b in batches) if longest is None else min(longest, max(len(b) for b in batches))
    per_step = 3 * (volumes + 1) + met * per_light
    length = max(1, LOOP_BUDGET // per_step - 1)
    cuts = MOST_CUTS * (8 + min(met, MOST_EDGES)) // 8 if length >= FEW_CUTS // 3 else 0
    steps += cuts
    slices = tuple(range(i, min(i + length, steps)) for i in range(0, steps, length))
    return batches, slices, cuts


def other_iterations(volumes, settings: Settings) -> int:
    """Iterations of a march that are no steps of full length, at the most: ends and beginnings of segments, of which
    there are no more than bounds of volumes, leaps, which are no more than the cells that a ray crosses, and in a
    spot's projection the least number of steps of a segment."""
    segments = 2 * max(len(volumes), 1)
    grids = [v for v in volumes if v.density is not None]
    count = segments * 3
    if settings.skip_empty:
        count += sum(sum(cells_across(v)) for v in grids)
    if not grids:
        count += segments * projective_minimum(settings)
    return count


def cells_across(volume: Volume) -> tuple[int, ...]:
    """Cells along each axis of a grid's block."""
    size = tuple(int(n) for n in field_dims(volume.density) + 2)
    return cell_counts(size, cell_edge(size))


def _steps_to_light(volume: Volume, settings: Settings) -> int:
    """Iterations of a march through a volume towards a light, at the most."""
    if settings.light_steps:
        return settings.light_steps + 1
    # From cell to cell: one crossing of a face after another along each axis.
    return int(np.minimum(field_dims(volume.density) + 2, MOST_STEPS).sum()) + 3


def projective_minimum(settings: Settings) -> int:
    """The least number of steps that a ray takes in a spot's projection, however short its way through the cone."""
    return max((settings.steps or LEAST_STEPS_IN_SHAPE) // 4, 1)
