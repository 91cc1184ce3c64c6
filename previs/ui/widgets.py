"""The one family of widgets that draws every knob.

All knobs behave alike: drag to change (Shift for fine steps), double-click or Ctrl+click to type, right-click to go
back to the stage's value, copy and paste; a bar before the label marks a value that differs from the stage's. A drag
is one entry of the undo history. A knob's ImGui id is its name, so `//Look/density_scale` finds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from imgui_bundle import ImVec2, icons_fontawesome, imgui

from ..description import Color
from .app import App
from .knobs import Knob, chroma, decoded, encoded, magnitude, number, scaled
from .theme import (
    ACCENT,
    ANIMATED,
    DIM,
    FILL,
    FILL_ACTIVE,
    FRAME,
    FRAME_HOVERED,
    INK,
    TEXT,
    close_on_escape,
    em,
    packed,
    tooltip,
    tooltip_now,
)

#: Width of the labels before the controls, and of the mark before the labels, in em. In a narrow panel labels take
#: no more than a part of the width.
LABEL_WIDTH, MARK_WIDTH = 8.2, 0.55
_LABEL_PART = 0.42
_DRAG_THRESHOLD = 2.0


@dataclass(frozen=True)
class Binding:
    """What a knob is bound to.

    Attributes:
        value: the value now.
        write: authors a new one.
        stage: the stage's value without the edits; None where there is none to go back to.
        reset: goes back to it.
        undoable: whether writing makes entries of the undo history; `action` is their label.
        animated: time code at which an animated value is edited; None for a constant.
        hint: read instead of the value, such as what an automatic one has come to.
    """

    value: Any
    write: Callable[[Any], None]
    stage: Any = None
    reset: Callable[[], None] | None = None
    undoable: bool = True
    action: str = ""
    animated: float | None = None
    hint: str = ""

    @property
    def edited(self) -> bool:
        """Whether the value differs from the stage's."""
        return self.stage is not None and not same(self.value, self.stage)


def same(a: Any, b: Any) -> bool:
    """Whether two values are equal to the precision that USD stores."""
    if isinstance(a, tuple) or isinstance(b, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) or isinstance(b, float):
        return math.isclose(a, b, rel_tol=2e-6, abs_tol=1e-9)
    return a == b


@dataclass
class _Interaction:
    """What the user is in the middle of; ImGui has one pointer, so there is one of these."""

    held: str = ""
    fraction: float = 0.0
    low: float = 0.0
    high: float = 0.0
    travelled: float = 0.0
    typing: str = ""
    text: str = ""
    frames_typing: int = 0
    gesture: str = ""
    quiet: str = ""
    clipboard: str = ""
    chroma: dict[str, Color] = field(default_factory=dict)


_now = _Interaction()


def end_finished_gesture(app: App) -> None:
    """Close the undo entry of a drag that is over. Every panel calls this before its first knob."""
    if _now.gesture and not imgui.is_any_item_active():
        _now.gesture = ""
        app.end()


def forget_colors() -> None:
    """Forget the chroma of colours that were dragged to black: another prim is shown."""
    _now.chroma.clear()


def _write_held(app: App, knob: Knob, binding: Binding, value: Any) -> None:
    """Author a value while the widget is held: all of them are one undo entry."""
    if binding.undoable and _now.gesture != knob.name:
        app.begin(binding.action or f"Change {knob.label.lower()}")
        _now.gesture = knob.name
    binding.write(value)


def draw(app: App, knob: Knob, binding: Binding, reserve: float = 0.0) -> None:
    """One row: mark, label, control. `reserve` pixels at its end are left free."""
    width = max(row(knob, binding) - reserve, em(2.0))
    if knob.kind == "color":
        _color(app, knob, binding, width)
    elif knob.kind == "bool":
        _check(knob, binding)
    elif knob.kind == "choice":
        _choice(knob, binding, width)
    else:
        _slider(app, knob, binding, width)


