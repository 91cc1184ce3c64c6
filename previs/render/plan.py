"""The plan of a frame: which passes it needs, why, and what each depends on.

Only what the scene needs is planned: no volume, no light maps; no mesh, no shadow maps and no depth test; one light, no
loop over lights. A plan is plain data made without OpenGL, so `previs info` can print it anywhere. A pass names what
it depends on (versions of the index, settings, projections) and the passes whose output it reads; it runs again
only if one of these moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ..description import (
    Camera,
    Light,
    Mesh,
    Note,
    Volume,
    box_corners,
    mesh_world_bounds,
    volume_box,
    volume_world_bounds,
)
from ..errors import PrevisError
from ..index import Entry, RenderIndex, camera_key
from ..settings import Settings
from .atlas import AtlasLayout, lay_out
from .fields import field_dims, packed_bytes, planned_reduction
from .method import method_of, stored_curve
from .precision import density_range, precision_notes
from .projection import (
    MAP_KINDS,
    SHADOW_KINDS,
    CameraRays,
    LightMap,
    ShadowFit,
    camera_rays,
    light_map,
    render_origin,
    shadow_fit,
)
from .scattered import ScatteredPixels

PassKind = Literal["fields", "shadow_map", "transmittance_map", "gbuffer", "gather", "surface", "march", "composite"]

Atlases = tuple[AtlasLayout | None, AtlasLayout | None]

MAX_VOLUMES = 128
MAX_LIGHTS_PER_BATCH = 64
#: Bytes of a light, a volume and a pair of both in the uniform blocks; see uniforms.py.
LIGHT_BYTES, VOLUME_BYTES, PAIR_BYTES = 14 * 16, 12 * 16, 7 * 16
#: Texture memory that all shadow maps, and all transmittance maps, may take together; beyond it they get coarser.
ATLAS_MEMORY = 2**30
#: Up to so many transmittance maps are never coarser than 256².
MANY_MAPS = 32
#: Loop iterations in one invocation of a shader. Mesa's llvmpipe silently ends all loops after 65535; a GPU's watchdog
#: ends a draw that takes too long. Longer marches are drawn in batches of lights and slices of the ray.
LOOP_BUDGET = 50_000
#: Optically deep steps of a ray that are cut once more, at the most: about two for every unit of optical depth until a
#: ray is opaque in the last of three channels.
MOST_CUTS = 160
#: With fewer the front of a dense medium is not resolved.
FEW_CUTS = 24


class _Fits:
    """What follows from the versions of parts of a scene alone, kept from plan to plan.

    A version never stands for another content in the same process, so nothing here is ever out of date.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: dict[Hashable, Any] = {}

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """What is kept under a key, or else what `make` gives."""
        if key in self._held:
            return self._held[key]
        while len(self._held) >= self._most:
            self._held.pop(next(iter(self._held)), None)
        made = self._held[key] = make()
        return made


#: Fits of all maps of a few plans of many lights and volumes; each takes about a kilobyte.
_fits = _Fits(20_000)


@dataclass(frozen=True)
class DeviceLimits:
    """What a device can do, as far as plans depend on it: edges of textures, bytes of a uniform block.

    The defaults are those of most devices in use.
    """

    texture_size: int = 16384
    texture_3d_size: int = 2048
    uniform_block_size: int = 65536


@dataclass(frozen=True, eq=False)
class PlannedPass:
    """One pass: `name` is unique in the plan, `why` one sentence, `inputs` names of the passes it reads.

    `depends` is compared between frames; `memory` are bytes of the textures it fills.
    """

    name: str
    kind: PassKind
    why: str
    resolution: tuple[int, ...]
    memory: int
    depends: Hashable
    inputs: tuple[str, ...] = ()
    payload: Any = None


@dataclass(frozen=True, eq=False)
class PlannedLight:
    """A light, and its shadow map if it needs one: `first_tile` counts faces in the shadow atlas."""

    record: Light
    shadow: ShadowFit | None
    first_tile: int


