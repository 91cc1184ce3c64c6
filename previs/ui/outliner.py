"""The panel "Outliner": what is on the stage, to find, select, hide and frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui

from ..scene import OutlineItem
from .app import App
from .theme import ACCENT, DIM, dim, em, packed, tooltip

ICONS: dict[str, str] = {
    "volume": icons_fontawesome.ICON_FA_CLOUD,
    "light": icons_fontawesome.ICON_FA_LIGHTBULB,
    "mesh": icons_fontawesome.ICON_FA_CUBE,
    "camera": icons_fontawesome.ICON_FA_VIDEO,
}
TITLES: dict[str, str] = {"volume": "Volumes", "light": "Lights", "mesh": "Meshes", "camera": "Cameras"}


@dataclass
class _State:
    """What the panel remembers between frames."""

    items: tuple[OutlineItem, ...] = ()
    filter: str = ""
    grouped_by: str | None = None
    scroll_up: bool = False
    groups: dict[str, list[OutlineItem]] = field(default_factory=dict)
    selection: str = ""


_state = _State()


def matching(items: tuple[OutlineItem, ...], text: str) -> dict[str, list[OutlineItem]]:
    """The items by kind whose path holds all words of a text, whatever their case."""
    words = text.lower().split()
    groups: dict[str, list[OutlineItem]] = {kind: [] for kind in TITLES}
    for item in items:
        path = item.path.lower()
        if all(word in path for word in words):
            groups[item.kind].append(item)
    return groups


def draw_outliner(app: App) -> None:
    """Draw the content of the window "Outliner"."""
    if app.document is None:
        dim("Nothing is open.")
        return
    items = app.document.scene.outline(app.document.time_code)
    _draw_filter()
    if _state.items is not items or _state.grouped_by != _state.filter:
        _state.scroll_up = _state.grouped_by != _state.filter
        _state.items, _state.grouped_by, _state.groups = items, _state.filter, matching(items, _state.filter)
    window = imgui.internal.get_current_window().id_
    if imgui.begin_child("prims", ImVec2(0.0, 0.0)):
        # Identifiers as if there were no child window, whose own name is made up by ImGui.
        imgui.internal.push_override_id(window)
        if _state.scroll_up:
            imgui.set_scroll_y(0.0)
            _state.scroll_up = False
        _draw_groups(app, len(items))
        imgui.pop_id()
    imgui.end_child()
    _state.selection = app.view.selection


def _draw_filter() -> None:
    clear = imgui.get_frame_height()
    imgui.set_next_item_width(-clear - em(0.2) if _state.filter else -1.0)
    hint = f"{icons_fontawesome.ICON_FA_SEARCH}  Filter"
    _, _state.filter = imgui.input_text_with_hint("##filter", hint, _state.filter)
    if _state.filter:
        imgui.same_line(0.0, em(0.2))
        if imgui.button(f"{icons_fontawesome.ICON_FA_TIMES}###clear_filter", ImVec2(clear, 0.0)):
            _state.filter = ""


def _draw_groups(app: App, count: int) -> None:
    found = 0
    for kind, items in _state.groups.items():
        found += len(items)
        if not items:
            continue
        flags = imgui.TreeNodeFlags_.span_avail_width | imgui.TreeNodeFlags_.no_tree_push_on_open
        # Many meshes would push everything else out of sight.
        imgui.set_next_item_open(kind != "mesh" or len(items) <= 12, imgui.Cond_.once)
        if any(i.path == app.view.selection for i in items) and app.view.selection != _state.selection:
            imgui.set_next_item_open(True)
        opened = imgui.tree_node_ex(f"{TITLES[kind]}###{kind}", int(flags))
        _count(str(len(items)))
        if opened:
            _draw_items(app, items)
    if count and not found:
        dim("Nothing of that name.")
    elif not count:
        dim("The stage holds no volume, light, mesh or camera.")


def _count(text: str) -> None:
    """A number at the right end of the last item."""
    hi, lo = imgui.get_item_rect_max(), imgui.get_item_rect_min()
    size = imgui.calc_text_size(text)
    at = ImVec2(hi.x - size.x - em(0.3), 0.5 * (lo.y + hi.y - size.y))
    imgui.get_window_draw_list().add_text(at, packed(DIM), text)


def _draw_items(app: App, items: list[OutlineItem]) -> None:
    selected = next((i for i, item in enumerate(items) if item.path == app.view.selection), None)
    fresh = selected is not None and app.view.selection != _state.selection
    clipper = imgui.ListClipper()
    clipper.begin(len(items))
    if fresh:
        clipper.include_item_by_index(selected)
    while clipper.step():
        for i in range(clipper.display_start, clipper.display_end):
            _draw_item(app, items[i], fresh and i == selected)


def _draw_item(app: App, item: OutlineItem, scroll_to: bool) -> None:
    imgui.push_id(item.path)
    start = imgui.get_cursor_pos_x()
    icon_width = em(1.5)
    buttons = icon_width * (2 if item.kind == "light" else 1)
    width = imgui.get_content_region_avail().x - buttons
    flags = imgui.SelectableFlags_.allow_double_click
    row = ImVec2(max(width, em(3.0)), 0.0)
    clicked, _ = imgui.selectable("##row", item.path == app.view.selection, int(flags), row)
    if scroll_to:
        imgui.set_scroll_here_y(0.5)
    tooltip(_about(item))
    if clicked:
        app.select(item.path)
        if imgui.is_mouse_double_clicked(0):
            _visit(app, item)
    imgui.same_line(start + em(0.9))
    through = item.kind == "camera" and app.view.camera_path == item.path
    dark = not item.visible
    color = ACCENT if through else (*DIM[:3], 0.55 if dark else 1.0)
    imgui.text_colored(ImVec4(*color), ICONS[item.kind])
    imgui.same_line(start + em(2.4))
    imgui.push_clip_rect(*_clip(start, row.x), True)
    if dark:
        imgui.text_disabled(item.name)
    else:
        imgui.text_unformatted(item.name)
    imgui.pop_clip_rect()
    imgui.same_line(start + width)
    if item.kind == "light":
        _solo(app, item, icon_width)
        imgui.same_line(start + width + icon_width)
    _eye(app, item, icon_width)
    imgui.pop_id()


def _clip(start: float, width: float) -> tuple[ImVec2, ImVec2]:
    corner, scroll = imgui.get_window_pos(), imgui.get_scroll_x()
    top = imgui.get_cursor_screen_pos().y
    left = corner.x + start - scroll
    return ImVec2(left, top), ImVec2(left + width, top + imgui.get_text_line_height_with_spacing())


def _about(item: OutlineItem) -> str:
    action = "Double-click to look through it." if item.kind == "camera" else "Double-click to frame it."
    shared = "" if item.editable else " Part of an instance: it cannot be changed alone."
    return f"{item.path}\n{action}{shared}"


def _visit(app: App, item: OutlineItem) -> None:
    if item.kind == "camera":
        app.look_through(item.path)
    else:
        app.frame(item.path)


def _icon_button(name: str, icon: str, color: Any, width: float) -> bool:
    clicked = imgui.invisible_button(name, ImVec2(width, imgui.get_text_line_height()))
    lo = imgui.get_item_rect_min()
    size = imgui.calc_text_size(icon)
    shown = (0.95, 0.95, 0.95, 1.0) if imgui.is_item_hovered() else color
    at = ImVec2(lo.x + 0.5 * (width - size.x), lo.y)
    imgui.get_window_draw_list().add_text(at, packed(shown), icon)
    return clicked


def _solo(app: App, item: OutlineItem, width: float) -> None:
    alone = app.view.solo == item.path
    icon = icons_fontawesome.ICON_FA_STAR
    if _icon_button("solo", icon, ACCENT if alone else (*DIM[:3], 0.35), width):
        app.view.solo = "" if alone else item.path
    tooltip("Solo: only this light shines; not an edit")


def _eye(app: App, item: OutlineItem, width: float) -> None:
    if item.kind == "camera" or not item.editable:
        imgui.dummy(ImVec2(width, 0.0))
        return
    icon = icons_fontawesome.ICON_FA_EYE if item.visible else icons_fontawesome.ICON_FA_EYE_SLASH
    if _icon_button("eye", icon, (0.75, 0.75, 0.75, 1.0) if item.visible else (*DIM[:3], 0.6), width):
        action = f"Hide {item.name}" if item.visible else f"Show {item.name}"
        app.edit(action, lambda scene: scene.set_visible(item.path, not item.visible))
    tooltip("Visible: click to hide" if item.visible else "Hidden: click to show")
