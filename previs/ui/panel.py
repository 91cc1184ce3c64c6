"""The panel "Look": everything about the selected volume or light, or a way to select one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui

from .. import blackbody
from ..description import Medium
from . import placing, widgets
from .app import App
from .knobs import LIGHT, LIGHT_BY_NAME, MEDIUM, MEDIUM_BY_NAME, PLACE_BY_NAME, Knob, encoded
from .lobe import ISOTROPIC, Lobe, Polar, Radius, lobe, outline
from .outliner import ICONS
from .theme import ACCENT, CURVES, DIM, FRAME, dim, em, packed, tooltip
from .widgets import Binding

_PAIRS = ("extinction", "albedo", "scattering", "absorption")
_USES_G = ("hg", "schlick", "two_lobe")
#: The sizes that each kind of light has.
SIZES: dict[str, tuple[str, ...]] = {
    "distant": ("angle",),
    "sphere": ("radius",),
    "disk": ("radius",),
    "rect": ("width", "height"),
    "cylinder": ("length", "radius"),
    "dome": (),
}
_SPOT = {"cone_angle": 30.0, "cone_softness": 0.2}


@dataclass(frozen=True)
class _Shown:
    """The values of one prim: as they are, as the stage has them without the edits, and which are animated."""

    now: Any
    stage: Any
    animated: frozenset[str]


@dataclass
class _State:
    """What the panel remembers between frames."""

    key: Hashable = None
    animated: frozenset[str] = frozenset()
    selection: str = ""
    headed: str = ""
    radius: Radius = "log"


_state = _State()


def draw_look(app: App) -> None:
    """Draw the content of the window "Look"."""
    widgets.end_finished_gesture(app)
    document = app.document
    if document is None:
        dim("Open a stage to see what it is made of.")
        return
    selection = app.view.selection
    if selection != _state.selection:
        _state.selection = selection
        widgets.forget_colors()
    # A picked instance is selected as what it was made from.
    path = document.scene.prim_path(selection) if selection else ""
    item = next((i for i in document.scene.outline(document.time_code) if i.path == path), None)
    if item is None:
        _draw_nothing(app, selection)
        return
    _draw_header(app, item)
    if not item.editable:
        dim("This prim is part of an instance: it looks as the prototype does and cannot be changed alone.")
        imgui.begin_disabled()
    if item.kind == "volume":
        _draw_volume(app, item.path)
    elif item.kind == "light":
        _draw_light(app, item.path)
    elif item.kind == "camera":
        _draw_camera(app, item.path)
    else:
        _draw_mesh(app, item.path)
    if not item.editable:
        imgui.end_disabled()


# --- nothing, meshes, cameras -----------------------------------------------------------------------------------------


def _draw_nothing(app: App, selection: str) -> None:
    if selection:
        dim(f"{selection} is not on the stage any more.")
    else:
        dim("Click a volume or a light, in the picture or here, to change how it looks.")
    for kind, title in (("volume", "Volumes"), ("light", "Lights")):
        items = [i for i in app.document.scene.outline(app.document.time_code) if i.kind == kind]
        if not items:
            continue
        imgui.separator_text(title)
        for item in items[:40]:
            if imgui.selectable(f"{ICONS[kind]}  {item.name}###{item.path}", False)[0]:
                app.select(item.path)
            tooltip(item.path)
        if len(items) > 40:
            dim(f"and {len(items) - 40} more in the outliner")


def _draw_header(app: App, item: Any) -> None:
    imgui.align_text_to_frame_padding()
    imgui.text_colored(ImVec4(*ACCENT), ICONS[item.kind])
    imgui.same_line(0.0, em(0.4))
    button = imgui.get_frame_height() * 1.2
    right = imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x
    corner = imgui.get_cursor_screen_pos()
    room = ImVec2(corner.x + right - imgui.get_cursor_pos_x() - 2.4 * button, corner.y + 2.0 * em())
    imgui.push_clip_rect(corner, room, True)
    imgui.text_unformatted(item.name)
    imgui.pop_clip_rect()
    tooltip(item.path)
    if item.kind == "camera":
        return
    imgui.same_line(right - 2 * button - em(0.2))
    eye = icons_fontawesome.ICON_FA_EYE if item.visible else icons_fontawesome.ICON_FA_EYE_SLASH
    if imgui.button(f"{eye}###header_visible", ImVec2(button, 0.0)):
        _toggle_visible(app, item)
    tooltip("Visible" if item.visible else "Hidden")
    imgui.same_line(0.0, em(0.2))
    if imgui.button(f"{icons_fontawesome.ICON_FA_CROSSHAIRS}###header_frame", ImVec2(button, 0.0)):
        app.frame(item.path)
    tooltip("Frame it in the view (F)")


def _toggle_visible(app: App, item: Any) -> None:
    action = f"Hide {item.name}" if item.visible else f"Show {item.name}"
    app.edit(action, lambda scene: scene.set_visible(item.path, not item.visible))


def _draw_camera(app: App, path: str) -> None:
    camera = app.document.description.cameras.get(path)
    through = app.view.camera_path == path
    if imgui.button("Leave the camera###look_through" if through else "Look through###look_through", ImVec2(-1.0, 0.0)):
        app.look_through("" if through else path)
    if camera is None:
        return
    if camera.projection == "perspective":
        angle = 2.0 * np.degrees(np.arctan(0.5 * camera.horizontal_aperture / camera.focal_length))
        dim(f"Perspective, {camera.focal_length:g} mm, {angle:.1f}° wide")
    else:
        dim(f"Orthographic, {0.1 * camera.horizontal_aperture:g} units wide")


def _draw_mesh(app: App, path: str) -> None:
    mesh = app.document.description.meshes.get(path)
    if mesh is None:
        dim("A mesh that is hidden. It neither shows nor casts shadows.")
        return
    count, instances = len(mesh.geometry.triangles), len(mesh.local_to_world)
    times = f", in {instances} places" if instances > 1 else ""
    noun = "triangle" if count == 1 else "triangles"
    dim(f"A mesh of {count:,} {noun}{times}. It hides what is behind it and casts shadows into media.")
    imgui.color_button(
        "##mesh_color", ImVec4(*encoded(mesh.surface.diffuse_color), 1.0), 0, ImVec2(em(2.0), imgui.get_frame_height())
    )
    imgui.same_line()
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted("from its vertices" if mesh.geometry.colors is not None else "diffuse colour")


# --- bindings ---------------------------------------------------------------------------------------------------------


def _shown(app: App, path: str, knobs: tuple[Knob, ...], read: str, authored: str) -> _Shown:
    """The values of a prim, by the scene's methods of these names.

    Values are read in every frame, which is cheap; which of them are animated only when the document moved.
    """
    document = app.document
    scene, time = document.scene, document.time_code
    key = (id(document), document.version, document.undo_label, path)
    if _state.key != key:
        _state.key = key
        _state.animated = frozenset(k.name for k in knobs if scene.is_animated(path, k.name))
    return _Shown(getattr(scene, read)(path, time), getattr(scene, authored)(path, time), _state.animated)


def _binding(app: App, path: str, knob: Knob, shown: _Shown, author: str, reset: str) -> Binding:
    name = knob.name
    time = app.document.time_code if name in shown.animated else None
    noun = path.rsplit("/", 1)[-1]

    def write(value: Any) -> None:
        app.edit(
            f"Set {knob.label.lower()} of {noun}",
            lambda scene: getattr(scene, author)(path, time=time, **{name: value}),
        )

    def go_back() -> None:
        app.edit(f"Reset {knob.label.lower()} of {noun}", lambda scene: getattr(scene, reset)(path, name))

    return Binding(
        value=_plain(getattr(shown.now, name)),
        write=write,
        stage=_plain(getattr(shown.stage, name)),
        reset=go_back,
        action=f"Set {knob.label.lower()} of {noun}",
        animated=time,
    )


def _plain(value: Any) -> Any:
    return tuple(float(c) for c in value) if isinstance(value, tuple | list | np.ndarray) else value


# --- volumes ----------------------------------------------------------------------------------------------------------


def _draw_volume(app: App, path: str) -> None:
    shown = _shown(app, path, MEDIUM, "medium", "authored_medium")
    medium: Medium = shown.now

    def knob(name: str) -> None:
        described = MEDIUM_BY_NAME[name]
        widgets.draw(app, described, _binding(app, path, described, shown, "set_medium", "reset_medium"))

    imgui.separator_text("Density")
    knob("density_scale")
    imgui.separator_text("Scattering")
    for name in _PAIRS:
        if name == "scattering":
            imgui.dummy(ImVec2(0.0, em(0.1)))
        knob(name)
    imgui.separator_text("Phase")
    knob("phase")
    if medium.phase in _USES_G:
        knob("anisotropy")
    if medium.phase == "two_lobe":
        knob("anisotropy2")
        knob("lobe_mix")
    _draw_lobe(medium)
    record = app.document.description.volumes.get(path)
    glows = medium.emits or (record is not None and (record.temperature is not None or record.emission is not None))
    imgui.dummy(ImVec2(0.0, em(0.1)))
    if _state.headed != path:
        imgui.set_next_item_open(glows)
    opened = imgui.collapsing_header("Emission and temperature###emission_header")
    if imgui.is_item_visible():
        # A panel that is only being made takes no notice of what is set.
        _state.headed = path
    if opened:
        for name in ("emission", "emission_scale"):
            knob(name)
        if record is None or record.temperature is not None:
            knob("temperature_scale")
            knob("temperature_offset")
        else:
            dim("The volume has no temperature field.")
        if medium.emits is False and max(medium.emission) > 0.0:
            dim("Nothing glows: the medium absorbs nothing. Lower the albedo.")
    _reset_all(app, path, shown, {k.name: k.label for k in MEDIUM}, "reset_medium")


def _reset_all(app: App, path: str, shown: _Shown, labels: Mapping[str, str], reset: str) -> None:
    pairs = ((name, _plain(getattr(shown.now, name)), _plain(getattr(shown.stage, name))) for name in labels)
    edited = [name for name, now, stage in pairs if not widgets.same(now, stage)]
    if not edited:
        return
    imgui.dummy(ImVec2(0.0, em(0.3)))
    label = f"{icons_fontawesome.ICON_FA_UNDO}  Reset to the stage's values###reset_all"
    if imgui.button(label, ImVec2(-1.0, 0.0)):
        noun = path.rsplit("/", 1)[-1]
        app.edit(f"Reset {noun}", lambda scene: getattr(scene, reset)(path, *edited))
    tooltip("Takes back the changes of:\n" + ", ".join(labels[name] for name in edited))


# --- the lobe ---------------------------------------------------------------------------------------------------------


def _draw_lobe(medium: Medium) -> None:
    """The polar plot: light comes from the left, the distance from the middle is how much goes that way."""
    width = imgui.get_content_region_avail().x
    radius = min(0.5 * width - em(1.0), em(5.2))
    if radius <= em(1.0):
        return
    size = ImVec2(width, 2.0 * radius + em(0.8))
    corner = imgui.get_cursor_screen_pos()
    clicked = imgui.invisible_button("phase_plot", size)
    hovered = imgui.is_item_hovered()
    paint = imgui.get_window_draw_list()
    paint.add_rect_filled(corner, ImVec2(corner.x + size.x, corner.y + size.y), packed(FRAME), em(0.2))
    if clicked:
        _state.radius = "linear" if _state.radius == "log" else "log"
    centre = (corner.x + 0.5 * size.x, corner.y + 0.5 * size.y)
    parts = _lobes(medium)
    polar = Polar.fitting([part for part, *_ in parts], _state.radius)
    even = float(polar.radii(ISOTROPIC)) * radius
    paint.add_circle(ImVec2(*centre), even, packed(DIM, 0.45), 64, 1.0)
    for step in (-1.0, 1.0):
        paint.add_line(ImVec2(*centre), ImVec2(centre[0] + step * radius, centre[1]), packed(DIM, 0.25))
        paint.add_line(ImVec2(*centre), ImVec2(centre[0], centre[1] + step * radius), packed(DIM, 0.25))
    for part, color, thickness in parts:
        line = outline(part, polar) * (radius, -radius) + centre
        paint.add_polyline([ImVec2(x, y) for x, y in line.tolist()], packed(color), thickness, 0)
    _draw_arrow(paint, centre, corner, radius)
    text = "log" if _state.radius == "log" else "linear"
    paint.add_text(ImVec2(corner.x + em(0.4), corner.y + em(0.2)), packed(DIM), text)
    if hovered:
        _lobe_tooltip(medium, centre)


def _lobes(medium: Medium) -> list[tuple[Lobe, Any, float]]:
    """The curves to draw with colour and thickness, the whole phase function last."""
    whole = lobe(medium.phase, medium.anisotropy, medium.anisotropy2, medium.lobe_mix)
    parts: list[tuple[Lobe, Any, float]] = []
    if medium.phase == "two_lobe":
        parts.append((lobe("hg", medium.anisotropy), (*CURVES[2][:3], 0.8), em(0.07)))
        parts.append((lobe("hg", medium.anisotropy2), (*CURVES[3][:3], 0.8), em(0.07)))
    return [*parts, (whole, ACCENT, em(0.13))]


def _draw_arrow(paint: Any, centre: tuple[float, float], corner: ImVec2, radius: float) -> None:
    """Where light comes from."""
    y, end = centre[1], centre[0] - radius - em(0.2)
    start = max(corner.x + em(0.4), end - em(2.2))
    if end - start < em(0.6):
        return
    paint.add_line(ImVec2(start, y), ImVec2(end, y), packed((1.0, 0.93, 0.7, 0.9)), em(0.1))
    head = em(0.35)
    tip = ImVec2(end + em(0.1), y)
    back = end - head
    paint.add_triangle_filled(tip, ImVec2(back, y - head), ImVec2(back, y + head), packed((1.0, 0.93, 0.7, 0.9)))


def _lobe_tooltip(medium: Medium, centre: tuple[float, float]) -> None:
    mouse = imgui.get_mouse_pos()
    angle = abs(float(np.arctan2(centre[1] - mouse.y, mouse.x - centre[0])))
    whole = lobe(medium.phase, medium.anisotropy, medium.anisotropy2, medium.lobe_mix)
    value = float(np.interp(angle, whole.angles, whole.values))
    imgui.set_tooltip(
        f"Light turned by {np.degrees(angle):.0f}°: {value:.3g} / sr, {value / ISOTROPIC:.3g} × as much as evenly\n"
        "Light comes from the left; the circle is even scattering.\nClick for a linear or logarithmic radius."
    )


# --- lights -----------------------------------------------------------------------------------------------------------


def _draw_light(app: App, path: str) -> None:
    shown = _shown(app, path, LIGHT, "light_values", "authored_light")
    light = shown.now

    def binding(name: str) -> Binding:
        return _binding(app, path, LIGHT_BY_NAME[name], shown, "set_light", "reset_light")

    def knob(name: str) -> None:
        widgets.draw(app, LIGHT_BY_NAME[name], binding(name))

    _draw_switches(app, path, shown)
    imgui.separator_text("Brightness")
    knob("intensity")
    knob("exposure")
    knob("normalize")
    imgui.separator_text("Colour")
    way = binding("enable_color_temperature")
    width = widgets.row(LIGHT_BY_NAME["enable_color_temperature"], way)
    picked = widgets.segments("color_by", (False, True), ("Colour", "Temperature"), way.value, width)
    if picked is not None and picked != way.value:
        way.write(picked)
    if light.enable_color_temperature:
        knob("color_temperature")
        _draw_temperature(light.color_temperature)
    knob("color")
    if light.enable_color_temperature and not widgets.same(tuple(light.color), (1.0, 1.0, 1.0)):
        dim("The colour multiplies the temperature's.")
    sizes = SIZES.get(light.kind, ())
    if sizes:
        imgui.separator_text("Size")
        for name in sizes:
            knob(name)
    _draw_cone(app, path, light, knob)
    _draw_place(app, path, shown)
    imgui.separator_text("Shadows")
    knob("casts_shadows")
    labels = {**{k.name: k.label for k in LIGHT}, "direction": "Direction", "position": "Position"}
    _reset_all(app, path, shown, labels, "reset_light")


def _draw_switches(app: App, path: str, shown: _Shown) -> None:
    """On, and alone."""
    widgets.draw(
        app, LIGHT_BY_NAME["visible"], _binding(app, path, LIGHT_BY_NAME["visible"], shown, "set_light", "reset_light")
    )
    imgui.same_line(0.0, em(1.5))
    alone = app.view.solo == path
    if alone:
        imgui.push_style_color(imgui.Col_.button, ImVec4(*(0.62 * c for c in ACCENT[:3]), 1.0))
    if imgui.button(f"{icons_fontawesome.ICON_FA_STAR}  Solo###solo"):
        app.view.solo = "" if alone else path
    if alone:
        imgui.pop_style_color()
    tooltip("Solo\nOnly this light shines in the view; the stage stays as it is.")


def _draw_temperature(kelvin: float) -> None:
    """The black body's colours from cold to warm, and where this one is."""
    knob = LIGHT_BY_NAME["color_temperature"]
    width, height = widgets.skip_label(), em(0.55)
    corner = imgui.get_cursor_screen_pos()
    imgui.dummy(ImVec2(width, height))
    paint = imgui.get_window_draw_list()
    colors = _temperature_colors(knob.low, knob.high)
    step = width / (len(colors) - 1)
    for i in range(len(colors) - 1):
        left, right = packed(colors[i]), packed(colors[i + 1])
        lo = ImVec2(corner.x + i * step, corner.y)
        paint.add_rect_filled_multi_color(lo, ImVec2(lo.x + step + 0.5, lo.y + height), left, right, right, left)
    x = corner.x + width * min(max(knob.fraction(kelvin), 0.0), 1.0)
    over = em(0.15)
    top, bottom = ImVec2(x, corner.y - over), ImVec2(x, corner.y + height + over)
    paint.add_line(top, bottom, packed((1.0, 1.0, 1.0, 1.0)), em(0.12))
    tooltip(f"{kelvin:.0f} K")


