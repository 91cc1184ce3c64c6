"""A bench from the stages to the files: results, plots, error sheets and the page that shows them."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import PrevisError
from ..io import write_text
from ..render.renderer import Renderer
from ..settings import BY_NAME
from . import page, plots
from .records import COLUMNS, csv_text, rows_of, scene_record
from .run import (
    CONVERGED,
    Convergence,
    Progress,
    Run,
    Variant,
    converged_march,
    machine,
    measure,
    opened,
    variants,
)
from .tables import Table, decibel, percent, ratio


@dataclass(frozen=True)
class Options:
    """What to measure on every stage.

    `coefficients` are stored values; `steps` of view and light rays alike, 0 for the plan's choice; `others` values of
    other knobs; `repeats` turns are counted after one that warms up; `width` of the pictures in pixels.
    """

    methods: tuple[str, ...]
    coefficients: tuple[int, ...] = (2, 6, 10, 14)
    steps: tuple[int, ...] = (0, 128)
    repeats: int = 5
    width: int = 480
    camera: str | None = None
    others: Mapping[str, Sequence[Any]] = field(default_factory=dict)

    def variants(self) -> list[Variant]:
        """All that is measured besides the converged march.

        Raises:
            ValueError: for a value that a knob does not take.
        """
        return variants(self.methods, self.coefficients, self.steps, self.others)

    def featured(self) -> list[Variant]:
        """Those that sheets and summaries show: the usual numbers of coefficients, steps as the plan chooses, of other
        knobs all values."""
        counts = [n for n in self.coefficients if n in (6, 14)] or [self.coefficients[0], self.coefficients[-1]]
        steps = 0 if 0 in self.steps else self.steps[0]
        return variants(self.methods, dict.fromkeys(counts), [steps], self.others)


@dataclass(frozen=True, eq=False)
class Measured:
    """What is kept of a scene: its rows, its record for JSON, and its error sheet as JPEG."""

    scene: str
    rows: list[dict[str, Any]]
    record: dict[str, Any]
    convergence: Convergence
    sheet: bytes


def names_of(stages: Sequence[str | Path]) -> list[str]:
    """A name for every stage: its file's, with a number where two are alike."""
    names: list[str] = []
    for stage in stages:
        name, number = Path(stage).stem, 2
        while name in names:
            name, number = f"{Path(stage).stem}-{number}", number + 1
        names.append(name)
    return names


def sweep(
    renderer: Renderer,
    stages: Sequence[str | Path],
    options: Options,
    output: Path,
    progress: Progress | None = None,
) -> list[Measured]:
    """Measure all variants on all stages and write an error sheet for each.

    Raises:
        PrevisError: when a stage cannot be opened or rendered.
    """
    # Said before the first is measured, not after the last.
    for stage in stages:
        if not Path(stage).is_file():
            raise PrevisError(f"{stage}: no such file")
    found = []
    for stage, name in zip(stages, names_of(stages), strict=True):
        with opened(stage, options.width, options.camera, name) as subject:
            convergence = converged_march(renderer, subject, progress)
            run = measure(renderer, subject, convergence.variant, options.variants(), options.repeats, progress)
        figure = _sheet(run, options)
        plots.save(figure, output / f"errors-{name}.png")
        rows = rows_of(run)
        found.append(Measured(name, rows, scene_record(run, convergence, rows), convergence, plots.jpeg(figure)))
    return found


def _sheet(run: Run, options: Options):
    featured = {v.name for v in options.featured()}
    pictures = [plots.Shown(r.variant.name, r.image.color) for r in run.results if r.variant.name in featured]
    return plots.error_sheet(run.subject.name, run.reference.image.color, pictures)


def summary(found: Sequence[Measured], options: Options) -> Table:
    """Mean error, PSNR and speed of the featured variants, a scene per row."""
    names = [v.name for v in options.featured()]
    rows = []
    for item in found:
        by_name = {row["variant"]: row for row in item.rows}
        rows.append((item.scene, *(_cell(by_name[name]) for name in names)))
    return Table(
        "Mean error, PSNR, and how many times faster than the converged march",
        ("scene", *names),
        tuple(rows),
    )


