"""What the window shows and how: everything that is neither in the stage nor worth an undo."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

CompareMode = Literal["off", "wipe", "error"]
CompareWith = Literal["coefficients", "march", "before"]

#: What the second picture is, in the order of the menu.
COMPARISONS: dict[CompareWith, str] = {
    "coefficients": "the other of 6 | 14",
    "march": "the reference march",
    "before": "before the last edit",
}


@dataclass(frozen=True)
class Inspection:
    """Where transmittance is inspected: a world point and the light whose ray passes through it."""

    point: tuple[float, float, float]
    light: str


@dataclass
class ViewState:
    """The state of the view.

    Attributes:
        selection: prim path of the selected volume, light, mesh or camera; "" for none.
        camera_path: the stage camera that is looked through; "" for the free camera.
        exposure: stops. `auto_exposure` sets it once from the next finished picture and then clears itself.
        color_correction: "disabled", "sRGB" or "openColorIO", with `ocio_display` and `ocio_view` ("" = default).
        gate_mask: darken what lies outside the aperture of the camera looked through.
        measuring: the error of a picture at rest is measured.
        converging: a picture at rest goes on to the truth, beyond what the settings ask for.
        solo: path of the only light that shines, "" for all.
        compare, compare_with: whether and with what the picture is compared; `divider` in [0, 1] of the width.
        inspecting: a click inspects transmittance instead of selecting.
        inspection: what the transmittance inspector shows.
        playing: whether time advances, `frames_per_second` how fast at most.
    """

    selection: str = ""
    camera_path: str = ""
    exposure: float = 0.0
    auto_exposure: bool = False
    color_correction: str = "sRGB"
    ocio_display: str = ""
    ocio_view: str = ""
    gate_mask: bool = True
    measuring: bool = True
    converging: bool = False
    solo: str = ""
    compare: CompareMode = "off"
    compare_with: CompareWith = "coefficients"
    divider: float = 0.5
    inspecting: bool = False
    inspection: Inspection | None = None
    playing: bool = False
    frames_per_second: float = 24.0


@dataclass
class Message:
    """Something said to the user: `kind` is "error", "warning" or "info", `until` a time of `time.monotonic`."""

    text: str
    kind: Literal["error", "warning", "info"]
    until: float


@dataclass
class Timings:
    """How long things took lately, in seconds: medians are what the status line shows."""

    frames: list[float] = field(default_factory=list)

    def add(self, seconds: float, keep: int = 60) -> None:
        """Remember one more."""
        self.frames.append(seconds)
        del self.frames[:-keep]

    @property
    def median(self) -> float:
        """The median of those remembered, 0 without any."""
        return float(np.median(self.frames)) if self.frames else 0.0
