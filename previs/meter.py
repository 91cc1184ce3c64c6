"""The error meter's statistics: which pixels of a picture to look at, and what they say of the whole.

A few hundred pixels are drawn again by the brute-force march at converged steps. They are chosen at random in two
phases (double sampling, Cochran 1977, chapter 12): many, where the picture is bright or uneven; of these a few, where
cheap but better pixels differ from it. Each counts for as many pixels as its probability says, so that sums over the
picture are estimated without bias (Horvitz and Thompson 1952). From these sums follow the relative errors and the PSNR
of `previs.metrics`, each with a 95 % confidence interval.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from . import metrics

#: Shares of the samples that are spread evenly over the picture, over what shows media or surfaces, and by how bright
#: and uneven the picture is; the others follow what it differs from better pixels. The first shares bound what an error
#: can count that was expected nowhere near.
EVEN_SHARE, SHOWN_SHARE, BRIGHT_SHARE = 0.2, 0.1, 0.2
#: Pixels of the first phase, per pixel of the second.
FIRST_PHASE = 32
#: What a difference to a neighbour counts in the guess at a pixel's error, against its own brightness.
UNEVENNESS = 1.0
#: Values of the picture above this part of its peak tell how far off the peak is.
BRIGHT = 0.8
#: Two-sided 95 % of a normal distribution.
_NORMAL = 1.959964


class Estimate(NamedTuple):
    """A value, and the ends of its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"


@dataclass(frozen=True)
class ErrorPart:
    """How far a picture is from the truth: `relative_rmse`, `mean_relative_error` and `psnr` (dB) as `previs.metrics`
    defines them, and `bias`, the light that the picture has too much, relative to all of the truth.

    Parts of an error add up in `bias`, and pixel by pixel; in the others they need not: they may cancel.
    """

    relative_rmse: Estimate
    mean_relative_error: Estimate
    psnr: Estimate
    bias: Estimate

    def to_dict(self) -> dict[str, Any]:
        """Names to ``{"value", "low", "high"}``; infinite values as None, which JSON can hold."""
        names = ("relative_rmse", "mean_relative_error", "psnr", "bias")
        return {name: {k: _finite(v) for k, v in getattr(self, name)._asdict().items()} for name in names}


@dataclass(frozen=True)
class ErrorEstimate(ErrorPart):
    """The error of a picture, estimated from some of its pixels.

    Attributes:
        light: the part that light has on its way into the media: the picture against one of the same view steps whose
            light is marched by brute force.
        view: the part of the view rays: what their steps are off converged ones, and what the picture is off its own
            march where it is interpolated.
        pixels: how many were drawn.
        steps, light_steps: of the truth, across a volume.
        seconds: that it took.
    """

    light: ErrorPart
    view: ErrorPart
    pixels: int
    steps: int = 0
    light_steps: int = 0
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {
            **super().to_dict(),
            "light": self.light.to_dict(),
            "view": self.view.to_dict(),
            "pixels": self.pixels,
            "steps": self.steps,
            "light_steps": self.light_steps,
            "seconds": self.seconds,
        }

    def __str__(self) -> str:
        mean, rms, ratio = self.mean_relative_error, self.relative_rmse, self.psnr
        return (
            f"mean error {_percent(mean)}, RMSE {_percent(rms)}, PSNR {ratio.value:.1f} dB "
            f"({ratio.low:.1f} to {ratio.high:.1f}); light {100 * self.light.mean_relative_error.value:.2g} %, "
            f"view steps {100 * self.view.mean_relative_error.value:.2g} %; {self.pixels} pixels"
        )


