"""``previs record``: frames of a stage to picture files, as usdrecord does it."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import sys
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import PrevisError
from ..io import COLOR_CORRECTIONS, check_format, parse_exposure, preload, write_text
from ..settings import Settings
from .arguments import (
    add_setting_arguments,
    add_stage_arguments,
    idle_notes,
    open_scene,
    preset_from,
    settings_from,
)
from .frames import frame_path, has_placeholder, parse_frames
from .view_of import camera_and_size, with_camera_light

if TYPE_CHECKING:
    from ..ahead import Writing
    from ..image import Image
    from ..render.choosing import Choice


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_stage_arguments(parser)
    parser.add_argument(
        "output", metavar="OUTPUT", help="picture: .exr (linear, all planes), .png or .jpg; ### is the frame"
    )
    times = parser.add_mutually_exclusive_group()
    times.add_argument("--frames", "-f", metavar="FRAMES", help="time codes, like 1:100x2,120")
    times.add_argument("--defaultTime", "-d", action="store_true", help="render the stage without time samples")
    parser.add_argument(
        "--colorCorrectionMode",
        "-color",
        choices=COLOR_CORRECTIONS,
        default="sRGB",
        help="for .png and .jpg (default: sRGB); openColorIO takes $OCIO or the built-in ACES config",
    )
    parser.add_argument(
        "--exposure", type=_exposure, default=0.0, metavar="EV", help="stops, or auto, for .png and .jpg"
    )
    parser.add_argument(
        "--reference",
        action="store_true",
        help="march light exactly, from voxel to voxel, and the view in at least 1024 steps and two per voxel",
    )
    parser.add_argument(
        "--stats", metavar="FILE.json", help="write times, plan, memory, warnings and measured error of every frame"
    )
    parser.add_argument(
        "--measure-error",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="estimate the error of every frame from pixels drawn again by brute force (default: with --stats)",
    )
    parser.add_argument(
        "--max-error",
        type=_limit,
        metavar="E",
        help="choose the cheapest settings whose mean relative error, upper end of its 95 %% interval, is at most "
        "E, as 0.01; knobs that are given keep their values",
    )
    parser.add_argument("--cameraLight", action="store_true", help="add a light that shines along the view")
    parser.add_argument(
        "--disableCameraLight", action="store_true", help="accepted; there is no camera light by default"
    )
    parser.add_argument("--complexity", "-c", metavar="LEVEL", help="accepted; meshes are drawn as their control cage")
    parser.add_argument(
        "--enableDomeLightVisibility", action="store_true", help="show the dome light's colour as background"
    )
    add_setting_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Render; 0 when all frames were written, 1 when one could not be, 2 for wrong arguments."""
    try:
        explicit = settings_from(arguments)
        frames = parse_frames(arguments.frames) if arguments.frames is not None else [None]
        if len(frames) > 1 and not has_placeholder(arguments.output):
            raise ValueError(f"{arguments.output}: {len(frames)} frames need a ### in the name for the frame number")
        if arguments.frames is None and has_placeholder(arguments.output):
            raise ValueError(f"{arguments.output}: has a place for the frame number; say which frames with --frames")
        if arguments.max_error is not None and arguments.reference:
            raise ValueError("--max-error chooses settings and --reference gives them; take one")
        if arguments.quality is not None and arguments.reference:
            raise ValueError("--quality and --reference both give settings; take one")
        if len({frame_path(arguments.output, frame) for frame in frames if frame is not None}) < len(frames) > 1:
            raise ValueError(f"{arguments.output}: several frames would have one name; write ###.### for decimals")
    except ValueError as error:
        print(f"previs record: {error}", file=sys.stderr)
        return 2
    check_format(arguments.output)
    # Said before the first frame, not after the last.
    for file in (arguments.output, arguments.stats):
        if file is not None and not Path(file).parent.is_dir():
            raise PrevisError(f"{file}: there is no folder {Path(file).parent}")
    from ..ahead import ReadAhead
    from ..index import RenderIndex
    from ..render.renderer import Renderer

    measures = bool(arguments.stats) if arguments.measure_error is None else arguments.measure_error
    with open_scene(arguments) as scene, Renderer() as renderer, contextlib.ExitStack() as stack:
        meter = _meter(renderer, stack) if measures else None
        ahead = stack.enter_context(ReadAhead(scene.reader, renderer))
        # The last to be left is the first here: a picture under way is written whatever ends the frames.
        recording = stack.enter_context(_Recording(arguments, len(frames)))
        if arguments.disableGpu and not renderer.is_software:
            print(
                f"warning: --disableGpu: this driver has no software rasteriser; {renderer.device} draws",
                file=sys.stderr,
            )
        settings = Settings(**scene.settings({**preset_from(arguments), **explicit}))
        index = RenderIndex()
        default_time = float("nan") if arguments.defaultTime else None
        previous = None
        preload()
        for number, frame in enumerate(frames):
            output = arguments.output if frame is None else frame_path(arguments.output, frame)
            try:
                begin = clock.perf_counter()
                time = frame if frame is not None else default_time
                description = scene.describe(time)
                camera, size = camera_and_size(arguments, scene, description, time)
                if arguments.cameraLight:
                    description = with_camera_light(description, camera)
                index.update(description)
                chosen = _reference(settings, description) if arguments.reference else settings
                if number + 1 < len(frames):
                    ahead.begin(frames[number + 1], description, chosen)
                progress = recording.progress(number, frame)
                unmeasured = choice = None
                if arguments.max_error is not None:
                    from ..render.choosing import render_within

                    limit = arguments.max_error
                    image, choice = render_within(
                        renderer, index, camera, size, chosen, limit, explicit, number, progress, previous
                    )
                    previous = choice.settings if choice.met else None
                else:
                    image = renderer.render(index, camera, size, chosen, progress)
                if meter is not None and choice is None:
                    try:
                        image = image.with_error(meter.measure(index, camera, image, chosen, number))
                    except PrevisError as error:
                        # The picture is there, and may be what was wanted.
                        unmeasured = f"its error was not measured: {error}"
                if arguments.enableDomeLightVisibility:
                    image = _over_dome(image, description)
            except PrevisError as error:
                recording.fail(frame, error)
                continue
            notes = [str(note) for note in idle_notes(explicit, chosen)]
            notes += list(image.stats["notes"]) + _light_notes(description)
            notes += [unmeasured] if unmeasured is not None else []
            notes += [str(choice)] if choice is not None and not choice.met else []
            recording.write(_Drawn(frame, output, image, camera.path, notes, choice, clock.perf_counter() - begin))
    if arguments.stats:
        frames_written = {"stage": arguments.stage, "frames": recording.records}
        write_text(Path(arguments.stats), json.dumps(frames_written, indent=2) + "\n")
    return 1 if recording.failed else 0


