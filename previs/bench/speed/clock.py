"""Timing what is drawn: whole frames from nothing but the voxels, and frames after a camera or a light moved.

Times are of the processor, all threads together, which is what a picture costs on a software rasteriser and which
other work on the machine hardly changes; and by the wall clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...description import Camera, Light, SceneDescription
from ...image import Image
from ...index import RenderIndex
from ...render.floor import FLOOR_STEPS, floor_plan
from ...render.measure import ErrorMeter
from ...render.planned import Plan
from ...render.renderer import Renderer
from ...render.scattered import ScatteredPixels
from ...settings import Settings
from ..run import Subject
from ..transforms import rotation, translation
from .ways import accelerators

#: Seconds that the floor is drawn for at least.
SHORT = 0.05
#: How far the camera and a light are moved, in degrees about the middle of the volumes.
TURN = 2.0


@dataclass(frozen=True)
class Taken:
    """Seconds of the processor and of the wall clock."""

    process: float
    wall: float

    def __mul__(self, factor: float) -> Taken:
        return Taken(self.process * factor, self.wall * factor)


@dataclass(frozen=True)
class FrameTimes:
    """What one way took in one turn; `floor` is that of the floor right before. None where it was not drawn."""

    whole: Taken
    camera: Taken | None
    light: Taken | None
    floor: Taken


def clocked(renderer: Renderer, work: Callable[[], object]) -> Taken:
    """The time that work takes, until all of its drawing is finished."""
    with renderer.context as context:
        context.finish()
    process, wall = time.process_time(), time.perf_counter()
    work()
    with renderer.context as context:
        context.finish()
    return Taken(time.process_time() - process, time.perf_counter() - wall)


def orbit(description: SceneDescription) -> np.ndarray:
    """A small turn of the world about the middle of the volumes, (4, 4), acting on row vectors."""
    middle = np.mean([_middle(v) for v in description.volumes.values()], axis=0)
    up = (0.0, 1.0, 0.0) if description.up_axis == "Y" else (0.0, 0.0, 1.0)
    return translation(*-middle) @ rotation(up, TURN) @ translation(*middle)


def _middle(volume) -> np.ndarray:
    if volume.density is not None and volume.density.grid.active_count:
        lo, hi = volume.density.grid.bounds
        point = np.append(0.5 * (np.asarray(lo, float) + np.asarray(hi, float)), 1.0)
        return (point @ np.asarray(volume.density.index_to_local, float) @ np.asarray(volume.local_to_world, float))[:3]
    return np.asarray(volume.local_to_world, float)[3, :3]


def moved_camera(camera: Camera, description: SceneDescription) -> Camera:
    """The camera after a small step around the volumes."""
    return replace(camera, camera_to_world=np.asarray(camera.camera_to_world, float) @ orbit(description))


def main_light(description: SceneDescription) -> Light | None:
    """The strongest light that casts shadows, else the strongest; None without one that can be moved."""
    lights = [light for light in description.lights.values() if light.kind != "dome" and max(light.strength) > 0.0]
    return max(lights, key=lambda light: (light.casts_shadows, max(light.strength)), default=None)


def moved_light(description: SceneDescription) -> SceneDescription | None:
    """The scene after its main light moved a little; None without one."""
    light = main_light(description)
    if light is None:
        return None
    turned = replace(light, light_to_world=np.asarray(light.light_to_world, float) @ orbit(description))
    return replace(description, lights={**description.lights, light.path: turned})


class Stopwatch:
    """Times ways to draw one scene; use it as a context manager, or call `release`.

    Pictures have one sample per pixel and are not read back. The floor has dense voxels of its own, whatever the ways
    do with theirs.

    Args:
        renderer: draws the pictures.
        subject: the scene; its index follows the light's moves, and is as it was after each.
    """

    def __init__(self, renderer: Renderer, subject: Subject) -> None:
        self.renderer, self.subject = renderer, subject
        self.description = subject.index.scene
        self.camera = moved_camera(subject.camera, self.description)
        self.lit = moved_light(self.description)
        self._floor = Renderer(context=renderer.context)
        # An index of its own would do as well; one more version of everything costs nothing.
        self._floor_index = RenderIndex()
        self._floor_index.update(self.description)

    def __enter__(self) -> Stopwatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Free the floor's voxels."""
        self._floor.release()

    def settings(self, values) -> Settings:
        """The stage's own settings with others in their place, at one sample per pixel."""
        return self.subject.settings.replace(antialias=1, **values)

    def plan(self, settings: Settings, camera: Camera | None = None, size=None, pixels=None) -> Plan:
        """The plan of a frame of the subject."""
        width, height = size or self.subject.size
        return self.renderer.plan(
            self.subject.index, camera or self.subject.camera, width, height, settings, pixels=pixels
        )

    def floor(self, steps: int = FLOOR_STEPS) -> Taken:
        """The time of the floor: the march through the density alone."""
        settings = self.subject.settings.replace(**accelerators(), antialias=1)
        plan = self._floor.plan(self._floor_index, self.subject.camera, *self.subject.size, settings)
        held = self._floor.executed

        def draw() -> None:
            self._floor.draw(floor_plan(plan, steps))

        if not held:
            draw()
        once = clocked(self._floor, draw)
        # A short one is drawn several times, until clocks can tell it from nothing.
        times = int(min(max(SHORT / max(once.wall, 1e-9), 1.0), 20.0))

        def repeatedly() -> None:
            for _ in range(times):
                draw()

        return clocked(self._floor, repeatedly) * (1.0 / times)

    def upload(self, settings: Settings) -> None:
        """Put the voxels where the settings want them, and forget all that was drawn."""
        plan = self.plan(settings)
        fields = tuple(p for p in plan.passes if p.kind == "fields")
        if fields:
            self.renderer.draw(replace(plan, passes=fields))
        self.renderer.forget_drawn()

    def whole(self, settings: Settings, size: tuple[int, int] | None = None) -> Taken:
        """The time of a frame from nothing but the voxels."""
        self.upload(settings)
        return clocked(self.renderer, lambda: self.renderer.draw(self.plan(settings, size=size)))

    def rows(self, settings: Settings, every: int) -> Taken:
        """As `whole`, estimated from every so many-th row of the picture."""
        width, height = self.subject.size
        rows, columns = np.mgrid[every // 2 : height : every, :width]
        pixels = ScatteredPixels(rows.ravel(), columns.ravel())
        self.upload(settings)
        taken = clocked(self.renderer, lambda: self.renderer.draw(self.plan(settings, pixels=pixels)))
        return taken * (height / len(rows))

    def camera_move(self, settings: Settings) -> Taken:
        """The time of a frame after the camera moved; a whole frame was drawn before."""
        return clocked(self.renderer, lambda: self.renderer.draw(self.plan(settings, self.camera)))

    def light_move(self, settings: Settings) -> Taken | None:
        """The time of a frame after the main light moved; a frame was drawn before."""
        if self.lit is None:
            return None
        # The camera stays where the frame before had it, whichever that was.
        self.renderer.draw(self.plan(settings))

        def draw() -> None:
            self.subject.index.update(self.lit)
            self.renderer.draw(self.plan(settings))

        try:
            return clocked(self.renderer, draw)
        finally:
            self.subject.index.update(self.description)

    def picture(self, settings: Settings) -> Image:
        """The frame of the settings, read back."""
        plan = self.plan(settings)
        self.renderer.draw(plan)
        return self.renderer.image(plan)

    def passes(self, settings: Settings) -> dict[str, float]:
        """Seconds of the wall clock by kind of pass, of a frame from nothing but the voxels."""
        self.upload(settings)
        plan, times, kinds = self.plan(settings), {}, {}
        self.renderer.draw(plan, times=times)
        for p in plan.passes:
            if p.name in times:
                kinds[p.kind] = kinds.get(p.kind, 0.0) + times[p.name]
        return kinds

    def meter(self) -> ErrorMeter:
        """An error meter on the same voxels."""
        return ErrorMeter(self.renderer)
