"""``previs info``: what is in a stage, how it would be rendered and why, and what is not shown as authored."""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np

from ..description import volume_world_bounds
from ..settings import BY_NAME, Settings
from .arguments import (
    add_setting_arguments,
    add_stage_arguments,
    idle_notes,
    open_scene,
    preset_from,
    settings_from,
)
from .view_of import camera_and_size


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_stage_arguments(parser)
    parser.add_argument("--time", type=float, help="time code (default: the earliest)")
    parser.add_argument("--json", action="store_true", help="machine-readable")
    add_setting_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print; needs no OpenGL."""
    try:
        explicit = settings_from(arguments)
    except ValueError as error:
        print(f"previs info: {error}", file=sys.stderr)
        return 2
    from ..index import RenderIndex
    from ..render.plan import make_plan

    # What cannot be read is listed with the rest; one missing file does not hide what else there is.
    arguments.keepGoing = True
    with open_scene(arguments) as scene:
        settings = Settings(**scene.settings({**preset_from(arguments), **explicit}))
        description = scene.describe(arguments.time)
        camera, (width, height) = camera_and_size(arguments, scene, description, arguments.time)
        index = RenderIndex()
        index.update(description)
        plan = make_plan(index, camera, width, height, settings)
        notes = (*idle_notes(explicit, settings), *description.notes, *plan.notes)
        if arguments.json:
            print(json.dumps(_as_json(description, camera, plan, notes), indent=2))
        else:
            print(_as_text(description, camera, plan, notes))
    return 0


def _value(value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _default(name: str, value) -> str:
    default = BY_NAME[name].default
    return "" if value == default else f" (default {_value(default)})"


def _point(values) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"


def _field_facts(field) -> dict:
    lo, hi = field.grid.bounds
    dims = [int(n) for n in np.asarray(hi) - np.asarray(lo) + 1]
    return {"grid": field.grid.name, "voxels": dims, "active": int(field.grid.active_count)}


def _as_json(description, camera, plan, notes) -> dict:
    volumes = {}
    for path, volume in description.volumes.items():
        medium = volume.medium
        facts = {
            name: _field_facts(f) for name in ("density", "temperature", "emission") if (f := getattr(volume, name))
        }
        volumes[path] = {
            "fields": facts,
            "shape": type(volume.shape).__name__ if volume.shape else None,
            "medium": {k: getattr(medium, k) for k in medium.__dataclass_fields__},
        }
    lights = {
        p: {"kind": v.kind, "strength": v.strength, "shadows": v.casts_shadows} for p, v in description.lights.items()
    }
    meshes = {
        p: {"triangles": len(m.geometry.triangles), "instances": len(m.local_to_world)}
        for p, m in description.meshes.items()
    }
    passes = [{"pass": p.name, "why": p.why, "resolution": list(p.resolution), "bytes": p.memory} for p in plan.passes]
    return {
        "volumes": volumes,
        "lights": lights,
        "meshes": meshes,
        "cameras": list(description.cameras),
        "camera": camera.path or None,
        "size": [plan.width, plan.height],
        "settings": dict(plan.settings),
        "plan": passes,
        "notes": [{"kind": n.kind, "path": n.path, "message": n.message} for n in notes],
    }


def _as_text(description, camera, plan, notes) -> str:
    lines = []

    def section(title: str, rows: list[str]) -> None:
        lines.append(f"{title} ({len(rows)})")
        lines.extend(f"  {row}" for row in rows)

    rows = []
    for path, volume in description.volumes.items():
        medium = volume.medium
        what = type(volume.shape).__name__.lower() + ", homogeneous" if volume.shape else ""
        for name in ("density", "temperature", "emission"):
            if field := getattr(volume, name):
                facts = _field_facts(field)
                what += f"{', ' if what else ''}{name} {'×'.join(map(str, facts['voxels']))} ({facts['active']} active)"
        extinction = " ".join(f"{c:.4g}" for c in medium.strength)
        albedo = " ".join(f"{c:.4g}" for c in medium.albedo)
        lo, hi = volume_world_bounds(volume)
        media = f"extinction {extinction}, albedo {albedo}, {medium.phase} g {medium.anisotropy:.3g}"
        rows.append(f"{path}  {what}; from {_point(lo)} to {_point(hi)}; {media}")
    section("volumes", rows)
    rows = []
    for path, light in description.lights.items():
        strength = " ".join(f"{c:.4g}" for c in (light.radiance if light.kind == "dome" else light.strength))
        kind = "spot" if light.shaping and light.shaping.cone_angle < 90.0 else light.kind
        if light.kind == "dome":
            what = f"dome, radiance {strength}"
        elif light.kind == "distant":
            what = f"distant, towards {_point(light.direction)}, irradiance {strength}"
        else:
            what = f"{kind} at {_point(light.position)}, radiant intensity {strength}"
        rows.append(f"{path}  {what}{'' if light.casts_shadows else ', no shadows'}")
    section("lights", rows)
    rows = [
        f"{path}  {len(m.geometry.triangles)} triangles"
        + (f" × {len(m.local_to_world)}" if len(m.local_to_world) > 1 else "")
        for path, m in description.meshes.items()
    ]
    section("meshes", rows)
    section("cameras", [f"{path}{'  <- used' if path == camera.path else ''}" for path in description.cameras])
    if not camera.path:
        lines.append("  none chosen: a camera that frames the stage is used")
    section("settings", [f"{name} {_value(value)}{_default(name, value)}" for name, value in plan.settings.items()])
    lines.append(f"plan for {plan.width}×{plan.height}")
    lines.extend("  " + line for line in plan.describe().splitlines())
    section("not shown as authored", [str(n) for n in notes])
    return "\n".join(lines)
