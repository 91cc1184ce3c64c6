"""Reads a stage into a scene description, and reads again only what changed.

Every prim that gives something has a `Translation`: its records and the prims they depend on. A new reading keeps the
translations that no change notice reached and, at another time, that nothing animates. A recomposition of prims (an
added or removed prim, a variant, a first binding) makes all of them anew, which is cheap: voxels and triangles come
from caches of their own, which only a change of the properties behind them empties.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdVol

from ..description import Camera, Light, Mesh, Note, SceneDescription, Volume
from ..errors import PrevisError
from .camera import read_camera
from .changes import ChangeTracker
from .context import Context, Placement, Translation
from .diagnostics import quiet_diagnostics
from .field import GridCache, GridRequest, LoadedGrid, fetch_grid, grid_request, is_current, named_file, outer_file
from .geometry import GeometryCache
from .instancing import is_visible_purpose, prototype_path, read_point_instancer
from .light import is_light, read_light
from .material import bound_material, is_volume_only
from .mesh import read_mesh
from .primitives import is_primitive
from .render_settings import RenderSettings, read_knobs, render_settings_of, settings_prim
from .values import numpy_matrix, time_code
from .variation import Variation
from .volume import USED_FIELDS, read_homogeneous_shape, read_volume

#: A light whose radius is more than this part of the scene's diagonal is noted as reduced to its centre.
LARGE_LIGHT = 0.05

#: Names of the space that the pictures are made in: linear Rec.709.
RENDERING_COLOR_SPACES = ("lin_rec709", "lin_rec709_scene", "lin_srgb")

_MEDIUM_SHAPES = ("Cube", "Sphere", "Capsule")

Time = float | Usd.TimeCode | None
Progress = Callable[[float, str], None]


class StageReader:
    """Translates one stage at any time, remembering what it read.

    `purposes` are the purposes shown besides "default". `mask` limits the reading to these prims and what is below
    them; materials elsewhere still count. With `keep_going` a volume whose field cannot be read is left out with a
    note instead of failing the reading. `render_settings` is the RenderSettings prim to follow instead of the stage's
    own choice. `opening_notes` are said besides those of the reading. `counters` counts the work done so far: "prims"
    translated, "grids" read from files, "geometry" built.
    """

    def __init__(
        self,
        stage: Usd.Stage,
        purposes: Iterable[str] = ("default", "render"),
        mask: Iterable[str] | None = None,
        keep_going: bool = False,
        render_settings: str | None = None,
    ) -> None:
        self.stage = stage
        self._settings_path = render_settings
        self._settings_prim: tuple[int, Usd.Prim | None] | None = None
        self.keep_going = keep_going
        self.counters: Counter[str] = Counter()
        self._purposes = frozenset(purposes) | {"default"}
        self._mask = Usd.StagePopulationMask(list(mask)) if mask is not None else None
        self._grids = GridCache(self.counters)
        self._geometries = GeometryCache(self.counters)
        self._tracker = ChangeTracker(stage)
        self._prims: list[Usd.Prim] | None = None
        self._translations: dict[Sdf.Path, Translation] = {}
        self._time: Usd.TimeCode | None = None
        self._stage_notes: list[Note] = []
        self._scene: SceneDescription | None = None
        self._recheck = False
        self.opening_notes: tuple[Note, ...] = ()

    @property
    def pending(self) -> bool:
        """Whether the stage changed since it was last read."""
        return self._tracker.pending

    @property
    def structure(self) -> int:
        """A number that moves when prims come, go, are shown or hidden or may have become something else."""
        return self._tracker.structure

    @property
    def purposes(self) -> frozenset[str]:
        """The purposes shown."""
        return self._purposes

    def close(self) -> None:
        """Stop listening to the stage and drop everything read."""
        self._tracker.close()
        self._translations.clear()
        self._prims = self._scene = None

    def render_settings(self) -> RenderSettings | None:
        """What the stage's RenderSettings say, None where there are none.

        Raises `PrevisError` when those asked for do not exist.
        """
        prim = self.settings_prim()
        return render_settings_of(prim) if prim is not None else None

    def settings_prim(self) -> Usd.Prim | None:
        """The RenderSettings prim that is followed, see `render_settings.settings_prim`."""
        if self._settings_prim is None or self._settings_prim[0] != self.structure:
            self._settings_prim = self.structure, settings_prim(self.stage, self._settings_path)
        return self._settings_prim[1]

    def knobs(self) -> dict[str, Any]:
        """The knobs of `previs.settings.TABLE` that the stage authors; what is wrong with others is in the notes."""
        return read_knobs(self.stage, self.settings_prim())[0]

    def read(self, time: Time = None, progress: Progress | None = None) -> SceneDescription:
        """Everything in the stage at a time code that a renderer may use.

        `time` is a number, a Usd.TimeCode, None for the earliest time (as usdrecord renders a stage without frames),
        or NaN for USD's default time, which knows no animation. Raises `PrevisError`, one line that names the prim,
        the file and the cause, when a volume cannot be read and the reader does not keep going.

        `progress` is called before each prim that is read with the done part in [0, 1], measured by the sizes of
        files, and the prim's path. What it raises ends the reading; what was read is kept for the next one.
        """
        with quiet_diagnostics():
            return self._read(time_code(time), progress)

    def grid_requests(self, time: Time = None) -> tuple[GridRequest, ...]:
        """The grids that the picture at a time takes from files, to be fetched by another thread.

        Volumes that are not visible now are left out, files that do not exist too.
        """
        code = time_code(time)
        requests: dict[GridRequest, None] = {}
        with quiet_diagnostics():
            for path, field in self._field_prims().items():
                prim = self.stage.GetPrimAtPath(path)
                if not prim or not prim.IsA(UsdVol.OpenVDBAsset):
                    continue
                try:
                    requests[grid_request(prim, code, field)] = None
                except PrevisError:
                    # Said by the reading of that time.
                    continue
        return tuple(requests)

    def fetch(self, request: GridRequest) -> LoadedGrid:
        """Read the grid of a request into the cache; for any thread, without touching the stage.

        The result has the `key` and `grid` of the `Field` that a later reading gives. Raises `PrevisError`, which
        names the prim, the file and the cause.
        """
        return fetch_grid(request, self._grids)

    def is_fetched(self, request: GridRequest) -> bool:
        """Whether the grid of a request is in memory, as its file is now."""
        return self._grids.holds(request.file, request.name, request.index)

    def files(self) -> tuple[str, ...]:
        """The files of the picture: layers, and the .vdb files of the time read last, missing ones too."""
        found: dict[str, None] = {}
        with quiet_diagnostics():
            for layer in self.stage.GetUsedLayers():
                if layer.realPath:
                    found[outer_file(layer.realPath)] = None
            time = self._time if self._time is not None else Usd.TimeCode.EarliestTime()
            for path in self._field_prims():
                prim = self.stage.GetPrimAtPath(path)
                file = named_file(prim, time) if prim and prim.IsA(UsdVol.OpenVDBAsset) else None
                if file:
                    found[file] = None
        return tuple(found)

    def recheck_files(self) -> None:
        """Read again, next time, what came from .vdb files that changed since or could not be read."""
        self._grids.forget_changed()
        self._recheck = True

    def _field_prims(self) -> dict[Sdf.Path, str]:
        """The field prims that are read, with the names of their relationships; all that may be read for a volume that
        was not read yet."""
        paths: dict[Sdf.Path, str] = {}
        for out in self._translations.values():
            paths.update(sorted(out.fields.items()))
        if self._prims is None:
            self._prims = list(self._interesting_prims())
            self._stage_notes = self._notes_of_stage()
        for prim in self._prims:
            # After a change that was not read yet some are gone.
            if prim and prim.IsA(UsdVol.Volume) and prim.GetPath() not in self._translations:
                fields = UsdVol.Volume(prim).GetFieldPaths()
                used = [name for name in fields if name in USED_FIELDS or "density" not in fields]
                paths.update({Sdf.Path(fields[name]): name for name in used})
        return paths

    def _notes_of_stage(self) -> list[Note]:
        return [*self._composition_notes(), *self._color_space_notes()]

    def _read(self, time: Usd.TimeCode, progress: Progress | None) -> SceneDescription:
        if not self._drop_stale(time) and self._scene is not None:
            return self._scene
        self._scene = None
        context = Context(
            self.stage,
            time,
            UsdGeom.XformCache(time),
            self._grids,
            self._geometries,
            self.counters,
            self._purposes,
            self.keep_going,
        )
        self._grids.begin()
        try:
            translations = self._translate_all(context, progress)
            for out in translations:
                for key in out.grid_files:
                    self._grids.use(key)
        finally:
            self._grids.end()
        scene = self._merge(translations)
        self._geometries.keep({m.geometry.key for m in scene.meshes.values()})
        self._scene = scene
        return scene

    def _translate_all(self, context: Context, progress: Progress | None) -> list[Translation]:
        if self._prims is None:
            self._prims = list(self._interesting_prims())
            self._stage_notes = self._notes_of_stage()
        sizes = self._unread_bytes(context.time) if progress is not None else {}
        total = sum(sizes.values()) + len(self._prims)
        done = 0
        translations = []
        for prim in self._prims:
            path = prim.GetPath()
            out = self._translations.get(path)
            if out is None:
                if progress is not None:
                    progress(done / total, str(path))
                out = self._translate(prim, context)
                # Kept only when complete: a failing prim is tried again by the next reading.
                self._translations[path] = out
            done += 1 + sizes.get(path, 0)
            translations.append(out)
        return translations

    def _unread_bytes(self, time: Usd.TimeCode) -> dict[Sdf.Path, int]:
        """How much there is to read for each Volume that is not read yet, by the sizes of files."""
        sizes: dict[Sdf.Path, int] = {}
        for prim in self._prims or ():
            if not prim.IsA(UsdVol.Volume) or prim.GetPath() in self._translations:
                continue
            targets = (self.stage.GetPrimAtPath(path) for path in UsdVol.Volume(prim).GetFieldPaths().values())
            files = {named_file(t, time) for t in targets if t and t.IsA(UsdVol.OpenVDBAsset)}
            sizes[prim.GetPath()] = sum(os.path.getsize(f) for f in files if f and os.path.isfile(f))
        return sizes

    def _drop_stale(self, time: Usd.TimeCode) -> bool:
        """Forget what the changes and the time make stale; whether there is anything to read."""
        changes = self._tracker.take()
        if changes:
            self._geometries.forget(changes)
        if changes.resynced or changes.everything:
            self._prims = None
        known = len(self._translations)
        if self._recheck:
            self._recheck = False
            self._drop(out for out in self._translations.values() if _rewritten(out) or _misses_something(out))
        dirty, last_time, self._time = list(changes.properties), self._time, time
        from_or_to_default = last_time is not None and time.IsDefault() != last_time.IsDefault()
        if changes.resynced or changes.everything or from_or_to_default:
            self._translations.clear()
        else:
            self._drop(out for out in self._translations.values() if out.stale(dirty))
            if time != last_time:
                variation = Variation(self.stage)
                self._drop(out for out in self._translations.values() if variation.varies(out) or _rewritten(out))
        return bool(changes) or len(self._translations) < known

    def _drop(self, translations: Iterable[Translation]) -> None:
        for out in list(translations):
            del self._translations[out.path]

    def _interesting_prims(self) -> Iterator[Usd.Prim]:
        """Prims that may give records, in the order of the stage; those under PointInstancers belong to them."""
        predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
        walk = iter(Usd.PrimRange(self.stage.GetPseudoRoot(), predicate))
        for prim in walk:
            if prim.IsPseudoRoot():
                continue
            if self._mask is not None and not self._mask.IncludesSubtree(prim.GetPath()):
                if not self._mask.Includes(prim.GetPath()):
                    walk.PruneChildren()
                continue
            if prim.IsA(UsdGeom.PointInstancer):
                walk.PruneChildren()
            if _gives_something(prim):
                yield prim

    def _composition_notes(self) -> Iterator[Note]:
        for error in self.stage.GetCompositionErrors():
            site = getattr(error, "rootSite", None)
            path = str(site.path) if site is not None else "/"
            yield Note("missing", path, " ".join(str(error).split()))

    def _color_space_notes(self) -> Iterator[Note]:
        settings = self.render_settings()
        name = settings.color_space if settings else None
        if name and name not in RENDERING_COLOR_SPACES:
            yield Note("ignored", settings.path, f"renderingColorSpace {name}: colours are taken as linear Rec.709")

    def _translate(self, prim: Usd.Prim, context: Context) -> Translation:
        self.counters["prims"] += 1
        out = Translation(prim.GetPath())
        out.depend(prim)
        if prim.IsA(UsdGeom.Camera):
            read_camera(prim, context, out)
            return out
        imageable = UsdGeom.Imageable(prim)
        if imageable and imageable.ComputeVisibility(context.time) == UsdGeom.Tokens.invisible:
            return out
        if not is_visible_purpose(prim, context):
            return out
        matrix = numpy_matrix(context.xforms.GetLocalToWorldTransform(prim))
        _translate_placed(prim, Placement.single(matrix), context, out)
        return out

    def _merge(self, translations: list[Translation]) -> SceneDescription:
        volumes: dict[str, Volume] = {}
        lights: dict[str, Light] = {}
        meshes: dict[str, Mesh] = {}
        cameras: dict[str, Camera] = {}
        notes = dict.fromkeys(
            (*self.opening_notes, *self._stage_notes, *read_knobs(self.stage, self.settings_prim())[1])
        )
        for out in translations:
            for records, target in ((out.volumes, volumes), (out.lights, lights), (out.meshes, meshes)):
                for record in records:
                    _insert(target, record, out.path)
            for camera in out.cameras:
                cameras[camera.path] = camera
            # A material shared by many prims is reported once.
            notes.update(dict.fromkeys(out.notes))
        scene = SceneDescription(
            volumes,
            lights,
            meshes,
            cameras,
            (),
            "Z" if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else "Y",
        )
        notes.update(dict.fromkeys(_subdivision_notes(translations)))
        notes.update(dict.fromkeys(_large_light_notes(scene)))
        return replace(scene, notes=tuple(notes))


def _gives_something(prim: Usd.Prim) -> bool:
    """Whether a prim can give records or notes: groups, materials and fields cannot."""
    kinds = (UsdGeom.Gprim, UsdVol.Volume, UsdGeom.PointInstancer, UsdGeom.Camera, UsdLux.LightFilter)
    return any(prim.IsA(kind) for kind in kinds) or prim.GetTypeName() == "SkelRoot" or is_light(prim)


def _translate_placed(prim: Usd.Prim, placement: Placement, context: Context, out: Translation) -> None:
    """Translate a visible prim at its places, whatever it is."""
    if prim.IsA(UsdGeom.PointInstancer):
        read_point_instancer(prim, placement, context, out, _translate_placed)
        return
    if prim.IsA(UsdVol.Volume):
        read_volume(prim, placement, context, out)
    elif prim.GetTypeName() in _MEDIUM_SHAPES and _is_medium(prim, out):
        read_homogeneous_shape(prim, placement, context, out)
    elif prim.IsA(UsdGeom.Mesh) or is_primitive(prim):
        read_mesh(prim, placement, context, out)
    elif prim.IsA(UsdGeom.Gprim):
        out.note("ignored", prim, f"{prim.GetTypeName()} prims are not shown")
    elif prim.GetTypeName() == "SkelRoot":
        out.note("approximated", prim, "skinning is not evaluated: meshes are shown as authored")
    elif prim.IsA(UsdLux.LightFilter):
        out.note("ignored", prim, "light filters are not modelled")
    elif prim.IsA(UsdGeom.Camera) and placement.instancer is not None:
        out.note("ignored", prim, "a camera inside a prototype")
    # A mesh with MeshLightAPI is both.
    if is_light(prim):
        read_light(prim, placement, context, out)


def _rewritten(out: Translation) -> bool:
    """Whether a file of voxels is another one than when it was read."""
    return not all(is_current(key, file) for key, file in out.grid_files.items())


def _misses_something(out: Translation) -> bool:
    """Whether a file or prim was missing or damaged when it was read."""
    return any(note.kind == "missing" for note in out.notes)


def _is_medium(prim: Usd.Prim, out: Translation) -> bool:
    material = bound_material(prim, Translation(out.path))
    return material is not None and is_volume_only(material)


def _insert(target: dict[str, Volume] | dict[str, Light] | dict[str, Mesh], record, owner: Sdf.Path) -> None:
    """Add a record; one that another instancer of the same prototype made already gets a path of its own."""
    path = record.path
    if path in target:
        path = prototype_path(path, owner)
    target[path] = record if path == record.path else replace(record, path=path)


def _subdivision_notes(translations: list[Translation]) -> list[Note]:
    """One note for all subdivision surfaces: nearly every mesh is one by the schema's default."""
    paths = [out.path for out in translations if out.subdivided]
    if not paths:
        return []
    what = "a subdivision surface is" if len(paths) == 1 else f"{len(paths)} subdivision surfaces are"
    return [Note("approximated", str(paths[0]), f"{what} shown as control cage, smoothly shaded")]


def _large_light_notes(scene: SceneDescription) -> list[Note]:
    lights = [
        light
        for light in scene.lights.values()
        if light.kind == "sphere" and not light.treat_as_point and light.world_radius > 0.0
    ]
    bounds = scene.world_bounds() if lights else None
    if bounds is None:
        return []
    diagonal = float(np.linalg.norm(bounds[1] - bounds[0]))
    return [
        Note(
            "approximated",
            light.path,
            f"lights media from its centre; its radius {light.world_radius:.4g} is "
            f"{100.0 * light.world_radius / diagonal:.0f} % of the scene's diagonal",
        )
        for light in lights
        if diagonal > 0.0 and light.world_radius > LARGE_LIGHT * diagonal
    ]
