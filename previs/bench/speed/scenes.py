"""The ways of every scene timed in turns, with their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import PrevisError
from ...meter import ErrorPart, Estimate
from ...render.draws import steps_across
from ...render.floor import FLOOR_STEPS
from ...render.renderer import Renderer
from ...settings import Settings
from ..report import names_of
from ..run import Progress, Spread, Subject, Variant, opened
from .accuracy import EqualError, Truth, equal_error
from .clock import FrameTimes, Stopwatch, Taken
from .ways import BRUTE_FORCE, DEFAULT, LADDER, plain, ways

#: A way whose frame is expected to take more seconds of the processor than this is drawn once, and of it only every
#: so many-th row.
SLOW, SLOW_ROWS = 20.0, 4
#: A way whose frame takes more seconds of the processor than this in the first turn is not drawn in the others.
LONG = 4.0
#: What a way is tried at first: a picture of so many times fewer pixels along both sides, which compiles its shaders.
TRIAL = 4


@dataclass(frozen=True)
class Options:
    """What to measure on every stage: `width` of the pictures, `repeats` turns that count after one that warms up,
    `pixels` at which errors are measured, `steps` of the floor, and the `ladder` of the plain renderer."""

    width: int = 320
    repeats: int = 3
    pixels: int = 1024
    camera: str | None = None
    steps: int = FLOOR_STEPS
    ladder: Sequence[int] = LADDER


@dataclass(frozen=True, eq=False)
class Measured:
    """What a way took and how far it was off.

    `turns` are empty for none but the floor's own row; `estimated` says that the times are of every fourth row, drawn
    once. `passes` are seconds of the wall clock by kind of pass.
    """

    variant: Variant
    settings: Settings
    turns: tuple[FrameTimes, ...]
    error: ErrorPart
    estimated: bool = False
    passes: Mapping[str, float] = field(default_factory=dict)

    def times(self, what: str, clock: str = "process") -> Spread | None:
        """Seconds of a ``whole`` frame, after a ``camera`` or a ``light`` move, or of the ``floor``; None where it was
        not drawn."""
        found = [getattr(t, clock) for t in self._taken(what)]
        return Spread.of(found) if found else None

    def over_floor(self, what: str, clock: str = "process") -> Spread | None:
        """The same in multiples of the floor right before."""
        floors = [getattr(t.floor, clock) for t in self.turns if getattr(t, what) is not None]
        found = [getattr(t, clock) / f for t, f in zip(self._taken(what), floors, strict=True) if f > 0.0]
        return Spread.of(found) if found else None

    def _taken(self, what: str) -> list[Taken]:
        return [taken for t in self.turns if (taken := getattr(t, what)) is not None]


@dataclass(frozen=True, eq=False)
class SceneSpeed:
    """All that was measured on one scene."""

    scene: str
    file: str
    size: tuple[int, int]
    ways: tuple[Measured, ...]
    floor: tuple[Taken, ...]
    equal: EqualError
    truth: Mapping[str, Any]

    def way(self, name: str) -> Measured | None:
        """The way of a name."""
        return next((w for w in self.ways if w.variant.name == name), None)

    @property
    def default(self) -> Measured:
        """The stage's own settings."""
        return next(w for w in self.ways if w.variant.name == DEFAULT)

    @property
    def plain(self) -> Measured:
        """The plain renderer at equal error."""
        return next(w for w in self.ways if w.variant.family == "plain")


def sweep(
    renderer: Renderer, stages: Sequence[str | Path], options: Options, progress: Progress | None = None
) -> list[SceneSpeed]:
    """Measure all ways on all stages.

    Raises:
        PrevisError: when a stage cannot be opened or rendered.
    """
    for stage in stages:
        if not Path(stage).is_file():
            raise PrevisError(f"{stage}: no such file")
    found = []
    for stage, name in zip(stages, names_of(stages), strict=True):
        renderer.forget_scene()
        with opened(stage, options.width, options.camera, name) as subject:
            found.append(measure(renderer, subject, options, progress))
    return found


