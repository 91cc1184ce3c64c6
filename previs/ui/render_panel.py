"""The panel "Render": the knobs of the renderer, how the picture is displayed, and what it is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui

from ..errors import PrevisError
from ..io import ColorViews, color_views
from ..render.method import METHODS, method_of
from ..settings import Settings
from . import widgets
from .app import App
from .knobs import RENDER, RENDER_BY_NAME, VIEW_BY_NAME, Knob, number
from .map_values import SWITCHED, map_values, set_map_values, with_map_values
from .state import COMPARISONS
from .theme import ACCENT, ERROR, FRAME, FRAME_HOVERED, INK, TEXT, dim, em, packed, tooltip
from .widgets import Binding

#: Always shown, above the fold; the rest of the table follows under "More" and "Performance".
MAIN = ("transmittance", "slices", "threshold", "map_size", "steps", "light_steps")
#: What trades nothing but time and memory, or ought to.
PERFORMANCE = ("march_divisor", "skip_empty", "cull_lights", "sparse", "field_memory")
_DESCRIBED = {"slices": "along light rays", 6: "map values", 14: "map values"}
_GOOD_FOR = {6: "interactive", 14: "high quality"}


def draw_render(app: App) -> None:
    """Draw the content of the window "Render"."""
    widgets.end_finished_gesture(app)
    if app.document is None:
        dim("Open a stage first.")
        return
    _draw_switch(app)
    unused = idle_knobs(app.document.settings)
    _draw_settings(app, [n for n in MAIN if n not in unused])
    if imgui.collapsing_header("More###more"):
        _draw_settings(app, [k.name for k in RENDER if k.name not in (*MAIN, *PERFORMANCE, *unused)])
    if imgui.collapsing_header("Performance###performance"):
        _draw_settings(app, PERFORMANCE)
    imgui.separator_text("Display")
    _draw_display(app)
    imgui.separator_text("At rest")
    _draw_rest(app)
    imgui.separator_text("Compare")
    _draw_compare(app)
    imgui.separator_text("Inspect")
    _draw_inspect(app)


# --- settings ---------------------------------------------------------------------------------------------------------


def idle_knobs(settings: Settings) -> frozenset[str]:
    """Names of the knobs that have no effect with the settings' transmittance, and are not shown."""
    method = method_of(settings)
    used = {
        "slices": method.curve == "slices",
        "coefficients": method.has_coefficients,
        "density_weighting": method.has_coefficients,
        "threshold": method.adaptive,
        "map_filter": method.adaptive,
        "map_size": method.has_maps,
    }
    return frozenset(name for name, is_used in used.items() if not is_used)


def _draw_settings(app: App, names: Sequence[str]) -> None:
    for name in names:
        _draw_setting(app, RENDER_BY_NAME[name])


def _draw_switch(app: App) -> None:
    """Slices | 6 | 14, large. Another number, set under "More", has a place of its own between."""
    settings = app.document.settings
    method = method_of(settings)
    now = "slices" if method.curve == "slices" else map_values(settings)
    numbers = sorted({*SWITCHED, map_values(settings)} - {0})
    imgui.separator_text(f"Light on its way: {method.values or method.name}")
    entries = ("slices", *numbers)
    width, height = imgui.get_content_region_avail().x, em(3.1)
    each = width / len(entries)
    paint, rounding = imgui.get_window_draw_list(), imgui.get_style().frame_rounding
    for i, entry in enumerate(entries):
        if i:
            imgui.same_line(0.0, 0.0)
        clicked = imgui.invisible_button(
            "switch_slices" if entry == "slices" else f"coefficients_{entry}", ImVec2(each, height)
        )
        lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        down = entry == now
        color = ACCENT if down else FRAME_HOVERED if imgui.is_item_hovered() else FRAME
        flags = imgui.ImDrawFlags_
        corners = flags.round_none
        corners |= flags.round_left if i == 0 else flags.round_none
        corners |= flags.round_right if i == len(entries) - 1 else flags.round_none
        gap = 1.0 if i < len(entries) - 1 else 0.0
        paint.add_rect_filled(lo, ImVec2(hi.x - gap, hi.y), packed(color), rounding, int(corners))
        ink = INK if down else TEXT
        _centred(str(entry).capitalize(), lo, hi, 0.34, ink, 1.35)
        _centred(_DESCRIBED.get(entry, "your own"), lo, hi, 0.76, ink, 0.82)
        tooltip(_switch_hint(settings, entry))
        if clicked and not down:
            if entry == "slices":
                _set(app, RENDER_BY_NAME["transmittance"], "slices")
            else:
                set_map_values(app, int(entry))


