"""The part of a plan that is made in light space: shadow maps of meshes, transmittance maps of volumes."""

from __future__ import annotations

import numpy as np

from ..description import Note, Volume, box_corners, mesh_world_bounds, volume_world_bounds
from ..index import Entry
from ..settings import Settings
from .atlas import AtlasLayout, lay_out
from .fields import field_dims
from .method import method_of, stored_curve
from .planned import DeviceLimits, PlannedLight, PlannedMap, PlannedPass, counted
from .projection import light_map, shadow_fit
from .versioned import FITS

#: Texture memory that all shadow maps, and all transmittance maps, may take together; beyond it they get coarser.
ATLAS_MEMORY = 2**30
#: Up to so many transmittance maps are never coarser than 256².
MANY_MAPS = 32


def _corner_points(boxes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    return np.concatenate([box_corners(*b) for b in boxes]) if boxes else np.zeros((0, 3))


def _mesh_bounds(entry: Entry):
    return FITS.get(("mesh", entry.versions["shape"]), lambda: mesh_world_bounds(entry.record))


def _volume_bounds(entry: Entry):
    key = ("volume", entry.versions["density"], entry.versions["placement"])
    return FITS.get(key, lambda: volume_world_bounds(entry.record))


def fitting_size(wanted: int, tiles: int, bytes_per_texel: int, limits: DeviceLimits) -> int:
    """The size of square tiles, halved from the wanted one until all fit one atlas and the memory for it."""
    size = min(wanted, limits.texture_size)
    while size > 16 and (
        tiles > (limits.texture_size // size) ** 2 or tiles * size * size * bytes_per_texel > ATLAS_MEMORY
    ):
        size //= 2
    return size


def plan_shadows(
    volumes, lights, meshes, settings: Settings, limits: DeviceLimits, previous: AtlasLayout | None, passes, notes
) -> tuple[tuple[PlannedLight, ...], AtlasLayout]:
    """A shadow map for every light that meshes can keep from something."""
    mesh_boxes = [b for e in meshes if (b := _mesh_bounds(e)) is not None]
    media = _corner_points([_volume_bounds(e) for e in volumes])
    casters = _corner_points(mesh_boxes)
    receivers = np.concatenate([casters, media])
    shapes = tuple((e.record.path, e.versions["shape"]) for e in meshes)
    # One object stands for all that is around the lights, so that a key is not as long as the scene.
    around = ("around", shapes, tuple((e.versions["density"], e.versions["placement"]) for e in volumes))
    surroundings = FITS.get(around, object)
    fits = [
        FITS.get(
            ("shadow", e.versions["placement"], surroundings),
            lambda e=e: shadow_fit(e.record, casters, receivers, media),
        )
        if len(casters) and e.record.casts_shadows
        else None
        for e in lights
    ]
    faces = sum(len(fit.matrices) for fit in fits if fit is not None)
    size = fitting_size(settings.shadow_map_size, faces, 4, limits)
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


def _longest(volume: Volume) -> int:
    """Voxels along the longest edge of a volume; 0 for a shape."""
    return int(field_dims(volume.density).max()) if volume.density is not None else 0


def map_size_for(volumes, grids: list[int], lights: int, settings: Settings, limits: DeviceLimits, notes) -> int:
    """Texels along a map's side: as asked, or two per voxel of a small grid and one of a large; less where too many
    maps are needed.

    Two, because the surface of a dense medium casts shadows as sharp as its voxels allow.
    """
    wanted = settings.map_size
    if not wanted:
        longest = max(_longest(volumes[i]) for i in grids)
        # A coarse grid that is dense has edges too: they need texels, unless there are very many maps to fill.
        few = len(grids) * lights <= MANY_MAPS
        least, most = (256, 1024) if few else (64, 512)
        texels = min(longest * 2, max(longest, 512))
        wanted = int(np.clip(-(-texels // 32) * 32, least, most))
        if longest > wanted:
            message = f"transmittance maps have {wanted}² texels for {longest} voxels; map_size sets more"
            notes.append(Note("approximated", max(volumes, key=_longest).path, message))
    size = fitting_size(wanted, len(grids) * lights, method_of(settings).texel_bytes(settings), limits)
    if size < wanted:
        message = f"{counted(len(grids) * lights, 'transmittance map')} have {size}² texels to fit"
        notes.append(Note("approximated", volumes[grids[0]].path, message))
    return size


def plan_maps(
    volumes,
    grids: list[int],
    lights,
    settings: Settings,
    size: int,
    limits: DeviceLimits,
    previous: AtlasLayout | None,
    passes: list[PlannedPass],
) -> tuple[tuple[PlannedMap, ...], AtlasLayout]:
    """A map for every pair of a light that casts shadows and a volume of voxels."""
    planned = []
    tile_bytes = size * size * method_of(settings).texel_bytes(settings)
    pairs = [(e.record.path, volumes[i].record.path) for e in lights if e.record.casts_shadows for i in grids]
    layout = lay_out(previous, [(p, 1) for p in pairs], size, tile_bytes, limits.texture_size, ATLAS_MEMORY)
    for light_number, light_entry in enumerate(lights):
        light = light_entry.record
        if not light.casts_shadows:
            continue
        for volume_number in grids:
            entry = volumes[volume_number]
            volume = entry.record
            strength = [s for s in volume.medium.strength if s > 0.0]
            versions = (light_entry.versions["placement"], entry.versions["density"], entry.versions["placement"])
            fit = FITS.get(("map", versions, size), lambda x=light, v=volume: light_map(x, v, size))
            tile = layout.spans[light.path, volume.path].start
            stored = stored_curve(light, volume, settings)
            item = PlannedMap(light_number, volume_number, fit, tile, max(strength), min(strength), *stored)
            planned.append(item)
            depends = (
                entry.versions["density"],
                entry.versions["placement"],
                (item.reference, item.weakest),
                fit.key(),
                item.tile,
                size,
                stored,
                settings.read_by("transmittance_map"),
            )
            passes.append(
                PlannedPass(
                    f"transmittance_map {light.path} > {volume.path}",
                    "transmittance_map",
                    f"how this volume attenuates this light; {fit.kind}",
                    (size, size),
                    tile_bytes,
                    depends,
                    payload=item,
                )
            )
    return tuple(planned), layout
