"""How the cost of a picture grows with what it is made of: sweeps over one size each, with fitted exponents."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...render.renderer import Renderer
from ...scene import Scene
from ..run import Progress, Spread, Subject, Variant, in_turns, subject_of
from .clock import Stopwatch
from .ways import ALL_OFF, DEFAULT, accelerators

#: Seconds that a frame may take; the larger ones of a sweep are then left out.
LIMIT = 20.0
#: Where the cloud of the sweeps is, and how dense.
BOUNDS, EXTINCTION, ALBEDO = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), 12.0, 0.9


@dataclass(frozen=True)
class Fit:
    """A power law: time = `factor` · size^`exponent`. `error` is the standard error of the exponent, NaN for two
    points."""

    exponent: float
    error: float
    factor: float

    def __str__(self) -> str:
        doubt = f" ± {self.error:.2f}" if math.isfinite(self.error) else ""
        return f"{self.exponent:.2f}{doubt}"


def fit_power_law(sizes: Sequence[float], times: Sequence[float]) -> Fit:
    """The least squares line through the logarithms.

    Raises:
        ValueError: for fewer than two different sizes, and for what is not above 0.
    """
    x, y = np.asarray(sizes, float), np.asarray(times, float)
    if x.shape != y.shape or np.unique(x).size < 2:
        raise ValueError("a power law is fitted to times of two sizes or more")
    if not (np.all(x > 0.0) and np.all(y > 0.0)):
        raise ValueError("a power law is fitted to numbers above 0")
    x, y = np.log(x), np.log(y)
    dx = x - x.mean()
    slope = float(dx @ y / (dx @ dx))
    rest = y - y.mean() - slope * dx
    error = math.sqrt(float(rest @ rest) / (len(x) - 2) / float(dx @ dx)) if len(x) > 2 else math.nan
    return Fit(slope, error, math.exp(float(y.mean()) - slope * float(x.mean())))


def fractal_cloud(side: int, seed: int = 1) -> np.ndarray:
    """A cloud of `side`³ voxels, float32 from 0 to 1, of the same shape whatever the side.

    Four octaves of linearly interpolated noise of half the amplitude each lift and lower a ball whose outside is empty:
    about a quarter of the voxels hold something.
    """
    random = np.random.default_rng(seed)
    place = (np.arange(side) + 0.5) / side
    axis = np.asarray(2.0 * place - 1.0, np.float32)
    values = np.empty((side, side, side), np.float32)
    noise = []
    for octave in range(4):
        cells = 4 * 2**octave
        lattice = random.uniform(-1.0, 1.0, (cells + 1,) * 3).astype(np.float32) * np.float32(0.5**octave)
        at = place * cells
        low = np.minimum(at.astype(int), cells - 1)
        weights = np.zeros((side, cells + 1), np.float32)
        weights[np.arange(side), low] = 1.0 - (at - low)
        weights[np.arange(side), low + 1] = at - low
        noise.append((weights, lattice))
    # A slab at a time: at 512³ one array of temporaries would be as large as the cloud.
    for i in range(side):
        total = np.zeros((side, side), np.float32)
        for weights, lattice in noise:
            total += weights @ np.tensordot(weights[i], lattice, 1) @ weights.T
        radius = np.sqrt(axis[i] ** 2 + axis[:, None] ** 2 + axis[None, :] ** 2)
        values[i] = np.clip(2.5 * (0.75 - radius) + 0.6 * total, 0.0, 1.0)
    return values


@dataclass(frozen=True)
class Sweep:
    """One sweep: the `sizes`, `make` a subject of each, what settings they change, and what is counted."""

    name: str
    unit: str
    sizes: tuple[int, ...]
    make: Callable[[int, int], Any]
    settings: Callable[[int], dict[str, Any]] = field(default=lambda size: {})
    #: What to plot and fit against: the sizes themselves where it is None.
    amount: Callable[[int], float] = float
    #: Width of the pictures by size and the usual width.
    width: Callable[[int, int], int] = field(default=lambda size, usual: usual)


@dataclass(frozen=True, eq=False)
class Series:
    """Times of one way over the sizes of a sweep, in seconds of the processor, with the fit through the medians."""

    name: str
    amounts: tuple[float, ...]
    times: tuple[Spread, ...]
    fit: Fit | None


@dataclass(frozen=True, eq=False)
class Scaling:
    """What came of a sweep; `left_out` are the sizes that would have taken too long."""

    name: str
    unit: str
    series: tuple[Series, ...]
    left_out: tuple[int, ...] = ()


def sweeps(full: bool) -> list[Sweep]:
    """The sweeps, in the quick size or the full one."""
    voxels = (32, 64, 128, 256, 512) if full else (32, 64, 128)
    side = 128 if full else 64
    return [
        Sweep(
            "voxels",
            "voxels",
            voxels,
            lambda size, width: _cloud(size, width),
            # Enough for the largest at its full resolution.
            lambda size: {"field_memory": 1024},
            amount=lambda size: float(size) ** 3,
        ),
        Sweep(
            "pixels",
            "pixels",
            (80, 160, 320, 640, 1280) if full else (80, 160, 320),
            lambda size, width: _cloud(side, size),
            amount=lambda size: size * float(round(size * 9 / 16)),
            width=lambda size, usual: size,
        ),
        Sweep(
            "steps",
            "steps of a view ray",
            (32, 64, 128, 256, 512, 1024) if full else (64, 128, 256, 512),
            lambda size, width: _cloud(side, width),
            lambda size: {"steps": size},
        ),
        Sweep(
            "lights",
            "spots",
            (1, 3, 10, 30, 100) if full else (1, 4, 16),
            lambda size, width: _spots(side, width, size),
        ),
        Sweep(
            "volumes",
            "volumes",
            (1, 2, 4, 8, 16, 32) if full else (1, 2, 4, 8),
            lambda size, width: _volumes(side // 2, width, size),
        ),
        Sweep(
            "coefficients",
            "stored values",
            (2, 4, 6, 8, 10, 12, 14, 16) if full else (2, 6, 10, 14),
            lambda size, width: _cloud(side, width),
            lambda size: {"transmittance": "quantile", "coefficients": size},
        ),
    ]


SWEEPS = tuple(sweep.name for sweep in sweeps(False))


def _camera(scene: Scene, distance: float = 5.2) -> None:
    scene.add_camera("/Camera", position=(0.0, 0.3, distance), target=(0, 0, 0), focal_length=70)


@contextmanager
def _cloud(side: int, width: int) -> Iterator[Subject]:
    """One cloud under one distant light."""
    with Scene() as scene:
        scene.add_volume("/Cloud", fractal_cloud(side), bounds=BOUNDS, extinction=EXTINCTION, albedo=ALBEDO)
        scene.add_distant_light("/Sun", direction=(0.8, -0.7, -0.35), irradiance=10.0)
        _camera(scene)
        yield subject_of(scene, f"{side}³ voxels", "", width)


@contextmanager
def _spots(side: int, width: int, count: int) -> Iterator[Subject]:
    """One cloud under so many spots, spread evenly over a hemisphere (a golden spiral)."""
    with Scene() as scene:
        scene.add_volume("/Cloud", fractal_cloud(side), bounds=BOUNDS, extinction=EXTINCTION, albedo=ALBEDO)
        for n in range(count):
            height = 1.0 - (n + 0.5) / count
            angle = n * math.pi * (3.0 - math.sqrt(5.0))
            across = math.sqrt(1.0 - height * height)
            position = 4.0 * np.array([across * math.cos(angle), height, across * math.sin(angle)])
            scene.add_spot_light(
                f"/Spot{n}", tuple(position), (0, 0, 0), cone_angle=20.0, radiant_intensity=40.0 / count
            )
        _camera(scene)
        yield subject_of(scene, f"{count} spots", "", width)


@contextmanager
def _volumes(side: int, width: int, count: int) -> Iterator[Subject]:
    """So many clouds apart from each other on a square lattice, under one distant light, all in the picture."""
    with Scene() as scene:
        across = math.ceil(math.sqrt(count))
        size = 2.4 / across
        for n in range(count):
            corner = np.array([(n % across) * size - 1.2, (n // across) * size - 1.2, -0.5 * size])
            bounds = (tuple(corner + 0.05 * size), tuple(corner + 0.95 * size))
            cloud = fractal_cloud(side, seed=n + 1)
            scene.add_volume(f"/Cloud{n}", cloud, bounds=bounds, extinction=EXTINCTION / size, albedo=ALBEDO)
        scene.add_distant_light("/Sun", direction=(0.8, -0.7, -0.35), irradiance=10.0)
        _camera(scene)
        yield subject_of(scene, f"{count} volumes", "", width)


def scaling(
    renderer: Renderer,
    chosen: Iterable[Sweep],
    width: int,
    repeats: int,
    progress: Progress | None = None,
    limit: float = LIMIT,
) -> list[Scaling]:
    """Time the sweeps: the whole frame and the one after a camera move by default, and the whole frame with all
    accelerators off, in turns.

    Raises:
        PrevisError: when a scene cannot be rendered.
    """
    return [_scaled(renderer, sweep, width, repeats, progress, limit) for sweep in chosen]


def _scaled(
    renderer: Renderer, sweep: Sweep, width: int, repeats: int, progress: Progress | None, limit: float
) -> Scaling:
    ways = [Variant(DEFAULT, {}, "default")]
    if accelerators():
        ways.append(Variant(ALL_OFF, accelerators(), "off"))
    taken: dict[str, list[tuple[float, Spread]]] = {}
    left_out, slow = [], set()
    for number, size in enumerate(sweep.sizes):
        if len(slow) == len(ways):
            left_out.append(size)
            continue
        if progress is not None:
            progress(f"{sweep.name}: {size}", number, len(sweep.sizes))
        renderer.forget_scene()
        with sweep.make(size, sweep.width(size, width)) as subject, Stopwatch(renderer, subject) as watch:
            asked = [w for w in ways if w.name not in slow]

            def one(item: int, turn: int, watch=watch, asked=asked, size=size) -> tuple[float, float, float]:
                settings = watch.settings({**sweep.settings(size), **asked[item].settings})
                whole = watch.whole(settings)
                return whole.process, watch.camera_move(settings).process, whole.wall

            for way, turns in zip(asked, in_turns(len(asked), repeats, one), strict=True):
                whole, camera, wall = zip(*turns, strict=True)
                amount = sweep.amount(size)
                taken.setdefault(f"{way.name}: whole frame", []).append((amount, Spread.of(whole)))
                taken.setdefault(f"{way.name}: camera move", []).append((amount, Spread.of(camera)))
                if min(wall) * _growth(sweep, number) > limit:
                    slow.add(way.name)
    series = []
    for name, points in taken.items():
        amounts, times = zip(*points, strict=True)
        medians = [t.median for t in times]
        fit = fit_power_law(amounts, medians) if len(points) > 1 and min(medians) > 0.0 else None
        series.append(Series(name, amounts, times, fit))
    return Scaling(sweep.name, sweep.unit, tuple(series), tuple(left_out))


def _growth(sweep: Sweep, number: int) -> float:
    """How many times longer the next size of a sweep may take."""
    if number + 1 == len(sweep.sizes):
        return 1.0
    return sweep.sizes[number + 1] / sweep.sizes[number]
