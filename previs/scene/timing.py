"""The time that a stage covers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pxr import Usd

#: Time codes per second where a stage says none, or none that a clock can go by.
DEFAULT_RATE = 24.0


@dataclass(frozen=True)
class TimeRange:
    """The first and last time code of a stage, and how many time codes make a second."""

    start: float
    end: float
    frames_per_second: float

    def after(self, time: float, frames: int) -> float:
        """The time code so many frames after another, before it where negative: whole ones from the start, round the
        range."""
        count = max(round(self.end - self.start) + 1, 1)
        return self.start + (round(time - self.start) + frames) % count


def time_range(stage: Usd.Stage) -> TimeRange | None:
    """The authored range where it is finite, else that of the time samples; None for a stage that nothing animates."""
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    authored = stage.HasAuthoredTimeCodeRange() and end > start and math.isfinite(end - start)
    rate = stage.GetTimeCodesPerSecond()
    if not 0.0 < rate < math.inf:
        rate = DEFAULT_RATE
    first, last = float("inf"), float("-inf")
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        # Value clips may animate what no layer of the stage mentions.
        if authored and prim.HasAuthoredMetadata("clips"):
            return TimeRange(start, end, rate)
        for attribute in prim.GetAuthoredAttributes():
            if not attribute.ValueMightBeTimeVarying():
                continue
            if authored:
                return TimeRange(start, end, rate)
            samples = attribute.GetTimeSamples()
            if samples:
                first, last = min(first, samples[0]), max(last, samples[-1])
    return TimeRange(first, last, rate) if last > first else None