def label_row(label: str, hint: str = "") -> float:
    """A label without a knob, in the layout of knobs; returns the width that is left for what follows."""
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + em(MARK_WIDTH))
    _label_text(label, "")
    if hint:
        tooltip(hint)
    return _to_control()


def skip_label() -> float:
    """Go to where controls begin, for what belongs to the knob above; returns the width that is left."""
    imgui.set_cursor_pos_x(_control_start())
    return max(imgui.get_content_region_avail().x, em(3.0))


def _control_start() -> float:
    """Window position at which controls begin."""
    padding = imgui.get_style().window_padding.x
    room = imgui.get_window_width() - 2.0 * padding
    return padding + min(em(MARK_WIDTH + LABEL_WIDTH), max(_LABEL_PART * room, em(4.0)))


def _to_control() -> float:
    imgui.same_line(_control_start())
    return max(imgui.get_content_region_avail().x, em(2.5))


def _label_text(label: str, icon: str) -> None:
    """A label, cut off where the control begins, with an icon behind it."""
    imgui.align_text_to_frame_padding()
    corner = imgui.get_cursor_screen_pos()
    room = _control_start() - imgui.get_cursor_pos_x() - em(0.2)
    imgui.push_clip_rect(corner, ImVec2(corner.x + room, corner.y + imgui.get_frame_height()), True)
    imgui.text_unformatted(label)
    imgui.pop_clip_rect()
    if icon:
        size = imgui.calc_text_size(label).x
        at = ImVec2(corner.x + min(size + em(0.35), room - em(0.9)), corner.y + imgui.get_style().frame_padding.y)
        imgui.get_window_draw_list().add_text(at, packed(ANIMATED), icon)


def row(knob: Knob, binding: Binding) -> float:
    """Mark and label of a knob whose control is drawn by the caller; returns the width that is left for it."""
    height = imgui.get_frame_height()
    corner = imgui.get_cursor_screen_pos()
    if binding.edited:
        lo, hi = ImVec2(corner.x, corner.y + 0.12 * height), ImVec2(corner.x + em(0.2), corner.y + 0.88 * height)
        imgui.get_window_draw_list().add_rect_filled(lo, hi, packed(ACCENT), em(0.1))
        area = ImVec2(corner.x - em(0.1), corner.y), ImVec2(corner.x + em(MARK_WIDTH), corner.y + height)
        if imgui.is_window_hovered() and imgui.is_mouse_hovering_rect(*area):
            stage = knob.format(binding.stage)
            tooltip_now(f"Changed\nThe stage says {stage}. Right-click the knob to go back to it.")
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + em(MARK_WIDTH))
    _label_text(knob.label, icons_fontawesome.ICON_FA_KEY if binding.animated is not None else "")
    tooltip(_explanation(knob, binding))
    _menu(knob, binding, f"{knob.name}_label_menu")
    return _to_control()


def _explanation(knob: Knob, binding: Binding) -> str:
    text = knob.tooltip()
    if binding.edited:
        text += f"\nThe stage's value: {knob.format(binding.stage)}."
    if binding.animated is not None:
        text += f"\nAnimated on the stage: a change is made at time {binding.animated:g} alone."
    return text


def _explain(knob: Knob, binding: Binding) -> None:
    """The tooltip of a slider, which keeps out of the way after a drag until the pointer comes back."""
    if _now.quiet == knob.name:
        if not imgui.is_item_hovered() and not imgui.is_item_active():
            _now.quiet = ""
    else:
        tooltip(_explanation(knob, binding))


