"""UsdRender settings: the camera, the resolution and the renderer's knobs that a stage asks for.

A knob of `previs.settings.TABLE` is an attribute `previs:<name>` of the RenderSettings prim, or of `/Render/previs`,
which is looked at whatever the stage's metadata say: metadata of a sublayer do not count, prims do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdRender

from ..description import Note
from ..errors import PrevisError
from ..settings import BY_NAME

#: Where knobs are found without any metadata.
KNOBS_PATH = Sdf.Path("/Render/previs")
KNOB_PREFIX = "previs:"


@dataclass(frozen=True)
class RenderSettings:
    """What a RenderSettings prim says, as far as it is used; None where not authored.

    `camera` is a prim path, `color_space` the `renderingColorSpace`.
    """

    path: str
    camera: str | None = None
    resolution: tuple[int, int] | None = None
    color_space: str | None = None


def settings_prim(stage: Usd.Stage, path: str | None = None) -> Usd.Prim | None:
    """The RenderSettings prim at `path`; without a path, the one that the stage's `renderSettingsPrimPath` selects.

    Without either, the only RenderSettings prim of the stage counts, `/Render/previs` aside where there is another;
    None when there is none, or more than one. Raises `PrevisError` when `path` is not a RenderSettings prim.
    """
    if path is not None:
        prim = stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
        if not prim or not prim.IsA(UsdRender.Settings):
            raise PrevisError(f"{path}: not a RenderSettings prim of the stage")
        return prim
    selected = UsdRender.Settings.GetStageRenderSettings(stage)
    if selected:
        return selected.GetPrim()
    return _only_settings(stage)


def needs_metadata(prim: Usd.Prim) -> bool:
    """Whether a RenderSettings prim is found only because it is asked for, or by the metadata of the root layer."""
    return prim.GetPath() != KNOBS_PATH and _only_settings(prim.GetStage()) != prim


def _only_settings(stage: Usd.Stage) -> Usd.Prim | None:
    found = [prim for prim in stage.Traverse() if prim.IsA(UsdRender.Settings)]
    if len(found) > 1:
        found = [prim for prim in found if prim.GetPath() != KNOBS_PATH]
    return found[0] if len(found) == 1 else None


def read_render_settings(stage: Usd.Stage, path: str | None = None) -> RenderSettings | None:
    """What the RenderSettings say that `settings_prim` finds, None where there are none.

    Raises `PrevisError` when `path` is not a RenderSettings prim.
    """
    prim = settings_prim(stage, path)
    return render_settings_of(prim) if prim is not None else None


def render_settings_of(prim: Usd.Prim) -> RenderSettings:
    """What a RenderSettings prim says of the picture."""
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


def read_knobs(stage: Usd.Stage, prim: Usd.Prim | None) -> tuple[dict[str, Any], tuple[Note, ...]]:
    """The knobs that `/Render/previs` and, above it, a RenderSettings prim author, and what is wrong with them."""
    knobs: dict[str, Any] = {}
    notes: list[Note] = []
    own = stage.GetPrimAtPath(KNOBS_PATH)
    for holder in dict.fromkeys(p for p in (own, prim) if p):
        for attribute in holder.GetAuthoredPropertiesInNamespace(KNOB_PREFIX.rstrip(":")):
            name = attribute.GetName().removeprefix(KNOB_PREFIX)
            setting = BY_NAME.get(name)
            if setting is None or not isinstance(attribute, Usd.Attribute):
                message = f"{attribute.GetName()} is not a knob; known are {', '.join(BY_NAME)}"
                notes.append(Note("ignored", str(holder.GetPath()), message))
                continue
            value = attribute.Get(Usd.TimeCode.EarliestTime())
            if value is None:
                continue
            if attribute.ValueMightBeTimeVarying():
                message = f"{attribute.GetName()} is animated; its first value is used"
                notes.append(Note("approximated", str(holder.GetPath()), message))
            try:
                knobs[name] = setting.parse(_exact(attribute, value))
            except ValueError as error:
                notes.append(Note("ignored", str(holder.GetPath()), f"{KNOB_PREFIX}{error}"))
    return knobs, tuple(notes)


def _exact(attribute: Usd.Attribute, value: Any) -> Any:
    """The number that was written, of which a float of 32 bits is the nearest."""
    return float(str(np.float32(value))) if attribute.GetTypeName() == Sdf.ValueTypeNames.Float else value
