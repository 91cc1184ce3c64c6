"""What ``bench --speed`` writes: results, tables, plots and the page that shows them."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...io import write_text
from ...render.renderer import Renderer
from .. import page, plots
from ..run import Spread, machine
from ..tables import Table, percent, ratio
from .peer import PeerResult
from .records import COLUMNS, csv_text, rows_of, scaling_record, scene_record
from .scaling import Scaling
from .scenes import LONG, SLOW, SLOW_ROWS, Measured, Options, SceneSpeed


def scene_table(scene: SceneSpeed) -> Table:
    """All ways of one scene: times, multiples of the floor, error."""
    rows, marked = [], set()
    equal = scene.plain.times("whole")
    for way in scene.ways:
        if way.variant.family in ("default", "plain"):
            marked.add(len(rows))
        whole = way.times("whole")
        faster = "–" if whole is None or equal is None else ratio(equal.median / whole.median)
        rows.append(
            (
                way.variant.name + (" (estimated)" if way.estimated else " (one turn)" if len(way.turns) == 1 else ""),
                *(_times(way, frame) for frame in ("whole", "camera", "light")),
                _spread(way.over_floor("whole")),
                _spread(way.over_floor("camera")),
                faster,
                error_cell(way),
            )
        )
    floor = [Spread.of([getattr(t, clock) for t in scene.floor]).median for clock in ("process", "wall")]
    rows.append((f"floor, {scene.truth['floor_steps']} steps", seconds(*floor), "–", "–", "1×", "–", "–", "–"))
    width, height = scene.size
    reached = "" if scene.equal.reached else ", which even so is further off than the default"
    return Table(
        f"{scene.scene}, {width}×{height}",
        (
            "way",
            "whole frame, processor (wall)",
            "camera move",
            "light move",
            "whole frame / floor (quartiles)",
            "camera move / floor",
            "× faster than brute force of the default's error",
            "mean error (95 %)",
        ),
        tuple(rows),
        f"Brute force at equal error takes {scene.equal.steps} steps along view and light rays{reached}.",
        marked=frozenset(marked),
    )


def seconds(process: float, wall: float) -> str:
    """Processor time with the wall clock's in brackets."""
    return f"{_short(process)} s ({_short(wall)})"


def _short(value: float) -> str:
    return f"{value:.1f}" if value >= 10.0 else f"{value:.2f}" if value >= 1.0 else f"{value:.3f}"


def _times(way: Measured, frame: str) -> str:
    process, wall = way.times(frame), way.times(frame, "wall")
    return "–" if process is None or wall is None else seconds(process.median, wall.median)


def _spread(spread: Spread | None) -> str:
    return "–" if spread is None else ratio(spread.median, spread.low, spread.high)


def error_cell(way: Measured) -> str:
    """The mean error with its interval."""
    value, low, high = way.error.mean_relative_error
    return f"{percent(value)} ({percent(low)} to {percent(high)})"


def passes_table(scene: SceneSpeed) -> Table:
    """Seconds by kind of pass."""
    kinds = list(dict.fromkeys(kind for way in scene.ways for kind in way.passes))
    rows = tuple(
        (way.variant.name, *(_short(way.passes[kind]) if kind in way.passes else "–" for kind in kinds))
        for way in scene.ways
        if way.passes
    )
    note = "Wall clock, one frame from nothing but the voxels, waiting for every pass to end."
    return Table(f"{scene.scene}: seconds by pass", ("way", *kinds), rows, note)


def scaling_table(found: Sequence[Scaling]) -> Table:
    """The exponents of all sweeps."""
    rows = []
    for sweep in found:
        for series in sweep.series:
            first, last = series.times[0].median, series.times[-1].median
            rows.append(
                (
                    sweep.name,
                    series.name,
                    f"{series.amounts[0]:g} to {series.amounts[-1]:g}",
                    f"{_short(first)} to {_short(last)} s",
                    "–" if series.fit is None else str(series.fit),
                )
            )
    return Table(
        "How the cost grows: time = constant · size ^ exponent",
        ("swept", "way and frame", "sizes", "processor time", "exponent ± standard error"),
        tuple(rows),
        "Least squares through the logarithms of the medians.",
        names=2,
    )


def peer_table(found: Sequence[PeerResult]) -> Table:
    """previs against VTK."""
    rows = tuple(
        (
            p.scene,
            p.name,
            "failed: " + p.failure if p.failure else f"{_short(p.wall)} s",
            "–" if p.failure else f"{_short(p.process)} s",
            "–" if p.failure else percent(p.mean_relative_error),
            "–" if p.failure else percent(p.relative_rmse),
        )
        for p in found
    )
    return Table(
        "The same voxels, camera and sun in VTK",
        ("scene", "renderer", "frame, wall", "frame, processor", "mean error", "relative RMSE"),
        rows,
        "The first volume of the stage, grey, under its main light alone, made distant; no meshes. VTK marches "
        "secondary rays (SetVolumetricScatteringBlending(2), SetGlobalIlluminationReach(1)) and has units of its own, "
        "so its picture is compared after the best single scale; that of previs is not scaled. A frame is drawn after "
        "one that warms up; of previs it is one from nothing but the voxels.",
        names=2,
    )


def headline(found: Sequence[SceneSpeed]) -> str:
    """The default settings in one sentence."""
    floors = [s.median for scene in found if (s := scene.default.over_floor("whole")) is not None]
    errors = [scene.default.error.mean_relative_error.value for scene in found]
    faster = [
        slow.median / fast.median
        for scene in found
        if (slow := scene.plain.times("whole")) is not None and (fast := scene.default.times("whole")) is not None
    ]
    where = "the scene" if len(found) == 1 else f"the {len(found)} scenes"
    return (
        f"By default a whole frame of {where} takes {_between(floors, ratio)} the time of a march through the density "
        f"alone; brute force of equal error takes {_between(faster, ratio)} as long as it. Its mean error is "
        f"{_between(errors, percent)}."
    )