def _menu(knob: Knob, binding: Binding, popup: str) -> None:
    """The menu of a right click on the last item."""
    if not imgui.begin_popup_context_item(popup):
        return
    close_on_escape()
    if binding.reset is not None and binding.stage is not None:
        label = f"Reset to the stage's value ({knob.format(binding.stage)})###reset"
        if imgui.menu_item(label, "", False, binding.edited)[0]:
            binding.reset()
    elif binding.reset is not None:
        changed = not same(binding.value, knob.default)
        if imgui.menu_item(f"Reset to {knob.format(knob.default)}###reset", "", False, changed)[0]:
            binding.reset()
    if knob.automatic and imgui.menu_item("Automatic###automatic", "", binding.value == 0, binding.value != 0)[0]:
        binding.write(knob.parse("auto"))
    if imgui.menu_item("Copy###copy", "", False)[0]:
        imgui.set_clipboard_text(_as_text(knob, binding.value))
    if knob.kind in ("float", "int", "color"):
        if imgui.is_window_appearing():
            # Asking in every frame is slow, and GLFW complains each time when there is no text.
            _now.clipboard = imgui.get_clipboard_text() or ""
        pasted = knob.parse(_now.clipboard)
        label = f"Paste {knob.format(pasted)}###paste" if pasted is not None else "Paste###paste"
        if imgui.menu_item(label, "", False, pasted is not None)[0]:
            binding.write(pasted)
        if imgui.menu_item("Type a value###type", "", False)[0]:
            _start_typing(knob, binding.value)
    imgui.end_popup()


def _as_text(knob: Knob, value: Any) -> str:
    """The value in full, to copy or to type over."""
    if knob.kind == "color":
        return ", ".join(f"{c:.7g}" for c in value)
    return f"{value:.7g}" if knob.kind == "float" else str(value)


# --- numbers ----------------------------------------------------------------------------------------------------------


def _slider(app: App, knob: Knob, binding: Binding, width: float) -> None:
    """A number: the frame fills with the value."""
    if _typing(knob, binding, width):
        return
    moved = _drag_area(knob, float(binding.value), width)
    if moved is not None:
        value = round(moved) if knob.kind == "int" else moved
        value = knob.clamped(0 if knob.automatic and _now.fraction < 0.0 else value)
        if not same(value, binding.value):
            _write_held(app, knob, binding, value)
    _maybe_type(knob, binding.value)
    texts = (binding.hint or knob.format(binding.value), knob.format(binding.value, unit=False))
    _paint_slider(knob, float(binding.value), texts, width)
    _explain(knob, binding)
    _menu(knob, binding, f"{knob.name}_menu")


def _drag_area(knob: Knob, value: float, width: float) -> float | None:
    """The item that is dragged; the value under the pointer while it is, None while nothing moves.

    The drag is relative: a click alone changes nothing, so a double click may follow.
    """
    pressed = imgui.invisible_button(knob.name, ImVec2(width, imgui.get_frame_height()))
    if imgui.is_item_hovered():
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    if imgui.is_item_activated():
        # What was typed outside of the comfortable range stretches it.
        low, high = min(knob.low, value) if value or knob.low <= 0.0 else knob.low, max(knob.high, value)
        _now.held, _now.low, _now.high, _now.travelled = knob.name, low, high, 0.0
        _now.fraction = 0.0 if knob.automatic and value == 0.0 else knob.fraction(value, low, high)
    if _now.held != knob.name:
        return None
    if not imgui.is_item_active():
        _now.held = ""
        if pressed and not imgui.is_mouse_released(0):
            # Pressed by the keyboard.
            _start_typing(knob, value)
        return None
    io = imgui.get_io()
    step = io.mouse_delta.x
    _now.travelled += abs(step)
    if step == 0.0 or _now.travelled < _DRAG_THRESHOLD:
        return None
    _now.quiet = knob.name
    _now.fraction += step / max(width, 1.0) * (0.1 if io.key_shift else 1.0)
    # A little beyond the end, so that the way back does not start at once, and an automatic value has a place.
    _now.fraction = min(max(_now.fraction, -0.05 if knob.automatic else 0.0), 1.0)
    inside = min(max(_now.fraction, 0.0), 1.0)
    return _rounded(knob, knob.at(inside, _now.low, _now.high), io.key_shift)


def _rounded(knob: Knob, value: float, fine: bool) -> float:
    """A value as one would type it: no more digits than a pixel of the slider is worth."""
    if value == 0.0:
        return 0.0
    if knob.response == "log":
        quantum = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    else:
        quantum = 10.0 ** math.floor(math.log10((_now.high - _now.low) / 200.0))
    quantum *= 0.1 if fine else 1.0
    return round(value / quantum) * quantum if quantum > 0.0 else value


