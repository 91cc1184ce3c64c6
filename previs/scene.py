"""Scenes in Python: open a stage or build one from arrays, edit it, save it.

A `Scene` is a USD stage and nothing besides: every method here authors USD, so whatever it does can be saved, composed
and read by any other program. NumPy volumes are written as .vdb files in a temporary folder that the Scene owns, so
they take the one way into the renderer that files take.

Conventions: arrays of voxels are indexed [x, y, z]; matrices are 4×4 and act on row vectors; colours are linear RGB,
given as three numbers or one; lengths are stage units; angles are degrees. A bad argument raises ValueError, a bad
file or prim `PrevisError`, both with one sentence.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdShade, UsdUtils, UsdVol, Vt

from . import vdb
from .description import PHASES, Camera, Color, Medium, SceneDescription
from .errors import PrevisError
from .stage import StageReader, default_camera, find_camera, open_stage
from .stage.context import Translation
from .stage.diagnostics import quiet_diagnostics
from .stage.field import GridCache, read_field
from .stage.material import PREVIS_VOLUME, bound_material, is_volume_only, previs_volume_shader, read_medium
from .stage.opening import FilePath
from .stage.polygons import smooth_normals, triangulate
from .stage.values import time_code

_COLORS = ("extinction", "albedo", "scattering", "absorption", "emission")
_RANGES = {
    "density_scale": (0.0, np.inf),
    "extinction": (0.0, np.inf),
    "albedo": (0.0, 1.0),
    "scattering": (0.0, np.inf),
    "absorption": (0.0, np.inf),
    "anisotropy": (-1.0, 1.0),
    "anisotropy2": (-1.0, 1.0),
    "lobe_mix": (0.0, 1.0),
    "emission": (0.0, np.inf),
    "emission_scale": (0.0, np.inf),
    "temperature_scale": (-np.inf, np.inf),
    "temperature_offset": (-np.inf, np.inf),
}
_MEDIUM_NAMES = (*(f.name for f in fields(Medium)), "scattering", "absorption")
_LIGHT_ATTRIBUTES: dict[str, tuple[str, Sdf.ValueTypeName]] = {
    "intensity": ("inputs:intensity", Sdf.ValueTypeNames.Float),
    "exposure": ("inputs:exposure", Sdf.ValueTypeNames.Float),
    "color": ("inputs:color", Sdf.ValueTypeNames.Color3f),
    "color_temperature": ("inputs:colorTemperature", Sdf.ValueTypeNames.Float),
    "enable_color_temperature": ("inputs:enableColorTemperature", Sdf.ValueTypeNames.Bool),
    "normalize": ("inputs:normalize", Sdf.ValueTypeNames.Bool),
    "angle": ("inputs:angle", Sdf.ValueTypeNames.Float),
    "radius": ("inputs:radius", Sdf.ValueTypeNames.Float),
    "width": ("inputs:width", Sdf.ValueTypeNames.Float),
    "height": ("inputs:height", Sdf.ValueTypeNames.Float),
    "length": ("inputs:length", Sdf.ValueTypeNames.Float),
    "treat_as_point": ("treatAsPoint", Sdf.ValueTypeNames.Bool),
    "cone_angle": ("inputs:shaping:cone:angle", Sdf.ValueTypeNames.Float),
    "cone_softness": ("inputs:shaping:cone:softness", Sdf.ValueTypeNames.Float),
    "focus": ("inputs:shaping:focus", Sdf.ValueTypeNames.Float),
    "focus_tint": ("inputs:shaping:focusTint", Sdf.ValueTypeNames.Color3f),
    "casts_shadows": ("inputs:shadow:enable", Sdf.ValueTypeNames.Bool),
}
_SHAPING = ("cone_angle", "cone_softness", "focus", "focus_tint")
_FILE_ENDINGS = (".usda", ".usd", ".usdc")

Vector = Sequence[float] | np.ndarray


class Scene:
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
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._files = 0

    # --- looking ----------------------------------------------------------------------------------------------

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

    # --- volumes ----------------------------------------------------------------------------------------------

    def add_volume(
        self,
        path: str,
        density: ArrayLike,
        *,
        bounds: tuple[Vector, Vector] | None = None,
        transform: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        emission: ArrayLike | Color | float | None = None,
        **medium: Any,
    ) -> str:
        """Add a volume of voxels; returns its prim path.

        `density` is (X, Y, Z), real numbers ≥ 0; `temperature` (kelvin, before the medium's scale and offset) and
        `emission` have the same shape. Three numbers or one as `emission` are the medium's emission colour instead,
        as for `set_medium`, which takes the colour besides a field.

        `bounds` = (lo, hi) is the box that the voxels' cells fill: voxel i along an axis of n voxels has its centre,
        where its value sits, at lo + (i + ½)·(hi − lo)/n. Between centres the field is trilinear, and it falls to 0
        over one voxel beyond the outermost centres. `transform` is the 4×4 matrix from indices to the volume's space
        instead. Without either, voxels are 1 wide and centred on the origin.
        The keywords of `set_medium` may follow. Raises ValueError for a wrong shape, type, path or medium value.
        """
        if emission is not None and _is_color(emission):
            medium, emission = {**medium, "emission": emission}, None
        values = _medium_values(medium)
        arrays = _field_arrays(density, temperature, emission)
        matrix = _index_transform(arrays["density"].shape, bounds, transform)
        volume = UsdVol.Volume.Define(self.stage, self._new_path(path))
        self._author_voxels(volume, arrays, matrix)
        if values:
            self._author_medium(volume.GetPrim(), values, None)
        return str(volume.GetPath())

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
        arrays = _field_arrays(density, temperature, emission)
        prim = self._volume_prim(path)
        if not prim.IsA(UsdVol.Volume):
            raise PrevisError(f"{path}: is a homogeneous shape, which has no voxels")
        volume = UsdVol.Volume(prim)
        if transform is None and bounds is None and volume.HasFieldRelationship("density"):
            asset = self.stage.GetPrimAtPath(volume.GetFieldPath("density"))
            transform = read_field(asset, time_code(None), GridCache(Counter()))[0].grid.index_to_world
        matrix = _index_transform(arrays["density"].shape, bounds, transform)
        self._author_voxels(volume, arrays, matrix)

    def add_box_medium(
        self,
        path: str,
        bounds: tuple[Vector, Vector] = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        *,
        transform: ArrayLike | None = None,
        **medium: Any,
    ) -> str:
        """Add a homogeneous box of density 1; returns its prim path.

        `bounds` = (lo, hi) in the box's own space, `transform` 4×4 from there to the world. The keywords of
        `set_medium` may follow. Raises ValueError for bounds without thickness and for bad values.
        """
        values = _medium_values(medium)
        lo, hi = _box(bounds)
        matrix = np.diag([*(hi - lo), 1.0])
        matrix[3, :3] = 0.5 * (lo + hi)
        cube = UsdGeom.Cube.Define(self.stage, self._new_path(path))
        cube.CreateSizeAttr(1.0)
        cube.CreateExtentAttr([(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)])
        _place(cube, matrix @ _affine(transform))
        self._author_medium(cube.GetPrim(), values, None)
        return str(cube.GetPath())

    def add_sphere_medium(
        self,
        path: str,
        radius: float = 1.0,
        center: Vector = (0.0, 0.0, 0.0),
        *,
        transform: ArrayLike | None = None,
        **medium: Any,
    ) -> str:
        """Add a homogeneous sphere of density 1; returns its prim path.

        `radius` > 0 and `center` in the sphere's own space, `transform` 4×4 from there to the world. The keywords
        of `set_medium` may follow. Raises ValueError for bad values.
        """
        values = _medium_values(medium)
        matrix = np.eye(4)
        matrix[3, :3] = _vector("center", center)
        size = _positive("radius", radius)
        sphere = UsdGeom.Sphere.Define(self.stage, self._new_path(path))
        sphere.CreateRadiusAttr(size)
        sphere.CreateExtentAttr([(-size,) * 3, (size,) * 3])
        _place(sphere, matrix @ _affine(transform))
        self._author_medium(sphere.GetPrim(), values, None)
        return str(sphere.GetPath())

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
        checked = _medium_values(values)
        if checked:
            self._author_medium(self._volume_prim(path), checked, time)

    # --- meshes -----------------------------------------------------------------------------------------------

    def add_mesh(
        self,
        path: str,
        points: ArrayLike,
        faces: ArrayLike | Sequence[Sequence[int]],
        *,
        color: Vector | float | None = None,
        normals: ArrayLike | None = None,
        smooth: bool = False,
        transform: ArrayLike | None = None,
    ) -> str:
        """Add a polygon mesh; returns its prim path.

        `points` (V, 3); `faces` (F, 3), (F, 4) or a list of index lists, counter-clockwise from outside. `color` is
        the diffuse colour (default 0.18), or (V, 3) colours. `normals` (V, 3), or `smooth` to have them computed;
        else the faces are flat. `transform` 4×4 local to world. Raises ValueError for wrong shapes or indices.
        """
        vertices = _rows("points", points)
        counts, indices = _polygons(faces, len(vertices))
        colors = None if color is None else _mesh_colors(color, len(vertices))
        if normals is not None:
            vertex_normals = _rows("normals", normals)
            if len(vertex_normals) != len(vertices):
                raise ValueError(f"normals: {len(vertex_normals)} for {len(vertices)} points")
        elif smooth:
            corners, _ = triangulate(vertices, counts, indices, counts >= 3)
            vertex_normals = smooth_normals(vertices, indices[corners])
        else:
            vertex_normals = None
        placement = _affine(transform)
        mesh = UsdGeom.Mesh.Define(self.stage, self._new_path(path))
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices.astype(np.int32)))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        # As we show every mesh, for other programs.
        mesh.CreateDoubleSidedAttr(True)
        extent = np.array([vertices.min(axis=0), vertices.max(axis=0)], np.float32)
        mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent))
        if vertex_normals is not None:
            mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(vertex_normals.astype(np.float32)))
            mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        if colors is not None:
            kind = UsdGeom.Tokens.constant if len(colors) == 1 else UsdGeom.Tokens.vertex
            mesh.CreateDisplayColorPrimvar(kind).Set(Vt.Vec3fArray.FromNumpy(colors.astype(np.float32)))
        _place(mesh, placement)
        return str(mesh.GetPath())

    def add_ground(
        self,
        path: str = "/ground",
        height: float = 0.0,
        size: float = 100.0,
        color: Vector | float | None = None,
    ) -> str:
        """Add a square of that `size` (stage units) across the up axis at a `height`; returns its prim path."""
        half = 0.5 * _positive("size", size)
        u, v = (0, 1) if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else (2, 0)
        points = np.full((4, 3), float(height))
        for i, (a, b) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)]):
            points[i, u], points[i, v] = a * half, b * half
        return self.add_mesh(path, points, [[0, 1, 2, 3]], color=color)

    # --- lights -----------------------------------------------------------------------------------------------

    def add_distant_light(
        self,
        path: str,
        direction: Vector = (0.0, -1.0, 0.0),
        *,
        irradiance: float | None = None,
        intensity: float | None = None,
        color: Vector | float = (1.0, 1.0, 1.0),
        angle: float = 0.53,
        casts_shadows: bool = True,
    ) -> str:
        """Add a sun; returns its prim path.

        `direction` is where the light travels. `irradiance` (default 1) is what a plane across that direction
        receives, whatever the `angle` (apparent diameter, degrees, 0 to 180); `intensity` sets the radiance of the
        sun's disk instead, as the USD attribute does. Raises ValueError for both, and for bad values.
        """
        values = _brightness("irradiance", irradiance, 1.0, intensity)
        light = UsdLux.DistantLight.Define(self.stage, self._new_path(path))
        self._author_light(light.GetPrim(), {**values, "color": color, "angle": angle}, None)
        return self._finish_light(light, casts_shadows, _looking((0.0, 0.0, 0.0), direction))

    def add_sphere_light(
        self,
        path: str,
        position: Vector = (0.0, 0.0, 0.0),
        *,
        radiant_intensity: float | None = None,
        intensity: float | None = None,
        radius: float = 0.1,
        color: Vector | float = (1.0, 1.0, 1.0),
        casts_shadows: bool = True,
    ) -> str:
        """Add a light bulb; returns its prim path.

        `position` in the world, `radius` ≥ 0 in stage units. `radiant_intensity` I (default 1) gives an irradiance
        of I/d² at the distance d, whatever the radius; `intensity` sets the radiance of its surface instead, as the
        USD attribute does. Raises ValueError for both, and for bad values.
        """
        # Normalised, a sphere of any radius has the radiant intensity L/4.
        strength = None if radiant_intensity is None else 4.0 * radiant_intensity
        values = _brightness("radiant_intensity", strength, 4.0, intensity)
        light = UsdLux.SphereLight.Define(self.stage, self._new_path(path))
        self._author_light(light.GetPrim(), {**values, "color": color, "radius": radius}, None)
        if radius == 0.0:
            light.CreateTreatAsPointAttr(True)
        matrix = np.eye(4)
        matrix[3, :3] = _vector("position", position)
        return self._finish_light(light, casts_shadows, matrix)

    def add_spot_light(
        self,
        path: str,
        position: Vector,
        target: Vector,
        *,
        radiant_intensity: float | None = None,
        intensity: float | None = None,
        cone_angle: float = 30.0,
        cone_softness: float = 0.1,
        focus: float = 0.0,
        radius: float = 0.0,
        color: Vector | float = (1.0, 1.0, 1.0),
        casts_shadows: bool = True,
    ) -> str:
        """Add a sphere light with a cone about its axis; returns its prim path.

        It shines from `position` towards `target`, both in the world. `cone_angle` is the half angle (0 to 180),
        `cone_softness` in [0, 1] the part of it over which the light fades; `focus` ≥ 0 narrows it by cosθ^focus.
        Brightness as for `add_sphere_light`, on the axis. Raises ValueError for bad values.
        """
        matrix = _looking(position, _vector("target", target) - _vector("position", position))
        strength = None if radiant_intensity is None else 4.0 * radiant_intensity
        values = _brightness("radiant_intensity", strength, 4.0, intensity)
        light = UsdLux.SphereLight.Define(self.stage, self._new_path(path))
        values |= {"color": color, "radius": radius, "cone_angle": cone_angle, "cone_softness": cone_softness}
        self._author_light(light.GetPrim(), {**values, "focus": focus}, None)
        if radius == 0.0:
            light.CreateTreatAsPointAttr(True)
        return self._finish_light(light, casts_shadows, matrix)

    def add_dome_light(self, path: str, *, intensity: float = 1.0, color: Vector | float = (1.0, 1.0, 1.0)) -> str:
        """Add a uniform environment of radiance `intensity` · `color`; returns its prim path."""
        light = UsdLux.DomeLight.Define(self.stage, self._new_path(path))
        self._author_light(light.GetPrim(), {"intensity": intensity, "color": color}, None)
        return str(light.GetPath())

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
        self._author_light(prim, values, time)
        if visible is not None:
            attribute = UsdGeom.Imageable(prim).CreateVisibilityAttr()
            _set_value(attribute, UsdGeom.Tokens.inherited if visible else UsdGeom.Tokens.invisible, None)
        if position is not None or direction is not None:
            world = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time_code(None)), float)
            if direction is not None:
                world = _looking(world[3, :3], direction)
            if position is not None:
                world[3, :3] = _vector("position", position)
            parent = np.array(UsdGeom.Xformable(prim).ComputeParentToWorldTransform(time_code(None)), float)
            _place(UsdGeom.Xformable(prim), world @ np.linalg.inv(parent))

    # --- cameras ----------------------------------------------------------------------------------------------

    def add_camera(
        self,
        path: str,
        position: Vector,
        target: Vector,
        *,
        up: Vector | None = None,
        focal_length: float = 50.0,
        horizontal_aperture: float = 36.0,
        vertical_aperture: float = 20.25,
        orthographic_width: float | None = None,
        clipping_range: tuple[float, float] = (0.01, 1.0e6),
    ) -> str:
        """Add a camera at `position` that looks at `target`, both in the world; returns its prim path.

        `up` defaults to the stage's up axis. `focal_length` and apertures are in millimetres, only their ratios
        matter. `orthographic_width` (stage units) makes it orthographic, with that width of view. Raises ValueError
        for a target at the position and for bad values.
        """
        matrix = _looking(position, _vector("target", target) - _vector("position", position), up, self._up())
        numbers = {
            "focal_length": _positive("focal_length", focal_length),
            "horizontal_aperture": _positive("horizontal_aperture", horizontal_aperture),
            "vertical_aperture": _positive("vertical_aperture", vertical_aperture),
        }
        near, far = (float(c) for c in clipping_range)
        if not 0.0 < near < far:
            raise ValueError(f"clipping_range must increase from above 0, not {clipping_range}")
        camera = UsdGeom.Camera.Define(self.stage, self._new_path(path))
        if orthographic_width is not None:
            camera.CreateProjectionAttr(UsdGeom.Tokens.orthographic)
            # Orthographic apertures are tenths of a stage unit.
            scale = 10.0 * _positive("orthographic_width", orthographic_width) / numbers["horizontal_aperture"]
            numbers["horizontal_aperture"] *= scale
            numbers["vertical_aperture"] *= scale
        camera.CreateFocalLengthAttr(numbers["focal_length"])
        camera.CreateHorizontalApertureAttr(numbers["horizontal_aperture"])
        camera.CreateVerticalApertureAttr(numbers["vertical_aperture"])
        camera.CreateClippingRangeAttr(Gf.Vec2f(near, far))
        _place(camera, matrix)
        return str(camera.GetPath())

    # --- the stage --------------------------------------------------------------------------------------------

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
            self._export(stage.Flatten(False) if composed else root, Path(path))

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
            self._export(UsdUtils.FlattenLayerStack(edits), Path(path))

    def close(self) -> None:
        """Release the stage and remove the temporary voxel files. Closing twice does nothing."""
        if self._stage is not None:
            self._reader.close()
            self._stage = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # --- authoring --------------------------------------------------------------------------------------------

    def _new_path(self, path: str) -> Sdf.Path:
        """A legal prim path that is still free; ``smoke`` means ``/smoke``."""
        text = path if str(path).startswith("/") else f"/{path}"
        if not Sdf.Path.IsValidPathString(text) or not Sdf.Path(text).IsPrimPath():
            raise ValueError(f"{path!r} is not a prim path: names of letters, digits and _, such as /world/smoke")
        prim_path = Sdf.Path(text)
        prim = self.stage.GetPrimAtPath(prim_path)
        if prim and prim.IsDefined():
            raise ValueError(f"{prim_path}: there is a prim at this path already")
        for parent in prim_path.GetParentPath().GetPrefixes():
            above = self.stage.GetPrimAtPath(parent)
            if not above or not above.IsDefined():
                UsdGeom.Xform.Define(self.stage, parent)
        return prim_path

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

    def _new_file(self, name: str) -> str:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="previs-scene-")
        self._files += 1
        return os.path.join(self._folder.name, f"{name}_{self._files}.vdb")

    def _up(self) -> np.ndarray:
        return np.eye(3)[2 if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else 1]

    def _author_voxels(self, volume: UsdVol.Volume, arrays: Mapping[str, np.ndarray], matrix: np.ndarray) -> None:
        """Write the arrays to a file and point the volume's fields to it."""
        file = self._new_file(volume.GetPrim().GetName())
        grids = [vdb.Grid.from_dense(name, array, matrix) for name, array in arrays.items()]
        vdb.write(file, grids, compression="none")
        for name in arrays:
            if not volume.HasFieldRelationship(name):
                volume.CreateFieldRelationship(name, volume.GetPath().AppendChild(name))
            asset = UsdVol.OpenVDBAsset.Define(self.stage, volume.GetFieldPath(name))
            before = asset.CreateFilePathAttr().Get()
            _set_value(asset.GetFilePathAttr(), Sdf.AssetPath(file), None)
            _set_value(asset.CreateFieldNameAttr(), name, None)
            if asset.GetFieldIndexAttr().HasAuthoredValue():
                _set_value(asset.GetFieldIndexAttr(), 0, None)
            asset.CreateFieldDataTypeAttr("float")
            asset.CreateFieldClassAttr("fogVolume")
            if before is not None and self._owns(before.path) and not self._refers_to(volume, before.path):
                os.remove(before.path)
        corners = _grid_extent(arrays["density"].shape, matrix)
        volume.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, c)) for c in corners]))

    def _owns(self, file: str) -> bool:
        """Whether a file is one of the Scene's temporary ones."""
        if self._folder is None or not os.path.isfile(file):
            return False
        return os.path.dirname(os.path.realpath(file)) == os.path.realpath(self._folder.name)

    def _refers_to(self, volume: UsdVol.Volume, file: str) -> bool:
        """Whether another field of the volume still uses a file."""
        fields = (UsdVol.OpenVDBAsset(self.stage.GetPrimAtPath(p)) for p in volume.GetFieldPaths().values())
        paths = (asset.GetFilePathAttr().Get() for asset in fields if asset)
        return any(p is not None and p.path == file for p in paths)

    def _author_medium(self, prim: Usd.Prim, values: dict[str, Any], time: float | None) -> None:
        out = Translation(prim.GetPath())
        material = bound_material(prim, out)
        shader = previs_volume_shader(material, out) if material else None
        if shader is None:
            shader = self._bind_new_medium(prim)
        elif shader.GetPrim().IsInstanceProxy():
            raise PrevisError(f"{shader.GetPath()}: belongs to a native instance, which cannot be edited on its own")
        values = dict(values)
        pairs = (("extinction", "albedo"), ("scattering", "absorption"))
        for pair, other in (pairs, pairs[::-1]):
            if any(n in values for n in pair) and any(_drives(shader, n) for n in other):
                # One parametrisation takes the place of the other; what is not set keeps its present value.
                current = read_medium(prim, bound_material(prim, out), time_code(time), out)
                for name in pair:
                    values.setdefault(name, getattr(current, name))
                for name in other:
                    _unset(_producer(shader, name))
        for name, value in values.items():
            attribute = _producer(shader, name)
            if attribute is None:
                kind = (
                    Sdf.ValueTypeNames.Token
                    if name == "phase"
                    else Sdf.ValueTypeNames.Color3f
                    if name in _COLORS
                    else Sdf.ValueTypeNames.Float
                )
                attribute = shader.CreateInput(name, kind).GetAttr()
            _set_value(attribute, Gf.Vec3f(*value) if name in _COLORS else value, time)

    def _bind_new_medium(self, prim: Usd.Prim) -> UsdShade.Shader:
        """Make a material with a PrevisVolume shader below the prim and bind it for every purpose."""
        path = prim.GetPath().AppendChild("PrevisMedium")
        material = UsdShade.Material.Define(self.stage, path)
        shader = UsdShade.Shader.Define(self.stage, path.AppendChild("Volume"))
        shader.CreateIdAttr(PREVIS_VOLUME)
        shader.CreateOutput("out", Sdf.ValueTypeNames.Token)
        material.CreateVolumeOutput().ConnectToSource(shader.ConnectableAPI(), "out")
        binding = UsdShade.MaterialBindingAPI.Apply(prim)
        binding.Bind(material)
        bound, _ = binding.ComputeBoundMaterial(UsdShade.Tokens.preview)
        if bound.GetPath() != path:
            # A binding for previews only, or one that overrides its descendants, is stronger.
            binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, UsdShade.Tokens.preview)
            bound, _ = binding.ComputeBoundMaterial(UsdShade.Tokens.preview)
        if bound.GetPath() != path:
            raise PrevisError(
                f"{prim.GetPath()}: its material {bound.GetPath()} is bound by a prim above it, which wins"
            )
        return shader

    def _author_light(self, prim: Usd.Prim, values: Mapping[str, Any], time: float | None) -> None:
        checked = {}
        for name, value in values.items():
            if name not in _LIGHT_ATTRIBUTES:
                known = ", ".join((*_LIGHT_ATTRIBUTES, "visible", "position", "direction"))
                raise ValueError(f"{name} is not a value of a light; there are: {known}")
            checked[name] = _light_value(name, value)
        if "color_temperature" in checked:
            checked.setdefault("enable_color_temperature", True)
        if any(name in checked for name in _SHAPING) and not prim.HasAPI(UsdLux.ShapingAPI):
            UsdLux.ShapingAPI.Apply(prim)
        if "casts_shadows" in checked and not prim.HasAPI(UsdLux.ShadowAPI):
            UsdLux.ShadowAPI.Apply(prim)
        for name, value in checked.items():
            attribute_name, kind = _LIGHT_ATTRIBUTES[name]
            attribute = prim.GetAttribute(attribute_name) or prim.CreateAttribute(attribute_name, kind, False)
            _set_value(attribute, value, time)

    def _finish_light(self, light: UsdGeom.Xformable, casts_shadows: bool, matrix: np.ndarray) -> str:
        if not casts_shadows:
            self._author_light(light.GetPrim(), {"casts_shadows": False}, None)
        _place(light, matrix)
        return str(light.GetPath())

    def _export(self, layer: Sdf.Layer, path: Path) -> None:
        """Write a layer with relative asset paths, and the Scene's own voxel files beside it."""
        if path.suffix not in _FILE_ENDINGS:
            raise ValueError(f"{path}: a scene is saved as {', '.join(_FILE_ENDINGS)}")
        folder = path.absolute().parent
        if not folder.is_dir():
            raise PrevisError(f"{folder}: no such folder to save in")
        copy = Sdf.Layer.CreateAnonymous(path.suffix)
        copy.TransferContent(layer)
        voxels: dict[str, str] = {}

        def relocate(asset_path: str) -> str:
            absolute = os.path.realpath(asset_path)
            if self._owns(asset_path):
                stem = Path(asset_path).name.rsplit("_", 1)[0]
                voxels.setdefault(absolute, _unique(f"{path.stem}_{stem}", set(voxels.values())))
                return f"./{voxels[absolute]}"
            # In a layer without a folder a relative path is relative to the working folder.
            if os.path.isabs(asset_path) or os.path.exists(asset_path):
                return os.path.relpath(os.path.abspath(asset_path), folder)
            return asset_path

        UsdUtils.ModifyAssetPaths(copy, relocate)
        try:
            with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=folder) as beside:
                for source, name in voxels.items():
                    vdb.write(os.path.join(beside, name), vdb.read(source))
                written = os.path.join(beside, path.name)
                if not copy.Export(written):
                    raise PrevisError(f"{path}: cannot be written")
                for name in voxels.values():
                    os.replace(os.path.join(beside, name), folder / name)
                os.replace(written, path)
            loaded = Sdf.Layer.Find(str(path.absolute()))
            if loaded is not None:
                # USD hands out the layer in memory for as long as anybody holds it.
                loaded.Reload(True)
        except OSError as error:
            raise PrevisError(f"{path}: cannot be written: {error.strerror or error}") from error
        except Tf.ErrorException as error:
            raise PrevisError(f"{path}: cannot be written") from error


