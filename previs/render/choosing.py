"""The cheapest settings that keep an error below a limit.

Candidates are tried on the few pixels that the error meter looks at, whose truth is drawn once. From cheap settings on,
what the meter blames is raised: the view's steps, or what the light's way is known by. Once the limit is met every knob
is lowered again as far as it stays met. The picture is then drawn and measured with other pixels; where it misses the
limit after all, the search goes on for a lower one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from ..description import Camera
from ..image import Image
from ..index import RenderIndex
from ..meter import ErrorPart, ErrorScale, PixelSample
from ..settings import BY_NAME, Settings
from .draws import light_steps_across, steps_across
from .measure import ErrorMeter, brute_force, converged
from .method import METHODS, SLICES_PER_DRAW, method_of
from .renderer import Renderer

#: Knobs that are chosen; those that the caller gives keep their values.
CHOSEN = ("transmittance", "coefficients", "steps", "light_steps", "map_size", "slices")
#: Those of them that say how light's way is known.
LIGHT_KNOBS = ("coefficients", "slices", "map_size", "light_steps")
#: Methods in the order of what they take.
METHODS_TRIED = ("slices", "quantile", "march")
#: Rungs of the ladders of knobs: numbers of values, and parts of what the plan would take.
COEFFICIENTS = (4, 6, 10, 14)
STEPS = (0.25, 0.5, 1.0, 2.0, 4.0)
LIGHT_STEPS = (0.5, 1.0, 2.0, 4.0)
MAP_SIZES = (0.25, 0.5, 1.0, 2.0, 4.0)
#: The same of slices and of their sizes, which cost by the product.
SLICES = (0.25, 0.5, 1.0, 2.0)
#: A raise that leaves more than this part of the light's error is not worth it.
WORTH = 0.95
#: What the limit of the search is multiplied by where the picture missed it, and how often.
CLOSER, ATTEMPTS = 0.75, 3

T = TypeVar("T")


@dataclass(frozen=True)
class Choice:
    """What was chosen for a limit of the mean relative error.

    Attributes:
        settings: the choice.
        limit: that the upper end of the error's interval had to keep.
        met: whether the picture does.
        tried: how many settings were tried.
        knobs: values of the knobs that were chosen, by name; 0 leaves one to the plan.
    """

    settings: Settings
    limit: float
    met: bool
    tried: int
    knobs: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"max_error": self.limit, "met": self.met, "tried": self.tried, "knobs": dict(self.knobs)}

    def __str__(self) -> str:
        words = " ".join(f"{name}={value}" for name, value in self.knobs.items()) or "no knob was free"
        if self.met:
            return f"mean error below {100 * self.limit:.3g} % with {words}"
        return f"no settings found for a mean error below {100 * self.limit:.3g} %; the best are {words}"


def render_within(
    renderer: Renderer,
    index: RenderIndex,
    camera: Camera,
    size: tuple[int, int],
    settings: Settings,
    limit: float,
    fixed: Collection[str] = (),
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    first: Settings | None = None,
) -> tuple[Image, Choice]:
    """Render a picture with the cheapest settings found whose mean relative error stays below a limit.

    The limit is for the upper end of the 95 % interval of `mean_relative_error`, measured on the picture.

    Args:
        renderer: to draw with.
        index, camera, size, settings: as for `Renderer.render`; of the settings the `CHOSEN` ones are replaced.
        limit: above 0.
        fixed: names of knobs that keep their values.
        seed: other pixels for another seed.
        progress: called with the part that is done, in [0, 1]; an exception it raises stops the work.
        first: settings to try before any search, as of the frame before.

    Returns:
        The picture with its measured error, and what was chosen; where nothing met the limit, the best that was found.

    Raises:
        PrevisError: when the scene cannot be rendered, or its error not be measured.
        ValueError: for a limit that is not positive.
    """
    if not limit > 0.0:
        raise ValueError(f"max_error: {limit!r} is not a number above 0")
    if "march_divisor" not in fixed:
        # The pixels that settings are tried on are marched one by one: what is interpolated would not show.
        settings = settings.replace(march_divisor=1)
    report = progress or (lambda _: None)
    best: tuple[float, Image, Settings] | None = None
    with ErrorMeter(renderer) as meter:

        def measured(chosen: Settings, number: int) -> bool:
            nonlocal best
            image = renderer.render(index, camera, size, chosen)
            image = image.with_error(meter.measure(index, camera, image, chosen, seed + 1000 * (number + 1)))
            assert image.error is not None
            reached = image.error.mean_relative_error.high
            if best is None or reached < best[0]:
                best = reached, image, chosen
            return reached <= limit

        met = first is not None and measured(first, ATTEMPTS)
        search = None
        if not met:
            search = _Search(meter, renderer, index, camera, size, settings, fixed, seed)
            aim = limit
            for number in range(ATTEMPTS):
                report(number / ATTEMPTS)
                found = search.find(aim)
                if met := measured(search.chosen(), number):
                    break
                if not found:
                    break
                aim *= CLOSER
    report(1.0)
    assert best is not None
    _, image, chosen = best
    idle = set(LIGHT_KNOBS) - set(_light_knobs(chosen))
    free = [name for name in CHOSEN if name not in fixed and name not in idle]
    choice = Choice(chosen, limit, met, search.tried if search else 0, {name: chosen[name] for name in free})
    return replace(image, stats={**image.stats, "choice": choice.to_dict()}), choice


def _light_knobs(settings: Settings) -> tuple[str, ...]:
    """Those of `LIGHT_KNOBS` that have an effect with a method."""
    method = method_of(settings)
    own = {"coefficients": method.has_coefficients, "slices": method.curve == "slices", "map_size": method.has_maps}
    return tuple(name for name in LIGHT_KNOBS if own.get(name, True))


def _finished(work: Generator[float, None, T]) -> T:
    """What a generator returns."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


