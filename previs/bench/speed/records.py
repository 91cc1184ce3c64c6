"""The results of ``bench --speed`` as plain data: a row per scene and way, the same in CSV and JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from typing import Any

from ...settings import BY_NAME
from ..records import plain
from ..run import Spread
from .scaling import Fit, Scaling
from .scenes import Measured, SceneSpeed

#: What is timed.
FRAMES = {
    "whole": "a frame from nothing but the voxels on the device",
    "camera": "a frame after the camera moved",
    "light": "a frame after the main light moved",
}
#: The columns of a row, in order, with what they hold.
COLUMNS = {
    "scene": "name of the scene",
    "way": "name of the way to draw it; `floor` is the march through the density alone",
    "family": "default, quality, without or with an accelerator, curve, off (all accelerators), march, plain, floor",
    "settings": "knobs in which it differs from the defaults of previs",
    **{
        f"{frame}_{clock}{end}": f"{words}: {meaning}, seconds{which}"
        for frame, words in FRAMES.items()
        for clock, meaning in (("process", "processor time of all threads"), ("wall", "time that passed"))
        for end, which in (("", ", median"), ("_low", ", first quartile"), ("_high", ", third quartile"))
    },
    **{
        f"{frame}_over_floor{end}": f"{words}: processor time in multiples of the floor right before{which}"
        for frame, words in FRAMES.items()
        for end, which in (("", ", median"), ("_low", ", first quartile"), ("_high", ", third quartile"))
    },
    "speedup": "whole frame: how many times faster than the plain renderer of the default's error, processor time",
    "mean_relative_error": "mean absolute error over the mean of the truth's lit values, estimated from pixels",
    "mean_relative_error_low": "lower end of its 95 % interval",
    "mean_relative_error_high": "upper end",
    "relative_rmse": "root mean square error over the same mean",
    "psnr": "peak signal-to-noise ratio in dB",
    "bias": "light that the picture has too much, relative to all of the truth",
    "turns": "turns that count",
    "estimated": "whether the time is that of every fourth row, drawn once",
}


def rows_of(scene: SceneSpeed) -> list[dict[str, Any]]:
    """The rows of a scene with the keys of `COLUMNS`; the floor comes last. What was not measured is None."""
    equal = scene.plain.times("whole")
    rows = [_row(scene, way, equal) for way in scene.ways]
    row = dict.fromkeys(COLUMNS)
    row |= {
        "scene": scene.scene,
        "way": "floor",
        "family": "floor",
        "settings": "",
        "turns": len(scene.floor),
        "estimated": False,
    }
    for clock in ("process", "wall"):
        row |= _spread(f"whole_{clock}", Spread.of([getattr(t, clock) for t in scene.floor]))
    return [*rows, row]


def _row(scene: SceneSpeed, way: Measured, equal: Spread | None) -> dict[str, Any]:
    changed = {n: v for n, v in way.settings.items() if v != BY_NAME[n].default}
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row |= {
        "scene": scene.scene,
        "way": way.variant.name,
        "family": way.variant.family,
        "settings": " ".join(f"{n}={v}" for n, v in changed.items()),
        "turns": len(way.turns),
        "estimated": way.estimated,
    }
    for frame in FRAMES:
        for clock in ("process", "wall"):
            row |= _spread(f"{frame}_{clock}", way.times(frame, clock))
        row |= _spread(f"{frame}_over_floor", way.over_floor(frame))
    whole = way.times("whole")
    if whole is not None and equal is not None and whole.median > 0.0:
        row["speedup"] = equal.median / whole.median
    error = way.error
    row |= dict(
        zip(
            ("mean_relative_error", "mean_relative_error_low", "mean_relative_error_high"),
            map(float, error.mean_relative_error),
            strict=True,
        )
    )
    for name in ("relative_rmse", "psnr", "bias"):
        row[name] = float(getattr(error, name).value)
    return row


def _spread(name: str, spread: Spread | None) -> dict[str, float | None]:
    if spread is None:
        return {}
    return {name: spread.median, f"{name}_low": spread.low, f"{name}_high": spread.high}


def scene_record(scene: SceneSpeed) -> dict[str, Any]:
    """A scene with its rows, for JSON."""
    return {
        "scene": scene.scene,
        "stage": scene.file,
        "size": list(scene.size),
        "truth": dict(scene.truth),
        "equal_error": {
            "steps": scene.equal.steps,
            "reached": scene.equal.reached,
            "tried": [[steps, plain(float(error.value))] for steps, error in scene.equal.tried],
        },
        "passes": {way.variant.name: dict(way.passes) for way in scene.ways if way.passes},
        "results": [{k: plain(v) for k, v in row.items()} for row in rows_of(scene)],
    }


def scaling_record(found: Scaling) -> dict[str, Any]:
    """A sweep, for JSON."""
    return {
        "name": found.name,
        "unit": found.unit,
        "left_out": list(found.left_out),
        "series": [
            {
                "name": s.name,
                "amounts": list(s.amounts),
                "seconds": [t.median for t in s.times],
                "seconds_low": [t.low for t in s.times],
                "seconds_high": [t.high for t in s.times],
                "fit": _fit(s.fit),
            }
            for s in found.series
        ],
    }


def _fit(fit: Fit | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    return {"exponent": fit.exponent, "standard_error": plain(fit.error), "factor": fit.factor}


def csv_text(rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows as CSV, with a header of `COLUMNS`; what a row has not is empty, truth is true or false."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow(
            ["" if v is None else str(v).lower() if isinstance(v, bool) else v for v in (row[n] for n in COLUMNS)]
        )
    return out.getvalue()
