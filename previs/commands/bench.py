"""``previs bench``: speed reported against error on the shipped scenes or on stages, and the hard cases."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from ..errors import PrevisError
from ..settings import BY_NAME
from .arguments import _positive

_METHODS = BY_NAME["transmittance"].choices


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "stages",
        nargs="*",
        metavar="STAGE",
        help="USD stages or .vdb files (default: the scenes that come with previs)",
    )
    parser.add_argument(
        "--output", "-o", metavar="FOLDER", default="bench", help="where index.html and the rest go (default: ./bench)"
    )
    parser.add_argument("--imageWidth", "-w", type=_positive, metavar="PIXELS", help="width (default: 480; quick: 240)")
    parser.add_argument("--camera", "-cam", metavar="CAMERA", help="camera of the stages (default: their own)")
    parser.add_argument(
        "--repeats",
        type=_positive,
        metavar="N",
        help="turns that count, after one that warms up (default: 5; quick: 3)",
    )
    parser.add_argument(
        "--methods",
        type=_list_of("transmittance"),
        metavar="NAME[,NAME...]",
        help=f"transmittance methods: {', '.join(_METHODS)} (default: all)",
    )
    parser.add_argument(
        "--coefficients",
        type=_list_of("coefficients"),
        metavar="N[,N...]",
        help="stored values per texel of a map (default: 2,6,10,14; quick: 6,14)",
    )
    parser.add_argument(
        "--steps",
        type=_list_of("steps"),
        metavar="N[,N...]",
        help="steps of view and light rays; 0 leaves them to the plan (default: 0,128; quick: 0)",
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=VALUE[,VALUE...]",
        help="values of another knob to compare as well, like map_filter=blend,nearest",
    )
    parser.add_argument("--quick", action="store_true", help="small pictures and few settings: minutes, not an hour")
    parser.add_argument(
        "--paper", action="store_true", help="also the tables of the papers; every .vdb is a smoke there"
    )
    parser.add_argument("--paper-only", action="store_true", help="the tables of the papers alone")
    parser.add_argument(
        "--truth",
        action="store_true",
        help="print how far small pictures are from the float64 reference, with 20 random scenes; minutes",
    )
    parser.add_argument(
        "--speed",
        action="store_true",
        help="what a frame costs instead: against a march through the density alone, without each accelerator, and "
        "against brute force of equal error; and how costs grow",
    )
    parser.add_argument("--full", action="store_true", help="with --speed: larger pictures and sweeps; an hour")
    parser.add_argument(
        "--scaling",
        type=_sweeps,
        metavar="NAME[,NAME...]",
        help="with --speed: sizes to sweep over, voxels, pixels, steps, lights, volumes, coefficients, or none "
        "(default: all)",
    )
    parser.add_argument(
        "--hard", action="store_true", help="print the table of hard cases alone; exit status 1 when one fails"
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure and write; 0 when done, 1 when a hard case fails."""
    from ..render.renderer import Renderer

    if arguments.hard:
        return _hard(arguments.methods)
    if arguments.truth:
        return _truth(arguments.stages, arguments.methods, arguments.imageWidth)
    if not arguments.speed and (arguments.full or arguments.scaling is not None):
        arguments.parser.error("--full and --scaling go with --speed")
    others = _others(arguments)
    try:
        from ..bench import paper, plots, report  # noqa: F401
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        raise PrevisError("drawing the plots needs matplotlib: pip install 'previs[bench]'") from None
    if arguments.speed:
        return _speed(arguments)
    from ..bench.run import shipped_stages

    quick = arguments.quick
    options = report.Options(
        methods=tuple(arguments.methods or _METHODS),
        coefficients=tuple(arguments.coefficients or ((6, 14) if quick else (2, 6, 10, 14))),
        steps=tuple(arguments.steps or ((0,) if quick else (0, 128))),
        repeats=arguments.repeats or (3 if quick else 5),
        width=arguments.imageWidth or (240 if quick else 480),
        camera=arguments.camera,
        others=others,
    )
    output = _folder(arguments.output)
    progress = _Line() if sys.stderr.isatty() else None
    with Renderer() as renderer:
        try:
            found, papers = [], []
            if not arguments.paper_only:
                found = report.sweep(renderer, arguments.stages or shipped_stages(), options, output, progress)
            if arguments.paper or arguments.paper_only:
                smokes = [stage for stage in arguments.stages if stage.lower().endswith(".vdb")]
                papers = paper.tables(renderer, smokes, quick, options.repeats, progress)
        finally:
            if progress is not None:
                progress.clear()
        files = report.write(output, renderer, found, options, papers)
    if found:
        print(report.headline(found))
    print(f"{len(files)} files in {output}; open {files[0]}")
    return 0


