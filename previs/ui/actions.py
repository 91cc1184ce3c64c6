"""What every command of the window does."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from . import placing
from .app import App
from .commands import Command
from .dialogs import Dialogs
from .knobs import VIEW_BY_NAME
from .map_values import map_values, other_map_values, set_map_values

STAGES = (".usd", ".usda", ".usdc", ".usdz", ".vdb")
LAYERS = (".usda", ".usd", ".usdc")
PICTURES = (".png", ".exr", ".jpg")


def make_commands(app: App, dialogs: Dialogs, leave: Callable[[Callable[[], None]], None], quit_: Callable[[], None]):
    """All commands by name.

    Args:
        app: what they act on.
        dialogs: asks for files.
        leave: calls the function it is given once unsaved edits were saved or given up.
        quit_: ends the program.
    """

    def has_document() -> bool:
        return app.document is not None

    def modified() -> bool:
        return app.document is not None and app.document.modified

    def folder() -> str:
        return os.path.dirname(os.path.abspath(app.document.path)) if app.document is not None else os.getcwd()

    def open_() -> None:
        dialogs.open_file("Open a stage or a .vdb file", folder(), STAGES, lambda p: leave(lambda: app.open(p)))

    def save_overrides() -> None:
        assert app.document is not None
        name = Path(app.document.name).stem + "_look.usda"
        dialogs.save_file("Save overrides", os.path.join(folder(), name), LAYERS, app.save_overrides)

    def load_overrides() -> None:
        dialogs.open_file("Load overrides", folder(), LAYERS, app.load_overrides)

    def add_sun() -> None:
        assert app.document is not None
        document = app.document
        taken = {Path(item.path).name for item in document.scene.outline(document.time_code)}
        path = f"/previs_lights/sun{next(n for n in range(1, 10000) if f'sun{n}' not in taken)}"
        # From the upper left of the front; 3 makes white surfaces about white at an exposure of 0.
        direction = placing.direction(40.0, -40.0, document.description.up_axis)
        dark = not document.description.lights
        if app.edit("Add a sun", lambda scene: scene.add_distant_light(path, direction, irradiance=3.0)):
            app.select(path)
            app.view.auto_exposure = app.view.auto_exposure or dark

    def export_image() -> None:
        assert app.document is not None
        name = Path(app.document.name).stem + ".png"
        dialogs.save_file("Export the picture", os.path.join(folder(), name), PICTURES, app.export_image)

    def reload() -> None:
        assert app.document is not None
        app.document.reload()

    def discard() -> None:
        assert app.document is not None
        app.document.discard()

    def coefficients(number: int) -> Callable[[], None]:
        return lambda: set_map_values(app, number)

    def has_coefficients(number: int) -> Callable[[], bool]:
        return lambda: app.document is not None and map_values(app.document.settings) == number

    def toggle_coefficients() -> None:
        assert app.document is not None
        set_map_values(app, other_map_values(app.document.settings))

    def slices() -> None:
        app.set_setting("transmittance", "slices")

    def has_slices() -> bool:
        return app.document is not None and app.document.settings.transmittance == "slices"

    def compare(mode: str) -> Callable[[], None]:
        def run() -> None:
            app.view.compare = "off" if app.view.compare == mode else mode

        return run

    def inspect() -> None:
        app.view.inspecting = not app.view.inspecting
        if not app.view.inspecting:
            app.view.inspection = None

    def play() -> None:
        app.view.playing = not app.view.playing

    def animated() -> bool:
        return app.document is not None and app.document.animated

    def light_selected() -> bool:
        return app.document is not None and app.view.selection in app.document.description.lights

    def solo() -> None:
        app.view.solo = "" if app.view.solo == app.view.selection else app.view.selection

    def auto_exposure() -> None:
        app.view.auto_exposure = True

    def gate_mask() -> None:
        app.view.gate_mask = not app.view.gate_mask

    def measure_error() -> None:
        app.view.measuring = not app.view.measuring

    def converge() -> None:
        app.view.converging = not app.view.converging

    return {
        "open": Command("Open…", open_, "Ctrl+O", tooltip="A USD stage, or a .vdb file on a default stage"),
        "reload": Command("Reload", reload, "Ctrl+R", has_document, tooltip="Read changed files again; edits stay"),
        "save_overrides": Command(
            "Save overrides…",
            save_overrides,
            "Ctrl+S",
            has_document,
            tooltip="Write the edits as a layer over the stage",
        ),
        "load_overrides": Command(
            "Load overrides…",
            load_overrides,
            "",
            has_document,
            tooltip="Read a layer saved before; it takes the place of the present edits",
        ),
        "add_sun": Command("Add a sun", add_sun, "", has_document, tooltip="A distant light, saved with the overrides"),
        "discard": Command("Discard overrides", discard, "", modified, tooltip="Take back every edit; can be undone"),
        "export_image": Command("Export picture…", export_image, "Ctrl+E", has_document, tooltip="As PNG, JPEG or EXR"),
        "copy_camera": Command(
            "Copy view to a stage camera",
            app.copy_camera,
            "Ctrl+Shift+C",
            has_document,
            tooltip="Saved with the overrides",
        ),
        "quit": Command("Quit", lambda: leave(quit_), "Ctrl+Q"),
        "undo": Command("Undo", app.undo, "Ctrl+Z", lambda: bool(app.document and app.document.undo_label)),
        "redo": Command(
            "Redo", app.redo, "Ctrl+Shift+Z Ctrl+Y", lambda: bool(app.document and app.document.redo_label)
        ),
        "frame_selection": Command(
            "Frame selection",
            lambda: app.frame(app.view.selection),
            "F",
            has_document,
            tooltip="Or all, without a selection",
        ),
        "frame_all": Command("Frame all", app.frame, "A", has_document),
        "free_camera": Command(
            "Free camera", lambda: app.look_through(""), "", has_document, lambda: not app.view.camera_path
        ),
        "gate_mask": Command(
            "Gate mask", gate_mask, "", has_document, lambda: app.view.gate_mask, "Darken what the camera does not see"
        ),
        "toggle_coefficients": Command("6 | 14 map values", toggle_coefficients, "T", has_document),
        "slices": Command(
            "Slices along light rays", slices, "L", has_document, has_slices, "Light is marched once along every ray"
        ),
        "six": Command("6 map values", coefficients(6), "6", has_document, has_coefficients(6), "Interactive"),
        "fourteen": Command("14 map values", coefficients(14), "4", has_document, has_coefficients(14), "High quality"),
        "toggle_wipe": Command(
            "Wipe",
            compare("wipe"),
            "W",
            has_document,
            lambda: app.view.compare == "wipe",
            "Two pictures, a divider to drag",
        ),
        "toggle_error": Command(
            "Error",
            compare("error"),
            "E",
            has_document,
            lambda: app.view.compare == "error",
            "Relative difference in false colour",
        ),
        "inspect": Command(
            "Inspect transmittance",
            inspect,
            "I",
            has_document,
            lambda: app.view.inspecting,
            "Click a point to see how light reaches it",
        ),
        "play": Command("Play", play, "Space", animated, lambda: app.view.playing),
        "next_frame": Command("Next frame", lambda: app.step_time(1), "RightArrow", animated),
        "previous_frame": Command("Previous frame", lambda: app.step_time(-1), "LeftArrow", animated),
        "measure_error": Command(
            VIEW_BY_NAME["measure_error"].label,
            measure_error,
            "",
            has_document,
            lambda: app.view.measuring,
            VIEW_BY_NAME["measure_error"].doc.rstrip("."),
        ),
        "converge": Command(
            VIEW_BY_NAME["converge"].label,
            converge,
            "",
            has_document,
            lambda: app.view.converging,
            VIEW_BY_NAME["converge"].doc.rstrip("."),
        ),
        "auto_exposure": Command(
            "Auto exposure", auto_exposure, "X", has_document, tooltip="Expose for what is seen now"
        ),
        "solo": Command(
            "Solo light", solo, "S", light_selected, lambda: bool(app.view.solo), "Only this light shines; not an edit"
        ),
    }