def _paint_slider(knob: Knob, value: float, texts: tuple[str, ...], width: float) -> None:
    """Frame, fill and the longest text that fits, over the last item's rectangle."""
    fill = FILL_ACTIVE if imgui.is_item_active() and _now.held == knob.name else FILL
    lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    paint = imgui.get_window_draw_list()
    rounding = imgui.get_style().frame_rounding
    held = _now.held == knob.name
    low, high = (_now.low, _now.high) if held else (min(knob.low, value), max(knob.high, value))
    if not held and knob.low > 0.0 and value <= 0.0:
        low = knob.low
    paint.add_rect_filled(lo, hi, packed(FRAME_HOVERED if imgui.is_item_hovered() else FRAME), rounding)
    automatic = knob.automatic and value == 0.0
    if not automatic:
        at = min(max(knob.fraction(value, low, high), 0.0), 1.0)
        zero = min(max(knob.fraction(0.0, low, high), 0.0), 1.0) if low < 0.0 < high else 0.0
        a, b = lo.x + width * min(at, zero), lo.x + width * max(at, zero)
        if b - a > 1.0:
            paint.add_rect_filled(ImVec2(a, lo.y), ImVec2(b, hi.y), packed(fill), rounding)
        if low < 0.0:
            x = round(lo.x + width * zero)
            paint.add_line(ImVec2(x, lo.y), ImVec2(x, hi.y), packed(DIM, 0.6))
    padding = imgui.get_style().frame_padding
    text = next((t for t in texts if imgui.calc_text_size(t).x <= hi.x - lo.x - 1.5 * padding.x), texts[-1])
    size = imgui.calc_text_size(text)
    color = DIM if automatic else TEXT
    paint.push_clip_rect(lo, hi, True)
    paint.add_text(ImVec2(hi.x - size.x - padding.x, lo.y + padding.y), packed(color), text)
    paint.pop_clip_rect()


# --- typing -----------------------------------------------------------------------------------------------------------


def _start_typing(knob: Knob, value: Any) -> None:
    _now.typing, _now.frames_typing, _now.held = knob.name, 0, ""
    _now.text = "auto" if knob.automatic and value == 0 else _as_text(knob, value)


def _maybe_type(knob: Knob, value: Any) -> None:
    """Start typing on a double click or a Ctrl+click of the last item."""
    if not imgui.is_item_hovered():
        return
    if imgui.is_mouse_double_clicked(0) or (imgui.is_mouse_clicked(0) and imgui.get_io().key_ctrl):
        _start_typing(knob, value)


def _typing(knob: Knob, binding: Binding, width: float) -> bool:
    """The text field that stands in for the control while a value is typed; whether there is one."""
    if _now.typing != knob.name:
        return False
    imgui.set_next_item_width(width)
    if _now.frames_typing == 0:
        imgui.set_keyboard_focus_here()
    _now.frames_typing += 1
    flags = imgui.InputTextFlags_.auto_select_all
    _, _now.text = imgui.input_text(f"##{knob.name}_typed", _now.text, flags)
    if imgui.is_item_deactivated() or (_now.frames_typing > 3 and not imgui.is_item_active()):
        _now.typing = ""
        value = None if imgui.is_key_pressed(imgui.Key.escape) else knob.parse(_now.text)
        if value is not None and not same(value, binding.value):
            binding.write(value)
    return True


# --- the other kinds --------------------------------------------------------------------------------------------------


def _check(knob: Knob, binding: Binding) -> None:
    size = imgui.get_frame_height()
    if imgui.invisible_button(knob.name, ImVec2(size, size)):
        binding.write(not binding.value)
    lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    paint = imgui.get_window_draw_list()
    hovered = imgui.is_item_hovered()
    paint.add_rect_filled(lo, hi, packed(FRAME_HOVERED if hovered else FRAME), imgui.get_style().frame_rounding)
    if binding.value:
        pad = round(size * 0.26)
        paint.add_rect_filled(ImVec2(lo.x + pad, lo.y + pad), ImVec2(hi.x - pad, hi.y - pad), packed(ACCENT), em(0.1))
    tooltip(_explanation(knob, binding))
    _menu(knob, binding, f"{knob.name}_menu")


