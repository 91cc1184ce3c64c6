"""The interchangeable ways to attenuate light on its way into the media, and what each needs of the pipeline.

A method is a row of `METHODS`: how its maps are generated and looked up (defines of the shaders), what a texel holds,
and what it is content with where knobs are left to the plan. The names are those of the `transmittance` knob.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..description import Light, Volume, volume_box
from ..settings import Settings

Curve = Literal["cosine", "quantile", "slices"]

CURVE_NUMBERS: Mapping[Curve, int] = {"cosine": 0, "quantile": 1, "slices": 2}
#: Slices of a light-space grid that one draw makes: seven textures of four, and one for what they came to.
SLICES_PER_DRAW = 28
#: Transmittance at which an adaptive range ends when that is left to the plan [ATFM12].
THRESHOLD = 0.01
#: The same for a light inside a volume. All that is seen of it from outside has passed most of the medium, where
#: nothing brighter is beside it: the curve must be known far below the usual threshold, in a power that keeps its
#: digits there.
THRESHOLD_INSIDE, WEIGHTING_INSIDE = 1e-6, 8.0
#: From this ratio between the strongest and the weakest channel on, quantiles are of a stretched exponential, which
#: resolves both ends of what channels ask for; the exponent is then this part of the ratio.
STRETCHED_FROM, STRETCHED_WEIGHTING = 8.0, 0.16
#: No power is stored higher than this: the root of a curve gets so flat that half floats blur it.
MOST_WEIGHTING = 16.0


@dataclass(frozen=True)
class Method:
    """One way to find the transmittance from a light to a point.

    Attributes:
        name: value of the `transmittance` knob.
        curve: what a texel of its maps holds; None for a method without maps.
        adaptive: whether every texel has a range of its own [ATFM12], so that lookups evaluate neighbouring texels
            one by one; else all share the volume's bounds [TFM11] and the texture unit blends coefficients.
        weighting: exponent α where it is left to the plan: maps hold T^(1/α) [TFM11 section 6.2].
        values: what its numbers are called.
        words: what it does, for the plan's reason, after the number of values.
    """

    name: str
    curve: Curve | None
    adaptive: bool
    weighting: float
    values: str
    words: str

    @property
    def has_maps(self) -> bool:
        """Whether it fills transmittance maps."""
        return self.curve is not None

    @property
    def has_coefficients(self) -> bool:
        """Whether its maps store the values that the knob `coefficients` counts."""
        return self.curve in ("cosine", "quantile")

    def why(self, coefficients: int) -> str:
        """A few words on it for a plan."""
        return f"{coefficients} {self.values}, {self.words}" if self.values else self.words

    def defines(self, settings: Settings) -> dict[str, int | bool]:
        """What the shaders are compiled for."""
        if self.curve == "slices":
            # Of their own number and texture: no variants for what others store.
            return {
                "HAS_MAPS": True,
                "MAP_ADAPTIVE": False,
                "MAP_CURVE": CURVE_NUMBERS["slices"],
                "COEFFICIENTS": 0,
                "MAP_LAYERS": 0,
                "MAP_FILTER": 0,
            }
        return {
            "HAS_MAPS": self.has_maps,
            "MAP_ADAPTIVE": self.adaptive,
            "MAP_CURVE": CURVE_NUMBERS[self.curve or "cosine"],
            "COEFFICIENTS": settings.coefficients,
            "MAP_LAYERS": self.layers(settings),
            "MAP_FILTER": ("nearest", "blend", "stochastic").index(settings.map_filter),
        }

    def layers(self, settings: Settings) -> int:
        """RGBA textures of half floats that its maps take besides that of the range: the values, then the extinction of
        the tail and what the curve has come to at the range's end."""
        return -(-(settings.coefficients + 2) // 4)

    def texel_bytes(self, settings: Settings, slices: int = 0) -> int:
        """Bytes of a texel in all textures; the range is of four 32-bit floats. Of `slices` there are so many."""
        if self.curve == "slices":
            return 2 * slices
        return 16 + 8 * self.layers(settings)


METHODS: Mapping[str, Method] = {
    m.name: m
    for m in (
        Method("tfm", "cosine", True, 2.0, "coefficients", "adaptive range"),
        Method("tfm-plain", "cosine", False, 1.0, "coefficients", "full range"),
        Method("quantile", "quantile", True, 1.5, "depths", "quantiles of the transmittance"),
        Method("slices", "slices", False, 1.0, "", "light marched once along every light ray, into slices"),
        Method("march", None, False, 1.0, "", "brute force towards every light"),
    )
}

#: The method whose maps of few values are the most accurate.
BEST_MAP = "quantile"


def method_of(settings: Settings) -> Method:
    """The method that the settings ask for."""
    return METHODS[settings.transmittance]


def stored_curve(light: Light, volume: Volume, settings: Settings) -> tuple[float, float, bool]:
    """Exponent α of the stored curve ([TFM11] section 6.2), the threshold at which its adaptive range ends, and whether
    its levels are stretched.

    Cosines of a medium whose channels differ need an exponent as large as they differ, so that the curve of the
    strongest channel is not gone where the weakest still transmits; quantiles take other levels.
    """
    method = method_of(settings)
    weighting, threshold = settings.density_weighting, settings.threshold
    inside = method.adaptive and _is_inside(light, volume)
    spread = max(volume.medium.strength) / min(s for s in volume.medium.strength if s > 0.0)
    stretched = method.curve == "quantile" and spread > STRETCHED_FROM
    if weighting <= 0.0:
        least = WEIGHTING_INSIDE if inside else method.weighting
        if stretched:
            weighting = max(least, STRETCHED_WEIGHTING * spread)
        elif method.adaptive:
            weighting = min(max(least, spread if method.curve == "cosine" else 1.0), MOST_WEIGHTING)
        else:
            weighting = method.weighting
    if threshold <= 0.0:
        threshold = THRESHOLD_INSIDE if inside else THRESHOLD
    return weighting, threshold, stretched


def _is_inside(light: Light, volume: Volume) -> bool:
    """Whether a light is within the bounds of a volume."""
    if light.kind == "distant":
        return False
    lo, hi, to_world = volume_box(volume)
    local = np.append(light.position, 1.0) @ np.linalg.inv(to_world)
    return bool(np.all(local[:3] >= lo) and np.all(local[:3] <= hi))