def _switch_hint(settings: Settings, entry: str | int) -> str:
    """What pressing an entry of the switch does."""
    if entry == "slices":
        return "Slices (key L)\nLight is marched once along every light ray, and known at even distances on it."
    name = with_map_values(settings, int(entry)).get("transmittance", settings.transmittance)
    keys = {6: " (key 6, T toggles)", 14: " (key 4, T toggles)"}.get(entry, "")
    good = f": {_GOOD_FOR[entry]}" if entry in _GOOD_FOR else ""
    lines = [f"{entry} {METHODS[name].values}{keys}{good}"]
    if not map_values(settings):
        lines.append(f"Light comes from {METHODS[settings.transmittance].name} now; this changes to maps ({name}).")
    return "\n".join((*lines, RENDER_BY_NAME["coefficients"].doc))


def _centred(text: str, lo: ImVec2, hi: ImVec2, height: float, color: Any, scale: float) -> None:
    """Text in the middle of a rectangle, at a part of its height."""
    imgui.push_font(None, imgui.get_style().font_size_base * scale)
    size = imgui.calc_text_size(text)
    at = ImVec2(0.5 * (lo.x + hi.x - size.x), lo.y + height * (hi.y - lo.y) - 0.5 * size.y)
    imgui.get_window_draw_list().add_text(at, packed(color), text)
    imgui.pop_font()


def _set(app: App, knob: Knob, value: Any) -> None:
    app.edit(f"Set {knob.label.lower()}", lambda scene: scene.set_setting(knob.name, value))


_authored: tuple[Any, dict[str, Any]] = (None, {})


def _authored_settings(app: App) -> dict[str, Any]:
    """What the stage says without the edits; read again when the document moved."""
    global _authored
    document = app.document
    key = (id(document), document.version)
    if _authored[0] != key:
        _authored = (key, document.scene.authored_settings())
    return _authored[1]


def _come_to(app: App, name: str) -> float | None:
    """What the plan of the picture has made of an automatic value; None where that differs from map to map."""
    plan = app.picture.plan
    if plan is None or not plan.maps or app.picture.level != "final" or not app.picture.current:
        return None
    if name == "map_size":
        return plan.map_size
    if name == "slices":
        return plan.map_slices or None
    found = {"threshold": {m.threshold for m in plan.maps}, "density_weighting": {m.weighting for m in plan.maps}}
    values = found.get(name, set())
    return values.pop() if len(values) == 1 else None


def _draw_setting(app: App, knob: Knob) -> None:
    document = app.document
    hint = ""
    if knob.automatic and document.settings[knob.name] == 0:
        come_to = _come_to(app, knob.name)
        hint = f"auto · {number(come_to, knob.decimals)}" if come_to is not None else ""
    binding = Binding(
        value=document.settings[knob.name],
        write=lambda value: _set(app, knob, value),
        stage=_authored_settings(app).get(knob.name, knob.default),
        reset=lambda: app.edit(f"Reset {knob.label.lower()}", lambda scene: scene.reset_settings(knob.name)),
        action=f"Set {knob.label.lower()}",
        hint=hint,
    )
    widgets.draw(app, knob, binding)


# --- display ----------------------------------------------------------------------------------------------------------


