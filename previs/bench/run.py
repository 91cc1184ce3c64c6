"""Measuring ways to render a scene against one another: which error, in which time.

A `Variant` is a name and the knobs that it sets, so that whatever has knobs can be measured. All variants of a scene
are rendered in turns in one run, each time from nothing, so that whatever else the machine does meets all alike; times
are compared within a turn, and only these ratios are comparable between machines.
"""

from __future__ import annotations

import itertools
import math
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .. import metrics
from ..api import choose_camera, choose_size
from ..description import Camera
from ..errors import PrevisError
from ..image import Image
from ..index import RenderIndex
from ..render.draws import fine_steps_across
from ..render.method import METHODS
from ..render.renderer import Renderer
from ..scene import Scene
from ..settings import BY_NAME, Settings

T = TypeVar("T")
#: What is told while a run goes on: what is being done, how many pictures are done, and of how many.
Progress = Callable[[str, int, int], None]

#: The shipped scenes, in the order in which they are shown.
SHIPPED = ("plume", "pyroclastic", "sandstorm", "cloud", "shaft", "duo")
#: A march is converged when doubling its steps changes the picture by less than this mean relative error.
CONVERGED = 5e-4
#: Steps of the view and the light rays that the search for a converged march begins with.
FIRST_STEPS = 512


def scene_folder() -> Path:
    """Where the shipped scenes are: inside an installed package, or beside it in a source tree."""
    installed = Path(__file__).parent.parent / "_scenes"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "scenes"


def shipped_stages() -> list[Path]:
    """The stages of the shipped scenes."""
    return [scene_folder() / f"{name}.usda" for name in SHIPPED]


@dataclass(frozen=True)
class Variant:
    """A way to render: its name, and the knobs in which it differs from the stage's own settings.

    Variants of one `family` are drawn alike: they differ in the number of stored values and in steps alone.
    """

    name: str
    settings: Mapping[str, Any]
    family: str


def variants(
    methods: Iterable[str],
    coefficients: Iterable[int],
    steps: Iterable[int],
    others: Mapping[str, Sequence[Any]] | None = None,
) -> list[Variant]:
    """All combinations of transmittance methods, stored values and steps; slices and marches have no number of values.

    Args:
        methods: values of the knob `transmittance`.
        coefficients: numbers of stored values.
        steps: of view rays and of light rays alike; 0 leaves both to the plan.
        others: values of other knobs, to combine with all methods that store something. What differs from a knob's
            default is in the name, and makes a family of its own.

    Raises:
        ValueError: for an unknown knob, and a value that a knob does not take.
    """
    coefficients, steps, found = list(coefficients), list(steps), []
    for name in others or {}:
        if name not in BY_NAME:
            raise ValueError(f"no knob {name!r}; known are {', '.join(BY_NAME)}")
    combined = [dict(zip(others or {}, values, strict=True)) for values in itertools.product(*(others or {}).values())]
    for method in methods:
        BY_NAME["transmittance"].parse(method)
        counts = coefficients if METHODS[method].has_coefficients else [None]
        for more, count in itertools.product(combined if METHODS[method].has_maps else [{}], counts):
            more = {name: BY_NAME[name].parse(value) for name, value in more.items()}
            unusual = "".join(f", {n} {v}" for n, v in more.items() if v != BY_NAME[n].default)
            for number in steps:
                settings: dict[str, Any] = {"transmittance": method, **more}
                if count is not None:
                    settings["coefficients"] = BY_NAME["coefficients"].parse(count)
                if number:
                    settings["steps"] = settings["light_steps"] = BY_NAME["steps"].parse(number)
                name = method if count is None else f"{method} {count}"
                name += unusual + (f", {number} steps" if number else "")
                found.append(Variant(name, settings, method + unusual))
    return found


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene to measure on, with the camera, the size and the stage's own settings."""

    name: str
    file: str
    index: RenderIndex
    camera: Camera
    size: tuple[int, int]
    settings: Settings


@contextmanager
def opened(stage: str | os.PathLike[str], width: int, camera: str | None = None, name: str = "") -> Iterator[Subject]:
    """A stage as a subject, for as long as the block lasts.

    Args:
        stage: the file.
        width: of the picture in pixels; the height follows the camera's aspect.
        camera: a camera's prim path or name; None is the stage's own choice.
        name: of the scene; the file's where it is empty.

    Raises:
        PrevisError: when it cannot be opened, or has no volume to measure on.
    """
    with Scene.open(stage) as scene:
        yield subject_of(scene, name or Path(stage).stem, str(stage), width, camera)


