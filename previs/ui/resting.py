"""What is done with a finished picture while nothing moves: its error is measured, and finer pictures follow it.

All of it is work for hands that rest: it goes on in pieces, it is dropped when anything changes, and what was found is
kept for as long as the picture that it was found of is on the screen. Nothing is measured twice.
"""

from __future__ import annotations

import time
from collections.abc import Generator

from ..errors import PrevisError
from ..meter import ErrorEstimate
from ..render.measure import ErrorMeter
from .picture import PIECE_SECONDS, Picture
from .refinement import CONVERGED_ERROR


class Rest:
    """Measures the picture shown, and lets it converge.

    Args:
        picture: to look after; its `converging` says whether finer levels are wanted.

    Attributes:
        measuring: whether errors are wanted. Where the picture is to converge they are in any case.
        progress: done part of the measurement under way, in [0, 1].
    """

    def __init__(self, picture: Picture) -> None:
        self.measuring = True
        self.progress = 0.0
        self._picture = picture
        self._meter: ErrorMeter | None = None
        self._work: Generator[float, None, ErrorEstimate] | None = None
        #: The picture that is being measured, and the one that was: their serial numbers.
        self._under_way = self._measured = 0
        self._estimate: ErrorEstimate | None = None
        self._problem = ""

    @property
    def estimate(self) -> ErrorEstimate | None:
        """The error of the picture that is on the screen; None while it is not known."""
        return self._estimate if self._knows() else None

    @property
    def problem(self) -> str:
        """Why the error of the picture on the screen cannot be measured, "" where it can."""
        return self._problem if self._knows() else ""

    @property
    def converged(self) -> bool:
        """Whether the picture on the screen is the truth, or as good as it."""
        if not self._picture.finished:
            return False
        if self._picture.level == "exact":
            return True
        return self.estimate is not None and self.estimate.mean_relative_error.high < CONVERGED_ERROR

    def _knows(self) -> bool:
        return self._picture.finished and self._measured == self._picture.serial

    @property
    def wants_measuring(self) -> bool:
        """Whether the picture on the screen is still to be measured, or is being."""
        picture = self._picture
        # Where there is nothing to march through, and at the truth itself, there is no error to measure.
        if not picture.finished or picture.level == "exact" or picture.plan is None or not picture.plan.volumes:
            return False
        return (self.measuring or picture.converging) and not self._knows()

    @property
    def pending(self) -> bool:
        """Whether `work` has anything to do."""
        picture = self._picture
        return picture.refining or self.wants_measuring or (picture.can_refine and not self.converged)

    def check(self, moving: bool) -> None:
        """Drop a measurement that is no longer wanted; call it in every frame."""
        if self._work is not None and (moving or not self.wants_measuring or self._under_way != self._picture.serial):
            self.drop()

    def work(self, seconds: float) -> None:
        """Measure for about so long, or begin a finer level, which the picture's own `work` goes on with.

        Raises:
            RuntimeError: for an error of previs; the picture is not measured again.
        """
        if not self.wants_measuring:
            if not self.converged:
                self._picture.refine()
            return
        begin = time.perf_counter()
        try:
            while time.perf_counter() - begin + PIECE_SECONDS <= seconds:
                if not (self._step() if self._work is not None else self._begin()):
                    return
        except PrevisError as error:
            self._finish(None, str(error))
        except BaseException:
            self._finish(None, "previs made an error")
            raise

    def _begin(self) -> bool:
        picture = self._picture
        request, settings, image = picture.shown_request, picture.shown_settings, picture.image()
        if request is None or settings is None or image is None:
            return False
        self._meter = ErrorMeter(picture.renderer)
        self._work = self._meter.measuring(request.index, request.camera, image, settings, piece_seconds=PIECE_SECONDS)
        self._under_way, self.progress = picture.serial, 0.0
        return True

    def _step(self) -> bool:
        """One piece; False when it was the last."""
        assert self._work is not None
        try:
            self.progress = next(self._work)
            return True
        except StopIteration as end:
            self._finish(end.value, "")
            return False

    def _finish(self, estimate: ErrorEstimate | None, problem: str) -> None:
        self.drop()
        self._measured = self._picture.serial
        self._estimate, self._problem = estimate, problem

    def drop(self) -> None:
        """Give up a measurement under way, and free what it took."""
        if self._work is not None:
            self._work.close()
            self._work = None
        if self._meter is not None:
            self._meter.release()
            self._meter = None
        self.progress = 0.0

    def release(self) -> None:
        """Free everything; the picture is not touched any more."""
        self.drop()