def _choice(knob: Knob, binding: Binding, width: float) -> None:
    picked = combo(knob.name, knob.choices, knob.choice_labels or knob.choices, binding.value, width)
    tooltip(_explanation(knob, binding))
    _menu(knob, binding, f"{knob.name}_menu")
    if picked is not None and picked != binding.value:
        binding.write(picked)


def combo(name: str, values: Any, labels: Any, value: Any, width: float) -> Any | None:
    """A drop-down list whose ImGui id is `name`; the value that was picked just now, or None.

    The entries of its popup have the ids `###<value>`. The last item is the closed list.
    """
    popup = f"{name}_choices"
    height = imgui.get_frame_height()
    clicked = imgui.invisible_button(name, ImVec2(width, height))
    lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    paint, padding = imgui.get_window_draw_list(), imgui.get_style().frame_padding
    hovered = imgui.is_item_hovered()
    paint.add_rect_filled(lo, hi, packed(FRAME_HOVERED if hovered else FRAME), imgui.get_style().frame_rounding)
    shown = dict(zip(values, labels, strict=True)).get(value, str(value))
    paint.push_clip_rect(lo, ImVec2(hi.x - height, hi.y), True)
    paint.add_text(ImVec2(lo.x + padding.x, lo.y + padding.y), packed(TEXT), shown)
    paint.pop_clip_rect()
    arrow = icons_fontawesome.ICON_FA_CARET_DOWN
    paint.add_text(ImVec2(hi.x - em(1.0), lo.y + padding.y), packed(TEXT if hovered else DIM), arrow)
    if clicked:
        imgui.open_popup(popup)
    picked = None
    if imgui.is_popup_open(popup):
        imgui.set_next_window_pos(ImVec2(lo.x, hi.y + 1.0))
        imgui.set_next_window_size_constraints(ImVec2(width, 0.0), ImVec2(em(40), em(22)))
        if imgui.begin_popup(popup):
            close_on_escape()
            for entry, label in zip(values, labels, strict=True):
                if imgui.selectable(f"{label}###{entry}", entry == value)[0]:
                    picked = entry
                if entry == value and imgui.is_window_appearing():
                    imgui.set_item_default_focus()
            imgui.end_popup()
    return picked


def segments(name: str, values: Any, labels: Any, value: Any, width: float, height: float = 0.0) -> Any | None:
    """Buttons side by side of which one is down; the value that was clicked just now, or None.

    Their ids are `<name>_<value>`.
    """
    paint, rounding = imgui.get_window_draw_list(), imgui.get_style().frame_rounding
    height = height or imgui.get_frame_height()
    each = width / len(values)
    picked = None
    for i, (entry, label) in enumerate(zip(values, labels, strict=True)):
        if i:
            imgui.same_line(0.0, 0.0)
        if imgui.invisible_button(f"{name}_{entry}", ImVec2(each, height)):
            picked = entry
        lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        down = entry == value
        color = ACCENT if down else FRAME_HOVERED if imgui.is_item_hovered() else FRAME
        sides = imgui.ImDrawFlags_
        corners = sides.round_none
        if i == 0:
            corners |= sides.round_left
        if i == len(values) - 1:
            corners |= sides.round_right
        paint.add_rect_filled(lo, ImVec2(hi.x - (i < len(values) - 1), hi.y), packed(color), rounding, int(corners))
        size = imgui.calc_text_size(label)
        at = ImVec2(0.5 * (lo.x + hi.x - size.x), 0.5 * (lo.y + hi.y - size.y))
        paint.add_text(at, packed(INK if down else TEXT), label)
    return picked


# --- colours ----------------------------------------------------------------------------------------------------------


