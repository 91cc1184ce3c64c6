"""The records of a plan: plain data, made without OpenGL."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ..description import Light, Mesh, Note, Volume
from ..settings import Settings
from .atlas import AtlasLayout
from .light_lists import LightLists
from .projection import MAP_KINDS, SHADOW_KINDS, CameraRays, LightMap, ShadowFit
from .scattered import ScatteredPixels

PassKind = Literal[
    "fields",
    "shadow_map",
    "transmittance_map",
    "gbuffer",
    "gather",
    "surface",
    "march",
    "upsample",
    "composite",
    "floor",
]

PHASE_NUMBERS = {"isotropic": 0, "hg": 1, "schlick": 2, "rayleigh": 3, "two_lobe": 4}
MAP_KINDS_NUMBERS = {kind: number for number, kind in enumerate(MAP_KINDS)}
SHADOW_KIND_NUMBERS = {kind: number for number, kind in enumerate(SHADOW_KINDS)}


Atlases = tuple[AtlasLayout | None, AtlasLayout | None]


@dataclass(frozen=True)
class DeviceLimits:
    """What a device can do, as far as plans depend on it: edges of textures, bytes of a uniform block.

    The defaults are those of most devices in use.
    """

    texture_size: int = 16384
    texture_3d_size: int = 2048
    uniform_block_size: int = 65536


@dataclass(frozen=True, eq=False)
class PlannedPass:
    """One pass: `name` is unique in the plan, `why` one sentence, `inputs` names of the passes it reads.

    `depends` is compared between frames; `memory` are bytes of the textures it fills.
    """

    name: str
    kind: PassKind
    why: str
    resolution: tuple[int, ...]
    memory: int
    depends: Hashable
    inputs: tuple[str, ...] = ()
    payload: Any = None


@dataclass(frozen=True, eq=False)
class PlannedLight:
    """A light, and its shadow map if it needs one: `first_tile` counts faces in the shadow atlas."""

    record: Light
    shadow: ShadowFit | None
    first_tile: int


@dataclass(frozen=True, eq=False)
class PlannedMap:
    """The transmittance map of one light through one volume and its tile in the atlas.

    Curves are stored at the `reference` extinction (per stage unit at density 1) to the power 1 / `weighting`; the
    adaptive range ends where the weakest channel, of extinction `weakest`, falls below the `threshold`. Levels of
    quantiles are `stretched` where channels differ much. `extent` are the texels of the tile that are used, across and
    up.
    """

    light: int
    volume: int
    fit: LightMap
    tile: int
    reference: float
    weakest: float
    weighting: float
    threshold: float
    stretched: bool
    extent: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that is known about a frame before it is drawn."""

    width: int
    height: int
    settings: Settings
    origin: np.ndarray
    rays: CameraRays
    volumes: tuple[Volume, ...]
    lights: tuple[PlannedLight, ...]
    meshes: tuple[Mesh, ...]
    ambient: tuple[float, float, float]
    maps: tuple[PlannedMap, ...]
    map_size: int
    map_slices: int
    shadow_size: int
    shadow_tiles: int
    map_atlas: AtlasLayout
    shadow_atlas: AtlasLayout
    limits: DeviceLimits
    batches: tuple[range, ...]
    slices: tuple[range, ...]
    cuts: int
    defines: Mapping[str, Any]
    passes: tuple[PlannedPass, ...]
    notes: tuple[Note, ...] = field(default=())
    pixels: ScatteredPixels | None = None
    #: One per batch of lights, or none.
    light_lists: tuple[LightLists, ...] = ()
    march_divisor: int = 1

    @property
    def march_size(self) -> tuple[int, int]:
        """(width, height) of what the march draws into: all pixels, or those that the others are interpolated from."""
        if self.march_divisor == 1:
            return self.target_size
        return march_size(self.width, self.height, self.march_divisor)

    @property
    def media_target(self) -> str:
        """Name of the target that holds the media at the size of the picture."""
        return "march" if self.march_divisor == 1 else "upsample"

    @property
    def target_size(self) -> tuple[int, int]:
        """(width, height) of what is drawn into: the picture's, or that of the scattered pixels."""
        return (self.width, self.height) if self.pixels is None else self.pixels.target_size

    def describe(self) -> str:
        """The plan as text: a line per pass with its reason, resolution and memory."""
        lines = []
        for p in self.passes:
            resolution = "×".join(str(n) for n in p.resolution) or "-"
            lines.append(f"{p.name:<44} {resolution:>14} {_bytes(p.memory):>10}  {p.why}")
        total = sum(p.memory for p in self.passes)
        lines.append(f"{'total':<44} {'':>14} {_bytes(total):>10}")
        return "\n".join(lines)


def march_size(width: int, height: int, divisor: int) -> tuple[int, int]:
    """How many pixels are marched along both sides: every `divisor`-th from the first one on, and the last one, so that
    every other pixel lies between some that are."""
    return -(-(width - 1) // divisor) + 1, -(-(height - 1) // divisor) + 1


def _bytes(count: int) -> str:
    return f"{count / 2**20:.1f} MiB" if count >= 2**19 else f"{count / 2**10:.1f} KiB"


def counted(number: int, name: str, plural: str = "s") -> str:
    """A number and what it counts."""
    return f"{number} {name}{plural if number != 1 else ''}"