# --- attributes -----------------------------------------------------------------------------------------------


def _producer(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    """The attribute that an edit of a shader's input must set: its own, or that of the interface it is connected to."""
    shader_input = shader.GetInput(name)
    if not shader_input:
        return None
    produced = UsdShade.Utils.GetValueProducingAttributes(shader_input)
    if produced and not UsdShade.Output.IsOutput(produced[0]):
        return produced[0]
    if shader_input.HasConnectedSource():
        source = shader_input.GetConnectedSources()[0]
        interface = source[0].source.GetInput(source[0].sourceName) if source else None
        if interface:
            return interface.GetAttr()
        # Driven by another shader: the edit replaces the connection.
        shader_input.ClearSources()
    return shader_input.GetAttr()


def _drives(shader: UsdShade.Shader, name: str) -> bool:
    shader_input = shader.GetInput(name)
    return bool(shader_input) and bool(UsdShade.Utils.GetValueProducingAttributes(shader_input))


def _unset(attribute: Usd.Attribute | None) -> None:
    """Make an attribute valueless, in this layer or, where a weaker one has a value, by blocking it."""
    if attribute is not None:
        attribute.Clear()
        if attribute.HasAuthoredValue():
            attribute.Block()


def _set_value(attribute: Usd.Attribute, value: Any, time: float | None) -> None:
    """Set a value for all times, or one sample of an animated attribute."""
    if time is None:
        if attribute.GetNumTimeSamples():
            # Samples in the same layer would hide the default.
            attribute.Clear()
        attribute.Set(value)
        return
    # Samples of one layer hide those of weaker ones altogether, so the others come along.
    samples = {t: attribute.Get(t) for t in attribute.GetTimeSamples()}
    if not samples:
        attribute.Set(value)
        return
    samples[float(time)] = value
    for sample_time, sample in samples.items():
        attribute.Set(sample, sample_time)


def _place(prim: UsdGeom.Xformable, matrix: np.ndarray) -> None:
    """Set the whole local transform."""
    identity = np.array_equal(matrix, np.eye(4))
    if identity and not UsdGeom.Xformable(prim).GetOrderedXformOps():
        return
    UsdGeom.Xformable(prim).MakeMatrixXform().Set(Gf.Matrix4d(np.asarray(matrix, float).tolist()))


# --- checks of arguments --------------------------------------------------------------------------------------


def _medium_values(values: Mapping[str, Any]) -> dict[str, Any]:
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if name not in _MEDIUM_NAMES:
            raise ValueError(f"{name} is not a value of a medium; there are: {', '.join(_MEDIUM_NAMES)}")
        if name == "phase":
            if value not in PHASES:
                raise ValueError(f"phase must be one of {', '.join(PHASES)}, not {value!r}")
            checked[name] = str(value)
            continue
        checked[name] = _color(name, value) if name in _COLORS else _number(name, value)
        lower, upper = _RANGES[name]
        numbers = np.atleast_1d(checked[name])
        if numbers.min() < lower or numbers.max() > upper:
            bounds = f"in [{lower:g}, {upper:g}]" if np.isfinite(upper) else f"at least {lower:g}"
            raise ValueError(f"{name} must be {bounds}, not {value}")
    alternatives = {"scattering", "absorption"} & checked.keys()
    if alternatives and {"extinction", "albedo"} & checked.keys():
        raise ValueError("give either extinction and albedo, or scattering and absorption")
    return checked


def _light_value(name: str, value: Any) -> Any:
    kind = _LIGHT_ATTRIBUTES[name][1]
    if kind == Sdf.ValueTypeNames.Bool:
        return bool(value)
    if kind == Sdf.ValueTypeNames.Color3f:
        return Gf.Vec3f(*_color(name, value))
    number = _number(name, value)
    if number < 0.0 and name != "exposure":
        raise ValueError(f"{name} must be at least 0, not {value}")
    if name == "cone_softness" and number > 1.0:
        raise ValueError(f"{name} must be in [0, 1], not {value}")
    return number


def _brightness(name: str, strength: float | None, default: float, intensity: float | None) -> dict[str, Any]:
    """The USD inputs for a light given by its strength (normalised) or by its surface's radiance."""
    if strength is not None and intensity is not None:
        raise ValueError(f"give either {name} or intensity")
    if intensity is not None:
        return {"intensity": intensity}
    return {"intensity": default if strength is None else strength, "normalize": True}


def _number(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number, not {value!r}") from None
    if not np.isfinite(number):
        raise ValueError(f"{name} must be finite, not {number}")
    return number


def _positive(name: str, value: Any) -> float:
    number = _number(name, value)
    if number <= 0.0:
        raise ValueError(f"{name} must be above 0, not {number:g}")
    return number


def _vector(name: str, value: Any) -> np.ndarray:
    try:
        vector = np.asarray(value, float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{name} must be three finite numbers, not {value!r}")
    return vector


def _color(name: str, value: Any) -> Color:
    if np.ndim(value) == 0:
        return (_number(name, value),) * 3
    return tuple(float(c) for c in _vector(name, value))


def _is_color(value: Any) -> bool:
    """Whether a value has the form of a colour, three numbers or one, which no array of voxels has."""
    try:
        return np.shape(value) in ((), (3,))
    except ValueError:  # a ragged list
        return False


def _voxels(name: str, array: ArrayLike) -> np.ndarray:
    voxels = np.asarray(array)
    if voxels.ndim != 3 or voxels.size == 0:
        raise ValueError(f"{name} must be an array of shape (X, Y, Z), not {voxels.shape}")
    if voxels.dtype.kind not in "fiub":
        raise ValueError(f"{name} must hold real numbers, not {voxels.dtype}")
    return voxels


def _field_arrays(
    density: ArrayLike, temperature: ArrayLike | None, emission: ArrayLike | None
) -> dict[str, np.ndarray]:
    """The voxels by field name, checked."""
    arrays = {"density": _voxels("density", density)}
    for name, array in (("temperature", temperature), ("emission", emission)):
        if array is not None:
            arrays[name] = _voxels(name, array)
            if arrays[name].shape != arrays["density"].shape:
                shapes = f"{arrays[name].shape}, density {arrays['density'].shape}"
                raise ValueError(f"{name} has the shape {shapes}: they must be equal")
    return arrays


def _box(bounds: tuple[Vector, Vector]) -> tuple[np.ndarray, np.ndarray]:
    if len(bounds) != 2:
        raise ValueError("bounds must be two corners, (lo, hi)")
    lo, hi = _vector("bounds[0]", bounds[0]), _vector("bounds[1]", bounds[1])
    if not np.all(hi > lo):
        raise ValueError(f"bounds have no thickness: {lo.tolist()} to {hi.tolist()}")
    return lo, hi


def _affine(transform: ArrayLike | None) -> np.ndarray:
    if transform is None:
        return np.eye(4)
    matrix = np.asarray(transform, float)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise ValueError("transform must be a finite 4×4 matrix")
    if not np.array_equal(matrix[:, 3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError("transform must act on row vectors: translation in its last row, last column 0 0 0 1")
    return matrix


def _index_transform(
    shape: tuple[int, ...], bounds: tuple[Vector, Vector] | None, transform: ArrayLike | None
) -> np.ndarray:
    """Index space to local space."""
    if transform is not None:
        if bounds is not None:
            raise ValueError("give either bounds or transform")
        matrix = _affine(transform)
        if np.linalg.det(matrix[:3, :3]) == 0.0:
            raise ValueError("transform is singular: the volume would have no thickness")
        return matrix
    size = np.array(shape, float)
    lo, hi = _box(bounds) if bounds is not None else (-0.5 * size, 0.5 * size)
    step = (hi - lo) / size
    matrix = np.diag([*step, 1.0])
    matrix[3, :3] = lo + 0.5 * step
    return matrix


def _grid_extent(shape: tuple[int, ...], matrix: np.ndarray) -> np.ndarray:
    """Local box (2, 3) of everything the field can reach: one voxel beyond the outermost centres."""
    corners = np.array([[(-1.0, n)[(i >> a) & 1] for a, n in enumerate(shape)] for i in range(8)])
    placed = corners @ matrix[:3, :3] + matrix[3, :3]
    return np.array([placed.min(axis=0), placed.max(axis=0)])


def _rows(name: str, values: ArrayLike) -> np.ndarray:
    array = np.asarray(values, float)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0 or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be finite numbers of shape (V, 3), not {array.shape}")
    return array


def _polygons(faces: Any, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """(counts, indices), checked."""
    rows = [np.asarray(face) for face in faces]
    if not rows or any(r.ndim != 1 or len(r) < 3 or r.dtype.kind not in "iu" for r in rows):
        raise ValueError("faces must be lists of at least three point indices")
    indices = np.concatenate(rows).astype(np.int64)
    if indices.min() < 0 or indices.max() >= n_points:
        raise ValueError(f"faces point outside the {n_points} points")
    return np.array([len(r) for r in rows]), indices


def _mesh_colors(color: Any, n_points: int) -> np.ndarray:
    if np.ndim(color) == 2:
        colors = _rows("color", color)
        if len(colors) != n_points:
            raise ValueError(f"color: {len(colors)} colours for {n_points} points")
        return colors
    return np.array([_color("color", color)])


def _looking(position: Any, direction: Any, up: Any = None, default_up: Vector = (0.0, 1.0, 0.0)) -> np.ndarray:
    """A rigid transform whose −Z axis points along a direction."""
    forward = _vector("direction", direction)
    length = np.linalg.norm(forward)
    if length == 0.0:
        raise ValueError("there is no direction from the position to the target")
    back = -forward / length
    upward = _vector("up", default_up if up is None else up)
    right = np.cross(upward, back)
    if np.linalg.norm(right) < 1e-6 * max(np.linalg.norm(upward), 1e-300):
        # Looking along up: any other axis will do.
        right = np.cross(np.eye(3)[int(np.argmin(np.abs(back)))], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3] = right, np.cross(back, right), back
    matrix[3, :3] = _vector("position", position)
    return matrix


def _unique(stem: str, taken: set[str]) -> str:
    name, number = f"{stem}.vdb", 2
    while name in taken:
        name, number = f"{stem}_{number}.vdb", number + 1
    return name