def _cell(row: dict[str, Any]) -> str:
    return f"{percent(row['mean_relative_error'])}, {decibel(row['psnr'])} dB, {ratio(row['speedup'])}"


def details(item: Measured) -> Table:
    """All variants of a scene, by rising time; those that nothing beats are marked."""
    ordered = sorted(item.rows, key=lambda row: row["relative_time"])
    rows = tuple(
        (
            row["variant"] + (" (default)" if row["default"] else ""),
            percent(row["mean_relative_error"]),
            decibel(row["psnr"]),
            "–" if row["ssim"] is None else f"{row['ssim']:.5f}",
            percent(row["volume_mean_relative_error"]),
            decibel(row["volume_psnr"]),
            f"{row['seconds']:.2f} s",
            ratio(row["relative_time"], row["relative_time_low"], row["relative_time_high"]),
            ratio(row["speedup"], row["speedup_low"], row["speedup_high"]),
        )
        for row in ordered
    )
    return Table(
        f"{item.scene}: everything that was measured",
        (
            "variant",
            "mean error",
            "PSNR, dB",
            "SSIM",
            "mean error, in-scattered",
            "PSNR, in-scattered",
            "time",
            "× the default's time (quartiles)",
            "× faster than the converged march (quartiles)",
        ),
        rows,
        "By rising time; what is highlighted nothing else beats in both time and error.",
        marked=frozenset(i for i, row in enumerate(ordered) if row["front"]),
    )


def reference_sentence(item: Measured) -> str:
    """What the truth of a scene is, and how sure it is."""
    c = item.convergence
    begin = (
        f"The truth is a brute-force march with {c.steps} steps along view rays and {c.light_steps} along light rays; "
    )
    change = (
        "nothing more could be tried"
        if c.change == float("inf")
        else f"doubling both changes it by {percent(c.change)}"
    )
    end = "" if c.converged else f", which is more than the {percent(CONVERGED)} that count as converged"
    return f"{begin}{change} on average{end}."


def headline(found: Sequence[Measured]) -> str:
    """The default settings in one sentence."""
    defaults = [row for item in found for row in item.rows if row["default"]]
    errors = sorted(row["mean_relative_error"] for row in defaults)
    speeds = sorted(row["speedup"] for row in defaults)
    where = "the scene" if len(found) == 1 else f"the {len(found)} scenes"
    between = [percent(errors[0]), percent(errors[-1])]
    faster = [ratio(speeds[0]), ratio(speeds[-1])]
    error = between[0] if between[0] == between[1] else f"{between[0]} to {between[1]}"
    speed = faster[0] if faster[0] == faster[1] else f"{faster[0]} to {faster[1]}"
    names = ", ".join(dict.fromkeys(row["variant"] for row in defaults))
    return (
        f"With the default settings ({names}) a picture of {where} is off by {error} of its brightness on average, and "
        f"is done {speed} faster than the brute-force march that is taken for the truth."
    )