@dataclass(frozen=True, eq=False)
class PlannedMap:
    """The transmittance map of one light through one volume and its tile in the atlas.

    Curves are stored at the `reference` extinction (per stage unit at density 1) to the power 1 / `weighting`; the
    adaptive range ends where the weakest channel, of extinction `weakest`, falls below the `threshold`. Levels of
    quantiles are `stretched` where channels differ much.
    """

    light: int
    volume: int
    fit: LightMap
    tile: int
    reference: float
    weakest: float
    weighting: float
    threshold: float
    stretched: bool


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that is known about a frame before it is drawn."""

    width: int
    height: int
    settings: Settings
    origin: np.ndarray
    rays: CameraRays
    volumes: tuple[Volume, ...]
    lights: tuple[PlannedLight, ...]
    meshes: tuple[Mesh, ...]
    ambient: tuple[float, float, float]
    maps: tuple[PlannedMap, ...]
    map_size: int
    shadow_size: int
    shadow_tiles: int
    map_atlas: AtlasLayout
    shadow_atlas: AtlasLayout
    limits: DeviceLimits
    batches: tuple[range, ...]
    slices: tuple[range, ...]
    cuts: int
    defines: Mapping[str, Any]
    passes: tuple[PlannedPass, ...]
    notes: tuple[Note, ...] = field(default=())
    pixels: ScatteredPixels | None = None

    @property
    def target_size(self) -> tuple[int, int]:
        """(width, height) of what is drawn into: the picture's, or that of the scattered pixels."""
        return (self.width, self.height) if self.pixels is None else self.pixels.target_size

    def describe(self) -> str:
        """The plan as text: a line per pass with its reason, resolution and memory."""
        lines = []
        for p in self.passes:
            resolution = "×".join(str(n) for n in p.resolution) or "-"
            lines.append(f"{p.name:<44} {resolution:>14} {_bytes(p.memory):>10}  {p.why}")
        total = sum(p.memory for p in self.passes)
        lines.append(f"{'total':<44} {'':>14} {_bytes(total):>10}")
        return "\n".join(lines)


def _bytes(count: int) -> str:
    return f"{count / 2**20:.1f} MiB" if count >= 2**19 else f"{count / 2**10:.1f} KiB"


