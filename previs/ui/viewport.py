"""The picture in its panel: the mouse moves the camera, picks, wipes and inspects; marks are drawn over it."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, icons_fontawesome_4, imgui

from ..description import Camera
from ..render.display import Compare, error_colormap, error_scale
from ..render.method import method_of
from .app import App
from .picking import project

#: A press that moves less than this, in em, is a click.
CLICK_EM = 0.3

_WHITE = (1.0, 1.0, 1.0, 0.9)
_SHADE = (0.0, 0.0, 0.0, 0.55)
_ACCENT = (1.0, 0.72, 0.25, 1.0)
_ERROR = (0.85, 0.25, 0.2, 0.92)


def draw_viewport(app: App) -> None:
    """Draw the panel's content; call it inside the window "View"."""
    size = imgui.get_content_region_avail()
    if size.x < 8 or size.y < 8:
        return
    scale = imgui.get_io().display_framebuffer_scale
    pixels = (max(int(size.x * scale.x), 1), max(int(size.y * scale.y), 1))
    if pixels != app.size:
        app.size = pixels
        # The window may be about to rest; until its next frame the picture would be stretched.
        hello_imgui.get_runner_params().fps_idling.enable_idling = False
    corner = imgui.get_cursor_screen_pos()
    canvas = _Canvas(corner, size)
    if app.shown is not None:
        imgui.image(imgui.ImTextureRef(app.shown.glo), size, (0, 1), (1, 0))
    lines = 0
    if app.document is None:
        _draw_welcome(app, canvas)
    else:
        camera = app.camera()
        if camera is not None:
            _draw_gate(app, canvas)
            _draw_lights(app, canvas, camera)
            _draw_selection(app, canvas, camera)
            _draw_inspected(app, canvas, camera)
        if app.view.compare != "off" and app.other is not None:
            _draw_compare(app, canvas)
        _take_mouse(app, canvas)
        lines = _draw_state(app, canvas)
    _draw_loading(app, canvas)
    _draw_messages(app, canvas, lines)


class _Canvas:
    """The rectangle of the picture on the screen."""

    def __init__(self, corner: ImVec2, size: ImVec2) -> None:
        self.x, self.y, self.width, self.height = corner.x, corner.y, size.x, size.y
        self.draw = imgui.get_window_draw_list()

    def at(self, u: float, v: float) -> ImVec2:
        """Screen position of parts of width and height from the upper left corner."""
        return ImVec2(self.x + u * self.width, self.y + v * self.height)

    @property
    def mouse(self) -> tuple[float, float]:
        """The mouse in parts of width and height."""
        position = imgui.get_mouse_pos()
        return (position.x - self.x) / self.width, (position.y - self.y) / self.height

    def text(self, u: float, v: float, text: str, color=_WHITE, offset: tuple[float, float] = (0.0, 0.0)) -> None:
        """Text with a shadow, its upper left corner there."""
        position = self.at(u, v)
        x, y = position.x + offset[0], position.y + offset[1]
        self.draw.add_text(ImVec2(x + 1, y + 1), _color((0, 0, 0, 0.8)), text)
        self.draw.add_text(ImVec2(x, y), _color(color), text)


def _color(color) -> int:
    return imgui.get_color_u32(imgui.ImVec4(*color))


# --- the mouse ----------------------------------------------------------------------------------------------------


def _take_mouse(app: App, canvas: _Canvas) -> None:
    """Left drag orbits, middle pans, right dollies, with or without Alt; the wheel dollies; a click picks."""
    imgui.set_cursor_screen_pos(ImVec2(canvas.x, canvas.y))
    imgui.set_next_item_allow_overlap()
    buttons = imgui.ButtonFlags_
    imgui.invisible_button(
        "picture",
        ImVec2(canvas.width, canvas.height),
        buttons.mouse_button_left | buttons.mouse_button_right | buttons.mouse_button_middle,
    )
    io = imgui.get_io()
    if imgui.is_item_hovered() and io.mouse_wheel:
        app.move_camera(lambda orbit: orbit.wheel(io.mouse_wheel))
    threshold = CLICK_EM * hello_imgui.em_size()
    if imgui.is_item_active():
        dx, dy = io.mouse_delta.x / canvas.height, -io.mouse_delta.y / canvas.height
        if dx or dy:
            aspect = app.size[0] / app.size[1]
            if imgui.is_mouse_dragging(imgui.MouseButton_.left, threshold):
                app.move_camera(lambda orbit: orbit.orbit(dx, dy))
            elif imgui.is_mouse_dragging(imgui.MouseButton_.middle, 0.0):
                app.move_camera(lambda orbit: orbit.pan(dx, dy, aspect))
            elif imgui.is_mouse_dragging(imgui.MouseButton_.right, 0.0):
                app.move_camera(lambda orbit: orbit.dolly(dx + dy))
    if imgui.is_item_deactivated() and imgui.is_mouse_released(imgui.MouseButton_.left):
        drag = io.mouse_drag_max_distance_sqr[0] if hasattr(io, "mouse_drag_max_distance_sqr") else 0.0
        if drag < threshold * threshold and not io.key_alt:
            app.click(*canvas.mouse)
    if app.view.compare == "wipe" and app.other is not None:
        _take_divider(app, canvas)