@dataclass(frozen=True)
class _Trial:
    whole: ErrorPart
    light: ErrorPart
    view: ErrorPart


class _Search:
    """The ladders of the knobs, the rung that each is on, and what candidates came to."""

    def __init__(
        self,
        meter: ErrorMeter,
        renderer: Renderer,
        index: RenderIndex,
        camera: Camera,
        size: tuple[int, int],
        settings: Settings,
        fixed: Collection[str],
        seed: int,
    ) -> None:
        self._meter, self._index, self._camera, self._size = meter, index, camera, size
        self._settings = settings
        self._volumes = [e.record for e in index.volumes.values()]
        self._trials: dict[tuple, _Trial] = {}
        self._marched: dict[int, np.ndarray] = {}
        self._ladders = self._make_ladders(renderer, fixed)
        self._rungs = dict.fromkeys(self._ladders, 0)
        start = self.chosen()
        image = renderer.render(index, camera, size, start)
        self._sample: PixelSample = _finished(meter.choosing(index, camera, image, start, seed))
        self._truth = self._pixels(converged(settings, self._volumes))
        self._scale = ErrorScale(image.color.astype(float), self._sample, self._truth)

    @property
    def tried(self) -> int:
        """How many settings were tried."""
        return len(self._trials)

    def chosen(self, **values: Any) -> Settings:
        """The settings of the rungs, but for the values given."""
        rungs = {name: ladder[self._rungs[name]] for name, ladder in self._ladders.items()}
        return self._settings.replace(**{**rungs, **values})

    def _make_ladders(self, renderer: Renderer, fixed: Collection[str]) -> dict[str, tuple]:
        grids = [v for v in self._volumes if v.density is not None]
        steps = max((steps_across(v, 0) for v in self._volumes), default=1)
        own = method_of(self._settings).name
        first = own if "transmittance" in fixed and METHODS[own].has_maps else METHODS_TRIED[0]
        maps = self._settings.replace(map_size=0, slices=0, light_steps=0, transmittance=first)
        light_steps = max((light_steps_across(v, maps) for v in grids), default=1)
        map_size = slices = 0
        if grids:
            plan = renderer.plan(self._index, self._camera, *self._size, maps)
            map_size, slices = plan.map_size, plan.map_slices
        ladders: dict[str, tuple] = {
            "transmittance": METHODS_TRIED,
            "coefficients": COEFFICIENTS,
            "slices": _parts("slices", slices, SLICES, SLICES_PER_DRAW) if slices else (self._settings.slices,),
            "map_size": _parts("map_size", map_size, SLICES if slices else MAP_SIZES),
            "light_steps": _parts("light_steps", light_steps, LIGHT_STEPS),
            "steps": _parts("steps", steps, STEPS),
        }
        for name in ladders:
            # Without voxels there are no maps, and no way of light to march.
            if name in fixed or (not grids and name != "steps") or not self._volumes:
                ladders[name] = (self._settings[name],)
        return ladders

    def _pixels(self, settings: Settings) -> np.ndarray:
        return _finished(self._meter.drawing(self._index, self._camera, self._size, (settings,), self._sample))[0]

    def _try(self, settings: Settings) -> _Trial:
        """What the pixels of some settings are off."""
        named = ("transmittance", "steps", *_light_knobs(settings))
        key = tuple((name, settings[name]) for name in named)
        if key not in self._trials:
            if settings.steps not in self._marched:
                self._marched[settings.steps] = self._pixels(brute_force(settings, self._volumes))
            found, marched = self._pixels(settings), self._marched[settings.steps]
            differences = found - self._truth, found - marched, marched - self._truth
            self._trials[key] = _Trial(*(self._scale.part(d) for d in differences))
        return self._trials[key]

    def find(self, limit: float) -> bool:
        """Go up until the limit is met, then down as far as it stays met; False when it cannot be."""
        while not self._meets(limit):
            trial = self._try(self.chosen())
            blamed = trial.view.mean_relative_error.value >= trial.light.mean_relative_error.value
            raises = (self._raise_view, self._raise_light) if blamed else (self._raise_light, self._raise_view)
            if not (raises[0]() or raises[1]()):
                return False
        for name in reversed(self._ladders):
            while self._rungs[name] > 0:
                self._rungs[name] -= 1
                if not self._meets(limit):
                    self._rungs[name] += 1
                    break
        return True

    def _meets(self, limit: float) -> bool:
        return self._try(self.chosen()).whole.mean_relative_error.high <= limit

    def _can_rise(self, name: str) -> bool:
        return self._rungs[name] + 1 < len(self._ladders[name])

    def _raise_view(self) -> bool:
        if not self._can_rise("steps"):
            return False
        self._rungs["steps"] += 1
        return True

    def _raise_light(self) -> bool:
        """Raise what lowers the light's error most; when nothing does it is the next method's turn, the brute-force
        march being the last."""
        names = _light_knobs(self.chosen())
        if not method_of(self.chosen()).has_maps and not self._ladders["light_steps"][self._rungs["light_steps"]]:
            # A march in steps can have more of them; one from voxel to voxel is exact.
            names = ()
        before = self._try(self.chosen()).light.mean_relative_error.value
        outcomes = []
        for name in filter(self._can_rise, names):
            value = self._ladders[name][self._rungs[name] + 1]
            outcomes.append((self._try(self.chosen(**{name: value})).light.mean_relative_error.value, name))
        if outcomes and min(outcomes)[0] < WORTH * before:
            self._rungs[min(outcomes)[1]] += 1
            return True
        # Each alone may wait for the other.
        if len(outcomes) > 1:
            together = {name: self._ladders[name][self._rungs[name] + 1] for _, name in outcomes}
            if self._try(self.chosen(**together)).light.mean_relative_error.value < WORTH * before:
                for _, name in outcomes:
                    self._rungs[name] += 1
                return True
        if self._can_rise("transmittance"):
            self._rungs["transmittance"] += 1
            if len(self._ladders["light_steps"]) > 1:
                self._rungs["light_steps"] = self._ladders["light_steps"].index(0)
            return True
        return False


def _parts(name: str, whole: int, parts: tuple[float, ...], multiple: int = 1) -> tuple[int, ...]:
    """The parts of a number in the range of a knob, rising, as multiples of another; what the plan would take is 0,
    which leaves it to it."""
    setting = BY_NAME[name]
    low, high = int(setting.minimum or 1), int(setting.maximum or 1)
    values = {part: min(max(round(part * whole / multiple) * multiple, low), high) for part in parts}
    return tuple(
        0 if part == 1.0 else v for part, v in values.items() if part == 1.0 or (low < v < high and v != whole)
    )