def subject_of(scene: Scene, name: str, file: str, width: int, camera: str | Camera | None = None) -> Subject:
    """A scene as a subject; arguments as for `opened`.

    Raises:
        PrevisError: when there is no volume to measure on, or no such camera.
    """
    description = scene.describe()
    if not description.volumes:
        raise PrevisError(f"{file}: no volume, so there is nothing to measure")
    chosen = choose_camera(scene, description, camera, None)
    index = RenderIndex()
    index.update(description)
    return Subject(name, file, index, chosen, choose_size(chosen, width), Settings(**scene.settings()))


@dataclass(frozen=True)
class Spread:
    """The median of several measurements and the quartiles around it."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Of one value or more; of one, all three are that value."""
        low, median, high = np.percentile(np.asarray(values, float), (25, 50, 75))
        return cls(float(median), float(low), float(high))


def in_turns(count: int, repeats: int, run: Callable[[int, int], T]) -> list[list[T]]:
    """Call ``run(item, turn)`` for every item in every turn, and return what came of it by item.

    Turn 0 warms up, compiling shaders and filling caches, and what comes of it is dropped.
    """
    found: list[list[T]] = [[] for _ in range(count)]
    for turn in range(repeats + 1):
        for item in range(count):
            value = run(item, turn)
            if turn > 0:
                found[item].append(value)
    return found


@dataclass(frozen=True, eq=False)
class Result:
    """What a variant gave: its picture, and what it took.

    `seconds` by the clock of `clock_of`; `speedup` is how many times less that is than the reference took in the same
    turn, and `relative_time` how many times as much as the default settings took. `view_speedup` is the same as
    `speedup` of the time that passed in the march along view rays alone: what a camera's movement takes, for which maps
    need not be filled again.
    """

    variant: Variant
    image: Image
    seconds: Spread
    speedup: Spread
    relative_time: Spread
    view_speedup: Spread


@dataclass(frozen=True, eq=False)
class Run:
    """All results of one interleaved run over a scene, and what they are compared with."""

    subject: Subject
    reference: Result
    results: tuple[Result, ...]
    #: Name of the variant that is the default settings.
    default: str


def clock_of(renderer: Renderer) -> tuple[Callable[[], float], str]:
    """The clock that frames are timed with, and its name in words.

    On a software rasteriser it is the processor time of all threads together, which other work on the machine hardly
    changes; otherwise the time that passes.
    """
    if renderer.is_software:
        return time.process_time, "processor time, all threads together"
    return time.perf_counter, "time from the call to the finished picture"


def measure(
    renderer: Renderer,
    subject: Subject,
    reference: Variant,
    chosen: Sequence[Variant],
    repeats: int,
    progress: Progress | None = None,
) -> Run:
    """Render the reference and all variants in turns, every picture from nothing.

    Where none of the variants is what the stage's own settings give, that is measured too, as "default".

    Raises:
        PrevisError: when one of them cannot be rendered; the message says which.
    """
    clock, _ = clock_of(renderer)
    settings = [subject.settings.replace(**v.settings) for v in chosen]
    chosen = list(chosen)
    same = [v.name for v, s in zip(chosen, settings, strict=True) if dict(s) == dict(subject.settings)]
    if not same:
        chosen.append(Variant("default", {}, subject.settings.transmittance))
        settings.append(subject.settings)
    default = same[0] if same else "default"
    everything = [reference, *chosen]
    all_settings = [subject.settings.replace(**reference.settings), *settings]
    images: dict[int, Image] = {}

    def one(item: int, turn: int) -> tuple[float, float]:
        if progress is not None:
            progress(f"{subject.name}: {everything[item].name}", turn * len(everything) + item, total)
        renderer.forget_scene()
        begin = clock()
        try:
            images[item] = renderer.render(subject.index, subject.camera, subject.size, all_settings[item])
        except PrevisError as error:
            raise PrevisError(f"{subject.name}, {everything[item].name}: {error}") from error
        return clock() - begin, images[item].stats["times"].get("march", math.nan)

    total = len(everything) * (repeats + 1)
    taken = in_turns(len(everything), repeats, one)
    times, views = ([[pair[part] for pair in turns] for turns in taken] for part in range(2))
    base = times[[v.name for v in everything].index(default)]
    results = [
        Result(
            v,
            images[i],
            Spread.of(times[i]),
            Spread.of([a / b for a, b in zip(times[0], times[i], strict=True)]),
            Spread.of([a / b for a, b in zip(times[i], base, strict=True)]),
            Spread.of([a / b for a, b in zip(views[0], views[i], strict=True)]),
        )
        for i, v in enumerate(everything)
    ]
    return Run(subject, results[0], tuple(results[1:]), default)