def _between(values: Sequence[float], text) -> str:
    if not values:
        return "–"
    low, high = text(min(values)), text(max(values))
    return low if low == high else f"{low} to {high}"


def write(
    output: Path,
    renderer: Renderer,
    found: Sequence[SceneSpeed],
    scalings: Sequence[Scaling],
    peers: Sequence[PeerResult],
    options: Options,
) -> tuple[list[Path], list[Table]]:
    """Write the results, the plots and the page; returns the files, the page first, and the tables.

    Raises:
        PrevisError: when a file cannot be written.
    """
    rows = [row for scene in found for row in rows_of(scene)]
    tables = [scene_table(scene) for scene in found]
    if peers:
        tables.append(peer_table(peers))
    if scalings:
        tables.append(scaling_table(scalings))
    files, sections = [], []

    def drawn(figure, name: str) -> bytes:
        for ending in ("png", "svg"):
            plots.save(figure, output / f"{name}.{ending}")
            files.append(output / f"{name}.{ending}")
        return plots.jpeg(figure)

    caption = (
        "To the left is faster, below is more accurate, both on logarithmic scales. The floor, a march through the "
        "density alone, would be at 1."
    )
    sections.append(
        page.section(
            "What a frame costs, and how far it is off",
            page.picture(drawn(plots.speed(rows), "speed"), "jpeg", caption),
            *(table.html() for table in tables[: len(found)]),
            page.folded("Seconds by pass", "".join(passes_table(scene).html() for scene in found)),
        )
    )
    if peers:
        sections.append(page.section("Against VTK", peer_table(peers).html()))
    if scalings:
        pictures = []
        for sweep in scalings:
            curves = [
                plots.Growth(
                    s.name if s.fit is None else f"{s.name}: exponent {s.fit}",
                    s.amounts,
                    [t.median for t in s.times],
                    s.fit and (s.fit.exponent, s.fit.factor),
                )
                for s in sweep.series
            ]
            figure = plots.growth(sweep.name, sweep.unit, curves)
            left = f" Left out, as too slow: {', '.join(map(str, sweep.left_out))}." if sweep.left_out else ""
            caption = f"Processor time over {sweep.unit}.{left}"
            pictures.append(page.picture(drawn(figure, f"scaling-{sweep.name}"), "jpeg", caption))
        sections.append(page.section("How the cost grows", scaling_table(scalings).html(), *pictures))
    host, version = machine(renderer), importlib.metadata.version("previs")
    date = datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes")
    record: dict[str, Any] = {
        "previs": version,
        "date": date,
        "machine": host,
        "options": {
            "width": options.width,
            "repeats": options.repeats,
            "error_pixels": options.pixels,
            "floor_steps": options.steps,
        },
        "columns": COLUMNS,
        "scenes": [scene_record(scene) for scene in found],
        "scaling": [scaling_record(s) for s in scalings],
        "peers": [p.record() for p in peers],
    }
    write_text(output / "speed.json", json.dumps(record, indent=2) + "\n")
    write_text(output / "speed.csv", csv_text(rows))
    write_text(output / "speed.md", "\n".join(table.markdown() for table in tables))
    sections.append(_measured(page.machine_table(host, version, date), options))
    write_text(output / "index.html", page.page("previs: what a frame costs", headline(found), sections))
    names = ("index.html", "speed.json", "speed.csv", "speed.md")
    return [*(output / name for name in names), *files], tables


def _measured(table: Table, options: Options) -> str:
    turns = "turn counts" if options.repeats == 1 else "turns count"
    return page.section(
        "How it was measured",
        page.bullets(
            (
                "All ways to draw a scene take turns in one process, each right after the floor; "
                f"{options.repeats} {turns}, after one that warms up. Medians are given, with quartiles in brackets.",
                "A whole frame is drawn from nothing but the voxels on the device: it plans the frame and runs all of "
                "its passes, until the last is finished; it is not read back, and has one sample per pixel. For the "
                "moves, the camera or the main light is turned by 2° about the volumes, and what is still valid of "
                "the frame before is used.",
                "Processor time is that of all threads together; on a GPU only the wall clock tells something.",
                f"The floor is a march of {options.steps} uniform steps from where a ray enters the bounds of the "
                "volumes to where it leaves them: one fetch of the dense density each, one exponential, no light.",
                "Brute force is what a plain renderer does: at every one of N steps of a view ray a march of N steps "
                "to every light, nothing skipped and nothing stored but the voxels and the shadow maps of meshes. Its "
                "N is the least of a ladder at which its error is no larger than that of the default. It "
                "shares the shader of the march with previs, which ends opaque rays and cuts deep steps: a plain "
                "renderer without these would need more steps.",
                f"What takes more than {LONG:g} seconds of the processor is drawn in one turn alone; of what would "
                f"take more than {SLOW:g} only every {SLOW_ROWS}th row is drawn, and it is marked as estimated.",
                f"Errors are those of {options.pixels} pixels, the same for all ways of a scene, against a march so "
                "fine that more steps change nothing, with 95 % intervals for the picture they stand for. They are "
                "relative to the mean of the lit pixels.",
                "Ratios can be compared between machines with care; seconds cannot.",
            )
        ),
        table.html(),
    )