def _percent(estimate: Estimate) -> str:
    value, low, high = (f"{100 * v:.2g}" for v in estimate)
    return f"{value} % ({low} to {high})"


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True, eq=False)
class PixelSample:
    """Pixels chosen at random: `rows` from the top, `columns`, and the `probability` with which each was, (N,) each.

    They are in the order in which they were chosen, along a curve on which neighbours are near each other. `density`
    (3, N) holds how the shares that do not know of better pixels are spread. A second phase has the `first`, the
    `better` values (N of the first, 3) of its pixels, and its own pixels' `places` among them.
    """

    rows: np.ndarray
    columns: np.ndarray
    probability: np.ndarray
    density: np.ndarray
    first: PixelSample | None = None
    better: np.ndarray | None = None
    places: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def deviation(self, values: np.ndarray) -> float:
        """Standard deviation of the sum over the picture that is estimated from one value per pixel.

        By successive differences in the order of choice (Wolter 2007, section 8.2, estimator v2), which counts only
        once what is alike in neighbours; pixels that were certain to be chosen add nothing.
        """
        weighted = (values / self.probability)[self.probability < 1.0]
        n = len(weighted)
        return math.sqrt(n / (2.0 * (n - 1)) * float(np.sum(np.diff(weighted) ** 2))) if n > 1 else 0.0


