"""The ladder of quality that the view climbs: a draft at once, the full picture when nothing moves.

A draft is small and takes few steps, as small as the machine needs to keep up with a hand; then the whole picture with
few steps; then what the settings ask for. Where the machine draws the full picture at once there is no ladder.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..settings import Settings

LevelName = Literal["draft", "medium", "final"]

#: Seconds that a draft may take; ten pictures a second with the window's own drawing on top.
DRAFT_SECONDS = 0.055
#: A final picture that takes no longer than this is drawn without a draft before it.
AT_ONCE_SECONDS = 0.04
#: A final picture that takes no longer than this needs no medium one before it.
NO_MEDIUM_SECONDS = 0.25
#: The size of drafts changes only when the present one takes less than this part of the time, or more than that
#: multiple of it: another size is another G-buffer, and a picture that flickers.
STEADY = (0.35, 1.5)
#: Sides of a draft's pixels, in pixels of the view.
DIVISORS = (1, 2, 3, 4, 6, 8)
#: What drafts are content with, where the settings ask for more or leave it to the plan (0).
DRAFT_LIMITS = {"steps": 48, "light_steps": 48, "map_size": 96, "shadow_map_size": 1024, "antialias": 1}
MEDIUM_STEPS = 64
#: Seconds per pixel before anything was measured: a processor and a graphics card.
FIRST_GUESS = {True: 1.0e-6, False: 2.0e-9}
#: A final picture takes so many times longer per pixel than a draft, before it was measured.
FINAL_TO_DRAFT = 4.0


@dataclass(frozen=True)
class Level:
    """One step of the ladder: `divisor` pixels of the view along each side of a pixel drawn.

    The settings' `antialias` is 1 but in a final level.
    """

    name: LevelName
    divisor: int
    settings: Settings

    def size(self, width: int, height: int) -> tuple[int, int]:
        """(width, height) of the picture drawn for a view of that many pixels."""
        return max(-(-width // self.divisor), 1), max(-(-height // self.divisor), 1)


class Pace:
    """Seconds per sample of a pixel of every level as measured lately, to choose how small a draft must be.

    Args:
        software: whether the processor draws.
    """

    def __init__(self, software: bool) -> None:
        guess = FIRST_GUESS[software]
        self._seconds = {"draft": guess, "medium": 2.0 * guess, "final": FINAL_TO_DRAFT * guess}
        self._divisor = 0

    def measured(self, level: Level, pixels: int, seconds: float) -> None:
        """Take in how long a whole picture of a level took, which has so many pixels times samples."""
        rate = seconds / max(pixels, 1)
        self._seconds[level.name] += 0.5 * (rate - self._seconds[level.name])

    def seconds(self, name: LevelName, pixels: int) -> float:
        """How long a picture of a level is expected to take."""
        return self._seconds[name] * pixels

    def first(self, width: int, height: int, settings: Settings) -> Level:
        """The level to draw at once."""
        if self.seconds("final", width * height) <= AT_ONCE_SECONDS:
            # More samples per pixel are for a picture at rest.
            return final(settings) if settings.antialias == 1 else Level("medium", 1, settings.replace(antialias=1))
        whole = self.seconds("draft", width * height)
        kept = whole / max(self._divisor, 1) ** 2 / DRAFT_SECONDS
        if not self._divisor or not STEADY[0] <= kept <= STEADY[1]:
            self._divisor = next((d for d in DIVISORS if whole / (d * d) <= DRAFT_SECONDS), DIVISORS[-1])
        return Level("draft", self._divisor, draft_settings(settings))

    def next(self, reached: LevelName, width: int, height: int, settings: Settings) -> Level | None:
        """The level after one that was reached; None after the last."""
        if reached == "final":
            return None
        slow = self.seconds("final", width * height * settings.antialias**2) > NO_MEDIUM_SECONDS
        if reached == "draft" and slow and settings.transmittance != "march" and _many_steps(settings):
            return Level("medium", 1, settings.replace(steps=MEDIUM_STEPS, antialias=1))
        return final(settings)


def final(settings: Settings) -> Level:
    """The last level: what the settings ask for."""
    return Level("final", 1, settings)


def draft_settings(settings: Settings) -> Settings:
    """The settings of a draft. Light is never marched in it: a map of it is filled sooner."""
    values = {name: min(settings[name] or limit, limit) for name, limit in DRAFT_LIMITS.items()}
    if settings.transmittance == "march":
        values["transmittance"] = "tfm"
    return settings.replace(**values)


def _many_steps(settings: Settings) -> bool:
    return settings.steps == 0 or settings.steps > MEDIUM_STEPS
