"""The knobs of the panels as data: what `previs.settings.TABLE` is for the renderer, for media and lights too.

A `Knob` says what a widget needs to know: the name that the scene's methods take, a label to read, the unit, the legal
range (what the stage accepts), the comfortable range (what the slider spans) and how it responds between. Nothing here
draws; `previs.ui.widgets` draws any knob.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..description import PHASES, Color, Medium
from ..settings import TABLE, Setting

Kind = Literal["float", "int", "choice", "bool", "color"]
Response = Literal["linear", "log"]

#: A slider with logarithmic response that starts at 0 is linear below this part of its comfortable range.
_LINEAR_PART = 1e-3


@dataclass(frozen=True)
class Knob:
    """One knob.

    Attributes:
        name: as `Scene.set_medium`, `set_light` or `set_setting` take it; the widget's ImGui id too.
        label: what the panel calls it.
        kind: the type of its value; a colour is three floats of linear RGB.
        doc: what it does, one or two sentences.
        default: the value where nothing is authored.
        unit: shown after the value.
        minimum, maximum: what the stage accepts, inclusive; None is unbounded. Of each channel, for a colour.
        low, high: what the slider spans; for a colour of its largest channel.
        response: how the slider moves between them.
        choices: the legal values of a choice, with `choice_labels` to read.
        step: whole numbers move by so much.
        automatic: 0 is legal besides the range and leaves the choice to previs.
        decimals: digits after the point at most; trailing zeros are not shown.
    """

    name: str
    label: str
    kind: Kind
    doc: str
    default: Any
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    low: float = 0.0
    high: float = 1.0
    response: Response = "linear"
    choices: tuple[str, ...] = ()
    choice_labels: tuple[str, ...] = ()
    step: int = 1
    automatic: bool = False
    decimals: int = 3

    def clamped(self, value: Any) -> Any:
        """The legal value nearest to a float, int or colour; other kinds as they are."""
        if self.kind == "color":
            return tuple(self._clamped(c) for c in value)
        if self.kind == "float":
            return self._clamped(value)
        if self.kind == "int":
            if self.automatic and value <= 0:
                return 0
            base = int(self.minimum or 0)
            return int(self._clamped(base + self.step * round((value - base) / self.step)))
        return value

    def _clamped(self, value: float) -> float:
        value = float(value)
        if not math.isfinite(value):
            return float(np.max(self.default))
        if self.automatic and value <= 0.0:
            return 0.0
        if self.minimum is not None:
            value = max(value, self.minimum)
        if self.maximum is not None:
            value = min(value, self.maximum)
        return value

    def fraction(self, value: float, low: float | None = None, high: float | None = None) -> float:
        """Where a value sits on the slider, in [0, 1] inside the comfortable range (or the one given)."""
        low, high = self.low if low is None else low, self.high if high is None else high
        if self.response == "log":
            low, high, value = (_signed_log(v, self._linear_below()) for v in (low, high, value))
        return (value - low) / (high - low) if high > low else 0.0

    def at(self, fraction: float, low: float | None = None, high: float | None = None) -> float:
        """The value at a place of the slider: the inverse of `fraction`."""
        low, high = self.low if low is None else low, self.high if high is None else high
        if self.response == "log":
            linear = self._linear_below()
            a, b = _signed_log(low, linear), _signed_log(high, linear)
            return _signed_power(a + (b - a) * fraction, linear)
        return low + (high - low) * fraction

    def _linear_below(self) -> float:
        return self.low if self.low > 0.0 else _LINEAR_PART * self.high

    def format(self, value: Any, unit: bool = True) -> str:
        """The value to read, with its unit."""
        if self.kind == "bool":
            return "on" if value else "off"
        if self.kind == "choice":
            labels = self.choice_labels or self.choices
            return dict(zip(self.choices, labels, strict=True)).get(value, str(value))
        if self.automatic and value == 0:
            return "auto"
        if self.kind == "color":
            if max(value) - min(value) <= 1e-6 * max(map(abs, value)):
                return self._number(value[0]) + (self._after() if unit else "")
            text = ", ".join(self._number(c) for c in value)
        else:
            text = self._number(value)
        return text + (self._after() if unit else "")

    def _number(self, value: float) -> str:
        return str(int(value)) if self.kind == "int" else number(value, self.decimals)

    def _after(self) -> str:
        return "" if not self.unit else self.unit if self.unit == "°" else f" {self.unit}"

    def parse(self, text: str) -> Any:
        """What a user typed, brought into the legal range; None when it is no number.

        A colour takes one number for all channels or three. "auto" is 0 where the knob has an automatic value. A unit
        after the number and a comma for the point are put up with.
        """
        text = text.strip().lower()
        if self.unit and text.endswith(self.unit.lower()):
            text = text[: -len(self.unit)].strip()
        if self.automatic and text in ("auto", "automatic"):
            return 0 if self.kind == "int" else 0.0
        if self.kind == "color":
            words = text.replace(",", " ").split()
            try:
                numbers = [float(word) for word in words]
            except ValueError:
                return None
            if len(numbers) not in (1, 3) or not all(map(math.isfinite, numbers)):
                return None
            return self.clamped(tuple(numbers * (3 // len(numbers))))
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            return None
        return self.clamped(value) if math.isfinite(value) else None

    def accepts(self) -> str:
        """The legal values in words."""
        if self.kind == "bool":
            return "on or off"
        if self.kind == "choice":
            return ", ".join(self.choice_labels or map(str, self.choices))
        unit = self._after()
        lower, upper = self.minimum, self.maximum
        if lower is not None and upper is not None:
            words = f"{number(lower, 6)} to {number(upper, 6)}{unit}"
        elif lower is not None:
            words = f"{number(lower, 6)}{unit} or more"
        else:
            words = "any number" + (f" ({self.unit})" if self.unit else "")
        return f"auto, or {words}" if self.automatic else words

    def tooltip(self) -> str:
        """Name, meaning, unit, range and default."""
        name = self.label if self.label.lower().replace(" ", "_") == self.name else f"{self.label} ({self.name})"
        return f"{name}\n{self.doc}\nRange: {self.accepts()}. Default: {self.format(self.default)}."


def number(value: float, decimals: int = 3) -> str:
    """A number to read: four significant digits, and no more than `decimals` after the point unless it is small."""
    value = float(value)
    if value == 0.0:
        return "0"
    if abs(value) < 10.0 ** (1 - decimals) or abs(value) >= 1e6:
        return f"{value:.4g}"
    places = max(0, min(decimals, 3 - math.floor(math.log10(abs(value)))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def magnitude(color: Color) -> float:
    """The largest channel."""
    return max(color)


def chroma(color: Color, fallback: Color = (1.0, 1.0, 1.0)) -> Color:
    """The colour with its largest channel at 1; `fallback` for black."""
    largest = max(color)
    return tuple(c / largest for c in color) if largest > 0.0 else fallback


def scaled(color: Color, largest: float, fallback: Color = (1.0, 1.0, 1.0)) -> Color:
    """The colour with its largest channel at `largest`, its chroma kept; `fallback` is the chroma of black."""
    return tuple(c * largest for c in chroma(color, fallback))


def encoded(color: Color) -> Color:
    """Linear RGB as a monitor takes it (sRGB), each channel kept in [0, 1]."""
    linear = np.clip(np.asarray(color, float), 0.0, 1.0)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-12) ** (1 / 2.4) - 0.055)
    return tuple(curved.tolist())


def decoded(color: Color) -> Color:
    """The inverse of `encoded` inside [0, 1]."""
    display = np.clip(np.asarray(color, float), 0.0, 1.0)
    linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    return tuple(linear.tolist())


def _signed_log(value: float, linear: float) -> float:
    """Logarithm that goes on linearly, with the same slope, below `linear` and through 0 to negative numbers."""
    size = abs(value)
    curved = size / linear if size <= linear else 1.0 + math.log(size / linear)
    return math.copysign(curved, value)


def _signed_power(value: float, linear: float) -> float:
    size = abs(value)
    return math.copysign(size * linear if size <= 1.0 else linear * math.exp(size - 1.0), value)


# --- media ------------------------------------------------------------------------------------------------------------

_MEDIUM = Medium()

MEDIUM: tuple[Knob, ...] = (
    Knob(
        "density_scale",
        "Density scale",
        "float",
        "Multiplies the density field: how thick the medium is, whatever it is made of.",
        _MEDIUM.density_scale,
        unit="×",
        minimum=0.0,
        low=0.01,
        high=100.0,
        response="log",
    ),
    Knob(
        "extinction",
        "Extinction",
        "color",
        "How much light is lost per stage unit where the density is 1 (σt): scattering and absorption together. "
        "A change keeps the albedo.",
        _MEDIUM.extinction,
        unit="/ unit",
        minimum=0.0,
        low=0.0,
        high=100.0,
        response="log",
    ),
    Knob(
        "albedo",
        "Albedo",
        "color",
        "The part of the lost light that is scattered instead of absorbed (σs/σt): near 1 for steam and clouds, lower "
        "for smoke and soot. A change keeps the extinction.",
        _MEDIUM.albedo,
        minimum=0.0,
        maximum=1.0,
        low=0.0,
        high=1.0,
        decimals=4,
    ),
    Knob(
        "scattering",
        "Scattering",
        "color",
        "How much light is scattered per stage unit where the density is 1 (σs). A change keeps the absorption.",
        _MEDIUM.scattering,
        unit="/ unit",
        minimum=0.0,
        low=0.0,
        high=100.0,
        response="log",
    ),
    Knob(
        "absorption",
        "Absorption",
        "color",
        "How much light is swallowed per stage unit where the density is 1 (σa). A change keeps the scattering.",
        _MEDIUM.absorption,
        unit="/ unit",
        minimum=0.0,
        low=0.0,
        high=100.0,
        response="log",
    ),
    Knob(
        "phase",
        "Phase function",
        "choice",
        "Where scattered light goes: evenly, by a Henyey–Greenstein lobe or its Schlick fit, as in thin air "
        "(Rayleigh), or by two lobes.",
        _MEDIUM.phase,
        choices=PHASES,
        choice_labels=("Isotropic", "Henyey–Greenstein", "Schlick", "Rayleigh", "Two lobes"),
    ),
    Knob(
        "anisotropy",
        "Anisotropy g",
        "float",
        "Mean cosine of the scattering angle: positive scatters forward, away from the light; negative back to it.",
        _MEDIUM.anisotropy,
        minimum=-1.0,
        maximum=1.0,
        low=-0.95,
        high=0.95,
    ),
    Knob(
        "anisotropy2",
        "Second g",
        "float",
        "Anisotropy of the second lobe, often negative: light that goes back.",
        _MEDIUM.anisotropy2,
        minimum=-1.0,
        maximum=1.0,
        low=-0.95,
        high=0.95,
    ),
    Knob(
        "lobe_mix",
        "Lobe mix",
        "float",
        "Weight of the second lobe: 0 is all first, 1 all second.",
        _MEDIUM.lobe_mix,
        minimum=0.0,
        maximum=1.0,
    ),
    Knob(
        "emission",
        "Emission",
        "color",
        "Emitted radiance, multiplied by the absorption: a medium that absorbs nothing cannot glow.",
        _MEDIUM.emission,
        minimum=0.0,
        low=0.0,
        high=100.0,
        response="log",
    ),
    Knob(
        "emission_scale",
        "Emission scale",
        "float",
        "Multiplies the emission.",
        _MEDIUM.emission_scale,
        unit="×",
        minimum=0.0,
        low=0.01,
        high=1000.0,
        response="log",
    ),
    Knob(
        "temperature_scale",
        "Temperature scale",
        "float",
        "Kelvin per unit of the temperature field; the glow has the colour of a black body.",
        _MEDIUM.temperature_scale,
        low=0.0,
        high=5000.0,
        response="log",
    ),
    Knob(
        "temperature_offset",
        "Temperature offset",
        "float",
        "Kelvin added to the scaled temperature field.",
        _MEDIUM.temperature_offset,
        unit="K",
        low=-2000.0,
        high=2000.0,
        decimals=0,
    ),
)

# --- lights -----------------------------------------------------------------------------------------------------------

LIGHT: tuple[Knob, ...] = (
    Knob("visible", "On", "bool", "Whether the light shines.", True),
    Knob(
        "intensity",
        "Intensity",
        "float",
        "Brightness of the light's surface, or its strength where it is normalised; the exposure multiplies it.",
        1.0,
        minimum=0.0,
        low=0.01,
        high=10000.0,
        response="log",
    ),
    Knob(
        "exposure",
        "Exposure",
        "float",
        "Stops: each one doubles the light.",
        0.0,
        unit="stops",
        low=-10.0,
        high=10.0,
        decimals=2,
    ),
    Knob("color", "Colour", "color", "Multiplies the light.", (1.0, 1.0, 1.0), minimum=0.0, low=0.0, high=1.0),
    Knob(
        "enable_color_temperature",
        "Colour by",
        "bool",
        "Give the light the colour of a black body, multiplied by its colour.",
        False,
    ),
    Knob(
        "color_temperature",
        "Temperature",
        "float",
        "Temperature of the black body: candle 1900, bulb 2800, sun 5500, white 6500, blue sky 10000.",
        6500.0,
        unit="K",
        minimum=1000.0,
        maximum=40000.0,
        low=1000.0,
        high=12000.0,
        decimals=0,
    ),
    Knob(
        "normalize",
        "Normalise",
        "bool",
        "Keep the strength when the light's size changes: intensity is then strength, not brightness of the surface.",
        False,
    ),
    Knob(
        "angle",
        "Angular size",
        "float",
        "Apparent diameter of a distant light; the sun's is 0.53°. Larger ones blur shadows.",
        0.53,
        unit="°",
        minimum=0.0,
        maximum=360.0,
        low=0.0,
        high=10.0,
        decimals=2,
    ),
    Knob("radius", "Radius", "float", "Radius of the light.", 0.5, "units", 0.0, None, 0.001, 10.0, "log"),
    Knob("width", "Width", "float", "Width of the light.", 1.0, "units", 0.0, None, 0.01, 100.0, "log"),
    Knob("height", "Height", "float", "Height of the light.", 1.0, "units", 0.0, None, 0.01, 100.0, "log"),
    Knob("length", "Length", "float", "Length of the light.", 1.0, "units", 0.0, None, 0.01, 100.0, "log"),
    Knob(
        "cone_angle",
        "Cone angle",
        "float",
        "Angle from the axis of the cone to its edge; nothing is lit outside.",
        90.0,
        unit="°",
        minimum=0.0,
        maximum=180.0,
        low=0.0,
        high=90.0,
        decimals=1,
    ),
    Knob(
        "cone_softness",
        "Cone softness",
        "float",
        "The part of the cone over which the light fades towards the edge.",
        0.0,
        minimum=0.0,
        maximum=1.0,
    ),
    Knob(
        "focus",
        "Focus",
        "float",
        "Draws the light to the axis of the cone: it falls by the cosine to this power.",
        0.0,
        minimum=0.0,
        low=0.0,
        high=100.0,
        response="log",
        decimals=2,
    ),
    Knob("casts_shadows", "Casts shadows", "bool", "Whether anything throws a shadow in this light.", True),
)

#: Where a light is: `Scene.set_light` takes `direction` and `position`, the panel shows angles and coordinates.
PLACE: tuple[Knob, ...] = (
    Knob(
        "elevation",
        "Elevation",
        "float",
        "How high over the horizon the light comes from: 90° shines straight down.",
        45.0,
        unit="°",
        # Straight up or down there is no azimuth to turn.
        minimum=-89.9,
        maximum=89.9,
        low=-89.9,
        high=89.9,
        decimals=1,
    ),
    Knob(
        "azimuth",
        "Azimuth",
        "float",
        "The side that the light comes from: 0° in front (+Z, or -Y where Z is up), 90° at +X.",
        0.0,
        unit="°",
        minimum=-180.0,
        maximum=180.0,
        low=-180.0,
        high=180.0,
        decimals=1,
    ),
    Knob("position_x", "X", "float", "Where the light is, in the world.", 0.0, "units"),
    Knob("position_y", "Y", "float", "Where the light is, in the world.", 0.0, "units"),
    Knob("position_z", "Z", "float", "Where the light is, in the world.", 0.0, "units"),
)

# --- the renderer -----------------------------------------------------------------------------------------------------

#: What `settings.TABLE` does not say: label, comfortable range, response, choices to read.
_RENDER_LOOKS: Mapping[str, Mapping[str, Any]] = {
    "transmittance": {
        "label": "Transmittance",
        "words": {
            "slices": "Slices along light rays",
            "quantile": "Maps of depths (quantile)",
            "tfm": "Maps of cosines (tfm)",
            "tfm-plain": "Plain cosines (tfm-plain)",
            "march": "March (reference)",
        },
    },
    "coefficients": {"label": "Map values", "low": 2, "high": 16},
    "slices": {"label": "Slices", "low": 28, "high": 560, "response": "log"},
    "steps": {"label": "View steps", "low": 16, "high": 2048, "response": "log"},
    "light_steps": {"label": "Light steps", "low": 16, "high": 2048, "response": "log"},
    "map_size": {"label": "Map size", "low": 8, "high": 2048, "response": "log"},
    "threshold": {"label": "Threshold", "low": 1e-4, "high": 0.2, "response": "log", "decimals": 5},
    "density_weighting": {"label": "Density weight", "low": 1.0, "high": 8.0, "decimals": 2},
    "map_filter": {"label": "Map filter"},
    "march_divisor": {"label": "Marched pixels", "words": {1: "All", 2: "One of 2 × 2", 4: "One of 4 × 4"}},
    "cull_lights": {"label": "Cull lights"},
    "skip_empty": {"label": "Skip empty space"},
    "sparse": {"label": "Sparse densities"},
    "shadow_map_size": {"label": "Shadow map", "low": 64, "high": 8192, "response": "log"},
    "projective_steps": {"label": "Projective steps"},
    "opacity_cutoff": {"label": "Opacity cutoff", "low": 1e-6, "high": 0.1, "response": "log", "decimals": 6},
    "ambient": {"label": "Ambient light", "low": 0.0, "high": 1.0, "decimals": 4},
    "antialias": {"label": "Antialiasing", "low": 1, "high": 4},
    "field_memory": {"label": "Field memory", "low": 16, "high": 4096, "response": "log"},
    "error_pixels": {"label": "Error pixels", "low": 16, "high": 4096, "response": "log"},
}


def _of_setting(setting: Setting) -> Knob:
    kinds: dict[type, Kind] = {bool: "bool", str: "choice", int: "int", float: "float"}
    looks = {"label": setting.name.replace("_", " ").capitalize(), **_RENDER_LOOKS.get(setting.name, {})}
    words = looks.pop("words", {})
    return Knob(
        name=setting.name,
        kind="choice" if setting.choices else kinds[setting.type],
        doc=setting.doc,
        default=setting.default,
        unit="" if setting.unit in ("texels", "radiance", "pixels") else setting.unit,
        minimum=setting.minimum,
        maximum=setting.maximum,
        choices=setting.choices,
        choice_labels=tuple(words.get(choice, str(choice).capitalize()) for choice in setting.choices),
        step=setting.step or 1,
        automatic=setting.automatic,
        **looks,
    )


RENDER: tuple[Knob, ...] = tuple(map(_of_setting, TABLE))

# --- the view ---------------------------------------------------------------------------------------------------------

VIEW: tuple[Knob, ...] = (
    Knob(
        "view_exposure",
        "Exposure",
        "float",
        "Stops by which the picture is brightened for the eye; the stage stays as it is.",
        0.0,
        unit="stops",
        minimum=-30.0,
        maximum=30.0,
        low=-8.0,
        high=8.0,
        decimals=2,
    ),
    Knob(
        "color_correction",
        "Colour",
        "choice",
        "How linear radiance becomes a picture: not at all, by the sRGB curve, or by OpenColorIO.",
        "sRGB",
        choices=("disabled", "sRGB", "openColorIO"),
        choice_labels=("None (linear)", "sRGB", "OpenColorIO"),
    ),
    Knob(
        "measure_error",
        "Measure error",
        "bool",
        "While nothing moves, measure how far the finished picture is from the truth, and say so below.",
        True,
    ),
    Knob(
        "converge",
        "Converge at rest",
        "bool",
        "While nothing moves, go on beyond what the settings ask for: twice the steps and more slices each time, "
        "to a brute-force march in the end. Off, the finished picture is what `previs record` writes.",
        False,
    ),
)


def _by_name(*tables: tuple[Knob, ...]) -> dict[str, Knob]:
    return {knob.name: knob for table in tables for knob in table}


MEDIUM_BY_NAME: Mapping[str, Knob] = _by_name(MEDIUM)
LIGHT_BY_NAME: Mapping[str, Knob] = _by_name(LIGHT)
PLACE_BY_NAME: Mapping[str, Knob] = _by_name(PLACE)
RENDER_BY_NAME: Mapping[str, Knob] = _by_name(RENDER)
VIEW_BY_NAME: Mapping[str, Knob] = _by_name(VIEW)
