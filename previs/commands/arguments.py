"""Arguments that several sub-commands share; the knobs come from the settings table."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..quality import PRESET_KNOBS, QUALITIES, preset
from ..settings import BY_NAME, TABLE, Settings

if TYPE_CHECKING:
    from ..description import Note

_PURPOSES = ("default", "render", "proxy", "guide")
#: The method that takes a number of coefficients where none is named that does.
_WITH_COEFFICIENTS = "quantile"
#: What a flag does besides setting its knob.
_MORE = {"coefficients": f" Without --transmittance it chooses maps that have them, {_WITH_COEFFICIENTS}."}


def add_stage_arguments(parser: argparse.ArgumentParser) -> None:
    """The stage, what of it to show, and how large."""
    parser.add_argument("stage", metavar="STAGE", help="USD stage: .usd, .usda, .usdc or .usdz; or a .vdb file")
    parser.add_argument(
        "--imageWidth", "-w", type=_positive, metavar="PIXELS", help="width of the image (default: 960)"
    )
    add_opening_arguments(parser)


def add_opening_arguments(parser: argparse.ArgumentParser) -> None:
    """What of a stage to show, and how to open it."""
    parser.add_argument(
        "--camera", "-cam", metavar="CAMERA", help="prim path or name of a camera (default: the stage's)"
    )
    parser.add_argument(
        "--mask", metavar="PATH[,PATH...]", help="show only these prims, what is below them and what they use"
    )
    parser.add_argument(
        "--purposes",
        metavar="PURPOSE[,PURPOSE...]",
        type=_purposes,
        default=["render"],
        help=f"purposes shown besides default: {', '.join(_PURPOSES[1:])} (default: render)",
    )
    parser.add_argument("--sessionLayer", metavar="LAYER", help="USD layer composed over the stage")
    parser.add_argument("--renderSettingsPrimPath", "-rs", metavar="PATH", help="RenderSettings prim to follow")
    parser.add_argument(
        "--keepGoing", action="store_true", help="leave out a volume that cannot be read, with a warning"
    )
    parser.add_argument(
        "--disableGpu", action="store_true", help="render on the processor (Mesa's software rasteriser)"
    )


def add_setting_arguments(parser: argparse.ArgumentParser) -> None:
    """The knobs of the settings table: a flag each for the common ones, --set for all."""
    group = parser.add_argument_group("quality")
    group.add_argument(
        "--quality",
        choices=QUALITIES,
        help="preset of the knobs " + ", ".join(PRESET_KNOBS) + "; it overrides the stage, and flags override it "
        "(default: the stage's values, else those of final)",
    )
    for setting in TABLE:
        if setting.flag:
            default = f" (default: {setting.default})"
            group.add_argument(
                setting.flag,
                dest=f"setting_{setting.name}",
                metavar=("|".join(str(c) for c in setting.choices) or "N"),
                help=setting.doc.replace("%", "%%") + _MORE.get(setting.name, "") + default,
            )
    names = ", ".join(s.name for s in TABLE)
    group.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="assignments", help=f"any knob: {names}"
    )


def preset_from(arguments: argparse.Namespace) -> dict[str, Any]:
    """The knobs that --quality sets, by name: they override the stage, and `settings_from` overrides them."""
    return preset(arguments.quality) if arguments.quality is not None else {}


def settings_from(arguments: argparse.Namespace) -> dict[str, Any]:
    """The knobs that the arguments set one by one, by name; a preset, the stage and the defaults have the others.

    Asking for a number of coefficients by their flag is asking for a method that has them.

    Raises:
        ValueError: one sentence naming the knob and what it accepts.
    """
    values: dict[str, Any] = {}
    for setting in TABLE:
        given = getattr(arguments, f"setting_{setting.name}", None)
        if given is not None:
            values[setting.name] = given
    for assignment in arguments.assignments:
        name, equals, value = assignment.partition("=")
        if not equals:
            raise ValueError(f"--set {assignment}: write NAME=VALUE")
        if name not in BY_NAME:
            raise ValueError(f"--set {assignment}: no knob {name!r}; known are {', '.join(BY_NAME)}")
        values[name] = value
    if getattr(arguments, "setting_coefficients", None) is not None:
        values.setdefault("transmittance", _WITH_COEFFICIENTS)
    return {name: BY_NAME[name].parse(value) for name, value in values.items()}


def idle_notes(explicit: Mapping[str, Any], settings: Settings) -> list[Note]:
    """What is said of knobs that were set one by one and have no effect with these settings."""
    from ..description import Note
    from ..render.method import method_of

    method = method_of(settings)
    if "coefficients" in explicit and not method.has_coefficients:
        return [Note("ignored", "coefficients", f"transmittance={method.name} stores none")]
    return []


def open_scene(arguments: argparse.Namespace):
    """The scene that the arguments name.

    Raises:
        PrevisError: when it cannot be opened.
    """
    from ..scene import Scene

    return Scene.open(arguments.stage, **scene_options(arguments))


def scene_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """The keyword arguments of `Scene.open` that the arguments ask for; --disableGpu takes effect here."""
    if arguments.disableGpu:
        os.environ["LIBGL_ALWAYS_SOFTWARE"] = "1"
    return {
        "session_layer": arguments.sessionLayer,
        "mask": [p for p in (arguments.mask or "").split(",") if p] or None,
        "purposes": arguments.purposes,
        "keep_going": arguments.keepGoing,
        "render_settings": arguments.renderSettingsPrimPath,
    }


def _purposes(text: str) -> list[str]:
    names = [name for name in text.replace(" ", ",").split(",") if name]
    for name in names:
        if name not in _PURPOSES:
            raise argparse.ArgumentTypeError(f"{name} is not one of {', '.join(_PURPOSES)}")
    return names


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of 1 or more")
    return value


_positive.__name__ = "whole number"
