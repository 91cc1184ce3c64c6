"""How quick the window is, measured with real frames: run it under a display, Xvfb for instance.

    xvfb-run -a -s "-screen 0 1440x900x24" python tests/ui/measure.py scenes/plume.usda [OUT.json]

Prints medians: from a slider's change to the new picture on the screen, pictures a second while orbiting, time between
frames of the window while the picture refines and while a stage loads, how long it takes to know the picture's error,
and processor use at rest. The view has 640×360 pixels. It is no test: nothing asserts a time.

With PREVIS_MEASURE_CORES=2 times are what the work would take on two cores that nobody else uses: the processor time of
the thread that draws the window, and half of that of all others, which are the rasteriser's. It is for a busy machine;
what the display server takes is not in it.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

os.environ.setdefault("PREVIS_CONFIG", tempfile.mkdtemp(prefix="previs-measure-"))

import glfw
import numpy as np
from imgui_bundle import glfw_utils, hello_imgui

import previs
from previs.ui.runner import Runner
from previs.ui.window import Start

VIEW = (640, 360)
CHANGES = 40
CORES = int(os.environ.get("PREVIS_MEASURE_CORES", "0"))


def clock() -> float:
    """Seconds: of the wall, or of work on so many cores. For the thread that draws the window."""
    if not CORES:
        return time.perf_counter()
    own = time.thread_time()
    return own + (time.process_time() - own) / CORES


def count_work() -> None:
    """Have pictures choose their drafts and pieces by work, not by a wall clock that others' work moves too."""
    from previs.render import pieces
    from previs.ui import picture

    for module in (pieces, picture):
        module.time = SimpleNamespace(perf_counter=clock)


