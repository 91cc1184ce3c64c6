"""The part of a plan that is made in light space: shadow maps of meshes, transmittance maps of volumes."""

from __future__ import annotations

import math

import numpy as np

from ..description import (
    Note,
    Volume,
    box_corners,
    mesh_world_bounds,
    transform_points,
    volume_box,
    volume_world_bounds,
)
from ..index import Entry
from ..settings import Settings
from .atlas import AtlasLayout, lay_out
from .draws import steps_across
from .fields import field_dims
from .light_lists import FEW_LIGHTS, LISTS_BYTES, LightLists, light_lists, reaches_box
from .method import SLICES_PER_DRAW, method_of, stored_curve
from .planned import DeviceLimits, PlannedLight, PlannedMap, PlannedPass, counted
from .precision import density_range
from .projection import light_map, shadow_fit
from .versioned import FITS

#: Texture memory that all shadow maps, and all transmittance maps, may take together; beyond it they get coarser.
ATLAS_MEMORY = 2**30
#: Up to so many transmittance maps are never coarser than 256².
MANY_MAPS = 32
#: Slices along the light's rays that are taken without being asked for.
SLICES_PER_VOXEL, LEAST_SLICES, MOST_SLICES = 0.75, 56, 224
#: Texels along the side of slices, from and to.
SLICE_SIZES = 128, 384
#: Texture memory that all light-space grids may take together; beyond it they get coarser.
SLICE_MEMORY = 2**28
#: Shorter side of a light-space grid at the least, as a part of the longer one.
LEAST_ASPECT = 0.125
#: Optical depth of the densest voxel from which slices are finer than voxels, up to twice as fine.
DEEP_VOXEL = 3.0


