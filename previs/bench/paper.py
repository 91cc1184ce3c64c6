"""The tables of the papers whose methods previs has, measured anew and set beside what they published.

[TFM11] Delalandre, Gautron, Marvie, François: Transmittance Function Mapping, I3D 2011: Table 1.
[ATFM12] the adaptive variant, DigiPro 2012: original against adaptive maps on a pyroclastic ball, in numbers, which the
paper shows in pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics
from ..description import Volume
from ..image import Image
from ..io import auto_exposure, display
from ..render.method import METHODS
from ..render.probe import probe
from ..render.renderer import Renderer
from ..scene import Scene
from ..settings import Settings
from . import media, plots
from .records import plain
from .reference_scene import reference_camera
from .run import Progress, Run, Subject, Variant, converged_march, measure, scene_folder, subject_of
from .tables import Table, decibel, percent, ratio

#: Coefficients of [TFM11] Table 1, and its density weighting.
COUNTS = (2, 8, 16)
WEIGHTING = 10.0
#: "using 100 samples/ray and a 1024² Transmittance Function Map".
STEPS, MAP_SIZE = 100, 1024
#: [TFM11] Table 1 by coefficients: frames per second; SSIM with density weighting and without; PSNR in dB likewise.
PUBLISHED = {
    "smoke": {
        2: (15.10, 0.9973, 0.8712, 54.52, 17.64),
        8: (14.78, 0.9974, 0.9549, 58.58, 25.50),
        16: (12.18, 0.9974, 0.9535, 60.02, 25.60),
    },
    "solid": {
        2: (14.41, 0.9868, 0.7977, 35.61, 16.74),
        8: (14.20, 0.9903, 0.8257, 43.27, 15.07),
        16: (13.98, 0.9905, 0.7755, 46.19, 14.30),
    },
}
#: Optical depth of the deepest way of the light through the media of Table 1, which the paper does not tell.
OPTICAL_DEPTH = {"smoke": 10.0, "solid": 10.0}
#: Of the media of Table 1: "low albedo media such as smoke"; the solid's is not told.
ALBEDO = {"smoke": 0.3, "solid": 0.8}
#: Optical depths at which the published method is tried on the media of Table 1.
THIN_TO_DENSE = (0.3, 1.0, 3.0, 10.0, 30.0)
#: Optical depths of the pyroclastic ball.
DEPTHS = (5.0, 50.0, 500.0, 5000.0)


@dataclass(frozen=True, eq=False)
class Paper:
    """What is shown of a paper: text, tables, and figures by name with a caption each; `record` is for JSON."""

    title: str
    text: tuple[str, ...]
    tables: tuple[Table, ...]
    figures: dict[str, plots.Figure]
    captions: dict[str, str]
    record: dict[str, Any] = field(default_factory=dict)


def tables(
    renderer: Renderer,
    smokes: Sequence[str] = (),
    quick: bool = False,
    repeats: int = 5,
    progress: Progress | None = None,
) -> list[Paper]:
    """Measure both papers' tables.

    Args:
        renderer: any.
        smokes: .vdb files of more smokes for the table of [TFM11].
        quick: small pictures, and in the table of [TFM11] maps of a quarter of its side.
        repeats: turns of the timing.
        progress: told of every picture.

    Raises:
        PrevisError: when a file cannot be read, or a scene cannot be rendered.
    """
    size, map_size = (160, MAP_SIZE // 4) if quick else (720, MAP_SIZE)
    return [
        transmittance_function_maps(renderer, smokes, size, repeats, progress, map_size),
        adaptive_maps(renderer, 160 if quick else 480, progress),
    ]


def own_methods() -> list[str]:
    """The methods with a number of values besides the published one of [TFM11]."""
    return [m.name for m in METHODS.values() if m.has_coefficients and m.name != "tfm-plain"]


# --- [TFM11] Table 1 --------------------------------------------------------------------------------------------------


def transmittance_function_maps(
    renderer: Renderer,
    smokes: Sequence[str] = (),
    size: int = 512,
    repeats: int = 5,
    progress: Progress | None = None,
    map_size: int = MAP_SIZE,
) -> Paper:
    """[TFM11] Table 1; arguments as for `tables`, `size` of the square pictures in pixels."""
    subjects = [("smoke", "smoke", media.smoke()), ("solid", "solid", media.solid())]
    subjects[1:1] = [(Path(file).stem, "smoke", media.cube_of(file)) for file in smokes]
    found, profiles, pictures, record = [], [], {}, []
    for name, kind, density in subjects:
        with media.made_scene(density, OPTICAL_DEPTH[kind], ALBEDO[kind]) as scene:
            subject = subject_of(scene, name, name, size)
            run = measure(renderer, subject, _march(map_size), _ways(map_size), repeats, progress)
            profiles.append(_profile(renderer, run, map_size))
        rows = {
            r.variant.name: _quality(r.image, run.reference.image) | {"speed": r.speedup, "view": r.view_speedup}
            for r in run.results
        }
        found.append(_table_one(name, kind, rows))
        shown = [plots.Shown(n, run_image(run, n).color) for n in ("tfm-plain 8, weighted", "tfm-plain 8", "tfm 8")]
        pictures[f"paper-{name}"] = plots.error_sheet(
            f"{name}, 8 values", run.reference.image.color, shown, "dual ray march"
        )
        record.append({"medium": name, "results": [_plain(n, row) for n, row in rows.items()]})
    depths = _by_depth(renderer, min(size, 160), min(map_size, 256), progress)
    names = ", ".join(own_methods())
    text = (
        "The first table of the paper: maps of 2, 8 and 16 coefficients against a dual ray march of the same "
        f"{STEPS} steps per ray, on {media.SIDE}³ voxels with a {map_size}² map, in the paper's layout. tfm-plain is "
        f"the published method, with density weighting {WEIGHTING:g} (DW) and without; {names}: the methods of previs "
        "with as many stored values. They choose their weighting themselves and are written under DW.",
        "Each medium is lit by one distant light. Optical depth along its deepest way through the medium: "
        + ", ".join(f"{k} {v:g}" for k, v in OPTICAL_DEPTH.items())
        + "; albedo: "
        + ", ".join(f"{k} {v:g}" for k, v in ALBEDO.items())
        + ". The paper tells neither, nor its media, light and camera: the smoke here is the shipped plume, the solid "
        "a union of ellipsoids in place of the Stanford bunny. Figures can be compared in kind, not digit by digit.",
        "PSNR and SSIM are those of the pictures as they are displayed (sRGB, 8 bits, peak 255), which the paper is "
        "assumed to mean; PSNR of the linear radiance, whose peak is the 99.9th percentile of the march, is in the "
        "last columns. Speed is in frames per second in the paper (on a GTX 480) and here in times faster than the "
        "dual ray march: of a frame from nothing, map and all, and of one for which the map is there, as when the "
        f"camera moves. A {map_size}² map has {map_size**2 / size**2:.1f} rays for every pixel of these pictures of "
        f"{size}², each through the whole box, while the march follows a ray to the light only from where a pixel sees "
        "the medium: for one picture of one small medium filling the map can cost more than it saves.",
        "How good full-range maps are hangs on the optical depth above all, as the table by optical depth shows: the "
        "published figures with weighting lie where a medium is thin. Near T = 1 the tenth power makes the error of a "
        "stored value ten times larger, near 0 it makes it smaller; so weighting mends ripples in the dark and costs "
        "accuracy where light enters, as the light rays below show. Without weighting the published PSNR falls when "
        "coefficients are added, which the error of a projection by itself cannot do.",
    )
    figures = {"paper-light-rays": plots.profiles(profiles), **pictures}
    captions = {
        "paper-light-rays": "Transmittance along the light ray through what the worst pixel of tfm-plain 8 with "
        "density weighting sees: the truth, and what 8 stored values make of it."
    }
    captions |= {name: f"{name.removeprefix('paper-')}: error of every pixel with 8 values." for name in pictures}
    return Paper(
        "Transmittance Function Mapping [TFM11], Table 1",
        text,
        (*found, depths),
        figures,
        captions,
        {"paper": "TFM11 table 1", "size": size, "map_size": map_size, "steps": STEPS, "media": record},
    )


def run_image(run: Run, name: str) -> Image:
    """The picture of a variant."""
    return next(r.image for r in run.results if r.variant.name == name)


def _march(map_size: int) -> Variant:
    settings = {"transmittance": "march", "steps": STEPS, "light_steps": STEPS, "map_size": map_size}
    return Variant("dual ray march", settings, "march")


def _ways(map_size: int) -> list[Variant]:
    """The methods and numbers of values of Table 1."""
    common = {"steps": STEPS, "light_steps": STEPS, "map_size": map_size}
    found = []
    for count in COUNTS:
        for alpha, suffix in ((WEIGHTING, ", weighted"), (1.0, "")):
            settings = {"transmittance": "tfm-plain", "coefficients": count, "density_weighting": alpha, **common}
            found.append(Variant(f"tfm-plain {count}{suffix}", settings, "tfm-plain"))
        for method in own_methods():
            settings = {"transmittance": method, "coefficients": count, **common}
            found.append(Variant(f"{method} {count}", settings, method))
    return found


def displayed(color: np.ndarray, stops: float) -> np.ndarray:
    """Linear radiance as an 8-bit sRGB picture shows it, values in [0, 1]."""
    return np.round(display(color, stops) * 255.0) / 255.0


def _quality(image: Image, truth: Image) -> dict[str, float]:
    """PSNR and SSIM of the displayed pictures, and PSNR of the linear ones."""
    stops = auto_exposure(truth.color)
    shown, wanted = displayed(image.color, stops), displayed(truth.color, stops)
    return {
        "ssim": metrics.ssim(shown, wanted, peak=1.0),
        "psnr": metrics.psnr(shown, wanted, peak=1.0),
        "linear_psnr": metrics.psnr(image.color, truth.color),
        "mean_relative_error": metrics.mean_relative_error(image.color, truth.color),
    }


def _table_one(name: str, kind: str, rows: dict[str, dict[str, Any]]) -> Table:
    lines, marked = [], set()

    def similarity(value: float) -> str:
        return f"{100.0 * value:.2f} %"

    for count in COUNTS:
        fps, ssim, ssim_off, psnr, psnr_off = PUBLISHED[kind][count]
        marked.add(len(lines))
        numbers = (similarity(ssim), similarity(ssim_off), f"{psnr:.2f}", f"{psnr_off:.2f}", "–", "–")
        lines.append((str(count), "published [TFM11]", f"{fps:.2f} fps", "–", *numbers))
        on, off = rows[f"tfm-plain {count}, weighted"], rows[f"tfm-plain {count}"]
        lines.append(
            (
                str(count),
                "tfm-plain",
                ratio(on["speed"].median),
                ratio(on["view"].median),
                similarity(on["ssim"]),
                similarity(off["ssim"]),
                f"{on['psnr']:.2f}",
                f"{off['psnr']:.2f}",
                f"{on['linear_psnr']:.2f}",
                f"{off['linear_psnr']:.2f}",
            )
        )
        for method in own_methods():
            row = rows[f"{method} {count}"]
            numbers = (similarity(row["ssim"]), "–", f"{row['psnr']:.2f}", "–", f"{row['linear_psnr']:.2f}", "–")
            speeds = ratio(row["speed"].median), ratio(row["view"].median)
            lines.append((str(count), method, *speeds, *numbers))
    header = (
        "values",
        "method",
        "speed",
        "speed, maps kept",
        "SSIM, DW",
        "SSIM, no DW",
        "PSNR, DW",
        "PSNR, no DW",
        "linear PSNR, DW",
        "linear PSNR, no DW",
    )
    beside = f"; published: {'Smoke' if kind == 'smoke' else 'Bunny'}"
    return Table(f"{name}, {media.SIDE}³ voxels{beside}", header, tuple(lines), names=2, marked=frozenset(marked))


def _by_depth(renderer: Renderer, size: int, map_size: int, progress: Progress | None) -> Table:
    """The published method on both media from thin to dense: PSNR of the displayed pictures."""
    ways = [v for v in _ways(map_size) if v.family == "tfm-plain"]
    lines = []
    for kind, density in (("smoke", media.smoke()), ("solid", media.solid())):
        for depth in THIN_TO_DENSE:
            with media.made_scene(density, depth, ALBEDO[kind]) as scene:
                subject = subject_of(scene, f"{kind}, optical depth {depth:g}", kind, size)
                truth = _render(renderer, subject, _march(map_size).settings)
                cells = {}
                for number, way in enumerate(ways):
                    if progress is not None:
                        progress(f"{subject.name}: {way.name}", number, len(ways))
                    cells[way.name] = _quality(_render(renderer, subject, way.settings), truth)["psnr"]
            weighted = [f"{cells[f'tfm-plain {n}, weighted']:.1f}" for n in COUNTS]
            lines.append((kind, f"{depth:g}", *weighted, *(f"{cells[f'tfm-plain {n}']:.1f}" for n in COUNTS)))
        lines.append(
            (
                kind,
                "published",
                *(f"{PUBLISHED[kind][n][3]:.1f}" for n in COUNTS),
                *(f"{PUBLISHED[kind][n][4]:.1f}" for n in COUNTS),
            )
        )
    header = (
        "medium",
        "optical depth",
        *(f"{n} values, DW" for n in COUNTS),
        *(f"{n} values, no DW" for n in COUNTS),
    )
    note = f"PSNR in dB of displayed pictures of {size}² pixels, with a {map_size}² map, against the dual ray march."
    published = frozenset(i for i, line in enumerate(lines) if line[1] == "published")
    return Table("tfm-plain by optical depth", header, tuple(lines), note, names=2, marked=published)


def _plain(name: str, row: dict[str, Any]) -> dict[str, Any]:
    numbers = {k: plain(v) for k, v in row.items() if k not in ("speed", "view")}
    for key, spread in (("speedup", row["speed"]), ("view_speedup", row["view"])):
        numbers |= {key: spread.median, f"{key}_low": spread.low, f"{key}_high": spread.high}
    return {"variant": name, **numbers}


def _profile(renderer: Renderer, run: Run, map_size: int, count: int = 8) -> plots.Profile:
    """The light ray through what the worst pixel of the weighted published method sees."""
    subject = run.subject
    truth = run.reference.image.color
    error = np.abs(run_image(run, f"tfm-plain {count}, weighted").color - truth).max(axis=2)
    pixel = np.unravel_index(int(np.argmax(error)), error.shape)
    point = seen_point(subject, (int(pixel[0]), int(pixel[1])))
    curves, found = [], None
    for variant in _ways(map_size):
        if variant.settings["coefficients"] != count:
            continue
        settings = subject.settings.replace(**variant.settings)
        found = probe(renderer, subject.index, settings, media.LIGHT, point)
        wanted = (settings.transmittance, settings.coefficients)
        curve = next(c for c in found.curves if (c.method, c.coefficients) == wanted)
        dashed = variant.settings.get("density_weighting") == 1.0
        curves.append(plots.Curve(variant.name, variant.family, curve.transmittance[:, 0], dashed))
    title = f"{subject.name}: pixel {pixel[1]}, {pixel[0]}"
    return plots.Profile(title, found.distance, found.picked, found.march.transmittance[:, 0], tuple(curves))


def seen_point(subject: Subject, pixel: tuple[int, int]) -> np.ndarray:
    """The point behind a pixel (row, column) from which the camera gets most: half of what it sees of the medium lies
    before it. (3,) in the world."""
    width, height = subject.size
    origins, directions, _ = reference_camera(subject.camera, width, height).rays(width, height)
    number = pixel[0] * width + pixel[1]
    origin, direction = origins[number], directions[number]
    volume = subject.index.volumes[media.VOLUME].record
    distance = np.linspace(0.0, 2.0 * float(np.linalg.norm(origin)), 4096)
    values = _nearest(volume, origin + distance[:, None] * direction) * max(volume.medium.strength)
    depth = np.cumsum(values) * (distance[1] - distance[0])
    seen = 1.0 - np.exp(-depth)
    return origin + distance[int(np.searchsorted(seen, 0.5 * seen[-1]))] * direction


def _nearest(volume: Volume, points: np.ndarray) -> np.ndarray:
    """Density of the nearest voxel, (N,)."""
    grid = volume.density.grid
    lo, hi = grid.bounds
    inverse = np.linalg.inv(volume.density.index_to_local @ volume.local_to_world)
    index = np.rint(points @ inverse[:3, :3] + inverse[3, :3]).astype(int) - lo
    values = grid.dense(lo, hi)
    within = ((index >= 0) & (index < values.shape)).all(axis=1)
    found = np.zeros(len(points))
    found[within] = values[tuple(index[within].T)]
    return found


# --- [ATFM12]: the pyroclastic ball -----------------------------------------------------------------------------------


def adaptive_maps(renderer: Renderer, width: int = 480, progress: Progress | None = None) -> Paper:
    """Original against adaptive maps on the pyroclastic ball, at optical depths from thin to extreme."""
    counts = (6, 14)
    ways = [
        (f"{label} {count}", {"transmittance": method, "coefficients": count, **more})
        for method, label, more in (
            ("tfm-plain", "tfm-plain", {"density_weighting": 1.0}),
            ("tfm-plain", f"tfm-plain, DW {WEIGHTING:g},", {"density_weighting": WEIGHTING}),
            *((method, method, {}) for method in own_methods()),
        )
        for count in counts
    ]
    lines, record, steps = [], [], []
    cells: dict[str, list[str]] = {name: [] for name, _ in ways}
    file = scene_folder() / "pyroclastic.usda"
    with Scene.open(file) as scene:
        path, volume = next(iter(scene.describe().volumes.items()))
        key = max((x for x in scene.describe().lights.values()), key=lambda x: max(x.strength))
        unit = media.deepest_way(volume, key.direction) * max(volume.medium.extinction)
        for depth in DEPTHS:
            scene.set_medium(path, density_scale=depth / unit, emission=(0.0, 0.0, 0.0))
            subject = subject_of(scene, f"pyroclastic, optical depth {depth:g}", str(file), width)
            truth = converged_march(renderer, subject, progress)
            steps.append(f"{depth:g}: {truth.steps}" + ("" if truth.converged else " (not converged)"))
            reference = _render(renderer, subject, truth.variant.settings)
            for number, (name, settings) in enumerate(ways):
                if progress is not None:
                    progress(f"{subject.name}: {name}", number, len(ways))
                image = _render(renderer, subject, {**settings, "steps": truth.steps})
                error = metrics.mean_relative_error(image.color, reference.color)
                value = metrics.psnr(image.color, reference.color)
                cells[name].append(f"{decibel(value)} dB, {percent(error)}")
                record.append(
                    {"optical_depth": depth, "way": name, "psnr": plain(value), "mean_relative_error": plain(error)}
                )
    names = {"tfm-plain": "original", "tfm": "adaptive"}
    for name, _ in ways:
        method = name.replace(",", " ").split()[0]
        lines.append((name, names.get(method, "beyond the papers"), *cells[name]))
    note = (
        "The shipped pyroclastic ball without its glow, its density scaled to the optical depth of the key light's "
        "deepest way through it. PSNR and mean error of the linear picture against the converged march; view rays take "
        f"the same steps in all ({'; '.join(steps)}), so that what differs is the light's transmittance alone."
    )
    header = ("method and values", "", *(f"optical depth {d:g}" for d in DEPTHS))
    table = Table("Original and adaptive maps by optical depth", header, tuple(lines), note, names=2)
    text = (
        "The paper shows in pictures that maps over the whole light ray lose the light in dense media, and that a "
        "range adapted to each ray keeps it, with 6 coefficients for interaction and 14 for quality. Here the same in "
        "numbers.",
    )
    return Paper(
        "Adaptive maps [ATFM12] on a pyroclastic ball",
        text,
        (table,),
        {},
        {},
        {"paper": "ATFM12", "width": width, "results": record},
    )


def _render(renderer: Renderer, subject: Subject, settings: Mapping[str, Any]) -> Image:
    values: Settings = subject.settings.replace(**settings)
    return renderer.render(subject.index, subject.camera, subject.size, values)
