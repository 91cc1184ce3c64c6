"""The error meter: draws the pixels from which a picture's error is estimated."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

import numpy as np

from ..description import Camera, Volume
from ..errors import PrevisError
from ..image import Image
from ..index import RenderIndex
from ..meter import FIRST_PHASE, ErrorEstimate, PixelSample, choose_again, choose_pixels, estimate_error
from ..settings import BY_NAME, Settings
from .draws import LOOP_BUDGET, fine_steps_across, steps_across
from .method import method_of
from .renderer import Renderer, sample_shifts
from .scattered import ScatteredPixels

#: Steps of a view ray through a volume that more would not change by anything that counts: so many at least, and so
#: many per step that the plan would take. On the shipped scenes doubling them changes the mean error by less than 2e-4.
CONVERGED_STEPS, CONVERGED_FACTOR = 2048, 4
#: Transmittance below which a converged view ray ends.
CONVERGED_CUTOFF = 1e-7
#: The pixels that say where errors are likely: by good maps, and so many times the steps. Of a curve, although slices
#: are quicker: those err where the picture's slices do, which then goes unseen, and intervals are twice as wide.
GUESS = {"transmittance": "quantile", "coefficients": 14, "map_filter": "blend"}
GUESS_STEPS = 2

T = TypeVar("T")


def converged(settings: Settings, volumes: list[Volume]) -> Settings:
    """The settings that the truth is drawn with: light by brute force, steps so fine that more would change nothing."""
    steps = max([CONVERGED_STEPS, *(CONVERGED_FACTOR * fine_steps_across(v) for v in volumes), settings.steps])
    cutoff = min(settings.opacity_cutoff, CONVERGED_CUTOFF)
    return brute_force(settings, volumes).replace(steps=_possible("steps", steps), opacity_cutoff=cutoff)


def brute_force(settings: Settings, volumes: list[Volume]) -> Settings:
    """The settings, with light marched by brute force, and every view ray."""
    found = settings.replace(transmittance="march", light_steps=0, march_divisor=1, cull_lights=False, skip_empty=False)
    grids = [v for v in volumes if v.density is not None]
    # A march that is exact may be longer than a draw can be; the longest one that can be is taken then.
    cells = sum(fine_steps_across(v) for v in grids)
    if 2 * cells > LOOP_BUDGET:
        found = found.replace(light_steps=max(LOOP_BUDGET // (2 * len(grids)) - 1, 1))
    return found


def _possible(name: str, value: int) -> int:
    return int(min(value, BY_NAME[name].maximum or value))


class ErrorMeter:
    """Estimates the error of pictures that a renderer has drawn; what that renderer holds stays as it is.

    Use it as a context manager, or call `release`.

    Args:
        renderer: whose context, shaders, voxels and meshes to use.

    Raises:
        ValueError: when the renderer was released.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = Renderer(share=renderer)

    def __enter__(self) -> ErrorMeter:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Free what the meter holds beside the renderer."""
        self._renderer.release()

    def measure(
        self,
        index: RenderIndex,
        camera: Camera,
        image: Image,
        settings: Settings,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> ErrorEstimate:
        """Estimate the error of a picture; see `measuring`. `progress` is called as by `Renderer.render`."""
        work = self.measuring(index, camera, image, settings, seed)
        while True:
            try:
                done = next(work)
            except StopIteration as end:
                return end.value
            if progress is not None:
                progress(done)

    def measuring(
        self,
        index: RenderIndex,
        camera: Camera,
        image: Image,
        settings: Settings,
        seed: int = 0,
        piece_seconds: float | None = None,
    ) -> Generator[float, None, ErrorEstimate]:
        """Estimate the error of a picture, a piece of work at a time.

        Between two pieces anything may be drawn in the context, and the generator may be dropped, as with
        `Renderer.drawing`. The scene must not change meanwhile.

        The truth of a pixel has the picture's own samples per pixel, shadow maps and voxels; what these approximate is
        not in the error.

        Args:
            index: the scene.
            camera: that the picture was drawn with.
            image: the picture, as it was drawn.
            settings: that it was drawn with; `error_pixels` of them says how many pixels to look at.
            seed: other pixels for another seed.
            piece_seconds: how long a piece should take; see `Renderer.drawing`.

        Yields:
            The part of the work that is done, in [0, 1].

        Returns:
            The estimate.

        Raises:
            PrevisError: when the scene cannot be drawn, or the picture holds values that are not finite.
        """
        if bad := np.count_nonzero(~np.isfinite(image.color)):
            raise PrevisError(f"{bad} values of the picture are not finite, so its error cannot be measured")
        clock = _Clock()
        volumes = [entry.record for entry in index.volumes.values()]
        sample = yield from clock.timed(self.choosing(index, camera, image, settings, seed, piece_seconds), 0.0, 0.4)
        truth = converged(settings, volumes)
        same_steps = brute_force(settings, volumes)
        # Scattered pixels are all marched: what the picture interpolates is in none of them.
        marched = (settings,) if settings.march_divisor > 1 else ()
        work = self.drawing(index, camera, image.size, (same_steps, truth, *marched), sample, piece_seconds)
        drawn = yield from clock.timed(work, 0.4, 1.0)
        return (
            yield from _aside(
                piece_seconds,
                1.0,
                lambda: estimate_error(
                    image.color,
                    sample,
                    *drawn,
                    steps=truth.steps,
                    light_steps=truth.light_steps,
                    seconds=clock.seconds,
                ),
            )
        )

    def choosing(
        self,
        index: RenderIndex,
        camera: Camera,
        image: Image,
        settings: Settings,
        seed: int = 0,
        piece_seconds: float | None = None,
    ) -> Generator[float, None, PixelSample]:
        """Choose the pixels to look at; the arguments are those of `measuring`."""
        shown = np.isfinite(image.depth)
        if (transmittance := image.aovs.get("transmittance")) is not None:
            shown = shown | (transmittance < 1.0).any(axis=2)
        count = FIRST_PHASE * settings.error_pixels
        sample = yield from _aside(piece_seconds, 0.0, lambda: choose_pixels(image.color, shown, count, seed))
        if settings.error_pixels < len(sample):
            better = yield from self._better(index, camera, image, settings, sample, piece_seconds)
            sample = choose_again(image.color, sample, better, settings.error_pixels, seed)
        yield 1.0
        return sample

    def _better(
        self,
        index: RenderIndex,
        camera: Camera,
        image: Image,
        settings: Settings,
        sample: PixelSample,
        piece_seconds: float | None,
    ) -> Generator[float, None, np.ndarray]:
        """Values of pixels that are likely to be nearer the truth, (N, 3): by good maps and more steps.

        Where the picture has light by brute force, maps would not be nearer: it is corrected by what the steps change,
        unless it is interpolated, which is likely to be the most that it is off.
        """
        volumes = [entry.record for entry in index.volumes.values()]
        automatic = {name: 0 for name in ("map_size", "threshold", "density_weighting", "light_steps")}
        same = settings.replace(**GUESS, **automatic)
        steps = max((steps_across(v, settings.steps) for v in volumes), default=1)
        finer = same.replace(steps=_possible("steps", GUESS_STEPS * steps))
        kinds = (finer,) if method_of(settings).has_maps or settings.march_divisor > 1 else (same, finer)
        drawn = yield from self.drawing(index, camera, image.size, kinds, sample, piece_seconds)
        if len(kinds) == 1:
            return drawn[0]
        found = image.color[sample.rows, sample.columns]
        return np.maximum(found + (drawn[1] - drawn[0]), 0.0)

    def drawing(
        self,
        index: RenderIndex,
        camera: Camera,
        size: tuple[int, int],
        kinds: tuple[Settings, ...],
        sample: PixelSample,
        piece_seconds: float | None = None,
    ) -> Generator[float, None, list[np.ndarray]]:
        """Pixels as each of several settings draws them, (N, 3) each, averaged over the samples of a pixel."""
        pixels = ScatteredPixels(sample.rows, sample.columns)
        shifts = sample_shifts(kinds[0].antialias)
        totals = [np.zeros((len(pixels), 3)) for _ in kinds]
        parts, done = len(shifts) * len(kinds), 0
        for shift in shifts:
            for total, settings in zip(totals, kinds, strict=True):
                plan = self._renderer.plan(index, camera, *size, settings, shift, pixels)
                for part in self._renderer.drawing(plan, piece_seconds):
                    yield (done + part) / parts
                done += 1
                total += self._renderer.scattered(plan)[:, :3]
        return [total / len(shifts) for total in totals]


def _aside(piece_seconds: float | None, done: float, work: Callable[[], T]) -> Generator[float, None, T]:
    """Do work without OpenGL; where pieces are wanted, in a thread, since it cannot be cut. Yields the `done` part."""
    if piece_seconds is None:
        return work()
    pool = ThreadPoolExecutor(1)
    try:
        result = pool.submit(work)
        while not result.done():
            wait([result], piece_seconds)
            yield done
        return result.result()
    finally:
        # Whoever drops the generator does not wait for it.
        pool.shutdown(wait=False)


class _Clock:
    """Adds up the time that work takes, without what others do between its pieces."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._begin = 0.0

    def start(self) -> None:
        self._begin = time.perf_counter()

    def stop(self) -> None:
        self.seconds += time.perf_counter() - self._begin

    def timed(self, work: Generator, first: float, last: float) -> Generator:
        """Run the work, timing its pieces; its progress counts from `first` to `last`."""
        while True:
            self.start()
            try:
                done = next(work)
            except StopIteration as end:
                return end.value
            finally:
                self.stop()
            yield first + (last - first) * done
