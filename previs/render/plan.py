"""The plan of a frame: which passes it needs, why, and what each depends on.

Only what the scene needs is planned: no volume, no light maps; no mesh, no shadow maps and no depth test; one light, no
loop over lights. A plan is plain data made without OpenGL, so `previs info` can print it anywhere. A pass names what
it depends on (versions of the index, settings, projections) and the passes whose output it reads; it runs again
only if one of these moved.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .. import blackbody
from ..description import Camera, Note, Volume, volume_box
from ..errors import PrevisError
from ..index import RenderIndex, camera_key
from ..settings import Settings
from .atlas import AtlasLayout
from .draws import VOLUME_BYTES, march_draws
from .fields import SPARSE_ROLES, field_dims, storage
from .light_lists import MOST_CELLS, MOST_INDICES, reaches_box
from .light_plan import map_resolution, meeting_grids, plan_light_lists, plan_maps, plan_shadows
from .method import method_of
from .planned import PHASE_NUMBERS, Atlases, DeviceLimits, Plan, PlannedMap, PlannedPass, counted, march_size
from .precision import density_range, precision_notes
from .projection import camera_rays, render_origin
from .scattered import ScatteredPixels
from .versioned import FITS

MAX_VOLUMES = 128


def make_plan(
    index: RenderIndex,
    camera: Camera,
    width: int,
    height: int,
    settings: Settings,
    shift: tuple[float, float] = (0.0, 0.0),
    limits: DeviceLimits | None = None,
    atlases: Atlases = (None, None),
    pixels: ScatteredPixels | None = None,
) -> Plan:
    """Plan one frame.

    Args:
        index: what is in the scene.
        camera: its aspect is conformed to the image.
        width, height: image size in pixels.
        settings: the knobs.
        shift: offset of the samples from the pixel centres, in pixels.
        limits: of the device; None takes the defaults.
        atlases: the layouts of transmittance maps and of shadow maps in the plan before, so that maps stay in their
            place.
        pixels: those to draw; None draws the picture.

    Raises:
        PrevisError: when the scene holds more volumes than a frame can march through.
    """
    limits = limits or DeviceLimits()
    scene = index.scene
    meshes = list(index.meshes.values())
    notes: list[Note] = []
    volumes = []
    for entry in index.volumes.values():
        if entry.record.density is not None and entry.record.density.grid.active_count == 0:
            notes.append(Note("empty", entry.record.path, "its density has no active voxels"))
        elif abs(np.linalg.det(volume_box(entry.record)[2][:3, :3])) < 1e-300 or _is_flat(entry.record):
            notes.append(Note("ignored", entry.record.path, "has no thickness, so nothing of it can be seen"))
        elif any(s > 0.0 for s in entry.record.medium.strength):
            volumes.append(entry)
    most_volumes = min(MAX_VOLUMES, limits.uniform_block_size // VOLUME_BYTES)
    if len(volumes) > most_volumes:
        raise PrevisError(
            f"{volumes[most_volumes].record.path}: the stage has {len(volumes)} volumes and a frame takes "
            f"{most_volumes}; hide some, or render them apart"
        )
    domes = [e.record for e in index.lights.values() if e.record.kind == "dome"]
    notes += [Note("approximated", d.path, "a dome lights every point evenly, without occlusion") for d in domes]
    ambient = tuple(settings.ambient + sum(d.radiance[c] for d in domes) for c in range(3))
    lights = [e for e in index.lights.values() if e.record.kind != "dome" and any(c > 0.0 for c in e.record.strength)]
    if settings.cull_lights and (bounds := scene.world_bounds()) is not None:
        lights = [e for e in lights if reaches_box(e.record, *bounds)]
    origin = render_origin(scene)
    conformed = camera.conformed(width / height)
    rays = camera_rays(conformed, origin, scene, (shift[0] / width, shift[1] / height))

    records = tuple(e.record for e in volumes)
    grids = [i for i, v in enumerate(records) if v.density is not None]
    memory = settings.field_memory * 2**20
    method = method_of(settings)
    passes: list[PlannedPass] = []

    fields = [
        (v, f, components, settings.sparse if role in SPARSE_ROLES else "off")
        for v in records
        for role, components in (("density", 1), ("temperature", 1), ("emission", 4))
        if (f := getattr(v, role)) is not None and f.grid.active_count
    ]
    has_bricks = False
    if fields:
        # Equal fields, those of instances, are held once.
        held = {}
        for volume, f, components, sparse in fields:
            stored = held[f.key, components, sparse] = storage(f, memory, limits.texture_3d_size, components, sparse)
            if (factor := stored.reduction) > 1:
                dims = "×".join(str(d) for d in field_dims(f))
                message = f"field of {dims} voxels is averaged over cubes of {factor}³ to fit"
                notes.append(Note("approximated", volume.path, message))
        keys = tuple((e.record.path, e.versions["density"], e.versions["emission_fields"]) for e in volumes)
        why = f"{counted(len(held), 'field')} of voxels"
        if len(held) < len(fields):
            why += f", used {len(fields)} times"
        size, edges = sum(s.nbytes for s in held.values()), sorted({s.edge for s in held.values() if s.edge})
        if has_bricks := bool(edges):
            why += f", {sum(s.edge > 0 for s in held.values())} in bricks of " + ", ".join(f"{e}³" for e in edges)
        passes.append(
            PlannedPass("fields", "fields", why, (), size, (keys, settings.read_by("fields"), limits), payload=records)
        )

    planned_lights, shadow_atlas = plan_shadows(volumes, lights, meshes, settings, limits, atlases[1], passes, notes)
    pairs = sum(len(meeting_grids(e, volumes, grids, settings)) for e in lights)
    size, slice_count = (0, 0)
    if grids:
        size, slice_count = map_resolution(records, grids, pairs, settings, limits, notes)
    maps, map_atlas = (), AtlasLayout()
    for entry in volumes:
        record = entry.record
        densities = (1.0, 1.0)
        if record.density is not None:
            key = ("densities", record.density.key)
            densities = FITS.get(key, lambda grid=record.density.grid: density_range(grid))
        notes += [Note("approximated", record.path, n) for n in precision_notes(record, densities, method)]
    if grids and method.has_maps:
        maps, map_atlas = plan_maps(volumes, grids, lights, settings, (size, slice_count), limits, atlases[0], passes)

    lists = plan_light_lists(volumes, lights, settings, limits)
    batches, slices, cuts = march_draws(records, len(lights), settings, limits, lists[0].longest if lists else None)
    if lists and len(batches) > 1:
        lists = plan_light_lists(volumes, lights, settings, limits, batches)
    if not cuts and grids:
        message = "the way to the lights takes so many steps that no deep steps of the view can be cut finer"
        notes.append(Note("approximated", records[grids[0]].path, message))
    view = (camera_key(conformed), width, height, shift, rays.key(), origin.tobytes())
    target = (width, height) if pixels is None else pixels.target_size
    texels = math.prod(target)
    # Scattered pixels are few, and none of them has marched neighbours.
    divisor = settings.march_divisor if pixels is None and records else 1
    chosen = pixels and pixels.key
    defines = _defines(records, planned_lights, maps, len(batches[0]), meshes, ambient, settings)
    defines["SCATTERED_PIXELS"] = pixels is not None
    defines["HAS_SPARSE"] = has_bricks
    defines |= {"HAS_LIGHT_LISTS": bool(lists), "MOST_CELLS": MOST_CELLS, "MOST_INDICES": MOST_INDICES}
    shadow_passes = tuple(p.name for p in passes if p.kind == "shadow_map")
    map_passes = tuple(p.name for p in passes if p.kind == "transmittance_map")
    field_passes = ("fields",) if fields else ()
    lit_by = tuple((e.record.path, e.versions["placement"], e.versions["colour"]) for e in lights)
    media_light = tuple((e.record.path, e.versions["placement"], e.versions["extinction"]) for e in volumes)

    if meshes:
        shapes = tuple((e.record.path, e.versions["shape"], e.versions["surface"]) for e in meshes)
        triangles = sum(len(e.record.geometry.triangles) * len(e.record.local_to_world) for e in meshes)
        passes.append(
            PlannedPass(
                "gbuffer",
                "gbuffer",
                f"{counted(len(meshes), 'mesh', 'es')}, {counted(triangles, 'triangle')} before the camera",
                (width, height),
                width * height * 44,
                (view, shapes, settings.read_by("gbuffer")),
            )
        )
        if pixels is not None:
            why = f"what the camera sees of the meshes at {counted(len(pixels), 'pixel')}"
            passes.append(PlannedPass("gather", "gather", why, target, texels * 40, chosen, ("gbuffer",)))
        passes.append(
            PlannedPass(
                "surface",
                "surface",
                f"light on the meshes from {counted(len(lights), 'light')}",
                target,
                texels * 16,
                (lit_by, media_light, ambient, settings.read_by("surface")),
                (passes[-1].name, *shadow_passes, *field_passes, *map_passes),
            )
        )
    geometry = () if not meshes else ("gbuffer",) if pixels is None else ("gather",)
    if records:
        media = tuple((e.record.path, e.versions["placement"], e.versions["scattering"]) for e in volumes)
        why = f"{counted(len(records), 'volume')}, {counted(len(lights), 'light')}"
        why += f"; {method.why(settings.coefficients)}" if grids else "; homogeneous, light attenuated in closed form"
        if defines["PROJECTIVE_STEPS"]:
            why += "; steps placed in the spot's projection"
        marched = march_size(width, height, divisor) if divisor > 1 else target
        held = (48 if defines["HAS_EMISSION"] else 32) * (2 if len(batches) * len(slices) > 1 else 1)
        read = (*geometry, *shadow_passes, *field_passes, *map_passes)
        passes.append(
            PlannedPass(
                "march",
                "march",
                f"{why}; one pixel of {divisor}×{divisor}" if divisor > 1 else why,
                marched,
                math.prod(marched) * held,
                (view, chosen, media, lit_by, ambient, settings.read_by("march")),
                read,
            )
        )
        if divisor > 1:
            why = "media between the marched pixels"
            why += ", but along surfaces; on an edge that they miss, the pixel is marched" if meshes else ""
            filled = texels * (held + (4 if meshes else 0))
            passes.append(PlannedPass("upsample", "upsample", why, target, filled, target, ("march", *read)))
    passes.append(
        PlannedPass(
            "composite",
            "composite",
            "media over surfaces",
            target,
            texels * 16,
            target,
            (*(("surface",) if meshes else ()), *((passes[-1].name,) if records else ())),
        )
    )
    return Plan(
        width=width,
        height=height,
        settings=settings,
        origin=origin,
        rays=rays,
        volumes=records,
        lights=planned_lights,
        meshes=tuple(e.record for e in meshes),
        ambient=ambient,
        maps=maps,
        map_size=size,
        map_slices=slice_count,
        shadow_size=shadow_atlas.size,
        shadow_tiles=sum(len(p.shadow.matrices) for p in planned_lights if p.shadow is not None),
        map_atlas=map_atlas,
        shadow_atlas=shadow_atlas,
        limits=limits,
        batches=batches,
        slices=slices,
        cuts=cuts,
        defines=defines,
        passes=tuple(passes),
        notes=tuple(notes),
        pixels=pixels,
        light_lists=lists,
        march_divisor=divisor,
    )


def _is_flat(volume: Volume) -> bool:
    lo, hi, _ = volume_box(volume)
    return bool(np.any(np.asarray(hi) <= np.asarray(lo)))


def _defines(volumes, lights, maps, batch: int, meshes, ambient, settings: Settings) -> dict[str, Any]:
    """What the shaders are compiled for."""
    phases = {v.medium.phase if v.medium.anisotropy != 0.0 or v.medium.phase != "hg" else "isotropic" for v in volumes}
    homogeneous = all(v.density is None for v in volumes)
    cone = [p for p in lights if p.shadow is not None and p.shadow.kind == "perspective"]
    kinds = {p.record.kind for p in lights}
    shapings = [p.record.shaping for p in lights if p.record.shaping is not None]
    emitting = [v for v in volumes if v.medium.emits]
    return {
        "VOLUME_COUNT": len(volumes),
        # As many as there are where they are few: the shader calls for them one by one.
        "LIGHT_CAPACITY": max(batch, 1) if batch <= 4 else 2 ** math.ceil(math.log2(batch)),
        "HAS_LIGHTS": bool(lights),
        "HAS_POINT": bool(kinds - {"distant"}),
        "HAS_SHAPING": any(p.record.shaping is not None for p in lights),
        "HAS_HARD_CONES": any(s.cone_softness <= 0.0 and s.cone_angle < 180.0 for s in shapings),
        "HAS_SOFT_CONES": any(s.cone_softness > 0.0 and s.cone_angle < 180.0 for s in shapings),
        "HAS_FOCUS": any(s.focus > 0.0 for s in shapings),
        "HAS_COSINE": bool(kinds & {"disk", "rect"}),
        "HAS_SHADOW_MAPS": any(p.shadow is not None for p in lights),
        "HAS_CUBES": any(p.shadow is not None and p.shadow.kind == "cube" for p in lights),
        "HAS_MESHES": bool(meshes),
        "SKIP_EMPTY": settings.skip_empty and not homogeneous,
        "HAS_GRIDS": any(v.density is not None for v in volumes),
        "HAS_SHAPES": any(v.shape is not None for v in volumes),
        "HAS_AMBIENT": any(a > 0.0 for a in ambient),
        "HAS_EMISSION": bool(emitting),
        "HAS_TEMPERATURE": any(v.temperature is not None for v in emitting),
        "BLACKBODY_SIZE": blackbody.TABLE_SIZE,
        "HAS_EMISSION_FIELD": any(v.emission is not None for v in emitting),
        "CHROMATIC": any(len(set(v.medium.extinction)) > 1 for v in volumes),
        "PHASE": PHASE_NUMBERS[phases.pop()] if len(phases) == 1 else -1,
        **method_of(settings).defines(settings),
        "LIGHT_CELLS": not method_of(settings).has_maps and settings.light_steps == 0,
        "MAP_EXPONENT": _map_exponent(volumes, maps),
        "PROJECTIVE_STEPS": bool(
            settings.projective_steps and homogeneous and volumes and len(lights) == 1 and len(cone) == 1
        ),
        "HAS_SPECULAR": any(m.record.surface.specular for m in meshes),
        "HAS_EMISSIVE": any(any(m.record.surface.emissive_color) for m in meshes),
    }


def _map_exponent(volumes: tuple[Volume, ...], maps: tuple[PlannedMap, ...]) -> int:
    """1 or 2 where every lookup raises to just that power, else 0: the shader then computes it per channel."""
    exponents = {m.weighting for m in maps}
    grey = all(len(set(v.medium.extinction)) == 1 for v in volumes)
    return int(exponents.pop()) if grey and exponents in ({1.0}, {2.0}) else 0