def measure(renderer: Renderer, subject: Subject, options: Options, progress: Progress | None = None) -> SceneSpeed:
    """Measure all ways on one scene: errors first, then times in turns.

    Raises:
        PrevisError: when a way cannot be rendered; the message says which.
    """
    chosen = ways(subject.settings)

    def tell(what: str, done: int = 0, total: int = 1) -> None:
        if progress is not None:
            progress(f"{subject.name}: {what}", done, total)

    with Stopwatch(renderer, subject) as watch, watch.meter() as meter:
        tell("default")
        default = watch.picture(watch.settings({}))
        truth = Truth(
            meter,
            subject,
            default,
            options.pixels,
            progress=lambda part: tell("truth", round(100 * part), 100),
        )
        wanted = truth.of_image(default).mean_relative_error.value

        def error_at(steps: int) -> Estimate:
            tell(f"how far is a plain march of {steps} steps off?")
            return truth.of_settings(watch.settings(plain(steps))).mean_relative_error

        equal = equal_error(error_at, wanted, options.ladder)
        chosen.append(Variant(f"{BRUTE_FORCE}, {equal.steps} steps", plain(equal.steps), "plain"))
        settings = [watch.settings(v.settings) for v in chosen]
        small = tuple(max(edge // TRIAL, 1) for edge in subject.size)
        slow, errors = [], []
        for number, (variant, values) in enumerate(zip(chosen, settings, strict=True)):
            tell(f"{variant.name}, tried", number, len(chosen))
            try:
                watch.whole(values, small)
                expected = (
                    watch.whole(values, small).process * subject.size[0] * subject.size[1] / (small[0] * small[1])
                )
                # Maps do not grow with the picture: of those nothing can be told from a small one.
                is_slow = values.transmittance == "march" and expected > SLOW
                errors.append(truth.of_settings(values) if is_slow else truth.of_image(watch.picture(values)))
            except PrevisError as error:
                raise PrevisError(f"{subject.name}, {variant.name}: {error}") from error
            slow.append(is_slow)
        turns: list[list[FrameTimes]] = [[] for _ in chosen]
        total = len(chosen) * (options.repeats + 1)
        floors = []
        for turn in range(options.repeats + 1):
            for number, (variant, values) in enumerate(zip(chosen, settings, strict=True)):
                tell(variant.name, turn * len(chosen) + number, total)
                if turns[number] and (slow[number] or turns[number][0].whole.process > LONG):
                    continue
                taken = _frame(watch, values, options.steps, slow[number])
                # The first turn warms up what is drawn again; what takes long has been tried, and needs no more.
                if turn or slow[number] or taken.whole.process > LONG:
                    turns[number].append(taken)
                    floors.append(taken.floor)
        passes = [{} if s else watch.passes(v) for v, s in zip(settings, slow, strict=True)]
    volumes = [entry.record for entry in subject.index.volumes.values()]
    return SceneSpeed(
        subject.name,
        subject.file,
        subject.size,
        tuple(
            Measured(v, s, tuple(t), e, is_slow, p)
            for v, s, t, e, is_slow, p in zip(chosen, settings, turns, errors, slow, passes, strict=True)
        ),
        tuple(floors),
        equal,
        {
            "steps": max(steps_across(v, truth.settings.steps) for v in volumes),
            "light_steps": truth.settings.light_steps,
            "pixels": len(truth.sample),
            "floor_steps": options.steps,
        },
    )


def _frame(watch: Stopwatch, settings: Settings, steps: int, slow: bool) -> FrameTimes:
    """One turn of one way, the floor right before it."""
    floor = watch.floor(steps)
    if slow:
        return FrameTimes(watch.rows(settings, SLOW_ROWS), None, None, floor)
    whole = watch.whole(settings)
    return FrameTimes(whole, watch.camera_move(settings), watch.light_move(settings), floor)
