"""UsdRender settings: the camera and the resolution that a stage asks for."""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Sdf, Usd, UsdRender

from ..errors import PrevisError


@dataclass(frozen=True)
class RenderSettings:
    """What a RenderSettings prim says, as far as it is used; None where not authored.

    `camera` is a prim path, `color_space` the `renderingColorSpace`.
    """

    path: str
    camera: str | None = None
    resolution: tuple[int, int] | None = None
    color_space: str | None = None


def read_render_settings(stage: Usd.Stage, path: str | None = None) -> RenderSettings | None:
    """The settings at `path`; without a path, those that the stage's `renderSettingsPrimPath` metadata selects.

    Without either, the only RenderSettings prim of the stage counts; None when there is none, or more than one.
    Raises `PrevisError` when `path` is not a RenderSettings prim.
    """
    if path is not None:
        prim = stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
        if not prim or not prim.IsA(UsdRender.Settings):
            raise PrevisError(f"{path}: not a RenderSettings prim of the stage")
    else:
        settings = UsdRender.Settings.GetStageRenderSettings(stage)
        if settings:
            prim = settings.GetPrim()
        else:
            found = [p for p in stage.Traverse() if p.IsA(UsdRender.Settings)]
            if len(found) != 1:
                return None
            prim = found[0]
    settings = UsdRender.Settings(prim)
    targets = settings.GetCameraRel().GetForwardedTargets()
    resolution = settings.GetResolutionAttr()
    size = resolution.Get() if resolution.HasAuthoredValue() else None
    return RenderSettings(
        path=str(prim.GetPath()),
        camera=str(targets[0]) if targets else None,
        resolution=(int(size[0]), int(size[1])) if size is not None else None,
        color_space=str(settings.GetRenderingColorSpaceAttr().Get() or "") or None,
    )