@dataclass(frozen=True)
class _Drawn:
    """A frame that was drawn, and what is to be said of it: `seconds` that it took, the notes, and how its settings
    were chosen where a limit was given."""

    frame: float | None
    output: str
    image: Image
    camera: str
    notes: list[str]
    choice: Choice | None
    seconds: float


class _Recording:
    """Writes the frames beside the drawing, one at a time, and says in their order what became of them.

    Attributes:
        records: of all frames that are done with, for --stats.
        failed: how many could not be drawn or written.
    """

    def __init__(self, arguments: argparse.Namespace, count: int) -> None:
        self.records: list[dict[str, Any]] = []
        self.failed = 0
        self._arguments, self._count = arguments, count
        self._said: set[str] = set()
        self._writing: tuple[_Drawn, Writing] | None = None

    def __enter__(self) -> _Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self._settle()

    def write(self, drawn: _Drawn) -> None:
        """Write a frame once the one before is written."""
        from ..ahead import Writing

        self._settle()
        exposure, correction = self._arguments.exposure, self._arguments.colorCorrectionMode
        save = functools.partial(drawn.image.save, drawn.output, exposure=exposure, color_correction=correction)
        self._writing = drawn, Writing(save)

    def fail(self, frame: float | None, error: PrevisError) -> None:
        """Say that a frame cannot be drawn or written."""
        self._settle()
        _clear_line()
        self.failed += 1
        where = "" if frame is None else f"frame {frame:g}: "
        print(f"previs record: {where}{error}", file=sys.stderr)
        self.records.append({"frame": frame, "error": str(error)})

    def progress(self, number: int, frame: float | None) -> Callable[[float], None]:
        """What the drawing of a frame is to call: shows how far it is, and says so when the one before is written."""
        show = _progress(number, self._count, frame)

        def advance(fraction: float) -> None:
            if self._writing is not None and self._writing[1].done:
                self._settle()
            if show is not None:
                show(fraction)

        return advance

    def _settle(self) -> None:
        """Wait for the frame that is being written, and say what became of it."""
        if self._writing is None:
            return
        (drawn, writing), self._writing = self._writing, None
        frame, output, image = drawn.frame, drawn.output, drawn.image
        try:
            seconds = drawn.seconds + writing.wait()
        except PrevisError as error:
            self.fail(frame, error)
            return
        _clear_line()
        for note in drawn.notes:
            if note not in self._said:
                self._said.add(note)
                print(f"warning: {note}", file=sys.stderr)
        if frame is not None:
            error = f"  {image.error}" if image.error is not None else ""
            print(f"Recording time code: {frame:.4f}  {output}  {seconds:.2f} s{error}", flush=True)
        elif image.error is not None:
            print(f"{output}: {image.error}", flush=True)
        if drawn.choice is not None and drawn.choice.met:
            print(f"{output}: {drawn.choice}", flush=True)
        stats = {k: v for k, v in image.stats.items() if k != "notes"}
        total = {
            "frame": frame,
            "file": output,
            "total_seconds": seconds,
            "camera": drawn.camera or "(frames the stage)",
        }
        self.records.append({**total, "size": list(image.size), "warnings": drawn.notes, **stats})