def _corner_points(boxes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    return np.concatenate([box_corners(*b) for b in boxes]) if boxes else np.zeros((0, 3))


def _mesh_bounds(entry: Entry):
    return FITS.get(("mesh", entry.versions["shape"]), lambda: mesh_world_bounds(entry.record))


def _volume_bounds(entry: Entry):
    key = ("volume", entry.versions["density"], entry.versions["placement"])
    return FITS.get(key, lambda: volume_world_bounds(entry.record))


def fitting_size(wanted: int, tiles: int, bytes_per_texel: int, edge: int, memory: int = ATLAS_MEMORY) -> int:
    """The size of square tiles, made smaller by a quarter from the wanted one until all fit one atlas of that edge and
    the memory for it."""
    size = min(wanted, edge)
    while size > 16 and (tiles > (edge // size) ** 2 or tiles * size * size * bytes_per_texel > memory):
        size = max(size * 3 // 4, 16)
    return size


def plan_shadows(
    volumes, lights, meshes, settings: Settings, limits: DeviceLimits, previous: AtlasLayout | None, passes, notes
) -> tuple[tuple[PlannedLight, ...], AtlasLayout]:
    """A shadow map for every light that meshes can keep from something."""
    mesh_boxes = [b for e in meshes if (b := _mesh_bounds(e)) is not None]
    media = _corner_points([_volume_bounds(e) for e in volumes])
    casters = _corner_points(mesh_boxes)
    bounds = (casters.min(axis=0), casters.max(axis=0)) if len(casters) else None
    receivers = np.concatenate([casters, media])
    shapes = tuple((e.record.path, e.versions["shape"]) for e in meshes)
    # One object stands for all that is around the lights, so that a key is not as long as the scene. Of media it is
    # their bounds alone, which a sequence of fields may keep.
    around = ("around", shapes, media.tobytes())
    surroundings = FITS.get(around, object)
    fits = [
        FITS.get(
            ("shadow", e.versions["placement"], surroundings),
            lambda e=e: shadow_fit(e.record, casters, receivers, media),
        )
        if bounds is not None
        and e.record.casts_shadows
        and (not settings.cull_lights or reaches_box(e.record, *bounds))
        else None
        for e in lights
    ]
    faces = sum(len(fit.matrices) for fit in fits if fit is not None)
    size = fitting_size(settings.shadow_map_size, faces, 4, limits.texture_size)
    if size < settings.shadow_map_size:
        message = f"{counted(faces, 'face')} of shadow maps are drawn with {size}² texels to fit"
        notes.append(Note("approximated", lights[0].record.path, message))
    wanted = [(e.record.path, len(fit.matrices)) for e, fit in zip(lights, fits, strict=True) if fit is not None]
    layout = AtlasLayout()
    if len(casters):
        layout = lay_out(previous, wanted, size, size * size * 4, limits.texture_size, ATLAS_MEMORY)
    planned = []
    for e, fit in zip(lights, fits, strict=True):
        light = e.record
        if fit is None:
            planned.append(PlannedLight(light, None, 0))
            continue
        tiles = layout.spans[light.path]
        planned.append(PlannedLight(light, fit, tiles.start))
        passes.append(
            PlannedPass(
                f"shadow_map {light.path}",
                "shadow_map",
                f"meshes cut this light; {fit.kind}, {counted(len(fit.matrices), 'face')}",
                (size, size, len(fit.matrices)),
                size * size * 4 * len(fit.matrices),
                (shapes, fit.key(), tiles, size),
                payload=planned[-1],
            )
        )
    return tuple(planned), layout


def voxel_depth(volume: Volume) -> float:
    """Optical depth of a volume's densest voxel along its longest edge, in the strongest channel."""
    density = volume.density
    to_world = np.asarray(density.index_to_local, float) @ np.asarray(volume.local_to_world, float)
    edge = float(np.linalg.norm(to_world[:3, :3], axis=1).max())
    _, most = FITS.get(("densities", density.key), lambda: density_range(density.grid))
    return most * max(volume.medium.strength) * edge


def _longest(volume: Volume) -> int:
    """Voxels along the longest edge of a volume; 0 for a shape."""
    return int(field_dims(volume.density).max()) if volume.density is not None else 0


def meeting_grids(light: Entry, volumes, grids: list[int], settings: Settings) -> list[int]:
    """The volumes of voxels that a light needs a map for: where it casts shadows and reaches them."""
    if not light.record.casts_shadows or not settings.cull_lights:
        return grids if light.record.casts_shadows else []

    def meets(e: Entry) -> bool:
        key = ("meets", light.versions["placement"], e.versions["density"], e.versions["placement"])
        return FITS.get(key, lambda: reaches_box(light.record, *_volume_bounds(e)))

    return [i for i in grids if meets(volumes[i])]


def plan_light_lists(
    volumes, lights, settings: Settings, limits: DeviceLimits, batches: tuple[range, ...] | None = None
) -> tuple[LightLists, ...]:
    """Lists of the lights that reach parts of the media, for all lights or for each batch; none where they would not
    pay."""
    if not (settings.cull_lights and volumes and len(lights) > FEW_LIGHTS):
        return ()
    if limits.uniform_block_size < LISTS_BYTES:
        return ()
    records = [e.record for e in volumes]
    bounds = [_volume_bounds(e) for e in volumes]
    lo, hi = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
    # The edges of cones are searched for within a step.
    margin = max(_diagonal(v) / steps_across(v, settings.steps) for v in records)
    lists = []
    for batch in batches or (range(len(lights)),):
        made = light_lists([lights[i].record for i in batch], lo, hi, margin, batches is not None)
        if made is None:
            return ()
        lists.append(made)
    return tuple(lists)


def _diagonal(volume: Volume) -> float:
    """World length of the longest diagonal of a volume's box."""
    lo, hi, to_world = volume_box(volume)
    corners = transform_points(box_corners(lo, hi), to_world)
    return float(np.linalg.norm(corners[:4] - corners[:3:-1], axis=1).max())


def map_resolution(
    volumes, grids: list[int], pairs: int, settings: Settings, limits: DeviceLimits, notes
) -> tuple[int, int]:
    """Texels along a map's side: as asked, or two per voxel of a small grid and one of a large; less where too many
    maps are needed. And the number of slices, 0 for a method that has none: as asked, or three for four voxels.

    Two, because the surface of a dense medium casts shadows as sharp as its voxels allow. Slices take one, and more of
    both, and of what is taken at the least, where a voxel is deep.
    """
    longest = max(_longest(volumes[i]) for i in grids)
    wanted, slices = settings.map_size, 0
    # A coarse grid that is dense has edges too: they need texels, unless there are very many maps to fill.
    few = pairs <= MANY_MAPS
    if method_of(settings).curve == "slices":
        deepest = max(voxel_depth(volumes[i]) for i in grids)
        finer = float(np.clip((deepest / DEEP_VOXEL) ** 1.5, 1.0, 2.0))
        least, most = (finer * LEAST_SLICES, MOST_SLICES) if few else (LEAST_SLICES, LEAST_SLICES)
        slices = settings.slices or int(np.clip(SLICES_PER_VOXEL * finer * longest, least, most))
        slices = min(-(-slices // SLICES_PER_DRAW), limits.texture_3d_size // SLICES_PER_DRAW) * SLICES_PER_DRAW
        if longest > 2 * slices and not settings.slices:
            message = f"light is kept at {slices} depths for {longest} voxels; slices sets more"
            notes.append(Note("approximated", max(volumes, key=_longest).path, message))
        least, most = SLICE_SIZES if few else (SLICE_SIZES[0] // 2, SLICE_SIZES[0])
        least = finer * least if few else least
        texels = finer * longest
    else:
        least, most = (256, 1024) if few else (64, 512)
        texels = min(longest * 2, max(longest, 512))
    if not wanted:
        wanted = int(-(-np.clip(texels, least, most) // 32) * 32)
        if longest > wanted:
            message = f"transmittance maps have {wanted}² texels for {longest} voxels; map_size sets more"
            notes.append(Note("approximated", max(volumes, key=_longest).path, message))
    edge, memory = _atlas_limits(slices, limits)
    size = fitting_size(wanted, pairs, method_of(settings).texel_bytes(settings, slices), edge, memory)
    if size < wanted:
        message = f"{counted(pairs, 'transmittance map')} have {size}² texels to fit"
        notes.append(Note("approximated", volumes[grids[0]].path, message))
    return size, slices


def _atlas_limits(slices: int, limits: DeviceLimits) -> tuple[int, int]:
    """Largest edge of the atlas of maps, and the memory that it may take."""
    return (limits.texture_3d_size, SLICE_MEMORY) if slices else (limits.texture_size, ATLAS_MEMORY)


def plan_maps(
    volumes,
    grids: list[int],
    lights,
    settings: Settings,
    resolution: tuple[int, int],
    limits: DeviceLimits,
    previous: AtlasLayout | None,
    passes: list[PlannedPass],
) -> tuple[tuple[PlannedMap, ...], AtlasLayout]:
    """A map for every pair of a light that casts shadows and a volume of voxels; `resolution` is the size of maps, and
    the number of slices."""
    planned = []
    size, slices = resolution
    tile_bytes = size * size * method_of(settings).texel_bytes(settings, slices)
    edge, memory = _atlas_limits(slices, limits)
    meeting = {e.record.path: meeting_grids(e, volumes, grids, settings) for e in lights}
    pairs = [(e.record.path, volumes[i].record.path) for e in lights for i in meeting[e.record.path]]
    layout = lay_out(previous, [(p, 1) for p in pairs], size, tile_bytes, edge, memory)
    for light_number, light_entry in enumerate(lights):
        light = light_entry.record
        for volume_number in meeting[light.path]:
            entry = volumes[volume_number]
            volume = entry.record
            strength = [s for s in volume.medium.strength if s > 0.0]
            versions = (light_entry.versions["placement"], entry.versions["density"], entry.versions["placement"])
            fit = FITS.get(("map", versions, size), lambda x=light, v=volume: light_map(x, v, size))
            tile = layout.spans[light.path, volume.path].start
            stored = stored_curve(light, volume, settings)
            extent = tuple(math.ceil(size * max(a, LEAST_ASPECT)) for a in fit.aspect) if slices else (size, size)
            item = PlannedMap(light_number, volume_number, fit, tile, max(strength), min(strength), *stored, extent)
            planned.append(item)
            depends = (
                entry.versions["density"],
                entry.versions["placement"],
                (item.reference, item.weakest),
                fit.key(),
                item.tile,
                resolution,
                stored,
                settings.read_by("transmittance_map"),
            )
            passes.append(
                PlannedPass(
                    f"transmittance_map {light.path} > {volume.path}",
                    "transmittance_map",
                    f"how this volume attenuates this light; {fit.kind}",
                    (*extent, slices) if slices else (size, size),
                    tile_bytes,
                    depends,
                    payload=item,
                )
            )
    return tuple(planned), layout
