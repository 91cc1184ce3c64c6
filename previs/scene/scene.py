"""Scenes in Python: open a stage or build one from arrays, edit it, save it.

A `Scene` is a USD stage and nothing besides: every method here authors USD, so whatever it does can be saved, composed
and read by any other program. NumPy volumes are written as .vdb files in a temporary folder that the Scene owns, so
they take the one way into the renderer that files take.

Conventions: arrays of voxels are indexed [x, y, z]; matrices are 4×4 and act on row vectors; colours are linear RGB,
given as three numbers or one; lengths are stage units; angles are degrees. A bad argument raises ValueError, a bad
file or prim `PrevisError`, both with one sentence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from numpy.typing import ArrayLike
from pxr import Usd, UsdGeom, UsdVol

from ..description import Camera, Medium, SceneDescription
from ..errors import PrevisError
from ..settings import Settings
from ..stage import StageReader, default_camera, find_camera, open_stage
from ..stage.diagnostics import quiet_diagnostics
from ..stage.field import GridCache, read_field
from ..stage.light import is_light
from ..stage.opening import FilePath
from ..stage.render_settings import read_knobs
from ..stage.values import time_code
from .arguments import Vector
from .bare_vdb import furnish, is_bare_vdb, layer_of
from .building import SceneBuilder
from .files import missing_layers, overrides_for, read_overrides, reload_layers
from .knobs import author_setting, known_setting, reset_settings
from .light import (
    LightValues,
    author_light,
    default_light_values,
    light_is_animated,
    light_values,
    place_light,
    require_light,
    reset_light,
)
from .medium import author_medium, medium_at, medium_is_animated, medium_values, reset_medium
from .outline import OutlineItem, outline, set_visible
from .overrides import Edits
from .prims import editable_prim, existing_prim, find_prim, plain_path, require_volume
from .saving import export
from .timing import TimeRange, time_range
from .voxels import VoxelFiles, field_arrays, index_transform

T = TypeVar("T")


class Scene(SceneBuilder):
    """A stage to build, edit, render and save.

    >>> with Scene() as scene:
    ...     scene.add_volume("/smoke", density, extinction=(4, 4, 4))
    ...     scene.add_distant_light("/sun", direction=(1, -2, 0), irradiance=3)
    ...     description = scene.describe()

    `Scene()` makes an empty stage in memory; `up_axis` is "Y" (default) or "Z". `Scene.open` reads a file. Edits of an
    opened file go to the stage's session layer and never change the file. `close` (or leaving the `with` block)
    removes the temporary voxel files; the scene cannot be used afterwards.
    """

    def __init__(self, up_axis: str = "Y") -> None:
        if up_axis not in ("Y", "Z"):
            raise ValueError(f'up_axis must be "Y" or "Z", not {up_axis!r}')
        stage = Usd.Stage.CreateInMemory("scene.usda")
        UsdGeom.SetStageUpAxis(stage, up_axis)
        self._set_up(stage, StageReader(stage), opened=False)

    @classmethod
    def open(
        cls,
        path: FilePath,
        session_layer: FilePath | None = None,
        *,
        mask: Iterable[str] | str | None = None,
        variants: Mapping[str, Mapping[str, str]] | None = None,
        purposes: Iterable[str] = ("default", "render"),
        keep_going: bool = False,
        render_settings: str | None = None,
    ) -> Scene:
        """Open a USD file, or a .vdb file on a default stage in memory with a sun, a ground and a camera.

        `session_layer` is a layer file over the stage, such as one written by `save_overrides`. `mask` limits the
        stage to these prim paths; `variants` maps prim paths to {variant set: variant}. `purposes` are shown
        besides "default". With `keep_going` volumes that cannot be read are left out with a note instead of
        failing `describe`. `render_settings` is the RenderSettings prim to follow instead of the stage's own
        choice. Raises `PrevisError` when a file or prim is missing or damaged.
        """
        scene = cls.__new__(cls)
        bare = is_bare_vdb(path)
        stage = open_stage(path, session_layer, mask, variants, layer_of(path) if bare else None)
        stage.SetEditTarget(stage.GetSessionLayer())
        reader = StageReader(stage, purposes, None, keep_going, render_settings)
        scene._set_up(stage, reader, opened=True)
        if bare:
            scene._bare = True
            reader.opening_notes = (furnish(stage, reader, path),)
        return scene

    def _set_up(self, stage: Usd.Stage, reader: StageReader, opened: bool) -> None:
        self._stage: Usd.Stage | None = stage
        self._reader = reader
        self._opened = opened
        self._bare = False
        self._voxel_files = VoxelFiles()
        self._edits = Edits(stage, opened)
        self._known: dict[str, Any] = {}
        self._known_structure = -1

    @property
    def stage(self) -> Usd.Stage:
        """The stage itself, for whatever is not offered here. Raises ValueError after `close`."""
        if self._stage is None:
            raise ValueError("the scene is closed")
        return self._stage

    @property
    def reader(self) -> StageReader:
        """The reader behind `describe`; its `counters` tell what was read."""
        return self._reader

    def describe(
        self, time: float | None = None, progress: Callable[[float, str], None] | None = None
    ) -> SceneDescription:
        """The scene as the renderer sees it, at a time code (None: the earliest; NaN: USD's default time).

        Only what changed since the last call is read again. `progress` is called before each prim that is read, with
        the done part in [0, 1] and the prim's path; what it raises ends the reading, and the next one goes on from
        there. Raises `PrevisError` when a volume cannot be read.
        """
        _ = self.stage
        return self._reader.read(time, progress)

    def camera(self, name: str | None = None, time: float | None = None) -> Camera | None:
        """A camera by prim path or name; without a name the stage's default one, None where it has no camera.

        Raises `PrevisError`, which lists the cameras, for an unknown name.
        """
        scene = self.describe(time)
        if name is not None:
            return find_camera(scene, name)
        settings = self._reader.render_settings()
        return default_camera(scene, settings.camera if settings else None)

    def medium(self, path: str, time: float | None = None) -> Medium:
        """The medium of a volume, as it is read from its material. Raises `PrevisError` for a path without volume."""
        prim = require_volume(existing_prim(self.stage, path, "volume"))
        with quiet_diagnostics():
            return medium_at(prim, time)

    def authored_medium(self, path: str, time: float | None = None) -> Medium:
        """The medium of a volume without the edits; PrevisVolume's defaults where they made the volume.

        Raises `PrevisError` for a path without volume.
        """
        require_volume(existing_prim(self.stage, path, "volume"))
        prim = find_prim(self._edits.stage_without, path)
        with quiet_diagnostics():
            return medium_at(prim, time) if prim is not None else Medium()

    def light_values(self, path: str, time: float | None = None) -> LightValues:
        """The numbers that are authored on a light. Raises `PrevisError` for a path without light."""
        return light_values(require_light(existing_prim(self.stage, path, "light")), time)

    def authored_light(self, path: str, time: float | None = None) -> LightValues:
        """The numbers that are authored on a light without the edits; schema defaults where they made the light.

        Raises `PrevisError` for a path without light.
        """
        present = require_light(existing_prim(self.stage, path, "light"))
        prim = find_prim(self._edits.stage_without, path)
        if prim is None or not is_light(prim):
            return default_light_values(present.GetTypeName())
        return light_values(prim, time)

    def is_animated(self, path: str, name: str) -> bool:
        """Whether a value of a medium or a light changes over time, by its name in `set_medium` or `set_light`.

        An edit of such a value at a `time` keeps the rest of the animation; one without hides it. Raises
        `PrevisError` for a path with neither, ValueError for an unknown name.
        """
        prim = existing_prim(self.stage, path, "volume or light")
        if is_light(prim):
            return light_is_animated(prim, name)
        return medium_is_animated(require_volume(prim), name)

    @property
    def time_range(self) -> TimeRange | None:
        """The time codes that the stage covers, None when nothing in it is animated."""
        return self._remembered("time range", lambda: time_range(self.stage))

    def outline(self, time: float | None = None) -> tuple[OutlineItem, ...]:
        """The volumes, lights, meshes and cameras in the order of the stage, also those that are invisible."""
        key = f"outline at {time_code(time)}"
        return self._remembered(key, lambda: outline(self.stage, self._reader.purposes, time))

    def prim_path(self, path: str) -> str:
        """The path in the outline of what a record of a description, such as an instance, was made from."""
        prim = find_prim(self.stage, path)
        return str(prim.GetPath()) if prim is not None else plain_path(path)

    def set_voxels(
        self,
        path: str,
        density: ArrayLike,
        *,
        bounds: tuple[Vector, Vector] | None = None,
        transform: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        emission: ArrayLike | None = None,
    ) -> None:
        """Give a Volume other voxels, for all times, as a simulation does after every step.

        The arrays, `bounds` and `transform` as for `add_volume`; with neither, the voxels take the place of the present
        ones: the transform stays as it is. A field that is not given stays as it is too. Raises ValueError for a
        wrong shape or type, `PrevisError` for a path without Volume, or whose present field cannot be read.
        """
        arrays = field_arrays(density, temperature, emission)
        prim = require_volume(editable_prim(self.stage, path, "volume"))
        if not prim.IsA(UsdVol.Volume):
            raise PrevisError(f"{path}: is a homogeneous shape, which has no voxels")
        volume = UsdVol.Volume(prim)
        if transform is None and bounds is None and volume.HasFieldRelationship("density"):
            asset = self.stage.GetPrimAtPath(volume.GetFieldPath("density"))
            transform = read_field(asset, time_code(None), GridCache(Counter()))[0].grid.index_to_world
        matrix = index_transform(arrays["density"].shape, bounds, transform)
        self._voxel_files.author(volume, arrays, matrix)

    def set_medium(self, path: str, *, time: float | None = None, **values: Any) -> None:
        """Change the medium of a volume; a material shared with other volumes changes for them too.

        | name | values | meaning |
        |---|---|---|
        | density_scale | ≥ 0 | multiplies the density field |
        | extinction | colour ≥ 0 | σt per stage unit and unit of density |
        | albedo | colour in [0, 1] | σs/σt |
        | scattering, absorption | colours ≥ 0 | σs and σa, instead of extinction and albedo |
        | anisotropy | [−1, 1] | g, forward where positive (kept inside ±0.999) |
        | phase | isotropic, hg, schlick, rayleigh, two_lobe | the phase function |
        | anisotropy2, lobe_mix | [−1, 1], [0, 1] | second lobe of two_lobe and its weight |
        | emission | colour ≥ 0 | emitted radiance (multiplied by σa) |
        | emission_scale | ≥ 0 | multiplies it |
        | temperature_scale, temperature_offset | any | kelvin = field · scale + offset |

        Where the bound material has no PrevisVolume shader, one is made and bound. `time` None sets the value for
        all times, an animation included; a number sets an animated value at that time code and keeps the rest.
        Raises ValueError for an unknown name or a value out of range, `PrevisError` for a path without volume.
        """
        checked = medium_values(values)
        if checked:
            author_medium(require_volume(editable_prim(self.stage, path, "volume")), checked, time)

    def set_light(self, path: str, *, time: float | None = None, **values: Any) -> None:
        """Change a light.

        The names are those of the USD inputs in Python spelling: intensity, exposure, color, color_temperature
        (kelvin; switches the temperature on), enable_color_temperature, normalize, angle, radius, width, height,
        length, treat_as_point, cone_angle, cone_softness, focus, focus_tint, casts_shadows; and visible (bool),
        position (world), direction (world, where the light travels). `time` as in `set_medium`; position, direction
        and visible are set for all times. Raises ValueError for an unknown name or a bad value, `PrevisError` for a
        path without light, or for one that stays hidden (see `set_visible`).
        """
        prim = editable_prim(self.stage, path, "light")
        if not is_light(prim):
            raise PrevisError(f"{path}: is not a light")
        position, direction = values.pop("position", None), values.pop("direction", None)
        visible = values.pop("visible", None)
        author_light(prim, values, time)
        if visible is not None:
            self.set_visible(path, bool(visible))
        if position is not None or direction is not None:
            place_light(prim, position, direction)

    def set_visible(self, path: str, visible: bool) -> None:
        """Show or hide a prim and what is below it, for all times.

        Raises `PrevisError` for a prim that stays hidden, since one above it is invisible, which it names.
        """
        prim = editable_prim(self.stage, path, "prim")
        authored = find_prim(self._edits.stage_without, path) if self._opened else None
        set_visible(prim, authored, self._edits.layer, visible)
        self._edits.prune()

    def reset_medium(self, path: str, *names: str) -> None:
        """Take the edits of these values of a medium back, of all where none is named.

        The names are those of `set_medium`. Of extinction and albedo, or scattering and absorption, what is not
        named stays as it is. Raises ValueError for an unknown name or a scene that was not opened from a file,
        `PrevisError` for a path without volume.
        """
        self._require_opened()
        prim = require_volume(editable_prim(self.stage, path, "volume"))
        reset_medium(self._edits.layer, prim, self._authored_prim(path), names)
        self._edits.prune()

    def reset_light(self, path: str, *names: str) -> None:
        """Take the edits of these values of a light back, of all where none is named.

        The names are those of `set_light`. Raises ValueError for an unknown name or a scene that was not opened from
        a file, `PrevisError` for a path without light.
        """
        self._require_opened()
        prim = require_light(editable_prim(self.stage, path, "light"))
        reset_light(self._edits.layer, prim, self._authored_prim(path), names)
        self._edits.prune()

    def settings(self, overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """All knobs of `previs.settings.TABLE`: the `overrides`, else what the stage says, else the defaults.

        The stage says it by attributes `previs:<name>` of its RenderSettings prim or of `/Render/previs`; those that
        are no knobs or have no legal value are in the notes of `describe`. Raises ValueError for an unknown or
        illegal override, `PrevisError` when the RenderSettings asked for do not exist.
        """
        _ = self.stage
        return dict(Settings(**{**self._reader.knobs(), **(overrides or {})}))

    def authored_settings(self) -> dict[str, Any]:
        """All knobs as `settings` without the edits."""
        stage, prim = self._edits.stage_without, self._reader.settings_prim()
        before = stage.GetPrimAtPath(prim.GetPath()) if prim is not None else None
        return dict(Settings(**read_knobs(stage, before or None)[0]))

    def set_setting(self, name: str, value: Any) -> None:
        """Set a knob of `previs.settings.TABLE` on the stage, where `previs record` finds it too.

        It is authored on the stage's RenderSettings prim; without one `/Render/previs` is made. What an opened stage
        says anyway leaves no edit behind. Raises ValueError for an unknown knob or an illegal value.
        """
        checked = known_setting(name).parse(value)
        if self._opened and self.authored_settings()[name] == checked:
            self.reset_settings(name)
        else:
            author_setting(self.stage, self._reader.settings_prim(), name, checked)

    def reset_settings(self, *names: str) -> None:
        """Take the edits of these knobs back, of all where none is named.

        Raises ValueError for an unknown knob, or for a scene that was not opened from a file.
        """
        self._require_opened()
        reset_settings(self._edits.layer, self._reader.settings_prim(), names)
        self._edits.prune()

    def remove(self, path: str) -> None:
        """Take a prim and what is below it out of the scene; one that a file holds is deactivated instead of deleted.

        Raises `PrevisError` when there is no such prim, or when it belongs to a native instance.
        """
        prim = editable_prim(self.stage, path, "prim")
        layer = self.stage.GetEditTarget().GetLayer()
        if any(spec.layer != layer for spec in prim.GetPrimStack()):
            prim.SetActive(False)
        else:
            self.stage.RemovePrim(prim.GetPath())

    def snapshot(self) -> str:
        """All edits as text, for `restore`: what the session layer of an opened scene holds itself, else the scene.

        A session layer that the scene was opened with, and variants chosen then, are no edits. The voxels that the
        scene holds now are kept until `close`, whatever `set_voxels` puts in their place.
        """
        _ = self.stage
        self._voxel_files.keep()
        return self._edits.snapshot()

    def restore(self, snapshot: str) -> None:
        """Put the edits of a `snapshot` in the place of the present ones; only what differs is read again.

        Raises `PrevisError` when the text is no snapshot.
        """
        _ = self.stage
        self._edits.restore(snapshot)

    @property
    def has_overrides(self) -> bool:
        """Whether an opened scene has edits."""
        return self._opened and not self._edits.empty

    def discard_overrides(self) -> None:
        """Take all edits back. Raises ValueError for a scene that was not opened from a file."""
        self._require_opened()
        self._edits.discard()

    def save(self, path: FilePath) -> None:
        """Write the scene to a .usda, .usd or .usdc file, its voxels to .vdb files beside it (zip-compressed).

        Paths in the file are relative. An opened scene is written flattened, with its edits; the other files
        it uses are referred to, not copied. Everything is written beside its place and then renamed: an existing file
        is never left half-written. Raises `PrevisError` when the folder or a file cannot be written, ValueError for
        another ending.
        """
        stage = self.stage
        root = stage.GetRootLayer()
        composed = self._opened or root.subLayerPaths or not stage.GetSessionLayer().empty
        with quiet_diagnostics():
            export(stage.Flatten(False) if composed else root, Path(path), self._voxel_files)

    def save_overrides(self, path: FilePath) -> None:
        """Write the edits of an opened scene, its session layer, to a file that `Scene.open` takes as `session_layer`.

        A session layer that the scene was opened with is part of it, and what the file holds already where the
        stage has it as a sublayer: over the stage the file gives the same picture. Voxels added since go to .vdb
        files beside it. Of a .vdb file, which has no stage to lie over, the whole scene is written, as by `save`.
        Raises ValueError for a scene that was not opened from a file (use `save`), `PrevisError` for
        a file that the stage itself is in, and what `save` raises.
        """
        self._require_opened("save() writes all of it")
        if self._bare:
            self.save(path)
            return
        with quiet_diagnostics():
            export(overrides_for(self.stage, Path(path)), Path(path), self._voxel_files)

    def load_overrides(self, path: FilePath) -> None:
        """Put what a file of overrides holds in the place of the present edits.

        Raises ValueError for a scene that was not opened from a file, `PrevisError` for a file that is missing or
        damaged.
        """
        self._require_opened()
        self._edits.replace(read_overrides(path))

    def files(self) -> tuple[str, ...]:
        """The files that the scene depends on: layers and .vdb files of the time described last, missing ones too."""
        return tuple(dict.fromkeys((*self._reader.files(), *missing_layers(self.stage))))

    def reload(self) -> None:
        """Read again, with the next `describe`, what changed on disk; the edits stay.

        Raises `PrevisError`, which names a layer that is gone or damaged; what was read of it before stays, and the
        others are read all the same.
        """
        stage = self.stage
        self._reader.recheck_files()
        # A stage without the edits does not look for layers that were missing.
        self._edits.close()
        reload_layers(stage)

    def close(self) -> None:
        """Release the stage and remove the temporary voxel files. Closing twice does nothing."""
        if self._stage is not None:
            self._reader.close()
            self._edits.close()
            self._stage = None
        self._voxel_files.close()

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _require_opened(self, instead: str = "there is nothing below its values") -> None:
        _ = self.stage
        if not self._opened:
            raise ValueError(f"the scene was not opened from a file: {instead}")

    def _authored_prim(self, path: str) -> Usd.Prim | None:
        return find_prim(self._edits.stage_without, path)

    def _remembered(self, key: str, compute: Callable[[], T]) -> T:
        """A value that only another structure of the stage changes."""
        structure = self._reader.structure
        _ = self.stage
        if self._known_structure != structure:
            self._known.clear()
            self._known_structure = structure
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]