def _speed(arguments: argparse.Namespace) -> int:
    """Time frames and write what came of it."""
    from ..bench.run import shipped_stages
    from ..bench.speed import peer, report, scaling, scenes
    from ..render.renderer import Renderer

    full = arguments.full
    options = scenes.Options(
        width=arguments.imageWidth or (640 if full else 320),
        repeats=arguments.repeats or (5 if full else 3),
        pixels=4096 if full else 1024,
        camera=arguments.camera,
    )
    chosen = [s for s in scaling.sweeps(full) if arguments.scaling is None or s.name in arguments.scaling]
    stages = arguments.stages or shipped_stages()
    output = _folder(arguments.output)
    progress = _Line() if sys.stderr.isatty() else None
    with Renderer() as renderer:
        try:
            found = scenes.sweep(renderer, stages, options, progress)
            peers = peer.compare(renderer, stages, options, progress) if peer.is_there() else []
            # Growth shows in small pictures as well.
            scalings = scaling.scaling(renderer, chosen, options.width // 2, min(options.repeats, 3), progress)
        finally:
            if progress is not None:
                progress.clear()
        files, tables = report.write(output, renderer, found, scalings, peers, options)
    print("\n".join(table.markdown() for table in tables))
    print(report.headline(found))
    print(f"{len(files)} files in {output}; open {files[0]}")
    return 0


def _folder(name: str) -> Path:
    """The folder to write into, made where it is not there."""
    output = Path(name)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PrevisError(f"{output}: no folder can be made there: {error.strerror}") from None
    return output


def _sweeps(text: str) -> list[str]:
    """Names of sweeps."""
    known = ("voxels", "pixels", "steps", "lights", "volumes", "coefficients")
    names = [] if text == "none" else [part.strip() for part in text.split(",")]
    if unknown := [name for name in names if name not in known]:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r} is none of {', '.join(known)}, and not none")
    return names


def _others(arguments: argparse.Namespace) -> dict[str, list]:
    """The knobs that --vary names, with their values."""
    others = {}
    for given in arguments.vary:
        name, equals, values = given.partition("=")
        if not equals or name in ("transmittance", "coefficients", "steps", "light_steps"):
            own = "" if not equals else f"; {name} has an option of its own"
            arguments.parser.error(f"--vary {given}: write NAME=VALUE[,VALUE...]{own}")
        if name not in BY_NAME:
            arguments.parser.error(f"--vary {given}: no knob {name!r}; known are {', '.join(BY_NAME)}")
        try:
            others[name] = _list_of(name)(values)
        except argparse.ArgumentTypeError as error:
            arguments.parser.error(f"--vary {given}: {error}")
    return others


def _hard(methods: list[str] | None) -> int:
    from ..bench import hard
    from ..render.renderer import Renderer

    line = _Line() if sys.stderr.isatty() else None

    def progress(fraction: float, name: str) -> None:
        if line is not None:
            line(name, round(100 * fraction), 100)

    with Renderer() as renderer:
        try:
            outcomes = hard.run(renderer, methods=methods, progress=progress)
        finally:
            if line is not None:
                line.clear()
    print(hard.table(outcomes))
    return 1 if any(outcome.verdict == "FAIL" for outcome in outcomes) else 0


def _truth(stages: list[str], methods: list[str] | None, width: int | None) -> int:
    from ..bench import truth
    from ..render.renderer import Renderer

    line = _Line() if sys.stderr.isatty() else None

    def progress(name: str) -> None:
        if line is not None:
            line(name, 0, 1)

    with Renderer() as renderer:
        try:
            found = truth.measure(renderer, stages or None, 20, methods, width or truth.WIDTH, progress)
        finally:
            if line is not None:
                line.clear()
    print(truth.table(found))
    return 0


class _Line:
    """A line of progress on a terminal."""

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show what is being done, as the picture after `done` of `total`."""
        width = shutil.get_terminal_size().columns - 1
        bar = "#" * round(20 * done / max(total, 1))
        print(f"\r{f'[{bar:<20}] {done}/{total}  {what}':<{width}.{width}}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take the line away."""
        print("\r" + " " * (shutil.get_terminal_size().columns - 1) + "\r", end="", file=sys.stderr, flush=True)


def _list_of(name: str) -> Callable[[str], list]:
    setting = BY_NAME[name]

    def parse(text: str) -> list:
        try:
            values = [setting.parse(part.strip()) for part in text.split(",")]
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        return list(dict.fromkeys(values))

    return parse
