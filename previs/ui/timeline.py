"""The panel "Timeline": play, scrub, step, and the frames that are in memory already."""

from __future__ import annotations

import math
from typing import Any

from imgui_bundle import ImVec2, icons_fontawesome, imgui

from .app import App
from .theme import ACCENT, ANIMATED, DIM, FRAME, TEXT, dim, em, packed, tooltip

#: Distances of the labelled ticks, times powers of ten.
_STEPS = (1, 2, 5)


def tick_step(span: float, room: float) -> float:
    """The least of 1, 2, 5, 10, 20, … frames between ticks of which no more than `room` fit over a span of time."""
    if span <= 0.0 or room < 1.0:
        return max(span, 1.0)
    least = span / room
    power = 10.0 ** math.floor(math.log10(max(least, 1e-9)))
    step = next(s * power for s in (*_STEPS, 10) if s * power >= least * (1.0 - 1e-9))
    return max(step, 1.0)


def draw_timeline(app: App) -> None:
    """Draw the content of the window "Timeline"."""
    document = app.document
    if document is None:
        dim("Nothing is open.")
        return
    span = document.time_range
    if span is None:
        dim("Nothing on this stage changes over time.")
        return
    _buttons(app)
    imgui.same_line(0.0, em(0.6))
    imgui.set_next_item_width(em(4.0))
    entered, value = imgui.input_float("##time", document.time, 0.0, 0.0, "%g", _ENTER)
    if entered and math.isfinite(value):
        app.set_time(min(max(value, span.start), span.end))
    tooltip(f"Time code\nFrom {span.start:g} to {span.end:g}.")
    rate = em(5.6)
    imgui.same_line(0.0, em(0.6))
    _scrub(app, max(imgui.get_content_region_avail().x - rate - em(0.6), em(4.0)))
    imgui.same_line(0.0, em(0.6))
    imgui.set_next_item_width(em(3.6))
    entered, value = imgui.input_float("##rate", app.view.frames_per_second, 0.0, 0.0, "%g", _ENTER)
    if entered and math.isfinite(value):
        app.view.frames_per_second = min(max(value, 0.1), 240.0)
    tooltip(f"Frames a second while playing\nThe stage says {span.frames_per_second:g}.")
    imgui.same_line(0.0, em(0.3))
    imgui.text_disabled("fps")


_ENTER = int(imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all)


def _buttons(app: App) -> None:
    size = ImVec2(em(1.9), 0.0)
    play = icons_fontawesome.ICON_FA_PAUSE if app.view.playing else icons_fontawesome.ICON_FA_PLAY
    for i, (name, icon, hint) in enumerate(
        (
            ("previous_frame", icons_fontawesome.ICON_FA_STEP_BACKWARD, "Previous frame (Left)"),
            ("play", play, "Pause (Space)" if app.view.playing else "Play (Space)"),
            ("next_frame", icons_fontawesome.ICON_FA_STEP_FORWARD, "Next frame (Right)"),
        )
    ):
        if i:
            imgui.same_line(0.0, em(0.15))
        if imgui.button(f"{icon}###{name}", size):
            app.commands[name].run()
        tooltip(hint)


def _scrub(app: App, width: float) -> None:
    """The slider of time: press or drag to go there, whole frames from the first on."""
    document = app.document
    span = document.time_range
    length = max(span.end - span.start, 1e-9)
    height = max(imgui.get_frame_height(), min(imgui.get_content_region_avail().y, em(2.6)))
    imgui.invisible_button("scrub", ImVec2(width, height))
    lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    margin = em(0.5)
    left, wide = lo.x + margin, max(hi.x - lo.x - 2 * margin, 1.0)
    if imgui.is_item_active():
        u = min(max((imgui.get_mouse_pos().x - left) / wide, 0.0), 1.0)
        time = min(span.start + round(u * length), span.end)
        if time != document.time:
            app.set_time(time)
    paint = imgui.get_window_draw_list()
    paint.add_rect_filled(lo, hi, packed(FRAME), imgui.get_style().frame_rounding)

    def at(time: float) -> float:
        return left + wide * (time - span.start) / length

    frame = max(wide / max(length, 1.0), 1.0)
    for time in app.prefetched:
        x = at(time) - 0.5 * frame
        lower, upper = ImVec2(max(x, lo.x), hi.y - em(0.22)), ImVec2(min(x + frame, hi.x), hi.y - em(0.06))
        paint.add_rect_filled(lower, upper, packed(ANIMATED, 0.8))
    _ticks(paint, span, wide, lo, hi, at)
    x = at(document.time)
    paint.add_rect_filled(ImVec2(x - em(0.09), lo.y), ImVec2(x + em(0.09), hi.y), packed(ACCENT), em(0.05))
    if imgui.is_item_hovered():
        u = min(max((imgui.get_mouse_pos().x - left) / wide, 0.0), 1.0)
        imgui.set_tooltip(f"{span.start + round(u * length):g}")


def _ticks(paint: Any, span: Any, wide: float, lo: ImVec2, hi: ImVec2, at: Any) -> None:
    length = span.end - span.start
    step = tick_step(length, wide / em(3.2))
    first = math.ceil(span.start / step - 1e-9) * step
    for i in range(int((span.end - first) / step + 1e-9) + 1):
        time = first + i * step
        x = round(at(time))
        paint.add_line(ImVec2(x, lo.y), ImVec2(x, lo.y + em(0.35)), packed(DIM, 0.9))
        text = f"{time:g}"
        size = imgui.calc_text_size(text)
        place = min(max(x - 0.5 * size.x, lo.x + em(0.1)), hi.x - size.x - em(0.1))
        if hi.y - lo.y > em(1.7):
            paint.add_text(ImVec2(place, lo.y + em(0.35)), packed(TEXT, 0.6), text)
    # One small tick per frame where there is room.
    if wide / max(length, 1.0) > em(0.35):
        for i in range(int(length) + 1):
            x = round(at(span.start + i))
            paint.add_line(ImVec2(x, lo.y), ImVec2(x, lo.y + em(0.15)), packed(DIM, 0.6))
