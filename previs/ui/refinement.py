"""The ladder of quality that the view climbs: a draft at once, the full picture when nothing moves.

A draft has the preset of that name: its media are marched for fewer pixels than there are, its surfaces are not. Where
the machine cannot keep up with a hand they are marched for fewer still, and then it is a smaller picture too. Then come
the media of the preset preview, then what the settings ask for. Where the machine draws the full picture at once there
is no ladder.

Where that is asked for it goes on to the truth: finer levels, and at last the march that errors are measured against.
Every level is a whole picture of its own, and every sample of a pixel takes all of its steps: the mean of many pictures
of few jittered steps has a limit that is off, as the mean of exponentials is not the exponential of the mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ..description import Volume
from ..quality import PRESET_KNOBS, at_most
from ..render.draws import fine_steps_across, steps_across
from ..render.measure import brute_force, converged
from ..render.method import SLICES_PER_DRAW, method_of
from ..settings import BY_NAME, Settings

LevelName = Literal["draft", "preview", "final", "finer", "exact"]

#: Levels that show what the settings ask for, or better.
FINISHED = ("final", "finer", "exact")

#: Seconds that a draft may take; ten pictures a second with the window's own drawing on top.
DRAFT_SECONDS = 0.055
#: A final picture that takes no longer than this is drawn without a draft before it.
AT_ONCE_SECONDS = 0.04
#: A final picture that takes no longer than this needs no preview before it.
NO_PREVIEW_SECONDS = 0.25
#: What a draft gives up changes only when the present one takes less than this part of the time, or more than that
#: multiple of it: another size is another G-buffer, and a picture that flickers.
STEADY = (0.35, 1.5)
#: What drafts give up, the least first: the side of a pixel in pixels of the view, and the side of the square of those
#: that one view ray is marched for at least.
DRAFTS = ((1, 1), (1, 4), (2, 1), (2, 4), (3, 4), (4, 4), (6, 4), (8, 4))
#: Time per pixel of a draft of which one pixel of 4 × 4 is marched, where that of the preset alone takes 1; measured in
#: software on the shipped plume and cloud.
COARSE_SHARE = 0.62
#: What of its preset a draft takes: the switch between 6 and 14 map values is to be seen at once.
DRAFT_KNOBS = tuple(name for name in PRESET_KNOBS if name != "coefficients")
#: What of its preset a preview takes: the final picture's maps are its own, or they would be made twice.
PREVIEW_KNOBS = tuple(name for name in PRESET_KNOBS if BY_NAME[name].invalidates == ("march",))
#: Finer levels light media by this method, whatever the settings' maps hold: it comes nearest to the truth.
FINER_METHOD: str = BY_NAME["transmittance"].default
#: They go up to twice as many slices of twice the size, but to no more texels along a side, and of all light-space
#: grids together: to fill them would take longer than the brute-force march that they precede.
FINER_MAP_SIZE, FINER_TEXELS = 1024, 2**25
#: Their view rays end where they transmit no more than that.
FINER_CUTOFF = 1e-5
#: A picture is as good as the truth where its mean relative error is below this for certain.
CONVERGED_ERROR = 1e-3
#: Seconds per pixel before anything was measured: a processor and a graphics card.
FIRST_GUESS = {True: 3.0e-7, False: 1.0e-9}
#: A final picture takes so many times longer per pixel than a draft, before it was measured.
FINAL_TO_DRAFT = 4.0


@dataclass(frozen=True)
class Level:
    """One step of the ladder: `divisor` pixels of the view along each side of a pixel drawn.

    The settings' `antialias` is 1 but in a final level and those after it, which are counted by `number` from 1.
    """

    name: LevelName
    divisor: int
    settings: Settings
    number: int = 0

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
        self._seconds = {"draft": guess, "preview": 2.0 * guess, "final": FINAL_TO_DRAFT * guess}
        self._draft: tuple[int, int] | None = None

    def measured(self, level: Level, pixels: int, seconds: float) -> None:
        """Take in how long a whole picture of a level took, which has so many pixels times samples."""
        rate = seconds / max(pixels, 1)
        if level.name == "draft":
            rate /= _share(level.settings.march_divisor)
        self._seconds[level.name] += 0.5 * (rate - self._seconds[level.name])

    def seconds(self, name: LevelName, pixels: int) -> float:
        """How long a picture of a level is expected to take, where it is a draft one of the preset."""
        return self._seconds[name] * pixels

    def first(self, width: int, height: int, settings: Settings) -> Level:
        """The level to draw at once."""
        if self.seconds("final", width * height) <= AT_ONCE_SECONDS:
            # More samples per pixel are for a picture at rest.
            return final(settings) if settings.antialias == 1 else Level("preview", 1, settings.replace(antialias=1))

        def part(draft: tuple[int, int]) -> float:
            divisor, marched = draft
            return self.seconds("draft", width * height) * _share(marched) / divisor**2 / DRAFT_SECONDS

        if self._draft is None or not STEADY[0] <= part(self._draft) <= STEADY[1]:
            self._draft = next((d for d in DRAFTS if part(d) <= 1.0), DRAFTS[-1])
        divisor, marched = self._draft
        return Level("draft", divisor, draft_settings(settings, marched))

    def next(self, reached: LevelName, width: int, height: int, settings: Settings) -> Level | None:
        """The level after one that was reached; None after the last."""
        if reached in FINISHED:
            return None
        slow = self.seconds("final", width * height * settings.antialias**2) > NO_PREVIEW_SECONDS
        preview = at_most(settings, "preview", PREVIEW_KNOBS).replace(antialias=1)
        if reached == "draft" and slow and method_of(settings).has_maps and preview != settings:
            return Level("preview", 1, preview)
        return final(settings)


def final(settings: Settings) -> Level:
    """The last level: what the settings ask for."""
    return Level("final", 1, settings)


def _share(marched: int) -> float:
    """Time per pixel of a draft of which one pixel of a square of that side is marched."""
    return COARSE_SHARE if marched == 4 else 1.0


def draft_settings(settings: Settings, marched: int = 1) -> Settings:
    """The settings of a draft, with view rays marched for squares of pixels of that side at least.

    Light is never marched in it: slices of it are filled sooner.
    """
    draft = at_most(settings, "draft", DRAFT_KNOBS).replace(antialias=1)
    draft = draft.replace(march_divisor=max(draft.march_divisor, marched))
    if not method_of(settings).has_maps:
        draft = draft.replace(transmittance=FINER_METHOD)
    return draft


@dataclass(frozen=True)
class SliceCounts:
    """What light-space grids a plan makes: texels along a side, slices of each, and how many grids; 0 without any."""

    size: int = 0
    slices: int = 0
    grids: int = 0

    def larger(self, factor: float) -> SliceCounts:
        """Grids that are larger by a factor along each of their axes, as far as there is room for so many."""
        if not self.size * self.slices * self.grids:
            return self
        room = (FINER_TEXELS / (self.size**2 * self.slices * self.grids)) ** (1.0 / 3.0)
        factor = max(min(factor, room, FINER_MAP_SIZE / self.size), 1.0)
        slices = math.ceil(self.slices * factor / SLICES_PER_DRAW) * SLICES_PER_DRAW
        return SliceCounts(round(self.size * factor), slices, self.grids)


def finer_levels(
    settings: Settings, volumes: Sequence[Volume], counts: SliceCounts = SliceCounts()
) -> tuple[Level, ...]:
    """The levels after the final one, on the way to the truth: each has a smaller error than the one before it.

    Each takes twice the steps of the one before, and larger light-space grids. The last one is the truth that errors
    are measured against: light by brute force, converged steps. All have the settings' samples per pixel, each of them
    with all of the level's steps.

    Args:
        settings: what the final level is drawn with.
        volumes: that it shows.
        counts: the light-space grids that it has, or would have by `FINER_METHOD`.

    Returns:
        The levels; none where the settings are the truth already, or nothing is marched through.
    """
    if not volumes:
        return ()
    truth = converged(settings, list(volumes))
    if truth == settings:
        return ()
    steps = max(steps_across(v, settings.steps) for v in volumes)
    doublings = 1
    while steps * 2**doublings < truth.steps:
        doublings += 1
    levels = []
    for number in range(1, doublings):
        part = number / (doublings - 1)
        found = _finer(settings, volumes, counts.larger(1.0 + part))
        found = found.replace(steps=steps * 2**number, opacity_cutoff=min(settings.opacity_cutoff, FINER_CUTOFF))
        levels.append(Level("finer", 1, found, number))
    return (*levels, Level("exact", 1, truth, len(levels) + 1))


def _finer(settings: Settings, volumes: Sequence[Volume], counts: SliceCounts) -> Settings:
    """Better ways for light: light-space grids of those counts; a march stays one."""
    if not method_of(settings).has_maps:
        return brute_force(settings, list(volumes))
    least = max((fine_steps_across(v) for v in volumes if v.density is not None), default=0)
    return settings.replace(
        transmittance=FINER_METHOD,
        march_divisor=1,
        map_size=counts.size,
        slices=counts.slices,
        light_steps=max(least, settings.light_steps),
    )