def write(
    output: Path,
    renderer: Renderer,
    found: Sequence[Measured],
    options: Options,
    papers: Sequence[Any] = (),
) -> list[Path]:
    """Write the results, the plots and the page; returns the files.

    Args:
        output: a folder that exists.
        renderer: that measured.
        found: what `sweep` gave.
        options: what it was asked for.
        papers: results of `previs.bench.paper`.

    Raises:
        PrevisError: when a file cannot be written.
    """
    host = machine(renderer)
    version = importlib.metadata.version("previs")
    date = datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes")
    files, sections, tables = [], [], []
    if found:
        rows = [row for item in found for row in item.rows]
        write_text(output / "results.csv", csv_text(rows))
        figure = plots.pareto(rows)
        for ending in ("png", "svg"):
            plots.save(figure, output / f"pareto.{ending}")
        files += [output / "results.csv", output / "pareto.png", output / "pareto.svg"]
        files += [output / f"errors-{item.scene}.png" for item in found]
        table = summary(found, options)
        tables.append(table)
        sections.append(_overview(found, options, table, plots.jpeg(figure)))
        sections += [_scene_section(item) for item in found]
    for paper in papers:
        for name, figure in paper.figures.items():
            plots.save(figure, output / f"{name}.png")
            files.append(output / f"{name}.png")
        tables += paper.tables
        sections.append(_paper_section(paper))
    record = {
        "previs": version,
        "date": date,
        "machine": host,
        "options": {
            "methods": list(options.methods),
            "coefficients": list(options.coefficients),
            "steps": list(options.steps),
            "others": {name: list(values) for name, values in options.others.items()},
            "repeats": options.repeats,
            "width": options.width,
        },
        "columns": COLUMNS,
        "scenes": [item.record for item in found],
        "papers": [paper.record for paper in papers],
    }
    write_text(output / "results.json", json.dumps(record, indent=2) + "\n")
    write_text(output / "tables.md", "\n".join(table.markdown() for table in tables))
    sections.append(_measured_section(page.machine_table(host, version, date), options))
    lead = headline(found) if found else "Tables in the layout of the papers whose methods previs has."
    text = page.page("previs: speed against error", lead, sections)
    write_text(output / "index.html", text)
    return [output / "index.html", output / "results.json", output / "tables.md", *files]


def _overview(found: Sequence[Measured], options: Options, table: Table, plot: bytes) -> str:
    caption = (
        "Every point is a way to render: to the left is faster, below is more accurate, both on logarithmic scales. "
        "Numbers beside points are stored values per texel. The grey line joins what nothing else beats in both; the "
        "circle is the default."
    )
    return page.section(
        "Which accuracy, in which time",
        page.paragraph(
            "Light is attenuated on its way into a medium. A brute-force march computes that anew for every point that "
            "the camera sees; the other methods store it once per light in maps, as a few values per texel, and are "
            "compared here with the march in error and in time."
        ),
        page.paragraph(BY_NAME["transmittance"].doc),
        page.picture(plot, "jpeg", caption),
        table.html(),
    )


def _scene_section(item: Measured) -> str:
    caption = (
        "Left what the method gives, in the middle the truth, at the right the error of every pixel in false colour. "
        "A pixel's error is counted in parts of the mean brightness of the picture."
    )
    table = details(item)
    return page.section(
        item.scene,
        page.paragraph(reference_sentence(item)),
        page.picture(item.sheet, "jpeg", caption),
        page.folded(f"All {len(item.rows)} measurements of this scene", table.html()),
    )


def _paper_section(paper: Any) -> str:
    parts = [page.paragraph(text) for text in paper.text]
    parts += [table.html() for table in paper.tables]
    parts += [page.picture(plots.jpeg(f), "jpeg", paper.captions[name]) for name, f in paper.figures.items()]
    return page.section(paper.title, *parts)


def _measured_section(table: Table, options: Options) -> str:
    turns = "turn" if options.repeats == 1 else "turns"
    return page.section(
        "How it was measured",
        page.bullets(
            (
                "The truth of every scene is the brute-force march whose steps are doubled until that changes the "
                f"picture by less than {percent(CONVERGED)} on average; how many that takes is written at every scene.",
                "Mean error: the mean absolute error over all pixels and channels, in parts of the mean brightness of "
                "the lit pixels, in linear radiance. PSNR: its peak is the 99.9th percentile of the truth; 6 dB "
                "more are half the error.",
                f"Pictures are {options.width} pixels wide and are rendered from nothing each time: voxels are "
                "uploaded, maps filled, the picture drawn.",
                f"All ways to render a scene take turns; {options.repeats} {turns} count, after one that warms up. "
                "Ratios are taken within a turn; the median is given, with the quartiles in brackets.",
                "Ratios can be compared between machines with care; seconds cannot.",
            )
        ),
        table.html(),
    )
