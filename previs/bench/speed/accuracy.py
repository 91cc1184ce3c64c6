"""How far ways to draw a scene are from its truth: all on the same pixels, so that they compare.

The truth is the converged march of `previs.render.measure` at pixels chosen at random as the error meter does; errors
of the picture follow from theirs, with 95 % intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...image import Image
from ...meter import ErrorPart, ErrorScale, Estimate, PixelSample, choose_pixels
from ...render.measure import ErrorMeter, converged
from ...settings import Settings
from ..run import Subject
from .ways import LADDER, accelerators


class Truth:
    """The truth of a scene at some pixels.

    Args:
        meter: draws them.
        subject: the scene.
        image: any picture of it: where it is bright or uneven more pixels are taken.
        pixels: how many.
        seed: other pixels for another seed.
        progress: called with the part that is done.
    """

    def __init__(
        self,
        meter: ErrorMeter,
        subject: Subject,
        image: Image,
        pixels: int,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._meter, self._subject = meter, subject
        shown = np.isfinite(image.depth)
        if (transmittance := image.aovs.get("transmittance")) is not None:
            shown = shown | (transmittance < 1.0).any(axis=2)
        self.sample: PixelSample = choose_pixels(image.color, shown, pixels, seed)
        volumes = [entry.record for entry in subject.index.volumes.values()]
        #: What the truth is drawn with.
        self.settings = converged(subject.settings.replace(antialias=1, **accelerators()), volumes)
        self.values = self.draw(self.settings, progress)
        self._scale = ErrorScale(np.asarray(image.color, float), self.sample, self.values)

    def draw(self, settings: Settings, progress: Callable[[float], None] | None = None) -> np.ndarray:
        """The pixels as settings draw them, (N, 3)."""
        subject = self._subject
        work = self._meter.drawing(subject.index, subject.camera, subject.size, (settings,), self.sample)
        while True:
            try:
                done = next(work)
            except StopIteration as end:
                return end.value[0]
            if progress is not None:
                progress(done)

    def of_pixels(self, values: np.ndarray) -> ErrorPart:
        """The error of a picture whose pixels these are, (N, 3)."""
        return self._scale.part(np.asarray(values, float) - self.values)

    def of_image(self, image: Image) -> ErrorPart:
        """The error of a picture."""
        return self.of_pixels(image.color[self.sample.rows, self.sample.columns])

    def of_settings(self, settings: Settings) -> ErrorPart:
        """The error of the picture that settings draw, of which only the pixels are drawn."""
        return self.of_pixels(self.draw(settings))


@dataclass(frozen=True)
class EqualError:
    """The plain renderer with the least steps whose error is no larger than what was asked for.

    `reached` is False where even the most steps were not enough: these are given then. `tried` are all that were drawn,
    with their errors.
    """

    steps: int
    error: Estimate
    reached: bool
    tried: tuple[tuple[int, Estimate], ...]


def equal_error(error_at: Callable[[int], Estimate], wanted: float, ladder: Sequence[int] = LADDER) -> EqualError:
    """Climb a ladder of steps to the first whose error is at or below what is wanted.

    Args:
        error_at: the error at a number of steps.
        wanted: mean relative error.
        ladder: rising numbers of steps; at least one.
    """
    tried = []
    for steps in ladder:
        error = error_at(steps)
        tried.append((steps, error))
        if error.value <= wanted:
            return EqualError(steps, error, True, tuple(tried))
    return EqualError(*tried[-1], False, tuple(tried))
