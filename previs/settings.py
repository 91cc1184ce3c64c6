"""The one table of knobs.

Every knob of the renderer is one row of `TABLE`: name, type, default, range, unit, what a change of it invalidates,
one sentence. The command line, the Python API and README are generated from these rows or checked against them, so
that a knob has the same name, range and sentence wherever it is met; the plan takes from them which passes a knob
runs again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Invalidates = Literal["fields", "shadow_map", "transmittance_map", "gbuffer", "surface", "march", "composite"]


@dataclass(frozen=True)
class Setting:
    """One knob. `minimum` and `maximum` are inclusive; `choices` lists the only legal values where it is not empty.

    `automatic` says that 0 is legal besides the range and leaves the choice to the plan. `invalidates` names the
    kinds of passes that read the knob: they run again when it changes, and so do the passes that read their output.
    """

    name: str
    default: Any
    doc: str
    invalidates: tuple[Invalidates, ...]
    minimum: float | None = None
    maximum: float | None = None
    step: int | None = None
    automatic: bool = False
    choices: tuple[Any, ...] = ()
    unit: str = ""
    flag: str = ""

    @property
    def type(self) -> type:
        """Type of the value: int, float, str or bool."""
        return type(self.default)

    def parse(self, value: Any) -> Any:
        """The value as this knob's type; accepts text.

        Raises:
            ValueError: with one sentence naming the knob and what it accepts.
        """
        try:
            if self.type is bool:
                parsed = value if isinstance(value, bool) else _TRUTH[str(value).strip().lower()]
            elif self.type is int:
                parsed = int(value) if not isinstance(value, float) or value == int(value) else None
                if isinstance(value, bool) or parsed is None:
                    raise ValueError
            else:
                parsed = self.type(value)
        except (ValueError, TypeError, KeyError, OverflowError):
            raise ValueError(f"{self.name}: {value!r} is not {self.accepts()}") from None
        if self.automatic and parsed == 0:
            return parsed
        below = self.minimum is not None and not parsed >= self.minimum
        above = self.maximum is not None and not parsed <= self.maximum
        stepped = self.step is not None and (parsed - int(self.minimum or 0)) % self.step != 0
        if below or above or stepped or (self.choices and parsed not in self.choices):
            raise ValueError(f"{self.name}: {value!r} is not {self.accepts()}")
        return parsed

    def accepts(self) -> str:
        """What values the knob takes, in words."""
        if self.choices:
            return "one of " + ", ".join(str(c) for c in self.choices)
        if self.type is bool:
            return "true or false"
        kind = {int: "a whole number", float: "a number", str: "text"}[self.type]
        if self.step == 2:
            kind = "an even number"
        if self.automatic:
            kind = "0 or " + kind
        if self.minimum is not None and self.maximum is not None:
            return f"{kind} from {self.minimum:g} to {self.maximum:g}"
        if self.minimum is not None:
            return f"{kind} of {self.minimum:g} or more"
        return kind


_TRUTH = {"1": True, "true": True, "on": True, "yes": True, "0": False, "false": False, "off": False, "no": False}

TABLE: tuple[Setting, ...] = (
    Setting(
        "transmittance",
        "slices",
        "How light is attenuated on its way into the media: slices, the optical depth at even distances along every "
        "light ray, marched once; quantile, maps of the depths at which the transmittance "
        "crosses fixed levels; tfm, adaptive transmittance function maps [ATFM12]; tfm-plain, the maps of [TFM11]; "
        "march, a brute-force march towards every light.",
        ("transmittance_map", "surface", "march"),
        choices=("slices", "quantile", "tfm", "tfm-plain", "march"),
        flag="--transmittance",
    ),
    Setting(
        "coefficients",
        6,
        "Values stored per texel of a transmittance map, coefficients or depths: 6 is interactive, 14 high quality.",
        ("transmittance_map", "surface", "march"),
        minimum=2,
        maximum=16,
        step=2,
        flag="--coefficients",
    ),
    Setting(
        "steps",
        0,
        "Steps of a view ray across the longest diagonal of a volume, shorter paths taking fewer of the same length; "
        "0 takes one for two voxels, and at least 96, in a homogeneous shape 128.",
        ("march",),
        minimum=1,
        maximum=16384,
        automatic=True,
        flag="--steps",
    ),
    Setting(
        "march_divisor",
        1,
        "View rays are marched for one pixel of so many along each side of the picture; those between are interpolated "
        "along the surfaces that end them. 1 marches all pixels.",
        ("march",),
        choices=(1, 2, 4),
        flag="--march-divisor",
    ),
    Setting(
        "light_steps",
        0,
        "Steps of a light ray across the longest diagonal of a volume, when a map is filled or light is marched; "
        "0 takes one per voxel and at least 256 in a map, one for two voxels in slices, and marches exactly, from "
        "voxel to voxel.",
        ("transmittance_map", "surface", "march"),
        minimum=1,
        maximum=16384,
        automatic=True,
    ),
    Setting(
        "map_size",
        0,
        "Texels along the side of a transmittance map; 0 follows the voxels that the light sees.",
        ("transmittance_map",),
        minimum=8,
        maximum=2048,
        automatic=True,
        unit="texels",
        flag="--map-size",
    ),
    Setting(
        "slices",
        0,
        "Depths at which slices keep the optical depth along every light ray, a multiple of 28; 0 follows the voxels.",
        ("transmittance_map",),
        minimum=2,
        maximum=1024,
        automatic=True,
    ),
    Setting(
        "threshold",
        0.0,
        "Transmittance below which the adaptive range of a map ends, judged for the weakest colour channel [ATFM12]. "
        "0 takes 0.01, and 1e-6 for a light inside the volume.",
        ("transmittance_map",),
        minimum=1e-6,
        maximum=0.5,
        automatic=True,
    ),
    Setting(
        "density_weighting",
        0.0,
        "Exponent alpha of [TFM11] section 6.2: maps hold T^(1/alpha). 0 takes 1.5 for quantile, 2 for "
        "tfm, 1 for tfm-plain; for the first two more where a light is inside the volume or channels differ more.",
        ("transmittance_map",),
        minimum=1.0,
        maximum=64.0,
        automatic=True,
    ),
    Setting(
        "map_filter",
        "blend",
        "How adaptive maps look between texels: blend evaluates the four neighbours and blends their transmittance; "
        "stochastic takes one of them at random, by how near it is; nearest takes the nearest.",
        ("surface", "march"),
        choices=("blend", "stochastic", "nearest"),
    ),
    Setting(
        "cull_lights",
        True,
        "Leave out lights where their cone does not reach: of maps, of surfaces and, by lists of lights for parts of "
        "the media, of the march. The picture stays the same.",
        ("shadow_map", "transmittance_map", "surface", "march"),
    ),
    Setting(
        "skip_empty",
        True,
        "Leap over parts of a volume that hold no density.",
        ("march",),
    ),
    Setting(
        "shadow_map_size",
        2048,
        "Texels along the side of one face of a shadow map.",
        ("shadow_map",),
        minimum=16,
        maximum=8192,
        unit="texels",
    ),
    Setting(
        "projective_steps",
        True,
        "Place steps evenly in the light's projection where one spot casts shafts through homogeneous media "
        "[TFM11 section 4.2].",
        ("march",),
    ),
    Setting(
        "opacity_cutoff",
        1e-4,
        "A view ray ends where no channel transmits more than this; what lies behind is lost.",
        ("march",),
        minimum=0.0,
        maximum=0.1,
    ),
    Setting(
        "ambient",
        0.0,
        "Radiance that reaches every point from everywhere, unoccluded: scattered ambient light [TFM11 section 4.3].",
        ("surface", "march"),
        minimum=0.0,
        unit="radiance",
    ),
    Setting(
        "antialias",
        1,
        "Samples along each side of a pixel, averaged by a box; 1 samples pixel centres.",
        ("gbuffer", "march"),
        minimum=1,
        maximum=16,
    ),
    Setting(
        "field_memory",
        512,
        "Memory for one field on the GPU; a larger field is reduced by a box filter, and said so.",
        ("fields",),
        minimum=1,
        maximum=16384,
        unit="MiB",
    ),
    Setting(
        "sparse",
        "auto",
        "Whether densities are held on the GPU in bricks, without what is empty: on, off, or auto for those "
        "that this shrinks by 32 MiB and 30 % or more, or that would not fit field_memory otherwise.",
        ("fields",),
        choices=("auto", "on", "off"),
    ),
    Setting(
        "error_pixels",
        256,
        "Random pixels that are drawn again by brute force to measure the error of a picture.",
        (),
        minimum=16,
        maximum=65536,
        unit="pixels",
    ),
)

BY_NAME: Mapping[str, Setting] = {s.name: s for s in TABLE}


class Settings(Mapping[str, Any]):
    """A complete set of values for the table, immutable. Attribute access: ``settings.coefficients``.

    Args:
        values: values for any of the knobs; the others take their defaults.

    Raises:
        ValueError: for an unknown knob or an illegal value, in one sentence.
    """

    __slots__ = ("_values",)

    def __init__(self, **values: Any) -> None:
        unknown = sorted(set(values) - set(BY_NAME))
        if unknown:
            raise ValueError(f"unknown setting {unknown[0]!r}; known are {', '.join(BY_NAME)}")
        complete = {s.name: s.parse(values[s.name]) if s.name in values else s.default for s in TABLE}
        object.__setattr__(self, "_values", complete)

    def __getattr__(self, name: str) -> Any:
        try:
            return object.__getattribute__(self, "_values")[name]
        except KeyError:
            raise AttributeError(f"unknown setting {name!r}") from None

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError("settings are immutable; use replace()")

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        changed = {n: v for n, v in self._values.items() if v != BY_NAME[n].default}
        return f"Settings({', '.join(f'{n}={v!r}' for n, v in changed.items())})"

    def read_by(self, kind: Invalidates) -> tuple[tuple[str, Any], ...]:
        """The knobs that passes of a kind read, with their values: hashable, to compare between frames."""
        return tuple((s.name, self._values[s.name]) for s in TABLE if kind in s.invalidates)

    def replace(self, **values: Any) -> Settings:
        """A copy with some values changed.

        Raises:
            ValueError: for an unknown knob or an illegal value.
        """
        return Settings(**{**self._values, **values})