def _draw_display(app: App) -> None:
    view = app.view
    exposure = VIEW_BY_NAME["view_exposure"]

    def expose(value: float) -> None:
        view.exposure = value

    auto = em(3.4)
    binding = Binding(view.exposure, expose, undoable=False, reset=lambda: expose(exposure.default))
    widgets.draw(app, exposure, binding, auto)
    imgui.same_line(0.0, em(0.3))
    if imgui.button("Auto###auto_exposure", ImVec2(auto - em(0.3), 0.0)):
        view.auto_exposure = True
    tooltip("Auto exposure (X)\nSets the exposure once, for what is seen now.")

    def correct(value: str) -> None:
        view.color_correction = value

    widgets.draw(app, VIEW_BY_NAME["color_correction"], Binding(view.color_correction, correct, undoable=False))
    if view.color_correction == "openColorIO":
        _draw_ocio(view)


def _draw_ocio(view: Any) -> None:
    try:
        offered: ColorViews = color_views()
    except PrevisError as error:
        imgui.push_style_color(imgui.Col_.text, ImVec4(*ERROR))
        imgui.text_wrapped(str(error))
        imgui.pop_style_color()
        return
    hint = f"From the OpenColorIO config {offered.config}."
    display = view.ocio_display if view.ocio_display in offered.displays else offered.default_display
    names = tuple(offered.displays)
    width = widgets.label_row("Display", hint)
    picked = widgets.combo("ocio_display", names, names, display, width)
    if picked is not None:
        view.ocio_display = picked
        view.ocio_view = ""
    tooltip(f"{display}\n{hint}")
    views = offered.displays[display]
    shown = view.ocio_view if view.ocio_view in views else offered.default_views[display]
    width = widgets.label_row("View", hint)
    picked = widgets.combo("ocio_view", views, views, shown, width)
    if picked is not None:
        view.ocio_display, view.ocio_view = display, picked
    tooltip(f"{shown}\n{hint}")


def _draw_rest(app: App) -> None:
    view = app.view

    def measure(value: bool) -> None:
        view.measuring = value

    def converge(value: bool) -> None:
        view.converging = value

    widgets.draw(app, VIEW_BY_NAME["measure_error"], Binding(view.measuring, measure, undoable=False))
    widgets.draw(app, VIEW_BY_NAME["converge"], Binding(view.converging, converge, undoable=False))


# --- compare and inspect ----------------------------------------------------------------------------------------------


def _draw_compare(app: App) -> None:
    view = app.view
    width = widgets.label_row("Show", "Off: one picture. Wipe: two, with a divider to drag. Error: their difference.")
    picked = widgets.segments("compare", ("off", "wipe", "error"), ("Off", "Wipe", "Error"), view.compare, width)
    if picked is not None:
        view.compare = picked
    width = widgets.label_row("With", "What the picture is compared with.")
    names = tuple(COMPARISONS)
    if view.compare == "off":
        imgui.begin_disabled()
    labels = tuple(COMPARISONS[n][:1].upper() + COMPARISONS[n][1:] for n in names)
    picked = widgets.combo("compare_with", names, labels, view.compare_with, width)
    if view.compare == "off":
        imgui.end_disabled()
    if picked is not None:
        view.compare_with = picked
    if view.compare == "off":
        return
    other = app.other
    if other is not None and other.error:
        imgui.push_style_color(imgui.Col_.text, ImVec4(*ERROR))
        imgui.text_wrapped(other.error)
        imgui.pop_style_color()
    elif other is None or not other.finished:
        dim("The other picture is being drawn…")


def _draw_inspect(app: App) -> None:
    view = app.view
    on = view.inspecting
    if on:
        imgui.push_style_color(imgui.Col_.button, ImVec4(*(0.62 * c for c in ACCENT[:3]), 1.0))
    icon = icons_fontawesome.ICON_FA_EYE_DROPPER
    if imgui.button(f"{icon}  Inspect transmittance###inspect", ImVec2(-1.0, 0.0)):
        app.commands["inspect"].run()
    if on:
        imgui.pop_style_color()
    tooltip("Inspect transmittance (I)\nClick a point of the picture to see how light reaches it.")
