"""UsdGeom cameras, and the choice of one."""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from ..description import Camera, SceneDescription
from ..errors import PrevisError
from .context import Context, Translation
from .values import as_float, attribute_value, numpy_matrix

#: The camera that usdrecord takes when none is named.
MAIN_CAMERA = "main_cam"


def read_camera(prim: Usd.Prim, context: Context, out: Translation) -> None:
    """Translate a camera prim. Its transform loses scale and shear; a sheared one is reported."""
    time = context.time

    def positive(name: str, default: float) -> float:
        value = as_float(attribute_value(prim, name, time, default))
        if value is None or value <= 0.0:
            out.note("repaired", prim, f"{name} is not a positive number; {default:g} is used")
            return default
        return value

    def number(name: str) -> float:
        return as_float(attribute_value(prim, name, time, 0.0)) or 0.0

    near_far = attribute_value(prim, "clippingRange", time, (1.0, 1.0e6))
    clipping = (float(near_far[0]), float(near_far[1]))
    if not 0.0 <= clipping[0] < clipping[1]:
        out.note("repaired", prim, f"clippingRange {clipping} is not increasing; (1, 1000000) is used")
        clipping = (1.0, 1.0e6)
    projection = attribute_value(prim, "projection", time, "perspective")
    if projection not in ("perspective", "orthographic"):
        out.note("repaired", prim, f"projection {projection} is unknown; perspective is used")
        projection = "perspective"
    _note_ignored_features(prim, time, out)
    out.cameras.append(
        Camera(
            path=str(prim.GetPath()),
            camera_to_world=_rigid(prim, numpy_matrix(context.xforms.GetLocalToWorldTransform(prim)), out),
            projection=projection,
            focal_length=positive("focalLength", 50.0),
            horizontal_aperture=positive("horizontalAperture", 20.955),
            vertical_aperture=positive("verticalAperture", 15.2908),
            horizontal_aperture_offset=number("horizontalApertureOffset"),
            vertical_aperture_offset=number("verticalApertureOffset"),
            clipping_range=clipping,
        )
    )


def _rigid(prim: Usd.Prim, matrix: np.ndarray, out: Translation) -> np.ndarray:
    """The rotation and translation of a camera's transform: its view direction is kept, then its up direction."""
    rows = matrix[:3, :3]
    back, up = rows[2], rows[1]
    lengths = np.linalg.norm(rows, axis=1)
    result = np.eye(4)
    result[3, :3] = matrix[3, :3]
    if not np.all(np.isfinite(matrix)) or lengths.min() <= 0.0:
        out.note("repaired", prim, "its transform is singular; the camera looks along -Z")
        if not np.all(np.isfinite(result)):
            result = np.eye(4)
        return result
    unit = rows / lengths[:, None]
    if np.abs(unit @ unit.T - np.eye(3)).max() > 1e-4:
        out.note("approximated", prim, "its transform is sheared; the shear is left out")
    elif np.linalg.det(unit) < 0.0:
        out.note("approximated", prim, "its transform mirrors; the mirror is left out")
    back = back / np.linalg.norm(back)
    up = up - back * np.dot(up, back)
    up = up / np.linalg.norm(up)
    result[:3, :3] = np.cross(up, back), up, back
    return result


def _note_ignored_features(prim: Usd.Prim, time: Usd.TimeCode, out: Translation) -> None:
    ignored = []
    if (as_float(attribute_value(prim, "fStop", time, 0.0)) or 0.0) > 0.0:
        ignored.append("depth of field (fStop)")
    if attribute_value(prim, "shutter:open", time, 0.0) != attribute_value(prim, "shutter:close", time, 0.0):
        ignored.append("motion blur (shutter)")
    if attribute_value(prim, "exposure", time, 0.0):
        ignored.append("exposure")
    if len(attribute_value(prim, "clippingPlanes", time, ())) > 0:
        ignored.append("clippingPlanes")
    if ignored:
        out.note("ignored", prim, ", ".join(ignored))


def find_camera(scene: SceneDescription | Usd.Stage, name: str) -> Camera:
    """The camera at a prim path, or the one whose prim has that name.

    `scene` is a description, or a stage (read at its earliest time). Raises `PrevisError`, which lists the cameras
    there are, when there is no such camera or when several have that name.
    """
    cameras = _cameras(scene)
    if name in cameras:
        return cameras[name]
    named = [c for path, c in cameras.items() if Sdf.Path(path).name == name]
    if len(named) == 1:
        return named[0]
    known = ", ".join(cameras) or "none"
    if named:
        raise PrevisError(f"{name}: several cameras have this name; give the path of one of: {known}")
    raise PrevisError(f"{name}: no such camera; the stage's cameras: {known}")


def default_camera(scene: SceneDescription, render_camera: str | None = None) -> Camera | None:
    """The camera to look through when none is asked for, None to frame the scene.

    In this order: `render_camera` (that of the RenderSettings), the only camera, one named ``main_cam``
    (usdrecord's default), the first in the order of the stage.
    """
    if render_camera and render_camera in scene.cameras:
        return scene.cameras[render_camera]
    for camera in scene.cameras.values():
        if Sdf.Path(camera.path).name == MAIN_CAMERA:
            return camera
    return next(iter(scene.cameras.values()), None)


def _cameras(scene: SceneDescription | Usd.Stage) -> dict[str, Camera]:
    if isinstance(scene, SceneDescription):
        return dict(scene.cameras)
    # Only the cameras are read: asking a stage for a camera must not load its volumes.
    from collections import Counter

    from .field import GridCache
    from .geometry import GeometryCache

    time, counters = Usd.TimeCode.EarliestTime(), Counter()
    context = Context(scene, time, UsdGeom.XformCache(time), GridCache(counters), GeometryCache(counters), counters)
    found = {}
    for prim in Usd.PrimRange(scene.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        if prim.IsA(UsdGeom.Camera):
            out = Translation(prim.GetPath())
            read_camera(prim, context, out)
            found[str(prim.GetPath())] = out.cameras[0]
    return found
