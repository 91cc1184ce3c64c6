"""The look of the window: neutral greys, so that no colour beside the picture changes how its colours are seen.

Sizes are in em, the height of the font, so that they follow the monitor's density.
"""

from __future__ import annotations

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot

Rgba = tuple[float, float, float, float]

#: What is selected, on, or differs from the stage.
ACCENT: Rgba = (1.0, 0.72, 0.25, 1.0)
#: An animated attribute, a frame in memory.
ANIMATED: Rgba = (0.44, 0.74, 0.47, 1.0)
WARNING: Rgba = (0.95, 0.77, 0.33, 1.0)
ERROR: Rgba = (0.95, 0.45, 0.40, 1.0)
GOOD: Rgba = (0.50, 0.78, 0.53, 1.0)
DIM: Rgba = (0.56, 0.56, 0.56, 1.0)
TEXT: Rgba = (0.87, 0.87, 0.87, 1.0)
#: Text on the accent.
INK: Rgba = (0.07, 0.07, 0.07, 1.0)
FRAME: Rgba = (0.105, 0.105, 0.105, 1.0)
FRAME_HOVERED: Rgba = (0.135, 0.135, 0.135, 1.0)
#: The filled part of a slider.
FILL: Rgba = (0.295, 0.295, 0.295, 1.0)
FILL_ACTIVE: Rgba = (0.47, 0.37, 0.19, 1.0)

#: Colours of the curves of a plot, told apart by lightness as well as hue. The first is the truth.
CURVES: tuple[Rgba, ...] = (
    (0.93, 0.93, 0.93, 1.0),
    (0.98, 0.55, 0.22, 1.0),
    (0.36, 0.70, 0.95, 1.0),
    (0.62, 0.83, 0.42, 1.0),
    (0.85, 0.48, 0.78, 1.0),
)


#: Of the default font, in pixels of a monitor of plain density.
_FONT_HEIGHT = 15.0


def em(count: float = 1.0) -> float:
    """So many times the height of the font, in pixels."""
    return hello_imgui.em_size(count)


def packed(color: Rgba, alpha: float = 1.0) -> int:
    """The colour as draw lists take it, dimmed with the style's alpha."""
    return imgui.get_color_u32(ImVec4(color[0], color[1], color[2], color[3] * alpha))


