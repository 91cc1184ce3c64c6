"""The panel "Render": the knobs of the renderer, how the picture is displayed, and what it is compared with."""

from __future__ import annotations

from typing import Any

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui

from ..errors import PrevisError
from ..io import ColorViews, color_views
from ..render.method import method_of
from . import widgets
from .app import App
from .knobs import RENDER, RENDER_BY_NAME, VIEW_BY_NAME, Knob, number
from .state import COMPARISONS
from .theme import ACCENT, ERROR, FRAME, FRAME_HOVERED, INK, TEXT, dim, em, packed, tooltip
from .widgets import Binding

#: Always shown, above the fold; the rest of the table follows under "More".
MAIN = ("transmittance", "threshold", "map_size", "steps", "light_steps")
_SWITCHED = "coefficients"


def draw_render(app: App) -> None:
    """Draw the content of the window "Render"."""
    widgets.end_finished_gesture(app)
    if app.document is None:
        dim("Open a stage first.")
        return
    _draw_switch(app)
    for name in MAIN:
        _draw_setting(app, RENDER_BY_NAME[name])
    if imgui.collapsing_header("More###more"):
        for knob in RENDER:
            if knob.name not in MAIN:
                _draw_setting(app, knob)
    imgui.separator_text("Display")
    _draw_display(app)
    imgui.separator_text("At rest")
    _draw_rest(app)
    imgui.separator_text("Compare")
    _draw_compare(app)
    imgui.separator_text("Inspect")
    _draw_inspect(app)


# --- settings ---------------------------------------------------------------------------------------------------------


def _draw_switch(app: App) -> None:
    """6 | 14, large. Another number, set under "More", has a place of its own between."""
    now = app.document.settings.coefficients
    method = method_of(app.document.settings)
    plain = not method.has_maps
    values = [6, 14] if now in (6, 14) else sorted([6, now, 14])
    described = {6: "interactive", 14: "high quality"}
    imgui.separator_text(f"Map values: {method.values}" if not plain else "Map values, not needed by the march")
    width, height = imgui.get_content_region_avail().x, em(3.1)
    each = width / len(values)
    paint, rounding = imgui.get_window_draw_list(), imgui.get_style().frame_rounding
    for i, value in enumerate(values):
        if i:
            imgui.same_line(0.0, 0.0)
        clicked = imgui.invisible_button(f"coefficients_{value}", ImVec2(each, height))
        lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        down = value == now
        color = ACCENT if down else FRAME_HOVERED if imgui.is_item_hovered() else FRAME
        flags = imgui.ImDrawFlags_
        corners = flags.round_none
        corners |= flags.round_left if i == 0 else flags.round_none
        corners |= flags.round_right if i == len(values) - 1 else flags.round_none
        gap = 1.0 if i < len(values) - 1 else 0.0
        shade = packed(color, 0.45 if plain else 1.0)
        paint.add_rect_filled(lo, ImVec2(hi.x - gap, hi.y), shade, rounding, int(corners))
        ink = INK if down else TEXT
        _centred(str(value), lo, hi, 0.34, ink, 1.35)
        _centred(described.get(value, "your own"), lo, hi, 0.76, ink, 0.82)
        if value in (6, 14):
            keys = "6" if value == 6 else "4"
            tooltip(f"{value} {method.values or 'map values'} (key {keys}, T toggles)\n{RENDER_BY_NAME[_SWITCHED].doc}")
        if clicked and value != now:
            _set(app, RENDER_BY_NAME[_SWITCHED], value)


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