def _count(number: int, name: str, plural: str = "s") -> str:
    return f"{number} {name}{plural if number != 1 else ''}"


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
    origin = render_origin(scene)
    conformed = camera.conformed(width / height)
    rays = camera_rays(conformed, origin, scene, (shift[0] / width, shift[1] / height))

    records = tuple(e.record for e in volumes)
    grids = [i for i, v in enumerate(records) if v.density is not None]
    memory = settings.field_memory * 2**20
    method = method_of(settings)
    passes: list[PlannedPass] = []

    fields = [
        (v, f, components)
        for v in records
        for f, components in ((v.density, 1), (v.temperature, 1), (v.emission, 4))
        if f is not None and f.grid.active_count
    ]
    if fields:
        # Equal fields, those of instances, are held once.
        held = {(f.key, components): f for _, f, components in fields}
        size = sum(packed_bytes(f, memory, limits.texture_3d_size, components) for (_, components), f in held.items())
        for volume, f, components in fields:
            factor = planned_reduction(f, memory, limits.texture_3d_size, components)
            if factor > 1:
                dims = "×".join(str(d) for d in field_dims(f))
                message = f"field of {dims} voxels is averaged over cubes of {factor}³ to fit"
                notes.append(Note("approximated", volume.path, message))
        keys = tuple((e.record.path, e.versions["density"], e.versions["emission_fields"]) for e in volumes)
        why = f"{_count(len(held), 'field')} of voxels"
        if len(held) < len(fields):
            why += f", used {len(fields)} times"
        passes.append(
            PlannedPass("fields", "fields", why, (), size, (keys, settings.read_by("fields"), limits), payload=records)
        )

    planned_lights, shadow_atlas = _plan_shadows(volumes, lights, meshes, settings, limits, atlases[1], passes, notes)
    casting = sum(e.record.casts_shadows for e in lights)
    size = _map_size(records, grids, casting, settings, limits, notes) if grids else 0
    maps, map_atlas = (), AtlasLayout()
    for entry in volumes:
        record = entry.record
        densities = (1.0, 1.0)
        if record.density is not None:
            key = ("densities", entry.versions["density"])
            densities = _fits.get(key, lambda grid=record.density.grid: density_range(grid))
        notes += [Note("approximated", record.path, n) for n in precision_notes(record, densities, method)]
    if grids and method.has_maps:
        maps, map_atlas = _plan_maps(volumes, grids, lights, settings, size, limits, atlases[0], passes)

    batches, slices, cuts = _draws(records, len(lights), settings, limits)
    if cuts < FEW_CUTS and grids:
        message = f"the way to the lights takes so many steps that only {cuts} deep steps of the view can be cut finer"
        notes.append(Note("approximated", records[grids[0]].path, message))
    view = (camera_key(conformed), width, height, shift, rays.key(), origin.tobytes())
    target = (width, height) if pixels is None else pixels.target_size
    texels = math.prod(target)
    chosen = pixels and pixels.key
    defines = _defines(records, planned_lights, maps, len(batches[0]), meshes, ambient, settings)
    defines["SCATTERED_PIXELS"] = pixels is not None
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
                f"{_count(len(meshes), 'mesh', 'es')}, {_count(triangles, 'triangle')} before the camera",
                (width, height),
                width * height * 44,
                (view, shapes, settings.read_by("gbuffer")),
            )
        )
        if pixels is not None:
            why = f"what the camera sees of the meshes at {_count(len(pixels), 'pixel')}"
            passes.append(PlannedPass("gather", "gather", why, target, texels * 40, chosen, ("gbuffer",)))
        passes.append(
            PlannedPass(
                "surface",
                "surface",
                f"light on the meshes from {_count(len(lights), 'light')}",
                target,
                texels * 16,
                (lit_by, media_light, ambient, settings.read_by("surface")),
                (passes[-1].name, *shadow_passes, *field_passes, *map_passes),
            )
        )
    geometry = () if not meshes else ("gbuffer",) if pixels is None else ("gather",)
    if records:
        media = tuple((e.record.path, e.versions["placement"], e.versions["scattering"]) for e in volumes)
        why = f"{_count(len(records), 'volume')}, {_count(len(lights), 'light')}"
        why += f"; {method.why(settings.coefficients)}" if grids else "; homogeneous, light attenuated in closed form"
        if defines["PROJECTIVE_STEPS"]:
            why += "; steps placed in the spot's projection"
        passes.append(
            PlannedPass(
                "march",
                "march",
                why,
                target,
                texels * (48 if defines["HAS_EMISSION"] else 32) * (2 if len(batches) * len(slices) > 1 else 1),
                (view, chosen, media, lit_by, ambient, settings.read_by("march")),
                (*geometry, *shadow_passes, *field_passes, *map_passes),
            )
        )
    passes.append(
        PlannedPass(
            "composite",
            "composite",
            "media over surfaces",
            target,
            texels * 16,
            target,
            (*(("surface",) if meshes else ()), *(("march",) if records else ())),
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
    )


def _is_flat(volume: Volume) -> bool:
    lo, hi, _ = volume_box(volume)
    return bool(np.any(np.asarray(hi) <= np.asarray(lo)))


#: Steps across the longest diagonal of a volume that has fewer voxels along it, when the number is left to the plan.
LEAST_STEPS = 256
#: No 3D texture has more voxels along its diagonal than this; a larger field is reduced.
MOST_STEPS = 4096


def steps_across(volume: Volume, wanted: int) -> int:
    """Steps across the longest diagonal of a volume: as many as wanted, or for 0 at least one per voxel."""
    if wanted:
        return wanted
    if volume.density is None:
        return LEAST_STEPS
    return min(max(LEAST_STEPS, math.ceil(float(np.linalg.norm(field_dims(volume.density) + 1)))), MOST_STEPS)


def _draws(
    records, lights: int, settings: Settings, limits: DeviceLimits
) -> tuple[tuple[range, ...], tuple[range, ...], int]:
    """How a march is cut into draws: ranges of lights, ranges of the steps of a ray, and how many deep steps a draw may
    cut.

    Raises:
        PrevisError: when the way to one light alone takes more steps than a draw may.
    """
    volumes = max(len(records), 1)
    grids = [v for v in records if v.density is not None]
    to_light = 0 if method_of(settings).has_maps else sum(_steps_to_light(v, settings) for v in grids)
    # The search for a shadow's edge, the phase functions, and the way to the light.
    per_light = 20 + 2 * volumes + to_light
    if per_light > LOOP_BUDGET:
        raise PrevisError(
            f"{grids[0].path}: a march to a light takes {to_light} steps through {_count(len(grids), 'volume')}, "
            f"a draw at most {LOOP_BUDGET}; set light_steps to {max(LOOP_BUDGET // (2 * len(grids)), 1)} or less"
        )
    pairs = limits.uniform_block_size // (PAIR_BYTES * volumes)
    most = min(MAX_LIGHTS_PER_BATCH, pairs, limits.uniform_block_size // LIGHT_BYTES, LOOP_BUDGET // per_light)
    # A power of two, as the blocks are sized in powers of two: few shader variants for many numbers of lights.
    size = 2 ** int(math.log2(max(most, 1)))
    batches = tuple(range(i, min(i + size, lights)) for i in range(0, lights, size)) or (range(0),)
    # A ray takes no more steps than it would in every volume apart, and one more for each of its segments; in a spot's
    # projection a segment has a least number of steps.
    segments = 2 * volumes
    steps = sum(steps_across(v, settings.steps) for v in records) + segments * 3
    if not grids:
        steps += segments * projective_minimum(settings)
    # A step may begin a segment, behind a gap; finding the first one passes all that lie before it.
    per_step = 3 * (volumes + 1) + max(len(b) for b in batches) * per_light
    # Rather shorter slices than uncut steps; a slice takes one step at the least.
    cuts = min(MOST_CUTS, 3 * LOOP_BUDGET // (4 * per_step))
    length = max(1, (LOOP_BUDGET - segments * (volumes + 2)) // per_step - cuts)
    slices = tuple(range(i, min(i + length, steps)) for i in range(0, steps, length))
    return batches, slices, cuts


def _steps_to_light(volume: Volume, settings: Settings) -> int:
    """Iterations of a march through a volume towards a light, at the most."""
    if settings.light_steps:
        return settings.light_steps + 1
    # From cell to cell: one crossing of a face after another along each axis.
    return int(np.minimum(field_dims(volume.density) + 2, MOST_STEPS).sum()) + 3


def _corner_points(boxes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    return np.concatenate([box_corners(*b) for b in boxes]) if boxes else np.zeros((0, 3))


def _mesh_bounds(entry: Entry):
    return _fits.get(("mesh", entry.versions["shape"]), lambda: mesh_world_bounds(entry.record))


def _volume_bounds(entry: Entry):
    key = ("volume", entry.versions["density"], entry.versions["placement"])
    return _fits.get(key, lambda: volume_world_bounds(entry.record))


def fitting_size(wanted: int, tiles: int, bytes_per_texel: int, limits: DeviceLimits) -> int:
    """The size of square tiles, halved from the wanted one until all fit one atlas and the memory for it."""
    size = min(wanted, limits.texture_size)
    while size > 16 and (
        tiles > (limits.texture_size // size) ** 2 or tiles * size * size * bytes_per_texel > ATLAS_MEMORY
    ):
        size //= 2
    return size


def _plan_shadows(
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
    surroundings = _fits.get(around, object)
    fits = [
        _fits.get(
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
        message = f"{_count(faces, 'face')} of shadow maps are drawn with {size}² texels to fit"
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
                f"meshes cut this light; {fit.kind}, {_count(len(fit.matrices), 'face')}",
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


def _map_size(volumes, grids: list[int], lights: int, settings: Settings, limits: DeviceLimits, notes) -> int:
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
        message = f"{_count(len(grids) * lights, 'transmittance map')} have {size}² texels to fit"
        notes.append(Note("approximated", volumes[grids[0]].path, message))
    return size


def _plan_maps(
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
            fit = _fits.get(("map", versions, size), lambda x=light, v=volume: light_map(x, v, size))
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


PHASE_NUMBERS = {"isotropic": 0, "hg": 1, "schlick": 2, "rayleigh": 3, "two_lobe": 4}
MAP_KINDS_NUMBERS = {kind: number for number, kind in enumerate(MAP_KINDS)}
SHADOW_KIND_NUMBERS = {kind: number for number, kind in enumerate(SHADOW_KINDS)}


def _defines(volumes, lights, maps, batch: int, meshes, ambient, settings: Settings) -> dict[str, Any]:
    """What the shaders are compiled for."""
    phases = {v.medium.phase if v.medium.anisotropy != 0.0 or v.medium.phase != "hg" else "isotropic" for v in volumes}
    homogeneous = all(v.density is None for v in volumes)
    cone = [p for p in lights if p.shadow is not None and p.shadow.kind == "perspective"]
    kinds = {p.record.kind for p in lights}
    emitting = [v for v in volumes if v.medium.emits]
    return {
        "VOLUME_COUNT": len(volumes),
        "LIGHT_CAPACITY": 2 ** math.ceil(math.log2(max(batch, 1))),
        "HAS_LIGHTS": bool(lights),
        "HAS_POINT": bool(kinds - {"distant"}),
        "HAS_SHAPING": any(p.record.shaping is not None for p in lights),
        "HAS_COSINE": bool(kinds & {"disk", "rect"}),
        "HAS_SHADOW_MAPS": any(p.shadow is not None for p in lights),
        "HAS_MESHES": bool(meshes),
        "HAS_GRIDS": any(v.density is not None for v in volumes),
        "HAS_SHAPES": any(v.shape is not None for v in volumes),
        "HAS_AMBIENT": any(a > 0.0 for a in ambient),
        "HAS_EMISSION": bool(emitting),
        "HAS_TEMPERATURE": any(v.temperature is not None for v in emitting),
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


def projective_minimum(settings: Settings) -> int:
    """The least number of steps that a ray takes in a spot's projection, however short its way through the cone."""
    return max((settings.steps or LEAST_STEPS) // 4, 1)


def _map_exponent(volumes: tuple[Volume, ...], maps: tuple[PlannedMap, ...]) -> int:
    """1 or 2 where every lookup raises to just that power, else 0: the shader then computes it per channel."""
    exponents = {m.weighting for m in maps}
    grey = all(len(set(v.medium.extinction)) == 1 for v in volumes)
    return int(exponents.pop()) if grey and exponents in ({1.0}, {2.0}) else 0