_ramp: dict[tuple[float, float], list[tuple[float, float, float, float]]] = {}


def _temperature_colors(low: float, high: float) -> list[tuple[float, float, float, float]]:
    if (low, high) not in _ramp:
        colors = blackbody.chromaticity(np.linspace(low, high, 25))
        bright = colors / colors.max(axis=1, keepdims=True)
        _ramp[(low, high)] = [(*encoded(c), 1.0) for c in bright.tolist()]
    return _ramp[(low, high)]


def _draw_cone(app: App, path: str, light: Any, knob: Callable[[str], None]) -> None:
    """The cone of a light that has one, or a way to give it one."""
    record = app.document.description.lights.get(path)
    shaped = light.cone_angle < 90.0 or (record is not None and record.shaping is not None)
    if not shaped and light.kind != "sphere":
        return
    imgui.separator_text("Cone")
    if shaped:
        for name in ("cone_angle", "cone_softness", "focus"):
            knob(name)
        return
    if imgui.button("Make it a spot###make_spot", ImVec2(-1.0, 0.0)):
        app.edit(f"Make {path.rsplit('/', 1)[-1]} a spot", lambda scene: scene.set_light(path, **_SPOT))
    tooltip("Gives the light a cone about its axis.")


# --- where a light is -------------------------------------------------------------------------------------------------


