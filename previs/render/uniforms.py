"""The uniform blocks of the shaders, packed as std140 lays them out: rows of four 32-bit floats.

The layouts mirror the structs in shaders/include: medium.glsl, lights.glsl, light_map_lookup.glsl and emission.glsl.
"""

from __future__ import annotations

import math

import numpy as np

from .. import blackbody
from ..description import Light, Volume
from .draws import light_steps_across, steps_across
from .light_lists import MOST_CELLS, MOST_INDICES, LightLists
from .planned import MAP_KINDS_NUMBERS, PHASE_NUMBERS, SHADOW_KIND_NUMBERS, Plan, PlannedMap
from .projection import relative_to
from .resources import Placement

VOLUMES_BINDING, LIGHTS_BINDING, LIGHT_MAPS_BINDING, EMISSIONS_BINDING = range(4)
LIGHT_LISTS_BINDING, BLACKBODY_BINDING = 7, 8
BLOCKS = {
    "Volumes": VOLUMES_BINDING,
    "Lights": LIGHTS_BINDING,
    "LightMaps": LIGHT_MAPS_BINDING,
    "Emissions": EMISSIONS_BINDING,
    "LightLists": LIGHT_LISTS_BINDING,
}

_VOLUME_ROWS = 15
_LIGHT_ROWS = 14
_LIGHT_MAP_ROWS = 8
_EMISSION_ROWS = 12

#: Parts along each axis that the box of a shape is cut into, to tell where it can be seen.
SHAPE_PARTS = 8
_SHAPE_GRID, _SHAPE_BOX, _SHAPE_SPHERE, _SHAPE_CAPSULE = range(4)


def step_length(volume: Volume, placements: dict[str, Placement], steps: int) -> float:
    """World length of a step: the longest diagonal of the volume's bounds over the number of steps."""
    lo, hi, to_world = _unit_box(volume, placements)
    edges = (np.asarray(hi) - np.asarray(lo))[:, None] * to_world[:3, :3]
    signs = np.array([[1, a, b] for a in (-1, 1) for b in (-1, 1)])
    return float(np.linalg.norm(signs @ edges, axis=1).max()) / steps