def _take_divider(app: App, canvas: _Canvas) -> None:
    width = 0.8 * hello_imgui.em_size()
    x = canvas.x + app.view.divider * canvas.width
    imgui.set_cursor_screen_pos(ImVec2(x - 0.5 * width, canvas.y))
    imgui.invisible_button("divider", ImVec2(width, canvas.height))
    if imgui.is_item_hovered() or imgui.is_item_active():
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    if imgui.is_item_active():
        app.view.divider = min(max(canvas.mouse[0], 0.0), 1.0)


# --- marks over the picture ---------------------------------------------------------------------------------------


def _draw_gate(app: App, canvas: _Canvas) -> None:
    left, top, right, bottom = app.gate
    if not app.view.gate_mask or (left, top, right, bottom) == (0.0, 0.0, 1.0, 1.0):
        return
    shade = _color(_SHADE)
    for a, b in (
        ((0.0, 0.0), (1.0, top)),
        ((0.0, bottom), (1.0, 1.0)),
        ((0.0, top), (left, bottom)),
        ((right, top), (1.0, bottom)),
    ):
        if b[0] > a[0] and b[1] > a[1]:
            canvas.draw.add_rect_filled(canvas.at(*a), canvas.at(*b), shade)


def _draw_lights(app: App, canvas: _Canvas, camera: Camera) -> None:
    """A mark where a light has a place, so that it can be clicked."""
    assert app.document is not None
    placed = [x for x in app.document.description.lights.values() if x.kind not in ("distant", "dome")]
    if not placed:
        return
    u, v, depth = project(camera, canvas.width / canvas.height, np.array([x.position for x in placed]))
    radius = 0.32 * hello_imgui.em_size()
    for light, x, y, z in zip(placed, u, v, depth, strict=True):
        if not (z > 0.0 and 0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
            continue
        selected = light.path == app.view.selection
        canvas.draw.add_circle(canvas.at(x, y), radius + 1.0, _color((0, 0, 0, 0.7)), 0, 2.5)
        canvas.draw.add_circle(canvas.at(x, y), radius, _color(_ACCENT if selected else _WHITE), 0, 1.5)
        canvas.draw.add_circle_filled(canvas.at(x, y), 0.35 * radius, _color(_ACCENT if selected else _WHITE))


def _draw_selection(app: App, canvas: _Canvas, camera: Camera) -> None:
    """The box of the selected volume or mesh."""
    assert app.document is not None
    path = app.view.selection
    description = app.document.description
    if not path or path in description.lights or path in description.cameras:
        return
    bounds = description.bounds_of(path)
    if bounds is None:
        return
    corners = np.array([[bounds[(i >> a) & 1][a] for a in range(3)] for i in range(8)])
    u, v, depth = project(camera, canvas.width / canvas.height, corners)
    canvas.draw.push_clip_rect(canvas.at(0, 0), canvas.at(1, 1), True)
    color = _color((*_ACCENT[:3], 0.45))
    for i in range(8):
        for axis in range(3):
            j = i | (1 << axis)
            if j != i and depth[i] > 0.0 and depth[j] > 0.0:
                canvas.draw.add_line(canvas.at(u[i], v[i]), canvas.at(u[j], v[j]), color, 1.0)
    canvas.draw.pop_clip_rect()


def _draw_inspected(app: App, canvas: _Canvas, camera: Camera) -> None:
    inspection = app.view.inspection
    if inspection is None:
        return
    u, v, depth = project(camera, canvas.width / canvas.height, np.array([inspection.point]))
    if depth[0] <= 0.0:
        return
    centre, arm = canvas.at(u[0], v[0]), 0.6 * hello_imgui.em_size()
    for color, width in (((0, 0, 0, 0.8), 3.0), (_ACCENT, 1.5)):
        canvas.draw.add_line(ImVec2(centre.x - arm, centre.y), ImVec2(centre.x + arm, centre.y), _color(color), width)
        canvas.draw.add_line(ImVec2(centre.x, centre.y - arm), ImVec2(centre.x, centre.y + arm), _color(color), width)


def _draw_compare(app: App, canvas: _Canvas) -> None:
    em = hello_imgui.em_size()
    here, there = (
        name if picture.finished else f"{name} ({picture.level})"
        for name, picture in zip(comparison_names(app), (app.picture, app.other), strict=True)
    )
    if app.view.compare == "wipe":
        x = app.view.divider
        canvas.draw.add_line(canvas.at(x, 0.0), canvas.at(x, 1.0), _color((0, 0, 0, 0.6)), 3.0)
        canvas.draw.add_line(canvas.at(x, 0.0), canvas.at(x, 1.0), _color(_WHITE), 1.0)
        canvas.draw.add_circle_filled(canvas.at(x, 0.5), 0.4 * em, _color(_WHITE))
        # Below, since the camera's name is above.
        widths = [imgui.calc_text_size(name).x + 0.6 * em for name in (here, there)]
        if widths[0] < x * canvas.width:
            canvas.text(x, 1.0, here, offset=(-widths[0], -1.6 * em))
        if widths[1] < (1.0 - x) * canvas.width:
            canvas.text(x, 1.0, there, offset=(0.6 * em, -1.6 * em))
    else:
        _draw_error_scale(canvas, f"{here} against {there}")


def _draw_error_scale(canvas: _Canvas, title: str) -> None:
    em = hello_imgui.em_size()
    marks = error_scale(Compare().error_range)
    # Edges on whole pixels: others are smoothed, and show as stripes where rectangles meet.
    width, height = round(min(16.0 * em, canvas.width - 3.0 * em)), round(0.8 * em)
    if width < 4.0 * em:
        return
    left, top = round(canvas.x + 1.5 * em), round(canvas.y + canvas.height - 3.2 * em)
    colors = [_color((r, g, b, 1.0)) for r, g, b in error_colormap()[::8]]
    edges = [left + round(width * i / (len(colors) - 1)) for i in range(len(colors))]
    for i in range(len(colors) - 1):
        a, z = ImVec2(edges[i], top), ImVec2(edges[i + 1], top + height)
        canvas.draw.add_rect_filled_multi_color(a, z, colors[i], colors[i + 1], colors[i + 1], colors[i])
    for position, text in marks:
        size = imgui.calc_text_size(text).x
        x = left + position * width
        canvas.draw.add_line(ImVec2(x, top + height), ImVec2(x, top + height + 0.2 * em), _color(_WHITE))
        canvas.text(0, 0, text, offset=(x - canvas.x - 0.5 * size, top - canvas.y + height + 0.2 * em))
    canvas.text(0, 0, f"relative error: {title}", offset=(left - canvas.x, top - canvas.y - 1.4 * em))


def comparison_names(app: App) -> tuple[str, str]:
    """What the picture and the one that it is compared with are, in a few words."""
    assert app.document is not None
    settings = app.document.settings
    transmittance = settings.transmittance

    def name(values) -> str:
        method = method_of(values)
        return f"{values.coefficients} {method.values}" if method.has_coefficients else method.name

    if app.view.compare_with == "before":
        return "now", "before"
    other = app.compared_settings(settings)
    if transmittance == other.transmittance == "march":
        return "march", "march"
    return name(settings), name(other)


def _draw_state(app: App, canvas: _Canvas) -> int:
    """What is not obvious: the camera looked through, a light that is alone, a picture that cannot be drawn.

    Returns the number of lines at the top.
    """
    assert app.document is not None
    em = hello_imgui.em_size()
    lines = []
    if app.view.camera_path:
        lines.append((f"{icons_fontawesome_4.ICON_FA_VIDEO}  {app.view.camera_path}", _WHITE))
    if app.view.solo:
        lines.append((f"solo: {app.view.solo}", _ACCENT))
    if app.view.inspecting:
        lines.append(("click a point to inspect its light; I to end", _ACCENT))
    description = app.document.description
    if not (description.volumes or description.meshes):
        lines.append(("nothing to show: this stage has no volume and no mesh", _ACCENT))
    elif not description.lights and not any(volume.medium.emits for volume in description.volumes.values()):
        lines.append(("no light shines here: Edit > Add a sun", _ACCENT))
    for i, (text, color) in enumerate(lines):
        canvas.text(0.0, 0.0, text, color, (0.8 * em, 0.5 * em + 1.3 * em * i))
    trouble = app.document.error or app.picture.error or (app.other.error if app.other is not None else "")
    if trouble:
        _banner(canvas, 1.0, trouble, _ERROR, bottom=True)
    return len(lines)


def _banner(canvas: _Canvas, row: float, text: str, color, bottom: bool = False) -> float:
    """A line of text on a coloured ground, wrapped; returns its height."""
    em = hello_imgui.em_size()
    width = canvas.width - 2.0 * em
    size = imgui.calc_text_size(text, wrap_width=width - 1.6 * em)
    height = size.y + 0.8 * em
    top = canvas.y + canvas.height - row - height - em if bottom else canvas.y + row
    left = canvas.x + em
    canvas.draw.add_rect_filled(
        ImVec2(left, top), ImVec2(left + size.x + 1.6 * em, top + height), _color(color), 0.3 * em
    )
    canvas.draw.add_text(
        imgui.get_font(),
        imgui.get_font_size(),
        ImVec2(left + 0.8 * em, top + 0.4 * em),
        _color((1, 1, 1, 1)),
        text,
        wrap_width=width - 1.6 * em,
    )
    return height


def _draw_messages(app: App, canvas: _Canvas, lines: int) -> None:
    """What was notified lately, under so many lines of text."""
    colors = {"error": _ERROR, "warning": (0.65, 0.45, 0.1, 0.92), "info": (0.16, 0.16, 0.17, 0.9)}
    em = hello_imgui.em_size()
    row = (0.9 + 1.3 * max(lines, 1)) * em
    for message in app.messages[-4:]:
        row += _banner(canvas, row, message.text, colors[message.kind]) + 0.3 * em


def _draw_loading(app: App, canvas: _Canvas) -> None:
    loading = app.loading
    if loading is None:
        return
    em = hello_imgui.em_size()
    width = min(26.0 * em, canvas.width - 2.0 * em)
    left, top = canvas.x + 0.5 * (canvas.width - width), canvas.y + 0.5 * canvas.height
    canvas.draw.add_rect_filled(
        ImVec2(left - em, top - 2.2 * em),
        ImVec2(left + width + em, top + 3.6 * em),
        _color((0.1, 0.1, 0.11, 0.94)),
        0.4 * em,
    )
    imgui.set_cursor_screen_pos(ImVec2(left, top - 1.6 * em))
    imgui.text(_shortened(loading.label, width))
    imgui.set_cursor_screen_pos(ImVec2(left, top))
    imgui.progress_bar(loading.progress, ImVec2(width, 1.2 * em), "")
    imgui.set_cursor_screen_pos(ImVec2(left, top + 1.8 * em))
    imgui.set_next_item_allow_overlap()
    if imgui.button("Cancel##loading", ImVec2(6.0 * em, 0.0)):
        loading.cancel()
        app.loading = None
        app.notify("Opening was cancelled")
    elif imgui.is_item_hovered():
        imgui.set_tooltip(loading.path)


def _shortened(text: str, width: float) -> str:
    while len(text) > 8 and imgui.calc_text_size(text).x > width:
        text = text[: len(text) // 2 - 2] + "…" + text[len(text) // 2 + 2 :]
    return text


def _draw_welcome(app: App, canvas: _Canvas) -> None:
    """What is shown before anything is open: how to open something."""
    if app.loading is not None:
        return
    em = hello_imgui.em_size()
    recent = app.preferences.recent[:8]
    height = (7.0 + 1.7 * len(recent)) * em
    left, top = canvas.x + max(0.5 * canvas.width - 11.0 * em, em), canvas.y + max(0.5 * (canvas.height - height), em)
    imgui.set_cursor_screen_pos(ImVec2(left, top))
    imgui.begin_group()
    imgui.push_font(None, 1.6 * imgui.get_font_size())
    imgui.text("previs")
    imgui.pop_font()
    imgui.text_disabled("Drop a USD stage or a .vdb file here")
    imgui.dummy(ImVec2(0.0, 0.4 * em))
    if imgui.button("Open…##welcome", ImVec2(8.0 * em, 1.8 * em)):
        app.commands["open"].run()
    if recent:
        imgui.dummy(ImVec2(0.0, 0.4 * em))
        imgui.text_disabled("Recent")
        for path in recent:
            if imgui.selectable(_shortened(path, 22.0 * em), False, 0, ImVec2(22.0 * em, 0.0))[0]:
                app.open(path)
    imgui.end_group()