def apply_theme() -> None:
    """Set the style of ImGui, and of ImPlot where there is one; called once when the window begins."""
    imgui.style_colors_dark()
    # There is no font yet; afterwards the runner scales the style by the monitor's density.
    unit = _FONT_HEIGHT
    style = imgui.get_style()
    style.window_padding = ImVec2(0.55 * unit, 0.5 * unit)
    style.frame_padding = ImVec2(0.4 * unit, 0.2 * unit)
    style.item_spacing = ImVec2(0.4 * unit, 0.28 * unit)
    style.item_inner_spacing = ImVec2(0.35 * unit, 0.25 * unit)
    style.window_rounding = style.child_rounding = 0.15 * unit
    style.frame_rounding = style.grab_rounding = style.popup_rounding = style.tab_rounding = 0.2 * unit
    style.scrollbar_rounding = 0.4 * unit
    style.window_border_size = style.frame_border_size = 0.0
    style.popup_border_size = 1.0
    style.scrollbar_size = 0.75 * unit
    style.indent_spacing = 0.9 * unit
    style.separator_text_border_size = 1.0
    style.separator_text_padding = ImVec2(0.0, 0.25 * unit)
    names = imgui.Col_
    greys = {
        names.text: 0.87,
        names.text_disabled: 0.56,
        names.window_bg: 0.165,
        names.popup_bg: 0.13,
        names.border: 0.25,
        names.frame_bg: FRAME[0],
        names.frame_bg_hovered: FRAME_HOVERED[0],
        names.frame_bg_active: 0.15,
        names.title_bg: 0.115,
        names.title_bg_active: 0.115,
        names.title_bg_collapsed: 0.115,
        names.menu_bar_bg: 0.125,
        names.scrollbar_bg: 0.13,
        names.scrollbar_grab: 0.30,
        names.scrollbar_grab_hovered: 0.36,
        names.scrollbar_grab_active: 0.42,
        names.slider_grab: 0.46,
        names.slider_grab_active: 0.62,
        names.button: 0.25,
        names.button_hovered: 0.31,
        names.button_active: 0.37,
        names.header: 0.26,
        names.header_hovered: 0.29,
        names.header_active: 0.33,
        names.separator: 0.25,
        names.tab: 0.12,
        names.tab_hovered: 0.25,
        names.tab_selected: 0.165,
        names.tab_dimmed: 0.12,
        names.tab_dimmed_selected: 0.165,
        names.tab_dimmed_selected_overline: 0.3,
        names.resize_grip: 0.22,
        names.docking_empty_bg: 0.09,
        names.table_header_bg: 0.18,
        names.table_border_light: 0.2,
    }
    for name, value in greys.items():
        style.set_color_(name, ImVec4(value, value, value, 1.0))
    style.set_color_(names.child_bg, ImVec4(0.0, 0.0, 0.0, 0.0))
    for name in (
        names.check_mark,
        names.nav_cursor,
        names.drag_drop_target,
        names.tab_selected_overline,
        names.separator_hovered,
        names.separator_active,
        names.resize_grip_hovered,
        names.resize_grip_active,
        names.text_link,
    ):
        style.set_color_(name, ImVec4(*ACCENT))
    style.set_color_(names.text_selected_bg, ImVec4(*ACCENT[:3], 0.35))
    style.set_color_(names.docking_preview, ImVec4(*ACCENT[:3], 0.45))
    style.set_color_(names.modal_window_dim_bg, ImVec4(0.0, 0.0, 0.0, 0.5))
    if implot.get_current_context() is not None:
        plot = implot.get_style()
        implot.style_colors_dark(plot)
        plot.set_color_(implot.Col_.frame_bg, ImVec4(0.0, 0.0, 0.0, 0.0))
        plot.set_color_(implot.Col_.plot_bg, ImVec4(*FRAME))
        plot.set_color_(implot.Col_.plot_border, ImVec4(0.25, 0.25, 0.25, 1.0))
        plot.set_color_(implot.Col_.legend_bg, ImVec4(0.13, 0.13, 0.13, 0.85))
        plot.set_color_(implot.Col_.legend_border, ImVec4(0.2, 0.2, 0.2, 1.0))


def tooltip(text: str) -> None:
    """A tooltip of the last item, wrapped; its first line stands out."""
    if not imgui.is_mouse_down(0) and imgui.begin_item_tooltip():
        _show_text(text)
        imgui.end_tooltip()


def tooltip_now(text: str) -> None:
    """A tooltip beside the pointer, for places that are no items."""
    if imgui.begin_tooltip():
        _show_text(text)
        imgui.end_tooltip()


def _show_text(text: str) -> None:
    heading, _, rest = text.partition("\n")
    imgui.push_text_wrap_pos(em(24))
    imgui.text_unformatted(heading)
    if rest:
        imgui.push_style_color(imgui.Col_.text, ImVec4(0.72, 0.72, 0.72, 1.0))
        imgui.text_unformatted(rest)
        imgui.pop_style_color()
    imgui.pop_text_wrap_pos()


def dim(text: str) -> None:
    """Wrapped text of less weight."""
    imgui.push_style_color(imgui.Col_.text, ImVec4(*DIM))
    imgui.text_wrapped(text)
    imgui.pop_style_color()


def close_on_escape() -> None:
    """Close the popup that is being drawn on Escape, as ImGui does with keyboard navigation alone."""
    if imgui.is_window_focused(imgui.FocusedFlags_.child_windows) and imgui.is_key_pressed(imgui.Key.escape):
        imgui.close_current_popup()
