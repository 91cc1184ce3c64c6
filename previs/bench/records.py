"""The results of a bench as plain data: one row per scene and variant, the same in CSV and JSON."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..render.method import METHODS
from .run import Convergence, Result, Run, errors_of, pareto_front

#: The columns of a row, in order, with what they hold.
COLUMNS = {
    "scene": "name of the scene",
    "variant": "name of the way to render; `converged march` is the reference",
    "family": "what is drawn alike: the method, and knobs other than its stored values and steps",
    "method": "transmittance method",
    "coefficients": "stored values per texel of a map; empty for slices and marches",
    "steps": "steps across the longest diagonal of a volume, of view rays; 0 where the plan chose",
    "light_steps": "the same of light rays",
    "mean_relative_error": "mean absolute error of the whole picture over the mean of its lit values",
    "relative_rmse": "root mean square error over the same mean",
    "psnr": "peak signal-to-noise ratio in dB; the peak is the 99.9th percentile of the reference",
    "ssim": "structural similarity of the luminance",
    "volume_mean_relative_error": "mean relative error of the in-scattered light alone",
    "volume_psnr": "PSNR of the in-scattered light alone, dB",
    "seconds": "median time of a picture from nothing, by the clock that is named",
    "seconds_low": "first quartile of it",
    "seconds_high": "third quartile",
    "speedup": "times faster than the reference in the same turn, median",
    "speedup_low": "first quartile",
    "speedup_high": "third quartile",
    "view_speedup": "times faster than the reference in the march along view rays alone, maps being there; median",
    "view_speedup_low": "first quartile",
    "view_speedup_high": "third quartile",
    "relative_time": "times the time of the default settings in the same turn, median",
    "relative_time_low": "first quartile",
    "relative_time_high": "third quartile",
    "default": "whether this is the default settings",
    "front": "whether no other variant of the scene is faster and nearer to the reference",
}


def rows_of(run: Run) -> list[dict[str, Any]]:
    """One row per variant with the keys of `COLUMNS`, the reference first."""
    truth = run.reference.image
    rows = [_row(run, result, errors_of(result.image, truth)) for result in (run.reference, *run.results)]
    candidates = rows[1:]
    points = [(row["relative_time"], row["mean_relative_error"]) for row in candidates]
    for number in pareto_front(points):
        candidates[number]["front"] = True
    return rows


def _row(run: Run, result: Result, errors: Mapping[str, float | None]) -> dict[str, Any]:
    settings = result.image.stats["settings"]
    method = settings["transmittance"]
    row: dict[str, Any] = {
        "scene": run.subject.name,
        "variant": result.variant.name,
        "family": result.variant.family,
        "method": method,
        "coefficients": settings["coefficients"] if METHODS[method].has_coefficients else None,
        "steps": settings["steps"],
        "light_steps": settings["light_steps"],
        "volume_mean_relative_error": None,
        "volume_psnr": None,
        **errors,
    }
    for name in ("seconds", "speedup", "view_speedup", "relative_time"):
        spread = getattr(result, name)
        row |= {name: spread.median, f"{name}_low": spread.low, f"{name}_high": spread.high}
    row |= {"default": result.variant.name == run.default, "front": False}
    return {name: row[name] for name in COLUMNS}


def scene_record(run: Run, convergence: Convergence, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A scene with its rows, for JSON."""
    return {
        "scene": run.subject.name,
        "stage": run.subject.file,
        "size": list(run.subject.size),
        "camera": run.subject.camera.path or "(frames the stage)",
        "reference": {
            "steps": convergence.steps,
            "light_steps": convergence.light_steps,
            "change_when_doubled": plain(convergence.change),
            "converged": convergence.converged,
        },
        "default": run.default,
        "notes": list(run.reference.image.stats["notes"]),
        "results": [{k: plain(v) for k, v in row.items()} for row in rows],
    }


def plain(value: Any) -> Any:
    """A value as JSON can hold it: numbers that are not finite become text."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def csv_text(rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows as CSV, with a header of `COLUMNS`; what a row has not is empty, truth is true or false."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow([_cell(row[name]) for name in COLUMNS])
    return out.getvalue()


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else value