@dataclass(frozen=True)
class Convergence:
    """A march, and what doubling all of its steps changes: the mean relative error of it against the doubled one.

    `converged` is whether that is below `CONVERGED`; if not, more steps cannot be taken.
    """

    steps: int
    light_steps: int
    change: float
    converged: bool

    @property
    def variant(self) -> Variant:
        """The march as a variant."""
        settings = {"transmittance": "march", "steps": self.steps, "light_steps": self.light_steps}
        return Variant("converged march", settings, "reference")


def converged_march(
    renderer: Renderer, subject: Subject, progress: Progress | None = None, width: int | None = None
) -> Convergence:
    """The brute-force march of a scene with the least steps, in doublings, whose doubling changes nothing.

    Args:
        renderer: any.
        subject: the scene.
        progress: told of every picture.
        width: of the pictures that are compared, in pixels; None is a quarter of the subject's, at least 64 or the
            subject's own. The number of steps that a ray needs does not depend on how many rays there are.

    Raises:
        PrevisError: when the march of the first number of steps cannot be rendered.
    """
    full = subject.size[0]
    width = min(full, width or max(full // 4, 64))
    size = (width, max(round(subject.size[1] * width / full), 1))

    def render(steps: int) -> np.ndarray:
        if progress is not None:
            progress(f"{subject.name}: does a march of {steps} steps converge?", 0, 1)
        settings = subject.settings.replace(transmittance="march", steps=steps, light_steps=steps)
        return renderer.render(subject.index, subject.camera, size, settings).color

    finest = max(fine_steps_across(v.record) for v in subject.index.volumes.values())
    steps = FIRST_STEPS
    while steps < finest:
        steps *= 2
    renderer.forget_scene()
    picture = render(steps)
    change = float("inf")
    while 2 * steps <= BY_NAME["steps"].maximum:
        try:
            doubled = render(2 * steps)
        except PrevisError:
            # The device's limit for one draw; what is reached is told.
            break
        change = metrics.mean_relative_error(picture, doubled)
        if change < CONVERGED:
            return Convergence(steps, steps, change, True)
        steps, picture = 2 * steps, doubled
    return Convergence(steps, steps, change, False)


def errors_of(image: Image, truth: Image) -> dict[str, float | None]:
    """How far a picture is from the truth: of the whole picture, and of the in-scattered light alone (``volume_…``).

    SSIM is None for pictures below 11 pixels.
    """
    small = min(truth.color.shape[:2]) < 11
    found: dict[str, float | None] = {
        "mean_relative_error": metrics.mean_relative_error(image.color, truth.color),
        "relative_rmse": metrics.relative_rmse(image.color, truth.color),
        "psnr": metrics.psnr(image.color, truth.color),
        "ssim": None if small else metrics.ssim(image.color, truth.color),
    }
    if "volume" in truth.aovs:
        pair = image.aovs["volume"], truth.aovs["volume"]
        found["volume_mean_relative_error"] = metrics.mean_relative_error(*pair)
        found["volume_psnr"] = metrics.psnr(*pair)
    return found


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Which points (cost, error) no other point beats: their numbers, by rising cost and falling error.

    A point is beaten by one that is no worse in both and better in one. Of equal points the first is kept.
    """
    front: list[int] = []
    for i in sorted(range(len(points)), key=lambda i: (*points[i], i)):
        if not front or points[i][1] < points[front[-1]][1]:
            front.append(i)
    return front


def machine(renderer: Renderer) -> dict[str, Any]:
    """What a run was measured on."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        pass
    return {
        "system": platform.platform(),
        "python": platform.python_version(),
        "processor": processor,
        "processors": os.cpu_count() or 1,
        "device": renderer.device,
        "software": renderer.is_software,
        "clock": clock_of(renderer)[1],
    }