def _color(app: App, knob: Knob, binding: Binding, width: float) -> None:
    """A colour: a swatch of its chroma that opens a picker, and a slider of its largest channel, which may exceed 1."""
    color: Color = binding.value
    shown = chroma(color, _now.chroma.get(knob.name, (1.0, 1.0, 1.0)))
    side = imgui.get_frame_height()
    popup = f"{knob.name}_picker"
    if imgui.invisible_button(f"{knob.name}_swatch", ImVec2(1.4 * side, side)):
        imgui.open_popup(popup)
    paint_swatch(shown if knob.maximum is None else color)
    tooltip(f"{knob.label}: {knob.format(color)}\nClick to pick the colour. The slider is its strength.")
    _menu(knob, binding, f"{knob.name}_swatch_menu")
    if imgui.begin_popup(popup):
        close_on_escape()
        _picker(app, knob, binding, shown)
        imgui.end_popup()

    spacing = em(0.3)
    imgui.same_line(0.0, spacing)
    rest = max(width - 1.4 * side - spacing, em(2.0))
    if _typing(knob, binding, rest):
        return
    moved = _drag_area(knob, magnitude(color), rest)
    if moved is not None:
        _write_color(app, knob, binding, scaled(color, moved, shown))
    _maybe_type(knob, color)
    short = ", ".join(f"{c:.2g}" for c in color)
    texts = (knob.format(color), knob.format(color, unit=False), short, number(magnitude(color), 2))
    _paint_slider(knob, magnitude(color), texts, rest)
    _explain(knob, binding)
    _menu(knob, binding, f"{knob.name}_menu")


def _write_color(app: App, knob: Knob, binding: Binding, color: Color) -> None:
    if magnitude(binding.value) > 0.0:
        _now.chroma[knob.name] = chroma(binding.value)
    color = knob.clamped(color)
    if not same(color, binding.value):
        _write_held(app, knob, binding, color)


def paint_swatch(color: Color) -> None:
    """Linear RGB over the last item's rectangle, as a monitor shows it."""
    lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    paint, rounding = imgui.get_window_draw_list(), imgui.get_style().frame_rounding
    paint.add_rect_filled(lo, hi, packed((*encoded(color), 1.0)), rounding)
    paint.add_rect(lo, hi, packed(TEXT if imgui.is_item_hovered() else DIM, 0.6), rounding)


def _picker(app: App, knob: Knob, binding: Binding, shown: Color) -> None:
    """The popup of a swatch: the chroma by wheel, the channels as numbers."""
    flags = imgui.ColorEditFlags_
    options = flags.picker_hue_wheel | flags.no_inputs | flags.no_side_preview | flags.no_alpha | flags.no_label
    imgui.text_unformatted(f"{knob.label}{f' ({knob.unit})' if knob.unit else ''}, linear RGB")
    color: Color = binding.value
    # The picker's colours are a monitor's. Unbounded colours keep their strength while the chroma is picked.
    start = encoded(shown if knob.maximum is None else color)
    imgui.set_next_item_width(em(13))
    changed, picked = imgui.color_picker3(f"##{knob.name}_wheel", list(start), int(options))
    if changed:
        target = decoded(tuple(picked))
        if knob.maximum is None:
            target = scaled(target, magnitude(color) if magnitude(color) > 0.0 else 1.0)
        _write_color(app, knob, binding, target)
    imgui.push_item_width(em(13))
    logarithmic = imgui.SliderFlags_.logarithmic if knob.response == "log" else imgui.SliderFlags_.none
    top = max(knob.high, magnitude(color))
    for i, name in enumerate("RGB"):
        flag = int(logarithmic | imgui.SliderFlags_.no_round_to_format)
        moved, value = imgui.slider_float(name, color[i], knob.low, top, "%.4g", flag)
        if moved:
            _write_color(app, knob, binding, tuple(value if k == i else c for k, c in enumerate(color)))
    imgui.pop_item_width()
    if knob.maximum is None:
        imgui.text_disabled("Values above 1 are fine: the slider in the row is the strength.")