def occupied_spheres(
    plan: Plan, placements: dict[str, Placement], number: int | None = None
) -> list[tuple[np.ndarray, float]]:
    """Spheres around all that is occupied, of each volume, or of the one of that number: centres (N, 3) relative to the
    render origin, and their radius."""
    spheres = []
    for volume in plan.volumes if number is None else plan.volumes[number : number + 1]:
        lo, hi, box_to_world = _unit_box(volume, placements)
        if volume.density is not None:
            placement = placements[volume.path]
            centres, edges = placement.occupied, 1.0 / np.maximum(placement.cells_scale, 1e-30)
            edges = np.minimum(edges, 1.0)
        else:
            edges = (np.asarray(hi) - np.asarray(lo)) / SHAPE_PARTS
            places = np.stack(np.meshgrid(*[np.arange(SHAPE_PARTS) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
            centres = lo + places * edges
        diagonals = np.array([[1, a, b] for a in (-1, 1) for b in (-1, 1)]) * edges
        radius = 0.5 * float(np.linalg.norm(diagonals @ box_to_world[:3, :3], axis=1).max())
        spheres.append((centres @ box_to_world[:3, :3] + box_to_world[3, :3] - plan.origin, radius))
    return spheres


def _unit_box(volume: Volume, placements: dict[str, Placement]):
    """(lo, hi, box_to_world) of the space in which the shaders intersect the volume."""
    to_world = np.asarray(volume.local_to_world, float)
    if volume.density is not None:
        return np.zeros(3), np.ones(3), placements[volume.path].box_to_local @ to_world
    shape = volume.shape
    matrix = np.eye(4)
    kind = type(shape).__name__
    if kind == "Box":
        lo, hi = shape.local_bounds
        matrix[:3, :3], matrix[3, :3] = np.diag(hi - lo), lo
        return np.zeros(3), np.ones(3), matrix @ to_world
    matrix[:3, :3] *= shape.radius
    if kind == "Sphere":
        return -np.ones(3), np.ones(3), matrix @ to_world
    # The capsule's axis becomes z: the rows of the matrix are the images of the shader's x, y, z.
    axis = "XYZ".index(shape.axis)
    matrix[:3, :3] = shape.radius * np.roll(np.eye(3), -(axis + 1), axis=0)
    half = 0.5 * shape.height / shape.radius
    return np.array([-1.0, -1.0, -1.0 - half]), np.array([1.0, 1.0, 1.0 + half]), matrix @ to_world


def pack_volumes(plan: Plan, placements: dict[str, Placement]) -> bytes:
    """The `Volumes` block."""
    rows = np.zeros((max(len(plan.volumes), 1), _VOLUME_ROWS, 4), np.float32)
    for row, volume in zip(rows, plan.volumes, strict=False):
        _, _, box_to_world = _unit_box(volume, placements)
        row[:4] = relative_to(np.linalg.inv(box_to_world), plan.origin)
        medium = volume.medium
        if volume.density is not None:
            placement = placements[volume.path]
            row[4], row[5] = placement.scale_row(), placement.offset_row()
            row[10, :3], row[11, :3] = placement.cells_scale, placement.cells_offset
            row[10, 3] = placement.cell_edge
            row[12:15] = placement.brick_rows()
            shape = _SHAPE_GRID
        else:
            shape = {"Box": _SHAPE_BOX, "Sphere": _SHAPE_SPHERE, "Capsule": _SHAPE_CAPSULE}[type(volume.shape).__name__]
        row[5, 3] = step_length(volume, placements, steps_across(volume, plan.settings.steps))
        row[6, :3] = medium.strength
        row[6, 3] = step_length(volume, placements, light_steps_across(volume, plan.settings))
        row[7, :3], row[7, 3] = medium.albedo, shape
        row[8] = (medium.anisotropy, medium.anisotropy2, medium.lobe_mix, PHASE_NUMBERS[medium.phase])
        row[9, :3] = _emission(volume)
        if shape == _SHAPE_CAPSULE:
            row[9, 3] = 0.5 * volume.shape.height / volume.shape.radius
    return rows.tobytes()


def _emission(volume: Volume) -> np.ndarray:
    """Emitted radiance but for the fields that hold voxels: one that holds none has its background's value."""
    medium = volume.medium
    emission = np.multiply(medium.emission, medium.emission_scale)
    if (field := volume.emission) is not None and not field.grid.active_count:
        emission = emission * np.asarray(field.grid.background, float)
    if (field := volume.temperature) is not None and not field.grid.active_count:
        kelvin = float(field.grid.background) * medium.temperature_scale + medium.temperature_offset
        emission = emission * (blackbody.radiance(kelvin) if kelvin > blackbody.TABLE_RANGE[0] else 0.0)
    return emission


def pack_emissions(plan: Plan, temperatures: dict[str, Placement], fields: dict[str, Placement]) -> bytes:
    """The `Emissions` block."""
    rows = np.zeros((max(len(plan.volumes), 1), _EMISSION_ROWS, 4), np.float32)
    for row, volume in zip(rows, plan.volumes, strict=False):
        to_world = np.asarray(volume.local_to_world, float)
        medium, flags = volume.medium, 0
        if (placement := temperatures.get(volume.path)) is not None:
            row[:4] = relative_to(np.linalg.inv(placement.box_to_local @ to_world), plan.origin)
            row[4], row[5] = placement.scale_row(), placement.offset_row()
            row[4, 3] *= medium.temperature_scale
            row[5, 3] = medium.temperature_offset
            flags |= 1
        if (placement := fields.get(volume.path)) is not None:
            row[6:10] = relative_to(np.linalg.inv(placement.box_to_local @ to_world), plan.origin)
            row[10], row[11] = placement.scale_row(), placement.offset_row()
            flags |= 2
        row[11, 3] = flags
    return rows.tobytes()


def pack_blackbody() -> bytes:
    """The `Blackbody` block."""
    rows = np.zeros((blackbody.TABLE_SIZE, 4), np.float32)
    rows[:, :3] = blackbody.table()
    return rows.tobytes()


def pack_lights(plan: Plan, batch: range, capacity: int) -> bytes:
    """The `Lights` block of one batch; `capacity` is the LIGHT_CAPACITY of the program."""
    rows = np.zeros((capacity, _LIGHT_ROWS, 4), np.float32)
    for row, number in zip(rows, batch, strict=False):
        planned = plan.lights[number]
        light = planned.record
        if light.kind == "distant":
            row[0, :3] = light.direction
        else:
            row[0, :3], row[0, 3] = light.position - plan.origin, 1.0
        row[1, :3], row[1, 3] = light.strength, clamp_radius(light)
        row[2, :3], row[2, 3] = light.direction, light.kind in ("disk", "rect")
        if (shaping := light.shaping) is not None and light.kind != "distant":
            outer = math.radians(min(max(shaping.cone_angle, 0.0), 180.0))
            softness = min(max(shaping.cone_softness, 0.0), 1.0)
            cosine = -2.0 if shaping.cone_angle >= 180.0 else math.cos(outer)
            row[3] = ((1.0 - softness) * outer, outer, shaping.focus, cosine)
            row[4, :3], row[4, 3] = shaping.focus_tint, 1.0 + math.sin(outer)
        if not light.casts_shadows:
            row[5, 0] = -1.0
        elif (fit := planned.shadow) is not None:
            row[5] = (SHADOW_KIND_NUMBERS[fit.kind], planned.first_tile, len(fit.matrices), fit.far)
            for i, matrix in enumerate(fit.matrices[:2]):
                row[6 + 4 * i : 10 + 4 * i] = relative_to(matrix, plan.origin)
    return rows.tobytes()


def pack_light_lists(plan: Plan, lists: LightLists) -> bytes:
    """The `LightLists` block of one batch."""
    size = np.maximum(lists.hi - lists.lo, 1e-30)
    head = np.zeros((2, 4), np.float32)
    head[0, :3], head[1, :3] = lists.lo - plan.origin, lists.cells / size
    head[0, 3] = lists.cells
    cells = np.zeros(MOST_CELLS, np.uint32)
    cells[: len(lists.count)] = (lists.count.astype(np.uint32) << 16) | lists.first.astype(np.uint32)
    listed = np.zeros(MOST_INDICES, np.uint8)
    listed[: len(lists.lights)] = lists.lights
    # The shader takes bytes from words by their value, the lowest first.
    return head.tobytes() + cells.tobytes() + listed.view("<u4").astype(np.uint32).tobytes()


def clamp_radius(light: Light) -> float:
    """Distance below which a light's 1/d² stops growing: its radius, as nothing lies inside the emitter."""
    return 0.0 if light.kind != "sphere" or light.treat_as_point else light.world_radius


def slice_distances(item: PlannedMap, slices: int) -> tuple[float, float]:
    """Distance of the first slice along a light's rays, counted from the centre's, and from one slice to the next."""
    first, last = item.fit.reach
    return first, max(last - first, 1e-30) / (slices - 1)


def pack_light_maps(plan: Plan, batch: range, capacity: int) -> bytes:
    """The `LightMaps` block of one batch; `capacity` is the LIGHT_CAPACITY of the program."""
    count = max(len(plan.volumes), 1)
    rows = np.zeros((capacity * count, _LIGHT_MAP_ROWS, 4), np.float32)
    for item in plan.maps:
        if item.light not in batch:
            continue
        row = rows[(item.light - batch.start) * count + item.volume]
        fit = item.fit
        row[:4] = fit.to_map
        row[4, :3], row[4, 3] = fit.centre - plan.origin, MAP_KINDS_NUMBERS[fit.kind]
        row[5, :3] = fit.from_light
        row[5, 3] = np.linalg.norm(fit.from_light)
        row[6] = (*plan.map_atlas.corner(item.tile), item.weighting / item.reference, item.stretched)
        if plan.map_slices:
            first, spacing = slice_distances(item, plan.map_slices)
            row[7] = first, 1.0 / spacing, *item.extent
            if fit.kind == "orthographic":
                row[:3, 2], row[3, 2] = fit.from_light / spacing, -first / spacing
    return rows.tobytes()
