"""What a bench draws: error against time, pictures with their errors, curves along a light ray.

The only module that uses matplotlib; importing it without matplotlib raises ModuleNotFoundError.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from .. import metrics
from ..io import auto_exposure, display, written_beside
from ..render.display import Compare, error_colormap
from ..settings import BY_NAME
from .tables import decibel, percent

matplotlib.use("Agg")

# Okabe and Ito's colours, which colour-blind people can tell apart.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_MARKERS = "os^Dv"
_FRONT = "#9a9a9a"


def family_colors(families: Sequence[str]) -> dict[str, str]:
    """A colour for every family: transmittance methods have the same one in every plot, marches are black."""
    known = [c for c in BY_NAME["transmittance"].choices if c != "march"]
    order = [*known, *(f for f in dict.fromkeys(families) if f not in known and f != "march")]
    return {"march": "#000000", **{f: _COLORS[i % len(_COLORS)] for i, f in enumerate(order)}}


def save(figure: Figure, path: Path) -> None:
    """Write a figure; the ending of the path picks the format.

    Raises:
        PrevisError: when it cannot be written.
    """
    # The date would make the same figure another file.
    metadata = {".png": {"Software": None}, ".svg": {"Date": None}}.get(path.suffix, {})
    with written_beside(path) as beside:
        figure.savefig(beside, format=path.suffix[1:], dpi=110, metadata=metadata)


def jpeg(figure: Figure, dpi: int = 110) -> bytes:
    """A figure as JPEG, to be put into a page."""
    out = io.BytesIO()
    figure.savefig(out, format="jpeg", dpi=dpi, pil_kwargs={"quality": 88})
    return out.getvalue()


def pareto(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Error against time, one panel per scene; `rows` as of `previs.bench.records.rows_of`.

    To the left is faster, below is more accurate. The grey line joins what no other way to render beats.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    across = min(3, len(scenes))
    down = -(-len(scenes) // across)
    figure = Figure(figsize=(1.2 + 4.2 * across, 1.2 + 3.5 * down), layout="constrained")
    colors = family_colors([row["family"] for row in rows if row["variant"] != "converged march"])
    shown: dict[str, Any] = {}
    for number, scene in enumerate(scenes):
        axes = figure.add_subplot(down, across, number + 1)
        part = [row for row in rows if row["scene"] == scene]
        _pareto_panel(axes, part[1:], colors, shown)
        slow = part[0]["relative_time"]
        axes.set_title(f"{scene}   (converged march: {slow:.3g} × the time)", fontsize=10)
        if number >= len(scenes) - across:
            axes.set_xlabel("time, in times of the default settings")
        if number % across == 0:
            axes.set_ylabel("mean relative error, %")
    figure.legend(
        shown.values(),
        shown.keys(),
        loc="outside upper center",
        ncols=min(len(shown), 2 * across),
        fontsize=9,
        frameon=False,
    )
    return figure


def _pareto_panel(
    axes: Axes, rows: Sequence[Mapping[str, Any]], colors: Mapping[str, str], shown: dict[str, Any]
) -> None:
    """The points of one scene; what they look like is added to `shown` by its name in the legend."""
    lowest = min((r["mean_relative_error"] for r in rows if 0.0 < r["mean_relative_error"] < np.inf), default=1e-6)

    def height(row: Mapping[str, Any]) -> float:
        # What is exact has no place on a logarithmic scale; it sits below the others.
        return 100.0 * min(max(row["mean_relative_error"], 0.5 * lowest), 1e6)

    front = sorted((r for r in rows if r["front"]), key=lambda r: r["relative_time"])
    if front:
        # Until one takes the time of the next better one, one has the error of this one.
        (line,) = axes.step(
            [r["relative_time"] for r in front],
            [height(r) for r in front],
            where="post",
            color=_FRONT,
            linewidth=5,
            alpha=0.45,
            solid_capstyle="round",
            zorder=1,
        )
        shown.setdefault("not beaten in time and error", line)
    steps = sorted({r["steps"] for r in rows})
    for family in dict.fromkeys(r["family"] for r in rows):
        for number in steps:
            part = [r for r in rows if r["family"] == family and r["steps"] == number]
            if not part:
                continue
            color = colors[family]
            x = [r["relative_time"] for r in part]
            spread = [
                [r["relative_time"] - r["relative_time_low"] for r in part],
                [r["relative_time_high"] - r["relative_time"] for r in part],
            ]
            points = axes.errorbar(
                x,
                [height(r) for r in part],
                xerr=np.maximum(spread, 0.0),
                color=color,
                marker=_MARKERS[steps.index(number) % len(_MARKERS)],
                markersize=5,
                markerfacecolor=color if number == steps[0] else "white",
                linewidth=0.9,
                elinewidth=0.8,
                zorder=3,
            )
            shown.setdefault(f"{family}, {number} steps" if number else family, points)
            for row in part:
                usual = number == steps[0] and row["coefficients"] in (6, 14)
                if row["coefficients"] is not None and (row["front"] or usual):
                    axes.annotate(
                        str(row["coefficients"]),
                        (row["relative_time"], height(row)),
                        textcoords="offset points",
                        xytext=(5, 4),
                        fontsize=8,
                        color=color,
                    )
    default = [r for r in rows if r["default"]]
    if default:
        ring = axes.scatter(
            [r["relative_time"] for r in default],
            [height(r) for r in default],
            s=150,
            facecolors="none",
            edgecolors="black",
            linewidths=1.2,
            zorder=4,
        )
        shown.setdefault("default settings", ring)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.12)
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high / low > 6.0 else MaxNLocator(6))
    axes.xaxis.set_major_formatter(plain)
    axes.xaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 100.0 else (1.0,)))
    axes.yaxis.set_major_formatter(plain)
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="both", alpha=0.2)


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture for a sheet: what it is, and its linear colour (H, W, 3)."""

    name: str
    color: np.ndarray


