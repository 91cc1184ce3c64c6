"""``previs view``: the window in which a stage is seen and tuned."""

from __future__ import annotations

import argparse

from .arguments import add_opening_arguments, scene_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "stage", metavar="STAGE", nargs="?", help="USD stage (.usd, .usda, .usdc, .usdz) or .vdb file to open"
    )
    parser.add_argument("--time", type=float, help="time code (default: the earliest)")
    add_opening_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Open the window; 0 when it was closed.

    Raises:
        PrevisError: when no window or no OpenGL can be had.
    """
    from ..ui.window import Start, run

    run(
        Start(
            path=arguments.stage,
            scene_options=scene_options(arguments),
            camera=arguments.camera,
            time=arguments.time,
        )
    )
    return 0