def _draw_place(app: App, path: str, shown: _Shown) -> None:
    """Where light comes from, for lights that have a direction, and where the light stands."""
    light = shown.now
    aimed = light.kind not in ("sphere", "cylinder", "dome") or light.cone_angle < 90.0
    placed = light.kind not in ("distant", "dome")
    if aimed:
        imgui.separator_text("Direction")
        _draw_direction(app, path, shown)
    if placed:
        imgui.separator_text("Position")
        _draw_position(app, path, shown)
    if (aimed or placed) and app.document.scene.is_animated(path, "position"):
        dim("It moves over time; a change here holds it still.")


def _place_binding(app: App, path: str, name: str, values: tuple[Any, Any], write: Callable[[Any], None]) -> Binding:
    noun = path.rsplit("/", 1)[-1]

    def go_back() -> None:
        app.edit(f"Reset {name} of {noun}", lambda scene: scene.reset_light(path, name))

    return Binding(values[0], write, values[1], go_back, action=f"Set {name} of {noun}")


def _draw_direction(app: App, path: str, shown: _Shown) -> None:
    up = app.document.description.up_axis
    now, stage = (placing.angles(values.direction, up) for values in (shown.now, shown.stage))
    for i, name in enumerate(("elevation", "azimuth")):

        def write(value: float, i: int = i) -> None:
            turned = placing.direction(*(value if k == i else now[k] for k in range(2)), up)
            noun = path.rsplit("/", 1)[-1]
            app.edit(f"Set direction of {noun}", lambda scene: scene.set_light(path, direction=turned))

        binding = _place_binding(app, path, "direction", (now[i], stage[i]), write)
        widgets.draw(app, PLACE_BY_NAME[name], binding)


def _draw_position(app: App, path: str, shown: _Shown) -> None:
    now, stage = shown.now.position, shown.stage.position
    description = app.document.description
    # A ground plane reaches much further than lights are moved.
    boxes = [b for volume in description.volumes if (b := description.bounds_of(volume)) is not None]
    bounds = np.array([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]]) if boxes else description.world_bounds()
    low, high = placing.reach(bounds, now)
    for i, axis in enumerate("xyz"):

        def write(value: float, i: int = i) -> None:
            moved = tuple(value if k == i else now[k] for k in range(3))
            noun = path.rsplit("/", 1)[-1]
            app.edit(f"Set position of {noun}", lambda scene: scene.set_light(path, position=moved))

        knob = replace(PLACE_BY_NAME[f"position_{axis}"], low=float(low[i]), high=float(high[i]))
        widgets.draw(app, knob, _place_binding(app, path, "position", (now[i], stage[i]), write))
