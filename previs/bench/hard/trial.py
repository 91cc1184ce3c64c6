"""What a hard case is, how it is tried with a method, and what comes of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from ... import metrics
from ...description import Camera, Note, SceneDescription
from ...errors import PrevisError
from ...image import Image
from ...index import RenderIndex
from ...render.method import METHODS as TRANSMITTANCES
from ...settings import BY_NAME, Settings
from ..reference_scene import reference_image
from .records import FRONT

#: Pixels of a picture: enough to see a hole, a seam or a band, few enough for the reference.
SIZE = (24, 16)
METHODS: tuple[str, ...] = BY_NAME["transmittance"].choices
#: The method that needs no maps, and so no coefficients.
MARCH = "march"
#: With maps and without: for what all maps share, such as where a point lies in them.
MAPS_AND_MARCH: tuple[str, ...] = tuple(dict.fromkeys((BY_NAME["transmittance"].default, "quantile", MARCH)))
#: Stands for the method of a case that no method has a part in; it runs with the default one.
ANY = "any"

#: Largest mean error against the reference, relative to the mean of the lit pixels, and least PSNR in dB: what is
#: promised for 6 and for 14 values per texel, and a march that is fit to judge both.
LIMITS: Mapping[int, tuple[float, float]] = {0: (0.005, 45.0), 6: (0.03, 40.0), 14: (0.01, 45.0)}
#: The same for slices, which have no number of values.
SLICES_LIMITS = 0.02, 40.0
#: What two pictures of the same thing, made in different ways, may differ by: rounding, not method.
SAME = 1e-3

#: Methods kept as they were published: less accurate than is asked of the default, they are "short" of it.
PUBLISHED = ("tfm", "tfm-plain")
#: The figures that may be short.
ACCURACY = ("mean error", "PSNR")
Verdict = Literal["pass", "reported", "short", "FAIL"]
Unit = Literal["%", "dB", "", "flag"]


class Rendering(Protocol):
    """What is asked of a renderer."""

    def render(self, index: RenderIndex, camera: Camera, size: tuple[int, int], settings: Settings) -> Image:
        """The picture of a scene."""
        ...


@dataclass(frozen=True)
class Measure:
    """One figure: fails above its limit, PSNR (in dB) below it, and when it is not a number. A flag is 1 or 0."""

    value: float
    limit: float
    meaning: str
    unit: Unit = ""

    @property
    def failed(self) -> bool:
        """Whether the limit is not kept."""
        return not (self.value >= self.limit if self.unit == "dB" else self.value <= self.limit)

    @property
    def severity(self) -> float:
        """The value as a part of its limit, to pick the worst of several; not a number counts as infinite."""
        if math.isnan(self.value):
            return math.inf
        if self.unit == "dB":
            return 10.0 ** (min(self.limit - self.value, 400.0) / 20.0)
        return self.value / self.limit if self.limit > 0.0 else (math.inf if self.value > 0.0 else 0.0)

    def text(self, value: float) -> str:
        """A value in the unit of this measure."""
        if self.unit == "%":
            return f"{100.0 * value:.2g} %"
        return f"{value:.1f} dB" if self.unit == "dB" else f"{value:.3g}"


@dataclass(frozen=True)
class Outcome:
    """What came of a case with a method.

    `worst` is the figure nearest to its limit, or farthest beyond it. `note` is what the program told the user, for
    the verdict "reported", or the error that ended a case that failed. `coefficients` is 0 for methods without.
    """

    case: str
    method: str
    coefficients: int
    worst: Measure
    verdict: Verdict
    note: str = ""

    @property
    def label(self) -> str:
        """Method and number of coefficients."""
        return f"{self.method} {self.coefficients}" if self.coefficients else self.method

    @property
    def error(self) -> str:
        """The worst figure in words, with its limit."""
        m = self.worst
        if m.unit == "flag":
            return m.meaning if m.failed else "as it should"
        return f"{m.meaning} {m.text(m.value)} ({'≥' if m.unit == 'dB' else '≤'} {m.text(m.limit)})"


class Trial:
    """One case with one method: renders, compares, and keeps every figure.

    `references` keeps the reference's pictures of a case for its next trial: a case asks for the same ones, in the same
    order, whatever the method.
    """

    def __init__(
        self, renderer: Rendering, method: str, coefficients: int, references: dict[int, np.ndarray] | None = None
    ) -> None:
        self.renderer = renderer
        self.method = method
        self.coefficients = coefficients
        self.measures: list[Measure] = []
        self.reports: list[str] = []
        self._references = {} if references is None else references
        self._asked = 0

    @property
    def limits(self) -> tuple[float, float]:
        """Largest mean error and least PSNR of this method against the reference."""
        return SLICES_LIMITS if self.method == "slices" else LIMITS[self.coefficients]

    def render(
        self, scene: SceneDescription, camera: Camera = FRONT, size: tuple[int, int] = SIZE, **settings: Any
    ) -> Image:
        """The picture with the method on trial; counts what is not finite or outside its bounds."""
        values: dict[str, Any] = {}
        if self.method != ANY:
            values["transmittance"] = self.method
        if self.coefficients:
            values["coefficients"] = self.coefficients
        index = RenderIndex()
        index.update(scene)
        image = self.renderer.render(index, camera, size, Settings(**{**values, **settings}))
        self.bounded(image)
        return image

    def bounded(self, image: Image) -> None:
        """Every plane is finite, opacity and transmittance lie in [0, 1], no radiance is negative."""
        planes = {"color": image.color, "alpha": image.alpha, **image.aovs}
        self.measure(sum(int(np.count_nonzero(~np.isfinite(p))) for p in planes.values()), 0.0, "values not finite")
        transmittances = [image.alpha, *(image.aovs[n] for n in ("transmittance",) if n in image.aovs)]
        outside = max(max(0.0, -float(np.min(t)), float(np.max(t)) - 1.0) for t in transmittances)
        self.measure(outside, 1e-6, "opacity or transmittance outside [0, 1] by")
        self.measure(max(float(-image.color.min()), 0.0), 0.0, "negative radiance")

    def measure(self, value: float, limit: float, meaning: str, unit: Unit = "") -> Measure:
        """Keep a figure that must not exceed its limit, or for dB not fall below it."""
        measure = Measure(float(value), limit, meaning, unit)
        self.measures.append(measure)
        return measure

    def right(self, scene: SceneDescription, camera: Camera = FRONT, noted: str = "", **settings: Any) -> Image:
        """Render, and compare with the float64 reference.

        With `noted` the limits may be exceeded where the program says so itself, in a note that holds this text.
        """
        image = self.render(scene, camera, **settings)
        truth = self._reference(scene, camera, settings)
        error = metrics.mean_relative_error(image.color, truth)
        psnr = metrics.psnr(image.color, truth)
        mean, least = self.limits
        if noted and (error > mean or psnr < least):
            self.told(image.stats["notes"], noted)
            return image
        self.measure(error, mean, "mean error", "%")
        self.measure(psnr, least, "PSNR", "dB")
        return image

    def _reference(self, scene: SceneDescription, camera: Camera, settings: Mapping[str, Any]) -> np.ndarray:
        number, self._asked = self._asked, self._asked + 1
        if number not in self._references:
            light = Settings(**{k: v for k, v in settings.items() if k == "ambient"})
            self._references[number] = reference_image(scene, camera, *SIZE, light, max_error=1e-3).color
        return self._references[number]

    def same(self, image: Image | np.ndarray, other: Image | np.ndarray, limit: float = SAME, what: str = "") -> None:
        """Two pictures that must be equal, within a mean error."""
        a, b = (x.color if isinstance(x, Image) else x for x in (image, other))
        self.measure(metrics.mean_relative_error(a, b), limit, what or "difference", "%")

    def continuous(self, images: list[Image], limit: float = SAME, what: str = "jump") -> None:
        """Pictures along a path of tiny steps: none differs from the next one by more than a mean error."""
        for first, second in itertools.pairwise(images):
            self.measure(metrics.mean_relative_error(second.color, first.color), limit, what, "%")

    def told(self, notes: Iterable[Note | str], *words: str) -> None:
        """The program says it in a note that holds all these words."""
        found = next((text for text in map(str, notes) if all(w in text for w in words)), None)
        self.measure(found is None, 0.0, f"no note of: {', '.join(words)}", "flag")
        if found is not None:
            self.reports.append(found)

    def refused(self, attempt: Callable[[], object], *words: str) -> None:
        """The program refuses with one line that holds all these words."""
        try:
            attempt()
        except PrevisError as error:
            text = str(error)
            good = "\n" not in text and all(w in text for w in words)
            self.measure(not good, 0.0, f"not one line of: {', '.join(words)}", "flag")
            self.reports.append(text)
        else:
            self.measure(1.0, 0.0, "not refused", "flag")

    def verdict(self) -> tuple[Measure, Verdict, str]:
        """(the worst figure, the verdict, what the program said)."""
        worst = max(
            self.measures,
            key=lambda m: (m.failed, m.severity, m.limit),
            default=Measure(1.0, 0.0, "nothing checked", "flag"),
        )
        if worst.failed:
            inaccurate = all(m.meaning in ACCURACY for m in self.measures if m.failed)
            return worst, "short" if inaccurate and self.method in PUBLISHED else "FAIL", ""
        return worst, "reported" if self.reports else "pass", self.reports[0] if self.reports else ""


Check = Callable[[Trial], None]


@dataclass(frozen=True)
class Case:
    """One hard case: `lines` are those of `LINES` that it covers, `coefficients` the numbers it takes with maps."""

    name: str
    lines: tuple[str, ...]
    check: Check
    methods: tuple[str, ...]
    coefficients: tuple[int, ...]

    def variants(self, methods: Iterable[str] | None = None) -> list[tuple[str, int]]:
        """(method, number of coefficients) of every trial; ANY is part of every choice of methods."""
        chosen = [m for m in self.methods if methods is None or m == ANY or m in set(methods)]
        return [(m, n) for m in chosen for n in (self.coefficients if _has_coefficients(m) else (0,))]


def _has_coefficients(method: str) -> bool:
    return method != ANY and TRANSMITTANCES[method].has_coefficients


CASES: dict[str, Case] = {}


def case(
    *lines: str, methods: tuple[str, ...] = METHODS, coefficients: tuple[int, ...] = (6, 14)
) -> Callable[[Check], Check]:
    """Register a function as a case, under its name with spaces.

    Slices, methods without maps, and `ANY`, have no coefficients.
    """

    def register(check: Check) -> Check:
        name = check.__name__.replace("_", " ")
        CASES[name] = Case(name, lines, check, methods, coefficients)
        return check

    return register
