"""The look of the window: neutral greys, so that no colour beside the picture changes how its colours are seen."""

from __future__ import annotations

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui

#: The one colour with a meaning of its own: what is selected, on, or differs from the stage.
ACCENT = (1.0, 0.72, 0.25, 1.0)


def apply_theme() -> None:
    """Set ImGui's style; called once when the window begins."""
    imgui.style_colors_dark()
    style = imgui.get_style()
    em = hello_imgui.em_size()
    style.window_padding = ImVec2(0.5 * em, 0.4 * em)
    style.frame_padding = ImVec2(0.35 * em, 0.18 * em)
    style.item_spacing = ImVec2(0.45 * em, 0.32 * em)
    style.item_inner_spacing = ImVec2(0.35 * em, 0.25 * em)
    style.window_rounding = style.frame_rounding = style.grab_rounding = 0.15 * em
    style.popup_rounding = style.tab_rounding = style.scrollbar_rounding = 0.15 * em
    style.window_border_size = 0.0
    style.frame_border_size = 0.0
    style.scrollbar_size = 0.75 * em
    names = imgui.Col_

    def grey(value: float, alpha: float = 1.0) -> ImVec4:
        return ImVec4(value, value, value, alpha)

    greys = {
        names.text: 0.86,
        names.text_disabled: 0.52,
        names.window_bg: 0.145,
        names.child_bg: 0.145,
        names.popup_bg: 0.115,
        names.border: 0.24,
        names.frame_bg: 0.21,
        names.frame_bg_hovered: 0.27,
        names.frame_bg_active: 0.31,
        names.title_bg: 0.10,
        names.title_bg_active: 0.10,
        names.title_bg_collapsed: 0.10,
        names.menu_bar_bg: 0.125,
        names.scrollbar_bg: 0.12,
        names.scrollbar_grab: 0.30,
        names.scrollbar_grab_hovered: 0.36,
        names.scrollbar_grab_active: 0.42,
        names.slider_grab: 0.52,
        names.slider_grab_active: 0.68,
        names.button: 0.26,
        names.button_hovered: 0.33,
        names.button_active: 0.40,
        names.header: 0.27,
        names.header_hovered: 0.31,
        names.header_active: 0.35,
        names.separator: 0.22,
        names.tab: 0.12,
        names.tab_hovered: 0.25,
        names.tab_selected: 0.19,
        names.tab_dimmed: 0.12,
        names.tab_dimmed_selected: 0.17,
        names.resize_grip: 0.22,
        names.docking_empty_bg: 0.09,
        names.table_header_bg: 0.18,
        names.table_border_light: 0.2,
    }
    for name, value in greys.items():
        style.set_color_(name, grey(value))
    for name in (names.check_mark, names.nav_cursor, names.drag_drop_target, names.tab_selected_overline):
        style.set_color_(name, ImVec4(*ACCENT))
    style.set_color_(names.text_selected_bg, ImVec4(*ACCENT[:3], 0.35))
    style.set_color_(names.modal_window_dim_bg, ImVec4(0.0, 0.0, 0.0, 0.5))
