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
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdUtils, UsdVol

from ..description import Camera, Medium, SceneDescription
from ..errors import PrevisError
from ..stage import StageReader, default_camera, find_camera, open_stage
from ..stage.context import Translation
from ..stage.diagnostics import quiet_diagnostics
from ..stage.field import GridCache, read_field
from ..stage.material import bound_material, is_volume_only, read_medium
from ..stage.opening import FilePath
from ..stage.values import time_code
from .arguments import Vector, checked_vector, looking
from .attributes import place, set_value
from .building import SceneBuilder
from .light import author_light
from .medium import author_medium, medium_values
from .saving import export
from .voxels import VoxelFiles, field_arrays, index_transform


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
    ) -> Scene:
        """Open a USD file.

        `session_layer` is a layer file over the stage, such as one written by `save_overrides`. `mask` limits the
        stage to these prim paths; `variants` maps prim paths to {variant set: variant}. `purposes` are shown
        besides "default". With `keep_going` volumes that cannot be read are left out with a note instead of
        failing `describe`. Raises `PrevisError` when a file or prim is missing or damaged.
        """
        scene = cls.__new__(cls)
        stage = open_stage(path, session_layer, mask, variants)
        stage.SetEditTarget(stage.GetSessionLayer())
        scene._set_up(stage, StageReader(stage, purposes, keep_going=keep_going), opened=True)
        return scene

    def _set_up(self, stage: Usd.Stage, reader: StageReader, opened: bool) -> None:
        self._stage: Usd.Stage | None = stage
        self._reader = reader
        self._opened = opened
        self._voxel_files = VoxelFiles()

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

    def describe(self, time: float | None = None) -> SceneDescription:
        """The scene as the renderer sees it, at a time code (None: the earliest; NaN: USD's default time).

        Only what changed since the last call is read again. Raises `PrevisError` when a volume cannot be read.
        """
        _ = self.stage
        return self._reader.read(time)

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
        prim = self._volume_prim(path)
        out = Translation(prim.GetPath())
        with quiet_diagnostics():
            return read_medium(prim, bound_material(prim, out), time_code(time), out)

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
        prim = self._volume_prim(path)
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
            author_medium(self._volume_prim(path), checked, time)

    def set_light(self, path: str, *, time: float | None = None, **values: Any) -> None:
        """Change a light.

        The names are those of the USD inputs in Python spelling: intensity, exposure, color, color_temperature
        (kelvin; switches the temperature on), enable_color_temperature, normalize, angle, radius, width, height,
        length, treat_as_point, cone_angle, cone_softness, focus, focus_tint, casts_shadows; and visible (bool),
        position (world), direction (world, where the light travels). `time` as in `set_medium`; position, direction
        and visible are set for all times. Raises ValueError for an unknown name or a bad value, `PrevisError` for a
        path without light.
        """
        prim = self._editable_prim(path, "light")
        if not prim.HasAPI(UsdLux.LightAPI):
            raise PrevisError(f"{path}: is not a light")
        position, direction = values.pop("position", None), values.pop("direction", None)
        visible = values.pop("visible", None)
        author_light(prim, values, time)
        if visible is not None:
            attribute = UsdGeom.Imageable(prim).CreateVisibilityAttr()
            set_value(attribute, UsdGeom.Tokens.inherited if visible else UsdGeom.Tokens.invisible, None)
        if position is not None or direction is not None:
            world = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time_code(None)), float)
            if direction is not None:
                world = looking(world[3, :3], direction)
            if position is not None:
                world[3, :3] = checked_vector("position", position)
            parent = np.array(UsdGeom.Xformable(prim).ComputeParentToWorldTransform(time_code(None)), float)
            place(UsdGeom.Xformable(prim), world @ np.linalg.inv(parent))

    def remove(self, path: str) -> None:
        """Take a prim and what is below it out of the scene; one that a file holds is deactivated instead of deleted.

        Raises `PrevisError` when there is no such prim, or when it belongs to a native instance.
        """
        prim = self._editable_prim(path, "prim")
        layer = self.stage.GetEditTarget().GetLayer()
        if any(spec.layer != layer for spec in prim.GetPrimStack()):
            prim.SetActive(False)
        else:
            self.stage.RemovePrim(prim.GetPath())

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

        Voxels added since go to .vdb files beside it. Raises ValueError for a scene that was not opened from a file
        (use `save`), and what `save` raises.
        """
        if not self._opened:
            raise ValueError("the scene was not opened from a file: save() writes all of it")
        with quiet_diagnostics():
            # The file may be the very session layer that the stage was opened with: its content and the edits become
            # one layer.
            edits = Usd.Stage.Open(self.stage.GetSessionLayer(), load=Usd.Stage.LoadNone)
            export(UsdUtils.FlattenLayerStack(edits), Path(path), self._voxel_files)

    def close(self) -> None:
        """Release the stage and remove the temporary voxel files. Closing twice does nothing."""
        if self._stage is not None:
            self._reader.close()
            self._stage = None
        self._voxel_files.close()

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _editable_prim(self, path: str, what: str) -> Usd.Prim:
        """The prim at a path; that of a record of an instance is its prototype's."""
        plain = str(path).split("[", 1)[0]
        valid = Sdf.Path.IsValidPathString(plain) and Sdf.Path(plain).IsAbsolutePath()
        prim = self.stage.GetPrimAtPath(plain) if valid else None
        if not prim:
            raise PrevisError(f"{path}: no such {what} in the scene")
        if prim.IsInstanceProxy():
            raise PrevisError(f"{path}: belongs to a native instance, which cannot be edited on its own")
        return prim

    def _volume_prim(self, path: str) -> Usd.Prim:
        prim = self._editable_prim(path, "volume")
        if not prim.IsA(UsdVol.Volume):
            material = bound_material(prim, Translation(prim.GetPath()))
            if material is None or not is_volume_only(material):
                raise PrevisError(f"{path}: is neither a Volume nor a shape with a medium")
        return prim