class Measurement:
    """Does things in the window frame by frame and notes the times."""

    def __init__(self, runner: Runner, path: str, large: str) -> None:
        self.runner, self.path, self.large = runner, path, large
        self.results: dict[str, Any] = {}
        self.steps = self._script()
        self.ended: list[float] = []
        self.dragging = self.mouse_moves = False
        self.awake = False

    def take_over(self) -> None:
        """Put the script between the window's frame and the application's turn."""
        app = self.runner.app
        tick = app.tick

        def scripted_tick() -> None:
            next(self.steps, None)
            app.dragging = self.dragging
            if self.mouse_moves:
                app.touched = time.monotonic()
            tick()
            # The script goes on at once, without the pause of a window at rest.
            if self.awake:
                app.notify("measuring")

        app.tick = scripted_tick

    def after_swap(self) -> None:
        self.ended.append(clock())

    def _wait(self, condition, seconds: float = 120.0):
        end = time.perf_counter() + seconds
        self.awake = True
        while not condition():
            assert time.perf_counter() < end, "it took too long"
            yield
        self.awake = False

    def _pause(self, seconds: float):
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            yield

    def _changes(self, change):
        """Median and 90th percentile of the time from a change to the frame that shows it, one after another."""
        app = self.runner.app
        times = []
        self.dragging = True
        for number in range(CHANGES):
            begin = clock()
            change(number)
            yield
            while not app.picture.current:
                yield
            # This frame has been swapped when the generator goes on; the one that shows the picture is its successor.
            yield
            times.append(self.ended[-1] - begin)
        self.dragging = False
        return statistics.median(times), sorted(times)[int(0.9 * CHANGES)]

    def _fit_window(self):
        """Give the window the size at which its view has the pixels asked for."""
        app, window = self.runner.app, glfw_utils.glfw_window_hello_imgui()
        for _ in range(5):
            yield
        for _ in range(60):
            if app.size == VIEW:
                break
            width, height = glfw.get_window_size(window)
            # A part of the window's growth goes to other panels.
            grow = [
                round(0.7 * (want - has)) or (want > has) - (want < has)
                for want, has in zip(VIEW, app.size, strict=True)
            ]
            glfw.set_window_size(window, width + grow[0], height + grow[1])
            for _ in range(3):
                yield
        self.results["cores"] = CORES
        self.results["view"], self.results["window"] = list(app.size), list(glfw.get_window_size(window))

    def _script(self):
        app = self.runner.app
        yield from self._fit_window()
        yield from self._wait(lambda: app.document is not None and app.picture.finished)
        document = app.document
        volume = next(iter(document.description.volumes))
        light = next(iter(document.description.lights))

        def medium(**values):
            return lambda scene: scene.set_medium(volume, **values)

        changes = {
            "albedo": lambda n: app.edit("a", medium(albedo=0.5 + 0.01 * n)),
            "density_scale": lambda n: app.edit("d", medium(density_scale=1.0 + 0.01 * n)),
            "light_intensity": lambda n: app.edit("i", lambda s: s.set_light(light, exposure=0.01 * n)),
            "light_direction": lambda n: app.edit(
                "l", lambda s: s.set_light(light, direction=(0.3 + 0.01 * n, -1, -0.4))
            ),
            "exposure": lambda n: setattr(app.view, "exposure", 0.01 * n),
        }
        for name, change in changes.items():
            median, most = yield from self._changes(change)
            self.results[name] = {
                "median_ms": 1e3 * median,
                "p90_ms": 1e3 * most,
                "ran": sorted({p.split()[0] for p in app.picture.executed}),
            }
            yield from self._wait(lambda: app.picture.finished)
        self.dragging = True
        begin, serial, divisors = clock(), app.picture.serial, []
        while clock() - begin < 4.0:
            # To and fro: what is looked at stays in view.
            turn = 0.004 if len(divisors) % 20 < 10 else -0.004
            app.move_camera(lambda orbit, turn=turn: orbit.orbit(turn, 0.0))
            divisors.append((app.size[0] / app.picture.plan.width, app.picture.plan.settings.march_divisor))
            yield
        seconds = clock() - begin
        self.results["orbit"] = {
            "pictures_per_second": (app.picture.serial - serial) / seconds,
            "divisor, march_divisor": sorted(divisors)[len(divisors) // 2],
        }
        self.dragging = False
        for name, hand in (("refining_under_a_moving_mouse", True), ("refining_hands_off", False)):
            app.move_camera(lambda orbit: orbit.orbit(0.004, 0.0))
            self.mouse_moves = hand
            begin, frames = clock(), len(self.ended)
            yield
            yield from self._wait(lambda: app.picture.finished)
            self.results[name] = {"seconds": clock() - begin, **intervals(self.ended[frames:])}
        self.mouse_moves = False
        app.move_camera(lambda orbit: orbit.orbit(0.004, 0.0))
        yield
        yield from self._wait(lambda: app.picture.finished)
        begin, frames = clock(), len(self.ended)
        yield from self._wait(lambda: app.rest.estimate is not None)
        self.results["measuring_the_error"] = {
            "seconds": clock() - begin,
            "of_these_measuring": app.rest.estimate.seconds,
            **intervals(self.ended[frames:]),
        }
        begin, frames = clock(), len(self.ended)
        app.open(self.large)
        yield from self._wait(lambda: app.loading is None)
        self.results["loading"] = {"seconds": clock() - begin, **intervals(self.ended[frames:])}
        app.open(self.path)
        yield from self._wait(lambda: app.loading is None)
        yield from self._wait(lambda: app.picture.finished and app.rest.estimate is not None)
        app.messages.clear()
        yield from self._pause(2.0)
        begin, spent, frames = time.perf_counter(), time.process_time(), len(self.ended)
        yield from self._pause(15.0)
        wall = time.perf_counter() - begin
        self.results["idle"] = {
            "processor_percent_of_one_core": 100.0 * (time.process_time() - spent) / wall,
            "frames_per_second": (len(self.ended) - frames) / wall,
        }
        hello_imgui.get_runner_params().app_shall_exit = True


def intervals(ends: list[float]) -> dict[str, float]:
    """Statistics of the time between frames of the window."""
    between = sorted(1e3 * (b - a) for a, b in pairwise(ends))
    if not between:
        return {}
    return {
        "median_ms": statistics.median(between),
        "p90_ms": between[int(0.9 * len(between))],
        "worst_ms": between[-1],
        "frames": len(between),
    }


def write_large(folder: Path) -> str:
    """A stage with a cloud of 256³ voxels, 8.6 million of them active, as compressed as exporters write it."""
    axis = np.linspace(-1.0, 1.0, 256)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    density = np.clip(1.0 - x * x - y * y - z * z, 0.0, None).astype(np.float32)
    density *= 1.0 + 0.5 * np.sin(40.0 * x) * np.sin(37.0 * y) * np.sin(31.0 * z)
    with previs.Scene() as scene:
        scene.add_volume("/cloud", density, bounds=((-1, -1, -1), (1, 1, 1)), extinction=(5, 5, 5))
        scene.add_distant_light("/sun", (-1, -1, -1), irradiance=3)
        scene.save(folder / "large.usda")
    return str(folder / "large.usda")


def main() -> int:
    from imgui_bundle import immapp

    from previs.ui.window import choose_platform

    path = sys.argv[1]
    choose_platform()
    if CORES:
        count_work()
    runner = Runner(Start(path=path, size=(1280, 720)))
    parameters, add_ons = runner.parameters()
    measurement = Measurement(runner, path, write_large(Path(tempfile.mkdtemp(prefix="previs-measure-"))))
    begin = parameters.callbacks.post_init

    def post_init() -> None:
        begin()
        if runner.app is not None:
            measurement.take_over()

    parameters.callbacks.post_init = post_init
    parameters.callbacks.after_swap = measurement.after_swap
    immapp.run(parameters, add_ons)
    if runner.failure is not None:
        raise runner.failure
    text = json.dumps(measurement.results, indent=1)
    print(text)
    if len(sys.argv) > 2:
        Path(sys.argv[2]).write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