def error_sheet(
    title: str, truth: np.ndarray, pictures: Sequence[Shown], truth_name: str = "converged march"
) -> Figure:
    """One row per picture: the picture, the reference, and the error of every pixel in false colour.

    The error of a pixel is the largest difference of a channel over the mean of the reference's lit values, as the
    window's error view has it.
    """
    height, width = truth.shape[:2]
    inches = 3.9
    tall = inches * height / width
    low, high = Compare().error_range
    norm, colormap = LogNorm(low, high, clip=True), ListedColormap(error_colormap())
    lit = truth[metrics.lit_mask(truth)]
    level = float(lit.mean()) if lit.size else 1.0
    stops = auto_exposure(truth)
    reference = display(truth, stops)
    rows = len(pictures)
    figure = Figure(figsize=(3 * inches + 0.4, rows * (tall + 0.3) + 1.1), layout="compressed")
    figure.suptitle(title, fontsize=12)
    grid = figure.subplots(rows, 3, squeeze=False)
    for axes, picture in zip(grid, pictures, strict=True):
        error = np.abs(picture.color - truth).max(axis=2) / level
        mean, decibels = metrics.mean_relative_error(picture.color, truth), metrics.psnr(picture.color, truth)
        axes[0].imshow(display(picture.color, stops), interpolation="nearest")
        axes[0].set_title(picture.name, fontsize=10)
        axes[1].imshow(reference, interpolation="nearest")
        axes[1].set_title(truth_name, fontsize=10)
        axes[2].imshow(colormap(norm(np.maximum(error, 1e-12)))[..., :3], interpolation="nearest")
        axes[2].set_title(f"error: {percent(mean)} on average, {decibel(decibels)} dB", fontsize=10)
        for a in axes:
            a.set_axis_off()
    bar = figure.colorbar(
        ScalarMappable(norm, colormap), ax=grid, orientation="horizontal", location="bottom", shrink=0.5, aspect=50
    )
    bar.set_label("error of a pixel, relative to the mean brightness of the picture", fontsize=9)
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{100.0 * v:g} %"))
    return figure


@dataclass(frozen=True, eq=False)
class Curve:
    """Transmittance at the distances of a profile, (N,), with a name for the legend and a family for the colour."""

    name: str
    family: str
    transmittance: np.ndarray
    dashed: bool = False


@dataclass(frozen=True, eq=False)
class Profile:
    """What light meets on its way through one point: the truth, and what stored values make of it.

    `distance` (N,) in stage units along the light ray, `picked` that of the point, `truth` (N,) by a fine march.
    """

    title: str
    distance: np.ndarray
    picked: float
    truth: np.ndarray
    curves: tuple[Curve, ...]


