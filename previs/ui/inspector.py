"""The panel "Inspector": transmittance along the light's ray through a point, as it is and as it is stored."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui, implot

from ..render.method import BEST_MAP, METHODS
from . import widgets
from .app import App
from .knobs import number
from .theme import ACCENT, CURVES, DIM, WARNING, Rgba, dim, em, packed, tooltip

if TYPE_CHECKING:
    from ..render.probe import ProbeCurve, TransmittanceProbe

Channel = Literal["mean", "red", "green", "blue"]
Scale = Literal["linear", "log"]

#: The lowest transmittance of the logarithmic plot.
LOG_FLOOR = 1e-4
_TRUTH = CURVES[0]
#: The ends of the range that the first curve's map was stored over, mostly that of all.
_MARK: Rgba = (0.72, 0.72, 0.72, 1.0)
#: What to do about a curve that is off, by what its map holds.
_ADVICE = {
    "cosine": "Waves about the true curve are ringing: more coefficients or a larger threshold calm them.",
    "quantile": "It is exact at as many depths as the map holds, and smooth between: more of them follow finer detail.",
    "slices": "Its optical depth is right at every slice, and straight between: more of them follow finer detail.",
    None: "",
}
_CHANNELS: dict[str, str] = {"mean": "RGB", "red": "R", "green": "G", "blue": "B"}


@dataclass
class _State:
    """What the panel remembers between frames."""

    scale: Scale = "linear"
    channel: Channel = "mean"
    probe: Any = None
    fit: bool = True


_state = _State()


def channel_of(values: np.ndarray, channel: Channel) -> np.ndarray:
    """One channel of a curve (N, 3), or the mean of all."""
    return values.mean(axis=1) if channel == "mean" else values[:, ("red", "green", "blue").index(channel)]


def is_colored(probe: TransmittanceProbe) -> bool:
    """Whether the channels of the true curve differ visibly."""
    return bool(np.ptp(probe.march.transmittance, axis=1).max() > 2e-3)


def deviation(curve: np.ndarray, truth: np.ndarray) -> float:
    """Root of the mean squared difference of two curves."""
    return float(np.sqrt(np.mean((curve - truth) ** 2)))


def verdict(rms: float) -> str:
    """What an RMS deviation of transmittance means for the eye."""
    if rms < 0.003:
        return "as good as exact"
    if rms < 0.01:
        return "very close"
    if rms < 0.03:
        return "slightly off"
    return "visibly off"


def short_name(curve: ProbeCurve) -> str:
    """The curve in the legend."""
    if not curve.coefficients:
        return curve.name
    return f"{curve.coefficients}" if curve.method == BEST_MAP else f"{curve.method} {curve.coefficients}"


def draw_inspector(app: App) -> None:
    """Draw the content of the window "Inspector"."""
    if app.document is None:
        dim("Nothing is open.")
        return
    probe: TransmittanceProbe | None = app.probe
    if probe is None:
        _draw_nothing(app)
        return
    if probe is not _state.probe:
        _state.probe, _state.fit = probe, True
    _draw_head(app, probe)
    channel: Channel = _state.channel if is_colored(probe) else "mean"
    lines = 1 + len(probe.curves)
    reserve = lines * imgui.get_text_line_height_with_spacing() + em(0.4)
    height = max(imgui.get_content_region_avail().y - reserve, em(9))
    _draw_plot(probe, channel, height)
    _draw_words(probe, channel)


def _draw_nothing(app: App) -> None:
    if app.view.inspection is not None:
        dim("The light's way to that point is measured when the picture is finished.")
    elif app.view.inspecting:
        dim("Click a point of the picture: into the smoke, or onto a surface behind it.")
    else:
        if imgui.button(f"{icons_fontawesome.ICON_FA_EYE_DROPPER}  Pick a point###pick", ImVec2(-1.0, 0.0)):
            app.commands["inspect"].run()
        dim("Shows how much of a light reaches each point of its way, and how well slices and maps know it (I).")


def _draw_head(app: App, probe: TransmittanceProbe) -> None:
    imgui.align_text_to_frame_padding()
    imgui.text_colored(ImVec4(*ACCENT), icons_fontawesome.ICON_FA_LIGHTBULB)
    imgui.same_line(0.0, em(0.4))
    _choose_light(app, probe)
    width = em(6.2)
    imgui.same_line(0.0, em(0.4))
    room = imgui.get_content_region_avail().x
    colored = is_colored(probe)
    channels = em(7.0) if colored else 0.0
    if room > width + channels:
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - width - channels - (em(0.4) if colored else 0.0))
    else:
        imgui.new_line()
    if colored:
        picked = widgets.segments("channel", tuple(_CHANNELS), tuple(_CHANNELS.values()), _state.channel, channels)
        if picked is not None:
            _state.channel = picked
        imgui.same_line(0.0, em(0.4))
    picked = widgets.segments("scale", ("linear", "log"), ("Linear", "Log"), _state.scale, width)
    if picked is not None and picked != _state.scale:
        _state.scale, _state.fit = picked, True


def _choose_light(app: App, probe: TransmittanceProbe) -> None:
    """The light whose ray is shown; another one can be picked."""
    lights = [p for p, light in app.document.description.lights.items() if light.kind != "dome"]
    names = [p.rsplit("/", 1)[-1] for p in lights]
    if len(lights) < 2:
        imgui.text_unformatted(probe.light.rsplit("/", 1)[-1])
        tooltip(probe.light)
        return
    picked = widgets.combo("probe_light", lights, names, probe.light, em(6.5))
    tooltip(f"{probe.light}\nThe light whose ray through the point is shown.")
    if picked is not None and picked != probe.light:
        inspection = app.view.inspection
        app.view.inspection = type(inspection)(inspection.point, picked)


def _draw_plot(probe: TransmittanceProbe, channel: Channel, height: float) -> None:
    logarithmic = _state.scale == "log"
    flags = implot.Flags_.no_mouse_text | implot.Flags_.no_box_select | implot.Flags_.no_title
    implot.push_style_var(implot.StyleVar_.plot_padding, ImVec2(em(0.3), em(0.4)))
    implot.push_style_var(implot.StyleVar_.label_padding, ImVec2(em(0.25), em(0.2)))
    implot.push_style_var(implot.StyleVar_.plot_min_size, ImVec2(em(6.0), em(6.0)))
    if not implot.begin_plot("##transmittance", ImVec2(-1.0, height), int(flags)):
        implot.pop_style_var(3)
        return
    x, y = implot.ImAxis_.x1, implot.ImAxis_.y1
    implot.setup_axes("distance along the ray", "", 0, 0)
    condition = imgui.Cond_.always if _state.fit else imgui.Cond_.once
    lower = LOG_FLOOR if logarithmic else -0.05
    upper = 1.5 if logarithmic else 1.05
    low, high = _interesting(probe)
    implot.setup_axis_limits(x, low, high, condition)
    implot.setup_axis_limits(y, lower, upper, condition)
    implot.setup_axis_scale(y, implot.Scale_.log10 if logarithmic else implot.Scale_.linear)
    implot.setup_legend(implot.Location_.north_east, int(implot.LegendFlags_.no_menus))
    implot.setup_finish()
    _state.fit = False

    def shown(values: np.ndarray) -> np.ndarray:
        line = np.ascontiguousarray(channel_of(values, channel), float)
        return np.maximum(line, 0.1 * LOG_FLOOR) if logarithmic else line

    distance = np.ascontiguousarray(probe.distance, float)
    _line("true", distance, shown(probe.march.transmittance), _TRUTH, em(0.27))
    if probe.visibility.min() < 0.999:
        _line("past surfaces", distance, shown(np.repeat(probe.visibility[:, None], 3, 1)), (*DIM[:3], 0.7), em(0.08))
    for i, curve in enumerate(probe.curves):
        _line(short_name(curve), distance, shown(curve.transmittance), CURVES[1 + i % 4], em(0.12))
    _marks(probe, channel)
    if implot.is_plot_hovered():
        _readout(probe, channel)
    implot.end_plot()
    implot.pop_style_var(3)


def _interesting(probe: TransmittanceProbe) -> tuple[float, float]:
    """The part of the ray where something happens: the whole of it, or less where it begins far before the medium."""
    ends = [probe.picked]
    for curve in _adaptive(probe):
        ends += [k for k in (curve.k_min, curve.k_max) if math.isfinite(k)]
    line = probe.march.transmittance.min(axis=1)
    changing = probe.distance[np.abs(np.gradient(line)) > 1e-4]
    if len(changing):
        ends += [float(changing[0]), float(changing[-1])]
    first, last = float(probe.distance[0]), float(probe.distance[-1])
    low, high = max(min(ends), first), min(max(ends), last)
    margin = 0.08 * max(high - low, 1e-3 * (last - first))
    return low - margin, high + margin


def _adaptive(probe: TransmittanceProbe) -> tuple[ProbeCurve, ...]:
    """The curves whose maps have a range of their own; slices, which come last, go through the whole volume."""
    return tuple(curve for curve in probe.curves if not curve.slices)


def _line(label: str, x: np.ndarray, y: np.ndarray, color: Rgba, weight: float) -> None:
    implot.plot_line(label, x, y, implot.Spec(line_color=ImVec4(*color), line_weight=weight))


def _marks(probe: TransmittanceProbe, channel: Channel) -> None:
    """Where the ranges begin and end, the threshold, and the point."""
    paint = implot.get_plot_draw_list()
    limits = implot.get_plot_limits()
    implot.push_plot_clip_rect()
    if probe.threshold > 0.0:
        _across(paint, limits, probe.threshold, "T th")
    spoken: list[float] = []
    for i, curve in enumerate(_adaptive(probe)):
        for k, name in ((curve.k_min, "k min"), (curve.k_max, "k max")):
            if not math.isfinite(k):
                continue
            known = any(abs(k - other) < 2e-3 * (limits.x.max - limits.x.min) for other in spoken)
            spoken.append(k)
            if not known:
                _down(paint, limits, k, name, _MARK if i == 0 else CURVES[1 + i % 4], 0.3 + 0.1 * i)
    value = float(np.interp(probe.picked, probe.distance, channel_of(probe.march.transmittance, channel)))
    at = implot.plot_to_pixels(probe.picked, max(value, LOG_FLOOR) if _state.scale == "log" else value)
    top = implot.plot_to_pixels(probe.picked, limits.y.max)
    bottom = implot.plot_to_pixels(probe.picked, limits.y.min)
    paint.add_line(top, bottom, packed(ACCENT, 0.35), em(0.08))
    paint.add_circle_filled(at, em(0.36), packed(ACCENT), 24)
    paint.add_circle(at, em(0.36), packed((0.0, 0.0, 0.0, 0.8)), 24, em(0.08))
    implot.pop_plot_clip_rect()


def _across(paint: Any, limits: Any, value: float, name: str) -> None:
    left, right = implot.plot_to_pixels(limits.x.min, value), implot.plot_to_pixels(limits.x.max, value)
    _dashes(paint, left, right, packed(WARNING, 0.65))
    size = imgui.calc_text_size(name)
    paint.add_text(ImVec2(right.x - size.x - em(0.3), left.y - em(1.1)), packed(WARNING, 0.9), name)


def _down(paint: Any, limits: Any, value: float, name: str, color: Rgba, height: float) -> None:
    top, bottom = implot.plot_to_pixels(value, limits.y.max), implot.plot_to_pixels(value, limits.y.min)
    _dashes(paint, top, bottom, packed(color, 0.7))
    size = imgui.calc_text_size(name)
    end = implot.get_plot_pos().x + implot.get_plot_size().x
    x = top.x + em(0.2) if top.x + size.x + em(0.3) < end else top.x - size.x - em(0.2)
    # Low, where neither the legend nor, in either scale, a usual threshold is.
    paint.add_text(ImVec2(x, bottom.y - height * (bottom.y - top.y)), packed(color, 0.9), name)


def _dashes(paint: Any, a: ImVec2, b: ImVec2, color: int) -> None:
    length = math.hypot(b.x - a.x, b.y - a.y)
    dash = em(0.4)
    for i in range(min(int(length / (2.0 * dash)) + 1, 200)):
        u, v = 2.0 * i * dash / max(length, 1e-6), min((2.0 * i + 1.0) * dash / max(length, 1e-6), 1.0)
        p = ImVec2(a.x + u * (b.x - a.x), a.y + u * (b.y - a.y))
        q = ImVec2(a.x + v * (b.x - a.x), a.y + v * (b.y - a.y))
        paint.add_line(p, q, color, 1.0)


def _readout(probe: TransmittanceProbe, channel: Channel) -> None:
    """The values under the pointer."""
    x = implot.get_plot_mouse_pos().x
    limits = implot.get_plot_limits()
    top, bottom = implot.plot_to_pixels(x, limits.y.max), implot.plot_to_pixels(x, limits.y.min)
    implot.get_plot_draw_list().add_line(top, bottom, packed(DIM, 0.6), 1.0)
    if not imgui.begin_tooltip():
        return
    imgui.text_disabled(f"distance {number(x)}")
    rows = [("true", probe.march.transmittance, _TRUTH)]
    rows += [(short_name(c), c.transmittance, CURVES[1 + i % 4]) for i, c in enumerate(probe.curves)]
    for name, values, color in rows:
        value = float(np.interp(x, probe.distance, channel_of(values, channel)))
        imgui.text_colored(ImVec4(*color), f"{name}: {number(value, 4)}")
    imgui.end_tooltip()


def _draw_words(probe: TransmittanceProbe, channel: Channel) -> None:
    """What the plot says, in words."""
    truth = channel_of(probe.march.transmittance, channel)
    value = float(np.interp(probe.picked, probe.distance, truth))
    imgui.text_unformatted(f"At the point: {100.0 * value:.3g} % of the light")
    tooltip(f"The true transmittance of the media at the picked point: {number(value, 5)}\nSurfaces are not in it.")
    for i, curve in enumerate(probe.curves):
        line = channel_of(curve.transmittance, channel)
        rms = deviation(line, truth)
        there = float(np.interp(probe.picked, probe.distance, line))
        imgui.text_colored(ImVec4(*CURVES[1 + i % 4]), f"{short_name(curve)}:")
        imgui.same_line(0.0, em(0.3))
        imgui.text_unformatted(f"RMS {rms:.2g}, {verdict(rms)}")
        tooltip(
            f"{curve.name}\nOff by {number(rms, 5)} along the ray (RMS), by {number(there - value, 5)} at the point."
            f"\n{_ADVICE[METHODS[curve.method].curve]}"
        )