def _meter(renderer, stack: contextlib.ExitStack):
    """What measures errors, released with the stack."""
    from ..render.measure import ErrorMeter

    return stack.enter_context(ErrorMeter(renderer))


def _reference(settings, description):
    """The settings, marching light exactly and the view in steps so fine that more of them change next to nothing."""
    from ..render.draws import fine_steps_across
    from ..render.measure import brute_force

    volumes = list(description.volumes.values())
    finest = max((fine_steps_across(volume) for volume in volumes), default=0)
    return brute_force(settings, volumes).replace(steps=max(settings.steps, 1024, 2 * finest))


def _light_notes(description) -> list[str]:
    """What an artist who looks at a black picture wants to be told."""
    notes = []
    if not description.volumes and not description.meshes:
        notes.append("the stage has nothing to show: no volume and no mesh")
    elif not any(max(light.radiance + light.strength) > 0.0 for light in description.lights.values()):
        notes.append("the stage has no light, so nothing is lit; --cameraLight adds one")
    return notes


def _over_dome(image, description):
    """The picture with the dome lights' colour behind it."""
    from dataclasses import replace

    import numpy as np

    radiance = np.sum(
        [light.radiance for light in description.lights.values() if light.kind == "dome"] or [(0, 0, 0)], axis=0
    )
    transmittance = image.aovs.get("transmittance", np.ones_like(image.color))
    open_sky = np.isinf(image.depth)[..., None] * transmittance
    return replace(image, color=(image.color + open_sky * radiance).astype(np.float32))


def _limit(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0")
    return value


_limit.__name__ = "number"


def _exposure(text: str) -> float | str:
    try:
        return parse_exposure(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("exposure: ")) from None


def _progress(number: int, count: int, frame: float | None):
    """A progress line on a terminal, for frames that take longer than a moment."""
    if not sys.stderr.isatty():
        return None
    begin = clock.perf_counter()

    def show(fraction: float) -> None:
        if clock.perf_counter() - begin < 0.5 and count == 1:
            return
        done = (number + fraction) / count
        bar = "#" * round(30 * done)
        name = f" frame {frame:g}" if frame is not None else ""
        print(f"\r[{bar:<30}] {100 * done:3.0f} %{name} ", end="", file=sys.stderr, flush=True)

    return show


def _clear_line() -> None:
    if sys.stderr.isatty():
        print("\r" + " " * 60 + "\r", end="", file=sys.stderr, flush=True)
