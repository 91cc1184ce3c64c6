"""Building a scene from arrays and numbers: volumes, homogeneous shapes, meshes, lights and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdVol, Vt

from ..description import Camera, Color
from ..stage.polygons import smooth_normals, triangulate
from .arguments import (
    Vector,
    checked_box,
    checked_polygons,
    checked_rows,
    checked_transform,
    checked_vector,
    is_color,
    looking,
    mesh_colors,
    positive_number,
)
from .attributes import place
from .light import author_light, brightness, finish_light
from .medium import author_medium, medium_values
from .voxels import VoxelFiles, field_arrays, index_transform


class SceneBuilder:
    """What a `Scene` can be made of. Every method authors one prim, whose path is free so far, and returns its path."""

    stage: Usd.Stage
    _voxel_files: VoxelFiles

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
        if emission is not None and is_color(emission):
            medium, emission = {**medium, "emission": emission}, None
        values = medium_values(medium)
        arrays = field_arrays(density, temperature, emission)
        matrix = index_transform(arrays["density"].shape, bounds, transform)
        volume = UsdVol.Volume.Define(self.stage, self._new_path(path))
        self._voxel_files.author(volume, arrays, matrix)
        if values:
            author_medium(volume.GetPrim(), values, None, keep=False)
        return str(volume.GetPath())

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
        values = medium_values(medium)
        lo, hi = checked_box(bounds)
        matrix = np.diag([*(hi - lo), 1.0])
        matrix[3, :3] = 0.5 * (lo + hi)
        cube = UsdGeom.Cube.Define(self.stage, self._new_path(path))
        cube.CreateSizeAttr(1.0)
        cube.CreateExtentAttr([(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)])
        place(cube, matrix @ checked_transform(transform))
        author_medium(cube.GetPrim(), values, None, keep=False)
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
        values = medium_values(medium)
        matrix = np.eye(4)
        matrix[3, :3] = checked_vector("center", center)
        size = positive_number("radius", radius)
        sphere = UsdGeom.Sphere.Define(self.stage, self._new_path(path))
        sphere.CreateRadiusAttr(size)
        sphere.CreateExtentAttr([(-size,) * 3, (size,) * 3])
        place(sphere, matrix @ checked_transform(transform))
        author_medium(sphere.GetPrim(), values, None, keep=False)
        return str(sphere.GetPath())

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
        vertices = checked_rows("points", points)
        counts, indices = checked_polygons(faces, len(vertices))
        colors = None if color is None else mesh_colors(color, len(vertices))
        if normals is not None:
            vertex_normals = checked_rows("normals", normals)
            if len(vertex_normals) != len(vertices):
                raise ValueError(f"normals: {len(vertex_normals)} for {len(vertices)} points")
        elif smooth:
            corners, _ = triangulate(vertices, counts, indices, counts >= 3)
            vertex_normals = smooth_normals(vertices, indices[corners])
        else:
            vertex_normals = None
        placement = checked_transform(transform)
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
        place(mesh, placement)
        return str(mesh.GetPath())

    def add_ground(
        self,
        path: str = "/ground",
        height: float = 0.0,
        size: float = 100.0,
        color: Vector | float | None = None,
    ) -> str:
        """Add a square of that `size` (stage units) across the up axis at a `height`; returns its prim path."""
        half = 0.5 * positive_number("size", size)
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
        values = brightness("irradiance", irradiance, 1.0, intensity)
        light = UsdLux.DistantLight.Define(self.stage, self._new_path(path))
        author_light(light.GetPrim(), {**values, "color": color, "angle": angle}, None)
        return finish_light(light, casts_shadows, looking((0.0, 0.0, 0.0), direction))

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
        values = brightness("radiant_intensity", strength, 4.0, intensity)
        light = UsdLux.SphereLight.Define(self.stage, self._new_path(path))
        author_light(light.GetPrim(), {**values, "color": color, "radius": radius}, None)
        if radius == 0.0:
            light.CreateTreatAsPointAttr(True)
        matrix = np.eye(4)
        matrix[3, :3] = checked_vector("position", position)
        return finish_light(light, casts_shadows, matrix)

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
        matrix = looking(position, checked_vector("target", target) - checked_vector("position", position))
        strength = None if radiant_intensity is None else 4.0 * radiant_intensity
        values = brightness("radiant_intensity", strength, 4.0, intensity)
        light = UsdLux.SphereLight.Define(self.stage, self._new_path(path))
        values |= {"color": color, "radius": radius, "cone_angle": cone_angle, "cone_softness": cone_softness}
        author_light(light.GetPrim(), {**values, "focus": focus}, None)
        if radius == 0.0:
            light.CreateTreatAsPointAttr(True)
        return finish_light(light, casts_shadows, matrix)

    def add_dome_light(self, path: str, *, intensity: float = 1.0, color: Vector | float = (1.0, 1.0, 1.0)) -> str:
        """Add a uniform environment of radiance `intensity` · `color`; returns its prim path."""
        light = UsdLux.DomeLight.Define(self.stage, self._new_path(path))
        author_light(light.GetPrim(), {"intensity": intensity, "color": color}, None)
        return str(light.GetPath())

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
        matrix = looking(
            position, checked_vector("target", target) - checked_vector("position", position), up, self._up()
        )
        numbers = {
            "focal_length": positive_number("focal_length", focal_length),
            "horizontal_aperture": positive_number("horizontal_aperture", horizontal_aperture),
            "vertical_aperture": positive_number("vertical_aperture", vertical_aperture),
        }
        near, far = (float(c) for c in clipping_range)
        if not 0.0 < near < far:
            raise ValueError(f"clipping_range must increase from above 0, not {clipping_range}")
        camera = UsdGeom.Camera.Define(self.stage, self._new_path(path))
        if orthographic_width is not None:
            camera.CreateProjectionAttr(UsdGeom.Tokens.orthographic)
            # Orthographic apertures are tenths of a stage unit.
            scale = 10.0 * positive_number("orthographic_width", orthographic_width) / numbers["horizontal_aperture"]
            numbers["horizontal_aperture"] *= scale
            numbers["vertical_aperture"] *= scale
        camera.CreateFocalLengthAttr(numbers["focal_length"])
        camera.CreateHorizontalApertureAttr(numbers["horizontal_aperture"])
        camera.CreateVerticalApertureAttr(numbers["vertical_aperture"])
        camera.CreateClippingRangeAttr(Gf.Vec2f(near, far))
        place(camera, matrix)
        return str(camera.GetPath())

    def copy_camera(self, path: str, camera: Camera) -> str:
        """Add a camera that sees just what a `Camera` record does; returns its prim path.

        Raises ValueError for a path that is taken or no prim path.
        """
        prim = UsdGeom.Camera.Define(self.stage, self._new_path(path))
        prim.CreateProjectionAttr(getattr(UsdGeom.Tokens, camera.projection))
        prim.CreateFocalLengthAttr(camera.focal_length)
        prim.CreateHorizontalApertureAttr(camera.horizontal_aperture)
        prim.CreateVerticalApertureAttr(camera.vertical_aperture)
        prim.CreateHorizontalApertureOffsetAttr(camera.horizontal_aperture_offset)
        prim.CreateVerticalApertureOffsetAttr(camera.vertical_aperture_offset)
        prim.CreateClippingRangeAttr(Gf.Vec2f(*camera.clipping_range))
        parent = np.array(UsdGeom.Xformable(prim).ComputeParentToWorldTransform(Usd.TimeCode.EarliestTime()), float)
        place(prim, np.asarray(camera.camera_to_world, float) @ np.linalg.inv(parent))
        return str(prim.GetPath())

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

    def _up(self) -> np.ndarray:
        return np.eye(3)[2 if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else 1]