def choose_pixels(color: np.ndarray, shown: np.ndarray | None = None, count: int = 256, seed: int = 0) -> PixelSample:
    """Choose pixels of a picture at random, more of them where it is bright or uneven.

    Systematic sampling with unequal probabilities (Madow 1949) along a Hilbert curve: no pixel is chosen twice, and the
    choice is spread evenly over the picture.

    Args:
        color: (H, W, 3) linear radiance, finite.
        shown: (H, W) bool, where the picture shows media or surfaces; None takes where it is not black.
        count: how many; all where the picture has no more.
        seed: other pixels for another seed.
    """
    color = np.asarray(color, float)
    height, width = color.shape[:2]
    order = _hilbert_order(height, width)
    density = np.stack([d.ravel() for d in _densities(color, shown)])[:, order]
    weight = np.array([EVEN_SHARE, SHOWN_SHARE, 1.0 - EVEN_SHARE - SHOWN_SHARE]) @ density
    number, probability = _systematic(weight, count, seed)
    chosen = order[number]
    return PixelSample(chosen // width, chosen % width, probability, density[:, number])


def choose_again(
    color: np.ndarray, first: PixelSample, better: np.ndarray, count: int = 256, seed: int = 0
) -> PixelSample:
    """Choose a few of the pixels chosen before, more of them where better pixels differ from the picture.

    Args:
        color: (H, W, 3) the picture.
        first: chosen by `choose_pixels`.
        better: (N, 3) values of its pixels that are likely to be nearer the truth. Estimates stay unbiased whatever
            they are; the better they are, the narrower the intervals.
        count, seed: as for `choose_pixels`.
    """
    off = np.linalg.norm(color[first.rows, first.columns] - better, axis=1)
    shares = np.array([EVEN_SHARE, SHOWN_SHARE, BRIGHT_SHARE])
    total = float(np.sum(off / first.probability))
    rest = off / total if total > 0.0 else first.density[2]
    wanted = shares @ first.density + (1.0 - shares.sum()) * rest
    number, probability = _systematic(wanted / first.probability, count, seed + 1)
    return PixelSample(
        first.rows[number],
        first.columns[number],
        first.probability[number] * probability,
        first.density[:, number],
        first,
        better,
        number,
    )


def _systematic(weight: np.ndarray, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Places chosen in proportion to weights, in rising order, and their probabilities; all where there are no more."""
    if count >= len(weight):
        return np.arange(len(weight)), np.ones(len(weight))
    probability = _inclusion(weight, count)
    reached = np.cumsum(probability)
    start = np.random.default_rng(seed).random()
    # Rounding must not lose the last one.
    number = np.searchsorted(reached * (count / reached[-1]), start + np.arange(count), side="right")
    number = np.minimum(number, len(weight) - 1)
    return number, probability[number]


def _densities(color: np.ndarray, shown: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How the shares are spread, (H, W) each with sum 1: evenly, over what is shown, by brightness and unevenness."""
    bright = np.abs(color).max(axis=2)
    uneven = np.zeros_like(bright)
    for axis in (0, 1):
        step = np.abs(np.diff(color, axis=axis)).max(axis=2)
        first, last = [slice(None)] * 2, [slice(None)] * 2
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        uneven[tuple(first)] = np.maximum(uneven[tuple(first)], step)
        uneven[tuple(last)] = np.maximum(uneven[tuple(last)], step)
    guess = bright + UNEVENNESS * uneven
    shown = (bright > 0.0) if shown is None else np.asarray(shown, bool)
    even = np.full(bright.shape, 1.0 / bright.size)
    return even, shown / shown.sum() if shown.any() else even, guess / guess.sum() if guess.any() else even


def _inclusion(weight: np.ndarray, count: int) -> np.ndarray:
    """Probabilities of at most 1 that add up to `count`, proportional to positive weights where they are below 1."""
    probability = weight * (count / weight.sum())
    while (over := probability > 1.0).any():
        probability[over] = 1.0
        below = probability < 1.0
        left = count - np.count_nonzero(~below)
        probability[below] *= left / probability[below].sum()
    return probability


@functools.lru_cache(maxsize=4)
def _hilbert_order(height: int, width: int) -> np.ndarray:
    """The pixels of a picture, as row · width + column, in the order in which a Hilbert curve passes them."""
    side = 1 << max(height - 1, width - 1, 1).bit_length()
    y, x = (np.ascontiguousarray(a.ravel(), np.int32) for a in np.mgrid[:height, :width])
    distance = np.zeros(x.size, np.int64)
    s = side // 2
    while s:
        right, upper = (x & s) > 0, (y & s) > 0
        distance += s * s * ((3 * right) ^ upper).astype(np.int64)
        flip = ~upper & right
        x[flip], y[flip] = side - 1 - x[flip], side - 1 - y[flip]
        swap = ~upper
        x[swap], y[swap] = y[swap], x[swap]
        s //= 2
    order = np.argsort(distance, kind="stable")
    order.flags.writeable = False
    return order


def estimate_error(
    color: np.ndarray,
    sample: PixelSample,
    same_steps: np.ndarray,
    truth: np.ndarray,
    marched: np.ndarray | None = None,
    steps: int = 0,
    light_steps: int = 0,
    seconds: float = 0.0,
) -> ErrorEstimate:
    """The error of a picture from the truth of some of its pixels.

    Args:
        color: (H, W, 3) the picture.
        sample: the pixels, chosen by `choose_pixels`.
        same_steps: (N, 3) what they are with the picture's own view steps and light by brute force.
        truth: (N, 3) what they are.
        marched: (N, 3) what they are by the picture's own settings, where the picture is interpolated; None where it
            has just that.
        steps, light_steps, seconds: for the record.

    Raises:
        ValueError: when a value is not finite.
    """
    color = np.asarray(color, float)
    found = color[sample.rows, sample.columns]
    same_steps, truth = np.asarray(same_steps, float), np.asarray(truth, float)
    marched = found if marched is None else np.asarray(marched, float)
    for name, values in (("picture", color), ("march", same_steps), ("truth", truth), ("marched pixels", marched)):
        if bad := np.count_nonzero(~np.isfinite(values)):
            raise ValueError(f"{bad} values of the {name} are not finite")
    scale = ErrorScale(color, sample, truth)
    light = marched - same_steps
    parts = [scale.part(difference) for difference in (found - truth, light, found - truth - light)]
    whole = parts[0]
    return ErrorEstimate(
        whole.relative_rmse,
        whole.mean_relative_error,
        whole.psnr,
        whole.bias,
        light=parts[1],
        view=parts[2],
        pixels=len(sample),
        steps=steps,
        light_steps=light_steps,
        seconds=seconds,
    )


class ErrorScale:
    """What errors are relative to: the lit values of the truth, their sum and its peak. They are all but known from the
    picture itself, and corrected by what the better pixels differ from it, and the truth from these.

    Args:
        color: (H, W, 3) the picture.
        sample: pixels of it.
        truth: (N, 3) what these are.
    """

    def __init__(self, color: np.ndarray, sample: PixelSample, truth: np.ndarray) -> None:
        self._sample = sample
        self._weight = 1.0 / sample.probability
        self._values = color.size
        shown = color[sample.rows, sample.columns]
        steps: list[tuple[PixelSample, np.ndarray, np.ndarray]] = [(sample, shown, truth)]
        if (first := sample.first) is not None and sample.better is not None and sample.places is not None:
            found = color[first.rows, first.columns]
            steps = [(first, found, sample.better), (sample, sample.better[sample.places], truth)]
            self._off = found - sample.better
        self.peak, self._peak_doubt, self._peak_part = self._find_peak(color, steps)
        threshold = metrics.LIT_THRESHOLD * self.peak if self.peak > 0.0 else math.inf
        lit = color.max(axis=2) > threshold
        self.sum, self.count = float(color[lit].sum()), 3.0 * np.count_nonzero(lit)
        parts = []
        for chosen, before, after in steps:
            lit_before, lit_after = before.max(axis=1) > threshold, after.max(axis=1) > threshold
            more = after.sum(axis=1) * lit_after - before.sum(axis=1) * lit_before
            more_count = 3.0 * (lit_after.astype(float) - lit_before)
            self.sum += float(np.sum(more / chosen.probability))
            self.count += float(np.sum(more_count / chosen.probability))
            parts.append((more, more_count))
        self.sum, self.count = max(self.sum, 0.0), max(self.count, 0.0)
        relative = [(m / (self.sum or 1.0), c / (self.count or 1.0)) for m, c in parts]
        self._first_part, (self._sum_part, self._count_part) = relative[0][0], relative[-1]

    def _find_peak(
        self, color: np.ndarray, steps: list[tuple[PixelSample, np.ndarray, np.ndarray]]
    ) -> tuple[float, float, np.ndarray]:
        """The peak, by what its logarithm may be off besides the sampling, and what each pixel adds to it."""
        sample, before, truth = steps[-1]
        if sample.first is None and np.all(sample.probability >= 1.0):
            whole = np.zeros_like(color)
            whole[sample.rows, sample.columns] = truth
            return metrics.peak(whole), 0.0, np.zeros(len(sample))
        start = peak = metrics.peak(color)
        if peak <= 0.0:
            return max(float(truth.max(initial=0.0)), 0.0), 0.0, np.zeros(len(sample))
        if len(steps) > 1:
            peak = _quantile_of(color, *steps[0])
        # The brightest values stand for the peak: it is off by as much as they are.
        bright = before >= BRIGHT * peak
        total = float(np.sum(before * bright / sample.probability[:, None]))
        if total <= 0.0:
            return peak, abs(math.log(peak / start)), np.zeros(len(sample))
        ratio = max(float(np.sum(truth * bright / sample.probability[:, None])) / total, 1e-9)
        left = np.sum((truth - before * ratio) * bright, axis=1) / (total * ratio)
        # What is left to doubt: where pictures of other errors disagree about the peak, so may the truth.
        found = [start, peak, peak * ratio]
        return found[-1], math.log(max(found) / min(found)), left

    def part(self, difference: np.ndarray) -> ErrorPart:
        """The error of which `difference` (N, 3) is what the pixels have."""
        squares = np.sum(difference**2, axis=1)
        amounts = np.sum(np.abs(difference), axis=1)
        signed = np.sum(difference, axis=1)
        square_sum, amount_sum = float(self._weight @ squares), float(self._weight @ amounts)
        if amount_sum == 0.0:
            none = Estimate(0.0, 0.0, 0.0)
            return ErrorPart(none, none, Estimate(math.inf, math.inf, math.inf), none)
        square_part, amount_part = squares / square_sum, amounts / amount_sum
        first = self._first_deviations()
        noise = math.hypot(self._deviation(0.5 * square_part - self._peak_part), first[0])
        rms = math.sqrt(square_sum / self._values)
        level = 20.0 * math.log10(self.peak / rms) if self.peak > 0.0 else -math.inf
        decibels = 20.0 / math.log(10.0) * (_quantile(square_part * self._weight) * noise + self._peak_doubt)
        psnr = Estimate(level, level - decibels, level + decibels)
        if self.sum <= 0.0:
            infinite = Estimate(math.inf, math.inf, math.inf)
            return ErrorPart(infinite, infinite, psnr, infinite)
        bias = float(self._weight @ signed) / self.sum
        width = _quantile(self._weight * np.abs(signed)) * math.hypot(
            self._deviation(signed / self.sum - bias * self._sum_part), first[3] * amount_sum / self.sum
        )
        return ErrorPart(
            _interval(
                math.sqrt(square_sum * self.count) / self.sum,
                _quantile(square_part * self._weight)
                * math.hypot(self._deviation(0.5 * square_part + 0.5 * self._count_part - self._sum_part), first[1]),
            ),
            _interval(
                amount_sum / self.sum,
                _quantile(amount_part * self._weight)
                * math.hypot(self._deviation(amount_part - self._sum_part), first[2]),
            ),
            psnr,
            Estimate(bias, bias - width, bias + width),
        )

    def _deviation(self, values: np.ndarray) -> float:
        return self._sample.deviation(values)

    def _first_deviations(self) -> tuple[float, float, float, float]:
        """What the first phase adds to the deviations: of log PSNR, of both relative errors, and of the bias relative
        to the mean error. What better pixels differ from the picture stands for its error."""
        first = self._sample.first
        if first is None:
            return 0.0, 0.0, 0.0, 0.0
        squares, amounts = np.sum(self._off**2, axis=1), np.sum(np.abs(self._off), axis=1)
        square_sum, amount_sum = (max(float(np.sum(v / first.probability)), 1e-300) for v in (squares, amounts))
        square_part, amount_part = 0.5 * squares / square_sum, amounts / amount_sum
        return (
            first.deviation(square_part),
            first.deviation(square_part - self._first_part),
            first.deviation(amount_part - self._first_part),
            first.deviation(np.sum(self._off, axis=1) / amount_sum),
        )


def _quantile_of(color: np.ndarray, sample: PixelSample, before: np.ndarray, after: np.ndarray) -> float:
    """`metrics.peak` of a picture, from some of its pixels: it has the values `after` where a known one has `before`.

    The number of values above a level is counted in the known picture and corrected by the sampled difference.
    """
    wanted = 0.001 * color.size
    known = np.sort(color.ravel())
    levels = np.unique(np.concatenate([before.ravel(), after.ravel(), [metrics.peak(color)]]))
    levels = levels[levels > 0.5 * metrics.peak(color)]
    weight = np.repeat(1.0 / sample.probability, 3)

    def above(values: np.ndarray) -> np.ndarray:
        order = np.argsort(values.ravel())
        reached = np.concatenate([[0.0], np.cumsum(weight[order])])
        return reached[-1] - reached[np.searchsorted(values.ravel()[order], levels, side="right")]

    count = known.size - np.searchsorted(known, levels, side="right") + above(after) - above(before)
    enough = np.flatnonzero(count >= wanted)
    return float(levels[enough[-1]]) if enough.size else metrics.peak(color)


def _quantile(shares: np.ndarray) -> float:
    """Half the width of a 95 % interval in standard deviations, by Student's distribution.

    The fewer pixels make up a sum, the less is its deviation known: its degrees of freedom are those of as many equal
    shares (Kish's effective sample size). The series is Abramowitz and Stegun 26.7.5.
    """
    effective = float(np.sum(shares)) ** 2 / max(float(np.sum(shares**2)), 1e-300)
    freedom, x = max(effective - 1.0, 1.0), _NORMAL
    first = (x**3 + x) / 4.0
    second = (5.0 * x**5 + 16.0 * x**3 + 3.0 * x) / 96.0
    return x + first / freedom + second / freedom**2


def _interval(value: float, width: float) -> Estimate:
    """A positive value whose logarithm is known to within `width`."""
    factor = math.exp(min(width, 50.0))
    return Estimate(value, value / factor, value * factor)
