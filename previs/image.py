"""A rendered picture and what is known about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np

from .meter import ErrorEstimate


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """A linear, scene-referred picture. Arrays are float32 with row 0 at the top.

    Attributes:
        color: (H, W, 3) radiance, premultiplied: media over surfaces over black.
        alpha: (H, W), 1 − mean transmittance to the background.
        depth: (H, W) distance of the first surface along the camera's axis in stage units, infinite where there
            is none.
        aovs: further planes by name, (H, W, 3): ``albedo`` and ``normal`` of surfaces, ``transmittance`` of the view
            ray through the media, ``volume`` (in-scattered light only), ``emission``; each where the scene has it.
        stats: the plan, what ran, times, memory, notes; see `Renderer.render`.
        error: how far it is from the truth, where that was measured.
    """

    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    aovs: Mapping[str, np.ndarray] = field(default_factory=dict)
    stats: Mapping[str, Any] = field(default_factory=dict)
    error: ErrorEstimate | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.color.shape[1], self.color.shape[0]

    def with_error(self, error: ErrorEstimate) -> Image:
        """The same picture with its measured error, also in `stats` under ``measured_error``."""
        return replace(self, error=error, stats={**self.stats, "measured_error": error.to_dict()})

    def __repr__(self) -> str:
        width, height = self.size
        return f"<Image {width}×{height}: {', '.join(('color', 'alpha', 'depth', *self.aovs))}>"

    def save(
        self,
        path: str | PathLike[str],
        exposure: float | str = 0.0,
        color_correction: str = "sRGB",
        ocio_display: str | None = None,
        ocio_view: str | None = None,
    ) -> None:
        """Write the picture; the ending picks the format: .exr linear with all planes, .png or .jpg for display.

        Args:
            path: file to write; it is written beside and renamed, so an existing file is never half replaced.
            exposure: stops applied to display formats, or "auto".
            color_correction: "disabled", "sRGB" or "openColorIO", for display formats.
            ocio_display, ocio_view: names of an OpenColorIO display and of a view of it; None takes the default.

        Raises:
            PrevisError: when the format is unknown, the config has no such display or view, or the file cannot be
                written.
            ValueError: for another exposure or color_correction.
        """
        from .io import save_image

        save_image(self, path, exposure, color_correction, ocio_display, ocio_view)