def profiles(found: Sequence[Profile]) -> Figure:
    """One panel per profile; the upper half linear, the lower half logarithmic, where what is dark shows."""
    figure = Figure(figsize=(0.6 + 5.6 * len(found), 6.6), layout="constrained")
    grid = figure.subplots(2, len(found), squeeze=False, sharex="col")
    for column, profile in enumerate(found):
        colors = family_colors([c.family for c in profile.curves])
        for row in range(2):
            axes = grid[row][column]
            axes.plot(profile.distance, profile.truth, color="black", linewidth=2.4, alpha=0.35, label="march (truth)")
            for curve in profile.curves:
                style = "--" if curve.dashed else "-"
                values = np.maximum(curve.transmittance, 1e-5) if row else curve.transmittance
                axes.plot(profile.distance, values, style, color=colors[curve.family], linewidth=1.2, label=curve.name)
            axes.axvline(profile.picked, color="#777777", linewidth=0.8, linestyle=":")
            axes.grid(alpha=0.2)
        grid[0][column].set_title(profile.title, fontsize=10)
        grid[0][column].set_ylim(-0.05, 1.05)
        grid[1][column].set_yscale("log")
        grid[1][column].set_ylim(1e-4, 1.3)
        grid[1][column].set_xlabel("distance along the light ray; dotted: the point that the pixel sees")
        grid[0][column].legend(fontsize=8)
    grid[0][0].set_ylabel("transmittance")
    grid[1][0].set_ylabel("transmittance, logarithmic")
    return figure


def speed(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Error against the time of a whole frame in multiples of the floor, one panel per scene; `rows` as of
    `previs.bench.speed.records.rows_of`."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    across = min(3, len(scenes))
    down = -(-len(scenes) // across)
    figure = Figure(figsize=(1.0 + 4.4 * across, 1.2 + 3.5 * down), layout="constrained")
    drawn = [row for row in rows if row["mean_relative_error"] is not None and row["whole_over_floor"]]
    families = list(dict.fromkeys(row["family"] for row in drawn))
    shown: dict[str, Any] = {}
    for number, scene in enumerate(scenes):
        axes = figure.add_subplot(down, across, number + 1)
        part = [row for row in drawn if row["scene"] == scene]
        lowest = min((r["mean_relative_error"] for r in part if r["mean_relative_error"] > 0.0), default=1e-6)
        for row in part:
            x, y = row["whole_over_floor"], 100.0 * max(row["mean_relative_error"], 0.5 * lowest)
            color = _COLORS[families.index(row["family"]) % len(_COLORS)]
            ends = [[max(y - 100.0 * row["mean_relative_error_low"], 0.0)]]
            ends.append([max(100.0 * row["mean_relative_error_high"] - y, 0.0)])
            spread = [[max(x - row["whole_over_floor_low"], 0.0)], [max(row["whole_over_floor_high"] - x, 0.0)]]
            point = axes.errorbar([x], [y], xerr=spread, yerr=ends, color=color, marker="o", markersize=5, linewidth=1)
            axes.annotate(
                row["way"], (x, y), textcoords="offset points", xytext=(5, 4), fontsize=7, color=color, clip_on=True
            )
            shown.setdefault(row["family"], point)
        axes.set_title(scene, fontsize=10)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.margins(0.2)
        _plain_numbers(axes)
        axes.grid(which="both", alpha=0.2)
        if number >= len(scenes) - across:
            axes.set_xlabel("whole frame, in times of the floor")
        if number % across == 0:
            axes.set_ylabel("mean relative error, %")
    figure.legend(shown.values(), shown.keys(), loc="outside upper center", ncols=6, fontsize=9, frameon=False)
    return figure


def _plain_numbers(axes: Axes) -> None:
    """Logarithmic axes labelled with plain numbers, as many as there is room for."""
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 200.0 else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


@dataclass(frozen=True, eq=False)
class Growth:
    """Times (N,) in seconds over amounts (N,), with the name for the legend and the fitted (exponent, factor)."""

    name: str
    amounts: Sequence[float]
    seconds: Sequence[float]
    fit: tuple[float, float] | None


def growth(title: str, unit: str, curves: Sequence[Growth]) -> Figure:
    """Times over the size of what is swept, both logarithmic, with the fitted power laws as thin lines."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for number, curve in enumerate(curves):
        color = _COLORS[number % len(_COLORS)]
        marker = _MARKERS[number % len(_MARKERS)]
        axes.plot(curve.amounts, curve.seconds, marker, color=color, markersize=6, label=curve.name)
        if curve.fit is not None:
            exponent, factor = curve.fit
            x = np.geomspace(min(curve.amounts), max(curve.amounts), 32)
            axes.plot(x, factor * x**exponent, color=color, linewidth=1, alpha=0.6)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.1)
    _plain_numbers(axes)
    axes.set_title(title, fontsize=11)
    axes.set_xlabel(unit)
    axes.set_ylabel("processor time of a frame, s")
    axes.grid(which="both", alpha=0.2)
    axes.legend(fontsize=8)
    return figure
